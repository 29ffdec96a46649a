!> Compressed rows: grouping, transposition, order, elimination order; TAP for `meson test`.
program test_csr
   use rk_csr, only : csr_type, group_by, sort
   use rk_cuthill, only : cuthill_mckee
   use rk_precision, only : i8
   use tap, only : check, finish
   implicit none


   call test_group_by
   call test_transposed
   call test_sort
   call test_cuthill_mckee
   call finish()

contains

!> Places of numbers in a list
subroutine test_group_by
   type(csr_type) :: places

   call group_by(4, [3, 1, 3, 4, 1, 3], places)
   call check('offsets count smaller numbers, an empty row as well', &
      & same(int(places%offset), [0, 2, 2, 5, 6]))
   call check('places ascend within a number', same(places%index, [2, 5, 1, 3, 6, 4]))
   call group_by(2, [0, 2, -1, 3, 2], places)
   call check('numbers out of range are left out', &
      & same(int(places%offset), [0, 0, 2]) .and. same(places%index, [2, 5]))
   call group_by(3, [integer ::], places)
   call check('an empty list', same(int(places%offset), [0, 0, 0, 0]) .and. size(places%index) == 0)
end subroutine test_group_by

!> A small case by hand
subroutine test_transposed
   type(csr_type) :: rows, columns, back
   integer(i8), allocatable :: entry(:)

   ! the second row is empty, no row holds number 4, the order within rows is not ascending
   rows = csr_type([0_i8, 3_i8, 3_i8, 5_i8, 6_i8], [5, 1, 3, 3, 2, 1])
   call rows%transposed(5, columns, entry)
   call check('rows of each number', same(int(columns%offset), [0, 2, 3, 5, 5, 6]) &
      & .and. same(columns%index, [1, 4, 3, 1, 3, 1]))
   call check('where the entries come from', same(int(entry), [2, 6, 5, 3, 4, 1]))
   call columns%transposed(4, back)
   call check('twice: the same rows', same(int(back%offset), int(rows%offset)))
   call check('twice: in ascending order', same(back%index, [1, 3, 5, 2, 3, 1]))
   rows = csr_type([0_i8], [integer ::])
   call rows%transposed(2, columns)
   call check('no rows at all', same(int(columns%offset), [0, 0, 0]) .and. size(columns%index) == 0)
end subroutine test_transposed

!> Numbers in ascending order
subroutine test_sort
   integer :: few(7), none(0), one(1)

   few = [4, -2, 9, 4, 0, 9, 1]
   call sort(few)
   call check('sorted, equal ones kept', same(few, [-2, 0, 1, 4, 4, 9, 9]))
   few = [7, 6, 5, 4, 3, 2, 1]
   call sort(few)
   call check('from descending order', same(few, [1, 2, 3, 4, 5, 6, 7]))
   call sort(few)
   call check('sorted ones stay', same(few, [1, 2, 3, 4, 5, 6, 7]))
   one = 3
   call sort(one)
   call sort(none)
   call check('one number and none', same(one, [3]))
end subroutine test_sort

!> A strip of 3 x 12 nodes and one of 3 x 5, numbered without any order, have their nodes along each
!> strip again
subroutine test_cuthill_mckee
   integer, parameter :: across = 3, n = across*17
   type(csr_type) :: above
   integer, allocatable :: order(:)
   integer :: number(n), place(n), i, j, k, far

   ! 20 and 51 have no common divisor
   number = [(1 + modulo(20*k, n), k=1, n)]
   allocate (above%offset(n + 1), above%index(0))
   above%offset(1) = 0
   do j = 1, n
      do i = 1, j
         if (meet(number([i, j]) - 1, across)) above%index = [above%index, i]
      end do
      above%offset(j + 1) = size(above%index)
   end do
   order = cuthill_mckee(above)
   place = 0
   place(order) = [(k, k=1, n)]
   call check('every node has its place', size(order) == n .and. all(place > 0))
   far = 0
   do j = 1, n
      do k = int(above%offset(j)) + 1, int(above%offset(j + 1))
         far = max(far, abs(place(j) - place(above%index(k))))
      end do
   end do
   ! levels of 3 and 5 nodes from a corner
   call check('nodes that meet are near', far < 3 + 5)
end subroutine test_cuthill_mckee

!> Whether two nodes are equal or neighbours in a strip, corners included; after 12 columns another
!> one begins
pure logical function meet(node, across)
   !> Numbers along the strips, from 0
   integer, intent(in) :: node(2)
   !> Nodes across
   integer, intent(in) :: across
   integer :: column(2), row(2)

   column = node/across
   row = modulo(node, across)
   meet = abs(column(1) - column(2)) <= 1 .and. abs(row(1) - row(2)) <= 1 &
      & .and. ((column(1) < 12) .eqv. (column(2) < 12))
end function meet

!> Equal in length and numbers
pure logical function same(a, b)
   !> Lists
   integer, intent(in) :: a(:), b(:)

   same = size(a) == size(b)
   if (same) same = all(a == b)
end function same

end program test_csr
