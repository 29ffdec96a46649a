!> Scenes that Python holds open, and answers to its questions about them: arrays and texts by name,
!> which the boundary hands over one after the other.
!>
!> A handle is serial*64 + row, so that a closed or reused row is recognised. Python owns the
!> handle and closes it. This table is the one place with module variables.
module rk_handles
   use, intrinsic :: iso_c_binding, only : c_char, c_int, c_null_char
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_discretisation, only : discretisation_type, free_discretisation
   use rk_error, only : error_type, fatal_error, err_input
   use rk_precision, only : wp
   use rk_problem, only : problem_type
   use rk_recorder, only : iteration_type, recorder_type, step_type
   use rk_run, only : outcome_type
   use rk_scene, only : scene_type
   use rk_text, only : to_text
   use rk_refine, only : refinement_type
   use rk_verdict, only : verdict_type
   implicit none
   private

   public :: slot_type, answer_type, listener_interface, open_slot, close_slot, find_slot

   !> Rows of the table
   integer, parameter :: rows = 64

   !> Arrays of an answer at most
   integer, parameter :: most = 48

   !> An array, flat
   type :: array_type
      character(len=16) :: name = ''
      !> What its numbers are: 0 real, 1 whole, 2 the letters of a text
      integer :: kind = 0
      !> At most three numbers
      integer, allocatable :: shape(:)
      real(wp), allocatable :: value(:)
   end type array_type

   !> Answer
   type :: answer_type
      !> Arrays so far
      integer :: count = 0
      type(array_type) :: array(most)
   contains
      procedure :: put, put_whole, put_text
   end type answer_type

   !> States of a solve, kept in memory
   type, extends(recorder_type) :: states_type
      !> Unknowns of each step, shape (n, steps)
      real(wp), allocatable :: x(:, :)
      !> Load, iterations, smallest and largest J, smallest eigenvalue of the acoustic tensor and
      !> its collocation point of each step, shape (6, steps)
      real(wp), allocatable :: info(:, :)
      !> Steps and iterations so far
      integer :: steps = 0
      integer :: iterations = 0
      !> Largest backward error [-]
      real(wp) :: backward_error = 0.0_wp
      !> Set from outside to end the solve
      logical :: stop = .false.
      !> Reader of notes, not associated without one
      procedure(listener_interface), pointer, nopass :: listener => null()
   contains
      procedure :: iteration, step, stopped, note
   end type states_type

   abstract interface
      !> Take a line, which may be empty; other than 0 asks the work to stop
      integer(c_int) function listener_interface(line) bind(c)
         import :: c_char, c_int
         !> Text, with a null character behind it
         character(kind=c_char), intent(in) :: line(*)
      end function listener_interface
   end interface

   !> What a handle stands for
   type :: slot_type
      !> Handle, 0 for a free row
      integer :: handle = 0
      !> Scene
      type(scene_type), pointer :: scene => null()
      !> Full problem
      class(discretisation_type), allocatable :: full
      !> Reduced problem, where one was made
      class(problem_type), pointer :: reduced => null()
      !> States of the last solve
      type(states_type), pointer :: states => null()
      !> Warnings, checks and wall times of the last solve
      type(outcome_type) :: outcome
      !> Verdict on them
      type(verdict_type) :: verdict
      !> Search for its points, where the deck wants one
      type(refinement_type) :: refinement
      !> Deck and points it was made of
      type(deck_type) :: deck
      type(cloud_type) :: model
      !> Shape functions in words: coefficients belong to them
      character(len=:), allocatable :: approximation
      !> Answer to the last question
      type(answer_type) :: answer
   end type slot_type

   type(slot_type), target, save :: table(0:rows - 1)
   integer, save :: serial = 0

contains

!> Take a free row
subroutine open_slot(slot, error)
   !> Row with its parts allocated
   type(slot_type), pointer, intent(out) :: slot
   !> Error handling: no free row
   type(error_type), allocatable, intent(out) :: error
   integer :: row

   nullify (slot)
   do row = 0, rows - 1
      if (table(row)%handle /= 0) cycle
      serial = serial + 1
      table(row)%handle = serial*rows + row
      slot => table(row)
      allocate (slot%scene, slot%states)
      return
   end do
   call fatal_error(error, err_input, 'too many open scenes, at most '//to_text(rows) &
      & //': close some')
end subroutine open_slot

!> Give a row back
subroutine close_slot(slot)
   type(slot_type), intent(inout) :: slot

   if (associated(slot%reduced)) deallocate (slot%reduced)
   if (allocated(slot%full)) then
      call free_discretisation(slot%full)
      deallocate (slot%full)
   end if
   deallocate (slot%states, slot%scene)
   slot%handle = 0
end subroutine close_slot

subroutine find_slot(handle, slot, error)
   integer, intent(in) :: handle
   type(slot_type), pointer, intent(out) :: slot
   !> Error handling: a closed handle
   type(error_type), allocatable, intent(out) :: error

   nullify (slot)
   if (handle > 0) then
      slot => table(mod(handle, rows))
      if (slot%handle == handle) return
   end if
   call fatal_error(error, err_input, 'this scene is closed')
end subroutine find_slot

!> Count an iteration
subroutine iteration(self, it)
   class(states_type), intent(inout) :: self
   type(iteration_type), intent(in) :: it

   self%iterations = self%iterations + 1
   self%backward_error = max(self%backward_error, it%solver%backward_error)
end subroutine iteration

!> Keep a converged state; that at rest is not asked for
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

!> Whether Python asked to stop
logical function stopped(self)
   class(states_type), intent(inout) :: self

   if (associated(self%listener)) call self%note('', warning=.false.)
   stopped = self%stop
end function stopped

!> Hand a line on to the reader, who may ask to stop
subroutine note(self, line, warning)
   class(states_type), intent(inout) :: self
   character(len=*), intent(in) :: line
   !> It deserves attention
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

   self%count = self%count + 1
   self%array(self%count) = array_type(name, 0, shape, value(:product(shape)))
end subroutine put

!> Add whole numbers
subroutine put_whole(self, name, shape, value)
   class(answer_type), intent(inout) :: self
   character(len=*), intent(in) :: name
   integer, intent(in) :: shape(:)
   integer, intent(in) :: value(*)

   call self%put(name, shape, real(value(:product(shape)), wp))
   self%array(self%count)%kind = 1
end subroutine put_whole

subroutine put_text(self, name, text)
   class(answer_type), intent(inout) :: self
   character(len=*), intent(in) :: name
   !> Not allocated counts as empty
   character(len=:), allocatable, intent(in) :: text
   integer :: i

   if (allocated(text)) then
      call self%put_whole(name, [len(text)], [(iachar(text(i:i)), i=1, len(text))])
   else
      call self%put_whole(name, [0], [integer ::])
   end if
   self%array(self%count)%kind = 2
end subroutine put_text

end module rk_handles
