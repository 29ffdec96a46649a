!> What a weak form knows of its body beside the iteration: integration points with gradients and
!> pressures, and states with the answers to questions about them.
module rk_weak
   use rk_cells, only : cells_type
   use rk_discretisation, only : discretisation_type, deformation, entry_displacement
   use rk_error, only : error_type, fatal_error, err_input
   use rk_follower, only : add_pressure, has_free_rim
   use rk_gradient, only : gradient_type
   use rk_group_stiffness, only : add_forces
   use rk_held, only : held_type, new_held
   use rk_kernel, only : window_polar
   use rk_multiplier, only : multiplier_type
   use rk_precision, only : wp
   use rk_pressure, only : pressure_type
   use rk_recovery, only : recovery_type
   use rk_section, only : cut_through, inner_force
   use rk_shape, only : shape_type
   use rk_states, only : field_state, point_state
   use rk_symmetric, only : symmetric_matrix
   use rk_tangent, only : tangent_type
   use rk_tensor, only : cross, determinant, identity
   use rk_weak_conditions, only : surface_type
   implicit none
   private

   public :: weak_problem, curved, deform_group, hold_points, new_state, pressures_at

   !> Weak form of a scene
   type, abstract, extends(discretisation_type) :: weak_problem
      !> Integration points
      type(cells_type) :: cells
      !> Gradients there
      type(gradient_type) :: gradient
      !> Pressure, and where it is an unknown
      type(pressure_type) :: pressure
      type(multiplier_type) :: multiplier
      !> Shape functions at the integration points
      type(shape_type) :: inside
      !> Gradients of nodal cells anywhere
      type(recovery_type) :: recovery
      !> Part of the bulk modulus that acts at each collocation and integration point, shape
      !> (nc + np), and that which acts on the projected volume ratio, shape (groups) [stress]
      real(wp), allocatable :: local_bulk(:), bulk(:)
      !> Surface
      type(surface_type) :: surface
      !> Tangent, and the part of it that never changes: penalty and stabilisation
      type(tangent_type) :: matrix
      real(wp), allocatable :: constant(:)
      !> Forces of each load factor, with those of prescribed values, shape (n, factors) [force]
      real(wp), allocatable :: force(:, :)
      !> What is held at source points; not allocated where the penalty holds
      type(held_type), allocatable :: held
      !> Nearest collocation point of each point, shape (np)
      integer, allocatable :: nearest(:)
   contains
      procedure :: scaled_norms
      procedure :: state
      !> Internal less external forces of a state
      procedure :: forces
      procedure :: at_place
      procedure :: load_points
      procedure :: of_tissue
      procedure :: strain_energy
      !> Force through a plane section and through a boundary set
      procedure :: section_force
      procedure :: set_force
      !> Moment of the forces on a boundary set
      procedure :: set_torque
      !> Displacement of the middle of a boundary set
      procedure :: set_displacement
   end type weak_problem

   !> Source points across four groups of two spacings each, that curvature is told by in boxes
   integer, parameter :: least_across = 9

contains

!> Whether pressures are written with their curvature: where the strains are as exact. On walls of
!> annuli those of boxes are not, and errors of both cancelled before; in space two groups across a
!> twisted bar put its stress three tenths off. Pressures of different tissues have no common
!> curvature. Slopes of fewer groups across a box than four tell none: it put the outermost fiber of
!> a clamped beam of 17x5 points 3.4 % off where it is 2.2 %; walls of tubes gain from two on.
logical function curved(self)
   !> Problem with cells
   class(weak_problem), intent(in) :: self

   associate (scene => self%scene)
      curved = scene%cloud%nd == 2 .and. scene%approximation%order == 2 &
         & .and. (.not. scene%cloud%polar .or. scene%approximation%window == window_polar) &
         & .and. .not. self%cells%smoothed .and. size(scene%tissue) == 1
      if (curved .and. .not. scene%cloud%polar .and. allocated(scene%cloud%lattice)) &
         & curved = minval(scene%cloud%lattice) >= least_across
   end associate
end function curved

