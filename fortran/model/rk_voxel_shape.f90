!> Shape of a body of voxels: how much of it is surface, and where it is thin.
module rk_voxel_shape
   use rk_cloud, only : cloud_type
   use rk_precision, only : wp
   implicit none
   private

   public :: surface_share, thin_directions

   !> Share of the voxels that must lie in thin parts to make a direction thin [-]
   real(wp), parameter :: enough = 0.25_wp

contains

!> Faces of voxels at the surface and between tissues for each voxel of a body, its ends along z
!> left out, which are known [-]: the volume that goes with moving them all by one voxel, over that
!> of the body
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

!> Directions along which a good part of the body is in layers thinner than some number of voxels
pure function thin_directions(cloud, least) result(thin)
   !> Points of a model of voxels
   type(cloud_type), intent(in) :: cloud
   !> Voxels across a layer that is not thin, shape (3)
   integer, intent(in) :: least(3)
   logical :: thin(3)
   integer, allocatable :: label(:, :, :)
   integer, allocatable :: at(:, :)
   integer :: d, ip, few, length, side, there(3)

   call paint(cloud, label, at)
   do d = 1, 3
      few = 0
      do ip = 1, size(at, 2)
         length = 1
         do side = -1, 1, 2
            there = at(:, ip)
            do while (length < least(d))
               there(d) = there(d) + side
               if (label(there(1), there(2), there(3)) &
                  & /= label(at(1, ip), at(2, ip), at(3, ip))) exit
               length = length + 1
            end do
         end do
         if (length < least(d)) few = few + 1
      end do
      thin(d) = few > enough*size(at, 2)
   end do
end function thin_directions

!> Labels on the grid of the voxels, -1 around them
pure subroutine paint(cloud, label, at)
   !> Points of a model of voxels
   type(cloud_type), intent(in) :: cloud
   !> Labels, shape (0:n(1)+1, 0:n(2)+1, 0:n(3)+1)
   integer, allocatable, intent(out) :: label(:, :, :)
   !> Place of each voxel in the grid, from 1, shape (3, nc)
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

end module rk_voxel_shape
