!> Clouds of simple bodies, whose points lie on a lattice, and the numbering of lattices.
module rk_lattice
   use rk_cloud, only : cloud_type
   use rk_precision, only : pi, wp
   implicit none
   private

   public :: new_box, new_annulus, lattice_frame, set_number, digits_of, place_of
   public :: box_sides, lattice_coordinates, outside_lattice, place_at

   !> Spacing at a side towards which a box is graded, relative to the mean spacing [-]
   real(wp), parameter :: at_side = 0.5_wp

   !> Names of the faces, in the order of set_number
   character(len=*), parameter :: box_faces(6) = ['x0', 'x1', 'y0', 'y1', 'z0', 'z1'], &
      & annulus_faces(4) = ['inner', 'outer', 'x0   ', 'y0   ']

contains

!> Box with the corner at the origin; sets x0, x1, y0, y1, z0, z1
subroutine new_box(self, size_, source, place, graded)
   type(cloud_type), intent(out) :: self
   !> Edge lengths, shape (nd), > 0 [length]
   real(wp), intent(in) :: size_(:)
   !> Source points in each direction, shape (nd), >= 2
   integer, intent(in) :: source(:)
   !> Collocation points in each direction, shape (nd), >= 2
   integer, intent(in) :: place(:)
   !> Sides towards which the spacing shrinks, in the order of set_number; none if absent
   logical, intent(in), optional :: graded(:)
   integer, allocatable :: at(:, :)
   logical :: ends(2, size(size_))
   real(wp) :: weight(maxval(place), size(size_))
   integer :: d, side, ip, k, n

   self%nd = size(size_)
   self%lattice = source
   self%source = grid_points(source, size_, 0)
   self%points = grid_points(place, size_, 0)
   self%volume_points = grid_points(source, size_, 1)
   allocate (self%spacing(self%nd, size(self%source, 2)))
   do d = 1, self%nd
      self%spacing(d, :) = size_(d)/(source(d) - 1)
      weight(:place(d), d) = [(quadrature(n, place(d), size_(d)), n=0, place(d) - 1)]
   end do
   ends = .false.
   if (present(graded)) ends = reshape(graded(:2*self%nd), shape(ends))
   if (any(ends)) call grade(self, size_, ends, place, weight)
   at = grid(place)
   self%place = at
   self%volume = [(share(at(:, ip), 0), ip=1, size(at, 2))]
   allocate (self%set_names(2*self%nd))
   self%set_names = box_faces(:2*self%nd)
   n = 0
   call start_boundary(self, 2*sum([(product(place)/place(d), d=1, self%nd)]))
   do d = 1, self%nd
      do side = 0, 1
         do ip = 1, size(at, 2)
            if (at(d, ip) /= side*(place(d) - 1)) cycle
            call add_entry(self, n, ip, set_number(.false., d, side), &
               & [(merge(2.0_wp*side - 1.0_wp, 0.0_wp, k == d), k=1, self%nd)], &
               & share(at(:, ip), d))
         end do
      end do
   end do

contains

   !> Share of a face, or of the volume if no direction is left out
   pure real(wp) function share(index, left_out)
      integer, intent(in) :: index(:)
      integer, intent(in) :: left_out
      integer :: k

      share = 1.0_wp
      do k = 1, size(index)
         if (k /= left_out) share = share*weight(index(k) + 1, k)
      end do
   end function share

end subroutine new_box

