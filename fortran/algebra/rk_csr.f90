!> Compressed rows of numbers: neighbours of points, members of groups, places of entries.
module rk_csr
   use rk_precision, only : i8, wp
   use rk_sort, only : order_along
   implicit none
   private

   public :: csr_type, envelope_order, group_by, joined, lengthened, sort

   !> Lists of numbers, one per row
   type :: csr_type
      !> Row i is index(offset(i)+1 : offset(i+1)), shape (rows + 1)
      integer(i8), allocatable :: offset(:)
      !> Numbers, 1-based, shape (entries)
      integer, allocatable :: index(:)
   contains
      procedure :: transposed
   end type csr_type

contains

!> For each number, the rows that contain it, ascending
pure subroutine transposed(self, n, other, entry)
   class(csr_type), intent(in) :: self
   !> Numbers run from 1 to n
   integer, intent(in) :: n
   !> Row j lists the rows that contain number j
   type(csr_type), intent(out) :: other
   !> Place of each entry of the transpose in the original, shape (entries)
   integer(i8), allocatable, intent(out), optional :: entry(:)
   integer(i8), allocatable :: at(:)
   integer(i8) :: k
   integer :: i

   call count_numbers(n, self%index, other%offset)
   allocate (other%index(other%offset(n + 1)))
   if (present(entry)) allocate (entry(other%offset(n + 1)))
   at = other%offset
   do i = 1, size(self%offset) - 1
      do k = self%offset(i) + 1, self%offset(i + 1)
         associate (to => at(self%index(k)))
            to = to + 1
            other%index(to) = i
            if (present(entry)) entry(to) = k
         end associate
      end do
   end do
end subroutine transposed

!> Rows of one list followed by the rows of another
pure function joined(first, second) result(both)
   !> Lists
   type(csr_type), intent(in) :: first, second
   type(csr_type) :: both

   both = csr_type([first%offset, first%offset(size(first%offset)) + second%offset(2:)], &
      & [first%index, second%index])
end function joined

!> Rows of one list, each extended by the same row of another list
pure function lengthened(first, second) result(both)
   !> Lists with the same number of rows
   type(csr_type), intent(in) :: first, second
   type(csr_type) :: both
   integer :: i

   allocate (both%offset, source=first%offset + second%offset)
   allocate (both%index(both%offset(size(both%offset))))
   do i = 1, size(both%offset) - 1
      both%index(both%offset(i) + 1:both%offset(i + 1)) = &
         & [first%index(first%offset(i) + 1:first%offset(i + 1)), &
         & second%index(second%offset(i) + 1:second%offset(i + 1))]
   end do
end function lengthened

!> Places at which each number occurs in a list, ascending
pure subroutine group_by(n, number, places)
   !> Numbers run from 1 to n; others are left out
   integer, intent(in) :: n
   !> List
   integer, intent(in) :: number(:)
   !> Row i has the places at which number i occurs
   type(csr_type), intent(out) :: places
   integer(i8), allocatable :: at(:)
   integer :: i

   call count_numbers(n, number, places%offset)
   allocate (places%index(places%offset(n + 1)))
   at = places%offset
   do i = 1, size(number)
      if (number(i) < 1 .or. number(i) > n) cycle
      at(number(i)) = at(number(i)) + 1
      places%index(at(number(i))) = i
   end do
end subroutine group_by

!> Offset of the entries of each number when they are sorted
pure subroutine count_numbers(n, number, offset)
   integer, intent(in) :: n
   integer, intent(in) :: number(:)
   !> Number of entries with smaller numbers; the last one is the total, shape (n + 1)
   integer(i8), allocatable, intent(out) :: offset(:)
   integer(i8) :: k
   integer :: i

   allocate (offset(n + 1), source=0_i8)
   do k = 1, size(number, kind=i8)
      if (number(k) < 1 .or. number(k) > n) cycle
      offset(number(k) + 1) = offset(number(k) + 1) + 1
   end do
   do i = 1, n
      offset(i + 1) = offset(i + 1) + offset(i)
   end do
end subroutine count_numbers

!> Elimination order of points along the axis that gives the smallest envelope of the matrix in
!> which all points of a list are coupled: the least sum of a power of the column lengths
subroutine envelope_order(list, x, n, power, place, reach, least)
   !> Lists of coupled points
   type(csr_type), intent(in) :: list
   !> Positions of the first points, shape (nd, located); the other points come last [length]
   real(wp), intent(in) :: x(:, :)
   !> Number of points
   integer, intent(in) :: n
   integer, intent(in) :: power
   !> Place of each point in the order, and first place coupled with it, shape (n) each
   integer, allocatable, intent(out) :: place(:), reach(:)
   !> The sum
   real(wp), intent(out) :: least
   integer, allocatable :: along(:), first(:)
   real(wp) :: total
   integer :: d, i

   least = huge(1.0_wp)
   do d = 1, size(x, 1)
      call order_along(x, d, along)
      along = [along, [(i, i=size(along) + 1, n)]]
      first = along
      do i = 1, size(list%offset) - 1
         associate (near => list%index(list%offset(i) + 1:list%offset(i + 1)))
            if (size(near) > 0) first(near) = min(first(near), minval(along(near)))
         end associate
      end do
      total = sum((along - first + 1.0_wp)**power)
      if (total >= least) cycle
      least = total
      call move_alloc(along, place)
      call move_alloc(first, reach)
   end do
end subroutine envelope_order

!> Shell sort in ascending order
pure subroutine sort(a)
   !> Numbers
   integer, intent(inout) :: a(:)
   integer :: gap, i, j, t

   gap = size(a)
   do while (gap > 1)
      gap = max(5*gap/11, 1)
      do i = gap + 1, size(a)
         t = a(i)
         do j = i - gap, 1, -gap
            if (a(j) <= t) exit
            a(j + gap) = a(j)
         end do
         a(j + gap) = t
      end do
   end do
end subroutine sort

end module rk_csr
