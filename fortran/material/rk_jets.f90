!> Derivatives of an energy given as an expression, up to the second and exact to rounding.
!>
!> A jet is a value with its derivatives with respect to those of I1r, I2r, I4r that occur, in a
!> symmetric matrix with indices from 0: entry (0, 0) is the value, (k, 0) a first and (k, l) a
!> second derivative. The operations of the expression act on jets instead of numbers.
!>
!> References: Griewank, Walther, Evaluating derivatives, 2nd ed. (2008), chapter 13,
!>             doi:10.1137/1.9780898717761
module rk_jets
   use rk_expression, only : tape_type
   use rk_material, only : energy_derivatives, invariant_state
   use rk_precision, only : wp
   implicit none
   private

   public :: jets_type, new_jets

   !> Operations, as in expression.cpp
   enum, bind(c)
      enumerator :: no_operation, plus, minus, times, over, power, less, greater, at_most, &
         & at_least, largest, smallest, negative, exponential, logarithm, root, sine, cosine, &
         & sinus_h, cosinus_h, tangens_h, magnitude
   end enum
   !> Operations whose results have kinks
   integer, parameter :: kinked(7) = [less, greater, at_most, at_least, largest, smallest, &
      & magnitude]

   !> An energy prepared for evaluation
   type :: jets_type
      !> Whether it depends on I1r, I2r, I4r and the activation
      logical :: uses(4) = .false.
      !> Whether it has kinks
      logical :: kinked = .false.
      !> Its operations
      type(tape_type), private :: tape
      !> Required values, in the order in which they are computed
      integer, allocatable, private :: step(:)
      !> Invariant that each variable stands for
      integer, allocatable, private :: kind(:)
   contains
      procedure :: derivatives
      procedure, private :: run
   end type jets_type

contains

!> Prepare the differentiation
subroutine new_jets(self, tape)
   !> Energy as a list of operations
   type(jets_type), intent(out) :: self
   type(tape_type), intent(in) :: tape
   logical :: needed(size(tape%operation))
   real(wp) :: value(0:0, 0:0, size(tape%operation))
   integer :: i

   self%tape = tape
   allocate (self%kind(0))
   ! fold constants: values without a variable become numbers
   self%step = [(i, i=1, size(tape%operation))]
   call self%run([0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], value)
   associate (t => self%tape)
      do i = 5, size(t%operation)
         if (t%operation(i) == no_operation) cycle
         if (.not. fixed(t, t%left(i))) cycle
         if (t%right(i) > 0) then
            if (.not. fixed(t, t%right(i))) cycle
         end if
         t%operation(i) = no_operation
         t%number(i) = value(0, 0, i)
      end do
      needed = .false.
      needed(t%result) = .true.
      do i = size(t%operation), 5, -1
         if (.not. needed(i) .or. t%operation(i) == no_operation) cycle
         needed(t%left(i)) = .true.
         if (t%right(i) > 0) needed(t%right(i)) = .true.
         self%kinked = self%kinked .or. any(kinked == t%operation(i))
      end do
   end associate
   self%uses = needed(:4)
   self%step = pack(self%step, needed)
   self%kind = pack([1, 2, 3], needed(:3))
end subroutine new_jets

!> Whether a value is a constant
pure logical function fixed(tape, i)
   type(tape_type), intent(in) :: tape
   !> Value
   integer, intent(in) :: i

   fixed = i > 4 .and. tape%operation(i) == no_operation
end function fixed

!> Energy and its derivatives with respect to the invariants that occur
pure subroutine derivatives(self, state, order, w)
   class(jets_type), intent(in) :: self
   type(invariant_state), intent(in) :: state
   !> Highest derivative to be computed, 0..2
   integer, intent(in) :: order
   type(energy_derivatives), intent(inout) :: w
   real(wp) :: jet(0:merge(size(self%kind), 0, order > 0), 0:merge(size(self%kind), 0, order > 0), &
      & size(self%tape%operation))

   call self%run([state%reduced, state%activation], jet)
   associate (e => jet(:, :, self%tape%result), kind => self%kind(:ubound(jet, 1)))
      w%energy = e(1, 1)
      w%first(kind) = e(2:, 1)
      w%second(kind, kind) = e(2:, 2:)
   end associate
end subroutine derivatives

