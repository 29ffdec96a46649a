!> Definition of a linear problem, as plain data: operator, loads, motion.
module rk_equation
   use rk_deck_records, only : dynamics_keys, linear_keys
   use rk_error, only : error_type, fatal_error, err_input
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: equation_type, motion_type
   public :: solution_at, source_at

   !> Distance of the points of finite differences, in sizes of the body [-]
   real(wp), parameter :: difference = 1.0e-3_wp

   !> A boundary point where components of a linear problem's solution are prescribed
   type :: pin_type
      !> Position [length]
      real(wp) :: point(3) = 0.0_wp
      !> Components
      logical :: fixed(3) = .false.
   end type pin_type

   !> A linear problem: the table of the deck, whose `problem` is not allocated in nonlinear scenes
   !> and whose `smoothing` is 0 where the coefficients are not interpolated
   type, extends(linear_keys) :: equation_type
      !> Size of the body [length]
      real(wp) :: extent(3) = 1.0_wp
      !> Single points where the solution is prescribed as 0
      type(pin_type), allocatable :: pin(:)
   contains
      procedure :: varies, is_known, fields
   end type equation_type

   !> Dynamics of a linear problem
   type, extends(dynamics_keys) :: motion_type
      !> Rows of prescribed values in collocation as published
      logical :: published = .false.
   contains
      procedure :: density_at, initial
   end type motion_type

contains

subroutine density_at(self, x, density, error)
   class(motion_type), intent(in) :: self
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Mass per volume
   real(wp), intent(out) :: density
   !> Error handling: no value there, or an invalid one
   type(error_type), allocatable, intent(inout) :: error

   call self%density%at(x, density, error)
   if (density > 0.0_wp .or. allocated(error)) return
   call fatal_error(error, err_input, self%density%where//': must be positive, not ' &
      & //to_text(density)//' as at '//to_text(x))
end subroutine density_at

!> Initial velocity
subroutine initial(self, x, value, error)
   class(motion_type), intent(in) :: self
   real(wp), intent(in) :: x(:)
   !> Components; unused ones are 0
   real(wp), intent(out) :: value(3)
   !> Error handling: no value there
   type(error_type), allocatable, intent(inout) :: error
   integer :: i

   value = 0.0_wp
   do i = 1, size(x)
      call self%velocity(i)%at(x, value(i), error)
   end do
end subroutine initial

!> Whether the coefficients vary over the body
pure logical function varies(self)
   class(equation_type), intent(in) :: self

   varies = self%E%given() .or. self%nu%given() .or. self%conductivity%given()
end function varies

pure logical function is_known(self)
   class(equation_type), intent(in) :: self

   is_known = self%exact(1)%given()
end function is_known

!> Number of components of the solution: one for Poisson's problem, else those of displacement
pure integer function fields(self, nd)
   class(equation_type), intent(in) :: self
   integer, intent(in) :: nd

   fields = nd
   if (allocated(self%problem)) fields = merge(1, nd, self%problem == 'poisson')
end function fields

!> Value and first derivatives of the solution
subroutine solution_at(equation, x, time, u, error)
   !> Problem, whose solution is known
   type(equation_type), intent(in) :: equation
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Time, not used if nothing moves
   real(wp), intent(in) :: time
   !> Value and first derivatives of each field; unknown derivatives are 0, shape (fields, nq)
   real(wp), intent(out) :: u(:, :)
   !> Error handling: an expression without a value there
   type(error_type), allocatable, intent(inout) :: error
   integer :: i

   u = 0.0_wp
   do i = 1, size(u, 1)
      call equation%exact(i)%at(x, u(i, 1), error, time)
      call equation%exact(i)%gradient(x, difference*minval(equation%extent(:size(x))), &
         & u(i, 2:1 + size(x)), error, time)
   end do
end subroutine solution_at

!> Source or body force
subroutine source_at(equation, x, time, f, error)
   type(equation_type), intent(in) :: equation
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Time, not used if nothing moves
   real(wp), intent(in) :: time
   !> Source of each field, shape (fields) [force/length^3]
   real(wp), intent(out) :: f(:)
   !> Error handling: an expression without a value there
   type(error_type), allocatable, intent(inout) :: error
   integer :: i

   do i = 1, size(f)
      call equation%source(i)%at(x, f(i), error, time)
   end do
end subroutine source_at

end module rk_equation
