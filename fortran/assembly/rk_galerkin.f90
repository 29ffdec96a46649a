!> Galerkin form of hyperelasticity (RKPM), total Lagrangian (4.22)-(4.33).
!>
!> The energy of the body is integrated with Gauss points, or with smoothed gradients in nodal cells
!> (SCNI). Prescribed displacements hold weakly: they are lifted into the gradients (rk_gradient)
!> and held by the penalty of (4.22), which needs not be large then. The volume change is projected
!> (rk_pressure). Residual and tangent are the exact derivatives of that energy.
module rk_galerkin
   use rk_blas, only : dgemm, dsyrk
   use rk_body, only : body_type, deformation, determinant
   use rk_boundary, only : new_boundary
   use rk_cells, only : cells_type, gauss_cells
   use rk_cross, only : cross, cross_form
   use rk_error, only : error_type
   use rk_gradient, only : gradient_type, new_gradient
   use rk_local, only : local_type
   use rk_nearest, only : nearest_places
   use rk_nodal, only : nodal_cells
   use rk_operator, only : row_operator
   use rk_precision, only : i8, wp
   use rk_pressure, only : new_pressure, pressure_type
   use rk_problem, only : state_type
   use rk_scene, only : scene_type
   use rk_shape, only : new_shape, shape_type
   use rk_symmetric, only : new_symmetric, symmetric_matrix
   implicit none
   private

   public :: galerkin_type, new_galerkin

   !> Galerkin problem of a scene
   type, extends(body_type) :: galerkin_type
      !> Integration points
      type(cells_type) :: cells
      !> Gradients there
      type(gradient_type) :: gradient
      !> Pressure
      type(pressure_type) :: pressure
      !> Shape functions at the surface
      type(shape_type) :: surface
      !> Components prescribed at each surface point, shape (nd, ms)
      logical, allocatable :: essential(:, :)
      !> Their values at full load, shape (nd, ms) [length]
      real(wp), allocatable :: value(:, :)
      !> Tractions of the others at full load, shape (nd, ms) [force/area]
      real(wp), allocatable :: traction(:, :)
      !> Penalty times area of each surface point, shape (ms) [force/length]
      real(wp), allocatable :: penalty(:)
      !> Collocation point whose material and fiber hold at each point, shape (np)
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
      type(symmetric_matrix) :: matrix
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
      !> Force through a boundary set
      procedure :: set_force
   end type galerkin_type

contains

