!> A layer of points beyond the sides of a lattice.
!>
!> On an even lattice, functions of order 1 with the cubic kernel and a support of two spacings are
!> cubic B-splines, and those near a side have no second derivative normal to it: they form a
!> natural spline. A free side that contracts, a bent beam or the flow along a wall has one, so that
!> errors at sides are of second order, and alternate with the spacings into the body. With a
!> further layer of points, whose coefficients lie on the parabola through those of the three
!> nearest ones, each function is a spline with a parabolic run-out. The unknowns remain the same.
!>
!> Reference: de Boor, A Practical Guide to Splines, doi:10.1007/978-1-4612-6333-3, chapter IV
module rk_margin
   use rk_place_shape, only : on_plane
   use rk_precision, only : wp
   implicit none
   private

   public :: margin_type, new_margin

   !> Points of a lattice and of the layers beyond its sides, and what stands for the latter
   type :: margin_type
      !> Points, shape (nd, n) [length]
      real(wp), allocatable :: point(:, :)
      !> Their supports, shape (nd, n) [length]
      real(wp), allocatable :: support(:, :)
      !> Sides that each lies beyond: the sum of 2**(side - 1), in the order of the sides of boxes
      integer, allocatable :: beyond(:)
      !> Number of source points that stand for each, themselves for points of the lattice
      integer, allocatable :: count(:)
      !> These source points and their factors, shape (most, n)
      integer, allocatable :: source(:, :)
      real(wp), allocatable :: factor(:, :)
   end type margin_type

   !> Points on the parabola
   integer, parameter :: on_parabola = 3

contains

!> Add the layers; a side has none where there are too few points, or where a plane on which
!> materials meet lies before the third one
subroutine new_margin(self, lattice, source, support, kink_axis, kink)
   type(margin_type), intent(out) :: self
   !> Source points along each axis, shape (nd)
   integer, intent(in) :: lattice(:)
   !> Source points, the last axis fastest, shape (nd, ns) [length]
   real(wp), intent(in) :: source(:, :)
   !> Their supports, shape (nd, ns) [length]
   real(wp), intent(in) :: support(:, :)
   !> Planes across which derivatives jump: axis and position [length]
   integer, intent(in), optional :: kink_axis(:)
   real(wp), intent(in), optional :: kink(:)
   real(wp) :: factor(on_parabola, 2, size(lattice)), share(on_parabola, 3), place(2, size(lattice))
   integer :: low(3), high(3), at(3), other(on_parabola, 3), step(3), parts(3)
   integer :: d, end, i, j, k, m, n, nd

   nd = size(lattice)
   low = 1
   high = 1
   high(:nd) = lattice
   step = 0
   step(nd) = 1
   do d = nd - 1, 1, -1
      step(d) = step(d + 1)*lattice(d + 1)
   end do
   do d = 1, nd
      do end = 1, 2
         if (.not. is_open(d, end)) cycle
         associate (x => line(d, end))
            place(end, d) = 2.0_wp*x(1) - x(2)
            do i = 1, on_parabola
               factor(i, end, d) = product((place(end, d) - pack(x, [1, 2, 3] /= i)) &
                  & /(x(i) - pack(x, [1, 2, 3] /= i)))
            end do
         end associate
         if (end == 1) low(d) = 0
         if (end == 2) high(d) = lattice(d) + 1
      end do
   end do

   n = product(high - low + 1)
   allocate (self%point(nd, n), self%support(nd, n), self%beyond(n), self%count(n))
   allocate (self%source(on_parabola**nd, n), source=0)
   allocate (self%factor(on_parabola**nd, n), source=0.0_wp)
   do m = 1, n
      at = low + [mod(m - 1, width(1)), mod((m - 1)/width(1), width(2)), &
         & (m - 1)/(width(1)*width(2))]
      parts = 1
      share = 1.0_wp
      other = spread(at, 1, on_parabola)
      self%beyond(m) = 0
      do d = 1, nd
         if (at(d) >= 1 .and. at(d) <= lattice(d)) cycle
         end = merge(1, 2, at(d) < 1)
         self%beyond(m) = self%beyond(m) + 2**(2*d + end - 3)
         parts(d) = on_parabola
         share(:, d) = factor(:, end, d)
         other(:, d) = [(merge(i, lattice(d) + 1 - i, end == 1), i=1, on_parabola)]
         at(d) = other(1, d)
      end do
      associate (nearest => own(at))
         self%point(:, m) = source(:, nearest)
         self%support(:, m) = support(:, nearest)
      end associate
      do d = 1, nd
         if (parts(d) > 1) self%point(d, m) = place(merge(1, 2, at(d) == 1), d)
      end do
      self%count(m) = 0
      do k = 1, parts(3)
         do j = 1, parts(2)
            do i = 1, parts(1)
               self%count(m) = self%count(m) + 1
               self%source(self%count(m), m) = own([other(i, 1), other(j, 2), other(k, 3)])
               self%factor(self%count(m), m) = share(i, 1)*share(j, 2)*share(k, 3)
            end do
         end do
      end do
   end do

contains

   !> Number of points along an axis, layers included
   pure integer function width(d)
      integer, intent(in) :: d

      width = high(d) - low(d) + 1
   end function width

   !> Source point at a position of the lattice
   pure integer function own(at)
      integer, intent(in) :: at(3)

      own = 1 + dot_product(at - 1, step)
   end function own

   !> Coordinates of the points nearest to a side [length]
   pure function line(d, end) result(x)
      integer, intent(in) :: d, end
      real(wp) :: x(on_parabola)
      integer :: i

      x = [(source(d, 1 + step(d)*merge(i - 1, lattice(d) - i, end == 1)), i=1, on_parabola)]
   end function line

   !> Whether a layer lies beyond a side
   pure logical function is_open(d, end)
      integer, intent(in) :: d, end
      real(wp) :: x(on_parabola)

      is_open = lattice(d) >= on_parabola
      if (.not. (is_open .and. present(kink))) return
      x = line(d, end)
      ! a parabola does not bend at a plane
      is_open = .not. any(kink_axis == d &
         & .and. abs(kink - x(1)) < (1.0_wp - on_plane)*abs(x(3) - x(1)))
   end function is_open

end subroutine new_margin

end module rk_margin
