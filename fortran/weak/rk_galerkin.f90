!> Galerkin form (RKPM) of hyperelasticity, total Lagrangian (4.22)-(4.33), and of linear problems,
!> whose law is linear in the gradient of the fields.
!>
!> The energy of the body is integrated with Gauss points, or with smoothed gradients in nodal cells
!> (SCNI). Prescribed displacements are imposed weakly: they are lifted into the gradients
!> (rk_gradient) and enforced by the penalty of (4.22), which then need not be large, on the surface
!> or at source points (rk_held). The volume change is projected (rk_pressure). Residual and tangent
!> are the exact derivatives of that energy.
!>
!> In linear problems the gradient of the fields takes the place of F, and its trace that of J - 1:
!> lambda acts on the projected change of volume, so that nearly incompressible bodies do not lock.
module rk_galerkin
   use rk_blas, only : dsyrk
   use rk_cells, only : cells_type
   use rk_conditions, only : new_boundary
   use rk_discretisation, only : deformation, discretisation_type, entry_displacement, &
      & has_few_cells
   use rk_equation, only : source_at
   use rk_error, only : error_type
   use rk_free_faces, only : free_faces_type, new_free_faces
   use rk_follower, only : add_pressure, has_free_rim
   use rk_fractions, only : parts_at
   use rk_gauss_cells, only : gauss_cells
   use rk_gradient, only : gradient_type, new_gradient
   use rk_group_stiffness, only : add_forces
   use rk_held, only : add_source_points
   use rk_kernel, only : window_polar
   use rk_mixture, only : mixture_type, new_mixture
   use rk_multiplier, only : multiplier_type, new_multiplier
   use rk_neighbours, only : nearest_points
   use rk_nodal_cells, only : nodal_cells
   use rk_precision, only : wp
   use rk_pressure, only : new_pressure, pressure_type
   use rk_problem, only : evaluation_type, stage_type
   use rk_programme, only : ramp
   use rk_recovery, only : new_recovery, recovery_type
   use rk_scene, only : scene_type
   use rk_shape, only : shape_type
   use rk_slides, only : slide_motion, slides_on
   use rk_stabilisation, only : bulk_within, judged_share, share_bulk
   use rk_states, only : field_state, point_state
   use rk_surface_sets, only : find_surface_sets
   use rk_symmetric, only : new_packed, packed_entries, symmetric_matrix
   use rk_tangent, only : new_tangent, tangent_type
   use rk_tensor, only : add_cross_form, cross, determinant, identity, principal_values
   use rk_text, only : to_text
   use rk_walls, only : new_walls, walls_type
   use rk_weak_conditions, only : add_load, new_pins, prescribed_at, set_conditions, &
      & surface_type
   implicit none
   private

   public :: galerkin_problem, new_galerkin, sources

   !> Galerkin problem of a scene
   type, extends(discretisation_type) :: galerkin_problem
      !> Integration points
      type(cells_type) :: cells
      !> Gradients there
      type(gradient_type) :: gradient
      !> Projected pressure, and multipliers where the pressure is an unknown
      type(pressure_type) :: pressure
      type(multiplier_type) :: multiplier
      !> Shape functions at the integration points
      type(shape_type) :: inside
      !> Gradients of nodal cells recovered at any place
      type(recovery_type) :: recovery
      !> Stress on free faces; not allocated where the form needs no correction
      type(free_faces_type), allocatable :: faces
      !> Stress on walls of annuli; not allocated if supports do not improve it
      type(walls_type), allocatable :: walls
      !> Part of the bulk modulus that acts at each collocation and integration point, shape
      !> (nc + np), and that which acts on the projected volume ratio, shape (groups) [stress]
      real(wp), allocatable :: local_bulk(:), bulk(:)
      !> Surface, and pins of a linear problem
      type(surface_type) :: surface, pins
      !> Tangent, and the part of its entries that never changes: penalty and stabilisation
      type(tangent_type) :: matrix
      type(packed_entries) :: constant
      !> Forces of each load factor, with those of prescribed values, shape (n, factors) [force]
      real(wp), allocatable :: force(:, :)
      !> Nearest collocation point of each point, shape (np)
      integer, allocatable :: nearest(:)
      !> F where the tangent was taken, and where the step to there began, shape (3, 3, np) [-]
      real(wp), allocatable :: origin(:, :, :), base(:, :, :)
      !> No step of the tangent leads to the next place: its tangent has the pressure of the base
      logical :: leaps = .false.
      !> Tangents also resist volume changes within groups of cells, to distinguish negative
      !> eigenvalues of the material from those of its pressures
      logical, private :: resists = .false.
      !> Tangents resist volume changes by a penalty where pressures are unknowns: such a tangent is
      !> positive definite if the equilibrium is stable
      logical, private :: penalised = .false.
   contains
      procedure, private :: base_volume
      procedure :: start, assemble, is_unstable, state, at_place, strain_energy, set_force
      procedure :: set_displacement, section_force, set_point_loads, inner_forces
      procedure :: constant_product, material_at
   end type galerkin_problem

   !> Multiple of the penalty to be added where the stability of an equilibrium is judged [-]
   real(wp), parameter :: firmly_held = 1.0e2_wp
   !> That penalty relative to the shear modulus [-]
   real(wp), parameter :: firm = 1.0e4_wp

contains

