!> Common part of all discretisations of a scene: shape functions at the collocation points,
!> conditions, and the state of the material at a place. Output and forces use nothing else.
module rk_discretisation
   use, intrinsic :: ieee_arithmetic, only : ieee_is_finite
   use rk_basis, only : second_index
   use rk_coefficients, only : coefficient_at, moduli
   use rk_conditions, only : boundary_type
   use rk_equation, only : equation_type
   use rk_error, only : error_type
   use rk_mixture, only : mixture_type
   use rk_precision, only : wp
   use rk_problem, only : problem_type
   use rk_programme, only : ramp
   use rk_scene, only : scene_type
   use rk_shape, only : shape_type
   use rk_states, only : field_state, point_state
   use rk_tensor, only : cofactor, determinant
   implicit none
   private

   public :: discretisation_type, free_discretisation, deformation, gradients, entry_displacement
   public :: at_rest, has_few_cells, judged_state, rounding, small_strain, turns_over

   !> Number of source points across a body up to which they are few: with two cells volume exchange
   !> in groups is part of bending, and the tangent is judged unchanged
   integer, parameter :: few_points = 4
   !> Stresses below this share of a modulus are rounding errors [-]
   real(wp), parameter :: rounding = 1.0e4_wp*epsilon(1.0_wp)
   !> Strains below this share of the body's translation and rotation are errors of iterations [-]
   real(wp), parameter :: of_motion = 1.0e-6_wp
   !> Strains above this never count as such errors [-]
   real(wp), parameter :: most_slack = 1.0e-5_wp
   !> Stresses below this share of the strain times the shear modulus are errors of iterations:
   !> those of a muscle that contracts freely [-]
   real(wp), parameter :: of_strain = 1.0e-7_wp
   !> Stresses of linear problems below this share of the displacement gradient times the shear
   !> modulus are rounding errors: those of a body in rigid motion [-]
   real(wp), parameter :: of_gradient = 1.0e-11_wp
   !> Loads whose displacements fall below this share of the largest have been removed again [-]
   real(wp), parameter :: taken_off = 0.5_wp

   !> A discretised scene
   type, abstract, extends(problem_type) :: discretisation_type
      !> Unknown fields at each source point
      integer :: fields = 0
      !> Shape functions at the collocation points
      type(shape_type), pointer :: shape => null()
      !> Conditions at boundary points
      type(boundary_type) :: boundary
      !> Materials of the collocation points, followed by those of further places
      type(mixture_type) :: mixture
      !> Unknowns are the amplitudes of modes
      logical :: reduced = .false.
      !> The work of the stress shows whether a state is in equilibrium; in weak forms it equals
      !> that of the forces by construction, so that a comparison is useless
      logical :: compares_works = .false.
   contains
      procedure :: field, state, at_place
      !> Force that the surroundings exert on the body through a boundary set, or its moment
      procedure(force_interface), deferred :: set_force
      procedure :: set_displacement => entry_displacement
      !> Force through a plane section of the body
      procedure(section_interface), deferred :: section_force
      procedure :: strain_energy, set_point_loads
      procedure, non_overridable :: has_pressure
      procedure, non_overridable :: linear_place
      procedure, non_overridable :: at_point, keep_places, largest_stress, negligible_stress
      procedure, non_overridable :: unstrained
   end type discretisation_type

   abstract interface
      function force_interface(self, set, state, share, about) result(force)
         import :: discretisation_type, field_state, wp
         class(discretisation_type), intent(in) :: self
         !> Boundary set
         integer, intent(in) :: set
         type(field_state), intent(in) :: state
         !> Part of the distance to the next fixed set in which the stress is evaluated, where
         !> sections give the force [-]
         real(wp), intent(in) :: share
         !> Point about which the moment is wanted, of the forces in the deformed position;
         !> available in nonlinear forms [length]
         real(wp), intent(in), optional :: about(3)
         real(wp) :: force(3)
      end function force_interface
      !> Force through a plane section: that of the part behind the plane on the part before it
      function section_interface(self, place, normal, state) result(force)
         import :: discretisation_type, field_state, wp
         class(discretisation_type), intent(in) :: self
         !> Point of the plane, shape (nd) [length]
         real(wp), intent(in) :: place(:)
         !> Its unit normal, shape (nd)
         real(wp), intent(in) :: normal(:)
         type(field_state), intent(in) :: state
         real(wp) :: force(3)
      end function section_interface
   end interface

