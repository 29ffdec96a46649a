!> Gauss points in the cells between the source points of a lattice.
!>
!> Cells come in groups of two in each direction, within which the volume change is projected. If
!> their number is odd, one or three are left over. In space each of these forms a group in the
!> middle, without a pressure that varies along its width: groups of three cells resist an exchange
!> of volume between cells hardly at all (a rubber cube of 5^3 cells between plates, 30 % shorter: J
!> from 0.08 to 4.0). In the plane one group of three in the middle does no harm, but where pairs
!> would leave several such groups, and with five cells, there is one cell in the middle. Functions
!> of order 1 would lock with a pressure that varies across it. 3 x 3 cells are separate groups as
!> in space: one group for all of them hardly resists any change of volume (a square held at a side
!> and pressed on top: 38 % off, 1 % with nine).
!>
!> Faces that are cut by the border of a named set have Gauss points in each of the parts; faces on
!> which a traction jumps have finer points.
!>
!> Planes on which materials meet cut cells, and groups end there, so that each has one material. In
!> the plane groups between them are at least two spacings wide, in space at most two and a half.
module rk_gauss_cells
   use rk_borders, only : border_rule, face_rule, tensor_rule
   use rk_cells, only : cells_type
   use rk_cloud, only : cloud_type
   use rk_conditions, only : conditions_at
   use rk_error, only : error_type, fatal_error, err_input
   use rk_gauss, only : gauss_rule
   use rk_lattice, only : digits_of, lattice_frame, place_of, set_number
   use rk_named_sets, only : sets_of
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   implicit none
   private

   public :: gauss_cells

   !> Number of cells between source points that form a group, in each direction
   integer, parameter :: group_size = 2
   !> Maximum width in spacings of a group in space that ends at a plane
   real(wp), parameter :: widest = 2.5_wp
   !> Groups that end at a plane and are thinner (in spacings) have no pressure varying across
   real(wp), parameter :: thinnest = 1.5_wp
   !> Planes closer than this to corners of cells, in spacings, are taken to lie on them [-]
   real(wp), parameter :: same_line = 1.0e-6_wp
   !> Subdivisions of a face in each direction where a traction jumps, by space dimension
   integer, parameter :: parts(3) = [1, 64, 12]
   !> Error allowed in the force on a face, relative to the largest of its component on any face: a
   !> jump anywhere between the points exceeds it, the error for smooth tractions is smaller [-]
   real(wp), parameter :: of_traction = 0.01_wp

   !> Cells of a lattice
   type :: lattice_type
      !> Space dimension; cells in each direction, 1 in unused directions
      integer :: nd = 0
      integer :: cells(3) = 1
      !> Coordinates are radius and angle
      logical :: polar = .false.
      !> First corner and size of a cell
      real(wp) :: low(3) = 0.0_wp
      real(wp) :: step(3) = 0.0_wp
      !> Coordinates of the corners where their spacing varies
      real(wp), allocatable :: line(:, :)
      !> The same in spacings where planes cut cells; whole numbers at source points
      real(wp), allocatable :: number(:, :)
   contains
      procedure :: corner, place, face_points
   end type lattice_type

contains