!> Set up the Galerkin problem of a scene
subroutine new_galerkin(self, scene, error)
   type(galerkin_problem), target, intent(inout) :: self
   type(scene_type), target, intent(in) :: scene
   type(error_type), allocatable, intent(out) :: error
   type(shape_type) :: facet
   type(shape_type), target :: faces
   type(shape_type), pointer :: closing
   real(wp), allocatable :: shear(:), softness(:), whole(:)
   integer :: blocks, ip, nc, nd, np, ns

   self%scene => scene
   self%linear = allocated(scene%equation%problem)
   nd = scene%cloud%nd
   nc = size(scene%cloud%points, 2)
   ns = size(scene%cloud%source, 2)
   self%fields = scene%equation%fields(nd)
   call new_boundary(self%boundary, scene, error)
   if (allocated(error)) return
   allocate (self%shape)
   call scene%shape_at(scene%cloud%points, self%shape, error, first=.not. self%linear)
   if (allocated(error)) return
   if (scene%method == 'rkpm-gauss' .and. .not. allocated(scene%cloud%block)) then
      call gauss_cells(self%cells, scene, error)
   else
      call nodal_cells(self%cells, scene%cloud, error)
   end if
   if (.not. allocated(error)) call find_surface_sets(self%cells, scene%cloud, error)
   if (.not. allocated(error) .and. scene%galerkin%essential == 'transformation') &
      & call add_source_points(self%cells, scene, error)
   if (allocated(error)) return
   np = size(self%cells%weight)
   self%extent = sqrt(real(nd*ns, wp))*maxval(maxval(scene%cloud%source, dim=2) &
      & - minval(scene%cloud%source, dim=2))

   call scene%shape_at(self%cells%point, self%inside, error, first=.not. self%cells%smoothed)
   closing => self%surface%shape
   if (.not. allocated(self%cells%place)) then
      self%cells%place = self%cells%surface
   else if (.not. allocated(error)) then
      call scene%shape_at(self%cells%surface, faces, error, plain=.true.)
      closing => faces
   end if
   if (.not. allocated(error)) call scene%shape_at(self%cells%place, self%surface%shape, error, &
      & first=.true.)
   if (.not. allocated(error)) call scene%shape_at(self%cells%facet, facet, error, plain=.true.)
   if (allocated(error)) then
      error%message = 'integration '//error%message
      return
   end if
   self%nearest = nearest_points(scene%cloud%centres(), self%cells%point)
   call new_mixture(self%mixture, scene, reshape([scene%cloud%points, self%cells%point], &
      & [nd, nc + np]), [[(ip, ip=1, nc)], self%nearest], error)
   if (allocated(error)) return
   shear = [(self%mixture%shear_modulus(nc + ip, identity), ip=1, np)]
   call set_conditions(self%surface, scene, self%cells, shear, error)
   if (allocated(error)) return
   blocks = ns + self%surface%plates%count
   call new_gradient(self%gradient, self%cells, blocks, self%inside, facet, closing, &
      & self%surface%shape, self%surface%essential, self%surface%plates%follows, scene%cloud%source)
   call self%gradient%set_essential(self%cells, self%surface%essential, self%surface%value)
   call share_bulk(self%mixture, self%cells, nc, scene%runs_out(), self%local_bulk, self%bulk, &
      & whole, softness)
   call new_pressure(self%pressure, self%cells, softness, whole, scene%cloud%points, curved(self), &
      & scene%approximation, error)
   if (allocated(error)) return
   call new_multiplier(self%multiplier, self%cells, self%bulk, shear, blocks, self%gradient%member)
   self%n = self%fields*(blocks + self%multiplier%extra)
   self%m = self%n
   if (self%cells%smoothed) call new_recovery(self%recovery, scene, self%cells, error)
   if (.not. allocated(error) .and. scene%approximation%order == 1 &
      & .and. allocated(scene%cloud%lattice) .and. .not. (scene%cloud%polar &
      & .or. self%linear .or. self%cells%smoothed)) then
      allocate (self%faces)
      call new_free_faces(self%faces, scene, error)
   end if
   if (allocated(error)) return
   if (allocated(self%pressure%share) .and. .not. (self%linear .or. allocated(scene%motion) &
      & .or. self%mixture%activation_jumps())) then
      allocate (self%walls)
      call new_walls(self%walls, scene, self%cells, self%surface, error)
      if (allocated(error)) return
      if (.not. any(self%walls%side)) deallocate (self%walls)
   end if
   self%energetic = self%multiplier%extra == 0 .and. .not. self%linear
   call new_tangent(self%matrix, scene, blocks, self%cells, self%gradient, self%multiplier, &
      & self%surface, self%inside, shear, error)
   if (allocated(error)) return
   self%inexact = .not. self%matrix%formed
   self%square = .true.
   if (self%multiplier%extra > 0) self%pressure_first = nd*blocks + 1
   self%pressure_extent = self%multiplier%extent
   if (self%inexact .or. allocated(scene%cloud%block)) call self%gradient%share()
   ! the minimal residual method cannot handle a skew part
   if (self%inexact .and. has_free_rim(scene)) self%caveat = 'the rim of a surface with ' &
      & //'boundary.pressure moves freely, which makes the tangent unsymmetric, and above ' &
      & //'galerkin.direct_limit its skew part is left out: use galerkin.direct_limit = ' &
      & //to_text(self%n)//' where memory allows, constrain the rim, or reduce the load'
   if (self%linear) call new_pins(self%pins, scene, scene%galerkin%penalty*maxval(shear), error)
   if (.not. allocated(error)) call set_constants(self, shear, error)
end subroutine new_galerkin

!> Penalty, stabilisation, tendons, and forces of prescribed values
subroutine set_constants(self, shear, error)
   !> Problem with conditions and the places of its matrix
   type(galerkin_problem), intent(inout) :: self
   !> Shear modulus at each integration point, shape (np) [stress]
   real(wp), intent(in) :: shear(:)
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(inout) :: error

   self%matrix%value = 0.0_wp
   call self%surface%add_penalty(self%matrix%symmetric_matrix, self%matrix%value)
   allocate (self%force(self%n, self%scene%programme%count()), source=0.0_wp)
   call self%surface%add_forces(self%force)
   call self%surface%plates%add_tendons(self%scene, self%cells, self%surface%penalty, &
      & self%matrix%symmetric_matrix, self%matrix%value, self%force)
   call self%matrix%complete(self%cells, self%inside, shear)
   ! the minimal residual method needs a symmetric matrix
   if (self%matrix%formed .and. has_free_rim(self%scene)) &
      & allocate (self%matrix%skew, source=0.0_wp*self%matrix%value)
   if (self%linear) call self%pins%add_penalty(self%matrix%symmetric_matrix, self%matrix%value)
   call new_packed(self%constant, self%matrix%symmetric_matrix)
   if (.not. self%linear) return
   call self%pins%add_forces(self%force)
   call add_load(self%inside, self%cells%weight, sources(self, 0.0_wp, error), &
      & self%force(:, ramp))