contains

!> Free the shape functions, which belong to the problem that created them
subroutine free_discretisation(self)
   class(discretisation_type), intent(inout) :: self

   if (associated(self%shape)) deallocate (self%shape)
end subroutine free_discretisation

!> Unknown fields and derivatives at a place from the unknowns
subroutine field(self, ip, x, last, u)
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

!> Whether the pressure is a separate field, which replaces the volumetric part of the stress
pure logical function has_pressure(self)
   class(discretisation_type), intent(in) :: self

   has_pressure = self%fields > self%scene%cloud%nd
end function has_pressure

!> State of the body; a form that needs more than unknowns and load adds its own data
subroutine state(self, x, load, at, tissue)
   class(discretisation_type), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   type(field_state), intent(out) :: at
   !> Tissue whose stress alone is wanted, for its part in a force; available in weak forms
   integer, intent(in), optional :: tissue

   at%x = x
   at%load = load
   at%factor = self%scene%factors(load)
   if (present(tissue)) at%tissue = tissue
end subroutine state

!> Mean displacement of a boundary set: that of its points, weighted by area
function entry_displacement(self, set, state) result(value)
   class(discretisation_type), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
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

!> Strain energy at the activation of the state: stored elastic work, and the work that active
!> fibers can still do [force length]
real(wp) function strain_energy(self, state, tissue) result(energy)
   class(discretisation_type), intent(in) :: self
   type(field_state), intent(in) :: state
   !> Tissue whose part is wanted, 0 for all
   integer, intent(in) :: tissue
   type(point_state) :: local
   real(wp) :: density, part, u(self%fields, self%shape%nq)
   integer :: ip

   energy = 0.0_wp
   do ip = 1, size(self%scene%cloud%points, 2)
      call self%at_point(state, ip, local)
      density = self%mixture%energy(ip, local%f, state%load, tissue, &
         & volumetric=.not. self%has_pressure())
      if (self%has_pressure()) then
         part = 1.0_wp
         if (tissue > 0) part = self%mixture%part_of(ip, tissue)
         call self%field(ip, state%x, 1, u)
         ! zero where volume is preserved
         density = density + 0.5_wp*part*u(self%scene%cloud%nd + 1, 1)**2/self%mixture%bulk(ip)
      end if
      energy = energy + self%scene%cloud%volume(ip)*density
   end do
end function strain_energy

subroutine at_point(self, state, ip, local)
   class(discretisation_type), intent(in) :: self
   type(field_state), intent(in) :: state
   !> Collocation point
   integer, intent(in) :: ip
   type(point_state), intent(out) :: local
   real(wp) :: u(self%fields, self%shape%nq)

   if (allocated(state%place)) then
      local = state%place(ip)
      return
   end if
   call self%field(ip, state%x, 1 + self%scene%cloud%nd, u)
   call self%at_place(state, ip, self%scene%cloud%points(:, ip), u, local)
end subroutine at_point

!> Store the material states at the collocation points, for several evaluations of a state
subroutine keep_places(self, state)
   class(discretisation_type), intent(in) :: self
   type(field_state), intent(inout) :: state
   type(point_state), allocatable :: place(:)
   integer :: ip

   allocate (place(size(self%scene%cloud%points, 2)))
   !$omp parallel do default(none) schedule(static) private(ip) shared(self, state, place)
   do ip = 1, size(place)
      call self%at_point(state, ip, place(ip))
   end do
   !$omp end parallel do
   call move_alloc(place, state%place)
end subroutine keep_places

