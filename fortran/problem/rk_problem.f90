!> What a nonlinear solver may know of a problem: residuals of an overdetermined system in terms of
!> the unknowns and the load, and their linearisation.
module rk_problem
   use rk_lstsq, only : row_operator
   use rk_precision, only : wp
   implicit none
   private

   public :: problem_type, evaluation_type, dense_limit

   !> Unknowns up to which the dense matrix of second derivatives pays: beyond, its factorisation
   !> takes longer than the iterations that it saves
   integer, parameter :: dense_limit = 8000

   !> What was seen while residuals were evaluated
   type :: evaluation_type
      !> Smallest volume ratio J [-]
      real(wp) :: min_j = 1.0_wp
      !> Largest volume ratio J [-]
      real(wp) :: max_j = 1.0_wp
      !> Collocation point with the smallest J
      integer :: worst = 0
      !> All volume ratios positive and all residuals finite
      logical :: valid = .true.
   end type evaluation_type

   !> Overdetermined nonlinear equations r(x, load) = 0, solved in the least squares sense
   type, abstract :: problem_type
      !> Equations
      integer :: m = 0
      !> Unknowns
      integer :: n = 0
      !> Norm of unknowns that would move every point by the size of the body, 0 where it has none
      real(wp) :: extent = 0.0_wp
   contains
      !> Size of a change of the unknowns
      procedure :: scaled_norms
      !> Fix what stays constant during a load step: row weights
      procedure(start_interface), deferred :: start_step
      !> Residuals and, where wanted, their linearisation
      procedure(evaluate_interface), deferred :: evaluate
      !> The same at the start of a load step
      procedure :: predict
      !> What speaks against a converged state
      procedure :: rejection
      !> The linearisation of the last evaluation
      procedure(operator_interface), deferred :: operator
      !> Second derivatives of r.r/2 at the last evaluation
      procedure :: hessian
   end type problem_type

   abstract interface
      subroutine start_interface(self, x, load)
         import :: problem_type, wp
         !> Problem
         class(problem_type), target, intent(inout) :: self
         !> Unknowns at the start of the step, shape (n)
         real(wp), contiguous, intent(in) :: x(:)
         !> Load at the end of the step, 0..1 [-]
         real(wp), intent(in) :: load
      end subroutine start_interface
      subroutine evaluate_interface(self, x, load, tangent, r, state)
         import :: problem_type, evaluation_type, wp
         !> Problem
         class(problem_type), target, intent(inout) :: self
         !> Unknowns, shape (n)
         real(wp), contiguous, intent(in) :: x(:)
         !> Load, 0..1 [-]
         real(wp), intent(in) :: load
         !> Linearise
         logical, intent(in) :: tangent
         !> Residuals, shape (m)
         real(wp), contiguous, intent(inout) :: r(:)
         !> What was seen
         type(evaluation_type), intent(out) :: state
      end subroutine evaluate_interface
      function operator_interface(self) result(op)
         import :: problem_type, row_operator
         !> Problem
         class(problem_type), target, intent(inout) :: self
         class(row_operator), pointer :: op
      end function operator_interface
   end interface

contains

!> Norms of the kinds of unknowns in a vector, each in units of its own: displacements in sizes of
!> the body, pressures, where there are any, in shear moduli. Pressures may be 1e8 times as large as
!> displacements; one norm of both would not see these.
pure function scaled_norms(self, x) result(norms)
   !> Problem
   class(problem_type), intent(in) :: self
   !> Unknowns or their change, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   real(wp) :: norms(2)

   norms = [norm2(x), 0.0_wp]
   if (self%extent > 0.0_wp) norms(1) = norms(1)/self%extent
end function scaled_norms

!> Residuals and linearisation at the start of a load step. Where the load enters in a way that
!> makes the start no good state, a problem may linearise in the load as well.
subroutine predict(self, x, done, load, r, state)
   !> Problem
   class(problem_type), target, intent(inout) :: self
   !> Unknowns of the last converged state, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Its load, 0..1 [-]
   real(wp), intent(in) :: done
   !> Load, 0..1 [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: state

   associate (unused => done)
   end associate
   call self%evaluate(x, load, .true., r, state)
end subroutine predict

!> Why a converged state is no answer of the equations that stand behind the rows, empty where
!> nothing speaks against it: a least squares functional may have several stationary points
function rejection(self, x) result(reason)
   !> Problem
   class(problem_type), intent(in) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   character(len=:), allocatable :: reason

   associate (unused => self, unused_x => x)
   end associate
   reason = ''
end function rejection

!> Second derivatives of r.r/2: A^T A plus the sum of r_i times the second derivatives of r_i
!> (5.59). Where residuals are linear, or Newton's step needs no more than A, there is no such sum.
subroutine hessian(self, x, load, r, a)
   !> Problem, linearised at x
   class(problem_type), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load, 0..1 [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> Upper triangle, shape (n, n)
   real(wp), contiguous, intent(inout) :: a(:, :)
   class(row_operator), pointer :: op

   associate (unused_x => x, unused_load => load, unused_r => r)
   end associate
   op => self%operator()
   call op%normal(a)
end subroutine hessian

end module rk_problem
