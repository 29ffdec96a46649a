!> Interface of a problem for a nonlinear solver: residuals of an overdetermined system in terms of
!> the unknowns and the load, and their linearisation.
module rk_problem
   use rk_operator, only : row_operator
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   use rk_text, only : to_text
   implicit none
   private

   public :: problem_type, evaluation_type, stage_type

   !> Request for residuals
   type :: stage_type
      !> Load, and load of the prescribed values lifted into gradients: at the start of a load step
      !> the latter may be that of the last state, from which the values jump [-]
      real(wp) :: load = 0.0_wp, lifted = 0.0_wp
      !> Linearise too
      logical :: tangent = .false.
      !> If the place is on the curve through the last converged states: their unknowns, the latest
      !> first, shape (n, states), and loads at equal distances, shape (states) [-]
      real(wp), allocatable :: behind(:, :), behind_load(:)
      !> Then the distance beyond the last one, as a fraction of that between the last two [-]
      real(wp) :: share = 0.0_wp
   end type stage_type

   !> Results of an evaluation beside the residuals
   type :: evaluation_type
      !> Smallest volume ratio J [-]
      real(wp) :: min_j = 1.0_wp
      !> Largest volume ratio J [-]
      real(wp) :: max_j = 1.0_wp
      !> Collocation point with the smallest J
      integer :: worst = 0
      !> All volume ratios positive and all residuals finite
      logical :: valid = .true.
      !> Size of the residuals, by which starts are compared and the next step is estimated: their
      !> norm, or the norm in which problems with inexact steps measure it
      real(wp) :: size = -1.0_wp
   end type evaluation_type

   !> Overdetermined nonlinear equations r(x, load) = 0, solved in the least squares sense
   type, abstract :: problem_type
      !> Scene that is modelled
      type(scene_type), pointer :: scene => null()
      !> Equations
      integer :: m = 0
      !> Unknowns
      integer :: n = 0
      !> Norm of unknowns that would move every point by the size of the body, 0 without a body
      real(wp) :: extent = 0.0_wp
      !> Pressures among the unknowns: the first of them, 0 without any, the distance to the next
      !> one, and the norm of pressures that equal the shear modulus everywhere [stress]
      integer :: pressure_first = 0
      integer :: pressure_stride = 1
      real(wp) :: pressure_extent = 1.0_wp
      !> Residuals are linear in the unknowns: one solve, no load steps
      logical :: linear = .false.
      !> As many equations as unknowns, the derivative of an energy, which the linearisation solves
      !> directly. It costs several evaluations and is omitted where residuals suffice
      logical :: square = .false.
      !> Steps are solved inexactly: the size of an evaluation measures the remaining residual
      logical :: inexact = .false.
      !> Row weights are those of the state that `start` was called with last
      logical :: weighted = .false.
      !> The residuals are the derivative of an energy, so that modes reduce both
      logical :: energetic = .false.
      !> Possible obstacle to convergence and its remedy, in terms of the deck; not allocated where
      !> none is known
      character(len=:), allocatable :: caveat
      !> Linearised rows, which assemble sets
      class(row_operator), pointer :: linearised => null()
   contains
      procedure :: start
      !> Residuals and, where wanted, their linearisation
      procedure(assemble_interface), deferred :: assemble
      procedure :: check_answer, is_unstable
      procedure, non_overridable :: evaluate
      procedure, non_overridable :: scaled_norms
      procedure, non_overridable :: get_advice
   end type problem_type

   abstract interface
      subroutine assemble_interface(self, x, stage, r, seen)
         import :: problem_type, evaluation_type, stage_type, wp
         class(problem_type), target, intent(inout) :: self
         !> Unknowns, shape (n)
         real(wp), contiguous, intent(in) :: x(:)
         !> Load, and whether to linearise
         type(stage_type), intent(in) :: stage
         !> Residuals, shape (m)
         real(wp), contiguous, intent(inout) :: r(:)
         !> Further results
         type(evaluation_type), intent(out) :: seen
      end subroutine assemble_interface
   end interface