end subroutine set_constants

!> Forces of the part of the tangent that never changes
subroutine constant_product(self, x, y)
   class(galerkin_problem), intent(in) :: self
   !> Displacements, shape (n) [length]
   real(wp), contiguous, intent(in) :: x(:)
   !> Forces, shape (n) [force]
   real(wp), contiguous, intent(inout) :: y(:)

   call self%constant%product(x, y)
   call self%matrix%add_stabilisation(x, y)
end subroutine constant_product

!> Body forces of a linear problem, shape (fields, np) [force/length^3]
function sources(self, time, error) result(b)
   !> Problem with its cells
   class(galerkin_problem), intent(in) :: self
   !> Time, unused in statics
   real(wp), intent(in) :: time
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(inout) :: error
   real(wp) :: b(self%fields, size(self%cells%weight))
   integer :: q

   b = 0.0_wp
   do q = 1, size(b, 2)
      call source_at(self%scene%equation, self%cells%point(:, q), time, b(:, q), error)
      if (allocated(error)) return
   end do
end function sources

!> Set loads that vary over the points and cannot be given in a deck, at full load of the ramp
subroutine set_point_loads(self, body_force, displacement, stress, place)
   class(galerkin_problem), intent(inout) :: self
   real(wp), intent(in) :: body_force(:, :)
   real(wp), intent(in) :: displacement(:, :)
   real(wp), intent(in) :: stress(:, :, :)
   !> Only return the points where values are wanted: the integration points, then those of the
   !> surface, shape (nd, n) [length]
   real(wp), allocatable, intent(out), optional :: place(:, :)
   integer :: nd, np

   nd = self%scene%cloud%nd
   np = size(self%cells%weight)
   if (present(place)) then
      place = reshape([self%cells%point, self%cells%place], [nd, np + size(self%cells%set)])
      return
   end if
   ! nothing is prescribed between points
   if (allocated(self%walls)) deallocate (self%walls)
   self%scene%body_force = body_force
   self%scene%weight = matmul(body_force(:, :np), self%cells%weight)
   call self%surface%set_varying(self%cells, displacement(:, np + 1:), stress(:, :, np + 1:))
   call self%gradient%set_essential(self%cells, self%surface%essential, self%surface%value)
   self%force = 0.0_wp
   call self%surface%add_forces(self%force)
   call add_load(self%inside, self%cells%weight, body_force(:nd, :np), self%force(:, ramp))
end subroutine set_point_loads

!> Forget where the last load step started; within an iteration the volume of the next tangent is
!> linear in the step from here
subroutine start(self, x, load, iteration)
   class(galerkin_problem), target, intent(inout) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), intent(in) :: load
   logical, intent(in) :: iteration

   associate (unused => x, unused_too => load)
   end associate
   if (iteration) then
      self%base = self%origin
      return
   end if
   if (allocated(self%base)) deallocate (self%base)
   call self%matrix%forget()
end subroutine start

!> Whether an equilibrium is unstable: its tangent is not positive definite. With pressures that
!> follow a free rim its symmetric part is judged, which is lost before the tangent is singular.
!> False if the tangent is not formed.
logical function is_unstable(self, x, load)
   class(galerkin_problem), target, intent(inout) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), intent(in) :: load
   type(evaluation_type) :: seen
   real(wp), allocatable :: r(:)

   is_unstable = .false.
   if (.not. self%matrix%formed) return
   allocate (r(self%m))
   ! no step begins: the last factor is kept
   if (allocated(self%base)) deallocate (self%base)
   self%penalised = self%matrix%indefinite
   is_unstable = .not. is_definite()
   if (is_unstable .and. .not. self%linear .and. allocated(self%scene%cloud%lattice)) then
      ! pressures of a group of cells resist the mean volume change and its slopes only: under large
      ! compression parts of a free face may exchange volume, which no real body does; a face that
      ! slides under a pressure of many shear moduli wrinkles against the penalty
      self%resists = .not. has_few_cells(self%scene)
      if (self%resists) is_unstable = .not. is_definite()
      self%resists = .false.
   end if
   self%penalised = .false.

contains

   !> Whether the tangent is positive definite
   logical function is_definite()
      call self%evaluate(x, load, r, seen, tangent=.true.)
      is_definite = self%matrix%definite()
   end function is_definite

end function is_unstable

