!> Volume rows of clouds that are no regular grids: one for each patch of the body.
!>
!> The mixed form asks for the right volume at no more points than there are pressure unknowns, and
!> everywhere in the body. On a regular grid these are the centres of the cells between source
!> points. Here the collocation points are shared among patches about one source spacing wide, and
!> the row stands at the centroid of each: patches reach to the surface, however ragged it is.
module rk_volume_points
   use rk_cloud, only : cloud_type
   use rk_neighbours, only : most_central, nearest_points
   use rk_precision, only : wp
   implicit none
   private

   public :: volume_patches, local_pitch

   !> Patches per source point at most: more rows than pressure unknowns lock the mixed form
   real(wp), parameter :: most = 0.9_wp
   !> Rounds in which patches and their centroids follow each other (Lloyd's iteration); patches
   !> even out in the first few
   integer, parameter :: rounds = 6
   !> Distances that differ by less are the same, in spacings
   real(wp), parameter :: as_far = 1.0e-6_wp

contains

!> Set the volume points of a cloud with source and collocation points
subroutine volume_patches(cloud)
   !> Cloud; the cells are set
   type(cloud_type), intent(inout) :: cloud
   real(wp) :: pitch(cloud%nd, size(cloud%points, 2)), width
   integer :: owner(size(cloud%points, 2)), ip, iv, round
   real(wp), allocatable :: volume(:)

   pitch = local_pitch(cloud)
   ! a little less than 1, so that the centres of a regular grid's cells are far enough apart
   width = 0.999_wp
   do
      call choose_seeds(cloud, pitch, width)
      if (size(cloud%volume_points, 2) <= max(1, int(most*size(cloud%source, 2)))) exit
      width = 1.1_wp*width
   end do
   do round = 1, rounds
      owner = owners(cloud, cloud%volume_points)
      allocate (volume(size(cloud%volume_points, 2)), source=0.0_wp)
      cloud%volume_points = 0.0_wp
      do ip = 1, size(owner)
         volume(owner(ip)) = volume(owner(ip)) + cloud%volume(ip)
         cloud%volume_points(:, owner(ip)) = cloud%volume_points(:, owner(ip)) &
            & + cloud%volume(ip)*cloud%points(:, ip)
      end do
      cloud%volume_points = &
         & cloud%volume_points(:, pack([(iv, iv=1, size(volume))], volume > 0.0_wp)) &
         & /spread(pack(volume, volume > 0.0_wp), 1, cloud%nd)
      deallocate (volume)
   end do
end subroutine volume_patches

!> Seeds of the patches: collocation points at least a width apart, those farthest from source
!> points first, as the centres of cells are
subroutine choose_seeds(cloud, pitch, width)
   !> Cloud; the cells are set to the seeds
   type(cloud_type), intent(inout) :: cloud
   !> Source spacing at each place, shape (nd, nc) [length]
   real(wp), intent(in) :: pitch(:, :)
   !> Least distance in spacings
   real(wp), intent(in) :: width
   real(wp) :: distance(size(pitch, 2))
   logical :: free(size(pitch, 2))
   real(wp) :: scaled(cloud%nd, size(pitch, 2))
   integer :: near(size(pitch, 2)), seed(size(pitch, 2)), ip, n

   scaled = cloud%points/spread(sum(cloud%spacing, dim=2)/size(cloud%spacing, 2), 2, size(near))
   near = owners(cloud, cloud%source)
   do ip = 1, size(distance)
      distance(ip) = sum(((cloud%points(:, ip) - cloud%source(:, near(ip)))/pitch(:, ip))**2)
   end do
   free = .true.
   n = 0
   do while (any(free))
      n = n + 1
      seed(n) = most_central(scaled, pack([(ip, ip=1, size(free))], free &
         & .and. distance >= maxval(distance, mask=free) - as_far))
      do ip = 1, size(free)
         if (free(ip)) free(ip) = sum(((cloud%points(:, ip) - cloud%points(:, seed(n))) &
            & /pitch(:, ip))**2) >= (width - as_far)**2
      end do
      ! whatever the rounding
      free(seed(n)) = .false.
   end do
   cloud%volume_points = cloud%points(:, seed(:n))
end subroutine choose_seeds

!> Centre nearest to each collocation point, in mean spacings of the source points
function owners(cloud, centre) result(near)
   !> Cloud with source and collocation points
   type(cloud_type), intent(in) :: cloud
   !> Centres, shape (nd, n) [length]
   real(wp), intent(in) :: centre(:, :)
   integer :: near(size(cloud%points, 2))
   real(wp) :: unit(cloud%nd)

   unit = sum(cloud%spacing, dim=2)/size(cloud%spacing, 2)
   near = nearest_points(centre/spread(unit, 2, size(centre, 2)), &
      & cloud%points/spread(unit, 2, size(cloud%points, 2)))
end function owners

!> Source spacing at each collocation point, that of the nearest source point
function local_pitch(cloud) result(pitch)
   !> Cloud with source and collocation points
   type(cloud_type), intent(in) :: cloud
   real(wp) :: pitch(cloud%nd, size(cloud%points, 2))

   pitch = cloud%spacing(:, owners(cloud, cloud%source))
end function local_pitch

end module rk_volume_points
