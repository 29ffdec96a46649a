!> Borders of named sets on a lattice: rules of integration on its faces whose points lie on either
!> side of them, and the extent of sets.
module rk_borders
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type
   use rk_gauss, only : gauss_rule
   use rk_lattice, only : digits_of, lattice_frame, place_at, set_number
   use rk_named_sets, only : sets_of
   use rk_precision, only : wp
   use rk_sort, only : sort
   implicit none
   private

   public :: face_rule, border_rule, tensor_rule, extent_of, adopt_nearest

   !> A rule of integration on a face, in coordinates from -1 to 1
   type :: face_rule
      !> Points along the directions of the face, in their order, shape (nd - 1, n)
      real(wp), allocatable :: xi(:, :)
      !> Weights, shape (n); their sum is 2^(nd-1)
      real(wp), allocatable :: share(:)
   end type face_rule

   !> Places in each direction of a face of a cell at which sets are compared: what is thinner may
   !> lie between them. By space dimension
   integer, parameter :: looks(3) = [1, 128, 24]
   !> The same for the extent of a set, on a whole side of the body
   integer, parameter :: looks_of_side(3) = [1, 1024, 96]
   !> Parts of a face in each direction, in which a border that does not follow its directions is
   !> taken to be smooth
   integer, parameter :: strips = 12, strips_of_side = 48
   !> Accuracy of a border; the outermost places lie as far inside, so that a border on the edge of
   !> a face does not cut it [-]
   real(wp), parameter :: close_to = 1.0e-6_wp

contains

!> Rule on a face of a lattice with parts that end where a border of sets cuts it: exact for
!> straight borders. On each line of points in the last direction the borders are found; in the
!> first direction of a face in space, parts end where the order of the sets on the lines changes
subroutine border_rule(rule, cut, cloud, axis, end, low, high, points, parts, error, side)
   type(face_rule), intent(out) :: rule
   !> Whether there is a border
   logical, intent(out) :: cut
   !> Cloud with a lattice and regions
   type(cloud_type), intent(in) :: cloud
   !> Direction across the face, and the side of the body on which it lies, low (0) or high (1)
   integer, intent(in) :: axis, end
   !> Its corners in the coordinates of the lattice, shape (nd)
   real(wp), intent(in) :: low(:), high(:)
   !> Gauss points of a part in each direction, and parts of a face besides those between borders
   integer, intent(in) :: points, parts
   !> Error handling: an expression that is not finite somewhere
   type(error_type), allocatable, intent(out) :: error
   !> The face is a whole side of the body
   logical, intent(in), optional :: side
   !> Sets along a line, without those that follow equal ones
   type :: sequence_type
      logical, allocatable :: of(:, :)
      !> Places from which they differ from the one before
      logical, allocatable :: starts(:)
   end type sequence_type
   type(sequence_type) :: sequence
   type(sequence_type), allocatable :: found(:)
   real(wp), allocatable :: at(:), across(:), along(:), inner(:), v(:), weight(:), u(:), share(:)
   integer :: i, k, lines, n, nd
   logical :: straight

   nd = size(low)
   n = looks(nd)
   lines = strips
   if (present(side)) n = looks_of_side(nd)
   if (present(side)) lines = strips_of_side
   at = (2.0_wp*[(k, k=0, n + 1)] - n - 1.0_wp)/n
   at([1, n + 2]) = [close_to - 1.0_wp, 1.0_wp - close_to]
   cut = .false.
   allocate (across(0))
   if (.not. allocated(cloud%region)) then
      rule = tensor_rule(parts, points, nd)
      return
   end if
   if (nd == 3) then
      allocate (found(size(at)))
      do k = 1, size(at)
         call look_along(at(k), found(k))
         if (allocated(error)) return
      end do
      straight = .true.
      do k = 2, size(at)
         if (same(found(k - 1), found(k))) then
            straight = straight .and. all(found(k - 1)%starts .eqv. found(k)%starts)
            cycle
         end if
         call add_change(at(k - 1), at(k), found(k - 1))
         if (allocated(error)) return
      end do
      cut = size(across) > 0 .or. size(found(1)%of, 2) > 1
   else
      call look_along(0.0_wp, sequence)
      if (allocated(error)) return
      cut = size(sequence%of, 2) > 1
   end if
   if (.not. cut) then
      rule = tensor_rule(parts, points, nd)
      return
   end if
   inner = even(parts)
   v = [0.0_wp]
   weight = [1.0_wp]
   if (nd == 3) then
      ! where a curved border ends, its length on the lines changes like a square root; as many
      ! parts in both directions make the rule independent of their order
      if (.not. straight) then
         inner = even(max(lines, parts))
         across = [across, ([across - 2.0_wp/lines/4**k, across + 2.0_wp/lines/4**k], k=1, 3)]
      end if
      call line_rule([inner, across], points, v, weight)
   end if
   allocate (rule%xi(nd - 1, 0), rule%share(0))
   do i = 1, size(v)
      call look_along(v(i), sequence, along)
      if (allocated(error)) return
      call line_rule([inner, along], points, u, share)
      rule%share = [rule%share, weight(i)*share]
      rule%xi = reshape([rule%xi, reshape([(pack([v(i), u(k)], [nd == 3, .true.]), &
         & k=1, size(u))], [nd - 1, size(u)])], [nd - 1, size(rule%share)])
   end do

