!> Named isotropic materials: the polynomial energy with the parameters its users look for.
!>
!>     neo-hookean     W_r = mu/2 (I1r - 3)                                    A10 = mu/2
!>     mooney-rivlin   W_r = C1 (I1r - 3) + C2 (I2r - 3)                       A10 = C1, A01 = C2
!>     yeoh            W_r = C1 (I1r - 3) + C2 (I1r - 3)^2 + C3 (I1r - 3)^3    A10, A20, A30
!>
!> all with K/2 (J - 1)^2. Abaqus has the same three, with K = 2/D1.
!>
!> References: Rivlin, Phil. Trans. R. Soc. A 240 (1948), doi:10.1098/rsta.1948.0002;
!>             Mooney, J. Appl. Phys. 11 (1940), doi:10.1063/1.1712836;
!>             Yeoh, Rubber Chem. Technol. 66 (1993), doi:10.5254/1.3538343
module rk_named
   use rk_error, only : error_type
   use rk_parameters, only : parameters_type
   use rk_polynomial, only : polynomial_type
   use rk_precision, only : wp
   implicit none
   private

   public :: neo_hookean_type, mooney_rivlin_type, yeoh_type

   !> Neo-Hookean material
   type, extends(polynomial_type) :: neo_hookean_type
   contains
      procedure :: set => set_neo_hookean
   end type neo_hookean_type

   !> Mooney-Rivlin material
   type, extends(polynomial_type) :: mooney_rivlin_type
   contains
      procedure :: set => set_mooney_rivlin
   end type mooney_rivlin_type

   !> Yeoh's material
   type, extends(polynomial_type) :: yeoh_type
   contains
      procedure :: set => set_yeoh
   end type yeoh_type

contains

!> Take and check mu and K
subroutine set_neo_hookean(self, parameters, error)
   !> Material
   class(neo_hookean_type), intent(inout) :: self
   !> Parameters
   type(parameters_type), intent(inout) :: parameters
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: mu

   call parameters%get('mu', mu, error, above=0.0_wp)
   if (allocated(error)) return
   self%a(1, 0) = 0.5_wp*mu
   call self%set_moduli(parameters, 'mu/2', error)
end subroutine set_neo_hookean

!> Take and check C1, C2 and K
subroutine set_mooney_rivlin(self, parameters, error)
   !> Material
   class(mooney_rivlin_type), intent(inout) :: self
   !> Parameters
   type(parameters_type), intent(inout) :: parameters
   !> Error handling
   type(error_type), allocatable, intent(out) :: error

   call parameters%get('C1', self%a(1, 0), error)
   if (allocated(error)) return
   call parameters%get('C2', self%a(0, 1), error)
   if (allocated(error)) return
   call self%set_moduli(parameters, 'C1 + C2', error)
end subroutine set_mooney_rivlin

!> Take and check C1, C2, C3 and K
subroutine set_yeoh(self, parameters, error)
   !> Material
   class(yeoh_type), intent(inout) :: self
   !> Parameters
   type(parameters_type), intent(inout) :: parameters
   !> Error handling
   type(error_type), allocatable, intent(out) :: error

   call parameters%get('C1', self%a(1, 0), error)
   if (allocated(error)) return
   call parameters%get('C2', self%a(2, 0), error)
   if (allocated(error)) return
   call parameters%get('C3', self%a(3, 0), error)
   if (allocated(error)) return
   call self%set_moduli(parameters, 'C1', error)
end subroutine set_yeoh

end module rk_named
