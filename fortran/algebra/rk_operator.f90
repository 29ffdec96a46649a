!> Interface of a matrix for the least squares solvers, and of a factor of it.
module rk_operator
   use rk_envelope, only : envelope_type, new_envelope
   use rk_error, only : error_type
   use rk_factor, only : factor_type
   use rk_lapack, only : syrk
   use rk_precision, only : i8, wp
   use rk_text, only : to_text
   implicit none
   private

   public :: row_operator, square_operator, square_report, factor_type, shortest

   !> A tall matrix given by its products
   type, abstract :: row_operator
      !> Rows
      integer :: m = 0
      !> Columns
      integer :: n = 0
   contains
      !> y = A x
      procedure(apply_interface), deferred :: apply
      !> x = A^T y
      procedure(apply_interface), deferred :: apply_transposed
      procedure :: envelope, dense
      !> A in compressed rows
      procedure(compressed_interface), deferred :: compressed
      procedure :: get_name
   end type row_operator

   !> Report of a solve
   type :: square_report
      !> Method used, and why
      character(len=:), allocatable :: used, why
      !> Number of iterations, including those of a refinement; 0 for a direct solve
      integer :: iterations = 0
      !> |A x - b| over |A| |x| + |b|; if iterative, the preconditioned residual [-]
      real(wp) :: backward_error = 0.0_wp
      !> Estimate of the reciprocal condition number, 0 where it is not known [-]
      real(wp) :: rcond = 0.0_wp
      !> The matrix is symmetric, and was found not to be positive definite
      logical :: indefinite = .false.
   end type square_report

   !> A square matrix with a solver of its equations
   type, abstract, extends(row_operator) :: square_operator
      !> Another start is available, so that a matrix that is costly to solve may be given up
      logical :: impatient = .false.
      !> The matrix is that of the last solve, whose factor is available
      logical :: again = .false.
   contains
      !> Solve (A + shift |D|) x = b with a diagonal D like that of A
      procedure(square_interface), deferred :: solve_square
   end type square_operator

   abstract interface
      !> Solve (A + shift |D|) x = b
      recursive subroutine square_interface(self, shift, b, x, report, error)
         import :: error_type, square_operator, square_report, wp
         class(square_operator), target, intent(inout) :: self
         !> Damping in units of the diagonal, >= 0 [-]
         real(wp), intent(in) :: shift
         !> Right hand side, shape (n)
         real(wp), contiguous, intent(in) :: b(:)
         !> Solution, shape (n)
         real(wp), contiguous, intent(inout) :: x(:)
         !> Method used and quality reached
         type(square_report), intent(out) :: report
         !> Error handling: singular matrix, no memory, no convergence
         type(error_type), allocatable, intent(out) :: error
      end subroutine square_interface
      !> Product with a vector
      subroutine apply_interface(self, x, y)
         import :: row_operator, wp
         class(row_operator), intent(in) :: self
         !> Vector
         real(wp), contiguous, intent(in) :: x(:)
         !> Product
         real(wp), contiguous, intent(inout) :: y(:)
      end subroutine apply_interface
      !> Entries in compressed rows
      subroutine compressed_interface(self, start, column, value)
         import :: i8, row_operator, wp
         class(row_operator), intent(in) :: self
         !> Row i has entries start(i)+1 : start(i+1), shape (m + 1)
         integer(i8), allocatable, intent(out) :: start(:)
         !> Column of each entry less 1, shape (entries)
         integer(i8), allocatable, intent(out) :: column(:)
         !> Entries
         real(wp), allocatable, intent(out) :: value(:)
      end subroutine compressed_interface
   end interface

   !> Inverse iterations for the smallest singular value: each squares the ratio to the next one
   integer, parameter :: sweeps = 3
   !> Fractional part of the golden ratio: its multiples modulo 1 are spread evenly
   real(wp), parameter :: golden = 0.6180339887498949_wp

contains

!> A as a dense matrix
subroutine dense(self, a)
   class(row_operator), intent(in) :: self
   !> Entries, shape (m, n)
   real(wp), contiguous, intent(inout) :: a(:, :)
   integer(i8), allocatable :: start(:), column(:)
   real(wp), allocatable :: value(:)
   integer(i8) :: k
   integer :: i

   call self%compressed(start, column, value)
   a = 0.0_wp
   do i = 1, self%m
      do k = start(i) + 1, start(i + 1)
         a(i, column(k) + 1) = value(k)
      end do
   end do
end subroutine dense

!> A^T A of a matrix without structure
subroutine envelope(self, a, error)
   class(row_operator), intent(in) :: self
   type(envelope_type), intent(out) :: a
   !> Error handling: no memory
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: full(:, :), product(:, :)
   integer :: j

   call new_envelope(a, [(j, j=1, self%n)], [(1, j=1, self%n)], error)
   if (allocated(error)) return
   allocate (full(self%m, self%n), product(self%n, self%n))
   call self%dense(full)
   call syrk(full, self%m, self%n, product)
   call a%clear()
   do j = 1, size(a%first)
      call a%add(j, a%position, [1, self%n + 1], product)
   end do
end subroutine envelope

subroutine get_name(self, j, text)
   class(row_operator), intent(in) :: self
   !> Column
   integer, intent(in) :: j
   character(len=:), allocatable, intent(out) :: text

   text = 'unknown '//to_text(j)//' of '//to_text(self%n)
end subroutine get_name

!> Direction that the column-scaled matrix shortens most, by inverse iteration, and the length of
!> its image. The image is computed with A itself: where the factor is singular to rounding, it
!> still shows whether A is.
subroutine shortest(op, factor, v, length)
   class(row_operator), intent(in) :: op
   class(factor_type), intent(in) :: factor
   !> Direction in column-scaled variables, length one, shape (n)
   real(wp), contiguous, intent(inout) :: v(:)
   !> |A D v|, an upper bound close to the smallest singular value
   real(wp), intent(out) :: length
   real(wp) :: image(op%m)
   integer :: j, k

   ! a start vector with a part in every direction
   v = [(0.5_wp + modulo(golden*j, 1.0_wp), j=1, op%n)]
   do k = 1, sweeps
      v = v/norm2(v)
      call factor%solve(v)
   end do
   v = v/norm2(v)
   call op%apply(v/factor%scale, image)
   length = norm2(image)
end subroutine shortest

end module rk_operator
