!> Gauss-Newton iteration for one load step (5.76), with step control.
!>
!> It stops on the gradient (5.78a) and the step (5.78b), never on the residual, which does not go
!> to zero. A state with a volume ratio J <= 0 is never accepted.
!>
!> Reference: Nocedal, Wright, Numerical Optimization, Springer (2006), chapter 10,
!>            doi:10.1007/978-0-387-40065-5
module rk_newton
   use, intrinsic :: iso_fortran_env, only : int64
   use rk_error, only : error_type, fatal_error, err_convergence, err_stopped
   use rk_lstsq, only : lstsq_report, row_operator, solve_lstsq
   use rk_precision, only : wp
   use rk_problem, only : problem_type, state_type
   use rk_recorder, only : iteration_type, recorder_type
   use rk_text, only : to_text
   implicit none
   private

   public :: newton_type, timer_type, solve_step, tick

   !> Wall times of the parts of a solve [s]
   type :: timer_type
      !> Residuals and rows
      real(wp) :: assemble = 0.0_wp
      !> Least squares
      real(wp) :: solve = 0.0_wp
      !> Clock count at the start
      integer(int64) :: start = 0
   end type timer_type

   !> Settings and outcome of the iteration
   type :: newton_type
      !> Least squares solver, one of solver_names
      character(len=8) :: linear = 'auto'
      !> Tolerance of both criteria [-]
      real(wp) :: tolerance = 1.0e-6_wp
      !> Iterations at most
      integer :: max_iterations = 25
      !> Iterations done
      integer :: iterations = 0
      !> Relative gradient and step reached [-]
      real(wp) :: gradient = 0.0_wp
      real(wp) :: step_norm = 0.0_wp
      !> Volume ratios of the last state
      type(state_type) :: state
   end type newton_type

   !> Step halvings of the line search
   integer, parameter :: max_cuts = 8
   !> A merit that grows by more than this factor after the first iteration means divergence
   real(wp), parameter :: growth = 4.0_wp

contains

!> Seconds since a clock count
real(wp) function tick(since)
   !> Clock count
   integer(int64), intent(in) :: since
   integer(int64) :: now, rate

   call system_clock(now, rate)
   tick = real(now - since, wp)/real(rate, wp)
end function tick

!> Solve one load step; x is changed only on success
subroutine solve_step(self, problem, step, load, x, recorder, timer, error)
   !> Settings and outcome
   type(newton_type), intent(inout) :: self
   !> Problem
   class(problem_type), target, intent(inout) :: problem
   !> Number of the load step, for the record
   integer, intent(in) :: step
   !> Load [-]
   real(wp), intent(in) :: load
   !> Unknowns, start and solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> Receiver of iterations
   class(recorder_type), intent(inout) :: recorder
   !> Wall times
   type(timer_type), intent(inout) :: timer
   !> Error handling: no convergence, failed factorisation, stopped
   type(error_type), allocatable, intent(out) :: error
   class(row_operator), pointer :: op
   type(lstsq_report) :: report
   type(iteration_type) :: it
   real(wp), allocatable :: a(:), da(:), r(:), g(:), trial(:)
   real(wp) :: merit, first_gradient, first_norm, scale
   integer(int64) :: clock

   allocate (a, source=x)
   allocate (da(problem%n), g(problem%n), r(problem%m), trial(problem%n))
   self%iterations = 0
   self%step_norm = huge(1.0_wp)
   call system_clock(clock)
   call problem%start_step(a, load)
   call problem%evaluate(a, load, .true., r, self%state)
   timer%assemble = timer%assemble + tick(clock)
   if (.not. self%state%valid) then
      call fatal_error(error, err_convergence, 'the start of the step is not a valid state: ' &
         & //volume_text(self%state))
      return
   end if
   do
      call system_clock(clock)
      op => problem%operator()
      timer%assemble = timer%assemble + tick(clock)
      call op%apply_transposed(r, g)
      it%gradient = norm2(g)
      merit = norm2(r)
      if (self%iterations == 0) first_gradient = it%gradient
      self%gradient = it%gradient/max(first_gradient, tiny(1.0_wp))
      if (converged(self)) then
         x = a
         return
      end if
      if (recorder%stopped()) then
         call fatal_error(error, err_stopped, 'stopped at load '//to_text(load))
         return
      end if
      if (self%iterations == self%max_iterations) then
         call fatal_error(error, err_convergence, 'no convergence in '//to_text(self%iterations) &
            & //' iterations: relative gradient '//to_text(self%gradient, 2)//', relative step ' &
            & //to_text(self%step_norm, 2)//', '//volume_text(self%state))
         return
      end if

      call system_clock(clock)
      r = -r
      call solve_lstsq(op, r, self%linear, da, report, error)
      timer%solve = timer%solve + tick(clock)
      if (allocated(error)) return
      self%iterations = self%iterations + 1

      call system_clock(clock)
      call search(scale)
      timer%assemble = timer%assemble + tick(clock)
      if (.not. scale > 0.0_wp) then
         call fatal_error(error, err_convergence, 'no step length reduces the residual or keeps ' &
            & //'J > 0: '//volume_text(self%state))
         return
      end if
      a = trial
      if (self%iterations == 1) first_norm = max(norm2(a), tiny(1.0_wp))
      self%step_norm = scale*norm2(da)/first_norm
      it%step = step
      it%load = load
      it%iteration = self%iterations
      it%residual = norm2(r)
      it%step_norm = self%step_norm
      it%min_j = self%state%min_j
      it%max_j = self%state%max_j
      it%backward_error = report%backward_error
      it%rcond = report%rcond
      it%solver = trim(report%used)
      it%refinements = report%iterations
      it%why = report%why
      it%seconds = tick(timer%start)
      call recorder%iteration(it)
   end do

contains

   !> Longest step that keeps J > 0 and does not let the merit grow. Prescribed displacements
   !> jump in the first iteration, where a growing merit is no sign of divergence.
   subroutine search(scale)
      !> Accepted step length, 0 if there is none
      real(wp), intent(out) :: scale
      type(state_type) :: state
      integer :: cut

      scale = 1.0_wp
      do cut = 0, max_cuts
         trial = a + scale*da
         call problem%evaluate(trial, load, .true., r, state)
         self%state = state
         if (state%valid) then
            if (self%iterations == 1 .or. norm2(r) <= growth*merit) return
         end if
         scale = 0.5_wp*scale
      end do
      scale = 0.0_wp
   end subroutine search

end subroutine solve_step

!> Both criteria, or a step at the level of rounding
pure logical function converged(self)
   !> Iteration
   type(newton_type), intent(in) :: self

   converged = self%iterations > 0 .and. (self%step_norm < 1.0e-13_wp .or. &
      & (self%step_norm < self%tolerance .and. self%gradient < self%tolerance))
end function converged

!> Smallest volume ratio and its place
function volume_text(state) result(text)
   !> State
   type(state_type), intent(in) :: state
   character(len=:), allocatable :: text

   text = 'smallest J '//to_text(state%min_j, 4)//' at collocation point '//to_text(state%worst)
end function volume_text

end module rk_newton
