!> Gradients of the approximation at integration points, with prescribed values on the surface
!> lifted into them.
!>
!> On the part of the surface where a component is prescribed, u - g is lifted into the body and
!> subtracted from the gradient: F = 1 + grad u - L(u - g). With smoothed gradients this replaces u
!> by g in the integral over the facets. A constant stress then does no work on test functions,
!> whatever their values on the surface: the prescribed values require no interpolation property, no
!> multipliers, and no large penalty.
!>
!> Reference: Bassi, Rebay, J. Comput. Phys. 131 (1997), doi:10.1006/jcph.1996.5572 (the lifting)
module rk_gradient
   use, intrinsic :: iso_c_binding, only : c_double, c_int, c_int64_t
   use rk_alike, only : find_alike
   use rk_cells, only : cells_type
   use rk_csr, only : csr_type, group_by
   use rk_precision, only : i8, wp
   use rk_shape, only : shape_type
   use rk_solid_products, only : plane_force, plane_gradient, plane_work, solid_force, &
      & solid_gradient, solid_work
   implicit none
   private

   public :: gradient_type, new_gradient

   !> Gradient of each component of the fields at each point; the fields are the displacement, or a
   !> single scalar
   type :: gradient_type
      !> Space dimension, and components of the fields
      integer :: nd = 0
      integer :: fields = 0
      !> Number of points of a cell, which are stored consecutively
      integer :: per_cell = 1
      !> Point q has entries start(q)+1 : start(q+1), shape (np + 1)
      integer(i8), allocatable :: start(:)
      !> Place of each entry's source point among those of its group
      integer, allocatable :: local(:)
      !> Source points of each group, ascending
      type(csr_type) :: member
      !> Component i of point q has its values at value(:, first(i, q)+1 : ), which may be shared
      !> with other points, shape (fields, np)
      integer(i8), allocatable :: first(:, :)
      !> Gradients of the shape functions, shape (nd, :) [1/length]
      real(wp), allocatable :: value(:, :)
      !> Part of the gradient due to prescribed values, for each load factor, shape (fields, nd, np,
      !> factors), index (i, A) [-]
      real(wp), allocatable :: given(:, :, :, :)
      !> Points that have such a part, shape (np)
      logical, allocatable :: lifts(:)
   contains
      procedure :: at => gradient_at
      !> Part of the gradient due to prescribed values
      procedure :: lifted
      !> Nodal forces of a stress
      procedure :: add_force
      procedure :: add_work
      !> Stiffness of tangent moduli
      procedure :: add_stiffness
      !> Set the prescribed values
      procedure :: set_essential
      !> Store equal gradients only once
      procedure :: share
   end type gradient_type

   interface
      !> Add the stiffness of some points of a cell (cell_stiffness.c)
      subroutine add_points(fields, nd, points, start, local, first, value, c4, members, room, &
         & part) bind(c, name='rk_add_stiffness')
         import :: c_double, c_int, c_int64_t
         integer(c_int), value :: fields, nd, points, members
         integer(c_int64_t), intent(in) :: start(*), first(*)
         integer(c_int), intent(in) :: local(*)
         real(c_double), intent(in) :: value(*), c4(*)
         real(c_double), intent(inout) :: room(*), part(*)
      end subroutine add_points

      !> Size of the work array that it needs
      pure function stiffness_room(fields, nd, points, members) result(room) &
         & bind(c, name='rk_stiffness_room')
         import :: c_int, c_int64_t
         integer(c_int), value :: fields, nd, points, members
         integer(c_int64_t) :: room
      end function stiffness_room
   end interface

contains

