!> Sparse symmetric matrices of blocks against dense ones; TAP for `meson test`.
program test_symmetric
   use rk_csr, only : csr_type
   use rk_error, only : error_type
   use rk_operator, only : square_report
   use rk_precision, only : i8, wp
   use rk_symmetric, only : new_symmetric, symmetric_matrix
   use tap, only : check, finish
   implicit none


   call test_blocks(1)
   call test_blocks(2)
   call test_blocks(3)
   call test_indefinite
   call test_kept_factor
   ! dense columns, and so many operations that a factor has half of the digits
   call test_large_factor(40, 8, 1.0e-11_wp)
   call test_large_factor(100, 120, 1.0e-8_wp)
   call finish()

contains

!> A matrix of overlapping groups: places of entries, sums, rows, products
subroutine test_blocks(block)
   !> Unknowns in a block
   integer, intent(in) :: block
   type(symmetric_matrix) :: matrix
   type(csr_type) :: group
   integer(i8), allocatable :: start(:), column(:)
   real(wp), allocatable :: a(:, :), full(:, :), rows(:, :), value(:), x(:), y(:), part(:, :)
   character(len=:), allocatable :: name
   integer :: g, i, j, k

   name = achar(iachar('0') + block)//' unknowns in a block: '
   ! block 4 meets no other
   group = csr_type([0_i8, 3_i8, 5_i8, 6_i8, 8_i8], [1, 3, 5, 2, 3, 4, 5, 6])
   call new_symmetric(matrix, block, 6, group)
   allocate (full(6*block, 6*block), a(6*block, 6*block), rows(6*block, 6*block), source=0.0_wp)
   do g = 1, 4
      associate (member => group%index(group%offset(g) + 1:group%offset(g + 1)))
         part = symmetric_part(block*size(member), g)
         call matrix%add(matrix%value, member, part)
         associate (at => [((block*(member(k) - 1) + i, i=1, block), k=1, size(member))])
            full(at, at) = full(at, at) + part
         end associate
      end associate
   end do
   call matrix%dense(a)
   call check(name//'sums of dense parts', all(abs(a - full) <= 1.0e-14_wp))
   call matrix%compressed(start, column, value)
   call check(name//'entries of both triangles', size(value) == block**2*16)
   do i = 1, matrix%n
      do k = int(start(i)) + 1, int(start(i + 1))
         rows(i, column(k) + 1) = value(k)
      end do
   end do
   call check(name//'compressed rows', all(abs(rows - full) <= 1.0e-14_wp))
   call check(name//'columns ascend in each row', all([((column(k) < column(k + 1), &
      & k=int(start(i)) + 1, int(start(i + 1)) - 1), i=1, matrix%n)]))
   x = [(real(modulo(7*j, 5) - 2, wp), j=1, matrix%n)]
   allocate (y(matrix%n))
   call matrix%apply(x, y)
   call check(name//'product', all(abs(y - matmul(full, x)) <= 1.0e-12_wp))
end subroutine test_blocks

!> A matrix without a diagonal has no Cholesky factor: LU of its compressed rows solves it
subroutine test_indefinite
   type(symmetric_matrix) :: matrix
   type(square_report) :: report
   type(error_type), allocatable :: error
   real(wp) :: b(4), x(4), full(4, 4)
   real(wp), parameter :: right(4) = [1.0_wp, -2.0_wp, 3.0_wp, 4.0_wp]
   integer :: k

   call new_symmetric(matrix, 1, 4, csr_type([0_i8, 2_i8, 4_i8, 6_i8], [1, 2, 2, 3, 3, 4]))
   do k = 1, 3
      call matrix%add(matrix%value, [k, k + 1], &
         & k*reshape([0.0_wp, 1.0_wp, 1.0_wp, 0.0_wp], [2, 2]))
   end do
   call matrix%dense(full)
   b = matmul(full, right)
   call matrix%solve_square(0.0_wp, b, x, report, error)
   call check('a matrix without a diagonal has a solution', .not. allocated(error))
   if (allocated(error)) return
   call check('not by Cholesky', report%used /= 'cholesky')
   call check('and it is right', all(abs(x - right) <= 1.0e-13_wp))
end subroutine test_indefinite

!> Matrices share the order of elimination, and one without a Cholesky factor does not affect them
subroutine test_kept_factor
   type(symmetric_matrix) :: matrix
   type(square_report) :: report
   type(error_type), allocatable :: error
   real(wp) :: b(6), x(6), first(6), full(6, 6)
   character(len=:), allocatable :: used
   integer :: g, round
   real(wp), parameter :: factor(3) = [1.0_wp, -1.0_wp, 1.0_wp]
   real(wp), parameter :: right(6) = [1.0_wp, -2.0_wp, 3.0_wp, 4.0_wp, 0.5_wp, -1.0_wp]

   call new_symmetric(matrix, 2, 3, csr_type([0_i8, 2_i8, 4_i8], [1, 2, 2, 3]))
   do round = 1, 3
      matrix%value = 0.0_wp
      call matrix%add(matrix%value, [1, 2], symmetric_part(4, 1))
      call matrix%add(matrix%value, [2, 3], factor(round)*symmetric_part(4, 2))
      call matrix%dense(full)
      b = matmul(full, right)
      call matrix%solve_square(0.0_wp, b, x, report, error)
      call check('a matrix has a solution', .not. allocated(error))
      if (allocated(error)) return
      if (round == 1) used = report%used
      if (round == 1) first = x
      call check('and it is right', all(abs(x - right) <= 1.0e-13_wp))
   end do
   call check('a matrix that comes again has the same factor', report%used == used)
   call check('and the same solution', all(abs(x - first) <= 0.0_wp))
   full = full + 0.5_wp*reshape([((merge(full(g, g), 0.0_wp, g == round), g=1, 6), round=1, 6)], &
      & [6, 6])
   call matrix%solve_square(0.5_wp, matmul(full, right), x, report, error)
   call check('a shift adds its share of the diagonal', .not. allocated(error) &
      & .and. all(abs(x - right) <= 1.0e-13_wp))
end subroutine test_kept_factor

!> Other entries in the order of the first matrix, and an indefinite matrix between them
subroutine test_large_factor(groups, members, tolerance)
   !> Groups of blocks in a row, two blocks apart, and blocks of each
   integer, intent(in) :: groups, members
   !> Error of a solution [-]
   real(wp), intent(in) :: tolerance
   type(symmetric_matrix) :: matrix
   type(square_report) :: report
   type(error_type), allocatable :: error
   real(wp), allocatable :: b(:), right(:), x(:)
   integer :: g, k, round
   real(wp), parameter :: factor(4) = [1.0_wp, 3.0_wp, -1.0_wp, 2.0_wp]

   call new_symmetric(matrix, 3, 2*groups + members, csr_type([(int(members*g, i8), g=0, groups), &
      & members*groups + 2_i8], [[((2*g + k, k=1, members), g=1, groups)], 1, 2]))
   allocate (b(matrix%n), x(matrix%n))
   right = [(real(modulo(7*k, 5) - 2, wp), k=1, matrix%n)]
   do round = 1, size(factor)
      matrix%value = 0.0_wp
      call matrix%add(matrix%value, [1, 2], symmetric_part(6, 1))
      do g = 1, groups
         call matrix%add(matrix%value, [(2*g + k, k=1, members)], &
            & merge(factor(round), 1.0_wp, modulo(g, 2) == 0)*symmetric_part(3*members, g))
      end do
      call matrix%apply(right, b)
      call matrix%solve_square(0.0_wp, b, x, report, error)
      call check('a large matrix has a solution', .not. allocated(error))
      if (allocated(error)) return
      call check('and it is right', all(abs(x - right) <= tolerance))
      call check('it is known to be definite, or not', &
         & matrix%definite() .eqv. factor(round) > 0.0_wp)
   end do
end subroutine test_large_factor

!> A positive definite matrix that is different for each number
pure function symmetric_part(n, number) result(a)
   !> Size
   integer, intent(in) :: n
   integer, intent(in) :: number
   real(wp) :: a(n, n)
   integer :: i, j

   do j = 1, n
      do i = 1, n
         a(i, j) = 1.0_wp/(1 + abs(i - j)*number)
      end do
      a(j, j) = n + 0.1_wp*j
   end do
end function symmetric_part

end program test_symmetric
