!> Pressure of nearly incompressible materials in weak forms: linear in each group of cells.
!>
!> The volume ratio J is projected on the polynomials of its group, and the bulk modulus acts only
!> on the projection: K/2 times the integral of (J_p - 1)^2. Four pressures for about eight cells of
!> Gauss points, or 27 nodal cells, leave enough freedom to deform without a change of volume. For
!> output the polynomials are blended into one continuous function.
!>
!> Reference: Simo, Taylor, Pister, Comput. Methods Appl. Mech. Eng. 51 (1985),
!>            doi:10.1016/0045-7825(85)90033-7
module rk_pressure
   use rk_cells, only : cells_type
   use rk_csr, only : csr_type
   use rk_error, only : error_type
   use rk_kernel, only : window_product, window_radial
   use rk_lapack, only : svd
   use rk_neighbours, only : find_neighbours
   use rk_place_shape, only : approximation_type, on_plane
   use rk_precision, only : i8, wp
   implicit none
   private

   public :: pressure_type, new_pressure

   !> Polynomials of the groups, orthonormal by volume over the bulk modulus, so that the energy is
   !> one modulus times a sum of squares even where soft and stiff tissues meet in a group
   type :: pressure_type
      !> Number of polynomials of each group, shape (groups)
      integer, allocatable :: count(:)
      !> Values at the points, zero beyond the count, shape (1 + nd, np) [length^(-nd/2)]
      real(wp), allocatable :: basis(:, :)
      !> Integrals of the polynomials, shape (1 + nd, groups) [length^(nd/2)]
      real(wp), allocatable :: total(:, :)
      !> Centre and size of each group, shape (nd, groups) [length]
      real(wp), allocatable :: centre(:, :)
      real(wp), allocatable :: reach(:, :)
      !> Polynomials in terms of the monomials 1, (x - centre)/reach, shape (1 + nd, 1 + nd, groups)
      real(wp), allocatable :: monomial(:, :, :)
      !> Factor from the pressure of the coefficients to the one that is written, shape (groups) [-]
      real(wp), allocatable :: whole(:)
      !> Groups near each collocation point
      type(csr_type) :: near
      !> Second moments of each group about its centre over its volume, shape (nd, nd, groups)
      !> [length^2]
      real(wp), allocatable :: moment(:, :, :)
      !> Groups around each one, and the weights of their slopes in its curvature, shape (nd,
      !> entries); not allocated where pressures are written unchanged [1/length]
      type(csr_type) :: around
      real(wp), allocatable :: share(:, :)
      !> Planes or circles on which materials meet and pressures jump, and whether each group lies
      !> beyond them, shape (planes, groups); not allocated if there are none
      type(approximation_type) :: planes
      logical, allocatable :: beyond_plane(:, :)
   contains
      procedure :: value => pressure_value, from_ratios, at => pressure_at
      procedure :: bends
      procedure, private :: slope
   end type pressure_type

   !> A polynomial is left out if the others represent it up to this part of its norm
   real(wp), parameter :: dependent = 1.0e-6_wp
   !> Supports of the blending, in sizes of a group; the list is a little larger, for probes between
   !> collocation points
   real(wp), parameter :: blend = 1.0_wp, list = 2.0_wp
   !> Positions on the rim of a support, where the blending vanishes, are excluded despite rounding
   real(wp), parameter :: inside = 1.0_wp - 1.0e-12_wp
   !> Neighbours of a group have their centres within this many of its sizes, corners included
   real(wp), parameter :: beside = 1.5_wp
   !> Regularisation, relative to the squared size of a group: a direction in which it has no
   !> neighbours has no curvature
   real(wp), parameter :: alone = 1.0e-9_wp

contains

