!> Motion of a body in the Galerkin form: M a'' + K a = F, with the penalty of prescribed values at
!> the new time, like the rows of the boundary in (6.40).
!>
!> With the penalty P implicit and the rest of the stiffness explicit, each vector a gives a scalar
!> equation whose solutions stay bounded where dt^2 (K - P) <= 4 M: the limit is that of K - P, and
!> a large penalty does not reduce the time step.
module rk_weak_motion
   use rk_error, only : error_type
   use rk_galerkin, only : galerkin_problem, sources
   use rk_motion, only : form_motion, loads_vary
   use rk_operator, only : square_report
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type
   use rk_sparse, only : solve_sparse, sparse_factor
   use rk_spectrum, only : largest_eigenvalue
   use rk_states, only : field_state
   use rk_weak_conditions, only : add_load, prescribed_at, surface_type
   implicit none
   private

   public :: weak_motion, new_weak_motion

   !> Body in motion
   type, extends(form_motion) :: weak_motion
      !> Problem with its stiffness
      type(galerkin_problem), pointer :: problem => null()
      !> Mass of each integration point, shape (np)
      real(wp), allocatable :: inertia(:)
      !> Entries of mass and penalty in the places of the stiffness
      real(wp), allocatable :: mass(:), penalty(:)
      !> Entries of the stiffness without the penalty
      real(wp), allocatable :: stiffness(:)
      !> Factor of mass and penalty, the same in all time steps
      type(sparse_factor) :: factor
   contains
      procedure :: start, product, loads, solve, limit
   end type weak_motion

contains

!> Set up the motion of a problem
subroutine new_weak_motion(self, problem, error)
   type(weak_motion), intent(out) :: self
   type(galerkin_problem), target, intent(inout) :: problem
   !> Error handling: a density that is not positive
   type(error_type), allocatable, intent(out) :: error
   type(evaluation_type) :: seen
   type(surface_type) :: points
   real(wp), allocatable :: r(:)
   real(wp) :: density
   integer :: q

   self%problem => problem
   self%motion = problem%scene%motion
   self%n = problem%n
   self%m = problem%n
   self%symmetric = .true.
   allocate (r(problem%n), source=0.0_wp)
   call problem%evaluate(0.0_wp*r, 0.0_wp, r, seen, tangent=.true.)
   self%inertia = problem%cells%weight
   do q = 1, size(self%inertia)
      call self%motion%density_at(problem%cells%point(:, q), density, error)
      if (allocated(error)) return
      self%inertia(q) = density*self%inertia(q)
   end do
   ! a mass at a point enters like a penalty
   points%shape = problem%inside
   points%penalty = self%inertia
   allocate (points%essential(problem%fields, size(self%inertia)), source=.true.)
   allocate (points%value(1, problem%fields, size(self%inertia)), source=0.0_wp)
   allocate (self%mass(size(problem%matrix%value)), source=0.0_wp)
   call points%add_penalty(problem%matrix%symmetric_matrix, self%mass)
   allocate (self%penalty, mold=self%mass)
   call problem%constant%unpack(self%penalty)
   self%stiffness = problem%matrix%value - self%penalty
   self%varies = loads_vary(problem%scene)
   call solve_sparse(self%factor, self%n, problem%matrix%start, problem%matrix%rows(), self%mass &
      & + self%motion%time_step**2*self%penalty, .true., error)
end subroutine new_weak_motion

