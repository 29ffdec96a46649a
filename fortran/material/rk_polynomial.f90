!> Polynomial energy in the reduced invariants, to third total order:
!>
!>     W_r = sum A_ij (I1r - 3)^i (I2r - 3)^j,   1 <= i + j <= 3
!>
!> Rubber, connective tissue, fat and the matrix of muscle are sets of its coefficients.
!>
!> References: thesis (4.35), (4.39), (5.37a);
!>             Rivlin, Saunders, Phil. Trans. R. Soc. A 243 (1951), doi:10.1098/rsta.1951.0004
module rk_polynomial
   use, intrinsic :: ieee_arithmetic, only : ieee_is_finite
   use rk_error, only : err_input, error_type, fatal_error
   use rk_material, only : kind_i1, kind_i2, material_type, energy_derivatives, invariant_state
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: polynomial_type, new_polynomial, check_parameter

   !> Isotropic material
   type, extends(material_type) :: polynomial_type
      !> Coefficients A_ij, zero where i + j > 3 [stress]
      real(wp) :: a(0:3, 0:3) = 0.0_wp
   contains
      procedure :: reduced
   end type polynomial_type

contains

!> Create an isotropic material
subroutine new_polynomial(self, name, a, bulk, error)
   !> Material
   type(polynomial_type), intent(out) :: self
   !> Name for messages
   character(len=*), intent(in) :: name
   !> Coefficients A_ij, zero for i = j = 0 and for i + j > 3 [stress]
   real(wp), intent(in) :: a(0:3, 0:3)
   !> Bulk modulus K, > 0, may be infinite [stress]
   real(wp), intent(in) :: bulk
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer :: i, j

   do j = 0, 3
      do i = 0, 3
         call check_parameter(name, 'A'//to_text(i)//to_text(j), a(i, j), error)
         if (allocated(error)) return
         if (abs(a(i, j)) > 0.0_wp .and. (i + j == 0 .or. i + j > 3)) then
            call fatal_error(error, err_input, "material '"//name//"': A"//to_text(i)// &
               & to_text(j)//" = "//to_text(a(i, j))//" is outside the cubic polynomial; "// &
               & "only A10 to A03 with i + j from 1 to 3 exist")
            return
         end if
      end do
   end do
   ! an infinite K keeps the volume; only a NaN or what is not positive is wrong
   if (.not. bulk > huge(1.0_wp)) call check_parameter(name, 'K', bulk, error, above=0.0_wp)
   if (allocated(error)) return
   self%name = name
   self%a = a
   self%bulk = bulk
   self%shear = 2.0_wp*(a(1, 0) + a(0, 1))
   if (.not. self%shear > 0.0_wp) then
      call fatal_error(error, err_input, "material '"//name//"': A10 + A01 = "// &
         & to_text(a(1, 0) + a(0, 1))//" must be positive, it is half the shear modulus")
      return
   end if
   self%active(kind_i1) = any(abs(a(1:, :)) > 0.0_wp)
   self%active(kind_i2) = any(abs(a(:, 1:)) > 0.0_wp)
end subroutine new_polynomial

!> Refuse a parameter that is not finite or not above (not below) a limit
subroutine check_parameter(material, name, value, error, above, least)
   !> Name of the material
   character(len=*), intent(in) :: material
   !> Name of the parameter
   character(len=*), intent(in) :: name
   !> Value
   real(wp), intent(in) :: value
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   !> The value must be greater
   real(wp), intent(in), optional :: above
   !> The value must be greater or equal
   real(wp), intent(in), optional :: least
   character(len=:), allocatable :: wanted

   if (.not. ieee_is_finite(value)) then
      wanted = "a finite number"
   else if (present(above)) then
      if (.not. value > above) wanted = "greater than "//to_text(above)
   else if (present(least)) then
      if (.not. value >= least) wanted = "at least "//to_text(least)
   end if
   if (allocated(wanted)) call fatal_error(error, err_input, "material '"//material//"': "// &
      & name//" = "//to_text(value)//" must be "//wanted)
end subroutine check_parameter

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
