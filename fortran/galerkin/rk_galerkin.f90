!> Galerkin form of hyperelasticity (RKPM), total Lagrangian (4.22)-(4.33).
!>
!> The energy of the body is integrated with Gauss points, or with smoothed gradients in nodal cells
!> (SCNI). Prescribed displacements hold weakly: they are lifted into the gradients (rk_gradient)
!> and held by the penalty of (4.22), which needs not be large then. The volume change is projected
!> (rk_pressure). Residual and tangent are the exact derivatives of that energy.
module rk_galerkin
   use rk_blas, only : dgemm, dsyrk
   use rk_cells, only : cells_type
   use rk_conditions, only : new_boundary
   use rk_discretisation, only : discretisation_type, deformation
   use rk_error, only : error_type
   use rk_gauss_cells, only : gauss_cells
   use rk_gradient, only : gradient_type, new_gradient
   use rk_mixture, only : new_mixture
   use rk_neighbours, only : nearest_points
   use rk_nodal_cells, only : nodal_cells
   use rk_operator, only : row_operator
   use rk_point_state, only : point_state
   use rk_precision, only : i8, wp
   use rk_pressure, only : new_pressure, pressure_type
   use rk_problem, only : evaluation_type
   use rk_recovery, only : new_recovery, recovery_type
   use rk_scene, only : scene_type
   use rk_shape, only : new_shape, shape_type
   use rk_stabilisation, only : share_bulk, stabilise
   use rk_tangent, only : add_forces, new_tangent, tangent_type
   use rk_tensor, only : cross, cross_form, determinant, identity
   use rk_weak_conditions, only : set_conditions, surface_type
   implicit none
   private

   public :: galerkin_problem, new_galerkin

   !> Galerkin problem of a scene
   type, extends(discretisation_type) :: galerkin_problem
      !> Integration points
      type(cells_type) :: cells
      !> Gradients there
      type(gradient_type) :: gradient
      !> Pressure
      type(pressure_type) :: pressure
      !> Shape functions at the integration points
      type(shape_type) :: inside
      !> Gradients of nodal cells anywhere
      type(recovery_type) :: recovery
      !> Part of the bulk modulus that acts at each collocation and integration point, shape
      !> (nc + np), and that which acts on the projected volume ratio, shape (groups) [stress]
      real(wp), allocatable :: local_bulk(:)
      real(wp), allocatable :: bulk(:)
      !> Surface
      type(surface_type) :: surface
      !> Nearest collocation point of each point, shape (np)
      integer, allocatable :: nearest(:)
      !> First Piola-Kirchhoff stress at each point in the last evaluation, shape (3, 3, np)
      real(wp), allocatable :: stress(:, :, :)
      !> Deformation gradient at each point in the last evaluation, and in that of the tangent which
      !> the next step takes, shape (3, 3, np) [-]
      real(wp), allocatable :: f(:, :, :)
      real(wp), allocatable :: base(:, :, :)
      !> Volume ratio at each point in the last evaluation, shape (np) [-]
      real(wp), allocatable :: volume(:)
      !> Tangent, and the part of it that never changes: penalty and stabilisation
      type(tangent_type) :: matrix
      real(wp), allocatable :: constant(:)
      !> Forces at full load: tractions, body forces, penalty of the prescribed values, shape (n)
      real(wp), allocatable :: force(:)
   contains
      procedure :: start_step
      procedure :: evaluate
      procedure :: predict
      procedure :: operator
      procedure :: hessian
      procedure :: local_state
      procedure :: settle
      procedure :: load_points
      procedure :: set_point_loads
      !> Force through a boundary set
      procedure :: set_force
   end type galerkin_problem


contains

