!> What a nonlinear solver may know of a problem: residuals of an overdetermined system in terms of
!> the unknowns and the load, and their linearisation.
module rk_problem
   use rk_error, only : error_type
   use rk_operator, only : row_operator, square_report
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
      !> The residuals have second derivatives that set_curvature finds
      logical :: curved = .false.
      !> A linearisation costs several evaluations and is not made where residuals tell enough
      logical :: costly = .false.
      !> Steps are solved to few digits: measure tells what they leave
      logical :: inexact = .false.
      !> The residuals are the derivative of an energy by the unknowns, so that modes reduce both
      logical :: energetic = .false.
   contains
      !> Size of a change of the unknowns
      procedure :: scaled_norms
      !> Whether residuals are linear in the unknowns: one solve, no load steps
      procedure :: is_linear
      !> Fix what stays constant during a load step: row weights
      procedure :: start_step
      !> Residuals; the linearisation stays what it was
      procedure(evaluate_interface), deferred :: evaluate
      !> Residuals and their linearisation, which operator, hessian and square_step then give
      procedure(evaluate_interface), deferred :: linearise
      !> Linearise at the start of a load step
      procedure :: predict
      !> Take along from two converged states what unknowns do not tell, to the start of a load step
      procedure :: extrapolate
      !> A step begins where the problem was linearised last
      procedure :: start_iteration
      !> Size of residuals
      procedure :: measure
      !> The linearisation
      procedure(operator_interface), deferred :: operator
      !> Second derivatives of r.r/2 where the problem was linearised
      procedure :: hessian
      !> Second derivatives of the residuals, weighted with the residuals
      procedure :: set_curvature
      !> Their product with a vector
      procedure :: apply_curvature
      !> Newton's step of a square linearisation
      procedure :: square_step
      !> What speaks against a converged state
      procedure :: rejection
      !> Whether a step turns material by a right angle
      procedure :: turns_over
      !> Whether unknowns are those of a body at rest, which nothing moves at a load
      procedure :: at_rest
      !> What a user can do where steps vanish but the gradient does not
      procedure :: advice
      !> What may keep the iteration from converging
      procedure :: caveat
   end type problem_type

   abstract interface
      subroutine evaluate_interface(self, x, load, r, seen)
         import :: problem_type, evaluation_type, wp
         !> Problem
         class(problem_type), target, intent(inout) :: self
         !> Unknowns, shape (n)
         real(wp), contiguous, intent(in) :: x(:)
         !> Load, 0..1 [-]
         real(wp), intent(in) :: load
         !> Residuals, shape (m)
         real(wp), contiguous, intent(inout) :: r(:)
         !> What was seen
         type(evaluation_type), intent(out) :: seen
      end subroutine evaluate_interface
      function operator_interface(self) result(op)
         import :: problem_type, row_operator
         !> Problem
         class(problem_type), target, intent(in) :: self
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

!> Fix what stays constant during a load step
subroutine start_step(self, x, load)
   !> Problem
   class(problem_type), target, intent(inout) :: self
   !> Unknowns at the start of the step, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load at the end of the step, 0..1 [-]
   real(wp), intent(in) :: load

   associate (unused => self, unused_x => x, unused_load => load)
   end associate
end subroutine start_step

!> Whether residuals are linear in the unknowns
pure logical function is_linear(self)
   !> Problem
   class(problem_type), intent(in) :: self

   associate (unused => self)
   end associate
   is_linear = .false.
end function is_linear

!> Residuals and linearisation at the start of a load step. Where the load enters in a way that
!> makes the start no good state, a problem may linearise in the load as well.
subroutine predict(self, x, done, load, residuals, r, seen)
   !> Problem
   class(problem_type), target, intent(inout) :: self
   !> Unknowns of the last converged state, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Its load, 0..1 [-]
   real(wp), intent(in) :: done
   !> Load, 0..1 [-]
   real(wp), intent(in) :: load
   !> Residuals will do: the linearisation may stay what it was
   logical, intent(in) :: residuals
   !> Residuals, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   associate (unused => done, unused_too => residuals)
   end associate
   call self%linearise(x, load, r, seen)
end subroutine predict

