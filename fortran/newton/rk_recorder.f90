!> Reports of a solver while it runs: an interface for receivers, independent of any file format.
module rk_recorder
   use rk_error, only : error_type
   use rk_lstsq, only : lstsq_report
   use rk_precision, only : wp
   implicit none
   private

   public :: recorder_type, iteration_type, step_type, start_type

   !> One iteration of the nonlinear solver
   type :: iteration_type
      !> Load step, counted from 1
      integer :: step = 0
      !> Load [-]
      real(wp) :: load = 0.0_wp
      !> Iteration, counted from 1
      integer :: iteration = 0
      !> |r|, weighted
      real(wp) :: residual = 0.0_wp
      !> |A^T r| (5.78a)
      real(wp) :: gradient = 0.0_wp
      !> |da|/|a| (5.78b), the larger one of displacements and pressures [-]
      real(wp) :: step_norm = 0.0_wp
      !> Smallest and largest volume ratio [-]
      real(wp) :: min_j = 1.0_wp
      real(wp) :: max_j = 1.0_wp
      !> Report of the linear solver
      type(lstsq_report) :: solver
      !> Wall time since the start of the solve [s]
      real(wp) :: seconds = 0.0_wp
   end type iteration_type

   !> One converged load step
   type :: step_type
      !> Load step, counted from 1
      integer :: step = 0
      !> Number of load steps
      integer :: steps = 0
      !> Load [-]
      real(wp) :: load = 0.0_wp
      !> Iterations, those of halved steps included
      integer :: iterations = 0
      !> Most halvings of the load on the way to it
      integer :: halvings = 0
      !> Relative gradient reached [-]
      real(wp) :: gradient = 0.0_wp
      !> Relative step reached, the Newton decrement of the last iteration [-]
      real(wp) :: step_norm = 0.0_wp
      !> Smallest and largest volume ratio [-]
      real(wp) :: min_j = 1.0_wp
      real(wp) :: max_j = 1.0_wp
      !> Smallest eigenvalue of the acoustic tensor, over the shear modulus at rest [-], and its
      !> collocation point; 0 where it was not computed
      real(wp) :: min_acoustic = huge(1.0_wp)
      integer :: acoustic_point = 0
      !> Whether the load was planned; false for the last state before a failure
      logical :: planned = .true.
      !> Kinetic and strain energy, and work of the loads since the start, of linear dynamics;
      !> otherwise not allocated [force length]
      real(wp), allocatable :: energy(:)
   end type step_type

   !> Where a run begins instead of at rest
   type :: start_type
      !> Load steps that an earlier run has done, from the first one on; none where only the
      !> iteration begins elsewhere
      type(step_type), allocatable :: step(:)
      !> Their unknowns, or those at which the iteration begins, shape (n, max(steps, 1))
      real(wp), allocatable :: x(:, :)
      !> Step 0 of this earlier run, and its unknowns, shape (n); not allocated without such a run
      type(step_type) :: begin
      real(wp), allocatable :: first(:)
      !> Iterations that led there and are recorded once more; not allocated where they were
      type(iteration_type), allocatable :: iteration(:)
      !> Halvings with which the first load step begins, where none was done
      integer :: halvings = 0
      !> Why the earlier run stopped after its steps; not allocated where it continues
      type(error_type), allocatable :: ended
   end type start_type

   !> Receiver of reports
   type, abstract :: recorder_type
      !> Receiver of the caller, asked whether to stop, where there is one
      class(recorder_type), pointer :: receiver => null()
   contains
      procedure :: iteration, step, stopped, note
   end type recorder_type

contains

!> An iteration was done; a receiver may ignore it
subroutine iteration(self, it)
   class(recorder_type), intent(inout) :: self
   type(iteration_type), intent(in) :: it

   associate (unused => self, unused_it => it)
   end associate
end subroutine iteration

!> A load step converged
subroutine step(self, st, x)
   class(recorder_type), intent(inout) :: self
   type(step_type), intent(in) :: st
   !> Converged unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)

   associate (unused => self, unused_step => st, unused_x => x)
   end associate
end subroutine step

!> Whether the user wants to stop
logical function stopped(self)
   class(recorder_type), intent(inout) :: self

   stopped = associated(self%receiver)
   if (stopped) stopped = self%receiver%stopped()
end function stopped

!> Note on an event during the run; a receiver may ignore it
subroutine note(self, line, warning)
   class(recorder_type), intent(inout) :: self
   character(len=*), intent(in) :: line
   !> The note is a warning; otherwise it does not concern the answer
   logical, intent(in) :: warning

   associate (unused => self, unused_line => line, unused_too => warning)
   end associate
end subroutine note

end module rk_recorder
