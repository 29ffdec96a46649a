!> Search for the source points that cover given positions: cell lists, any cloud, one support per
!> source point and direction.
module rk_neighbours
   use rk_csr, only : csr_type, group_by, sort
   use rk_error, only : error_type, fatal_error, err_input
   use rk_kernel, only : window_product, window_radial
   use rk_precision, only : i8, wp
   implicit none
   private

   public :: find_neighbours, nearest_points, all_nearest, most_central_of

   !> Source points sorted into boxes of the size of the largest support
   type :: boxes_type
      integer :: n(3) = 1
      real(wp) :: low(3) = 0.0_wp
      real(wp) :: size(3) = 1.0_wp
      type(csr_type) :: member
   end type boxes_type

   !> Points on the rim of a support, where the window vanishes, are excluded despite rounding
   real(wp), parameter :: inside = 1.0_wp - 1.0e-12_wp
   !> Distances that differ by less than this part of the point spacing count as equal
   real(wp), parameter :: same = 1.0e-6_wp
   !> Maximum number of points nearest to one position: the corners of a cell of a lattice
   integer, parameter :: most_ties = 8

contains

!> Find the neighbours of all positions
subroutine find_neighbours(self, source, support, place, window, error)
   !> Source points that cover each position, ascending
   type(csr_type), intent(out) :: self
   !> Source points, shape (nd, ns) [length]
   real(wp), intent(in) :: source(:, :)
   !> Support of each source point, shape (nd, ns), > 0 [length]
   real(wp), intent(in) :: support(:, :)
   !> Positions, shape (nd, np) [length]
   real(wp), intent(in) :: place(:, :)
   !> One of the window_* constants
   integer, intent(in) :: window
   type(error_type), allocatable, intent(out) :: error
   type(boxes_type) :: cells
   integer, allocatable :: own(:)
   integer(i8) :: used
   integer :: ip, n

   if (.not. all(support > 0.0_wp .and. support < huge(1.0_wp))) then
      call fatal_error(error, err_input, 'support sizes must be positive, finite numbers')
      return
   end if
   if (.not. (all(abs(source) < huge(1.0_wp)) .and. all(abs(place) < huge(1.0_wp)))) then
      call fatal_error(error, err_input, 'point coordinates must be finite numbers')
      return
   end if
   call fill_cells(cells, source, support)

   allocate (self%offset(size(place, 2) + 1))
   self%offset(1) = 0
   ! threads keep their results until all are counted; the second loop has the same distribution
   !$omp parallel default(none) private(ip, n, used, own) &
   !$omp shared(self, cells, source, support, place, window)
   used = 0
   allocate (own(2*size(source, 2)))
   !$omp do schedule(static)
   do ip = 1, size(place, 2)
      if (size(own) - used < size(source, 2)) call lengthen(own, used)
      call search(cells, source, support, place(:, ip), window, n, own(used + 1:))
      call sort(own(used + 1:used + n))
      self%offset(ip + 1) = n
      used = used + n
   end do
   !$omp end do
   !$omp single
   do ip = 1, size(place, 2)
      self%offset(ip + 1) = self%offset(ip) + self%offset(ip + 1)
   end do
   allocate (self%index(self%offset(size(place, 2) + 1)))
   !$omp end single
   used = 0
   !$omp do schedule(static)
   do ip = 1, size(place, 2)
      n = int(self%offset(ip + 1) - self%offset(ip))
      self%index(self%offset(ip) + 1:self%offset(ip + 1)) = own(used + 1:used + n)
      used = used + n
   end do
   !$omp end do
   !$omp end parallel
end subroutine find_neighbours

!> Double the length of a list
pure subroutine lengthen(list, used)
   integer, allocatable, intent(inout) :: list(:)
   !> Number of entries that are kept
   integer(i8), intent(in) :: used
   integer, allocatable :: longer(:)

   allocate (longer(2*size(list, kind=i8)))
   longer(:used) = list(:used)
   call move_alloc(longer, list)
end subroutine lengthen

!> Index of the point nearest to each position, the most central of equals, shape (places)
function nearest_points(point, place) result(nearest)
   !> Points, at least one, shape (nd, np) [length]
   real(wp), intent(in) :: point(:, :)
   !> Positions, shape (nd, places) [length]
   real(wp), intent(in) :: place(:, :)
   integer :: nearest(size(place, 2))
   integer, allocatable :: near(:, :)

   call all_nearest(point, place, near)
   nearest = most_central_of(point, near)
