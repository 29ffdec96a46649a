!> Cells of a model: blocks of voxels between source points, or the voxels nearest to each source
!> point.
module rk_voxels
   use rk_cloud, only : cloud_type
   use rk_csr, only : csr_type, group_by
   use rk_error, only : error_type, fatal_error, err_input
   use rk_facets, only : facets_type
   use rk_groups, only : groups_of, join_small, pairs, slots, threes
   use rk_precision, only : i8, wp
   use rk_text, only : to_text
   use rk_voxel_shape, only : end_taper
   implicit none
   private

   public :: voxel_facets

   !> Tolerance for normals equally near to a face's, positions equally near to source points [-]
   real(wp), parameter :: same = 1.0e-6_wp

contains

!> Facets of all cells and their groups: blocks of source spacings; small groups cut by the surface
!> are joined to others
subroutine voxel_facets(facets, cloud, group, filled, error)
   type(facets_type), intent(inout) :: facets
   type(cloud_type), intent(in) :: cloud
   !> Groups of each cell, shape (slots, cells)
   integer, allocatable, intent(out) :: group(:, :)
   !> Volume of the body in each cell over that of its voxels, shape (cells) [-]; not allocated if
   !> all voxels are full
   real(wp), allocatable, intent(out) :: filled(:)
   !> Error handling: no voxels, a source point without voxels
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: area(3), x(3), part, taper(2)
   real(wp), allocatable :: centre(:, :), number(:), share(:)
   integer, allocatable :: owner(:), at(:, :), voxel(:, :, :)
   !> Boundary entries of each voxel
   type(csr_type) :: entries
   integer :: n(3), cells, ip, other, d, side, set, next(3), entry, least

   if (.not. allocated(cloud%voxels%index)) then
      call fatal_error(error, err_input, 'nodal cells need a model of voxels, or a box, ' &
         & //'or an annulus: build the model from a label map, or use method "rkcm"')
      return
   end if
   share = cloud%volume/product(cloud%voxels%size)
   if (.not. all(share > 0.0_wp)) then
      ip = findloc(share > 0.0_wp, .false., dim=1)
      call fatal_error(error, err_input, 'collocation point '//to_text(ip)//' at ' &
         & //to_text(cloud%points(:, ip))//' has no volume, run `myork build` again')
      return
   end if
   centre = cloud%centres()
   call find_owners(cloud, owner, cells, error)
   if (allocated(error)) return
   ! set nearly full voxels to exactly full
   if (all(abs(share - 1.0_wp) < 1.0e-6_wp)) then
      share = 1.0_wp
   else
      allocate (filled(cells), number(cells), source=0.0_wp)
      do ip = 1, size(owner)
         filled(owner(ip)) = filled(owner(ip)) + share(ip)
         number(owner(ip)) = number(owner(ip)) + 1.0_wp
      end do
      filled = filled/number
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
   call group_by(size(cloud%points, 2), cloud%boundary_point, entries)
   taper = end_taper(cloud)
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
               entry = nearest_entry(entries, cloud, ip, area)
               ! an end slice has as much cut area as body in it, and less at an end where the body
               ! tapers
               part = 1.0_wp
               if (d == 3 .and. (next(3) == 0 .or. next(3) > n(3))) &
                  & part = share(ip)*(1.0_wp - taper(merge(1, 2, side < 0)))
               set = 0
               if (entry > 0) set = cloud%boundary_set(entry)
               call facets%add(x, area, owner(ip), 0, set, part, entry)
            else if (side == 1 .and. owner(other) /= owner(ip)) then
               call facets%add(x, area, owner(ip), owner(other), 0)
            end if
         end do
      end do
   end do
   call find_groups(cloud, owner, cells, group, least)
   call join_small(group, facets, least)
end subroutine voxel_facets

!> Cell of each voxel: that of its block, or of the nearest source point
subroutine find_owners(cloud, owner, cells, error)
   type(cloud_type), intent(in) :: cloud
   !> Cell of each voxel, shape (nc)
   integer, allocatable, intent(out) :: owner(:)
   integer, intent(out) :: cells
   !> Error handling: a source point without voxels
   type(error_type), allocatable, intent(out) :: error
   integer :: last(3), ip, i
   integer, allocatable :: number(:), place(:)

   last = [size(cloud%source, 2), 1, 1]
   if (allocated(cloud%block)) then
      last = maxval(cloud%block, dim=2) + 1
      place = [(1 + cloud%block(1, ip) + last(1)*(cloud%block(2, ip) &
         & + last(2)*cloud%block(3, ip)), ip=1, size(cloud%block, 2))]
   else
      place = cloud%nearest_source()
   end if
   allocate (number(product(last)), source=0)
   number(place) = 1
   cells = 0
   do i = 1, size(number)
      if (number(i) == 0 .and. allocated(cloud%block)) cycle
      if (number(i) == 0) then
         call fatal_error(error, err_input, 'source point '//to_text(i)//' at ' &
            & //to_text(cloud%source(:, i))//' has no voxel of its own')
         return
      end if
      cells = cells + 1
      number(i) = cells
   end do
   owner = number(place)
end subroutine find_owners

!> Groups of two blocks in each direction or of three source spacings; groups that the surface cuts
!> to less than half are joined to others
pure subroutine find_groups(cloud, owner, cells, group, least)
   type(cloud_type), intent(in) :: cloud
   integer, intent(in) :: owner(:)
   integer, intent(in) :: cells
   !> Groups of each cell, from 1, shape (slots, cells)
   integer, allocatable, intent(out) :: group(:, :)
   !> Minimum number of cells of a group
   integer, intent(out) :: least
   real(wp) :: step(3), low(3), high(3), at(3)
   integer :: n(3), i

   allocate (group(slots, cells))
   if (allocated(cloud%block)) then
      least = 4
      n = maxval(cloud%block, dim=2) + 1
      do i = 1, size(owner)
         group(:, owner(i)) = groups_of(pairs(cloud%block(:, i), n), &
            & pairs(n - 1 - cloud%block(:, i), n), 1 + pairs(n - 1, n))
      end do
      return
   end if
   ! linear pressures on groups of two do not satisfy the inf-sup condition with nodal integration
   least = 14
   step = minval(cloud%spacing, dim=2)
   low = minval(cloud%source, dim=2)
   high = maxval(cloud%source, dim=2)
   n = 1 + nint((high - low)/step + same)
   do i = 1, cells
      at = cloud%source(:, i)
      group(:, i) = groups_of(threes(nint((at - low)/step + same), n), &
         & threes(nint((high - at)/step + same), n), 1 + threes(n - 1, n))
   end do
end subroutine find_groups

!> Boundary entry of a voxel's face: the one whose normal is nearest to the face's; among equals,
!> that of the first set; 0 if there is none
pure integer function nearest_entry(entries, cloud, ip, area)
   !> Boundary entries of each voxel
   type(csr_type), intent(in) :: entries
   type(cloud_type), intent(in) :: cloud
   !> Voxel
   integer, intent(in) :: ip
   !> Area times normal, shape (nd)
   real(wp), intent(in) :: area(:)
   real(wp) :: most
   integer(i8) :: k

   nearest_entry = 0
   do k = entries%offset(ip) + 1, entries%offset(ip + 1)
      associate (e => entries%index(k))
         if (nearest_entry > 0) then
            associate (more => dot_product(cloud%normal(:, e), area) - most)
               if (more < -same*norm2(area)) cycle
               if (more <= same*norm2(area) .and. cloud%boundary_set(e) &
                  & >= cloud%boundary_set(nearest_entry)) cycle
            end associate
         end if
         most = dot_product(cloud%normal(:, e), area)
         nearest_entry = e
      end associate
   end do
end function nearest_entry

end module rk_voxels
