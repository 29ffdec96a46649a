!> Calls of libraries whose sums depend on the number of threads run on one.
!>
!> OpenBLAS and what is built on it (LAPACK, SuiteSparse) divide a product by the number of threads,
!> and with it the order of its sums. Where this package calls them from its own threads they use no
!> more of them; everywhere else they are held to one, so that one and two threads give the same
!> bits. Only the calling thread is held: other threads of the process, and a BLAS that numpy
!> brings, keep theirs. This holds for OpenBLAS built with OpenMP, as `setup.sh` installs it.
!> CHOLMOD asks for teams of four to copy, whatever was set: it gets none. On two busy cores they
!> made the solves of a plane body five times slower.
module rk_threads
   use omp_lib, only : omp_get_max_active_levels, omp_get_max_threads, omp_set_max_active_levels, &
      & omp_set_num_threads
   implicit none
   private

   public :: threads_type, hold_threads, release_threads

   !> What is given back
   type :: threads_type
      !> Threads of a team
      integer :: number = 1
      !> Teams within teams
      integer :: levels = 1
   end type threads_type

contains

!> Let the libraries that this thread calls use one thread
subroutine hold_threads(kept)
   !> Threads to be given back
   type(threads_type), intent(out) :: kept

   kept = threads_type(omp_get_max_threads(), omp_get_max_active_levels())
   call omp_set_num_threads(1)
   call omp_set_max_active_levels(0)
end subroutine hold_threads

!> Give the threads back
subroutine release_threads(kept)
   !> Threads before `hold_threads`
   type(threads_type), intent(in) :: kept

   call omp_set_num_threads(kept%number)
   call omp_set_max_active_levels(kept%levels)
end subroutine release_threads

end module rk_threads
