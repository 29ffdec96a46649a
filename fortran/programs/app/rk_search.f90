!> Receiver of a search for points, before a run has files: tells of it on the terminal.
module rk_search
   use rk_precision, only : wp
   use rk_recorder, only : iteration_type, recorder_type, step_type
   use rk_system, only : interrupted, tell
   implicit none
   private

   public :: search_type

   !> Receiver
   type, extends(recorder_type) :: search_type
      !> Below 0 nothing is told
      integer :: verbosity = 0
   contains
      procedure :: iteration
      procedure :: step
      procedure :: stopped
      procedure :: note
   end type search_type

contains

!> An iteration was done
subroutine iteration(self, it)
   !> Receiver
   class(search_type), intent(inout) :: self
   !> Iteration
   type(iteration_type), intent(in) :: it

   associate (unused => self, unused_too => it)
   end associate
end subroutine iteration

!> A load step converged
subroutine step(self, st, x)
   !> Receiver
   class(search_type), intent(inout) :: self
   !> Load step
   type(step_type), intent(in) :: st
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)

   associate (unused => self, unused_too => st, unused_as_well => x)
   end associate
end subroutine step

!> Whether the user wants to stop
logical function stopped(self)
   !> Receiver
   class(search_type), intent(inout) :: self

   associate (unused => self)
   end associate
   stopped = interrupted()
end function stopped

!> Something happened on the way
subroutine note(self, line)
   !> Receiver
   class(search_type), intent(inout) :: self
   !> What happened
   character(len=*), intent(in) :: line

   if (self%verbosity >= 0) call tell(line)
end subroutine note

end module rk_search
