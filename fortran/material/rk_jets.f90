!> Derivatives of an energy that is given as an expression, up to the third and exact to rounding.
!>
!> A jet is a Taylor polynomial up to an order in those of I1r, I2r, I4r that occur: its
!> coefficients are the derivatives over factorials. The operations of the expression act on jets
!> in place of numbers. A product is a sum over pairs of coefficients; a function f of a jet a + d
!> is the sum of f^(k)(a)/k! d^k, which ends with the order, as d has no constant term.
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

   !> An energy as it is evaluated
   type :: jets_type
      !> Does it depend on I1r, I2r, I4r and the activation?
      logical :: uses(4) = .false.
      !> Has it kinks?
      logical :: kinked = .false.
      !> Its operations
      type(tape_type), private :: tape
      !> Values that are needed, in the order in which they are computed
      integer, allocatable, private :: step(:)
      !> How many coefficients, and how many pairs that make products, up to each order
      integer, private :: coefficients(0:3), pairs(0:3)
      !> Pairs of coefficients and that of the product to which they add, shape (3, pairs)
      integer, allocatable, private :: pair(:, :)
      !> Coefficient of each derivative, by the variables 1.. or none (0), and the factorials
      !> between them
      integer, allocatable, private :: place(:, :, :)
      real(wp), allocatable, private :: factor(:)
      !> Which invariant is each variable
      integer, allocatable, private :: kind(:)
   contains
      procedure :: derivatives
      procedure, private :: run, multiplied, composed
   end type jets_type

contains

!> Get ready to differentiate
subroutine new_jets(self, tape)
   !> Energy as it is evaluated
   type(jets_type), intent(out) :: self
   type(tape_type), intent(in) :: tape
   logical :: needed(size(tape%operation))
   real(wp) :: value(1, size(tape%operation))
   integer :: i

   self%tape = tape
   call set_powers(self, [integer ::])
   ! what has no variable in it is a number from now on
   self%step = [(i, i=1, size(tape%operation))]
   call self%run([0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], 0, value)
   associate (t => self%tape)
      do i = 5, size(t%operation)
         if (t%operation(i) == no_operation) cycle
         if (.not. fixed(t, t%left(i))) cycle
         if (t%right(i) > 0) then
            if (.not. fixed(t, t%right(i))) cycle
         end if
         t%operation(i) = no_operation
         t%number(i) = value(1, i)
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
   call set_powers(self, pack([1, 2, 3], needed(:3)))
end subroutine new_jets

!> Whether a value is a number
pure logical function fixed(tape, i)
   !> Operations
   type(tape_type), intent(in) :: tape
   !> Value
   integer, intent(in) :: i

   fixed = i > 4 .and. tape%operation(i) == no_operation
end function fixed

!> Set the coefficients of jets in some of the invariants
pure subroutine set_powers(self, kind)
   class(jets_type), intent(inout) :: self
   !> Invariants that are variables, shape (nv)
   integer, intent(in) :: kind(:)
   !> Powers of each variable in each coefficient, by rising order
   integer :: powers(size(kind), 20)
   !> Coefficient whose powers are these, in base 4
   integer :: place(0:4**size(kind) - 1), base(0:size(kind)), own(size(kind))
   integer :: a, b, c, code, degree, i, j, k, nv, pass

   nv = size(kind)
   self%kind = kind
   base = [0, (4**(i - 1), i=1, nv)]
   place = 0
   k = 0
   do degree = 0, 3
      do code = 0, size(place) - 1
         own = mod(code/base(1:), 4)
         if (sum(own) /= degree) cycle
         k = k + 1
         powers(:, k) = own
         place(code) = k
      end do
      self%coefficients(degree) = k
   end do
   self%factor = [(product(gamma(powers(:, i) + 1.0_wp)), i=1, k)]
   do pass = 1, 2
      c = 0
      do degree = 0, 3
         do i = 1, k
            do j = 1, k
               own = powers(:, i) + powers(:, j)
               if (sum(own) /= degree) cycle
               c = c + 1
               if (pass == 2) self%pair(:, c) = [i, j, place(sum(own*base(1:)))]
            end do
         end do
         self%pairs(degree) = c
      end do
      if (pass == 2) exit
      if (allocated(self%pair)) deallocate (self%pair)
      allocate (self%pair(3, c))
   end do
   if (allocated(self%place)) deallocate (self%place)
   allocate (self%place(0:nv, 0:nv, 0:nv))
   do a = 0, nv
      do b = 0, nv
         self%place(:, b, a) = place(base + base(b) + base(a))
      end do
   end do
