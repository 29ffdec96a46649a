!> Common solution of a scene through its load, for the executable and for scenes in memory:
!> settings of the iteration, load steps or one linear solve, and checks that give warnings.
module rk_run
   use rk_clock, only : tick, timer_type
   use rk_discretisation, only : discretisation_type, judged_state, rounding
   use rk_ellipticity, only : ellipticity_type, find_ellipticity
   use rk_error, only : error_type, fatal_error, err_convergence
   use rk_error_norms, only : error_norms, norms_type
   use rk_force, only : own_work_mismatch, set_forces
   use rk_fractions, only : parts_at
   use rk_motion, only : form_motion, march
   use rk_newton, only : newton_type
   use rk_newton_step, only : solve_linear
   use rk_precision, only : i8, wp
   use rk_probes, only : quantity_kind
   use rk_problem, only : problem_type
   use rk_recorder, only : iteration_type, recorder_type, start_type, step_type
   use rk_reduced, only : new_motion
   use rk_reduced_motion, only : moving_problem, prepare
   use rk_scene, only : last_part, scene_type
   use rk_states, only : field_state
   use rk_static, only : solve_static
   use rk_text, only : to_text
   implicit none
   private

   public :: outcome_type, solve_scene, solve_problem, never_strained

   !> Displacements below this share of the size of the body are rounding errors [-]
   real(wp), parameter :: unmoved = 1.0e-13_wp
   !> States of a motion that are judged. They lie closer together towards the end, where errors are
   !> largest, and not at multiples of any period
   integer, parameter :: looks = 16
   !> Distance up to which a probe lies on an interface of two materials, in spacings [-]
   real(wp), parameter :: beside = 1.0e-6_wp
   !> Bulk over shear modulus beyond which a step of the tolerance leaves an error in pressures, and
   !> the smallest share of the tolerance that is required: with stiffer ones rounding is larger [-]
   real(wp), parameter :: firm = 1.0e3_wp, finest = 0.05_wp

   !> Results of a run beside its states
   type :: outcome_type
      !> Warnings, each with its line feed
      character(len=:), allocatable :: warnings
      !> Imbalance of the forces on all sets in the states judged, over the largest force [-]
      real(wp) :: imbalance = 0.0_wp
      !> Work of the stress less that of the forces in the peak state, not allocated where they are
      !> not compared [-]
      real(wp), allocatable :: work_mismatch
      !> Places of output where some state has J <= 0 or a stress that is not finite, shape (nc)
      logical, allocatable :: broken(:)
      !> Where the material lost its ellipticity, in words; not allocated if it did not
      character(len=:), allocatable :: lost
      !> Points of output where it is lost in the last state, shape (nc)
      logical, allocatable :: lost_last(:)
      !> Why the run stopped early; not allocated if it did not
      character(len=:), allocatable :: ended
      !> The tangent in the peak state is not positive definite: the body would leave that state
      logical :: unstable = .false.
      !> The last iteration had a Cholesky factor of the tangent
      logical :: factored = .false.
      !> Smallest volume ratio at the places of output in all states [-]
      real(wp) :: min_j = huge(1.0_wp)
      !> The last state
      type(field_state) :: last
      !> States that are judged: that of full load, or all planned ones of a programme and some of
      !> a motion, whose ends may be at rest: loads, for a motion times, shape (n)
      real(wp), allocatable :: load(:)
      !> Their unknowns, shape (unknowns, n)
      real(wp), allocatable :: x(:, :)
      !> The body is not strained in any of them: it is at rest, or moved as a whole
      logical :: unstrained = .false.
      !> The state by which the answer is judged, and its number
      type(field_state) :: peak
      integer :: judged = 0
      !> Error of a linear problem with a known solution
      type(norms_type), allocatable :: norms
      !> Wall times of assembly and linear algebra
      type(timer_type) :: timer
      !> Wall time of the checks behind the warnings [s]
      real(wp) :: seconds = 0.0_wp
   contains
      procedure :: warn
   end type outcome_type

   !> Receiver between the solver and that of a caller: checks each state before it is passed on
   type, extends(recorder_type) :: watcher_type
      !> Problem whose states arrive
      class(discretisation_type), pointer :: problem => null()
      !> Where warnings are kept
      type(outcome_type), pointer :: outcome => null()
   contains
      procedure :: iteration, step, note => pass_on
   end type watcher_type

contains