!> Set up the Galerkin problem of a scene
subroutine new_galerkin(self, scene, error)
   !> Problem
   type(galerkin_problem), intent(inout) :: self
   !> Scene
   type(scene_type), target, intent(in) :: scene
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   type(shape_type) :: facet
   real(wp), allocatable :: shear(:)
   integer :: ip, nc, nd, np

   self%scene => scene
   nd = scene%cloud%nd
   nc = size(scene%cloud%points, 2)
   self%fields = nd
   call new_boundary(self%boundary, scene%cloud, scene%condition, error)
   if (allocated(error)) return
   allocate (self%shape)
   call new_shape(self%shape, scene%approximation, scene%cloud%source, scene%support, &
      & scene%cloud%points, error)
   if (allocated(error)) return
   if (scene%method == 'rkpm-gauss') then
      call gauss_cells(self%cells, scene%cloud, scene%galerkin%gauss, &
         & min(scene%approximation%order - 1, 1), error)
   else
      call nodal_cells(self%cells, scene%cloud, error)
   end if
   if (allocated(error)) return
   np = size(self%cells%weight)
   self%n = nd*size(scene%cloud%source, 2)
   self%m = self%n
   self%extent = sqrt(real(self%n, wp))*maxval(maxval(scene%cloud%source, dim=2) &
      & - minval(scene%cloud%source, dim=2))

   call shapes_at(scene, self%cells%point, self%inside, error)
   if (allocated(error)) return
   call shapes_at(scene, self%cells%surface, self%surface%shape, error)
   if (allocated(error)) return
   call shapes_at(scene, self%cells%facet, facet, error)
   if (allocated(error)) return
   self%nearest = nearest_points(scene%cloud%points, self%cells%point)
   call new_mixture(self%mixture, scene, reshape([scene%cloud%points, self%cells%point], &
      & [nd, nc + np]), [[(ip, ip=1, nc)], self%nearest], error)
   if (allocated(error)) return
   shear = [(self%mixture%shear_modulus(nc + ip, identity), ip=1, np)]
   call set_conditions(self%surface, scene, self%cells, shear)
   call new_gradient(self%gradient, self%cells, size(scene%cloud%source, 2), self%inside, facet, &
      & self%surface%shape, self%surface%essential)
   call self%gradient%set_essential(self%cells, self%surface%essential, self%surface%value)
   call new_pressure(self%pressure, self%cells, scene%galerkin%pressure_degree, &
      & scene%cloud%points, error)
   if (allocated(error)) return
   call share_bulk(self%mixture, self%cells, nc, scene%galerkin%stabilisation, self%local_bulk, &
      & self%bulk)
   if (self%cells%smoothed) call new_recovery(self%recovery, scene, self%cells, error)
   if (allocated(error)) return
   call new_tangent(self%matrix, size(scene%cloud%source, 2), self%cells, self%gradient, &
      & self%surface, self%inside, shear, scene%galerkin%direct_limit, error)
   if (allocated(error)) return
   allocate (self%stress(3, 3, np), self%f(3, 3, np), self%volume(np), self%force(self%n))
   allocate (self%constant(size(self%matrix%value, kind=i8)), source=0.0_wp)
   call self%surface%add_penalty(self%matrix%symmetric_matrix, self%constant)
   if (self%cells%smoothed) call stabilise(self%matrix%symmetric_matrix, self%constant, &
      & self%cells, self%inside, scene%galerkin%stabilisation*shear)
   self%force = 0.0_wp
   call self%surface%add_forces(self%force)
end subroutine new_galerkin

!> Shape functions at places
subroutine shapes_at(scene, place, shape, error)
   !> Scene
   type(scene_type), intent(in) :: scene
   !> Places, shape (nd, np) [length]
   real(wp), intent(in) :: place(:, :)
   !> Shape functions
   type(shape_type), intent(out) :: shape
   !> Error handling
   type(error_type), allocatable, intent(out) :: error

   call new_shape(shape, scene%approximation, scene%cloud%source, scene%support, place, error)
   if (allocated(error)) error%message = 'integration '//error%message
end subroutine shapes_at

!> Points where set_point_loads wants values: the integration points, then those of the surface
function load_points(self) result(x)
   !> Problem
   class(galerkin_problem), intent(in) :: self
   !> Points, shape (nd, n) [length]
   real(wp), allocatable :: x(:, :)
   integer :: np

   np = size(self%cells%weight)
   allocate (x(size(self%cells%point, 1), np + size(self%cells%set)))
   x(:, :np) = self%cells%point
   x(:, np + 1:) = self%cells%surface
