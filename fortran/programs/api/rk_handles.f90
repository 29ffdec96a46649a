!> Scenes that Python has open, and answers to its questions about them: arrays and texts by name,
!> which the boundary returns in one call.
!>
!> A handle is the address of a slot. Python owns it and closes it.
module rk_handles
   use, intrinsic :: iso_c_binding, only : c_char, c_f_pointer, c_int, c_null_char, c_null_ptr
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_discretisation, only : discretisation_type, free_discretisation
   use rk_precision, only : i8, wp
   use rk_problem, only : problem_type
   use rk_recorder, only : iteration_type, recorder_type, step_type
   use rk_run, only : outcome_type
   use rk_scene, only : scene_type
   use rk_text, only : to_text
   use rk_refine, only : refinement_type
   use rk_verdict, only : verdict_type
   implicit none
   private

   public :: slot_type, answer_type, listener_interface, slot_of, close_slot

   !> Answer
   type :: answer_type
      !> Name of each array, kind of its numbers (0 real, 1 integer, 2 letters of a text) and its
      !> shape, one line each
      character(len=:), allocatable :: forms
      !> Numbers of all arrays, one after the other
      real(wp), allocatable :: value(:)
   contains
      procedure :: put, put_whole, put_text
      procedure, private :: add
   end type answer_type

   !> States of a solve, stored in memory
   type, extends(recorder_type) :: states_type
      !> Unknowns of each step, shape (n, steps)
      real(wp), allocatable :: x(:, :)
      !> Load, iterations, smallest and largest J, smallest eigenvalue of the acoustic tensor and
      !> its collocation point of each step, shape (6, steps)
      real(wp), allocatable :: info(:, :)
      !> Number of steps and iterations so far
      integer :: steps = 0
      integer :: iterations = 0
      !> Largest backward error [-]
      real(wp) :: backward_error = 0.0_wp
      !> Set from outside to stop the solve
      logical :: stop = .false.
      !> Receiver of notes, not associated if there is none
      procedure(listener_interface), pointer, nopass :: listener => null()
   contains
      procedure :: iteration, step, stopped, note
   end type states_type

   abstract interface
      !> Receive a line, which may be empty; a result other than 0 asks the work to stop
      integer(c_int) function listener_interface(line) bind(c)
         import :: c_char, c_int
         !> Text that ends with a null character
         character(kind=c_char), intent(in) :: line(*)
      end function listener_interface
   end interface

   !> Contents of a slot
   type :: slot_type
      !> Scene
      type(scene_type) :: scene
      !> Full problem
      class(discretisation_type), allocatable :: full
      !> Reduced problem, if one was made
      class(problem_type), pointer :: reduced => null()
      !> States of the last solve
      type(states_type) :: states
      !> Warnings, checks and wall times of the last solve
      type(outcome_type) :: outcome
      !> Verdict on them
      type(verdict_type) :: verdict
      !> Search for its points, if the deck requests one
      type(refinement_type) :: refinement
      !> Deck and points from which it was made
      type(deck_type) :: deck
      type(cloud_type) :: model
      !> Description of the shape functions to which the coefficients belong
      character(len=:), allocatable :: approximation
      !> Answer to the last question
      type(answer_type) :: answer
   end type slot_type

contains

function slot_of(handle) result(slot)
   !> Address of a slot that is open
   integer(i8), intent(in) :: handle
   type(slot_type), pointer :: slot

   call c_f_pointer(transfer(handle, c_null_ptr), slot)
end function slot_of

!> Free the memory of a slot
subroutine close_slot(slot)
   type(slot_type), pointer, intent(inout) :: slot

   if (associated(slot%reduced)) deallocate (slot%reduced)
   if (allocated(slot%full)) call free_discretisation(slot%full)
   deallocate (slot)
end subroutine close_slot

!> Count an iteration
subroutine iteration(self, it)
   class(states_type), intent(inout) :: self
   type(iteration_type), intent(in) :: it

   self%iterations = self%iterations + 1
   self%backward_error = max(self%backward_error, it%solver%backward_error)
end subroutine iteration

!> Store a converged state; the state at rest is not stored
subroutine step(self, st, x)
   class(states_type), intent(inout) :: self
   type(step_type), intent(in) :: st
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)

   if (st%step == 0) return
   self%steps = self%steps + 1
   if (self%steps > size(self%x, 2)) return
   self%x(:, self%steps) = x
   self%info(:, self%steps) = [st%load, real(st%iterations, wp), st%min_j, st%max_j, &
      & st%min_acoustic, real(st%acoustic_point, wp)]
end subroutine step

!> Whether Python requested a stop
logical function stopped(self)
   class(states_type), intent(inout) :: self

   if (associated(self%listener)) call self%note('', warning=.false.)
   stopped = self%stop
end function stopped

!> Pass a line to the receiver, who may request a stop
subroutine note(self, line, warning)
   class(states_type), intent(inout) :: self
   character(len=*), intent(in) :: line
   !> Whether it deserves attention
   logical, intent(in) :: warning

   associate (unused => warning)
   end associate
   if (.not. associated(self%listener)) return
   if (self%listener(line//c_null_char) /= 0) self%stop = .true.
end subroutine note

!> Add real numbers
subroutine put(self, name, shape, value)
   class(answer_type), intent(inout) :: self
   character(len=*), intent(in) :: name
   integer, intent(in) :: shape(:)
   !> Numbers, the first index of the shape running first
   real(wp), intent(in) :: value(*)

   call self%add(name, 0, shape, value(:product(shape)))
end subroutine put

!> Add integers
subroutine put_whole(self, name, shape, value)
   class(answer_type), intent(inout) :: self
   character(len=*), intent(in) :: name
   integer, intent(in) :: shape(:)
   integer, intent(in) :: value(*)

   call self%add(name, 1, shape, real(value(:product(shape)), wp))
end subroutine put_whole

subroutine put_text(self, name, text)
   class(answer_type), intent(inout) :: self
   character(len=*), intent(in) :: name
   !> An array that is not allocated counts as empty
   character(len=:), allocatable, intent(in) :: text
   integer :: i, length

   length = 0
   if (allocated(text)) length = len(text)
   call self%add(name, 2, [length], [(real(iachar(text(i:i)), wp), i=1, length)])
end subroutine put_text

subroutine add(self, name, kind, shape, value)
   class(answer_type), intent(inout) :: self
   character(len=*), intent(in) :: name
   integer, intent(in) :: kind, shape(:)
   !> Numbers, shape (product(shape))
   real(wp), intent(in) :: value(:)
   integer :: i

   self%forms = self%forms//name//' '//to_text(kind)
   do i = 1, size(shape)
      self%forms = self%forms//' '//to_text(shape(i))
   end do
   self%forms = self%forms//new_line('a')
   self%value = [self%value, value]
end subroutine add

end module rk_handles
