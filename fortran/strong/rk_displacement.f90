!> Strong form collocation of hyperelasticity in displacements (RKCM).
module rk_displacement
   use rk_conditions, only : new_boundary
   use rk_discretisation, only : deformation
   use rk_equilibrium, only : equilibrium_problem, new_equilibrium
   use rk_error, only : error_type
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   use rk_text, only : to_text
   implicit none
   private

   public :: displacement_problem, new_displacement

   !> Collocation problem of a scene
   type, extends(equilibrium_problem) :: displacement_problem
   contains
      procedure :: start_step
      procedure :: renew
      procedure :: advice
   end type displacement_problem

contains

!> Set up the collocation problem of a scene
subroutine new_displacement(self, scene, error)
   !> Problem
   type(displacement_problem), intent(inout) :: self
   !> Scene
   type(scene_type), target, intent(in) :: scene
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: none(scene%cloud%nd, 0)

   call new_equilibrium(self, scene, scene%cloud%nd, none, error)
end subroutine new_displacement

!> Take other loads from the scene; materials are asked at each evaluation
subroutine renew(self, materials, error)
   !> Problem
   class(displacement_problem), intent(inout) :: self
   !> Material parameters have changed as well
   logical, intent(in) :: materials
   !> Error handling: contradicting conditions
   type(error_type), allocatable, intent(out) :: error

   associate (unused => materials)
   end associate
   call new_boundary(self%boundary, self%scene%cloud, self%scene%condition, &
      & self%scene%programme%count(), error)
end subroutine renew

!> Weights of the essential rows (5.52b), from the tangent at the start of the step
subroutine start_step(self, x, load)
   !> Problem
   class(displacement_problem), target, intent(inout) :: self
   !> Unknowns at the start of the step, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load at the end of the step [-]
   real(wp), intent(in) :: load
   real(wp) :: u(self%fields, self%shape%nq), f(3, 3), h(3, 3, 3), p(3, 3)
   real(wp) :: c4(3, 3, 3, 3), factor
   integer :: b, ip, nd

   if (self%scene%solver%weight_essential > 0.0_wp) then
      self%essential_weight = self%scene%solver%weight_essential
      return
   end if
   factor = self%scene%solver%weight_c4
   if (.not. factor > 0.0_wp) factor = real(self%shape%ns, wp)
   nd = self%scene%cloud%nd
   do b = 1, size(self%boundary%point)
      ip = self%boundary%point(b)
      call self%field(ip, x, 1 + nd, u)
      call deformation(nd, u, f, h)
      call self%mixture%tangent(ip, f, load, p, c4, volumetric=.true.)
      self%essential_weight(b) = factor*maxval(abs(c4(:nd, :nd, :nd, :nd)))
   end do
end subroutine start_step

!> What a user can do where steps vanish but the gradient does not, in the words of the deck
function advice(self) result(text)
   !> Problem
   class(displacement_problem), intent(in) :: self
   character(len=:), allocatable :: text

   if (self%scene%has_kinks()) then
      text = 'the published fiber curves have kinks, use curve = "smooth"'
   else
      text = 'rounding outweighs the rest, of a K of '//to_text(self%scene%stiffest_ratio(), 2) &
         & //' shear moduli, use method "rkcm-mixed"'
   end if
end function advice

end module rk_displacement
