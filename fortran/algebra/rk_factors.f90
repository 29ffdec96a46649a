!> Factors of the normal matrix: Cholesky in an envelope, R of a dense QR.
module rk_factors
   use rk_envelope, only : envelope_type
   use rk_lapack, only : solve_triangular
   use rk_operator, only : factor_type
   use rk_precision, only : wp
   implicit none
   private

   public :: envelope_factor, dense_factor

   !> Cholesky factor in an envelope
   type, extends(factor_type) :: envelope_factor
      type(envelope_type) :: matrix
   contains
      procedure :: solve => envelope_solve
   end type envelope_factor

   !> Upper triangle of a QR factorisation
   type, extends(factor_type) :: dense_factor
      !> R in the leading rows, shape (m, n)
      real(wp), allocatable :: a(:, :)
      !> Unknown of each column, shape (n)
      integer, allocatable :: pivot(:)
   contains
      procedure :: solve => dense_solve
   end type dense_factor

contains

!> Solve in place
subroutine envelope_solve(self, x)
   class(envelope_factor), intent(in) :: self
   real(wp), contiguous, intent(inout) :: x(:)

   call self%matrix%solve(x)
end subroutine envelope_solve

!> Solve in place
subroutine dense_solve(self, x)
   class(dense_factor), intent(in) :: self
   real(wp), contiguous, intent(inout) :: x(:)
   real(wp) :: y(size(x))

   y = x(self%pivot)
   call solve_triangular(self%a, y, transposed=.true.)
   call solve_triangular(self%a, y, transposed=.false.)
   x(self%pivot) = y
end subroutine dense_solve

end module rk_factors
