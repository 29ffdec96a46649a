!> Facets of nodal cells, collected one by one, and the integration points that they enclose.
module rk_facets
   use rk_cells, only : cells_type
   use rk_csr, only : csr_type, group_by
   use rk_precision, only : i8, wp
   implicit none
   private

   public :: facets_type, close_cells

   !> Points of facets; the arrays grow as points are added
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
      procedure :: add
   end type facets_type

contains

!> Add a point
subroutine add(self, x, area, cell, other, set, part, entry)
   class(facets_type), intent(inout) :: self
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Area times normal, out of the cell, shape (nd) [length^(nd-1)]
   real(wp), intent(in) :: area(:)
   !> Cell, and the one on the other side, 0 on the surface
   integer, intent(in) :: cell, other
   !> Boundary set on the surface
   integer, intent(in) :: set
   !> Area of the body behind the facet over its own; 1 if not given [-]
   real(wp), intent(in), optional :: part
   !> Boundary entry on the surface of a model
   integer, intent(in), optional :: entry
   integer :: room

   if (.not. allocated(self%x)) allocate (self%x(size(x), 64), self%area(size(x), 64), &
      & self%side(2, 64), self%set(64), self%part(64), self%entry(64))
   if (self%n == size(self%set)) then
      room = 2*self%n
      self%x = reshape(self%x, [size(x), room], pad=[0.0_wp])
      self%area = reshape(self%area, [size(x), room], pad=[0.0_wp])
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

!> Integration points from facets: volumes, centres and moments by the divergence theorem. A cell in
!> several groups has a point in each, which represents a share of it and of its facets
subroutine close_cells(self, cells, facets, group, filled)
   type(cells_type), intent(inout) :: self
   integer, intent(in) :: cells
   type(facets_type), intent(in) :: facets
   !> Groups of each cell, from 1; groups without cells are left out, shape (slots, cells)
   integer, intent(in) :: group(:, :)
   !> Filled fraction of each cell's volume; 1 if not allocated, shape (cells) [-]
   real(wp), allocatable, intent(in) :: filled(:)
   type(csr_type) :: copies
   integer :: i, k, nd, side, ms, mf, d
   integer(i8) :: a, b
   real(wp), allocatable :: share(:), weight(:), point(:, :), moment(:, :, :)
   real(wp) :: area(size(facets%x, 1)), x(size(facets%x, 1))

   nd = size(facets%x, 1)
   call list_points(group, self%first, self%node, share)
   call group_by(cells, self%node, copies)
   self%smoothed = .true.
   allocate (point(nd, cells), weight(cells), moment(nd, nd, cells), source=0.0_wp)
   do k = 1, facets%n
      do side = 1, merge(1, 2, facets%side(2, k) == 0)
         i = facets%side(side, k)
         area = merge(1, -1, side == 1)*facets%area(:, k)
         weight(i) = weight(i) + dot_product(facets%x(:, k), area)/nd
         point(:, i) = point(:, i) + 0.5_wp*facets%x(:, k)**2*area
      end do
   end do
   do i = 1, cells
      point(:, i) = point(:, i)/weight(i)
   end do
   do k = 1, facets%n
      do side = 1, merge(1, 2, facets%side(2, k) == 0)
         i = facets%side(side, k)
         area = merge(1, -1, side == 1)*facets%area(:, k)
         x = facets%x(:, k) - point(:, i)
         do d = 1, nd
            moment(:, d, i) = moment(:, d, i) + 0.5_wp*x**2*x(d)*area
            moment(d, d, i) = moment(d, d, i) - x(d)**3*area(d)/6.0_wp
         end do
      end do
   end do
   self%point = point(:, self%node)
   self%weight = share*weight(self%node)
   allocate (self%moment(nd, nd, size(share)))
   do i = 1, size(share)
      ! the quadrature of oblique facets is exact for linear functions only
      associate (own => moment(:, :, self%node(i)))
         self%moment(:, :, i) = 0.5_wp*share(i)*(own + transpose(own))
      end associate
   end do

   ms = 0
   mf = 0
   do k = 1, facets%n
      if (facets%side(2, k) == 0) then
         ms = ms + points_of(facets%side(1, k))
      else
         mf = mf + points_of(facets%side(1, k))*points_of(facets%side(2, k))
      end if
   end do
   allocate (self%facet(nd, mf), self%area(nd, mf), self%side(2, mf))
   allocate (self%surface(nd, ms), self%outward(nd, ms), self%set(ms), self%part(ms))
   allocate (self%lift_point(ms), self%lift(ms))
   if (any(facets%entry(:facets%n) > 0)) allocate (self%entry(ms))
   self%lift_first = [(i, i=0, ms)]
   mf = 0
   ms = 0
   do k = 1, facets%n
      do a = copies%offset(facets%side(1, k)) + 1, copies%offset(facets%side(1, k) + 1)
         i = copies%index(a)
         if (facets%side(2, k) > 0) then
            do b = copies%offset(facets%side(2, k)) + 1, copies%offset(facets%side(2, k) + 1)
               mf = mf + 1
               self%facet(:, mf) = facets%x(:, k)
               self%area(:, mf) = share(i)*share(copies%index(b))*facets%area(:, k)
               self%side(:, mf) = [i, copies%index(b)]
            end do
         else
            ms = ms + 1
            self%surface(:, ms) = facets%x(:, k)
            self%outward(:, ms) = share(i)*facets%area(:, k)
            self%set(ms) = facets%set(k)
            self%part(ms) = facets%part(k)
            if (allocated(self%entry)) self%entry(ms) = facets%entry(k)
            self%lift_point(ms) = i
            self%lift(ms) = 1.0_wp/self%weight(i)
         end if
      end do
   end do
   if (.not. allocated(filled)) return
   self%filled = filled(self%node)
   self%weight = self%filled*self%weight
   do i = 1, size(share)
      self%moment(:, :, i) = self%filled(i)*self%moment(:, :, i)
   end do

contains

   pure integer function points_of(cell)
      integer, intent(in) :: cell

      points_of = int(copies%offset(cell + 1) - copies%offset(cell))
   end function points_of

end subroutine close_cells

!> Points of all cells, sorted by group: one for each group to which a cell belongs
pure subroutine list_points(group, first, cell, share)
   !> Groups of each cell, from 1, shape (slots, cells)
   integer, intent(in) :: group(:, :)
   !> Group g has points first(g)+1 : first(g+1), groups without points left out
   integer, allocatable, intent(out) :: first(:)
   !> Cell of each point, and the share of the cell that the point represents [-]
   integer, allocatable, intent(out) :: cell(:)
   real(wp), allocatable, intent(out) :: share(:)
   type(csr_type) :: members
   integer, allocatable :: all_of(:), in_group(:)
   integer :: n, i, s
   real(wp), allocatable :: part(:)

   allocate (all_of(size(group)), in_group(size(group)), part(size(group)))
   n = 0
   do i = 1, size(group, 2)
      do s = 1, size(group, 1)
         if (any(group(:s - 1, i) == group(s, i))) cycle
         n = n + 1
         all_of(n) = i
         in_group(n) = group(s, i)
         part(n) = count(group(:, i) == group(s, i))/real(size(group, 1), wp)
      end do
   end do
   call group_by(maxval(group), in_group(:n), members)
   associate (offset => members%offset)
      first = [0, pack(int(offset(2:)), offset(2:) > offset(:size(offset) - 1))]
   end associate
   cell = all_of(members%index)
   share = part(members%index)
end subroutine list_points

end module rk_facets
