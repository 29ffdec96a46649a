!> Point clouds: source points, collocation points, boundary sets.
module rk_cloud
   use rk_csr, only : csr_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_kernel, only : window_product
   use rk_memory, only : available_bytes
   use rk_neighbours, only : all_nearest, find_neighbours, most_central_of
   use rk_precision, only : i8, wp
   use rk_region, only : region_type
   use rk_text, only : to_text
   implicit none
   private

   public :: cloud_type, voxels_type, check_cloud, take_arrays

   !> Greatest index of a voxel; no image has more voxels along an edge
   integer, parameter :: max_index = 1000000
   !> Points closer than this part of the source spacing are taken as equal [-]
   real(wp), parameter :: alike = 1.0e-6_wp
   !> Maximum distance of a point from the centre of its voxel, in voxel edges: points on the
   !> surface were moved there, at shallow ends by three edges [-]
   real(wp), parameter :: moved = 10.0_wp
   !> Largest coordinate, and inverse of the smallest spacing: squares of their ratios are finite
   real(wp), parameter :: largest = 1.0e60_wp
   !> Tolerance for the length of unit vectors and for sums of fractions [-]
   real(wp), parameter :: off_unit = 1.0e-6_wp
   !> Maximum memory per voxel of arrays on the voxel grid: eight octants of 4 bytes, a distance and
   !> a number [byte]
   real(wp), parameter :: voxel_bytes = 44.0_wp

   !> Regular grid of the voxels that a model was made of
   type :: voxels_type
      !> Index of each collocation point's voxel in the grid, shape (3, nc); not allocated for
      !> bodies that are not made of voxels
      integer, allocatable :: index(:, :)
      !> Edges of a voxel [length]
      real(wp) :: size(3) = 0.0_wp
      !> Centre of the voxel with index 0, 0, 0 [length]
      real(wp) :: origin(3) = 0.0_wp
   contains
      procedure :: centre
   end type voxels_type

   !> Points of a body. A boundary entry is a collocation point seen as part of one boundary set; a
   !> point on an edge has one entry for each set. Components have the names of the same arrays in
   !> Python's PointCloud and in model.h5.
   type :: cloud_type
      !> Space dimension, 2 or 3
      integer :: nd = 0
      !> Source points, shape (nd, ns) [length]
      real(wp), allocatable :: source(:, :)
      !> Distance of neighbouring source points in each direction, shape (nd, ns) [length]
      real(wp), allocatable :: spacing(:, :)
      !> Collocation points, shape (nd, nc) [length]
      real(wp), allocatable :: points(:, :)
      !> Voxels of the collocation points of a model
      type(voxels_type) :: voxels
      !> Block of each collocation point's voxel, from 0 in each direction, shape (3, nc); allocated
      !> if the source points are the corners of these blocks
      integer, allocatable :: block(:, :)
      !> Points of volume rows: centres of the cells between the source points of a lattice, shape
      !> (nd, nv) [length]
      real(wp), allocatable :: volume_points(:, :)
      !> Volume (area in 2-D) that belongs to each collocation point, shape (nc) [length^nd]
      real(wp), allocatable :: volume(:)
      !> Label of the tissue, shape (nc)
      integer, allocatable :: label(:)
      !> Fraction of each tissue in the volume of a collocation point, shape (nf, nc) [-]; not
      !> allocated if each point has only the tissue of its label
      real(wp), allocatable :: fraction(:, :)
      !> Label of each fraction, shape (nf)
      integer, allocatable :: fraction_label(:)
      !> Fiber direction, unit vectors or zeros, shape (3, nc)
      real(wp), allocatable :: fiber(:, :)
      !> Activation of the fibers at each point relative to that of their muscle, from 0 to 1, shape
      !> (nc); not allocated where it is 1 everywhere [-]
      real(wp), allocatable :: activation(:)
      !> Collocation point of each boundary entry, shape (nb)
      integer, allocatable :: boundary_point(:)
      !> Set of each boundary entry, shape (nb)
      integer, allocatable :: boundary_set(:)
      !> Outward unit normal, shape (nd, nb)
      real(wp), allocatable :: normal(:, :)
      !> Area (length in 2-D) that belongs to the entry, shape (nb) [length^(nd-1)]
      real(wp), allocatable :: area(:)
      !> Names of the sets: sides, then regions
      character(len=32), allocatable :: set_names(:)
      !> Sets that are parts of the surface, stored after the sides; not allocated if there are none
      type(region_type), allocatable :: region(:)
      !> Whether a boundary entry lies in a set, shape (sets, nb); not allocated if each lies only
      !> in the set of its side
      logical, allocatable :: within(:, :)
      !> Unit of all lengths; not allocated or blank if the deck's applies
      character(len=:), allocatable :: length_unit
      !> Source points along each direction of a box or (radial, angular) an annulus, shape (nd);
      !> not allocated for other bodies
      integer, allocatable :: lattice(:)
      !> Coordinates of these along each direction of a box whose spacing varies, from 0, shape (:,
      !> nd) [length]
      real(wp), allocatable :: line(:, :)
      !> Index of each collocation point of such a body in their own lattice, from 0, shape (nd, nc)
      integer, allocatable :: place(:, :)
      !> The directions are radius and angle
      logical :: polar = .false.
   contains
      procedure :: find_set, in_set, is_wall, sides, meets_side, mean_spacing
      procedure :: centres, is_outside, labels, nearest_sources, nearest_source
   end type cloud_type

