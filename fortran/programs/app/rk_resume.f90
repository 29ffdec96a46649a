!> Runs that begin at a state of another run: resumed in the same folder, or started from a file.
module rk_resume
   use rk_deck, only : deck_type
   use rk_deck_scene, only : approximation_text
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_journal, only : read_journal
   use rk_precision, only : i8, wp
   use rk_recorder, only : start_type, step_type
   use rk_results, only : read_restart, restart_type, to_space
   use rk_text, only : line, lines_of, to_text
   use rk_text_file, only : load_text
   implicit none
   private

   public :: resumed_type, resume_run, resume_points, start_from, step_numbers, step_columns
   public :: journal_name

   !> Numbers of a step in the file: those of step_type, of carried_type, the worst backward error,
   !> misfit and condition of the run so far, and the columns that are carried
   integer, parameter :: numbers_of_step = 15
   !> Journal of a run, in its folder
   character(len=*), parameter :: journal_name = '/results.journal'

   !> What an ended run has left
   type :: resumed_type
      !> Its load steps; not allocated where nothing was solved yet
      type(start_type), allocatable :: start
      !> Lines of history.csv behind the first, each with its line feed
      character(len=:), allocatable :: history
      !> Worst backward error, misfit and condition of the run up to each step, shape (3, 0:steps)
      !> [-]
      real(wp), allocatable :: worst(:, :)
      !> Bytes of the journal that are whole, 0 where there is none
      integer(i8) :: journal = 0
   end type resumed_type

contains

!> Load steps of an ended run in a folder, and the lines of its history that belong to them: by its
!> journal where it was killed, by its results where it ended
subroutine resume_run(self, folder, deck, problem, error)
   type(resumed_type), intent(out) :: self
   character(len=*), intent(in) :: folder
   !> Deck, which must be that of the run
   type(deck_type), intent(in) :: deck
   class(discretisation_type), intent(in) :: problem
   !> Error handling: another deck, other points, a damaged file
   type(error_type), allocatable, intent(out) :: error
   type(restart_type) :: found
   character(len=:), allocatable :: path
   integer :: k, planned

   self%history = ''
   if (problem%linear) return
   call read_run(folder, found, path, self%history, self%journal, error)
   if (allocated(error)) return
   ! a state between two planned ones, where the run ended, is found again
   planned = 0
   if (allocated(found%load)) planned = count(found%step(8, 2:) > 0.0_wp)
   if (planned == 0) then
      ! what has led to the state at load 0 is found again
      self%history = ''
      self%journal = 0
      return
   end if
   call compare_decks(found, deck, path, error)
   if (.not. allocated(error)) call compare_points(found, deck, problem, path, error)
   if (allocated(error)) return
   allocate (self%start)
   self%start%first = found%x(:, 1)
   self%start%begin = step_of(found, 1)
   if (allocated(self%start%begin%carried)) deallocate (self%start%begin%carried)
   allocate (self%start%step(planned), self%worst(3, 0:planned))
   do k = 1, planned
      self%start%step(k) = step_of(found, k + 1)
   end do
   self%start%x = found%x(:, 2:planned + 1)
   self%worst(:, :) = found%step(12:14, :planned + 1)
   self%history = lines_until(self%history, planned)
end subroutine resume_run

!> Give a deck that has a table refine the points which its ended run had found, so that they are
!> not searched again: another search may be ended by its cost at others
subroutine resume_points(folder, deck, resumed, error)
   character(len=*), intent(in) :: folder
   !> Deck, replaced by one with these points
   type(deck_type), intent(inout) :: deck
   !> Whether there was a run with states
   logical, intent(out) :: resumed
   !> Error handling: another deck, a damaged file
   type(error_type), allocatable, intent(out) :: error
   type(restart_type) :: found
   type(deck_type) :: finer
   character(len=:), allocatable :: path, history
   character(len=512), allocatable :: words(:)
   integer(i8) :: journal
   integer :: own

   resumed = .false.
   call read_run(folder, found, path, history, journal, error)
   if (allocated(error) .or. .not. allocated(found%load)) return
   if (size(found%load) < 2) return
   own = len(deck%overrides)
   if (found%deck /= deck%text .or. index(found%overrides, deck%overrides) /= 1) then
      call compare_decks(found, deck, path, error)
      return
   end if
   resumed = .true.
   call lines_of(found%overrides(own + 1:), words)
   call deck%vary(words, finer, error)
   if (.not. allocated(error)) deck = finer
end subroutine resume_points

