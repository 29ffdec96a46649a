!> Load steps from rest through planned loads, halved where the iteration fails and grown again
!> afterwards.
module rk_static
   use rk_clock, only : timer_type
   use rk_error, only : error_type, fatal_error, err_convergence, err_linalg, err_stopped
   use rk_newton, only : newton_type, solve_step
   use rk_precision, only : wp
   use rk_problem, only : problem_type
   use rk_programme, only : plan_type
   use rk_recorder, only : recorder_type, step_type
   use rk_text, only : to_text
   implicit none
   private

   public :: solve_static

   !> Halvings up to which an iteration that gets on slowly is given up early: beyond, the load is
   !> hard itself, as where a column buckles, and slow iterations may be the only ones that arrive
   integer, parameter :: early = 5

contains

!> Solve all load steps
subroutine solve_static(problem, newton, planned, max_halvings, x, recorder, timer, error)
   !> Problem
   class(problem_type), target, intent(inout) :: problem
   !> Settings of the iteration
   type(newton_type), intent(inout) :: newton
   !> Load steps
   type(plan_type), intent(in) :: planned
   !> Halvings of a step before giving up
   integer, intent(in) :: max_halvings
   !> Unknowns, start and last converged state, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> Receiver of iterations and steps
   class(recorder_type), intent(inout) :: recorder
   !> Wall times
   type(timer_type), intent(inout) :: timer
   !> Error handling: no convergence, stopped, wrong input; x holds and the recorder saw the last
   !> converged state
   type(error_type), allocatable, intent(out) :: error
   type(step_type) :: record
   real(wp), allocatable :: before(:)
   real(wp) :: load, part, target_load, done, from
   integer :: step, halvings

   done = 0.0_wp
   halvings = 0
   record%steps = size(planned%load)
   do step = 1, record%steps
      from = done
      target_load = planned%load(step)
      record%step = step
      record%iterations = 0
      do
         ! a step is a power of two of the planned one, so the target is met exactly
         part = planned%most(step)/2.0_wp**halvings
         load = min(done + part, target_load)
         if (target_load - load < 1.0e-9_wp*part) load = target_load
         newton%done = done
         newton%impatient = halvings < min(early, max_halvings)
         before = x
         call solve_step(newton, problem, step, load, x, recorder, timer, error)
         record%iterations = record%iterations + newton%iterations
         if (.not. allocated(error) .and. halvings < max_halvings) then
            if (problem%turns_over(before, x)) then
               call fatal_error(error, err_convergence, 'the step turns material by a right ' &
                  & //'angle or more')
               x = before
            end if
         end if
         if (allocated(error)) then
            if (any(error%code == [err_convergence, err_linalg]) .and. halvings < max_halvings &
               & .and. .not. newton%pinned) then
               halvings = halvings + 1
               call recorder%note('load '//to_text(load, 4)//': '//error%message &
                  & //'; the load step is halved to '//to_text(0.5_wp*part, 4))
               deallocate (error)
               ! the secant may have led astray
               if (allocated(newton%slope)) deallocate (newton%slope)
               cycle
            end if
            call give_up()
            return
         end if
         newton%slope = (x - before)/(load - done)
         done = load
         record%load = load
         record%gradient = newton%gradient
         record%step_norm = newton%step_norm
         record%min_j = newton%state%min_j
         record%max_j = newton%state%max_j
         if (halvings > 0 .and. 2*newton%iterations <= newton%max_iterations) then
            halvings = halvings - 1
         end if
         if (load >= target_load) exit
      end do
      call recorder%step(record, x)
      ! what was prescribed goes on at another rate
      if (planned%knot(step) .and. allocated(newton%slope)) deallocate (newton%slope)
   end do

contains

   !> Hand over the last converged state and say where it ended
   subroutine give_up()
      if (done > from) then
         record%planned = .false.
         call recorder%step(record, x)
      end if
      if (error%code == err_stopped) error%message = error%message//'; last converged load ' &
         & //to_text(done)
      if (.not. any(error%code == [err_convergence, err_linalg])) return
      error%message = 'did not converge at load '//to_text(load)//': '//error%message &
         & //'; last converged load '//to_text(done)
      error%code = err_convergence
   end subroutine give_up

end subroutine solve_static

end module rk_static