!> Move the points of a box towards some of its sides
subroutine grade(self, size_, ends, place, weight)
   !> Box with evenly spaced points
   type(cloud_type), intent(inout) :: self
   !> Edge lengths, shape (nd) [length]
   real(wp), intent(in) :: size_(:)
   !> Low and high sides towards which the points move, shape (2, nd)
   logical, intent(in) :: ends(:, :)
   !> Collocation points in each direction, shape (nd)
   integer, intent(in) :: place(:)
   !> Their weights along each direction, shape (:, nd) [length]
   real(wp), intent(inout) :: weight(:, :)
   real(wp), allocatable :: x(:), gap(:)
   integer :: at(size(size_), size(self%source, 2)), d, k, n

   at = grid(self%lattice)
   allocate (self%line(0:maxval(self%lattice) - 1, self%nd), source=0.0_wp)
   do d = 1, self%nd
      self%source(d, :) = size_(d)*nearer(self%source(d, :)/size_(d), ends(:, d))
      self%points(d, :) = size_(d)*nearer(self%points(d, :)/size_(d), ends(:, d))
      self%volume_points(d, :) = size_(d)*nearer(self%volume_points(d, :)/size_(d), ends(:, d))
      n = self%lattice(d)
      x = size_(d)*nearer([(real(k, wp)/(n - 1), k=0, n - 1)], ends(:, d))
      self%line(:n - 1, d) = x
      gap = x(2:) - x(:n - 1)
      ! supports are based on the wider of the gaps beside a point
      gap = max([gap(1), gap], [gap, gap(n - 1)])
      self%spacing(d, :) = gap(at(d, :) + 1)
      if (.not. any(ends(:, d))) cycle
      n = place(d)
      x = size_(d)*nearer([(real(k, wp)/(n - 1), k=0, n - 1)], ends(:, d))
      weight(:n, d) = 0.5_wp*([x(2:), x(n)] - [x(1), x(:n - 1)])
   end do
end subroutine grade

!> Share of a length before a point, moved towards one or both ends
pure function nearer(share, ends) result(moved)
   !> Share for evenly spaced points, shape (n) [-]
   real(wp), intent(in) :: share(:)
   !> Ends towards which the points move, shape (2)
   logical, intent(in) :: ends(2)
   real(wp) :: moved(size(share))
   real(wp), parameter :: less = 1.0_wp - at_side

   if (all(ends)) then
      moved = share - less*sin(2.0_wp*pi*share)/(2.0_wp*pi)
   else if (ends(1)) then
      moved = share - less*sin(pi*share)/pi
   else if (ends(2)) then
      moved = share + less*sin(pi*share)/pi
   else
      moved = share
   end if
end function nearer

!> Sides of a box that are named in a text, in the order of set_number
pure function box_sides(names) result(named)
   character(len=*), intent(in) :: names
   logical :: named(size(box_faces))
   integer :: k

   named = [(index(names, trim(box_faces(k))) > 0, k=1, size(box_faces))]
end function box_sides

!> Quarter of a tube in plane strain, points radial x angular; sets inner, outer, x0 (the symmetry
!> plane x = 0) and y0
subroutine new_annulus(self, inner, outer, source, place)
   type(cloud_type), intent(out) :: self
   !> Inner radius, > 0 [length]
   real(wp), intent(in) :: inner
   !> Outer radius, > inner [length]
   real(wp), intent(in) :: outer
   !> Source points, radial and angular
   integer, intent(in) :: source(:)
   !> Collocation points, radial and angular
   integer, intent(in) :: place(:)
   integer, allocatable :: at(:, :)
   real(wp) :: r, t, weight_r, weight_t
   integer :: ip, is, n

   self%nd = 2
   self%lattice = source
   self%polar = .true.
   self%source = bend(grid_points(source, [outer - inner, 0.5_wp*pi], 0))
   self%points = bend(grid_points(place, [outer - inner, 0.5_wp*pi], 0))
   self%volume_points = bend(grid_points(source, [outer - inner, 0.5_wp*pi], 1))
   ! the same spacing in both directions, the larger of radial and angular distance: rectangular
   ! supports do not turn with the angle
   allocate (self%spacing(2, size(self%source, 2)))
   do is = 1, size(self%source, 2)
      self%spacing(:, is) = max((outer - inner)/(source(1) - 1), &
         & 0.5_wp*pi*norm2(self%source(:, is))/(source(2) - 1))
   end do
   allocate (self%set_names(size(annulus_faces)))
   self%set_names = annulus_faces
   n = 0
   call start_boundary(self, 2*sum(place))
   at = grid(place)
   self%place = at
   allocate (self%volume(size(at, 2)))
   do ip = 1, size(at, 2)
      r = norm2(self%points(:, ip))
      t = 0.5_wp*pi*at(2, ip)/(place(2) - 1)
      weight_t = r*quadrature(at(2, ip), place(2), 0.5_wp*pi)
      weight_r = quadrature(at(1, ip), place(1), outer - inner)
      self%volume(ip) = weight_r*weight_t
      if (at(1, ip) == 0) call add_entry(self, n, ip, set_number(.true., 1, 0), &
         & -[cos(t), sin(t)], weight_t)
      if (at(1, ip) == place(1) - 1) call add_entry(self, n, ip, set_number(.true., 1, 1), &
         & [cos(t), sin(t)], weight_t)
      if (at(2, ip) == place(2) - 1) call add_entry(self, n, ip, set_number(.true., 2, 1), &
         & [-1.0_wp, 0.0_wp], weight_r)
      if (at(2, ip) == 0) call add_entry(self, n, ip, set_number(.true., 2, 0), &
         & [0.0_wp, -1.0_wp], weight_r)
   end do

