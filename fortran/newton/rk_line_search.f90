!> Longest step along a direction that keeps J > 0 and lowers the residual.
!>
!> References: Nocedal, Wright, Numerical Optimization, Springer (2006), section 3.1,
!>             doi:10.1007/978-0-387-40065-5
!>             Grippo, Lampariello, Lucidi, A nonmonotone line search technique for Newton's
!>             method, SIAM J. Numer. Anal. 23 (1986), doi:10.1137/0723046
module rk_line_search
   use rk_precision, only : wp
   use rk_problem, only : problem_type, evaluation_type
   implicit none
   private

   public :: search

   !> Largest number of step halvings
   integer, parameter :: max_cuts = 8
   !> Growth of the residual after the first iteration that counts as divergence
   real(wp), parameter :: growth = 4.0_wp
   !> Share of the fall predicted by the slope that a downhill step must achieve
   real(wp), parameter :: armijo = 1.0e-4_wp
   !> Rounding error of the merit, relative to it
   real(wp), parameter :: rounding = 1.0e-12_wp

contains

!> Halve a step until it is acceptable. Prescribed displacements jump in the first iteration of a
!> load step, where a growing merit does not indicate divergence: that step is accepted unchecked.
subroutine search(problem, load, a, da, r, slope, highest, blind, downhill, ahead, trial, new, &
   & scale, gain, state)
   !> Problem, linearised at the trial afterwards unless it is square
   class(problem_type), target, intent(inout) :: problem
   !> Load [-]
   real(wp), intent(in) :: load
   !> Unknowns and step, shape (n)
   real(wp), contiguous, intent(in) :: a(:), da(:)
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> Derivative of r.r/2 along the step
   real(wp), intent(in) :: slope
   !> |r| to which its growth is compared, at least that of r
   real(wp), intent(in) :: highest
   !> Accept any valid state
   logical, intent(in) :: blind
   !> The merit must fall; otherwise it may grow slightly, as in Gauss-Newton
   logical, intent(in) :: downhill
   !> Linearise a square problem at the end of the full step
   logical, intent(in) :: ahead
   !> Unknowns reached, shape (n)
   real(wp), contiguous, intent(inout) :: trial(:)
   !> Their residuals, shape (m)
   real(wp), contiguous, intent(inout) :: new(:)
   !> Accepted step length, 0 if there is none [-]
   real(wp), intent(out) :: scale
   !> Fall of r.r/2
   real(wp), intent(out) :: gain
   !> Evaluation at the trial
   type(evaluation_type), intent(out) :: state
   real(wp) :: merit
   integer :: cut
   logical :: accepted

   merit = 0.5_wp*dot_product(r, r)
   scale = 1.0_wp
   do cut = 0, max_cuts
      trial = a + scale*da
      call problem%evaluate(trial, load, new, state, tangent=.not. problem%square &
         & .or. (ahead .and. cut == 0))
      ! as a product of differences, which stays accurate where the merit hardly changes
      gain = 0.5_wp*sum((r - new)*(r + new))
      if (blind) then
         accepted = .true.
      else if (downhill) then
         accepted = gain >= -armijo*scale*slope - rounding*merit
      else
         accepted = merit - gain <= 0.5_wp*(growth*highest)**2
      end if
      if (state%valid .and. accepted) return
      scale = 0.5_wp*scale
   end do
   scale = 0.0_wp
end subroutine search

end module rk_line_search