!> Stress and deformation at a place from the displacement there
subroutine at_place(self, state, ip, x, u, local)
   class(discretisation_type), intent(in) :: self
   type(field_state), intent(in) :: state
   !> Collocation point whose material and fiber apply there
   integer, intent(in) :: ip
   !> Undeformed place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Unknown fields there with derivatives, shape (fields, nq)
   real(wp), intent(in) :: u(:, :)
   type(point_state), intent(out) :: local
   real(wp) :: h(3, 3, 3)

   if (self%linear) then
      call self%linear_place(ip, x, u, local)
      return
   end if
   local%x(:size(x)) = x
   local%u(:size(x)) = u(:size(x), 1)
   call deformation(size(x), u, local%f, h)
   local%j = determinant(local%f)
   call self%mixture%stress(ip, local%f, state%load, local%p, volumetric=.not. self%has_pressure())
   if (self%has_pressure()) local%p = local%p + u(size(x) + 1, 1)*cofactor(local%f)
   ! (5.31b)
   local%cauchy = matmul(local%p, transpose(local%f))/local%j
end subroutine at_place

!> Small strain stress at a place; for a scalar problem only the value
subroutine linear_place(self, ip, x, u, local, pressure)
   class(discretisation_type), intent(in) :: self
   !> Collocation point nearest to the place
   integer, intent(in) :: ip
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Fields with derivatives, shape (fields, nq)
   real(wp), intent(in) :: u(:, :)
   type(point_state), intent(out) :: local
   !> Stress that replaces the one by lambda [stress]
   real(wp), intent(in), optional :: pressure
   type(error_type), allocatable :: error
   real(wp) :: pair(2)

   ! interpolated coefficients are not known between collocation points
   pair = self%mixture%pair(:, ip)
   if (.not. self%scene%equation%smoothing > 0.0_wp) &
      & call coefficient_at(self%scene%equation, x, pair, error)
   call small_strain(self%scene%equation, pair, x, u, local, pressure)
end subroutine linear_place

!> Small strain stress from the derivatives at a place; for a scalar problem only the value
pure subroutine small_strain(equation, pair, x, u, local, pressure)
   type(equation_type), intent(in) :: equation
   !> Lambda and mu there [stress]
   real(wp), intent(in) :: pair(2)
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Fields with derivatives, shape (fields, nq)
   real(wp), intent(in) :: u(:, :)
   type(point_state), intent(out) :: local
   !> Stress that replaces the one by lambda [stress]
   real(wp), intent(in), optional :: pressure
   real(wp) :: modulus(3, 3, 3, 3), lambda
   integer :: a, d, k, nd
   logical :: across

   nd = size(x)
   local%x(:nd) = x
   local%u(:size(u, 1)) = u(:, 1)
   do a = 1, 3
      local%f(a, a) = 1.0_wp
   end do
   if (equation%problem == 'poisson') return
   local%f(:nd, :nd) = local%f(:nd, :nd) + u(:, 2:1 + nd)
   local%j = determinant(local%f)
   lambda = pair(1)
   if (present(pressure)) lambda = 0.0_wp
   modulus = moduli(equation, [lambda, pair(2)])
   do d = 1, nd
      do k = 1, nd
         do a = 1, nd
            local%p(:nd, a) = local%p(:nd, a) + modulus(:nd, a, k, d)*u(k, 1 + d)
         end do
      end do
   end do
   across = nd == 2
   if (across) local%p(3, 3) = lambda*(u(1, 2) + u(2, 3))
   if (present(pressure)) then
      do a = 1, merge(3, nd, across)
         local%p(a, a) = local%p(a, a) + pressure
      end do
   end if
   local%cauchy = local%p
end subroutine small_strain

!> Set loads that vary over the points and cannot be given in a deck, at full load of the ramp
subroutine set_point_loads(self, body_force, displacement, stress, place)
   class(discretisation_type), intent(inout) :: self
   !> Body force per undeformed volume, shape (3, n) [force/length^3]
   real(wp), intent(in) :: body_force(:, :)
   !> Displacement of the prescribed components, shape (3, n) [length]
   real(wp), intent(in) :: displacement(:, :)
   !> Stress P(i, A) whose traction the other components carry, shape (3, 3, n) [stress]
   real(wp), intent(in) :: stress(:, :, :)
   !> Only return the points where values are wanted: the collocation points, shape (nd, n) [length]
   real(wp), allocatable, intent(out), optional :: place(:, :)
   integer :: b, i, nd

   if (present(place)) then
      place = self%scene%cloud%points
      return
   end if
   nd = self%scene%cloud%nd
   self%scene%body_force = body_force
   self%scene%weight = matmul(body_force, self%scene%cloud%volume)
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

