!> Nodal cells of a model: each source point has the voxels nearest to it.
module rk_voxels
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_facets, only : facets_type, join_small
   use rk_neighbours, only : nearest_points
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: voxel_facets

   !> Source spacings that make a group, in each direction: linear pressures on two do not satisfy
   !> the inf-sup condition with nodal integration, on three they do
   integer, parameter :: group_size = 3

contains

!> Facets of all cells and their groups: blocks of source spacings, those cut small by the surface
!> joined to others
subroutine voxel_facets(facets, cloud, group, error)
   !> Facets
   type(facets_type), intent(inout) :: facets
   !> Cloud of a model
   type(cloud_type), intent(in) :: cloud
   !> Group of each cell, shape (ns)
   integer, allocatable, intent(out) :: group(:)
   !> Error handling: no voxels, a source point without voxels
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: low(3), size_(3), step(3), area(3)
   integer, allocatable :: owner(:), at(:, :), voxel(:, :, :), first(:)
   integer :: n(3), blocks(3), ip, other, d, side, next(3), nd, set

   nd = cloud%nd
   low = 0.0_wp
   size_ = 1.0_wp
   step = 1.0_wp
   n = 1
   do d = 1, nd
      low(d) = minval(cloud%voxel_centre(d, :))
      size_(d) = least_gap(cloud%voxel_centre(d, :), 1.0e-6_wp*minval(cloud%spacing(d, :)))
      step(d) = minval(cloud%spacing(d, :))
      if (size_(d) > 0.0_wp) n(d) = 1 + nint((maxval(cloud%voxel_centre(d, :)) - low(d))/size_(d))
      if (.not. size_(d) > 0.0_wp) size_(d) = step(d)
   end do
   if (.not. all(abs(cloud%volume - product(size_)) < 1.0e-6_wp*product(size_))) then
      call fatal_error(error, err_input, 'nodal cells need a model of equal voxels, or a box, ' &
         & //'or an annulus')
      return
   end if
   ! the nearest source point in source spacings
   owner = nearest_points(cloud%source/spread(step(:nd), 2, size(cloud%source, 2)), &
      & cloud%voxel_centre/spread(step(:nd), 2, size(cloud%voxel_centre, 2)))
   allocate (first(size(cloud%source, 2)), source=0)
   do ip = size(owner), 1, -1
      first(owner(ip)) = ip
   end do
   if (any(first == 0)) then
      ip = findloc(first, 0, dim=1)
      call fatal_error(error, err_input, 'source point '//to_text(ip)//' at ' &
         & //to_text(cloud%source(:, ip))//' has no voxel of its own')
      return
   end if
   allocate (at(3, size(owner)), source=1)
   allocate (voxel(0:n(1) + 1, 0:n(2) + 1, 0:n(3) + 1), source=0)
   do ip = 1, size(owner)
      at(:nd, ip) = 1 + nint((cloud%voxel_centre(:, ip) - low(:nd))/size_(:nd))
      associate (taken => voxel(at(1, ip), at(2, ip), at(3, ip)))
         if (taken > 0) then
            call fatal_error(error, err_input, 'collocation points '//to_text(taken)//' and ' &
               & //to_text(ip)//' stand for the same voxel, run `myork build` again')
            return
         end if
         taken = ip
      end associate
   end do
   do ip = 1, size(owner)
      do d = 1, nd
         do side = -1, 1, 2
            next = at(:, ip)
            next(d) = next(d) + side
            other = voxel(next(1), next(2), next(3))
            area = 0.0_wp
            area(d) = side*product(size_(:nd))/size_(d)
            associate (x => cloud%voxel_centre(:, ip) + 0.5_wp*side*size_(d)*unit(nd, d))
               if (other == 0) then
                  set = face_set(cloud, ip, area(:nd))
                  call facets%add(x, area(:nd), owner(ip), 0, set)
               else if (side == 1 .and. owner(other) /= owner(ip)) then
                  call facets%add(x, area(:nd), owner(ip), owner(other), 0)
               end if
            end associate
         end do
      end do
   end do
   blocks = 1
   do d = 1, nd
      blocks(d) = 1 + int((maxval(cloud%source(d, :)) - minval(cloud%source(d, :))) &
         & /(group_size*step(d)) + 0.5_wp)
   end do
   allocate (group(size(first)))
   do ip = 1, size(first)
      next = 0
      do d = 1, nd
         next(d) = int((cloud%source(d, ip) - minval(cloud%source(d, :)))/(group_size*step(d)) &
            & + 0.25_wp/group_size)
      end do
      next(:nd) = min(next(:nd), blocks(:nd) - 1)
      group(ip) = 1 + next(1) + blocks(1)*(next(2) + blocks(2)*next(3))
   end do
   call join_small(group, facets, (group_size**nd + 1)/2)
end subroutine voxel_facets

!> Smallest distance of different numbers, 0 if all are the same
pure real(wp) function least_gap(x, tolerance)
   !> Numbers
   real(wp), intent(in) :: x(:)
   !> Numbers nearer than this are the same
   real(wp), intent(in) :: tolerance
   real(wp) :: here, next

   least_gap = 0.0_wp
   here = minval(x)
   do
      if (.not. any(x > here + tolerance)) return
      next = minval(x, mask=x > here + tolerance)
      if (least_gap > 0.0_wp) then
         least_gap = min(least_gap, next - here)
      else
         least_gap = next - here
      end if
      here = next
   end do
end function least_gap

!> Boundary set of a voxel's face: that of the entry whose normal is nearest to the face's
pure integer function face_set(cloud, ip, area)
   !> Cloud
   type(cloud_type), intent(in) :: cloud
   !> Voxel
   integer, intent(in) :: ip
   !> Area times normal, shape (nd)
   real(wp), intent(in) :: area(:)
   real(wp) :: most
   integer :: e

   most = -huge(1.0_wp)
   face_set = 0
   do e = 1, size(cloud%point)
      if (cloud%point(e) /= ip) cycle
      if (dot_product(cloud%normal(:, e), area) <= most) cycle
      most = dot_product(cloud%normal(:, e), area)
      face_set = cloud%set(e)
   end do
end function face_set

!> Unit vector
pure function unit(nd, d) result(e)
   !> Space dimension
   integer, intent(in) :: nd
   !> Direction
   integer, intent(in) :: d
   real(wp) :: e(nd)

   e = 0.0_wp
   e(d) = 1.0_wp
end function unit

end module rk_voxels
