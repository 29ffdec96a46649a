!> Entries of a JSON file written by a station, kept verbatim: entries that are not understood are
!> not changed.
!>
!> All stations write an object over several lines with one blank per level (rk_json, write_json of
!> files.py), so that each entry of the outermost object begins a line with the indentation of the
!> first one, even after entries copied from another file. Files are complete or absent
!> (rk_text_file), so that no other JSON syntax is checked.
module rk_json_entries
   use rk_text_file, only : load_text
   implicit none
   private

   public :: json_entry, read_entries

   !> An entry of an object
   type :: json_entry
      !> Name, with its escapes kept
      character(len=:), allocatable :: key
      !> Value, verbatim
      character(len=:), allocatable :: value
   end type json_entry

contains

!> Read the entries of a file that holds one object
subroutine read_entries(path, entries, damaged)
   !> File; a missing one has no entries
   character(len=*), intent(in) :: path
   !> Entries in their order; none if the file is damaged
   type(json_entry), allocatable, intent(out) :: entries(:)
   !> The file exists but is not an object as stations write it
   logical, intent(out) :: damaged
   character(len=*), parameter :: feed = new_line('a')
   character(len=:), allocatable :: text, begin
   integer :: at, colon, last, next

   allocate (entries(0))
   inquire (file=path, exist=damaged)
   if (.not. damaged) return
   call load_text(path, text)
   text = text(:len(text) - merge(1, 0, index(text, feed, back=.true.) == len(text)))
   damaged = text /= '{}'
   if (.not. damaged) return
   ! entries lie between the line feed after the first bracket and the one before the last
   at = 2
   last = len(text) - 1
   if (index(text, '{'//feed) /= 1 .or. index(text, feed//'}', back=.true.) /= last) return
   begin = feed//repeat(' ', verify(text(3:), ' ') - 1)//'"'
   do while (at < last)
      next = at + index(text(at + 1:last), begin)
      if (next == at) next = last
      colon = index(text(at:next - 1), '": ')
      if (index(text(at:next - 1), begin) /= 1 .or. colon == 0) exit
      colon = at + colon - 1
      entries = [entries, json_entry(text(at + len(begin):colon - 1), &
         & text(colon + 3:next - merge(2, 1, next < last)))]
      ! the first entry of a nested object that has the same indentation
      if (len(entries(size(entries))%value) == 0) exit
      at = next
   end do
   damaged = at < last
   if (damaged) entries = entries(:0)
end subroutine read_entries

end module rk_json_entries
