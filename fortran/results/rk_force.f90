!> Balance of the forces on a body, and of their virtual work with that of the stresses.
!>
!> In equilibrium the stress and the forces do the same work in any smooth virtual displacement, of
!> which the displacement itself is one. A strong form sets the divergence of the stress to zero
!> only in a weighted mean, and in bending the mean hardly shows the error: cantilevers whose tip
!> deflection is 90 % off leave the forces on the ends in balance, but not this work.
module rk_force
   use, intrinsic :: ieee_arithmetic, only : ieee_is_finite
   use rk_conditions, only : conditions_at
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type
   use rk_precision, only : wp
   use rk_programme, only : combined, ramp
   use rk_states, only : field_state, point_state
   implicit none
   private

   public :: set_forces, own_work_mismatch

   !> Forces below this share of those that the stress transmits inside are too small to compare
   real(wp), parameter :: no_force = 1.0e-3_wp

contains

!> Sum of the body force and the forces on all sides of the body with conditions, and the largest of
!> them: the sum is 0 for a body in equilibrium. Unbalanced forces indicate a locked or too coarse
!> solution. Each force is taken from the nearer half of the body: over the whole length between two
!> fixed sets both would be the same mean of all sections, however these differ. A body without
!> external forces, such as a muscle with a free end, has only forces of rounding.
subroutine set_forces(problem, state, left, largest)
   class(discretisation_type), intent(in) :: problem
   type(field_state), intent(in) :: state
   !> Norm of the sum, and largest norm, at least a share of the force inside the body and an error
   !> of the iteration [force]
   real(wp), intent(out) :: left, largest
   type(point_state) :: local
   real(wp) :: total(3), force(3), inside, total_volume, length
   integer :: c, ip, set

   total = state%load*problem%scene%weight
   largest = norm2(total)
   do set = 1, problem%scene%cloud%sides()
      ! loads set point by point may act on any side
      if (.not. (allocated(problem%scene%body_force) &
         & .or. any([(problem%scene%cloud%meets_side(problem%scene%condition(c)%set, set), &
         & c=1, size(problem%scene%condition))]))) cycle
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
      total_volume = sum(cloud%volume)
      length = maxval(maxval(cloud%points, dim=2) - minval(cloud%points, dim=2))
   end associate
   largest = max(largest, no_force*inside/length, &
      & problem%negligible_stress(state)*total_volume/length)
end subroutine set_forces

!> Work of the stress minus that of the forces, over the larger of the forces' work and the integral
!> of |P : grad u|; 0 for a body at rest [-]
real(wp) function own_work_mismatch(problem, state) result(mismatch)
   class(discretisation_type), intent(in) :: problem
   type(field_state), intent(in) :: state
   type(point_state) :: local
   real(wp) :: inside, outside, total, density, force(3)
   integer :: a, c, ip, nd, side

   nd = problem%scene%cloud%nd
   inside = 0.0_wp
   total = 0.0_wp
   outside = 0.0_wp
   associate (cloud => problem%scene%cloud, condition => problem%scene%condition)
      do ip = 1, size(cloud%points, 2)
         call problem%at_point(state, ip, local)
         do a = 1, nd
            local%f(a, a) = local%f(a, a) - 1.0_wp
         end do
         density = sum(local%p(:nd, :nd)*local%f(:nd, :nd))*cloud%volume(ip)
         inside = inside + density
         total = total + abs(density)
      end do
      do side = 1, cloud%sides()
         outside = outside + surface_work(problem, side, state)
      end do
      do c = 1, size(condition)
         if (condition(c)%moves_unevenly()) cycle
         if (.not. any(condition(c)%fixed .and. condition(c)%value%acts())) cycle
         force = problem%set_force(condition(c)%set, state, 1.0_wp)
         outside = outside + state%factor(ramp + condition(c)%amplitude) &
            & *sum(force*condition(c)%value%number, mask=condition(c)%fixed)
      end do
   end associate
   mismatch = 0.0_wp
   total = max(total, abs(outside))
   if (total > 0.0_wp) mismatch = (inside - outside)/total
end function own_work_mismatch

!> Work of prescribed tractions, or of the stress where the displacements of a wall vary
real(wp) function surface_work(problem, side, state) result(work)
   class(discretisation_type), intent(in) :: problem
   !> Side of the body
   integer, intent(in) :: side
   type(field_state), intent(in) :: state
   type(error_type), allocatable :: error
   type(point_state) :: local
   real(wp), dimension(size(state%factor), 3) :: traction, value
   real(wp) :: pull(3)
   logical :: fixed(3), here(size(problem%scene%condition))
   integer :: c, e, i, ip, nd

   nd = problem%scene%cloud%nd
   work = 0.0_wp
   associate (cloud => problem%scene%cloud)
      do e = 1, size(cloud%boundary_point)
         if (cloud%boundary_set(e) /= side) cycle
         here = cloud%in_set(e, problem%scene%condition%set)
         if (.not. any(here)) cycle
         ip = cloud%boundary_point(e)
         call conditions_at(problem%scene, here, cloud%points(:, ip), fixed, &
            & value, traction, error)
         if (allocated(error)) return
         call problem%at_point(state, ip, local)
         pull = [(merge(0.0_wp, combined(traction(:, i), state%factor), fixed(i)), i=1, 3)]
         if (any([(here(c) .and. problem%scene%condition(c)%moves_unevenly(), c=1, size(here))])) &
            & pull(:nd) = pull(:nd) + merge(matmul(local%p(:nd, :nd), cloud%normal(:, e)), 0.0_wp, &
            & fixed(:nd))
         work = work + dot_product(pull(:nd), local%u(:nd))*cloud%area(e)
      end do
   end associate
end function surface_work

end module rk_force
