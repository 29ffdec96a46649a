!> Least squares Galerkin reduction as it is published (6.62)-(6.67): in each iteration the rows of
!> the full problem are assembled and then multiplied with the modes. rk_reduced gives the same rows
!> without the full ones; this form is what it is measured against.
module rk_reduced_rows
   use rk_discretisation, only : discretisation_type
   use rk_matrix, only : matrix_rows
   use rk_operator, only : row_operator
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type, problem_type
   implicit none
   private

   public :: reduced_rows, new_reduced_rows

   !> Rows of a full problem times modes; unknowns are the modes' amplitudes
   type, extends(problem_type) :: reduced_rows
      private
      !> Full problem
      class(discretisation_type), pointer :: full => null()
      !> Orthonormal modes, shape (full n, r)
      real(wp), allocatable :: modes(:, :)
      !> Rows times modes, shape (m, r)
      type(matrix_rows) :: rows
   contains
      procedure :: start_step
      procedure :: evaluate
      procedure :: linearise
      procedure :: operator
      procedure :: advice
   end type reduced_rows

contains

!> Project a full problem on modes
subroutine new_reduced_rows(self, full, modes)
   !> Reduced problem; the full one must outlive it, and serves it in each of its evaluations
   type(reduced_rows), intent(inout) :: self
   !> Full problem
   class(discretisation_type), target, intent(inout) :: full
   !> Orthonormal modes, shape (full n, r)
   real(wp), intent(in) :: modes(:, :)

   self%full => full
   self%modes = modes
   self%n = size(modes, 2)
   self%m = full%m
   self%extent = full%extent
   allocate (self%rows%a(self%m, self%n))
   self%rows%m = self%m
   self%rows%n = self%n
end subroutine new_reduced_rows

!> Fix the row weights of a load step
subroutine start_step(self, x, load)
   !> Problem
   class(reduced_rows), target, intent(inout) :: self
   !> Amplitudes at the start of the step, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load at the end of the step [-]
   real(wp), intent(in) :: load

   call self%full%start_step(matmul(self%modes, x), load)
end subroutine start_step

!> Residuals of the full problem
subroutine evaluate(self, x, load, r, seen)
   !> Problem
   class(reduced_rows), target, intent(inout) :: self
   !> Amplitudes, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   call self%full%evaluate(matmul(self%modes, x), load, r, seen)
end subroutine evaluate

!> Residuals, and all rows times the modes
subroutine linearise(self, x, load, r, seen)
   !> Problem
   class(reduced_rows), target, intent(inout) :: self
   !> Amplitudes, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen
   class(row_operator), pointer :: full_rows
   integer :: j

   call self%full%linearise(matmul(self%modes, x), load, r, seen)
   ! no rows exist; the caller rejects the state
   if (.not. seen%valid) return
   full_rows => self%full%operator()
   do j = 1, self%n
      call full_rows%apply(self%modes(:, j), self%rows%a(:, j))
   end do
end subroutine linearise

!> Rows times modes
function operator(self) result(op)
   !> Problem, linearised
   class(reduced_rows), target, intent(in) :: self
   class(row_operator), pointer :: op

   op => self%rows
end function operator

!> What a user can do where steps vanish but the gradient does not, in the words of the deck
function advice(self) result(text)
   !> Problem
   class(reduced_rows), intent(in) :: self
   character(len=:), allocatable :: text

   text = self%full%advice()
end function advice

end module rk_reduced_rows
