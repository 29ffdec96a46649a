!> Point clouds: source points, collocation points, boundary sets; and the clouds of simple bodies.
module rk_cloud
   use rk_error, only : error_type, fatal_error, err_input
   use rk_kernel, only : window_product
   use rk_neighbours, only : find_neighbours, neighbour_type
   use rk_precision, only : i8, pi, wp
   use rk_text, only : to_text
   implicit none
   private

   public :: cloud_type, new_box, new_annulus, check_cloud, jitter

   !> Points of a body. A boundary entry is a collocation point seen as part of one boundary set; a
   !> point on an edge has one entry for each set.
   type :: cloud_type
      !> Space dimension, 2 or 3
      integer :: nd = 0
      !> Source points, shape (nd, ns) [length]
      real(wp), allocatable :: source(:, :)
      !> Distance of neighbouring source points in each direction, shape (nd, ns) [length]
      real(wp), allocatable :: spacing(:, :)
      !> Collocation points, shape (nd, nc) [length]
      real(wp), allocatable :: place(:, :)
      !> Centres of the voxels of a model that belong to the collocation points, shape (nd, nc)
      !> [length]; not allocated for other bodies
      real(wp), allocatable :: centre(:, :)
      !> Where volume rows stand: centres of the cells between source points or of patches, shape
      !> (nd, nv) [length]
      real(wp), allocatable :: cell(:, :)
      !> Volume (area in 2-D) that belongs to each collocation point, shape (nc) [length^nd]
      real(wp), allocatable :: volume(:)
      !> Label of the tissue, shape (nc)
      integer, allocatable :: label(:)
      !> Fiber direction, unit vectors or zeros, shape (3, nc)
      real(wp), allocatable :: fiber(:, :)
      !> Collocation point of each boundary entry, shape (nb)
      integer, allocatable :: point(:)
      !> Set of each boundary entry, shape (nb)
      integer, allocatable :: set(:)
      !> Outward unit normal, shape (nd, nb)
      real(wp), allocatable :: normal(:, :)
      !> Area (length in 2-D) that belongs to the entry, shape (nb) [length^(nd-1)]
      real(wp), allocatable :: area(:)
      !> Names of the sets
      character(len=32), allocatable :: set_name(:)
      !> Source points along each direction of a box or (radial, angular) an annulus, shape (nd);
      !> not allocated for other bodies
      integer, allocatable :: lattice(:)
      !> The source points have left the lattice
      logical :: jittered = .false.
      !> The directions are radius and angle
      logical :: polar = .false.
   contains
      !> Number of a set by its name, 0 if unknown
      procedure :: find_set
      !> Distance of neighbouring source points, mean over points and directions
      procedure :: mean_spacing
   end type cloud_type

contains

!> Number of a set by its name, 0 if unknown
pure integer function find_set(self, name)
   !> Cloud
   class(cloud_type), intent(in) :: self
   !> Name
   character(len=*), intent(in) :: name
   integer :: i

   find_set = 0
   do i = 1, size(self%set_name)
      if (self%set_name(i) == name) find_set = i
   end do
end function find_set

!> Distance of neighbouring source points: the edge of a cube as large as the mean cell [length]
pure real(wp) function mean_spacing(self)
   !> Cloud
   class(cloud_type), intent(in) :: self

   mean_spacing = product(sum(self%spacing, dim=2)/size(self%spacing, 2))**(1.0_wp/self%nd)
end function mean_spacing

!> Regular grid of places, last direction fastest
pure function grid(n) result(index)
   !> Points in each direction, shape (nd)
   integer, intent(in) :: n(:)
   integer :: index(size(n), product(n))
   integer :: i, d, rest

   do i = 1, product(n)
      rest = i - 1
      do d = size(n), 1, -1
         index(d, i) = mod(rest, n(d))
         rest = rest/n(d)
      end do
   end do
end function grid

