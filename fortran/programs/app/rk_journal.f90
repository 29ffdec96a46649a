!> Journal of a run: the data needed to resume it, in a file that only grows.
!>
!> A result file can be torn if its process is killed while writing: HDF5 rewrites parts of the
!> file. In a journal only the last load step can be torn; the sum of its unknowns detects data lost
!> by a disk in a power failure.
module rk_journal
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_error, only : error_type, fatal_error, err_file
   use rk_precision, only : i8, wp
   use rk_recorder, only : step_type
   use rk_results, only : restart_type, to_space
   use rk_text_file, only : make_file
   implicit none
   private

   public :: journal_type, run_type, read_journal

   !> Journal of a run, in its folder
   character(len=*), parameter :: journal_name = '/results.journal'
   !> Mark of the files this module reads
   character(len=*), parameter :: mark = 'myork-journal 4 '

   !> Journal being written
   type :: journal_type
      private
      !> Unit of its file; 0 if there is none
      integer :: unit = 0
      !> Lines of the history since the last step, each with its line feed
      character(len=:), allocatable :: lines
      !> Load steps written, including that at load 0
      integer :: steps = 0
   contains
      procedure :: open => open_journal, add_line, add_step
   end type journal_type

   !> Run read from its journal, without load steps if nothing was solved
   type, extends(restart_type) :: run_type
      !> Deck, and its overrides, one per line
      character(len=:), allocatable :: deck, overrides
      !> Load steps, that at load 0 first
      type(step_type), allocatable :: step(:)
      !> Lines of history.csv after the first, each with its line feed
      character(len=:), allocatable :: history
      !> Position at which its journal continues, counted in bytes from 1
      integer(i8) :: behind = 0
   end type run_type

contains

!> Begin a journal, or continue one after its last step
subroutine open_journal(self, folder, run, deck, approximation, cloud, unknowns, error)
   class(journal_type), intent(inout) :: self
   character(len=*), intent(in) :: folder
   !> Run to be resumed, not allocated for a new run
   type(run_type), allocatable, intent(in) :: run
   type(deck_type), intent(in) :: deck
   !> Description of the shape functions
   character(len=*), intent(in) :: approximation
   type(cloud_type), intent(in) :: cloud
   integer, intent(in) :: unknowns
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
   write (self%unit, iostat=stat) mark, len(deck%text), len(deck%overrides), len(approximation), &
      & size(cloud%source, 2), size(cloud%points, 2), unknowns, deck%text, deck%overrides, &
      & approximation, to_space(cloud%source), to_space(cloud%points)
   flush (self%unit, iostat=stat)
end subroutine open_journal

!> Add a line to the history
subroutine add_line(self, line)
   class(journal_type), intent(inout) :: self
   character(len=*), intent(in) :: line

   if (self%unit /= 0) self%lines = self%lines//line//new_line('a')
end subroutine add_line

!> Add a load step, unless the journal has it. A state between two planned ones is not stored: it is
!> solved again. A full disk is an error of the results, which are in the same folder
subroutine add_step(self, step, x)
   class(journal_type), intent(inout) :: self
   type(step_type), intent(in) :: step
   !> Unknowns, shape (n)
   real(wp), intent(in) :: x(:)
   integer :: stat

   if (self%unit == 0 .or. step%step < self%steps .or. .not. step%planned) return
   write (self%unit, iostat=stat) len(self%lines), step%step, step%steps, step%iterations, &
      & step%load, step%gradient, step%step_norm, step%min_j, step%max_j, x, self%lines, sum(x)
   flush (self%unit, iostat=stat)
   self%steps = self%steps + 1
   self%lines = ''
end subroutine add_step

!> Read the journal in a folder up to its last complete step
subroutine read_journal(self, path, folder, error)
   type(run_type), intent(out) :: self
   !> Its file, for messages
   character(len=:), allocatable, intent(out) :: path
   character(len=*), intent(in) :: folder
   !> Error handling: content that is not a journal of this version
   type(error_type), allocatable, intent(out) :: error
   character(len=len(mark)) :: first
   integer(i8) :: bytes
   integer :: n(6), stat, unit

   allocate (self%load(0), self%step(0))
   self%history = ''
   path = folder//journal_name
   ! opening a pipe, which has no length, would wait for its other end
   inquire (file=path, size=bytes)
   if (bytes <= 0) return
   open (newunit=unit, file=path, form='unformatted', access='stream', status='old', &
      & action='read', iostat=stat)
   if (stat /= 0) return
   n = 0
   read (unit, iostat=stat) first, n
   if (stat == 0 .and. (first /= mark .or. any(n < 0 .or. n > bytes))) then
      call fatal_error(error, err_file, path//': is damaged, or another version ' &
         & //'wrote it; run again without --resume')
   else if (stat == 0) then
      allocate (character(len=n(1)) :: self%deck)
      allocate (character(len=n(2)) :: self%overrides)
      allocate (character(len=n(3)) :: self%approximation)
      allocate (self%source(3, n(4)), self%points(3, n(5)), self%x(n(6), 0))
      read (unit, iostat=stat) self%deck, self%overrides, self%approximation, self%source, &
         & self%points
      do while (stat == 0)
         inquire (unit=unit, pos=self%behind)
         call read_step(self, unit, bytes, stat)
      end do
   end if
   close (unit)
end subroutine read_journal

!> Read the next load step of a journal
subroutine read_step(self, unit, bytes, stat)
   class(run_type), intent(inout) :: self
   integer, intent(in) :: unit
   !> Length of its file
   integer(i8), intent(in) :: bytes
   !> Nonzero if there is none, or only a part of one
   integer, intent(out) :: stat
   type(step_type) :: step
   character(len=:), allocatable :: lines
   real(wp) :: x(size(self%x, 1)), total
   integer :: length

   read (unit, iostat=stat) length, step%step, step%steps, step%iterations, step%load, &
      & step%gradient, step%step_norm, step%min_j, step%max_j, x
   if (stat == 0 .and. (length < 0 .or. length > bytes .or. step%step /= size(self%step))) stat = 1
   if (stat /= 0) return
   allocate (character(len=length) :: lines)
   read (unit, iostat=stat) lines, total
   if (stat == 0 .and. abs(sum(x) - total) > 0.0_wp) stat = 1
   if (stat /= 0) return
   self%step = [self%step, step]
   self%load = [self%load, step%load]
   self%x = reshape([self%x, x], [size(x), size(self%load)])
   self%history = self%history//lines
end subroutine read_step

end module rk_journal
