!> Factors of sparse symmetric matrices of blocks: digits, and what is known to be definite; TAP for
!> `meson test`.
program test_symmetric
   use rk_csr, only : csr_type
   use rk_error, only : error_type
   use rk_operator, only : square_report
   use rk_precision, only : i8, wp
   use rk_symmetric, only : new_symmetric, symmetric_matrix
   use tap, only : check, finish
   implicit none

   ! dense columns, and so many operations that a factor has half of the digits
   call test_large_factor(40, 8, 1.0e-11_wp)
   call test_large_factor(100, 120, 1.0e-8_wp)
   call finish()

contains

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
