!> Conjugate gradients for least squares with the factor of the normal matrix as preconditioner.
!>
!> Reference: Bjorck, Numerical Methods for Least Squares Problems, SIAM (1996),
!>            doi:10.1137/1.9781611971484 (CGLS 7.4, corrected semi-normal equations 2.4.6,
!>            backward error 1.4.3)
module rk_cgls
   use rk_operator, only : factor_type, row_operator
   use rk_precision, only : wp
   implicit none
   private

   public :: refine

   !> Backward error at which refinement stops: unit roundoff
   real(wp), parameter :: goal = 1.0e-16_wp
   !> Iterations without halving the gradient after which refinement has reached the rounding level
   integer, parameter :: patience = 2

contains

!> Refine a solution to the rounding level
subroutine refine(op, b, factor, limit, x, iterations)
   class(row_operator), intent(in) :: op
   !> Right hand side, shape (m)
   real(wp), contiguous, intent(in) :: b(:)
   !> Factor of a matrix near the normal matrix
   class(factor_type), intent(in) :: factor
   integer, intent(in) :: limit
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   integer, intent(out) :: iterations
   real(wp), allocatable :: residual(:), g(:), p(:), z(:), q(:), best(:)
   real(wp) :: gamma, gamma_old, gradient, least, matrix_norm, step
   integer :: last_gain

   allocate (residual(op%m), q(op%m), g(op%n), p(op%n), z(op%n))
   ! Frobenius norm of the matrix with columns of unit length
   matrix_norm = sqrt(real(op%n, wp))
   call op%apply(x, q)
   residual = b - q
   best = x
   least = huge(1.0_wp)
   gamma_old = 1.0_wp
   last_gain = 0
   do iterations = 0, limit
      call op%apply_transposed(residual, g)
      g = g/factor%scale
      gradient = norm2(g)
      if (gradient < least) then
         if (gradient < 0.5_wp*least) last_gain = iterations
         least = gradient
         best = x
      end if
      if (iterations >= last_gain + patience) exit
      if (gradient <= goal*matrix_norm*norm2(residual)) exit
      if (iterations == limit) exit
      z = g
      call factor%solve(z)
      gamma = dot_product(g, z)
      if (iterations == 0) then
         p = z
      else
         p = z + (gamma/gamma_old)*p
      end if
      gamma_old = gamma
      z = p/factor%scale
      call op%apply(z, q)
      step = dot_product(q, q)
      if (.not. step > 0.0_wp) exit
      step = gamma/step
      x = x + step*z
      residual = residual - step*q
   end do
   x = best
end subroutine refine

end module rk_cgls
