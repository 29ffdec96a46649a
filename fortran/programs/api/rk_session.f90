!> Operations of the Python boundary on a scene: open, solve full or reduced, evaluate.
module rk_session
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type, open_deck
   use rk_deck_scene, only : get_approximation, new_scene
   use rk_error, only : error_type, fatal_error, err_input
   use rk_handles, only : close_slot, listener_interface, slot_type
   use rk_lstsq, only : solver_names
   use rk_new_problem, only : new_problem
   use rk_precision, only : wp
   use rk_problem, only : problem_type
   use rk_recorder, only : start_type
   use rk_refine, only : refine
   use rk_run, only : outcome_type, solve_problem, solve_scene
   use rk_verdict, only : judge, verdict_type
   implicit none
   private

   public :: open_session, solve_session, find_problem

contains

subroutine open_session(path, text, overrides, model, listener, slot, error)
   !> Deck, or its name for messages
   character(len=*), intent(in) :: path
   !> Text of the deck; blank to read the file
   character(len=*), intent(in) :: text
   !> Overrides "table.key=value"; blanks are skipped
   character(len=*), intent(in) :: overrides(:)
   !> Points of the model file, if the deck needs one
   type(cloud_type), intent(in) :: model
   !> Receiver of the lines of a search for points, who may stop it
   procedure(listener_interface) :: listener
   !> The scene, not associated on error
   type(slot_type), pointer, intent(out) :: slot
   type(error_type), allocatable, intent(out) :: error
   type(deck_type) :: deck

   nullify (slot)
   call open_deck(deck, path, text, pack(overrides, overrides /= ''), 'solve', error)
   if (allocated(error)) return
   allocate (slot)
   slot%states%listener => listener
   call refine(slot%refinement, deck, model, slot%states, error)
   nullify (slot%states%listener)
   if (.not. allocated(error) .and. allocated(slot%refinement%start)) &
      & call move_alloc(slot%refinement%start%ended, error)
   if (.not. allocated(error)) call new_scene(slot%scene, deck, model, error)
   if (.not. allocated(error)) then
      call new_problem(slot%full, slot%scene, error)
      call deck%locate(error)
   end if
   if (allocated(error)) then
      call close_slot(slot)
   else
      slot%deck = deck
      slot%model = model
      call get_approximation(deck, slot%approximation)
   end if
end subroutine open_session

!> Full or reduced problem of a scene
subroutine find_problem(slot, reduced, problem, error)
   type(slot_type), intent(in), target :: slot
   !> Whether the reduced problem is requested
   logical, intent(in) :: reduced
   class(problem_type), pointer, intent(out) :: problem
   !> Error handling: no reduced model
   type(error_type), allocatable, intent(out) :: error

   problem => slot%full
   if (reduced) problem => slot%reduced
   if (.not. associated(problem)) call fatal_error(error, err_input, 'this scene has no reduced ' &
      & //'model yet')
end subroutine find_problem

!> Solve the full or the reduced problem through all load steps
subroutine solve_session(slot, linear, reduced, estimate, x, error)
   type(slot_type), target, intent(inout) :: slot
   !> Least squares solver; blank for the deck's
   character(len=*), intent(in) :: linear
   !> Whether to solve the reduced problem
   logical, intent(in) :: reduced
   !> Whether to compute a second solution for error bars
   logical, intent(in) :: estimate
   !> Unknowns at which the iteration begins, shape (n)
   real(wp), intent(in) :: x(:)
   type(error_type), allocatable, intent(out) :: error
   class(problem_type), pointer :: problem
   type(start_type), allocatable :: start

   ! weak forms would not read it
   if (linear /= '' .and. .not. any(solver_names == linear)) then
      call fatal_error(error, err_input, 'unknown least squares solver '//trim(linear) &
         & //'; give a choice of solver.linear, or none')
      return
   end if
   if (allocated(slot%states%x)) deallocate (slot%states%x, slot%states%info)
   slot%states%steps = 0
   call find_problem(slot, reduced, problem, error)
   if (allocated(error)) return
   ! the search for the points has already solved it
   if (.not. reduced .and. linear == '' .and. .not. any(abs(x) > 0.0_wp)) &
      & call move_alloc(slot%refinement%start, start)
   if (.not. allocated(start)) then
      allocate (start)
      allocate (start%step(0))
      start%x = reshape(x, [size(x), 1])
   end if
   associate (states => slot%states, steps => slot%scene%steps())
      allocate (states%x(problem%n, steps), states%info(6, steps))
      states%iterations = 0
      states%backward_error = 0.0_wp
      states%stop = .false.
   end associate
   slot%verdict = verdict_type(reasons='')
   if (reduced) then
      slot%outcome = outcome_type(warnings='')
      call solve_problem(problem, slot%scene, linear, slot%states, slot%outcome%timer, error, &
         & start)
   else
      call solve_scene(slot%full, linear, slot%states, slot%outcome, error, start)
      call judge(slot%verdict, slot%full, slot%deck, slot%model, estimate, slot%refinement, &
         & slot%states, slot%outcome)
      if (allocated(slot%refinement%reason)) slot%verdict%reasons = slot%verdict%reasons &
         & //slot%refinement%reason//new_line('a')
   end if
end subroutine solve_session

end module rk_session
