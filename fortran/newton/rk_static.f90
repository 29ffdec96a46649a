!> Load steps from rest through planned loads, halved where the iteration fails and enlarged again
!> afterwards. A programme that begins loaded has a step 0, to its first state: the given start, in
!> equilibrium with the values prescribed there, or else a state approached from rest.
module rk_static
   use rk_clock, only : timer_type
   use rk_discretisation, only : at_rest, turns_over
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

   !> Halvings after which a run stops at an unstable state: the branch is lost, and states reached
   !> by further halvings are arbitrary
   integer, parameter :: early = 5
   !> Steps of a run that begins halved (as it was needed with fewer points) before they grow
   integer, parameter :: rests = 3

contains

!> Solve all load steps
subroutine solve_static(problem, newton, planned, max_halvings, halved, x, recorder, timer, error, &
   & last)
   class(problem_type), target, intent(inout) :: problem
   type(newton_type), intent(inout) :: newton
   type(plan_type), intent(in) :: planned
   !> Halvings of a step before giving up
   integer, intent(in) :: max_halvings
   !> Halvings with which it begins if no load step is done yet
   integer, intent(in) :: halved
   !> Unknowns, start and last converged state, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> Receiver of iterations and steps
   class(recorder_type), intent(inout) :: recorder
   type(timer_type), intent(inout) :: timer
   !> Error handling: no convergence, stopped, wrong input; x is, and the recorder has, the last
   !> converged state
   type(error_type), allocatable, intent(out) :: error
   !> Load step that another run has done, of which x is then the state; without it x is that of
   !> load 0, or any other at which the iteration begins
   type(step_type), intent(in), optional :: last
   type(step_type) :: record
   real(wp), allocatable :: before(:)
   real(wp) :: load, part, most, target_load, done, from
   integer :: step, first, halvings, waits
   logical :: aside, settled

   done = 0.0_wp
   aside = any(abs(x) > 0.0_wp) .and. .not. present(last)
   settled = present(last)
   halvings = min(halved, max_halvings)
   waits = merge(rests, 0, halvings > 0)
   first = 1
   if (present(last)) then
      record = step_type(gradient=last%gradient, step_norm=last%step_norm, min_j=last%min_j, &
         & max_j=last%max_j)
      first = last%step + 1
      done = last%load
   end if
   record%steps = size(planned%load)
   if (planned%loaded .and. .not. present(last)) then
      if (aside) call begin_at_start()
      if (allocated(error)) return
      if (.not. any(abs(x) > 0.0_wp)) then
         first = 0
         done = -1.0_wp
      end if
   end if
   do step = first, record%steps
      from = done
      if (step > 0) then
         target_load = planned%load(step)
         most = planned%most(step)
      else
         target_load = 0.0_wp
         most = planned%first_most
      end if
      record%step = step
      record%iterations = 0
      record%halvings = halvings
      do
         call choose_load()
         if (nothing_moves()) then
            ! iterations would work on rounding errors
            done = load
            record%load = load
         else
            call try_step()
            if (allocated(error)) then
               if (aside .and. any(error%code == [err_convergence, err_linalg])) then
                  call leave_start('load '//to_text(load, 4))
                  cycle
               else if (may_halve()) then
                  call halve()
                  cycle
               end if
               call give_up()
               return
            end if
            call arrive()
         end if
         if (load >= target_load) exit
      end do
      waits = 0
      ! the rate of the prescribed values changes
      if (step == 0) then
         call newton%path%forget()
      else if (planned%knot(step)) then
         call newton%path%forget()
      end if
      call recorder%step(record, x)
   end do

contains

   !> Load of the next step: the planned one over a power of two, so that the target is met exactly
   subroutine choose_load()
      part = most/2.0_wp**halvings
      load = min(done + part, target_load)
      if (target_load - load < 1.0e-9_wp*part) load = target_load
      newton%done = done
      ! a start off the path has the prescribed values of this load
      if (aside) newton%done = load
      newton%impatient = halvings < max_halvings &
         & .and. .not. (newton%unstable .and. halvings >= early)
      newton%settles = .false.
      newton%passes = load < target_load
      newton%hastens = halvings < early
      if (step > 0 .and. load >= target_load) newton%settles = step == record%steps &
         & .or. planned%knot(step)
   end subroutine choose_load

   !> Whether the last state is also that of the next load
   logical function nothing_moves()
      nothing_moves = at_rest(problem, x, load)
      if (settled .and. .not. nothing_moves) nothing_moves = .not. problem%scene%changes(done, load)
   end function nothing_moves

   !> Iterate at the load; x is changed only on success
   subroutine try_step()
      before = x
      call solve_step(newton, problem, step, load, x, recorder, timer, error)
      record%iterations = record%iterations + newton%iterations
      if (allocated(error) .or. halvings >= max_halvings) return
      if (.not. turns_over(problem, before, x)) return
      call fatal_error(error, err_convergence, 'the step rotates material by 90 degrees or more')
      x = before
   end subroutine try_step

   !> Whether a smaller step may succeed where this one failed
   logical function may_halve()
      may_halve = any(error%code == [err_convergence, err_linalg]) &
         & .and. halvings < max_halvings .and. .not. newton%pinned
      if (may_halve .and. halvings >= early) may_halve = .not. is_lost()
   end function may_halve

   !> Whether the last converged state is unstable; a tangent that is not positive definite does not
   !> suffice
   logical function is_lost()
      is_lost = newton%unstable .and. done > 0.0_wp
      if (is_lost) is_lost = problem%is_unstable(x, done)
   end function is_lost

   subroutine halve()
      ! the last step before the planned load is shorter than its part: unless the part is cut
      ! below that, the same step would be repeated
      do
         halvings = halvings + 1
         part = 0.5_wp*part
         if (part < 0.99_wp*(load - done) .or. halvings >= max_halvings) exit
      end do
      record%halvings = max(record%halvings, halvings)
      call recorder%note('load '//to_text(load, 4)//': '//error%message &
         & //'; the load step is halved to '//to_text(part, 4), warning=.false.)
      deallocate (error)
      ! the secant may have pointed the wrong way
      call newton%path%forget()
   end subroutine halve

   !> Accept a converged state
   subroutine arrive()
      ! the step from a start off the path gives no direction of the path
      if (.not. aside) call newton%path%note(before, x, done, load, problem%inexact)
      aside = .false.
      settled = .true.
      done = load
      call note_state(load)
      waits = max(waits - 1, 0)
      if (halvings > 0 .and. waits == 0 .and. 2*newton%iterations <= newton%max_iterations) &
         & halvings = halvings - 1
   end subroutine arrive

   !> Write a converged state to the record
   subroutine note_state(reached)
      !> Its load [-]
      real(wp), intent(in) :: reached

      record%load = reached
      record%gradient = newton%gradient
      record%step_norm = newton%step_norm
      record%min_j = newton%state%min_j
      record%max_j = newton%state%max_j
   end subroutine note_state

   !> Equilibrium at load 0 from a start, which is already one if the start belongs to the beginning
   !> of the programme. Without one, the first state is approached from rest
   subroutine begin_at_start()
      before = x
      record%step = 0
      newton%done = 0.0_wp
      newton%impatient = .true.
      call solve_step(newton, problem, 0, 0.0_wp, x, recorder, timer, error)
      record%iterations = newton%iterations
      if (.not. allocated(error)) then
         if (turns_over(problem, before, x)) call fatal_error(error, err_convergence, 'the start ' &
            & //'is rotated by 90 degrees or more')
      end if
      if (allocated(error)) then
         if (.not. any(error%code == [err_convergence, err_linalg])) return
         call leave_start('the beginning of the programme')
         return
      end if
      aside = .false.
      call note_state(0.0_wp)
      call recorder%step(record, x)
   end subroutine begin_at_start

   !> Go on from rest where no equilibrium is found from a start off the path: smaller loads are
   !> only farther from it
   subroutine leave_start(place)
      !> Where it was sought, in words
      character(len=*), intent(in) :: place

      call recorder%note('no equilibrium at '//place//' from the given start: '//error%message &
         & //'; it is approached from rest instead', warning=.false.)
      deallocate (error)
      newton%reuses = .false.
      aside = .false.
      x = 0.0_wp
   end subroutine leave_start

   !> Hand over the last converged state and report where the run stopped
   subroutine give_up()
      if (done > from .and. step > 0) then
         call settle()
         record%planned = .false.
         call recorder%step(record, x)
      end if
      if (error%code == err_stopped) error%message = error%message//'; last converged load ' &
         & //to_text(done)
      if (.not. any(error%code == [err_convergence, err_linalg])) return
      error%message = 'did not converge at load '//to_text(load)//': '//error%message &
         & //'; last converged load '//to_text(done)
      if (is_lost()) then
         error%message = error%message//', an unstable equilibrium, where the branch is lost; ' &
            & //'reduce the load, or constrain the body'
      else if (.not. (newton%pinned .or. allocated(problem%caveat))) then
         error%message = error%message//'; use more load.steps or points, or reduce the load'
      end if
      if (allocated(problem%caveat)) error%message = error%message//'; '//problem%caveat
      error%code = err_convergence
   end subroutine give_up

   !> Solve the last converged state, an intermediate one, to full accuracy
   subroutine settle()
      type(error_type), allocatable :: failure
      logical :: unstable

      unstable = newton%unstable
      newton%passes = .false.
      newton%reuses = .false.
      newton%done = done
      call solve_step(newton, problem, step, done, x, recorder, timer, failure)
      newton%unstable = unstable
      if (allocated(failure)) return
      record%iterations = record%iterations + newton%iterations
      call note_state(done)
   end subroutine settle

end subroutine solve_static

end module rk_static
