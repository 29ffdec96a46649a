!> Window functions of the reproducing kernel approximation and their derivatives.
!>
!> References: 1. quintic B-spline, thesis equation (5.6)
!>             2. cubic B-spline, Liu, Jun, Zhang, Int. J. Numer. Meth. Fluids 20 (1995),
!>                doi:10.1002/fld.1650200824
module rk_kernel
   use rk_precision, only : wp
   implicit none
   private

   public :: kernel_quintic, window_product, window_radial, window_polar
   public :: kernel_names, window_names, polar_window, window

   !> Names of the kernels and of the windows in decks, in the order of the numbers below
   character(len=*), parameter :: kernel_names(2) = ['quintic', 'cubic  ']
   character(len=*), parameter :: window_names(3) = ['product', 'radial ', 'polar  ']
   !> Quintic B-spline, C4: collocation
   integer, parameter :: kernel_quintic = 1
   !> Cubic B-spline, C2: Galerkin
   integer, parameter :: kernel_cubic = 2
   !> Product of one-dimensional windows: rectangular support
   integer, parameter :: window_product = 1
   !> Window of the scaled distance: ellipsoidal support
   integer, parameter :: window_radial = 2
   !> Product of windows in radius and angle about the origin, in the plane: supports turn with the
   !> angle, so that on polar lattices the windows are splines of radius and angle
   integer, parameter :: window_polar = 3

contains

!> One-dimensional window w(z) and derivatives; w1z is w'(z)/z, finite at z = 0
pure subroutine spline(kernel, z, w, w1z, w2)
   !> One of the kernel_* constants
   integer, intent(in) :: kernel
   !> Distance over support, >= 0 [-]
   real(wp), intent(in) :: z
   !> Value [-]
   real(wp), intent(out) :: w
   !> First derivative over z [-]
   real(wp), intent(out) :: w1z
   !> Second derivative [-]
   real(wp), intent(out) :: w2
   real(wp), parameter :: c = 81.0_wp/40.0_wp
   real(wp) :: t, s

   w = 0.0_wp
   w1z = 0.0_wp
   w2 = 0.0_wp
   if (.not. z < 1.0_wp) return
   t = 1.0_wp - z
   select case (kernel)
   case (kernel_cubic)
      if (z < 0.5_wp) then
         w = 2.0_wp/3.0_wp - 4.0_wp*z**2 + 4.0_wp*z**3
         w1z = -8.0_wp + 12.0_wp*z
         w2 = -8.0_wp + 24.0_wp*z
      else
         w = 4.0_wp/3.0_wp*t**3
         w1z = -4.0_wp*t**2/z
         w2 = 8.0_wp*t
      end if
   case (kernel_quintic)
      if (z < 1.0_wp/3.0_wp) then
         w = 11.0_wp/20.0_wp - 4.5_wp*z**2 + 20.25_wp*z**4 - 20.25_wp*z**5
         w1z = -9.0_wp + 81.0_wp*z**2 - 101.25_wp*z**3
         w2 = -9.0_wp + 243.0_wp*z**2 - 405.0_wp*z**3
      else
         ! second and third branch of (5.6) as truncated powers
         s = max(2.0_wp/3.0_wp - z, 0.0_wp)
         w = c*(t**5 - 6.0_wp*s**5)
         w1z = c*(-5.0_wp*t**4 + 30.0_wp*s**4)/z
         w2 = c*(20.0_wp*t**3 - 120.0_wp*s**3)
      end if
   end select
end subroutine spline

!> Window of one source point at one position with gradient and second derivatives
pure subroutine window(kernel, shape, nd, r, a, phi, dphi, ddphi)
   !> One of the kernel_* constants
   integer, intent(in) :: kernel
   !> One of the window_* constants
   integer, intent(in) :: shape
   !> Space dimension, 1..3
   integer, intent(in) :: nd
   !> Position minus source point, shape (nd) [length]
   real(wp), intent(in) :: r(:)
   !> Support of the source point in each direction, shape (nd) [length]
   real(wp), intent(in) :: a(:)
   !> Value [-]
   real(wp), intent(out) :: phi
   !> Gradient, shape (nd) [1/length]
   real(wp), intent(out) :: dphi(:)
   !> Second derivatives, shape (nd, nd), or size 0 [1/length^2]
   real(wp), intent(out) :: ddphi(:, :)
   real(wp) :: w(3), d(3), dd(3), g(3), z, w1z, w2, other
   logical :: seconds
   integer :: i, j, k

   seconds = size(ddphi) > 0
   if (shape == window_product) then
      do i = 1, nd
         call spline(kernel, abs(r(i))/a(i), w(i), w1z, w2)
         d(i) = w1z*r(i)/a(i)**2
         dd(i) = w2/a(i)**2
      end do
      phi = product(w(:nd))
      do i = 1, nd
         other = 1.0_wp
         do k = 1, nd
            if (k /= i) other = other*w(k)
         end do
         dphi(i) = d(i)*other
         if (.not. seconds) cycle
         ddphi(i, i) = dd(i)*other
         do j = 1, i - 1
            other = 1.0_wp
            do k = 1, nd
               if (k /= i .and. k /= j) other = other*w(k)
            end do
            ddphi(i, j) = d(i)*d(j)*other
            ddphi(j, i) = ddphi(i, j)
         end do
      end do
   else
      g(:nd) = r(:nd)/a(:nd)**2
      z = norm2(r(:nd)/a(:nd))
      call spline(kernel, z, phi, w1z, w2)
      do i = 1, nd
         dphi(i) = w1z*g(i)
         if (.not. seconds) cycle
         do j = 1, nd
            ddphi(i, j) = 0.0_wp
            if (z > 0.0_wp) ddphi(i, j) = (w2 - w1z)*(g(i)/z)*(g(j)/z)
         end do
         ddphi(i, i) = ddphi(i, i) + w1z/a(i)**2
      end do
   end if
end subroutine window

!> Window in radius and angle of one source point, with gradient and second derivatives
pure subroutine polar_window(kernel, x, source, a, phi, dphi, ddphi)
   !> One of the kernel_* constants
   integer, intent(in) :: kernel
   !> Position and source point, not at the origin, shape (2) [length]
   real(wp), intent(in) :: x(:), source(:)
   !> Support of the source point, radial and circumferential, shape (2) [length]
   real(wp), intent(in) :: a(:)
   !> Value [-]
   real(wp), intent(out) :: phi
   !> Gradient, shape (2) [1/length]
   real(wp), intent(out) :: dphi(:)
   !> Second derivatives, shape (2, 2), or size 0 [1/length^2]
   real(wp), intent(out) :: ddphi(:, :)
   real(wp) :: d(2), dd(size(ddphi, 1), size(ddphi, 2)), e(2), t(2), radius, own, angle
   integer :: j

   radius = norm2(x)
   own = norm2(source)
   e = x/radius
   t = [-e(2), e(1)]
   angle = atan2(source(1)*x(2) - source(2)*x(1), dot_product(source, x))
   call window(kernel, window_product, 2, [radius - own, own*angle], a, phi, d, dd)
   d(2) = d(2)*own/radius
   dphi = d(1)*e + d(2)*t
   if (size(ddphi) == 0) return
   dd(1, 2) = (dd(1, 2)*own - d(2))/radius
   dd(2, 2) = dd(2, 2)*(own/radius)**2 + d(1)/radius
   do j = 1, 2
      ddphi(:, j) = dd(1, 1)*e*e(j) + dd(1, 2)*(e*t(j) + t*e(j)) + dd(2, 2)*t*t(j)
   end do
end subroutine polar_window

end module rk_kernel
