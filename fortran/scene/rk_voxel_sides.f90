!> Sides of a model of voxels by name: planes at which a body is cut, most of them of symmetry.
!>
!> Places of the surface lie on a smoothed one, whose normals turn away from a plane near its rim. A
!> side has whole faces of voxels instead: all that end the body along an axis.
module rk_voxel_sides
   use rk_cloud, only : cloud_type
   use rk_precision, only : wp
   implicit none
   private

   public :: add_side

   !> Sides across the slices; those at the ends are sets of a model
   character(len=*), parameter :: names(4) = ['x0', 'x1', 'y0', 'y1']

contains

!> Add a side to the sets of a model where it has none of this name: the outer faces of its first or
!> last layer of voxels, which leave the sets they were in
subroutine add_side(cloud, name)
   !> Points of a model, without sets that are parts of the surface
   type(cloud_type), intent(inout) :: cloud
   !> Name; nothing is done for those of no side
   character(len=*), intent(in) :: name
   integer, allocatable :: layer(:)
   real(wp) :: outward(3)
   integer :: axis, d, ip, n

   if (.not. (any(names == name) .and. allocated(cloud%voxels%index)) .or. cloud%nd /= 3) return
   if (cloud%find_set(name) > 0) return
   axis = index('xy', name(1:1))
   d = merge(1, -1, name(2:2) == '1')
   associate (place => d*cloud%voxels%index(axis, :))
      layer = pack([(ip, ip=1, size(place))], place == maxval(place))
   end associate
   outward = 0.0_wp
   outward(axis) = d
   n = size(layer)
   cloud%boundary_point = [layer, cloud%boundary_point]
   ! of sets with the same normal the first one has a face
   cloud%boundary_set = [spread(1, 1, n), 1 + cloud%boundary_set]
   cloud%normal = reshape([spread(outward, 2, n), cloud%normal], [3, n + size(cloud%normal, 2)])
   cloud%area = [cloud%volume(layer)/cloud%voxels%size(axis), cloud%area]
   cloud%set_names = [character(len=len(cloud%set_names)) :: name, cloud%set_names]
end subroutine add_side

end module rk_voxel_sides
