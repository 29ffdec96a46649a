!> Gauss points in the cells between the source points of a lattice.
!>
!> Cells come in groups of two in each direction, within which the volume change is projected. Where
!> their number is odd, one or three are left over. In space they are groups of their own in the
!> middle, without a pressure that varies along their width: in groups of three cells volume goes
!> from cell to cell almost for nothing (a rubber cube of 5^3 cells between plates, 30 % shorter: J
!> from 0.08 to 4.0). In the plane such groups do no harm, but of five cells there is one in the
!> middle.
!>
!> Faces that the border of a named set cuts have finer points, which lie on one side of it each.
module rk_gauss_cells
   use rk_cells, only : cells_type
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_gauss, only : gauss_rule
   use rk_lattice, only : digits_of, lattice_frame, place_of, set_number
   use rk_named_sets, only : sets_of
   use rk_neighbours, only : nearest_points
   use rk_precision, only : wp
   implicit none
   private

   public :: gauss_cells

   !> Cells between source points that make one group, in each direction
   integer, parameter :: group_size = 2
   !> Parts of a face in each direction where the border of a set cuts it, by space dimension
   integer, parameter :: parts(3) = [1, 64, 12]

contains

!> Gauss points in the cells between the source points of a lattice
subroutine gauss_cells(self, cloud, count, degree, error)
   !> Points
   type(cells_type), intent(out) :: self
   !> Cloud with a lattice
   type(cloud_type), intent(in) :: cloud
   !> Gauss points in each direction of a cell
   integer, intent(in) :: count
   !> Degree of the polynomials that lifted values reproduce
   integer, intent(in) :: degree
   !> Error handling: no lattice
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: rule(count), share(count), low(3), step(3), map(3, 3), jacobian
   real(wp) :: outer(3), fine_rule(count*parts(cloud%nd)), fine_share(count*parts(cloud%nd))
   integer :: cells(3), groups(3), pairs(3), ones(3), at(3), cell(3), from(3), to(3), g(3)
   integer :: points(3)
   integer, allocatable :: number(:)
   logical, allocatable :: cut(:, :)
   integer :: nd, np, ng, i, j, d, k, side, faces, ms, mf, nl, own

   if (.not. allocated(cloud%lattice)) then
      call fatal_error(error, err_input, 'Gauss cells need the lattice of a box or an annulus, ' &
         & //'or a model of voxels: '//trim(merge( &
         & 'use method "rkpm-scni"                        ', &
         & 'build it from a label map, or use "rkcm-mixed"', allocated(cloud%voxels%index))))
      return
   end if
   nd = cloud%nd
   call gauss_rule(rule, share)
   call lattice_frame(cloud, low, step)
   cells = 1
   cells(:nd) = cloud%lattice - 1
   call arrange(cells, nd == 3, pairs, ones, groups)
   ng = product(groups)
   own = count**nd
   points = 1
   points(:nd) = count
   np = product(cells)*own
   faces = 0
   mf = 0
   do d = 1, nd
      faces = faces + 2*product(cells)/cells(d)*count**(nd - 1)
      mf = mf + (product(cells) - product(cells)/cells(d))*count**(nd - 1)
   end do
   call compose(rule, share, parts(nd), fine_rule, fine_share)
   call find_cut(error)
   if (allocated(error)) return
   faces = faces + cuts()*(size(fine_rule)**(nd - 1) - count**(nd - 1))
   self%per_cell = own
   allocate (self%facet(nd, mf), self%area(nd, mf), self%side(2, mf), number(product(cells)))
   allocate (self%point(nd, np), self%weight(np), self%first(ng + 1))
   allocate (self%surface(nd, faces), self%outward(nd, faces), self%set(faces))
   allocate (self%part(faces), source=1.0_wp)
   allocate (self%lift_first(faces + 1), self%lift_point(faces*own), self%lift(faces*own))
   if (nd == 3 .and. any(ones > 0)) allocate (self%thin(nd, ng))
   self%first(1) = 0
   self%lift_first(1) = 0
   np = 0
   do i = 1, ng
      g = digits_of(i - 1, groups)
      from = group_start(g, cells, groups, pairs, ones)
      to = group_start(g + 1, cells, groups, pairs, ones) - 1
      if (allocated(self%thin)) self%thin(:, i) = to == from .and. cells > 1
      do j = 1, product(to - from + 1)
         np = np + 1
         number(place_of(from + digits_of(j - 1, to - from + 1), cells)) = np
      end do
   end do
   np = 0
   ms = 0
   mf = 0
   nl = 0
   do i = 1, ng
      g = digits_of(i - 1, groups)
      from = group_start(g, cells, groups, pairs, ones)
      to = group_start(g + 1, cells, groups, pairs, ones) - 1
      do j = 1, product(to - from + 1)
         cell = from + digits_of(j - 1, to - from + 1)
         do k = 1, own
            at = digits_of(k - 1, points)
            call place(cell, rule(at(:nd) + 1))
            self%point(:, np + k) = outer(:nd)
            self%weight(np + k) = jacobian*product(share(at(:nd) + 1))
         end do
         do d = 1, nd
            do side = 0, 1
               if (cell(d) == side*(cells(d) - 1)) then
                  if (cut(2*d - 1 + side, place_of(cell, cells))) then
                     call add_surface(cell, d, side, fine_rule, fine_share)
                  else
                     call add_surface(cell, d, side, rule, share)
                  end if
               else if (side == 1) then
                  call add_facet(cell, d)
               end if
            end do
         end do
         np = np + own
      end do
      self%first(i + 1) = np
   end do
   self%lift_point = self%lift_point(:nl)
   self%lift = self%lift(:nl)