!> Compute all required values
pure subroutine run(self, x, jet)
   class(jets_type), intent(in) :: self
   !> I1r, I2r, I4r and the activation [-]
   real(wp), intent(in) :: x(4)
   !> Jet of each value, shape (0:n, 0:n, values); n = 0 for values only
   real(wp), intent(inout) :: jet(0:, 0:, :)
   integer :: i, k, s

   associate (t => self%tape)
      do s = 1, size(self%step)
         i = self%step(s)
         associate (z => jet(:, :, i), a => jet(:, :, max(t%left(i), 1)), &
            & b => jet(:, :, max(t%right(i), 1)))
            select case (t%operation(i))
            case (no_operation)
               z = 0.0_wp
               if (i > 4) then
                  z(1, 1) = t%number(i)
               else
                  z(1, 1) = x(i)
                  do k = 1, ubound(jet, 1)
                     if (self%kind(k) /= i) cycle
                     z(1 + k, 1) = 1.0_wp
                     z(1, 1 + k) = 1.0_wp
                  end do
               end if
            case (plus)
               z = a + b
            case (minus)
               z = a - b
            case (negative)
               z = -a
            case (times)
               if (fixed(t, t%left(i))) then
                  z = a(1, 1)*b
               else if (fixed(t, t%right(i))) then
                  z = b(1, 1)*a
               else
                  z = multiplied(a, b)
               end if
            case (over)
               if (fixed(t, t%right(i))) then
                  z = a/b(1, 1)
               else
                  z = multiplied(a, composed(powered(b(1, 1), -1.0_wp), b))
               end if
            case (power)
               if (fixed(t, t%right(i))) then
                  z = composed(powered(a(1, 1), b(1, 1)), a)
               else
                  z = composed(logarithmic(a(1, 1)), a)
                  z = multiplied(b, z)
                  z = composed(spread(exp(z(1, 1)), 1, 3), z)
               end if
            case (less, greater, at_most, at_least)
               z = 0.0_wp
               z(1, 1) = merge(1.0_wp, 0.0_wp, holds(t%operation(i), a(1, 1), b(1, 1)))
            case (largest)
               z = merge(a, b, a(1, 1) > b(1, 1))
            case (smallest)
               z = merge(a, b, a(1, 1) < b(1, 1))
            case (magnitude)
               z = sign(1.0_wp, a(1, 1))*a
            case default
               z = composed(functions(t%operation(i), a(1, 1)), a)
            end select
         end associate
      end do
   end associate
end subroutine run

pure function multiplied(a, b) result(z)
   real(wp), intent(in) :: a(0:, 0:), b(0:, 0:)
   real(wp) :: z(0:ubound(a, 1), 0:ubound(a, 1))
   integer :: k

   z = a(0, 0)*b + b(0, 0)*a
   z(0, 0) = a(0, 0)*b(0, 0)
   do k = 1, ubound(z, 2)
      z(1:, k) = z(1:, k) + a(1:, 0)*b(0, k) + b(1:, 0)*a(0, k)
   end do
end function multiplied

!> Function of a jet
pure function composed(f, a) result(z)
   !> The function and its derivatives at the value of the jet
   real(wp), intent(in) :: f(0:2)
   real(wp), intent(in) :: a(0:, 0:)
   real(wp) :: z(0:ubound(a, 1), 0:ubound(a, 1))
   integer :: k

   z = 0.0_wp
   z(0, 0) = f(0)
   ! constants, at which the derivatives need not be finite
   if (all(abs(a(1:, 0)) <= 0.0_wp) .and. all(abs(a(1:, 1:)) <= 0.0_wp)) return
   z = f(1)*a
   z(0, 0) = f(0)
   do k = 1, ubound(z, 2)
      z(1:, k) = z(1:, k) + f(2)*a(1:, 0)*a(0, k)
   end do
end function composed

!> Evaluate a comparison
elemental logical function holds(operation, a, b)
   integer, intent(in) :: operation
   real(wp), intent(in) :: a, b

   select case (operation)
   case (less)
      holds = a < b
   case (greater)
      holds = a > b
   case (at_most)
      holds = a <= b
   case default
      holds = a >= b
   end select
end function holds

!> Power and its derivatives; for whole exponents also at and below zero
pure function powered(a, p) result(f)
   !> Base
   real(wp), intent(in) :: a
   !> Exponent
   real(wp), intent(in) :: p
   real(wp) :: f(0:2), factor
   integer :: k, whole

   whole = nint(max(min(p, 1e6_wp), -1e6_wp))
   factor = 1.0_wp
   f = 0.0_wp
   do k = 0, 2
      ! a whole power has no derivatives beyond its exponent
      if (.not. abs(factor) > 0.0_wp) exit
      if (abs(p - whole) > 0.0_wp) then
         f(k) = factor*a**(p - k)
      else
         f(k) = factor*a**(whole - k)
      end if
      factor = factor*(p - k)
   end do
end function powered

!> Logarithm and its derivatives
pure function logarithmic(a) result(f)
   real(wp), intent(in) :: a
   real(wp) :: f(0:2)

   f = log(a)
   ! below zero the derivatives would be finite, but the energy is undefined
   if (a > 0.0_wp) f(1:) = [1.0_wp/a, -1.0_wp/a**2]
end function logarithmic

!> Other functions and their derivatives
pure function functions(operation, a) result(f)
   integer, intent(in) :: operation
   real(wp), intent(in) :: a
   real(wp) :: f(0:2), t

   select case (operation)
   case (exponential)
      f = exp(a)
   case (logarithm)
      f = logarithmic(a)
   case (root)
      f = powered(a, 0.5_wp)
   case (sine)
      f = [sin(a), cos(a), -sin(a)]
   case (cosine)
      f = [cos(a), -sin(a), -cos(a)]
   case (sinus_h)
      f = [sinh(a), cosh(a), sinh(a)]
   case (cosinus_h)
      f = [cosh(a), sinh(a), cosh(a)]
   case default
      t = tanh(a)
      f = [t, 1.0_wp - t**2, -2.0_wp*t*(1.0_wp - t**2)]
   end select
end function functions

end module rk_jets