!> Set up the Galerkin problem of a scene
subroutine new_galerkin(self, scene, error)
   !> Problem
   type(galerkin_type), intent(inout) :: self
   !> Scene
   type(scene_type), target, intent(in) :: scene
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   type(shape_type) :: inside, facet
   integer :: nd, np

   self%scene => scene
   nd = scene%cloud%nd
   self%fields = nd
   call new_boundary(self%boundary, scene%cloud, scene%condition, error)
   if (allocated(error)) return
   allocate (self%shape)
   call new_shape(self%shape, scene%approximation, scene%cloud%source, scene%support, &
      & scene%cloud%place, error)
   if (allocated(error)) return
   if (scene%method == 'rkpm-gauss') then
      call gauss_cells(self%cells, scene%cloud, scene%gauss, &
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

   call shapes_at(scene, self%cells%point, inside, error)
   if (allocated(error)) return
   call shapes_at(scene, self%cells%surface, self%surface, error)
   if (allocated(error)) return
   if (self%cells%smoothed) call shapes_at(scene, self%cells%facet, facet, error)
   if (allocated(error)) return
   call nearest_places(scene%cloud%place, self%cells%point, self%nearest, error)
   if (allocated(error)) return
   call set_conditions(self)
   call new_gradient(self%gradient, self%cells, size(scene%cloud%source, 2), inside, facet, &
      & self%surface, self%essential, self%value)
   call new_pressure(self%pressure, self%cells, scene%pressure_degree, scene%cloud%place, error)
   if (allocated(error)) return
   call new_symmetric(self%matrix, nd, size(scene%cloud%source, 2), self%gradient%member_start, &
      & self%gradient%member)
   allocate (self%stress(3, 3, np), self%f(3, 3, np), self%volume(np), self%force(self%n))
   allocate (self%constant(size(self%matrix%value, kind=i8)))
   call set_constant(self, inside)
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

!> Conditions at the surface points, from those on their sets
subroutine set_conditions(self)
   !> Problem with integration points
   type(galerkin_type), intent(inout) :: self
   real(wp) :: x(2), spacing
   integer :: c, s, nd, ms, q

   nd = self%scene%cloud%nd
   ms = size(self%cells%set)
   allocate (self%essential(nd, ms), source=.false.)
   allocate (self%value(nd, ms), self%traction(nd, ms), self%penalty(ms), source=0.0_wp)
   do s = 1, ms
      do c = 1, size(self%scene%condition)
         associate (condition => self%scene%condition(c))
            if (condition%set /= self%cells%set(s)) cycle
            self%traction(:, s) = self%traction(:, s) + condition%traction(:nd)
            where (condition%fixed(:nd))
               self%essential(:, s) = .true.
               self%value(:, s) = condition%value(:nd)
            end where
            if (.not. condition%is_radial) cycle
            x = self%cells%surface(:2, s)
            self%essential(:2, s) = .true.
            self%value(:2, s) = condition%radial*x/norm2(x)
         end associate
      end do
      where (self%essential(:, s)) self%traction(:, s) = 0.0_wp
      q = self%cells%lift_point(self%cells%lift_first(s) + 1)
      ! the spacing of the source points, as the body's volume and their number have it
      spacing = (sum(self%cells%weight)/size(self%scene%cloud%source, 2))**(1.0_wp/nd)
      associate (material => self%scene%tissue(self%scene%tissue_of(self%nearest(q)))%material)
         self%penalty(s) = self%scene%penalty*material%shear/spacing*norm2(self%cells%outward(:, s))
      end associate
   end do
end subroutine set_conditions

!> Penalty, tractions and body forces: linear in the unknowns and in the load
subroutine set_constant(self, inside)
   !> Problem
   type(galerkin_type), intent(inout) :: self
   !> Shape functions at the integration points
   type(shape_type), intent(in) :: inside
   real(wp), allocatable :: part(:, :)
   integer :: nd, s, i, k, l, q
   integer(i8) :: at, to_value

   nd = self%scene%cloud%nd
   self%constant = 0.0_wp
   self%force = 0.0_wp
   do s = 1, size(self%penalty)
      at = self%surface%neighbour%offset(s)
      to_value = self%surface%first(self%surface%stencil(s))
      associate (n => self%surface%count(s))
         associate (node => self%surface%neighbour%index(at + 1:at + n), &
            & value => self%surface%value(1, to_value + 1:to_value + n))
            do i = 1, nd
               self%force(nd*(node - 1) + i) = self%force(nd*(node - 1) + i) + value &
                  & *(merge(self%penalty(s)*self%value(i, s), 0.0_wp, self%essential(i, s)) &
                  & + norm2(self%cells%outward(:, s))*self%traction(i, s))
            end do
            if (.not. any(self%essential(:, s))) cycle
            allocate (part(nd*n, nd*n), source=0.0_wp)
            do l = 1, n
               do k = 1, l
                  do i = 1, nd
                     if (self%essential(i, s)) part(nd*(k - 1) + i, nd*(l - 1) + i) &
                        & = self%penalty(s)*value(k)*value(l)
                  end do
               end do
            end do
            call self%matrix%add(self%constant, node, part)
            deallocate (part)
         end associate
      end associate
   end do
   if (.not. allocated(self%scene%body_force)) return
   do q = 1, size(self%nearest)
      at = inside%neighbour%offset(q)
      to_value = inside%first(inside%stencil(q))
      do k = 1, inside%count(q)
         associate (node => inside%neighbour%index(at + k))
            self%force(nd*(node - 1) + 1:nd*node) = self%force(nd*(node - 1) + 1:nd*node) &
               & + self%cells%weight(q)*inside%value(1, to_value + k) &
               & *self%scene%body_force(:nd, self%nearest(q))
         end associate
      end do
   end do
end subroutine set_constant

!> Forget where the last step came from
subroutine start_step(self, x, load)
   !> Problem
   class(galerkin_type), target, intent(inout) :: self
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
   class(galerkin_type), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Linearise
   logical, intent(in) :: tangent
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(state_type), intent(out) :: state

   call assemble(self, x, load, load, tangent, r, state)
end subroutine evaluate

!> The same with essential values of the last converged state: they jump at the start of a load step,
!> and the gradients into which they are lifted might not even keep J > 0. The jump acts linearly.
subroutine predict(self, x, done, load, r, state)
   !> Problem
   class(galerkin_type), target, intent(inout) :: self
   !> Unknowns of the last converged state, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Its load [-]
   real(wp), intent(in) :: done
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(state_type), intent(out) :: state

   call assemble(self, x, done, load, .true., r, state)
end subroutine predict

!> Sum over the groups
subroutine assemble(self, x, held, load, tangent, r, state)
   !> Problem
   type(galerkin_type), intent(inout) :: self
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
   type(state_type), intent(out) :: state
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
         call group_part(self, g, reshape(x, [nd, size(x)/nd]), held, load, tangent, &
            & force, part)
         !$omp ordered
         call add_force(member, force, r)
         if (tangent) call self%matrix%add(self%matrix%value, member, part)
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

!> Add the forces of a group
pure subroutine add_force(member, force, r)
   !> Source points of the group
   integer, intent(in) :: member(:)
   !> Forces on them, shape (nd, members) [force]
   real(wp), intent(in) :: force(:, :)
   !> Residual, shape (n)
   real(wp), intent(inout) :: r(:)
   integer :: k, nd

   nd = size(force, 1)
   do k = 1, size(member)
      r(nd*(member(k) - 1) + 1:nd*member(k)) = r(nd*(member(k) - 1) + 1:nd*member(k)) + force(:, k)
   end do
end subroutine add_force

!> Forces and stiffness of a group of points
subroutine group_part(self, g, x, held, load, tangent, force, part)
   !> Problem; stress, volume ratio and pressure of the group are set
   class(galerkin_type), intent(inout) :: self
   !> Group
   integer, intent(in) :: g
   !> Unknowns, shape (nd, ns) [length]
   real(wp), intent(in) :: x(:, :)
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
   real(wp) :: linear(4), jump(4), pressure
   integer :: nd, n, q, o, i, k, members, b
   integer(i8) :: e

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
   if (tangent) allocate (part(nd*members, nd*members), source=0.0_wp)
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

   bulk = self%scene%tissue(self%scene%tissue_of(self%nearest(o + 1)))%material%bulk
   value(:b) = bulk*(value(:b) - self%pressure%total(:b, g))
   self%pressure%coefficient(:b, g) = value(:b)
   ! the pressure of a mixed Newton iteration, in which it is linear in the step: with K (J - 1) of
   ! the new place instead, the stiffness suffers from every bit of volume that a step leaves
   linear(:b) = bulk*(linear(:b) - self%pressure%total(:b, g))
   jump = 0.0_wp
   if (tangent) then
      allocate (c4(3, 3, 3, 3, n))
      allocate (volume(nd*members, b), source=0.0_wp)
   end if
   do q = 1, n
      pressure = dot_product(value(:b), self%pressure%basis(:b, o + q))
      associate (f => self%f(:, :, o + q))
         cofactor = 0.5_wp*cross(f, f)
      end associate
      associate (ip => self%nearest(o + q), activation => load*self%scene%activation)
         associate (material => self%scene%tissue(self%scene%tissue_of(ip))%material, &
            & fiber => self%scene%cloud%fiber(:, ip))
            if (tangent) then
               call material%tangent(self%f(:, :, o + q), fiber, activation, p, &
                  & c4(:, :, :, :, q), volumetric=.false.)
               c4(:, :, :, :, q) = self%cells%weight(o + q)*(c4(:, :, :, :, q) &
                  & + dot_product(linear(:b), self%pressure%basis(:b, o + q)) &
                  & *reshape(cross_form(self%f(:, :, o + q)), [3, 3, 3, 3]))
            else
               call material%stress(self%f(:, :, o + q), fiber, activation, p, volumetric=.false.)
            end if
         end associate
      end associate
      p = p + pressure*cofactor
      self%stress(:, :, o + q) = p
      if (tangent .and. held < load) then
         do i = 1, nd
            do k = 1, nd
               p(:nd, :nd) = p(:nd, :nd) + (load - held)/self%cells%weight(o + q) &
                  & *c4(:nd, :nd, i, k, q)*self%gradient%given(i, k, o + q)
            end do
         end do
         jump(:b) = jump(:b) + (load - held)*self%cells%weight(o + q)*self%pressure%basis(:b, o + q) &
            & *sum(cofactor(:nd, :nd)*self%gradient%given(:, :, o + q))
      end if
      p = self%cells%weight(o + q)*p
      cofactor = self%cells%weight(o + q)*cofactor
      do e = self%gradient%start(o + q) + 1, self%gradient%start(o + q + 1)
         k = int(e - self%gradient%start(o + q))
         do i = 1, nd
            associate (grad => self%gradient%value(:, self%gradient%first(i, o + q) + k), &
               & at => self%gradient%local(e))
               force(i, at) = force(i, at) + dot_product(p(i, :nd), grad)
               if (tangent) volume(nd*(at - 1) + i, :) = volume(nd*(at - 1) + i, :) &
                  & + dot_product(cofactor(i, :nd), grad)*self%pressure%basis(:b, o + q)
            end associate
         end do
      end do
   end do
   if (.not. tangent) return
   force = force + bulk*reshape(matmul(volume, jump(:b)), shape(force))
   call dsyrk('u', 'n', nd*members, b, bulk, volume, nd*members, 0.0_wp, part, nd*members)
   call add_stiffness(self, o, n, members, c4, part)
end subroutine group_part

!> Stiffness of the tangent moduli: the gradients of all points of a group stacked, so that the work
!> is in a few large products
subroutine add_stiffness(self, o, n, members, c4, part)
   !> Problem
   class(galerkin_type), intent(in) :: self
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
   class(galerkin_type), target, intent(inout) :: self
   class(row_operator), pointer :: op

   ! asked for at the places where steps begin
   self%base = self%f
   op => self%matrix
end function operator

!> Newton's matrix of r.r/2 is not needed: the tangent is square and solved directly
subroutine hessian(self, x, load, r, a)
   !> Problem
   class(galerkin_type), target, intent(inout) :: self
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
   class(galerkin_type), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   real(wp), allocatable :: r(:)
   type(state_type) :: state

   allocate (r(self%n))
   call self%evaluate(x, load, .false., r, state)
end subroutine settle

!> Stress and deformation at a place from the displacement there and the settled state's pressure
subroutine local_state(self, ip, x, u, load, local)
   !> Problem
   class(galerkin_type), intent(in) :: self
   !> Collocation point whose material and fiber hold there
   integer, intent(in) :: ip
   !> Undeformed place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Displacement with derivatives, shape (nd, nq)
   real(wp), intent(in) :: u(:, :)
   !> Load [-]
   real(wp), intent(in) :: load
   !> State
   type(local_type), intent(out) :: local
   real(wp) :: h(3, 3, 3)

   local%x(:size(x)) = x
   local%u(:size(x)) = u(:size(x), 1)
   call deformation(size(x), u, local%f, h)
   local%j = determinant(local%f)
   associate (material => self%scene%tissue(self%scene%tissue_of(ip))%material)
      call material%stress(local%f, self%scene%cloud%fiber(:, ip), load*self%scene%activation, &
         & local%p, volumetric=.false.)
   end associate
   local%p = local%p + 0.5_wp*self%pressure%at(ip, x)*cross(local%f, local%f)
   local%cauchy = matmul(local%p, transpose(local%f))/local%j
end subroutine local_state

!> Force that the surroundings exert on the body through a set, from the settled state: what does
!> the work when the set moves
function set_force(self, set, x, load) result(force)
   !> Problem
   class(galerkin_type), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   real(wp) :: force(3)
   real(wp) :: u(self%fields, self%surface%nq), p(3, 3)
   integer :: i, k, nd, s

   nd = self%scene%cloud%nd
   force = 0.0_wp
   do s = 1, size(self%cells%set)
      if (self%cells%set(s) /= set) cycle
      call self%surface%interpolate(s, x, 1, 1, u)
      p = 0.0_wp
      do k = self%cells%lift_first(s) + 1, self%cells%lift_first(s + 1)
         associate (q => self%cells%lift_point(k))
            p = p + self%cells%lift(k)*self%cells%weight(q)*self%stress(:, :, q)
         end associate
      end do
      do i = 1, nd
         if (self%essential(i, s)) then
            force(i) = force(i) + dot_product(p(i, :nd), self%cells%outward(:, s)) &
               & - self%penalty(s)*(u(i, 1) - load*self%value(i, s))
         else
            force(i) = force(i) + load*self%traction(i, s)*norm2(self%cells%outward(:, s))
         end if
      end do
   end do
end function set_force

end module rk_galerkin