!> Set up the polynomials
subroutine new_pressure(self, cells, softness, whole, place, curved, planes, error)
   type(pressure_type), intent(out) :: self
   type(cells_type), intent(in) :: cells
   !> Bulk modulus of the group over that of each integration point, shape (np) [-]
   real(wp), intent(in) :: softness(:)
   !> Factor from the pressure of the coefficients to the one that is written, shape (groups) [-]
   real(wp), intent(in) :: whole(:)
   !> Collocation points, shape (nd, nc) [length]
   real(wp), intent(in) :: place(:, :)
   !> Write pressures with their curvature (plane problems)
   logical, intent(in) :: curved
   !> Approximation, with the planes on which materials meet
   type(approximation_type), intent(in) :: planes
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: m(:, :)
   real(wp) :: before, c(1 + size(place, 1)), factor
   integer :: d, g, i, j, k, n, nd, groups, trial

   nd = size(place, 1)
   groups = size(cells%first) - 1
   self%whole = whole
   allocate (self%count(groups), self%centre(nd, groups), self%reach(nd, groups))
   allocate (self%basis(1 + nd, size(cells%weight)), source=0.0_wp)
   allocate (self%total(1 + nd, groups), source=0.0_wp)
   allocate (self%monomial(1 + nd, 1 + nd, groups), source=0.0_wp)
   do g = 1, groups
      associate (x => cells%point(:, cells%first(g) + 1:cells%first(g + 1)), &
         & w => cells%weight(cells%first(g) + 1:cells%first(g + 1)), &
         & soft => cells%weight(cells%first(g) + 1:cells%first(g + 1)) &
         & *softness(cells%first(g) + 1:cells%first(g + 1)))
         self%centre(:, g) = matmul(x, w)/sum(w)
         do d = 1, nd
            ! width of a box with the same second moment
            self%reach(d, g) = sqrt(12.0_wp*sum(w*(x(d, :) - self%centre(d, g))**2)/sum(w))
         end do
         self%reach(:, g) = max(self%reach(:, g), sum(w)**(1.0_wp/nd))
         if (allocated(m)) deallocate (m)
         allocate (m(size(w), 1 + nd))
         n = 0
         do i = 1, 1 + nd
            if (i > 1 .and. allocated(cells%thin)) then
               if (cells%thin(i - 1, g)) cycle
            end if
            c = 0.0_wp
            c(i) = 1.0_wp
            m(:, n + 1) = 1.0_wp
            if (i > 1) m(:, n + 1) = (x(i - 1, :) - self%centre(i - 1, g))/self%reach(i - 1, g)
            before = sqrt(sum(soft))
            ! orthogonalising twice is enough
            do trial = 1, 2
               do j = 1, n
                  factor = sum(soft*m(:, j)*m(:, n + 1))
                  m(:, n + 1) = m(:, n + 1) - factor*m(:, j)
                  c = c - factor*self%monomial(:, j, g)
               end do
            end do
            factor = sqrt(sum(soft*m(:, n + 1)**2))
            if (factor <= dependent*before) cycle
            n = n + 1
            m(:, n) = m(:, n)/factor
            self%monomial(:, n, g) = c/factor
         end do
         self%count(g) = n
         if (n > 1 .and. n <= nd .and. .not. allocated(cells%thin)) &
            & call flatten(x, w, self%centre(:, g), self%reach(:, g), self%monomial(2:, 2:n, g), &
            & error)
         if (allocated(error)) return
         self%total(:n, g) = matmul(w, m(:, :n))
         self%basis(:n, cells%first(g) + 1:cells%first(g + 1)) = transpose(m(:, :n))
      end associate
   end do
   if (allocated(planes%kink)) then
      self%planes = planes
      ! the centre of a curved group may lie outside it
      self%beyond_plane = reshape([((planes%across(k, cells%point(:, cells%first(g) + 1)) &
         & > planes%kink(k), k=1, size(planes%kink)), g=1, groups)], [size(planes%kink), groups])
   end if
   call find_neighbours(self%near, self%centre, list*self%reach, place, window_product, error)
   if (allocated(error) .or. .not. curved) return
   call find_neighbours(self%around, self%centre, beside*self%reach, self%centre, window_radial, &
      & error)
   if (.not. allocated(error)) call weigh_slopes(self, cells)
end subroutine new_pressure

