!> Points on the facets of cells, where fluxes are looked at, and the rows of the balances that the
!> cells make of them.
!>
!> A flux is a number or vector at each point, outward of the first cell there. What one cell loses
!> the other gains: sums over all cells leave only the surface, to rounding.
module rk_flux_points
   use rk_csr, only : csr_type, sort
   use rk_precision, only : i8, wp
   use rk_shape, only : shape_type
   implicit none
   private

   public :: flux_points, flux_terms, close_points, ray_points

   !> Points of facets
   type :: flux_points
      !> Places, shape (nd, n) [length]
      real(wp), allocatable :: x(:, :)
      !> Area times normal, outward of the first cell, shape (nd, n) [length^(nd-1)]
      real(wp), allocatable :: area(:, :)
      !> Cells on both sides, the second 0 on the surface, shape (2, n)
      integer, allocatable :: side(:, :)
      !> Points of each cell
      type(csr_type) :: cell
      !> Shape functions of the source points there
      type(shape_type) :: shape
      !> Source points that the fluxes of each cell depend on, ascending
      type(csr_type) :: source
   contains
      !> Direction of the flux at a point as a cell sees it
      procedure :: sign => sign_of
      !> Functions that the points of each cell see
      procedure :: functions_of
      !> Sums of the fluxes of all cells
      procedure :: balance
      !> Derivatives of a cell's balance by the unknowns
      procedure :: rows
   end type flux_points

   !> Fluxes with their derivatives
   type :: flux_terms
      !> Flux, shape (m, n)
      real(wp), allocatable :: flux(:, :)
      !> Its derivative by the derivatives of each displacement, shape (m, field, derivative, n)
      real(wp), allocatable :: slope(:, :, :, :)
      !> By the displacement itself, shape (m, field, n); not allocated where there is none
      real(wp), allocatable :: plain(:, :, :)
      !> By the pressure, shape (m, n); not allocated where there is none
      real(wp), allocatable :: pressure(:, :)
   end type flux_terms

contains

!> Find the points of each cell, and the source points that these see
subroutine close_points(self, cells)
   !> Points with sides and shape functions
   type(flux_points), intent(inout) :: self
   !> Cells
   integer, intent(in) :: cells

   call gather(cells, self%side, self%cell)
   call self%functions_of(self%shape, self%source)
end subroutine close_points

!> Points of each cell, in their order
subroutine gather(cells, side, points)
   !> Cells
   integer, intent(in) :: cells
   !> Cells on both sides, shape (2, n)
   integer, intent(in) :: side(:, :)
   !> Points of each
   type(csr_type), intent(out) :: points
   integer(i8) :: at(cells)
   integer :: i, q, s

   allocate (points%offset(cells + 1), source=0_i8)
   do q = 1, size(side, 2)
      do s = 1, 2
         if (side(s, q) > 0) points%offset(side(s, q) + 1) = points%offset(side(s, q) + 1) + 1
      end do
   end do
   do i = 1, cells
      points%offset(i + 1) = points%offset(i + 1) + points%offset(i)
   end do
   allocate (points%index(points%offset(cells + 1)))
   at = points%offset(:cells)
   do q = 1, size(side, 2)
      do s = 1, 2
         if (side(s, q) == 0) cycle
         at(side(s, q)) = at(side(s, q)) + 1
         points%index(at(side(s, q))) = q
      end do
   end do
end subroutine gather

!> Functions that some point of each cell sees, ascending
subroutine functions_of(self, shape, found)
   !> Points
   class(flux_points), intent(in) :: self
   !> Functions at the points
   type(shape_type), intent(in) :: shape
   !> Functions of each cell
   type(csr_type), intent(out) :: found
   integer, allocatable :: mark(:)
   integer(i8) :: k, l, n
   integer :: i, is, pass, q

   allocate (found%offset(size(self%cell%offset)), mark(shape%ns))
   found%offset(1) = 0
   do pass = 1, 2
      mark = 0
      n = 0
      do i = 1, size(self%cell%offset) - 1
         do k = self%cell%offset(i) + 1, self%cell%offset(i + 1)
            q = self%cell%index(k)
            do l = shape%neighbour%offset(q) + 1, shape%neighbour%offset(q + 1)
               is = shape%neighbour%index(l)
               if (mark(is) == i) cycle
               mark(is) = i
               n = n + 1
               if (pass == 2) found%index(n) = is
            end do
         end do
         found%offset(i + 1) = n
         if (pass == 2) call sort(found%index(found%offset(i) + 1:n))
      end do
      if (pass == 1) allocate (found%index(n))
   end do
end subroutine functions_of

!> Direction of the flux at a point as a cell sees it: 1 outward, -1 inward
pure real(wp) function sign_of(self, q, cell)
   !> Points
   class(flux_points), intent(in) :: self
   !> Point
   integer, intent(in) :: q
   !> Cell, one of both sides
   integer, intent(in) :: cell

   sign_of = merge(1.0_wp, -1.0_wp, self%side(1, q) == cell)
end function sign_of