!> Residual (4.31), internal less external forces, and where wanted the tangent (4.32): a sum over
!> the groups. At the start of a load step the prescribed values in the gradients are those of the
!> last converged state: they jump there, and gradients with the new values might not even keep
!> J > 0. The jump acts linearly.
subroutine assemble(self, x, stage, r, seen)
   class(galerkin_problem), target, intent(inout) :: self
   real(wp), contiguous, intent(in) :: x(:)
   type(stage_type), intent(in) :: stage
   real(wp), contiguous, intent(inout) :: r(:)
   type(evaluation_type), intent(out) :: seen
   type(field_state) :: at
   real(wp), allocatable :: part(:, :), force(:, :), factor(:), jump(:)
   real(wp) :: excess(1 + self%gradient%nd)
   integer :: g
   logical :: tangent

   self%linearised => self%matrix
   if (allocated(stage%behind)) call extrapolate(self, stage)
   call new_state(self, at)
   at%factor = self%scene%factors(stage%lifted)
   factor = self%scene%factors(stage%load)
   jump = factor - at%factor
   if (.not. any(abs(jump) > 0.0_wp)) jump = [real(wp) ::]
   ! pressures carried to a place are known only on the way to it: a tangent with them is not kept
   tangent = stage%tangent .or. (size(jump) > 0 .and. self%inexact)
   if (size(jump) > 0) self%leaps = .not. tangent
   r = 0.0_wp
   call self%constant_product(x(:self%matrix%n), r(:self%matrix%n))
   r = r - matmul(self%force, factor)
   if (tangent) call self%constant%unpack(self%matrix%value)
   if (tangent .and. self%resists) call self%surface%add_penalty(self%matrix%symmetric_matrix, &
      & self%matrix%value, times=firmly_held)
   if (tangent .and. allocated(self%matrix%skew)) self%matrix%skew = 0.0_wp
   call self%matrix%groups%attach(self%cells, self%gradient, self%pressure, self%multiplier)
   if (tangent .and. self%inexact) call self%matrix%pressures%go_to(x)
   ! parts are added in the order of the groups, so that sums do not depend on the threads
   !$omp parallel do default(none) schedule(static, 1) ordered private(g, part, force, excess) &
   !$omp shared(self, x, jump, stage, tangent, r, at)
   do g = 1, size(self%cells%first) - 1
      associate (member => self%gradient%member%index(self%gradient%member%offset(g) + 1: &
         & self%gradient%member%offset(g + 1)))
         call deform_group(self, g, x, at, excess=excess)
         call group_part(self, g, at, excess, jump, stage%load, tangent, force, part)
         !$omp ordered
         call add_forces(member, force, r)
         if (tangent .and. self%matrix%formed) call self%matrix%add(self%matrix%value, member, part)
         !$omp end ordered
      end associate
   end do
   !$omp end parallel do
   call add_pressure(self%surface, self%cells, factor, x, tangent, self%matrix, r)
   seen%worst = minloc(at%j, dim=1)
   seen%min_j = at%j(seen%worst)
   seen%max_j = maxval(at%j)
   ! comparisons that a NaN fails
   seen%valid = all(at%j > 0.0_wp) .and. all(abs(r) <= huge(1.0_wp))
   seen%worst = self%nearest(seen%worst)
   if (tangent .or. size(jump) > 0) call move_alloc(at%f, self%origin)
   if (tangent) self%leaps = .false.
   if (.not. (tangent .and. seen%valid .and. self%inexact)) return
   self%matrix%wanted = self%scene%solver%tolerance
   call self%matrix%measure(-r, seen%size)
end subroutine assemble

!> Volume ratio of a point at the end of a step, linearised in the step as in a mixed Newton
!> iteration: with J of the new state instead, any volume error left by a step disturbs the
!> stiffness. Where no step of the tangent leads to the state, that of its beginning
pure real(wp) function base_volume(self, q, f)
   class(galerkin_problem), intent(in) :: self
   !> Integration point
   integer, intent(in) :: q
   !> F(i, A) at the end of the step [-]
   real(wp), intent(in) :: f(3, 3)

   associate (base => self%base(:, :, q))
      base_volume = determinant(base)
      if (.not. self%leaps) base_volume = base_volume + 0.5_wp*sum(cross(base, base)*(f - base))
   end associate
end function base_volume

