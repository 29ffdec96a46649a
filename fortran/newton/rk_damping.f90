!> Which matrix the next iteration uses, and how strongly it is damped.
!>
!> Gauss-Newton takes A^T A, Newton adds the second derivatives of the residuals (5.59). Both may be
!> damped by lambda times their diagonal (Levenberg, Marquardt). Gauss-Newton converges linearly
!> where residuals remain, Newton quadratically, but its matrix is no product A^T A and has half the
!> digits of a QR of A. `auto` begins with Gauss-Newton. It changes over where residuals remain, the
!> steps shrink too slowly and the matrix has digits to spare, and keeps to Newton in the next load
!> step from the second iteration on. A Newton step that is cut, gains less than promised or is no
!> shorter than the one before sends it back, and large problems keep to Gauss-Newton. Where the
!> exact matrix is not positive definite, Gauss-Newton takes the step.
!>
!> Reference: Nocedal, Wright, Numerical Optimization, Springer (2006), sections 4.1 and 10.3,
!>            doi:10.1007/978-0-387-40065-5
module rk_damping
   use rk_precision, only : wp
   implicit none
   private

   public :: damping_type

   !> State of the choice
   type :: damping_type
      !> "gauss-newton", "full" or "auto"
      character(len=:), allocatable :: method
      !> Second derivatives are used
      logical :: curved = .false.
      !> Damping in units of the diagonal [-]
      real(wp) :: lambda = 0.0_wp
      !> The problem is small enough for a dense matrix of second derivatives
      logical :: affordable = .true.
      !> Reciprocal condition of A in the last Gauss-Newton step [-]
      real(wp) :: rcond = 0.0_wp
      !> Relative step of the last iteration [-]
      real(wp), private :: last = 0.0_wp
      !> Least gradient and merit so far
      real(wp), private :: least_gradient = 0.0_wp
      real(wp), private :: least_merit = 0.0_wp
      !> Iterations without progress
      integer, private :: idle = 0
      !> Iterations for which `auto` keeps away from Newton
      integer, private :: barred = 0
      !> Newton ended the last load step
      logical :: trusted = .false.
   contains
      procedure :: start
      !> Choose before an iteration
      procedure :: choose
      !> Learn from its outcome
      procedure :: learn
      procedure :: finish, resume
      !> A trial failed
      procedure :: reject
      !> Nothing moves any more
      procedure :: stalled
   end type damping_type

   !> Gauss-Newton is linear where a step promises less than this share of the merit
   real(wp), parameter :: remains = 0.1_wp
   !> It is slow where more iterations than this are left at its present rate
   real(wp), parameter :: slow = 0.3_wp
   !> A^T A has no digits left below the square of this reciprocal condition of A
   real(wp), parameter :: least_rcond = 1.0e-7_wp
   !> Iterations without Newton after a bad step of his
   integer, parameter :: rest = 3
   !> Progress: the least gradient falls below this share, or the least merit by the other one
   real(wp), parameter :: gradient_share = 0.9_wp, merit_share = 1.0e-6_wp
   !> Iterations without progress that make a stall
   integer, parameter :: patience = 6
   !> Quality of the quadratic model below which damping grows, above which it falls
   real(wp), parameter :: poor = 0.25_wp, good = 0.75_wp
   !> Growth of the merit in an undamped Gauss-Newton step that means divergence
   real(wp), parameter :: climb = 0.1_wp
   !> Damping where it begins, and where it ends [-]
   real(wp), parameter :: first_lambda = 1.0e-4_wp, last_lambda = 1.0e-10_wp
   !> Growth and fall of the damping
   real(wp), parameter :: growth = 10.0_wp, fall = 0.1_wp

contains

subroutine start(self)
   class(damping_type), intent(inout) :: self

   ! the last load step failed
   if (self%last < huge(1.0_wp)) self%trusted = .false.
   self%curved = self%method == 'full'
   self%lambda = 0.0_wp
   self%idle = 0
   self%barred = 0
   self%last = huge(1.0_wp)
   self%least_gradient = huge(1.0_wp)
   self%least_merit = huge(1.0_wp)
end subroutine start

!> End a load step that converged
subroutine finish(self)
   class(damping_type), intent(inout) :: self

   self%trusted = self%curved
   self%last = huge(1.0_wp)
