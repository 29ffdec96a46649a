!> Force of muscle fibers against their stretch: active and passive curves.
!>
!> A curve is a list of pieces between stretches. It is kept as its integral, a polynomial plus
!> an exponential a piece, so that energy, force and the slopes of the force come from one place.
!>
!> The published curves have kinks. The smooth ones replace the curve around each break by the
!> polynomial of degree 7 that continues value and three derivatives on either side; the rows of
!> the strong form take the second derivative of the force. Where a curve starts from zero, the
!> polynomial lies on the far side only, so that the curve stays zero where it was zero. With the
!> default parameters they differ by less than 2 % of the peak.
!>
!> References: thesis (4.36)-(4.38), with two corrections: the third branch of (4.37) continues
!>             value and slope of the second, the active curve is zero outside [0.4, 1.6];
!>             Zajac, Crit. Rev. Biomed. Eng. 17 (1989) 359-411;
!>             Blemker, Pinsky, Delp, J. Biomech. 38 (2005), doi:10.1016/j.jbiomech.2004.04.009
module rk_fiber
   use rk_precision, only : wp
   implicit none
   private

   public :: curve_type, active_curve, passive_curve, evaluate_curve

   !> Degree of the polynomials of the integral
   integer, parameter :: degree = 8
   !> Largest number of pieces
   integer, parameter :: max_pieces = 9

   !> Force f = sum c(k) t^k + amplitude exp(rate t), t = stretch - centre, as in the thesis
   type :: branch_type
      !> Centre of the powers [-]
      real(wp) :: centre = 0.0_wp
      !> Coefficients [-]
      real(wp) :: c(0:2) = 0.0_wp
      !> Factor of the exponential [-]
      real(wp) :: amplitude = 0.0_wp
      !> Rate of the exponential, not zero [-]
      real(wp) :: rate = 1.0_wp
   end type branch_type

   !> Integral of a force by the stretch, piece by piece
   type :: curve_type
      private
      !> Number of pieces
      integer :: n = 0
      !> Stretch above which a piece holds [-]
      real(wp) :: start(max_pieces) = 0.0_wp
      !> Centre of the powers [-]
      real(wp) :: centre(max_pieces) = 0.0_wp
      !> Coefficients of the powers [-]
      real(wp) :: c(0:degree, max_pieces) = 0.0_wp
      !> Factor of the exponential [-]
      real(wp) :: amplitude(max_pieces) = 0.0_wp
      !> Rate of the exponential [-]
      real(wp) :: rate(max_pieces) = 1.0_wp
   end type curve_type

contains

!> Active force (4.38), zero outside [0.4, 1.6]
pure function active_curve(smooth) result(curve)
   !> Smooth or as published?
   logical, intent(in) :: smooth
   !> Curve
   type(curve_type) :: curve
   type(branch_type) :: branch(5)

   branch(2) = branch_type(0.4_wp, [0.0_wp, 0.0_wp, 9.0_wp])
   branch(3) = branch_type(1.0_wp, [1.0_wp, 0.0_wp, -4.0_wp])
   branch(4) = branch_type(1.6_wp, [0.0_wp, 0.0_wp, 9.0_wp])
   curve = new_curve(branch, [0.4_wp, 0.6_wp, 1.4_wp, 1.6_wp], &
      & [0.0_wp, 0.05_wp, 0.05_wp, 0.15_wp], [0.15_wp, 0.05_wp, 0.05_wp, 0.0_wp], smooth)
end function active_curve

!> Passive force (4.37), the third branch continuing value and slope of the second
pure function passive_curve(smooth, gamma1, gamma2) result(curve)
   !> Smooth or as published?
   logical, intent(in) :: smooth
   !> Factor [-]
   real(wp), intent(in) :: gamma1
   !> Rate, > 0 [-]
   real(wp), intent(in) :: gamma2
   !> Curve
   type(curve_type) :: curve
   type(branch_type) :: branch(3)
   real(wp) :: growth

   growth = gamma1*exp(0.4_wp*gamma2)
   branch(2) = branch_type(1.0_wp, [-gamma1, 0.0_wp, 0.0_wp], gamma1, gamma2)
   branch(3) = branch_type(1.4_wp, [growth - gamma1, growth*gamma2, 0.0_wp])
   curve = new_curve(branch, [1.0_wp, 1.4_wp], [0.0_wp, 0.05_wp], [0.15_wp, 0.05_wp], smooth)
end function passive_curve

!> Integral of the force from stretch 1, the force and its derivatives by the stretch
pure subroutine evaluate_curve(curve, stretch, order, d)
   type(curve_type), intent(in) :: curve
   !> Normalised stretch, lambda* [-]
   real(wp), intent(in) :: stretch
   !> Highest derivative of the integral wanted, 0..4
   integer, intent(in) :: order
   !> d(0) integral, d(1) force, d(2).. its slopes, up to d(order) [-]
   real(wp), intent(out) :: d(0:)
   integer :: i

   i = 1
   do while (i < curve%n)
      if (.not. stretch > curve%start(i + 1)) exit
      i = i + 1
   end do
   call evaluate_piece(curve, i, stretch, order, d)
end subroutine evaluate_curve

