!> Which matrix the next iteration uses, and how strongly it is damped.
!>
!> Gauss-Newton takes A^T A, Newton adds the second derivatives of the residuals (5.59). Both may be
!> damped by lambda times their diagonal (Levenberg, Marquardt). Gauss-Newton converges linearly
!> where residuals remain, Newton quadratically. `auto` changes over where that shows and the exact
!> matrix is positive definite; where it is not, Gauss-Newton is the better guide.
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
      !> Gradient of the last iteration; least gradient and merit so far
      real(wp), private :: last = 0.0_wp
      real(wp), private :: least_gradient = 0.0_wp
      real(wp), private :: least_merit = 0.0_wp
      !> Iterations without progress
      integer, private :: idle = 0
   contains
      !> Begin a load step
      procedure :: start
      !> Choose before an iteration
      procedure :: choose
      !> Learn from its outcome
      procedure :: learn
      !> The damped step has arrived; see whether a whole one would move
      procedure :: release
      !> A trial failed
      procedure :: reject
      !> Nothing moves any more
      procedure :: stalled
   end type damping_type

   !> Gauss-Newton is fast where the gradient falls by this factor in an iteration
   real(wp), parameter :: fast = 0.2_wp
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

!> Begin a load step. `auto` keeps to Newton where the last step needed it.
subroutine start(self)
   !> Choice
   class(damping_type), intent(inout) :: self

   self%curved = self%method == 'full' .or. (self%method == 'auto' .and. self%curved)
   self%lambda = 0.0_wp
   self%idle = 0
   self%last = huge(1.0_wp)
   self%least_gradient = huge(1.0_wp)
   self%least_merit = huge(1.0_wp)
end subroutine start

!> Choose the matrix of the next iteration
subroutine choose(self, iterations, gradient, merit)
   !> Choice
   class(damping_type), intent(inout) :: self
   !> Iterations done in this load step
   integer, intent(in) :: iterations
   !> |A^T r| now
   real(wp), intent(in) :: gradient
   !> |r| now
   real(wp), intent(in) :: merit

   self%idle = self%idle + 1
   ! the start of a load step lies off the path and is no measure
   if (iterations > 1 .and. (gradient < gradient_share*self%least_gradient &
      & .or. merit < (1.0_wp - merit_share)*self%least_merit)) self%idle = 0
   if (iterations > 0) then
      self%least_gradient = min(self%least_gradient, gradient)
      self%least_merit = min(self%least_merit, merit)
   end if
   if (iterations > 1 .and. self%method == 'auto' .and. gradient > fast*self%last) &
      & self%curved = .true.
   self%last = gradient
end subroutine choose

!> Adapt the damping after an accepted step
subroutine learn(self, newton, scale, gain, predicted, merit)
   !> Choice
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

   if (.not. newton .and. .not. self%lambda > 0.0_wp) then
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

!> Damping is over
subroutine release(self)
   !> Choice
   class(damping_type), intent(inout) :: self

   self%lambda = 0.0_wp
end subroutine release

!> No step length was acceptable
subroutine reject(self)
   !> Choice
   class(damping_type), intent(inout) :: self

   self%lambda = max(first_lambda, growth**2*self%lambda)
end subroutine reject

!> Whether neither gradient nor merit have fallen for a while, as in a cycle
pure logical function stalled(self)
   !> Choice
   class(damping_type), intent(in) :: self

   stalled = self%idle >= patience
end function stalled

end module rk_damping
