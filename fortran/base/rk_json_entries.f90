!> Entries of a JSON file that others wrote, word for word: what is not understood is not changed.
!>
!> The whole text is checked, so that nothing of a damaged file is taken for an entry.
!>
!> References: 1. RFC 8259, The JavaScript Object Notation, doi:10.17487/RFC8259
module rk_json_entries
   use rk_precision, only : i8
   implicit none
   private

   public :: json_entry, read_entries

   !> An entry of an object
   type :: json_entry
      !> Name, escapes as they stand in the text
      character(len=:), allocatable :: key
      !> Value as it stands in the text
      character(len=:), allocatable :: value
   end type json_entry

   !> Objects and arrays inside each other at most; a summary has five
   integer, parameter :: max_depth = 100
   !> Between words
   character(len=*), parameter :: blank = ' '//achar(9)//achar(10)//achar(13)
   character(len=*), parameter :: digits = '0123456789'

contains

!> Read the entries of a file that holds one object
subroutine read_entries(path, entries, damaged)
   !> File; one that is not there has no entries
   character(len=*), intent(in) :: path
   !> Entries in their order, none of a damaged file
   type(json_entry), allocatable, intent(out) :: entries(:)
   !> The file is there and is not a JSON object
   logical, intent(out) :: damaged
   character(len=:), allocatable :: text
   integer(i8) :: bytes
   integer :: at, stat, unit
   logical :: found, valid

   allocate (entries(0))
   damaged = .false.
   inquire (file=path, exist=found, size=bytes)
   if (.not. found) return
   damaged = .true.
   if (bytes < 2 .or. bytes > huge(at)) return
   allocate (character(len=bytes) :: text)
   open (newunit=unit, file=path, access='stream', form='unformatted', status='old', &
      & action='read', iostat=stat)
   if (stat /= 0) return
   read (unit, iostat=stat) text
   close (unit)
   if (stat /= 0) return
   at = 1
   call skip_blanks(text, at)
   if (.not. follows(text, at, '{')) return
   call skip_list(text, at, 1, valid, entries)
   call skip_blanks(text, at)
   damaged = .not. valid .or. at <= len(text)
   if (.not. damaged) return
   deallocate (entries)
   allocate (entries(0))
end subroutine read_entries

!> Whether a character comes next
pure logical function follows(text, at, character)
   !> JSON text
   character(len=*), intent(in) :: text
   !> Place
   integer, intent(in) :: at
   character(len=1), intent(in) :: character

   follows = .false.
   if (at <= len(text)) follows = text(at:at) == character
end function follows

!> Go behind blanks
pure subroutine skip_blanks(text, at)
   !> JSON text
   character(len=*), intent(in) :: text
   !> Place
   integer, intent(inout) :: at
   integer :: length

   if (at > len(text)) return
   length = verify(text(at:), blank)
   at = merge(len(text) + 1, at + length - 1, length == 0)
end subroutine skip_blanks

!> Go behind a value of any kind
recursive subroutine skip_value(text, at, depth, valid)
   !> JSON text
   character(len=*), intent(in) :: text
   !> Place, of the value's first character
   integer, intent(inout) :: at
   !> Open objects and arrays
   integer, intent(in) :: depth
   !> Whether there was a value
   logical, intent(out) :: valid

   valid = .false.
   if (at > len(text)) return
   select case (text(at:at))
   case ('{', '[')
      call skip_list(text, at, depth + 1, valid)
   case ('"')
      call skip_text(text, at, valid)
   case ('t')
      call skip_word(text, at, 'true', valid)
   case ('f')
      call skip_word(text, at, 'false', valid)
   case ('n')
      call skip_word(text, at, 'null', valid)
   case default
      call skip_number(text, at, valid)
   end select
end subroutine skip_value

