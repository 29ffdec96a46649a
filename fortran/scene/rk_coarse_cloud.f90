!> A coarser cloud of a body of voxels: blocks of voxels in the place of voxels, and source points
!> as many times as far apart. What is filled of a block is its volume, as `myork build` merges
!> voxels.
module rk_coarse_cloud
   use rk_cloud, only : cloud_type
   use rk_precision, only : wp
   implicit none
   private

   public :: coarse_cloud

   !> Layers of source points that a direction must keep
   integer, parameter :: least_layers = 2
   !> Share of a block from which on it belongs to the body [-]
   real(wp), parameter :: least_share = 1.0_wp/3.0_wp
   !> Shares that differ by less are the same [-]
   real(wp), parameter :: same = 1.0e-6_wp

contains

!> Merge blocks of voxels, two in each direction, along z as many as divide the slices evenly, so
!> that the body keeps its length
subroutine coarse_cloud(cloud, kept, coarse, possible)
   !> Points of a model of voxels
   type(cloud_type), intent(in) :: cloud
   !> Directions in which no voxels are merged, shape (3)
   logical, intent(in) :: kept(3)
   !> Its coarser cloud
   type(cloud_type), intent(out) :: coarse
   !> Whether some direction has layers enough
   logical, intent(out) :: possible
   integer :: low(3), n(3), edge(3), ratio(3), blocks(3), at(3), d, ip, k
   integer, allocatable :: block(:), number(:, :, :)
   real(wp), allocatable :: volume(:, :, :)
   real(wp) :: whole

   possible = .false.
   if (.not. allocated(cloud%voxels%index) .or. cloud%nd /= 3) return
   low = minval(cloud%voxels%index, dim=2)
   n = maxval(cloud%voxels%index, dim=2) - low + 1
   ratio = max(1, nint(minval(cloud%spacing, dim=2)/cloud%voxels%size))
   edge = 1
   do d = 1, 3
      do k = 2, 3
         if (kept(d) .or. edge(d) > 1 .or. n(d) < k*ratio(d)*least_layers) cycle
         if (d < 3 .or. mod(n(d), k) == 0) edge(d) = k
      end do
   end do
   if (all(edge == 1)) return
   possible = .true.
   blocks = (n + edge - 1)/edge
   allocate (volume(0:blocks(1) + 1, 0:blocks(2) + 1, 0:blocks(3) + 1), source=0.0_wp)
   allocate (number, mold=int(volume))
   do ip = 1, size(cloud%volume)
      at = 1 + (cloud%voxels%index(:, ip) - low)/edge
      volume(at(1), at(2), at(3)) = volume(at(1), at(2), at(3)) + cloud%volume(ip)
   end do
   whole = product(edge*cloud%voxels%size)
   allocate (block(size(cloud%volume)))
   number = 0
   k = 0
   do ip = 1, size(block)
      at = home(1 + (cloud%voxels%index(:, ip) - low)/edge)
      if (number(at(1), at(2), at(3)) == 0) then
         k = k + 1
         number(at(1), at(2), at(3)) = k
      end if
      block(ip) = number(at(1), at(2), at(3))
   end do
   coarse%nd = 3
   coarse%set_names = cloud%set_names
   if (allocated(cloud%length_unit)) coarse%length_unit = cloud%length_unit
   coarse%voxels%size = cloud%voxels%size*edge
   coarse%voxels%origin = cloud%voxels%origin + cloud%voxels%size*(low + 0.5_wp*(edge - 1))
   allocate (coarse%voxels%index(3, k))
   do ip = 1, size(block)
      coarse%voxels%index(:, block(ip)) = home(1 + (cloud%voxels%index(:, ip) - low)/edge) - 1
   end do
   call merge_points(cloud, coarse, block)
   call merge_boundary(cloud, coarse, block)
   call place_sources(coarse, ratio)

contains

   !> Place of the block to which what is at a place belongs: the fullest around one too empty
   pure function home(place) result(best)
      integer, intent(in) :: place(3)
      integer :: best(3)

      best = place
      if (volume(place(1), place(2), place(3)) > (1.0_wp + same)*least_share*whole) return
      best = place + maxloc(nint(volume(place(1) - 1:place(1) + 1, place(2) - 1:place(2) + 1, &
         & place(3):place(3))/(same*whole))) - 2
      best(3) = place(3)
   end function home

end subroutine coarse_cloud

