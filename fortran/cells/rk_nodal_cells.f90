!> Nodal cells for smoothed gradients (SCNI): one for each source point.
!>
!> A cell is known by its facets. Neighbours share theirs with all quadrature points, and each
!> facet's quadrature is exact for linear functions, so that smoothed gradients of linear functions
!> are exact and the sum of all cells leaves only the surface.
!>
!> Reference: Chen, Wu, Yoon, You, Int. J. Numer. Meth. Engng 50 (2001),
!>            doi:10.1002/1097-0207(20010120)50:2<435::AID-NME32>3.0.CO;2-A
module rk_nodal_cells
   use rk_cells, only : cells_type
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type
   use rk_facets, only : close_cells, facets_type
   use rk_groups, only : groups_of, slots, threes
   use rk_lattice, only : digits_of, lattice_frame, place_of, set_number
   use rk_precision, only : wp
   use rk_voxels, only : voxel_facets
   implicit none
   private

   public :: nodal_cells, lattice_index

   !> Gauss points of an edge, from -1 to 1
   real(wp), parameter :: gauss(2) = [-1.0_wp, 1.0_wp]/sqrt(3.0_wp)
   !> Widths that differ by less than this share are the same
   real(wp), parameter :: alike = 1.0e-6_wp

contains

!> Cells of all source points: from the lattice where there is one, of whole voxels in a model,
!> where blocks have several points
subroutine nodal_cells(self, cloud, error)
   type(cells_type), intent(out) :: self
   type(cloud_type), intent(in) :: cloud
   !> Error handling: cells that are not there
   type(error_type), allocatable, intent(out) :: error
   type(facets_type) :: facets
   integer, allocatable :: group(:, :)
   real(wp), allocatable :: filled(:)
   integer :: is, lattice(3), at(3)

   if (allocated(cloud%lattice)) then
      if (cloud%nd == 2) then
         call lattice_facets_2d(facets, cloud)
      else
         call lattice_facets_3d(facets, cloud)
      end if
      lattice = 1
      lattice(:cloud%nd) = cloud%lattice
      allocate (group(slots, size(cloud%source, 2)))
      do is = 1, size(group, 2)
         at = lattice_index(cloud, is)
         group(:, is) = groups_of(threes(at, lattice), threes(lattice - 1 - at, lattice), &
            & 1 + threes(lattice - 1, lattice))
      end do
   else
      call voxel_facets(facets, cloud, group, filled, error)
   end if
   if (allocated(error)) return
   call close_cells(self, size(group, 2), facets, group, filled)
   if (allocated(cloud%block)) call split_cells(self)
end subroutine nodal_cells

!> Put 2^nd points in the place of one in each cell: as many resist gradients that vary within it.
!> They lie about its centre so that they have its volume and its second moments: of a box they are
!> its 2 x 2 x 2 Gauss points. The mean of their gradients stays that of the facets
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
            & < (1.0_wp - alike)*sqrt(sum(self%moment(d, d, o:e))/sum(self%weight(o:e))), d=1, nd)]
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

!> Place of a source point in its lattice, from 0
pure function lattice_index(cloud, is) result(index)
   !> Cloud with a lattice
   type(cloud_type), intent(in) :: cloud
   !> Source point
   integer, intent(in) :: is
   integer :: index(3)

   index = 0
   index(:cloud%nd) = digits_of(is - 1, cloud%lattice)
end function lattice_index

!> Facets of a plane lattice, straight between the centres of its meshes; on the surface they meet
!> in the source points
subroutine lattice_facets_2d(facets, cloud)
   type(facets_type), intent(inout) :: facets
   type(cloud_type), intent(in) :: cloud
   real(wp) :: low(3), step(3)
   integer :: i, d, o, last(2), end, half(2), index(3), next(3), is, from(2), to(2)

   call lattice_frame(cloud, low, step)
   last = 2*(cloud%lattice - 1)
   do is = 1, size(cloud%source, 2)
      index = lattice_index(cloud, is)
      do d = 1, 2
         o = 3 - d
         do end = 0, 1
            ! in half spacings: where the cell ends in this direction, and its range along the other
            half(d) = min(max(2*index(d) + 2*end - 1, 0), last(d))
            from(d) = half(d)
            to(d) = half(d)
            from(o) = max(2*index(o) - 1, 0)
            to(o) = min(2*index(o) + 1, last(o))
            if (half(d) == 2*index(d)) then
               do i = from(o), to(o) - 1
                  from(o) = i
                  to(o) = i + 1
                  call edge(corner(from), corner(to), 0, set_number(cloud%polar, d, end))
               end do
            else if (end == 1) then
               next = index
               next(d) = index(d) + 1
               call edge(corner(from), corner(to), place_of(next(:2), cloud%lattice), 0)
            end if
         end do
      end do
   end do

contains

   !> Place in the plane of a corner in half spacings
   pure function corner(at) result(x)
      integer, intent(in) :: at(2)
      real(wp) :: x(2)

      x = low(:2) + 0.5_wp*step(:2)*at
      if (cloud%polar) x = x(1)*[cos(x(2)), sin(x(2))]
   end function corner

   !> Two Gauss points of an edge
   subroutine edge(a, b, other, set)
      real(wp), intent(in) :: a(2), b(2)
      integer, intent(in) :: other, set
      real(wp) :: normal(2)
      integer :: k

      ! a and b follow the other direction: turned to the side of growing d, then outwards
      normal = [b(2) - a(2), a(1) - b(1)]
      if (d == 2) normal = -normal
      if (end == 0) normal = -normal
      do k = 1, 2
         call facets%add(0.5_wp*(a + b) + 0.5_wp*gauss(k)*(b - a), 0.5_wp*normal, is, other, set)
      end do
   end subroutine edge

end subroutine lattice_facets_2d

!> Facets of a lattice in space: rectangles half way between the source points
subroutine lattice_facets_3d(facets, cloud)
   type(facets_type), intent(inout) :: facets
   type(cloud_type), intent(in) :: cloud
   real(wp) :: low(3), step(3), from(3), to(3), x(3), area(3)
   integer :: i, j, d, o, p, end, index(3), next(3), is

   call lattice_frame(cloud, low, step)
   do is = 1, size(cloud%source, 2)
      index = lattice_index(cloud, is)
      from = low + step*max(index - 0.5_wp, 0.0_wp)
      to = low + step*min(index + 0.5_wp, real(cloud%lattice - 1, wp))
      do d = 1, 3
         o = modulo(d, 3) + 1
         p = modulo(d + 1, 3) + 1
         do end = 0, 1
            next = index
            next(d) = index(d) + 2*end - 1
            if (end == 0 .and. next(d) >= 0) cycle
            x(d) = merge(to(d), from(d), end == 1)
            area = 0.0_wp
            area(d) = 0.25_wp*(2*end - 1)*(to(o) - from(o))*(to(p) - from(p))
            do i = 1, 2
               do j = 1, 2
                  x(o) = 0.5_wp*(from(o) + to(o)) + 0.5_wp*gauss(i)*(to(o) - from(o))
                  x(p) = 0.5_wp*(from(p) + to(p)) + 0.5_wp*gauss(j)*(to(p) - from(p))
                  if (next(d) < 0 .or. next(d) >= cloud%lattice(d)) then
                     call facets%add(x, area, is, 0, set_number(.false., d, end))
                  else
                     call facets%add(x, area, is, place_of(next, cloud%lattice), 0)
                  end if
               end do
            end do
         end do
      end do
   end do
end subroutine lattice_facets_3d

end module rk_nodal_cells