end function nearest_points

!> The most central of the points given for each position, shape (places)
function most_central_of(point, near) result(chosen)
   !> Points, shape (nd, np) [length]
   real(wp), intent(in) :: point(:, :)
   !> Indices of some points for each position, at least one, padded with 0, shape (:, places)
   integer, intent(in) :: near(:, :)
   integer :: chosen(size(near, 2))
   real(wp) :: middle(size(point, 1)), slack
   integer :: ip

   middle = middle_of(point)
   slack = same*spacing_of(point)
   chosen = near(1, :)
   do ip = 1, size(chosen)
      if (near(2, ip) > 0) chosen(ip) = first_among(point, pack(near(:, ip), near(:, ip) > 0), &
         & middle, slack)
   end do
end function most_central_of

!> Of some points, choose the one nearest to the centre of all, and of these the lowest in x, in y,
!> in z: a choice between equals that depends neither on their order nor on the position of the
!> body, and seldom on its handedness
pure integer function first_among(point, among, middle, slack)
   real(wp), intent(in) :: point(:, :)
   integer, intent(in) :: among(:)
   !> Centre of all points, shape (nd), and distance below which they are equal [length]
   real(wp), intent(in) :: middle(:), slack
   real(wp) :: away(size(among))
   integer, allocatable :: left(:)
   integer :: d, k

   away = [(norm2(point(:, among(k)) - middle), k=1, size(among))]
   left = pack(among, away <= minval(away) + slack)
   do d = 1, size(point, 1)
      left = pack(left, point(d, left) <= minval(point(d, left)) + slack)
   end do
   first_among = left(1)
end function first_among

!> Centre of the bounding box of points, shape (nd) [length]
pure function middle_of(point) result(middle)
   real(wp), intent(in) :: point(:, :)
   real(wp) :: middle(size(point, 1))

   middle = 0.5_wp*(maxval(point, dim=2) + minval(point, dim=2))
end function middle_of

!> Spacing of the points if they formed a lattice [length]
pure real(wp) function spacing_of(point)
   real(wp), intent(in) :: point(:, :)

   spacing_of = max(maxval(maxval(point, dim=2) - minval(point, dim=2)) &
      & /real(size(point, 2), wp)**(1.0_wp/size(point, 1)), tiny(1.0_wp))
end function spacing_of

!> Indices of the points nearest to each position; several where these are equally near
subroutine all_nearest(point, place, near)
   !> Points, at least one, shape (nd, np) [length]
   real(wp), intent(in) :: point(:, :)
   !> Positions, shape (nd, places) [length]
   real(wp), intent(in) :: place(:, :)
   !> Indices, ascending, padded with 0, shape (most_ties, places)
   integer, allocatable, intent(out) :: near(:, :)
   type(csr_type) :: within
   type(error_type), allocatable :: error
   integer, allocatable :: left(:), found(:)
   logical, allocatable :: seen(:)
   real(wp) :: radius, slack
   integer :: i, n

   slack = same*spacing_of(point)
   ! share of each point in the bounding box, as an edge length
   radius = product(max(maxval(point, dim=2) - minval(point, dim=2), 4.0_wp*slack) &
      & /real(size(point, 2), wp)**(1.0_wp/size(point, 1)))**(1.0_wp/size(point, 1))
   allocate (near(most_ties, size(place, 2)), source=0)
   left = [(i, i=1, size(place, 2))]
   do while (size(left) > 0)
      call find_neighbours(within, point, spread(spread(radius, 1, size(point, 1)), 2, &
         & size(point, 2)), place(:, left), window_radial, error)
      if (allocated(error)) return
      allocate (seen(size(left)))
      do i = 1, size(left)
         associate (own => within%index(within%offset(i) + 1:within%offset(i + 1)))
            found = nearest_of(place(:, left(i)), own)
            seen(i) = size(found) > 0
            n = min(size(found), most_ties)
            near(:n, left(i)) = found(:n)
         end associate
      end do
      left = pack(left, .not. seen)
      deallocate (seen)
      radius = 2.0_wp*radius
   end do

