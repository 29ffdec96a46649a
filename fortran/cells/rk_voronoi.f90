!> Voronoi cells of scattered points, clipped by the box around them.
!>
!> A cell is a convex polytope: the box, cut by the planes half way to the points around. Each facet
!> is taken from the cell of the lower number and shared, so that both cells see the same one.
!>
!> Distances are in spacings of each direction, as for the functions: by lengths, moves along a flat
!> body make cells that reach from one wall to the other.
!>
!> Reference: Aurenhammer, ACM Comput. Surv. 23 (1991), doi:10.1145/116873.116880
module rk_voronoi
   use rk_cloud, only : cloud_type
   use rk_csr, only : csr_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_facets, only : add_flat, facets_type
   use rk_kernel, only : window_radial
   use rk_lattice, only : set_number
   use rk_neighbours, only : find_neighbours
   use rk_precision, only : i8, wp
   use rk_tensor, only : vector_product
   use rk_text, only : to_text
   implicit none
   private

   public :: voronoi_facets

   !> Corners of a facet, in order around it, and facets of a cell: room for any cloud that is not
   !> degenerate
   integer, parameter :: max_corners = 64, max_facets = 128

   !> A convex cell. In the plane its facets have two corners.
   type :: cell_type
      integer :: facets = 0
      !> Corners of each facet
      integer :: corners(max_facets) = 0
      real(wp) :: x(3, max_corners, max_facets) = 0.0_wp
      !> Source point behind each facet, or minus the boundary set
      integer :: behind(max_facets) = 0
   end type cell_type

   !> Distances below this share of the spacing are rounding
   real(wp), parameter :: rounding = 1.0e-10_wp
   !> Points within this many spacings may share a facet
   real(wp), parameter :: reach = 3.5_wp

contains

