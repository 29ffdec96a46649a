!> Boundary sets that are named parts of the surface: assignment of positions to sets.
!>
!> Every position lies in the set of its side, and in those of all regions that contain it. Sets may
!> overlap.
module rk_named_sets
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type
   use rk_neighbours, only : nearest_points
   use rk_precision, only : wp
   use rk_region, only : region_type
   implicit none
   private

   public :: add_set, sets_of

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
subroutine sets_of(cloud, place, outward, side, within, error)
   !> Cloud, which may have regions
   type(cloud_type), intent(in) :: cloud
   !> Positions, shape (nd, ms) [length]
   real(wp), intent(in) :: place(:, :)
   !> Outward normals of any length, shape (nd, ms)
   real(wp), intent(in) :: outward(:, :)
   !> Side on which each lies, shape (ms)
   integer, intent(in) :: side(:)
   !> Whether each lies in each set, shape (sets, ms)
   logical, allocatable, intent(out) :: within(:, :)
   !> Error handling: an expression that is not finite somewhere
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: normal(cloud%nd)
   integer :: k, label(size(side)), n, regions, s

   n = cloud%sides()
   regions = 0
   if (allocated(cloud%region)) regions = size(cloud%region)
   label = 0
   do k = 1, regions
      if (.not. allocated(cloud%region(k)%label)) cycle
      ! the tissue of the nearest point
      label = cloud%label(nearest_points(cloud%points, place))
      exit
   end do
   allocate (within(n + regions, size(side)))
   do s = 1, size(side)
      within(:n, s) = [(k, k=1, n)] == side(s)
      normal = outward(:, s)/norm2(outward(:, s))
      do k = 1, regions
         within(n + k, s) = cloud%region(k)%holds(place(:, s), normal, side(s), label(s), &
            & error)
         if (allocated(error)) return
      end do
   end do
end subroutine sets_of

end module rk_named_sets
