!> Step of one iteration: Gauss-Newton by least squares, Newton or a damped step by Cholesky; of a
!> square problem, and of a linear one, the solution of its equations.
module rk_newton_step
   use rk_damping, only : damping_type
   use rk_error, only : error_type
   use rk_factors, only : envelope_factor
   use rk_lstsq, only : lstsq_report, row_operator, solve_lstsq
   use rk_operator, only : solve_as_it_is, square_report
   use rk_precision, only : wp
   use rk_problem, only : problem_type
   use rk_recorder, only : iteration_type
   use rk_shifted, only : shifted_report, solve_shifted
   use rk_text, only : to_text
   implicit none
   private

   public :: find_step, solve_equations

contains

!> Step of the chosen matrix
subroutine find_step(problem, op, linear, load, a, r, g, damping, da, newton, predicted, factor, &
   & factored, it, error)
   !> Problem, linearised at a
   class(problem_type), target, intent(inout) :: problem
   class(row_operator), intent(inout) :: op
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
   type(envelope_factor), intent(inout) :: factor
   !> There is such a factor of this step
   logical, intent(out) :: factored
   !> Record of the iteration: the solver's part
   type(iteration_type), intent(inout) :: it
   !> Error handling: failed factorisation
   type(error_type), allocatable, intent(out) :: error
   type(shifted_report) :: shifted
   real(wp), allocatable :: matrix(:, :)

   it%refinements = 0
   it%misfit = 0.0_wp
   factored = .false.
   predicted = 0.0_wp
   newton = damping%curved .and. .not. problem%square
   if (newton .or. (damping%lambda > 0.0_wp .and. .not. problem%square)) then
      allocate (matrix(problem%n, problem%n))
      if (newton) then
         call problem%hessian(a, load, r, matrix)
      else
         call op%normal(matrix)
      end if
      call solve_shifted(matrix, g, &
         & damping%method == 'full' .or. damping%lambda > 0.0_wp, &
         & damping%lambda, da, shifted, error)
      if (allocated(error)) return
      predicted = shifted%predicted
      it%backward_error = shifted%backward_error
      it%rcond = shifted%rcond
      if (newton) then
         it%solver = 'newton'
         it%why = 'second derivatives of the residuals make the matrix symmetric but no product ' &
            & //'A^T A, so there is no QR: Cholesky with a shift of '
      else
         it%solver = 'damped'
         it%why = 'Gauss-Newton diverged or met a kink: normal equations with a shift of '
      end if
      it%why = it%why//to_text(damping%lambda, 2)
      deallocate (matrix)
      newton = newton .and. (shifted%positive .or. damping%lambda > 0.0_wp)
   end if
   if (problem%square .or. .not. (newton .or. damping%lambda > 0.0_wp)) then
      call solve_equations(problem, op, linear, damping%lambda, -r, da, it, error, factor)
      if (allocated(error)) return
      predicted = -0.5_wp*dot_product(g, da)
      if (problem%square) return
      factored = any(it%solver == ['normal ', 'refined'])
      damping%rcond = it%rcond
   end if
end subroutine find_step

!> Solve A x = b as it is, or in the least squares sense where it has more equations than unknowns
subroutine solve_equations(problem, op, linear, shift, b, x, it, error, factor)
   class(problem_type), intent(in) :: problem
   class(row_operator), target, intent(inout) :: op
   !> Least squares solver, one of solver_names
   character(len=*), intent(in) :: linear
   !> Damping of square equations in units of the diagonal, >= 0 [-]
   real(wp), intent(in) :: shift
   !> Right hand side, shape (m)
   real(wp), contiguous, intent(in) :: b(:)
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> Record of the iteration: the solver's part
   type(iteration_type), intent(inout) :: it
   !> Error handling: rank deficient, fewer rows than columns
   type(error_type), allocatable, intent(out) :: error
   !> Factor of A^T A, where the least squares solver makes one
   type(envelope_factor), intent(inout), optional :: factor
   type(lstsq_report) :: report
   type(square_report) :: square

   if (problem%square) then
      call solve_as_it_is(op, shift, b, x, square, error)
      if (allocated(error)) return
      it%backward_error = square%backward_error
      it%rcond = square%rcond
      it%solver = square%used
      it%refinements = square%iterations
      it%why = square%why
      it%indefinite = square%indefinite
   else
      call solve_lstsq(op, b, linear, x, report, error, factor)
      if (allocated(error)) return
      it%backward_error = report%backward_error
      it%misfit = report%misfit
      it%rcond = report%rcond
      it%solver = trim(report%used)
      it%refinements = report%iterations
      it%why = report%why
   end if
end subroutine solve_equations

end module rk_newton_step
