!> Iteration for one load step, with step control: Gauss-Newton (5.76) on the least squares
!> functional (5.53)-(5.58), Newton on an energy.
!>
!> It stops on the gradient (5.78a) and the step (5.78b), never on the residual, which does not go
!> to zero. A state with a volume ratio J <= 0 is never accepted.
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

   !> Iterations over which |r| of a square problem must fall to a share, from the first number of
   !> iterations on. In 660 load steps of beams, columns, cubes, sheets and muscles those that
   !> arrived missed it 4 times, and those that failed in the end had it after 9 iterations of 24.
   integer, parameter :: pace = 3, settled = 6
   real(wp), parameter :: share = 0.3_wp
   !> Smallest volume ratio that a first iterate may have where a smaller load step is at hand, of
   !> that at which the load step starts; the largest may grow by the inverse [-]
   real(wp), parameter :: squeezed = 0.2_wp
   !> Step, and residual of the first one, with which a state on the way is near enough; so small a
   !> step leaves a tangent as it is, also in its stability [-]
   real(wp), parameter :: near = 1.0e-3_wp
   !> Step on the way whose end a single correction may bring so near [-]
   real(wp), parameter :: near_on_way = 0.05_wp
   !> Bulk over shear modulus of which this holds; it falls with the root of stiffer ones [-]
   real(wp), parameter :: firm = 1.0e3_wp

   !> Settings and outcome of the iteration, and what load steps hand to the next
   type :: newton_type
      !> Least squares solver, one of solver_names
      character(len=:), allocatable :: linear
      !> Tolerance of both criteria [-]
      real(wp) :: tolerance = 1.0e-6_wp
      !> Iterations at most
      integer :: max_iterations = 25
      !> Load of the state at which a step starts [-]
      real(wp) :: done = 0.0_wp
      !> A smaller load step is at hand: give up where a square problem gets on slowly
      logical :: impatient = .false.
      !> The load is one by which answers are judged: the last, or one where its rate changes
      logical :: settles = .false.
      !> The load is on the way to the one that is asked for: nothing but the next start is taken
      !> from its state
      logical :: passes = .false.
      !> A single correction may end a step on the way: the branch is not in danger
      logical :: hastens = .false.
      !> Way through the last states
      type(path_type) :: path
      !> Iterations done
      integer :: iterations = 0
      !> Relative gradient and step reached [-]: of a square problem the residual, which is the
      !> gradient of its energy; where steps are solved to few digits the next step as predicted
      real(wp) :: gradient = 0.0_wp
      real(wp) :: step_norm = 0.0_wp
      !> The iteration ended at a jump of the residuals, which smaller load steps do not remove
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
      !> Sizes of the unknowns that steps are small against
      real(wp) :: extent(2) = 0.0_wp
      !> |r| before the last iterations, the latest first
      real(wp) :: past(pace) = huge(1.0_wp)
      !> What is left of the residual by the next step, where steps are solved to few digits
      real(wp) :: promised = huge(1.0_wp)
      !> Fall of the merit that the last step promised, of the merit [-]
      real(wp) :: left = huge(1.0_wp)
      !> The last step was neither shortened nor damped
      logical :: whole = .true.
      !> The last step moved nothing beside the size of the body
      logical :: still = .false.
      !> The problem is linearised at the last state
      logical :: linearised = .true.
      !> The state is one on the way, whose residual |r| needs to fall no farther than this
      logical :: passes = .false.
      real(wp) :: enough = 0.0_wp
      !> Steps below which corrections find what the next step of Newton would: second orders of
      !> volume come back as K times as large a pressure [-]
      real(wp) :: reach = near
      !> Steps rejected in a row
      integer :: rejected = 0
      !> Times that row weights were taken in this load step, and from which state, shape (n)
      integer :: weighings = 0
      real(wp), allocatable :: weighed(:)
      !> Damping of the steps
      type(damping_type) :: damping
   end type progress_type

   !> Rejected steps in a row before giving up
   integer, parameter :: max_rejected = 3
   !> Iterations after a converged state that begin with the row weights of the state before each
   integer, parameter :: max_weighings = 12
   !> Share of a step that is taken back where steps alternate, at least: that of steps which shrink
   !> to a fourth [-]
   real(wp), parameter :: overshot = 0.2_wp
   !> Damping that leaves a step whole, rounding of an ill-conditioned matrix [-]
   real(wp), parameter :: slight = 1.0e-8_wp
   !> Fall of the merit, of the merit, that drowns in the rounding of residuals of stiff materials
   real(wp), parameter :: nothing = 1.0e-11_wp
   !> Corrections of a step at most, and the size of each, of the one before, at most [-]
   integer, parameter :: most_corrections = 3
   real(wp), parameter :: falls = 0.1_wp
   !> Residual that a step solved to few digits may leave, in tolerances: it has the volume times K,
   !> and is K over the shear modulus larger than that of the equations that are solved [-]
   real(wp), parameter :: slack = 10.0_wp
   !> Size of a step over what the residual's promises, at most, of one solved to few digits [-]
   real(wp), parameter :: caution = 10.0_wp
   !> Steps below this share of the unknowns, or of the size of the body, are rounding [-]
   real(wp), parameter :: rounding = 1.0e-13_wp
   !> Steps below this share of the unknowns where all were below the tolerance: the load step began
   !> where it ends, as where a programme stands still, and its gradient is a rounding. Also where
   !> the gradient is below its tolerance and rounding keeps the steps from being accepted [-]
   real(wp), parameter :: stands = 1.0e-10_wp

