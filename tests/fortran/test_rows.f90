!> Rows of a collocation matrix against the dense matrix written out by hand; TAP for `meson test`.
program test_rows
   use rk_envelope, only : envelope_type
   use rk_error, only : error_type
   use rk_kernel, only : kernel_quintic, window_product
   use rk_precision, only : i8, wp
   use rk_rows, only : new_rows, rows_type
   use rk_shape, only : approximation_type, new_shape, shape_type
   use tap, only : check, finish
   implicit none

   !> Rounding of sums of some hundred products of numbers of the size 1 to 10
   real(wp), parameter :: tight = 1.0e-10_wp
   integer, parameter :: nd = 2, fields = 3
   type(shape_type), target :: shape
   type(rows_type) :: rows
   real(wp), allocatable :: a(:, :)
   integer :: seed = 1

   call set_up
   call test_products
   call test_written
   call test_squared
   call finish()

contains

!> Places of a lattice, with two blocks at every third place, and the dense matrix
subroutine set_up
   type(error_type), allocatable :: error
   real(wp) :: source(nd, 30), support(nd, 30), place(nd, 99)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer :: at(132), count(132), range(2, 132)
   integer :: b, c, i, k, q

   source = reshape([((real(i, wp), real(k, wp), i=0, 5), k=0, 4)], [nd, 30])
   place = reshape([((0.5_wp*i, 0.5_wp*k, i=0, 10), k=0, 8)], [nd, 99])
   support = 2.6_wp
   call new_shape(shape, approximation_type(2, kernel_quintic, window_product), source, support, &
      & place, error)
   call check('shape functions', .not. allocated(error))
   if (allocated(error)) error stop
   ! behind the blocks of all places those of the boundary, which use values and first derivatives
   at = [[(i, i=1, 99)], [(i, i=1, 99, 3)]]
   count = [spread(nd, 1, 99), spread(1, 1, 33)]
   range(1, :) = 1
   range(1, :99) = 2
   range(2, :99) = shape%nq
   range(2, 100:) = 1 + nd
   call new_rows(rows, shape, fields, at, count, range, place, [1.0_wp, 1.0_wp])
   call check('rows and unknowns', rows%m == 2*99 + 33 .and. rows%n == fields*30)
   allocate (a(rows%m, rows%n), source=0.0_wp)
   do b = 1, size(at)
      call shape%row(at(b), nodes, values)
      do q = range(1, b), range(2, b)
         do c = 1, fields
            do i = 1, count(b)
               rows%coefficient(i, c, q, b) = number()
               do k = 1, size(nodes)
                  associate (entry => a(rows%row(b) + i, fields*(nodes(k) - 1) + c))
                     entry = entry + rows%coefficient(i, c, q, b)*values(q, k)
                  end associate
               end do
            end do
         end do
      end do
   end do
end subroutine set_up

!> A x and A^T y
subroutine test_products
   real(wp) :: x(rows%n), y(rows%m), image(rows%m), back(rows%n)
   integer :: i

   x = [(number(), i=1, rows%n)]
   y = [(number(), i=1, rows%m)]
   call rows%apply(x, image)
   call check('A x', all(abs(image - matmul(a, x)) <= tight))
   call rows%apply_transposed(y, back)
   call check('A^T y', all(abs(back - matmul(y, a)) <= tight))
end subroutine test_products

!> The matrix, dense and in compressed rows
subroutine test_written
   real(wp) :: full(rows%m, rows%n)
   real(wp), allocatable :: value(:)
   integer(i8), allocatable :: start(:), column(:)
   integer(i8) :: k
   integer :: i

   call rows%dense(full)
   call check('dense', all(abs(full - a) <= tight))
   call rows%compressed(start, column, value)
   full = 0.0_wp
   do i = 1, rows%m
      do k = start(i) + 1, start(i + 1)
         full(i, column(k) + 1) = value(k)
      end do
   end do
   call check('compressed', all(abs(full - a) <= tight))
   call check('columns ascend in each row', all([((column(k) < column(k + 1), k=start(i) + 1, &
      & start(i + 1) - 1), i=1, rows%m)]))
end subroutine test_written

!> A^T A, whose order of elimination must not show
subroutine test_squared
   type(envelope_type) :: square
   type(error_type), allocatable :: error
   real(wp) :: x(rows%n), y(rows%n)
   integer :: j

   call rows%envelope(square, error)
   if (.not. allocated(error)) call square%equilibrate()
   if (.not. allocated(error)) call square%factorise(error)
   call check('A^T A has a factor', .not. allocated(error))
   if (allocated(error)) return
   x = [(number(), j=1, rows%n)]
   y = matmul(matmul(a, x), a)/square%scale
   call square%solve(y)
   call check('which solves with it', all(abs(y/square%scale - x) <= 1.0e-8_wp))
end subroutine test_squared

!> Numbers from -1 to 1 without an order that shows
real(wp) function number()
   ! minimal standard generator: Park, Miller, Commun. ACM 31 (1988), doi:10.1145/63039.63042
   seed = int(modulo(16807_i8*seed, 2147483647_i8))
   number = 2.0_wp*real(seed, wp)/2147483647.0_wp - 1.0_wp
end function number

end program test_rows