contains

   !> Sets along a line in the last direction of the face, and their borders if they are asked for
   subroutine look_along(v, sequence, border)
      !> Place of the line in the first direction
      real(wp), intent(in) :: v
      type(sequence_type), intent(out) :: sequence
      real(wp), allocatable, intent(out), optional :: border(:)
      logical, allocatable :: within(:, :), here(:, :)
      logical :: keep(size(at))
      real(wp) :: a, b
      integer :: k

      call look(v, at, within)
      if (allocated(error)) return
      keep = [.true., (any(within(:, k) .neqv. within(:, k - 1)), k=2, size(at))]
      sequence%of = within(:, pack([(k, k=1, size(at))], keep))
      sequence%starts = keep
      if (.not. present(border)) return
      allocate (border(0))
      do k = 2, size(at)
         if (.not. keep(k)) cycle
         a = at(k - 1)
         b = at(k)
         do while (b - a > close_to)
            call look(v, [0.5_wp*(a + b)], here)
            if (allocated(error)) return
            if (all(here(:, 1) .eqv. within(:, k - 1))) then
               a = 0.5_wp*(a + b)
            else
               b = 0.5_wp*(a + b)
            end if
         end do
         border = [border, 0.5_wp*(a + b)]
      end do
   end subroutine look_along

   !> Add the place between two lines at which the sequence of the first one ends
   subroutine add_change(from, to, first)
      real(wp), intent(in) :: from, to
      type(sequence_type), intent(in) :: first
      type(sequence_type) :: here
      real(wp) :: a, b

      a = from
      b = to
      do while (b - a > close_to)
         call look_along(0.5_wp*(a + b), here)
         if (allocated(error)) return
         if (same(first, here)) then
            a = 0.5_wp*(a + b)
         else
            b = 0.5_wp*(a + b)
         end if
      end do
      across = [across, 0.5_wp*(a + b)]
   end subroutine add_change

   !> Sets at places of a line
   subroutine look(v, u, within)
      real(wp), intent(in) :: v, u(:)
      logical, allocatable, intent(out) :: within(:, :)
      real(wp) :: q(nd), place(nd, size(u)), outward(nd, size(u))
      integer :: d, k, other

      do k = 1, size(u)
         other = merge(1, 2, axis /= 1)
         do d = 1, nd
            if (d == axis) then
               q(d) = low(d)
            else if (nd == 3 .and. d == other) then
               q(d) = low(d) + 0.5_wp*(1.0_wp + v)*(high(d) - low(d))
            else
               q(d) = low(d) + 0.5_wp*(1.0_wp + u(k))*(high(d) - low(d))
            end if
         end do
         place(:, k) = place_at(cloud, q)
         outward(:, k) = normal_at(cloud, axis, end, place(:, k))
      end do
      call sets_of(cloud, place, outward, spread(set_number(cloud%polar, axis, end), 1, size(u)), &
         & within, error)
   end subroutine look

   pure logical function same(a, b)
      type(sequence_type), intent(in) :: a, b

      same = size(a%of) == size(b%of)
      if (same) same = all(a%of .eqv. b%of)
   end function same