!> Gauss points in the cells between the source points of a lattice
subroutine gauss_cells(self, scene, error)
   type(cells_type), intent(out) :: self
   !> Scene, whose cloud has a lattice
   type(scene_type), target, intent(in) :: scene
   !> Error handling: no lattice
   type(error_type), allocatable, intent(out) :: error
   type(cloud_type), pointer :: cloud
   type(lattice_type) :: lattice
   type(face_rule) :: plain
   type(face_rule), allocatable :: own_rule(:)
   real(wp), allocatable :: xi(:, :), x(:, :), area(:, :)
   real(wp) :: jacobian, node(scene%galerkin%gauss), share(scene%galerkin%gauss)
   integer :: groups(3), cell(3), next(3), from(3), to(3), at(3), points(3)
   integer, allocatable :: number(:), bound(:, :), which(:, :)
   logical :: linear, whole
   integer :: nd, np, i, j, d, k, end, faces, ms, mf, own, count, degree

   cloud => scene%cloud
   count = scene%galerkin%gauss
   ! tractions of functions of order p have degree p - 1, which lifted values then reproduce
   degree = min(scene%approximation%order, count) - 1
   if (.not. allocated(cloud%lattice)) then
      call fatal_error(error, err_input, 'Gauss cells need the lattice of a box or an annulus, ' &
         & //'or a model of voxels: '//trim(merge( &
         & 'use method "rkpm-scni"                  ', &
         & 'build it from a label map, or use "rkcm"', allocated(cloud%voxels%index))))
      return
   end if
   nd = cloud%nd
   lattice%nd = nd
   lattice%polar = cloud%polar
   call lattice_frame(cloud, lattice%low, lattice%step)
   lattice%cells(:nd) = cloud%lattice - 1
   if (allocated(cloud%line)) allocate (lattice%line, source=cloud%line)
   if (allocated(scene%approximation%kink)) call cut_lattice(lattice, &
      & scene%approximation%kink_axis, scene%approximation%kink)
   call gauss_rule(node, share)
   plain = tensor_rule(1, count, nd)
   call find_cut(scene, lattice, plain, own_rule, which, error)
   if (allocated(error)) return
   own = count**nd
   points = 1
   points(:nd) = count
   associate (cells => lattice%cells)
      whole = nd == 3 .or. all(cells(:nd) == 3)
      linear = scene%approximation%order == 1
      allocate (bound(0:maxval(cells), 3))
      do d = 1, 3
         call arrange(lattice, d, whole, linear, groups(d), bound(:, d), &
            & scene%approximation%kink_axis, scene%approximation%kink)
      end do
      np = product(cells)*own
      mf = sum([(product(cells) - product(cells)/cells(d), d=1, nd)])*count**(nd - 1)
      faces = sum([(2*product(cells)/cells(d), d=1, nd)])*count**(nd - 1) &
         & + sum([(size(own_rule(k)%share) - count**(nd - 1), k=1, size(own_rule))])
      self%per_cell = own
      self%linear = lattice%polar .and. scene%approximation%order == 2
      allocate (self%facet(nd, mf), self%area(nd, mf), self%side(2, mf), number(product(cells)))
      allocate (self%point(nd, np), self%weight(np), self%first(product(groups) + 1))
      allocate (self%surface(nd, faces), self%outward(nd, faces), self%set(faces), &
         & self%face(faces))
      allocate (self%part(faces), source=1.0_wp)
      allocate (self%lift_point(faces*own), self%lift(faces*own))
      self%lift_first = [(own*k, k=0, faces)]
      allocate (self%thin(nd, product(groups)))
      self%first(1) = 0
      np = 0
      do i = 1, product(groups)
         call find_group(i)
         self%thin(:, i) = [(is_thin(d), d=1, nd)]
         do j = 1, product(to - from + 1)
            np = np + 1
            number(place_of(from + digits_of(j - 1, to - from + 1), cells)) = np
         end do
      end do
      np = 0
      ms = 0
      mf = 0
      do i = 1, size(self%first) - 1
         call find_group(i)
         do j = 1, product(to - from + 1)
            cell = from + digits_of(j - 1, to - from + 1)
            do k = 1, own
               at = digits_of(k - 1, points)
               call lattice%place(cell, node(at(:nd) + 1), self%point(:, np + k), jacobian)
               self%weight(np + k) = jacobian*product(share(at(:nd) + 1))
            end do
            do d = 1, nd
               do end = 0, 1
                  if (cell(d) == end*(cells(d) - 1)) then
                     k = which(2*d - 1 + end, place_of(cell, cells))
                     if (k > 0) then
                        call add_surface(own_rule(k))
                     else
                        call add_surface(plain)
                     end if
                  else if (end == 1) then
                     call add_facets()
                  end if
               end do
            end do
            np = np + own
         end do
         self%first(i + 1) = np
      end do
   end associate
   if (.not. any(self%thin)) deallocate (self%thin)

