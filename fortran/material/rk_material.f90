!> Hyperelastic materials: energy, stress and tangents at one point.
!>
!>     W = W_r(I1r, I2r, I4r, activation) + K/2 (J - 1)^2
!>
!> in the reduced invariants I1r = J^(-2/3) I1, I2r = J^(-4/3) I2, I4r = J^(-2/3) N.C.N. A material
!> extends `material_type` by two procedures: one reads its parameters, one gives the derivatives of
!> W_r. The powers of J are treated here and the tensors in rk_tensors. Procedures evaluated at
!> points are pure and allocate nothing, so they may be called from any thread. J <= 0 gives NaN:
!> the caller must check J first.
!>
!> References: thesis (4.34), (4.35), (5.36)-(5.38), Appendix C (C.1), (C.5), (C.10)
module rk_material
   use rk_deck, only : deck_type
   use rk_error, only : error_type
   use rk_precision, only : wp
   use rk_tensor, only : add_cross_form, cofactor, cross, determinant
   use rk_tensors, only : derivatives_type, first_tensor, invariants_type, kind_i1, kind_i2, &
      & kind_i4, second_form, set_invariants
   implicit none
   private

   public :: material_type, material_point, invariant_state, energy_derivatives
   public :: kind_i1, kind_i2, kind_i4

   !> Exponents n of the reduced invariants I J^(-n)
   real(wp), parameter :: exponent(3) = [2.0_wp, 4.0_wp, 2.0_wp]/3.0_wp
   !> Perturbation of F or N in the central differences along axes [-]: their error is its square
   !> times third derivatives, below 1e-8 of the term
   real(wp), parameter :: step = 1.0e-5_wp

   !> Arguments of the reduced energy at one point
   type :: invariant_state
      !> Reduced invariants I1r, I2r, I4r; unused ones have the values of F = I [-]
      real(wp) :: reduced(3)
      !> Whether there is a fiber here
      logical :: fibered
      !> Activation of the fibers, 0..1 [-]
      real(wp) :: activation
   end type invariant_state

   !> State at which a material is evaluated
   type :: material_point
      !> Deformation gradient F(i,A), all components also in the plane [-]
      real(wp) :: f(3, 3)
      !> Fiber in the reference body, unit vector or zeros for none [-]
      real(wp) :: fiber(3) = 0.0_wp
      !> Activation, 0..1 [-]
      real(wp) :: activation = 0.0_wp
      !> Whether to include K/2 (J-1)^2
      logical :: volumetric = .true.
   end type material_point

   !> Reduced energy and its derivatives with respect to I1r, I2r, I4r
   type :: energy_derivatives
      !> Energy W_r [stress]
      real(wp) :: energy
      !> First derivatives [stress]
      real(wp) :: first(3)
      !> Second derivatives, symmetric [stress]
      real(wp) :: second(3, 3)
   end type energy_derivatives

   !> Material of a set of points
   type, abstract :: material_type
      !> Name for messages
      character(len=:), allocatable :: name
      !> Bulk modulus K; infinite where J = 1 and the volumetric part is a separate pressure
      !> [stress]
      real(wp) :: bulk = 0.0_wp
      !> Shear modulus of small deformations, without fibers [stress]
      real(wp) :: shear = 0.0_wp
      !> Whether the reduced energy depends on I1r, I2r, I4r
      logical :: active(3) = .false.
      !> Whether it has fibers, so that its points need a direction
      logical :: fibered = .false.
      !> Whether its stress has kinks, at which a residual in strong form jumps
      logical :: kinked = .false.
   contains
      procedure(set_material), deferred :: set
      !> Derivatives of the reduced energy
      procedure(reduced_energy), deferred :: reduced
      procedure :: incompressible, shear_modulus, energy, stress, strong
   end type material_type

   abstract interface
      !> Read the parameters, then set the moduli and the active invariants
      subroutine set_material(self, deck, at, error)
         import :: deck_type, error_type, material_type
         class(material_type), intent(inout) :: self
         !> Deck, which was checked against the schema
         type(deck_type), intent(in) :: deck
         !> Table with the parameters, such as material.1
         character(len=*), intent(in) :: at
         !> Error handling: a modulus that is not positive, an expression that is not an energy
         type(error_type), allocatable, intent(out) :: error
      end subroutine set_material

      !> Reduced energy and its derivatives up to an order. Only the array entries of the active
      !> invariants are used; entries of a higher order than requested may stay unset.
      pure subroutine reduced_energy(self, state, order, w)
         import :: material_type, energy_derivatives, invariant_state
         class(material_type), intent(in) :: self
         !> Reduced invariants and activation
         type(invariant_state), intent(in) :: state
         !> Highest derivative to be computed, 0..2
         integer, intent(in) :: order
         type(energy_derivatives), intent(out) :: w
      end subroutine reduced_energy
   end interface

contains

!> Whether K is infinite, so that J does not determine any stress
pure logical function incompressible(self)
   class(material_type), intent(in) :: self

   incompressible = self%bulk > huge(1.0_wp)
end function incompressible

