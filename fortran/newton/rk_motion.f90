!> Linear dynamics (6.33)-(6.35) by central differences, thesis (6.36)-(6.43).
!>
!> The states of two times give that of the next by equations L a(n+1) = B (2 a(n) - a(n-1))
!> - dt^2 K a(n) + loads, at least as many as unknowns. This module has the parts common to all
!> forms: the time integration, the states that are written, and the detection of instability.
module rk_motion
   use, intrinsic :: ieee_arithmetic, only : ieee_quiet_nan, ieee_value
   use rk_clock, only : tick, timer_type
   use rk_equation, only : motion_type
   use rk_error, only : error_type, fatal_error, err_convergence, err_input, err_stopped
   use rk_precision, only : i8, wp
   use rk_recorder, only : iteration_type, recorder_type, step_type
   use rk_scene, only : scene_type
   use rk_text, only : to_text
   implicit none
   private

   public :: form_motion, moving_type, loads_vary, march

   !> A body in motion
   type, abstract :: moving_type
      !> Unknowns
      integer :: n = 0
   contains
      !> Coefficients at the start, and one time step later
      procedure(start_interface), deferred :: start
      !> Coefficients at the next time
      procedure(advance_interface), deferred :: advance
   end type moving_type

   !> Moving body of a form, M a'' + K a = f with prescribed values at the new time:
   !> L a(n+1) = M (2 a(n) - a(n-1)) - dt^2 (K a(n) - f(n)) + h(n+1), L being M and their penalty
   type, abstract, extends(moving_type) :: form_motion
      !> Equations of a time step
      integer :: m = 0
      !> Settings of the motion
      type(motion_type) :: motion
      !> Whether loads or prescribed values change with time
      logical :: varies = .false.
      !> Whether the equations have symmetric matrices, as many as unknowns
      logical :: symmetric = .false.
      !> Loads f at the later of the last two times, and terms h of prescribed values, shape (m)
      real(wp), allocatable :: force(:), held(:)
      !> Work of the loads since the start, of symmetric forms
      real(wp) :: work = 0.0_wp
   contains
      !> Product of L, M or K with coefficients
      procedure(product_interface), deferred :: product
      !> Loads of a time, and terms of prescribed values then in a time step that ends there
      procedure(loads_interface), deferred :: loads
      !> Coefficients that satisfy the equations, exactly or in the least squares sense
      procedure(solve_interface), deferred :: solve
      !> Largest time step that is stable, huge where it is not known
      procedure(limit_interface), deferred :: limit
      procedure :: advance
      !> M (2 a(n) - a(n-1)) - dt^2 K a(n)
      procedure :: carry
      procedure :: add_loads, energy
   end type form_motion

   abstract interface
      subroutine start_interface(self, first, second, error)
         import :: moving_type, error_type, wp
         !> Body, with the loads of the second time on return
         class(moving_type), intent(inout) :: self
         !> Coefficients at both times, shape (n)
         real(wp), contiguous, intent(inout) :: first(:), second(:)
         type(error_type), allocatable, intent(out) :: error
      end subroutine start_interface
      subroutine advance_interface(self, before, now, time, next, error)
         import :: moving_type, error_type, wp
         class(moving_type), intent(inout) :: self
         !> Coefficients at the last two times, shape (n)
         real(wp), contiguous, intent(in) :: before(:), now(:)
         !> The later one of these times
         real(wp), intent(in) :: time
         !> Coefficients one time step later, shape (n)
         real(wp), contiguous, intent(inout) :: next(:)
         !> Error handling: an expression without a value somewhere
         type(error_type), allocatable, intent(out) :: error
      end subroutine advance_interface
      subroutine product_interface(self, what, x, y)
         import :: form_motion, wp
         class(form_motion), intent(in) :: self
         !> left, mass or stiffness
         character(len=*), intent(in) :: what
         !> Coefficients, shape (n)
         real(wp), contiguous, intent(in) :: x(:)
         !> Product, shape (m)
         real(wp), contiguous, intent(inout) :: y(:)
      end subroutine product_interface
      subroutine loads_interface(self, time, force, held, error)
         import :: form_motion, error_type, wp
         class(form_motion), intent(in) :: self
         real(wp), intent(in) :: time
         !> Loads, and terms of prescribed values in a time step that ends then, shape (m)
         real(wp), allocatable, intent(out) :: force(:), held(:)
         !> Error handling: an expression without a value somewhere
         type(error_type), allocatable, intent(out) :: error
      end subroutine loads_interface
      subroutine solve_interface(self, y, x)
         import :: form_motion, wp
         class(form_motion), intent(in) :: self
         !> Right hand side, shape (m)
         real(wp), contiguous, intent(in) :: y(:)
         !> Coefficients, shape (n)
         real(wp), contiguous, intent(inout) :: x(:)
      end subroutine solve_interface
      subroutine limit_interface(self, step, error)
         import :: form_motion, error_type, wp
         class(form_motion), intent(in) :: self
         !> Largest stable step, huge where it is not known
         real(wp), intent(out) :: step
         type(error_type), allocatable, intent(out) :: error
      end subroutine limit_interface
   end interface

   !> Growth of the unknowns beyond which a motion has diverged [-]
   real(wp), parameter :: blown_up = 1.0e8_wp

