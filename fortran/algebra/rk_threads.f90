!> Libraries whose sums depend on the number of threads are called with one thread.
!>
!> OpenBLAS and the libraries built on it (LAPACK, SuiteSparse) split a product by the number of
!> threads, and so change the order of its sums. Called from the threads of this package they use no
!> further ones; everywhere else they are limited to one, so that one and two threads give the same
!> bits. Only the calling thread is limited: other threads of the process, and a BLAS brought by
!> numpy, keep theirs. This applies to OpenBLAS built with OpenMP, as `setup.sh` installs it.
!> CHOLMOD requests teams of four threads to copy, whatever was set: it gets none. On two busy cores
!> they made the solves of a plane body five times slower.
module rk_threads
   use omp_lib, only : omp_get_max_active_levels, omp_get_max_threads, omp_set_max_active_levels, &
      & omp_set_num_threads
   implicit none
   private

   public :: threads_type, hold_threads, release_threads

   !> Thread settings to be restored
   type :: threads_type
      !> Number of threads of a team
      integer :: number = 1
      !> Number of nested levels
      integer :: levels = 1
   end type threads_type

contains

!> Limit the libraries that this thread calls to one thread
subroutine hold_threads(kept)
   !> Settings to be restored
   type(threads_type), intent(out) :: kept

   kept = threads_type(omp_get_max_threads(), omp_get_max_active_levels())
   call omp_set_num_threads(1)
   call omp_set_max_active_levels(0)
end subroutine hold_threads

!> Restore the settings
subroutine release_threads(kept)
   !> Settings before `hold_threads`
   type(threads_type), intent(in) :: kept

   call omp_set_num_threads(kept%number)
   call omp_set_max_active_levels(kept%levels)
end subroutine release_threads

end module rk_threads
