!> What all discretisations of a scene share: shape functions at the collocation points, conditions,
!> and the state of the material at a place. Output and forces know no more of a problem than this.
module rk_discretisation
   use rk_basis, only : second_index
   use rk_conditions, only : boundary_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_mixture, only : mixture_type
   use rk_precision, only : wp
   use rk_problem, only : problem_type
   use rk_programme, only : ramp
   use rk_scene, only : scene_type
   use rk_shape, only : shape_type
   use rk_states, only : field_state, point_state
   use rk_tensor, only : cofactor, determinant
   use rk_text, only : to_text
   implicit none
   private

   public :: discretisation_type, free_discretisation, deformation, entry_displacement, rounding

   !> Stresses below this share of a modulus are roundings [-]
   real(wp), parameter :: rounding = 1.0e4_wp*epsilon(1.0_wp)

   !> A discretised scene
   type, abstract, extends(problem_type) :: discretisation_type
      !> What is modelled
      type(scene_type), pointer :: scene => null()
      !> Unknown fields at each source point
      integer :: fields = 0
      !> Shape functions at the collocation points
      type(shape_type), pointer :: shape => null()
      !> Conditions at boundary points
      type(boundary_type) :: boundary
      !> Materials of the collocation points and of further places behind them
      type(mixture_type) :: mixture
   contains
      !> Unknown fields and derivatives at a place from the unknowns
      procedure :: field
      !> Whether the pressure is a field of its own
      procedure :: has_pressure
      !> Whether a step turns material by a right angle
      procedure :: turns_over
      !> Whether unknowns are those of a body at rest, which nothing moves at a load
      procedure :: at_rest
      !> Largest stress of a state, and the stiffness of which it may be a rounding
      procedure :: largest_stress
      !> The same problem in terms of the amplitudes of modes
      procedure :: reduce
      !> What a user can do where steps vanish but the gradient does not
      procedure :: advice
      !> State of the body, for questions about it
      procedure :: state
      !> State at a place, from the displacement there
      procedure :: at_place
      !> State at a collocation point
      procedure :: at_point
      !> Force that the surroundings exert on the body through a boundary set
      procedure(force_interface), deferred :: set_force
      !> Moment of the forces on a set where it has moved to
      procedure :: set_torque
      !> Displacement of the middle of a set
      procedure :: set_displacement => entry_displacement
      !> Force through a plane section of the body
      procedure :: section_force
      !> Work of the stress against that of the forces
      procedure :: compare_works
      !> The state with the stress of one tissue alone
      procedure :: of_tissue
      !> Energy of the deformation
      procedure :: strain_energy
      !> Points where set_point_loads wants values
      procedure :: load_points
      !> Set what varies over the points and has no place in a deck
      procedure :: set_point_loads
      !> Take other loads and material parameters from the scene
      procedure :: renew
   end type discretisation_type

   abstract interface
      function force_interface(self, set, state, share) result(force)
         import :: discretisation_type, field_state, wp
         !> Problem
         class(discretisation_type), intent(in) :: self
         !> Boundary set
         integer, intent(in) :: set
         !> State
         type(field_state), intent(in) :: state
         !> Part of the way to the next fixed set in which the stress is looked at, where sections
         !> tell the force [-]
         real(wp), intent(in) :: share
         real(wp) :: force(3)
      end function force_interface
   end interface

contains

!> Give back the shape functions, which belong to the problem that made them
subroutine free_discretisation(self)
   !> Problem
   class(discretisation_type), intent(inout) :: self

   if (associated(self%shape)) deallocate (self%shape)
end subroutine free_discretisation

!> Unknown fields and derivatives at a place from the unknowns
subroutine field(self, ip, x, last, u)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> Place
   integer, intent(in) :: ip
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Last derivative wanted
   integer, intent(in) :: last
   !> Fields with derivatives, shape (fields, nq); displacement [length], [-], [1/length]
   real(wp), intent(out) :: u(:, :)

   call self%shape%interpolate(ip, x, 1, last, u)
end subroutine field

!> Whether the pressure is a field of its own, which replaces the volumetric part of the stress
pure logical function has_pressure(self)
   !> Problem
   class(discretisation_type), intent(in) :: self

   has_pressure = self%fields > self%scene%cloud%nd
