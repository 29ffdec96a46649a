!> Newton steps of a symmetric, possibly indefinite matrix: Cholesky with a growing shift.
!>
!> The matrix is scaled to a unit diagonal (absolute values) and lambda times the unit matrix is
!> added; where the factorisation still fails, lambda grows until it does not. Then the step points
!> downhill. There is no QR for this matrix, which is not a product A^T A.
!>
!> Reference: Nocedal, Wright, Numerical Optimization, Springer (2006), algorithm 3.3,
!>            doi:10.1007/978-0-387-40065-5
module rk_shifted
   use rk_error, only : error_type, fatal_error, err_linalg
   use rk_lapack, only : cholesky, reciprocal_condition, solve_triangular
   use rk_operator, only : square_report
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: shifted_report, solve_shifted

   !> What a solve did; rcond is that of the scaled, shifted matrix in the 1-norm, the backward
   !> error the relative residual of the scaled equations
   type, extends(square_report) :: shifted_report
      !> Whether the matrix, with the shift wanted, is positive definite
      logical :: positive = .true.
      !> Fall of the quadratic model g.x + x.H x/2 along the step, > 0
      real(wp) :: predicted = 0.0_wp
   end type shifted_report

   !> First shift where none was wanted and the matrix is indefinite, growth, and the last one tried
   real(wp), parameter :: first_shift = 1.0e-12_wp, growth = 30.0_wp, last_shift = 1.0e6_wp
   !> Smallest diagonal entry that scales, of the largest
   real(wp), parameter :: least_diagonal = 1.0e-14_wp

contains

!> Solve (H + lambda D) x = -g with the diagonal D of H
subroutine solve_shifted(a, g, grow, lambda, x, report, error)
   !> Upper triangle of H, destroyed, shape (n, n)
   real(wp), contiguous, intent(inout) :: a(:, :)
   !> Gradient, shape (n)
   real(wp), contiguous, intent(in) :: g(:)
   !> Grow the shift of an indefinite matrix; otherwise return without a step
   logical, intent(in) :: grow
   !> Smallest shift wanted, shift used [-]
   real(wp), intent(inout) :: lambda
   !> Step, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   type(shifted_report), intent(out) :: report
   !> Error handling: entries that are not finite
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: scale(:), diagonal(:), b(:), y(:)
   integer :: i, j, n

   n = size(g)
   allocate (scale(n), diagonal(n), b(n), y(n))
   do j = 1, n
      scale(j) = abs(a(j, j))
   end do
   scale = sqrt(max(scale, least_diagonal*maxval(scale)))
   if (.not. minval(scale) > 0.0_wp) then
      call fatal_error(error, err_linalg, 'second derivatives are zero or not finite')
      return
   end if
   do j = 1, n
      diagonal(j) = a(j, j)/scale(j)**2
      do i = 1, j - 1
         ! the lower triangle keeps what the factorisation destroys
         a(i, j) = a(i, j)/(scale(i)*scale(j))
         a(j, i) = a(i, j)
      end do
   end do
   do
      do j = 1, n
         a(j, j) = diagonal(j) + lambda
      end do
      call cholesky(a, error)
      if (.not. allocated(error)) exit
      report%positive = .false.
      if (.not. grow) then
         deallocate (error)
         return
      end if
      if (.not. lambda < last_shift) then
         error%message = 'Newton equations: '//error%message//' with a shift of ' &
            & //to_text(lambda, 2)
         return
      end if
      lambda = max(first_shift, growth*lambda)
      do j = 1, n
         a(:j - 1, j) = a(j, :j - 1)
      end do
   end do
   call reciprocal_condition(a, report%rcond)
   b = -g/scale
   y = b
   call solve_triangular(a, y, transposed=.true.)
   call solve_triangular(a, y, transposed=.false.)
   x = y/scale
   report%predicted = 0.5_wp*(dot_product(b, y) + lambda*dot_product(y, y))
   call residual()
   report%backward_error = norm2(b)/max(norm2(y)*sqrt(real(n, wp)), tiny(1.0_wp))

contains

   !> b - (H + lambda D) y in scaled variables
   subroutine residual()
      b = b - (diagonal + lambda)*y
      do j = 1, n - 1
         b(j + 1:) = b(j + 1:) - a(j + 1:, j)*y(j)
         b(j) = b(j) - dot_product(a(j + 1:, j), y(j + 1:))
      end do
   end subroutine residual

end subroutine solve_shifted

end module rk_shifted