contains

!> Solve one load step; x is changed only on success
subroutine solve_step(self, problem, step, load, x, recorder, timer, error)
   type(newton_type), intent(inout) :: self
   class(problem_type), target, intent(inout) :: problem
   !> Number of the load step, for the record
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
   !> Last step of Gauss-Newton, the gradient there, and what was moved, shape (n)
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
      ! steps that are solved to few digits, or have row weights, need the full way
      now%passes = self%passes .and. problem%square .and. .not. problem%inexact
      now%enough = near*norm2(r)
      now%reach = merge(near_on_way, near, now%passes .and. self%hastens) &
         & *min(1.0_wp, sqrt(firm/problem%scene%stiffest_ratio()))
      timer%assemble = timer%assemble + tick(clock)
   end subroutine start

   !> Where the start is far from an equilibrium a smaller load step is better than a costly solve
   subroutine set_patience()
      select type (matrix => problem%linearised)
      class is (square_operator)
         matrix%impatient = self%impatient .and. self%iterations == 0
         matrix%again = self%reuses .and. self%iterations == 0
         self%reuses = .false.
      end select
   end subroutine set_patience

   !> Whether the state is not the one from which the row weights are: states would depend on the
   !> way to them
   logical function off_weight()
      off_weight = self%settles .and. problem%weighted .and. now%weighings < max_weighings
      if (off_weight) off_weight = any(problem%scaled_norms(a - now%weighed) &
         & >= self%tolerance*now%extent)
   end function off_weight

   !> Go on from a converged state with the row weights that it makes
   subroutine iterate_on()
      now%limit = self%iterations + self%max_iterations
      self%step_norm = huge(1.0_wp)
      now%left = huge(1.0_wp)
      now%still = .false.
      now%rejected = 0
      now%damping = damping_type()
      call weigh()
   end subroutine iterate_on

   !> Take the row weights from the state
   subroutine weigh()
      now%weighings = now%weighings + 1
      if (allocated(last_step)) deallocate (last_step)
      now%weighed = a
      call problem%start(a, load, .false.)
      call linearise()
   end subroutine weigh

   !> Correct a step by further ones with its factor, each of which takes a fifth of the time or
   !> less. What is left by the last one is as if a step of Newton of that size had left it.
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
            ! stiff motions need a second one
            if (k /= 2 .and. self%step_norm < merge(near, self%tolerance, now%passes)) exit
            call matrix%solve_square(0.0_wp, -r, da, report, failure)
            if (allocated(failure)) exit
            trial = a + da
            call problem%evaluate(trial, load, new, seen)
            size_now = maxval(problem%scaled_norms(da)/now%extent)
            ! on the way what does not end it would spoil the pressures of the next tangent
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

   !> Gradient and residual at a
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

   !> Where residuals remain, steps of Gauss-Newton may overshoot and alternate. The secant of the
   !> last two, in the metric of A^T A, says by what share
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

   !> Search along the step, take what it finds and learn from it
   subroutine take_step()
      real(wp) :: moved(2), scale, gain, highest
      logical :: ahead, blind, definite

      call system_clock(clock)
      now%left = predicted/max(0.5_wp*merit**2, tiny(1.0_wp))
      ! neither the jump at the start of a load step nor rounding says anything about the step
      blind = self%iterations == 1 .or. now%left < nothing &
         & .or. (problem%extent > 0.0_wp .and. all(problem%scaled_norms(da) <= rounding))
      moved = problem%scaled_norms(da)
      ! a step along a soft mode strains stiff ones, as bending stretches a column, and the next
      ! step corrects that: residuals need not fall from step to step
      definite = problem%square .and. it%solver%used == 'cholesky'
      highest = merit
      if (definite) highest = maxval(now%past, mask=now%past < huge(1.0_wp))
      ! of a state in the midst of the iteration the tangent is wanted next
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
         ! see whether a whole step would move
         if (now%left < nothing) now%damping%lambda = 0.0_wp
      else
         ! back to where the step began, with more damping
         now%rejected = now%rejected + 1
         call now%damping%reject()
         call problem%evaluate(a, load, r, self%state, tangent=.true.)
      end if
      if (self%iterations == 1) then
         now%extent = problem%scaled_norms(a)
         ! a pressure may be none; then strain times the shear modulus is what it is small against
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