!> Tangent modulus, without fibers, of the simple shear that has the same reduced invariants: rubber
!> sheared by five times its height is a hundred times as stiff as at rest. Never below the value at
!> rest [stress]
pure real(wp) function shear_modulus(self, f)
   class(material_type), intent(in) :: self
   !> Deformation gradient F(i,A) [-]
   real(wp), intent(in) :: f(3, 3)
   type(invariants_type) :: inv
   type(energy_derivatives) :: r
   type(invariant_state) :: state
   real(wp) :: power(3), squared, slope, bend
   integer :: m

   call set_invariants(inv, f, [0.0_wp, 0.0_wp, 0.0_wp], self%active, gradients=.false.)
   call set_state(inv, 0.0_wp, state, power)
   call self%reduced(state, 2, r)
   squared = 0.0_wp
   slope = 0.0_wp
   bend = 0.0_wp
   do m = 2, inv%n
      associate (k => inv%kind(m))
         ! I1 = I2 = 3 + gamma^2, shear stress gamma dW/d(gamma^2)
         squared = max(squared, state%reduced(k) - 3.0_wp)
         slope = slope + r%first(k)
         bend = bend + sum(r%second(inv%kind(2:inv%n), k))
      end associate
   end do
   shear_modulus = max(self%shear, 2.0_wp*slope + 4.0_wp*squared*bend)
end function shear_modulus

!> Energy W per reference volume [stress]
pure function energy(self, at) result(w)
   class(material_type), intent(in) :: self
   type(material_point), intent(in) :: at
   real(wp) :: w
   type(invariants_type) :: inv
   type(energy_derivatives) :: r
   type(invariant_state) :: state
   real(wp) :: power(3)

   call set_invariants(inv, at%f, at%fiber, self%active, gradients=.false.)
   call set_state(inv, at%activation, state, power)
   call self%reduced(state, 0, r)
   w = r%energy
   if (at%volumetric) w = w + 0.5_wp*self%bulk*(inv%value(1) - 1.0_wp)**2
end function energy

!> First Piola-Kirchhoff stress and, if requested, the tangent
pure subroutine stress(self, at, p, c4)
   class(material_type), intent(in) :: self
   type(material_point), intent(in) :: at
   !> Stress P(i,A) = dW/dF_iA [stress]
   real(wp), intent(out) :: p(3, 3)
   !> Tangent C4(i,A,j,B) = dP_iA/dF_jB [stress]
   real(wp), intent(out), optional :: c4(3, 3, 3, 3)
   type(invariants_type) :: inv
   type(derivatives_type) :: w

   call set_invariants(inv, at%f, at%fiber, self%active, gradients=.true.)
   call set_derivatives(self, inv, at, merge(2, 1, present(c4)), w)
   call first_tensor(inv, w, p)
   if (present(c4)) call second_form(inv, w, c4)
end subroutine stress

!> All terms of a row of the strong form: P, C4, the pull of fibers that converge or bend, and, if
!> requested, T(i,k,C) = C4_iAkC,A, the derivative of P_iA,A by F_kC: a residual alone does not need
!> it, and it is most of the work.
!>
!> P and C4 depend on the position through F and the fiber direction N. The slopes of the isochoric
!> parts are differences of their values slightly to either side along both. K/2 (J-1)^2 is a
!> polynomial in F; differences of it would leave the rounding of F over their step, times K.
pure subroutine strong(self, nd, at, h, turn, p, c4, pull, t)
   class(material_type), intent(in) :: self
   !> Space dimension: 3, or 2 for plane strain (F_33 = 1)
   integer, intent(in) :: nd
   type(material_point), intent(in) :: at
   !> Second derivatives of the displacement H(j,B,A) = u_j,BA; indices above nd are not read
   !> [1/length]
   real(wp), intent(in) :: h(3, 3, 3)
   !> Slope N_k,A of the fiber, shape (3, nd) [1/length]
   real(wp), intent(in) :: turn(:, :)
   !> Stress P(i,A), all components also in the plane [stress]
   real(wp), intent(out) :: p(3, 3)
   !> Tangent C4(i,A,j,B); zero where an index is above nd [stress]
   real(wp), intent(out) :: c4(3, 3, 3, 3)
   !> dP_iA/dN_k N_k,A [stress/length]
   real(wp), intent(out) :: pull(3)
   !> Divergence T(i,k,C); zero where an index is above nd [stress/length]
   real(wp), intent(out), optional :: t(3, 3, 3)
   type(material_point) :: beside
   real(wp) :: along(3, 3), n(3), q(3, 3, 2), q4(3, 3, 3, 3, 2), bend(3, 3), cof(3, 3), rate
   integer :: a, c, way

   call self%stress(at, p, c4)
   pull = 0.0_wp
   if (present(t)) t = 0.0_wp
   cof = cofactor(at%f)
   do a = 1, nd
      do way = merge(1, 2, present(t)), 2
         along = 0.0_wp
         n = 0.0_wp
         if (way == 1) along(:nd, :nd) = h(:nd, :nd, a)
         if (way == 2) n = turn(:, a)
         rate = norm2(along) + norm2(n)
         if (.not. rate > 0.0_wp) cycle
         do c = 1, 2
            associate (aside => (2*c - 3)*step/rate)
               beside = material_point(at%f + aside*along, at%fiber + aside*n, at%activation, &
                  & .false.)
            end associate
            if (present(t)) then
               call self%stress(beside, q(:, :, c), q4(:, :, :, :, c))
            else
               call self%stress(beside, q(:, :, c))
            end if
         end do
         rate = 0.5_wp*rate/step
         if (way == 2) pull = pull + rate*(q(:, a, 2) - q(:, a, 1))
         if (.not. present(t)) cycle
         t = t + rate*(q4(:, a, :, :, 2) - q4(:, a, :, :, 1))
         if (way == 2 .or. .not. at%volumetric) cycle
         bend = cross(at%f, along)
         q4(:, :, :, :, 1) = 0.0_wp
         call add_cross_form(self%bulk, sum(cof*along)*at%f + (determinant(at%f) - 1.0_wp)*along, &
            & q4(:, :, :, :, 1))
         do c = 1, 3
            t(:, :, c) = t(:, :, c) + q4(:, a, :, c, 1) + self%bulk*(outer(bend(:, a), cof(:, c)) &
               & + outer(cof(:, a), bend(:, c)))
         end do
      end do
   end do
   do a = nd + 1, 3
      c4(a, :, :, :) = 0.0_wp
      c4(:, a, :, :) = 0.0_wp
      c4(:, :, a, :) = 0.0_wp
      c4(:, :, :, a) = 0.0_wp
      if (.not. present(t)) cycle
      t(a, :, :) = 0.0_wp
      t(:, a, :) = 0.0_wp
      t(:, :, a) = 0.0_wp
   end do

