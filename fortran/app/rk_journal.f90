!> Journal of a run: what it needs to go on, in a file that only grows.
!>
!> A result file that was being written when its process was killed can be torn. The journal cannot:
!> it is written record by record, each with its length before and behind it, and a reader stops at
!> the first one that is not whole. It goes when the results have taken their names.
module rk_journal
   use, intrinsic :: iso_fortran_env, only : int64
   use rk_error, only : error_type, fatal_error, err_file
   use rk_precision, only : wp
   use rk_restart, only : restart_type
   implicit none
   private

   public :: journal_type, read_journal

   !> Kinds of records: deck, overrides, approximation, points, lines of the history, steps
   integer(int64), parameter, public :: is_deck = 1, is_overrides = 2, is_approximation = 3, &
      & is_source = 4, is_points = 5, is_line = 6, is_step = 7

   !> Journal being written
   type :: journal_type
      private
      !> Unit, 0 where it is closed
      integer :: unit = 0
      !> Name
      character(len=:), allocatable :: path
   contains
      !> Start it, or go on behind its last whole record
      procedure :: open => open_journal
      !> Add a text
      procedure :: add_text
      !> Add numbers
      procedure :: add_numbers
      !> Close it; it stays or goes
      procedure :: close => close_journal
   end type journal_type

contains

!> Start a journal, or go on behind its last whole record
subroutine open_journal(self, path, behind, error)
   !> Journal
   class(journal_type), intent(inout) :: self
   !> File
   character(len=*), intent(in) :: path
   !> Bytes that are whole, 0 for a new one
   integer(int64), intent(in) :: behind
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   character(len=10) :: mode
   integer :: stat
   character(len=200) :: why

   self%path = path
   mode = merge('old       ', 'replace   ', behind > 0)
   open (newunit=self%unit, file=path, access='stream', form='unformatted', status=trim(mode), &
      & action='readwrite', iostat=stat, iomsg=why)
   if (stat == 0 .and. behind > 0) then
      ! what stands behind is torn
      read (self%unit, pos=behind + 1, iostat=stat)
      if (stat == 0) endfile (self%unit, iostat=stat, iomsg=why)
   end if
   if (stat == 0) return
   self%unit = 0
   call fatal_error(error, err_file, path//': cannot be written: '//trim(why))
end subroutine open_journal

!> Add a text
subroutine add_text(self, kind, text, error)
   !> Journal
   class(journal_type), intent(inout) :: self
   !> Kind of the record
   integer(int64), intent(in) :: kind
   !> Text
   character(len=*), intent(in) :: text
   !> Error handling: a full disk
   type(error_type), allocatable, intent(out) :: error
   integer :: stat

   if (self%unit == 0) return
   write (self%unit, iostat=stat) kind, len(text, int64), 0_int64, text, len(text, int64)
   if (stat == 0) flush (self%unit, iostat=stat)
   if (stat /= 0) call fatal_error(error, err_file, self%path//': cannot be written; is the disk ' &
      & //'full?')
end subroutine add_text

!> Add a table of numbers, and another one
subroutine add_numbers(self, kind, values, more, error)
   !> Journal
   class(journal_type), intent(inout) :: self
   !> Kind of the record
   integer(int64), intent(in) :: kind
   !> Numbers, shape (n)
   real(wp), contiguous, intent(in) :: values(:)
   !> Further ones, shape (m, columns)
   real(wp), contiguous, intent(in) :: more(:, :)
   !> Error handling: a full disk
   type(error_type), allocatable, intent(out) :: error
   integer(int64) :: total
   integer :: stat

   if (self%unit == 0) return
   total = 8*(size(values, kind=int64) + size(more, kind=int64))
   write (self%unit, iostat=stat) kind, total, size(more, 2, int64), values, more, total
   if (stat == 0) flush (self%unit, iostat=stat)
   if (stat /= 0) call fatal_error(error, err_file, self%path//': cannot be written; is the disk ' &
      & //'full?')
end subroutine add_numbers

!> Close a journal
subroutine close_journal(self, remove)
   !> Journal; nothing happens to a closed one
   class(journal_type), intent(inout) :: self
   !> It is needed no more
   logical, intent(in) :: remove
   integer :: ignored

   if (self%unit == 0) return
   if (remove) then
      close (self%unit, status='delete', iostat=ignored)
   else
      close (self%unit, iostat=ignored)
   end if
   self%unit = 0
end subroutine close_journal

!> Read a journal up to its last whole step
subroutine read_journal(path, numbers, found, history, whole)
   !> File, which exists
   character(len=*), intent(in) :: path
   !> Numbers of a step, beside its load
   integer, intent(in) :: numbers
   !> Content, as a result file would have it; no states where there is none
   type(restart_type), intent(out) :: found
   !> Lines of the history up to this step, each with its line feed
   character(len=:), allocatable, intent(out) :: history
   !> Bytes up to there
   integer(int64), intent(out) :: whole
   integer(int64) :: kind, length, columns, behind, at
   integer :: n, stat, unit
   character(len=:), allocatable :: text, lines
   real(wp), allocatable :: values(:)

   allocate (found%load(0), found%step(numbers, 0), found%x(0, 0), found%carried(0, 0), &
      & found%source(3, 0), found%points(3, 0))
   found%deck = ''
   found%overrides = ''
   found%approximation = ''
   history = ''
   lines = ''
   whole = 0
   open (newunit=unit, file=path, access='stream', form='unformatted', status='old', &
      & action='read', iostat=stat)
   if (stat /= 0) return
   do
      read (unit, iostat=stat) kind, length, columns
      if (stat /= 0 .or. length < 0 .or. columns < 0) exit
      if (kind <= is_approximation .or. kind == is_line) then
         if (allocated(text)) deallocate (text)
         allocate (character(len=length) :: text, stat=stat)
         if (stat == 0) read (unit, iostat=stat) text, behind
      else
         if (allocated(values)) deallocate (values)
         allocate (values(length/8), stat=stat)
         if (stat == 0) read (unit, iostat=stat) values, behind
      end if
      if (stat /= 0) exit
      if (behind /= length) exit
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
         inquire (unit, pos=at)
         whole = at - 1
      end select
   end do
   close (unit)
end subroutine read_journal

end module rk_journal
