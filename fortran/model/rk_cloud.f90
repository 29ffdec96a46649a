!> Point clouds: source points, collocation points, boundary sets.
module rk_cloud
   use rk_csr, only : csr_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_kernel, only : window_product
   use rk_neighbours, only : find_neighbours, nearest_points
   use rk_precision, only : i8, wp
   use rk_region, only : region_type
   use rk_text, only : to_text
   implicit none
   private

   public :: cloud_type, voxels_type, check_cloud

   !> Part of the spacing of source points within which points are the same [-]
   real(wp), parameter :: alike = 1.0e-6_wp

   !> Regular grid of the voxels that a model was made of
   type :: voxels_type
      !> Place of each collocation point's voxel in the grid, shape (3, nc); not allocated for
      !> bodies that are not made of voxels
      integer, allocatable :: index(:, :)
      !> Edges of a voxel [length]
      real(wp) :: size(3) = 0.0_wp
      !> Centre of the voxel at place 0, 0, 0 [length]
      real(wp) :: origin(3) = 0.0_wp
   contains
      !> Centre of a collocation point's voxel
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
      !> where the source points are the corners of these blocks
      integer, allocatable :: block(:, :)
      !> Where volume rows stand: centres of the cells between source points or of patches, shape
      !> (nd, nv) [length]
      real(wp), allocatable :: volume_points(:, :)
      !> Volume (area in 2-D) that belongs to each collocation point, shape (nc) [length^nd]
      real(wp), allocatable :: volume(:)
      !> Label of the tissue, shape (nc)
      integer, allocatable :: label(:)
      !> Fraction of each tissue in the volume of a collocation point, shape (nf, nc) [-]; not
      !> allocated where each holds one tissue, that of its label
      real(wp), allocatable :: fraction(:, :)
      !> Label of each fraction, shape (nf)
      integer, allocatable :: fraction_label(:)
      !> Fiber direction, unit vectors or zeros, shape (3, nc)
      real(wp), allocatable :: fiber(:, :)
      !> Activation of the fibers of each point, of that of their muscle, from 0 to 1, shape (nc);
      !> not allocated where it is 1 everywhere [-]
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
      !> Sets that are parts of the surface, those behind the sides; not allocated without any
      type(region_type), allocatable :: region(:)
      !> Whether a boundary entry lies in a set, shape (sets, nb); not allocated where each lies in
      !> that of its side alone
      logical, allocatable :: within(:, :)
      !> Unit of all lengths, not allocated or blank where the deck's holds
      character(len=:), allocatable :: length_unit
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
      !> Whether a boundary entry lies in a set, number of sides, whether a set has a part of one
      procedure :: in_set
      procedure :: sides
      procedure :: meets_side
      !> Middle of a set by area
      procedure :: set_centroid
      !> Distance of neighbouring source points, mean over points and directions
      procedure :: mean_spacing
      !> Centres of the voxels, or the collocation points
      procedure :: centres
      !> Source point nearest to each collocation point
      procedure :: nearest_source
   end type cloud_type

contains

!> Centre of a collocation point's voxel [length]
pure function centre(self, ip) result(x)
   !> Voxels
   class(voxels_type), intent(in) :: self
   !> Collocation point
   integer, intent(in) :: ip
   real(wp) :: x(3)

   x = self%origin + self%index(:, ip)*self%size
end function centre

!> Number of a set by its name, 0 if unknown
pure integer function find_set(self, name)
   !> Cloud
   class(cloud_type), intent(in) :: self
   !> Name
   character(len=*), intent(in) :: name
   integer :: i

   find_set = 0
   do i = 1, size(self%set_names)
      if (self%set_names(i) == name) find_set = i
   end do
end function find_set

!> Whether a boundary entry lies in a set
elemental logical function in_set(self, e, set)
   !> Cloud
   class(cloud_type), intent(in) :: self
   !> Boundary entry
   integer, intent(in) :: e
   !> Set
   integer, intent(in) :: set

   if (allocated(self%within)) then
      in_set = self%within(set, e)
   else
      in_set = self%boundary_set(e) == set
   end if
end function in_set

!> Number of sides, whose sets come first
pure integer function sides(self)
   !> Cloud
   class(cloud_type), intent(in) :: self

   sides = size(self%set_names)
   if (allocated(self%region)) sides = sides - size(self%region)
end function sides

!> Whether a set has boundary entries on a side
pure logical function meets_side(self, set, side)
   !> Cloud
   class(cloud_type), intent(in) :: self
   !> Set
   integer, intent(in) :: set
   !> Side, the set of which is itself
   integer, intent(in) :: side
   integer :: e

   meets_side = set == side
   if (meets_side .or. .not. allocated(self%within)) return
   meets_side = any([(self%within(set, e), e=1, size(self%boundary_set))] &
      & .and. self%boundary_set == side)
end function meets_side

!> Middle of a set by area, shape (nd) [length]
pure function set_centroid(self, set) result(middle)
   !> Cloud
   class(cloud_type), intent(in) :: self
   !> Set, which has entries
   integer, intent(in) :: set
   real(wp) :: middle(self%nd), total
   integer :: e

   middle = 0.0_wp
   total = 0.0_wp
   do e = 1, size(self%boundary_set)
      if (.not. self%in_set(e, set)) cycle
      middle = middle + self%area(e)*self%points(:, self%boundary_point(e))
      total = total + self%area(e)
   end do
   middle = middle/total
end function set_centroid

!> Distance of neighbouring source points: the edge of a cube as large as the mean cell [length]
pure real(wp) function mean_spacing(self)
   !> Cloud
   class(cloud_type), intent(in) :: self

   mean_spacing = product(sum(self%spacing, dim=2)/size(self%spacing, 2))**(1.0_wp/self%nd)