!> Volumes, tissues and fibers of the blocks
subroutine merge_points(cloud, coarse, block)
   !> Points of the model
   type(cloud_type), intent(in) :: cloud
   !> Coarser cloud with its voxels
   type(cloud_type), intent(inout) :: coarse
   !> Block of each point, shape (nc)
   integer, intent(in) :: block(:)
   real(wp), allocatable :: fibered(:)
   logical, allocatable :: present(:, :)
   integer :: ip, k, f

   k = size(coarse%voxels%index, 2)
   if (allocated(cloud%fraction_label)) then
      coarse%fraction_label = cloud%fraction_label
   else
      coarse%fraction_label = distinct(cloud%label)
   end if
   allocate (coarse%volume(k), source=0.0_wp)
   allocate (coarse%fraction(size(coarse%fraction_label), k), source=0.0_wp)
   allocate (coarse%fiber(3, k), source=0.0_wp)
   allocate (coarse%points(3, k))
   allocate (present(size(coarse%fraction_label), k), source=.false.)
   do ip = 1, size(block)
      associate (b => block(ip), v => cloud%volume(ip))
         coarse%volume(b) = coarse%volume(b) + v
         f = findloc(coarse%fraction_label, cloud%label(ip), dim=1)
         if (f > 0) present(f, b) = .true.
         if (allocated(cloud%fraction)) then
            coarse%fraction(:, b) = coarse%fraction(:, b) + v*cloud%fraction(:, ip)
         else
            coarse%fraction(f, b) = coarse%fraction(f, b) + v
         end if
         ! a direction and its opposite are one fiber
         coarse%fiber(:, b) = coarse%fiber(:, b) + v*sign(1.0_wp, &
            & dot_product(coarse%fiber(:, b), cloud%fiber(:, ip)))*cloud%fiber(:, ip)
      end associate
   end do
   if (allocated(cloud%activation)) then
      ! only fibers have an activation
      allocate (coarse%activation(k), fibered(k), source=0.0_wp)
      do ip = 1, size(block)
         associate (b => block(ip), v => merge(cloud%volume(ip), 0.0_wp, &
            & any(abs(cloud%fiber(:, ip)) > 0.0_wp)))
            coarse%activation(b) = coarse%activation(b) + v*cloud%activation(ip)
            fibered(b) = fibered(b) + v
         end associate
      end do
      where (fibered > 0.0_wp) coarse%activation = min(1.0_wp, coarse%activation/fibered)
   end if
   allocate (coarse%label(k))
   do f = 1, k
      coarse%points(:, f) = coarse%voxels%centre(f)
      coarse%fraction(:, f) = coarse%fraction(:, f)/sum(coarse%fraction(:, f))
      ! points that hold some of a label but have another bring no fiber of it; a label of points
      ! may have no fraction at all
      if (.not. any(present(:, f))) present(:, f) = .true.
      coarse%label(f) = coarse%fraction_label(maxloc(nint(coarse%fraction(:, f)/same), &
         & dim=1, mask=present(:, f)))
      if (norm2(coarse%fiber(:, f)) > 0.0_wp) &
         & coarse%fiber(:, f) = coarse%fiber(:, f)/norm2(coarse%fiber(:, f))
   end do
end subroutine merge_points

!> One entry for each set that a block is part of
subroutine merge_boundary(cloud, coarse, block)
   !> Points of the model
   type(cloud_type), intent(in) :: cloud
   !> Coarser cloud with its points
   type(cloud_type), intent(inout) :: coarse
   !> Block of each point, shape (nc)
   integer, intent(in) :: block(:)
   integer :: entry(size(coarse%points, 2), size(cloud%set_names)), e, n, b, s

   entry = 0
   n = 0
   do e = 1, size(cloud%boundary_point)
      associate (mine => entry(block(cloud%boundary_point(e)), cloud%boundary_set(e)))
         if (mine > 0) cycle
         n = n + 1
         mine = n
      end associate
   end do
   allocate (coarse%boundary_point(n), coarse%boundary_set(n))
   allocate (coarse%normal(3, n), coarse%area(n), source=0.0_wp)
   do e = 1, size(cloud%boundary_point)
      b = block(cloud%boundary_point(e))
      s = cloud%boundary_set(e)
      associate (mine => entry(b, s))
         coarse%boundary_point(mine) = b
         coarse%boundary_set(mine) = s
         coarse%area(mine) = coarse%area(mine) + cloud%area(e)
         ! a sheet has two sides, of which the first one counts
         if (dot_product(coarse%normal(:, mine), cloud%normal(:, e)) >= 0.0_wp) &
            & coarse%normal(:, mine) = coarse%normal(:, mine) + cloud%area(e)*cloud%normal(:, e)
      end associate
   end do
   do e = 1, n
      coarse%normal(:, e) = coarse%normal(:, e)/norm2(coarse%normal(:, e))
   end do
end subroutine merge_boundary

!> A source point in the middle of as many blocks in each direction as voxels had one
subroutine place_sources(coarse, ratio)
   !> Coarser cloud with its voxels
   type(cloud_type), intent(inout) :: coarse
   !> Voxels from one source point to the next
   integer, intent(in) :: ratio(3)
   integer :: cells(3), at(3), ip, n
   logical, allocatable :: taken(:, :, :)

   cells = maxval(coarse%voxels%index, dim=2)/ratio + 1
   allocate (taken(cells(1), cells(2), cells(3)), source=.false.)
   do ip = 1, size(coarse%voxels%index, 2)
      at = coarse%voxels%index(:, ip)/ratio + 1
      taken(at(1), at(2), at(3)) = .true.
   end do
   allocate (coarse%source(3, count(taken)))
   n = 0
   do ip = 0, size(taken) - 1
      at = 1 + [mod(ip, cells(1)), mod(ip/cells(1), cells(2)), ip/(cells(1)*cells(2))]
      if (.not. taken(at(1), at(2), at(3))) cycle
      n = n + 1
      coarse%source(:, n) = coarse%voxels%origin + coarse%voxels%size*(ratio*(at - 0.5_wp) - 0.5_wp)
   end do
   coarse%spacing = spread(coarse%voxels%size*ratio, 2, n)
end subroutine place_sources

!> Different values in their order
pure function distinct(value) result(found)
   !> Values
   integer, intent(in) :: value(:)
   integer, allocatable :: found(:)
   integer :: next

   allocate (found(0))
   next = minval(value)
   do
      found = [found, next]
      if (all(value <= next)) exit
      next = minval(value, mask=value > next)
   end do
end function distinct

end module rk_coarse_cloud
