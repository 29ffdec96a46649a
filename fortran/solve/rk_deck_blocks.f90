!> Blocks of voxels whose corners are the source points of a model.
!>
!> The deck says how many there are, or its distance of source points does. Where neither was chosen
!> that distance is two voxels, and directions in which a tissue or the body has too few blocks
!> across take single voxels instead, as long as the blocks do not become too many. Layers of
!> tissues shear along each other from the held ends on: where there are several, z takes them as
!> well.
module rk_deck_blocks
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type, table_defaults
   use rk_error, only : error_type
   use rk_precision, only : wp
   use rk_voxel_lattice, only : corner_sources
   use rk_voxel_shape, only : least_thickness
   implicit none
   private

   public :: put_corners, finer_directions

   !> Blocks across a layer that are enough
   integer, parameter :: enough_blocks = 4
   !> Blocks up to which they become finer by themselves: a minute with the second solution
   integer, parameter :: most_blocks = 5000

contains

!> Put the source points at the corners of blocks where the form has them there
subroutine put_corners(cloud, deck)
   !> Points of the model file
   type(cloud_type), intent(inout) :: cloud
   type(deck_type), intent(in) :: deck
   character(len=:), allocatable :: method
   integer, allocatable :: blocks(:)

   call deck%get('scene.method', method)
   if (method /= 'rkpm-gauss' .or. .not. allocated(cloud%voxels%index)) return
   call deck%get('geometry.blocks', blocks)
   call corner_sources(cloud, blocks, finer_directions(cloud, deck))
end subroutine put_corners

!> Directions in which blocks are single voxels, since layers are thin and nobody chose another
!> distance
function finer_directions(cloud, deck) result(finer)
   !> Points of the model file
   type(cloud_type), intent(in) :: cloud
   type(deck_type), intent(in) :: deck
   logical :: finer(3)
   type(deck_type) :: defaults
   type(error_type), allocatable :: error
   integer, allocatable :: usual(:)
   integer :: thickness(3), ratio(3)

   finer = .false.
   if (deck%has('geometry.blocks') .or. deck%given('build.source_stride')) return
   call table_defaults(defaults, 'build', '', '', error)
   if (allocated(error)) return
   call defaults%get('build.source_stride', usual)
   ratio = nint(minval(cloud%spacing, dim=2)/cloud%voxels%size)
   if (any(ratio /= usual)) return
   thickness = least_thickness(cloud)
   finer = thickness < enough_blocks*ratio
   finer(3) = any(finer) .and. (finer(3) .or. any(cloud%label /= cloud%label(1)))
   do while (any(finer) .and. size(cloud%label)/product(real(merge(1, ratio, finer), wp)) &
      & > most_blocks)
      ! the thickest layers can do without
      finer = finer .and. thickness < maxval(thickness, mask=finer)
   end do
end function finer_directions

end module rk_deck_blocks
