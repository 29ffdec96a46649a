!> Calls of libraries whose sums depend on the number of threads run on one.
!>
!> OpenBLAS and what is built on it (LAPACK, SuiteSparse) divide a product by the number of threads,
!> and with it the order of its sums. Where this package calls them from its own threads they use no
!> more of them; everywhere else they are held to one, so that one and two threads give the same
!> bits. Only the calling thread is held: other threads of the process, and a BLAS that numpy
!> brings, keep theirs. This holds for OpenBLAS built with OpenMP, as `setup.sh` installs it.
module rk_threads
   use omp_lib, only : omp_get_max_threads, omp_set_num_threads
   implicit none
   private

   public :: hold_threads, release_threads

contains

!> Let the libraries that this thread calls use one thread
subroutine hold_threads(kept)
   !> Threads to be given back
   integer, intent(out) :: kept

   kept = omp_get_max_threads()
   call omp_set_num_threads(1)
end subroutine hold_threads

!> Give the threads back
subroutine release_threads(kept)
   !> Threads before `hold_threads`
   integer, intent(in) :: kept

   call omp_set_num_threads(kept)
end subroutine release_threads

end module rk_threads