contains

   pure function outer(x, y)
      real(wp), intent(in) :: x(3), y(3)
      real(wp) :: outer(3, 3)

      outer = spread(x, 2, 3)*spread(y, 1, 3)
   end function outer

end subroutine strong

!> Reduced invariants I J^(-n) of the invariants in use
pure subroutine set_state(inv, activation, state, power)
   type(invariants_type), intent(in) :: inv
   !> Activation [-]
   real(wp), intent(in) :: activation
   type(invariant_state), intent(out) :: state
   !> Powers J^(-n) of I1r, I2r, I4r [-]
   real(wp), intent(out) :: power(3)
   integer :: n

   power(1) = inv%value(1)**(-2.0_wp/3.0_wp)
   power(2) = power(1)**2
   power(3) = power(1)
   state%reduced = [3.0_wp, 3.0_wp, 1.0_wp]
   state%activation = activation
   state%fibered = inv%kind(inv%n) == kind_i4
   do n = 2, inv%n
      associate (k => inv%kind(n))
         state%reduced(k) = inv%value(n)*power(k)
      end associate
   end do
end subroutine set_state

!> Derivatives of W by the unscaled invariants from those by the reduced ones and by J
pure subroutine set_derivatives(self, inv, at, order, w)
   class(material_type), intent(in) :: self
   type(invariants_type), intent(in) :: inv
   type(material_point), intent(in) :: at
   !> Highest derivative to be computed, 1..2
   integer, intent(in) :: order
   type(derivatives_type), intent(out) :: w
   type(energy_derivatives) :: r
   type(invariant_state) :: state
   !> Of a reduced invariant by I, by I and J, and by J (once, twice)
   real(wp), dimension(4) :: di, dij, dj, djj
   real(wp) :: power(3), inverse
   integer :: k(4), m, a, b

   call set_state(inv, at%activation, state, power)
   call self%reduced(state, order, r)
   m = inv%n
   k = inv%kind
   inverse = 1.0_wp/inv%value(1)
   do a = 2, m
      associate (n => exponent(k(a)))
         di(a) = power(k(a))
         dj(a) = -n*inverse*state%reduced(k(a))
         dij(a) = -n*inverse*di(a)
         djj(a) = -(n + 1.0_wp)*inverse*dj(a)
      end associate
   end do

   w%first(1) = 0.0_wp
   if (at%volumetric) w%first(1) = self%bulk*(inv%value(1) - 1.0_wp)
   do a = 2, m
      w%first(a) = r%first(k(a))*di(a)
      w%first(1) = w%first(1) + r%first(k(a))*dj(a)
   end do
   if (order < 2) return

   w%second(1, 1) = 0.0_wp
   if (at%volumetric) w%second(1, 1) = self%bulk
   do a = 2, m
      w%second(1, 1) = w%second(1, 1) + r%first(k(a))*djj(a)
      w%second(a, 1) = r%first(k(a))*dij(a)
      do b = 2, m
         associate (wab => r%second(k(a), k(b)))
            w%second(b, a) = wab*di(a)*di(b)
            w%second(a, 1) = w%second(a, 1) + wab*di(a)*dj(b)
            w%second(1, 1) = w%second(1, 1) + wab*dj(a)*dj(b)
         end associate
      end do
      w%second(1, a) = w%second(a, 1)
   end do
end subroutine set_derivatives

end module rk_material