contains

!> Coefficients at the next time
subroutine advance(self, before, now, time, next, error)
   class(form_motion), intent(inout) :: self
   real(wp), contiguous, intent(in) :: before(:), now(:)
   real(wp), intent(in) :: time
   real(wp), contiguous, intent(inout) :: next(:)
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: side(self%m), force(self%m)

   call self%carry(before, now, side)
   force = self%force
   call self%add_loads(time, side, error)
   if (allocated(error)) return
   call self%solve(side, next)
   if (self%symmetric) self%work = self%work + 0.5_wp*dot_product(force, next - before)
end subroutine advance

!> Right hand side from the last two states
subroutine carry(self, before, now, y)
   class(form_motion), intent(in) :: self
   !> Coefficients at the last two times, shape (n)
   real(wp), contiguous, intent(in) :: before(:), now(:)
   !> Right hand side without loads, shape (m)
   real(wp), contiguous, intent(inout) :: y(:)
   real(wp) :: image(self%m)

   call self%product('mass', 2.0_wp*now - before, y)
   call self%product('stiffness', now, image)
   y = y - self%motion%time_step**2*image
end subroutine carry

!> Add the loads of a time and the prescribed values of the time after it, whose loads are then set
subroutine add_loads(self, time, y, error)
   !> Body with the loads of the time
   class(form_motion), intent(inout) :: self
   !> Time at the start of the step
   real(wp), intent(in) :: time
   !> Right hand side, to which the loads are added, shape (m)
   real(wp), contiguous, intent(inout) :: y(:)
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(out) :: error

   y = y + self%motion%time_step**2*self%force
   if (self%varies) call self%loads(time + self%motion%time_step, self%force, self%held, error)
   if (.not. allocated(error)) y = y + self%held
end subroutine add_loads

!> Kinetic energy between two times, strain energy as the scheme conserves it, and the work of the
!> loads; NaN where the equations have no symmetric matrices
function energy(self, now, next)
   class(form_motion), intent(in) :: self
   !> Coefficients at two times, shape (n)
   real(wp), contiguous, intent(in) :: now(:), next(:)
   real(wp) :: energy(3)
   real(wp) :: image(self%m), speed(self%n)

   energy = ieee_value(energy, ieee_quiet_nan)
   if (.not. self%symmetric) return
   speed = (next - now)/self%motion%time_step
   call self%product('mass', speed, image)
   energy(1) = 0.5_wp*dot_product(speed, image)
   call self%product('stiffness', now, image)
   energy(2) = 0.5_wp*dot_product(next, image)
   energy(3) = self%work
