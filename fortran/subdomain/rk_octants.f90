!> Cells of a body of voxels about the corners of its blocks, and patches about every second corner.
!>
!> Each voxel is eight octants, and each octant belongs to the corner that is nearest to it: cells
!> and patches are unions of octants with plane facets along the axes. What two of them share in
!> one plane is one facet, however many voxels it crosses, with four points that have its area,
!> centre and second moments. Where the body is a box of whole blocks these are the cells, patches
!> and points of its lattice.
!>
!> Of merged voxels the facets inside have the mean area of what is filled on both sides. A surface
!> through a voxel carries no stress where nothing pulls at it: it may be left out of the balance.
module rk_octants
   use rk_cells, only : cells_type
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_facets, only : add_flat, close_cells, facets_type
   use rk_precision, only : wp
   use rk_text, only : to_text
   use rk_voxel_lattice, only : corner_lattice, corner_of_octants
   use rk_voxels, only : face_entries, side_of
   implicit none
   private

   public :: octant_cells, octant_patches

   !> Share of a whole patch that a patch has at least: that of a corner of a box [-]
   real(wp), parameter :: least_share = 0.124_wp

   !> Faces of octants in one plane between the same two cells
   type :: face_type
      !> Cells below and above the plane, 0 for none, and voxel of the surface, 0 if all are alike
      integer :: below = 0, above = 0, voxel = 0
      !> Next one of the same cell
      integer :: next = 0
      !> Area, and sums of places and of their products [length^2], [length^3], [length^4]
      real(wp) :: area = 0.0_wp, first(3) = 0.0_wp, second(3, 3) = 0.0_wp
   end type face_type

contains

