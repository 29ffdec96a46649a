!> A problem in the span of modes: least squares Galerkin reduction (6.60)-(6.67) of rows, which
!> ends by (6.68), (6.69) and whose rows are formed in the span at once or in full
!> (rk_reduced_rows), projection of the derivatives of an energy (rk_reduced_galerkin), and of
!> motions (rk_reduced_motion).
module rk_reduced
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_lstsq, only : row_operator
   use rk_motion, only : moving_type
   use rk_new_motion, only : new_motion
   use rk_precision, only : wp
   use rk_problem, only : problem_type, evaluation_type
   use rk_reduced_galerkin, only : new_reduced_galerkin, reduced_galerkin
   use rk_reduced_motion, only : moving_problem, new_moving_problem
   use rk_reduced_rows, only : new_reduced_rows, reduced_rows
   use rk_text, only : to_text
   implicit none
   private

   public :: new_reduced, reduction_type

   !> How a problem is reduced
   type :: reduction_type
      !> auto, galerkin or least-squares: what the residual is orthogonal to
      character(len=:), allocatable :: projection
      !> Rows of collocation assembled in full and then projected, as published, and not in the span
      !> of the modes at once
      logical :: assembled = .false.
   end type reduction_type

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
subroutine new_reduced(reduced, full, modes, way, error)
   !> Reduced problem, not associated after an error; the full one must outlive it
   class(problem_type), pointer, intent(out) :: reduced
   !> Full problem
   class(discretisation_type), target, intent(inout) :: full
   !> Orthonormal modes, shape (full n, r)
   real(wp), intent(in) :: modes(:, :)
   !> How it is projected and assembled
   type(reduction_type), intent(in) :: way
   !> Error handling: modes of another model, a form that cannot be reduced so
   type(error_type), allocatable, intent(out) :: error
   type(reduced_problem), pointer :: rows
   type(reduced_galerkin), pointer :: projected
   type(reduced_rows), pointer :: assembled

   nullify (reduced)
   if (size(modes, 1) /= full%n) then
      call fatal_error(error, err_input, 'modes have '//to_text(size(modes, 1)) &
         & //' entries, the model '//to_text(full%n)//' unknowns')
      return
   end if
   if (full%is_linear()) then
      call new_reduced_motion(reduced, full, modes, way%projection, error)
      return
   end if
   if (way%projection == 'galerkin' .and. .not. full%energetic) then
      call fatal_error(error, err_input, 'rom.projection: collocation has more equations than ' &
         & //'unknowns, which "galerkin" cannot project: take "least-squares"')
   else if (way%projection == 'least-squares' .and. full%energetic) then
      call fatal_error(error, err_input, 'rom.projection: nonlinear Galerkin forms have as many ' &
         & //'equations as unknowns and are projected by "galerkin"')
   end if
   if (allocated(error)) return
   if (full%energetic) then
      allocate (projected)
      call new_reduced_galerkin(projected, full, modes)
      reduced => projected
      return
   end if
   if (way%assembled) then
      allocate (assembled)
      call new_reduced_rows(assembled, full, modes)
      reduced => assembled
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

!> Project a motion on modes
subroutine new_reduced_motion(reduced, full, modes, projection, error)
   !> Reduced problem, not associated after an error
   class(problem_type), pointer, intent(out) :: reduced
   !> Linear problem
   class(discretisation_type), target, intent(inout) :: full
   !> Orthonormal modes, shape (full n, r)
   real(wp), intent(in) :: modes(:, :)
   !> How it is projected
   character(len=*), intent(in) :: projection
   !> Error handling: a problem that does not move, Galerkin projection of collocation
   type(error_type), allocatable, intent(out) :: error
   type(moving_problem), pointer :: moving
   class(moving_type), pointer :: body

   nullify (reduced)
   if (.not. allocated(full%scene%motion)) then
      call fatal_error(error, err_input, 'reduced models are made of nonlinear problems and of ' &
         & //'motions: a linear problem at rest is solved once, which leaves nothing to save')
      return
   end if
   call new_motion(body, full, error)
   if (allocated(error)) return
   allocate (moving)
   call new_moving_problem(moving, body, modes, projection, error)
   if (allocated(error)) then
      deallocate (moving)
   else
      reduced => moving
   end if
end subroutine new_reduced_motion

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
