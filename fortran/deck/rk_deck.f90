!> The input deck: values by key, checked and filled with the defaults of the schema.
!>
!> Keys are "table.key", for an array of tables "table.1.key" with the entry's number. The TOML
!> parser and all checks are C++ (deck.h); plain values and their places are stored here.
module rk_deck
   use, intrinsic :: iso_c_binding, only : c_char, c_double, c_f_pointer, c_int, c_null_char, c_ptr
   use rk_cstring, only : to_fortran
   use rk_error, only : err_input, error_type, fatal_error
   use rk_expression, only : expression_type, value_type
   use rk_precision, only : wp
   use rk_text, only : line, lines_of
   implicit none
   private

   public :: deck_type, open_deck, resolve_key, word_length

   !> Longest key, and longest word of an array of texts
   integer, parameter :: word_length = 32

   !> Kinds of entries, numbered as in deck_c.cpp
   integer, parameter :: other = 0, is_text = 1, is_list = 2

   !> A table, or a key with its value
   type :: entry_type
      !> Full key
      character(len=:), allocatable :: key
      !> File and line, or the override; empty for a default
      character(len=:), allocatable :: where
      !> Key as a user would write it, "material.fat.K"
      character(len=:), allocatable :: address
      !> Value of a text; for several texts, one per line
      character(len=:), allocatable :: text
      !> Values of numbers
      real(wp), allocatable :: numbers(:)
      !> One of the kinds above
      integer :: kind = other
   end type entry_type

   !> A checked deck
   type :: deck_type
      !> Name of the file, as given by the user
      character(len=:), allocatable :: path
      !> Folder of the file; relative paths of the deck start there
      character(len=:), allocatable :: folder
      !> Text of the file, unchanged
      character(len=:), allocatable :: text
      !> SHA-256 of the text; overrides are added as lines "--set key=value"
      character(len=:), allocatable :: sha256
      !> All values, a JSON object
      character(len=:), allocatable :: json
      !> Entries in the order of their keys
      type(entry_type), allocatable, private :: entry(:)
      !> Overrides, one per line
      character(len=:), allocatable :: overrides
   contains
      procedure :: has, given, count => count_entries
      procedure :: complain, locate
      !> Whether the value is a text (where a number is possible as well)
      procedure :: is_text => value_is_text
      !> Value of a key. Without one a number or an expression is unchanged; texts and arrays are
      !> empty. The integer of a name is the number of the entry that has it.
      generic :: get => get_integer, get_real, get_text, get_reals, get_integers, get_texts, &
         & get_expression, get_value, get_values
      !> First components of a vector, which keeps its values if the deck has none
      procedure :: get_vector
      procedure :: vary
      procedure, private :: get_integer, get_real, get_text, get_reals, get_integers, get_texts, &
         & get_expression, get_value, get_values, set_expression
      procedure, private :: find
   end type deck_type

   !> An entry as in deck_c.cpp; all pointers are valid until rk_deck_close
   type, bind(c) :: entry_view
      type(c_ptr) :: key, where, address, text, numbers
      !> Number of numbers; kind
      integer(c_int) :: count, kind
   end type entry_view

   !> A deck as in deck_c.cpp, to which its handle points
   type, bind(c) :: deck_view
      type(c_ptr) :: message, name, text, sha256, folder, json, full_key, entries
      integer(c_int) :: count, status
   end type deck_view

   interface
      function rk_deck_open(path, text, overrides, command, key) result(handle) bind(c)
         import :: c_char, c_ptr
         character(kind=c_char), intent(in) :: path(*), text(*), overrides(*), command(*), key(*)
         type(c_ptr) :: handle
      end function rk_deck_open

      subroutine rk_deck_close(handle) bind(c)
         import :: c_ptr
         type(c_ptr), value :: handle
      end subroutine rk_deck_close
   end interface

contains

!> Read and check a deck, in a file or in memory; the error lists all complaints, one per line
subroutine open_deck(deck, path, text, overrides, command, error)
   type(deck_type), intent(out) :: deck
   !> File, or the name of the text for messages
   character(len=*), intent(in) :: path
   !> Text of the deck; blank to read the file
   character(len=*), intent(in) :: text
   !> "table.key=value" each; blank ones are ignored
   character(len=*), intent(in) :: overrides(:)
   !> Command whose tables are required, as in the schema's needed_by; blank for none
   character(len=*), intent(in) :: command
   type(error_type), allocatable, intent(out) :: error

   deck%overrides = joined(overrides)
   call take(deck, opened(path, text, deck%overrides, command, ''), error)
end subroutine open_deck