!> Set up the gradients
subroutine new_gradient(self, cells, ns, inside, facet, surface, held, essential, follows, &
   & source)
   type(gradient_type), intent(out) :: self
   !> Integration points
   type(cells_type), intent(in) :: cells
   !> Number of source points, plus the blocks of unknowns that follow them
   integer, intent(in) :: ns
   !> Shape functions at the points, the facets, the surface and the places of conditions
   type(shape_type), target, intent(in) :: inside, facet, surface, held
   !> Components prescribed at each surface point, shape (fields, ms)
   logical, intent(in) :: essential(:, :)
   !> Block whose unknown a prescribed component follows, 0 if none, shape (fields, ms)
   integer, intent(in) :: follows(:, :)
   !> Source points, shape (nd, n) [length]
   real(wp), intent(in) :: source(:, :)
   type(csr_type) :: facets, lifts, surfaces
   integer, allocatable :: surface_of(:), touched(:)
   real(wp), allocatable :: plain(:, :), common(:, :), slope(:, :, :), taken(:, :, :)
   real(wp), pointer, contiguous :: psi(:, :)
   integer, pointer, contiguous :: nodes(:)
   logical, allocatable :: seen(:)
   real(wp) :: centre(size(cells%point, 1))
   integer :: fields, nd, np, n, shared, pass, cell, q, s
   integer(i8) :: entries, values
   logical :: lifted

   nd = size(cells%point, 1)
   np = size(cells%point, 2)
   fields = size(essential, 1)
   self%nd = nd
   self%fields = fields
   self%per_cell = cells%per_cell
   allocate (surface_of(size(cells%lift_point)))
   do s = 1, size(cells%set)
      surface_of(cells%lift_first(s) + 1:cells%lift_first(s + 1)) = s
   end do
   call group_by(np, cells%lift_point, lifts)
   call group_by(np/cells%per_cell, reshape(cells%side, [size(cells%side)]), facets)
   call group_by(np/cells%per_cell, [(1 + (cells%lift_point(cells%lift_first(s) + 1) - 1) &
      & /cells%per_cell, s=1, size(cells%set))], surfaces)
   allocate (self%start(np + 1), self%first(fields, np))
   allocate (slope(nd, merge(nd, 0, cells%linear), ns), source=0.0_wp)
   allocate (plain(nd, ns), common(nd, ns), taken(nd, fields, ns), touched(ns), seen(ns))
   seen = .false.
   plain = 0.0_wp
   taken = 0.0_wp
   ! the first pass only counts entries
   do pass = 1, 2
      entries = 0
      values = 0
      do cell = 1, np/cells%per_cell
         n = 0
         if (cells%closed) call gather_cell()
         shared = n
         if (pass == 2) common(:, :shared) = plain(:, touched(:shared))
         do q = (cell - 1)*cells%per_cell + 1, cell*cells%per_cell
            n = shared
            if (pass == 2) call take_common()
            lifted = .false.
            call gather_point()
            self%start(q) = entries
            if (pass == 2 .and. cells%linear) call reproduce()
            if (pass == 2) call keep()
            entries = entries + n
            values = values + merge(fields*n, n, lifted)
            seen(touched(shared + 1:n)) = .false.
         end do
         seen(touched(:shared)) = .false.
         if (pass == 2) slope(:, :, touched(:shared)) = 0.0_wp
      end do
      self%start(np + 1) = entries
      if (pass == 1) allocate (self%local(entries), self%value(nd, values))
   end do
   call find_members(self, cells, ns)

