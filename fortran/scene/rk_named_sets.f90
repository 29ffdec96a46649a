!> Boundary sets that are named parts of the surface: assignment of positions to sets.
!>
!> Every position lies in the set of its side, and in those of all regions that contain it. Sets may
!> overlap.
module rk_named_sets
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type
   use rk_lattice, only : digits_of, lattice_frame, place_at, set_number
   use rk_neighbours, only : nearest_points
   use rk_precision, only : wp
   use rk_region, only : region_type
   implicit none
   private

   public :: add_set, sets_of, extent_of

   !> Samples in each direction of a side by which the extent of a set is measured, by dimension
   integer, parameter :: samples(3) = [1, 1024, 96]

contains

!> Add a set to those of a cloud
subroutine add_set(cloud, name, region, found, error)
   !> Cloud with its boundary entries and labels
   type(cloud_type), intent(inout) :: cloud
   character(len=*), intent(in) :: name
   type(region_type), intent(in) :: region
   !> Whether it contains a boundary entry
   logical, intent(out) :: found
   !> Error handling: an expression that is not finite somewhere
   type(error_type), allocatable, intent(inout) :: error
   logical :: inside(size(cloud%boundary_set))
   logical, allocatable :: wider(:, :)
   integer :: c, e, n

   do e = 1, size(inside)
      associate (ip => cloud%boundary_point(e))
         inside(e) = region%holds(cloud%points(:, ip), cloud%normal(:, e), &
            & cloud%boundary_set(e), cloud%label(ip), error)
      end associate
      if (allocated(error)) return
   end do
   found = any(inside)
   n = size(cloud%set_names)
   if (.not. allocated(cloud%region)) then
      allocate (cloud%region(0), cloud%within(n, size(inside)))
      do e = 1, size(inside)
         cloud%within(:, e) = [(c, c=1, n)] == cloud%boundary_set(e)
      end do
   end if
   cloud%set_names = [character(len=len(cloud%set_names)) :: cloud%set_names, name]
   cloud%region = [cloud%region, region]
   allocate (wider(n + 1, size(inside)))
   wider(:n, :) = cloud%within
   wider(n + 1, :) = inside
   call move_alloc(wider, cloud%within)
end subroutine add_set

!> Sets of positions on the surface that are not boundary entries
subroutine sets_of(cloud, place, outward, side, near, within, error)
   !> Cloud, which may have regions
   type(cloud_type), intent(in) :: cloud
   !> Positions, shape (nd, ms) [length]
   real(wp), intent(in) :: place(:, :)
   !> Outward normals of any length, shape (nd, ms)
   real(wp), intent(in) :: outward(:, :)
   !> Side on which each lies, shape (ms)
   integer, intent(in) :: side(:)
   !> Collocation point whose tissue each has, shape (ms)
   integer, intent(in) :: near(:)
   !> Whether each lies in each set, shape (sets, ms)
   logical, allocatable, intent(out) :: within(:, :)
   !> Error handling: an expression that is not finite somewhere
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: normal(cloud%nd)
   integer :: k, n, regions, s

   n = cloud%sides()
   regions = 0
   if (allocated(cloud%region)) regions = size(cloud%region)
   allocate (within(n + regions, size(side)))
   do s = 1, size(side)
      within(:n, s) = [(k, k=1, n)] == side(s)
      normal = outward(:, s)/norm2(outward(:, s))
      do k = 1, regions
         within(n + k, s) = cloud%region(k)%holds(place(:, s), normal, side(s), &
            & cloud%label(near(s)), error)
         if (allocated(error)) return
      end do
   end do
end subroutine sets_of

!> Area of a set and its centre: from fine samples of the sides of a lattice, whose boundary entries
!> are too few to determine the extent of a part, otherwise from the entries
subroutine extent_of(cloud, set, area, middle, error)
   type(cloud_type), intent(in) :: cloud
   !> Set that has boundary entries
   integer, intent(in) :: set
   !> Area [length^(nd-1)]
   real(wp), intent(out) :: area
   !> Centre, shape (nd) [length]
   real(wp), intent(out) :: middle(:)
   !> Error handling: an expression that is not finite somewhere
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: place(:, :), outward(:, :), weight(:)
   integer, allocatable :: side(:)
   logical, allocatable :: within(:, :)
   integer :: e

   allocate (weight(0))
   if (set > cloud%sides() .and. allocated(cloud%lattice)) then
      call sample_sides(cloud, place, outward, side)
      call sets_of(cloud, place, outward, side, nearest_points(cloud%points, place), within, error)
      if (allocated(error)) return
      weight = merge(norm2(outward, dim=1), 0.0_wp, within(set, :))
   end if
   ! also for a set that falls between the samples
   if (.not. any(weight > 0.0_wp)) then
      place = cloud%points(:, cloud%boundary_point)
      weight = merge(cloud%area, 0.0_wp, cloud%in_set([(e, e=1, size(cloud%area))], set))
   end if
   area = sum(weight)
   middle = matmul(place, weight)/area
end subroutine extent_of

!> Positions on the sides of a lattice with their normals, whose lengths are the areas
subroutine sample_sides(cloud, place, outward, side)
   !> Cloud with a lattice
   type(cloud_type), intent(in) :: cloud
   !> Shape (nd, ms) [length]
   real(wp), allocatable, intent(out) :: place(:, :)
   !> Area times outward normal, shape (nd, ms) [length^(nd-1)]
   real(wp), allocatable, intent(out) :: outward(:, :)
   integer, allocatable, intent(out) :: side(:)
   real(wp) :: low(3), step(3), share(cloud%nd), edge(cloud%nd), q(cloud%nd)
   integer :: number(cloud%nd), digit(cloud%nd), d, k, nd, s

   nd = cloud%nd
   s = 2*nd*samples(nd)**(nd - 1)
   allocate (place(nd, s), outward(nd, s), side(s))
   call lattice_frame(cloud, low, step)
   edge = step(:nd)*(cloud%lattice - 1)
   outward = 0.0_wp
   s = 0
   do d = 1, nd
      number = samples(nd)
      number(d) = 2
      do k = 0, product(number) - 1
         s = s + 1
         digit = digits_of(k, number)
         share = (digit + 0.5_wp)/number
         share(d) = digit(d)
         q = low(:nd) + edge*share
         place(:, s) = place_at(cloud, q)
         side(s) = set_number(cloud%polar, d, digit(d))
         outward(d, s) = (2*digit(d) - 1)*product(edge(:d - 1)/number(:d - 1)) &
            & *product(edge(d + 1:)/number(d + 1:))
         if (.not. cloud%polar) cycle
         associate (radial => place(:, s)/q(1))
            if (d == 1) outward(:, s) = outward(1, s)*place(:, s)
            if (d == 2) outward(:, s) = outward(2, s)*[-radial(2), radial(1)]
         end associate
      end do
   end do
end subroutine sample_sides

end module rk_named_sets
