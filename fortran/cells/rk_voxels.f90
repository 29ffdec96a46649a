!> Nodal cells of a model: each source point has the voxels nearest to it.
module rk_voxels
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_facets, only : facets_type, join_small
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
subroutine voxel_facets(facets, cloud, group, filled, error)
   !> Facets
   type(facets_type), intent(inout) :: facets
   !> Cloud of a model
   type(cloud_type), intent(in) :: cloud
   !> Group of each cell, shape (ns)
   integer, allocatable, intent(out) :: group(:)
   !> Volume of the body in each cell over that of its voxels, shape (ns) [-]; not allocated where
   !> all voxels are full
   real(wp), allocatable, intent(out) :: filled(:)
   !> Error handling: no voxels, a source point without voxels
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: step(3), area(3), x(3), part
   real(wp), allocatable :: centre(:, :), share(:)
   integer, allocatable :: owner(:), at(:, :), voxel(:, :, :), first(:)
   integer :: n(3), blocks(3), ip, other, d, side, next(3), set

   if (.not. allocated(cloud%voxels%index)) then
      call fatal_error(error, err_input, 'nodal cells need a model of voxels, or a box, ' &
         & //'or an annulus')
      return
   end if
   share = cloud%volume/product(cloud%voxels%size)
   if (.not. all(share > 0.0_wp)) then
      ip = findloc(share > 0.0_wp, .false., dim=1)
      call fatal_error(error, err_input, 'collocation point '//to_text(ip)//' at ' &
         & //to_text(cloud%points(:, ip))//' has no volume, run `myork build` again')
      return
   end if
   allocate (centre, mold=cloud%points)
   do ip = 1, size(centre, 2)
      centre(:, ip) = cloud%voxels%centre(ip)
   end do
   step = minval(cloud%spacing, dim=2)
   owner = cloud%nearest_source()
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
   ! full voxels are full to the last bit
   if (all(abs(share - 1.0_wp) < 1.0e-6_wp)) then
      share = 1.0_wp
   else
      filled = mean_of(share, owner, size(first))
   end if
   at = cloud%voxels%index + spread(1 - minval(cloud%voxels%index, dim=2), 2, size(owner))
   n = maxval(at, dim=2)
   allocate (voxel(0:n(1) + 1, 0:n(2) + 1, 0:n(3) + 1), source=0)
   do ip = 1, size(owner)
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
      do d = 1, 3
         do side = -1, 1, 2
            next = at(:, ip)
            next(d) = next(d) + side
            other = voxel(next(1), next(2), next(3))
            area = 0.0_wp
            area(d) = side*product(cloud%voxels%size)/cloud%voxels%size(d)
            x = centre(:, ip)
            x(d) = x(d) + 0.5_wp*side*cloud%voxels%size(d)
            if (other == 0) then
               set = face_set(cloud, ip, area)
               ! a slice at an end is cut through as much of the body as it holds
               part = 1.0_wp
               if (d == 3 .and. (next(3) == 0 .or. next(3) > n(3))) part = share(ip)
               call facets%add(x, area, owner(ip), 0, set, part)
            else if (side == 1 .and. owner(other) /= owner(ip)) then
               call facets%add(x, area, owner(ip), owner(other), 0)
            end if
         end do
      end do
   end do
   do d = 1, 3
      blocks(d) = 1 + int((maxval(cloud%source(d, :)) - minval(cloud%source(d, :))) &
         & /(group_size*step(d)) + 0.5_wp)
   end do
   allocate (group(size(first)))
   do ip = 1, size(first)
      do d = 1, 3
         next(d) = int((cloud%source(d, ip) - minval(cloud%source(d, :)))/(group_size*step(d)) &
            & + 0.25_wp/group_size)
      end do
      next = min(next, blocks - 1)
      group(ip) = 1 + next(1) + blocks(1)*(next(2) + blocks(2)*next(3))
   end do
   call join_small(group, facets, (group_size**3 + 1)/2)
end subroutine voxel_facets

!> Mean of the voxels of each cell
pure function mean_of(values, owner, cells) result(mean)
   !> Value of each voxel, shape (nc)
   real(wp), intent(in) :: values(:)
   !> Its cell, shape (nc)
   integer, intent(in) :: owner(:)
   !> Cells, each with a voxel at least
   integer, intent(in) :: cells
   real(wp) :: mean(cells)
   integer :: number(cells), ip

   mean = 0.0_wp
   number = 0
   do ip = 1, size(owner)
      mean(owner(ip)) = mean(owner(ip)) + values(ip)
      number(owner(ip)) = number(owner(ip)) + 1
   end do
   mean = mean/number
end function mean_of

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
   do e = 1, size(cloud%boundary_point)
      if (cloud%boundary_point(e) /= ip) cycle
      if (dot_product(cloud%normal(:, e), area) <= most) cycle
      most = dot_product(cloud%normal(:, e), area)
      face_set = cloud%boundary_set(e)
   end do
end function face_set

end module rk_voxels