!> The C++ object of a deck
function opened(path, text, overrides, command, key) result(handle)
   !> File, or the name of the text
   character(len=*), intent(in) :: path
   character(len=*), intent(in) :: text
   !> Overrides, one per line
   character(len=*), intent(in) :: overrides
   !> Command whose tables are required, and key whose full name is requested; blank for none
   character(len=*), intent(in) :: command, key
   type(c_ptr) :: handle

   handle = rk_deck_open(trim(path)//c_null_char, text//c_null_char, overrides//c_null_char, &
      & trim(command)//c_null_char, key//c_null_char)
end function opened

!> The key that an override would set, with the name of its entry: material.fat.K for material.K.
!> The deck may have other faults
subroutine resolve_key(path, text, overrides, key, full, error)
   !> File, or the name for messages
   character(len=*), intent(in) :: path
   !> Text of the deck; blank to read the file
   character(len=*), intent(in) :: text
   !> "table.key=value" each; blank ones are ignored
   character(len=*), intent(in) :: overrides(:)
   !> Key as in an override
   character(len=*), intent(in) :: key
   !> Its full name
   character(len=:), allocatable, intent(out) :: full
   !> Error handling: no such key, entry or file
   type(error_type), allocatable, intent(out) :: error
   type(c_ptr) :: handle
   type(deck_view), pointer :: view

   handle = opened(path, text, joined(overrides), '', key)
   call c_f_pointer(handle, view)
   full = to_fortran(view%full_key)
   if (full == '') call fatal_error(error, int(view%status), to_fortran(view%message))
   call rk_deck_close(handle)
end subroutine resolve_key

!> The same deck with further overrides, which are inserted before its own
subroutine vary(self, overrides, other, error)
   class(deck_type), intent(in) :: self
   !> "table.key=value", one per line
   character(len=*), intent(in) :: overrides
   type(deck_type), intent(out) :: other
   type(error_type), allocatable, intent(out) :: error

   other%overrides = self%overrides//overrides
   call take(other, opened(self%path, self%text, other%overrides, '', ''), error)
end subroutine vary

pure integer function joined_length(list) result(length)
   character(len=*), intent(in) :: list(:)

   length = sum(len_trim(list)) + size(list)
end function joined_length

pure function joined(list) result(lines)
   !> Texts
   character(len=*), intent(in) :: list(:)
   character(len=joined_length(list)) :: lines
   integer :: i, at

   at = 1
   do i = 1, size(list)
      lines(at:) = trim(list(i))//new_line('a')
      at = at + len_trim(list(i)) + 1
   end do
end function joined

!> Copy all data of the C++ object and delete it
subroutine take(deck, handle, error)
   type(deck_type), intent(inout) :: deck
   !> C++ object
   type(c_ptr), intent(in) :: handle
   type(error_type), allocatable, intent(out) :: error
   type(deck_view), pointer :: view
   type(entry_view), pointer :: entries(:)
   real(c_double), pointer :: numbers(:)
   integer :: i

   call c_f_pointer(handle, view)
   call c_f_pointer(view%entries, entries, [view%count])
   deck%path = to_fortran(view%name)
   deck%text = to_fortran(view%text)
   deck%sha256 = to_fortran(view%sha256)
   deck%folder = to_fortran(view%folder)
   deck%json = to_fortran(view%json)
   allocate (deck%entry(view%count))
   do i = 1, size(deck%entry)
      associate (entry => deck%entry(i), from => entries(i))
         entry%kind = from%kind
         entry%key = to_fortran(from%key)
         entry%where = to_fortran(from%where)
         entry%address = to_fortran(from%address)
         entry%text = to_fortran(from%text)
         call c_f_pointer(from%numbers, numbers, [from%count])
         entry%numbers = numbers
      end associate
   end do
   if (view%status /= 0) call fatal_error(error, int(view%status), to_fortran(view%message))
   call rk_deck_close(handle)
end subroutine take

!> Number of the entry with a key, 0 if there is none
pure function find(self, key) result(number)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   integer :: number
   integer :: first, last, middle

   first = 1
   last = size(self%entry)
   do while (first < last)
      middle = (first + last)/2
      if (llt(self%entry(middle)%key, key)) then
         first = middle + 1
      else
         last = middle
      end if
   end do
   number = 0
   if (first > last) return
   if (self%entry(first)%key == key) number = first
end function find

!> Whether a key has a value, or a table exists
pure function has(self, key) result(yes)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   logical :: yes

   yes = self%count(key) > 0
end function has

!> Whether a key is given in the deck or by an override
pure function given(self, key) result(yes)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   logical :: yes
   integer :: number

   number = self%find(key)
   yes = number > 0
   if (yes) yes = self%entry(number)%where /= ''
end function given

!> Number of entries of an array of tables; 1 for any other existing item, 0 for a missing one
pure function count_entries(self, key) result(number)
   class(deck_type), intent(in) :: self
   !> Name of the array of tables
   character(len=*), intent(in) :: key
   integer :: number
   integer :: found

   number = 0
   found = self%find(key)
   if (found == 0) return
   number = 1
   if (self%entry(found)%kind == is_list) number = nint(self%entry(found)%numbers(1))
end function count_entries

!> Number of the entry of a key, or else of its table, if it is given; 0 otherwise
pure recursive function written(self, key) result(number)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   integer :: number
   integer :: dot

   number = self%find(key)
   if (number > 0) then
      if (self%entry(number)%where /= '') return
   end if
   number = 0
   dot = index(key, '.', back=.true.)
   if (dot > 1) number = written(self, key(:dot - 1))
end function written

!> Place where a key was written; for a key that was not, that of its table or the file
subroutine get_place(self, key, place)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   character(len=:), allocatable, intent(out) :: place
   integer :: number

   number = written(self, key)
   place = self%path
   if (number > 0) place = self%entry(number)%where
end subroutine get_place

!> Place where a key was written and its name, as at the start of messages
subroutine cite(self, key, text)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   character(len=:), allocatable, intent(out) :: text
   character(len=:), allocatable :: place
   integer :: number, table

   number = self%find(key)
   text = key
   if (number > 0) then
      text = self%entry(number)%address
   else
      table = self%find(key(:index(key, '.', back=.true.) - 1))
      if (table > 0) text = self%entry(table)%address//key(index(key, '.', back=.true.):)
   end if
   call get_place(self, key, place)
   text = place//': '//text
end subroutine cite

!> Complain about a key. The error grows by a line, so that a user sees all complaints together
subroutine complain(self, key, what, error)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   !> The fault, and how to correct it
   character(len=*), intent(in) :: what
   !> Error so far, if any
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: lines, place

   lines = ''
   if (allocated(error)) lines = error%message//new_line('a')
   call cite(self, key, place)
   call fatal_error(error, err_input, lines//place//': '//what)
end subroutine complain

!> Add the place of the geometry to an error about it, unless it has a place already
subroutine locate(self, error)
   class(deck_type), intent(in) :: self
   !> Error, if any
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: place

   if (.not. allocated(error)) return
   if (index(error%message, self%path//':') == 1 .or. index(error%message, '--set ') == 1) return
   call cite(self, 'geometry', place)
   error%message = place//': '//error%message
end subroutine locate

!> Whether the value of a key is a text
pure function value_is_text(self, key) result(yes)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   logical :: yes
   integer :: number

   number = self%find(key)
   yes = .false.
   if (number > 0) yes = self%entry(number)%kind == is_text
end function value_is_text

subroutine get_integer(self, key, value)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   integer, intent(inout) :: value
   real(wp) :: number

   number = value
   call self%get(key, number)
   value = nint(number)
end subroutine get_integer

subroutine get_real(self, key, value)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   real(wp), intent(inout) :: value
   real(wp), allocatable :: values(:)

   call self%get(key, values)
   if (size(values) == 1) value = values(1)
end subroutine get_real

!> Read a vector
subroutine get_vector(self, key, value)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   !> Its components, as many as given in the deck
   real(wp), intent(inout) :: value(:)
   real(wp), allocatable :: values(:)

   call self%get(key, values)
   value(:size(values)) = values
end subroutine get_vector

subroutine get_expression(self, key, value)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   type(expression_type), intent(inout) :: value

   if (self%is_text(key)) call self%set_expression(key, self%entry(self%find(key))%text, value)
end subroutine get_expression

subroutine get_value(self, key, value)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   type(value_type), intent(inout) :: value

   call self%get(key, value%number)
   call self%get(key, value%expression_type)
end subroutine get_value

!> Read an array of numbers and expressions
subroutine get_values(self, key, value)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   !> Numbers, or expressions for all items if one of them is a text
   type(value_type), intent(inout) :: value(:)
   character(len=:), allocatable :: lines
   integer :: i

   call self%get_vector(key, value%number)
   call self%get(key, lines)
   do i = 1, size(value)
      if (len(line(lines, i)) == 0) return
      call self%set_expression(key, line(lines, i), value(i)%expression_type)
   end do
end subroutine get_values

!> Set an expression
subroutine set_expression(self, key, text, expression)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   character(len=*), intent(in) :: text
   !> Expression with its place in the deck
   class(expression_type), intent(inout) :: expression

   expression%text = text
   call cite(self, key, expression%where)
end subroutine set_expression

subroutine get_text(self, key, value)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   character(len=:), allocatable, intent(out) :: value
   integer :: number

   value = ''
   number = self%find(key)
   if (number > 0) value = self%entry(number)%text
end subroutine get_text

subroutine get_reals(self, key, value)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   !> Its values
   real(wp), allocatable, intent(out) :: value(:)
   integer :: number

   number = self%find(key)
   if (number > 0) then
      value = self%entry(number)%numbers
   else
      allocate (value(0))
   end if
end subroutine get_reals

subroutine get_integers(self, key, value)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   integer, allocatable, intent(out) :: value(:)
   real(wp), allocatable :: values(:)

   call self%get(key, values)
   value = nint(values)
end subroutine get_integers

subroutine get_texts(self, key, value)
   class(deck_type), intent(in) :: self
   character(len=*), intent(in) :: key
   character(len=word_length), allocatable, intent(out) :: value(:)
   character(len=:), allocatable :: lines

   call self%get(key, lines)
   call lines_of(lines, value)
end subroutine get_texts

end module rk_deck
