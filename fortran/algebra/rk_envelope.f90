!> Symmetric positive definite matrices stored by block columns between their first entry and the
!> diagonal, and their Cholesky factors.
!>
!> The Cholesky factor of a matrix fills nothing above the first entry of a column, so unknowns
!> ordered along the body keep memory and work to n b and n b^2, b the reach of an unknown. Block
!> columns make every operation one of matrices; a block belongs to one thread, so that the result
!> does not depend on the number of threads.
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
