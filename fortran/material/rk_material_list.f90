!> The materials by the names they have in decks. A new material is one more case here.
module rk_material_list
   use rk_error, only : error_type
   use rk_material, only : material_item
   use rk_muscle, only : muscle_type
   use rk_named, only : mooney_rivlin_type, neo_hookean_type, yeoh_type
   use rk_parameters, only : parameters_type
   use rk_polynomial, only : polynomial_type
   implicit none
   private

   public :: new_material

   !> Names of the materials
   character(len=*), parameter :: names(5) = ['polynomial   ', 'muscle       ', &
      & 'neo-hookean  ', 'mooney-rivlin', 'yeoh         ']

contains

!> Create a material from its parameters; `model`, one of them, is its name in the list
subroutine new_material(item, parameters, error)
   !> Material
   type(material_item), intent(out) :: item
   !> Model and parameters
   type(parameters_type), intent(inout) :: parameters
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: model

   call parameters%get('model', model, names, error)
   if (allocated(error)) return
   select case (model)
   case ('polynomial')
      allocate (polynomial_type :: item%material)
   case ('muscle')
      allocate (muscle_type :: item%material)
   case ('neo-hookean')
      allocate (neo_hookean_type :: item%material)
   case ('mooney-rivlin')
      allocate (mooney_rivlin_type :: item%material)
   case ('yeoh')
      allocate (yeoh_type :: item%material)
   end select
   item%material%name = parameters%name
   call item%material%set(parameters, error)
   if (allocated(error)) return
   call parameters%check_all_asked(error)
end subroutine new_material

end module rk_material_list