contains

   !> Part common to all points of a closed cell: the mean gradient by the divergence theorem over
   !> its facets and surface, in place of the mean by quadrature; the first moments about its centre
   !> likewise give the slopes, shape (nd, nd, :), the last index that of source points [1/length^2]
   subroutine gather_cell()
      real(wp) :: volume, weight
      real(wp) :: moment(nd, nd)
      integer :: a, i, k, o
      integer(i8) :: e

      o = (cell - 1)*cells%per_cell
      weight = sum(cells%weight(o + 1:o + cells%per_cell))
      volume = weight
      if (allocated(cells%filled)) volume = volume/cells%filled(o + 1)
      centre = matmul(cells%point(:, o + 1:o + cells%per_cell), &
         & cells%weight(o + 1:o + cells%per_cell))/weight
      do e = facets%offset(cell) + 1, facets%offset(cell + 1)
         i = (facets%index(e) + 1)/2
         call gather(facet, i, merge(1, -1, mod(facets%index(e), 2) == 1)*cells%area(:, i)/volume, &
            & cells%facet(:, i) - centre)
      end do
      do e = surfaces%offset(cell) + 1, surfaces%offset(cell + 1)
         i = surfaces%index(e)
         call gather(surface, i, cells%outward(:, i)/volume, cells%surface(:, i) - centre)
      end do
      if (cells%smoothed) return
      do k = o + 1, o + cells%per_cell
         call gather_gradient(inside, k, -cells%weight(k)/weight, cells%point(:, k) - centre)
      end do
      if (pass == 1 .or. .not. cells%linear) return
      moment = 0.0_wp
      do k = o + 1, o + cells%per_cell
         associate (x => cells%point(:, k) - centre)
            do a = 1, nd
               moment(:, a) = moment(:, a) + x*x(a)*cells%weight(k)/weight
            end do
         end associate
      end do
      moment = reshape([moment(2, 2), -moment(2, 1), -moment(1, 2), moment(1, 1)], [2, 2]) &
         & /(moment(1, 1)*moment(2, 2) - moment(1, 2)**2)
      do k = 1, n
         associate (own => slope(:, :, touched(k)))
            do i = 1, nd
               own(i, :) = [own(i, 1)*moment(1, 1) + own(i, 2)*moment(2, 1), &
                  & own(i, 1)*moment(1, 2) + own(i, 2)*moment(2, 2)]
            end do
         end associate
      end do
   end subroutine gather_cell

   !> Mean and slopes of the cell at a point
   subroutine take_common()
      real(wp) :: arm(nd)
      integer :: a, k

      arm = cells%point(:, q) - centre
      do k = 1, shared
         plain(:, touched(k)) = common(:, k)
         do a = 1, size(slope, 2)
            plain(:, touched(k)) = plain(:, touched(k)) + slope(:, a, touched(k))*arm(a)
         end do
      end do
   end subroutine take_common

   !> Gradients of constant and linear functions are exact, whatever the rule of the arcs
   subroutine reproduce()
      real(wp) :: a(2, 2), mean(2), x(2)
      integer :: j, k

      call inside%row(q, nodes, psi)
      mean = 0.0_wp
      do k = 1, n
         mean = mean + plain(:, touched(k))
      end do
      do j = 1, size(nodes)
         plain(:, nodes(j)) = plain(:, nodes(j)) - psi(1, j)*mean
      end do
      a = 0.0_wp
      do k = 1, n
         if (touched(k) > size(source, 2)) cycle
         x = source(:, touched(k)) - cells%point(:, q)
         a(:, 1) = a(:, 1) + x*plain(1, touched(k))
         a(:, 2) = a(:, 2) + x*plain(2, touched(k))
      end do
      a = reshape([a(2, 2), -a(2, 1), -a(1, 2), a(1, 1)], [2, 2])/(a(1, 1)*a(2, 2) &
         & - a(1, 2)*a(2, 1))
      do k = 1, n
         plain(:, touched(k)) = [plain(1, touched(k))*a(1, 1) + plain(2, touched(k))*a(2, 1), &
            & plain(1, touched(k))*a(1, 2) + plain(2, touched(k))*a(2, 2)]
      end do
   end subroutine reproduce

   !> Gradients at a point in addition to those of its cell, and the part subtracted by lifting
   subroutine gather_point()
      integer :: d, i
      integer(i8) :: e

      if (cells%smoothed) then
         ! stabilisation couples all source points covering the centre; facets may miss some
         call gather(inside, q, [(0.0_wp, d=1, nd)])
      else if (pass == 2 .or. .not. cells%closed) then
         call gather_gradient(inside, q, 1.0_wp)
      end if
      do e = lifts%offset(q) + 1, lifts%offset(q + 1)
         i = surface_of(lifts%index(e))
         if (any(essential(:, i))) call gather_lift(i, cells%lift(lifts%index(e)))
      end do
   end subroutine gather_point

   !> Store the entries gathered at a point, and reset the work arrays
   subroutine keep()
      integer :: d, k

      self%local(entries + 1:entries + n) = touched(:n)
      do d = 1, fields
         self%first(d, q) = values
         if (lifted) self%first(d, q) = values + (d - 1)*n
      end do
      do k = 1, n
         do d = 1, merge(fields, 1, lifted)
            self%value(:, self%first(d, q) + k) = plain(:, touched(k)) - taken(:, d, touched(k))
         end do
      end do
      plain(:, touched(:n)) = 0.0_wp
      if (lifted) taken(:, :, touched(:n)) = 0.0_wp
   end subroutine keep

   !> Register a source point
   subroutine touch(node)
      integer, intent(in) :: node

      if (seen(node)) return
      seen(node) = .true.
      n = n + 1
      touched(n) = node
   end subroutine touch

   !> Add the values at a position times a vector
   subroutine gather(shape, ip, vector, arm)
      type(shape_type), target, intent(in) :: shape
      integer, intent(in) :: ip
      real(wp), intent(in) :: vector(:)
      real(wp), intent(in), optional :: arm(:)
      integer :: a, j

      call shape%row(ip, nodes, psi)
      do j = 1, size(nodes)
         call touch(nodes(j))
         if (pass == 2) plain(:, nodes(j)) = plain(:, nodes(j)) + psi(1, j)*vector
         if (pass == 1 .or. .not. cells%linear .or. .not. present(arm)) cycle
         do a = 1, nd
            slope(:, a, nodes(j)) = slope(:, a, nodes(j)) + psi(1, j)*vector*arm(a)
         end do
      end do
   end subroutine gather

   !> Add the gradients at a position times a factor
   subroutine gather_gradient(shape, ip, factor, arm)
      type(shape_type), target, intent(in) :: shape
      integer, intent(in) :: ip
      real(wp), intent(in) :: factor
      real(wp), intent(in), optional :: arm(:)
      integer :: a, j

      call shape%row(ip, nodes, psi)
      do j = 1, size(nodes)
         call touch(nodes(j))
         if (pass == 2) plain(:, nodes(j)) = plain(:, nodes(j)) + factor*psi(2:1 + nd, j)
         if (pass == 1 .or. .not. cells%linear .or. .not. present(arm)) cycle
         do a = 1, nd
            slope(:, a, nodes(j)) = slope(:, a, nodes(j)) + factor*psi(2:1 + nd, j)*arm(a)
            slope(a, a, nodes(j)) = slope(a, a, nodes(j)) + factor*psi(1, j)
         end do
      end do
   end subroutine gather_gradient

   !> Part subtracted by the lifting of a surface point
   subroutine gather_lift(ip, factor)
      integer, intent(in) :: ip
      real(wp), intent(in) :: factor
      integer :: c, j

      lifted = .true.
      call held%row(ip, nodes, psi)
      do j = 1, size(nodes)
         call touch(nodes(j))
         if (pass == 1) cycle
         do c = 1, fields
            if (.not. essential(c, ip)) cycle
            taken(:, c, nodes(j)) = taken(:, c, nodes(j)) + factor*psi(1, j)*cells%outward(:, ip)
         end do
      end do
      do c = 1, fields
         if (follows(c, ip) == 0) cycle
         call touch(follows(c, ip))
         if (pass == 1) cycle
         associate (own => taken(:, c, follows(c, ip)))
            own = own - factor*cells%outward(:, ip)
         end associate
      end do
   end subroutine gather_lift