contains

!> Centre of a collocation point's voxel [length]
pure function centre(self, ip) result(x)
   class(voxels_type), intent(in) :: self
   !> Collocation point
   integer, intent(in) :: ip
   real(wp) :: x(3)

   x = self%origin + self%index(:, ip)*self%size
end function centre

!> Number of a set by its name, 0 if unknown
pure integer function find_set(self, name)
   class(cloud_type), intent(in) :: self
   character(len=*), intent(in) :: name

   ! findloc with back reads memory before the texts if gfortran 12 finds none
   do find_set = size(self%set_names), 1, -1
      if (self%set_names(find_set) == name) return
   end do
end function find_set

!> Whether a boundary entry lies in a set
elemental logical function in_set(self, e, set)
   class(cloud_type), intent(in) :: self
   !> Boundary entry
   integer, intent(in) :: e
   integer, intent(in) :: set

   if (allocated(self%within)) then
      in_set = self%within(set, e)
   else
      in_set = self%boundary_set(e) == set
   end if
end function in_set

!> Whether the points of a set of a model lie on its smooth surface; the others are planes
elemental logical function is_wall(self, set)
   class(cloud_type), intent(in) :: self
   integer, intent(in) :: set

   is_wall = any(self%set_names(set) == ['surface', 'bone   '])
end function is_wall

!> Number of sides, whose sets come first
pure integer function sides(self)
   class(cloud_type), intent(in) :: self

   sides = size(self%set_names)
   if (allocated(self%region)) sides = sides - size(self%region)
end function sides

!> Whether a set has boundary entries on a side
pure logical function meets_side(self, set, side)
   class(cloud_type), intent(in) :: self
   integer, intent(in) :: set
   !> Side, which is its own set
   integer, intent(in) :: side
   integer :: e

   meets_side = set == side .or. any(self%in_set([(e, e=1, size(self%boundary_set))], set) &
      & .and. self%boundary_set == side)
end function meets_side

!> Distance of neighbouring source points: the edge of a cube as large as the mean cell [length]
pure real(wp) function mean_spacing(self)
   class(cloud_type), intent(in) :: self

   mean_spacing = product(sum(self%spacing, dim=2)/size(self%spacing, 2))**(1.0_wp/self%nd)
end function mean_spacing

!> Centres of the voxels of the collocation points, or the points themselves without voxels
pure function centres(self) result(at)
   class(cloud_type), intent(in) :: self
   real(wp) :: at(size(self%points, 1), size(self%points, 2))
   integer :: ip

   at = self%points
   if (.not. allocated(self%voxels%index)) return
   do ip = 1, size(at, 2)
      at(:, ip) = self%voxels%centre(ip)
   end do
end function centres