end function load_points

!> Set what varies over the points and has no place in a deck, at full load
subroutine set_point_loads(self, body_force, displacement, stress)
   !> Problem
   class(galerkin_problem), intent(inout) :: self
   !> Body force per undeformed volume, shape (3, n) [force/length^3]
   real(wp), intent(in) :: body_force(:, :)
   !> Displacement of the essential components, shape (3, n) [length]
   real(wp), intent(in) :: displacement(:, :)
   !> Stress P(i, A) whose traction the other components carry, shape (3, 3, n) [stress]
   real(wp), intent(in) :: stress(:, :, :)
   integer :: k, nd, np, q, s
   integer(i8) :: at, first

   nd = self%scene%cloud%nd
   np = size(self%cells%weight)
   do s = 1, size(self%cells%set)
      self%surface%value(:, s) = displacement(:nd, np + s)
      self%surface%traction(:, s) = merge(0.0_wp, matmul(stress(:nd, :nd, np + s), &
         & self%cells%outward(:, s))/self%surface%area(s), self%surface%essential(:, s))
   end do
   call self%gradient%set_essential(self%cells, self%surface%essential, self%surface%value)
   self%force = 0.0_wp
   call self%surface%add_forces(self%force)
   do q = 1, np
      at = self%inside%neighbour%offset(q)
      first = self%inside%first(self%inside%stencil(q))
      do k = 1, self%inside%count(q)
         associate (node => self%inside%neighbour%index(at + k))
            self%force(nd*(node - 1) + 1:nd*node) = self%force(nd*(node - 1) + 1:nd*node) &
               & + self%cells%weight(q)*self%inside%value(1, first + k)*body_force(:nd, q)
         end associate
      end do
   end do
end subroutine set_point_loads

!> Forget where the last step came from
subroutine start_step(self, x, load)
   !> Problem
   class(galerkin_problem), target, intent(inout) :: self
   !> Unknowns at the start of the step, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load at the end of the step [-]
   real(wp), intent(in) :: load

   associate (unknowns => x, at => load)
   end associate
   if (allocated(self%base)) deallocate (self%base)
end subroutine start_step

!> Residual and tangent (4.31), (4.32): internal less external forces
subroutine evaluate(self, x, load, tangent, r, state)
   !> Problem
   class(galerkin_problem), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Linearise
   logical, intent(in) :: tangent
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: state

   call assemble(self, x, load, load, tangent, r, state)
end subroutine evaluate

!> The same with essential values of the last converged state: they jump at the start of a load
!> step, and the gradients into which they are lifted might not even keep J > 0. The jump acts
!> linearly.
subroutine predict(self, x, done, load, r, state)
   !> Problem
   class(galerkin_problem), target, intent(inout) :: self
   !> Unknowns of the last converged state, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Its load [-]
   real(wp), intent(in) :: done
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: state

   call assemble(self, x, done, load, .true., r, state)
end subroutine predict

!> Sum over the groups
subroutine assemble(self, x, held, load, tangent, r, state)
   !> Problem
   type(galerkin_problem), intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load of the essential values in the gradients [-]
   real(wp), intent(in) :: held
   !> Load [-]
   real(wp), intent(in) :: load
   !> Linearise
   logical, intent(in) :: tangent
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: state
   real(wp), allocatable :: part(:, :), force(:, :)
   integer :: g, nd

   nd = self%scene%cloud%nd
   call self%matrix%product(self%constant, x, r)
   r = r - load*self%force
   if (tangent) self%matrix%value = self%constant
   ! parts are added in the order of the groups, so that sums do not depend on the threads
   !$omp parallel do default(none) schedule(static, 1) ordered private(g, part, force) &
   !$omp shared(self, x, held, load, tangent, r, nd)
   do g = 1, size(self%cells%first) - 1
      associate (member => self%gradient%member(self%gradient%member_start(g) + 1: &
         & self%gradient%member_start(g + 1)))
         call group_part(self, g, x, held, load, tangent, force, part)
         !$omp ordered
         call add_forces(member, force, r)
         if (tangent .and. self%matrix%formed) call self%matrix%add(self%matrix%value, member, part)
         !$omp end ordered
      end associate
   end do
   !$omp end parallel do
   state%worst = minloc(self%volume, dim=1)
   state%min_j = self%volume(state%worst)
   state%max_j = maxval(self%volume)
   ! comparisons that a NaN fails
   state%valid = all(self%volume > 0.0_wp) .and. all(abs(r) <= huge(1.0_wp))
   state%worst = self%nearest(state%worst)
