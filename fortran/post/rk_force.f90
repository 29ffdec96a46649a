!> Balance of the forces on a body.
module rk_force
   use rk_discretisation, only : discretisation_type
   use rk_precision, only : wp
   use rk_states, only : field_state
   implicit none
   private

   public :: set_forces

contains

!> Sum of the forces on all boundary sets with conditions, and the largest of them: the sum is 0 for
!> a body in equilibrium. Forces that do not balance are the sign of a locked or too coarse
!> solution. Each is
!> taken from the nearer half of the body: over the whole length between two fixed sets both would
!> be the same mean of all sections, however these differ.
subroutine set_forces(problem, state, left, largest)
   !> Full problem
   class(discretisation_type), intent(in) :: problem
   !> State
   type(field_state), intent(in) :: state
   !> Norm of the sum, and the largest norm [force]
   real(wp), intent(out) :: left, largest
   real(wp) :: total(3), force(3)
   integer :: set

   total = 0.0_wp
   largest = 0.0_wp
   do set = 1, size(problem%scene%cloud%set_names)
      if (.not. any(problem%scene%condition%set == set)) cycle
      force = problem%set_force(set, state, 0.5_wp)
      total = total + force
      largest = max(largest, norm2(force))
   end do
   left = norm2(total)
end subroutine set_forces

end module rk_force