!> Sum of the outward fluxes of each cell
pure function balance(self, flux) result(total)
   !> Points
   class(flux_points), intent(in) :: self
   !> Fluxes, shape (m, n)
   real(wp), intent(in) :: flux(:, :)
   !> Sums, shape (m, cells)
   real(wp) :: total(size(flux, 1), size(self%cell%offset) - 1)
   integer(i8) :: k
   integer :: i

   total = 0.0_wp
   do i = 1, size(total, 2)
      do k = self%cell%offset(i) + 1, self%cell%offset(i + 1)
         associate (q => self%cell%index(k))
            total(:, i) = total(:, i) + self%sign(q, i)*flux(:, q)
         end associate
      end do
   end do
end function balance

!> Derivatives of a cell's balance by the displacements of its source points and by pressures
subroutine rows(self, cell, terms, pressure, by_pressure, mark, part, column)
   !> Points
   class(flux_points), target, intent(in) :: self
   !> Cell
   integer, intent(in) :: cell
   !> Fluxes linearised
   type(flux_terms), intent(in) :: terms
   !> Functions of the pressure at the points, and those that each cell sees; of no meaning where
   !> no flux depends on it
   type(shape_type), target, intent(in) :: pressure
   type(csr_type), intent(in) :: by_pressure
   !> Work: zero, shape (>= source points and pressures), zero again afterwards
   integer, intent(inout) :: mark(:)
   !> By the displacements, shape (m, fields, source points of the cell)
   real(wp), intent(out) :: part(:, :, :)
   !> By the pressures, shape (m, pressures of the cell)
   real(wp), intent(out) :: column(:, :)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   real(wp) :: slope(size(part, 1), size(part, 2))
   integer(i8) :: k
   integer :: d, j

   associate (mine => self%source%index(self%source%offset(cell) + 1:self%source%offset(cell + 1)))
      mark(mine) = [(j, j=1, size(mine))]
      part = 0.0_wp
      do k = self%cell%offset(cell) + 1, self%cell%offset(cell + 1)
         associate (q => self%cell%index(k), sign => self%sign(self%cell%index(k), cell))
            call self%shape%row(q, nodes, values)
            do j = 1, size(nodes)
               slope = sign*values(2, j)*terms%slope(:, :, 1, q)
               do d = 2, size(terms%slope, 3)
                  slope = slope + sign*values(1 + d, j)*terms%slope(:, :, d, q)
               end do
               if (allocated(terms%plain)) slope = slope + sign*values(1, j)*terms%plain(:, :, q)
               part(:, :, mark(nodes(j))) = part(:, :, mark(nodes(j))) + slope
            end do
         end associate
      end do
      mark(mine) = 0
   end associate
   if (.not. allocated(terms%pressure)) return
   associate (mine => by_pressure%index(by_pressure%offset(cell) + 1:by_pressure%offset(cell + 1)))
      mark(mine) = [(j, j=1, size(mine))]
      column = 0.0_wp
      do k = self%cell%offset(cell) + 1, self%cell%offset(cell + 1)
         associate (q => self%cell%index(k), sign => self%sign(self%cell%index(k), cell))
            call pressure%row(q, nodes, values)
            do j = 1, size(nodes)
               column(:, mark(nodes(j))) = column(:, mark(nodes(j))) &
                  & + sign*values(1, j)*terms%pressure(:, q)
            end do
         end associate
      end do
      mark(mine) = 0
   end associate
end subroutine rows

!> Points and weights inside cells, from those of their facets along the rays from a point of each
!> cell: exact for cubic functions where the facets' are. Where the cell is no star weights may be
!> negative, and are right all the same.
subroutine ray_points(self, centre, x, weight, cell)
   !> Points of facets
   type(flux_points), intent(in) :: self
   !> Point of each cell, shape (nd, cells) [length]
   real(wp), intent(in) :: centre(:, :)
   !> Places, shape (nd, m) [length]
   real(wp), allocatable, intent(out) :: x(:, :)
   !> Weights, shape (m) [length^nd]
   real(wp), allocatable, intent(out) :: weight(:)
   !> Cell of each, shape (m)
   integer, allocatable, intent(out) :: cell(:)
   real(wp) :: at(2), share(2), arm(size(centre, 1))
   integer(i8) :: k
   integer :: i, m, nd, r

   nd = size(centre, 1)
   ! Gauss rule of the weight s^(nd-1) on 0..1
   if (nd == 2) then
      at = 0.6_wp + sqrt(0.06_wp)*[-1, 1]
   else
      at = 2.0_wp/3.0_wp + sqrt(2.0_wp/45.0_wp)*[-1, 1]
   end if
   share(2) = (1.0_wp/(nd + 1) - at(1)/nd)/(at(2) - at(1))
   share(1) = 1.0_wp/nd - share(2)
   allocate (x(nd, 2*size(self%cell%index)), weight(2*size(self%cell%index)))
   allocate (cell(size(weight)))
   m = 0
   do i = 1, size(centre, 2)
      do k = self%cell%offset(i) + 1, self%cell%offset(i + 1)
         associate (q => self%cell%index(k))
            arm = self%x(:, q) - centre(:, i)
            do r = 1, 2
               m = m + 1
               x(:, m) = centre(:, i) + at(r)*arm
               weight(m) = share(r)*self%sign(q, i)*dot_product(arm, self%area(:, q))
               cell(m) = i
            end do
         end associate
      end do
   end do
end subroutine ray_points

end module rk_flux_points