end subroutine border_rule

!> Outward unit normal on a side of a lattice, shape (nd)
pure function normal_at(cloud, axis, end, place) result(normal)
   type(cloud_type), intent(in) :: cloud
   integer, intent(in) :: axis, end
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: place(:)
   real(wp) :: normal(size(place))

   normal = 0.0_wp
   normal(axis) = 1.0_wp
   if (cloud%polar) normal = place/norm2(place)
   if (cloud%polar .and. axis == 2) normal = [-normal(2), normal(1)]
   normal = (2*end - 1)*normal
end function normal_at

!> Rule on equal parts of a face
pure function tensor_rule(parts, points, nd) result(rule)
   !> Parts in each direction, Gauss points of each, space dimension
   integer, intent(in) :: parts, points, nd
   type(face_rule) :: rule
   real(wp), allocatable :: node(:), share(:)
   integer :: digit(nd - 1), k, n

   call line_rule(even(parts), points, node, share)
   n = size(node)**(nd - 1)
   allocate (rule%xi(nd - 1, n), rule%share(n))
   do k = 1, n
      digit = digits_of(k - 1, spread(size(node), 1, nd - 1))
      rule%xi(:, k) = node(digit + 1)
      rule%share(k) = product(share(digit + 1))
   end do
end function tensor_rule

!> Ends of equal parts of the line from -1 to 1
pure function even(parts) result(bound)
   integer, intent(in) :: parts
   real(wp) :: bound(parts + 1)
   integer :: k

   bound = [(2.0_wp*k/parts - 1.0_wp, k=0, parts)]
end function even

!> Gauss points on the parts of the line from -1 to 1
pure subroutine line_rule(bound, points, node, share)
   !> Ends of the parts, in any order; those outside of the line are moved to its ends
   real(wp), intent(in) :: bound(:)
   !> Number of points of a part
   integer, intent(in) :: points
   !> Places and weights
   real(wp), allocatable, intent(out) :: node(:), share(:)
   real(wp) :: x(points), w(points), ascending(size(bound))
   integer, allocatable :: place(:)
   integer :: k

   call gauss_rule(x, w)
   call sort(bound, place)
   ascending(place) = min(max(bound, -1.0_wp), 1.0_wp)
   allocate (node(0), share(0))
   do k = 2, size(bound)
      associate (a => ascending(k - 1), b => ascending(k))
         if (b - a < close_to) cycle
         node = [node, 0.5_wp*(a + b + (b - a)*x)]
         share = [share, 0.5_wp*(b - a)*w]
      end associate
   end do
end subroutine line_rule

!> Area of a set and its centre: on a lattice, whose boundary entries are too few to determine the
!> extent of a part, by its borders, otherwise from the entries
subroutine extent_of(cloud, set, area, middle, error)
   type(cloud_type), intent(in) :: cloud
   integer, intent(in) :: set
   !> Area [length^(nd-1)]
   real(wp), intent(out) :: area
   !> Centre, shape (nd) [length]
   real(wp), intent(out) :: middle(:)
   !> Error handling: an expression that is not finite somewhere
   type(error_type), allocatable, intent(out) :: error
   integer :: e, side

   area = 0.0_wp
   middle = 0.0_wp
   if (set > cloud%sides() .and. allocated(cloud%lattice)) then
      do side = 1, 2*cloud%nd
         call add_extent(cloud, set, (side + 1)/2, modulo(side + 1, 2), area, middle, error)
         if (allocated(error)) return
      end do
   end if
   ! also for a set that falls between the places looked at
   if (.not. area > 0.0_wp) then
      associate (part => merge(cloud%area, 0.0_wp, &
         & cloud%in_set([(e, e=1, size(cloud%area))], set)))
         area = sum(part)
         middle = matmul(cloud%points(:, cloud%boundary_point), part)
      end associate
   end if
   middle = middle/area
