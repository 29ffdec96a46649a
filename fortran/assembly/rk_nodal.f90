!> Nodal cells for smoothed gradients (SCNI): one for each source point.
!>
!> A cell is known by its facets. Neighbours share theirs with all quadrature points, and each
!> facet's quadrature is exact for linear functions, so that smoothed gradients of linear functions
!> are exact and the sum of all cells leaves only the surface.
!>
!> Reference: Chen, Wu, Yoon, You, Int. J. Numer. Meth. Engng 50 (2001),
!>            doi:10.1002/1097-0207(20010120)50:2<435::AID-NME32>3.0.CO;2-A
module rk_nodal
   use rk_cells, only : cells_type, digits_of, lattice_frame, lattice_group, set_number
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_precision, only : wp
   implicit none
   private

   public :: nodal_cells

   !> Points of facets, grown as they come
   type :: facets_type
      integer :: n = 0
      !> Place, area times normal, cells on both sides (the second 0 on the surface), boundary set
      real(wp), allocatable :: x(:, :)
      real(wp), allocatable :: area(:, :)
      integer, allocatable :: side(:, :)
      integer, allocatable :: set(:)
   contains
      !> Add a point
      procedure :: add
   end type facets_type

   !> Gauss points of an edge, from -1 to 1
   real(wp), parameter :: gauss(2) = [-1.0_wp, 1.0_wp]/sqrt(3.0_wp)

contains

!> Cells of all source points
subroutine nodal_cells(self, cloud, error)
   !> Points
   type(cells_type), intent(out) :: self
   !> Cloud
   type(cloud_type), intent(in) :: cloud
   !> Error handling: no lattice
   type(error_type), allocatable, intent(out) :: error
   type(facets_type) :: facets
   integer :: group(size(cloud%source, 2)), is, lattice(3)

   if (.not. allocated(cloud%lattice)) then
      call fatal_error(error, err_input, 'nodal cells need the lattice of a box or an annulus')
      return
   end if
   lattice = 1
   lattice(:cloud%nd) = cloud%lattice
   if (cloud%nd == 2) then
      call lattice_facets_2d(facets, cloud)
   else
      call lattice_facets_3d(facets, cloud)
   end if
   do is = 1, size(group)
      group(is) = lattice_group(lattice_index(cloud, is), lattice)
   end do
   call close_cells(self, size(group), facets, group)
end subroutine nodal_cells

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
   !> Cloud with a lattice
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

!> Facets of a plane lattice, straight between the centres of its meshes; on the surface they meet
!> in the source points
subroutine lattice_facets_2d(facets, cloud)
   !> Facets
   type(facets_type), intent(inout) :: facets
   !> Cloud
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
               call edge(corner(from), corner(to), lattice_point(cloud, next), 0)
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
   !> Facets
   type(facets_type), intent(inout) :: facets
   !> Cloud
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
                     call facets%add(x, area, is, lattice_point(cloud, next), 0)
                  end if
               end do
            end do
         end do
      end do
   end do
end subroutine lattice_facets_3d

!> Add a point
subroutine add(self, x, area, cell, other, set)
   !> Facets
   class(facets_type), intent(inout) :: self
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Area times normal, out of the cell, shape (nd) [length^(nd-1)]
   real(wp), intent(in) :: area(:)
   !> Cell, and the one on the other side, 0 on the surface
   integer, intent(in) :: cell, other
   !> Boundary set on the surface
   integer, intent(in) :: set
   integer :: room

   if (.not. allocated(self%x)) allocate (self%x(size(x), 64), self%area(size(x), 64), &
      & self%side(2, 64), self%set(64))
   if (self%n == size(self%set)) then
      room = 2*self%n
      call grow(self%x, room)
      call grow(self%area, room)
      self%side = reshape(self%side, [2, room], pad=[0])
      self%set = reshape(self%set, [room], pad=[0])
   end if
   self%n = self%n + 1
   self%x(:, self%n) = x
   self%area(:, self%n) = area
   self%side(:, self%n) = [cell, other]
   self%set(self%n) = set
