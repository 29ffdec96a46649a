!> Symmetric positive definite matrices stored by block columns between their first entry and the
!> diagonal, and their Cholesky factors.
!>
!> The Cholesky factor of a matrix has no fill-in above the first entry of a column. With unknowns
!> ordered along the body, memory grows as n b and work as n b^2, where b is the bandwidth. With
!> block columns every operation is one of matrices. Each block belongs to one thread, so that the
!> result does not depend on the number of threads.
!>
!> Reference: George, Liu, Computer Solution of Large Sparse Positive Definite Systems,
!>            Prentice-Hall (1981), chapter 4
module rk_envelope
   use rk_blas, only : gemm => dgemm, gemv => dgemv, potrf => dpotrf, &
      & syrk => dsyrk, trsm => dtrsm, trsv => dtrsv
   use rk_error, only : error_type, fatal_error, err_linalg, err_memory
   use rk_factor, only : factor_type
   use rk_precision, only : i8, wp, rk => wp
   use rk_text, only : to_text
   implicit none
   private

   public :: envelope_type, new_envelope

   include 'envelope.inc'
end module rk_envelope
