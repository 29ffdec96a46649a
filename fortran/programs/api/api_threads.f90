! Python boundary of the threads.

!> Set the number of threads of the calls that follow, 0 leaves it as it is; the number before
subroutine set_threads(number, before)
   use omp_lib, only : omp_get_max_threads, omp_set_num_threads
   implicit none
   integer, intent(in) :: number
   integer, intent(out) :: before

   before = omp_get_max_threads()
   if (number > 0) call omp_set_num_threads(number)
end subroutine set_threads

!> Let the calling thread work alone from now on, whatever number of threads it is asked for: in the
!> child of a fork the team that its parent's thread had does not exist, and waiting for it would
!> never end. Threads that the child starts itself have teams of their own.
subroutine work_alone()
   use omp_lib, only : omp_set_max_active_levels
   implicit none

   call omp_set_max_active_levels(0)
end subroutine work_alone
