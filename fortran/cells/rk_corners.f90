!> Source points at the corners of cells of Gauss points.
module rk_corners
   use rk_cells, only : cells_type
   use rk_cloud, only : cloud_type
   use rk_lattice, only : place_of
   use rk_precision, only : wp
   implicit none
   private

   public :: corners_type, new_corners, has_corners

   !> Relative difference below which spacings count as equal [-]
   real(wp), parameter :: alike = 1.0e-6_wp

   !> Cells of a lattice and the source points at their corners
   type :: corners_type
      !> Source points of each cell, the first direction fastest, shape (2^nd, cells)
      integer, allocatable :: of(:, :)
      !> Lower corner of each cell, shape (nd, cells) [length]
      real(wp), allocatable :: low(:, :)
      !> Edges of a cell, shape (nd) [length]
      real(wp), allocatable :: step(:)
   contains
      procedure :: within
   end type corners_type

contains

!> Whether source points are the corners of equal cells: in boxes with an even lattice, and in
!> bodies of voxels
pure logical function has_corners(cloud)
   type(cloud_type), intent(in) :: cloud

   has_corners = allocated(cloud%block) .or. (allocated(cloud%lattice) &
      & .and. .not. (cloud%polar .or. any(maxval(cloud%spacing, dim=2) &
      & > (1.0_wp + alike)*minval(cloud%spacing, dim=2))))
end function has_corners

subroutine new_corners(self, cloud, cells)
   type(corners_type), intent(out) :: self
   type(cloud_type), intent(in) :: cloud
   !> Cells of Gauss points
   type(cells_type), intent(in) :: cells
   real(wp) :: low(cloud%nd), centre(cloud%nd)
   integer :: n(3), at(3), c, is, k, nd
   integer, allocatable :: number(:)

   nd = cloud%nd
   low = minval(cloud%source, dim=2)
   self%step = sum(cloud%spacing, dim=2)/size(cloud%spacing, 2)
   n = 1
   n(:nd) = 1 + nint((maxval(cloud%source, dim=2) - low)/self%step)
   allocate (number(product(n)), source=0)
   at = 0
   do is = 1, size(cloud%source, 2)
      at(:nd) = nint((cloud%source(:, is) - low)/self%step)
      number(place_of(at, n)) = is
   end do
   allocate (self%of(2**nd, size(cells%weight)/cells%per_cell))
   allocate (self%low(nd, size(self%of, 2)))
   do c = 1, size(self%of, 2)
      associate (own => cells%point(:, cells%per_cell*(c - 1) + 1:cells%per_cell*c))
         centre = sum(own, dim=2)/cells%per_cell
      end associate
      at(:nd) = min(max(int((centre - low)/self%step), 0), n(:nd) - 2)
      self%low(:, c) = low + self%step*at(:nd)
      do k = 0, 2**nd - 1
         self%of(k + 1, c) = number(place_of(at + merge(1, 0, btest(k, [0, 1, 2])), n))
      end do
   end do
end subroutine new_corners

!> Place in a cell, from 0 at its lower corner to 1, shape (nd)
pure function within(self, cell, x) result(xi)
   class(corners_type), intent(in) :: self
   integer, intent(in) :: cell
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   real(wp) :: xi(size(x))

   xi = min(max((x - self%low(:, cell))/self%step, 0.0_wp), 1.0_wp)
end function within

end module rk_corners
