!> Pressures carried along with the displacements where inexact solves leave a volume error.
!>
!> The volume error of a step must not return as a force K times as large: the next tangent takes
!> the pressures of the solve, and the next solve starts from them. They are linear along the step.
!> A load step starts with pressures extrapolated from the last converged states: with those of the
!> displacements there, the volume error of the displacements would act as a force K times as large.
module rk_carried_pressure
   use rk_precision, only : wp
   implicit none
   private

   public :: carried_pressure, new_carried_pressure

   !> Coefficients of the pressures of all groups
   type :: carried_pressure
      !> Those in the residual, and those that are carried to its place, shape
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

   !> Distance from the line of the last step, relative to its length, that puts a place off it [-]
   real(wp), parameter :: aside = 1.0e-6_wp

contains

!> Allocate the pressures
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

!> Set the place of the next tangent and carry the pressures there: they are linear along the last
!> step, and are not carried elsewhere
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

!> Extrapolate the pressures of the last states to the next place
subroutine extrapolate(self, pressure, share)
   class(carried_pressure), intent(inout) :: self
   !> Pressures of states at equal distances, the latest first, shape (1 + nd, groups, states)
   !> [stress length^(nd/2)]
   real(wp), intent(in) :: pressure(:, :, :)
   !> Distance beyond the last state, as a fraction of that between the last two states [-]
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

!> Record a solve at the last place
subroutine note(self, step, gained)
   class(carried_pressure), intent(inout) :: self
   !> Its displacements, shape (n)
   real(wp), contiguous, intent(in) :: step(:)
   !> Its change of the pressures in the residual, shape (1 + nd, groups)
   !> [stress length^(nd/2)]
   real(wp), intent(in) :: gained(:, :)

   self%begun = self%place
   self%step = step
   self%before = self%present
   self%gained = gained
end subroutine note

end module rk_carried_pressure
