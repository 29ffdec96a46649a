!> Iteration for one load step, with step control: Gauss-Newton (5.76) on the least squares
!> functional (5.53)-(5.58), Newton on an energy.
!>
!> It stops on the gradient (5.78a) and the step (5.78b), never on the residual, which does not
!> vanish. A state with a volume ratio J <= 0 is never accepted.
!>
!> Reference: Nocedal, Wright, Numerical Optimization, Springer (2006), chapter 10,
!>            doi:10.1007/978-0-387-40065-5
module rk_newton
   use, intrinsic :: iso_fortran_env, only : int64
   use rk_clock, only : tick, timer_type
   use rk_damping, only : damping_type
   use rk_error, only : error_type, fatal_error, err_convergence, err_stopped
   use rk_line_search, only : search
   use rk_newton_step, only : find_step
   use rk_operator, only : square_operator, square_report
   use rk_path, only : path_type
   use rk_precision, only : wp
   use rk_problem, only : problem_type, evaluation_type
   use rk_recorder, only : iteration_type, recorder_type
   use rk_text, only : to_text
   implicit none
   private

   public :: newton_type, solve_step

   !> Iterations over which |r| of a square problem must fall to a share, after a number of
   !> iterations. In 660 load steps of beams, columns, cubes, sheets and muscles those that
   !> converged missed it 4 times, and those that failed in the end had it after 9 iterations of 24.
   integer, parameter :: pace = 3, settled = 6
   real(wp), parameter :: share = 0.3_wp
   !> Smallest volume ratio of a first iterate where a smaller load step is possible, relative to
   !> that at the start of the load step; the largest may grow by the inverse [-]
   real(wp), parameter :: squeezed = 0.25_wp
   !> Step, and residual relative to the first, with which an intermediate state is accurate enough;
   !> so small a step does not change a tangent or its stability [-]
   real(wp), parameter :: near = 1.0e-3_wp
   !> Step to an intermediate state that a single correction may make so accurate [-]
   real(wp), parameter :: near_on_way = 0.05_wp
   !> Bulk over shear modulus up to which this holds; beyond, it falls with the square root [-]
   real(wp), parameter :: firm = 1.0e3_wp

   !> Settings and outcome of the iteration, and data passed from one load step to the next
   type :: newton_type
      !> Least squares solver, one of solver_names
      character(len=:), allocatable :: linear
      !> Tolerance of both criteria [-]
      real(wp) :: tolerance = 1.0e-6_wp
      !> Largest number of iterations
      integer :: max_iterations = 25
      !> Load of the state at which a step starts [-]
      real(wp) :: done = 0.0_wp
      !> A smaller load step is possible: give up where a square problem converges slowly
      logical :: impatient = .false.
      !> Answers are judged at this load: the last one, or one where the rate of loading changes
      logical :: settles = .false.
      !> The load is an intermediate one: its state is only used for the next start
      logical :: passes = .false.
      !> A single correction may end an intermediate step: there is no risk of leaving the branch
      logical :: hastens = .false.
      !> Path through the last states
      type(path_type) :: path
      !> Number of iterations done
      integer :: iterations = 0
      !> Relative gradient and step reached [-]: for a square problem the residual, which is the
      !> gradient of its energy; where steps are solved inexactly the predicted next step
      real(wp) :: gradient = 0.0_wp
      real(wp) :: step_norm = 0.0_wp
      !> The iteration stopped at a jump of the residuals, which smaller load steps do not remove
      logical :: pinned = .false.
      !> The last step of the last load step that converged had no Cholesky factor where one was
      !> tried: its equilibrium may be unstable
      logical :: unstable = .false.
      !> A first iterate was found: a smaller load step from the same state has the same factor
      logical :: reuses = .false.
      !> Volume ratios of the last state
      type(evaluation_type) :: state
      !> Smallest and largest volume ratio of the state at which the load step starts [-]
      real(wp), private :: least_j = 1.0_wp, largest_j = 1.0_wp
   end type newton_type

   !> Progress of one load step
   type :: progress_type
      !> Tolerance of the relative gradient [-]
      real(wp) :: balance = 0.0_wp
      !> Iterations after which this load step is given up
      integer :: limit = 0
      !> |A^T r| at the last converged state, |r| of a square problem
      real(wp) :: first_gradient = 0.0_wp
      !> The first step, over the size of the unknowns [-]
      real(wp) :: first_step = huge(1.0_wp)
      !> Sizes of the unknowns to which steps are compared
      real(wp) :: extent(2) = 0.0_wp
      !> |r| before the last iterations, the latest first
      real(wp) :: past(pace) = huge(1.0_wp)
      !> Remaining residual, which predicts the next step, where steps are solved inexactly
      real(wp) :: promised = huge(1.0_wp)
      !> Predicted fall of the merit in the last step, relative to the merit [-]
      real(wp) :: left = huge(1.0_wp)
      !> The last step was neither shortened nor damped
      logical :: whole = .true.
      !> The last step was negligible compared with the size of the body
      logical :: still = .false.
      !> The problem is linearised at the last state
      logical :: linearised = .true.
      !> The state is an intermediate one, whose residual |r| needs to fall no farther than this
      logical :: passes = .false.
      real(wp) :: enough = 0.0_wp
      !> Steps below which corrections replace the next Newton step: second-order errors of volume
      !> return as pressures K times as large [-]
      real(wp) :: reach = near
      !> Steps rejected in a row
      integer :: rejected = 0
      !> Number of times row weights were set in this load step, and their state, shape (n)
      integer :: weighings = 0
      real(wp), allocatable :: weighed(:)
      !> Damping of the steps
      type(damping_type) :: damping
   end type progress_type

   !> Rejected steps in a row before giving up
   integer, parameter :: max_rejected = 3
   !> Iterations after a converged state that each begin with the row weights of the last state
   integer, parameter :: max_weighings = 12
   !> Smallest share of a step that is taken back where steps alternate: that of steps which shrink
   !> to a fourth [-]
   real(wp), parameter :: overshot = 0.2_wp
   !> Damping up to which a step counts as undamped, rounding of an ill-conditioned matrix [-]
   real(wp), parameter :: slight = 1.0e-8_wp
   !> Relative fall of the merit that is lost in the rounding of residuals of stiff materials
   real(wp), parameter :: nothing = 1.0e-11_wp
   !> Most corrections of a step, and largest size of each relative to the one before [-]
   integer, parameter :: most_corrections = 3
   real(wp), parameter :: falls = 0.1_wp
   !> Residual that an inexactly solved step may leave, in tolerances: it has the volume times K,
   !> and is larger by K over the shear modulus than that of the equations that are solved [-]
   real(wp), parameter :: slack = 10.0_wp
   !> Largest ratio of an inexactly solved step to the one predicted from the residual [-]
   real(wp), parameter :: caution = 10.0_wp
   !> Steps below this share of the unknowns, or of the size of the body, are rounding errors [-]
   real(wp), parameter :: rounding = 1.0e-13_wp
   !> Steps below this share of the unknowns if all were below the tolerance: the load step began at
   !> its solution, as where a programme is constant, and its gradient is a rounding error. Also if
   !> the gradient is below its tolerance and rounding prevents steps from being accepted [-]
   real(wp), parameter :: stands = 1.0e-10_wp