!> The next step of an iteration whose steps are solved to few digits, predicted from what is left
!> of the residual: it need not be made only to see that it is small
subroutine predict_step(self, now)
   !> Iteration, whose state is linearised
   type(newton_type), intent(inout) :: self
   type(progress_type), intent(inout) :: now
   real(wp) :: before

   before = now%promised
   now%promised = self%state%size
   if (self%iterations == 0 .or. .not. now%whole) return
   ! a step that was not made is never called rounding: the forces must balance as well
   if (self%step_norm > rounding) self%step_norm = max(rounding, min(1.0_wp, caution*now%promised &
      & /before)*self%step_norm)
end subroutine predict_step

!> Start of a load step: the last converged state, or where the way through the last ones leads to
!> if that has less residual. The gradient that ends the iteration is relative to that of the last
!> converged state either way: a good start must not ask for a better end.
subroutine begin(self, problem, load, a, r, first_gradient)
   !> Settings; the state that is seen
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
   ! the start will have another matrix
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
   ! a journal may name no load before the last one
   if (problem%inexact .and. .not. abs(self%done - self%path%earlier) > 0.0_wp) return
   state = self%state
   call self%path%lead(problem, self%done, load, a, r, state, found)
   if (found) then
      self%state = state
   else
      call problem%evaluate(a, load, r, self%state, .true., lifted=self%done)
   end if
end subroutine begin

!> Reasons to end without convergence
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

!> Both criteria, or a step at the level of rounding, or a small step with nothing left to gain
pure logical function converged(self, now, inexact)
   type(newton_type), intent(in) :: self
   type(progress_type), intent(in) :: now
   !> Steps are solved to few digits: what they promise does not say that the forces balance
   logical, intent(in) :: inexact

   converged = self%iterations > 0 .and. self%step_norm < self%tolerance
   if (converged) converged = (now%whole .and. (self%step_norm < rounding &
      & .or. self%gradient < now%balance .or. (now%left < nothing .and. .not. inexact))) &
      ! a full Newton step may end where rounding keeps every further one from being accepted
      & .or. self%gradient < rounding
   converged = converged .or. (self%iterations > 0 .and. now%whole .and. now%still) &
      & .or. (now%first_step < self%tolerance .and. now%whole .and. self%step_norm < stands)
   ! where rounding lets no step through, the last one is damped without an end
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
