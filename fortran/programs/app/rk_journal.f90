!> Journal of a run: what it needs to go on, in a file that only grows.
!>
!> A result file that was being written when its process was killed can be torn. The journal cannot:
!> it is written record by record, and a reader stops at the first one that is not whole. A record
!> is a head of four numbers (kind, bytes of the body, columns, Adler-32 of all of it) and the body:
!> a disk that lost power may have kept the length of a record and not what it held. The journal
!> goes when the results have taken their names.
module rk_journal
   use rk_error, only : error_type, fatal_error, err_file
   use rk_precision, only : i8, wp
   use rk_results, only : restart_type
   use rk_text, only : to_text
   use rk_text_file, only : text_file
   implicit none
   private

   public :: journal_type, read_journal

   !> Kinds of records: deck, overrides, approximation, points, lines of the history, steps
   integer(i8), parameter, public :: is_deck = 1, is_overrides = 2, is_approximation = 3, &
      & is_source = 4, is_points = 5, is_line = 6, is_step = 7

   !> Bytes of a head
   integer(i8), parameter :: nhead = 32

   !> Journal being written
   type, extends(text_file) :: journal_type
   contains
      procedure :: add_text, add_numbers
      procedure, private :: add
   end type journal_type

contains

subroutine add_text(self, kind, text, error)
   class(journal_type), intent(inout) :: self
   !> Kind of the record
   integer(i8), intent(in) :: kind
   character(len=*), intent(in) :: text
   type(error_type), allocatable, intent(inout) :: error

   call self%add(kind, text, 0_i8, error)
end subroutine add_text

!> Add a table of numbers, and another one
subroutine add_numbers(self, kind, values, more, error)
   class(journal_type), intent(inout) :: self
   integer(i8), intent(in) :: kind
   !> Numbers, shape (n)
   real(wp), intent(in) :: values(:)
   !> Further ones, shape (m, columns)
   real(wp), intent(in) :: more(:, :)
   type(error_type), allocatable, intent(inout) :: error

   associate (all_numbers => [values, more])
      call self%add(kind, transfer(all_numbers, repeat(' ', 8*size(all_numbers))), &
         & size(more, 2, i8), error)
   end associate
end subroutine add_numbers

!> Add a record
subroutine add(self, kind, body, columns, error)
   !> Journal; nothing is added to a closed one
   class(journal_type), intent(inout) :: self
   integer(i8), intent(in) :: kind
   character(len=*), intent(in) :: body
   integer(i8), intent(in) :: columns
   !> Error handling: a full disk; after an error nothing is added
   type(error_type), allocatable, intent(inout) :: error

   if (allocated(error)) return
   associate (head => [kind, len(body, i8), columns])
      call self%write(transfer([head, sum_of(head, body)], repeat(' ', nhead))//body, error)
   end associate
end subroutine add

!> Read a journal up to its last whole step
subroutine read_journal(path, numbers, found, history, whole, error)
   !> File, which exists
   character(len=*), intent(in) :: path
   !> Numbers of a step, beside its load
   integer, intent(in) :: numbers
   !> Content, as a result file would have it; no states where there is none
   type(restart_type), intent(out) :: found
   !> Lines of the history up to this step, each with its line feed
   character(len=:), allocatable, intent(out) :: history
   !> Bytes up to there
   integer(i8), intent(out) :: whole
   !> Error handling: what no journal of this version holds
   type(error_type), allocatable, intent(out) :: error
   integer(i8) :: at, bytes, head(4)
   integer :: n, stat, unit
   character(len=:), allocatable :: lines, text
   real(wp), allocatable :: values(:)

   allocate (found%load(0), found%step(numbers, 0), found%x(0, 0), found%carried(0, 0), &
      & found%source(3, 0), found%points(3, 0))
   found%deck = ''
   found%overrides = ''
   found%approximation = ''
   history = ''
   lines = ''
   whole = 0
   at = 0
   inquire (file=path, size=bytes)
   open (newunit=unit, file=path, access='stream', form='unformatted', status='old', &
      & action='read', iostat=stat)
   if (stat /= 0) return
   do while (at + nhead <= bytes)
      read (unit, iostat=stat) head
      if (stat /= 0) exit
      associate (kind => head(1), length => head(2), columns => head(3))
         if (kind < is_deck .or. kind > is_step .or. min(length, columns) < 0) then
            call fatal_error(error, err_file, path//': its record at byte '//to_text(at) &
               & //' is damaged, or another version wrote it; run again without --resume')
            exit
         end if
         ! a process that is killed leaves a part of its last record
         if (length > bytes - at - nhead) exit
         if (allocated(text)) deallocate (text)
         allocate (character(len=length) :: text)
         read (unit, iostat=stat) text
         if (stat /= 0 .or. head(4) /= sum_of(head(:3), text)) exit
         if (any(kind == [is_source, is_points, is_step])) values = transfer(text, [0.0_wp])
         at = at + nhead + length
         select case (kind)
         case (is_deck)
            found%deck = text
         case (is_overrides)
            found%overrides = text
         case (is_approximation)
            found%approximation = text
         case (is_source)
            found%source = reshape(values, [3, size(values)/3])
         case (is_points)
            found%points = reshape(values, [3, size(values)/3])
         case (is_line)
            lines = lines//text//new_line('a')
         case (is_step)
            n = int((size(values) - numbers - 1)/(1 + columns))
            if (size(found%load) == 0) then
               deallocate (found%x)
               allocate (found%x(n, 0))
            end if
            found%load = [found%load, values(1)]
            found%step = reshape([found%step, values(2:numbers + 1)], [numbers, size(found%load)])
            found%x = reshape([found%x, values(numbers + 2:numbers + 1 + n)], [n, size(found%load)])
            found%carried = reshape([found%carried, values(numbers + 2 + n:)], &
               & [n, size(found%carried, 2) + int(columns)])
            history = lines
            whole = at
         end select
      end associate
   end do
   close (unit)
end subroutine read_journal

!> Adler-32 of a record (RFC 1950)
pure integer(i8) function sum_of(head, body) result(check)
   !> Kind, bytes of the body, columns
   integer(i8), intent(in) :: head(3)
   character(len=*), intent(in) :: body
   integer(i8), parameter :: prime = 65521
   character(len=24) :: first
   integer(i8) :: a, b, i

   first = transfer(head, first)
   a = 1
   b = 0
   do i = 1, len(first, i8) + len(body, i8)
      if (i <= len(first)) then
         a = mod(a + ichar(first(i:i)), prime)
      else
         a = mod(a + ichar(body(i - len(first):i - len(first))), prime)
      end if
      b = mod(b + a, prime)
   end do
   check = 65536*b + a
end function sum_of

end module rk_journal