end subroutine new_gradient

!> Source points of each group of cells; replace the source points of entries by places among them
subroutine find_members(self, cells, ns)
   !> Gradients, whose entries are still numbers of source points
   type(gradient_type), intent(inout) :: self
   !> Integration points
   type(cells_type), intent(in) :: cells
   !> Number of source points, plus the blocks of unknowns that follow them
   integer, intent(in) :: ns
   integer, allocatable :: touched(:)
   logical, allocatable :: seen(:)
   integer(i8) :: e, entries
   integer :: g, i, k, n, pass

   allocate (self%member%offset(size(cells%first)), touched(ns), seen(ns))
   seen = .false.
   self%member%offset(1) = 0
   do pass = 1, 2
      entries = 0
      do g = 1, size(cells%first) - 1
         n = 0
         do e = self%start(cells%first(g) + 1) + 1, self%start(cells%first(g + 1) + 1)
            if (seen(self%local(e))) cycle
            seen(self%local(e)) = .true.
            n = n + 1
            touched(n) = self%local(e)
         end do
         if (pass == 2) then
            k = 0
            do i = minval(touched(:n)), maxval(touched(:n))
               if (.not. seen(i)) cycle
               k = k + 1
               self%member%index(entries + k) = i
            end do
         end if
         seen(touched(:n)) = .false.
         entries = entries + n
         self%member%offset(g + 1) = entries
      end do
      if (pass == 1) allocate (self%member%index(entries))
   end do
   do g = 1, size(cells%first) - 1
      do e = self%member%offset(g) + 1, self%member%offset(g + 1)
         touched(self%member%index(e)) = int(e - self%member%offset(g))
      end do
      do e = self%start(cells%first(g) + 1) + 1, self%start(cells%first(g + 1) + 1)
         self%local(e) = touched(self%local(e))
      end do
   end do
end subroutine find_members

