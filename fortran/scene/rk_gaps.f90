!> Narrow gaps in a body of voxels, which its shape functions bridge: parts on either side of them
!> that are not joined nearby would move together.
module rk_gaps
   use rk_cloud, only : cloud_type
   use rk_precision, only : wp
   implicit none
   private

   public :: find_gaps

   !> Width below which a gap is bridged, in spacings of the source points: a slit of one spacing
   !> joins two halves of a beam, one of 1.5 leaves their deflection 2 % too small
   real(wp), parameter :: bridged = 1.5_wp
   !> Distance within which parts count as joined, in spacings
   real(wp), parameter :: nearby = 2.0_wp

contains

!> Part of the surface that faces a part of the body across such a gap
subroutine find_gaps(cloud, share, place)
   type(cloud_type), intent(in) :: cloud
   !> Area of these faces of voxels relative to that of all faces [-]
   real(wp), intent(out) :: share
   !> Centre of a voxel at such a face, shape (3) [length]; zero if there is none
   real(wp), intent(out) :: place(3)
   logical, allocatable :: filled(:, :, :)
   integer, allocatable :: at(:, :)
   real(wp) :: face(3), spacing(3), surface, across
   integer :: n(3), most(3), next(3), ip, d, k, side

   share = 0.0_wp
   place = 0.0_wp
   if (.not. allocated(cloud%voxels%index)) return
   at = cloud%voxels%index + spread(1 - minval(cloud%voxels%index, dim=2), 2, &
      & size(cloud%voxels%index, 2))
   n = maxval(at, dim=2)
   spacing = maxval(cloud%spacing, dim=2)
   most = ceiling(bridged*spacing/cloud%voxels%size) - 1
   face = product(cloud%voxels%size)/cloud%voxels%size
   allocate (filled(0:n(1) + 1, 0:n(2) + 1, 0:n(3) + 1), source=.false.)
   do ip = 1, size(at, 2)
      filled(at(1, ip), at(2, ip), at(3, ip)) = .true.
   end do
   surface = 0.0_wp
   across = 0.0_wp
   do ip = 1, size(at, 2)
      do d = 1, 3
         do side = -1, 1, 2
            next = at(:, ip)
            next(d) = next(d) + side
            if (filled(next(1), next(2), next(3))) cycle
            surface = surface + face(d)
            do k = 1, merge(most(d), 0, side > 0)
               next(d) = next(d) + 1
               if (next(d) > n(d)) exit
               if (.not. filled(next(1), next(2), next(3))) cycle
               if (are_joined(filled, at(:, ip), next, nint(nearby*spacing/cloud%voxels%size))) exit
               if (.not. across > 0.0_wp) place = cloud%voxels%centre(ip)
               across = across + 2.0_wp*face(d)
               exit
            end do
         end do
      end do
   end do
   share = across/surface
end subroutine find_gaps

!> Whether two voxels are joined through faces of others not far from them
logical function are_joined(filled, first, second, reach)
   !> Voxels of the body, with a layer of others around them
   logical, intent(in) :: filled(0:, 0:, 0:)
   integer, intent(in) :: first(3), second(3)
   !> Number of voxels beside the two that are looked at
   integer, intent(in) :: reach(3)
   logical, allocatable :: seen(:, :, :)
   integer, allocatable :: queue(:, :)
   integer :: low(3), high(3), next(3), head, tail, d, side

   low = max(min(first, second) - reach, 0)
   high = min(max(first, second) + reach, shape(filled) - 1)
   allocate (seen(low(1):high(1), low(2):high(2), low(3):high(3)), source=.false.)
   allocate (queue(3, product(high - low + 1)))
   are_joined = .true.
   queue(:, 1) = first
   seen(first(1), first(2), first(3)) = .true.
   head = 0
   tail = 1
   do while (head < tail)
      head = head + 1
      do d = 1, 3
         do side = -1, 1, 2
            next = queue(:, head)
            next(d) = next(d) + side
            if (next(d) < low(d) .or. next(d) > high(d)) cycle
            if (seen(next(1), next(2), next(3)) .or. .not. filled(next(1), next(2), next(3))) cycle
            if (all(next == second)) return
            seen(next(1), next(2), next(3)) = .true.
            tail = tail + 1
            queue(:, tail) = next
         end do
      end do
   end do
   are_joined = .false.
end function are_joined

end module rk_gaps