contains

!> Solve one load step; x is changed only on success
subroutine solve_step(self, problem, step, load, x, recorder, timer, error)
   type(newton_type), intent(inout) :: self
   class(problem_type), target, intent(inout) :: problem
   !> Number of the load step, for the recorder
   integer, intent(in) :: step
   !> Load [-]
   real(wp), intent(in) :: load
   !> Unknowns, start and solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   class(recorder_type), intent(inout) :: recorder
   type(timer_type), intent(inout) :: timer
   !> Error handling: no convergence, failed factorisation, stopped
   type(error_type), allocatable, intent(out) :: error
   type(progress_type) :: now
   type(iteration_type) :: it
   real(wp), allocatable :: a(:), da(:), r(:), g(:), trial(:), new(:)
   !> Last Gauss-Newton step, the gradient there, and the step that was taken, shape (n)
   real(wp), allocatable :: last_step(:), last_g(:), taken(:)
   real(wp) :: merit, predicted, imposed
   integer(int64) :: clock
   character(len=:), allocatable :: reason

   allocate (a, source=x)
   allocate (da(problem%n), g(problem%n), r(problem%m), trial(problem%n), new(problem%m))
   call start()
   if (.not. self%state%valid) then
      call get_volume_text(problem, self%state, reason)
      call fatal_error(error, err_convergence, 'the start of the step is not a valid state: ' &
         & //reason)
      return
   end if
   do
      call assess()
      if (now%passes .and. now%whole .and. self%step_norm < near .and. merit < now%enough) exit
      if (converged(self, now, problem%inexact)) then
         if (off_weight()) then
            call iterate_on()
            cycle
         end if
         call problem%check_answer(a, reason)
         if (len(reason) == 0) exit
         call fatal_error(error, err_convergence, reason)
         return
      end if
      if (.not. now%linearised) then
         call check_end(self, now, problem, load, merit, recorder, error)
         if (allocated(error)) return
         call linearise()
         cycle
      end if
      call now%damping%note(self%iterations, it%gradient, merit)
      call check_end(self, now, problem, load, merit, recorder, error)
      if (allocated(error)) return
      now%past = [merit, now%past(:pace - 1)]
      imposed = now%damping%lambda
      call system_clock(clock)
      call set_patience()
      call find_step(problem, self%linear, imposed, r, g, da, predicted, it%solver, error)
      timer%solve = timer%solve + tick(clock)
      if (allocated(error)) return
      self%iterations = self%iterations + 1
      if (.not. problem%square) call relax()
      call take_step()
      if (now%weighings > 0 .and. now%linearised) then
         if (off_weight()) call weigh()
      end if
   end do
   x = a
   self%reuses = .false.
   self%unstable = .false.
   if (allocated(it%solver%used)) self%unstable = it%solver%used == 'lu' .and. it%solver%indefinite

contains

   !> The state at which the load step starts, linearised
   subroutine start()
      self%iterations = 0
      self%step_norm = huge(1.0_wp)
      now%limit = self%max_iterations
      now%balance = self%tolerance
      if (problem%inexact) now%balance = slack*self%tolerance
      call system_clock(clock)
      if (problem%weighted) now%weighed = a
      call begin(self, problem, load, a, r, now%first_gradient)
      ! steps that are solved inexactly, or have row weights, must converge fully
      now%passes = self%passes .and. problem%square .and. .not. problem%inexact
      now%enough = near*norm2(r)
      now%reach = merge(near_on_way, near, now%passes .and. self%hastens) &
         & *min(1.0_wp, sqrt(firm/problem%scene%stiffest_ratio()))
      timer%assemble = timer%assemble + tick(clock)
   end subroutine start

   !> If the start is far from an equilibrium, a smaller load step is better than a costly solve
   subroutine set_patience()
      select type (matrix => problem%linearised)
      class is (square_operator)
         matrix%impatient = self%impatient .and. self%iterations == 0
         matrix%again = self%reuses .and. self%iterations == 0
         self%reuses = .false.
      end select
   end subroutine set_patience

   !> Whether row weights are from another state than the present one: states would then depend on
   !> the path to them
   logical function off_weight()
      off_weight = self%settles .and. problem%weighted .and. now%weighings < max_weighings
      if (off_weight) off_weight = any(problem%scaled_norms(a - now%weighed) &
         & >= self%tolerance*now%extent)
   end function off_weight

   !> Continue from a converged state with the row weights of this state
   subroutine iterate_on()
      now%limit = self%iterations + self%max_iterations
      self%step_norm = huge(1.0_wp)
      now%left = huge(1.0_wp)
      now%still = .false.
      now%rejected = 0
      now%damping = damping_type()
      call weigh()
   end subroutine iterate_on

   !> Set the row weights from the state
   subroutine weigh()
      now%weighings = now%weighings + 1
      if (allocated(last_step)) deallocate (last_step)
      now%weighed = a
      call problem%start(a, load, .false.)
      call linearise()
   end subroutine weigh

   !> Correct a step by further ones with its factor, each of which takes at most a fifth of the
   !> time. The error left by the last one is that after a Newton step of that size.
   subroutine correct()
      type(square_report) :: report
      type(evaluation_type) :: seen
      type(error_type), allocatable :: failure
      real(wp) :: size_before, size_now
      integer :: k

      select type (matrix => problem%linearised)
      class is (square_operator)
         size_before = self%step_norm
         matrix%again = .true.
         do k = 1, merge(1, most_corrections, now%passes)
            ! stiff modes need a second one
            if (k /= 2 .and. self%step_norm < merge(near, self%tolerance, now%passes)) exit
            call matrix%solve_square(0.0_wp, -r, da, report, failure)
            if (allocated(failure)) exit
            trial = a + da
            call problem%evaluate(trial, load, new, seen)
            size_now = maxval(problem%scaled_norms(da)/now%extent)
            ! in an intermediate step an insufficient correction would corrupt the next pressures
            if (.not. (seen%valid .and. size_now <= merge(near, falls*size_before, now%passes) &
               & .and. norm2(new) < norm2(r))) exit
            a = trial
            r = new
            self%state = seen
            self%step_norm = merge(size_now, size_now/sqrt(size_before), now%passes)
            size_before = size_now
         end do
         matrix%again = .false.
      end select
   end subroutine correct

   subroutine linearise()
      call system_clock(clock)
      call problem%evaluate(a, load, r, self%state, tangent=.true.)
      timer%assemble = timer%assemble + tick(clock)
      now%linearised = .true.
   end subroutine linearise

   !> Gradient and residual at the unknowns a
   subroutine assess()
      if (problem%inexact .and. .not. now%linearised) call linearise()
      if (now%linearised) then
         call problem%start(a, load, .true.)
         call problem%linearised%apply_transposed(r, g)
         it%gradient = norm2(g)
      end if
      merit = norm2(r)
      self%gradient = merge(merit, it%gradient, problem%square) &
         & /max(now%first_gradient, tiny(1.0_wp))
      if (problem%inexact) call predict_step(self, now)
   end subroutine assess

   !> Where residuals remain, Gauss-Newton steps may overshoot and alternate. The secant of the last
   !> two, in the metric of A^T A, gives the share to take back
   subroutine relax()
      real(wp) :: plain(problem%n), change(problem%n), whole, part

      if (imposed > 0.0_wp) then
         if (allocated(last_step)) deallocate (last_step)
         return
      end if
      plain = da
      if (allocated(last_step)) then
         change = da - last_step
         whole = dot_product(change, last_g - g)
         part = -dot_product(change, g)
         if (part > overshot*whole .and. part < whole) da = da - part/whole*(taken + change)
      end if
      last_step = plain
      last_g = g
   end subroutine relax

   !> Search along the step, take the accepted step and adapt the damping
   subroutine take_step()
      real(wp) :: moved(2), scale, gain, highest
      logical :: ahead, blind, definite

      call system_clock(clock)
      now%left = predicted/max(0.5_wp*merit**2, tiny(1.0_wp))
      ! the jump at the start of a load step and rounding errors are no measure of the step
      blind = self%iterations == 1 .or. now%left < nothing &
         & .or. (problem%extent > 0.0_wp .and. all(problem%scaled_norms(da) <= rounding))
      moved = problem%scaled_norms(da)
      ! a step along a soft mode strains stiff ones, as bending stretches a column, and the next
      ! step corrects this: residuals need not fall from step to step
      definite = problem%square .and. it%solver%used == 'cholesky'
      highest = merit
      if (definite) highest = maxval(now%past, mask=now%past < huge(1.0_wp))
      ! in the middle of the iteration the tangent of the state is needed next
      ahead = problem%square .and. .not. problem%inexact .and. any(moved >= max(now%reach, &
         & self%tolerance)*now%extent) .and. (self%iterations > 1 .or. self%path%states() > 0)
      call search(problem, load, a, da, r, dot_product(g, da), highest, blind, &
         & imposed > 0.0_wp, ahead, trial, new, scale, gain, self%state)
      now%whole = scale >= 1.0_wp .and. imposed < slight
      taken = scale*da
      if (blind .or. .not. scale > 0.0_wp) then
         if (allocated(last_step)) deallocate (last_step)
      end if
      if (scale > 0.0_wp) then
         now%rejected = 0
         now%linearised = .not. problem%square .or. (ahead .and. scale >= 1.0_wp)
         a = trial
         r = new
         if (.not. blind) call now%damping%learn(scale, gain, predicted, 0.5_wp*merit**2, definite)
         self%reuses = self%iterations == 1 .and. self%path%states() == 0 .and. definite &
            & .and. .not. (problem%inexact .or. self%unstable)
         ! try whether an undamped step would make progress
         if (now%left < nothing) now%damping%lambda = 0.0_wp
      else
         ! return to the start of the step, with more damping
         now%rejected = now%rejected + 1
         call now%damping%reject()
         call problem%evaluate(a, load, r, self%state, tangent=.true.)
      end if
      if (self%iterations == 1) then
         now%extent = problem%scaled_norms(a)
         ! pressures may be zero; then they are compared with strain times the shear modulus
         now%extent = max(now%extent, now%extent(1), tiny(1.0_wp))
      end if
      if (scale > 0.0_wp) moved = scale*moved
      self%step_norm = maxval(moved/now%extent)
      if (self%iterations == 1) now%first_step = self%step_norm
      now%still = scale > 0.0_wp .and. problem%extent > 0.0_wp .and. all(moved <= rounding)
      if (self%step_norm < now%reach .and. self%iterations > 1 .and. now%whole .and. definite &
         & .and. .not. problem%inexact) call correct()
      timer%assemble = timer%assemble + tick(clock)
      it%step = step
      it%load = load
      it%iteration = self%iterations
      it%residual = norm2(r)
      it%step_norm = self%step_norm
      it%min_j = self%state%min_j
      it%max_j = self%state%max_j
      it%seconds = tick(timer%start)
      call recorder%iteration(it)
   end subroutine take_step

end subroutine solve_step

!> Predict the size of the next step of an iteration with inexact steps from the remaining residual:
!> it need not be solved only to see that it is small
subroutine predict_step(self, now)
   !> Iteration, whose state is linearised
   type(newton_type), intent(inout) :: self
   type(progress_type), intent(inout) :: now
   real(wp) :: before

   before = now%promised
   now%promised = self%state%size
   if (self%iterations == 0 .or. .not. now%whole) return
   ! a predicted step never counts as rounding: the forces must balance too
   if (self%step_norm > rounding) self%step_norm = max(rounding, min(1.0_wp, caution*now%promised &
      & /before)*self%step_norm)
end subroutine predict_step

!> Start of a load step: the last converged state, or the extrapolation of the path through the last
!> ones if that has a smaller residual. In both cases the gradient that ends the iteration is
!> relative to that of the last converged state: a good start must not tighten the tolerance.
subroutine begin(self, problem, load, a, r, first_gradient)
   !> Settings; the evaluation of the state is set
   type(newton_type), intent(inout) :: self
   !> Problem, linearised at the start
   class(problem_type), target, intent(inout) :: problem
   real(wp), intent(in) :: load
   !> Unknowns, last converged state and start, shape (n)
   real(wp), contiguous, intent(inout) :: a(:)
   !> Residuals at the start, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   !> |A^T r| at the last converged state, |r| of a square problem
   real(wp), intent(out) :: first_gradient
   type(evaluation_type) :: state
   real(wp) :: g(size(a))
   logical :: found

   if (.not. self%reuses) call problem%start(a, load, .false.)
   ! the start has another matrix
   call problem%evaluate(a, load, r, self%state, lifted=self%done, &
      & tangent=.not. (problem%square .and. (self%reuses .or. self%path%states() > 0)))
   self%least_j = self%state%min_j
   self%largest_j = self%state%max_j
   call problem%start(a, load, .true.)
   first_gradient = norm2(r)
   if (.not. problem%square) then
      call problem%linearised%apply_transposed(r, g)
      first_gradient = norm2(g)
   end if
   if (self%path%states() == 0) return
   ! a journal may lack the load before the last one
   if (problem%inexact .and. .not. abs(self%done - self%path%earlier) > 0.0_wp) return
   state = self%state
   call self%path%lead(problem, self%done, load, a, r, state, found)
   if (found) then
      self%state = state
   else
      call problem%evaluate(a, load, r, self%state, .true., lifted=self%done)
   end if
end subroutine begin

!> Reasons to stop without convergence
subroutine check_end(self, now, problem, load, merit, recorder, error)
   type(newton_type), intent(inout) :: self
   type(progress_type), intent(in) :: now
   class(problem_type), intent(in) :: problem
   real(wp), intent(in) :: load
   !> |r| now
   real(wp), intent(in) :: merit
   !> Receiver of iterations, which knows whether to stop
   class(recorder_type), intent(inout) :: recorder
   !> Error handling: stopped, no convergence
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: advice, reached

   if (recorder%stopped()) then
      call fatal_error(error, err_stopped, 'stopped on the way to load ' &
         & //to_text(load))
      return
   end if
   call get_volume_text(problem, self%state, reached)
   reached = ': relative gradient '//to_text(self%gradient, 2)//', relative step ' &
      & //to_text(self%step_norm, 2)//', '//reached
   self%pinned = self%step_norm < self%tolerance &
      & .and. (now%rejected == max_rejected .or. now%damping%stalled())
   if (self%pinned .and. .not. self%gradient <= huge(1.0_wp)) then
      call fatal_error(error, err_convergence, 'the gradient is not finite: material constants ' &
         & //'are too large, such as K = 1E100'//reached)
   else if (self%pinned) then
      call problem%get_advice(advice)
      call fatal_error(error, err_convergence, 'the Newton steps vanish but the gradient does ' &
         & //'not: '//advice//reached)
   else if (now%rejected == max_rejected) then
      call fatal_error(error, err_convergence, 'the line search found no step that ' &
         & //'reduces the residual with J > 0'//reached)
   else if (now%damping%stalled()) then
      call fatal_error(error, err_convergence, 'the iteration stalls or cycles'//reached)
   else if (self%impatient .and. problem%square .and. self%iterations == 1 &
      & .and. self%gradient > now%balance .and. (self%state%min_j < squeezed*self%least_j &
      & .or. self%state%max_j*squeezed > self%largest_j)) then
      call fatal_error(error, err_convergence, 'the first iterate is far from the solution' &
         & //reached)
   else if (self%impatient .and. problem%square .and. self%iterations >= settled &
      & .and. merit > share*now%past(pace) .and. self%gradient > now%balance) then
      call fatal_error(error, err_convergence, 'too slow after '//to_text(self%iterations) &
         & //' iterations'//reached)
   else if (self%iterations == now%limit) then
      call fatal_error(error, err_convergence, 'no convergence in '//to_text(self%iterations) &
         & //' iterations'//reached)
   end if
end subroutine check_end

!> Both criteria, or a step at the level of rounding, or a small step without any predicted gain
pure logical function converged(self, now, inexact)
   type(newton_type), intent(in) :: self
   type(progress_type), intent(in) :: now
   !> Steps are solved inexactly: their predicted gain does not show that the forces balance
   logical, intent(in) :: inexact

   converged = self%iterations > 0 .and. self%step_norm < self%tolerance
   if (converged) converged = (now%whole .and. (self%step_norm < rounding &
      & .or. self%gradient < now%balance .or. (now%left < nothing .and. .not. inexact))) &
      ! a full Newton step may end where rounding prevents every further one from being accepted
      & .or. self%gradient < rounding
   converged = converged .or. (self%iterations > 0 .and. now%whole .and. now%still) &
      & .or. (now%first_step < self%tolerance .and. now%whole .and. self%step_norm < stands)
   ! where rounding prevents every step, the last one is damped endlessly
   converged = converged .or. (self%iterations > 0 .and. self%step_norm < stands &
      & .and. self%gradient < now%balance)
end function converged

!> Smallest volume ratio and where it is
subroutine get_volume_text(problem, state, text)
   class(problem_type), intent(in) :: problem
   type(evaluation_type), intent(in) :: state
   character(len=:), allocatable, intent(out) :: text

   text = 'smallest J '//to_text(state%min_j, 4)
   associate (points => problem%scene%cloud%points)
      ! volume rows may be at other places
      if (state%worst > 0 .and. state%worst <= size(points, 2)) text = text//' at ' &
         & //to_text(points(:, state%worst))
   end associate
end subroutine get_volume_text

end module rk_newton
