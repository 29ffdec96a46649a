!> Known solutions of linear problems, with first and second derivatives.
!>
!> Source, flux and prescribed values of a problem follow from its solution by the problem's own
!> operators, so every solution fits every operator with as many unknown fields.
!>
!> References: thesis equations (5.22), (5.23), (5.25), (5.26);
!>             Timoshenko, Goodier, Theory of Elasticity, McGraw-Hill (1970), section 21
module rk_solutions
   use rk_basis, only : second_index
   use rk_coefficients, only : coefficient_at, moduli
   use rk_equation, only : equation_type
   use rk_error, only : error_type
   use rk_precision, only : pi, wp
   use rk_shape, only : derivative_count
   implicit none
   private

   public :: exact_field, flux_at, solution_at, source_at

   !> Distance of values whose differences are derivatives, in sizes of the body [-]
   real(wp), parameter :: difference = 1.0e-3_wp

contains

!> Value and first derivatives of the solution, also of one that the deck gives
subroutine solution_at(equation, x, time, u, error)
   !> Problem, whose solution is known
   type(equation_type), intent(in) :: equation
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Time, of no meaning where nothing moves
   real(wp), intent(in) :: time
   !> Value and first derivatives of each field, behind them what is not known, shape (fields, nq)
   real(wp), intent(out) :: u(:, :)
   !> Error handling: an expression without a value there
   type(error_type), allocatable, intent(inout) :: error
   integer :: i

   if (.not. equation%is_own()) then
      call exact_field(equation, x, u)
      return
   end if
   u = 0.0_wp
   do i = 1, size(u, 1)
      call equation%exact_of(i)%at(x, u(i, 1), error, time)
      call equation%exact_of(i)%gradient(x, difference*minval(equation%extent(:size(x))), &
         & u(i, 2:1 + size(x)), error, time)
   end do
end subroutine solution_at

!> Source or body force: that of the deck, or minus the operator of the known solution
subroutine source_at(equation, x, time, f, error)
   !> Problem
   type(equation_type), intent(in) :: equation
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Time, of no meaning where nothing moves
   real(wp), intent(in) :: time
   !> Source of each field, shape (fields) [force/length^3]
   real(wp), intent(out) :: f(:)
   !> Error handling: an expression without a value there
   type(error_type), allocatable, intent(inout) :: error
   real(wp) :: u(size(f), derivative_count(size(x))), pair(2)
   real(wp), allocatable :: c(:, :, :, :)
   integer :: a, d, i

   if (.not. equation%is_own()) then
      call exact_field(equation, x, u)
      call coefficient_at(equation, x, pair, error)
      c = moduli(equation, size(x), pair)
      f = 0.0_wp
      do d = 1, size(x)
         do a = 1, size(x)
            f = f - matmul(c(:, a, :, d), u(:, second_index(size(x), min(a, d), max(a, d))))
         end do
      end do
      return
   end if
   f = equation%source(:size(f))
   do i = 1, size(f)
      if (equation%source_of(i)%given()) call equation%source_of(i)%at(x, f(i), error, time)
   end do
end subroutine source_at

!> Value of a known solution on the surface, and what flows in there: its traction
subroutine flux_at(equation, x, normal, value, flux, error)
   !> Problem, whose solution is known
   type(equation_type), intent(in) :: equation
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Outward unit normal, shape (nd)
   real(wp), intent(in) :: normal(:)
   !> Value and flux of each field, shape (fields) [length], [force/area]
   real(wp), intent(out) :: value(:), flux(:)
   !> Error handling: coefficients without a value there
   type(error_type), allocatable, intent(inout) :: error
   real(wp) :: u(size(value), derivative_count(size(x))), pair(2)
   real(wp), allocatable :: c(:, :, :, :)
   integer :: a, d

   call exact_field(equation, x, u)
   call coefficient_at(equation, x, pair, error)
   c = moduli(equation, size(x), pair)
   value = u(:, 1)
   flux = 0.0_wp
   do d = 1, size(x)
      do a = 1, size(x)
         flux = flux + normal(a)*matmul(c(:, a, :, d), u(:, 1 + d))
      end do
   end do
end subroutine flux_at

!> Value and derivatives of the solution at a place
pure subroutine exact_field(equation, x, u)
   !> Problem
   type(equation_type), intent(in) :: equation
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Value, first and second derivatives (11, 12, 13, 22, 23, 33) of each field, shape (fields, nq)
   real(wp), intent(out) :: u(:, :)
   integer :: c

   select case (equation%solution)
   case ('exp_x')
      call exponential(x(1), u(1, :))
   case ('exp_xy')
      call exponential_of_product(x(1), x(2), u(1, :))
   case ('cantilever')
      call cantilever(equation, x(1), x(2), u)
   case ('sine')
      do c = 1, size(u, 1)
         call sines(x, 0.25_wp*pi*(c - 1), u(c, :))
      end do
   case default
      do c = 1, size(u, 1)
         call polynomial(equation%degree, x, equation%extent(:size(x)), c, u(c, :))
      end do
   end select
end subroutine exact_field

