!> Step of one iteration: Gauss-Newton by least squares, Newton or a damped step by Cholesky; of a
!> square problem, and of a linear one, the solution of its equations.
module rk_newton_step
   use, intrinsic :: ieee_arithmetic, only : ieee_quiet_nan, ieee_value
   use, intrinsic :: iso_fortran_env, only : int64
   use rk_clock, only : tick, timer_type
   use rk_damping, only : damping_type
   use rk_envelope, only : envelope_type
   use rk_error, only : error_type, fatal_error, err_linalg
   use rk_lstsq, only : lstsq_report, solve_lstsq
   use rk_operator, only : square_operator
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type, problem_type
   use rk_recorder, only : iteration_type, recorder_type, step_type
   use rk_shifted, only : shifted_report, solve_shifted
   use rk_text, only : to_text
   implicit none
   private

   public :: find_step, solve_equations, solve_linear

contains

!> Step of the chosen matrix
subroutine find_step(problem, linear, load, a, r, g, damping, da, newton, predicted, factor, &
   & factored, report, error)
   !> Problem, linearised at a
   class(problem_type), target, intent(inout) :: problem
   !> Least squares solver, one of solver_names
   character(len=*), intent(in) :: linear
   !> Load [-]
   real(wp), intent(in) :: load
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: a(:)
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> A^T r, shape (n)
   real(wp), contiguous, intent(in) :: g(:)
   type(damping_type), intent(inout) :: damping
   !> Step, shape (n)
   real(wp), contiguous, intent(inout) :: da(:)
   !> The matrix has second derivatives
   logical, intent(out) :: newton
   !> Fall of r.r/2 that the quadratic model promises
   real(wp), intent(out) :: predicted
   !> Factor of A^T A, where the least squares solver made one
   type(envelope_type), intent(inout) :: factor
   !> There is such a factor of this step
   logical, intent(out) :: factored
   type(lstsq_report), intent(out) :: report
   !> Error handling: failed factorisation
   type(error_type), allocatable, intent(out) :: error
   type(shifted_report) :: shifted
   real(wp), allocatable :: matrix(:, :)

   factored = .false.
   predicted = 0.0_wp
   newton = damping%curved .and. .not. problem%square
   if (newton .or. (damping%lambda > 0.0_wp .and. .not. problem%square)) then
      allocate (matrix(problem%n, problem%n))
      if (newton) then
         call problem%hessian(a, load, r, matrix)
      else
         call problem%linearised%normal(matrix)
      end if
      call solve_shifted(matrix, g, &
         & damping%method == 'full' .or. damping%lambda > 0.0_wp, &
         & damping%lambda, da, shifted, error)
      if (allocated(error)) return
      predicted = shifted%predicted
      report%square_report = shifted%square_report
      if (newton) then
         report%used = 'newton'
         report%why = 'second derivatives of the residuals make the matrix symmetric but no ' &
            & //'product A^T A, so there is no QR: Cholesky with a shift of '
      else
         report%used = 'damped'
         report%why = 'Gauss-Newton diverged or met a kink: normal equations with a shift of '
      end if
      report%why = report%why//to_text(damping%lambda, 2)
      deallocate (matrix)
      newton = newton .and. (shifted%positive .or. damping%lambda > 0.0_wp)
   end if
   if (problem%square .or. .not. (newton .or. damping%lambda > 0.0_wp)) then
      call solve_equations(problem, linear, damping%lambda, -r, da, report, error, factor)
      if (allocated(error)) return
      predicted = -0.5_wp*dot_product(g, da)
      if (problem%square) return
      factored = any(report%used == ['normal ', 'refined'])
      damping%rcond = report%rcond
   end if
end subroutine find_step

!> Solve A x = b as it is, or in the least squares sense where it has more equations than unknowns
subroutine solve_equations(problem, linear, shift, b, x, report, error, factor)
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
   !> Factor of A^T A, where the least squares solver makes one
   type(envelope_type), intent(inout), optional :: factor

   if (problem%square) then
      select type (op => problem%linearised)
      class is (square_operator)
         call op%solve_square(shift, b, x, report%square_report, error)
      end select
   else
      call solve_lstsq(problem%linearised, b, linear, x, report, error, factor)
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
      call fatal_error(error, err_linalg, 'the solution holds numbers that are not finite: loads ' &
         & //'or stiffnesses leave the range of numbers; compare them and their unit')
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