!> Whether a step rotates material by a right angle or more somewhere, beyond which the iteration
!> may reach a different solution: a block that is stretched to six times its length can end with
!> its sides exchanged, in equilibrium and with J > 0. Then x.(F F_0^-1)x is not positive for some x
!> in more than a few places, with F_0 and F before and after; at singular corners F is arbitrary.
function turns_over(problem, before, after) result(found)
   !> Problem; only full discretisations are checked
   class(problem_type), intent(in) :: problem
   !> Unknowns, shape (n) each
   real(wp), contiguous, intent(in) :: before(:), after(:)
   logical :: found
   ! share of the places at which a step may rotate material so far [-]
   real(wp), parameter :: few_places = 0.05_wp
   real(wp) :: f(3, 3), f0(3, 3), h(3, 3, 3), turn(3, 3)
   real(wp), allocatable :: u(:, :)
   integer :: ip, nd, places

   found = .false.
   select type (problem)
   class is (discretisation_type)
      if (problem%reduced) return
      places = 0
      nd = problem%scene%cloud%nd
      allocate (u(problem%fields, problem%shape%nq))
      do ip = 1, size(problem%scene%cloud%points, 2)
         call problem%field(ip, before, 1 + nd, u)
         call deformation(nd, u, f0, h)
         call problem%field(ip, after, 1 + nd, u)
         call deformation(nd, u, f, h)
         ! J_0 F F_0^-1, with J_0 > 0
         turn = matmul(f, transpose(cofactor(f0)))
         turn = 0.5_wp*(turn + transpose(turn))
         if (.not. (turn(1, 1) > 0.0_wp .and. determinant(turn) > 0.0_wp &
            & .and. turn(1, 1)*turn(2, 2) > turn(1, 2)**2)) places = places + 1
      end do
      found = places > few_places*size(problem%scene%cloud%points, 2)
   end select
end function turns_over

!> The state of a run by which its answer is judged: the last one, whatever the way there, or where
!> the loads were removed again the one with the largest displacements
integer function judged_state(problem, x) result(judged)
   class(problem_type), intent(in) :: problem
   !> Unknowns of the states, shape (n, states)
   real(wp), contiguous, intent(in) :: x(:, :)
   real(wp) :: sizes(2, size(x, 2))
   integer :: k

   sizes = reshape([(problem%scaled_norms(x(:, k)), k=1, size(x, 2))], shape(sizes))
   judged = size(x, 2)
   if (sizes(1, judged) < taken_off*maxval(sizes(1, :))) judged = maxloc(sizes(1, :), dim=1)
end function judged_state

!> Whether a lattice has few cells in some direction
pure logical function has_few_cells(scene)
   type(scene_type), intent(in) :: scene

   has_few_cells = .false.
   if (allocated(scene%cloud%lattice)) has_few_cells = minval(scene%cloud%lattice) <= few_points
end function has_few_cells

!> Whether unknowns are those of a body at rest that no load or stress sets in motion at a load
logical function at_rest(problem, x, load)
   !> Problem; only full discretisations are checked
   class(problem_type), intent(in) :: problem
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   type(field_state) :: state
   real(wp) :: stress, stiffness

   at_rest = .false.
   if (any(abs(x) > 0.0_wp) .or. allocated(problem%scene%body_force)) return
   select type (problem)
   class is (discretisation_type)
      if (problem%reduced .or. problem%scene%is_loaded(load)) return
      ! fibers of lambda_o < 1 are in tension without activation
      call problem%state(x, load, state)
      call problem%largest_stress(state, stress, stiffness)
      at_rest = stress <= rounding*stiffness
   end select
end function at_rest

!> Largest stress of a state at the collocation points, and the stiffness of which it may be a
!> rounding error
subroutine largest_stress(self, state, stress, stiffness)
   class(discretisation_type), intent(in) :: self
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

