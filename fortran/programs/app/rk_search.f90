!> Receiver of a search for points, before a run has files: reports it on the terminal.
module rk_search
   use rk_recorder, only : recorder_type
   use rk_system, only : interrupted, tell
   implicit none
   private

   public :: search_type

   !> Receiver
   type, extends(recorder_type) :: search_type
      !> Below 0 nothing is printed
      integer :: verbosity = 0
   contains
      procedure :: stopped
      procedure :: note
   end type search_type

contains

!> Whether the user wants to stop
logical function stopped(self)
   class(search_type), intent(inout) :: self

   associate (unused => self)
   end associate
   stopped = interrupted()
end function stopped

!> Something happened on the way
subroutine note(self, line, warning)
   class(search_type), intent(inout) :: self
   character(len=*), intent(in) :: line
   !> It deserves attention, which the run that follows will ask for again
   logical, intent(in) :: warning

   if (self%verbosity >= 0 .and. .not. warning) call tell(line)
end subroutine note

end module rk_search
