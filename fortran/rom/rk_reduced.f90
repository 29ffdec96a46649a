!> A problem in the span of modes: least squares Galerkin reduction (6.60)-(6.67) of rows,
!> which ends by (6.68), (6.69), or projection of the derivatives of an energy
!> (rk_reduced_galerkin).
module rk_reduced
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_lstsq, only : row_operator
   use rk_precision, only : wp
   use rk_problem, only : problem_type, evaluation_type
   use rk_reduced_galerkin, only : new_reduced_galerkin, reduced_galerkin
   use rk_text, only : to_text
   implicit none
   private

   public :: new_reduced

   !> Rows in the span of modes; unknowns are the modes' amplitudes. Post-processing knows none
   !> of them: it takes states of the full problem.
   type, extends(problem_type) :: reduced_problem
      private
      !> The form of the full problem, in amplitudes
      class(discretisation_type), allocatable :: base
   contains
      procedure :: start_step
      procedure :: evaluate
      procedure :: linearise
      procedure :: operator
      procedure :: hessian
      procedure :: advice
   end type reduced_problem

contains

!> Project a full problem on modes
subroutine new_reduced(reduced, full, modes, error)
   !> Reduced problem, not associated after an error; the full one must outlive it
   class(problem_type), pointer, intent(out) :: reduced
   !> Full problem
   class(discretisation_type), target, intent(inout) :: full
   !> Orthonormal modes, shape (full n, r)
   real(wp), intent(in) :: modes(:, :)
   !> Error handling: modes of another model, a form that cannot be reduced
   type(error_type), allocatable, intent(out) :: error
   type(reduced_problem), pointer :: rows
   type(reduced_galerkin), pointer :: projected

   nullify (reduced)
   if (size(modes, 1) /= full%n) then
      call fatal_error(error, err_input, 'modes have '//to_text(size(modes, 1)) &
         & //' entries, the model '//to_text(full%n)//' unknowns')
      return
   end if
   if (full%is_linear()) then
      call fatal_error(error, err_input, 'reduced models are made of nonlinear problems: a ' &
         & //'linear one is solved once, which leaves nothing to save')
      return
   end if
   if (full%energetic) then
      allocate (projected)
      call new_reduced_galerkin(projected, full, modes)
      reduced => projected
      return
   end if
   allocate (rows)
   call full%reduce(modes, rows%base, error)
   if (allocated(error)) then
      deallocate (rows)
      return
   end if
   rows%m = rows%base%m
   rows%n = rows%base%n
   rows%extent = rows%base%extent
   reduced => rows
end subroutine new_reduced

!> Fix the row weights of a load step
subroutine start_step(self, x, load)
   !> Problem
   class(reduced_problem), target, intent(inout) :: self
   !> Amplitudes at the start of the step, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load at the end of the step [-]
   real(wp), intent(in) :: load

   call self%base%start_step(x, load)
end subroutine start_step

!> Residuals of the full problem
subroutine evaluate(self, x, load, r, seen)
   !> Problem
   class(reduced_problem), target, intent(inout) :: self
   !> Amplitudes, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   call self%base%evaluate(x, load, r, seen)
end subroutine evaluate

!> Residuals and linearised rows A'U
subroutine linearise(self, x, load, r, seen)
   !> Problem
   class(reduced_problem), target, intent(inout) :: self
   !> Amplitudes, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   call self%base%linearise(x, load, r, seen)
end subroutine linearise

!> Linearised rows A'U
function operator(self) result(op)
   !> Problem, linearised
   class(reduced_problem), target, intent(in) :: self
   class(row_operator), pointer :: op

   op => self%base%operator()
end function operator

!> Second derivatives of r.r/2
subroutine hessian(self, x, load, r, a)
   !> Problem, linearised at x
   class(reduced_problem), target, intent(inout) :: self
   !> Amplitudes, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> Upper triangle, shape (r, r)
   real(wp), contiguous, intent(inout) :: a(:, :)

   call self%base%hessian(x, load, r, a)
end subroutine hessian

!> What a user can do where steps vanish but the gradient does not, in the words of the deck
function advice(self) result(text)
   !> Problem
   class(reduced_problem), intent(in) :: self
   character(len=:), allocatable :: text

   text = self%base%advice()
end function advice

end module rk_reduced
