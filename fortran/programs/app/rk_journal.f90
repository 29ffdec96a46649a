!> Journal of a run: what it needs to go on, in a file that only grows.
!>
!> A result file that was being written when its process was killed can be torn. The journal is
!> written record by record, each with a checksum, and a reader stops at the first one that is not
!> whole: a disk that lost power may have kept the length of a file and not what it contains.
module rk_journal
   use, intrinsic :: iso_c_binding, only : c_int64_t, c_size_t
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_error, only : error_type, fatal_error, err_file
   use rk_precision, only : i8, wp
   use rk_recorder, only : carried_type, step_type
   use rk_results, only : restart_type, to_space
   use rk_text_file, only : make_file
   implicit none
   private

   public :: journal_type, run_type, read_journal

   !> Journal of a run, in its folder
   character(len=*), parameter :: journal_name = '/results.journal'
   !> Mark of the files this module reads
   character(len=*), parameter :: mark = 'myork-journal 3 '
   !> Numbers of a step beside its arrays
   integer, parameter :: numbers_of_step = 13

   !> Journal being written
   type :: journal_type
      private
      !> Unit of its file; 0 where there is none
      integer :: unit = 0
      !> Lines of the history since the last step, each with its line feed
      character(len=:), allocatable :: lines
      !> Load steps that it has, that at load 0 included
      integer :: steps = 0
   contains
      procedure :: open => open_journal, add_line, add_step
   end type journal_type

   !> Run as its journal has it, without load steps where nothing was solved
   type, extends(restart_type) :: run_type
      !> Deck, and its overrides as lines
      character(len=:), allocatable :: deck, overrides
      !> Load steps, that at load 0 first
      type(step_type), allocatable :: step(:)
      !> Worst backward error, misfit and condition of the run up to each, shape (3, steps) [-]
      real(wp), allocatable :: worst(:, :)
      !> Lines of history.csv behind the first, each with its line feed
      character(len=:), allocatable :: history
      !> Where its journal goes on, counted in bytes from 1
      integer(i8) :: behind = 0
   end type run_type

   interface
      !> Checksum of some bytes and of those before them
      integer(c_int64_t) function rkf_checksum(data, bytes, before) bind(c)
         import :: c_int64_t, c_size_t
         type(*), intent(in) :: data(*)
         integer(c_size_t), value :: bytes
         integer(c_int64_t), value :: before
      end function rkf_checksum
   end interface

contains

