!> Sparse factorisations of SuiteSparse.
!>
!> References: Chen et al., ACM TOMS 35 (2008) 22, doi:10.1145/1391989.1391995;
!>             Davis, ACM TOMS 38 (2011) 8, doi:10.1145/2049662.2049670
module rk_sparse
   use, intrinsic :: iso_c_binding, only : c_associated, c_double, c_int, c_int64_t, c_null_ptr, &
      & c_ptr
   use rk_error, only : error_type, fatal_error, err_linalg, err_memory
   use rk_operator, only : factor_type, row_operator
   use rk_precision, only : i8, wp
   use rk_threads, only : hold_threads, release_threads, threads_type
   implicit none
   private

   public :: sparse_factor, sparse_qr, solve_sparse

   !> A factor stored by SuiteSparse, together with the data shared by all matrices with the same
   !> sparsity pattern: the elimination order and the pattern of the factor. Do not copy it: each
   !> copy would free the handle.
   type, extends(factor_type) :: sparse_factor
      type(c_ptr), private :: handle = c_null_ptr
   contains
      procedure :: solve
      final :: free
   end type sparse_factor

   interface
      integer(c_int) function rk_sparse_qr(m, n, start, column, value, b, tol, x, handle) bind(c)
         import :: c_double, c_int, c_int64_t, c_ptr
         integer(c_int64_t), value :: m, n
         integer(c_int64_t), intent(in) :: start(*), column(*)
         real(c_double), intent(in) :: value(*), b(*)
         real(c_double), value :: tol
         real(c_double), intent(inout) :: x(*)
         type(c_ptr), intent(out) :: handle
      end function rk_sparse_qr
      integer(c_int) function rk_sparse_direct(n, start, row, value, definite, b, x, rcond, kept) &
         & bind(c)
         import :: c_double, c_int, c_int64_t, c_ptr
         integer(c_int64_t), value :: n
         integer(c_int64_t), intent(in) :: start(*), row(*)
         real(c_double), intent(in) :: value(*)
         integer(c_int), value :: definite
         real(c_double), intent(in), optional :: b(*)
         real(c_double), intent(inout), optional :: x(*)
         real(c_double), intent(out) :: rcond
         type(c_ptr), intent(inout) :: kept
      end function rk_sparse_direct
      subroutine rk_sparse_solve(handle, length, x) bind(c)
         import :: c_double, c_int64_t, c_ptr
         type(c_ptr), value :: handle
         integer(c_int64_t), value :: length
         real(c_double), intent(inout) :: x(*)
      end subroutine rk_sparse_solve
      subroutine rk_sparse_free(handle) bind(c)
         import :: c_ptr
         type(c_ptr), value :: handle
      end subroutine rk_sparse_free
   end interface

contains

!> Least squares by sparse QR of the column-scaled matrix
subroutine sparse_qr(self, op, b, x, error)
   !> Factor, R^T R
   type(sparse_factor), intent(inout) :: self
   class(row_operator), intent(in) :: op
   !> Right hand side, shape (m)
   real(wp), contiguous, intent(in) :: b(:)
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> Error handling: rank deficient, no memory
   type(error_type), allocatable, intent(out) :: error
   integer(i8), allocatable :: start(:), column(:)
   real(wp), allocatable :: value(:)
   integer(i8) :: k
   type(threads_type) :: kept
   integer(c_int) :: stat

   call op%compressed(start, column, value)
   allocate (self%scale(op%n), source=0.0_wp)
   do k = 1, size(value, kind=i8)
      self%scale(column(k) + 1) = self%scale(column(k) + 1) + value(k)**2
   end do
   self%scale = sqrt(self%scale)
   if (.not. all(self%scale > 0.0_wp)) return
   do k = 1, size(value, kind=i8)
      value(k) = value(k)/self%scale(column(k) + 1)
   end do
   call hold_threads(kept)
   stat = rk_sparse_qr(int(op%m, i8), int(op%n, i8), start, column, value, b, &
      & op%n*epsilon(1.0_wp), x, self%handle)
   call release_threads(kept)
   call complain(stat, error)
   if (.not. allocated(error)) x = x/self%scale
end subroutine sparse_qr

!> Factorise a square matrix, and solve equations with it if a right-hand side is given
subroutine solve_sparse(kept, n, start, row, value, definite, error, b, x, rcond)
   !> Factor, or data left from earlier factors of matrices with the same sparsity pattern
   type(sparse_factor), intent(inout) :: kept
   !> Unknowns
   integer, intent(in) :: n
   !> Column j has entries start(j)+1 : start(j+1), shape (n + 1)
   integer(i8), contiguous, intent(in) :: start(:)
   !> Row of each entry less 1, ascending in each column
   integer(i8), contiguous, intent(in) :: row(:)
   !> Entries
   real(wp), contiguous, intent(in) :: value(:)
   !> The entries are the upper triangle of a symmetric, positive definite matrix (Cholesky);
   !> otherwise they are the whole matrix (LU), and its factor is not kept
   logical, intent(in) :: definite
   !> Error handling: not positive definite, singular, no memory
   type(error_type), allocatable, intent(out) :: error
   !> Right hand side, shape (n)
   real(wp), contiguous, intent(in), optional :: b(:)
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout), optional :: x(:)
   !> Estimate of the reciprocal condition number [-]
   real(wp), intent(out), optional :: rcond
   type(threads_type) :: threads
   real(wp) :: rough
   integer(c_int) :: stat

   call hold_threads(threads)
   if (present(b)) then
      stat = rk_sparse_direct(int(n, i8), start, row, value, merge(1, 0, definite), b, x, rough, &
         & kept%handle)
   else
      stat = rk_sparse_direct(int(n, i8), start, row, value, merge(1, 0, definite), rcond=rough, &
         & kept=kept%handle)
   end if
   call release_threads(threads)
   if (present(rcond)) rcond = rough
   call complain(stat, error)
end subroutine solve_sparse

!> Convert the return code of the shim to an error
subroutine complain(stat, error)
   !> Return code
   integer(c_int), intent(in) :: stat
   type(error_type), allocatable, intent(out) :: error

   select case (stat)
   case (0)
   case (2)
      call fatal_error(error, err_memory, 'no memory for a sparse factor: use solver "refined"')
   case default
      call fatal_error(error, err_linalg, 'matrix is not positive definite or not of full rank')
   end select
end subroutine complain

!> Solve with a factor; a Cholesky factor also takes several vectors, one behind the other
subroutine solve(self, x)
   class(sparse_factor), intent(in) :: self
   real(wp), contiguous, intent(inout) :: x(:)
   type(threads_type) :: kept

   call hold_threads(kept)
   call rk_sparse_solve(self%handle, size(x, kind=i8), x)
   call release_threads(kept)
end subroutine solve

!> Elemental, so that every factor of an array is freed as well
impure elemental subroutine free(self)
   type(sparse_factor), intent(inout) :: self

   if (c_associated(self%handle)) call rk_sparse_free(self%handle)
   self%handle = c_null_ptr
end subroutine free

end module rk_sparse