end function energy

!> Whether loads or prescribed values change with time
logical function loads_vary(scene)
   type(scene_type), intent(in) :: scene
   integer :: i, k

   loads_vary = any([(scene%equation%source(i)%uses('t'), i=1, 3)])
   do k = 1, size(scene%condition)
      loads_vary = loads_vary .or. any([(scene%condition(k)%value(i)%uses('t') .or. &
         & scene%condition(k)%traction(i)%uses('t'), i=1, 3)])
   end do
end function loads_vary

!> Integrate in time and hand over states
subroutine march(body, motion, x, recorder, timer, error)
   class(moving_type), intent(inout) :: body
   !> Time step, end and states that are written
   type(motion_type), intent(in) :: motion
   !> Coefficients at the end, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   class(recorder_type), intent(inout) :: recorder
   type(timer_type), intent(inout) :: timer
   !> Error handling: a step that is not stable, a stop
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: before(:), now(:), next(:)
   type(iteration_type) :: it
   type(step_type) :: st
   real(wp) :: largest, limit, none
   integer(i8) :: clock
   integer :: k, steps

   call system_clock(clock)
   allocate (before(body%n), now(body%n), next(body%n))
   steps = nint(motion%end_time/motion%time_step)
   limit = huge(1.0_wp)
   select type (body)
   class is (form_motion)
      call body%limit(limit, error)
   end select
   if (.not. allocated(error) .and. limit < huge(1.0_wp)) then
      call recorder%note('largest stable time step '//to_text(limit, 4)//', used ' &
         & //to_text(motion%time_step, 4), warning=.false.)
      if (motion%time_step > limit) call fatal_error(error, err_input, 'dynamics.time_step: ' &
         & //to_text(motion%time_step)//' is not stable, central differences allow ' &
         & //'at most '//to_text(limit, 4)//' with these points')
   end if
   timer%assemble = tick(clock)
   if (.not. allocated(error)) call body%start(before, now, error)
   if (allocated(error)) return
   largest = max(maxval(abs(before)), maxval(abs(now)))
   ! small strains have no volume ratio
   none = ieee_value(none, ieee_quiet_nan)
   ! a body that loads move from rest has no amplitude to compare with yet
   if (.not. largest > 0.0_wp) largest = huge(1.0_wp)/blown_up
   do k = 1, steps
      call body%advance(before, now, k*motion%time_step, next, error)
      if (allocated(error)) return
      if (recorder%stopped()) then
         call fatal_error(error, err_stopped, 'stopped at time '//to_text(k*motion%time_step))
         return
      end if
      ! a comparison that a NaN fails; loads make motions grow in proportion to time
      if (.not. maxval(abs(next)) <= blown_up*largest) then
         call fatal_error(error, err_convergence, 'the motion diverges at time ' &
            & //to_text(k*motion%time_step)//': use a smaller dynamics.time_step, or method ' &
            & //'"rkpm-gauss", whose limit is known')
         return
      end if
      if (k <= 2) largest = max(largest, maxval(abs(next)))
      if (mod(k, motion%every) == 0 .or. k == steps) then
         it%step = k
         it%load = k*motion%time_step
         it%iteration = 1
         it%solver%used = 'central differences'
         it%solver%why = it%solver%used
         it%seconds = tick(timer%start)
         it%solver%rcond = 1.0_wp
         call recorder%iteration(it)
         st = step_type(step=k, steps=steps, load=it%load, iterations=1, min_j=none, max_j=none)
         st%energy = [none, none, none]
         select type (body)
         class is (form_motion)
            st%energy = body%energy(now, next)
         end select
         call recorder%step(st, now)
      end if
      before = now
      now = next
   end do
   x = before
   timer%solve = tick(clock)

end subroutine march

end module rk_motion