!> Forces and stiffness of a group of points
subroutine group_part(self, g, at, excess, change, load, tangent, force, part)
   !> Problem; a tangent that is not formed keeps moduli and cofactors of the group
   class(galerkin_problem), intent(inout) :: self
   !> Group
   integer, intent(in) :: g
   !> State with the deformation of the group
   type(field_state), intent(in) :: at
   !> Projected change of its volume, shape (1 + nd) [length^(nd/2)]
   real(wp), intent(in) :: excess(:)
   !> Change of the load factors of the prescribed values in the gradients up to the load, shape
   !> (factors); empty without a change [-]
   real(wp), intent(in) :: change(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Stiffness wanted
   logical, intent(in) :: tangent
   !> Forces, shape (fields, members) [force]
   real(wp), allocatable, intent(inout) :: force(:, :)
   !> Upper triangle of the stiffness, shape (fields*members, fields*members) [force/length]
   real(wp), allocatable, intent(inout) :: part(:, :)
   real(wp), allocatable :: ahead(:), bulk(:), c4(:, :, :, :, :), volume(:, :), work(:, :, :)
   real(wp) :: basis(4), h(self%fields, self%gradient%nd), p(3, 3), cofactor(3, 3), own, ahead_own
   real(wp) :: linear(size(at%pressure, 1)), jump(size(at%pressure, 1)), within, taken, resistance
   integer :: fields, nc, nd, n, q, o, i, k, members, b
   logical :: formed, jumps, stacked

   formed = tangent .and. self%matrix%formed
   ! the volume change of the group is needed as rows
   jumps = size(change) > 0 .and. any(self%gradient%lifts(self%cells%first(g) + 1: &
      & self%cells%first(g + 1)))
   stacked = formed .or. jumps
   fields = self%fields
   nd = self%gradient%nd
   nc = size(self%scene%cloud%points, 2)
   o = self%cells%first(g)
   n = self%cells%first(g + 1) - o
   b = self%pressure%count(g)
   members = int(self%gradient%member%offset(g + 1) - self%gradient%member%offset(g))
   if (allocated(force)) deallocate (force)
   allocate (force(fields, members), source=0.0_wp)
   if (allocated(part)) then
      if (size(part, 1) /= fields*members) deallocate (part)
   end if
   if (formed .and. .not. allocated(part)) allocate (part(fields*members, fields*members))
   ! no stress exists; the caller rejects the state
   if (.not. all(at%j(o + 1:o + n) > 0.0_wp)) then
      if (formed) part = 0.0_wp
      return
   end if
   jump = 0.0_wp
   within = 0.0_wp
   taken = 0.0_wp
   resistance = self%bulk(g)
   if (self%penalised .and. self%multiplier%free(g)) resistance = firm &
      & *maxval([(self%mixture%shear_modulus(nc + o + q, at%f(:, :, o + q)), q=1, n)])
   if (self%resists) then
      bulk = [(self%mixture%bulk_at_one_pressure(nc + o + q) - self%local_bulk(nc + o + q), q=1, n)]
      if (self%multiplier%free(g)) bulk = resistance
      taken = minval([0.5_wp, [(bulk_within(self%mixture, nc + o + q, judged_share), q=1, n)]/bulk])
   end if
   if (tangent .or. jumps) then
      linear = at%pressure(:, g)
      if (self%matrix%pressures%carrying .and. .not. self%multiplier%free(g)) then
         linear = self%matrix%pressures%carried(:, g)
      else if (allocated(self%base) .and. .not. self%multiplier%free(g)) then
         ahead = [(self%base_volume(o + q, at%f(:, :, o + q)), q=1, n)]
         linear = self%pressure%from_ratios(g, self%cells, self%bulk(g), ahead)
      else if (.not. self%multiplier%free(g)) then
         linear(1) = linear(1) + active_pressure(self, g, at, load)
      end if
      allocate (c4(3, 3, 3, 3, n))
      if (stacked) allocate (work(4, fields, members), source=0.0_wp)
   end if
   do q = 1, n
      associate (f => at%f(:, :, o + q), j => at%j(o + q))
         cofactor = volume_slope(self, f)
         own = self%local_bulk(nc + o + q)*volume_change(self, at, o + q)
         if (tangent .or. jumps) then
            ahead_own = own
            if (allocated(ahead)) ahead_own = self%local_bulk(nc + o + q)*(ahead(q) - 1.0_wp)
            call self%mixture%stress(nc + o + q, f, load, p, c4(:, :, :, :, q), volumetric=.false.)
            if (.not. self%linear) call add_cross_form(ahead_own &
               & + self%pressure%value(g, o + q, linear), f, c4(:, :, :, :, q))
            if (self%resists) within = taken*bulk(q)
            do k = 1, nd
               do i = 1, fields
                  c4(:, :, i, k, q) = self%cells%weight(o + q)*(c4(:, :, i, k, q) &
                     & + (self%local_bulk(nc + o + q) + within)*(cofactor*cofactor(i, k)))
               end do
            end do
         else
            call self%mixture%stress(nc + o + q, f, load, p, volumetric=.false.)
         end if
         p = p + (own + self%pressure%value(g, o + q, at%pressure(:, g)))*cofactor
      end associate
      if (jumps) then
         h = self%gradient%lifted(o + q, change)
         do i = 1, fields
            do k = 1, nd
               p(:nd, :nd) = p(:nd, :nd) + c4(:nd, :nd, i, k, q)*h(i, k)/self%cells%weight(o + q)
            end do
         end do
         jump(:b) = jump(:b) + self%cells%weight(o + q)*sum(cofactor(:fields, :nd)*h) &
            & *self%pressure%basis(:b, o + q)
      end if
      p = self%cells%weight(o + q)*p
      cofactor = self%cells%weight(o + q)*cofactor
      if (tangent .and. .not. formed) self%matrix%groups%cofactor(:, :, o + q) = cofactor
      call self%gradient%add_force(o + q, p, force)
      if (.not. stacked) cycle
      basis = 0.0_wp
      basis(:b) = self%pressure%basis(:b, o + q)
      call self%gradient%add_work(o + q, cofactor, basis, work)
   end do
   if (stacked) volume = transpose(reshape(work(:b, :, :), [b, fields*members]))
   if (self%multiplier%free(g)) then
      call self%multiplier%set_rows(g, excess(:b) + jump(:b), force)
   else if (stacked) then
      force = force + self%bulk(g)*reshape(matmul(volume, jump(:b)), shape(force))
   end if
   if (.not. tangent) return
   if (.not. formed) then
      call self%matrix%keep_group(g, self%bulk(g), c4, at%pressure(:, g), jump)
      return
   end if
   if (self%multiplier%free(g) .and. .not. self%penalised) then
      part = 0.0_wp
      call self%multiplier%set_stiffness(g, volume, part)
   else
      call dsyrk('u', 'n', fields*members, b, (1.0_wp - taken)*resistance, volume, &
         & fields*members, 0.0_wp, part, fields*members)
      if (self%multiplier%free(g)) call self%multiplier%set_idle(g, 0, part)
   end if
   call self%gradient%add_stiffness(o, c4, part)
end subroutine group_part

!> First coefficient of the pressure with which active stress at rest is only tension along the
!> fibers: without it the stress across them is compressive, and the tangent at the start of the
!> first load step may not be positive definite [stress length^(nd/2)]
real(wp) function active_pressure(self, g, at, load) result(value)
   class(galerkin_problem), intent(in) :: self
   !> Group
   integer, intent(in) :: g
   !> State with the deformation of the group; where it is deformed the pressure is zero
   type(field_state), intent(in) :: at
   !> Load [-]
   real(wp), intent(in) :: load
   real(wp) :: p(3, 3), principal(3), volume
   integer :: q

   value = 0.0_wp
   volume = 0.0_wp
   do q = self%cells%first(g) + 1, self%cells%first(g + 1)
      if (any(abs(at%f(:, :, q) - identity) > 0.0_wp)) then
         value = 0.0_wp
         return
      end if
      call self%mixture%stress(size(self%scene%cloud%points, 2) + q, at%f(:, :, q), load, p, &
         & volumetric=.false.)
      principal = principal_values(p)
      value = value - self%cells%weight(q)*principal(3)
      volume = volume + self%cells%weight(q)
   end do
   value = value/(volume*self%pressure%basis(1, self%cells%first(g) + 1))
end function active_pressure

!> Derivative of the volume ratio with respect to F; in a linear problem that of the trace [-]
pure function volume_slope(self, f) result(slope)
   class(galerkin_problem), intent(in) :: self
   !> Deformation gradient [-]
   real(wp), intent(in) :: f(3, 3)
   real(wp) :: slope(3, 3)

   slope = identity
   if (.not. self%linear) slope = 0.5_wp*cross(f, f)
end function volume_slope

!> Change of volume at an integration point [-]
pure real(wp) function volume_change(self, at, q)
   class(galerkin_problem), intent(in) :: self
   type(field_state), intent(in) :: at
   integer, intent(in) :: q
   integer :: k

   if (self%linear) then
      volume_change = sum([(at%f(k, k, q), k=1, self%gradient%nd)])
   else
      volume_change = at%j(q) - 1.0_wp
   end if
end function volume_change

!> Pressures on the curve through the last converged states
subroutine extrapolate(self, stage)
   !> Problem, linearised at the last converged state
   type(galerkin_problem), intent(inout) :: self
   type(stage_type), intent(in) :: stage
   type(field_state) :: at
   real(wp), allocatable :: pressure(:, :, :)
   integer :: k

   allocate (pressure(size(self%pressure%total, 1), size(self%pressure%total, 2), &
      & size(stage%behind_load)))
   do k = 1, size(stage%behind_load)
      call self%state(stage%behind(:, k), stage%behind_load(k), at)
      pressure(:, :, k) = at%pressure
   end do
   call self%matrix%pressures%extrapolate(pressure, stage%share)
end subroutine extrapolate

!> Whether pressures are written with their curvature: in annuli, where the strains are equally
!> accurate. With box windows those of walls are not, and the errors of both cancel without it; in
!> 3D, two groups across a twisted bar left its stress off by 0.3. Pressures of different tissues
!> have no common curvature.
logical function curved(self)
   class(galerkin_problem), intent(in) :: self

   associate (scene => self%scene)
      curved = scene%cloud%polar .and. scene%approximation%window == window_polar &
         & .and. scene%approximation%order == 2 .and. .not. self%cells%smoothed &
         & .and. size(scene%tissue) == 1
   end associate
end function curved

!> State of the body with stresses
subroutine state(self, x, load, at, tissue)
   class(galerkin_problem), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), intent(in) :: load
   type(field_state), intent(out) :: at
   !> Tissue whose stress alone is wanted, with its fraction of the pressure
   integer, intent(in), optional :: tissue
   !> Gradients due to the prescribed values at a time; only their given part is set
   type(gradient_type) :: lift
   type(error_type), allocatable :: error
   real(wp), allocatable :: part(:), value(:, :, :), traction(:, :, :)
   logical, allocatable :: essential(:, :)
   integer :: g, nc, q

   nc = size(self%scene%cloud%points, 2)
   call new_state(self, at)
   at%x = x
   at%load = load
   at%factor = self%scene%factors(load)
   ! in a motion the load is the time, at which its expressions have already been evaluated
   if (allocated(self%scene%motion)) then
      at%factor = [0.0_wp]
      call prescribed_at(self%scene, self%cells, essential, value, traction, error, load)
      lift%nd = self%gradient%nd
      lift%fields = self%fields
      lift%start = self%gradient%start
      call lift%set_essential(self%cells, essential, value)
   end if
   allocate (at%p(3, 3, size(at%j)), part(size(at%j)))
   part = 1.0_wp
   if (present(tissue)) then
      at%tissue = tissue
      part = [(self%mixture%part_of(nc + q, tissue), q=1, size(part))]
   end if
   !$omp parallel do default(none) schedule(static, 1) private(g, q) &
   !$omp shared(self, x, load, at, nc, part, tissue, lift)
   do g = 1, size(self%cells%first) - 1
      call deform_group(self, g, x, at, lift)
      do q = self%cells%first(g) + 1, self%cells%first(g + 1)
         at%p(:, :, q) = 0.0_wp
         ! no stress exists
         if (.not. at%j(q) > 0.0_wp) cycle
         call self%mixture%stress(nc + q, at%f(:, :, q), load, at%p(:, :, q), &
            & volumetric=.false., tissue=tissue)
         at%p(:, :, q) = at%p(:, :, q) + part(q)*volume_slope(self, at%f(:, :, q)) &
            & *(self%local_bulk(nc + q)*volume_change(self, at, q) &
            & + self%pressure%value(g, q, at%pressure(:, g)))
      end do
   end do
   !$omp end parallel do
   if (allocated(self%pressure%share)) at%bend = self%pressure%bends(at%pressure)
   if (present(tissue)) call move_alloc(part, at%part)
   if (present(tissue) .or. .not. allocated(self%walls)) return
   allocate (at%push(self%fields, size(self%scene%cloud%source, 2)), source=0.0_wp)
   call self%surface%add_push(self%cells, self%walls%side, at, at%push)