contains

   !> From radius offset and angle to the plane; points on the axes lie exactly on them
   pure function bend(x) result(y)
      real(wp), intent(in) :: x(:, :)
      real(wp) :: y(2, size(x, 2))
      integer :: i

      do i = 1, size(x, 2)
         y(:, i) = (inner + x(1, i))*[cos(x(2, i)), sin(x(2, i))]
         if (x(2, i) >= 0.5_wp*pi) y(1, i) = 0.0_wp
      end do
   end function bend

end subroutine new_annulus

!> Corner and spacing of a lattice, in radius and angle if it is polar
pure subroutine lattice_frame(cloud, low, step)
   !> Cloud with a lattice
   type(cloud_type), intent(in) :: cloud
   !> Corner and spacing [length], [radian]
   real(wp), intent(out) :: low(3), step(3)
   integer :: d

   low = 0.0_wp
   step = 1.0_wp
   if (cloud%polar) then
      low(1) = minval(cloud%source(1, :), mask=cloud%source(2, :) <= 0.0_wp)
      step(1) = (maxval(cloud%source(1, :)) - low(1))/(cloud%lattice(1) - 1)
      step(2) = 0.5_wp*pi/(cloud%lattice(2) - 1)
   else
      do d = 1, cloud%nd
         low(d) = minval(cloud%source(d, :))
         step(d) = (maxval(cloud%source(d, :)) - low(d))/(cloud%lattice(d) - 1)
      end do
   end if
end subroutine lattice_frame

!> Coordinates along the directions of a lattice: radius and angle if it is polar
pure function lattice_coordinates(cloud, x) result(q)
   type(cloud_type), intent(in) :: cloud
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   real(wp) :: q(size(x))

   q = x
   if (cloud%polar) q = [norm2(x), atan2(x(2), x(1))]
end function lattice_coordinates

!> The inverse map
pure function place_at(cloud, q) result(x)
   type(cloud_type), intent(in) :: cloud
   real(wp), intent(in) :: q(:)
   real(wp) :: x(size(q))

   x = q
   if (cloud%polar) x = q(1)*[cos(q(2)), sin(q(2))]
end function place_at

!> Whether a position lies outside the body of a lattice; points on the surface may be off it by
!> rounding
pure logical function outside_lattice(cloud, x)
   !> Cloud with a lattice
   type(cloud_type), intent(in) :: cloud
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   real(wp), parameter :: slack = 1.0e-6_wp
   real(wp) :: low(3), step(3), at(3), extent(3)

   call lattice_frame(cloud, low, step)
   at(:cloud%nd) = lattice_coordinates(cloud, x)
   extent(:cloud%nd) = step(:cloud%nd)*(cloud%lattice - 1)
   outside_lattice = any(abs(at(:cloud%nd) - low(:cloud%nd) - 0.5_wp*extent(:cloud%nd)) &
      & > (0.5_wp + slack)*extent(:cloud%nd))
end function outside_lattice

