!> Nodal cells for smoothed gradients (SCNI): one for each source point.
!>
!> A cell is defined by its facets. Neighbours share their facets with all quadrature points, and
!> each facet's quadrature is exact for linear functions, so that smoothed gradients of linear
!> functions are exact and in the sum of all cells only the surface remains.
!>
!> Reference: Chen, Wu, Yoon, You, Int. J. Numer. Meth. Engng 50 (2001),
!>            doi:10.1002/1097-0207(20010120)50:2<435::AID-NME32>3.0.CO;2-A
module rk_nodal_cells
   use rk_borders, only : border_rule, face_rule, tensor_rule
   use rk_cells, only : cells_type
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type
   use rk_facets, only : close_cells, facets_type
   use rk_groups, only : groups_of, slots, threes
   use rk_lattice, only : digits_of, lattice_frame, place_at, place_of, set_number
   use rk_precision, only : wp
   use rk_voxels, only : voxel_facets
   implicit none
   private

   public :: nodal_cells, lattice_index

   !> Gauss points of a facet in each direction
   integer, parameter :: gauss = 2
   !> Relative difference below which widths count as equal
   real(wp), parameter :: alike = 1.0e-6_wp

contains

!> Cells of all source points: from the lattice if there is one, otherwise from whole voxels of a
!> model, where a block has several points
subroutine nodal_cells(self, cloud, error)
   type(cells_type), intent(out) :: self
   type(cloud_type), intent(in) :: cloud
   !> Error handling: no cells available
   type(error_type), allocatable, intent(out) :: error
   type(facets_type) :: facets
   integer, allocatable :: group(:, :)
   real(wp), allocatable :: filled(:)
   integer :: is, lattice(3), at(3)

   if (allocated(cloud%lattice)) then
      call lattice_facets(facets, cloud, error)
      if (allocated(error)) return
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
   if (allocated(self%entry)) call find_places(self, cloud)
end subroutine nodal_cells

!> Places of conditions on curved walls: facets moved along the normal of the smooth surface onto it
!> (shifted boundary, Main and Scovazzi, J. Comput. Phys. 372 (2018), doi:10.1016/j.jcp.2017.10.026)
subroutine find_places(self, cloud)
   type(cells_type), intent(inout) :: self
   type(cloud_type), intent(in) :: cloud
   integer :: s

   self%place = self%surface
   do s = 1, size(self%entry)
      if (self%entry(s) == 0) cycle
      if (.not. cloud%is_wall(self%set(s))) cycle
      associate (normal => cloud%normal(:, self%entry(s)), &
         & on => cloud%points(:, cloud%boundary_point(self%entry(s))))
         self%place(:, s) = self%place(:, s) + dot_product(on - self%surface(:, s), normal)*normal
      end associate
   end do
end subroutine find_places

!> Replace the point of each cell by 2^nd points: as many resist gradients that vary within it. They
!> lie about its centre with the volume and the second moments of the cell: in a box they are its 2
!> x 2 x 2 Gauss points. The mean of their gradients remains that of the facets
subroutine split_cells(self)
   !> Nodal cells with one point each
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

!> Index of a source point in its lattice, from 0
pure function lattice_index(cloud, is) result(index)
   !> Cloud with a lattice
   type(cloud_type), intent(in) :: cloud
   !> Source point
   integer, intent(in) :: is
   integer :: index(3)

   index = 0
   index(:cloud%nd) = digits_of(is - 1, cloud%lattice)
end function lattice_index

!> Facets of a lattice, straight and half way between the source points; on the surface of a plane
!> lattice they meet at the source points
subroutine lattice_facets(facets, cloud, error)
   type(facets_type), intent(inout) :: facets
   type(cloud_type), intent(in) :: cloud
   !> Error handling: a set's expression that is not finite
   type(error_type), allocatable, intent(out) :: error
   type(face_rule) :: plain, rule
   logical :: cut
   real(wp) :: low(3), step(3)
   integer :: d, i, is, length, nd, o, p, end
   integer, dimension(cloud%nd) :: from, index, last, next, to

   nd = cloud%nd
   call lattice_frame(cloud, low, step)
   last = 2*(cloud%lattice - 1)
   plain = tensor_rule(1, gauss, nd)
   do is = 1, size(cloud%source, 2)
      index = digits_of(is - 1, cloud%lattice)
      do d = 1, nd
         ! the other directions
         o = modulo(d, nd) + 1
         p = modulo(d + 1, nd) + 1
         do end = 0, 1
            ! in half spacings: the end of the cell in this direction, its range along the others
            from = max(2*index - 1, 0)
            to = min(2*index + 1, last)
            if (end == 0) to(d) = from(d)
            from(d) = to(d)
            next = index
            next(d) = index(d) + 2*end - 1
            if (next(d) < 0 .or. next(d) >= cloud%lattice(d)) then
               length = merge(1, to(o) - from(o), nd == 2)
               do i = from(o), to(o) - 1, length
                  from(o) = i
                  to(o) = i + length
                  call border_rule(rule, cut, cloud, d, end, frame(from), frame(to), gauss, 1, &
                     & error)
                  if (allocated(error)) return
                  call add_facet(rule, 0, set_number(cloud%polar, d, end))
               end do
            else if (end == 1) then
               call add_facet(plain, place_of(next, cloud%lattice), 0)
            end if
         end do
      end do
   end do

contains

   !> Coordinates of a corner given in half spacings
   pure function frame(at) result(q)
      integer, intent(in) :: at(:)
      real(wp) :: q(nd)

      q = low(:nd) + 0.5_wp*step(:nd)*at
   end function frame

   !> Points of the facet between two corners
   subroutine add_facet(rule, other, set)
      type(face_rule), intent(in) :: rule
      integer, intent(in) :: other, set
      real(wp) :: a(nd), area(nd), b(nd), xi(nd)
      integer :: k

      a = place_at(cloud, frame(from))
      b = place_at(cloud, frame(to))
      if (nd == 2) then
         ! a and b follow the other direction: orient the normal towards increasing d
         area = 0.5_wp*[b(2) - a(2), a(1) - b(1)]
         if (d == 2) area = -area
      else
         area = 0.0_wp
         area(d) = 0.25_wp*(b(o) - a(o))*(b(p) - a(p))
      end if
      do k = 1, size(rule%share)
         ! the facet is straight between its corners
         if (nd == 2) xi = rule%xi(1, k)
         if (nd == 3) xi([min(o, p), max(o, p)]) = rule%xi(:, k)
         if (nd == 3) xi(d) = 0.0_wp
         call facets%add(0.5_wp*(a + b) + 0.5_wp*xi*(b - a), &
            & (2*end - 1)*rule%share(k)*area, is, other, set)
      end do
   end subroutine add_facet

end subroutine lattice_facets

end module rk_nodal_cells