end subroutine set_powers

!> Energy and its derivatives by the invariants that occur
pure subroutine derivatives(self, state, order, w)
   class(jets_type), intent(in) :: self
   type(invariant_state), intent(in) :: state
   !> Highest derivative wanted, 0..3
   integer, intent(in) :: order
   type(energy_derivatives), intent(inout) :: w
   real(wp) :: jet(self%coefficients(order), size(self%tape%operation))
   integer :: a, b, nv

   call self%run([state%reduced, state%activation], order, jet)
   nv = size(self%kind)
   associate (e => jet(:, self%tape%result), kind => self%kind, f => self%factor, at => self%place)
      w%energy = e(1)
      if (order > 0) w%first(kind) = e(at(1:, 0, 0))
      do a = 1, merge(nv, 0, order > 1)
         w%second(kind, kind(a)) = f(at(1:, a, 0))*e(at(1:, a, 0))
         do b = 1, merge(nv, 0, order > 2)
            w%third(kind, kind(b), kind(a)) = f(at(1:, b, a))*e(at(1:, b, a))
         end do
      end do
   end associate
end subroutine derivatives

!> All values that are needed
pure subroutine run(self, x, order, jet)
   class(jets_type), intent(in) :: self
   !> I1r, I2r, I4r and the activation [-]
   real(wp), intent(in) :: x(4)
   !> Order of the jets
   integer, intent(in) :: order
   !> Coefficients of each value
   real(wp), intent(inout) :: jet(:, :)
   integer :: i, k, s

   associate (t => self%tape)
      do s = 1, size(self%step)
         i = self%step(s)
         associate (z => jet(:, i), a => jet(:, max(t%left(i), 1)), &
            & b => jet(:, max(t%right(i), 1)))
            select case (t%operation(i))
            case (no_operation)
               z = 0.0_wp
               if (i > 4) then
                  z(1) = t%number(i)
               else
                  z(1) = x(i)
                  if (order < 1) cycle
                  do k = 1, size(self%kind)
                     if (self%kind(k) == i) z(self%place(k, 0, 0)) = 1.0_wp
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
                  z = a(1)*b
               else if (fixed(t, t%right(i))) then
                  z = b(1)*a
               else
                  z = self%multiplied(a, b, order)
               end if
            case (over)
               if (fixed(t, t%right(i))) then
                  z = a/b(1)
               else
                  z = self%multiplied(a, self%composed(powered(b(1), -1.0_wp), b, order), order)
               end if
            case (power)
               if (fixed(t, t%right(i))) then
                  z = self%composed(powered(a(1), b(1)), a, order)
               else
                  z = self%composed(logarithmic(a(1)), a, order)
                  z = self%multiplied(b, z, order)
                  z = self%composed(exp(z(1))/[1.0_wp, 1.0_wp, 2.0_wp, 6.0_wp], z, order)
               end if
            case (less, greater, at_most, at_least)
               z = 0.0_wp
               z(1) = merge(1.0_wp, 0.0_wp, holds(t%operation(i), a(1), b(1)))
            case (largest)
               z = merge(a, b, a(1) > b(1))
            case (smallest)
               z = merge(a, b, a(1) < b(1))
            case (magnitude)
               z = sign(1.0_wp, a(1))*a
            case default
               z = self%composed(functions(t%operation(i), a(1)), a, order)
            end select
         end associate
      end do
   end associate
