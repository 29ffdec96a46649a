!> Explicit interfaces of the BLAS and LAPACK routines that work on parts of larger arrays.
!>
!> Reference: Anderson et al., LAPACK Users' Guide, 3rd ed., SIAM (1999),
!>            doi:10.1137/1.9780898719604
module rk_blas
   use rk_precision, only : sp, wp
   implicit none
   private

   public :: dgemm, dgemv, dgesv, dpotrf, dsteqr, dsyrk, dtrsm, dtrsv
   public :: sgemm, sgemv, spotrf, ssyrk, strsm, strsv

   interface
      subroutine dgemm(transa, transb, m, n, k, alpha, a, lda, b, ldb, beta, c, ldc)
         import :: wp
         character, intent(in) :: transa, transb
         integer, intent(in) :: m, n, k, lda, ldb, ldc
         real(wp), intent(in) :: alpha, beta, a(lda, *), b(ldb, *)
         real(wp), intent(inout) :: c(ldc, *)
      end subroutine dgemm
      subroutine dgemv(trans, m, n, alpha, a, lda, x, incx, beta, y, incy)
         import :: wp
         character, intent(in) :: trans
         integer, intent(in) :: m, n, lda, incx, incy
         real(wp), intent(in) :: alpha, beta, a(lda, *), x(*)
         real(wp), intent(inout) :: y(*)
      end subroutine dgemv
      subroutine dgesv(n, nrhs, a, lda, ipiv, b, ldb, info)
         import :: wp
         integer, intent(in) :: n, nrhs, lda, ldb
         real(wp), intent(inout) :: a(lda, *), b(ldb, *)
         integer, intent(out) :: ipiv(*), info
      end subroutine dgesv
      subroutine dpotrf(uplo, n, a, lda, info)
         import :: wp
         character, intent(in) :: uplo
         integer, intent(in) :: n, lda
         real(wp), intent(inout) :: a(lda, *)
         integer, intent(out) :: info
      end subroutine dpotrf
      subroutine dsteqr(compz, n, d, e, z, ldz, work, info)
         import :: wp
         character, intent(in) :: compz
         integer, intent(in) :: n, ldz
         real(wp), intent(inout) :: d(*), e(*), z(ldz, *)
         real(wp), intent(out) :: work(*)
         integer, intent(out) :: info
      end subroutine dsteqr
      subroutine dsyrk(uplo, trans, n, k, alpha, a, lda, beta, c, ldc)
         import :: wp
         character, intent(in) :: uplo, trans
         integer, intent(in) :: n, k, lda, ldc
         real(wp), intent(in) :: alpha, beta, a(lda, *)
         real(wp), intent(inout) :: c(ldc, *)
      end subroutine dsyrk
      subroutine dtrsm(side, uplo, transa, diag, m, n, alpha, a, lda, b, ldb)
         import :: wp
         character, intent(in) :: side, uplo, transa, diag
         integer, intent(in) :: m, n, lda, ldb
         real(wp), intent(in) :: alpha, a(lda, *)
         real(wp), intent(inout) :: b(ldb, *)
      end subroutine dtrsm
      subroutine dtrsv(uplo, trans, diag, n, a, lda, x, incx)
         import :: wp
         character, intent(in) :: uplo, trans, diag
         integer, intent(in) :: n, lda, incx
         real(wp), intent(in) :: a(lda, *)
         real(wp), intent(inout) :: x(*)
      end subroutine dtrsv
      subroutine sgemm(transa, transb, m, n, k, alpha, a, lda, b, ldb, beta, c, ldc)
         import :: sp
         character, intent(in) :: transa, transb
         integer, intent(in) :: m, n, k, lda, ldb, ldc
         real(sp), intent(in) :: alpha, beta, a(lda, *), b(ldb, *)
         real(sp), intent(inout) :: c(ldc, *)
      end subroutine sgemm
      subroutine sgemv(trans, m, n, alpha, a, lda, x, incx, beta, y, incy)
         import :: sp
         character, intent(in) :: trans
         integer, intent(in) :: m, n, lda, incx, incy
         real(sp), intent(in) :: alpha, beta, a(lda, *), x(*)
         real(sp), intent(inout) :: y(*)
      end subroutine sgemv
      subroutine spotrf(uplo, n, a, lda, info)
         import :: sp
         character, intent(in) :: uplo
         integer, intent(in) :: n, lda
         real(sp), intent(inout) :: a(lda, *)
         integer, intent(out) :: info
      end subroutine spotrf
      subroutine ssyrk(uplo, trans, n, k, alpha, a, lda, beta, c, ldc)
         import :: sp
         character, intent(in) :: uplo, trans
         integer, intent(in) :: n, k, lda, ldc
         real(sp), intent(in) :: alpha, beta, a(lda, *)
         real(sp), intent(inout) :: c(ldc, *)
      end subroutine ssyrk
      subroutine strsm(side, uplo, transa, diag, m, n, alpha, a, lda, b, ldb)
         import :: sp
         character, intent(in) :: side, uplo, transa, diag
         integer, intent(in) :: m, n, lda, ldb
         real(sp), intent(in) :: alpha, a(lda, *)
         real(sp), intent(inout) :: b(ldb, *)
      end subroutine strsm
      subroutine strsv(uplo, trans, diag, n, a, lda, x, incx)
         import :: sp
         character, intent(in) :: uplo, trans, diag
         integer, intent(in) :: n, lda, incx
         real(sp), intent(in) :: a(lda, *)
         real(sp), intent(inout) :: x(*)
      end subroutine strsv
   end interface

end module rk_blas
