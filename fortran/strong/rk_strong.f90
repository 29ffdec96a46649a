!> What all strong forms share: linear equations at points, and forces from sections of the body.
module rk_strong
   use rk_discretisation, only : discretisation_type
   use rk_lstsq, only : row_operator
   use rk_rows, only : rows_type
   use rk_section_force, only : force_on_set, plane_force, torque_on_set
   use rk_states, only : field_state
   use rk_precision, only : wp
   implicit none
   private

   public :: strong_problem

   !> Collocation problem of a scene
   type, abstract, extends(discretisation_type) :: strong_problem
      !> Linearised rows
      type(rows_type) :: rows
   contains
      procedure :: operator
      procedure :: set_force
      procedure :: section_force
   end type strong_problem

contains

!> Linearised rows
function operator(self) result(op)
   !> Problem
   class(strong_problem), target, intent(in) :: self
   class(row_operator), pointer :: op

   op => self%rows
end function operator

!> Force that the surroundings exert on the body through a set, or its moment
function set_force(self, set, state, share, about) result(force)
   !> Problem
   class(strong_problem), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> State
   type(field_state), intent(in) :: state
   !> Part of the way to the next fixed set that is looked at [-]
   real(wp), intent(in) :: share
   !> Point about which the moment is wanted [length]
   real(wp), intent(in), optional :: about(3)
   real(wp) :: force(3)

   if (present(about)) then
      force = torque_on_set(self, set, state, about)
   else
      force = force_on_set(self, set, state, share)
   end if
end function set_force

!> Force through a plane section
function section_force(self, place, normal, state) result(force)
   !> Problem
   class(strong_problem), intent(in) :: self
   !> Point of the plane, shape (nd) [length]
   real(wp), intent(in) :: place(:)
   !> Its unit normal, shape (nd)
   real(wp), intent(in) :: normal(:)
   !> State
   type(field_state), intent(in) :: state
   real(wp) :: force(3)

   force = plane_force(self, place, normal, state)
end function section_force

end module rk_strong