contains

   !> Place and Jacobian of a point of a cell
   subroutine place(index, xi)
      integer, intent(in) :: index(3)
      real(wp), intent(in) :: xi(:)
      real(wp) :: q(3)
      integer :: e

      q = 0.0_wp
      q(:nd) = low(:nd) + step(:nd)*(index(:nd) + 0.5_wp*(1.0_wp + xi))
      map = 0.0_wp
      if (cloud%polar) then
         outer = [q(1)*cos(q(2)), q(1)*sin(q(2)), 0.0_wp]
         map(:2, 1) = 0.5_wp*step(1)*[cos(q(2)), sin(q(2))]
         map(:2, 2) = 0.5_wp*step(2)*q(1)*[-sin(q(2)), cos(q(2))]
         jacobian = 0.25_wp*step(1)*step(2)*q(1)
      else
         outer = q
         do e = 1, nd
            map(e, e) = 0.5_wp*step(e)
         end do
         jacobian = product(0.5_wp*step(:nd))
      end if
   end subroutine place

   !> A Gauss point of a face of a cell
   subroutine face_point(index, axis, end, k, nodes, shares, xi, area)
      integer, intent(in) :: index(3), axis, end, k
      real(wp), intent(in) :: nodes(:), shares(:)
      real(wp), intent(out) :: xi(:), area(:)
      real(wp) :: length
      integer :: e, n, sub(3)

      n = 0
      length = 1.0_wp
      sub = digits_of(k - 1, [size(nodes), merge(size(nodes), 1, nd == 3), 1])
      do e = 1, nd
         if (e == axis) then
            xi(e) = 2.0_wp*end - 1.0_wp
         else
            n = n + 1
            xi(e) = nodes(sub(n) + 1)
            length = length*shares(sub(n) + 1)
         end if
      end do
      call place(index, xi)
      ! columns of the map are orthogonal: the face's area is the product of the others' lengths
      area = xi(axis)*length*jacobian*map(:nd, axis)/sum(map(:, axis)**2)
      ! normals of an arc add up to its chord, so that the faces of a cell close around it
      if (cloud%polar .and. axis == 1) area = area*2.0_wp*sin(0.5_wp*step(2)) &
         & /sum(0.5_wp*step(2)*shares*cos(0.5_wp*step(2)*nodes))
   end subroutine face_point

   !> Gauss points of a face between two cells, at the upper end of the first
   subroutine add_facet(index, axis)
      integer, intent(in) :: index(3), axis
      real(wp) :: xi(nd)
      integer :: k, next(3)

      next = index
      next(axis) = index(axis) + 1
      do k = 1, count**(nd - 1)
         mf = mf + 1
         call face_point(index, axis, 1, k, rule, share, xi, self%area(:, mf))
         self%facet(:, mf) = outer(:nd)
         self%side(:, mf) = [number(place_of(index, cells)), number(place_of(next, cells))]
      end do
   end subroutine add_facet

   !> Points of a face on the surface
   subroutine add_surface(index, axis, end, nodes, shares)
      integer, intent(in) :: index(3), axis, end
      real(wp), intent(in) :: nodes(:), shares(:)
      real(wp) :: xi(nd), eta(nd)
      integer :: digit(3), k, q

      do k = 1, size(nodes)**(nd - 1)
         ms = ms + 1
         call face_point(index, axis, end, k, nodes, shares, xi, self%outward(:, ms))
         self%surface(:, ms) = outer(:nd)
         self%set(ms) = set_number(cloud%polar, axis, end)
         do q = 1, own
            digit = digits_of(q - 1, points)
            eta = rule(digit(:nd) + 1)
            nl = nl + 1
            self%lift_point(nl) = np + q
            self%lift(nl) = product(kernel(eta, xi)*share(digit(:nd) + 1))/self%weight(np + q)
         end do
         self%lift_first(ms + 1) = nl
      end do
   end subroutine add_surface

   !> Faces on the surface whose finer points do not all lie in the same sets
   subroutine find_cut(error)
      type(error_type), allocatable, intent(out) :: error
      real(wp), allocatable :: at(:, :), area(:, :)
      integer, allocatable :: face(:), side_of(:)
      logical, allocatable :: within(:, :)
      real(wp) :: xi(nd)
      integer :: c, e, end, index(3), k, n, each

      allocate (cut(2*nd, product(cells)), source=.false.)
      if (.not. allocated(cloud%region)) return
      each = size(fine_rule)**(nd - 1)
      n = faces/count**(nd - 1)*each
      allocate (at(nd, n), area(nd, n), face(n), side_of(n))
      n = 0
      do c = 1, product(cells)
         index = digits_of(c - 1, cells)
         do e = 1, nd
            do end = 0, 1
               if (index(e) /= end*(cells(e) - 1)) cycle
               do k = 1, each
                  n = n + 1
                  call face_point(index, e, end, k, fine_rule, fine_share, xi, area(:, n))
                  at(:, n) = outer(:nd)
                  side_of(n) = set_number(cloud%polar, e, end)
                  face(n) = 2*e - 1 + end + 2*nd*(c - 1)
               end do
            end do
         end do
      end do
      call sets_of(cloud, at, area, side_of, nearest_points(cloud%points, at), within, error)
      if (allocated(error)) return
      do k = 1, n, each
         associate (here => within(:, k:k + each - 1))
            cut(1 + mod(face(k) - 1, 2*nd), 1 + (face(k) - 1)/(2*nd)) &
               & = any(any(here, dim=2) .and. .not. all(here, dim=2))
         end associate
      end do
   end subroutine find_cut

   !> Faces that are cut
   integer function cuts()
      integer :: c, e

      cuts = 0
      do c = 1, size(cut, 2)
         do e = 1, size(cut, 1)
            if (cut(e, c)) cuts = cuts + 1
         end do
      end do
   end function cuts

   !> Reproducing kernel of Legendre polynomials up to the degree, in each direction
   elemental real(wp) function kernel(x, y)
      real(wp), intent(in) :: x, y

      kernel = 0.5_wp
      if (degree > 0) kernel = kernel + 1.5_wp*x*y
   end function kernel