end subroutine assemble

!> Forces and stiffness of a group of points
subroutine group_part(self, g, x, held, load, tangent, force, part)
   !> Problem; stress, volume ratio and pressure of the group are set
   class(galerkin_problem), intent(inout) :: self
   !> Group
   integer, intent(in) :: g
   !> Unknowns [length]
   real(wp), intent(in) :: x(self%gradient%nd, self%n/self%gradient%nd)
   !> Load of the essential values in the gradients [-]
   real(wp), intent(in) :: held
   !> Load [-]
   real(wp), intent(in) :: load
   !> Stiffness wanted
   logical, intent(in) :: tangent
   !> Forces, shape (nd, members) [force]
   real(wp), allocatable, intent(inout) :: force(:, :)
   !> Upper triangle of the stiffness, shape (nd*members, nd*members) [force/length]
   real(wp), allocatable, intent(inout) :: part(:, :)
   real(wp), allocatable :: c4(:, :, :, :, :), local(:, :), volume(:, :)
   real(wp) :: h(self%gradient%nd, self%gradient%nd), p(3, 3), cofactor(3, 3), bulk, value(4)
   real(wp) :: linear(4), jump(4), pressure, local_pressure
   integer :: nc, nd, n, q, o, i, k, members, b
   integer(i8) :: e
   logical :: formed, stacked

   formed = tangent .and. self%matrix%formed
   ! what the volume of the group changes by is wanted as rows
   stacked = formed .or. (tangent .and. held < load)
   nd = self%gradient%nd
   o = self%cells%first(g)
   n = self%cells%first(g + 1) - o
   b = self%pressure%count(g)
   associate (member => self%gradient%member(self%gradient%member_start(g) + 1: &
      & self%gradient%member_start(g + 1)))
      members = size(member)
      allocate (local(nd, members))
      local = x(:, member)
   end associate
   if (allocated(force)) deallocate (force)
   allocate (force(nd, members), source=0.0_wp)
   if (allocated(part)) deallocate (part)
   if (formed) allocate (part(nd*members, nd*members), source=0.0_wp)
   value = 0.0_wp
   linear = 0.0_wp
   do q = 1, n
      call self%gradient%at(o + q, local, held, h)
      associate (f => self%f(:, :, o + q), w => self%cells%weight(o + q))
         f = 0.0_wp
         do i = 1, 3
            f(i, i) = 1.0_wp
         end do
         f(:nd, :nd) = f(:nd, :nd) + h
         self%volume(o + q) = determinant(f)
         value(:b) = value(:b) + w*self%volume(o + q)*self%pressure%basis(:b, o + q)
         if (.not. allocated(self%base)) cycle
         associate (base => self%base(:, :, o + q))
            linear(:b) = linear(:b) + w*self%pressure%basis(:b, o + q)*(determinant(base) &
               & + 0.5_wp*sum(cross(base, base)*(f - base)))
         end associate
      end associate
   end do
   if (.not. allocated(self%base)) linear = value
   self%stress(:, :, o + 1:o + n) = 0.0_wp
   ! no stress exists; the caller rejects the state
   if (.not. all(self%volume(o + 1:o + n) > 0.0_wp)) return

   nc = size(self%scene%cloud%points, 2)
   bulk = self%bulk(g)
   value(:b) = bulk*(value(:b) - self%pressure%total(:b, g))
   self%pressure%coefficient(:b, g) = value(:b)
   ! the pressure of a mixed Newton iteration, in which it is linear in the step: with K (J - 1) of
   ! the new place instead, the stiffness suffers from every bit of volume that a step leaves
   linear(:b) = bulk*(linear(:b) - self%pressure%total(:b, g))
   jump = 0.0_wp
   if (tangent) then
      allocate (c4(3, 3, 3, 3, n))
      if (stacked) allocate (volume(nd*members, b), source=0.0_wp)
   end if
   do q = 1, n
      local_pressure = self%local_bulk(nc + o + q)*(self%volume(o + q) - 1.0_wp)
      pressure = local_pressure + dot_product(value(:b), self%pressure%basis(:b, o + q))
      associate (f => self%f(:, :, o + q))
         cofactor = 0.5_wp*cross(f, f)
      end associate
      if (tangent) then
         call self%mixture%tangent(nc + o + q, self%f(:, :, o + q), load, p, c4(:, :, :, :, q), &
            & volumetric=.false.)
         c4(:, :, :, :, q) = self%cells%weight(o + q)*(c4(:, :, :, :, q) &
            & + (local_pressure + dot_product(linear(:b), self%pressure%basis(:b, o + q))) &
            & *reshape(cross_form(self%f(:, :, o + q)), [3, 3, 3, 3]) &
            & + self%local_bulk(nc + o + q)*reshape(matmul(reshape(cofactor, [9, 1]), &
            & reshape(cofactor, [1, 9])), [3, 3, 3, 3]))
      else
         call self%mixture%stress(nc + o + q, self%f(:, :, o + q), load, p, volumetric=.false.)
      end if
      p = p + pressure*cofactor
      self%stress(:, :, o + q) = p
      if (tangent .and. held < load) then
         h = (load - held)*self%gradient%given(:, :, o + q)
         do i = 1, nd
            do k = 1, nd
               p(:nd, :nd) = p(:nd, :nd) + c4(:nd, :nd, i, k, q)*h(i, k)/self%cells%weight(o + q)
            end do
         end do
         jump(:b) = jump(:b) + self%cells%weight(o + q)*sum(cofactor(:nd, :nd)*h) &
            & *self%pressure%basis(:b, o + q)
      end if
      p = self%cells%weight(o + q)*p
      cofactor = self%cells%weight(o + q)*cofactor
      if (tangent .and. .not. formed) self%matrix%cofactor(:, :, o + q) = cofactor
      call self%gradient%add_force(o + q, p, force)
      if (.not. stacked) cycle
      do e = self%gradient%start(o + q) + 1, self%gradient%start(o + q + 1)
         k = int(e - self%gradient%start(o + q))
         do i = 1, nd
            associate (grad => self%gradient%value(:, self%gradient%first(i, o + q) + k), &
               & at => self%gradient%local(e))
               volume(nd*(at - 1) + i, :) = volume(nd*(at - 1) + i, :) &
                  & + dot_product(cofactor(i, :nd), grad)*self%pressure%basis(:b, o + q)
            end associate
         end do
      end do
   end do
   if (.not. tangent) return
   if (stacked) force = force + bulk*reshape(matmul(volume, jump(:b)), shape(force))
   if (.not. formed) then
      self%matrix%bulk(g) = bulk
      self%matrix%moduli(:, :, :, :, o + 1:o + n) = c4
      return
   end if
   call dsyrk('u', 'n', nd*members, b, bulk, volume, nd*members, 0.0_wp, part, nd*members)
   call add_stiffness(self, o, n, members, c4, part)