contains

   !> First and last cell of a group
   subroutine find_group(group)
      integer, intent(in) :: group
      integer :: g(3)

      g = digits_of(group - 1, groups)
      from = [(bound(g(d), d), d=1, 3)]
      to = [(bound(g(d) + 1, d) - 1, d=1, 3)]
   end subroutine find_group

   !> Whether a group is too thin in a direction for a pressure that varies along it
   pure logical function is_thin(d)
      integer, intent(in) :: d

      is_thin = (whole .or. linear) .and. to(d) == from(d)
      if (allocated(scene%approximation%kink)) is_thin = lattice%number(to(d) + 1, d) &
         & - lattice%number(from(d), d) < thinnest
      is_thin = is_thin .and. lattice%cells(d) > 1
   end function is_thin

   !> Gauss points of a face between two cells, at the upper end of the first
   subroutine add_facets()
      call lattice%face_points(cell, d, end, plain, xi, x, area)
      next = cell
      next(d) = cell(d) + 1
      do k = 1, size(x, 2)
         mf = mf + 1
         self%facet(:, mf) = x(:, k)
         self%area(:, mf) = area(:, k)
         self%side(:, mf) = [number(place_of(cell, lattice%cells)), &
            & number(place_of(next, lattice%cells))]
      end do
   end subroutine add_facets

   !> Points of a face on the surface
   subroutine add_surface(points_of)
      type(face_rule), intent(in) :: points_of
      integer :: q

      call lattice%face_points(cell, d, end, points_of, xi, x, area)
      do k = 1, size(x, 2)
         ms = ms + 1
         self%surface(:, ms) = x(:, k)
         self%outward(:, ms) = area(:, k)
         self%set(ms) = set_number(cloud%polar, d, end)
         self%face(ms) = 2*nd*(place_of(cell, lattice%cells) - 1) + 2*d - 1 + end
         do q = 1, own
            at = digits_of(q - 1, points)
            associate (eta => node(at(:nd) + 1), l => own*(ms - 1) + q)
               self%lift_point(l) = np + q
               self%lift(l) = product(kernel(eta, xi(:, k))*share(at(:nd) + 1)) &
                  & /self%weight(np + q)
            end associate
         end do
      end do
   end subroutine add_surface

   !> Reproducing kernel of Legendre polynomials up to the degree, in each direction
   elemental real(wp) function kernel(x, y)
      real(wp), intent(in) :: x, y
      real(wp) :: p(0:1), q(0:1)
      integer :: n

      p = [0.0_wp, 1.0_wp]
      q = p
      kernel = 0.5_wp
      do n = 1, degree
         p = [p(1), ((2*n - 1)*x*p(1) - (n - 1)*p(0))/n]
         q = [q(1), ((2*n - 1)*y*q(1) - (n - 1)*q(0))/n]
         kernel = kernel + 0.5_wp*(2*n + 1)*p(1)*q(1)
      end do
   end function kernel

end subroutine gauss_cells

!> Coordinates of the first corner of a cell, shape (nd)
pure function corner(self, cell) result(q)
   class(lattice_type), intent(in) :: self
   !> Cell, from 0
   integer, intent(in) :: cell(3)
   real(wp) :: q(self%nd)
   integer :: d

   q = self%low(:self%nd) + self%step(:self%nd)*cell(:self%nd)
   if (allocated(self%line)) q = [(self%line(cell(d), d), d=1, self%nd)]
end function corner

!> Place of a point of a cell
pure subroutine place(self, cell, xi, x, jacobian, map)
   class(lattice_type), intent(in) :: self
   !> Cell, from 0
   integer, intent(in) :: cell(3)
   !> Its point from -1 to 1, shape (nd)
   real(wp), intent(in) :: xi(:)
   !> Place, shape (nd) [length]
   real(wp), intent(out) :: x(:)
   !> Volume per volume of the square from -1 to 1 [length^nd]
   real(wp), intent(out) :: jacobian
   !> Derivatives of the place by xi, orthogonal columns, zero beyond nd [length]
   real(wp), intent(out), optional :: map(3, 3)
   real(wp) :: q(3), step(3)
   integer :: e

   q = 0.0_wp
   step = self%step
   if (present(map)) map = 0.0_wp
   associate (nd => self%nd)
      q(:nd) = self%low(:nd) + step(:nd)*(cell(:nd) + 0.5_wp*(1.0_wp + xi))
      if (allocated(self%line)) then
         step(:nd) = self%corner(cell + 1) - self%corner(cell)
         q(:nd) = self%corner(cell) + 0.5_wp*step(:nd)*(1.0_wp + xi)
      end if
      if (self%polar) then
         x = q(1)*[cos(q(2)), sin(q(2))]
         jacobian = 0.25_wp*step(1)*step(2)*q(1)
         if (.not. present(map)) return
         map(:2, 1) = 0.5_wp*step(1)*[cos(q(2)), sin(q(2))]
         map(:2, 2) = 0.5_wp*step(2)*q(1)*[-sin(q(2)), cos(q(2))]
      else
         x = q(:nd)
         jacobian = product(0.5_wp*step(:nd))
         if (.not. present(map)) return
         do e = 1, nd
            map(e, e) = 0.5_wp*step(e)
         end do
      end if
   end associate
