!> Ascending order of numbers.
module rk_sort
   use rk_precision, only : wp
   implicit none
   private

   public :: sort, order_along

contains

!> Places of numbers in ascending order
pure subroutine sort(key, place)
   !> Numbers, shape (n)
   real(wp), intent(in) :: key(:)
   !> Place of each number, shape (n)
   integer, allocatable, intent(out) :: place(:)
   integer :: index(size(key)), buffer(size(key))
   integer :: width, low, middle, high, i, j, k

   ! bottom-up merge sort
   index = [(i, i=1, size(key))]
   width = 1
   do while (width < size(key))
      do low = 1, size(key), 2*width
         middle = min(low + width, size(key) + 1)
         high = min(low + 2*width, size(key) + 1)
         i = low
         j = middle
         do k = low, high - 1
            if (j >= high) then
               buffer(k) = index(i)
               i = i + 1
            else if (i >= middle) then
               buffer(k) = index(j)
               j = j + 1
            else if (key(index(i)) <= key(index(j))) then
               buffer(k) = index(i)
               i = i + 1
            else
               buffer(k) = index(j)
               j = j + 1
            end if
         end do
      end do
      index = buffer
      width = 2*width
   end do
   allocate (place(size(key)))
   place(index) = [(i, i=1, size(key))]
end subroutine sort

!> Place of each point in an order along an axis
subroutine order_along(x, axis, place)
   !> Coordinates, shape (nd, n) [length]
   real(wp), intent(in) :: x(:, :)
   integer, intent(in) :: axis
   !> Places, shape (n)
   integer, allocatable, intent(out) :: place(:)
   real(wp) :: weight(size(x, 1))
   integer :: e

   ! points of a layer are ordered by their other coordinates
   weight = [(merge(1.0_wp, 1.0e-5_wp**modulo(e - axis, size(x, 1)), e == axis), &
      & e=1, size(x, 1))]/max(maxval(x, dim=2) - minval(x, dim=2), tiny(1.0_wp))
   call sort(matmul(weight, x), place)
end subroutine order_along

end module rk_sort