end subroutine gauss_cells

!> A rule on equal parts of the line from -1 to 1
pure subroutine compose(rule, share, parts, fine_rule, fine_share)
   !> Points and weights, shape (n)
   real(wp), intent(in) :: rule(:), share(:)
   !> Parts
   integer, intent(in) :: parts
   !> Points and weights on them, shape (n*parts)
   real(wp), intent(out) :: fine_rule(:), fine_share(:)
   integer :: k, n

   n = size(rule)
   do k = 1, parts
      fine_rule(n*(k - 1) + 1:n*k) = (rule + 2*k - 1)/parts - 1.0_wp
      fine_share(n*(k - 1) + 1:n*k) = share/parts
   end do
end subroutine compose

!> Groups of cells in one direction, which lie symmetrically: a mirrored body is the same one
elemental subroutine arrange(cells, in_space, pairs, ones, groups)
   !> Cells in this direction
   integer, intent(in) :: cells
   !> Body in three dimensions
   logical, intent(in) :: in_space
   !> Groups of two before the single cells; 0 where there are none of these
   integer, intent(out) :: pairs
   !> Single cells
   integer, intent(out) :: ones
   !> All groups
   integer, intent(out) :: groups

   ones = 0
   groups = max(1, cells/group_size)
   if (mod(cells, 2) == 1 .and. (in_space .or. cells == 5)) then
      ones = merge(mod(cells, 4), 1, in_space)
      groups = ones + (cells - ones)/group_size
   else if (mod(cells, 2) == 1 .and. mod(groups, 2) == 0) then
      ! an odd cell is in the middle group of an odd number of groups
      groups = groups - 1
   end if
   pairs = (cells - ones)/4
end subroutine arrange

!> First cell of a group, from 0
elemental integer function group_start(group, cells, groups, pairs, ones)
   !> Group, from 0
   integer, intent(in) :: group
   !> Cells in this direction, and their groups
   integer, intent(in) :: cells
   integer, intent(in) :: groups
   !> Groups of two before the single cells, and those
   integer, intent(in) :: pairs
   integer, intent(in) :: ones

   if (ones == 0) then
      group_start = nint(real(group*cells, wp)/groups)
   else
      group_start = group_size*group - min(max(group - pairs, 0), ones)
   end if
end function group_start

end module rk_gauss_cells
