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
   use rk_error, only : err_input, error_type, fatal_error
   use rk_fiber, only : active_curve, curve_type, evaluate_curve, passive_curve
   use rk_material, only : kind_i1, kind_i2, kind_i4, energy_derivatives, invariant_state
   use rk_polynomial, only : check_parameter, new_polynomial, polynomial_type
   use rk_precision, only : wp
   implicit none
   private

   public :: muscle_type, new_muscle, fiber_type

   !> Parameters of the fibers; the defaults are those of the references
   type :: fiber_type
      !> Largest isometric stress, >= 0 [stress]
      real(wp) :: sigma_max = 30.0_wp
      !> Stretch of optimal length, > 0 [-]
      real(wp) :: lambda_o = 1.0_wp
      !> Factor of the passive force, >= 0 [-]
      real(wp) :: gamma1 = 0.05_wp
      !> Rate of the passive force, > 0 [-]
      real(wp) :: gamma2 = 6.6_wp
      !> "published" or "smooth"
      character(len=16) :: curve = 'published'
   end type fiber_type

   !> Muscle
   type, extends(polynomial_type) :: muscle_type
      !> Parameters of the fibers
      type(fiber_type) :: fibers
      !> Active force
      type(curve_type) :: active_force
      !> Passive force
      type(curve_type) :: passive_force
   contains
      procedure :: reduced
   end type muscle_type

contains

!> Create a muscle
subroutine new_muscle(self, name, a, bulk, fibers, error)
   !> Material
   type(muscle_type), intent(out) :: self
   !> Name for messages
   character(len=*), intent(in) :: name
   !> Coefficients A_ij of the matrix, zero for i = j = 0 and for i + j > 3 [stress]
   real(wp), intent(in) :: a(0:3, 0:3)
   !> Bulk modulus K, > 0, may be infinite [stress]
   real(wp), intent(in) :: bulk
   !> Parameters of the fibers
   type(fiber_type), intent(in) :: fibers
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   logical :: smooth

   call new_polynomial(self%polynomial_type, name, a, bulk, error)
   if (allocated(error)) return
   call check_parameter(name, 'sigma_max', fibers%sigma_max, error, least=0.0_wp)
   if (allocated(error)) return
   call check_parameter(name, 'lambda_o', fibers%lambda_o, error, above=0.0_wp)
   if (allocated(error)) return
   call check_parameter(name, 'gamma1', fibers%gamma1, error, least=0.0_wp)
   if (allocated(error)) return
   call check_parameter(name, 'gamma2', fibers%gamma2, error, above=0.0_wp)
   if (allocated(error)) return
   if (fibers%curve /= 'published' .and. fibers%curve /= 'smooth') then
      call fatal_error(error, err_input, "material '"//name//"': curve = '"// &
         & trim(fibers%curve)//"' must be 'published' or 'smooth'")
      return
   end if
   smooth = fibers%curve == 'smooth'
   self%fibers = fibers
   self%active_force = active_curve(smooth)
   self%passive_force = passive_curve(smooth, fibers%gamma1, fibers%gamma2)
   self%active(kind_i4) = fibers%sigma_max > 0.0_wp
end subroutine new_muscle

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
   stretch = sqrt(state%reduced(kind_i4))/self%fibers%lambda_o
   c = 0.5_wp/self%fibers%lambda_o**2
   call evaluate_curve(self%active_force, stretch, order, f)
   call evaluate_curve(self%passive_force, stretch, order, passive)
   f(:order) = self%fibers%sigma_max*(state%activation*f(:order) + passive(:order))

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