end function has_pressure

!> The same problem in terms of the amplitudes of modes, of those forms that know how; where there
!> is an energy, modes reduce its derivatives without the form
subroutine reduce(self, modes, problem, error)
   !> Full problem
   class(discretisation_type), intent(in) :: self
   !> Orthonormal modes, shape (n, r)
   real(wp), intent(in) :: modes(:, :)
   !> Its copy in modes, which uses the shape functions of the full one
   class(discretisation_type), allocatable, intent(out) :: problem
   !> Error handling: a form that cannot be reduced
   type(error_type), allocatable, intent(out) :: error

   associate (unused => modes, unused_too => problem)
   end associate
   if (self%scene%galerkin%transformation) then
      call fatal_error(error, err_input, 'modes do not reduce galerkin.essential = ' &
         & //'"transformation": take "penalty"')
      return
   end if
   call fatal_error(error, err_input, 'modes do not reduce method "'//self%scene%method &
      & //'" with a material of K = inf, whose pressures are unknowns: take a finite K, 1e3 ' &
      & //'times the shear modulus, or method "rkcm-mixed"')
end subroutine reduce

!> What a user can do where steps vanish but the gradient does not, in the words of the deck
function advice(self) result(text)
   !> Problem
   class(discretisation_type), intent(in) :: self
   character(len=:), allocatable :: text

   if (self%scene%has_kinks()) then
      text = 'the published fiber curves have kinks, use curve = "smooth"'
   else
      text = 'rounding outweighs what is left (the largest K is ' &
         & //to_text(self%scene%stiffest_ratio(), 2)//' of its shear moduli), or no step leads ' &
         & //'on; take a smaller K, more points or less load'
   end if
end function advice

!> State of the body; a form that needs more than unknowns and load to answer adds it
subroutine state(self, x, load, at)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> State
   type(field_state), intent(out) :: at

   at%x = x
   at%load = load
   at%factor = self%scene%factors(load)
end subroutine state

!> Work of the stress in the state's own displacement less that of the forces, relative; weak forms
!> keep the two equal by construction, which is nothing to compare
subroutine compare_works(self, state, mismatch)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> State
   type(field_state), intent(in) :: state
   !> Mismatch, not allocated where the works are not compared [-]
   real(wp), allocatable, intent(out) :: mismatch

   associate (unused => self, unused_too => state, unused_three => mismatch)
   end associate
end subroutine compare_works

!> Moment of the forces that the surroundings exert on the body through a set, where it has moved
!> to; nonlinear forms know it
function set_torque(self, set, state, about) result(torque)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> State
   type(field_state), intent(in) :: state
   !> Point about which it turns [length]
   real(wp), intent(in) :: about(3)
   real(wp) :: torque(3)

   associate (unused => self, unused_set => set, unused_state => state, unused_about => about)
   end associate
   torque = 0.0_wp
end function set_torque

!> Displacement of the middle of a boundary set: the mean of that of its points, by area
function entry_displacement(self, set, state) result(value)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> State
   type(field_state), intent(in) :: state
   real(wp) :: value(3)
   real(wp) :: u(self%fields, self%shape%nq), total
   integer :: e

   value = 0.0_wp
   total = 0.0_wp
   associate (cloud => self%scene%cloud)
      do e = 1, size(cloud%boundary_point)
         if (.not. cloud%in_set(e, set)) cycle
         call self%field(cloud%boundary_point(e), state%x, 1, u)
         value(:cloud%nd) = value(:cloud%nd) + cloud%area(e)*u(:cloud%nd, 1)
         total = total + cloud%area(e)
      end do
   end associate
   value = value/total
end function entry_displacement

!> Force through a plane section: that of the part behind the normal on the part before it;
!> nonlinear forms know it
function section_force(self, place, normal, state) result(force)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> Point of the plane, shape (nd) [length]
   real(wp), intent(in) :: place(:)
   !> Its unit normal, shape (nd)
   real(wp), intent(in) :: normal(:)
   !> State
   type(field_state), intent(in) :: state
   real(wp) :: force(3)

   associate (unused => self, unused_place => place, unused_normal => normal, unused_state => state)
   end associate
   force = 0.0_wp
end function section_force

!> The state with the stress of one tissue alone, for its part in a force; weak forms know it
subroutine of_tissue(self, state, tissue, own)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> State of the body
   type(field_state), intent(in) :: state
   !> Tissue
   integer, intent(in) :: tissue
   !> The same with other stresses
   type(field_state), intent(out) :: own

   associate (unused => self, unused_too => tissue)
   end associate
   own = state
end subroutine of_tissue

!> Energy of the deformation at the activation of the state: what elastic work has stored, and of
!> active fibers what they could still do [force length]
real(wp) function strain_energy(self, state, tissue) result(energy)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> State of the body
   type(field_state), intent(in) :: state
   !> Tissue whose part is wanted, 0 for all
   integer, intent(in) :: tissue
   type(point_state) :: local
   integer :: ip

   energy = 0.0_wp
   do ip = 1, size(self%scene%cloud%points, 2)
      call self%at_point(state, ip, local)
      energy = energy + self%scene%cloud%volume(ip)*self%mixture%energy(ip, local%f, state%load, &
         & tissue, volumetric=.not. self%has_pressure())
   end do
end function strain_energy

!> State at a collocation point
subroutine at_point(self, state, ip, local)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> State of the body
   type(field_state), intent(in) :: state
   !> Collocation point
   integer, intent(in) :: ip
   !> State there
   type(point_state), intent(out) :: local
   real(wp) :: u(self%fields, self%shape%nq)

   call self%field(ip, state%x, 1 + self%scene%cloud%nd, u)
   call self%at_place(state, ip, self%scene%cloud%points(:, ip), u, local)
end subroutine at_point

!> Stress and deformation at a place from the displacement there
subroutine at_place(self, state, ip, x, u, local)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> State of the body
   type(field_state), intent(in) :: state
   !> Collocation point whose material and fiber hold there
   integer, intent(in) :: ip
   !> Undeformed place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Unknown fields there with derivatives, shape (fields, nq)
   real(wp), intent(in) :: u(:, :)
   !> State there
   type(point_state), intent(out) :: local
   real(wp) :: h(3, 3, 3)

   local%x(:size(x)) = x
   local%u(:size(x)) = u(:size(x), 1)
   call deformation(size(x), u, local%f, h)
   local%j = determinant(local%f)
   call self%mixture%stress(ip, local%f, state%load, local%p, volumetric=.true.)
   ! (5.31b)
   local%cauchy = matmul(local%p, transpose(local%f))/local%j
end subroutine at_place

!> Points where set_point_loads wants values: the collocation points
function load_points(self) result(x)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> Points, shape (nd, n) [length]
   real(wp), allocatable :: x(:, :)

   x = self%scene%cloud%points
end function load_points

!> Set what varies over the points and has no place in a deck, at full load of the ramp
subroutine set_point_loads(self, body_force, displacement, stress)
   !> Problem
   class(discretisation_type), intent(inout) :: self
   !> Body force per undeformed volume, shape (3, n) [force/length^3]
   real(wp), intent(in) :: body_force(:, :)
   !> Displacement of the essential components, shape (3, n) [length]
   real(wp), intent(in) :: displacement(:, :)
   !> Stress P(i, A) whose traction the other components carry, shape (3, 3, n) [stress]
   real(wp), intent(in) :: stress(:, :, :)
   integer :: b, i, nd

   nd = self%scene%cloud%nd
   self%scene%body_force = body_force
   associate (boundary => self%boundary)
      boundary%value = 0.0_wp
      boundary%traction = 0.0_wp
      do b = 1, size(boundary%point)
         do i = 1, nd
            boundary%value(ramp, i, b) = displacement(i, boundary%point(b))
            boundary%traction(ramp, i, b) = dot_product(stress(i, :nd, boundary%point(b)), &
               & boundary%normal(:, i, b))
         end do
      end do
   end associate
end subroutine set_point_loads

!> Take other loads and material parameters from the scene, whose points, conditions and tissues are
!> as they were; shape functions stay
subroutine renew(self, materials, error)
   !> Problem
   class(discretisation_type), intent(inout) :: self
   !> Material parameters have changed as well
   logical, intent(in) :: materials
   !> Error handling: a form that cannot
   type(error_type), allocatable, intent(out) :: error

   associate (unused => materials)
   end associate
   call fatal_error(error, err_input, 'a linear problem cannot be changed: open another scene')
   associate (unused => self)
   end associate
end subroutine renew

!> Whether x.(F F_0^-1)x is not positive for some x in more than a few places, with F_0 and F before
!> and after a step; at singular corners F is anything
function turns_over(self, before, after) result(found)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> Unknowns, shape (n) each
   real(wp), contiguous, intent(in) :: before(:), after(:)
   logical :: found
   ! share of the places at which a step may turn material [-]
   real(wp), parameter :: few_places = 0.05_wp
   real(wp) :: u(self%fields, self%shape%nq), f(3, 3), f0(3, 3), h(3, 3, 3), turn(3, 3)
   integer :: ip, nd, places

   places = 0
   nd = self%scene%cloud%nd
   do ip = 1, size(self%scene%cloud%points, 2)
      call self%field(ip, before, 1 + nd, u)
      call deformation(nd, u, f0, h)
      call self%field(ip, after, 1 + nd, u)
      call deformation(nd, u, f, h)
      ! J_0 F F_0^-1, whose factor is positive
      turn = matmul(f, transpose(cofactor(f0)))
      turn = 0.5_wp*(turn + transpose(turn))
      if (.not. (turn(1, 1) > 0.0_wp .and. determinant(turn) > 0.0_wp &
         & .and. turn(1, 1)*turn(2, 2) > turn(1, 2)**2)) places = places + 1
   end do
   found = places > few_places*size(self%scene%cloud%points, 2)
end function turns_over

!> Whether unknowns are those of a body at rest, which nothing moves at a load
logical function at_rest(self, x, load)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   type(field_state) :: state
   real(wp) :: stress, stiffness

   at_rest = .false.
   if (any(abs(x) > 0.0_wp) .or. allocated(self%scene%body_force)) return
   if (self%scene%is_loaded(load)) return
   ! fibers of lambda_o < 1 pull without activation
   call self%state(x, load, state)
   call self%largest_stress(state, stress, stiffness)
   at_rest = stress <= rounding*stiffness
end function at_rest

!> Largest stress of a state at the collocation points, and the stiffness of which it may be a
!> rounding
subroutine largest_stress(self, state, stress, stiffness)
   !> Problem
   class(discretisation_type), intent(in) :: self
   !> State
   type(field_state), intent(in) :: state
   !> Largest component of P [stress]
   real(wp), intent(out) :: stress
   !> Largest modulus of the materials [stress]
   real(wp), intent(out) :: stiffness
   type(point_state) :: local
   integer :: ip, k

   stiffness = 0.0_wp
   do k = 1, size(self%scene%tissue)
      associate (material => self%scene%tissue(k)%material)
         stiffness = max(stiffness, material%shear)
         if (.not. material%incompressible()) stiffness = max(stiffness, material%bulk)
      end associate
   end do
   stress = 0.0_wp
   do ip = 1, size(self%scene%cloud%points, 2)
      call self%at_point(state, ip, local)
      stress = max(stress, maxval(abs(local%p)))
   end do
end subroutine largest_stress

!> Deformation gradient (5.28), (5.29) and its derivatives from the displacement's derivatives
pure subroutine deformation(nd, u, f, h)
   !> Space dimension
   integer, intent(in) :: nd
   !> Fields with derivatives, the displacement first, shape (>= nd, nq)
   real(wp), intent(in) :: u(:, :)
   !> F(i, A) [-]
   real(wp), intent(out) :: f(3, 3)
   !> u_j,BA as h(j, B, A), zero where the fields have no second derivatives [1/length]
   real(wp), intent(out) :: h(3, 3, 3)
   integer :: a, b, q

   f = 0.0_wp
   h = 0.0_wp
   do a = 1, 3
      f(a, a) = 1.0_wp
   end do
   do a = 1, nd
      f(:nd, a) = f(:nd, a) + u(:nd, 1 + a)
      if (size(u, 2) == 1 + nd) cycle
      do b = a, nd
         q = second_index(nd, a, b)
         h(:nd, b, a) = u(:nd, q)
         h(:nd, a, b) = u(:nd, q)
      end do
   end do
end subroutine deformation

end module rk_discretisation