end subroutine add

!> More columns
subroutine grow(a, columns)
   !> Array
   real(wp), allocatable, intent(inout) :: a(:, :)
   !> Columns wanted
   integer, intent(in) :: columns
   real(wp), allocatable :: wide(:, :)

   allocate (wide(size(a, 1), columns), source=0.0_wp)
   wide(:, :size(a, 2)) = a
   call move_alloc(wide, a)
end subroutine grow

!> Integration points from facets: volumes, centres and moments by the divergence theorem
subroutine close_cells(self, cells, facets, group)
   !> Points
   type(cells_type), intent(inout) :: self
   !> Cells
   integer, intent(in) :: cells
   !> Facets
   type(facets_type), intent(in) :: facets
   !> Group of each cell, from 1; groups without cells are left out, shape (cells)
   integer, intent(in) :: group(:)
   integer :: number(cells), members(0:maxval(group)), i, k, g, nd, side, ms, d
   real(wp) :: area(size(facets%x, 1)), x(size(facets%x, 1))

   nd = size(facets%x, 1)
   members = 0
   do i = 1, cells
      members(group(i)) = members(group(i)) + 1
   end do
   self%smoothed = .true.
   allocate (self%first(1), source=0)
   do g = 1, maxval(group)
      if (members(g) > 0) self%first = [self%first, self%first(size(self%first)) + members(g)]
      members(g) = members(g) + members(g - 1)
   end do
   do i = cells, 1, -1
      number(i) = members(group(i))
      members(group(i)) = members(group(i)) - 1
   end do

   allocate (self%point(nd, cells), self%weight(cells), self%moment(nd, nd, cells), source=0.0_wp)
   do k = 1, facets%n
      do side = 1, merge(1, 2, facets%side(2, k) == 0)
         i = number(facets%side(side, k))
         area = merge(1, -1, side == 1)*facets%area(:, k)
         self%weight(i) = self%weight(i) + dot_product(facets%x(:, k), area)/nd
         self%point(:, i) = self%point(:, i) + 0.5_wp*facets%x(:, k)**2*area
      end do
   end do
   do i = 1, cells
      self%point(:, i) = self%point(:, i)/self%weight(i)
   end do
   do k = 1, facets%n
      do side = 1, merge(1, 2, facets%side(2, k) == 0)
         i = number(facets%side(side, k))
         area = merge(1, -1, side == 1)*facets%area(:, k)
         x = facets%x(:, k) - self%point(:, i)
         do d = 1, nd
            self%moment(:, d, i) = self%moment(:, d, i) + 0.5_wp*x**2*x(d)*area
            self%moment(d, d, i) = self%moment(d, d, i) - x(d)**3*area(d)/6.0_wp
         end do
      end do
   end do

   ms = count(facets%side(2, :facets%n) == 0)
   allocate (self%facet(nd, facets%n - ms), self%area(nd, facets%n - ms), &
      & self%side(2, facets%n - ms))
   allocate (self%surface(nd, ms), self%outward(nd, ms), self%set(ms))
   allocate (self%lift_first(ms + 1), self%lift_point(ms), self%lift(ms))
   i = 0
   ms = 0
   self%lift_first(1) = 0
   do k = 1, facets%n
      if (facets%side(2, k) > 0) then
         i = i + 1
         self%facet(:, i) = facets%x(:, k)
         self%area(:, i) = facets%area(:, k)
         self%side(:, i) = number(facets%side(:, k))
      else
         ms = ms + 1
         self%surface(:, ms) = facets%x(:, k)
         self%outward(:, ms) = facets%area(:, k)
         self%set(ms) = facets%set(k)
         self%lift_first(ms + 1) = ms
         self%lift_point(ms) = number(facets%side(1, k))
         self%lift(ms) = 1.0_wp/self%weight(self%lift_point(ms))
      end if
   end do
end subroutine close_cells

end module rk_nodal