!> Solve a scene through all load steps
subroutine solve_scene(problem, linear, recorder, outcome, error, start)
   class(discretisation_type), target, intent(inout) :: problem
   !> Least squares solver; blank for the scene's
   character(len=*), intent(in) :: linear
   !> Receiver of states and warnings; a nonlinear run begins with the state at rest, step 0
   class(recorder_type), target, intent(inout) :: recorder
   !> Results of the checks; warnings are valid after an error too
   type(outcome_type), target, intent(out) :: outcome
   !> Error handling: the run stopped early, the recorder has the last converged state
   type(error_type), allocatable, intent(out) :: error
   !> Where it begins instead of at rest; steps of an earlier run are recorded once more, and
   !> nothing is solved if that run stopped early
   type(start_type), intent(in), optional :: start
   type(watcher_type) :: watcher
   real(wp), allocatable :: rest(:)
   integer(i8) :: clock
   integer :: k
   logical :: loaded

   outcome%warnings = ''
   call warn_of_conditions(problem%scene, outcome, recorder)
   call warn_of_interfaces(problem%scene, outcome, recorder)
   watcher%problem => problem
   watcher%receiver => recorder
   watcher%outcome => outcome
   loaded = .false.
   if (.not. problem%linear) then
      rest = spread(0.0_wp, 1, problem%n)
      loaded = problem%scene%programme%begins_loaded()
      ! where the programme begins loaded its first state is still to be found
      if (.not. loaded) call recorder%step(step_type(load=0.0_wp), rest)
   end if
   if (present(start)) then
      if (allocated(start%iteration)) then
         do k = 1, size(start%iteration)
            call watcher%iteration(start%iteration(k))
         end do
      end if
      if (loaded .and. allocated(start%first)) call watcher%step(start%begin, start%first)
      do k = 1, size(start%step)
         call watcher%step(start%step(k), start%x(:, k))
      end do
      if (allocated(start%ended)) error = start%ended
   end if
   if (.not. allocated(error)) call solve_problem(problem, problem%scene, linear, watcher, &
      & outcome%timer, error, start)
   call system_clock(clock)
   if (.not. problem%linear) then
      if (.not. allocated(outcome%last%x)) call problem%state(rest, 0.0_wp, outcome%last)
      if (.not. allocated(error)) call check_response(problem, outcome%last, error)
      call find_imbalance(problem, outcome)
      ! loads that vary from point to point are not those of the conditions on sets
      if (problem%compares_works .and. .not. allocated(problem%scene%body_force)) &
         & outcome%work_mismatch = own_work_mismatch(problem, outcome%peak)
      if (.not. allocated(error) .and. outcome%judged > 0 .and. .not. outcome%unstrained) then
         ! not needed if the last iteration had a Cholesky factor of the tangent
         if (.not. outcome%factored .or. outcome%judged < size(outcome%load)) outcome%unstable &
            & = problem%is_unstable(outcome%x(:, outcome%judged), outcome%load(outcome%judged))
      end if
      outcome%seconds = outcome%seconds + tick(clock)
   else if (.not. allocated(error) .and. problem%scene%equation%is_known()) then
      call find_norms(problem, outcome, error)
      outcome%norms%seconds = tick(clock)
   end if
   if (.not. allocated(error)) return
   outcome%ended = error%message
   call outcome%warn(error%message, recorder)
end subroutine solve_scene

!> Errors against the known solution in all states that are judged; the norms are those of the last
subroutine find_norms(problem, outcome, error)
   class(discretisation_type), intent(in) :: problem
   type(outcome_type), intent(inout) :: outcome
   !> Error handling: a solution that is not finite
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: largest(2)
   integer :: k

   allocate (outcome%norms)
   largest = 0.0_wp
   do k = 1, size(outcome%load)
      call error_norms(problem, outcome%x(:, k), outcome%load(k), outcome%norms, error)
      if (allocated(error)) return
      largest = max(largest, [outcome%norms%l2, outcome%norms%l2_solution])
   end do
   outcome%norms%largest_l2 = largest(1)
   outcome%norms%largest_l2_solution = largest(2)
end subroutine find_norms

