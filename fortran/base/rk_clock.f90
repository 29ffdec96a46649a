!> Wall clock.
module rk_clock
   use, intrinsic :: iso_fortran_env, only : int64
   use rk_precision, only : wp
   implicit none
   private

   public :: tick, timer_type

   !> Wall times of the parts of a solve [s]
   type :: timer_type
      !> Residuals and rows
      real(wp) :: assemble = 0.0_wp
      !> Least squares
      real(wp) :: solve = 0.0_wp
      !> Clock count at the start
      integer(int64) :: start = 0
   end type timer_type

contains

!> Seconds since a clock count
real(wp) function tick(since)
   !> Clock count
   integer(int64), intent(in) :: since
   integer(int64) :: now, rate

   call system_clock(now, rate)
   tick = real(now - since, wp)/real(rate, wp)
end function tick

end module rk_clock