!> Lift the prescribed values
subroutine set_essential(self, cells, essential, value)
   class(gradient_type), intent(inout) :: self
   !> Integration points
   type(cells_type), intent(in) :: cells
   !> Components prescribed at each surface point, shape (fields, ms)
   logical, intent(in) :: essential(:, :)
   !> Their values for each load factor, shape (factors, fields, ms) [length]
   real(wp), intent(in) :: value(:, :, :)
   integer :: a, c, k, s

   if (allocated(self%given)) deallocate (self%given, self%lifts)
   allocate (self%lifts(size(self%start) - 1), source=.false.)
   allocate (self%given(self%fields, self%nd, size(self%start) - 1, size(value, 1)), source=0.0_wp)
   do a = 1, size(value, 1)
      do s = 1, size(cells%set)
         do k = cells%lift_first(s) + 1, cells%lift_first(s + 1)
            self%lifts(cells%lift_point(k)) = self%lifts(cells%lift_point(k)) &
               & .or. any(essential(:, s))
            associate (given => self%given(:, :, cells%lift_point(k), a))
               do c = 1, self%fields
                  if (essential(c, s)) given(c, :) = given(c, :) &
                     & + cells%lift(k)*value(a, c, s)*cells%outward(:, s)
               end do
            end associate
         end do
      end do
   end do
end subroutine set_essential

!> Store gradients that differ only by rounding once: most cells of a lattice are alike, and data
!> that stay in the cache need not be read
subroutine share(self)
   class(gradient_type), intent(inout) :: self
   integer, allocatable :: same(:)
   integer(i8), allocatable :: first(:, :), number(:)
   real(wp), allocatable :: value(:, :)
   integer(i8) :: l, values
   integer :: q

   associate (entries => self%start(2:) - self%start(:size(self%start) - 1))
      number = merge(1, self%fields, self%first(1, :) == self%first(self%fields, :))*entries
   end associate
   call find_alike(self%nd*self%first(1, :), self%nd*number, self%value, same)
   values = sum(number, mask=same == [(q, q=1, size(same))])
   if (values == sum(number)) return
   allocate (value(size(self%value, 1), values))
   allocate (first, mold=self%first)
   values = 0
   do q = 1, size(same)
      if (same(q) < q) then
         first(:, q) = first(:, same(q))
         cycle
      end if
      l = self%first(1, q)
      value(:, values + 1:values + number(q)) = self%value(:, l + 1:l + number(q))
      first(:, q) = self%first(:, q) - l + values
      values = values + number(q)
   end do
   call move_alloc(first, self%first)
   call move_alloc(value, self%value)
end subroutine share

!> Displacement gradient at a point
pure subroutine gradient_at(self, q, x, factor, h)
   class(gradient_type), intent(in) :: self
   !> Point
   integer, intent(in) :: q
   !> Coefficients of the group's source points, shape (fields, members) [length]
   real(wp), contiguous, intent(in) :: x(:, :)
   !> Load factors, shape (factors); if empty, no values are lifted [-]
   real(wp), intent(in) :: factor(:)
   !> Gradient u_i,A with the lifting, shape (fields, nd) [-]
   real(wp), intent(out) :: h(:, :)
   integer(i8) :: e
   integer :: i, k

   h = 0.0_wp
   if (self%lifts(q)) h = self%lifted(q, factor)
   if (self%fields == 3 .and. self%first(1, q) == self%first(self%fields, q)) then
      ! the usual case in a solid
      call solid_gradient(int(self%start(q + 1) - self%start(q)), self%local(self%start(q) &
         & + 1:), self%value(:, self%first(1, q) + 1:), x, h)
      return
   end if
   if (self%fields == 2) then
      call plane_gradient(int(self%start(q + 1) - self%start(q)), self%local(self%start(q) + 1:), &
         & self%value(:, self%first(1, q) + 1:), self%value(:, self%first(2, q) + 1:), x, h)
      return
   end if
   do e = self%start(q) + 1, self%start(q + 1)
      k = int(e - self%start(q))
      do i = 1, self%fields
         h(i, :) = h(i, :) + x(i, self%local(e))*self%value(:, self%first(i, q) + k)
      end do
   end do
end subroutine gradient_at

!> Part of the gradient at a point due to prescribed values, u_i,A [-]
pure function lifted(self, q, factor) result(h)
   class(gradient_type), intent(in) :: self
   !> Point
   integer, intent(in) :: q
   !> Load factors or their change, shape (factors); if empty, the part is zero [-]
   real(wp), intent(in) :: factor(:)
   real(wp) :: h(self%fields, self%nd)
   integer :: a

   h = 0.0_wp
   if (.not. self%lifts(q)) return
   do a = 1, size(factor)
      h = h + factor(a)*self%given(:, :, q, a)
   end do