!> Stress that is an error of the iteration beside the mean strain of a state, in linear problems
!> one of rounding beside its mean displacement gradient [stress]
real(wp) function negligible_stress(self, state) result(stress)
   class(discretisation_type), intent(in) :: self
   type(field_state), intent(in) :: state
   type(point_state) :: local
   real(wp) :: h(3, 3), shear
   integer :: i, ip

   stress = 0.0_wp
   if (self%fields < self%scene%cloud%nd) return
   associate (cloud => self%scene%cloud)
      do ip = 1, size(cloud%points, 2)
         call self%at_point(state, ip, local)
         h = local%f
         if (.not. self%linear) h = matmul(transpose(h), h)
         do i = 1, 3
            h(i, i) = h(i, i) - 1.0_wp
         end do
         ! no more than a body can be sheared; J may be zero at singular corners
         if (.not. ieee_is_finite(norm2(h))) cycle
         if (self%linear) then
            shear = of_gradient*self%mixture%pair(2, ip)
         else
            shear = of_strain*self%scene%tissue(self%scene%tissue_of(ip))%material%shear
         end if
         stress = stress + cloud%volume(ip)*shear*min(norm2(h), 1.0_wp)
      end do
      stress = stress/sum(cloud%volume)
   end associate
end function negligible_stress

!> Whether strains and stresses of a state are rounding errors: of a body at rest, or in rigid
!> motion
logical function unstrained(self, state)
   class(discretisation_type), intent(in) :: self
   type(field_state), intent(in) :: state
   type(point_state) :: local
   real(wp) :: h(3, 3), strain, stress, stiffness, motion(2)
   integer :: i, ip

   unstrained = .false.
   if (self%linear) return
   motion = 0.0_wp
   strain = 0.0_wp
   associate (points => self%scene%cloud%points)
      do ip = 1, size(points, 2)
         call self%at_point(state, ip, local)
         h = matmul(transpose(local%f), local%f)
         do i = 1, 3
            h(i, i) = h(i, i) - 1.0_wp
            local%f(i, i) = local%f(i, i) - 1.0_wp
         end do
         strain = max(strain, 0.5_wp*norm2(h))
         if (.not. strain <= most_slack) return
         motion = max(motion, [norm2(local%u), norm2(local%f)])
      end do
      motion(1) = motion(1)/norm2(maxval(points, dim=2) - minval(points, dim=2))
   end associate
   call self%largest_stress(state, stress, stiffness)
   associate (least => max(rounding, min(most_slack, of_motion*sum(motion))))
      unstrained = strain <= least .and. stress <= least*stiffness
   end associate
end function unstrained

!> Deformation gradient (5.28), (5.29) and its derivatives from those of the displacement
pure subroutine deformation(nd, u, f, h)
   integer, intent(in) :: nd
   !> Fields with derivatives, the displacement first, shape (>= nd, nq)
   real(wp), intent(in) :: u(:, :)
   !> F(i, A) [-]
   real(wp), intent(out) :: f(3, 3)
   !> u_j,BA as h(j, B, A), zero where the fields have no second derivatives [1/length]
   real(wp), intent(out) :: h(3, 3, 3)
   integer :: a

   call gradients(nd, u, f, h)
   do a = 1, 3
      f(a, a) = 1.0_wp + f(a, a)
   end do
end subroutine deformation

!> First and second derivatives u_i,A and u_j,BA of fields, with zeros where there are fewer than
!> three of them or of the dimensions
pure subroutine gradients(nd, u, g, h)
   integer, intent(in) :: nd
   !> Fields with derivatives, shape (>= 1, nq)
   real(wp), intent(in) :: u(:, :)
   !> [-]
   real(wp), intent(out) :: g(3, 3)
   !> As h(j, B, A) [1/length]
   real(wp), intent(out) :: h(3, 3, 3)
   integer :: a, b, n, q

   n = min(nd, size(u, 1))
   g = 0.0_wp
   h = 0.0_wp
   do a = 1, nd
      g(:n, a) = u(:n, 1 + a)
      if (size(u, 2) == 1 + nd) cycle
      do b = a, nd
         q = second_index(nd, a, b)
         h(:n, b, a) = u(:n, q)
         h(:n, a, b) = u(:n, q)
      end do
   end do
end subroutine gradients

end module rk_discretisation