!> Boundary set of a face of a lattice
pure integer function set_number(polar, axis, end)
   !> The directions are radius and angle
   logical, intent(in) :: polar
   !> Direction of the face's normal
   integer, intent(in) :: axis
   !> 0 at the low end, 1 at the high end
   integer, intent(in) :: end

   set_number = 2*axis - 1 + end
   if (polar .and. axis == 2) set_number = 4 - end
end function set_number

!> Number, from 1, of digits
pure integer function place_of(digit, base)
   !> Digits, the last one fastest
   integer, intent(in) :: digit(:)
   !> Number of values of each digit
   integer, intent(in) :: base(:)
   integer :: d

   place_of = 0
   do d = 1, size(base)
      place_of = place_of*base(d) + digit(d)
   end do
   place_of = place_of + 1
end function place_of

!> Digits of a number, the last one fastest
pure function digits_of(number, base) result(digit)
   !> Number, from 0
   integer, intent(in) :: number
   !> Number of values of each digit
   integer, intent(in) :: base(:)
   integer :: digit(size(base))
   integer :: d, rest

   rest = number
   do d = size(base), 1, -1
      digit(d) = mod(rest, base(d))
      rest = rest/base(d)
   end do
end function digits_of

!> Indices of a regular grid, last direction fastest
pure function grid(n) result(index)
   !> Points in each direction, shape (nd)
   integer, intent(in) :: n(:)
   integer :: index(size(n), product(n))
   integer :: i

   do i = 1, product(n)
      index(:, i) = digits_of(i - 1, n)
   end do
end function grid

!> Points of a regular grid over a box, or the centres of its cells
pure function grid_points(n, length, centres) result(x)
   integer, intent(in) :: n(:)
   !> Edge lengths, shape (nd) [length]
   real(wp), intent(in) :: length(:)
   !> 1 for centres of cells, 0 for points
   integer, intent(in) :: centres
   real(wp) :: x(size(n), product(n - centres))
   integer :: at(size(n), product(n - centres)), d

   at = grid(n - centres)
   do d = 1, size(n)
      x(d, :) = length(d)*(at(d, :) + 0.5_wp*centres)/real(n(d) - 1, wp)
   end do
end function grid_points

!> Weight of a point in the integral over a line: Simpson's rule, or the trapezoidal rule for an
!> even number of points
pure real(wp) function quadrature(i, n, length)
   !> Point, counted from 0
   integer, intent(in) :: i
   !> Number of points
   integer, intent(in) :: n
   !> Length of the line [length]
   real(wp), intent(in) :: length

   if (mod(n, 2) == 1) then
      quadrature = merge(4.0_wp, 2.0_wp, mod(i, 2) == 1)/3.0_wp
   else
      quadrature = 1.0_wp
   end if
   if (i == 0 .or. i == n - 1) quadrature = 0.5_wp*quadrature
   quadrature = quadrature*length/(n - 1)
end function quadrature

!> Initialise one tissue, no fibers, and arrays for boundary entries
subroutine start_boundary(self, n)
   !> Cloud with collocation points
   type(cloud_type), intent(inout) :: self
   !> Number of entries
   integer, intent(in) :: n

   allocate (self%label(size(self%points, 2)), source=1)
   allocate (self%fiber(3, size(self%points, 2)), source=0.0_wp)
   allocate (self%boundary_point(n), self%boundary_set(n), self%normal(self%nd, n), self%area(n))
end subroutine start_boundary

subroutine add_entry(self, n, point, set, normal, area)
   type(cloud_type), intent(inout) :: self
   !> Number of entries so far
   integer, intent(inout) :: n
   !> Collocation point
   integer, intent(in) :: point
   !> Boundary set
   integer, intent(in) :: set
   !> Outward unit normal, shape (nd)
   real(wp), intent(in) :: normal(:)
   !> Area [length^(nd-1)]
   real(wp), intent(in) :: area

   n = n + 1
   self%boundary_point(n) = point
   self%boundary_set(n) = set
   self%area(n) = area
   self%normal(:, n) = normal
end subroutine add_entry

end module rk_lattice
