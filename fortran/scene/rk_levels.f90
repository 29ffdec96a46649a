!> Activation as a field: the part of its muscle's activation that each place has.
module rk_levels
   use rk_error, only : error_type, fatal_error, err_input
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   use rk_text, only : to_text
   implicit none
   private

   public :: has_levels, find_level

contains

!> Whether activations vary within muscles
pure logical function has_levels(scene)
   type(scene_type), intent(in) :: scene
   integer :: k

   has_levels = allocated(scene%cloud%activation) &
      & .or. any([(scene%tissue(k)%level%given(), k=1, size(scene%tissue))])
end function has_levels

!> Part of its activation that a muscle has at a place
subroutine find_level(scene, tissue, point, place, level, error)
   type(scene_type), intent(in) :: scene
   !> Muscle
   integer, intent(in) :: tissue
   !> Collocation point whose fibers it has there
   integer, intent(in) :: point
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: place(:)
   !> Part, from 0 to 1 [-]
   real(wp), intent(out) :: level
   !> Error handling: an expression without a value there, or with one out of range
   type(error_type), allocatable, intent(inout) :: error

   level = 1.0_wp
   associate (given => scene%tissue(tissue)%level)
      if (given%given()) then
         call given%at(place, level, error)
         if (allocated(error) .or. (level >= 0.0_wp .and. level <= 1.0_wp)) return
         call fatal_error(error, err_input, given%where//": '"//given%text//"' is " &
            & //to_text(level)//' at '//to_text(place)//', but must be between 0 and 1')
      else if (allocated(scene%cloud%activation)) then
         level = scene%cloud%activation(point)
      end if
   end associate
end subroutine find_level

end module rk_levels