!> States of the run in a folder, that at load 0 first; none are allocated where there is no run
subroutine read_run(folder, found, path, history, journal, error)
   character(len=*), intent(in) :: folder
   type(restart_type), intent(out) :: found
   !> File they are from
   character(len=:), allocatable, intent(out) :: path
   !> Lines of history.csv behind the first, each with its line feed
   character(len=:), allocatable, intent(out) :: history
   !> Bytes of the journal that are whole, 0 where there is none
   integer(i8), intent(out) :: journal
   !> Error handling: a damaged file
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: text
   logical :: exists

   history = ''
   journal = 0
   path = folder//journal_name
   inquire (file=path, exist=exists)
   if (exists) then
      call read_journal(path, numbers_of_step, found, history, journal, error)
      return
   end if
   path = folder//'/results.vtkhdf'
   inquire (file=path, exist=exists)
   if (.not. exists) return
   call read_restart(found, path, error)
   if (allocated(error)) then
      error%message = error%message//'; run again without --resume'
      return
   end if
   call load_text(folder//'/history.csv', text)
   history = text(1 + index(text, new_line('a')):)
end subroutine read_run

!> State of a file at which the iteration shall begin
subroutine start_from(words, deck, problem, start, error)
   !> File and step, "FILE" for the last one or "FILE:STEP"
   character(len=*), intent(in) :: words
   type(deck_type), intent(in) :: deck
   class(discretisation_type), intent(in) :: problem
   type(start_type), allocatable, intent(out) :: start
   !> Error handling: no such file or step, other points
   type(error_type), allocatable, intent(out) :: error
   type(restart_type) :: found
   character(len=:), allocatable :: path
   integer :: colon, stat, step
   logical :: exists

   if (problem%linear) then
      call fatal_error(error, err_input, '--start-from '//words//': a linear problem is solved ' &
         & //'or marched from its own start; leave the option out')
      return
   end if
   path = words
   step = -1
   colon = index(words, ':', back=.true.)
   if (colon > 1 .and. colon < len(words)) then
      read (words(colon + 1:), *, iostat=stat) step
      if (stat == 0 .and. verify(words(colon + 1:), '0123456789') == 0) path = words(:colon - 1)
   end if
   inquire (file=path//'/results.vtkhdf', exist=exists)
   if (exists) path = path//'/results.vtkhdf'
   call read_restart(found, path, error)
   if (allocated(error)) return
   call compare_points(found, deck, problem, path, error)
   if (allocated(error)) return
   if (step < 0) step = size(found%load) - 1
   if (step > size(found%load) - 1) then
      call fatal_error(error, err_input, path//': has no step '//to_text(step) &
         & //'; the last one is '//to_text(size(found%load) - 1))
      return
   end if
   allocate (start)
   allocate (start%step(0))
   start%x = found%x(:, step + 1:step + 1)
end subroutine start_from

!> Refuse the file of another deck, and say where it differs
subroutine compare_decks(found, deck, path, error)
   type(restart_type), intent(in) :: found
   type(deck_type), intent(in) :: deck
   character(len=*), intent(in) :: path
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: what
   integer :: k

   if (found%deck == deck%text .and. found%overrides == deck%overrides) return
   if (found%deck /= deck%text) then
      k = 1
      do while (line(found%deck, k) == line(deck%text, k))
         k = k + 1
      end do
      what = 'line '//to_text(k)//' was "'//line(found%deck, k)//'"'
   else if (len(found%overrides) > 1) then
      what = 'it was solved with --set '//found%overrides(:len(found%overrides) - 1)
   else
      what = 'it was solved without --set'
   end if
   call fatal_error(error, err_input, path//': holds a run of another deck: '//what &
      & //'; resume with the deck as it was, or run again without --resume')
end subroutine compare_decks

!> Refuse states of other points or another approximation
subroutine compare_points(found, deck, problem, path, error)
   type(restart_type), intent(in) :: found
   type(deck_type), intent(in) :: deck
   class(discretisation_type), intent(in) :: problem
   character(len=*), intent(in) :: path
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: what

   what = ''
   associate (cloud => problem%scene%cloud)
      if (size(found%source, 2) /= size(cloud%source, 2)) then
         what = to_text(size(found%source, 2))//' source points, this deck has ' &
            & //to_text(size(cloud%source, 2))
      else if (size(found%points, 2) /= size(cloud%points, 2)) then
         what = to_text(size(found%points, 2))//' collocation points, this deck has ' &
            & //to_text(size(cloud%points, 2))
      else if (any(abs(found%source - to_space(cloud%source)) > 0.0_wp) .or. any(abs( &
         & found%points - to_space(cloud%points)) > 0.0_wp)) then
         what = 'points at other places than those of this deck'
      else if (found%approximation /= approximation_text(deck)) then
         what = 'an approximation of '//found%approximation//', this deck has ' &
            & //approximation_text(deck)
      else if (size(found%x, 1) /= problem%n) then
         what = to_text(size(found%x, 1))//' unknowns, this deck has '//to_text(problem%n)
      end if
   end associate
   if (what /= '') call fatal_error(error, err_input, path//': its states have '//what)
end subroutine compare_points

!> A step as the numbers that the file keeps
pure function step_numbers(step, worst) result(row)
   type(step_type), intent(in) :: step
   !> Worst backward error, misfit and condition of the run so far [-]
   real(wp), intent(in) :: worst(3)
   real(wp) :: row(numbers_of_step)

   row = 0.0_wp
   row(1:8) = [real(step%step, wp), real(step%steps, wp), real(step%iterations, wp), &
      & step%gradient, step%step_norm, step%min_j, step%max_j, merge(1.0_wp, 0.0_wp, step%planned)]
   row(12:14) = worst
   if (.not. allocated(step%carried)) return
   row(15) = size(step_columns(step), 2)
   row(9:10) = [real(step%carried%halvings, wp), step%carried%held]
   ! a slope, and its changes
   if (allocated(step%carried%slope)) row(11) = 1.0_wp
   if (allocated(step%carried%bend)) row(11) = 1.0_wp + size(step%carried%bend, 2)
end function step_numbers

!> What a step carries as columns: slope, and its changes or where its matrix was taken from
pure function step_columns(step) result(columns)
   !> Step with what it carries
   type(step_type), intent(in) :: step
   real(wp), allocatable :: columns(:, :)
   integer :: k

   if (.not. allocated(step%carried)) then
      allocate (columns(0, 0))
      return
   end if
   associate (carried => step%carried)
      if (allocated(carried%place)) then
         allocate (columns(size(carried%place), 3), source=0.0_wp)
         columns(:, 2) = carried%place
         columns(:, 3) = carried%origin
      else if (allocated(carried%slope)) then
         k = 0
         if (allocated(carried%bend)) k = size(carried%bend, 2)
         allocate (columns(size(carried%slope), 1 + k))
         if (k > 0) columns(:, 2:) = carried%bend
      else
         allocate (columns(0, 0))
      end if
      if (allocated(carried%slope)) columns(:, 1) = carried%slope
   end associate
end function step_columns

!> A planned step of a file
function step_of(found, k) result(step)
   type(restart_type), intent(in) :: found
   !> Its number
   integer, intent(in) :: k
   type(step_type) :: step
   integer :: columns, first

   associate (row => found%step(:, k))
      step%load = found%load(k)
      step%step = nint(row(1))
      step%steps = nint(row(2))
      step%iterations = nint(row(3))
      step%gradient = row(4)
      step%step_norm = row(5)
      step%min_j = row(6)
      step%max_j = row(7)
      if (step%step == step%steps) return
      allocate (step%carried)
      step%carried%halvings = nint(row(9))
      step%carried%held = row(10)
      columns = nint(row(15))
      first = nint(sum(found%step(15, :k - 1)))
      associate (own => found%carried(:, first + 1:first + columns))
         if (row(11) > 0.0_wp) step%carried%slope = own(:, 1)
         if (row(11) > 1.0_wp) step%carried%bend = own(:, 2:nint(row(11)))
         if (columns < 3 .or. row(11) > 1.0_wp) return
         step%carried%place = own(:, 2)
         step%carried%origin = own(:, 3)
      end associate
   end associate
end function step_of

!> Lines of a history that belong to steps up to a number
function lines_until(text, steps) result(lines)
   !> Lines, each with its line feed
   character(len=*), intent(in) :: text
   !> Last step
   integer, intent(in) :: steps
   character(len=:), allocatable :: lines
   integer :: comma, first, length, stat, step

   lines = ''
   first = 1
   do
      length = index(text(first:), new_line('a'))
      if (length == 0) return
      comma = index(text(first:first + length - 1), ',')
      read (text(first:first + max(comma, 1) - 2), *, iostat=stat) step
      if (stat == 0 .and. step <= steps) lines = lines//text(first:first + length - 1)
      first = first + length
   end do
end function lines_until

end module rk_resume
