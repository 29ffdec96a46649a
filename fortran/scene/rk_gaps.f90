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
   !> Number of pairs of facing voxels that are looked at, evenly among all
   integer, parameter :: enough = 500

contains

!> Part of the surface that faces a part of the body across such a gap
subroutine find_gaps(cloud, share, place)
   type(cloud_type), intent(in) :: cloud
   !> Area of these faces of voxels relative to that of all faces [-]
   real(wp), intent(out) :: share
   !> Centre of a voxel at such a face, shape (3) [length]; not set where there is none
   real(wp), intent(out) :: place(3)
   logical, allocatable :: filled(:, :, :)
   integer, allocatable :: at(:, :), pair(:, :)
   real(wp) :: face(3), spacing(3), surface, across
   integer :: n(3), most(3), next(3), pass, pairs, ip, d, k, side, step

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
   do pass = 1, 2
      pairs = 0
      do ip = 1, size(at, 2)
         do d = 1, 3
            do side = -1, 1, 2
               next = at(:, ip)
               next(d) = next(d) + side
               if (filled(next(1), next(2), next(3))) cycle
               if (pass == 1) surface = surface + face(d)
               if (side < 0) cycle
               do k = 1, most(d)
                  next(d) = next(d) + 1
                  if (next(d) > n(d)) exit
                  if (filled(next(1), next(2), next(3))) exit
               end do
               if (k > most(d) .or. next(d) > n(d)) cycle
               pairs = pairs + 1
               if (pass == 2) pair(:, pairs) = [ip, d, k]
            end do
         end do
      end do
      if (pass == 1) allocate (pair(3, pairs))
   end do
   across = 0.0_wp
   step = 1 + (pairs - 1)/enough
   do k = 1, pairs, step
      associate (first => at(:, pair(1, k)), d => pair(2, k))
         next = first
         next(d) = next(d) + pair(3, k) + 1
         if (are_joined(filled, first, next, nint(nearby*spacing/cloud%voxels%size))) cycle
         if (.not. across > 0.0_wp) place = cloud%voxels%centre(pair(1, k))
         across = across + 2.0_wp*step*face(d)
      end associate
   end do
   share = min(across/surface, 1.0_wp)
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
