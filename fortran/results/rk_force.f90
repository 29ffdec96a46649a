!> Balance of the forces on a body.
module rk_force
   use, intrinsic :: ieee_arithmetic, only : ieee_is_finite
   use rk_discretisation, only : discretisation_type
   use rk_precision, only : wp
   use rk_states, only : field_state, point_state
   implicit none
   private

   public :: set_forces

   !> Forces below this share of those that the stress transmits inside are none to compare with
   real(wp), parameter :: no_force = 1.0e-3_wp

contains

!> Sum of the forces on all sides of the body with conditions, and the largest of them: the sum is 0
!> for a body in equilibrium. Forces that do not balance are the sign of a locked or too coarse
!> solution. Each is taken from the nearer half of the body: over the whole length between two fixed
!> sets both would be the same mean of all sections, however these differ. A body that nothing pulls
!> at, such as a muscle with a free end, has forces of rounding only.
subroutine set_forces(problem, state, left, largest)
   class(discretisation_type), intent(in) :: problem
   type(field_state), intent(in) :: state
   !> Norm of the sum, and the largest norm, at least a share of what the stress transmits [force]
   real(wp), intent(out) :: left, largest
   type(point_state) :: local
   real(wp) :: total(3), force(3), inside
   integer :: c, ip, set

   total = 0.0_wp
   largest = 0.0_wp
   do set = 1, problem%scene%cloud%sides()
      if (.not. any([(problem%scene%cloud%meets_side(problem%scene%condition(c)%set, set), &
         & c=1, size(problem%scene%condition))])) cycle
      force = problem%set_force(set, state, 0.5_wp)
      total = total + force
      largest = max(largest, norm2(force))
   end do
   left = norm2(total)
   inside = 0.0_wp
   associate (cloud => problem%scene%cloud)
      do ip = 1, size(cloud%points, 2)
         call problem%at_point(state, ip, local)
         if (ieee_is_finite(norm2(local%p))) inside = inside + cloud%volume(ip)*norm2(local%p)
      end do
      inside = inside/maxval(maxval(cloud%points, dim=2) - minval(cloud%points, dim=2))
   end associate
   largest = max(largest, no_force*inside)
end subroutine set_forces

end module rk_force
