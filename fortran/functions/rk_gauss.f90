!> Gauss-Legendre rules on [-1, 1].
!>
!> Reference: Davis, Rabinowitz, Methods of Numerical Integration, Academic Press (1984), section
!> 2.7, doi:10.1016/C2013-0-10566-1
module rk_gauss
   use rk_precision, only : pi, wp
   implicit none
   private

   public :: gauss_rule

contains

!> Nodes and weights, exact for polynomials of degree 2n - 1
pure subroutine gauss_rule(x, w)
   !> Nodes, ascending, shape (n) [-]
   real(wp), intent(out) :: x(:)
   !> Weights, shape (n) [-]
   real(wp), intent(out) :: w(:)
   real(wp) :: z, p, dp
   integer :: i, n, trial

   n = size(x)
   do i = 1, n
      z = cos(pi*(n - i + 0.75_wp)/(n + 0.5_wp))
      ! Newton's iteration converges quadratically from this start: six steps are more than enough
      do trial = 1, 6
         call legendre(n, z, p, dp)
         z = z - p/dp
      end do
      call legendre(n, z, p, dp)
      x(i) = z
      w(i) = 2.0_wp/((1.0_wp - z**2)*dp**2)
   end do
   ! without their rounding faces close better
   w = 2.0_wp*w/sum(w)
end subroutine gauss_rule

!> Legendre polynomial and its derivative by the three-term recurrence
pure subroutine legendre(n, z, p, dp)
   !> Degree, >= 1
   integer, intent(in) :: n
   !> Argument inside (-1, 1)
   real(wp), intent(in) :: z
   !> Value and derivative
   real(wp), intent(out) :: p, dp
   real(wp) :: before, next
   integer :: k

   before = 1.0_wp
   p = z
   do k = 2, n
      next = ((2*k - 1)*z*p - (k - 1)*before)/k
      before = p
      p = next
   end do
   dp = n*(z*p - before)/(z**2 - 1.0_wp)
end subroutine legendre

end module rk_gauss
