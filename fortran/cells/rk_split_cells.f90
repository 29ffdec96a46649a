!> Nodal cells of bodies of voxels with as many points as resist gradients that vary within them.
!>
!> The points of a cell lie about its centre so that they have its volume and its second moments: of
!> a box they are its 2 x 2 x 2 Gauss points. The mean of their gradients stays that of the facets.
module rk_split_cells
   use rk_cells, only : cells_type
   use rk_precision, only : wp
   implicit none
   private

   public :: split_cells

   !> Widths that differ by less than this share are the same
   real(wp), parameter :: same = 1.0e-6_wp

contains

!> Put 2^nd points in the place of one in each cell
subroutine split_cells(self)
   !> Nodal cells, one point each
   type(cells_type), intent(inout) :: self
   real(wp), allocatable :: point(:, :), width(:), volume(:)
   integer, allocatable :: lift_point(:)
   integer :: d, g, i, k, n, nd, s

   nd = size(self%point, 1)
   n = 2**nd
   allocate (point(nd, n*size(self%weight)), width(nd))
   do i = 1, size(self%weight)
      width = [(sqrt(max(self%moment(d, d, i), 0.0_wp)/self%weight(i)), d=1, nd)]
      do k = 0, n - 1
         point(:, n*(i - 1) + k + 1) = self%point(:, i) &
            & + [(merge(width(d), -width(d), btest(k, d - 1)), d=1, nd)]
      end do
   end do
   allocate (self%thin(nd, size(self%first) - 1))
   do g = 1, size(self%first) - 1
      associate (o => self%first(g) + 1, e => self%first(g + 1))
         self%thin(:, g) = [(maxval(self%point(d, o:e)) - minval(self%point(d, o:e)) &
            & < (1.0_wp - same)*sqrt(sum(self%moment(d, d, o:e))/sum(self%weight(o:e))), d=1, nd)]
      end associate
   end do
   volume = self%weight
   if (allocated(self%filled)) then
      volume = volume/self%filled
      self%filled = [(spread(self%filled(i), 1, n), i=1, size(self%filled))]
   end if
   call move_alloc(point, self%point)
   self%weight = [(spread(self%weight(i)/n, 1, n), i=1, size(self%weight))]
   self%first = n*self%first
   lift_point = self%lift_point
   self%lift_point = [((n*(lift_point(s) - 1) + k, k=1, n), s=1, size(lift_point))]
   self%lift = [(spread(1.0_wp/volume(lift_point(s)), 1, n), s=1, size(lift_point))]
   self%lift_first = [(n*s, s=0, size(lift_point))]
   self%per_cell = n
   self%smoothed = .false.
   deallocate (self%node, self%moment)
end subroutine split_cells

end module rk_split_cells
