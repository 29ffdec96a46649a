!> Memory available on this machine.
module rk_memory
   use rk_precision, only : wp
   implicit none
   private

   public :: available_bytes

contains

!> Free memory reported by the system; huge where it reports none [byte]
real(wp) function available_bytes()
   character(len=64) :: name, line
   integer :: unit, stat
   real(wp) :: kilobytes

   available_bytes = huge(1.0_wp)
   open (newunit=unit, file='/proc/meminfo', action='read', status='old', iostat=stat)
   if (stat /= 0) return
   do
      read (unit, '(a)', iostat=stat) line
      if (stat /= 0) exit
      if (index(line, 'MemAvailable:') /= 1) cycle
      read (line, *, iostat=stat) name, kilobytes
      if (stat == 0) available_bytes = 1024.0_wp*kilobytes
      exit
   end do
   close (unit)
end function available_bytes

end module rk_memory
