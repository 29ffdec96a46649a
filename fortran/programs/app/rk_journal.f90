!> Journal of a run: what it needs to go on, in a file that only grows.
!>
!> A result file that was being written when its process was killed can be torn. The journal cannot:
!> it is written step by step, and a reader stops at the first record that is not whole. Fortran
!> puts its length before a record; a disk that lost power may have kept this and not what is behind
!> it, so that a step has the sums of its numbers and letters there as well.
module rk_journal
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
   character(len=*), parameter :: mark = 'myork-journal 1 '
   !> Records before those of the first step, and records of a step
   integer, parameter :: before_steps = 3, of_step = 2
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
   end type run_type

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
   integer :: k, stat

   call make_file(folder//journal_name, allocated(run), error)
   if (allocated(error)) return
   open (newunit=self%unit, file=folder//journal_name, form='unformatted', status='old', &
      & action='readwrite', iostat=stat)
   self%lines = ''
   if (allocated(run)) then
      self%steps = size(run%step)
      do k = 1, before_steps + of_step*self%steps
         read (self%unit, iostat=stat)
      end do
      return
   end if
   associate (source => to_space(cloud%source), points => to_space(cloud%points))
      write (self%unit, iostat=stat) mark
      write (self%unit, iostat=stat) len(deck%text), len(deck%overrides), len(approximation), &
         & size(source, 2), size(points, 2)
      write (self%unit, iostat=stat) deck%text, deck%overrides, approximation, source, points
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
   integer :: stat

   if (self%unit == 0 .or. step%step < self%steps .or. .not. step%planned) return
   if (allocated(step%carried)) own = step%carried
   if (.not. allocated(own%slope)) allocate (own%slope(0))
   if (.not. allocated(own%bend)) allocate (own%bend(size(x), 0))
   if (.not. allocated(own%place)) allocate (own%place(0), own%origin(0))
   associate (numbers => [step%load, real(step%step, wp), real(step%steps, wp), &
      & real(step%iterations, wp), step%gradient, step%step_norm, step%min_j, step%max_j, worst, &
      & own%held, real(own%halvings, wp), x, own%slope, own%bend, own%place, own%origin])
      write (self%unit, iostat=stat) size(x), size(own%slope), size(own%bend, 2), &
         & size(own%place), len(self%lines), allocated(step%carried), sum(numbers), &
         & sum_of(self%lines)
      write (self%unit, iostat=stat) numbers, self%lines
   end associate
   flush (self%unit, iostat=stat)
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
   character(len=:), allocatable :: lines
   character(len=len(mark)) :: first
   integer(i8) :: bytes
   integer :: length, n(5), stat, step, unit
   logical :: sound

   allocate (self%load(0), self%step(0), self%worst(3, 0))
   self%history = ''
   path = folder//journal_name
   ! opening a pipe, which has no length, would wait for its other end
   inquire (file=path, size=bytes)
   if (bytes < len(mark)) return
   open (newunit=unit, file=path, form='unformatted', status='old', action='read', iostat=stat)
   if (stat /= 0) return
   read (unit, iostat=stat) first
   sound = stat == 0 .and. first == mark
   n = 0
   ! a run that was killed at once has no more
   read (unit, iostat=stat) n
   ! what the file has not would hardly fit into memory
   sound = sound .and. all(n >= 0) &
      & .and. sum(real(n(:3), wp)) + 24.0_wp*sum(real(n(4:), wp)) <= bytes
   if (.not. sound) call fatal_error(error, err_file, path//': is damaged, or another version ' &
      & //'wrote it; run again without --resume')
   if (stat == 0 .and. sound) then
      allocate (character(len=n(1)) :: self%deck)
      allocate (character(len=n(2)) :: self%overrides)
      allocate (character(len=n(3)) :: self%approximation)
      allocate (self%source(3, n(4)), self%points(3, n(5)))
      read (unit, iostat=stat) self%deck, self%overrides, self%approximation, self%source, &
         & self%points
      do while (stat == 0)
         call read_step(self, unit, stat)
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

!> Read a load step
subroutine read_step(self, unit, stat)
   class(run_type), intent(inout) :: self
   integer, intent(in) :: unit
   !> Not 0 where there is no whole one
   integer, intent(out) :: stat
   type(step_type) :: step
   type(carried_type) :: own
   character(len=:), allocatable :: lines
   real(wp), allocatable :: numbers(:)
   real(wp) :: check
   integer :: changes, length, letters, n, o, places, slopes
   integer(i8) :: bytes
   logical :: carries

   read (unit, iostat=stat) n, slopes, changes, places, length, carries, check, letters
   if (stat /= 0) return
   inquire (unit=unit, size=bytes)
   if (min(n, slopes, changes, places, length) < 0 .or. 8.0_wp*(real(n, wp)*(1 + changes) + slopes &
      & + 2.0_wp*places) + length > bytes) stat = 1
   if (stat /= 0) return
   allocate (numbers(numbers_of_step + n*(1 + changes) + slopes + 2*places))
   allocate (character(len=length) :: lines)
   read (unit, iostat=stat) numbers, lines
   if (stat == 0 .and. (abs(sum(numbers) - check) > 0.0_wp .or. sum_of(lines) /= letters)) stat = 1
   if (stat /= 0) return
   step%load = numbers(1)
   step%step = nint(numbers(2))
   step%steps = nint(numbers(3))
   step%iterations = nint(numbers(4))
   step%gradient = numbers(5)
   step%step_norm = numbers(6)
   step%min_j = numbers(7)
   step%max_j = numbers(8)
   own%held = numbers(12)
   own%halvings = nint(numbers(13))
   o = numbers_of_step + n
   if (slopes > 0) own%slope = numbers(o + 1:o + slopes)
   o = o + slopes
   if (changes > 0) own%bend = reshape(numbers(o + 1:o + n*changes), [n, changes])
   o = o + n*changes
   if (places > 0) own%place = numbers(o + 1:o + places)
   if (places > 0) own%origin = numbers(o + places + 1:o + 2*places)
   if (carries) step%carried = own
   self%step = [self%step, step]
   self%load = [self%load, step%load]
   if (.not. allocated(self%x)) allocate (self%x(n, 0))
   self%x = reshape([self%x, numbers(numbers_of_step + 1:numbers_of_step + n)], &
      & [n, size(self%load)])
   self%worst = reshape([self%worst, numbers(9:11)], [3, size(self%load)])
   self%history = self%history//lines
end subroutine read_step

pure integer function sum_of(text)
   character(len=*), intent(in) :: text
   integer :: i

   sum_of = sum([(ichar(text(i:i)), i=1, len(text))])
end function sum_of

end module rk_journal