end subroutine state

!> Add the forces of the stresses of a state
subroutine inner_forces(self, state, r)
   class(galerkin_problem), intent(in) :: self
   type(field_state), intent(in) :: state
   !> Forces, shape (n) [force]
   real(wp), intent(inout) :: r(:)
   real(wp), allocatable :: part(:, :)
   integer :: g, q

   do g = 1, size(self%cells%first) - 1
      associate (member => self%gradient%member%index(self%gradient%member%offset(g) + 1: &
         & self%gradient%member%offset(g + 1)))
         allocate (part(self%fields, size(member)), source=0.0_wp)
         do q = self%cells%first(g) + 1, self%cells%first(g + 1)
            call self%gradient%add_force(q, self%cells%weight(q)*state%p(:, :, q), part)
         end do
         call add_forces(member, part, r)
         deallocate (part)
      end associate
   end do
end subroutine inner_forces

!> Strain energy including that of the projected change of volume; for the whole body also that of
!> the penalty, which is part of the work of prescribed displacements, but not of springs [force
!> length]
real(wp) function strain_energy(self, state, tissue) result(energy)
   class(galerkin_problem), intent(in) :: self
   type(field_state), intent(in) :: state
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
         ! half the pressure times the projected change of volume, zero where volume is preserved
         density = 0.5_wp*self%local_bulk(nc + q)*volume_change(self, state, q)**2
         if (self%bulk(g) > 0.0_wp .and. .not. self%multiplier%free(g)) density = density &
            & + 0.5_wp*pressure**2/self%bulk(g)
         energy = energy + self%cells%weight(q)*(part*density + self%mixture%energy(nc + q, &
            & state%f(:, :, q), state%load, tissue, volumetric=.false.))
      end do
   end do