!> exp(x), (5.22)
pure subroutine exponential(x, u)
   !> Coordinate [length]
   real(wp), intent(in) :: x
   !> Value and derivatives, shape (nq)
   real(wp), intent(out) :: u(:)

   u(1:3) = exp(x)
end subroutine exponential

!> exp(x y), (5.23)
pure subroutine exponential_of_product(x, y, u)
   !> Coordinates [length]
   real(wp), intent(in) :: x, y
   !> Value and derivatives, shape (nq)
   real(wp), intent(out) :: u(:)

   u = exp(x*y)*[1.0_wp, y, x, y**2, 1.0_wp + x*y, x**2]
end subroutine exponential_of_product

!> Product of sin(pi x_d + phase), (5.26) for phase 0
pure subroutine sines(x, phase, u)
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Phase [-]
   real(wp), intent(in) :: phase
   !> Value and derivatives, shape (nq)
   real(wp), intent(out) :: u(:)
   real(wp) :: factor(0:2, size(x))

   factor(0, :) = sin(pi*x + phase)
   factor(1, :) = pi*cos(pi*x + phase)
   factor(2, :) = -pi**2*factor(0, :)
   call products(factor, u)
end subroutine sines

!> Value and derivatives of a product of functions of one coordinate each
pure subroutine products(factor, u)
   !> Value, first and second derivative of each function, shape (0:2, nd)
   real(wp), intent(in) :: factor(0:, :)
   !> Value and derivatives, shape (nq)
   real(wp), intent(out) :: u(:)
   integer :: order(size(factor, 2)), a, b, nd

   nd = size(factor, 2)
   u(1) = product(factor(0, :))
   do a = 1, nd
      order = 0
      order(a) = 1
      u(1 + a) = chosen()
      do b = a, nd
         order = 0
         order(a) = 1
         order(b) = order(b) + 1
         u(second_index(nd, a, b)) = chosen()
      end do
   end do

contains

   pure real(wp) function chosen()
      integer :: d
      chosen = product([(factor(order(d), d), d=1, nd)])
   end function chosen

end subroutine products

!> (1 + a . x/extent)**degree with another direction a for each field
pure subroutine polynomial(degree, x, extent, field, u)
   !> Degree
   integer, intent(in) :: degree
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Size of the body, shape (nd) [length]
   real(wp), intent(in) :: extent(:)
   !> Field
   integer, intent(in) :: field
   !> Value and derivatives, shape (nq)
   real(wp), intent(out) :: u(:)
   real(wp), parameter :: direction(5) = [0.7_wp, -0.4_wp, 0.5_wp, 0.3_wp, -0.6_wp]
   real(wp) :: a(size(x)), p
   integer :: i, j

   a = direction(field:field + size(x) - 1)/extent
   p = 1.0_wp + dot_product(a, x)
   u(1) = p**degree
   do i = 1, size(x)
      u(1 + i) = degree*p**max(degree - 1, 0)*a(i)
      do j = i, size(x)
         u(second_index(size(x), i, j)) = degree*(degree - 1)*p**max(degree - 2, 0)*a(i)*a(j)
      end do
   end do
end subroutine polynomial

!> Beam held at x = 0 with a shear force on its other end, (5.25). The axis lies at half height.
pure subroutine cantilever(equation, x, height, u)
   !> Problem with its moduli, force and size
   type(equation_type), intent(in) :: equation
   !> Coordinates [length]
   real(wp), intent(in) :: x, height
   !> Value and derivatives, shape (2, 6) [length], [-], [1/length]
   real(wp), intent(out) :: u(:, :)
   real(wp) :: y, l, d, e, v, k

   l = equation%extent(1)
   d = equation%extent(2)
   y = height - 0.5_wp*d
   e = equation%young
   v = equation%poisson_ratio
   if (.not. equation%plane_stress) then
      e = e/(1.0_wp - v**2)
      v = v/(1.0_wp - v)
   end if
   k = 2.0_wp*equation%force/(e*d**3)
   u(1, 1) = -y*((6.0_wp*l - 3.0_wp*x)*x + (2.0_wp + v)*(y**2 - 0.25_wp*d**2))
   u(1, 2) = -y*(6.0_wp*l - 6.0_wp*x)
   u(1, 3) = -(6.0_wp*l - 3.0_wp*x)*x - (2.0_wp + v)*(3.0_wp*y**2 - 0.25_wp*d**2)
   u(1, 4) = 6.0_wp*y
   u(1, 5) = -(6.0_wp*l - 6.0_wp*x)
   u(1, 6) = -6.0_wp*(2.0_wp + v)*y
   u(2, 1) = (3.0_wp*l - x)*x**2 + 3.0_wp*v*y**2*(l - x) + 0.25_wp*(4.0_wp + 5.0_wp*v)*d**2*x
   u(2, 2) = 6.0_wp*l*x - 3.0_wp*x**2 - 3.0_wp*v*y**2 + 0.25_wp*(4.0_wp + 5.0_wp*v)*d**2
   u(2, 3) = 6.0_wp*v*y*(l - x)
   u(2, 4) = 6.0_wp*(l - x)
   u(2, 5) = -6.0_wp*v*y
   u(2, 6) = 6.0_wp*v*(l - x)
   u = k*u
end subroutine cantilever

end module rk_solutions