end subroutine place

!> Points of a face of a cell
pure subroutine face_points(self, cell, axis, end, rule, xi, x, area)
   class(lattice_type), intent(in) :: self
   !> Cell, from 0
   integer, intent(in) :: cell(3)
   !> Direction across the face, and its lower (0) or upper (1) end
   integer, intent(in) :: axis, end
   type(face_rule), intent(in) :: rule
   !> Points of the cell from -1 to 1, their places [length], normals times area [length^(nd-1)],
   !> shape (nd, n) each
   real(wp), allocatable, intent(out) :: xi(:, :), x(:, :), area(:, :)
   real(wp) :: jacobian, map(3, 3)
   integer :: k

   associate (nd => self%nd, turn => self%step(2), n => size(rule%share))
      allocate (xi(nd, n), x(nd, n), area(nd, n))
      xi(:axis - 1, :) = rule%xi(:axis - 1, :)
      xi(axis, :) = 2.0_wp*end - 1.0_wp
      xi(axis + 1:, :) = rule%xi(axis:, :)
      do k = 1, n
         call self%place(cell, xi(:, k), x(:, k), jacobian, map)
         ! columns of the map are orthogonal: the face's area is the product of the others' lengths
         area(:, k) = xi(axis, k)*rule%share(k)*jacobian*map(:nd, axis)/sum(map(:, axis)**2)
      end do
      ! normals of an arc add up to that of its chord, so that the faces of a cell close
      if (self%polar .and. axis == 1) area = area*2.0_wp*sin(0.5_wp*turn) &
         & /sum(0.5_wp*turn*rule%share*cos(0.5_wp*turn*rule%xi(1, :)))
   end associate
end subroutine face_points

!> Find faces on the surface that are cut by borders of sets, or whose regular points do not capture
!> the traction, and their rules
subroutine find_cut(scene, lattice, plain, own, which, error)
   type(scene_type), intent(in) :: scene
   !> Its cells
   type(lattice_type), intent(in) :: lattice
   !> Rule of other faces
   type(face_rule), intent(in) :: plain
   type(face_rule), allocatable, intent(out) :: own(:)
   !> Rule of each face of each cell, 0 for the plain one, shape (2 nd, cells)
   integer, allocatable, intent(out) :: which(:, :)
   !> Error handling: an expression that is not finite
   type(error_type), allocatable, intent(out) :: error
   type(face_rule) :: rule
   type(face_rule), allocatable :: longer(:)
   real(wp), allocatable :: at(:, :), area(:, :)
   real(wp) :: low(lattice%nd), high(lattice%nd)
   integer, allocatable :: side_of(:)
   logical, allocatable :: within(:, :), outer(:, :), missed(:, :)
   integer :: c, cell(3), d, end, k, n
   logical :: cut

   associate (nd => lattice%nd, cells => lattice%cells, cloud => scene%cloud)
      allocate (own(0))
      allocate (which(2*nd, product(cells)), source=0)
      if (.not. (allocated(cloud%region) .or. any_varying(scene))) return
      allocate (outer(2*nd, product(cells)), missed(2*nd, product(cells)))
      do c = 1, size(outer, 2)
         cell = digits_of(c - 1, cells)
         outer(:, c) = [((cell(d) == end*(cells(d) - 1), end=0, 1), d=1, nd)]
      end do
      missed = .false.
      if (any_varying(scene)) call compare_tractions()
      if (allocated(error)) return
      n = 0
      allocate (longer(count(outer)))
      do c = 1, size(outer, 2)
         do k = 1, 2*nd
            if (.not. outer(k, c)) cycle
            d = (k + 1)/2
            end = k + 1 - 2*d
            cell = digits_of(c - 1, cells)
            low = lattice%corner(cell)
            high = lattice%corner(cell + 1)
            low(d) = merge(high(d), low(d), end == 1)
            high(d) = low(d)
            call border_rule(rule, cut, cloud, d, end, low, high, &
               & scene%galerkin%gauss, merge(parts(nd), 1, missed(k, c)), error)
            if (allocated(error)) return
            if (.not. (cut .or. missed(k, c))) cycle
            n = n + 1
            which(k, c) = n
            longer(n) = rule
         end do
      end do
      own = longer(:n)
   end associate