!> Project the slopes of a group whose points lie on a line or a plane onto it: the points do not
!> determine the slopes across. Slopes along the first axis alone grow without bound as the line
!> turns away from that axis, and so do pressures beside the line
subroutine flatten(x, w, centre, reach, slope, error)
   !> Points of the group, shape (nd, n) [length]
   real(wp), intent(in) :: x(:, :)
   !> Their volumes, shape (n) [length^nd]
   real(wp), intent(in) :: w(:)
   !> Centre and size of the group, shape (nd) each [length]
   real(wp), intent(in) :: centre(:), reach(:)
   !> Slopes of its polynomials in (x - centre)/reach, shape (nd, polynomials)
   real(wp), intent(inout) :: slope(:, :)
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: u(:, :), size_of(:), axis(:, :), along(:, :)
   integer :: q

   call svd(transpose(reshape([(sqrt(w(q))*(x(:, q) - centre)/reach, q=1, size(w))], shape(x))), &
      & u, size_of, axis, error)
   if (allocated(error)) return
   associate (own => axis(:size(slope, 2), :))
      along = matmul(transpose(own), matmul(own, slope))
   end associate
   if (any(abs(along - slope) > dependent*maxval(abs(slope)))) slope = along
end subroutine flatten

!> Least squares weights of the slopes around each group, and its second moments (plane problems)
subroutine weigh_slopes(self, cells)
   !> Pressure with its groups and those around them
   type(pressure_type), intent(inout) :: self
   type(cells_type), intent(in) :: cells
   real(wp) :: a(2, 2), x(2)
   integer(i8) :: k
   integer :: d, g, q

   allocate (self%moment(2, 2, size(self%count)), source=0.0_wp)
   allocate (self%share(2, size(self%around%index)))
   do g = 1, size(self%count)
      associate (weight => cells%weight(cells%first(g) + 1:cells%first(g + 1)))
         do q = 1, size(weight)
            x = cells%point(:, cells%first(g) + q) - self%centre(:, g)
            do d = 1, 2
               self%moment(:, d, g) = self%moment(:, d, g) + weight(q)*x*x(d)/sum(weight)
            end do
         end do
      end associate
      a = 0.0_wp
      do d = 1, 2
         a(d, d) = alone*self%reach(d, g)**2
      end do
      do k = self%around%offset(g) + 1, self%around%offset(g + 1)
         x = self%centre(:, self%around%index(k)) - self%centre(:, g)
         self%share(:, k) = x
         do d = 1, 2
            a(:, d) = a(:, d) + x*x(d)
         end do
      end do
      a = reshape([a(2, 2), -a(2, 1), -a(1, 2), a(1, 1)], [2, 2])/(a(1, 1)*a(2, 2) &
         & - a(1, 2)*a(2, 1))
      do k = self%around%offset(g) + 1, self%around%offset(g + 1)
         self%share(:, k) = matmul(a, self%share(:, k))
      end do
   end do
end subroutine weigh_slopes

!> Slope of the pressure of a group, shape (nd) [stress/length]
pure function slope(self, g, coefficient)
   class(pressure_type), intent(in) :: self
   !> Group
   integer, intent(in) :: g
   !> Coefficients of p, shape (1 + nd, groups) [stress length^(nd/2)]
   real(wp), intent(in) :: coefficient(:, :)
   real(wp) :: slope(size(self%centre, 1))

   associate (b => self%count(g))
      slope = matmul(self%monomial(2:, :b, g), coefficient(:b, g))/self%reach(:, g)
   end associate
end function slope

!> Second derivatives of the pressures of all groups, each from the slopes of those around it, shape
!> (nd, nd, groups) [stress/length^2]
pure function bends(self, coefficient) result(bend)
   !> Polynomials that are written with their curvature
   class(pressure_type), intent(in) :: self
   real(wp), intent(in) :: coefficient(:, :)
   real(wp) :: bend(size(self%centre, 1), size(self%centre, 1), size(self%count))
   real(wp) :: change(size(self%centre, 1))
   integer(i8) :: k
   integer :: d, g

   bend = 0.0_wp
   do g = 1, size(self%count)
      do k = self%around%offset(g) + 1, self%around%offset(g + 1)
         change = self%slope(self%around%index(k), coefficient) - self%slope(g, coefficient)
         do d = 1, size(change)
            bend(:, d, g) = bend(:, d, g) &
               & + 0.5_wp*(change*self%share(d, k) + change(d)*self%share(:, k))
         end do
      end do
   end do