!> The next linearisation is on the curve through the last converged states, of which the problem is
!> linearised at the last one; what a state has beside its unknowns may be extrapolated as well
subroutine extrapolate(self, x, load, share)
   !> Problem, linearised at the last converged state by predict
   class(problem_type), target, intent(inout) :: self
   !> Unknowns of the last states, the latest first, shape (n, states)
   real(wp), contiguous, intent(in) :: x(:, :)
   !> Their loads at equal distances, 0..1, shape (states) [-]
   real(wp), intent(in) :: load(:)
   !> Way beyond the last state, of that from the one before to it [-]
   real(wp), intent(in) :: share

   associate (unused => self, unused_x => x, unused_load => load, unused_share => share)
   end associate
end subroutine extrapolate

!> Size of residuals where the problem was linearised, by which starts are compared and what a step
!> leaves is told
subroutine measure(self, r, size)
   !> Problem, linearised
   class(problem_type), target, intent(inout) :: self
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> Their size
   real(wp), intent(out) :: size

   associate (unused => self)
   end associate
   size = norm2(r)
end subroutine measure

!> A step begins where the problem was linearised last; a linearisation at its end may depend on it
subroutine start_iteration(self)
   !> Problem
   class(problem_type), intent(inout) :: self

   associate (unused => self)
   end associate
end subroutine start_iteration

!> Newton's step of a linearisation with as many equations as unknowns, solved as they are. Others
!> find none here: theirs is a least squares problem.
subroutine square_step(self, shift, r, dx, found, report, error)
   !> Problem, linearised
   class(problem_type), target, intent(inout) :: self
   !> Damping in units of the diagonal, >= 0 [-]
   real(wp), intent(in) :: shift
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> Step, shape (n)
   real(wp), contiguous, intent(inout) :: dx(:)
   !> Whether there is such a step
   logical, intent(out) :: found
   !> What was used and how good it is
   type(square_report), intent(out) :: report
   !> Error handling: singular matrix, no memory, no convergence
   type(error_type), allocatable, intent(out) :: error

   associate (unused => self, unused_shift => shift, unused_r => r, unused_dx => dx)
   end associate
   found = .false.
end subroutine square_step

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

!> Whether a step turns material by a right angle or more somewhere, beyond which another solution
!> than the one on the way may be met: a block that is stretched to six times its length can end
!> with its sides exchanged, in equilibrium and with J > 0
function turns_over(self, before, after) result(found)
   !> Problem
   class(problem_type), intent(in) :: self
   !> Unknowns before and after the step, shape (n) each
   real(wp), contiguous, intent(in) :: before(:), after(:)
   logical :: found

   associate (unused => self, unused_before => before, unused_after => after)
   end associate
   found = .false.
end function turns_over

!> Whether unknowns are those of a body at rest, which nothing moves at a load
logical function at_rest(self, x, load)
   !> Problem
   class(problem_type), intent(in) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load

   associate (unused => self, unused_x => x, unused_load => load)
   end associate
   at_rest = .false.
end function at_rest

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

!> Find the sum of r_i times the second derivatives of r_i; nothing where there are none
subroutine set_curvature(self, x, load, r)
   !> Problem
   class(problem_type), intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load, 0..1 [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)

   associate (unused => self, unused_x => x, unused_load => load, unused_r => r)
   end associate
end subroutine set_curvature

!> Product of this sum, as last found, with a vector
subroutine apply_curvature(self, x, y)
   !> Problem
   class(problem_type), intent(in) :: self
   !> Vector, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Product, shape (n)
   real(wp), contiguous, intent(inout) :: y(:)

   associate (unused => self, unused_x => x)
   end associate
   y = 0.0_wp
end subroutine apply_curvature

!> What a user can do where steps vanish but the gradient does not, in the words of the deck
function advice(self) result(text)
   !> Problem
   class(problem_type), intent(in) :: self
   character(len=:), allocatable :: text

   associate (unused => self)
   end associate
   text = 'the residuals may have kinks'
end function advice

!> What is known beforehand that may keep the iteration from converging, and what a user can do, in
!> the words of the deck; empty where there is nothing
function caveat(self) result(text)
   !> Problem
   class(problem_type), intent(in) :: self
   character(len=:), allocatable :: text

   associate (unused => self)
   end associate
   text = ''
end function caveat

end module rk_problem