!> Loads at a time: those inside, on the free surface and of lifted values, and those of the penalty
subroutine loads(self, time, force, held, error)
   class(weak_motion), intent(in) :: self
   real(wp), intent(in) :: time
   !> Loads without the penalty, and those of the penalty times the time step squared, shape (n)
   real(wp), allocatable, intent(out) :: force(:), held(:)
   type(error_type), allocatable, intent(out) :: error
   type(field_state) :: at
   logical, allocatable :: essential(:, :)
   real(wp), allocatable :: value(:, :, :), traction(:, :, :)

   allocate (force(self%n), held(self%n), source=0.0_wp)
   associate (problem => self%problem, surface => self%problem%surface)
      call prescribed_at(problem%scene, problem%cells, essential, value, traction, error, time)
      if (allocated(error)) return
      if (any(abs(value) > 0.0_wp)) then
         ! inner forces due to the prescribed values alone
         call problem%state(force, time, at)
         call problem%inner_forces(at, held)
         force = -held
         held = 0.0_wp
      end if
      call add_load(problem%inside, problem%cells%weight, sources(problem, time, error), force)
      if (allocated(error)) return
      call add_load(surface%shape, surface%area, merge(0.0_wp, traction(1, :, :), essential), force)
      call add_load(surface%shape, surface%penalty, merge(value(1, :, :), 0.0_wp, essential), held)
   end associate
   held = self%motion%time_step**2*held
end subroutine loads

!> Largest stable time step
subroutine limit(self, step, error)
   class(weak_motion), intent(in) :: self
   real(wp), intent(out) :: step
   !> Error handling: a mass that is not positive
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: value

   call largest_eigenvalue(self%problem%matrix%symmetric_matrix, self%stiffness &
      & - self%penalty, self%mass, value, error)
   step = huge(1.0_wp)
   if (.not. allocated(error) .and. value > 0.0_wp) step = 2.0_wp/sqrt(value)
end subroutine limit

!> Coefficients at the start, in the rest position, and one time step later, by the projected
!> velocity (6.42)
subroutine start(self, first, second, error)
   class(weak_motion), intent(inout) :: self
   real(wp), contiguous, intent(inout) :: first(:), second(:)
   type(error_type), allocatable, intent(out) :: error
   real(wp), dimension(self%n) :: side, speed

   first = 0.0_wp
   call project(self, speed, error)
   if (.not. allocated(error)) call self%loads(0.0_wp, self%force, self%held, error)
   if (allocated(error)) return
   associate (dt => self%motion%time_step)
      call self%product('mass', dt*speed, side)
      side = side + 0.5_wp*dt**2*self%force
      if (self%varies) call self%loads(dt, self%force, self%held, error)
      if (.not. allocated(error)) call self%solve(side + self%held, second)
   end associate
end subroutine start

!> Product of a matrix with coefficients; L is mass and penalty, the matrix of the new time
subroutine product(self, what, x, y)
   class(weak_motion), intent(in) :: self
   character(len=*), intent(in) :: what
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)

   associate (matrix => self%problem%matrix)
      select case (what)
      case ('left')
         call matrix%product(self%mass + self%motion%time_step**2*self%penalty, x, y)
      case ('mass')
         call matrix%product(self%mass, x, y)
      case ('stiffness')
         call matrix%product(self%stiffness, x, y)
      end select
   end associate
end subroutine product

!> Solve with mass and penalty
subroutine solve(self, y, x)
   class(weak_motion), intent(in) :: self
   real(wp), contiguous, intent(in) :: y(:)
   real(wp), contiguous, intent(inout) :: x(:)

   x = y
   call self%factor%solve(x)
end subroutine solve

!> Projection of the initial velocity with the consistent mass
subroutine project(self, x, error)
   class(weak_motion), intent(in) :: self
   !> Coefficients, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   type(error_type), allocatable, intent(out) :: error
   type(square_report) :: report
   real(wp) :: side(self%n), value(3, size(self%inertia))
   integer :: q

   do q = 1, size(self%inertia)
      call self%motion%initial(self%problem%cells%point(:, q), value(:, q), error)
      if (allocated(error)) return
   end do
   side = 0.0_wp
   call add_load(self%problem%inside, self%inertia, value(:self%problem%fields, :), side)
   x = 0.0_wp
   if (any(abs(side) > 0.0_wp)) call self%problem%matrix%solve_with(self%mass, side, x, &
      & report, error)
end subroutine project

end module rk_weak_motion
