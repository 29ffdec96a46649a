!> Elimination order of Cuthill and McKee; TAP for `meson test`.
program test_csr
   use rk_csr, only : csr_type
   use rk_cuthill, only : cuthill_mckee
   use tap, only : check, finish
   implicit none

   call test_cuthill_mckee
   call finish()

contains

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

end program test_csr
