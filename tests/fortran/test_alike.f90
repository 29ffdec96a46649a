!> Rows that are alike, and products of sparse rows; TAP for `meson test`.
program test_alike
   use rk_alike, only : find_alike
   use rk_precision, only : i8, wp
   use rk_sparse_rows, only : new_sparse_rows, sparse_rows
   use tap, only : check, finish
   implicit none

   call test_find
   call test_products
   call finish()

contains

!> Rounding makes no difference, anything else does
subroutine test_find
   integer, allocatable :: same(:)
   real(wp), parameter :: value(20) = [1.0_wp, 2.0_wp, 3.0_wp, &
      & 1.0_wp, 2.0_wp*(1.0_wp + 1.0e-14_wp), 3.0_wp, &
      & 1.0_wp, 2.0_wp, &
      & 1.0_wp, 2.0_wp, 3.0_wp + 1.0e-8_wp, &
      & 3.0_wp, 2.0_wp, 1.0_wp, &
      & 1.0_wp, 2.0_wp, &
      & 1.0_wp, 2.0_wp, 3.0_wp, &
      & 0.0_wp]
   integer(i8), parameter :: first(8) = [0_i8, 3_i8, 6_i8, 8_i8, 11_i8, 14_i8, 16_i8, 19_i8]

   call find_alike(first, [3_i8, 3_i8, 2_i8, 3_i8, 3_i8, 2_i8, 3_i8, 0_i8], value, same)
   call check('the first row like each one', all(same == [1, 1, 3, 4, 5, 3, 1, 8]))
end subroutine test_find

!> Second differences: of one vector, of two and of three the same products
subroutine test_products
   integer, parameter :: n = 1500
   type(sparse_rows) :: rows
   integer(i8) :: start(n + 1), column(3*n)
   real(wp) :: value(3*n), x(3, n), y(3, n), z(3, n)
   integer :: i, k

   ! zeros beyond the ends are left out
   do i = 1, n
      column(3*i - 2:3*i) = modulo([i - 2, i - 1, i], n)
      value(3*i - 2:3*i) = [-1.0_wp, 2.0_wp, -1.0_wp]
   end do
   value(1) = 0.0_wp
   value(3*n) = 0.0_wp
   start = [(3*i, i=0, n)]
   x = reshape([(sin(real(i, wp)), i=1, 3*n)], [3, n])
   call new_sparse_rows(rows, start, column, value)
   call rows%product(x, y, .false.)
   call check('zeros are left out', size(rows%value) == 3*n - 2)
   do k = 1, 3
      z = 0.0_wp
      call rows%product(x(:k, :), z(:k, :), .false.)
      call check('products as before', .not. any(abs(z(:k, :) - y(:k, :)) > 0.0_wp))
   end do
end subroutine test_products

end program test_alike
