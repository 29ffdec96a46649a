!> Damping of steps.
!>
!> Gauss-Newton takes A^T A. Where it diverges, stalls or meets a kink, a multiple lambda of the
!> diagonal is added (Levenberg, Marquardt), which is adapted to the quality of the quadratic model.
!>
!> Reference: Nocedal, Wright, Numerical Optimization, Springer (2006), sections 4.1 and 10.3,
!>            doi:10.1007/978-0-387-40065-5
module rk_damping
   use rk_precision, only : wp
   implicit none
   private

   public :: damping_type

   !> Damping of one load step
   type :: damping_type
      !> Damping in units of the diagonal [-]
      real(wp) :: lambda = 0.0_wp
      !> Least gradient and merit so far
      real(wp), private :: least_gradient = huge(1.0_wp)
      real(wp), private :: least_merit = huge(1.0_wp)
      !> Iterations without progress
      integer, private :: idle = 0
   contains
      procedure :: note, learn, reject, stalled
   end type damping_type

   !> Progress: the least gradient falls below this share of itself, or the least merit by the other
   real(wp), parameter :: gradient_share = 0.9_wp, merit_share = 1.0e-6_wp
   !> Iterations without progress that count as a stall
   integer, parameter :: patience = 6
   !> Quality of the quadratic model below which damping grows, above which it falls
   real(wp), parameter :: poor = 0.25_wp, good = 0.75_wp
   !> Growth of the merit in an undamped step that counts as divergence
   real(wp), parameter :: climb = 0.1_wp
   !> Damping at which it begins, and below which it ends [-]
   real(wp), parameter :: first_lambda = 1.0e-4_wp, last_lambda = 1.0e-10_wp
   !> Growth and fall of the damping
   real(wp), parameter :: growth = 10.0_wp, fall = 0.1_wp

contains

!> Record the progress before an iteration
subroutine note(self, iterations, gradient, merit)
   class(damping_type), intent(inout) :: self
   !> Iterations done in this load step
   integer, intent(in) :: iterations
   !> |A^T r| now
   real(wp), intent(in) :: gradient
   !> |r| now
   real(wp), intent(in) :: merit

   ! the start of a load step lies off the path and is not a measure
   if (iterations == 0) return
   self%idle = self%idle + 1
   if (gradient < gradient_share*self%least_gradient &
      & .or. merit < (1.0_wp - merit_share)*self%least_merit) self%idle = 0
   self%least_gradient = min(self%least_gradient, gradient)
   self%least_merit = min(self%least_merit, merit)
end subroutine note

!> Adapt the damping after an accepted step
subroutine learn(self, scale, gain, predicted, merit, definite)
   class(damping_type), intent(inout) :: self
   !> Step length, 1 for the full step [-]
   real(wp), intent(in) :: scale
   !> Fall of r.r/2
   real(wp), intent(in) :: gain
   !> Its fall by the quadratic model
   real(wp), intent(in) :: predicted
   !> r.r/2 before
   real(wp), intent(in) :: merit
   !> Newton step with a positive definite tangent: it descends in energy, even if the residuals
   !> grow on the way
   logical, intent(in) :: definite

   if (.not. self%lambda > 0.0_wp) then
      ! the merit of Gauss-Newton may grow slightly on its way
      if (scale < 1.0_wp .or. (.not. definite .and. (gain < -climb*merit &
         & .or. 2*self%idle >= patience))) self%lambda = first_lambda
   else if (scale < 1.0_wp .or. gain < poor*predicted) then
      self%lambda = max(first_lambda, growth*self%lambda)
   else if (gain > good*predicted) then
      self%lambda = fall*self%lambda
      if (definite .or. self%lambda < last_lambda) self%lambda = 0.0_wp
   end if
end subroutine learn

!> No step length was acceptable
subroutine reject(self)
   class(damping_type), intent(inout) :: self

   self%lambda = max(first_lambda, growth**2*self%lambda)
end subroutine reject

!> Whether neither gradient nor merit have fallen for a while, as in a cycle
pure logical function stalled(self)
   class(damping_type), intent(in) :: self

   stalled = self%idle >= patience
end function stalled

end module rk_damping
