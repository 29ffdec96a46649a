!> Reproducing kernel shape functions at one position.
!>
!> The moment matrix is factorised once; its derivatives are never formed: the vectors M_,i b and
!> M_,ij b are accumulated from the neighbours.
!>
!> Across a plane on which materials meet derivatives jump. Where such a plane separates the
!> neighbours of a position, their distance from the plane, a ridge |x - c|, is added to the basis,
!> so that fields that are linear on each side are reproduced. A small number on the diagonal of its
!> moment makes it fade where only distant neighbours lie beyond the plane. With windows in radius
!> and angle planes are replaced by circles, and ridges are |r - c|.
!>
!> References: thesis section 4.2.1 and equations (5.1)-(5.5);
!>             Liu, Jun, Zhang, Int. J. Numer. Meth. Fluids 20 (1995), doi:10.1002/fld.1650200824;
!>             Fleming, Chu, Moran, Belytschko, Int. J. Numer. Meth. Engng 40 (1997) 1483-1504
!>             (enriched basis)
module rk_place_shape
   use rk_basis, only : monomials, second_index
   use rk_error, only : err_input, error_type, fatal_error
   use rk_kernel, only : kernel_names, polar_window, window, window_names, window_polar, &
      & window_product
   use rk_precision, only : wp
   implicit none
   private

   public :: approximation_type, new_approximation, shape_at_place, on_plane

   !> Parameters of the approximation
   type :: approximation_type
      !> Order of the basis, 0..6
      integer :: order
      !> One of the kernel_* constants
      integer :: kernel
      !> One of the window_* constants
      integer :: window
      !> Planes across which derivatives may jump: the axis across each, and its position [length];
      !> for windows in radius and angle circles: 1, and the radius; not allocated if there are none
      integer, allocatable :: kink_axis(:)
      real(wp), allocatable :: kink(:)
   contains
      procedure :: across
   end type approximation_type

   !> A pivot below this share of the unit diagonal means a singular moment matrix
   real(wp), parameter :: pivot_min = 1.0e-13_wp
   !> Positions this near to a plane, in supports, spacings or groups of cells, are taken to lie on
   !> it, and have the derivatives of the side beyond it [-]
   real(wp), parameter :: on_plane = 1.0e-9_wp
   !> Number added to the moment of a ridge, relative to the kernel's largest value: beams and bars
   !> of two materials are as accurate with a third and three times of it
   real(wp), parameter :: fading = 6.0e-4_wp

contains

!> Approximation from the names of kernel and window in decks
subroutine new_approximation(self, order, kernel, window, error)
   type(approximation_type), intent(out) :: self
   integer, intent(in) :: order
   character(len=*), intent(in) :: kernel, window
   !> Error handling: no such kernel or window
   type(error_type), allocatable, intent(out) :: error

   self%order = order
   self%kernel = findloc(kernel_names, kernel, dim=1)
   self%window = findloc(window_names, window, dim=1)
   if (min(self%kernel, self%window) == 0) call fatal_error(error, err_input, "kernel '"//kernel &
      & //"' or window '"//window//"' is unknown; available: quintic cubic; product radial polar")
end subroutine new_approximation

!> Coordinate of a position across a plane, or its radius for a circle [length]
pure real(wp) function across(self, k, x)
   class(approximation_type), intent(in) :: self
   !> Plane
   integer, intent(in) :: k
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)

   if (self%window == window_polar) then
      across = norm2(x)
   else
      across = x(self%kink_axis(k))
   end if
end function across

