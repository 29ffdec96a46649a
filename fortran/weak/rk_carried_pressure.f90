!> Pressures beside the displacements of an iteration whose solves leave some change of volume.
!>
!> What a step leaves of volume must not come back as K times as large a force: the next tangent
!> takes the pressures of the solve, and the next solve begins with them. On the step they are
!> linear. The start of a load step has those of the curve through the last converged states: with
!> its own, what the displacements there miss of the volume would be a force of K times as much.
module rk_carried_pressure
   use rk_precision, only : wp
   implicit none
   private

   public :: carried_pressure, new_carried_pressure

   !> Coefficients of the pressures of all groups
   type :: carried_pressure
      !> Those that the residual has, and those that are carried to its place, shape
      !> (1 + nd, groups) [stress length^(nd/2)]
      real(wp), allocatable :: present(:, :)
      real(wp), allocatable :: carried(:, :)
      !> Pressures are carried to the place of the linearisation
      logical :: carrying = .false.
      !> The next place is the one to which pressures were extrapolated
      logical, private :: foreseen = .false.
      !> Place of the linearisation, shape (n)
      real(wp), allocatable, private :: place(:)
      !> Place, step and pressures of the last solve in this load step, and their change
      real(wp), allocatable, private :: begun(:), step(:), before(:, :), gained(:, :)
   contains
      procedure :: forget, go_to, extrapolate, note
   end type carried_pressure

   !> Distance from the last step, of its length, at which a place is not on it [-]
   real(wp), parameter :: aside = 1.0e-6_wp

contains

!> Make room
subroutine new_carried_pressure(self, rows, groups)
   type(carried_pressure), intent(out) :: self
   !> Coefficients of a group, and groups
   integer, intent(in) :: rows, groups

   allocate (self%present(rows, groups), self%carried(rows, groups), source=0.0_wp)
end subroutine new_carried_pressure

!> Begin a load step: nothing is carried from the last one
subroutine forget(self)
   class(carried_pressure), intent(inout) :: self

   self%foreseen = .false.
   if (allocated(self%step)) deallocate (self%begun, self%step, self%before, self%gained)
end subroutine forget

!> Note where the tangent is taken next, and carry the pressures there: on the last step they are
!> linear, elsewhere there are none to carry
subroutine go_to(self, x)
   class(carried_pressure), intent(inout) :: self
   !> Place, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   real(wp) :: along

   self%place = x
   self%carrying = self%foreseen
   self%foreseen = .false.
   if (self%carrying .or. .not. allocated(self%step)) return
   along = dot_product(x - self%begun, self%step)/max(norm2(self%step)**2, tiny(1.0_wp))
   self%carrying = norm2(x - self%begun - along*self%step) <= aside*norm2(self%step)
   if (self%carrying) self%carried = self%before + along*self%gained
end subroutine go_to

!> Carry pressures to the next place along the curve through those of the last states
subroutine extrapolate(self, pressure, share)
   class(carried_pressure), intent(inout) :: self
   !> Pressures of states at equal distances, the latest first, shape (1 + nd, groups, states)
   !> [stress length^(nd/2)]
   real(wp), intent(in) :: pressure(:, :, :)
   !> Way beyond the last state, of that from the one before to it [-]
   real(wp), intent(in) :: share
   real(wp) :: change(size(pressure, 1), size(pressure, 2), size(pressure, 3)), factor
   integer :: k, n

   ! Newton's backward differences
   n = size(pressure, 3)
   change = pressure
   self%carried = change(:, :, 1)
   factor = 1.0_wp
   do k = 1, n - 1
      change(:, :, :n - k) = change(:, :, :n - k) - change(:, :, 2:n - k + 1)
      factor = factor*(share + k - 1)/k
      self%carried = self%carried + factor*change(:, :, 1)
   end do
   self%foreseen = .true.
end subroutine extrapolate

!> Note a solve at the last place
subroutine note(self, step, gained)
   class(carried_pressure), intent(inout) :: self
   !> Its displacements, shape (n)
   real(wp), contiguous, intent(in) :: step(:)
   !> Its change of the pressures that the residual has, shape (1 + nd, groups)
   !> [stress length^(nd/2)]
   real(wp), intent(in) :: gained(:, :)

   self%begun = self%place
   self%step = step
   self%before = self%present
   self%gained = gained
end subroutine note

end module rk_carried_pressure
