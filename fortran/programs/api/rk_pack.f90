!> Errors and materials as plain numbers and text, for the Python boundary.
module rk_pack
   use rk_error, only : error_type
   use rk_material, only : material_item
   use rk_energies, only : new_material
   use rk_parameters, only : parameters_type
   use rk_precision, only : wp
   implicit none
   private

   public :: pack_error, unpack_material

contains

!> Status and message of an error; 0 and blanks without one
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

!> Material from its name and its parameters by the keys of a deck
subroutine unpack_material(item, name, keys, texts, numbers, error)
   type(material_item), intent(out) :: item
   !> Name for messages
   character(len=*), intent(in) :: name
   !> Keys, shape (n)
   character(len=*), intent(in) :: keys(:)
   !> Values that are texts, blank for numbers, shape (n)
   character(len=*), intent(in) :: texts(:)
   !> Values that are numbers, shape (n)
   real(wp), intent(in) :: numbers(:)
   type(error_type), allocatable, intent(out) :: error
   type(parameters_type) :: parameters
   integer :: i

   parameters%kind = 'material'
   parameters%name = name
   do i = 1, size(keys)
      if (texts(i) == '') then
         call parameters%add(trim(keys(i)), numbers(i))
      else
         call parameters%add(trim(keys(i)), trim(texts(i)))
      end if
   end do
   call new_material(item, parameters, error)
end subroutine unpack_material

end module rk_pack
