!> The least squares ladder on matrices with known answers; TAP for `meson test`.
program test_lstsq
   use, intrinsic :: ieee_arithmetic, only : ieee_invalid, ieee_quiet_nan, &
      & ieee_set_flag, ieee_set_halting_mode, ieee_value
   use rk_error, only : err_input, err_linalg, error_type
   use rk_lstsq, only : lstsq_report, solve_lstsq, solver_names
   use rk_matrix, only : matrix_rows
   use rk_precision, only : i8, wp
   use tap, only : check, finish
   implicit none

   !> Rows and columns, enough for several blocks of the envelope
   integer, parameter :: rows = 500, columns = 300
   integer(i8), save :: state = 1
   integer :: k

   do k = 1, size(solver_names)
      call test_answer(trim(solver_names(k)))
      call test_large_condition(trim(solver_names(k)))
      call test_light_rows(trim(solver_names(k)))
      call test_undetermined(trim(solver_names(k)))
      call test_refused(trim(solver_names(k)))
      call test_condition(trim(solver_names(k)))
   end do
   call test_refined_by_itself
   call finish()

contains

!> The error of x is bounded by rounding times the condition, squared where residuals count. Bits on
!> one and two threads: tests/unit/test_interrupts.py
subroutine test_answer(name)
   character(len=*), intent(in) :: name
   real(wp), parameter :: condition = 1.0e3_wp
   real(wp), allocatable :: a(:, :)
   real(wp) :: b(rows), x(columns), found(columns)
   type(lstsq_report) :: report
   type(error_type), allocatable :: error

   allocate (a(rows, columns))
   call problem(condition, 1.0_wp, a, b, x)
   call solve(a, b, name, found, report, error)
   call check(name//' finds the answer', norm2(found - x) &
      & < 100*epsilon(1.0_wp)*condition**2*norm2(x))
   call check(name//' has its backward error', report%backward_error > 0.0_wp &
      & .and. report%backward_error < 1.0e-14_wp)
   call check(name//' says what was used', any(report%used == [character(len=13) :: name, &
      & name(index(name, '-') + 1:), 'refined']) &
      & .or. (name == 'auto' .and. len(report%why) > 0))
end subroutine test_answer

!> At 1e7 normal equations keep no digit; the others are at the level of QR: the residual of a fit
!> is longer than the best one by the square of its distance
subroutine test_large_condition(name)
   character(len=*), intent(in) :: name
   real(wp), allocatable :: a(:, :)
   real(wp) :: b(rows), x(columns), found(columns), across(rows)
   type(lstsq_report) :: report
   type(error_type), allocatable :: error

   if (name == 'normal') return
   allocate (a(rows, columns))
   call problem(1.0e7_wp, 1.0_wp, a, b, x, across)
   call solve(a, b, name, found, report, error)
   call check(name//' at condition 1e7', norm2(matmul(a, found) - b) &
      & < norm2(across)*(1.0_wp + 1.0e-12_wp))
   call check(name//' is near the best fit', report%misfit < 1.0e-8_wp &
      & .and. report%backward_error < 1.0e-12_wp)
end subroutine test_large_condition

!> Normal equations square the condition, which shows where the residual is small
subroutine test_refined_by_itself
   real(wp), allocatable :: a(:, :)
   real(wp) :: b(rows), x(columns), found(columns)
   type(lstsq_report) :: report
   type(error_type), allocatable :: error

   allocate (a(rows, columns))
   call problem(1.0e6_wp, 1.0e-6_wp, a, b, x)
   call solve(a, b, 'normal', found, report, error)
   call check('normal equations that miss are refined', report%used == 'refined' &
      & .and. index(report%why, 'normal reached') > 0 .and. report%iterations > 0)
end subroutine test_refined_by_itself

