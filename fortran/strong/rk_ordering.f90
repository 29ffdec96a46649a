!> Orders of points: boxes that gather near ones, and an elimination order along the body.
!>
!> Reference: George, Liu, Computer Solution of Large Sparse Positive Definite Systems,
!>            Prentice-Hall (1981), chapter 4
module rk_ordering
   use rk_csr, only : csr_type, group_by
   use rk_precision, only : i8, wp
   use rk_sort, only : sort
   implicit none
   private

   public :: envelope_order, find, gather

contains

!> Gather items whose places lie in the same box
pure subroutine gather(position, place, spacing, order, group)
   !> Coordinates of all places, shape (nd, np) [length]
   real(wp), intent(in) :: position(:, :)
   !> Place of each item, shape (n)
   integer, intent(in) :: place(:)
   !> Size of the boxes, shape (nd) [length]
   real(wp), intent(in) :: spacing(:)
   !> Items by their boxes, shape (n)
   integer, allocatable, intent(out) :: order(:)
   !> Box g holds order(group(g)+1 : group(g+1)); no box is empty
   integer, allocatable, intent(out) :: group(:)
   type(csr_type) :: box
   real(wp) :: low(size(spacing))
   integer :: box_of(size(place)), n(3), c(3), b, d

   low = minval(position, dim=2)
   n = 1
   do d = 1, size(spacing)
      n(d) = 1 + int((maxval(position(d, :)) - low(d))/spacing(d) + 1.0e-9_wp)
   end do
   do b = 1, size(place)
      c = 0
      do d = 1, size(spacing)
         ! the last layer of points joins the box below it
         c(d) = min(int((position(d, place(b)) - low(d))/spacing(d) + 1.0e-9_wp), &
            & max(n(d) - 2, 0))
      end do
      box_of(b) = 1 + c(1) + n(1)*(c(2) + n(2)*c(3))
   end do
   call group_by(product(n), box_of, box)
   order = box%index
   ! empty boxes make no group
   associate (offset => box%offset)
      group = [0, pack(int(offset(2:)), offset(2:) > offset(:size(offset) - 1))]
   end associate
end subroutine gather

!> Elimination order of points along the axis that gives the smallest envelope of the matrix in
!> which two points meet that share a place
subroutine envelope_order(neighbour, centre, position, reach)
   !> Points that cover each place
   type(csr_type), intent(in) :: neighbour
   !> Coordinates of the points, shape (nd, ns) [length]
   real(wp), intent(in) :: centre(:, :)
   !> Place of each point in the order, shape (ns)
   integer, allocatable, intent(out) :: position(:)
   !> First place in the order of the points that meet each point, shape (ns)
   integer, allocatable, intent(out) :: reach(:)
   integer, allocatable :: order(:), first(:)
   real(wp) :: extent(size(centre, 1)), weight(size(centre, 1))
   integer(i8) :: size_now, size_best
   integer :: d, e, nd

   nd = size(centre, 1)
   extent = max(maxval(centre, dim=2) - minval(centre, dim=2), tiny(1.0_wp))
   size_best = huge(1_i8)
   do d = 1, nd
      ! points of a layer are distinguished by their other coordinates
      weight = [(merge(1.0_wp, 1.0e-5_wp**modulo(e - d, nd), e == d), e=1, nd)]/extent
      call sort(matmul(weight, centre), order)
      call find_reach(neighbour, order, first)
      size_now = sum(order - first + 1_i8)
      if (size_now >= size_best) cycle
      size_best = size_now
      call move_alloc(order, position)
      call move_alloc(first, reach)
   end do
end subroutine envelope_order

!> First point in an order that shares a place with each point
subroutine find_reach(neighbour, order, reach)
   type(csr_type), intent(in) :: neighbour
   !> Place of each point in the order, shape (ns)
   integer, intent(in) :: order(:)
   !> First place of those that share a place, shape (ns)
   integer, allocatable, intent(out) :: reach(:)
   integer :: ip

   reach = order
   do ip = 1, size(neighbour%offset) - 1
      associate (near => neighbour%index(neighbour%offset(ip) + 1:neighbour%offset(ip + 1)))
         if (size(near) > 0) reach(near) = min(reach(near), minval(order(near)))
      end associate
   end do
end subroutine find_reach

!> Position of a number in an ascending list, 0 if absent
pure integer function find(list, number)
   !> Ascending list
   integer, intent(in) :: list(:)
   integer, intent(in) :: number
   integer :: low, high, middle

   low = 1
   high = size(list)
   find = 0
   do while (low <= high)
      middle = (low + high)/2
      if (list(middle) == number) then
         find = middle
         return
      else if (list(middle) < number) then
         low = middle + 1
      else
         high = middle - 1
      end if
   end do
end function find

end module rk_ordering