!> Whether a position is farther than half a voxel from a body of voxels; bodies without voxels have
!> no outside
pure logical function is_outside(self, x)
   class(cloud_type), intent(in) :: self
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   real(wp), parameter :: slack = 1.0e-6_wp
   integer :: ip

   is_outside = allocated(self%voxels%index)
   do ip = 1, size(self%points, 2)
      if (.not. is_outside) return
      is_outside = any(abs(x - self%voxels%centre(ip)) > (1.0_wp + slack)*self%voxels%size)
   end do
end function is_outside

!> Labels of the points in ascending order
pure function labels(self) result(found)
   class(cloud_type), intent(in) :: self
   integer, allocatable :: found(:)

   found = [minval(self%label)]
   do while (any(self%label > found(size(found))))
      found = [found, minval(self%label, mask=self%label > found(size(found)))]
   end do
end function labels

!> Source points nearest to each collocation point, or to the centre of its voxel if it has one, in
!> source spacings: several where these are equally near, padded with 0, shape (:, nc)
function nearest_sources(self) result(near)
   class(cloud_type), intent(in) :: self
   integer, allocatable :: near(:, :)
   real(wp), allocatable :: at(:, :)
   real(wp) :: step(size(self%source, 1))

   at = self%centres()
   step = minval(self%spacing, dim=2)
   call all_nearest(self%source/spread(step, 2, size(self%source, 2)), &
      & at/spread(step, 2, size(at, 2)), near)
end function nearest_sources

!> The most central of these source points
function nearest_source(self) result(owner)
   class(cloud_type), intent(in) :: self
   integer, allocatable :: owner(:)

   owner = most_central_of(self%source, self%nearest_sources())
end function nearest_source

