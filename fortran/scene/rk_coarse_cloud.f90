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

   !> Parts of voxels in blocks, those of a voxel together
   type :: shares_type
      !> Voxel ip has entries first(ip)+1 : first(ip+1)
      integer, allocatable :: first(:)
      !> Voxel and block of each entry, shape (entries)
      integer, allocatable :: point(:), block(:)
      !> Place of the block, from 1, shape (3, entries)
      integer, allocatable :: place(:, :)
      !> Part of the voxel in it, shape (entries) [-]
      real(wp), allocatable :: part(:)
   end type shares_type

contains

!> Merge blocks of voxels, two in each direction, along z as many as divide the slices evenly, so
!> that the body keeps its length. Of an odd number across the slices, blocks begin half a voxel
!> outside at both ends, so that a body and its mirror image are merged alike
subroutine coarse_cloud(cloud, kept, coarse, possible)
   !> Points of a model of voxels
   type(cloud_type), intent(in) :: cloud
   !> Directions in which no voxels are merged, shape (3)
   logical, intent(in) :: kept(3)
   !> Its coarser cloud
   type(cloud_type), intent(out) :: coarse
   !> Whether some direction has layers enough
   logical, intent(out) :: possible
   type(shares_type) :: shares
   integer :: low(3), n(3), edge(3), ratio(3), blocks(3), at(3), d, e, k
   integer, allocatable :: number(:, :, :)
   real(wp), allocatable :: volume(:, :, :)
   logical :: astride(3)

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
   astride = edge == 2 .and. mod(n, 2) == 1
   call share_voxels(shares, cloud%voxels%index - spread(low, 2, size(cloud%volume)), edge, astride)
   allocate (volume(0:blocks(1) + 1, 0:blocks(2) + 1, 0:blocks(3) + 1), source=0.0_wp)
   allocate (number, mold=int(volume))
   do e = 1, size(shares%point)
      at = shares%place(:, e)
      volume(at(1), at(2), at(3)) = volume(at(1), at(2), at(3)) &
         & + shares%part(e)*cloud%volume(shares%point(e))
   end do
   call leave_empty(shares, volume, least_share*product(edge*cloud%voxels%size))
   number = 0
   k = 0
   do e = 1, size(shares%point)
      at = shares%place(:, e)
      if (number(at(1), at(2), at(3)) == 0) then
         k = k + 1
         number(at(1), at(2), at(3)) = k
      end if
      shares%block(e) = number(at(1), at(2), at(3))
   end do
   coarse%nd = 3
   coarse%set_names = cloud%set_names
   if (allocated(cloud%length_unit)) coarse%length_unit = cloud%length_unit
   coarse%voxels%size = cloud%voxels%size*edge
   coarse%voxels%origin = cloud%voxels%origin + cloud%voxels%size*(low + 0.5_wp*(edge - 1) &
      & - merge(0.5_wp, 0.0_wp, astride))
   allocate (coarse%voxels%index(3, k))
   coarse%voxels%index(:, shares%block) = shares%place - 1
   call merge_points(cloud, coarse, shares)
   call merge_boundary(cloud, coarse, shares)
   call place_sources(coarse, ratio)

end subroutine coarse_cloud

!> Blocks of which each voxel is a part
pure subroutine share_voxels(self, index, edge, astride)
   !> Shares; blocks are not numbered yet
   type(shares_type), intent(out) :: self
   !> Voxels, from 0, shape (3, nc)
   integer, intent(in) :: index(:, :)
   !> Voxels along each edge of a block
   integer, intent(in) :: edge(3)
   !> Directions in which every other voxel lies in two blocks, which begin half a voxel outside
   logical, intent(in) :: astride(3)
   integer :: ip, k, d, n, place(3)
   real(wp) :: part

   n = size(index, 2)*2**count(astride)
   allocate (self%point(n), self%place(3, n), self%part(n), self%block(n))
   allocate (self%first(size(index, 2) + 1), source=0)
   n = 0
   do ip = 1, size(index, 2)
      corner: do k = 0, 7
         part = 1.0_wp
         do d = 1, 3
            place(d) = 1 + index(d, ip)/edge(d)
            if (astride(d) .and. mod(index(d, ip), 2) == 1) then
               part = 0.5_wp*part
               if (btest(k, d - 1)) place(d) = place(d) + 1
            else if (btest(k, d - 1)) then
               cycle corner
            end if
         end do
         n = n + 1
         self%point(n) = ip
         self%place(:, n) = place
         self%part(n) = part
      end do corner
      self%first(ip + 1) = n
   end do
   self%point = self%point(:n)
   self%place = self%place(:, :n)
   self%part = self%part(:n)
   self%block = self%block(:n)
end subroutine share_voxels

