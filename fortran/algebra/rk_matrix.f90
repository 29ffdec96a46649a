!> A stored matrix as a row operator: small dense least squares of reduced models.
module rk_matrix
   use rk_error, only : error_type
   use rk_lapack, only : solve_qr
   use rk_operator, only : square_operator, square_report
   use rk_precision, only : i8, wp
   implicit none
   private

   public :: matrix_rows

   !> Stored rows
   type, extends(square_operator) :: matrix_rows
      !> Entries, shape (m, n)
      real(wp), allocatable :: a(:, :)
   contains
      procedure :: apply, apply_transposed, compressed, solve_square
   end type matrix_rows

contains

subroutine apply(self, x, y)
   class(matrix_rows), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)

   y = matmul(self%a, x)
end subroutine apply

subroutine apply_transposed(self, x, y)
   class(matrix_rows), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)

   y = matmul(x, self%a)
end subroutine apply_transposed

!> A in compressed rows, zeros included
subroutine compressed(self, start, column, value)
   class(matrix_rows), intent(in) :: self
   integer(i8), allocatable, intent(out) :: start(:)
   integer(i8), allocatable, intent(out) :: column(:)
   real(wp), allocatable, intent(out) :: value(:)
   integer :: i, j

   start = [(int(self%n, i8)*i, i=0, self%m)]
   column = [((int(j - 1, i8), j=1, self%n), i=1, self%m)]
   value = reshape(transpose(self%a), [self%m*self%n])
end subroutine compressed

!> Solve (A + shift |D|) x = b with a small square matrix that need not be symmetric
recursive subroutine solve_square(self, shift, b, x, report, error)
   class(matrix_rows), target, intent(inout) :: self
   real(wp), intent(in) :: shift
   real(wp), contiguous, intent(in) :: b(:)
   real(wp), contiguous, intent(inout) :: x(:)
   type(square_report), intent(out) :: report
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: a(:, :), factor(:, :)
   integer :: j

   allocate (a, source=self%a)
   do j = 1, self%n
      a(j, j) = a(j, j) + shift*abs(a(j, j))
   end do
   allocate (factor, source=a)
   x = b
   call solve_qr(factor, x, error)
   if (allocated(error)) return
   associate (diagonal => [(abs(factor(j, j)), j=1, self%n)])
      report%rcond = minval(diagonal)/maxval(diagonal)
   end associate
   report%backward_error = norm2(matmul(a, x) - b) &
      & /max(norm2(a)*norm2(x) + norm2(b), tiny(1.0_wp))
   report%used = 'projected'
   report%why = 'the tangent in the span of a few modes is small and dense'
end subroutine solve_square

end module rk_matrix
