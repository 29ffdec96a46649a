!> Force of muscle fibers as a function of stretch: active and passive curves.
!>
!> A curve is a list of pieces between stretches. It is stored as its integral, one polynomial plus
!> exponential per piece, so that energy, force and the slopes of the force are consistent.
!>
!> The published curves have kinks. The smooth ones replace the curve around each break by the
!> polynomial of degree 7 that continues value and three derivatives on either side, since the rows
!> of the strong form need the second derivative of the force. Where a curve starts from zero, the
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

   !> Integral of a force over the stretch between two breaks: sum c(k) t^k + amplitude exp(rate t),
   !> t = stretch - centre
   type :: piece_type
      !> Stretch above which the piece applies [-]
      real(wp) :: start = 0.0_wp
      !> Centre of the powers [-]
      real(wp) :: centre = 0.0_wp
      !> Coefficients of the powers [-]
      real(wp) :: c(0:degree) = 0.0_wp
      !> Factor of the exponential [-]
      real(wp) :: amplitude = 0.0_wp
      !> Rate of the exponential [-]
      real(wp) :: rate = 1.0_wp
   end type piece_type

   !> Integral of a force over the stretch, piece by piece
   type :: curve_type
      private
      !> Number of pieces
      integer :: n = 0
      type(piece_type) :: piece(max_pieces)
   end type curve_type

contains

!> Active force (4.38), zero outside [0.4, 1.6]
pure function active_curve(smooth) result(curve)
   !> Smooth, or else as published
   logical, intent(in) :: smooth
   type(curve_type) :: curve
   type(piece_type) :: branch(5)

   branch(2) = new_branch(0.4_wp, [0.0_wp, 0.0_wp, 9.0_wp])
   branch(3) = new_branch(1.0_wp, [1.0_wp, 0.0_wp, -4.0_wp])
   branch(4) = new_branch(1.6_wp, [0.0_wp, 0.0_wp, 9.0_wp])
   curve = new_curve(branch, [0.4_wp, 0.6_wp, 1.4_wp, 1.6_wp], &
      & [0.0_wp, 0.05_wp, 0.05_wp, 0.15_wp], [0.15_wp, 0.05_wp, 0.05_wp, 0.0_wp], smooth)
end function active_curve

!> Passive force (4.37), the third branch continuing value and slope of the second
pure function passive_curve(smooth, gamma1, gamma2) result(curve)
   !> Smooth, or else as published
   logical, intent(in) :: smooth
   !> Factor [-]
   real(wp), intent(in) :: gamma1
   !> Rate, > 0 [-]
   real(wp), intent(in) :: gamma2
   type(curve_type) :: curve
   type(piece_type) :: branch(3)
   real(wp) :: growth

   growth = gamma1*exp(0.4_wp*gamma2)
   branch(2) = new_branch(1.0_wp, [-gamma1, 0.0_wp, 0.0_wp])
   branch(2)%amplitude = gamma1/gamma2
   branch(2)%rate = gamma2
   branch(3) = new_branch(1.4_wp, [growth - gamma1, growth*gamma2, 0.0_wp])
   curve = new_curve(branch, [1.0_wp, 1.4_wp], [0.0_wp, 0.05_wp], [0.15_wp, 0.05_wp], smooth)
end function passive_curve

!> Force sum c(k) t^k, t = stretch - centre, as in the thesis
pure function new_branch(centre, c) result(branch)
   !> Centre of the powers [-]
   real(wp), intent(in) :: centre
   !> Coefficients [-]
   real(wp), intent(in) :: c(0:)
   !> Its integral
   type(piece_type) :: branch
   integer :: k

   branch%centre = centre
   do k = 0, ubound(c, 1)
      branch%c(k + 1) = c(k)/(k + 1)
   end do
end function new_branch

!> Integral of the force from stretch 1, the force and its derivatives with respect to the stretch
pure subroutine evaluate_curve(curve, stretch, order, d)
   type(curve_type), intent(in) :: curve
   !> Normalised stretch, lambda* [-]
   real(wp), intent(in) :: stretch
   !> Highest derivative of the integral to be computed, 0..4
   integer, intent(in) :: order
   !> d(0) integral, d(1) force, d(2).. slopes of the force, up to d(order) [-]
   real(wp), intent(out) :: d(0:)
   integer :: i

   i = 1
   do while (i < curve%n)
      if (.not. stretch > curve%piece(i + 1)%start) exit
      i = i + 1
   end do
   call evaluate_piece(curve%piece(i), stretch, order, d)
end subroutine evaluate_curve

