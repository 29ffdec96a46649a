!> A scene: the model of a run, as plain data.
module rk_scene
   use rk_cloud, only : cloud_type
   use rk_equation, only : equation_type, motion_type
   use rk_error, only : error_type
   use rk_expression, only : expression_type, value_type
   use rk_kernel, only : window_product
   use rk_margin, only : margin_type, new_margin
   use rk_material, only : material_type
   use rk_deck_records, only : approximation_keys, boundary_keys, exact_keys, galerkin_keys, &
      & load_keys, mixed_keys, probe_keys, reference_keys, solver_keys
   use rk_precision, only : wp
   use rk_programme, only : plan_type, programme_type, ramp
   use rk_shape, only : approximation_type, new_shape, shape_type
   implicit none
   private

   public :: last_part, scene_type, tissue_type, condition_type, probe_type, displacement_weight

   !> Weight of the displacement rows of the mixed form, and of balanced ones of collocation, in
   !> shear moduli over spacing [-]
   real(wp), parameter :: displacement_weight = 15.0_wp

   !> A material and the label of its points
   type :: tissue_type
      !> Law and parameters
      class(material_type), allocatable :: material
      !> Name in the deck
      character(len=:), allocatable :: name
      !> Label of the points; 0 fills all points
      integer :: label = 0
      !> Part of a box or an annulus that it may fill; not given if labels of the points define it,
      !> or if it fills the remainder
      type(expression_type) :: part
      !> Activation of its fibers when its amplitude is 1 [-]
      real(wp) :: activation = 0.0_wp
      !> Amplitude of the activation, 0 for the ramp
      integer :: amplitude = 0
      !> Relative activation at each position, instead of that of the points [-]
      type(expression_type) :: level
   end type tissue_type

   !> Values prescribed on a boundary set when its amplitude is 1, in addition to the numbers of the
   !> deck, which are 0 if not given
   type, extends(boundary_keys) :: condition_type
      !> Boundary set
      integer :: set = 0
      !> Prescribed displacement components; for a tendon those in which its direction has a part,
      !> which its plate moves
      logical :: fixed(3) = .false.
      !> Their values [length]
      type(value_type) :: value(3)
      !> Radial displacement about the third axis replaces the components
      logical :: is_radial = .false.
      !> Load factor of the sine of a rotation, followed by that of 1 - cos; 0 without a rotation
      integer :: sine = 0
   contains
      procedure :: moves_unevenly, acts, prescribes
   end type condition_type

   !> Iteration, linear solver and weights of boundary rows
   type, extends(solver_keys) :: solver_options
      !> Weight of rows of prescribed displacements as a plain number, used if positive
      real(wp) :: weight_essential
      !> Otherwise: this number times max|C4| at the point; 0 means the number of source points
      real(wp) :: weight_c4
      !> Weight of traction rows
      real(wp) :: weight_traction
   end type solver_options

   !> A number or vector to record in every step
   type, extends(probe_keys) :: probe_type
      !> Boundary set of which it is taken, 0 for a point or a plane
      integer :: set = 0
   contains
      procedure :: of_body, at_a_place
   end type probe_type

   !> All data that a solve needs
   type :: scene_type
      !> Title of the model
      character(len=:), allocatable :: title
      !> Discretisation
      character(len=:), allocatable :: method
      !> Points
      type(cloud_type) :: cloud
      !> Shape functions
      type(approximation_type) :: approximation
      !> Whether a material in space is a layer thinner than the points resolve
      logical :: thin_layers = .false.
      !> Whether coefficients of a linear problem jump across surfaces other than planes
      logical :: jumps = .false.
      !> Support of each source point, shape (nd, ns) [length]
      real(wp), allocatable :: support(:, :)
      !> Shape functions as given in the deck, and interfaces between materials
      type(approximation_keys) :: basis
      !> Linear problem, instead of materials, conditions and loads
      type(equation_type) :: equation
      !> Its motion, not allocated in statics
      type(motion_type), allocatable :: motion
      !> Materials
      type(tissue_type), allocatable :: tissue(:)
      !> Material of each collocation point, shape (nc)
      integer, allocatable :: tissue_of(:)
      !> Fraction of each material in the volume of a collocation point, shape (nt, nc) [-]; not
      !> allocated if each point has one material
      real(wp), allocatable :: tissue_part(:, :)
      !> Units of force and length, printed with every number
      character(len=:), allocatable :: force_unit, length_unit
      !> Boundary conditions
      type(condition_type), allocatable :: condition(:)
      !> Load steps and activation
      type(load_keys) :: load
      !> Load programme
      type(programme_type) :: programme
      !> Body force at full load per undeformed volume, zero if not allocated, shape (3, points
      !> required by the form) [force/length^3]
      real(wp), allocatable :: body_force(:, :)
      !> Its integral over the body [force]
      real(wp) :: weight(3) = 0.0_wp
      !> Iteration, linear solver, weights of boundary rows
      type(solver_options) :: solver
      !> Mixed form
      type(mixed_keys) :: mixed
      !> Galerkin form
      type(galerkin_keys) :: galerkin
      !> Probes
      type(probe_type), allocatable :: probe(:)
      !> Exact solutions
      type(exact_keys), allocatable :: exact(:)
      !> Reference values
      type(reference_keys), allocatable :: reference(:)
   contains
      procedure :: steps => count_steps, factors, activation_at, common_activation
      procedure :: common_tissue, has_own_activations, is_loaded, changes, shape_at, runs_out
      procedure :: stiffest_ratio, has_kinks
   end type scene_type