!> Shape functions of all neighbours at one position
subroutine shape_at_place(approximation, powers, source, support, neighbours, x, value, singular)
   !> Order, kernel and window
   type(approximation_type), intent(in) :: approximation
   !> Exponents of the basis, shape (3, nb)
   integer, intent(in) :: powers(:, :)
   !> Source points, shape (nd, ns) [length]
   real(wp), intent(in) :: source(:, :)
   !> Support, shape (nd, ns) [length]
   real(wp), intent(in) :: support(:, :)
   !> Neighbours, shape (n)
   integer, intent(in) :: neighbours(:)
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Value and derivatives, shape (nq, n); nq = 1 + nd for first ones only, 1 for values only
   real(wp), intent(out) :: value(:, :)
   !> Whether the moment matrix is singular
   logical, intent(out) :: singular
   real(wp), allocatable :: h(:, :), dh(:, :, :), ddh(:, :, :)
   real(wp), allocatable :: m(:, :), phi(:), dphi(:, :), ddphi(:, :, :)
   real(wp), allocatable :: s(:), ds(:, :), dds(:, :), t(:, :), dt(:, :, :)
   real(wp), allocatable :: b(:), db(:, :), ddb(:, :)
   real(wp), allocatable :: w(:), slope(:, :), bend(:, :)
   real(wp) :: scale(size(x)), r(3), peak
   integer, allocatable :: ridge(:)
   integer :: nd, nb, n, i, j, k, q, seconds, smooth

   nd = size(x)
   smooth = size(powers, 2)
   n = size(neighbours)
   seconds = max(size(value, 1) - 1 - nd, 0)
   value = 0.0_wp
   singular = n < smooth
   if (singular) return
   ridge = parting(approximation, source, support, neighbours)
   nb = smooth + size(ridge)
   allocate (h(nb, n), dh(nb, nd, n), ddh(nb, seconds, n), w(nb))
   allocate (m(nb, nb), phi(n), dphi(nd, n), ddphi(nd, merge(nd, 0, seconds > 0), n))
   scale = maxval(support(:, neighbours), dim=2)
   ! supports in radius and angle have no fixed directions in the plane
   if (approximation%window == window_polar) scale = maxval(scale)

   allocate (slope(nd, size(ridge)), bend(nd*(nd + 1)/2, size(ridge)), source=0.0_wp)
   do i = 1, size(ridge)
      associate (a => approximation%kink_axis(ridge(i)), at => approximation%kink(ridge(i)), &
         & here => approximation%across(ridge(i), x))
         slope(a, i) = sign(1.0_wp, here - at + on_plane*scale(a))/maxval(support(a, neighbours))
         if (approximation%window /= window_polar) cycle
         bend(:, i) = slope(a, i)*[x(2)**2, -x(1)*x(2), x(1)**2]/here**3
         slope(:, i) = slope(a, i)*x/here
      end associate
   end do
   m = 0.0_wp
   do k = 1, n
      r(:nd) = x - source(:, neighbours(k))
      call monomials(nd, approximation%order, powers, r(:nd), scale, h(:smooth, k), &
         & dh(:smooth, :, k), ddh(:smooth, :, k))
      do i = 1, size(ridge)
         associate (a => approximation%kink_axis(ridge(i)), at => approximation%kink(ridge(i)), &
            & there => approximation%across(ridge(i), source(:, neighbours(k))))
            h(smooth + i, k) = (abs(approximation%across(ridge(i), x) - at) - abs(there - at)) &
               & /maxval(support(a, neighbours))
            dh(smooth + i, :, k) = slope(:, i)
            ddh(smooth + i, :, k) = bend(:seconds, i)
         end associate
      end do
      if (approximation%window == window_polar) then
         call polar_window(approximation%kernel, x, source(:, neighbours(k)), &
            & support(:, neighbours(k)), phi(k), dphi(:, k), ddphi(:, :, k))
      else
         call window(approximation%kernel, approximation%window, nd, r(:nd), &
            & support(:, neighbours(k)), phi(k), dphi(:, k), ddphi(:, :, k))
      end if
      do j = 1, nb
         m(:j, j) = m(:j, j) + phi(k)*h(j, k)*h(:j, k)
      end do
   end do
   if (size(ridge) > 0) call window(approximation%kernel, merge(window_product, &
      & approximation%window, approximation%window == window_polar), nd, 0.0_wp*x, &
      & support(:, neighbours(1)), peak, r(:nd), ddphi(:, :0, 1))
   do j = smooth + 1, nb
      m(j, j) = m(j, j) + fading*peak
   end do
   call factorise(m, w, singular)
   if (singular) return

   ! M b = H(0) (4.21)
   allocate (b(nb), db(nb, nd), ddb(nb, seconds))
   b = 0.0_wp
   b(1) = 1.0_wp
   call solve(m, w, b)
   allocate (s(n), ds(nd, n), dds(seconds, n), t(nd, n), dt(nd, nd, n))
   do k = 1, n
      s(k) = dot_product(h(:, k), b)
      value(1, k) = phi(k)*s(k)
   end do
   if (size(value, 1) == 1) return
   do k = 1, n
      do i = 1, nd
         ds(i, k) = dot_product(b, dh(:, i, k))
      end do
      do q = 1, seconds
         dds(q, k) = dot_product(b, ddh(:, q, k))
      end do
   end do
   ! M b_,i = -M_,i b
   do i = 1, nd
      db(:, i) = 0.0_wp
      do k = 1, n
         db(:, i) = db(:, i) - phi(k)*s(k)*dh(:, i, k) &
            & - (phi(k)*ds(i, k) + dphi(i, k)*s(k))*h(:, k)
      end do
      call solve(m, w, db(:, i))
   end do
   do k = 1, n
      do i = 1, nd
         t(i, k) = dot_product(h(:, k), db(:, i))
         value(1 + i, k) = dphi(i, k)*s(k) + phi(k)*(ds(i, k) + t(i, k))
      end do
   end do
   if (seconds == 0) return
   do k = 1, n
      do j = 1, nd
         do i = 1, nd
            ! dt(i, j) = H_,i . b_,j
            dt(i, j, k) = dot_product(dh(:, i, k), db(:, j))
         end do
      end do
   end do
   ! M b_,ij = -(M_,ij b + M_,i b_,j + M_,j b_,i)
   do i = 1, nd
      do j = i, nd
         q = second_index(nd, i, j) - 1 - nd
         ddb(:, q) = 0.0_wp
         do k = 1, n
            ddb(:, q) = ddb(:, q) - phi(k)*s(k)*ddh(:, q, k) &
               & - (phi(k)*(ds(j, k) + t(j, k)) + dphi(j, k)*s(k))*dh(:, i, k) &
               & - (phi(k)*(ds(i, k) + t(i, k)) + dphi(i, k)*s(k))*dh(:, j, k) &
               & - (phi(k)*(dds(q, k) + dt(i, j, k) + dt(j, i, k)) &
               & + dphi(j, k)*(ds(i, k) + t(i, k)) + dphi(i, k)*(ds(j, k) + t(j, k)) &
               & + ddphi(i, j, k)*s(k))*h(:, k)
         end do
         call solve(m, w, ddb(:, q))
      end do
   end do
   do k = 1, n
      do i = 1, nd
         do j = i, nd
            q = second_index(nd, i, j) - 1 - nd
            value(1 + nd + q, k) = ddphi(i, j, k)*s(k) &
               & + dphi(i, k)*(ds(j, k) + t(j, k)) + dphi(j, k)*(ds(i, k) + t(i, k)) &
               & + phi(k)*(dds(q, k) + dt(i, j, k) + dt(j, i, k) &
               & + dot_product(h(:, k), ddb(:, q)))
         end do
      end do
   end do