!> Refuse arrays from a file that do not fit together or that contain invalid indices; Python names
!> the wrong entry of its arrays (arrays.py). Indices count from 0 before, from 1 after
subroutine take_arrays(self, error)
   !> Model with nd = 3
   type(cloud_type), intent(inout) :: self
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: n(3)
   integer :: ip, nb, np, ns

   ns = size(self%source, 2)
   np = size(self%points, 2)
   nb = size(self%boundary_point)
   call need('source', ns > 0 .and. are_columns(self%source, ns))
   call need('spacing', are_columns(self%spacing, ns) .and. all(self%spacing >= 1.0_wp/largest))
   call need('points', np > 0 .and. are_columns(self%points, np))
   call need('label', size(self%label) == np)
   call need('fiber', are_columns(self%fiber, np))
   if (allocated(error)) return
   call need_each('fiber', norm2(self%fiber, dim=1) <= off_unit &
      & .or. abs(norm2(self%fiber, dim=1) - 1.0_wp) <= off_unit, [(ip, ip=1, np)], self%fiber, &
      & 'neither a unit vector nor zero')
   call need('volume', size(self%volume) == np .and. all(self%volume >= 0.0_wp &
      & .and. self%volume <= huge(1.0_wp)) .and. any(self%volume > 0.0_wp))
   call need('boundary_point', all(self%boundary_point >= 0 .and. self%boundary_point < np))
   call need('boundary_set', size(self%boundary_set) == nb .and. all(self%boundary_set >= 0 &
      & .and. self%boundary_set < size(self%set_names)))
   call need('normal', are_columns(self%normal, nb))
   if (allocated(error)) return
   call need_each('normal', abs(norm2(self%normal, dim=1) - 1.0_wp) < off_unit, &
      & self%boundary_point + 1, self%normal, 'not a unit vector')
   call need('area', size(self%area) == nb .and. all(self%area >= 0.0_wp &
      & .and. self%area <= huge(1.0_wp)))
   if (allocated(self%activation)) call need('activation', size(self%activation) == np &
      & .and. all(self%activation >= 0.0_wp .and. self%activation <= 1.0_wp))
   if (allocated(self%fraction)) then
      call need('fraction', all(shape(self%fraction) == [size(self%fraction_label), np]))
      if (allocated(error)) return
      call need_each('fraction', all(self%fraction >= 0.0_wp, dim=1) &
         & .and. abs(sum(self%fraction, dim=1) - 1.0_wp) < off_unit, [(ip, ip=1, np)], &
         & self%fraction, 'none may be negative, and their sum must be 1')
   end if
   if (allocated(self%voxels%index)) then
      associate (voxels => self%voxels)
         call need('voxels/index', all(shape(voxels%index) == [3, np]) &
            & .and. all(voxels%index >= -max_index .and. voxels%index <= max_index))
         call need('voxels/size', all(voxels%size > 0.0_wp .and. voxels%size <= huge(1.0_wp)))
         call need('voxels/origin', all(abs(voxels%origin) <= huge(1.0_wp)))
         if (allocated(error)) return
         call need('voxels/origin', all([(maxval(abs(self%points(:, ip) - voxels%centre(ip))) &
            & <= moved*maxval(voxels%size), ip=1, np)]))
         n = maxval(voxels%index, dim=2) - minval(voxels%index, dim=2) + 1
         if (voxel_bytes*product(n) > available_bytes()) call fatal_error(error, err_input, &
            & "'voxels/index' spans a grid of "//to_text(nint(n(1)))//' x '//to_text(nint(n(2))) &
            & //' x '//to_text(nint(n(3)))//' voxels, more than there is memory for')
      end associate
   end if
   if (allocated(error)) return
   self%boundary_point = self%boundary_point + 1
   self%boundary_set = self%boundary_set + 1

contains

   !> Whether an array has three numbers in range for each of n entries
   logical function are_columns(values, n)
      real(wp), intent(in) :: values(:, :)
      !> Required number of entries
      integer, intent(in) :: n

      are_columns = all(shape(values) == [3, n]) .and. all(abs(values) <= largest)
   end function are_columns

   !> Report the first array that is not valid
   subroutine need(name, right)
      !> Array, and whether it is valid
      character(len=*), intent(in) :: name
      logical, intent(in) :: right

      if (.not. (right .or. allocated(error))) call fatal_error(error, err_input, "'"//name &
         & //"' does not have the numbers of a model: one for each point, finite and in range")
   end subroutine need

   !> Report the first wrong entry and its point
   subroutine need_each(name, right, point, values, rule)
      character(len=*), intent(in) :: name
      logical, intent(in) :: right(:)
      !> Collocation point of each entry, from 1
      integer, intent(in) :: point(:)
      !> Entries, shape (:, n)
      real(wp), intent(in) :: values(:, :)
      !> Rule that an entry must satisfy
      character(len=*), intent(in) :: rule
      integer :: k

      if (allocated(error) .or. all(right)) return
      k = findloc(right, .false., dim=1)
      call fatal_error(error, err_input, "'"//name//"' at collocation point "//to_text(point(k)) &
         & //' at '//to_text(self%points(:, point(k)))//' is '//to_text(values(:, k))//': '//rule)
   end subroutine need_each

end subroutine take_arrays

!> Refuse two points at one position
subroutine check_cloud(self, error)
   type(cloud_type), intent(in) :: self
   type(error_type), allocatable, intent(out) :: error

   call check_distinct(self%source, alike*self%spacing, 'source', error)
   if (.not. allocated(error)) call check_distinct(self%points, &
      & spread(alike*minval(self%spacing, dim=2), 2, size(self%points, 2)), 'collocation', error)
end subroutine check_cloud

!> Refuse two points at one position: equal source points make the equations singular, equal
!> collocation points count their position twice
subroutine check_distinct(points, near, kind, error)
   !> Points, shape (nd, n) [length]
   real(wp), intent(in) :: points(:, :)
   !> Distance in each direction below which two points count as equal, shape (nd, n) [length]
   real(wp), intent(in) :: near(:, :)
   !> Kind of the points, for messages
   character(len=*), intent(in) :: kind
   type(error_type), allocatable, intent(out) :: error
   type(csr_type) :: same
   integer :: i
   integer(i8) :: k

   call find_neighbours(same, points, near, points, window_product, error)
   if (allocated(error)) return
   do i = 1, size(points, 2)
      k = same%offset(i) + 1
      if (same%offset(i + 1) == k) cycle
      call fatal_error(error, err_input, kind//' points '//to_text(same%index(k))//' and ' &
         & //to_text(same%index(k + 1))//' at '//to_text(points(:, i)) &
         & //' are the same: remove one')
      return
   end do
end subroutine check_distinct

end module rk_cloud
