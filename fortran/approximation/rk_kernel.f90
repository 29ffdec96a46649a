!> Window functions of the reproducing kernel approximation and their derivatives.
!>
!> References: 1. quintic B-spline, thesis equation (5.6)
!>             2. cubic B-spline, Liu, Jun, Zhang, Int. J. Numer. Meth. Fluids 20 (1995),
!>                doi:10.1002/fld.1650200824
module rk_kernel
   use rk_precision, only : wp
   implicit none
   private

   public :: kernel_quintic, kernel_cubic, window_product, window_radial
   public :: window

   !> Quintic B-spline, C4: collocation
   integer, parameter :: kernel_quintic = 1
   !> Cubic B-spline, C2: Galerkin
   integer, parameter :: kernel_cubic = 2
   !> Product of one-dimensional windows: rectangular support
   integer, parameter :: window_product = 1
   !> Window of the scaled distance: ellipsoidal support
   integer, parameter :: window_radial = 2

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
   if (kernel == kernel_cubic) then
      if (z < 0.5_wp) then
         w = 2.0_wp/3.0_wp - 4.0_wp*z**2 + 4.0_wp*z**3
         w1z = -8.0_wp + 12.0_wp*z
         w2 = -8.0_wp + 24.0_wp*z
      else
         w = 4.0_wp/3.0_wp*t**3
         w1z = -4.0_wp*t**2/z
         w2 = 8.0_wp*t
      end if
   else if (z < 1.0_wp/3.0_wp) then
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
end subroutine spline

!> Window of one source point at one place with gradient and second derivatives
pure subroutine window(kernel, shape, nd, r, a, phi, dphi, ddphi)
   !> One of the kernel_* constants
   integer, intent(in) :: kernel
   !> One of the window_* constants
   integer, intent(in) :: shape
   !> Space dimension, 1..3
   integer, intent(in) :: nd
   !> Place minus source point, shape (nd) [length]
   real(wp), intent(in) :: r(:)
   !> Support of the source point in each direction, shape (nd) [length]
   real(wp), intent(in) :: a(:)
   !> Value [-]
   real(wp), intent(out) :: phi
   !> Gradient, shape (nd) [1/length]
   real(wp), intent(out) :: dphi(:)
   !> Second derivatives, shape (nd, nd) [1/length^2]
   real(wp), intent(out) :: ddphi(:, :)
   real(wp) :: w(3), d(3), dd(3), g(3), z, w1z, w2, other
   integer :: i, j, k

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
         do j = 1, nd
            ddphi(i, j) = 0.0_wp
            if (z > 0.0_wp) ddphi(i, j) = (w2 - w1z)*(g(i)/z)*(g(j)/z)
         end do
         ddphi(i, i) = ddphi(i, i) + w1z/a(i)**2
      end do
   end if
end subroutine window

end module rk_kernel