!> Hold source points, with the values of the deck
subroutine hold_points(self, error)
   !> Problem with its surface
   class(weak_problem), intent(inout) :: self
   !> Error handling: places that cannot be held together
   type(error_type), allocatable, intent(out) :: error
   integer :: h

   if (self%surface%plates%count > 0 .or. has_free_rim(self%scene)) then
      call fatal_error(error, err_input, 'galerkin.essential = "transformation" knows neither ' &
         & //'tendons nor pressures with a free rim: take galerkin.essential = "penalty"')
      return
   end if
   if (.not. allocated(self%held)) call new_held(self%held, self%scene, self%cells, &
      & self%surface, error)
   if (allocated(error) .or. .not. allocated(self%held)) return
   associate (near => self%held%nearest + size(self%scene%cloud%points, 2), mixture => self%mixture)
      call self%held%set_deck(self%scene, [(mixture%shear_modulus(near(h), identity), &
         & h=1, size(near))], [(mixture%bulk_at_one_pressure(near(h)), h=1, size(near))], self%n, &
         & error)
   end associate
end subroutine hold_points

!> Points where set_point_loads wants values: the integration points, those of the surface, then
!> held source points
function load_points(self) result(x)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> Points, shape (nd, n) [length]
   real(wp), allocatable :: x(:, :)
   integer :: nd

   nd = size(self%cells%point, 1)
   x = reshape([self%cells%point, self%cells%surface], [nd, size(self%cells%weight) &
      & + size(self%cells%set)])
   if (allocated(self%held)) x = reshape([x, self%held%at%x], [nd, size(x, 2) &
      & + size(self%held%at%x, 2)])
end function load_points

!> Norms of displacements and of the pressures that are unknowns
pure function scaled_norms(self, x) result(norms)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> Unknowns or their change, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   real(wp) :: norms(2)

   associate (nu => self%n - self%gradient%nd*self%multiplier%extra)
      norms = [norm2(x(:nu))/self%extent, 0.0_wp]
      if (nu < self%n) norms(2) = norm2(x(nu + 1:))/self%multiplier%extent
   end associate
end function scaled_norms

!> State of the body with stresses
subroutine state(self, x, load, at)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> State
   type(field_state), intent(out) :: at
   integer :: g, nc, q

   nc = size(self%scene%cloud%points, 2)
   call new_state(self, at)
   at%x = x
   at%load = load
   at%factor = self%scene%factors(load)
   allocate (at%p(3, 3, size(at%j)))
   !$omp parallel do default(none) schedule(static, 1) private(g, q) shared(self, x, load, at, nc)
   do g = 1, size(self%cells%first) - 1
      call deform_group(self, g, x, at)
      do q = self%cells%first(g) + 1, self%cells%first(g + 1)
         at%p(:, :, q) = 0.0_wp
         ! no stress exists
         if (.not. at%j(q) > 0.0_wp) cycle
         call self%mixture%stress(nc + q, at%f(:, :, q), load, at%p(:, :, q), volumetric=.false.)
         at%p(:, :, q) = at%p(:, :, q) + (self%local_bulk(nc + q)*(at%j(q) - 1.0_wp) &
            & + self%pressure%value(g, q, at%pressure(:, g))) &
            & *(0.5_wp*cross(at%f(:, :, q), at%f(:, :, q)))
      end do
   end do
   !$omp end parallel do
   if (allocated(self%held)) at%held = self%held%reaction(self%forces(at))
end subroutine state

!> Internal less external forces of a state
function forces(self, state) result(r)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> State with stresses
   type(field_state), intent(in) :: state
   !> Forces, shape (n) [force]
   real(wp) :: r(self%n)
   real(wp), allocatable :: part(:, :)
   type(symmetric_matrix) :: none
   integer :: g, q

   r = 0.0_wp
   call self%matrix%constant_product(self%constant, state%x(:self%matrix%n), r(:self%matrix%n))
   r = r - matmul(self%force, state%factor)
   do g = 1, size(self%cells%first) - 1
      associate (member => self%gradient%member%index(self%gradient%member%offset(g) + 1: &
         & self%gradient%member%offset(g + 1)))
         allocate (part(self%gradient%nd, size(member)), source=0.0_wp)
         do q = self%cells%first(g) + 1, self%cells%first(g + 1)
            call self%gradient%add_force(q, self%cells%weight(q)*state%p(:, :, q), part)
         end do
         call add_forces(member, part, r)
         deallocate (part)
      end associate
   end do
   call add_pressure(self%surface, self%cells, state%factor, state%x, .false., none, r)
end function forces

!> The state with the stress of one tissue alone, which has its fraction of the pressure
subroutine of_tissue(self, state, tissue, own)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> State of the body
   type(field_state), intent(in) :: state
   !> Tissue
   integer, intent(in) :: tissue
   !> The same with other stresses
   type(field_state), intent(out) :: own
   integer :: g, nc, q

   nc = size(self%scene%cloud%points, 2)
   own = state
   if (allocated(own%held)) own%held = own%held &
      & *spread([(self%mixture%part_of(nc + self%held%nearest(q), tissue), &
      & q=1, size(own%held, 2))], 1, size(own%held, 1))
   own%part = [(self%mixture%part_of(nc + q, tissue), q=1, size(state%j))]
   do g = 1, size(self%cells%first) - 1
      do q = self%cells%first(g) + 1, self%cells%first(g + 1)
         if (.not. state%j(q) > 0.0_wp) cycle
         associate (f => state%f(:, :, q))
            call self%mixture%stress(nc + q, f, state%load, own%p(:, :, q), volumetric=.false., &
               & tissue=tissue)
            own%p(:, :, q) = own%p(:, :, q) + own%part(q)*(self%local_bulk(nc + q) &
               & *(state%j(q) - 1.0_wp) + self%pressure%value(g, q, state%pressure(:, g))) &
               & *(0.5_wp*cross(f, f))
         end associate
      end do
   end do
end subroutine of_tissue

!> Energy of the deformation, with that of the projected change of volume; of the whole body with
!> that of its supports [force length]
real(wp) function strain_energy(self, state, tissue) result(energy)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> State of the body
   type(field_state), intent(in) :: state
   !> Tissue whose part is wanted, 0 for all
   integer, intent(in) :: tissue
   real(wp) :: density, part, pressure
   integer :: g, nc, q

   nc = size(self%scene%cloud%points, 2)
   energy = 0.0_wp
   if (tissue == 0) energy = self%surface%held_energy(state)
   do g = 1, size(self%cells%first) - 1
      do q = self%cells%first(g) + 1, self%cells%first(g + 1)
         part = 1.0_wp
         if (tissue > 0) part = self%mixture%part_of(nc + q, tissue)
         if (.not. part > 0.0_wp) cycle
         pressure = self%pressure%value(g, q, state%pressure(:, g))
         ! half the pressure times the projected change of volume, none where that is kept
         density = 0.5_wp*self%local_bulk(nc + q)*(state%j(q) - 1.0_wp)**2
         if (self%bulk(g) > 0.0_wp .and. .not. self%multiplier%free(g)) density = density &
            & + 0.5_wp*pressure**2/self%bulk(g)
         energy = energy + self%cells%weight(q)*(part*density + self%mixture%energy(nc + q, &
            & state%f(:, :, q), state%load, tissue, volumetric=.false.))
      end do
   end do
end function strain_energy

!> Room for the deformation of all groups
pure subroutine new_state(self, at)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> State
   type(field_state), intent(out) :: at

   allocate (at%f(3, 3, size(self%cells%weight)), at%j(size(self%cells%weight)))
   allocate (at%pressure, at%volume, mold=self%pressure%total)
end subroutine new_state

!> Deformation of a group of points, and the pressure that its change of volume makes
pure subroutine deform_group(self, g, x, at)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> Group
   integer, intent(in) :: g
   !> Unknowns [length]
   real(wp), intent(in) :: x(self%gradient%nd, self%n/self%gradient%nd)
   !> State with the load factors of the essential values in the gradients, of which F, J and
   !> pressure of the group are set
   type(field_state), intent(inout) :: at
   real(wp), allocatable :: local(:, :)
   real(wp) :: h(self%gradient%nd, self%gradient%nd), value(size(at%pressure, 1))
   integer :: b, nd, q

   nd = self%gradient%nd
   b = self%pressure%count(g)
   associate (member => self%gradient%member%index(self%gradient%member%offset(g) + 1: &
      & self%gradient%member%offset(g + 1)))
      allocate (local(nd, size(member)))
      local = x(:, member)
   end associate
   value = 0.0_wp
   do q = self%cells%first(g) + 1, self%cells%first(g + 1)
      call self%gradient%at(q, local, at%factor, h)
      at%f(:, :, q) = identity
      at%f(:nd, :nd, q) = at%f(:nd, :nd, q) + h
      at%j(q) = determinant(at%f(:, :, q))
      value(:b) = value(:b) + self%cells%weight(q)*at%j(q)*self%pressure%basis(:b, q)
   end do
   value(:b) = value(:b) - self%pressure%total(:b, g)
   at%volume(:, g) = value
   if (self%multiplier%free(g)) then
      at%pressure(:, g) = self%multiplier%pressure(g, local)
   else
      at%pressure(:, g) = self%bulk(g)*value
   end if
end subroutine deform_group

!> Coefficients of the pressures of a state, shape (1 + nd, groups) [stress length^(nd/2)]
function pressures_at(self, x, load) result(pressure)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   real(wp), allocatable :: pressure(:, :)
   type(field_state) :: at
   integer :: g

   call new_state(self, at)
   at%factor = self%scene%factors(load)
   !$omp parallel do default(none) schedule(static) private(g) shared(self, x, at)
   do g = 1, size(self%cells%first) - 1
      call deform_group(self, g, x, at)
   end do
   !$omp end parallel do
   call move_alloc(at%pressure, pressure)
end function pressures_at

!> Stress and deformation at a place from the displacement and the pressure there
subroutine at_place(self, state, ip, x, u, local)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> State of the body
   type(field_state), intent(in) :: state
   !> Collocation point whose material and fiber hold there
   integer, intent(in) :: ip
   !> Undeformed place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Displacement with derivatives, shape (nd, nq)
   real(wp), intent(in) :: u(:, :)
   !> State there
   type(point_state), intent(out) :: local
   real(wp) :: h(3, 3, 3), pressure

   local%x(:size(x)) = x
   local%u(:size(x)) = u(:size(x), 1)
   pressure = self%pressure%at(ip, x, state%pressure)
   if (self%cells%smoothed) then
      local%f = self%recovery%at(ip, x, state%f)
      local%j = determinant(local%f)
      pressure = pressure + (local%j - 1.0_wp)*self%local_bulk(ip)
   else
      call deformation(size(x), u, local%f, h)
      local%j = determinant(local%f)
   end if
   call self%mixture%stress(ip, local%f, state%load, local%p, volumetric=.false.)
   local%p = local%p + 0.5_wp*pressure*cross(local%f, local%f)
   local%cauchy = matmul(local%p, transpose(local%f))/local%j
end subroutine at_place

!> Force through a plane section: that of its part behind the normal on the part before it
function section_force(self, place, normal, state) result(force)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> Point of the plane, shape (nd) [length]
   real(wp), intent(in) :: place(:)
   !> Its unit normal, shape (nd)
   real(wp), intent(in) :: normal(:)
   !> State
   type(field_state), intent(in) :: state
   real(wp) :: force(3)
   real(wp), allocatable :: cut(:), held(:)

   cut = cut_through(self%scene, place, normal)
   allocate (held(self%n), source=0.0_wp)
   if (allocated(state%part)) then
      ! the stress of one tissue, to which neither supports nor stabilisation belong
      force = inner_force(self%cells, self%gradient, cut, state, held)
      return
   end if
   call self%matrix%constant_product(self%constant, state%x(:self%matrix%n), held(:self%matrix%n))
   force = inner_force(self%cells, self%gradient, cut, state, held) &
      & + self%surface%held_force(self%cells, cut, state)
end function section_force

!> Force that the surroundings exert on the body through a set
function set_force(self, set, state, share) result(force)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> State
   type(field_state), intent(in) :: state
   !> Of no meaning: the work of the surface's own points is exact
   real(wp), intent(in) :: share
   real(wp) :: force(3)

   associate (unused => share)
   end associate
   force = self%surface%force(self%cells, set, state)
   if (allocated(self%held)) force = force + self%held%force(set, state%held)
end function set_force

!> Moment of the forces that the surroundings exert on the body through a set
function set_torque(self, set, state, about) result(torque)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> State
   type(field_state), intent(in) :: state
   !> Point about which it turns [length]
   real(wp), intent(in) :: about(3)
   real(wp) :: torque(3)

   torque = self%surface%torque(self%cells, set, state, about)
   if (allocated(self%held)) torque = torque + self%held%torque(set, state%held, state%x, about)
end function set_torque

!> Displacement of the middle of a set: of a part of the surface that of its integration points, of
!> which there are more than boundary entries
function set_displacement(self, set, state) result(value)
   !> Problem
   class(weak_problem), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> State
   type(field_state), intent(in) :: state
   real(wp) :: value(3)
   real(wp) :: u(self%fields, self%surface%shape%nq), total
   integer :: s

   if (set <= self%scene%cloud%sides()) then
      value = entry_displacement(self, set, state)
      return
   end if
   value = 0.0_wp
   total = 0.0_wp
   do s = 1, size(self%cells%set)
      if (.not. self%cells%in_set(s, set)) cycle
      call self%surface%shape%interpolate(s, state%x, 1, 1, u)
      value(:self%fields) = value(:self%fields) + self%surface%bearing(s)*u(:, 1)
      total = total + self%surface%bearing(s)
   end do
   value = value/total
end function set_displacement

end module rk_weak
