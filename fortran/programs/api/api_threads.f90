! Python boundary of the threads.

!> Set the number of threads of later calls, 0 leaves it unchanged; returns the previous number
subroutine set_threads(number, before)
   use omp_lib, only : omp_get_max_threads, omp_set_num_threads
   implicit none
   integer, intent(in) :: number
   integer, intent(out) :: before

   before = omp_get_max_threads()
   if (number > 0) call omp_set_num_threads(number)
end subroutine set_threads

!> Limit the calling thread to one thread from now on, whatever number is requested: in the child of
!> a fork the team of its parent's thread does not exist, and waiting for it would never end.
!> Threads that the child starts itself have teams of their own.
subroutine work_alone()
   use omp_lib, only : omp_set_max_active_levels
   implicit none

   call omp_set_max_active_levels(0)
end subroutine work_alone