end subroutine run

pure function multiplied(self, a, b, order) result(z)
   class(jets_type), intent(in) :: self
   !> Jets
   real(wp), intent(in) :: a(:), b(:)
   integer, intent(in) :: order
   real(wp) :: z(size(a))
   integer :: p

   z = 0.0_wp
   do p = 1, self%pairs(order)
      associate (q => self%pair(:, p))
         z(q(3)) = z(q(3)) + a(q(1))*b(q(2))
      end associate
   end do
end function multiplied

!> Function of a jet
pure function composed(self, f, a, order) result(z)
   class(jets_type), intent(in) :: self
   !> Derivatives of the function over factorials, by the value of the jet
   real(wp), intent(in) :: f(0:3)
   !> Jet
   real(wp), intent(in) :: a(:)
   integer, intent(in) :: order
   real(wp) :: z(size(a)), d(size(a))
   integer :: k

   z = 0.0_wp
   z(1) = f(0)
   if (order < 1) return
   d = a
   d(1) = 0.0_wp
   if (all(abs(d) <= 0.0_wp)) return
   z = f(order)*d
   do k = order - 1, 1, -1
      z(1) = f(k)
      z = self%multiplied(d, z, order)
   end do
   z(1) = f(0)
end function composed

!> Whether a comparison holds
elemental logical function holds(operation, a, b)
   integer, intent(in) :: operation
   !> What is compared
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

!> Power and its derivatives over factorials; of whole powers also at and below zero
pure function powered(a, p) result(f)
   !> Base
   real(wp), intent(in) :: a
   !> Exponent
   real(wp), intent(in) :: p
   real(wp) :: f(0:3), binomial
   integer :: k, whole

   whole = nint(max(min(p, 1e6_wp), -1e6_wp))
   binomial = 1.0_wp
   f = 0.0_wp
   do k = 0, 3
      ! a whole power above zero has no further derivatives
      if (.not. abs(binomial) > 0.0_wp) exit
      if (abs(p - whole) > 0.0_wp) then
         f(k) = binomial*a**(p - k)
      else
         f(k) = binomial*a**(whole - k)
      end if
      binomial = binomial*(p - k)/(k + 1)
   end do
end function powered

!> Logarithm and its derivatives over factorials
pure function logarithmic(a) result(f)
   !> Argument
   real(wp), intent(in) :: a
   real(wp) :: f(0:3)
   integer :: k

   f = log(a)
   ! the derivatives would be finite below zero, where there is no energy
   if (.not. a > 0.0_wp) return
   do k = 1, 3
      f(k) = -(-1.0_wp/a)**k/k
   end do
end function logarithmic

!> Other functions and their derivatives over factorials
pure function functions(operation, a) result(f)
   integer, intent(in) :: operation
   real(wp), intent(in) :: a
   real(wp) :: f(0:3), t, s

   select case (operation)
   case (exponential)
      f = exp(a)
   case (logarithm)
      f = logarithmic(a)
      return
   case (root)
      f = powered(a, 0.5_wp)
      return
   case (sine)
      f = [sin(a), cos(a), -sin(a), -cos(a)]
   case (cosine)
      f = [cos(a), -sin(a), -cos(a), sin(a)]
   case (sinus_h)
      f = [sinh(a), cosh(a), sinh(a), cosh(a)]
   case (cosinus_h)
      f = [cosh(a), sinh(a), cosh(a), sinh(a)]
   case default
      t = tanh(a)
      s = 1.0_wp - t**2
      f = [t, s, -2.0_wp*t*s, -2.0_wp*s*(1.0_wp - 3.0_wp*t**2)]
   end select
   f = f/[1.0_wp, 1.0_wp, 2.0_wp, 6.0_wp]
end function functions

end module rk_jets
