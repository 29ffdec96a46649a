!> Transversely isotropic muscle: polynomial matrix and fibers that carry and produce force.
!>
!>     lambda dW_f/dlambda = sigma_max lambda/lambda_o (activation f_active + f_passive)
!>
!> of lambda* = lambda/lambda_o with lambda^2 = I4r, the reduced square of the fiber stretch.
!> The energy of the fibers is counted from lambda* = 1. Fibers v and -v are the same; a fiber of
!> zeros leaves the matrix alone.
!>
!> References: thesis (4.34)-(4.36);
!>             Blemker, Pinsky, Delp, J. Biomech. 38 (2005), doi:10.1016/j.jbiomech.2004.04.009
module rk_muscle
   use rk_error, only : error_type
   use rk_fiber, only : active_curve, curve_type, evaluate_curve, passive_curve
   use rk_material, only : kind_i1, kind_i2, kind_i4, energy_derivatives, invariant_state
   use rk_parameters, only : parameters_type
   use rk_polynomial, only : polynomial_type
   use rk_precision, only : wp
   implicit none
   private

   public :: muscle_type

   !> Muscle
   type, extends(polynomial_type) :: muscle_type
      !> Largest isometric stress, >= 0 [stress]
      real(wp) :: sigma_max
      !> Stretch of optimal length, > 0 [-]
      real(wp) :: lambda_o
      !> Active force
      type(curve_type) :: active_force
      !> Passive force
      type(curve_type) :: passive_force
   contains
      procedure :: set
      procedure :: reduced
   end type muscle_type

contains

!> Take and check the parameters of the matrix and of the fibers
subroutine set(self, parameters, error)
   !> Material
   class(muscle_type), intent(inout) :: self
   !> Parameters
   type(parameters_type), intent(inout) :: parameters
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   !> Factor, >= 0, and rate, > 0, of the passive force [-]
   real(wp) :: gamma1, gamma2
   character(len=:), allocatable :: curve
   logical :: smooth

   call self%polynomial_type%set(parameters, error)
   if (allocated(error)) return
   call parameters%get('sigma_max', self%sigma_max, error, least=0.0_wp)
   if (allocated(error)) return
   call parameters%get('lambda_o', self%lambda_o, error, above=0.0_wp)
   if (allocated(error)) return
   call parameters%get('gamma1', gamma1, error, least=0.0_wp)
   if (allocated(error)) return
   call parameters%get('gamma2', gamma2, error, above=0.0_wp)
   if (allocated(error)) return
   call parameters%get('curve', curve, ['published', 'smooth   '], error)
   if (allocated(error)) return
   smooth = curve == 'smooth'
   self%active_force = active_curve(smooth)
   self%passive_force = passive_curve(smooth, gamma1, gamma2)
   self%active(kind_i4) = self%sigma_max > 0.0_wp
   self%fibered = .true.
   self%kinked = .not. smooth
end subroutine set

!> Energy of matrix and fibers and its derivatives
pure subroutine reduced(self, state, order, w)
   !> Material
   class(muscle_type), intent(in) :: self
   !> Reduced invariants and activation
   type(invariant_state), intent(in) :: state
   !> Highest derivative wanted
   integer, intent(in) :: order
   !> Energy and derivatives
   type(energy_derivatives), intent(out) :: w
   !> Integral of the force by lambda*, the force and its derivatives [-]
   real(wp) :: f(0:4), passive(0:4)
   !> lambda*, and d lambda*/d I4r = c/lambda* [-]
   real(wp) :: stretch, c

   call self%polynomial_type%reduced(state, order, w)
   if (.not. state%fibered) return
   stretch = sqrt(state%reduced(kind_i4))/self%lambda_o
   c = 0.5_wp/self%lambda_o**2
   call evaluate_curve(self%active_force, stretch, order, f)
   call evaluate_curve(self%passive_force, stretch, order, passive)
   f(:order) = self%sigma_max*(state%activation*f(:order) + passive(:order))

   w%energy = w%energy + f(0)
   if (order < 1) return
   w%first(kind_i4) = c*f(1)/stretch
   if (order < 2) return
   w%second(kind_i1:kind_i2, kind_i4) = 0.0_wp
   w%second(kind_i4, kind_i1:kind_i2) = 0.0_wp
   w%second(kind_i4, kind_i4) = c**2*(f(2) - f(1)/stretch)/stretch**2
   if (order < 3) return
   w%third(:, :, kind_i4) = 0.0_wp
   w%third(:, kind_i4, :) = 0.0_wp
   w%third(kind_i4, :, :) = 0.0_wp
   w%third(kind_i4, kind_i4, kind_i4) = &
      & c**3*(f(3) - 3.0_wp*(f(2) - f(1)/stretch)/stretch)/stretch**3
   if (order < 4) return
   w%fourth(kind_i4, kind_i4, kind_i4, kind_i4) = c**4*(f(4) - 6.0_wp*f(3)/stretch &
      & + 15.0_wp*(f(2) - f(1)/stretch)/stretch**2)/stretch**4
end subroutine reduced

end module rk_muscle