contains

!> Number of load steps; for a motion, number of states written
pure integer function count_steps(self)
   class(scene_type), intent(in) :: self
   type(plan_type) :: planned

   if (allocated(self%motion)) then
      count_steps = (nint(self%motion%end_time/self%motion%time_step) + self%motion%every - 1) &
         & /self%motion%every
      return
   end if
   planned = self%programme%plan(self%load%steps)
   count_steps = size(planned%load)
end function count_steps

!> Load factors at a load; prescribed values are linear in them
pure function factors(self, load) result(factor)
   class(scene_type), intent(in) :: self
   !> Load [-]
   real(wp), intent(in) :: load
   !> Factors, shape (factors) [-]
   real(wp) :: factor(self%programme%count())

   factor = self%programme%factors(load)
end function factors

!> Activation of a tissue's fibers at a load [-]
elemental real(wp) function activation_at(self, tissue, load)
   class(scene_type), intent(in) :: self
   integer, intent(in) :: tissue
   real(wp), intent(in) :: load

   associate (muscle => self%tissue(tissue))
      activation_at = self%programme%value(muscle%amplitude, load)*muscle%activation
   end associate
end function activation_at

!> A tissue with the activation that all muscles have; 0 if they differ or there is none
pure integer function common_tissue(self) result(common)
   class(scene_type), intent(in) :: self
   integer :: k

   common = 0
   if (.not. allocated(self%tissue)) return
   do k = 1, size(self%tissue)
      if (.not. self%tissue(k)%material%fibered) cycle
      if (common == 0) then
         common = k
      else if (self%tissue(k)%amplitude /= self%tissue(common)%amplitude &
         & .or. abs(self%tissue(k)%activation - self%tissue(common)%activation) > 0.0_wp) then
         common = 0
         return
      end if
   end do
   ! an expression gives different activations to the points of one tissue
   if (any([(self%tissue(k)%level%given(), k=1, size(self%tissue))])) common = 0
end function common_tissue

!> Activation at a load of all muscles, or of those without their own one [-]
elemental real(wp) function common_activation(self, load)
   class(scene_type), intent(in) :: self
   real(wp), intent(in) :: load
   integer :: k

   k = self%common_tissue()
   if (k > 0) then
      common_activation = self%activation_at(k, load)
   else
      common_activation = self%programme%value(self%load%amplitude, load)*self%load%activation
   end if
end function common_activation

!> Whether muscles have different activations
pure logical function has_own_activations(self) result(own)
   class(scene_type), intent(in) :: self
   integer :: k

   own = .false.
   if (allocated(self%tissue)) own = self%common_tissue() == 0 &
      & .and. any([(self%tissue(k)%material%fibered, k=1, size(self%tissue))])
end function has_own_activations

!> Whether a muscle is active or a condition acts at a load
pure logical function is_loaded(self, load)
   class(scene_type), intent(in) :: self
   real(wp), intent(in) :: load
   integer :: k

   is_loaded = any([(self%activation_at(k, load) > 0.0_wp, k=1, size(self%tissue))]) &
      & .or. any([(self%condition(k)%acts(self%factors(load)), k=1, size(self%condition))])
end function is_loaded

!> Whether a muscle, a condition or a body force acts differently at two loads
pure logical function changes(self, from, to)
   class(scene_type), intent(in) :: self
   !> Loads [-]
   real(wp), intent(in) :: from, to
   integer :: k

   changes = allocated(self%body_force) .or. any([(abs(self%activation_at(k, to) &
      & - self%activation_at(k, from)) > 0.0_wp, k=1, size(self%tissue))]) &
      & .or. any([(self%condition(k)%acts(self%factors(to) - self%factors(from)), k=1, &
      & size(self%condition))])
end function changes

