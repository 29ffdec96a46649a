!> Boundary sets that are parts of the surface with names: which of its places lie in which.
!>
!> Every place lies in the set of its side, and in those of all regions that hold it. Sets may
!> overlap.
module rk_named_sets
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type
   use rk_lattice, only : lattice_frame, set_number
   use rk_neighbours, only : nearest_points
   use rk_precision, only : wp
   use rk_region, only : region_type
   implicit none
   private

   public :: add_set, sets_of, extent_of

   !> Places in each direction of a side at which the extent of a set is looked at, by dimension
   integer, parameter :: samples(3) = [1, 1024, 96]

contains

!> Add a set to those of a cloud
subroutine add_set(cloud, name, region, found, error)
   !> Cloud with its boundary entries and labels
   type(cloud_type), intent(inout) :: cloud
   character(len=*), intent(in) :: name
   type(region_type), intent(in) :: region
   !> It holds a boundary entry
   logical, intent(out) :: found
   !> Error handling: an expression that is not finite somewhere
   type(error_type), allocatable, intent(inout) :: error
   logical :: inside(size(cloud%boundary_set))
   logical, allocatable :: wider(:, :)
   integer :: c, e, n

   do e = 1, size(inside)
      associate (ip => cloud%boundary_point(e))
         inside(e) = region%holds(cloud%points(:, ip), cloud%normal(:, e), &
            & cloud%boundary_set(e), cloud%label(ip), error)
      end associate
      if (allocated(error)) return
   end do
   found = any(inside)
   n = size(cloud%set_names)
   if (.not. allocated(cloud%region)) then
      allocate (cloud%region(0), cloud%within(n, size(inside)))
      do e = 1, size(inside)
         cloud%within(:, e) = [(c, c=1, n)] == cloud%boundary_set(e)
      end do
   end if
   cloud%set_names = [character(len=len(cloud%set_names)) :: cloud%set_names, name]
   cloud%region = [cloud%region, region]
   allocate (wider(n + 1, size(inside)))
   wider(:n, :) = cloud%within
   wider(n + 1, :) = inside
   call move_alloc(wider, cloud%within)
end subroutine add_set

!> Sets of places of the surface that are no boundary entries
subroutine sets_of(cloud, place, outward, side, near, within, error)
   !> Cloud, which may have regions
   type(cloud_type), intent(in) :: cloud
   !> Places, shape (nd, ms) [length]
   real(wp), intent(in) :: place(:, :)
   !> Outward normals of any length, shape (nd, ms)
   real(wp), intent(in) :: outward(:, :)
   !> Side that each lies on, shape (ms)
   integer, intent(in) :: side(:)
   !> Collocation point whose tissue each has, shape (ms)
   integer, intent(in) :: near(:)
   !> Whether each lies in each set, shape (sets, ms)
   logical, allocatable, intent(out) :: within(:, :)
   !> Error handling: an expression that is not finite somewhere
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: normal(cloud%nd)
   integer :: k, n, regions, s

   n = cloud%sides()
   regions = 0
   if (allocated(cloud%region)) regions = size(cloud%region)
   allocate (within(n + regions, size(side)))
   do s = 1, size(side)
      within(:n, s) = [(k, k=1, n)] == side(s)
      normal = outward(:, s)/norm2(outward(:, s))
      do k = 1, regions
         within(n + k, s) = cloud%region(k)%holds(place(:, s), normal, side(s), &
            & cloud%label(near(s)), error)
         if (allocated(error)) return
      end do
   end do
end subroutine sets_of

!> Area of a set and its middle: from fine samples of the sides of a lattice, whose boundary entries
!> are too few to determine the extent of a part, from the entries elsewhere
subroutine extent_of(cloud, set, area, middle, error)
   type(cloud_type), intent(in) :: cloud
   !> Set that has boundary entries
   integer, intent(in) :: set
   !> Area [length^(nd-1)]
   real(wp), intent(out) :: area
   !> Middle, shape (nd) [length]
   real(wp), intent(out) :: middle(:)
   !> Error handling: an expression that is not finite somewhere
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: place(:, :), outward(:, :)
   integer, allocatable :: side(:), near(:)
   real(wp) :: low(3), step(3), share
   integer :: e, s
   logical :: inside

   if (set <= cloud%sides() .or. .not. allocated(cloud%lattice)) then
      middle = cloud%set_centroid(set)
      area = sum([(merge(cloud%area(e), 0.0_wp, cloud%in_set(e, set)), e=1, size(cloud%area))])
      return
   end if
   call lattice_frame(cloud, low, step)
   call sample_sides(cloud, low, step, place, outward, side)
   near = nearest_points(cloud%points, place)
   area = 0.0_wp
   middle = 0.0_wp
   do s = 1, size(side)
      share = norm2(outward(:, s))
      inside = cloud%region(set - cloud%sides())%holds(place(:, s), outward(:, s)/share, side(s), &
         & cloud%label(near(s)), error)
      if (allocated(error)) return
      if (.not. inside) cycle
      area = area + share
      middle = middle + share*place(:, s)
   end do
   ! a set between the samples
   if (area > 0.0_wp) then
      middle = middle/area
   else
      middle = cloud%set_centroid(set)
   end if
end subroutine extent_of

!> Places on the sides of a lattice with their normals, whose lengths are the areas
subroutine sample_sides(cloud, low, step, place, outward, side)
   !> Cloud with a lattice
   type(cloud_type), intent(in) :: cloud
   !> Corner and spacing of the lattice, in radius and angle where it is polar [length], [radian]
   real(wp), intent(in) :: low(3), step(3)
   real(wp), allocatable, intent(out) :: place(:, :)
   !> Area times outward normal, shape (nd, ms) [length^(nd-1)]
   real(wp), allocatable, intent(out) :: outward(:, :)
   integer, allocatable, intent(out) :: side(:)
   real(wp) :: q(3), edge(3), radial(2)
   integer :: d, each, end, k, n, nd, o, p

   nd = cloud%nd
   n = samples(nd)
   each = n**(nd - 1)
   allocate (place(nd, 2*nd*each), outward(nd, 2*nd*each), side(2*nd*each))
   outward = 0.0_wp
   edge = 1.0_wp
   edge(:nd) = step(:nd)*(cloud%lattice - 1)
   do d = 1, nd
      o = modulo(d, nd) + 1
      p = modulo(d + 1, nd) + 1
      do end = 0, 1
         do k = 0, each - 1
            associate (s => 1 + k + each*(2*d - 2 + end))
               q = low
               q(d) = low(d) + end*edge(d)
               if (nd > 1) q(o) = low(o) + edge(o)*(mod(k, n) + 0.5_wp)/n
               if (nd == 3) q(p) = low(p) + edge(p)*(k/n + 0.5_wp)/n
               side(s) = set_number(cloud%polar, d, end)
               outward(d, s) = 2*end - 1
               if (nd > 1) outward(d, s) = outward(d, s)*edge(o)/n
               if (nd == 3) outward(d, s) = outward(d, s)*edge(p)/n
               place(:, s) = q(:nd)
               if (.not. cloud%polar) cycle
               radial = [cos(q(2)), sin(q(2))]
               place(:, s) = q(1)*radial
               if (d == 1) then
                  outward(:, s) = outward(1, s)*q(1)*radial
               else
                  outward(:, s) = outward(2, s)*[-radial(2), radial(1)]
               end if
            end associate
         end do
      end do
   end do
end subroutine sample_sides

end module rk_named_sets
