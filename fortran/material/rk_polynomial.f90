!> Polynomial energy in the reduced invariants, to third total order:
!>
!>     W_r = sum A_ij (I1r - 3)^i (I2r - 3)^j,   1 <= i + j <= 3
!>
!> Rubber, connective tissue, fat and the matrix of muscle are sets of its coefficients.
!>
!> References: thesis (4.35), (4.39), (5.37a);
!>             Rivlin, Saunders, Phil. Trans. R. Soc. A 243 (1951), doi:10.1098/rsta.1951.0004
module rk_polynomial
   use rk_error, only : err_input, error_type, fatal_error
   use rk_material, only : kind_i1, kind_i2, material_type, energy_derivatives, invariant_state
   use rk_parameters, only : parameters_type
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: polynomial_type

   !> Isotropic material
   type, extends(material_type) :: polynomial_type
      !> Coefficients A_ij, zero where i + j > 3 [stress]
      real(wp) :: a(0:3, 0:3) = 0.0_wp
   contains
      procedure :: set
      procedure :: reduced
      !> Bulk and shear modulus, once the coefficients are there
      procedure :: set_moduli
   end type polynomial_type

contains

!> Take and check A10 to A03 and K
subroutine set(self, parameters, error)
   !> Material
   class(polynomial_type), intent(inout) :: self
   !> Parameters
   type(parameters_type), intent(inout) :: parameters
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer :: i, j

   do i = 0, 3
      do j = 0, 3 - i
         if (i + j == 0) cycle
         call parameters%get('A'//to_text(i)//to_text(j), self%a(i, j), error)
         if (allocated(error)) return
      end do
   end do
   call self%set_moduli(parameters, 'A10 + A01', error)
end subroutine set

!> Take K; set what follows from it and from the coefficients
subroutine set_moduli(self, parameters, sum_name, error)
   !> Material with its coefficients
   class(polynomial_type), intent(inout) :: self
   !> Parameters
   type(parameters_type), intent(inout) :: parameters
   !> What A10 + A01 are in parameters, for messages
   character(len=*), intent(in) :: sum_name
   !> Error handling
   type(error_type), allocatable, intent(out) :: error

   ! an infinite K keeps the volume
   call parameters%get('K', self%bulk, error, above=0.0_wp, infinite=.true.)
   if (allocated(error)) return
   associate (a => self%a)
      self%shear = 2.0_wp*(a(1, 0) + a(0, 1))
      self%active(kind_i1) = any(abs(a(1:, :)) > 0.0_wp)
      self%active(kind_i2) = any(abs(a(:, 1:)) > 0.0_wp)
      if (.not. self%shear > 0.0_wp) call fatal_error(error, err_input, "material '"//self%name &
         & //"': "//sum_name//" = "//to_text(a(1, 0) + a(0, 1))//" must be positive, it is half " &
         & //"the shear modulus")
   end associate
end subroutine set_moduli

!> Polynomial and its derivatives
pure subroutine reduced(self, state, order, w)
   !> Material
   class(polynomial_type), intent(in) :: self
   !> Reduced invariants
   type(invariant_state), intent(in) :: state
   !> Highest derivative wanted
   integer, intent(in) :: order
   !> Energy and derivatives
   type(energy_derivatives), intent(out) :: w
   real(wp) :: x, y

   x = state%reduced(kind_i1) - 3.0_wp
   y = state%reduced(kind_i2) - 3.0_wp
   associate (a => self%a)
      w%energy = x*(a(1, 0) + x*(a(2, 0) + x*a(3, 0))) + y*(a(0, 1) + y*(a(0, 2) + y*a(0, 3))) &
         & + x*y*(a(1, 1) + x*a(2, 1) + y*a(1, 2))
      if (order < 1) return
      w%first(1) = a(1, 0) + x*(2.0_wp*a(2, 0) + x*3.0_wp*a(3, 0))
      w%second(1, 1) = 2.0_wp*a(2, 0) + x*6.0_wp*a(3, 0)
      w%third(1, 1, 1) = 6.0_wp*a(3, 0)
      if (order > 3) w%fourth = 0.0_wp
      if (.not. self%active(kind_i2)) return

      w%first(1) = w%first(1) + y*(a(1, 1) + 2.0_wp*x*a(2, 1) + y*a(1, 2))
      w%first(2) = a(0, 1) + y*(2.0_wp*a(0, 2) + y*3.0_wp*a(0, 3)) &
         & + x*(a(1, 1) + x*a(2, 1) + 2.0_wp*y*a(1, 2))
      w%second(1, 1) = w%second(1, 1) + 2.0_wp*y*a(2, 1)
      w%second(1, 2) = a(1, 1) + 2.0_wp*(x*a(2, 1) + y*a(1, 2))
      w%second(2, 1) = w%second(1, 2)
      w%second(2, 2) = 2.0_wp*(a(0, 2) + x*a(1, 2)) + y*6.0_wp*a(0, 3)
      w%third(2, 2, 2) = 6.0_wp*a(0, 3)
      w%third(1, 1, 2) = 2.0_wp*a(2, 1)
      w%third(1, 2, 1) = w%third(1, 1, 2)
      w%third(2, 1, 1) = w%third(1, 1, 2)
      w%third(1, 2, 2) = 2.0_wp*a(1, 2)
      w%third(2, 1, 2) = w%third(1, 2, 2)
      w%third(2, 2, 1) = w%third(1, 2, 2)
   end associate
end subroutine reduced

end module rk_polynomial
