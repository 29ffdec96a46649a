!> Groups of cells within which the volume change is projected: rows of nodal cells of a lattice;
!> small groups cut by the surface are joined to others. The grouping depends neither on the order
!> of the points nor on the position of the body. A row that cannot be divided symmetrically is
!> divided in both orders: each cell then has a slot for each order, and contributes a share to each
!> group named in its slots.
module rk_groups
   use rk_csr, only : csr_type, group_by, sort
   use rk_facets, only : facets_type
   use rk_lattice, only : place_of
   use rk_precision, only : i8, wp
   implicit none
   private

   public :: slots, groups_of, threes, pairs, join_small

   !> Number of groups of a cell: a row in each direction may be counted from either end
   integer, parameter :: slots = 8

   !> Relative difference below which distances and areas count as equal
   real(wp), parameter :: same = 1.0e-6_wp

contains

!> Groups of a cell, from 1, one per slot
pure function groups_of(first, last, groups) result(group)
   !> Group in each direction, from 0, of the cell counted from the first and from the last one
   integer, intent(in) :: first(3), last(3)
   !> Groups in each direction
   integer, intent(in) :: groups(3)
   integer :: group(slots)
   integer :: d, s

   group = [(place_of(merge(groups - 1 - last, first, [(btest(s, d), d=0, 2)]), groups), &
      & s=0, slots - 1)]
end function groups_of

!> Group of a nodal cell in one direction, from 0: threes, as symmetric as possible
!>
!> Between groups of two, linear pressures can alternate almost without work: their inf-sup constant
!> falls with the spacing, that of groups of three does not.
elemental integer function threes(cell, cells) result(group)
   !> Cell, from 0
   integer, intent(in) :: cell
   !> Cells in this direction
   integer, intent(in) :: cells
   integer :: n

   n = cells/3
   group = cell/3
   ! five cells are divided into three and two from either end: three groups would cost accuracy
   if (cells <= 5) then
      if (cells == 4) group = 0
      return
   end if
   select case (mod(cells, 3))
   case (1)
      if (mod(n, 2) == 1) then
         ! a group of four in the middle
         if (cell > 3*(n/2) + 2) group = (cell - 1)/3
      else
         ! a single cell in the middle
         if (cell > 3*(n/2)) group = (cell + 2)/3
      end if
   case (2)
      ! groups of four at the ends
      group = min(max(cell - 1, 0)/3, n - 1)
   end select
end function threes

!> Group of a block of voxels in one direction, from 0: pairs, with a single one in the middle if
!> their number is odd
elemental integer function pairs(block, blocks) result(group)
   !> Block, from 0
   integer, intent(in) :: block
   !> Blocks in this direction
   integer, intent(in) :: blocks

   group = block/2
   if (mod(blocks, 2) == 1 .and. block > 2*((blocks - 1)/4)) group = (block + 1)/2
end function pairs

!> Join groups of few cells to the group with which they share the largest area, the smallest and
!> outermost groups first. Of equal areas the innermost group is chosen; where several remain, the
!> cells are distributed equally over them
subroutine join_small(group, facets, least)
   !> Groups of each cell, from 1, shape (slots, cells)
   integer, intent(inout) :: group(:, :)
   type(facets_type), intent(in) :: facets
   !> Minimum number of cells of a group; an isolated component keeps its group
   integer, intent(in) :: least
   type(csr_type) :: of_cell
   integer, allocatable :: own(:), near(:), others(:)
   logical, allocatable :: small(:)
   integer(i8) :: e
   integer :: members(maxval(group)), g, i, k, s
   real(wp), dimension(maxval(group)) :: shared, away, weight
   real(wp) :: centre(size(facets%x, 1), maxval(group)), middle(size(facets%x, 1)), extent

   call group_by(size(group, 2), reshape(facets%side(:, :facets%n), [2*facets%n]), of_cell)
   associate (x => facets%x(:, :facets%n))
      middle = 0.5_wp*(maxval(x, dim=2) + minval(x, dim=2))
      extent = maxval(maxval(x, dim=2) - minval(x, dim=2))
   end associate
   centre = 0.0_wp
   weight = 0.0_wp
   do k = 1, facets%n
      do i = 1, 2
         if (facets%side(i, k) == 0) cycle
         do s = 1, slots
            g = group(s, facets%side(i, k))
            weight(g) = weight(g) + norm2(facets%area(:, k))
            centre(:, g) = centre(:, g) + norm2(facets%area(:, k))*(facets%x(:, k) - middle)
         end do
      end do
   end do
   away = norm2(centre, dim=1)/max(weight, tiny(1.0_wp))
   members = 0
   do i = 1, size(group, 2)
      do s = 1, slots
         members(group(s, i)) = members(group(s, i)) + 1
      end do
   end do
   do
      small = members > 0 .and. members < slots*least
      if (.not. any(small)) return
      small = small .and. members == minval(members, mask=small)
      g = findloc(small .and. away >= maxval(away, mask=small) - same*extent, .true., dim=1)
      shared = 0.0_wp
      own = pack([(i, i=1, size(group, 2))], any(group == g, dim=1))
      near = [((of_cell%index(e), e=of_cell%offset(own(i)) + 1, of_cell%offset(own(i) + 1)), &
         & i=1, size(own))]
      near = (near + 1)/2
      call sort(near)
      do i = 1, size(near)
         k = near(i)
         if (facets%side(2, k) == 0) cycle
         do s = 1, slots
            associate (a => group(s, facets%side(1, k)), b => group(s, facets%side(2, k)))
               if (a == b) cycle
               if (a == g) shared(b) = shared(b) + norm2(facets%area(:, k))
               if (b == g) shared(a) = shared(a) + norm2(facets%area(:, k))
            end associate
         end do
      end do
      if (.not. any(shared > 0.0_wp)) then
         ! isolated: skip it from now on
         members(g) = slots*least
         cycle
      end if
      small = shared >= (1.0_wp - same)*maxval(shared)
      small = small .and. away <= minval(away, mask=small) + same*extent
      others = pack([(i, i=1, size(small))], small)
      do i = 1, size(own)
         k = 0
         do s = 1, slots
            if (group(s, own(i)) /= g) cycle
            k = k + 1
            group(s, own(i)) = others(1 + mod(k, size(others)))
            members(group(s, own(i))) = members(group(s, own(i))) + 1
         end do
      end do
      members(g) = 0
   end do
end subroutine join_small

end module rk_groups
