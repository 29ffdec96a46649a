!> A stored matrix as a row operator: small dense least squares of reduced models.
module rk_matrix
   use rk_lapack, only : matvec, syrk
   use rk_lstsq, only : row_operator
   use rk_precision, only : wp
   implicit none
   private

   public :: matrix_rows

   !> Stored rows
   type, extends(row_operator) :: matrix_rows
      !> Entries, shape (m, n)
      real(wp), allocatable :: a(:, :)
   contains
      procedure :: apply
      procedure :: apply_transposed
      procedure :: normal
      procedure :: dense
   end type matrix_rows

contains

!> y = A x
subroutine apply(self, x, y)
   !> Matrix
   class(matrix_rows), intent(in) :: self
   !> Vector, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Product, shape (m)
   real(wp), contiguous, intent(inout) :: y(:)

   call matvec(self%a, x, y, transposed=.false.)
end subroutine apply

!> y = A^T x
subroutine apply_transposed(self, x, y)
   !> Matrix
   class(matrix_rows), intent(in) :: self
   !> Vector, shape (m)
   real(wp), contiguous, intent(in) :: x(:)
   !> Product, shape (n)
   real(wp), contiguous, intent(inout) :: y(:)

   call matvec(self%a, x, y, transposed=.true.)
end subroutine apply_transposed

!> Upper triangle of A^T A
subroutine normal(self, a)
   !> Matrix
   class(matrix_rows), intent(in) :: self
   !> Product, shape (n, n)
   real(wp), contiguous, intent(inout) :: a(:, :)

   call syrk(self%a, self%m, self%n, a)
end subroutine normal

!> A itself
subroutine dense(self, a)
   !> Matrix
   class(matrix_rows), intent(in) :: self
   !> Entries, shape (m, n)
   real(wp), contiguous, intent(inout) :: a(:, :)

   a = self%a
end subroutine dense

end module rk_matrix