end function bends

!> Pressure at a point of a group [stress]
pure real(wp) function pressure_value(self, g, q, coefficient)
   class(pressure_type), intent(in) :: self
   !> Group and its point
   integer, intent(in) :: g, q
   !> Coefficients of the group's pressure, shape (1 + nd) [stress length^(nd/2)]
   real(wp), intent(in) :: coefficient(:)

   associate (b => self%count(g))
      pressure_value = dot_product(coefficient(:b), self%basis(:b, q))
   end associate
end function pressure_value

!> Pressure of a group for volume ratios of its points
pure function from_ratios(self, g, cells, bulk, ratio) result(value)
   class(pressure_type), intent(in) :: self
   integer, intent(in) :: g
   type(cells_type), intent(in) :: cells
   !> Bulk modulus of the group [stress]
   real(wp), intent(in) :: bulk
   !> Volume ratios, shape (points of the group) [-]
   real(wp), intent(in) :: ratio(:)
   !> Coefficients [stress length^(nd/2)]
   real(wp) :: value(size(self%total, 1))

   value = 0.0_wp
   associate (b => self%count(g), first => cells%first(g) + 1, last => cells%first(g + 1))
      value(:b) = bulk*(matmul(self%basis(:b, first:last), cells%weight(first:last)*ratio) &
         & - self%total(:b, g))
   end associate
end function from_ratios

!> Blended pressure at a position: the polynomials of groups weighted by a partition of unity
pure real(wp) function pressure_at(self, ip, x, coefficient, bend) result(p)
   class(pressure_type), intent(in) :: self
   !> Collocation point nearest to the position
   integer, intent(in) :: ip
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   real(wp), intent(in) :: coefficient(:, :)
   !> Their curvatures if pressures are written with them, shape (nd, nd, groups) [stress/length^2]
   real(wp), intent(in), optional :: bend(:, :, :)
   real(wp) :: s(3), weight, total, local
   integer(i8) :: k
   integer :: j, nd

   nd = size(x)
   p = 0.0_wp
   total = 0.0_wp
   do k = self%near%offset(ip) + 1, self%near%offset(ip + 1)
      associate (g => self%near%index(k))
         s(:nd) = (x - self%centre(:, g))/self%reach(:, g)
         if (.not. all(abs(s(:nd)) < inside*blend)) cycle
         if (allocated(self%beyond_plane)) then
            if (beyond(self, g, x)) cycle
         end if
         weight = product(1.0_wp - abs(s(:nd))/blend)
         local = 0.0_wp
         do j = 1, self%count(g)
            local = local + coefficient(j, g) &
               & *(self%monomial(1, j, g) + dot_product(self%monomial(2:, j, g), s(:nd)))
         end do
         if (present(bend)) then
            associate (away => x - self%centre(:, g))
               local = local + 0.5_wp*(dot_product(away, matmul(bend(:, :, g), away)) &
                  & - sum(bend(:, :, g)*self%moment(:, :, g)))
            end associate
         end if
         p = p + weight*self%whole(g)*local
         total = total + weight
      end associate
   end do
   if (total > 0.0_wp) p = p/total
end function pressure_at

!> Whether a plane separates a position from a group
pure logical function beyond(self, g, x)
   class(pressure_type), intent(in) :: self
   integer, intent(in) :: g
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   integer :: k

   beyond = .false.
   do k = 1, size(self%beyond_plane, 1)
      beyond = beyond .or. (self%planes%across(k, x) - self%planes%kink(k) > -on_plane &
         & *self%reach(self%planes%kink_axis(k), g) .neqv. self%beyond_plane(k, g))
   end do
end function beyond

end module rk_pressure
