!> Facets of nodal cells, collected one by one, and the integration points that they enclose.
module rk_facets
   use rk_cells, only : cells_type
   use rk_csr, only : csr_type, group_by
   use rk_precision, only : wp
   use rk_tensor, only : vector_product
   implicit none
   private

   public :: facets_type, add_flat, close_cells

   !> Points of facets, grown as they come
   type :: facets_type
      integer :: n = 0
      !> Place, area times normal, cells on both sides (the second 0 on the surface), boundary set
      real(wp), allocatable :: x(:, :)
      real(wp), allocatable :: area(:, :)
      !> Area of the body behind a facet of the surface over its own [-]
      real(wp), allocatable :: part(:)
      integer, allocatable :: side(:, :)
      integer, allocatable :: set(:)
      !> Boundary entry on the surface of a model, 0 elsewhere
      integer, allocatable :: entry(:)
   contains
      !> Add a point
      procedure :: add
   end type facets_type

contains

!> Add a point
subroutine add(self, x, area, cell, other, set, part, entry)
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
   !> Area of the body behind the facet over its own, all if not given [-]
   real(wp), intent(in), optional :: part
   !> Boundary entry on the surface of a model
   integer, intent(in), optional :: entry
   integer :: room

   if (.not. allocated(self%x)) allocate (self%x(size(x), 64), self%area(size(x), 64), &
      & self%side(2, 64), self%set(64), self%part(64), self%entry(64))
   if (self%n == size(self%set)) then
      room = 2*self%n
      call grow(self%x, room)
      call grow(self%area, room)
      self%side = reshape(self%side, [2, room], pad=[0])
      self%set = reshape(self%set, [room], pad=[0])
      self%entry = reshape(self%entry, [room], pad=[0])
      self%part = reshape(self%part, [room], pad=[0.0_wp])
   end if
   self%n = self%n + 1
   self%x(:, self%n) = x
   self%area(:, self%n) = area
   self%side(:, self%n) = [cell, other]
   self%set(self%n) = set
   self%entry(self%n) = 0
   if (present(entry)) self%entry(self%n) = entry
   self%part(self%n) = 1.0_wp
   if (present(part)) self%part(self%n) = part
end subroutine add

!> Add four points that have area, centre and second moments of a flat facet in space: the Gauss
!> points of a rectangle
subroutine add_flat(self, area, centre, moment, first, cell, other, set)
   !> Facets
   class(facets_type), intent(inout) :: self
   !> Area times normal, out of the cell [length^2]
   real(wp), intent(in) :: area(3)
   !> Centre [length]
   real(wp), intent(in) :: centre(3)
   !> Second moments about it over the area [length^2]
   real(wp), intent(in) :: moment(3, 3)
   !> A direction in the plane, of any length
   real(wp), intent(in) :: first(3)
   !> Cell, and the one on the other side, 0 on the surface
   integer, intent(in) :: cell, other
   !> Boundary set on the surface
   integer, intent(in) :: set
   real(wp) :: axis(3, 2)
   integer :: k

   call main_axes(area/norm2(area), first, moment, axis)
   do k = 0, 3
      call self%add(centre + merge(1, -1, btest(k, 0))*axis(:, 1) &
         & + merge(1, -1, btest(k, 1))*axis(:, 2), 0.25_wp*area, cell, other, set)
   end do
end subroutine add_flat

!> Main axes of the second moments of a flat facet, as long as its deviations along them
pure subroutine main_axes(normal, first, moment, axis)
   !> Unit normal
   real(wp), intent(in) :: normal(3)
   !> A direction in the plane, of any length
   real(wp), intent(in) :: first(3)
   !> Second moments about the centre over the area [length^2]
   real(wp), intent(in) :: moment(3, 3)
   !> Axes [length]
   real(wp), intent(out) :: axis(3, 2)
   real(wp) :: e(3), f(3), angle, along, across, mixed

   e = first/norm2(first)
   f = vector_product(normal, e)
   along = dot_product(e, matmul(moment, e))
   across = dot_product(f, matmul(moment, f))
   mixed = dot_product(e, matmul(moment, f))
   ! what is alike in all directions has no axes but rounding
   angle = 0.0_wp
   if (hypot(2.0_wp*mixed, along - across) > 1.0e-9_wp*(along + across)) &
      & angle = 0.5_wp*atan2(2.0_wp*mixed, along - across)
   axis(:, 1) = cos(angle)*e + sin(angle)*f
   axis(:, 2) = cos(angle)*f - sin(angle)*e
   axis(:, 1) = axis(:, 1)*sqrt(max(dot_product(axis(:, 1), matmul(moment, axis(:, 1))), 0.0_wp))
   axis(:, 2) = axis(:, 2)*sqrt(max(dot_product(axis(:, 2), matmul(moment, axis(:, 2))), 0.0_wp))
end subroutine main_axes

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
subroutine close_cells(self, cells, facets, group, filled)
   !> Points
   type(cells_type), intent(inout) :: self
   !> Cells
   integer, intent(in) :: cells
   !> Facets
   type(facets_type), intent(in) :: facets
   !> Group of each cell, from 1; groups without cells are left out, shape (cells)
   integer, intent(in) :: group(:)
   !> Part of each cell's volume that counts, all if not allocated, shape (cells) [-]
   real(wp), allocatable, intent(in) :: filled(:)
   type(csr_type) :: members
   integer :: number(cells), i, k, nd, side, ms, d
   real(wp) :: area(size(facets%x, 1)), x(size(facets%x, 1))

   nd = size(facets%x, 1)
   call group_by(maxval(group), group, members)
   associate (offset => members%offset)
      self%first = [0, pack(int(offset(2:)), offset(2:) > offset(:size(offset) - 1))]
   end associate
   self%smoothed = .true.
   self%node = members%index
   number(self%node) = [(i, i=1, cells)]
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

   ! the quadrature of oblique facets is exact for linear functions only
   do i = 1, cells
      self%moment(:, :, i) = 0.5_wp*(self%moment(:, :, i) + transpose(self%moment(:, :, i)))
   end do

   ms = count(facets%side(2, :facets%n) == 0)
   allocate (self%facet(nd, facets%n - ms), self%area(nd, facets%n - ms), &
      & self%side(2, facets%n - ms))
   allocate (self%surface(nd, ms), self%outward(nd, ms), self%set(ms), self%part(ms))
   allocate (self%lift_first(ms + 1), self%lift_point(ms), self%lift(ms))
   i = 0
   ms = 0
   if (any(facets%entry(:facets%n) > 0)) self%entry = pack(facets%entry(:facets%n), &
      & facets%side(2, :facets%n) == 0)
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
         self%part(ms) = facets%part(k)
         self%lift_first(ms + 1) = ms
         self%lift_point(ms) = number(facets%side(1, k))
         self%lift(ms) = 1.0_wp/self%weight(self%lift_point(ms))
      end if
   end do
   if (.not. allocated(filled)) return
   self%filled = filled(self%node)
   self%weight = self%filled*self%weight
   do i = 1, cells
      self%moment(:, :, i) = self%filled(i)*self%moment(:, :, i)
   end do
end subroutine close_cells

end module rk_facets
