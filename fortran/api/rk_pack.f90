!> Errors as plain numbers and text, for the Python boundary.
module rk_pack
   use rk_error, only : error_type
   implicit none
   private

   public :: pack_error

contains

!> Status and message of an error; 0 and blanks without one
subroutine pack_error(error, stat, message)
   !> Error
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

end module rk_pack
