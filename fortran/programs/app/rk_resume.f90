!> Runs that begin at a state of another run: resumed in the same folder, or started from a file.
module rk_resume
   use rk_deck, only : deck_type
   use rk_deck_scene, only : get_approximation
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_journal, only : read_journal, run_type
   use rk_precision, only : wp
   use rk_recorder, only : start_type
   use rk_results, only : read_restart, restart_type, to_space
   use rk_text, only : line, to_text
   implicit none
   private

   public :: resume_run, resume_points, start_from

contains

!> Read the load steps of an interrupted run in a folder
subroutine resume_run(run, start, folder, deck, problem, error)
   !> The run; not allocated if nothing was solved
   type(run_type), allocatable, intent(out) :: run
   !> Start of the resumed run; not allocated if nothing was solved
   type(start_type), allocatable, intent(out) :: start
   character(len=*), intent(in) :: folder
   !> Deck, which must be that of the run
   type(deck_type), intent(in) :: deck
   class(discretisation_type), intent(in) :: problem
   !> Error handling: another deck, other points, a damaged file
   type(error_type), allocatable, intent(out) :: error
   type(run_type) :: found
   character(len=:), allocatable :: path

   if (problem%linear) return
   call read_journal(found, path, folder, error)
   ! the solution of the state at load 0 is repeated
   if (allocated(error) .or. size(found%step) < 2) return
   call compare_decks(found, deck, path, error)
   if (.not. allocated(error)) call compare_points(found, deck, problem, path, error)
   if (allocated(error)) return
   run = found
   allocate (start)
   start%first = run%x(:, 1)
   start%begin = run%step(1)
   start%step = run%step(2:)
   start%x = run%x(:, 2:)
end subroutine resume_run

!> Give a deck with a table refine the points found by its interrupted run, so that they are not
!> searched again: another search may be stopped by its cost at other points
subroutine resume_points(folder, deck, resumed, error)
   character(len=*), intent(in) :: folder
   !> Deck, replaced by one with these points
   type(deck_type), intent(inout) :: deck
   !> Whether there was a run with states
   logical, intent(out) :: resumed
   !> Error handling: another deck, a damaged file
   type(error_type), allocatable, intent(out) :: error
   type(run_type) :: found
   type(deck_type) :: finer
   character(len=:), allocatable :: path
   integer :: own

   resumed = .false.
   call read_journal(found, path, folder, error)
   if (allocated(error) .or. size(found%step) < 2) return
   own = len(deck%overrides)
   if (found%deck /= deck%text .or. index(found%overrides, deck%overrides) /= 1) then
      call compare_decks(found, deck, path, error)
      return
   end if
   resumed = .true.
   call deck%vary(found%overrides(own + 1:), finer, error)
   if (.not. allocated(error)) deck = finer
end subroutine resume_points

!> Read from a file the state at which the iteration begins
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
         & //'or integrated from its own initial state; omit the option')
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

!> Refuse the file of another deck, and report where it differs
subroutine compare_decks(found, deck, path, error)
   type(run_type), intent(in) :: found
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
   call fatal_error(error, err_input, path//': contains a run of another deck: '//what &
      & //'; resume with the deck as it was, or run again without --resume')
end subroutine compare_decks

!> Refuse states of other points or another approximation
subroutine compare_points(found, deck, problem, path, error)
   class(restart_type), intent(in) :: found
   type(deck_type), intent(in) :: deck
   class(discretisation_type), intent(in) :: problem
   character(len=*), intent(in) :: path
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: approximation, what

   what = ''
   call get_approximation(deck, approximation)
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
      else if (found%approximation /= approximation) then
         what = 'an approximation of '//found%approximation//', this deck has '//approximation
      else if (size(found%x, 1) /= problem%n) then
         what = to_text(size(found%x, 1))//' unknowns, this deck has '//to_text(problem%n)
      end if
   end associate
   if (what /= '') call fatal_error(error, err_input, path//': its states have '//what)
end subroutine compare_points

end module rk_resume
