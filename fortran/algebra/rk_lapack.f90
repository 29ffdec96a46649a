!> Wrappers of the LAPACK and BLAS routines used by the other modules, for whole arrays.
!>
!> Reference: Anderson et al., LAPACK Users' Guide, 3rd ed., SIAM (1999),
!>            doi:10.1137/1.9780898719604
module rk_lapack
   use rk_blas, only : dpotrf, dsyrk, dtrsv
   use rk_error, only : error_type, fatal_error, err_linalg
   use rk_precision, only : wp
   use rk_text, only : to_text
   use rk_threads, only : hold_threads, release_threads, threads_type
   implicit none
   private

   public :: cholesky, solve_triangular, solve_qr, solve_pivoted_qr, svd, syrk

   interface
      subroutine dgels(trans, m, n, nrhs, a, lda, b, ldb, work, lwork, info)
         import :: wp
         character, intent(in) :: trans
         integer, intent(in) :: m, n, nrhs, lda, ldb, lwork
         real(wp), intent(inout) :: a(lda, *), b(ldb, *)
         real(wp), intent(out) :: work(*)
         integer, intent(out) :: info
      end subroutine dgels
      subroutine dgelsy(m, n, nrhs, a, lda, b, ldb, jpvt, rcond, rank, work, lwork, info)
         import :: wp
         integer, intent(in) :: m, n, nrhs, lda, ldb, lwork
         real(wp), intent(inout) :: a(lda, *), b(ldb, *)
         integer, intent(inout) :: jpvt(*)
         real(wp), intent(in) :: rcond
         integer, intent(out) :: rank, info
         real(wp), intent(out) :: work(*)
      end subroutine dgelsy
      subroutine dgesdd(jobz, m, n, a, lda, s, u, ldu, vt, ldvt, work, lwork, iwork, info)
         import :: wp
         character, intent(in) :: jobz
         integer, intent(in) :: m, n, lda, ldu, ldvt, lwork
         real(wp), intent(inout) :: a(lda, *)
         real(wp), intent(out) :: s(*), u(ldu, *), vt(ldvt, *), work(*)
         integer, intent(out) :: iwork(*), info
      end subroutine dgesdd
   end interface

contains

