!> Kinds of numbers, used everywhere.
module rk_precision
   use, intrinsic :: iso_fortran_env, only : int64, real32, real64
   implicit none
   private

   public :: wp, sp, i8, pi

   !> Working precision
   integer, parameter :: wp = real64
   !> Single precision, enough for preconditioners
   integer, parameter :: sp = real32
   !> Long integers: sizes that may exceed 2**31, hash keys
   integer, parameter :: i8 = int64
   !> Ratio of a circle's circumference to its diameter [-]
   real(wp), parameter :: pi = 3.141592653589793238462643383279502884_wp

end module rk_precision