!> Solve any problem of a scene, full or reduced, with the settings of its deck
subroutine solve_problem(problem, scene, linear, recorder, timer, error, start)
   class(problem_type), target, intent(inout) :: problem
   type(scene_type), intent(in) :: scene
   !> Least squares solver; blank for the scene's
   character(len=*), intent(in) :: linear
   class(recorder_type), intent(inout) :: recorder
   type(timer_type), intent(out) :: timer
   !> Error handling: the run stopped early
   type(error_type), allocatable, intent(out) :: error
   !> Where it begins instead of at rest
   type(start_type), intent(in), optional :: start
   type(newton_type) :: newton
   type(step_type), allocatable :: last
   real(wp), allocatable :: x(:)
   integer :: done, halvings

   newton%linear = trim(linear)
   if (linear == '') newton%linear = scene%solver%linear
   newton%tolerance = scene%solver%tolerance
   ! a last step of size s leaves errors of about s**2 in volumes, and K times that in pressures;
   ! above the limit of direct solves the residual, which contains K, decides instead
   if (problem%square .and. .not. problem%inexact .and. scene%stiffest_ratio() <= huge(1.0_wp)) &
      & newton%tolerance = newton%tolerance &
      & *max(finest, sqrt(firm/max(scene%stiffest_ratio(), firm)))
   newton%max_iterations = scene%solver%max_iterations
   allocate (x(problem%n), source=0.0_wp)
   call system_clock(timer%start)
   if (problem%linear .and. allocated(scene%motion)) then
      call solve_motion(problem, scene, newton%linear, x, recorder, timer, error)
      return
   else if (problem%linear) then
      done = 0
      if (present(start)) done = size(start%step)
      ! the search for the points has already solved it
      if (done == 0) call solve_linear(problem, newton%linear, x, recorder, timer, error)
      return
   end if
   halvings = 0
   if (present(start)) then
      done = size(start%step)
      x = start%x(:, max(done, 1))
      halvings = start%halvings
      if (done > 0) last = start%step(done)
   end if
   ! without a last step the argument is absent
   call solve_static(problem, newton, scene%programme%plan(scene%load%steps), &
      & scene%load%max_halvings, halvings, x, recorder, timer, error, last)
end subroutine solve_problem

subroutine solve_motion(problem, scene, linear, x, recorder, timer, error)
   class(problem_type), target, intent(inout) :: problem
   !> Scene with a motion
   type(scene_type), intent(in) :: scene
   !> Linear solver of a reduced problem
   character(len=*), intent(in) :: linear
   !> Unknowns at the end, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   class(recorder_type), intent(inout) :: recorder
   type(timer_type), intent(inout) :: timer
   !> Error handling: a step that is not stable
   type(error_type), allocatable, intent(out) :: error
   class(form_motion), pointer :: body

   select type (problem)
   class is (moving_problem)
      call prepare(problem, linear, error)
      if (.not. allocated(error)) call march(problem%body, scene%motion, x, &
         & recorder, timer, error)
   class is (discretisation_type)
      call new_motion(body, problem, error)
      if (allocated(error)) return
      call march(body, scene%motion, x, recorder, timer, error)
      deallocate (body)
   end select
end subroutine solve_motion