!> Box with the corner at the origin; sets x0, x1, y0, y1, z0, z1
subroutine new_box(self, size_, source, place, error)
   !> Cloud
   type(cloud_type), intent(out) :: self
   !> Edge lengths, shape (nd), > 0 [length]
   real(wp), intent(in) :: size_(:)
   !> Source points in each direction, shape (nd), >= 2
   integer, intent(in) :: source(:)
   !> Collocation points in each direction, shape (nd), >= 2
   integer, intent(in) :: place(:)
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer, allocatable :: at(:, :)
   integer :: d, side, ip, n

   call check_counts(size(size_), source, place, error)
   if (allocated(error)) return
   if (.not. all(size_ > 0.0_wp)) then
      call fatal_error(error, err_input, 'edge lengths of the box must be positive, not ' &
         & //to_text(size_))
      return
   end if
   self%nd = size(size_)
   self%lattice = source
   self%source = grid_points(source, size_)
   self%place = grid_points(place, size_)
   self%cell = grid_centres(source, size_)
   allocate (self%spacing(self%nd, size(self%source, 2)))
   do d = 1, self%nd
      self%spacing(d, :) = size_(d)/(source(d) - 1)
   end do
   call default_tissue(self)
   at = grid(place)
   self%volume = [(share(at(:, ip), 0), ip=1, size(at, 2))]
   self%set_name = [character(len=32) :: 'x0', 'x1', 'y0', 'y1', 'z0', 'z1']
   self%set_name = self%set_name(:2*self%nd)
   n = 0
   call start_boundary(self, 2*sum([(product(place)/place(d), d=1, self%nd)]))
   do d = 1, self%nd
      do side = 0, 1
         do ip = 1, size(at, 2)
            if (at(d, ip) /= side*(place(d) - 1)) cycle
            call add_entry(self, n, ip, 2*d - 1 + side, axis(self%nd, d, 2*side - 1), &
               & share(at(:, ip), d))
         end do
      end do
   end do

contains

   !> Share of a face, or of the body where no direction is left out
   pure real(wp) function share(index, left_out)
      integer, intent(in) :: index(:)
      integer, intent(in) :: left_out
      integer :: k

      share = 1.0_wp
      do k = 1, size(index)
         if (k /= left_out) share = share*quadrature(index(k), place(k), size_(k))
      end do
   end function share

end subroutine new_box

!> Quarter of a tube in plane strain, points radial x angular; sets inner, outer, x0 (the symmetry
!> plane x = 0) and y0
subroutine new_annulus(self, inner, outer, source, place, error)
   !> Cloud
   type(cloud_type), intent(out) :: self
   !> Inner radius, > 0 [length]
   real(wp), intent(in) :: inner
   !> Outer radius, > inner [length]
   real(wp), intent(in) :: outer
   !> Source points, radial and angular
   integer, intent(in) :: source(:)
   !> Collocation points, radial and angular
   integer, intent(in) :: place(:)
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer, allocatable :: at(:, :)
   real(wp) :: r, t, weight_r, weight_t
   integer :: ip, is, n

   call check_counts(2, source, place, error)
   if (allocated(error)) return
   if (.not. (inner > 0.0_wp .and. outer > inner)) then
      call fatal_error(error, err_input, 'radii of the annulus must grow from inner to outer, ' &
         & //'not '//to_text([inner, outer]))
      return
   end if
   self%nd = 2
   self%lattice = source
   self%polar = .true.
   self%source = bend(grid_points(source, [outer - inner, 0.5_wp*pi]))
   self%place = bend(grid_points(place, [outer - inner, 0.5_wp*pi]))
   self%cell = bend(grid_centres(source, [outer - inner, 0.5_wp*pi]))
   ! the same spacing in both directions, the larger of radial and angular distance: rectangular
   ! supports do not turn with the angle
   allocate (self%spacing(2, size(self%source, 2)))
   do is = 1, size(self%source, 2)
      self%spacing(:, is) = max((outer - inner)/(source(1) - 1), &
         & 0.5_wp*pi*norm2(self%source(:, is))/(source(2) - 1))
   end do
   call default_tissue(self)
   self%set_name = [character(len=32) :: 'inner', 'outer', 'x0', 'y0']
   n = 0
   call start_boundary(self, 2*sum(place))
   at = grid(place)
   allocate (self%volume(size(at, 2)))
   do ip = 1, size(at, 2)
      r = norm2(self%place(:, ip))
      t = 0.5_wp*pi*at(2, ip)/(place(2) - 1)
      weight_t = r*quadrature(at(2, ip), place(2), 0.5_wp*pi)
      weight_r = quadrature(at(1, ip), place(1), outer - inner)
      self%volume(ip) = weight_r*weight_t
      if (at(1, ip) == 0) call add_entry(self, n, ip, 1, -[cos(t), sin(t)], weight_t)
      if (at(1, ip) == place(1) - 1) call add_entry(self, n, ip, 2, [cos(t), sin(t)], weight_t)
      if (at(2, ip) == place(2) - 1) call add_entry(self, n, ip, 3, [-1.0_wp, 0.0_wp], weight_r)
      if (at(2, ip) == 0) call add_entry(self, n, ip, 4, [0.0_wp, -1.0_wp], weight_r)
   end do

contains

   !> From radius offset and angle to the plane; the axes are met exactly
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

!> Move the source points of a box off their lattice, always in the same way. Those on the surface
!> stay on their faces, edges and corners.
subroutine jitter(self, share)
   !> Box
   type(cloud_type), intent(inout) :: self
   !> Largest move, in spacings [-]
   real(wp), intent(in) :: share
   real(wp) :: low, high, fraction
   integer(i8) :: state
   integer :: d, is

   self%jittered = .true.
   state = 1
   do d = 1, self%nd
      low = minval(self%source(d, :))
      high = maxval(self%source(d, :))
      do is = 1, size(self%source, 2)
         ! minimal standard generator: Park, Miller, Commun. ACM 31 (1988), doi:10.1145/63039.63042
         state = modulo(16807_i8*state, 2147483647_i8)
         if (self%source(d, is) <= low .or. self%source(d, is) >= high) cycle
         fraction = 2.0_wp*real(state, wp)/2147483647.0_wp - 1.0_wp
         self%source(d, is) = self%source(d, is) + share*fraction*self%spacing(d, is)
      end do
   end do
end subroutine jitter

!> Refuse what no later station could make sense of
subroutine check_cloud(self, error)
   !> Cloud
   type(cloud_type), intent(in) :: self
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer :: i

   call check_source(self, error)
   if (allocated(error)) return
   do i = 1, size(self%place, 2)
      if (.not. all(abs(self%place(:, i)) <= huge(1.0_wp))) then
         call fatal_error(error, err_input, 'collocation point '//to_text(i)//' has coordinates ' &
            & //'that are not finite')
         return
      end if
      if (.not. (norm2(self%fiber(:, i)) <= 1.0e-6_wp .or. &
         & abs(norm2(self%fiber(:, i)) - 1.0_wp) <= 1.0e-6_wp)) then
         call fatal_error(error, err_input, 'fiber at collocation point '//to_text(i)//' at ' &
            & //to_text(self%place(:, i))//' is '//to_text(self%fiber(:, i)) &
            & //': neither a unit vector nor zero')
         return
      end if
   end do
   do i = 1, size(self%point)
      if (self%point(i) < 1 .or. self%point(i) > size(self%place, 2) .or. self%set(i) < 1 &
         & .or. self%set(i) > size(self%set_name)) then
         call fatal_error(error, err_input, 'boundary entry '//to_text(i)//' names point ' &
            & //to_text(self%point(i))//' and set '//to_text(self%set(i))//', which do not exist')
         return
      end if
      if (.not. abs(norm2(self%normal(:, i)) - 1.0_wp) < 1.0e-6_wp) then
         call fatal_error(error, err_input, 'normal of boundary entry '//to_text(i)//' at ' &
            & //to_text(self%place(:, self%point(i)))//' is not a unit vector')
         return
      end if
   end do
end subroutine check_cloud

!> Source points must be finite and all different: equal ones make the equations singular
subroutine check_source(self, error)
   !> Cloud
   type(cloud_type), intent(in) :: self
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   type(neighbour_type) :: same
   integer :: i
   integer(i8) :: k

   do i = 1, size(self%source, 2)
      if (all(abs(self%source(:, i)) <= huge(1.0_wp)) .and. all(self%spacing(:, i) > 0.0_wp)) cycle
      call fatal_error(error, err_input, 'source point '//to_text(i)//' at ' &
         & //to_text(self%source(:, i))//' with spacing '//to_text(self%spacing(:, i)) &
         & //': coordinates must be finite, spacings positive')
      return
   end do
   call find_neighbours(same, self%source, 1.0e-6_wp*self%spacing, self%source, window_product, &
      & error)
   if (allocated(error)) return
   do i = 1, size(self%source, 2)
      k = same%offset(i) + 1
      if (same%offset(i + 1) == k) cycle
      call fatal_error(error, err_input, 'source points '//to_text(same%index(k))//' and ' &
         & //to_text(same%index(k + 1))//' at '//to_text(self%source(:, i)) &
         & //' are the same: remove one')
      return
   end do
end subroutine check_source

!> Grid counts fit the dimension and allow differences
subroutine check_counts(nd, source, place, error)
   !> Space dimension
   integer, intent(in) :: nd
   !> Source points in each direction
   integer, intent(in) :: source(:)
   !> Collocation points in each direction
   integer, intent(in) :: place(:)
   !> Error handling
   type(error_type), allocatable, intent(out) :: error

   if (size(source) /= nd .or. size(place) /= nd) then
      call fatal_error(error, err_input, 'source and collocation need '//to_text(nd)//' counts')
   else if (any(source < 2) .or. any(place < 2)) then
      call fatal_error(error, err_input, 'at least 2 points in each direction are needed')
   end if
end subroutine check_counts

!> Points of a regular grid over a box
pure function grid_points(n, length) result(x)
   !> Points in each direction, shape (nd)
   integer, intent(in) :: n(:)
   !> Edge lengths, shape (nd) [length]
   real(wp), intent(in) :: length(:)
   real(wp) :: x(size(n), product(n))
   integer :: at(size(n), product(n)), d

   at = grid(n)
   do d = 1, size(n)
      x(d, :) = length(d)*at(d, :)/real(n(d) - 1, wp)
   end do
end function grid_points

!> Weight of a point in the integral over a line: Simpson's rule, with an even number of points the
!> trapezoidal rule
pure real(wp) function quadrature(i, n, length)
   !> Point, counted from 0
   integer, intent(in) :: i
   !> Points
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

!> Centres of the cells of a regular grid
pure function grid_centres(n, length) result(x)
   !> Points in each direction, shape (nd)
   integer, intent(in) :: n(:)
   !> Edge lengths, shape (nd) [length]
   real(wp), intent(in) :: length(:)
   real(wp) :: x(size(n), product(n - 1))
   integer :: at(size(n), product(n - 1)), d

   at = grid(n - 1)
   do d = 1, size(n)
      x(d, :) = length(d)*(at(d, :) + 0.5_wp)/real(n(d) - 1, wp)
   end do
end function grid_centres

!> One tissue, no fibers
subroutine default_tissue(self)
   !> Cloud with collocation points
   type(cloud_type), intent(inout) :: self

   allocate (self%label(size(self%place, 2)), source=1)
   allocate (self%fiber(3, size(self%place, 2)), source=0.0_wp)
end subroutine default_tissue

!> Room for boundary entries
subroutine start_boundary(self, n)
   !> Cloud
   type(cloud_type), intent(inout) :: self
   !> Number of entries
   integer, intent(in) :: n

   allocate (self%point(n), self%set(n), self%normal(self%nd, n), self%area(n))
end subroutine start_boundary

!> Write the next boundary entry
subroutine add_entry(self, n, point, set, normal, area)
   !> Cloud
   type(cloud_type), intent(inout) :: self
   !> Entries so far
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
   self%point(n) = point
   self%set(n) = set
   self%area(n) = area
   self%normal(:, n) = normal
end subroutine add_entry

!> Unit vector along an axis
pure function axis(nd, d, sign) result(v)
   !> Space dimension
   integer, intent(in) :: nd
   !> Axis
   integer, intent(in) :: d
   !> -1 or 1
   integer, intent(in) :: sign
   real(wp) :: v(nd)

   v = 0.0_wp
   v(d) = real(sign, wp)
end function axis

end module rk_cloud