contains

   !> Points of a rule on all outer faces
   subroutine points_of(rule)
      type(face_rule), intent(in) :: rule
      real(wp), allocatable :: xi(:, :), x(:, :), outward(:, :)
      integer :: c, d, k, n, each

      each = size(rule%share)
      n = each*count(outer)
      if (allocated(at)) deallocate (at, area, side_of)
      allocate (at(lattice%nd, n), area(lattice%nd, n), side_of(n))
      n = 0
      do c = 1, size(outer, 2)
         do k = 1, size(outer, 1)
            if (.not. outer(k, c)) cycle
            d = (k + 1)/2
            associate (end => k + 1 - 2*d)
               call lattice%face_points(digits_of(c - 1, lattice%cells), d, end, rule, xi, x, &
                  & outward)
               side_of(n + 1:n + each) = set_number(scene%cloud%polar, d, end)
            end associate
            at(:, n + 1:n + each) = x
            area(:, n + 1:n + each) = outward
            n = n + each
         end do
      end do
   end subroutine points_of

   !> Mark faces on which the two rules differ
   subroutine compare_tractions()
      real(wp), allocatable :: exact(:, :), found(:, :)

      call integrate(tensor_rule(parts(lattice%nd), scene%galerkin%gauss, lattice%nd), exact)
      if (.not. allocated(error)) call integrate(plain, found)
      if (allocated(error)) return
      missed = unpack(any(abs(exact - found) > of_traction*spread(maxval(abs(exact), dim=2), 2, &
         & size(exact, 2)), dim=1), outer, .false.)
   end subroutine compare_tractions

   !> Forces on the faces
   subroutine integrate(rule, force)
      type(face_rule), intent(in) :: rule
      !> Forces of all load factors at some times, shape (3 factors times, faces) [force]
      real(wp), allocatable, intent(out) :: force(:, :)
      real(wp), dimension(scene%programme%count(), 3) :: value, traction
      real(wp), allocatable :: time(:)
      logical :: fixed(3)
      integer :: each, i, k

      each = size(rule%share)
      call points_of(rule)
      call sets_of(scene%cloud, at, area, side_of, within, error)
      if (allocated(error)) return
      time = [0.0_wp]
      ! times without a common period
      if (allocated(scene%motion)) time = scene%motion%end_time &
         & *[0.0_wp, 0.13_wp, 0.31_wp, 0.57_wp, 0.83_wp, 1.0_wp]
      allocate (force(size(traction)*size(time), size(at, 2)/each), source=0.0_wp)
      do i = 1, size(at, 2)
         do k = 1, size(time)
            call conditions_at(scene, within(scene%condition%set, i), &
               & at(:, i), fixed, value, traction, error, time(k))
            if (allocated(error)) return
            associate (own => force((k - 1)*size(traction) + 1:k*size(traction), &
               & 1 + (i - 1)/each))
               own = own + norm2(area(:, i))*reshape(traction, [size(traction)])
            end associate
         end do
      end do
   end subroutine integrate

end subroutine find_cut

!> Whether any traction is an expression of position
pure logical function any_varying(scene) result(any_)
   type(scene_type), intent(in) :: scene
   integer :: c, i

   any_ = any([((scene%condition(c)%traction(i)%given(), i=1, scene%cloud%nd), &
      & c=1, size(scene%condition))])
end function any_varying

!> Cut the cells of a box at planes
pure subroutine cut_lattice(self, axis, plane)
   type(lattice_type), intent(inout) :: self
   !> The axis across each plane, and its place [length]
   integer, intent(in) :: axis(:)
   real(wp), intent(in) :: plane(:)
   real(wp), allocatable :: line(:, :)
   real(wp) :: share
   integer :: at, d, k

   allocate (line(0:maxval(self%cells) + size(plane), self%nd), source=0.0_wp)
   allocate (self%number(0:ubound(line, 1), self%nd))
   do d = 1, self%nd
      if (allocated(self%line)) then
         line(:self%cells(d), d) = self%line(:self%cells(d), d)
      else
         line(:self%cells(d), d) = self%low(d) + self%step(d)*[(k, k=0, self%cells(d))]
      end if
      self%number(:, d) = [(k, k=0, size(line, 1) - 1)]
      do k = 1, size(plane)
         if (axis(k) /= d) cycle
         if (nearest_line(plane(k)) < same_line*self%step(d)) cycle
         at = count(line(:self%cells(d), d) < plane(k))
         associate (last => self%cells(d))
            line(at + 1:last + 1, d) = line(at:last, d)
            self%number(at + 1:last + 1, d) = self%number(at:last, d)
         end associate
         line(at, d) = plane(k)
         share = (line(at, d) - line(at - 1, d))/(line(at + 1, d) - line(at - 1, d))
         self%number(at, d) = (1.0_wp - share)*self%number(at - 1, d) &
            & + share*self%number(at + 1, d)
         self%cells(d) = self%cells(d) + 1
      end do
   end do
   call move_alloc(line, self%line)