!> Facets of all cells
subroutine voronoi_facets(facets, cloud, error)
   type(facets_type), intent(inout) :: facets
   !> Cloud in a box whose corners are source points
   type(cloud_type), intent(in) :: cloud
   !> Error handling: a point whose cell is not closed by the points around
   type(error_type), allocatable, intent(out) :: error
   type(csr_type) :: near
   type(cell_type), allocatable :: cell
   real(wp) :: low(3), high(3), x(3), stretch(3), spacing, radius
   real(wp), allocatable :: source(:, :), apart(:)
   integer, allocatable :: order(:)
   logical, allocatable :: left(:)
   integer :: is, j, k, nd, d

   nd = cloud%nd
   low = 0.0_wp
   high = 0.0_wp
   spacing = maxval(cloud%spacing)
   stretch = 1.0_wp
   source = cloud%source
   do d = 1, nd
      stretch(d) = spacing/maxval(cloud%spacing(d, :))
      source(d, :) = stretch(d)*source(d, :)
      low(d) = minval(source(d, :))
      high(d) = maxval(source(d, :))
   end do
   call find_neighbours(near, source, reach*spread(spread(spacing, 1, nd), 2, &
      & size(source, 2)), source, window_radial, error)
   if (allocated(error)) return
   allocate (cell)
   do is = 1, size(source, 2)
      call start_cell(cell, nd, low, high)
      order = near%index(near%offset(is) + 1:near%offset(is + 1))
      apart = [(norm2(source(:, order(k)) - source(:, is)), k=1, size(order))]
      x = 0.0_wp
      x(:nd) = source(:, is)
      left = order /= is
      do
         if (.not. any(left)) exit
         k = minloc(apart, dim=1, mask=left)
         left(k) = .false.
         ! a plane beyond all corners cuts nothing, nor do those farther away
         if (apart(k) > 2.0_wp*farthest(cell, x)) exit
         call cut(cell, nd, x, source(:, order(k)), order(k), rounding*spacing)
      end do
      radius = farthest(cell, x)
      if (.not. 2.0_wp*radius < reach*spacing) then
         call fatal_error(error, err_input, 'source point '//to_text(is)//' at ' &
            & //to_text(cloud%source(:, is))//' has too few neighbours to close its cell, whose ' &
            & //'corners are '//to_text(radius/spacing, 3)//' spacings away: fill the gap there')
         return
      end if
      ! the source point itself may lie on a facet of the box
      x = centre_of(cell)/stretch
      do j = 1, cell%facets
         if (cell%behind(j) > 0 .and. cell%behind(j) < is) cycle
         associate (corner => cell%x(:, :cell%corners(j), j))
            corner = corner/spread(stretch, 2, size(corner, 2))
         end associate
         call add_facet(facets, nd, cell%x(:, :cell%corners(j), j), x, is, cell%behind(j))
      end do
   end do
end subroutine voronoi_facets

!> The box
subroutine start_cell(cell, nd, low, high)
   type(cell_type), intent(out) :: cell
   integer, intent(in) :: nd
   !> Corners of the box [length]
   real(wp), intent(in) :: low(3), high(3)
   integer, parameter :: around(2, 4) = reshape([0, 0, 1, 0, 1, 1, 0, 1], [2, 4])
   integer :: d, side, o, p, k

   do d = 1, nd
      o = modulo(d, nd) + 1
      p = modulo(d + 1, 3) + 1
      do side = 0, 1
         cell%facets = cell%facets + 1
         cell%corners(cell%facets) = merge(2, 4, nd == 2)
         cell%behind(cell%facets) = -set_number(.false., d, side)
         do k = 1, cell%corners(cell%facets)
            associate (x => cell%x(:, k, cell%facets))
               x = low
               x(d) = merge(high(d), low(d), side == 1)
               if (around(1, k) == 1) x(o) = high(o)
               if (nd == 3 .and. around(2, k) == 1) x(p) = high(p)
            end associate
         end do
      end do
   end do
end subroutine start_cell

!> Distance of the farthest corner
pure real(wp) function farthest(cell, x)
   type(cell_type), intent(in) :: cell
   !> Source point [length]
   real(wp), intent(in) :: x(3)
   integer :: j, k

   farthest = 0.0_wp
   do j = 1, cell%facets
      do k = 1, cell%corners(j)
         farthest = max(farthest, norm2(cell%x(:, k, j) - x))
      end do
   end do
end function farthest

!> A point inside
pure function centre_of(cell) result(x)
   type(cell_type), intent(in) :: cell
   real(wp) :: x(3)
   integer :: j

   x = 0.0_wp
   do j = 1, cell%facets
      x = x + sum(cell%x(:, :cell%corners(j), j), dim=2)/(cell%corners(j)*cell%facets)
   end do
end function centre_of

!> Take away what is nearer to another point
subroutine cut(cell, nd, x, other, number, tolerance)
   type(cell_type), intent(inout) :: cell
   integer, intent(in) :: nd
   real(wp), intent(in) :: x(3)
   !> The other one, shape (nd) [length]
   real(wp), intent(in) :: other(:)
   integer, intent(in) :: number
   !> Corners nearer to the plane than this lie on it [length]
   real(wp), intent(in) :: tolerance
   real(wp) :: normal(3), half(3), corner(3, max_corners), height(max_corners), cap(3, max_corners)
   integer :: j, k, next, n, caps, kept

   normal = 0.0_wp
   normal(:nd) = other - x(:nd)
   normal = normal/norm2(normal)
   half = x
   half(:nd) = 0.5_wp*(x(:nd) + other)
   caps = 0
   kept = 0
   do j = 1, cell%facets
      n = cell%corners(j)
      do k = 1, n
         height(k) = dot_product(normal, cell%x(:, k, j) - half)
         if (abs(height(k)) < tolerance) height(k) = 0.0_wp
      end do
      next = 0
      do k = 1, n
         associate (here => height(k), there => height(modulo(k, n) + 1), &
            & a => cell%x(:, k, j), b => cell%x(:, modulo(k, n) + 1, j))
            if (here <= 0.0_wp) then
               next = next + 1
               corner(:, next) = a
               if (here >= 0.0_wp) call add_cap(a)
            end if
            ! two corners in the plane make one edge, not two
            if (n == 2 .and. k == 2) cycle
            if (here*there < 0.0_wp) then
               next = next + 1
               corner(:, next) = a + here/(here - there)*(b - a)
               call add_cap(corner(:, next))
            end if
         end associate
      end do
      if (next < nd) cycle
      kept = kept + 1
      cell%corners(kept) = next
      cell%x(:, :next, kept) = corner(:, :next)
      cell%behind(kept) = cell%behind(j)
   end do
   cell%facets = kept
   if (caps < nd) return
   if (nd == 3) call around(normal, cap(:, :caps))
   cell%facets = kept + 1
   cell%corners(kept + 1) = caps
   cell%x(:, :caps, kept + 1) = cap(:, :caps)
   cell%behind(kept + 1) = number

contains

   !> Note a corner of the new facet, once
   subroutine add_cap(point)
      real(wp), intent(in) :: point(3)
      integer :: i

      do i = 1, caps
         if (norm2(cap(:, i) - point) < tolerance) return
      end do
      caps = caps + 1
      cap(:, caps) = point
   end subroutine add_cap

end subroutine cut

!> Put the corners of a convex facet in order
pure subroutine around(normal, corner)
   !> Normal of the facet
   real(wp), intent(in) :: normal(3)
   !> Corners, shape (3, n) [length]
   real(wp), intent(inout) :: corner(:, :)
   real(wp) :: angle(size(corner, 2)), middle(3), e(3), f(3), moved(3), turn
   integer :: i, j

   middle = sum(corner, dim=2)/size(corner, 2)
   e = corner(:, 1) - middle
   e = e/norm2(e)
   f = vector_product(normal, e)
   do i = 1, size(corner, 2)
      angle(i) = atan2(dot_product(f, corner(:, i) - middle), dot_product(e, corner(:, i) - middle))
   end do
   do i = 2, size(corner, 2)
      moved = corner(:, i)
      turn = angle(i)
      j = i - 1
      do while (j > 0)
         if (angle(j) <= turn) exit
         corner(:, j + 1) = corner(:, j)
         angle(j + 1) = angle(j)
         j = j - 1
      end do
      corner(:, j + 1) = moved
      angle(j + 1) = turn
   end do
end subroutine around

!> Quadrature points of a facet: Gauss points of an edge; of a polygon four that have its area,
!> centre and second moments, which are the Gauss points of a rectangle
subroutine add_facet(facets, nd, corner, inside, is, behind)
   type(facets_type), intent(inout) :: facets
   integer, intent(in) :: nd
   real(wp), intent(in) :: corner(:, :)
   !> A point on the inner side [length]
   real(wp), intent(in) :: inside(3)
   !> Cell
   integer, intent(in) :: is
   !> Cell behind, or minus the boundary set
   integer, intent(in) :: behind
   real(wp) :: a(3), b(3), area(3), middle(3), centre(3), moment(3, 3), part
   integer :: i, k, n

   n = size(corner, 2)
   middle = sum(corner, dim=2)/n
   if (nd == 2) then
      a = corner(:, 1)
      b = corner(:, 2)
      area = 0.5_wp*[b(2) - a(2), a(1) - b(1), 0.0_wp]
      if (dot_product(area, middle - inside) < 0.0_wp) area = -area
      do k = -1, 1, 2
         call facets%add(middle(:2) + 0.5_wp*k/sqrt(3.0_wp)*(b(:2) - a(:2)), area(:2), is, &
            & max(behind, 0), max(-behind, 0))
      end do
      return
   end if
   area = 0.0_wp
   centre = 0.0_wp
   moment = 0.0_wp
   do k = 1, n
      a = corner(:, k) - middle
      b = corner(:, modulo(k, n) + 1) - middle
      part = 0.5_wp*norm2(vector_product(a, b))
      area = area + 0.5_wp*vector_product(a, b)
      centre = centre + part*(a + b)/3.0_wp
      do i = 1, 3
         moment(:, i) = moment(:, i) + part/12.0_wp*(a*a(i) + b*b(i) + (a + b)*(a(i) + b(i)))
      end do
   end do
   part = norm2(area)
   centre = centre/part
   if (dot_product(area, middle - inside) < 0.0_wp) area = -area
   do i = 1, 3
      moment(:, i) = moment(:, i)/part - centre*centre(i)
   end do
   call add_flat(facets, area, middle + centre, moment, corner(:, 1) - middle, is, &
      & max(behind, 0), max(-behind, 0))
end subroutine add_facet

end module rk_voronoi
