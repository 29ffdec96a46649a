!> Journal of a run: what it needs to go on, in a file that only grows.
!>
!> A result file that was being written when its process was killed can be torn. The journal cannot:
!> it is written record by record, and a reader stops at the first one that is not whole. A record
!> is a head of three numbers (kind, bytes of the body, columns), their CRC-32, the body and its
!> CRC-32, so that a record that was changed on the disk is not taken for a state. The journal goes
!> when the results have taken their names.
module rk_journal
   use, intrinsic :: iso_c_binding, only : c_associated, c_char, c_int, c_int64_t, c_loc, &
      & c_null_char, c_null_ptr, c_ptr
   use, intrinsic :: iso_fortran_env, only : int64
   use rk_cstring, only : to_fortran
   use rk_error, only : error_type, fatal_error, err_file
   use rk_precision, only : wp
   use rk_restart, only : restart_type
   use rk_text_file, only : rkf_close, rkf_create
   implicit none
   private

   public :: journal_type, read_journal

   !> Kinds of records: deck, overrides, approximation, points, lines of the history, steps
   integer(int64), parameter, public :: is_deck = 1, is_overrides = 2, is_approximation = 3, &
      & is_source = 4, is_points = 5, is_line = 6, is_step = 7

   !> Bytes of a head with its check, and of a check
   integer(int64), parameter :: nhead = 32, ncheck = 8

   !> Journal being written
   type :: journal_type
      private
      !> Open stream of C
      type(c_ptr) :: handle = c_null_ptr
      !> Name
      character(len=:), allocatable :: path
   contains
      procedure :: open => open_journal, add_text, add_numbers, remove => remove_journal
      procedure, private :: check
   end type journal_type

   interface
      type(c_ptr) function rkf_record(handle, head, one, none, two, ntwo) bind(c)
         import :: c_int64_t, c_ptr
         type(c_ptr), value :: handle
         integer(c_int64_t), intent(in) :: head(3)
         type(c_ptr), value :: one, two
         integer(c_int64_t), value :: none, ntwo
      end function rkf_record
      integer(c_int64_t) function rkf_check(before, bytes, length) bind(c)
         import :: c_int64_t, c_ptr
         integer(c_int64_t), value :: before
         type(c_ptr), value :: bytes
         integer(c_int64_t), value :: length
      end function rkf_check
      integer(c_int) function unlink(path) bind(c)
         import :: c_char, c_int
         character(kind=c_char), intent(in) :: path(*)
      end function unlink
   end interface

contains

!> Start a journal, or go on behind its last whole record
subroutine open_journal(self, path, behind, error)
   class(journal_type), intent(inout) :: self
   character(len=*), intent(in) :: path
   !> Bytes that are whole, 0 for a new one
   integer(int64), intent(in) :: behind
   type(error_type), allocatable, intent(out) :: error

   self%path = path
   call self%check(rkf_create(path//c_null_char, merge(behind, -1_int64, behind > 0), &
      & self%handle), error)
end subroutine open_journal

subroutine add_text(self, kind, text, error)
   !> Journal; nothing is added to a closed one
   class(journal_type), intent(inout) :: self
   !> Kind of the record
   integer(int64), intent(in) :: kind
   character(len=*), intent(in), target :: text
   !> Error handling: a full disk
   type(error_type), allocatable, intent(out) :: error

   if (.not. c_associated(self%handle)) return
   call self%check(rkf_record(self%handle, [kind, len(text, int64), 0_int64], c_loc(text), &
      & len(text, int64), c_null_ptr, 0_int64), error)
end subroutine add_text

!> Add a table of numbers, and another one
subroutine add_numbers(self, kind, values, more, error)
   class(journal_type), intent(inout) :: self
   integer(int64), intent(in) :: kind
   !> Numbers, shape (n)
   real(wp), contiguous, intent(in), target :: values(:)
   !> Further ones, shape (m, columns)
   real(wp), contiguous, intent(in), target :: more(:, :)
   type(error_type), allocatable, intent(out) :: error

   if (.not. c_associated(self%handle)) return
   associate (n => 8*size(values, kind=int64), m => 8*size(more, kind=int64))
      call self%check(rkf_record(self%handle, [kind, n + m, size(more, 2, int64)], &
         & c_loc(values), n, c_loc(more), m), error)
   end associate
end subroutine add_numbers

subroutine remove_journal(self)
   !> Journal; nothing happens to a closed one
   class(journal_type), intent(inout) :: self
   type(c_ptr) :: why
   integer(c_int) :: ignored

   if (.not. c_associated(self%handle)) return
   why = rkf_close(self%handle)
   self%handle = c_null_ptr
   ignored = unlink(self%path//c_null_char)
end subroutine remove_journal

!> Turn the answer of C into an error
subroutine check(self, why, error)
   class(journal_type), intent(in) :: self
   !> Reason of a failure, null for success
   type(c_ptr), intent(in) :: why
   type(error_type), allocatable, intent(out) :: error

   if (c_associated(why)) call fatal_error(error, err_file, self%path//': cannot be written: ' &
      & //to_fortran(why))
end subroutine check

!> Read a journal up to its last whole step
subroutine read_journal(path, numbers, found, history, whole, damage)
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
   !> Byte at which the first record begins whose check differs; negative where there is none
   integer(int64), intent(out) :: damage
   integer(int64) :: at, bytes, tail
   integer(int64), target :: head(4)
   integer :: n, stat, unit
   character(len=:), allocatable :: lines
   character(len=:), allocatable, target :: text
   real(wp), allocatable :: values(:)

   allocate (found%load(0), found%step(numbers, 0), found%x(0, 0), found%carried(0, 0), &
      & found%source(3, 0), found%points(3, 0))
   found%deck = ''
   found%overrides = ''
   found%approximation = ''
   history = ''
   lines = ''
   whole = 0
   damage = -1
   inquire (file=path, size=bytes)
   if (bytes < nhead) return
   open (newunit=unit, file=path, access='stream', form='unformatted', status='old', &
      & action='read', iostat=stat)
   if (stat /= 0) return
   at = 0
   do while (at + nhead <= bytes)
      read (unit, iostat=stat) head
      if (stat /= 0) exit
      damage = at
      if (head(4) /= rkf_check(0_int64, c_loc(head), nhead - ncheck)) exit
      damage = -1
      associate (kind => head(1), length => head(2), columns => head(3))
         ! a process that is killed leaves a part of its last record
         if (at + nhead + length + ncheck > bytes) exit
         if (allocated(text)) deallocate (text)
         allocate (character(len=length) :: text)
         read (unit, iostat=stat) text, tail
         if (stat /= 0) exit
         if (tail /= rkf_check(0_int64, c_loc(text), length)) damage = at
         if (damage >= 0) exit
         if (any(kind == [is_source, is_points, is_step])) values = transfer(text, [0.0_wp])
         at = at + nhead + length + ncheck
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

end module rk_journal
