!> Texts of C.
module rk_cstring
   use, intrinsic :: iso_c_binding, only : c_char, c_f_pointer, c_ptr, c_size_t
   implicit none
   private

   public :: c_strlen, to_fortran

   interface
      pure function c_strlen(text) result(length) bind(c, name='strlen')
         import :: c_ptr, c_size_t
         type(c_ptr), intent(in), value :: text
         integer(c_size_t) :: length
      end function c_strlen
   end interface

contains

function to_fortran(pointer) result(text)
   !> Text that ends with a null character
   type(c_ptr), intent(in) :: pointer
   character(len=c_strlen(pointer)) :: text
   character(kind=c_char), pointer :: letters(:)
   integer :: i

   call c_f_pointer(pointer, letters, [len(text)])
   do i = 1, len(text)
      text(i:i) = letters(i)
   end do
end function to_fortran

end module rk_cstring