end subroutine extent_of

!> Give a set that lies between the points of a lattice the boundary entry nearest to its centre on
!> each side that it lies on
subroutine adopt_nearest(cloud, set, found, error)
   type(cloud_type), intent(inout) :: cloud
   !> Set without boundary entries
   integer, intent(in) :: set
   !> Whether it lies on any side
   logical, intent(out) :: found
   !> Error handling: an expression that is not finite somewhere
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: area, middle(cloud%nd)
   integer :: e, end, axis, side

   found = .false.
   do side = 1, 2*cloud%nd
      axis = (side + 1)/2
      end = modulo(side + 1, 2)
      area = 0.0_wp
      middle = 0.0_wp
      call add_extent(cloud, set, axis, end, area, middle, error)
      if (allocated(error)) return
      if (.not. area > 0.0_wp) cycle
      found = .true.
      e = minloc([(norm2(cloud%points(:, cloud%boundary_point(e)) - middle/area), &
         & e=1, size(cloud%area))], dim=1, &
         & mask=cloud%boundary_set == set_number(cloud%polar, axis, end))
      cloud%within(set, e) = .true.
   end do
end subroutine adopt_nearest

!> Add the area and the moment of what lies on a side of a lattice
subroutine add_extent(cloud, set, axis, end, area, moment, error)
   type(cloud_type), intent(in) :: cloud
   integer, intent(in) :: set
   !> Direction across the side, and whether it is the low (0) or high (1) one
   integer, intent(in) :: axis, end
   !> Area [length^(nd-1)], and the integral of position, shape (nd) [length^nd]
   real(wp), intent(inout) :: area, moment(:)
   !> Error handling: an expression that is not finite somewhere
   type(error_type), allocatable, intent(out) :: error
   type(face_rule) :: rule
   real(wp), allocatable :: place(:, :), outward(:, :)
   logical, allocatable :: within(:, :)
   real(wp) :: low(3), step(3), high(3), part
   integer :: d, k, other(cloud%nd - 1)
   logical :: cut

   call lattice_frame(cloud, low, step)
   high(:cloud%nd) = low(:cloud%nd) + step(:cloud%nd)*(cloud%lattice - 1)
   low(axis) = merge(high(axis), low(axis), end == 1)
   high(axis) = low(axis)
   call border_rule(rule, cut, cloud, axis, end, low(:cloud%nd), high(:cloud%nd), 4, 1, error, &
      & side=.true.)
   if (allocated(error)) return
   allocate (place(cloud%nd, size(rule%share)), outward(cloud%nd, size(rule%share)))
   other = pack([(d, d=1, cloud%nd)], [(d, d=1, cloud%nd)] /= axis)
   do k = 1, size(rule%share)
      associate (q => place(:, k))
         q = low(:cloud%nd)
         q(other) = q(other) + 0.5_wp*(1.0_wp + rule%xi(:, k))*(high(other) - low(other))
         q = place_at(cloud, q)
         outward(:, k) = normal_at(cloud, axis, end, q)
      end associate
   end do
   call sets_of(cloud, place, outward, spread(set_number(cloud%polar, axis, end), 1, &
      & size(rule%share)), within, error)
   if (allocated(error)) return
   do k = 1, size(rule%share)
      if (.not. within(set, k)) cycle
      part = rule%share(k)*product(0.5_wp*(high(other) - low(other)))
      if (cloud%polar .and. axis == 1) part = part*low(1)
      area = area + part
      moment = moment + part*place(:, k)
   end do
end subroutine add_extent

end module rk_borders