!> Begin a journal, or go on behind the last step of one
subroutine open_journal(self, folder, run, deck, approximation, cloud, error)
   class(journal_type), intent(inout) :: self
   character(len=*), intent(in) :: folder
   !> Run that goes on, not allocated where one begins
   type(run_type), allocatable, intent(in) :: run
   type(deck_type), intent(in) :: deck
   !> Shape functions in words
   character(len=*), intent(in) :: approximation
   type(cloud_type), intent(in) :: cloud
   !> Error handling: a name that cannot be written to
   type(error_type), allocatable, intent(out) :: error
   integer :: stat

   call make_file(folder//journal_name, allocated(run), error)
   if (allocated(error)) return
   open (newunit=self%unit, file=folder//journal_name, form='unformatted', access='stream', &
      & status='old', action='readwrite', iostat=stat)
   self%lines = ''
   if (allocated(run)) then
      self%steps = size(run%step)
      read (self%unit, pos=run%behind, iostat=stat)
      endfile (self%unit, iostat=stat)
      return
   end if
   associate (source => to_space(cloud%source), points => to_space(cloud%points))
      write (self%unit, iostat=stat) mark
      call write_record(self%unit, [len(deck%text), len(deck%overrides), size(source, 2)], &
         & [source, points], deck%text//deck%overrides//approximation)
   end associate
end subroutine open_journal

!> Add a line to the history
subroutine add_line(self, line)
   class(journal_type), intent(inout) :: self
   character(len=*), intent(in) :: line

   if (self%unit /= 0) self%lines = self%lines//line//new_line('a')
end subroutine add_line

!> Add a load step, unless the journal has it. A state between two planned ones is found again. A
!> full disk is an error of the results, which are in the same folder
subroutine add_step(self, step, worst, x)
   class(journal_type), intent(inout) :: self
   type(step_type), intent(in) :: step
   !> Worst backward error, misfit and condition of the run so far [-]
   real(wp), intent(in) :: worst(3)
   !> Unknowns, shape (n)
   real(wp), intent(in) :: x(:)
   type(carried_type) :: own

   if (self%unit == 0 .or. step%step < self%steps .or. .not. step%planned) return
   if (allocated(step%carried)) own = step%carried
   associate (path => own%path)
      if (.not. allocated(path%slope)) allocate (path%slope(0))
      if (.not. allocated(path%bend)) allocate (path%bend(size(x), 0))
      call write_record(self%unit, [size(x), size(path%slope), size(path%bend, 2), &
         & merge(1, 0, allocated(step%carried))], [step%load, real(step%step, wp), &
         & real(step%steps, wp), real(step%iterations, wp), step%gradient, step%step_norm, &
         & step%min_j, step%max_j, worst, path%earlier, real(own%halvings, wp), x, path%slope, &
         & path%bend], self%lines)
   end associate
   self%steps = self%steps + 1
   self%lines = ''
end subroutine add_step

!> Read the journal in a folder up to its last whole step
subroutine read_journal(self, path, folder, error)
   type(run_type), intent(out) :: self
   !> Its file, for messages
   character(len=:), allocatable, intent(out) :: path
   character(len=*), intent(in) :: folder
   !> Error handling: what no journal of this version holds
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: lines, text
   character(len=len(mark)) :: first
   real(wp), allocatable :: numbers(:)
   integer, allocatable :: n(:)
   integer(i8) :: bytes
   integer :: length, stat, step, unit
   logical :: whole

   allocate (self%load(0), self%step(0), self%worst(3, 0))
   self%history = ''
   path = folder//journal_name
   ! opening a pipe, which has no length, would wait for its other end
   inquire (file=path, size=bytes)
   if (bytes < len(mark)) return
   open (newunit=unit, file=path, form='unformatted', access='stream', status='old', &
      & action='read', iostat=stat)
   if (stat /= 0) return
   read (unit, iostat=stat) first
   call read_record(unit, n, numbers, text, whole)
   if (stat /= 0 .or. first /= mark .or. (.not. whole .and. bytes > len(mark))) then
      call fatal_error(error, err_file, path//': is damaged, or another version ' &
         & //'wrote it; run again without --resume')
   else if (whole) then
      self%deck = text(:n(1))
      self%overrides = text(n(1) + 1:n(1) + n(2))
      self%approximation = text(n(1) + n(2) + 1:)
      self%source = reshape(numbers(:3*n(3)), [3, n(3)])
      self%points = reshape(numbers(3*n(3) + 1:), [3, size(numbers)/3 - n(3)])
      do while (whole)
         inquire (unit=unit, pos=self%behind)
         call read_record(unit, n, numbers, text, whole)
         if (whole) call add_read_step(self, n, numbers, text)
      end do
   end if
   close (unit)
   ! of a search for points the iterations of all load steps come first
   lines = self%history
   self%history = ''
   do while (len(lines) > 0)
      length = index(lines, new_line('a'))
      read (lines(:index(lines, ',') - 1), *) step
      if (step < size(self%step)) self%history = self%history//lines(:length)
      lines = lines(length + 1:)
   end do
end subroutine read_journal

!> Write a record: sizes and checksum, numbers and a text. A full disk is an error of the results,
!> which are in the same folder
subroutine write_record(unit, n, numbers, text)
   integer, intent(in) :: unit
   !> Whole numbers
   integer, intent(in) :: n(:)
   !> Numbers
   real(wp), intent(in) :: numbers(:)
   character(len=*), intent(in) :: text
   integer :: stat

   write (unit, iostat=stat) size(n), size(numbers), len(text), checksum(n, numbers, text), n, &
      & numbers, text
   flush (unit, iostat=stat)
end subroutine write_record

!> Read a record
subroutine read_record(unit, n, numbers, text, whole)
   integer, intent(in) :: unit
   !> Whole numbers
   integer, allocatable, intent(out) :: n(:)
   !> Numbers
   real(wp), allocatable, intent(out) :: numbers(:)
   character(len=:), allocatable, intent(out) :: text
   !> Whether there is one, and its checksum is right
   logical, intent(out) :: whole
   integer(i8) :: bytes, expected, position
   integer :: sizes(3), stat

   read (unit, iostat=stat) sizes, expected
   inquire (unit=unit, size=bytes, pos=position)
   whole = stat == 0 .and. all(sizes >= 0)
   ! sizes that were damaged would hardly fit into memory
   if (whole) whole = sum(int(sizes, i8)*[4_i8, 8_i8, 1_i8]) <= bytes - position + 1
   if (.not. whole) return
   allocate (n(sizes(1)), numbers(sizes(2)))
   allocate (character(len=sizes(3)) :: text)
   read (unit, iostat=stat) n, numbers, text
   whole = stat == 0 .and. checksum(n, numbers, text) == expected
end subroutine read_record

!> Checksum of a record
integer(i8) function checksum(n, numbers, text)
   integer, intent(in) :: n(:)
   real(wp), intent(in) :: numbers(:)
   character(len=*), intent(in) :: text

   checksum = rkf_checksum([size(n), size(numbers), len(text), n], (size(n) + 3)*4_c_size_t, &
      & 0_i8)
   checksum = rkf_checksum(numbers, size(numbers)*8_c_size_t, checksum)
   checksum = rkf_checksum(transfer(text, 'a', len(text)), len(text, c_size_t), checksum)
end function checksum

!> Add a load step that was read
subroutine add_read_step(self, n, numbers, lines)
   class(run_type), intent(inout) :: self
   !> Unknowns, slopes, changes of these, and 1 where the iteration carries something
   integer, intent(in) :: n(4)
   !> Numbers as they were written
   real(wp), intent(in) :: numbers(:)
   !> Lines of its history
   character(len=*), intent(in) :: lines
   type(step_type) :: step
   type(carried_type) :: own
   integer :: o

   step%load = numbers(1)
   step%step = nint(numbers(2))
   step%steps = nint(numbers(3))
   step%iterations = nint(numbers(4))
   step%gradient = numbers(5)
   step%step_norm = numbers(6)
   step%min_j = numbers(7)
   step%max_j = numbers(8)
   own%path%earlier = numbers(12)
   own%halvings = nint(numbers(13))
   associate (x => n(1), slopes => n(2), changes => n(3))
      o = numbers_of_step + x
      if (slopes > 0) own%path%slope = numbers(o + 1:o + slopes)
      o = o + slopes
      if (changes > 0) own%path%bend = reshape(numbers(o + 1:o + x*changes), [x, changes])
      if (n(4) == 1) step%carried = own
      self%step = [self%step, step]
      self%load = [self%load, step%load]
      if (.not. allocated(self%x)) allocate (self%x(x, 0))
      self%x = reshape([self%x, numbers(numbers_of_step + 1:numbers_of_step + x)], &
         & [x, size(self%load)])
   end associate
   self%worst = reshape([self%worst, numbers(9:11)], [3, size(self%load)])
   self%history = self%history//lines
end subroutine add_read_step

end module rk_journal