end function lifted

!> Add the internal forces of a stress
pure subroutine add_force(self, q, p, force)
   class(gradient_type), intent(in) :: self
   !> Point
   integer, intent(in) :: q
   !> First Piola-Kirchhoff stress times weight, shape (3, 3), index (i, A) [stress length^nd]
   real(wp), intent(in) :: p(:, :)
   !> Forces on the group's source points, shape (fields, members) [force]
   real(wp), contiguous, intent(inout) :: force(:, :)
   integer(i8) :: e
   integer :: i, k

   if (self%fields == 3 .and. self%first(1, q) == self%first(self%fields, q)) then
      call solid_force(int(self%start(q + 1) - self%start(q)), self%local(self%start(q) + 1:), &
         & self%value(:, self%first(1, q) + 1:), p(:3, :3), force)
      return
   end if
   if (self%fields == 2) then
      call plane_force(int(self%start(q + 1) - self%start(q)), self%local(self%start(q) + 1:), &
         & self%value(:, self%first(1, q) + 1:), self%value(:, self%first(2, q) + 1:), &
         & p(:2, :2), force)
      return
   end if
   do e = self%start(q) + 1, self%start(q + 1)
      k = int(e - self%start(q))
      do i = 1, self%fields
         force(i, self%local(e)) = force(i, self%local(e)) &
            & + dot_product(p(i, :self%nd), self%value(:, self%first(i, q) + k))
      end do
   end do
end subroutine add_force

!> Add the work of a stress at a point on the displacements, with several factors
pure subroutine add_work(self, q, p, factor, work)
   class(gradient_type), intent(in) :: self
   !> Point
   integer, intent(in) :: q
   !> First Piola-Kirchhoff stress times weight, shape (3, 3), index (i, A) [stress length^nd]
   real(wp), intent(in) :: p(:, :)
   !> Factors, as many as a group in space has polynomials
   real(wp), intent(in) :: factor(4)
   !> Work on the displacements of the group's source points, shape (4, fields, members)
   real(wp), contiguous, intent(inout) :: work(:, :, :)
   real(wp) :: force
   integer(i8) :: e
   integer :: i, k

   if (self%fields == 3 .and. self%first(1, q) == self%first(self%fields, q)) then
      call solid_work(int(self%start(q + 1) - self%start(q)), self%local(self%start(q) + 1:), &
         & self%value(:, self%first(1, q) + 1:), p(:3, :3), factor, work)
      return
   end if
   if (self%fields == 2) then
      call plane_work(int(self%start(q + 1) - self%start(q)), self%local(self%start(q) + 1:), &
         & self%value(:, self%first(1, q) + 1:), self%value(:, self%first(2, q) + 1:), &
         & p(:2, :2), factor, work)
      return
   end if
   do e = self%start(q) + 1, self%start(q + 1)
      k = int(e - self%start(q))
      do i = 1, self%fields
         force = dot_product(p(i, :self%nd), self%value(:, self%first(i, q) + k))
         work(:4, i, self%local(e)) = work(:4, i, self%local(e)) + force*factor
      end do
   end do
end subroutine add_work

!> Add the stiffness of tangent moduli at the points of a group, cell by cell
subroutine add_stiffness(self, o, c4, part)
   class(gradient_type), intent(in) :: self
   !> Number of points before the group
   integer, intent(in) :: o
   !> Moduli times weight at its points, shape (3, 3, 3, 3, n) [stress length^nd]
   real(wp), contiguous, intent(in) :: c4(:, :, :, :, :)
   !> Stiffness of its source points, to which the upper triangle is added, shape (fields*members,
   !> fields*members) [force/length]
   real(wp), contiguous, intent(inout) :: part(:, :)
   real(wp), allocatable :: room(:)
   integer :: n, q

   ! points of a cell have nearly the same source points, those of a group twice as many
   n = merge(size(c4, 5), self%per_cell, self%per_cell == 1)
   associate (members => size(part, 1)/self%fields)
      allocate (room(stiffness_room(self%fields, self%nd, n, members)))
      do q = 1, size(c4, 5), n
         call add_points(self%fields, self%nd, n, self%start(o + q:), self%local, &
            & self%first(:, o + q:), self%value, c4(:, :, :, :, q:), members, room, part)
      end do
   end associate
end subroutine add_stiffness

end module rk_gradient