contains

   !> Those of some points that are nearest to a position; none if a point beyond the radius may be
   !> equally near
   pure function nearest_of(x, among) result(nearest)
      !> Position, shape (nd) [length]
      real(wp), intent(in) :: x(:)
      integer, intent(in) :: among(:)
      integer, allocatable :: nearest(:)
      real(wp) :: away(size(among))
      integer :: k

      away = [(norm2(point(:, among(k)) - x), k=1, size(among))]
      nearest = pack(among, away <= minval(away) + slack .and. minval(away) + 2.0_wp*slack < radius)
   end function nearest_of

end subroutine all_nearest

!> Sort the source points into cells
subroutine fill_cells(cells, source, support)
   type(boxes_type), intent(out) :: cells
   real(wp), intent(in) :: source(:, :)
   !> Support, shape (nd, ns) [length]
   real(wp), intent(in) :: support(:, :)
   integer :: cell(size(source, 2)), d, is, nd, most

   nd = size(source, 1)
   ! a few wide cells suffice when supports are small or points far apart
   most = nint(real(8*size(source, 2), wp)**(1.0_wp/nd))
   do d = 1, nd
      cells%low(d) = minval(source(d, :))
      cells%size(d) = maxval(support(d, :))
      cells%n(d) = 1 + int(min((maxval(source(d, :)) - cells%low(d))/cells%size(d), real(most, wp)))
      cells%size(d) = max(cells%size(d), &
         & (maxval(source(d, :)) - cells%low(d))/cells%n(d)*(1.0_wp + 1.0e-12_wp))
   end do
   do is = 1, size(source, 2)
      cell(is) = cell_of(cells, cell_index(cells, source(:, is), 0))
   end do
   call group_by(product(cells%n), cell, cells%member)
end subroutine fill_cells

!> Cell coordinates of a position, or of a cell beside it, clipped to the grid
pure function cell_index(cells, x, way) result(c)
   type(boxes_type), intent(in) :: cells
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Number of cells to move along each axis
   integer, intent(in) :: way
   integer :: c(3)
   integer :: d

   c = 1
   do d = 1, size(x)
      c(d) = 1 + int(min(max((x(d) + way*cells%size(d) - cells%low(d))/cells%size(d), 0.0_wp), &
         & real(cells%n(d) - 1, wp)))
   end do
end function cell_index

!> Number of a cell from its coordinates
pure integer function cell_of(cells, c)
   type(boxes_type), intent(in) :: cells
   !> Coordinates
   integer, intent(in) :: c(3)

   cell_of = c(1) + cells%n(1)*(c(2) - 1 + cells%n(2)*(c(3) - 1))
end function cell_of

!> Find the source points that cover a position
pure subroutine search(cells, source, support, x, window, n, found)
   type(boxes_type), intent(in) :: cells
   real(wp), intent(in) :: source(:, :)
   real(wp), intent(in) :: support(:, :)
   real(wp), intent(in) :: x(:)
   integer, intent(in) :: window
   !> Number of neighbours
   integer, intent(out) :: n
   !> Neighbours, the first n entries
   integer, intent(inout) :: found(:)
   real(wp) :: square
   integer :: lo(3), hi(3), i, j, k, d, cell, nd
   integer(i8) :: m

   nd = size(x)
   lo = cell_index(cells, x, -1)
   hi = cell_index(cells, x, 1)
   n = 0
   do k = lo(3), hi(3)
      do j = lo(2), hi(2)
         do i = lo(1), hi(1)
            cell = cell_of(cells, [i, j, k])
            do m = cells%member%offset(cell) + 1, cells%member%offset(cell + 1)
               associate (is => cells%member%index(m))
                  if (window == window_product) then
                     ! most are rejected by the first coordinate
                     do d = 1, nd
                        if (.not. abs(x(d) - source(d, is)) < inside*support(d, is)) exit
                     end do
                     if (d <= nd) cycle
                  else
                     square = 0.0_wp
                     do d = 1, nd
                        square = square + ((x(d) - source(d, is))/support(d, is))**2
                     end do
                     if (.not. square < inside) cycle
                  end if
                  n = n + 1
                  found(n) = is
               end associate
            end do
         end do
      end do
   end do
end subroutine search

end module rk_neighbours
