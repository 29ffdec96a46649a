!> Least squares of a dense matrix: solution; then backward error, distance to the best fit over
!> the residual, reciprocal condition, refinement iterations; method used and why
subroutine least_squares(m, n, a, b, method, x, numbers, used, why, stat, message)
   use rk_error, only : error_type, pack_error
   use rk_lstsq, only : lstsq_report, solve_lstsq
   use rk_matrix, only : matrix_rows
   implicit none
   !f2py threadsafe
   integer, intent(in) :: m, n
   double precision, intent(in) :: a(m, n), b(m)
   character(len=*), intent(in) :: method
   double precision, intent(out) :: x(n), numbers(4)
   character(len=16), intent(out) :: used
   character(len=1024), intent(out) :: why
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(lstsq_report) :: report
   type(matrix_rows) :: op

   x = 0
   numbers = 0
   used = ''
   why = ''
   op%m = m
   op%n = n
   op%a = a
   call solve_lstsq(op, b, method, x, report, error)
   call pack_error(error, stat, message)
   if (stat /= 0) return
   numbers = [report%backward_error, report%misfit, report%rcond, dble(report%iterations)]
   used = report%used
   why = report%why
end subroutine least_squares