end subroutine finish

!> Go on behind a load step of another run
subroutine resume(self, rcond, trusted)
   class(damping_type), intent(inout) :: self
   !> Reciprocal condition of its last Gauss-Newton matrix [-]
   real(wp), intent(in) :: rcond
   !> Newton ended it
   logical, intent(in) :: trusted

   self%rcond = rcond
   self%trusted = trusted
   self%last = huge(1.0_wp)
end subroutine resume

!> Choose the matrix of the next iteration
subroutine choose(self, iterations, gradient, merit, step_norm, tolerance, left)
   class(damping_type), intent(inout) :: self
   !> Iterations done in this load step
   integer, intent(in) :: iterations
   !> |A^T r| now
   real(wp), intent(in) :: gradient
   !> |r| now
   real(wp), intent(in) :: merit
   !> Relative step of the last iteration, and where it shall end [-]
   real(wp), intent(in) :: step_norm, tolerance
   !> Fall of the merit that it promised, of the merit [-]
   real(wp), intent(in) :: left

   self%idle = self%idle + 1
   ! the start of a load step lies off the path and is no measure
   if (iterations > 1 .and. (gradient < gradient_share*self%least_gradient &
      & .or. merit < (1.0_wp - merit_share)*self%least_merit)) self%idle = 0
   if (iterations > 0) then
      self%least_gradient = min(self%least_gradient, gradient)
      self%least_merit = min(self%least_merit, merit)
   end if
   if (self%method == 'auto') then
      if (self%curved .and. .not. step_norm < self%last) call bar(self)
      self%curved = iterations > 0 .and. self%barred == 0 .and. self%affordable &
         & .and. self%rcond > least_rcond
      ! the first step of a load step is a jump and says nothing about the rate
      if (self%curved .and. .not. self%trusted) then
         self%curved = iterations > 2 .and. left < remains .and. step_norm > tolerance
         if (self%curved) self%curved = log(tolerance/step_norm) &
            & < slow*log(min(step_norm/self%last, 1.0_wp))
      end if
      if (self%curved) self%trusted = .true.
      self%barred = max(self%barred - 1, 0)
   end if
   self%last = step_norm
end subroutine choose

!> Keep away from Newton for a while
subroutine bar(self)
   type(damping_type), intent(inout) :: self

   self%trusted = .false.
   self%curved = .false.
   self%barred = rest
end subroutine bar

!> Adapt the damping after an accepted step
subroutine learn(self, newton, scale, gain, predicted, merit)
   class(damping_type), intent(inout) :: self
   !> The step was Newton's
   logical, intent(in) :: newton
   !> Step length, 1 for the full step [-]
   real(wp), intent(in) :: scale
   !> Fall of r.r/2
   real(wp), intent(in) :: gain
   !> Its fall by the quadratic model
   real(wp), intent(in) :: predicted
   !> r.r/2 before
   real(wp), intent(in) :: merit

   if (newton .and. self%method == 'auto' .and. .not. self%lambda > 0.0_wp) then
      if (scale < 1.0_wp .or. gain < poor*predicted) call bar(self)
   else if (.not. newton .and. .not. self%lambda > 0.0_wp) then
      ! Gauss-Newton may climb a little on its way
      if (scale < 1.0_wp .or. gain < -climb*merit .or. 2*self%idle >= patience) &
         & self%lambda = first_lambda
   else if (scale < 1.0_wp .or. gain < poor*predicted) then
      self%lambda = max(first_lambda, growth*self%lambda)
   else if (gain > good*predicted) then
      self%lambda = fall*self%lambda
      if (self%lambda < last_lambda) self%lambda = 0.0_wp
   end if
end subroutine learn

!> No step length was acceptable
subroutine reject(self)
   class(damping_type), intent(inout) :: self

   if (self%method == 'auto' .and. self%curved .and. .not. self%lambda > 0.0_wp) then
      call bar(self)
   else
      self%lambda = max(first_lambda, growth**2*self%lambda)
   end if
end subroutine reject

!> Whether neither gradient nor merit have fallen for a while, as in a cycle
pure logical function stalled(self)
   class(damping_type), intent(in) :: self

   stalled = self%idle >= patience
end function stalled

end module rk_damping