!> Upper Cholesky factor in place of the upper triangle
subroutine cholesky(a, error)
   !> Symmetric positive definite matrix, shape (n, n)
   real(wp), contiguous, intent(inout) :: a(:, :)
   !> Error handling: not positive definite
   type(error_type), allocatable, intent(out) :: error
   type(threads_type) :: kept
   integer :: info

   call hold_threads(kept)
   call dpotrf('u', size(a, 1), a, size(a, 1), info)
   call release_threads(kept)
   if (info /= 0) call fatal_error(error, err_linalg, 'matrix is not positive definite, minor ' &
      & //to_text(info)//' of '//to_text(size(a, 1)))
end subroutine cholesky

!> Solve R x = b or R^T x = b in place
subroutine solve_triangular(r, b, transposed)
   !> Matrix whose leading upper triangle is R, shape (>= n, n)
   real(wp), contiguous, intent(in) :: r(:, :)
   !> Right hand side, replaced by the solution, shape (n)
   real(wp), contiguous, intent(inout) :: b(:)
   !> Solve with the transpose
   logical, intent(in) :: transposed
   type(threads_type) :: kept

   call hold_threads(kept)
   call dtrsv('u', merge('t', 'n', transposed), 'n', size(b), r, size(r, 1), b, 1)
   call release_threads(kept)
end subroutine solve_triangular

!> Least squares by Householder QR (DGELS)
subroutine solve_qr(a, b, error)
   !> Matrix, its R in the leading triangle afterwards, shape (m, n), m >= n
   real(wp), contiguous, intent(inout) :: a(:, :)
   !> Right hand side, shape (m); its first n entries are the solution afterwards
   real(wp), contiguous, intent(inout) :: b(:)
   !> Error handling: rank deficient
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: work(:)
   real(wp) :: query(1)
   type(threads_type) :: kept
   integer :: m, n, info

   m = size(a, 1)
   n = size(a, 2)
   call dgels('n', m, n, 1, a, m, b, m, query, -1, info)
   allocate (work(nint(query(1))))
   call hold_threads(kept)
   call dgels('n', m, n, 1, a, m, b, m, work, size(work), info)
   call release_threads(kept)
   if (info /= 0) call fatal_error(error, err_linalg, 'least squares matrix of shape ' &
      & //to_text(m)//' x '//to_text(n)//' is rank deficient, column '//to_text(info))
end subroutine solve_qr

!> Minimum-norm least squares solutions by rank revealing QR (DGELSY)
subroutine solve_pivoted_qr(a, b, pivot, rank, error)
   !> Matrix, destroyed, shape (m, n), m >= n
   real(wp), contiguous, intent(inout) :: a(:, :)
   !> Right hand sides, shape (m, k); their first n entries are the solutions afterwards
   real(wp), contiguous, intent(inout) :: b(:, :)
   !> Column order of the factor in the leading triangle, shape (n)
   integer, intent(out) :: pivot(:)
   !> Numerical rank to a relative accuracy of n roundings
   integer, intent(out) :: rank
   !> Error handling: numbers that are not finite
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: work(:)
   real(wp) :: query(1), tolerance
   type(threads_type) :: kept
   integer :: m, n, k, info

   m = size(a, 1)
   n = size(a, 2)
   k = size(b, 2)
   tolerance = n*epsilon(1.0_wp)
   pivot = 0
   call dgelsy(m, n, k, a, m, b, m, pivot, tolerance, rank, query, -1, info)
   allocate (work(nint(query(1))))
   call hold_threads(kept)
   call dgelsy(m, n, k, a, m, b, m, pivot, tolerance, rank, work, size(work), info)
   call release_threads(kept)
   if (info /= 0) call fatal_error(error, err_linalg, 'rank revealing QR failed, info ' &
      & //to_text(info))
end subroutine solve_pivoted_qr

!> Thin singular value decomposition A = U S V^T
subroutine svd(a, u, s, vt, error)
   !> Matrix, shape (m, n)
   real(wp), intent(in) :: a(:, :)
   !> Left singular vectors, shape (m, min(m, n))
   real(wp), allocatable, intent(out) :: u(:, :)
   !> Singular values in descending order, shape (min(m, n))
   real(wp), allocatable, intent(out) :: s(:)
   !> Right singular vectors, transposed, shape (min(m, n), n)
   real(wp), allocatable, intent(out) :: vt(:, :)
   !> Error handling: no convergence
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: copy(:, :), work(:)
   integer, allocatable :: iwork(:)
   real(wp) :: query(1)
   type(threads_type) :: kept
   integer :: m, n, k, info

   m = size(a, 1)
   n = size(a, 2)
   k = min(m, n)
   allocate (copy, source=a)
   allocate (u(m, k), s(k), vt(k, n), iwork(8*k))
   call dgesdd('s', m, n, copy, m, s, u, m, vt, k, query, -1, iwork, info)
   allocate (work(nint(query(1))))
   call hold_threads(kept)
   call dgesdd('s', m, n, copy, m, s, u, m, vt, k, work, size(work), iwork, info)
   call release_threads(kept)
   if (info /= 0) call fatal_error(error, err_linalg, 'singular value decomposition failed, info ' &
      & //to_text(info)//': check for NaN or infinite values')
end subroutine svd

!> Upper triangle of C = A^T A
subroutine syrk(a, rows, columns, c)
   !> Matrix, shape (>= rows, >= columns)
   real(wp), contiguous, intent(in) :: a(:, :)
   !> Rows in use
   integer, intent(in) :: rows
   !> Columns in use
   integer, intent(in) :: columns
   !> Product, shape (>= columns, >= columns)
   real(wp), contiguous, intent(inout) :: c(:, :)
   type(threads_type) :: kept

   call hold_threads(kept)
   call dsyrk('u', 't', columns, rows, 1.0_wp, a, size(a, 1), 0.0_wp, c, size(c, 1))
   call release_threads(kept)
end subroutine syrk

end module rk_lapack