contains

!> Begin a load step, during which row weights do not change, or a step of the iteration from the
!> place of the last linearisation, on which the linearisation at its end may depend
subroutine start(self, x, load, iteration)
   class(problem_type), target, intent(inout) :: self
   !> Unknowns there, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load at the end of the step, 0..1 [-]
   real(wp), intent(in) :: load
   !> Only an iteration begins
   logical, intent(in) :: iteration

   associate (unused => self, unused_x => x, unused_load => load, unused_too => iteration)
   end associate
end subroutine start

!> Residuals and, where wanted, their linearisation, which otherwise remains unchanged
subroutine evaluate(self, x, load, r, seen, tangent, lifted)
   class(problem_type), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load, 0..1 [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   type(evaluation_type), intent(out) :: seen
   !> Linearise
   logical, intent(in), optional :: tangent
   !> Load of the last converged state, whose unknowns are the start of this load step: where they
   !> are not a good state at the new load, a problem may linearise in the load too [-]
   real(wp), intent(in), optional :: lifted
   type(stage_type) :: stage

   stage%load = load
   stage%lifted = load
   if (present(lifted)) stage%lifted = lifted
   if (present(tangent)) stage%tangent = tangent
   call self%assemble(x, stage, r, seen)
   if (seen%size < 0.0_wp) seen%size = norm2(r)
end subroutine evaluate

!> Norms of the kinds of unknowns in a vector, each with its own scale: displacements in sizes of
!> the body, pressures, where there are any, in shear moduli. Pressures may be 1e8 times as large as
!> displacements, which would not show in one norm of both.
pure function scaled_norms(self, x) result(norms)
   class(problem_type), intent(in) :: self
   !> Unknowns or their change, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   real(wp) :: norms(2)

   norms = [norm2(x), 0.0_wp]
   if (self%pressure_first > 0) then
      norms(2) = norm2(x(self%pressure_first::self%pressure_stride))
      norms(1) = sqrt(max(sum(x**2) - norms(2)**2, 0.0_wp))
      if (self%pressure_stride == 1) norms(1) = norm2(x(:self%pressure_first - 1))
      norms(2) = norms(2)/self%pressure_extent
   end if
   if (self%extent > 0.0_wp) norms(1) = norms(1)/self%extent
end function scaled_norms

!> Why a converged state does not solve the equations on which the rows are based, empty where
!> no check rejects it: a least squares functional may have several stationary points
subroutine check_answer(self, x, reason)
   class(problem_type), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   character(len=:), allocatable, intent(out) :: reason

   associate (unused => self, unused_x => x)
   end associate
   reason = ''
end subroutine check_answer

!> Whether an equilibrium is unstable; false if a problem cannot determine this
logical function is_unstable(self, x, load)
   class(problem_type), target, intent(inout) :: self
   !> Its unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Its load [-]
   real(wp), intent(in) :: load

   associate (unused => self, unused_x => x, unused_load => load)
   end associate
   is_unstable = .false.
end function is_unstable

!> Advice where steps vanish but the gradient does not, in terms of the deck
subroutine get_advice(self, text)
   class(problem_type), intent(in) :: self
   character(len=:), allocatable, intent(out) :: text

   text = to_text(self%scene%stiffest_ratio(), 2)
   if (self%scene%has_kinks()) then
      text = 'the stress has kinks: use curve = "smooth" for fibers, in an energy of your own ' &
         & //'smooth functions in place of max, min, abs and comparisons'
   else
      text = 'rounding errors dominate (the largest K is '//text//' times its shear modulus), or ' &
         & //'no step reduces the residual; use a smaller K, more points or less load'
      if (index(self%scene%method, 'rkpm') /= 1) text = text//', or method "rkpm-gauss"'
   end if
end subroutine get_advice

end module rk_problem
