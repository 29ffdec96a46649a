!> Galerkin reduction (6.27)-(6.31): equilibrium of a form that has an energy, in the span of modes.
!>
!> With modes V, orthonormal, the energy E(V a) has the residual V^T r(V a) and the tangent V^T K V.
!> Both are assembled in full and then projected, so that the volume is projected as in the full
!> problem, and essential values are lifted and held by the penalty there. The pressures stay linear
!> in Newton's step as well: every state of the iteration passes through the full problem.
!>
!> Reference: Kunisch, Volkwein, Numer. Math. 90 (2001), doi:10.1007/s002110100282
module rk_reduced_galerkin
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type
   use rk_lapack, only : solve_qr
   use rk_matrix, only : matrix_rows
   use rk_operator, only : row_operator, square_report
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type, problem_type
   implicit none
   private

   public :: reduced_galerkin, new_reduced_galerkin

   !> A problem with an energy in the span of modes; unknowns are the modes' amplitudes
   type, extends(problem_type) :: reduced_galerkin
      private
      !> Full problem
      class(discretisation_type), pointer :: full => null()
      !> Orthonormal modes, shape (full n, r)
      real(wp), allocatable :: modes(:, :)
      !> Residual of the full problem, shape (full n) [force]
      real(wp), allocatable :: residual(:)
      !> Projected tangent, shape (r, r)
      type(matrix_rows) :: tangent
   contains
      procedure :: start_step
      procedure :: evaluate
      procedure :: linearise
      procedure :: predict
      procedure :: start_iteration
      procedure :: operator
      procedure :: square_step
      procedure :: advice
   end type reduced_galerkin

contains

!> Project a full problem on modes
subroutine new_reduced_galerkin(self, full, modes)
   !> Reduced problem; the full one must outlive it, and serves it in each of its evaluations
   type(reduced_galerkin), intent(inout) :: self
   !> Full problem, whose residuals are the derivative of an energy
   class(discretisation_type), target, intent(inout) :: full
   !> Orthonormal modes, shape (full n, r)
   real(wp), intent(in) :: modes(:, :)

   self%full => full
   self%modes = modes
   self%n = size(modes, 2)
   self%m = self%n
   ! amplitudes of orthonormal modes have the norm of the unknowns they stand for
   self%extent = full%extent
   self%costly = full%costly
   allocate (self%residual(full%n))
   allocate (self%tangent%a(self%n, self%n))
   self%tangent%m = self%n
   self%tangent%n = self%n
end subroutine new_reduced_galerkin

!> Forget where the last step came from
subroutine start_step(self, x, load)
   !> Problem
   class(reduced_galerkin), target, intent(inout) :: self
   !> Amplitudes at the start of the step, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load at the end of the step [-]
   real(wp), intent(in) :: load

   call self%full%start_step(matmul(self%modes, x), load)
end subroutine start_step

!> Projected residual
subroutine evaluate(self, x, load, r, seen)
   !> Problem
   class(reduced_galerkin), target, intent(inout) :: self
   !> Amplitudes, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (r)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   call self%full%evaluate(matmul(self%modes, x), load, self%residual, seen)
   r = matmul(self%residual, self%modes)
end subroutine evaluate

!> Projected residual and tangent
subroutine linearise(self, x, load, r, seen)
   !> Problem
   class(reduced_galerkin), target, intent(inout) :: self
   !> Amplitudes, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (r)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   call self%full%linearise(matmul(self%modes, x), load, self%residual, seen)
   call project(self, r, seen)
end subroutine linearise

!> Projected residual and tangent at the start of a load step
subroutine predict(self, x, done, load, residuals, r, seen)
   !> Problem
   class(reduced_galerkin), target, intent(inout) :: self
   !> Amplitudes of the last converged state, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Its load [-]
   real(wp), intent(in) :: done
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals will do: the tangent may stay what it was
   logical, intent(in) :: residuals
   !> Residuals, shape (r)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   call self%full%predict(matmul(self%modes, x), done, load, residuals, self%residual, seen)
   if (residuals) then
      r = matmul(self%residual, self%modes)
   else
      call project(self, r, seen)
   end if
end subroutine predict

!> V^T r and V^T K V of the full problem as it was linearised last
subroutine project(self, r, seen)
   !> Problem
   class(reduced_galerkin), target, intent(inout) :: self
   !> Residuals, shape (r)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(in) :: seen
   class(row_operator), pointer :: full_tangent
   real(wp), allocatable :: image(:)
   integer :: j

   r = matmul(self%residual, self%modes)
   ! no tangent exists; the caller rejects the state
   if (.not. seen%valid) return
   full_tangent => self%full%operator()
   allocate (image(self%full%n))
   do j = 1, self%n
      call full_tangent%apply(self%modes(:, j), image)
      self%tangent%a(:, j) = matmul(image, self%modes)
   end do
end subroutine project

!> The volume of the next tangent is linear in the step from here
subroutine start_iteration(self)
   !> Problem, linearised
   class(reduced_galerkin), intent(inout) :: self

   call self%full%start_iteration()
end subroutine start_iteration

!> Projected tangent
function operator(self) result(op)
   !> Problem, linearised
   class(reduced_galerkin), target, intent(in) :: self
   class(row_operator), pointer :: op

   op => self%tangent
end function operator

!> Newton's step by the projected tangent, which need not be positive definite
subroutine square_step(self, shift, r, dx, found, report, error)
   !> Problem, linearised
   class(reduced_galerkin), target, intent(inout) :: self
   !> Damping in units of the diagonal, >= 0 [-]
   real(wp), intent(in) :: shift
   !> Residuals, shape (r)
   real(wp), contiguous, intent(in) :: r(:)
   !> Step, shape (r)
   real(wp), contiguous, intent(inout) :: dx(:)
   !> Always
   logical, intent(out) :: found
   !> What was used and how good it is
   type(square_report), intent(out) :: report
   !> Error handling: singular matrix
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: a(:, :), factor(:, :)
   integer :: j

   found = .true.
   allocate (a, source=self%tangent%a)
   do j = 1, self%n
      a(j, j) = a(j, j) + shift*abs(a(j, j))
   end do
   allocate (factor, source=a)
   dx = -r
   call solve_qr(factor, dx, report%rcond, error)
   if (allocated(error)) return
   report%backward_error = norm2(matmul(a, dx) + r) &
      & /max(norm2(a)*norm2(dx) + norm2(r), tiny(1.0_wp))
   report%used = 'projected'
   report%why = 'the tangent in the span of a few modes is small and dense'
end subroutine square_step

!> What a user can do where steps vanish but the gradient does not, in the words of the deck
function advice(self) result(text)
   !> Problem
   class(reduced_galerkin), intent(in) :: self
   character(len=:), allocatable :: text

   text = self%full%advice()
end function advice

end module rk_reduced_galerkin