end function strain_energy

!> Allocate the deformation of all groups
pure subroutine new_state(self, at)
   class(galerkin_problem), intent(in) :: self
   type(field_state), intent(out) :: at

   allocate (at%f(3, 3, size(self%cells%weight)), at%j(size(self%cells%weight)))
   allocate (at%pressure, mold=self%pressure%total)
end subroutine new_state

!> Deformation of a group of points, and the pressure due to its change of volume
pure subroutine deform_group(self, g, x, at, lift, excess)
   class(galerkin_problem), intent(in) :: self
   integer, intent(in) :: g
   !> Unknowns [length]
   real(wp), intent(in) :: x(self%fields, self%n/self%fields)
   !> State with the load factors of the prescribed values in the gradients, of which F, J and
   !> pressure of the group are set
   type(field_state), intent(inout) :: at
   !> Gradients due to prescribed values in a motion
   type(gradient_type), intent(in), optional :: lift
   !> Projected change of volume by the group's polynomials, shape (1 + nd) [length^(nd/2)]
   real(wp), intent(out), optional :: excess(:)
   real(wp), allocatable :: local(:, :)
   real(wp) :: h(self%fields, self%gradient%nd), value(size(at%pressure, 1))
   integer :: b, nd, q

   nd = self%gradient%nd
   b = self%pressure%count(g)
   associate (member => self%gradient%member%index(self%gradient%member%offset(g) + 1: &
      & self%gradient%member%offset(g + 1)))
      allocate (local(self%fields, size(member)))
      local = x(:, member)
   end associate
   value = 0.0_wp
   do q = self%cells%first(g) + 1, self%cells%first(g + 1)
      call self%gradient%at(q, local, at%factor, h)
      if (self%linear) then
         if (present(lift)) then
            if (allocated(lift%given)) h = h + lift%given(:, :, q, 1)
         end if
         at%f(:, :, q) = 0.0_wp
         at%f(:self%fields, :nd, q) = h
         at%j(q) = 1.0_wp
      else
         at%f(:, :, q) = identity
         at%f(:nd, :nd, q) = at%f(:nd, :nd, q) + h
         at%j(q) = determinant(at%f(:, :, q))
      end if
      value(:b) = value(:b) + self%cells%weight(q)*volume_change(self, at, q) &
         & *self%pressure%basis(:b, q)
   end do
   if (present(excess)) excess = value
   if (self%multiplier%free(g)) then
      at%pressure(:, g) = self%multiplier%pressure(g, local)
   else
      at%pressure(:, g) = self%bulk(g)*value
   end if
end subroutine deform_group

!> Stress and deformation at a place from the displacement and the pressure there
subroutine at_place(self, state, ip, x, u, local)
   class(galerkin_problem), intent(in) :: self
   type(field_state), intent(in) :: state
   integer, intent(in) :: ip
   real(wp), intent(in) :: x(:)
   !> Displacement with derivatives, shape (nd, nq)
   real(wp), intent(in) :: u(:, :)
   type(point_state), intent(out) :: local
   type(mixture_type) :: here
   real(wp) :: h(3, 3, 3), slope(3, 3), pressure
   integer :: i

   pressure = self%pressure%at(ip, x, state%pressure, state%bend)
   if (self%linear) then
      call self%linear_place(ip, x, u, local, pressure)
      return
   end if
   local%x(:size(x)) = x
   local%u(:size(x)) = u(:size(x), 1)
   if (self%cells%smoothed) then
      local%f = self%recovery%at(ip, x, state%f)
      local%j = determinant(local%f)
      pressure = pressure + (local%j - 1.0_wp)*self%local_bulk(ip)
   else
      call deformation(size(x), u, local%f, h)
      local%j = determinant(local%f)
   end if
   call self%mixture%beside(self%material_at(ip, x), x, here)
   call here%stress(1, local%f, state%load, local%p, volumetric=.false.)
   local%p = local%p + 0.5_wp*pressure*cross(local%f, local%f)
   local%cauchy = matmul(local%p, transpose(local%f))/local%j
   if (allocated(state%push)) then
      i = self%walls%find(self%scene, ip, x)
      if (i == 0) return
      slope = local%f
      call self%walls%follow(i, state%factor, slope)
      call self%walls%release(i, here, state%load, slope, local, &
         & self%walls%traction(i, state%push))
      return
   end if
   if (.not. allocated(self%faces) .or. state%tissue > 0) return
   i = self%faces%find(self%scene, ip, x)
   if (i == 0) return
   slope = local%f - identity
   call self%faces%smooth(i, state%x, slope)
   call self%faces%release(i, here, state%load, identity + slope, local)
end subroutine at_place

!> Index in the mixture of the material at a place: its nearest collocation point or, where that has
!> another material, the nearest integration point of the same material
integer function material_at(self, ip, x) result(at)
   class(galerkin_problem), intent(in) :: self
   !> Collocation point
   integer, intent(in) :: ip
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   type(error_type), allocatable :: error
   real(wp) :: least, off, part(size(self%scene%tissue))
   integer :: k, nc, own

   at = ip
   if (.not. (allocated(self%scene%approximation%kink) .or. self%mixture%meets())) return
   call parts_at(self%scene, x, part, error)
   ! where an expression has no value here, the collocation point is taken
   if (allocated(error)) return
   own = maxloc(part, dim=1)
   if (self%mixture%part_of(ip, own) > 0.0_wp) return
   nc = size(self%scene%cloud%points, 2)
   least = huge(1.0_wp)
   do k = 1, size(self%cells%weight)
      off = sum((self%cells%point(:, k) - x)**2)
      if (off >= least .or. .not. self%mixture%part_of(nc + k, own) > 0.0_wp) cycle
      least = off
      at = nc + k
   end do