!> Warn of inactive conditions
subroutine warn_of_conditions(scene, outcome, recorder)
   type(scene_type), intent(in) :: scene
   type(outcome_type), intent(inout) :: outcome
   class(recorder_type), intent(inout) :: recorder
   integer :: k

   if (scene%load%activation > 0.0_wp .and. .not. any([(scene%tissue(k)%material%fibered, &
      & k=1, size(scene%tissue))])) call outcome%warn('load.activation has no effect: no ' &
      & //'material has fibers; model = "muscle" does', recorder)
   do k = 1, size(scene%condition)
      associate (condition => scene%condition(k))
         if (any(condition%fixed .and. condition%traction%acts())) call warn_of('traction')
         if (any(condition%fixed .and. condition%spring > 0.0_wp)) call warn_of('spring')
         if (all(condition%fixed(:scene%cloud%nd)) .and. abs(condition%pressure) > 0.0_wp) &
            & call warn_of('pressure')
      end associate
   end do

contains

   !> Warn of a load on prescribed components
   subroutine warn_of(key)
      character(len=*), intent(in) :: key

      call outcome%warn('boundary.'//trim(scene%cloud%set_names(scene%condition(k)%set))//': ' &
         & //key//' has no effect in a component whose displacement is prescribed; leave one of ' &
         & //'the two out', recorder)
   end subroutine warn_of

end subroutine warn_of_conditions

!> Warn of probes on an interface of materials that are defined by expressions, if their quantity
!> may jump there
subroutine warn_of_interfaces(scene, outcome, recorder)
   type(scene_type), intent(in) :: scene
   type(outcome_type), intent(inout) :: outcome
   class(recorder_type), intent(inout) :: recorder
   type(error_type), allocatable :: error
   character(len=:), allocatable :: text
   real(wp), dimension(scene%cloud%nd) :: high, low, x
   real(wp) :: part(size(scene%tissue)), reach
   integer :: d, found, i, other, own, side

   if (size(scene%tissue) < 2) return
   reach = beside*minval(scene%cloud%spacing)
   low = minval(scene%cloud%points, dim=2)
   high = maxval(scene%cloud%points, dim=2)
   do i = 1, size(scene%probe)
      if (.not. scene%probe(i)%at_a_place()) cycle
      if (quantity_kind(scene%probe(i)%quantity) == 'length') cycle
      call parts_at(scene, scene%probe(i)%point(:size(x)), part, error)
      if (allocated(error)) return
      own = findloc(part > 0.0_wp, .true., dim=1)
      other = own
      do d = 1, size(x)
         do side = -1, 1, 2
            x = scene%probe(i)%point(:size(x))
            x(d) = x(d) + side*reach
            if (x(d) < low(d) .or. x(d) > high(d)) cycle
            found = last_part(scene%tissue, x, error)
            if (allocated(error)) return
            if (found > 0 .and. found /= own) other = found
         end do
      end do
      if (own == 0 .or. other == own) cycle
      text = 'between those of the two'
      if (allocated(scene%approximation%kink) .or. .not. scene%basis%interface > 0.0_wp) &
         & text = 'that in '//scene%tissue(own)%name
      call outcome%warn('probe '//scene%probe(i)%name//' lies on the interface of ' &
         & //scene%tissue(own)%name//' and '//scene%tissue(other)%name//', across which it may ' &
         & //'jump: its value is '//text//'; move it into the material that is meant', recorder)
   end do
end subroutine warn_of_interfaces

!> Keep a warning and report it
subroutine warn(self, line, recorder)
   class(outcome_type), intent(inout) :: self
   !> Warning
   character(len=*), intent(in) :: line
   class(recorder_type), intent(inout) :: recorder

   self%warnings = self%warnings//line//new_line('a')
   call recorder%note(line, warning=.true.)
end subroutine warn

!> Imbalance of the forces in the state that is judged: the last one, whatever the way there, or
!> where the loads were removed again the one with the largest displacements
subroutine find_imbalance(problem, outcome)
   class(discretisation_type), intent(in) :: problem
   !> Outcome with states
   type(outcome_type), intent(inout) :: outcome
   real(wp) :: left, largest
   integer :: k

   outcome%peak = outcome%last
   if (.not. allocated(outcome%load)) return
   ! keep one copy
   if (allocated(outcome%last%place)) deallocate (outcome%last%place)
   outcome%unstrained = never_strained(problem, outcome%load, outcome%x)
   k = judged_state(problem, outcome%x)
   outcome%judged = k
   if (k < size(outcome%load)) call problem%state(outcome%x(:, k), outcome%load(k), outcome%peak)
   call set_forces(problem, outcome%peak, left, largest)
   if (largest > 0.0_wp) outcome%imbalance = left/largest
end subroutine find_imbalance

!> Whether strains are rounding errors in all states
logical function never_strained(problem, load, x) result(never)
   class(discretisation_type), intent(in) :: problem
   !> Loads, shape (m) [-]
   real(wp), intent(in) :: load(:)
   !> Unknowns, shape (n, m)
   real(wp), intent(in) :: x(:, :)
   type(field_state) :: state
   integer :: k

   never = .false.
   do k = size(load), 1, -1
      call problem%state(x(:, k), load(k), state)
      never = problem%unstrained(state)
      if (.not. never) return
   end do
end function never_strained

!> Refuse a state with displacements and stresses of the size of rounding errors: the load is
!> negligible beside the stiffness of some material. The iteration stops at once, as nothing moves.
subroutine check_response(problem, state, error)
   class(discretisation_type), intent(in) :: problem
   type(field_state), intent(in) :: state
   !> Error handling: no answer to the load
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: stress, modulus

   if (.not. problem%scene%is_loaded(state%load)) return
   associate (size_of => problem%scaled_norms(state%x))
      if (size_of(1) > unmoved) return
   end associate
   call problem%largest_stress(state, stress, modulus)
   if (.not. stress > 0.0_wp .or. stress > rounding*modulus) return
   call fatal_error(error, err_convergence, 'the load displaces the body by less than rounding ' &
      & //'error relative to its size, and its stresses, up to '//to_text(stress, 2)//', are ' &
      & //'rounding errors of a stiffness of '//to_text(modulus, 2)//': the answer is ' &
      & //'meaningless; check material constants, loads and their units')
end subroutine check_response

subroutine iteration(self, it)
   class(watcher_type), intent(inout) :: self
   type(iteration_type), intent(in) :: it

   self%outcome%factored = .false.
   if (allocated(it%solver%used)) self%outcome%factored = it%solver%used == 'cholesky' &
      & .and. index(it%solver%why, 'shift') == 0
   call self%receiver%iteration(it)
end subroutine iteration

!> A load step converged: find where its material is nearest to losing its ellipticity
subroutine step(self, st, x)
   class(watcher_type), intent(inout) :: self
   type(step_type), intent(in) :: st
   real(wp), contiguous, intent(in) :: x(:)
   type(ellipticity_type) :: worst
   type(step_type) :: seen
   integer(i8) :: clock

   call system_clock(clock)
   call self%problem%state(x, st%load, self%outcome%last)
   if (st%step > 0) call keep(self%outcome, self%problem%scene, st%load, x)
   seen = st
   if (self%problem%linear) then
      call self%receiver%step(seen, x)
      return
   end if
   call self%problem%keep_places(self%outcome%last)
   call find_ellipticity(self%problem, self%outcome%last, worst)
   self%outcome%seconds = self%outcome%seconds + tick(clock)
   if (.not. allocated(self%outcome%broken)) &
      & allocate (self%outcome%broken(size(worst%broken)), source=.false.)
   self%outcome%broken(:) = self%outcome%broken .or. worst%broken
   call move_alloc(worst%lost, self%outcome%lost_last)
   seen%min_acoustic = worst%value
   seen%acoustic_point = worst%point
   ! J is that of the F that is written, also where a form integrates elsewhere
   if (allocated(self%outcome%last%j)) then
      seen%min_j = worst%min_j
      self%outcome%min_j = min(self%outcome%min_j, worst%min_j)
      seen%max_j = worst%max_j
   end if
   call self%receiver%step(seen, x)
   if (worst%value > 0.0_wp .or. allocated(self%outcome%lost)) return
   self%outcome%lost = 'the material loses ellipticity at ' &
      & //to_text(self%problem%scene%cloud%points(:, worst%point))//' (collocation point ' &
      & //to_text(worst%point)//') from load '//to_text(st%load)
   call self%outcome%warn(self%outcome%lost, self%receiver)
end subroutine step

!> Keep a state that is judged: for a ramp it replaces the last one, for a programme it is added,
!> for a motion it is added once the last one kept is due
subroutine keep(outcome, scene, load, x)
   type(outcome_type), intent(inout) :: outcome
   type(scene_type), intent(in) :: scene
   !> Load, for a motion the time
   real(wp), intent(in) :: load
   !> Unknowns, shape (n)
   real(wp), intent(in) :: x(:)
   integer :: n
   logical :: instead

   n = 0
   if (allocated(outcome%load)) n = size(outcome%load)
   instead = n > 0 .and. scene%programme%count() <= 1
   if (instead .and. allocated(scene%motion)) instead = looked(outcome%load(n)) &
      & == looked(sum(outcome%load(max(n - 1, 1):n - 1)))
   if (instead) then
      outcome%load(n) = load
      outcome%x(:, n) = x
   else if (n > 0) then
      outcome%load = [outcome%load, load]
      outcome%x = reshape([outcome%x, x], [size(x), n + 1])
   else
      outcome%load = [load]
      outcome%x = reshape(x, [size(x), 1])
   end if

contains

   !> Number of states that are due up to a time
   integer function looked(time)
      real(wp), intent(in) :: time

      looked = int(looks*(time/scene%motion%end_time)**2)
   end function looked

end subroutine keep

!> Pass on a note or a warning between two steps
subroutine pass_on(self, line, warning)
   class(watcher_type), intent(inout) :: self
   character(len=*), intent(in) :: line
   logical, intent(in) :: warning

   if (warning) then
      call self%outcome%warn(line, self%receiver)
   else
      call self%receiver%note(line, warning)
   end if
end subroutine pass_on

end module rk_run
