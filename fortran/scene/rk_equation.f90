!> What a linear problem is, as plain data: operator, loads or known solution, motion.
module rk_equation
   use rk_error, only : error_type, fatal_error, err_input
   use rk_expression, only : expression_type
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: equation_type, motion_type, pin_type

   !> A boundary point where components of a linear problem's solution are prescribed
   type :: pin_type
      !> Place [length]
      real(wp) :: point(3) = 0.0_wp
      !> Components
      logical :: fixed(3) = .false.
   end type pin_type

   !> A linear problem, with a known solution or with loads of its own
   type :: equation_type
      !> poisson or elasticity; not allocated in nonlinear scenes
      character(len=:), allocatable :: kind
      !> Name of the solution; none where source and conditions are those of the deck
      character(len=:), allocatable :: solution
      !> Then what the solution is, where somebody knows, by component
      type(expression_type) :: exact_of(3)
      !> and the source or body force, a number or an expression for each component
      !> [force/length^3]
      real(wp) :: source(3) = 0.0_wp
      type(expression_type) :: source_of(3)
      !> Degree of a polynomial solution
      integer :: degree = 0
      !> Young's modulus [force/length^2] and Poisson's ratio [-]
      real(wp) :: young = 1.0_wp
      real(wp) :: poisson_ratio = 0.0_wp
      !> Conductivity of Poisson's problem
      real(wp) :: conductivity = 1.0_wp
      !> Expressions in their place
      type(expression_type) :: young_of, ratio_of, conductivity_of
      !> Support of functions that interpolate the coefficients between source points, in spacings;
      !> 0 for the coefficients themselves [-]
      real(wp) :: smoothing = 0.0_wp
      !> Plane stress instead of plane strain
      logical :: plane_stress = .false.
      !> Shear force on the end of the cantilever, per thickness [force/length]
      real(wp) :: force = 0.0_wp
      !> Size of the body [length]
      real(wp) :: extent(3) = 1.0_wp
      !> Boundary sets where the solution's values are prescribed; elsewhere its flux is
      integer, allocatable :: essential(:)
      !> Single points where they are
      type(pin_type), allocatable :: pin(:)
   contains
      !> Whether its coefficients vary over the body
      procedure :: varies
      !> Whether the deck has the loads, and not the solution
      procedure :: is_own
      !> Whether a solution is known
      procedure :: is_known
      !> Components of the solution
      procedure :: fields
   end type equation_type

   !> What makes a linear problem move
   type :: motion_type
      !> Mass per volume, and an expression in its place
      real(wp) :: density = 1.0_wp
      type(expression_type) :: density_of
      !> Time step, and the end, which is a multiple of it
      real(wp) :: step = 0.0_wp
      real(wp) :: end = 0.0_wp
      !> Time steps from one state that is written to the next
      integer :: every = 1
      !> Essential rows of collocation as published
      logical :: published = .false.
      !> Displacement and velocity at the start, and expressions in their place
      real(wp) :: displacement(3) = 0.0_wp
      real(wp) :: velocity(3) = 0.0_wp
      type(expression_type) :: displacement_of(3), velocity_of(3)
   contains
      !> Density at a place
      procedure :: density_at
      !> Displacement or velocity at the start
      procedure :: initial
   end type motion_type

contains

!> Density at a place
subroutine density_at(self, x, density, error)
   !> Motion
   class(motion_type), intent(in) :: self
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Mass per volume
   real(wp), intent(out) :: density
   !> Error handling: no value there, or none that is possible
   type(error_type), allocatable, intent(inout) :: error

   density = self%density
   if (self%density_of%given()) call self%density_of%at(x, density, error)
   if (density > 0.0_wp .or. allocated(error)) return
   call fatal_error(error, err_input, self%density_of%where//': must be positive, not ' &
      & //to_text(density)//' as at '//to_text(x))
end subroutine density_at

!> Displacement or velocity at the start
subroutine initial(self, displacement, x, value, error)
   !> Motion
   class(motion_type), intent(in) :: self
   !> The displacement, otherwise the velocity
   logical, intent(in) :: displacement
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Components, those of no meaning 0
   real(wp), intent(out) :: value(3)
   !> Error handling: no value there
   type(error_type), allocatable, intent(inout) :: error
   integer :: i

   value = merge(self%displacement, self%velocity, displacement)
   do i = 1, size(x)
      if (displacement .and. self%displacement_of(i)%given()) then
         call self%displacement_of(i)%at(x, value(i), error)
      else if (.not. displacement .and. self%velocity_of(i)%given()) then
         call self%velocity_of(i)%at(x, value(i), error)
      end if
   end do
end subroutine initial

!> Whether the coefficients vary over the body
pure logical function varies(self)
   !> Equation
   class(equation_type), intent(in) :: self

   varies = self%young_of%given() .or. self%ratio_of%given() .or. self%conductivity_of%given()
end function varies

!> Whether the deck has the loads, and not the solution; so it is in nonlinear scenes
pure logical function is_own(self)
   !> Equation
   class(equation_type), intent(in) :: self

   is_own = .true.
   if (allocated(self%solution)) is_own = self%solution == 'none'
end function is_own

!> Whether a solution is known
pure logical function is_known(self)
   !> Equation
   class(equation_type), intent(in) :: self

   is_known = .not. self%is_own() .or. self%exact_of(1)%given()
end function is_known

!> Components of the solution: one of Poisson's problem, else those of the displacement
pure integer function fields(self, nd)
   !> Equation
   class(equation_type), intent(in) :: self
   !> Space dimension
   integer, intent(in) :: nd

   fields = nd
   if (allocated(self%kind)) fields = merge(1, nd, self%kind == 'poisson')
end function fields

end module rk_equation