end function material_at

!> Force through a plane section: that of the part behind the plane on the part before it, from the
!> work of the internal forces in a relative motion of the two. In equilibrium it equals the sum of
!> all forces behind the plane exactly, however coarse the points are
function section_force(self, place, normal, state) result(force)
   class(galerkin_problem), intent(in) :: self
   real(wp), intent(in) :: place(:)
   real(wp), intent(in) :: normal(:)
   type(field_state), intent(in) :: state
   real(wp) :: force(3)
   real(wp), allocatable :: cut(:), inner(:)
   logical :: moved
   integer :: k, nd

   nd = self%scene%cloud%nd
   call cut_through(self%scene, place, normal, cut, moved)
   allocate (inner(self%n), source=0.0_wp)
   ! the penalty, springs and stabilisation do not contribute to the stress of one tissue
   if (state%tissue == 0) call self%constant_product(state%x(:self%matrix%n), &
      & inner(:self%matrix%n))
   force = self%surface%held_force(self%cells, cut, state)
   call self%inner_forces(state, inner)
   do k = 1, size(cut)
      force(:nd) = force(:nd) + cut(k)*inner(nd*(k - 1) + 1:nd*k)
   end do
   ! loads and supports between the plane and the cut; those of one tissue are not known
   if (state%tissue == 0 .and. moved) force = force + self%surface%force_between(self%cells, cut, &
      & dot_product(normal, place), normal, 0.5_wp*dot_product(abs(normal), &
      & sum(self%scene%cloud%spacing, dim=2))/size(cut), state)
end function section_force

!> Share of each source point in that motion, which grows from 0 to 1 within one spacing across the
!> plane. The cut must not reach surface points at the ends of the body: near an end the plane is
!> moved inwards, and where there is no room for that, the share grows over the whole body
subroutine cut_through(scene, place, normal, share, moved)
   type(scene_type), intent(in) :: scene
   !> Point of the plane, shape (nd) [length]
   real(wp), intent(in) :: place(:)
   !> Its unit normal, shape (nd)
   real(wp), intent(in) :: normal(:)
   !> Share, 0 before the plane and 1 behind it, shape (ns) [-]
   real(wp), allocatable, intent(out) :: share(:)
   !> The share does not grow at the plane, or not there alone
   logical, intent(out) :: moved
   real(wp) :: first, last, margin, middle, width

   associate (cloud => scene%cloud)
      share = matmul(normal, cloud%source)
      first = minval(share)
      last = maxval(share)
      width = dot_product(abs(normal), sum(cloud%spacing, dim=2))/size(share)
      margin = dot_product(abs(normal), maxval(scene%support, dim=2))
      ! rotated supports reach as far as their corners
      if (scene%approximation%window == window_polar) margin = norm2(maxval(scene%support, dim=2))
      ! what lies beyond a side follows its three nearest points
      if (scene%runs_out()) margin = width + dot_product(abs(normal), &
         & maxval(max(scene%support, 2.0_wp*cloud%spacing), dim=2))
      margin = margin - 0.5_wp*width
      middle = dot_product(normal, place)
      moved = last - first < 2.0_wp*margin .or. middle < first + margin .or. middle > last - margin
      if (last - first >= 2.0_wp*margin) then
         middle = min(max(middle, first + margin), last - margin)
      else
         middle = 0.5_wp*(first + last)
         width = last - first
      end if
      share = min(max(0.5_wp + (share - middle)/width, 0.0_wp), 1.0_wp)
   end associate
end subroutine cut_through

!> Force that the surroundings exert on the body through a set, or its moment
function set_force(self, set, state, share, about) result(force)
   class(galerkin_problem), intent(in) :: self
   integer, intent(in) :: set
   type(field_state), intent(in) :: state
   !> Unused: the work of the surface points is exact
   real(wp), intent(in) :: share
   real(wp), intent(in), optional :: about(3)
   real(wp) :: force(3)
   type(error_type), allocatable :: error
   real(wp), allocatable :: motion(:), value(:, :, :), traction(:, :, :)
   logical, allocatable :: essential(:, :)
   real(wp) :: push(3)
   logical :: covers(self%scene%cloud%sides())
   integer :: i, s, side, slide

   associate (unused => share)
   end associate
   ! in a motion the load is the time, at which its expressions have already been evaluated
   if (allocated(self%scene%motion)) call prescribed_at(self%scene, self%cells, essential, value, &
      & traction, error, state%load)
   force = self%surface%force(self%cells, set, state, value, traction, about)
   if (present(about)) return
   ! a set may be a whole side by another name, or several sides
   covers = [(any(self%cells%set == side) .and. all(self%cells%set /= side &
      & .or. .not. self%surface%area > 0.0_wp .or. [(self%cells%in_set(s, set), s=1, &
      & size(self%cells%set))]), side=1, size(covers))]
   if (.not. any(covers)) return
   do slide = 1, self%scene%cloud%sides()
      i = slides_on(self%scene%cloud, self%surface, self%cells, slide)
      if (i == 0) cycle
      do side = 1, self%scene%cloud%sides()
         if (covers(slide) .eqv. covers(side)) cycle
         motion = slide_motion(self%scene%cloud, self%surface, self%cells, slide, i, side)
         if (.not. any(abs(motion) > 0.0_wp)) cycle
         push = self%surface%force(self%cells, side, state, value, traction, motion=motion)
         force(i) = force(i) + merge(push(i), -push(i), covers(slide))
      end do
   end do
end function set_force

!> Mean displacement of a set: for a part of the surface that of its integration points, of which
!> there are more than boundary entries
function set_displacement(self, set, state) result(value)
   class(galerkin_problem), intent(in) :: self
   integer, intent(in) :: set
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

end module rk_galerkin
