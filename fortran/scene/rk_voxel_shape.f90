!> Shape of a body of voxels: its share of surface, its thin parts, and the planes at which it is
!> cut, most of them planes of symmetry.
!>
!> Surface points lie on a smoothed surface, whose normals turn away from a plane near its rim. A
!> side of the body consists of whole voxel faces instead: all that end the body along an axis.
module rk_voxel_shape
   use rk_cloud, only : cloud_type
   use rk_precision, only : wp
   implicit none
   private

   public :: surface_share, end_taper, thin_directions, least_thickness, add_side

   !> Share of the voxels that must lie in thin parts for a direction to count as thin [-]
   real(wp), parameter :: enough = 0.25_wp
   !> Share of the body below which a tissue may have any thickness [-]
   real(wp), parameter :: small = 0.05_wp
   !> Maximum share of an end's area by which it is narrower than its slice: tips [-]
   real(wp), parameter :: most_taper = 0.5_wp
   !> Sides parallel to the axis of the slices; the ends are already sets of a model
   character(len=*), parameter :: names(4) = ['x0', 'x1', 'y0', 'y1']

contains

!> Number of voxel faces at the surface and between tissues per voxel of a body, except the ends
!> along z, which are known [-]: the relative change of volume if all of them moved by one voxel
pure real(wp) function surface_share(cloud) result(share)
   !> Points of a model of voxels
   type(cloud_type), intent(in) :: cloud
   integer, allocatable :: label(:, :, :)
   integer, allocatable :: at(:, :)
   integer :: d, faces, ip, side, there(3)

   call paint(cloud, label, at)
   faces = 0
   do ip = 1, size(at, 2)
      do d = 1, 3
         do side = -1, 1, 2
            there = at(:, ip)
            there(d) = there(d) + side
            if (d == 3 .and. (there(d) == 0 .or. there(d) == ubound(label, 3))) cycle
            associate (own => label(at(1, ip), at(2, ip), at(3, ip)), &
               & other => label(there(1), there(2), there(3)))
               ! a face between tissues is seen from both sides
               if (other < 0) faces = faces + 2
               if (other >= 0 .and. other /= own) faces = faces + 1
            end associate
         end do
      end do
   end do
   share = 0.5_wp*faces/size(at, 2)
end function surface_share

!> Share of area by which each end along z is narrower than its slice, labelled at its middle, half
!> a slice further in: the area is extrapolated from the two outermost slices [-]
pure function end_taper(cloud) result(taper)
   !> Points of a model of voxels
   type(cloud_type), intent(in) :: cloud
   !> At the lower and at the upper end
   real(wp) :: taper(2)
   real(wp) :: filled(2)
   integer :: end, k

   do end = 1, 2
      associate (z => (3 - 2*end)*cloud%voxels%index(3, :))
         filled = [(sum(cloud%volume, mask=z == minval(z) + k), k=0, 1)]
      end associate
      taper(end) = min(most_taper, max(0.0_wp, 0.5_wp*(filled(2)/filled(1) - 1.0_wp)))
   end do
end function end_taper

!> Directions along which a large part of the body is in layers below a given number of voxels
pure function thin_directions(cloud, least) result(thin)
   !> Points of a model of voxels
   type(cloud_type), intent(in) :: cloud
   !> Minimum number of voxels across a layer that is not thin, shape (3)
   integer, intent(in) :: least(3)
   logical :: thin(3)
   integer, allocatable :: length(:, :)

   length = layers(cloud)
   thin = count(length < spread(least, 2, size(length, 2)), dim=2) > enough*size(length, 2)
end function thin_directions

!> Thickness of the thinnest tissue along each direction: only a limited part of any tissue is in
!> thinner layers. Tissues that are a small part of the body are ignored
pure function least_thickness(cloud) result(thickness)
   !> Points of a model of voxels
   type(cloud_type), intent(in) :: cloud
   !> Numbers of voxels, shape (3)
   integer :: thickness(3)
   integer, allocatable :: length(:, :)
   logical :: own(size(cloud%label))
   integer :: d, k

   length = layers(cloud)
   thickness = maxval(length, dim=2)
   associate (label => cloud%labels())
      do k = 1, size(label)
         own = cloud%label == label(k)
         if (count(own) < small*size(own)) cycle
         do d = 1, 3
            do while (count(length(d, :) < thickness(d) .and. own) > enough*count(own))
               thickness(d) = thickness(d) - 1
            end do
         end do
      end do
   end associate
end function least_thickness

!> Run of voxels of the same tissue through each voxel, along each direction, shape (3, nc)
pure function layers(cloud) result(length)
   type(cloud_type), intent(in) :: cloud
   integer, allocatable :: length(:, :)
   integer, allocatable :: label(:, :, :)
   integer, allocatable :: at(:, :)
   integer :: d, ip, own, side, there(3)

   call paint(cloud, label, at)
   allocate (length, mold=at)
   length = 1
   do ip = 1, size(at, 2)
      own = label(at(1, ip), at(2, ip), at(3, ip))
      do d = 1, 3
         do side = -1, 1, 2
            there = at(:, ip)
            do
               there(d) = there(d) + side
               if (label(there(1), there(2), there(3)) /= own) exit
               length(d, ip) = length(d, ip) + 1
            end do
         end do
      end do
   end do
end function layers

!> Labels on the grid of the voxels, -1 around them
pure subroutine paint(cloud, label, at)
   type(cloud_type), intent(in) :: cloud
   !> Labels, shape (0:n(1)+1, 0:n(2)+1, 0:n(3)+1)
   integer, allocatable, intent(out) :: label(:, :, :)
   !> Index of each voxel in the grid, from 1, shape (3, nc)
   integer, allocatable, intent(out) :: at(:, :)
   integer :: ip, low(3), n(3)

   low = minval(cloud%voxels%index, dim=2)
   n = maxval(cloud%voxels%index, dim=2) - low + 1
   allocate (label(0:n(1) + 1, 0:n(2) + 1, 0:n(3) + 1), source=-1)
   allocate (at, mold=cloud%voxels%index)
   do ip = 1, size(at, 2)
      at(:, ip) = cloud%voxels%index(:, ip) - low + 1
      label(at(1, ip), at(2, ip), at(3, ip)) = max(0, cloud%label(ip))
   end do
end subroutine paint

!> Add a side to the sets of a model that has none of this name: the outer faces of its first or
!> last layer of voxels, which are removed from their former sets
subroutine add_side(cloud, name)
   !> Points of a model, without sets that are parts of the surface
   type(cloud_type), intent(inout) :: cloud
   !> Name; nothing is done if it is not the name of a side
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
   ! among sets with the same normal a face belongs to the first one
   cloud%boundary_set = [spread(1, 1, n), 1 + cloud%boundary_set]
   cloud%normal = reshape([spread(outward, 2, n), cloud%normal], [3, n + size(cloud%normal, 2)])
   cloud%area = [cloud%volume(layer)/cloud%voxels%size(axis), cloud%area]
   cloud%set_names = [character(len=len(cloud%set_names)) :: name, cloud%set_names]
end subroutine add_side

end module rk_voxel_shape