!> Go behind an object or an array
recursive subroutine skip_list(text, at, depth, valid, entries)
   !> JSON text
   character(len=*), intent(in) :: text
   !> Place, of the opening bracket
   integer, intent(inout) :: at
   !> Open objects and arrays, this one included
   integer, intent(in) :: depth
   !> Whether it is whole
   logical, intent(out) :: valid
   !> Entries of an object are added here, where wanted
   type(json_entry), allocatable, intent(inout), optional :: entries(:)
   character(len=1) :: closing
   integer :: key(2), first

   key = at
   closing = merge('}', ']', text(at:at) == '{')
   at = at + 1
   valid = depth <= max_depth
   if (.not. valid) return
   call skip_blanks(text, at)
   if (follows(text, at, closing)) then
      at = at + 1
      return
   end if
   do
      if (closing == '}') then
         key(1) = at
         call skip_text(text, at, valid)
         if (.not. valid) return
         key(2) = at - 1
         call skip_blanks(text, at)
         valid = follows(text, at, ':')
         if (.not. valid) return
         at = at + 1
         call skip_blanks(text, at)
      end if
      first = at
      call skip_value(text, at, depth, valid)
      if (.not. valid) return
      if (present(entries)) entries = [entries, &
         & json_entry(text(key(1) + 1:key(2) - 1), text(first:at - 1))]
      call skip_blanks(text, at)
      if (.not. follows(text, at, ',')) exit
      at = at + 1
      call skip_blanks(text, at)
   end do
   valid = follows(text, at, closing)
   at = at + 1
end subroutine skip_list

!> Go behind a text in quotation marks
pure subroutine skip_text(text, at, valid)
   !> JSON text
   character(len=*), intent(in) :: text
   !> Place, of the first mark
   integer, intent(inout) :: at
   !> Whether it ends
   logical, intent(out) :: valid
   integer :: four

   valid = .false.
   if (.not. follows(text, at, '"')) return
   at = at + 1
   do while (at <= len(text))
      select case (text(at:at))
      case ('"')
         at = at + 1
         valid = .true.
         return
      case ('\')
         at = at + 1
         if (at > len(text)) return
         if (index('"\/bfnrtu', text(at:at)) == 0) return
         if (text(at:at) == 'u') then
            four = min(at + 4, len(text))
            if (four < at + 4) return
            if (verify(text(at + 1:four), digits//'abcdefABCDEF') > 0) return
            at = four
         end if
      case (achar(0):achar(31))
         return
      end select
      at = at + 1
   end do
end subroutine skip_text

!> Go behind a word that has no quotation marks
pure subroutine skip_word(text, at, word, valid)
   !> JSON text
   character(len=*), intent(in) :: text
   !> Place
   integer, intent(inout) :: at
   character(len=*), intent(in) :: word
   !> Whether it is this word
   logical, intent(out) :: valid

   valid = index(text(at:), word) == 1
   at = at + len(word)
end subroutine skip_word

!> Go behind a number
pure subroutine skip_number(text, at, valid)
   !> JSON text
   character(len=*), intent(in) :: text
   !> Place
   integer, intent(inout) :: at
   !> Whether it is a number
   logical, intent(out) :: valid
   integer :: first

   if (follows(text, at, '-')) at = at + 1
   first = at
   call skip_digits(text, at, valid)
   ! a leading zero stands alone
   if (valid .and. text(first:first) == '0') valid = at == first + 1
   if (valid .and. follows(text, at, '.')) then
      at = at + 1
      call skip_digits(text, at, valid)
   end if
   if (.not. valid) return
   if (.not. (follows(text, at, 'e') .or. follows(text, at, 'E'))) return
   at = at + 1
   if (follows(text, at, '+') .or. follows(text, at, '-')) at = at + 1
   call skip_digits(text, at, valid)
end subroutine skip_number

!> Go behind digits
pure subroutine skip_digits(text, at, valid)
   !> JSON text
   character(len=*), intent(in) :: text
   !> Place
   integer, intent(inout) :: at
   !> Whether there is one
   logical, intent(out) :: valid
   integer :: length

   valid = .false.
   if (at > len(text)) return
   length = verify(text(at:), digits) - 1
   if (length < 0) length = len(text) - at + 1
   valid = length > 0
   at = at + length
end subroutine skip_digits

end module rk_json_entries
