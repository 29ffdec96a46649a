!> Entries of a JSON file that others wrote, word for word: what is not understood is not changed.
!>
!> The whole text is checked, so that nothing of a damaged file is taken for an entry.
!>
!> References: 1. RFC 8259, The JavaScript Object Notation, doi:10.17487/RFC8259
module rk_json_entries
   use rk_text_file, only : load_text
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
   !> Place in the text
   integer :: at

   allocate (entries(0))
   inquire (file=path, exist=damaged)
   if (.not. damaged) return
   call load_text(path, text)
   at = 1
   call skip_blanks()
   if (.not. next_is('{')) return
   damaged = .not. skips_list(1)
   call skip_blanks()
   damaged = damaged .or. at <= len(text)
   if (.not. damaged) return
   deallocate (entries)
   allocate (entries(0))

contains

   !> Whether a character comes next
   logical function next_is(letter)
      character(len=1), intent(in) :: letter

      next_is = .false.
      if (at <= len(text)) next_is = text(at:at) == letter
   end function next_is

   !> Go behind a character, where it comes next
   logical function skips(letter)
      character(len=1), intent(in) :: letter

      skips = next_is(letter)
      if (skips) at = at + 1
   end function skips

   subroutine skip_blanks()
      integer :: length

      if (at > len(text)) return
      length = verify(text(at:), blank)
      at = merge(len(text) + 1, at + length - 1, length == 0)
   end subroutine skip_blanks

   !> Go behind a value of any kind, where there is one
   recursive logical function skips_value(depth) result(valid)
      !> Open objects and arrays
      integer, intent(in) :: depth

      valid = .false.
      if (at > len(text)) return
      select case (text(at:at))
      case ('{', '[')
         valid = skips_list(depth + 1)
      case ('"')
         valid = skips_text()
      case ('t')
         valid = skips_word('true')
      case ('f')
         valid = skips_word('false')
      case ('n')
         valid = skips_word('null')
      case default
         valid = skips_number()
      end select
   end function skips_value

   !> Go behind an object or an array, whose opening bracket comes next, where it is whole; entries
   !> of the first one are kept
   recursive logical function skips_list(depth) result(valid)
      !> Open objects and arrays, this one included
      integer, intent(in) :: depth
      character(len=1) :: closing
      integer :: key(2), first

      key = at
      closing = merge('}', ']', text(at:at) == '{')
      at = at + 1
      valid = depth <= max_depth
      if (.not. valid) return
      call skip_blanks()
      if (skips(closing)) return
      do
         if (closing == '}') then
            key(1) = at
            valid = skips_text()
            if (.not. valid) return
            key(2) = at - 1
            call skip_blanks()
            valid = skips(':')
            if (.not. valid) return
            call skip_blanks()
         end if
         first = at
         valid = skips_value(depth)
         if (.not. valid) return
         if (depth == 1) entries = [entries, &
            & json_entry(text(key(1) + 1:key(2) - 1), text(first:at - 1))]
         call skip_blanks()
         if (.not. skips(',')) exit
         call skip_blanks()
      end do
      valid = skips(closing)
   end function skips_list

   !> Go behind a text in quotation marks, where it ends
   logical function skips_text() result(valid)
      integer :: four

      valid = .false.
      if (.not. skips('"')) return
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
   end function skips_text

   !> Go behind a word that has no quotation marks, where it comes next
   logical function skips_word(word) result(valid)
      character(len=*), intent(in) :: word

      valid = index(text(at:), word) == 1
      at = at + len(word)
   end function skips_word

   !> Go behind a number, where there is one
   logical function skips_number() result(valid)
      integer :: first

      if (next_is('-')) at = at + 1
      first = at
      valid = skips_digits()
      ! a leading zero stands alone
      if (valid .and. text(first:first) == '0') valid = at == first + 1
      if (valid .and. next_is('.')) then
         at = at + 1
         valid = skips_digits()
      end if
      if (.not. valid) return
      if (.not. (next_is('e') .or. next_is('E'))) return
      at = at + 1
      if (next_is('+') .or. next_is('-')) at = at + 1
      valid = skips_digits()
   end function skips_number

   !> Go behind digits, where there is one
   logical function skips_digits() result(valid)
      integer :: length

      valid = .false.
      if (at > len(text)) return
      length = verify(text(at:), digits) - 1
      if (length < 0) length = len(text) - at + 1
      valid = length > 0
      at = at + length
   end function skips_digits

end subroutine read_entries

end module rk_json_entries
