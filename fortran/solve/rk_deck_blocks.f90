!> Blocks of voxels whose corners are the source points of a model.
!>
!> Their number is given in the deck, or by its distance of source points. Where neither is given
!> that distance is two voxels, and single voxels are used instead in directions in which a tissue
!> or the body has too few blocks across, as long as the blocks do not become too many. Layers of
!> tissues shear along each other from the constrained ends on: where there are several, single
!> voxels are used along z too.
!>
!> A lattice covers the body, and the corners of each of its cells that contains voxels are source
!> points; those at the surface lie on it or outside. Source points at the centres of voxels end
!> half a spacing inside, and linear functions continued from there make a body too stiff in
!> bending: a bracket with four of them across its arms moved 7 % too little, 0.2 % with the
!> corners.
module rk_deck_blocks
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_precision, only : wp
   use rk_voxel_shape, only : least_thickness
   implicit none
   private

   public :: put_corners, finer_directions

   !> Sufficient number of blocks across a layer
   integer, parameter :: enough_blocks = 4
   !> Number of blocks up to which they are refined by default: a minute with the second solution
   integer, parameter :: most_blocks = 5000
   !> Ratios that differ by less count as equal [-]
   real(wp), parameter :: same = 1.0e-6_wp

contains

!> Put the source points at the corners of blocks where the form needs them there
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

!> Directions in which blocks are single voxels, since layers are thin and no distance was given
function finer_directions(cloud, deck) result(finer)
   !> Points of the model file
   type(cloud_type), intent(in) :: cloud
   type(deck_type), intent(in) :: deck
   logical :: finer(3)
   integer, allocatable :: usual(:)
   integer :: thickness(3), ratio(3)

   finer = .false.
   if (deck%has('geometry.blocks') .or. deck%given('build.source_stride')) return
   call deck%get('build.source_stride', usual)
   ratio = nint(minval(cloud%spacing, dim=2)/cloud%voxels%size)
   if (any(ratio /= usual)) return
   thickness = least_thickness(cloud)
   finer = thickness < enough_blocks*ratio
   finer(3) = any(finer) .and. (finer(3) .or. any(cloud%label /= cloud%label(1)))
   do while (any(finer) .and. size(cloud%label)/product(real(merge(1, ratio, finer), wp)) &
      & > most_blocks)
      ! the thickest layers need it least
      finer = finer .and. thickness < maxval(thickness, mask=finer)
   end do
end function finer_directions

!> Put the source points at the corners of blocks, about as large as their spacing unless a number
!> or single voxels are requested; the ends of the body are planes of their lattice
subroutine corner_sources(cloud, blocks, single)
   !> Points of a model of voxels
   type(cloud_type), intent(inout) :: cloud
   !> Blocks along each direction, shape (3); empty if none are given
   integer, intent(in) :: blocks(:)
   !> Directions in which each voxel is a block if no number is given, shape (3)
   logical, intent(in) :: single(3)
   integer :: low(3), n(3), cells(3), corner(3), i, ip, k
   logical, allocatable :: taken(:, :, :)
   real(wp) :: step(3), start(3)

   low = minval(cloud%voxels%index, dim=2)
   n = maxval(cloud%voxels%index, dim=2) - low + 1
   ! none is smaller than a voxel; two and a half are rounded up to three despite rounding errors
   cells = nint((1.0_wp + same)*min(real(n, wp), max(1.0_wp, &
      & n*cloud%voxels%size/minval(cloud%spacing, dim=2))))
   where (single) cells = n
   if (size(blocks) == 3) cells = min(blocks, n)
   step = n*cloud%voxels%size/cells
   start = cloud%voxels%origin + cloud%voxels%size*(low - 0.5_wp)
   allocate (cloud%block, mold=cloud%voxels%index)
   allocate (taken(0:cells(1), 0:cells(2), 0:cells(3)), source=.false.)
   do ip = 1, size(cloud%voxels%index, 2)
      ! a centre between two blocks belongs to the inner one
      associate (at => 2*(cloud%voxels%index(:, ip) - low) + 1)
         cloud%block(:, ip) = (at*cells - merge(1, 0, at > n))/(2*n)
      end associate
      associate (at => cloud%block(:, ip))
         taken(at(1):at(1) + 1, at(2):at(2) + 1, at(3):at(3) + 1) = .true.
      end associate
   end do
   deallocate (cloud%source)
   allocate (cloud%source(3, count(taken)))
   k = 0
   do i = 0, size(taken) - 1
      corner = [mod(i, cells(1) + 1), mod(i/(cells(1) + 1), cells(2) + 1), &
         & i/((cells(1) + 1)*(cells(2) + 1))]
      if (.not. taken(corner(1), corner(2), corner(3))) cycle
      k = k + 1
      cloud%source(:, k) = start + step*corner
   end do
   cloud%spacing = spread(step, 2, k)
end subroutine corner_sources

end module rk_deck_blocks
