!> Whether a stationary point of r.r/2 is a minimum, and a way down where it is none.
!>
!> The matrix of second derivatives is N + S with N = A^T A and S the sum of r_i times the second
!> derivatives of r_i. Where residuals remain, S may outweigh N in a direction that N hardly sees:
!> the gradient vanishes, and yet other states fulfil the equations better. Newton's method ends
!> there as readily as at a minimum. Gauss-Newton is driven away, by the factor mu of the largest
!> eigenvalue of -S v = mu N v in each iteration, but from a start without a part in v, as one of
!> a symmetric body, it takes rounding and luck which of its iterations ends at the saddle.
!>
!> The matrix is indefinite where mu > 1. Lanczos' method finds mu with the factor of N from the
!> last iteration, from below, so that a value above 1 is certain; and a curvature that the
!> rounding of an ill-conditioned factor made up is seen from the lengths of A v and S v themselves.
!>
!> Reference: Bjorck, Numerical Methods for Least Squares Problems, SIAM (1996), chapter 9,
!>            doi:10.1137/1.9781611971484 (when Gauss-Newton converges, and to what)
module rk_minimum
   use rk_envelope, only : envelope_type
   use rk_error, only : error_type
   use rk_lapack, only : largest_eigenpair
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type, problem_type
   implicit none
   private

   public :: find_descent, leave_saddle

   !> Steps of Lanczos' method, at most and before the search may end
   integer, parameter :: steps = 16, least_steps = 4
   !> Eigenvalue from which on a point is a saddle [-]
   real(wp), parameter :: indefinite = 1.001_wp
   !> Error of the eigenvalue at which its vector is good enough to go along [-]
   real(wp), parameter :: close = 0.1_wp
   !> First step off a saddle, of the state; doublings of it until r.r/2 falls, and all
   real(wp), parameter :: first_move = 1.0e-3_wp
   integer, parameter :: first_doublings = 12, doublings = 30
   !> Least fall of r.r/2 that is worth the way, of it: rounding of stiff residuals lies below
   real(wp), parameter :: worth = 1.0e-9_wp
   !> Fractional part of the golden ratio: its multiples are spread evenly
   real(wp), parameter :: golden = 0.6180339887498949_wp

contains

!> Direction in which r.r/2 curves down at a stationary point
subroutine find_descent(problem, factor, ready, x, load, r, saddle, v)
   !> Problem, linearised at x
   class(problem_type), target, intent(inout) :: problem
   !> Factor of A^T A near x
   type(envelope_type), intent(inout) :: factor
   !> The factor is there; otherwise it is made here
   logical, intent(in) :: ready
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> There is such a direction
   logical, intent(out) :: saddle
   !> Direction, shape (n)
   real(wp), contiguous, intent(inout) :: v(:)
   type(error_type), allocatable :: error
   real(wp), allocatable :: q(:, :), p(:, :), s(:, :), image(:)
   real(wp) :: alpha(steps), beta(steps), part(steps), value, mu
   integer :: i, j, k, n

   saddle = .false.
   if (.not. problem%curved) return
   if (.not. ready) then
      call problem%linearised%envelope(factor, error)
      if (allocated(error)) return
      call factor%equilibrate()
      if (.not. all(factor%scale > 0.0_wp)) return
      call factor%factorise(error)
      ! as good as singular: a minimum cannot be distinguished from a saddle
      if (allocated(error)) return
   end if
   call problem%hessian(x, load, r)
   ! vectors q, N q and S q; a start with a part in every direction
   n = problem%n
   allocate (q(n, steps), p(n, steps + 1), s(n, steps), image(problem%m))
   p(:, 1) = factor%scale*[(0.5_wp - modulo(golden*i, 1.0_wp), i=1, n)]
   call solve_normal(p(:, 1), v)
   value = sqrt(abs(dot_product(p(:, 1), v)))
   do k = 1, steps
      ! a comparison that a NaN fails
      if (.not. value > 0.0_wp) return
      q(:, k) = v/value
      p(:, k) = p(:, k)/value
      call problem%apply_curvature(q(:, k), s(:, k))
      p(:, k + 1) = -s(:, k)
      alpha(k) = dot_product(q(:, k), p(:, k + 1))
      ! against all earlier ones: a few sums for vectors that stay orthogonal
      do j = 1, k
         p(:, k + 1) = p(:, k + 1) - dot_product(q(:, j), p(:, k + 1))*p(:, j)
      end do
      call largest_eigenpair(alpha(:k), beta(:k - 1), mu, part(:k))
      call solve_normal(p(:, k + 1), v)
      beta(k) = sqrt(abs(dot_product(p(:, k + 1), v)))
      if (mu > indefinite .and. beta(k)*abs(part(k)) < close*mu) exit
      if (k >= least_steps .and. mu + 2.0_wp*beta(k)*abs(part(k)) < 1.0_wp) return
      value = beta(k)
   end do
   if (.not. mu > indefinite) return
   k = min(k, steps)
   v = matmul(q(:, :k), part(:k))
   call problem%linearised%apply(v, image)
   value = -dot_product(v, matmul(s(:, :k), part(:k)))
   saddle = value > indefinite*sum(image**2)
   ! both ways lead down; the one taken must not hang on rounding
   if (sum([(0.5_wp - modulo(golden*i, 1.0_wp), i=1, n)]*v) < 0.0_wp) v = -v

contains

   !> Solve N y = b
   subroutine solve_normal(b, y)
      real(wp), contiguous, intent(in) :: b(:)
      real(wp), contiguous, intent(inout) :: y(:)

      y = b/factor%scale
      call factor%solve(y)
      y = y/factor%scale
   end subroutine solve_normal

end subroutine find_descent

!> Go down a direction as long as r.r/2 falls
subroutine leave_saddle(problem, load, v, x, r, state, left)
   !> Problem, linearised at x before and after
   class(problem_type), target, intent(inout) :: problem
   !> Load [-]
   real(wp), intent(in) :: load
   !> Direction, shape (n)
   real(wp), contiguous, intent(in) :: v(:)
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> Residuals, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   type(evaluation_type), intent(inout) :: state
   !> The saddle was left; otherwise nothing has changed
   logical, intent(out) :: left
   type(evaluation_type) :: seen
   real(wp), allocatable :: trial(:), new(:)
   real(wp) :: step, gain, best, merit
   integer :: k

   allocate (trial, mold=x)
   allocate (new, mold=r)
   merit = 0.5_wp*sum(r**2)
   best = worth*merit
   step = first_move*norm2(x)/norm2(v)
   left = .false.
   do k = 0, doublings
      trial = x + 2.0_wp**k*step*v
      call problem%evaluate(trial, load, new, seen)
      gain = 0.5_wp*sum((r - new)*(r + new))
      if (.not. (seen%valid .and. gain > best)) then
         if (left .or. k == first_doublings) exit
         cycle
      end if
      left = .true.
      best = gain
   end do
   if (left) x = x + 2.0_wp**(k - 1)*step*v
   if (left) call problem%evaluate(x, load, r, state, tangent=.true.)
end subroutine leave_saddle

end module rk_minimum