!> Cells of the source points of a model, which are corners of its blocks
subroutine octant_cells(cells, cloud, error)
   !> Cells
   type(cells_type), intent(out) :: cells
   !> Cloud of a model
   type(cloud_type), intent(in) :: cloud
   !> Error handling: a voxel without volume
   type(error_type), allocatable, intent(out) :: error
   type(facets_type) :: facets
   real(wp) :: low(3), step(3)
   real(wp), allocatable :: whole(:)
   integer, allocatable :: corner(:, :), number(:, :, :), owner(:, :, :), voxel(:, :, :)
   integer :: blocks(3), at(3), i

   if (.not. all(cloud%volume > 0.0_wp)) then
      i = findloc(cloud%volume > 0.0_wp, .false., dim=1)
      call fatal_error(error, err_input, 'collocation point '//to_text(i)//' at ' &
         & //to_text(cloud%points(:, i))//' has no volume, run `myork build` again')
      return
   end if
   call corner_lattice(cloud, [integer ::], spread(.false., 1, 3), low, step, blocks)
   allocate (number(0:blocks(1), 0:blocks(2), 0:blocks(3)), source=0)
   do i = 1, size(cloud%source, 2)
      at = nint((cloud%source(:, i) - low)/step)
      number(at(1), at(2), at(3)) = i
   end do
   call corner_of_octants(cloud, step, corner)
   call find_voxels(cloud, voxel)
   call own(voxel, corner, number, owner)
   call collect(facets, cloud, voxel, owner, size(cloud%source, 2), .true.)
   call close_cells(cells, size(cloud%source, 2), facets, [(i, i=1, size(cloud%source, 2))], whole)
end subroutine octant_cells

!> Patches about corners of a lattice with the given number of blocks
subroutine octant_patches(facets, cloud, blocks, point)
   !> Their facets
   type(facets_type), intent(inout) :: facets
   !> Cloud of a model
   type(cloud_type), intent(in) :: cloud
   !> Blocks along each direction, shape (3)
   integer, intent(in) :: blocks(:)
   !> Corners that have patches, shape (3, patches) [length]
   real(wp), allocatable, intent(out) :: point(:, :)
   real(wp) :: low(3), step(3), apart, nearest
   integer, allocatable :: corner(:, :), number(:, :, :), owner(:, :, :), voxel(:, :, :)
   integer, allocatable :: members(:), place(:, :)
   integer :: n(3), at(3), i, j, k, m, near

   call corner_lattice(cloud, blocks, spread(.false., 1, 3), low, step, n)
   call corner_of_octants(cloud, step, corner)
   call find_voxels(cloud, voxel)
   allocate (number(0:n(1), 0:n(2), 0:n(3)), place(3, product(n + 1)))
   m = 0
   do i = 0, n(1)
      do j = 0, n(2)
         do k = 0, n(3)
            m = m + 1
            number(i, j, k) = m
            place(:, m) = [i, j, k]
         end do
      end do
   end do
   call own(voxel, corner, number, owner)
   allocate (members(0:m), source=0)
   do k = 1, size(owner, 3) - 2
      do j = 1, size(owner, 2) - 2
         do i = 1, size(owner, 1) - 2
            members(owner(i, j, k)) = members(owner(i, j, k)) + 1
         end do
      end do
   end do
   ! what is too small for a pressure of its own belongs to the nearest corner that is not
   members(0) = 0
   near = max(1, nint(least_share*8*product(step/cloud%voxels%size)))
   if (maxval(members) < near) near = maxval(members)
   point = reshape([(low + step*place(:, i), i=1, m)], [3, m])
   point = reshape(pack(point, spread(members(1:) >= near, 1, 3)), [3, count(members(1:) >= near)])
   do i = 1, m
      if (members(i) == 0) cycle
      at = place(:, i)
      nearest = huge(1.0_wp)
      do j = 1, size(point, 2)
         apart = sum(((low + step*at - point(:, j))/step)**2)
         if (apart >= nearest) cycle
         nearest = apart
         number(at(1), at(2), at(3)) = j
      end do
   end do
   call own(voxel, corner, number, owner)
   call collect(facets, cloud, voxel, owner, size(point, 2), .false.)
end subroutine octant_patches

!> Collocation point of each voxel of the grid, 0 outside the body
subroutine find_voxels(cloud, voxel)
   !> Cloud of a model
   type(cloud_type), intent(in) :: cloud
   !> Points, shape (0:nx+1, 0:ny+1, 0:nz+1)
   integer, allocatable, intent(out) :: voxel(:, :, :)
   integer :: low(3), n(3), at(3), ip

   low = minval(cloud%voxels%index, dim=2)
   n = maxval(cloud%voxels%index, dim=2) - low + 1
   allocate (voxel(0:n(1) + 1, 0:n(2) + 1, 0:n(3) + 1), source=0)
   do ip = 1, size(cloud%voxels%index, 2)
      at = cloud%voxels%index(:, ip) - low + 1
      voxel(at(1), at(2), at(3)) = ip
   end do
end subroutine find_voxels

!> Cell of each octant, 0 outside the body
subroutine own(voxel, corner, number, owner)
   !> Collocation points of voxels, shape (0:nx+1, 0:ny+1, 0:nz+1)
   integer, intent(in) :: voxel(0:, 0:, 0:)
   !> Corner nearest to the octants of each layer in each direction, from 0
   integer, intent(in) :: corner(:, :)
   !> Cell of each corner, from corner 0, 0, 0
   integer, intent(in) :: number(0:, 0:, 0:)
   !> Cells, shape (0:2nx+1, 0:2ny+1, 0:2nz+1)
   integer, allocatable, intent(out) :: owner(:, :, :)
   integer :: n(3), i, j, k

   n = 2*(shape(voxel) - 2)
   allocate (owner(0:n(1) + 1, 0:n(2) + 1, 0:n(3) + 1), source=0)
   do k = 1, n(3)
      do j = 1, n(2)
         do i = 1, n(1)
            if (voxel((i + 1)/2, (j + 1)/2, (k + 1)/2) == 0) cycle
            owner(i, j, k) = number(corner(1, i), corner(2, j), corner(3, k))
         end do
      end do
   end do
end subroutine own

!> Facets between cells and on the surface, plane by plane
subroutine collect(facets, cloud, voxel, owner, cells, of_cells)
   !> Facets
   type(facets_type), intent(inout) :: facets
   !> Cloud of a model
   type(cloud_type), intent(in) :: cloud
   !> Collocation points of voxels, shape (0:nx+1, 0:ny+1, 0:nz+1)
   integer, intent(in) :: voxel(0:, 0:, 0:)
   !> Cell of each octant, shape (0:2nx+1, 0:2ny+1, 0:2nz+1)
   integer, intent(in) :: owner(0:, 0:, 0:)
   !> Number of cells
   integer, intent(in) :: cells
   !> Areas by what is filled inside, and by voxels on the surface, where conditions act
   logical, intent(in) :: of_cells
   type(face_type), allocatable :: face(:)
   type(face_entries) :: entries
   integer :: head(0:cells), n(3), lower(3), upper(3), first(3), last(3), d, o, p, i, j, k, faces
   real(wp) :: half(3), low(3), x(3), share

   call entries%find(cloud)
   half = 0.5_wp*cloud%voxels%size
   low = cloud%voxels%origin + (minval(cloud%voxels%index, dim=2) - 0.5_wp)*cloud%voxels%size
   n = shape(owner) - 2
   allocate (face(64))
   head = 0
   do d = 1, 3
      o = modulo(d, 3) + 1
      p = modulo(d + 1, 3) + 1
      do i = 0, n(d)
         faces = 0
         lower(d) = i
         upper(d) = i + 1
         do k = 1, n(p)
            lower(p) = k
            upper(p) = k
            do j = 1, n(o)
               lower(o) = j
               upper(o) = j
               associate (a => owner(lower(1), lower(2), lower(3)), &
                  & b => owner(upper(1), upper(2), upper(3)))
                  if (a == b) cycle
                  first = (lower + 1)/2
                  last = (upper + 1)/2
                  x = low + half*(lower - 0.5_wp)
                  x(d) = low(d) + half(d)*i
                  share = 1.0_wp
                  if (of_cells .and. a > 0 .and. b > 0) share = 0.5_wp &
                     & *(filled(voxel(first(1), first(2), first(3))) &
                     & + filled(voxel(last(1), last(2), last(3))))
                  call note(a, b, max(voxel(first(1), first(2), first(3)), &
                     & voxel(last(1), last(2), last(3))))
               end associate
            end do
         end do
         do j = 1, faces
            call put(face(j))
            head([face(j)%below, face(j)%above]) = 0
         end do
      end do
   end do

contains

   !> Part of a voxel that is body; full ones are full to the last bit
   real(wp) function filled(ip)
      integer, intent(in) :: ip

      filled = cloud%volume(ip)/product(cloud%voxels%size)
      if (abs(filled - 1.0_wp) < 1.0e-6_wp) filled = 1.0_wp
   end function filled

   !> Add the face of an octant to those of its cells
   subroutine note(a, b, ip)
      integer, intent(in) :: a, b, ip
      integer :: at, key, q
      real(wp) :: area

      key = 0
      if (of_cells .and. min(a, b) == 0) key = ip
      at = head(max(a, b))
      do while (at > 0)
         if (face(at)%below == a .and. face(at)%above == b .and. face(at)%voxel == key) exit
         at = face(at)%next
      end do
      if (at == 0) then
         if (faces == size(face)) face = [face, face]
         faces = faces + 1
         at = faces
         face(at) = face_type(a, b, key, head(max(a, b)))
         head(max(a, b)) = at
      end if
      area = share*half(o)*half(p)
      face(at)%area = face(at)%area + area
      face(at)%first = face(at)%first + area*x
      do q = 1, 3
         face(at)%second(:, q) = face(at)%second(:, q) + area*x*x(q)
      end do
      face(at)%second(o, o) = face(at)%second(o, o) + area*half(o)**2/12.0_wp
      face(at)%second(p, p) = face(at)%second(p, p) + area*half(p)**2/12.0_wp
   end subroutine note

   !> Points of a facet
   subroutine put(of)
      type(face_type), intent(in) :: of
      real(wp) :: area(3), centre(3), moment(3, 3), part
      integer :: cell, e, q

      area = 0.0_wp
      area(d) = of%area
      cell = of%below
      if (cell == 0) then
         area = -area
         cell = of%above
      end if
      centre = of%first/of%area
      if (of%voxel > 0) then
         e = entries%nearest(cloud, of%voxel, area)
         part = 1.0_wp
         if (d == 3 .and. (i == 0 .or. i == n(3))) part = filled(of%voxel)
         call facets%add(centre, area, cell, 0, side_of(cloud, e), part, e)
         return
      end if
      do q = 1, 3
         moment(:, q) = of%second(:, q)/of%area - centre*centre(q)
      end do
      x = 0.0_wp
      x(o) = 1.0_wp
      call add_flat(facets, area, centre, moment, x, cell, merge(of%above, 0, of%below > 0), 0)
   end subroutine put

end subroutine collect

end module rk_octants