end subroutine shape_at_place

!> Planes that separate the neighbours of a position
pure function parting(approximation, source, support, neighbours) result(ridge)
   type(approximation_type), intent(in) :: approximation
   !> Source points and their supports, shape (nd, ns) [length]
   real(wp), intent(in) :: source(:, :), support(:, :)
   !> Neighbours, shape (n)
   integer, intent(in) :: neighbours(:)
   !> Indices of the planes
   integer, allocatable :: ridge(:)
   real(wp) :: away(size(neighbours))
   integer :: i, k

   allocate (ridge(0))
   if (.not. allocated(approximation%kink)) return
   do k = 1, size(approximation%kink)
      do i = 1, size(neighbours)
         away(i) = (approximation%across(k, source(:, neighbours(i))) - approximation%kink(k)) &
            & /support(approximation%kink_axis(k), neighbours(i))
      end do
      if (minval(away) < -on_plane .and. maxval(away) > on_plane) ridge = [ridge, k]
   end do
end function parting

!> Cholesky factor of the moment matrix scaled to a unit diagonal
pure subroutine factorise(m, w, singular)
   !> Upper triangle of the matrix, replaced by its factor, shape (nb, nb)
   real(wp), intent(inout) :: m(:, :)
   !> Reciprocal square roots of the diagonal, shape (nb)
   real(wp), intent(out) :: w(:)
   !> Whether the matrix is singular to rounding
   logical, intent(out) :: singular
   integer :: i, j

   singular = .true.
   do j = 1, size(m, 1)
      if (.not. m(j, j) > 0.0_wp) return
      w(j) = 1.0_wp/sqrt(m(j, j))
   end do
   do j = 1, size(m, 1)
      m(:j, j) = m(:j, j)*w(:j)*w(j)
      do i = 1, j - 1
         m(i, j) = (m(i, j) - dot_product(m(:i - 1, i), m(:i - 1, j)))/m(i, i)
      end do
      m(j, j) = m(j, j) - dot_product(m(:j - 1, j), m(:j - 1, j))
      if (.not. m(j, j) > pivot_min) return
      m(j, j) = sqrt(m(j, j))
   end do
   singular = .false.
end subroutine factorise

!> Solve with the factor of the moment matrix
pure subroutine solve(m, w, b)
   !> Factor, shape (nb, nb)
   real(wp), intent(in) :: m(:, :)
   !> Scaling, shape (nb)
   real(wp), intent(in) :: w(:)
   !> Right hand side, replaced by the solution, shape (nb)
   real(wp), intent(inout) :: b(:)
   integer :: i

   b = b*w
   do i = 1, size(b)
      b(i) = (b(i) - dot_product(m(:i - 1, i), b(:i - 1)))/m(i, i)
   end do
   do i = size(b), 1, -1
      b(i) = b(i)/m(i, i)
      b(:i - 1) = b(:i - 1) - b(i)*m(:i - 1, i)
   end do
   b = b*w
end subroutine solve

end module rk_place_shape
