!> From the table [linear] of a checked deck to the equation of a scene.
module rk_deck_linear
   use rk_deck, only : deck_type
   use rk_deck_boundary, only : read_conditions
   use rk_error, only : error_type
   use rk_linear, only : set_essential_weight
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   use rk_text, only : to_text
   implicit none
   private

   public :: read_linear

contains

!> Operators, loads and where the solution is prescribed
subroutine read_linear(scene, deck, error)
   !> Scene with points and solver
   type(scene_type), intent(inout) :: scene
   type(deck_type), intent(in) :: deck
   !> Error handling, one line more for each unknown side
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: at, word
   integer :: k

   associate (equation => scene%equation)
      call equation%read(deck, 'linear')
      equation%extent(:scene%cloud%nd) = maxval(scene%cloud%points, dim=2)
      allocate (equation%pin(deck%count('pin')))
      do k = 1, size(equation%pin)
         at = 'pin.'//to_text(k)
         call deck%get_vector(at//'.point', equation%pin(k)%point)
         call deck%get(at//'.components', word)
         equation%pin(k)%fixed = [index(word, 'x') > 0, index(word, 'y') > 0, index(word, 'z') > 0]
      end do
   end associate
   call read_conditions(scene, deck, error)
   if (deck%has('dynamics')) then
      allocate (scene%motion)
      call scene%motion%read(deck, 'dynamics')
      call deck%get('solver.weight_essential', word)
      scene%motion%published = word == 'ns-c4'
   end if
   ! no materials or load steps
   allocate (scene%tissue(0), scene%tissue_of(0))
   scene%load%steps = 1
   scene%load%activation = 0.0_wp
   if (.not. allocated(error)) call set_essential_weight(scene, error)
end subroutine read_linear

end module rk_deck_linear
