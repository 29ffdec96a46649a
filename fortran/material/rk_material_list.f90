!> The materials by the names they have in decks. A new material is one more case here.
module rk_material_list
   use rk_error, only : err_input, error_type, fatal_error
   use rk_material, only : material_item
   use rk_muscle, only : fiber_type, muscle_type, new_muscle
   use rk_polynomial, only : new_polynomial, polynomial_type
   use rk_precision, only : wp
   implicit none
   private

   public :: new_material

contains

!> Create a material of a model
subroutine new_material(item, model, name, a, bulk, fibers, error)
   !> Material
   type(material_item), intent(out) :: item
   !> "polynomial" or "muscle"
   character(len=*), intent(in) :: model
   !> Name for messages
   character(len=*), intent(in) :: name
   !> Coefficients A_ij of the polynomial [stress]
   real(wp), intent(in) :: a(0:3, 0:3)
   !> Bulk modulus K, > 0, may be infinite [stress]
   real(wp), intent(in) :: bulk
   !> Parameters of the fibers, used by muscle
   type(fiber_type), intent(in) :: fibers
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   type(polynomial_type) :: polynomial
   type(muscle_type) :: muscle

   select case (model)
   case ('polynomial')
      call new_polynomial(polynomial, name, a, bulk, error)
      if (.not. allocated(error)) allocate (item%material, source=polynomial)
   case ('muscle')
      call new_muscle(muscle, name, a, bulk, fibers, error)
      if (.not. allocated(error)) allocate (item%material, source=muscle)
   case default
      call fatal_error(error, err_input, "material '"//name//"': model = '"//trim(model)// &
         & "' must be 'polynomial' or 'muscle'")
   end select
end subroutine new_material

end module rk_material_list
