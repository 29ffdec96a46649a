!> A linear problem: one assembly, one solve, no iteration and no load steps.
module rk_linear_solve
   use, intrinsic :: ieee_arithmetic, only : ieee_quiet_nan, ieee_value
   use, intrinsic :: iso_fortran_env, only : int64
   use rk_clock, only : tick, timer_type
   use rk_error, only : error_type, fatal_error, err_linalg
   use rk_newton_step, only : solve_equations
   use rk_operator, only : row_operator
   use rk_precision, only : wp
   use rk_problem, only : problem_type, evaluation_type
   use rk_recorder, only : iteration_type, recorder_type, step_type
   implicit none
   private

   public :: solve_linear

contains

!> Solve and hand over the only state
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
   class(row_operator), pointer :: op
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
   op => problem%operator()
   timer%assemble = tick(clock)
   call op%apply_transposed(r, g)
   first_gradient = max(norm2(g), tiny(1.0_wp))
   r = -r
   call system_clock(clock)
   call solve_equations(problem, op, method, 0.0_wp, r, x, it, error)
   timer%solve = tick(clock)
   if (allocated(error)) return
   ! comparisons that a NaN fails
   if (.not. all(abs(x) <= huge(1.0_wp))) then
      call fatal_error(error, err_linalg, 'the solution holds numbers that are not finite: loads ' &
         & //'or stiffnesses leave the range of numbers; compare them and their unit')
      return
   end if
   call problem%evaluate(x, 1.0_wp, r, state)
   call op%apply_transposed(r, g)
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

end module rk_linear_solve