!> Whether prescribed displacements vary over the set
pure logical function moves_unevenly(self)
   class(condition_type), intent(in) :: self

   moves_unevenly = self%is_radial .or. self%sine > 0 .or. any(self%value%given())
end function moves_unevenly

!> Whether a probe refers to a whole body or tissue
pure logical function of_body(self)
   class(probe_type), intent(in) :: self

   of_body = any(self%quantity == [character(len=13) :: 'energy', 'fiber_stretch', 'pennation'])
end function of_body

!> Whether a probe refers to a point in the body, not to a set, a plane or the whole body
pure logical function at_a_place(self)
   class(probe_type), intent(in) :: self

   at_a_place = self%set == 0 .and. .not. self%of_body() .and. index(self%quantity, 'section') /= 1
end function at_a_place

!> Whether a displacement or a traction that need not be zero is prescribed
pure logical function acts(self, factor)
   class(condition_type), intent(in) :: self
   !> Load factors to check; without them, whether it acts at any, shape (factors) [-]
   real(wp), intent(in), optional :: factor(:)

   acts = (self%is_radial .and. abs(self%radial) > 0.0_wp) &
      & .or. any(self%value%acts() .and. self%fixed) .or. any(self%traction%acts()) &
      & .or. abs(self%pressure) > 0.0_wp .or. abs(self%pull) > 0.0_wp
   if (.not. present(factor)) then
      acts = acts .or. self%sine > 0
      return
   end if
   acts = acts .and. abs(factor(ramp + self%amplitude)) > 0.0_wp
   if (self%sine > 0) acts = acts .or. any(abs(factor(self%sine:self%sine + 1)) > 0.0_wp)
end function acts

!> Displacement components that a condition prescribes
pure function prescribes(self) result(fixed)
   class(condition_type), intent(in) :: self
   logical :: fixed(3)

   fixed = self%fixed
   if (self%is_radial) fixed(:2) = .true.
end function prescribes

!> Shape functions of the source points at given positions
subroutine shape_at(self, place, shape, error, first, plain)
   class(scene_type), intent(in) :: self
   !> Positions, shape (nd, np) [length]
   real(wp), intent(in) :: place(:, :)
   type(shape_type), intent(out) :: shape
   !> Error handling: a position covered by too few source points
   type(error_type), allocatable, intent(out) :: error
   !> First derivatives only
   logical, intent(in), optional :: first
   !> Values only
   logical, intent(in), optional :: plain

   type(margin_type), allocatable :: margin

   if (self%runs_out()) then
      allocate (margin)
      call new_margin(margin, self%cloud%lattice, self%cloud%source, self%support, &
         & self%approximation%kink_axis, self%approximation%kink)
   end if
   call new_shape(shape, self%approximation, self%cloud%source, self%support, place, error, first, &
      & plain, margin)
end subroutine shape_at

!> Whether functions run out parabolically at the sides of a box; wider supports would need more
!> than one layer of points beyond them
pure logical function runs_out(self)
   class(scene_type), intent(in) :: self

   runs_out = self%method == 'rkpm-gauss' .and. self%approximation%order == 1 &
      & .and. self%approximation%window == window_product &
      & .and. allocated(self%cloud%lattice) .and. .not. self%cloud%polar
   if (runs_out) runs_out = all(self%basis%support(:self%cloud%nd) <= 2.0_wp)
end function runs_out

!> Last material whose part of the body contains a position, 0 if none does
integer function last_part(tissue, x, error) result(found)
   type(tissue_type), intent(in) :: tissue(:)
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Error handling: an expression without a value there
   type(error_type), allocatable, intent(inout) :: error
   real(wp) :: value

   do found = size(tissue), 1, -1
      if (.not. tissue(found)%part%given()) return
      call tissue(found)%part%at(x, value, error)
      if (allocated(error)) exit
      if (abs(value) > 0.0_wp) return
   end do
   found = max(found, 0)
end function last_part

!> Largest ratio of a bulk modulus to its shear modulus, which makes the displacement form lock [-]
pure real(wp) function stiffest_ratio(self)
   class(scene_type), intent(in) :: self
   integer :: k

   stiffest_ratio = 0.0_wp
   do k = 1, size(self%tissue)
      stiffest_ratio = max(stiffest_ratio, self%tissue(k)%material%bulk &
         & /self%tissue(k)%material%shear)
   end do
end function stiffest_ratio

!> Whether the stress of a material has kinks
pure logical function has_kinks(self)
   class(scene_type), intent(in) :: self
   integer :: k

   has_kinks = any([(self%tissue(k)%material%kinked, k=1, size(self%tissue))])
end function has_kinks

end module rk_scene