!> Move what is in a block too empty to the fullest around it, in equal parts where there are
!> several
pure subroutine leave_empty(self, volume, least)
   type(shares_type), intent(inout) :: self
   !> Volume of the body in each block, with a layer of blocks around, from 0 [length^3]
   real(wp), intent(in) :: volume(0:, 0:, 0:)
   !> Volume that a block needs [length^3]
   real(wp), intent(in) :: least
   type(shares_type) :: moved
   logical :: fullest(3, 3)
   integer :: ip, e, i, j, n, round

   allocate (moved%first, source=self%first)
   do round = 1, 2
      n = 0
      do ip = 1, size(self%first) - 1
         do e = self%first(ip) + 1, self%first(ip + 1)
            associate (at => self%place(:, e))
               fullest = .false.
               fullest(2, 2) = volume(at(1), at(2), at(3)) > (1.0_wp + same)*least
               if (.not. fullest(2, 2)) then
                  associate (around => volume(at(1) - 1:at(1) + 1, at(2) - 1:at(2) + 1, at(3)))
                     fullest = around >= (1.0_wp - same)*maxval(around)
                  end associate
               end if
               do j = 1, 3
                  do i = 1, 3
                     if (.not. fullest(i, j)) cycle
                     n = n + 1
                     if (round == 1) cycle
                     moved%point(n) = ip
                     moved%place(:, n) = at + [i - 2, j - 2, 0]
                     moved%part(n) = self%part(e)/count(fullest)
                  end do
               end do
            end associate
         end do
         if (round == 2) moved%first(ip + 1) = n
      end do
      if (round == 1) allocate (moved%point(n), moved%block(n), moved%place(3, n), moved%part(n))
   end do
   self = moved
end subroutine leave_empty

!> Volumes, tissues and fibers of the blocks
subroutine merge_points(cloud, coarse, shares)
   type(cloud_type), intent(in) :: cloud
   !> Coarser cloud with its voxels
   type(cloud_type), intent(inout) :: coarse
   type(shares_type), intent(in) :: shares
   real(wp), allocatable :: fibered(:)
   logical, allocatable :: present(:, :)
   integer :: e, k, f

   k = size(coarse%voxels%index, 2)
   if (allocated(cloud%fraction_label)) then
      coarse%fraction_label = cloud%fraction_label
   else
      coarse%fraction_label = cloud%labels()
   end if
   allocate (coarse%volume(k), source=0.0_wp)
   allocate (coarse%fraction(size(coarse%fraction_label), k), source=0.0_wp)
   allocate (coarse%fiber(3, k), source=0.0_wp)
   allocate (coarse%points(3, k))
   allocate (present(size(coarse%fraction_label), k), source=.false.)
   do e = 1, size(shares%point)
      associate (ip => shares%point(e), b => shares%block(e), &
         & v => shares%part(e)*cloud%volume(shares%point(e)))
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
      do e = 1, size(shares%point)
         associate (ip => shares%point(e), b => shares%block(e), &
            & v => shares%part(e)*merge(cloud%volume(shares%point(e)), 0.0_wp, &
            & any(abs(cloud%fiber(:, shares%point(e))) > 0.0_wp)))
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
subroutine merge_boundary(cloud, coarse, shares)
   type(cloud_type), intent(in) :: cloud
   !> Coarser cloud with its points
   type(cloud_type), intent(inout) :: coarse
   type(shares_type), intent(in) :: shares
   integer :: entry(size(coarse%points, 2), size(cloud%set_names)), e, k, n, b, s

   entry = 0
   n = 0
   do e = 1, size(cloud%boundary_point)
      associate (ip => cloud%boundary_point(e))
         do k = shares%first(ip) + 1, shares%first(ip + 1)
            associate (mine => entry(shares%block(k), cloud%boundary_set(e)))
               if (mine > 0) cycle
               n = n + 1
               mine = n
            end associate
         end do
      end associate
   end do
   allocate (coarse%boundary_point(n), coarse%boundary_set(n))
   allocate (coarse%normal(3, n), coarse%area(n), source=0.0_wp)
   do e = 1, size(cloud%boundary_point)
      s = cloud%boundary_set(e)
      do k = shares%first(cloud%boundary_point(e)) + 1, shares%first(cloud%boundary_point(e) + 1)
         b = shares%block(k)
         associate (mine => entry(b, s), area => shares%part(k)*cloud%area(e))
            coarse%boundary_point(mine) = b
            coarse%boundary_set(mine) = s
            coarse%area(mine) = coarse%area(mine) + area
            ! a sheet has two sides, of which the first one counts
            if (dot_product(coarse%normal(:, mine), cloud%normal(:, e)) >= 0.0_wp) &
               & coarse%normal(:, mine) = coarse%normal(:, mine) + area*cloud%normal(:, e)
         end associate
      end do
   end do
   do e = 1, n
      coarse%normal(:, e) = coarse%normal(:, e)/norm2(coarse%normal(:, e))
   end do
end subroutine merge_boundary

!> A source point in the middle of as many blocks in each direction as voxels had one
subroutine place_sources(coarse, ratio)
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

end module rk_coarse_cloud