end function mean_spacing

!> Centres of the voxels of the collocation points, or these where there are no voxels
pure function centres(self) result(at)
   !> Cloud
   class(cloud_type), intent(in) :: self
   real(wp) :: at(size(self%points, 1), size(self%points, 2))
   integer :: ip

   at = self%points
   if (.not. allocated(self%voxels%index)) return
   do ip = 1, size(at, 2)
      at(:, ip) = self%voxels%centre(ip)
   end do
end function centres

!> Source point nearest to each collocation point, or to the centre of its voxel where it has one,
!> in source spacings
function nearest_source(self) result(owner)
   !> Cloud
   class(cloud_type), intent(in) :: self
   integer, allocatable :: owner(:)
   real(wp), allocatable :: at(:, :)
   real(wp) :: step(size(self%source, 1))

   at = self%centres()
   step = minval(self%spacing, dim=2)
   owner = nearest_points(self%source/spread(step, 2, size(self%source, 2)), &
      & at/spread(step, 2, size(at, 2)))
end function nearest_source

!> Refuse what no later station could make sense of
subroutine check_cloud(self, error)
   !> Cloud
   type(cloud_type), intent(in) :: self
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer :: i

   call check_source(self, error)
   if (allocated(error)) return
   call check_points(self, error)
   if (allocated(error)) return
   do i = 1, size(self%points, 2)
      if (.not. (norm2(self%fiber(:, i)) <= 1.0e-6_wp .or. &
         & abs(norm2(self%fiber(:, i)) - 1.0_wp) <= 1.0e-6_wp)) then
         call fatal_error(error, err_input, 'fiber at collocation point '//to_text(i)//' at ' &
            & //to_text(self%points(:, i))//' is '//to_text(self%fiber(:, i)) &
            & //': neither a unit vector nor zero')
         return
      end if
   end do
   if (allocated(self%volume)) then
      i = findloc(self%volume >= 0.0_wp .and. self%volume <= huge(1.0_wp), .false., dim=1)
      if (i > 0) then
         call fatal_error(error, err_input, 'volume of collocation point '//to_text(i)//' at ' &
            & //to_text(self%points(:, i))//' is '//to_text(self%volume(i)) &
            & //': it must be finite and not negative')
         return
      end if
   end if
   if (allocated(self%fraction)) then
      i = findloc(all(self%fraction >= 0.0_wp, dim=1) .and. &
         & abs(sum(self%fraction, dim=1) - 1.0_wp) < 1.0e-6_wp, .false., dim=1)
      if (i > 0) then
         call fatal_error(error, err_input, 'fractions of tissues at collocation point ' &
            & //to_text(i)//' at '//to_text(self%points(:, i))//' are ' &
            & //to_text(self%fraction(:, i))//': none may be negative, and their sum must be 1')
         return
      end if
   end if
   do i = 1, size(self%boundary_point)
      associate (point => self%boundary_point(i), set => self%boundary_set(i))
         if (point < 1 .or. point > size(self%points, 2) .or. set < 1 &
            & .or. set > size(self%set_names)) then
            call fatal_error(error, err_input, 'boundary entry '//to_text(i)//' names point ' &
               & //to_text(point)//' and set '//to_text(set)//', which do not exist')
            return
         end if
      end associate
      if (.not. abs(norm2(self%normal(:, i)) - 1.0_wp) < 1.0e-6_wp) then
         call fatal_error(error, err_input, 'normal of boundary entry '//to_text(i)//' at ' &
            & //to_text(self%points(:, self%boundary_point(i)))//' is not a unit vector')
         return
      end if
      if (.not. (self%area(i) >= 0.0_wp .and. self%area(i) <= huge(1.0_wp))) then
         call fatal_error(error, err_input, 'area of boundary entry '//to_text(i)//' at ' &
            & //to_text(self%points(:, self%boundary_point(i)))//' is '//to_text(self%area(i)) &
            & //': it must be finite and not negative')
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
   integer :: i

   do i = 1, size(self%source, 2)
      if (all(abs(self%source(:, i)) <= huge(1.0_wp)) .and. all(self%spacing(:, i) > 0.0_wp)) cycle
      call fatal_error(error, err_input, 'source point '//to_text(i)//' at ' &
         & //to_text(self%source(:, i))//' with spacing '//to_text(self%spacing(:, i)) &
         & //': coordinates must be finite, spacings positive')
      return
   end do
   call check_distinct(self%source, alike*self%spacing, 'source', error)
end subroutine check_source

!> Collocation points must be finite and all different: equal ones count their place twice
subroutine check_points(self, error)
   !> Cloud, its source points checked
   type(cloud_type), intent(in) :: self
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer :: i

   do i = 1, size(self%points, 2)
      if (all(abs(self%points(:, i)) <= huge(1.0_wp))) cycle
      call fatal_error(error, err_input, 'collocation point '//to_text(i)//' has coordinates ' &
         & //'that are not finite')
      return
   end do
   call check_distinct(self%points, &
      & spread(alike*minval(self%spacing, dim=2), 2, size(self%points, 2)), 'collocation', error)
end subroutine check_points

!> Refuse two points in one place
subroutine check_distinct(points, near, kind, error)
   !> Points, shape (nd, n) [length]
   real(wp), intent(in) :: points(:, :)
   !> Distance in each direction below which two are the same, shape (nd, n) [length]
   real(wp), intent(in) :: near(:, :)
   !> What they are called
   character(len=*), intent(in) :: kind
   !> Error handling
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