!> The same for one piece, also outside the interval where it holds
pure subroutine evaluate_piece(curve, i, stretch, order, d)
   type(curve_type), intent(in) :: curve
   !> Number of the piece
   integer, intent(in) :: i
   !> Normalised stretch [-]
   real(wp), intent(in) :: stretch
   integer, intent(in) :: order
   !> Integral and its derivatives, up to d(order) [-]
   real(wp), intent(out) :: d(0:)
   real(wp) :: t, power
   integer :: k, m

   t = stretch - curve%centre(i)
   d(0:order) = 0.0_wp
   do k = degree, 0, -1
      do m = order, 1, -1
         d(m) = d(m)*t + d(m - 1)
      end do
      d(0) = d(0)*t + curve%c(k, i)
   end do
   power = 1.0_wp
   do m = 2, order
      power = power*m
      d(m) = d(m)*power
   end do
   if (abs(curve%amplitude(i)) > 0.0_wp) then
      power = curve%amplitude(i)*exp(curve%rate(i)*t)
      do m = 0, order
         d(m) = d(m) + power
         power = power*curve%rate(i)
      end do
   end if
end subroutine evaluate_piece

!> Curve of branches that meet at breaks, with blended zones around the breaks
pure function new_curve(branch, break, below, above, smooth) result(curve)
   !> Forces between the breaks, shape (breaks + 1)
   type(branch_type), intent(in) :: branch(:)
   !> Stretches where the branches meet, rising [-]
   real(wp), intent(in) :: break(:)
   !> Width of the blended zone below a break [-]
   real(wp), intent(in) :: below(:)
   !> Width of the blended zone above a break [-]
   real(wp), intent(in) :: above(:)
   !> Are there blended zones?
   logical, intent(in) :: smooth
   !> Curve
   type(curve_type) :: curve
   type(curve_type) :: beyond
   real(wp) :: left(0:4), right(0:4), first, last, at_one(0:0)
   integer :: i

   call add_branch(curve, branch(1), 0.0_wp)
   do i = 1, size(break)
      first = break(i)
      last = break(i)
      if (smooth) then
         first = break(i) - below(i)
         last = break(i) + above(i)
         call evaluate_curve(curve, first, 4, left)
         beyond = curve_type()
         call add_branch(beyond, branch(i + 1), last)
         call evaluate_piece(beyond, 1, last, 4, right)
         call add_blend(curve, first, last - first, left(1:4), right(1:4))
      end if
      call add_branch(curve, branch(i + 1), last)
   end do
   call evaluate_curve(curve, 1.0_wp, 0, at_one)
   curve%c(0, :curve%n) = curve%c(0, :curve%n) - at_one(0)
end function new_curve

!> Append a branch, its integral continuing that of the piece before
pure subroutine add_branch(curve, branch, start)
   type(curve_type), intent(inout) :: curve
   !> Force
   type(branch_type), intent(in) :: branch
   !> Stretch above which it holds [-]
   real(wp), intent(in) :: start
   integer :: k
   real(wp) :: before(0:0)

   before = 0.0_wp
   if (curve%n > 0) call evaluate_curve(curve, start, 0, before)
   curve%n = curve%n + 1
   curve%start(curve%n) = start
   curve%centre(curve%n) = branch%centre
   do k = 0, 2
      curve%c(k + 1, curve%n) = branch%c(k)/(k + 1)
   end do
   curve%rate(curve%n) = branch%rate
   curve%amplitude(curve%n) = branch%amplitude/branch%rate
   call close_gap(curve, before(0))
end subroutine add_branch

!> Append the polynomial force of degree 7 with four given derivatives at both ends
pure subroutine add_blend(curve, start, width, left, right)
   type(curve_type), intent(inout) :: curve
   !> Stretch where it begins [-]
   real(wp), intent(in) :: start
   !> Width [-]
   real(wp), intent(in) :: width
   !> Force and three derivatives at the start [-]
   real(wp), intent(in) :: left(0:3)
   !> Force and three derivatives at the end [-]
   real(wp), intent(in) :: right(0:3)
   real(wp) :: low(0:3), gap(0:3), b(0:3), high(4:7), c(0:7), before(0:0)
   integer :: k

   call evaluate_curve(curve, start, 0, before)
   ! In u = (stretch - start)/width: low powers from the left, then u^4 times a cubic in u - 1
   low = left*[1.0_wp, width, width**2/2.0_wp, width**3/6.0_wp]
   gap = right*[1.0_wp, width, width**2/2.0_wp, width**3/6.0_wp] &
      & - [sum(low), low(1) + 2.0_wp*low(2) + 3.0_wp*low(3), low(2) + 3.0_wp*low(3), low(3)]
   b(0) = gap(0)
   b(1) = gap(1) - 4.0_wp*b(0)
   b(2) = gap(2) - 6.0_wp*b(0) - 4.0_wp*b(1)
   b(3) = gap(3) - 4.0_wp*b(0) - 6.0_wp*b(1) - 4.0_wp*b(2)
   high = [b(0) - b(1) + b(2) - b(3), b(1) - 2.0_wp*b(2) + 3.0_wp*b(3), b(2) - 3.0_wp*b(3), b(3)]

   curve%n = curve%n + 1
   curve%start(curve%n) = start
   curve%centre(curve%n) = start
   c = [low, high]
   do k = 0, 7
      curve%c(k + 1, curve%n) = c(k)/width**k/(k + 1)
   end do
   call close_gap(curve, before(0))
end subroutine add_blend

!> Make the integral of the last piece start at a value
pure subroutine close_gap(curve, before)
   type(curve_type), intent(inout) :: curve
   !> Integral at the start of the last piece [-]
   real(wp), intent(in) :: before
   real(wp) :: begin(0:0)

   call evaluate_piece(curve, curve%n, curve%start(curve%n), 0, begin)
   curve%c(0, curve%n) = curve%c(0, curve%n) + before - begin(0)
end subroutine close_gap

end module rk_fiber
