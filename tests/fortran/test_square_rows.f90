!> Sparse square matrices without symmetry against dense ones; TAP for `meson test`.
program test_square_rows
   use rk_error, only : error_type
   use rk_operator, only : square_report
   use rk_precision, only : i8, wp
   use rk_square_rows, only : new_square_rows, square_rows
   use tap, only : check, finish
   implicit none
   integer, parameter :: n = 30

   call test_products
   call test_solution
   call finish()

contains

!> A matrix whose row i has columns i - 2, i and i + 5; the last rows have no diagonal
subroutine make(matrix, full)
   !> Matrix
   type(square_rows), intent(out) :: matrix
   !> The same, dense
   real(wp), intent(out) :: full(n, n)
   integer(i8) :: start(n + 1)
   integer(i8), allocatable :: column(:)
   integer, parameter :: apart(3) = [-2, 0, 5]
   integer :: c, i, k

   full = 0.0_wp
   do i = 1, n
      do k = 1, 3
         c = i + apart(k)
         if (c < 1 .or. c > n .or. (i > n - 2 .and. c == i)) cycle
         full(i, c) = 1.0_wp + 0.1_wp*modulo(7*i + 3*c, 11)
      end do
   end do
   full(n - 1:, 1:2) = reshape([2.0_wp, 0.0_wp, 0.0_wp, 3.0_wp], [2, 2])
   start(1) = 0
   allocate (column(0))
   do i = 1, n
      column = [column, pack([(int(c, i8), c=0, n - 1)], abs(full(i, :)) > 0.0_wp)]
      start(i + 1) = size(column, kind=i8)
   end do
   call new_square_rows(matrix, start, column)
   do i = 1, n
      matrix%value(start(i) + 1:start(i + 1)) = full(i, column(start(i) + 1:start(i + 1)) + 1)
   end do
end subroutine make

!> Products with both factors, and all entries
subroutine test_products
   type(square_rows) :: matrix
   real(wp) :: full(n, n), dense(n, n), x(n), y(n)
   integer :: i

   call make(matrix, full)
   x = [(sin(real(i, wp)), i=1, n)]
   call matrix%apply(x, y)
   call check('A x', all(abs(y - matmul(full, x)) < 1.0e-14_wp*n))
   call matrix%apply_transposed(x, y)
   call check('A^T x', all(abs(y - matmul(x, full)) < 1.0e-14_wp*n))
   call matrix%dense(dense)
   call check('entries', all(abs(dense - full) <= 0.0_wp))
end subroutine test_products

!> Solution, damped or not
subroutine test_solution
   type(square_rows) :: matrix
   type(square_report) :: report
   type(error_type), allocatable :: error
   real(wp) :: full(n, n), x(n), y(n), b(n)
   integer :: i

   call make(matrix, full)
   b = [(cos(real(i, wp)), i=1, n)]
   call matrix%solve_square(0.0_wp, b, x, report, error)
   call check('solved', .not. allocated(error))
   call check('A x = b', maxval(abs(matmul(full, x) - b)) < 1.0e-12_wp)
   call check('backward error', report%backward_error < 1.0e-15_wp)
   call matrix%solve_square(0.5_wp, b, y, report, error)
   do i = 1, n
      full(i, i) = 1.5_wp*full(i, i)
   end do
   call check('(A + D/2) x = b', maxval(abs(matmul(full, y) - b)) < 1.0e-12_wp)
end subroutine test_solution

end program test_square_rows