end subroutine group_part

!> Stiffness of the tangent moduli: the gradients of all points of a group stacked, so that the work
!> is in a few large products
subroutine add_stiffness(self, o, n, members, c4, part)
   !> Problem
   class(galerkin_problem), intent(in) :: self
   !> Points before the group, points in it, and its source points
   integer, intent(in) :: o, n, members
   !> Moduli times weight, shape (3, 3, 3, 3, n) [stress length^nd]
   real(wp), intent(in) :: c4(:, :, :, :, :)
   !> Stiffness, shape (nd*members, nd*members) [force/length]
   real(wp), intent(inout) :: part(:, :)
   real(wp), allocatable :: stack(:, :, :), right(:, :), block(:, :)
   integer :: nd, i, j, k, q
   integer(i8) :: e

   nd = self%gradient%nd
   allocate (stack(nd*n, members, nd), source=0.0_wp)
   allocate (right(nd*n, members), block(members, members))
   do i = 1, nd
      do q = 1, n
         do e = self%gradient%start(o + q) + 1, self%gradient%start(o + q + 1)
            k = int(e - self%gradient%start(o + q))
            stack(nd*(q - 1) + 1:nd*q, self%gradient%local(e), i) = &
               & self%gradient%value(:, self%gradient%first(i, o + q) + k)
         end do
      end do
   end do
   do j = 1, nd
      do i = 1, j
         do k = 1, members
            do q = 1, n
               right(nd*(q - 1) + 1:nd*q, k) = matmul(c4(i, :nd, j, :nd, q), &
                  & stack(nd*(q - 1) + 1:nd*q, k, j))
            end do
         end do
         call dgemm('t', 'n', members, members, nd*n, 1.0_wp, stack(:, :, i), nd*n, right, nd*n, &
            & 0.0_wp, block, members)
         part(i::nd, j::nd) = part(i::nd, j::nd) + block
         if (i < j) part(j::nd, i::nd) = part(j::nd, i::nd) + transpose(block)
      end do
   end do
