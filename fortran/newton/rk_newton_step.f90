!> Step of one iteration: least squares, damped by Cholesky; of a square problem, and of a linear
!> one, the solution of its equations.
module rk_newton_step
   use, intrinsic :: ieee_arithmetic, only : ieee_quiet_nan, ieee_value
   use, intrinsic :: iso_fortran_env, only : int64
   use rk_clock, only : tick, timer_type
   use rk_envelope, only : envelope_type
   use rk_error, only : error_type, fatal_error, err_linalg
   use rk_lstsq, only : lstsq_report, solve_lstsq
   use rk_operator, only : row_operator, shortest, square_operator
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type, problem_type
   use rk_recorder, only : iteration_type, recorder_type, step_type
   use rk_text, only : to_text
   implicit none
   private

   public :: find_step, solve_linear

contains

!> Step of least squares, or of the equations of a square problem
subroutine find_step(problem, linear, shift, r, g, da, predicted, report, error)
   !> Problem, linearised
   class(problem_type), intent(in) :: problem
   !> Least squares solver, one of solver_names
   character(len=*), intent(in) :: linear
   !> Damping in units of the diagonal, >= 0 [-]
   real(wp), intent(in) :: shift
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> A^T r, shape (n)
   real(wp), contiguous, intent(in) :: g(:)
   !> Step, shape (n)
   real(wp), contiguous, intent(inout) :: da(:)
   !> Fall of r.r/2 predicted by the quadratic model
   real(wp), intent(out) :: predicted
   type(lstsq_report), intent(out) :: report
   !> Error handling: failed factorisation
   type(error_type), allocatable, intent(out) :: error

   if (shift > 0.0_wp .and. .not. problem%square) then
      call solve_damped(problem%linearised, shift, g, da, predicted, report, error)
   else
      call solve_equations(problem, linear, shift, -r, da, report, error)
      predicted = -0.5_wp*dot_product(g, da)
   end if
end subroutine find_step

!> Solve (A^T A + shift D) x = -g with the diagonal D of A^T A
subroutine solve_damped(op, shift, g, x, predicted, report, error)
   class(row_operator), intent(in) :: op
   !> Damping in units of the diagonal, > 0 [-]
   real(wp), intent(in) :: shift
   !> A^T r, shape (n)
   real(wp), contiguous, intent(in) :: g(:)
   !> Step, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> Fall of r.r/2 predicted by the quadratic model
   real(wp), intent(out) :: predicted
   type(lstsq_report), intent(out) :: report
   !> Error handling: an unknown in no equation, no memory
   type(error_type), allocatable, intent(out) :: error
   type(envelope_type) :: factor
   real(wp) :: image(op%m), left(op%n)

   report%used = 'damped'
   report%why = 'Gauss-Newton diverged or met a kink: normal equations with a shift of ' &
      & //to_text(shift, 2)
   call op%envelope(factor, error)
   if (allocated(error)) return
   call factor%equilibrate()
   if (.not. all(factor%scale > 0.0_wp)) then
      call fatal_error(error, err_linalg, 'a column of the equations is zero or not finite')
      return
   end if
   call factor%shift(shift)
   call factor%factorise(error)
   if (allocated(error)) return
   x = -g/factor%scale
   call factor%solve(x)
   x = x/factor%scale
   predicted = 0.5_wp*(shift*sum((factor%scale*x)**2) - dot_product(g, x))
   call op%apply(x, image)
   call op%apply_transposed(image, left)
   left = left + shift*factor%scale**2*x + g
   report%backward_error = norm2(left/factor%scale) &
      & /max(norm2(factor%scale*x)*sqrt(real(op%n, wp)), tiny(1.0_wp))
   call shortest(op, factor, left, report%rcond)
   report%rcond = report%rcond/sqrt(real(op%n, wp))
end subroutine solve_damped

!> Solve A x = b, in the least squares sense where it has more equations than unknowns
subroutine solve_equations(problem, linear, shift, b, x, report, error)
   !> Problem, linearised
   class(problem_type), intent(in) :: problem
   !> Least squares solver, one of solver_names
   character(len=*), intent(in) :: linear
   !> Damping of square equations in units of the diagonal, >= 0 [-]
   real(wp), intent(in) :: shift
   !> Right hand side, shape (m)
   real(wp), contiguous, intent(in) :: b(:)
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   type(lstsq_report), intent(out) :: report
   !> Error handling: rank deficient, fewer rows than columns
   type(error_type), allocatable, intent(out) :: error

   if (problem%square) then
      select type (op => problem%linearised)
      class is (square_operator)
         call op%solve_square(shift, b, x, report%square_report, error)
      end select
   else
      call solve_lstsq(problem%linearised, b, linear, x, report, error)
   end if
end subroutine solve_equations

!> Solve a linear problem by one assembly and one solve, and hand over the only state
subroutine solve_linear(problem, method, x, recorder, timer, error)
   !> Problem whose rows do not depend on the unknowns
   class(problem_type), target, intent(inout) :: problem
   !> Least squares solver, one of solver_names
   character(len=*), intent(in) :: method
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   class(recorder_type), intent(inout) :: recorder
   type(timer_type), intent(inout) :: timer
   !> Error handling: rank deficient, fewer rows than columns
   type(error_type), allocatable, intent(out) :: error
   type(iteration_type) :: it
   type(evaluation_type) :: state
   real(wp), allocatable :: r(:), g(:)
   real(wp) :: first_gradient, none
   integer(int64) :: clock

   allocate (r(problem%m), g(problem%n))
   x = 0.0_wp
   call system_clock(clock)
   call problem%start(x, 1.0_wp, .false.)
   call problem%evaluate(x, 1.0_wp, r, state, tangent=.true.)
   timer%assemble = tick(clock)
   call problem%linearised%apply_transposed(r, g)
   first_gradient = max(norm2(g), tiny(1.0_wp))
   r = -r
   call system_clock(clock)
   call solve_equations(problem, method, 0.0_wp, r, x, it%solver, error)
   timer%solve = tick(clock)
   if (allocated(error)) return
   ! comparisons that a NaN fails
   if (.not. all(abs(x) <= huge(1.0_wp))) then
      call fatal_error(error, err_linalg, 'the solution contains NaN or infinite values: loads ' &
         & //'or stiffnesses exceed the floating-point range; check them and their units')
      return
   end if
   call problem%evaluate(x, 1.0_wp, r, state)
   call problem%linearised%apply_transposed(r, g)
   it%step = 1
   it%load = 1.0_wp
   it%iteration = 1
   it%residual = norm2(r)
   it%gradient = norm2(g)
   it%seconds = tick(timer%start)
   call recorder%iteration(it)
   ! small strains have no volume ratio
   none = ieee_value(none, ieee_quiet_nan)
   call recorder%step(step_type(step=1, steps=1, load=1.0_wp, iterations=1, &
      & gradient=it%gradient/first_gradient, min_j=none, max_j=none), x)
end subroutine solve_linear

end module rk_newton_step
