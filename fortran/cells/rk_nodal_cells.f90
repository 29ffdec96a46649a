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
   use rk_lattice, only : digits_of, lattice_frame, set_number
   use rk_precision, only : wp
   use rk_tensor, only : vector_product
   use rk_voxels, only : voxel_facets
   implicit none
   private

   public :: nodal_cells, lattice_index

   !> Gauss points of an edge, from -1 to 1
   real(wp), parameter :: gauss(2) = [-1.0_wp, 1.0_wp]/sqrt(3.0_wp)
   !> Widths that differ by less than this share are the same
   real(wp), parameter :: alike = 1.0e-6_wp

contains

!> Cells of all source points: between those of a lattice, of whole voxels in a model, where blocks
!> have several points
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
      call lattice_facets(facets, cloud)
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
   integer :: base(3)

   base = 1
   base(4 - cloud%nd:) = cloud%lattice
   base = digits_of(is - 1, base)
   index = 0
   index(:cloud%nd) = base(4 - cloud%nd:)
end function lattice_index

!> Source point at a place of the lattice
pure integer function lattice_point(cloud, index)
   type(cloud_type), intent(in) :: cloud
   !> Place, from 0
   integer, intent(in) :: index(3)
   integer :: d

   lattice_point = 0
   do d = 1, cloud%nd
      lattice_point = lattice_point*cloud%lattice(d) + index(d)
   end do
   lattice_point = lattice_point + 1
end function lattice_point

!> Facets of a lattice, straight between the centres of its meshes. Those of an annulus lie at their
!> radius and angle, those of points off their lattice in the mean of the points around. On the
!> surface of a plane body facets meet in the source points
subroutine lattice_facets(facets, cloud)
   type(facets_type), intent(inout) :: facets
   type(cloud_type), intent(in) :: cloud
   real(wp) :: low(3), step(3)
   integer :: d, end, i, is, nd, other, set
   integer, dimension(3) :: last, index, next, from, to

   nd = cloud%nd
   call lattice_frame(cloud, low, step)
   last = 0
   last(:nd) = 2*(cloud%lattice - 1)
   do is = 1, size(cloud%source, 2)
      index = lattice_index(cloud, is)
      do d = 1, nd
         do end = 0, 1
            ! in half spacings: where the cell ends in this direction, its range along the others
            from = max(2*index - 1, 0)
            to = min(2*index + 1, last)
            from(d) = min(max(2*index(d) + 2*end - 1, 0), last(d))
            to(d) = from(d)
            if (from(d) /= 2*index(d)) then
               if (end == 0) cycle
               next = index
               next(d) = index(d) + 1
               other = lattice_point(cloud, next)
               set = 0
               call add_facet()
               cycle
            end if
            other = 0
            set = set_number(cloud%polar, d, end)
            if (nd == 3) then
               call add_facet()
            else
               do i = from(3 - d), to(3 - d) - 1
                  from(3 - d) = i
                  to(3 - d) = i + 1
                  call add_facet()
               end do
            end if
         end do
      end do
   end do

contains

   !> Gauss points of an edge, or of a quadrilateral that need not be flat
   subroutine add_facet()
      real(wp), dimension(nd) :: a, b, along, across, bent
      real(wp), dimension(3) :: area, u, v
      integer :: k, l, o, p

      o = modulo(d, nd) + 1
      p = modulo(d + 1, nd) + 1
      a = corner(from)
      b = corner(merge(to, from, [1, 2, 3] == o))
      if (nd == 2) then
         ! turned to the side of growing d, then outwards
         area(:2) = merge(0.5_wp, -0.5_wp, (d == 1) .eqv. (end == 1))*[b(2) - a(2), a(1) - b(1)]
         do k = 1, 2
            call facets%add(0.5_wp*(a + b) + 0.5_wp*gauss(k)*(b - a), area(:2), is, other, set)
         end do
         return
      end if
      associate (c => corner(to), e => corner(merge(to, from, [1, 2, 3] == p)))
         along = 0.5_wp*((b - a) + (c - e))
         across = 0.5_wp*((e - a) + (c - b))
         bent = 0.5_wp*((c - e) - (b - a))
         a = 0.5_wp*(0.5_wp*(a + b) + 0.5_wp*(c + e))
      end associate
      do k = 1, 2
         do l = 1, 2
            u = along + gauss(l)*bent
            v = across + gauss(k)*bent
            area = merge(0.25_wp, -0.25_wp, end == 1)*vector_product(u, v)
            call facets%add(a + 0.5_wp*(gauss(k)*along + gauss(l)*across &
               & + gauss(k)*gauss(l)*bent), area, is, other, set)
         end do
      end do
   end subroutine add_facet

   !> Place of a corner in half spacings
   pure function corner(at) result(x)
      integer, intent(in) :: at(3)
      real(wp) :: x(nd)
      integer :: k

      x = low(:nd) + 0.5_wp*step(:nd)*at(:nd)
      if (cloud%polar) x = x(1)*[cos(x(2)), sin(x(2))]
      if (.not. cloud%jittered) return
      x = 0.0_wp
      do k = 0, 2**nd - 1
         x = x + 0.5_wp**nd*cloud%source(:, lattice_point(cloud, (at + ibits(k, [0, 1, 2], 1))/2))
      end do
   end function corner

end subroutine lattice_facets

end module rk_nodal_cells
