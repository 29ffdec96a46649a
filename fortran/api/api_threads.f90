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