!> The same for one piece, also outside the interval where it applies
pure subroutine evaluate_piece(piece, stretch, order, d)
   type(piece_type), intent(in) :: piece
   !> Normalised stretch [-]
   real(wp), intent(in) :: stretch
   integer, intent(in) :: order
   !> Integral and its derivatives, up to d(order) [-]
   real(wp), intent(out) :: d(0:)
   real(wp) :: t, power
   integer :: k, m

   t = stretch - piece%centre
   d(0:order) = 0.0_wp
   do k = degree, 0, -1
      do m = order, 1, -1
         d(m) = d(m)*t + d(m - 1)
      end do
      d(0) = d(0)*t + piece%c(k)
   end do
   power = 1.0_wp
   do m = 2, order
      power = power*m
      d(m) = d(m)*power
   end do
   if (abs(piece%amplitude) > 0.0_wp) then
      power = piece%amplitude*exp(piece%rate*t)
      do m = 0, order
         d(m) = d(m) + power
         power = power*piece%rate
      end do
   end if
end subroutine evaluate_piece

!> Curve of branches that meet at breaks, with blended zones around the breaks
pure function new_curve(branch, break, below, above, smooth) result(curve)
   !> Integrals of the forces between the breaks, shape (breaks + 1)
   type(piece_type), intent(in) :: branch(:)
   !> Stretches where the branches meet, ascending [-]
   real(wp), intent(in) :: break(:)
   !> Width of the blended zone below a break [-]
   real(wp), intent(in) :: below(:)
   !> Width of the blended zone above a break [-]
   real(wp), intent(in) :: above(:)
   !> Whether there are blended zones
   logical, intent(in) :: smooth
   type(curve_type) :: curve
   real(wp) :: left(0:4), right(0:4), first, last, at_one(0:0)
   integer :: i

   call append(curve, branch(1), 0.0_wp)
   do i = 1, size(break)
      first = break(i)
      last = break(i)
      if (smooth) then
         first = break(i) - below(i)
         last = break(i) + above(i)
         call evaluate_curve(curve, first, 4, left)
         call evaluate_piece(branch(i + 1), last, 4, right)
         call append(curve, blend(first, last - first, left(1:4), right(1:4)), first)
      end if
      call append(curve, branch(i + 1), last)
   end do
   call evaluate_curve(curve, 1.0_wp, 0, at_one)
   do i = 1, curve%n
      curve%piece(i)%c(0) = curve%piece(i)%c(0) - at_one(0)
   end do
end function new_curve

!> Append a piece; its integral continues that of the piece before
pure subroutine append(curve, piece, start)
   type(curve_type), intent(inout) :: curve
   !> Piece, whose integral is known up to a constant
   type(piece_type), intent(in) :: piece
   !> Stretch above which it applies [-]
   real(wp), intent(in) :: start
   real(wp) :: before(0:0), begin(0:0)

   before = 0.0_wp
   if (curve%n > 0) call evaluate_curve(curve, start, 0, before)
   call evaluate_piece(piece, start, 0, begin)
   curve%n = curve%n + 1
   curve%piece(curve%n) = piece
   curve%piece(curve%n)%start = start
   curve%piece(curve%n)%c(0) = piece%c(0) + before(0) - begin(0)
end subroutine append

!> Polynomial force of degree 7 with four given values and derivatives at either end
pure function blend(start, width, left, right) result(piece)
   !> Stretch where it begins [-]
   real(wp), intent(in) :: start
   !> Width [-]
   real(wp), intent(in) :: width
   !> Force and three derivatives at the start [-]
   real(wp), intent(in) :: left(0:3)
   !> Force and three derivatives at the end [-]
   real(wp), intent(in) :: right(0:3)
   type(piece_type) :: piece
   real(wp) :: low(0:3), gap(0:3), b(0:3), high(4:7)
   integer :: k

   ! In u = (stretch - start)/width: low powers from the left, then u^4 times a cubic in u - 1
   low = left*[1.0_wp, width, width**2/2.0_wp, width**3/6.0_wp]
   gap = right*[1.0_wp, width, width**2/2.0_wp, width**3/6.0_wp] &
      & - [sum(low), low(1) + 2.0_wp*low(2) + 3.0_wp*low(3), low(2) + 3.0_wp*low(3), low(3)]
   b(0) = gap(0)
   b(1) = gap(1) - 4.0_wp*b(0)
   b(2) = gap(2) - 6.0_wp*b(0) - 4.0_wp*b(1)
   b(3) = gap(3) - 4.0_wp*b(0) - 6.0_wp*b(1) - 4.0_wp*b(2)
   high = [b(0) - b(1) + b(2) - b(3), b(1) - 2.0_wp*b(2) + 3.0_wp*b(3), b(2) - 3.0_wp*b(3), b(3)]

   piece = new_branch(start, [low, high]/[(width**k, k=0, 7)])
end function blend

end module rk_fiber
