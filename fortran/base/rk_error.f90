!> Errors are values: an unallocated `error_type` means success.
!>
!> Nothing below the programs stops or prints; the last argument of a procedure that may
!> fail is `error`, tested by its caller after every call.
module rk_error
   implicit none
   private

   public :: error_type, fatal_error, pack_error
   public :: err_input, err_file, err_convergence, err_linalg, err_memory, err_stopped

   !> Impossible value, bad deck, bad shape: the user's input must change (exit code 2)
   integer, parameter :: err_input = 2
   !> A file is missing, unreadable or cannot be written (exit code 2)
   integer, parameter :: err_file = 3
   !> The nonlinear solution was not reached (exit code 1)
   integer, parameter :: err_convergence = 4
   !> A factorisation failed or a matrix is singular (exit code 1)
   integer, parameter :: err_linalg = 5
   !> The scene does not fit into memory (exit code 2)
   integer, parameter :: err_memory = 6
   !> Stopped by the user (exit code 1)
   integer, parameter :: err_stopped = 7

   !> What went wrong and what to do about it
   type :: error_type
      !> One of the err_* constants
      integer :: code = 0
      !> Full sentence with the offending value
      character(len=:), allocatable :: message
   end type error_type

contains

subroutine fatal_error(error, code, message)
   type(error_type), allocatable, intent(out) :: error
   !> One of the err_* constants
   integer, intent(in) :: code
   !> Full sentence with the offending value
   character(len=*), intent(in) :: message

   allocate (error)
   error%code = code
   error%message = message
end subroutine fatal_error

!> Status and message of an error, for the Python boundary; 0 and blanks without one
subroutine pack_error(error, stat, message)
   type(error_type), allocatable, intent(in) :: error
   !> Code of the error, 0 for success
   integer, intent(out) :: stat
   !> Text of the error, blank for success
   character(len=*), intent(out) :: message

   stat = 0
   message = ''
   if (allocated(error)) then
      stat = error%code
      message = error%message
   end if
end subroutine pack_error

end module rk_error