!> Rows weighted 1e10 fix two combinations of the unknowns; the light rows fix the rest. The answer
!> is their fit within the constraints, up to the inverse of the weight
subroutine test_light_rows(name)
   character(len=*), intent(in) :: name
   real(wp), parameter :: heavy = 1.0e10_wp
   real(wp) :: a(42, 6), b(42), x(6), v(6), found(6)
   type(lstsq_report) :: report
   type(error_type), allocatable :: error

   a = 0.0_wp
   call problem(10.0_wp, 1.0_wp, a(:40, 3:), b(:40), x(3:))
   call fill(a(:40, 1))
   call fill(a(:40, 2))
   call fill(x(:2))
   b(:40) = b(:40) + matmul(a(:40, :2), x(:2))
   a(41, 1) = heavy
   a(42, 2) = heavy
   b(41:) = heavy*x(:2)
   ! no unknown stands alone in a row
   call fill(v)
   a = a - 2.0_wp*spread(matmul(a, v), 2, 6)*spread(v, 1, 42)/sum(v**2)
   x = x - 2.0_wp*v*dot_product(v, x)/sum(v**2)
   call solve(a, b, name, found, report, error)
   call check(name//': light rows count', norm2(found - x) < 1.0e-4_wp*norm2(x))
end subroutine test_light_rows

!> Two columns that differ by a factor: their unknowns, and no others, are undetermined. DGELSY
!> gives the smallest solution: with columns of the same norm scaling does not change which
subroutine test_undetermined(name)
   character(len=*), intent(in) :: name
   real(wp) :: a(60, 20), b(60), x(20), found(20)
   type(lstsq_report) :: report
   type(error_type), allocatable :: error

   call problem(10.0_wp, 1.0_wp, a, b, x)
   a(:, 14) = a(:, 5)*merge(1.0_wp, 3.0_wp, name == 'dgelsy')
   call solve(a, b, name, found, report, error)
   if (name == 'dgelsy') then
      call check('the smallest solution', abs(found(14) - found(5)) < 1.0e-10_wp*abs(found(5)) &
         & .and. norm2(matmul(matmul(a, found) - b, a)) < 1.0e-12_wp*norm2(b))
      call check('its rank', index(report%why, 'rank 19 of 20') > 0)
   else
      call check(name//' names what is undetermined', refused(error, err_linalg, 'rank 19 of 20') &
         & .and. refused(error, err_linalg, 'unknown 5 of 20') &
         & .and. refused(error, err_linalg, 'unknown 14 of 20'))
   end if
end subroutine test_undetermined

!> A column of zeros, a NaN, and a solver that does not exist
subroutine test_refused(name)
   character(len=*), intent(in) :: name
   real(wp) :: a(60, 20), b(60), x(20), found(20), own(60)
   type(lstsq_report) :: report
   type(error_type), allocatable :: error

   call problem(10.0_wp, 1.0_wp, a, b, x)
   own = a(:, 8)
   a(:, 8) = 0.0_wp
   call solve(a, b, name, found, report, error)
   call check(name//': a column of zeros', refused(error, err_input, &
      & 'unknown 8 of 20 appears in no equation'))
   a(:, 8) = own
   a(4, 8) = ieee_value(own(1), ieee_quiet_nan)
   ! checked builds stop at a comparison with it
   call ieee_set_halting_mode(ieee_invalid, .false.)
   call solve(a, b, name, found, report, error)
   call ieee_set_flag(ieee_invalid, .false.)
   call check(name//': not a number', refused(error, err_linalg, 'NaN or infinite'))
   call solve(a, b, name//'x', found, report, error)
   call check(name//'x is no solver', refused(error, err_input, 'unknown least squares solver'))
end subroutine test_refused

!> Unit columns at right angles but for two, at 1e-4: the smallest singular value is that over the
!> root of 2
subroutine test_condition(name)
   character(len=*), intent(in) :: name
   real(wp), parameter :: angle = 1.0e-4_wp
   real(wp) :: a(60, 20), b(60), x(20), found(20), right
   type(lstsq_report) :: report
   type(error_type), allocatable :: error

   call problem(1.0_wp, 1.0_wp, a, b, x)
   a(:, 2) = cos(angle)*a(:, 1) + sin(angle)*a(:, 2)
   call solve(a, b, name, found, report, error)
   right = angle/sqrt(2.0_wp)/sqrt(20.0_wp)
   call check(name//' estimates the condition', report%rcond < 3.0_wp*right*sqrt(20.0_wp) &
      & .and. report%rcond > right/30.0_wp)
end subroutine test_condition

!> Matrix with given condition, a right hand side that it does not meet, and the best fit: exact to
!> rounding, for b is the image of x and a vector across the range of a
subroutine problem(condition, residual, a, b, x, across)
   real(wp), intent(in) :: condition
   !> Size of the entries across the range
   real(wp), intent(in) :: residual
   real(wp), intent(out) :: a(:, :), b(:), x(:)
   !> What the best fit leaves of b
   real(wp), intent(out), optional :: across(:)
   real(wp) :: rest(size(b)), u(size(b)), v(size(x))
   integer :: i, n

   n = size(x)
   a = 0.0_wp
   do i = 1, n
      a(i, i) = condition**(-real(i - 1, wp)/(n - 1))
   end do
   rest = 0.0_wp
   call fill(rest(n + 1:))
   rest = residual*rest
   ! reflections keep lengths and angles
   do i = 1, 3
      call fill(u)
      call fill(v)
      a = a - 2.0_wp*spread(u, 2, n)*spread(matmul(u, a), 1, size(u))/sum(u**2)
      rest = rest - 2.0_wp*u*dot_product(u, rest)/sum(u**2)
      a = a - 2.0_wp*spread(matmul(a, v), 2, n)*spread(v, 1, size(u))/sum(v**2)
   end do
   call fill(x)
   b = matmul(a, x) + rest
   if (present(across)) across = rest
end subroutine problem

!> Numbers from -1 to 1 (Park, Miller, Commun. ACM 31 (1988), doi:10.1145/63039.63042)
subroutine fill(x)
   real(wp), intent(out) :: x(:)
   integer :: i

   do i = 1, size(x)
      state = modulo(16807_i8*state, 2147483647_i8)
      x(i) = 2.0_wp*real(state, wp)/2147483647.0_wp - 1.0_wp
   end do
end subroutine fill

subroutine solve(a, b, name, x, report, error)
   real(wp), intent(in) :: a(:, :)
   real(wp), contiguous, intent(in) :: b(:)
   character(len=*), intent(in) :: name
   real(wp), contiguous, intent(out) :: x(:)
   type(lstsq_report), intent(out) :: report
   type(error_type), allocatable, intent(out) :: error
   type(matrix_rows) :: op

   op%m = size(a, 1)
   op%n = size(a, 2)
   op%a = a
   x = 0.0_wp
   call solve_lstsq(op, b, name, x, report, error)
end subroutine solve

!> Whether an error is of a kind and says something
logical function refused(error, code, words)
   type(error_type), allocatable, intent(in) :: error
   integer, intent(in) :: code
   character(len=*), intent(in) :: words

   refused = allocated(error)
   if (refused) refused = error%code == code .and. index(error%message, words) > 0
end function refused

end program test_lstsq