end subroutine add_stiffness

!> Tangent
function operator(self) result(op)
   !> Problem
   class(galerkin_problem), target, intent(inout) :: self
   class(row_operator), pointer :: op

   ! asked for at the places where steps begin
   self%base = self%f
   self%matrix%cells => self%cells
   self%matrix%gradient => self%gradient
   self%matrix%pressure => self%pressure
   op => self%matrix
end function operator

!> Newton's matrix of r.r/2 is not needed: the tangent is square and solved directly
subroutine hessian(self, x, load, r, a)
   !> Problem
   class(galerkin_problem), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (n)
   real(wp), contiguous, intent(in) :: r(:)
   !> Upper triangle of A^T A, shape (n, n)
   real(wp), contiguous, intent(inout) :: a(:, :)

   associate (unknowns => x, at => load, residual => r)
   end associate
   call self%matrix%normal(a)
end subroutine hessian

!> Evaluate, so that stress and pressure are those of the state
subroutine settle(self, x, load)
   !> Problem
   class(galerkin_problem), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   real(wp), allocatable :: r(:)
   type(evaluation_type) :: state

   allocate (r(self%n))
   call self%evaluate(x, load, .false., r, state)
end subroutine settle

!> Stress and deformation at a place from the displacement there and the settled state's pressure
subroutine local_state(self, ip, x, u, load, local)
   !> Problem
   class(galerkin_problem), intent(in) :: self
   !> Collocation point whose material and fiber hold there
   integer, intent(in) :: ip
   !> Undeformed place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Displacement with derivatives, shape (nd, nq)
   real(wp), intent(in) :: u(:, :)
   !> Load [-]
   real(wp), intent(in) :: load
   !> State
   type(point_state), intent(out) :: local
   real(wp) :: h(3, 3, 3), pressure

   local%x(:size(x)) = x
   local%u(:size(x)) = u(:size(x), 1)
   pressure = self%pressure%at(ip, x)
   if (self%cells%smoothed) then
      local%f = self%recovery%at(ip, x, self%f)
      local%j = determinant(local%f)
      pressure = pressure + (local%j - 1.0_wp)*self%local_bulk(ip)
   else
      call deformation(size(x), u, local%f, h)
      local%j = determinant(local%f)
   end if
   call self%mixture%stress(ip, local%f, load, local%p, volumetric=.false.)
   local%p = local%p + 0.5_wp*pressure*cross(local%f, local%f)
   local%cauchy = matmul(local%p, transpose(local%f))/local%j
end subroutine local_state

!> Force that the surroundings exert on the body through a set, from the settled state
function set_force(self, set, x, load, share) result(force)
   !> Problem
   class(galerkin_problem), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Of no meaning: the work of the surface's own points is exact
   real(wp), intent(in) :: share
   real(wp) :: force(3)

   associate (unused => share)
   end associate
   force = self%surface%force(self%cells, self%stress, set, x, load)
end function set_force

end module rk_galerkin
