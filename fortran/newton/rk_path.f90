!> Path of the unknowns through the last converged states, and its extrapolation.
!>
!> The first load step after two states begins on the secant through them. Where steps are solved
!> inexactly, a curve through three or more states at equal distances pays off: every digit that the
!> start lacks costs iterations.
module rk_path
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type, problem_type, stage_type
   implicit none
   private

   public :: path_type

   !> Backward differences of the last states
   type :: path_type
      !> Change of the unknowns with the load in the last step, not allocated before the second one,
      !> shape (n)
      real(wp), allocatable :: slope(:)
      !> Its differences from step to step, where steps are equal: the first one, the difference of
      !> that, shape (n, steps before the last one)
      real(wp), allocatable :: bend(:, :)
      !> Load at which the last step began, where steps are solved inexactly [-]
      real(wp) :: earlier = 0.0_wp
   contains
      procedure :: forget, note, states, at, lead
   end type path_type

   !> Largest number of curvatures that are kept
   integer, parameter :: most = 2
   !> Difference, relative to a step, below which steps count as equal [-]
   real(wp), parameter :: equal = 1.0e-9_wp
   !> Residual of a start, relative to that of the last state, below which fewer states need not be
   !> tried: secants of the leg reduce it by factors of 15 to 35 [-]
   real(wp), parameter :: near = 0.02_wp

contains

!> Forget all: the path continues at another rate, or the prediction failed
pure subroutine forget(self)
   class(path_type), intent(inout) :: self

   if (allocated(self%slope)) deallocate (self%slope)
   if (allocated(self%bend)) deallocate (self%bend)
end subroutine forget

!> Record a converged step
pure subroutine note(self, before, x, done, load, curved)
   class(path_type), intent(inout) :: self
   !> Unknowns before and after the step, shape (n) each
   real(wp), contiguous, intent(in) :: before(:), x(:)
   !> Loads of both [-]
   real(wp), intent(in) :: done, load
   !> Curvatures are wanted beside the secant
   logical, intent(in) :: curved
   real(wp), allocatable :: slope(:), bend(:, :)
   integer :: k, n

   allocate (slope, source=(x - before)/(load - done))
   if (curved) then
      n = 0
      if (abs(load - 2.0_wp*done + self%earlier) <= equal*(load - done)) &
         & n = min(most, self%states())
      allocate (bend(size(x), n))
      do k = 1, n
         if (k == 1) bend(:, 1) = slope - self%slope
         if (k > 1) bend(:, k) = bend(:, k - 1) - self%bend(:, k - 1)
      end do
      call move_alloc(bend, self%bend)
      self%earlier = done
   end if
   call move_alloc(slope, self%slope)
end subroutine note

!> Number of states that determine the path, beside the last one
pure integer function states(self)
   class(path_type), intent(in) :: self

   states = 0
   if (allocated(self%slope)) states = 1
   if (states > 0 .and. allocated(self%bend)) states = 1 + size(self%bend, 2)
end function states

!> Unknowns at a load, extrapolated from some of the states
pure function at(self, x, done, load, states) result(ahead)
   class(path_type), intent(in) :: self
   !> Unknowns of the last state, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Its load [-]
   real(wp), intent(in) :: done
   !> Load [-]
   real(wp), intent(in) :: load
   !> States beside the last one, from 1 on
   integer, intent(in) :: states
   real(wp) :: ahead(size(x)), factor
   integer :: k

   ahead = x + (load - done)*self%slope
   factor = load - done
   do k = 1, states - 1
      factor = factor*(k + (load - done)/(done - self%earlier))/(k + 1)
      ahead = ahead + factor*self%bend(:, k)
   end do
end function at

!> Extrapolate the path from all known states, or from fewer where the residual is not small. If all
!> extrapolations are farther from equilibrium than the last state, none is found, and the problem
!> is linearised elsewhere on return
subroutine lead(self, problem, done, load, x, r, seen, found)
   !> Path with at least one state beside the last one
   class(path_type), intent(in) :: self
   !> Problem, linearised at the last state
   class(problem_type), target, intent(inout) :: problem
   !> Loads of the last state and of the next [-]
   real(wp), intent(in) :: done, load
   !> Unknowns of the last state; the start, if one is found, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> Residuals there, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   !> Evaluation at the last state, on return at the start
   type(evaluation_type), intent(inout) :: seen
   !> A start was found
   logical, intent(out) :: found
   real(wp), allocatable :: ahead(:), new(:)
   real(wp) :: least, size_here
   integer :: best, now, states

   size_here = seen%size
   allocate (new, mold=r)
   least = size_here
   best = 0
   do states = self%states(), 1, -1
      call go_ahead(states)
      if (.not. seen%valid) cycle
      if (.not. seen%size < least) cycle
      least = seen%size
      best = states
      if (least < near*size_here) exit
   end do
   found = best > 0
   if (.not. found) return
   if (now /= best) call go_ahead(best)
   x = ahead
   r = new

contains

   !> Linearise at the extrapolation from some of the states
   subroutine go_ahead(some)
      integer, intent(in) :: some
      type(stage_type) :: stage
      integer :: k

      now = some
      ahead = self%at(x, done, load, some)
      if (.not. problem%inexact) then
         call problem%evaluate(ahead, load, new, seen, tangent=.true.)
         return
      end if
      stage = stage_type(load=load, lifted=load, tangent=.true., &
         & share=(load - done)/(done - self%earlier))
      stage%behind_load = [(done - k*(done - self%earlier), k=0, some)]
      allocate (stage%behind(size(x), some + 1))
      do k = 1, some + 1
         stage%behind(:, k) = self%at(x, done, stage%behind_load(k), some)
      end do
      call problem%assemble(ahead, stage, new, seen)
      if (seen%size < 0.0_wp) seen%size = norm2(new)
   end subroutine go_ahead

end subroutine lead

end module rk_path
