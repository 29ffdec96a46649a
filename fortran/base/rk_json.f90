!> A JSON text that is written piece by piece.
!>
!> Numbers keep all their digits in the shortest form that reads back the same; values that JSON
!> cannot represent (NaN, infinity) become null.
!>
!> References: 1. RFC 8259, The JavaScript Object Notation, doi:10.17487/RFC8259
module rk_json
   use, intrinsic :: ieee_arithmetic, only : ieee_is_finite
   use rk_error, only : error_type
   use rk_precision, only : wp
   use rk_text, only : to_text, written
   use rk_text_file, only : save_text
   implicit none
   private

   public :: json_type

   !> A growing text; every begin needs its end, and every item of an object needs a key
   type :: json_type
      !> Text written so far, with spare room
      character(len=:), allocatable, private :: buffer
      !> Its length without the spare room
      integer, private :: length = 0
      !> Depth of open objects and arrays
      integer, private :: depth = 0
      !> Is the next item the first of its object or array?
      logical, private :: first = .true.
   contains
      procedure :: begin_object, end_object, begin_array, end_array
      !> put(key, value) inside an object: an integer, a real number, a logical, a text or a list of
      !> these, on one line
      generic :: put => put_value, put_list
      procedure :: put_json, put_lines, text => text_so_far, save => save_json
      procedure, private :: put_value, put_list, item, append
   end type json_type

contains

!> Start an item: comma, new line, indentation and key
subroutine item(self, key)
   class(json_type), intent(inout) :: self
   !> Name of the item; absent in an array
   character(len=*), intent(in), optional :: key

   if (.not. self%first) call self%append(',')
   if (self%depth > 0) call self%append(new_line('a')//repeat(' ', self%depth))
   self%first = .false.
   if (.not. present(key)) return
   call append_quoted(self, key)
   call self%append(': ')
end subroutine item

subroutine begin_object(self, key)
   class(json_type), intent(inout) :: self
   !> Name of the object; absent in an array and at the start
   character(len=*), intent(in), optional :: key

   call begin(self, '{', key)
end subroutine begin_object

subroutine begin_array(self, key)
   class(json_type), intent(inout) :: self
   character(len=*), intent(in) :: key

   call begin(self, '[', key)
end subroutine begin_array

subroutine begin(self, bracket, key)
   class(json_type), intent(inout) :: self
   character(len=1), intent(in) :: bracket
   character(len=*), intent(in), optional :: key

   call self%item(key)
   call self%append(bracket)
   self%depth = self%depth + 1
   self%first = .true.
end subroutine begin

subroutine end_object(self)
   class(json_type), intent(inout) :: self

   call end_list(self, '}')
end subroutine end_object

subroutine end_array(self)
   class(json_type), intent(inout) :: self

   call end_list(self, ']')
end subroutine end_array

subroutine end_list(self, bracket)
   class(json_type), intent(inout) :: self
   character(len=1), intent(in) :: bracket

   self%depth = self%depth - 1
   if (.not. self%first) call self%append(new_line('a')//repeat(' ', self%depth))
   call self%append(bracket)
   self%first = .false.
end subroutine end_list

!> Put a value into an object
subroutine put_value(self, key, value)
   class(json_type), intent(inout) :: self
   character(len=*), intent(in) :: key
   !> Number, logical or text
   class(*), intent(in) :: value

   call self%item(key)
   call append_literal(self, value)
end subroutine put_value

!> Put a list into an object
subroutine put_list(self, key, value)
   class(json_type), intent(inout) :: self
   character(len=*), intent(in) :: key
   !> Numbers, logicals or texts
   class(*), intent(in) :: value(:)

   integer :: i

   call self%item(key)
   call self%append('[')
   do i = 1, size(value)
      if (i > 1) call self%append(', ')
      call append_literal(self, value(i))
   end do
   call self%append(']')
end subroutine put_list

!> Put an item whose value is already JSON into an object
subroutine put_json(self, key, value)
   class(json_type), intent(inout) :: self
   character(len=*), intent(in) :: key
   !> Complete value
   character(len=*), intent(in) :: value

   call self%item(key)
   call self%append(value)
end subroutine put_json

!> Put the lines of a text into an object, as a list
subroutine put_lines(self, key, text)
   class(json_type), intent(inout) :: self
   character(len=*), intent(in) :: key
   !> Lines, each ending in a line feed
   character(len=*), intent(in) :: text
   integer :: first, length

   call self%begin_array(key)
   first = 1
   do
      length = index(text(first:), new_line('a'))
      if (length == 0) exit
      call self%item()
      call append_quoted(self, text(first:first + length - 2))
      first = first + length
   end do
   call self%end_array()
end subroutine put_lines

!> Append a value
subroutine append_literal(self, value)
   type(json_type), intent(inout) :: self
   class(*), intent(in) :: value

   select type (value)
   type is (integer)
      call self%append(to_text(value))
   type is (real(wp))
      call append_real(self, value)
   type is (logical)
      call self%append(trim(merge('true ', 'false', value)))
   type is (character(len=*))
      call append_quoted(self, value)
   end select
end subroutine append_literal

!> Append to the text; the room doubles, so that n pieces cost O(n)
subroutine append(self, piece)
   class(json_type), intent(inout) :: self
   !> Text to append
   character(len=*), intent(in) :: piece
   character(len=:), allocatable :: larger
   integer :: needed

   needed = self%length + len(piece)
   if (.not. allocated(self%buffer)) allocate (character(len=1024) :: self%buffer)
   if (needed > len(self%buffer)) then
      allocate (character(len=max(needed, 2*len(self%buffer))) :: larger)
      larger(:self%length) = self%buffer(:self%length)
      call move_alloc(larger, self%buffer)
   end if
   self%buffer(self%length + 1:needed) = piece
   self%length = needed
end subroutine append

!> Text written so far
pure function text_so_far(self) result(text)
   class(json_type), intent(in) :: self
   character(len=self%length) :: text

   if (self%length > 0) text = self%buffer(:self%length)
end function text_so_far

!> Write the text to a file, which is either complete or does not exist
subroutine save_json(self, path, error)
   class(json_type), intent(in) :: self
   character(len=*), intent(in) :: path
   type(error_type), allocatable, intent(out) :: error

   call save_text(path, self%buffer(:self%length), error)
end subroutine save_json

!> Append a text in quotation marks, with JSON's escapes
subroutine append_quoted(self, value)
   type(json_type), intent(inout) :: self
   !> Any text
   character(len=*), intent(in) :: value
   character(len=6) :: code
   integer :: i

   call self%append('"')
   do i = 1, len(value)
      select case (iachar(value(i:i)))
      case (34, 92)
         call self%append('\'//value(i:i))
      case (10)
         call self%append('\n')
      case (0:9, 11:31, 127)
         write (code, '(a, z4.4)') '\u', iachar(value(i:i))
         call self%append(code)
      case default
         call self%append(value(i:i))
      end select
   end do
   call self%append('"')
end subroutine append_quoted

!> Append the shortest text that reads back the same number
subroutine append_real(self, value)
   type(json_type), intent(inout) :: self
   real(wp), intent(in) :: value
   character(len=:), allocatable :: text

   text = 'null'
   if (ieee_is_finite(value)) text = trim(written(value, 0, 0))
   if (verify(text, '-0123456789') == 0) text = text//'.0'
   call self%append(text)
end subroutine append_real

end module rk_json