contains

   !> Distance of the nearest corner of cells [length]
   pure real(wp) function nearest_line(x)
      real(wp), intent(in) :: x

      nearest_line = minval(abs(line(:self%cells(d), d) - x))
   end function nearest_line

end subroutine cut_lattice

!> Groups of cells in one direction: equal ones between planes, symmetric ones where there is no
!> plane, so that a mirrored body gives mirrored groups
subroutine arrange(self, d, whole, linear, groups, bound, axis, plane)
   type(lattice_type), intent(in) :: self
   !> Direction
   integer, intent(in) :: d
   !> Left-over cells form groups of one: all of them, or one in the middle where functions of order
   !> 1 would have more than one group of three
   logical, intent(in) :: whole, linear
   !> Number of groups
   integer, intent(out) :: groups
   !> First cell of each group, from 0, and at the end the number of cells
   integer, intent(inout) :: bound(0:)
   !> Planes on which materials meet: the axis across each, and its place [length]
   integer, intent(in), optional :: axis(:)
   real(wp), intent(in), optional :: plane(:)
   integer :: c, k, n, parts, start
   logical :: planes

   planes = .false.
   if (present(axis)) planes = any(axis == d)
   if (.not. planes) then
      call arrange_evenly()
      return
   end if
   groups = 0
   start = 0
   bound(0) = 0
   do c = 1, self%cells(d)
      if (c < self%cells(d) .and. .not. any(axis == d .and. abs(plane - self%line(c, d)) &
         & < 2.0_wp*same_line*self%step(d))) cycle
      associate (from => self%number(start, d), to => self%number(c, d))
         parts = parts_of(to - from)
         do k = 1, parts - 1
            n = start + minloc(abs(self%number(start + 1:c - 1, d) - from &
               & - k*(to - from)/parts), dim=1)
            groups = groups + 1
            bound(groups) = n
         end do
      end associate
      groups = groups + 1
      bound(groups) = c
      start = c
   end do

contains

   !> Number of groups between two planes: odd for an odd number of spacings, since no line then
   !> lies in the middle
   pure integer function parts_of(width) result(parts)
      !> Distance of the planes in spacings [-]
      real(wp), intent(in) :: width

      parts = max(1, int((width + 0.5_wp)/group_size + same_line))
      if (self%nd == 3) parts = max(1, ceiling(width/widest - same_line))
      if (abs(width - nint(width)) > same_line .or. mod(nint(width), 2) == 0) return
      if (mod(parts, 2) == 0) parts = parts + merge(1, -1, self%nd == 3 .or. nint(width) == 5)
   end function parts_of

   !> Groups in a direction without planes
   subroutine arrange_evenly()
      integer :: g, ones, pairs

      associate (cells => self%cells(d))
         ones = 0
         groups = max(1, cells/group_size)
         if (mod(cells, 2) == 1 .and. (whole .or. cells == 5 &
            & .or. (linear .and. mod(cells, 4) == 1))) then
            ones = merge(mod(cells, 4), 1, whole)
            groups = ones + (cells - ones)/group_size
         else if (mod(cells, 2) == 1 .and. mod(groups, 2) == 0) then
            ! the odd cell goes to the middle group of an odd number of groups
            groups = groups - 1
         end if
         pairs = (cells - ones)/4
         do g = 0, groups
            if (ones == 0) then
               bound(g) = nint(real(g*cells, wp)/groups)
            else
               bound(g) = group_size*g - min(max(g - pairs, 0), ones)
            end if
         end do
      end associate
   end subroutine arrange_evenly

end subroutine arrange

end module rk_gauss_cells
