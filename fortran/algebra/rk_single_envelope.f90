!> Envelopes in single precision (rk_envelope), whose factors precondition an iteration: they take
!> half the memory and time.
module rk_single_envelope
   use rk_blas, only : gemm => sgemm, gemv => sgemv, potrf => spotrf, &
      & syrk => ssyrk, trsm => strsm, trsv => strsv
   use rk_error, only : error_type, fatal_error, err_linalg, err_memory
   use rk_factor, only : factor_type
   use rk_precision, only : i8, wp, rk => sp
   use rk_text, only : to_text
   implicit none
   private

   public :: envelope_type, new_envelope

   include 'envelope.inc'
end module rk_single_envelope
