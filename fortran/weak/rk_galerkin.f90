!> Galerkin form of hyperelasticity (RKPM), total Lagrangian (4.22)-(4.33).
!>
!> The energy of the body is integrated with Gauss points, or with smoothed gradients in nodal cells
!> (SCNI). Prescribed displacements hold weakly: they are lifted into the gradients (rk_gradient)
!> and held by the penalty of (4.22), which needs not be large then, or exactly at source points
!> (rk_held). The volume change is projected (rk_pressure). Residual and tangent are the exact
!> derivatives of that energy.
module rk_galerkin
   use rk_blas, only : dsyrk
   use rk_conditions, only : new_boundary
   use rk_csr, only : csr_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_follower, only : add_pressure, has_free_rim
   use rk_gauss_cells, only : gauss_cells
   use rk_gradient, only : new_gradient
   use rk_group_stiffness, only : add_forces
   use rk_mixture, only : new_mixture
   use rk_multiplier, only : new_multiplier
   use rk_neighbours, only : nearest_points
   use rk_nodal_cells, only : nodal_cells
   use rk_operator, only : row_operator, square_report
   use rk_precision, only : i8, wp
   use rk_pressure, only : new_pressure
   use rk_problem, only : evaluation_type
   use rk_programme, only : ramp
   use rk_recovery, only : new_recovery
   use rk_scene, only : scene_type
   use rk_shape, only : shape_type
   use rk_split_cells, only : split_cells
   use rk_stabilisation, only : share_bulk
   use rk_states, only : field_state
   use rk_surface_sets, only : find_surface_sets
   use rk_tangent, only : new_tangent
   use rk_tensor, only : add_cross_form, cross, identity
   use rk_text, only : to_text
   use rk_weak, only : curved, deform_group, hold_points, new_state, pressures_at, weak_problem
   use rk_weak_conditions, only : add_body_force, set_conditions
   implicit none
   private

   public :: galerkin_problem, new_galerkin

   !> Galerkin problem of a scene
   type, extends(weak_problem) :: galerkin_problem
      !> F where the tangent was taken, and where the step to there began, shape (3, 3, np) [-]
      real(wp), allocatable :: origin(:, :, :), base(:, :, :)
      !> The next place is no step of the tangent: the pressure of its tangent is that of the base
      logical :: leaps = .false.
   contains
      procedure :: start_step
      procedure :: evaluate
      procedure :: linearise
      procedure :: predict
      procedure :: extrapolate
      procedure :: start_iteration
      procedure :: measure
      procedure :: operator
      procedure :: square_step
      procedure :: set_point_loads
      procedure :: renew
      procedure :: caveat
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
   type(csr_type) :: covering
   real(wp), allocatable :: shear(:), softness(:)
   integer :: blocks, ip, nc, nd, np, ns

   self%scene => scene
   self%costly = .true.
   nd = scene%cloud%nd
   nc = size(scene%cloud%points, 2)
   ns = size(scene%cloud%source, 2)
   self%fields = nd
   call new_boundary(self%boundary, scene%cloud, scene%condition, scene%programme%count(), error)
   if (allocated(error)) return
   allocate (self%shape)
   call scene%shape_at(scene%cloud%points, self%shape, error, first=.true.)
   if (allocated(error)) return
   if (allocated(scene%cloud%block)) then
      call nodal_cells(self%cells, scene%cloud, error)
      if (.not. allocated(error)) call split_cells(self%cells)
   else if (scene%method == 'rkpm-gauss') then
      call gauss_cells(self%cells, scene%cloud, scene%galerkin%gauss, &
         & min(scene%approximation%order - 1, 1), error)
   else
      call nodal_cells(self%cells, scene%cloud, error)
   end if
   if (.not. allocated(error)) call find_surface_sets(self%cells, scene%cloud, error)
   if (allocated(error)) return
   np = size(self%cells%weight)
   self%extent = sqrt(real(nd*ns, wp))*maxval(maxval(scene%cloud%source, dim=2) &
      & - minval(scene%cloud%source, dim=2))

   call scene%shape_at(self%cells%point, self%inside, error, first=.not. self%cells%smoothed)
   if (.not. allocated(error)) call scene%shape_at(self%cells%surface, self%surface%shape, error, &
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
   call new_gradient(self%gradient, self%cells, blocks, self%inside, facet, self%surface%shape, &
      & self%surface%essential, self%surface%plates%follows)
   call self%gradient%set_essential(self%cells, self%surface%essential, self%surface%value)
   call share_bulk(self%mixture, self%cells, nc, self%local_bulk, self%bulk, softness)
   call new_pressure(self%pressure, self%cells, softness, scene%cloud%points, curved(self), error)
   if (allocated(error)) return
   call new_multiplier(self%multiplier, self%cells, self%bulk, shear, blocks, self%gradient%member)
   self%n = nd*(blocks + self%multiplier%extra)
   self%m = self%n
   if (self%cells%smoothed) call new_recovery(self%recovery, scene, self%cells, error)
   if (allocated(error)) return
   if (scene%galerkin%transformation) call hold_points(self, error)
   if (allocated(error)) return
   self%energetic = self%multiplier%extra == 0 .and. .not. allocated(self%held)
   covering = csr_type([0_i8], [integer ::])
   if (allocated(self%held)) covering = self%held%points%shape%neighbour
   call new_tangent(self%matrix, blocks, self%cells, self%gradient, self%multiplier, self%surface, &
      & self%inside, covering, shear, scene%galerkin%direct_limit, error)
   if (allocated(error)) return
   self%inexact = .not. self%matrix%formed
   if (self%inexact) call self%gradient%share()
   call set_constants(self, shear)
end subroutine new_galerkin

!> Penalty, stabilisation, tendons, and forces of what is prescribed
subroutine set_constants(self, shear)
   !> Problem with conditions and the places of its matrix
   type(galerkin_problem), intent(inout) :: self
   !> Shear modulus at each integration point, shape (np) [stress]
   real(wp), intent(in) :: shear(:)

   if (allocated(self%constant)) deallocate (self%constant, self%force)
   allocate (self%constant(size(self%matrix%value, kind=i8)), source=0.0_wp)
   call self%surface%add_penalty(self%matrix%symmetric_matrix, self%constant)
   allocate (self%force(self%n, self%scene%programme%count()), source=0.0_wp)
   call self%surface%add_forces(self%force)
   call self%surface%plates%add_tendons(self%scene, self%cells, self%surface%penalty, &
      & self%matrix%symmetric_matrix, self%constant, self%force)
   if (self%cells%smoothed) call self%matrix%stabilise(self%constant, self%cells, self%inside, &
      & shear)
   if (allocated(self%matrix%skew)) deallocate (self%matrix%skew)
   ! minimal residuals need a symmetric matrix
   if (self%matrix%formed .and. has_free_rim(self%scene)) &
      & allocate (self%matrix%skew, source=0.0_wp*self%constant)
end subroutine set_constants

!> Take other loads and material parameters from the scene
subroutine renew(self, materials, error)
   !> Problem
   class(galerkin_problem), intent(inout) :: self
   !> Material parameters have changed as well
   logical, intent(in) :: materials
   !> Error handling: what depends on materials cannot be made again
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: shear(:), softness(:)
   integer :: ip, nc

   associate (scene => self%scene)
      if (materials) then
         do ip = 1, size(scene%tissue)
            if (self%multiplier%extra > 0 .or. scene%tissue(ip)%material%incompressible()) then
               call fatal_error(error, err_input, 'where K = inf makes pressures unknowns, ' &
                  & //'materials cannot be changed in an open scene: open another one')
               return
            end if
         end do
         if (.not. self%matrix%formed) call fatal_error(error, err_input, 'above ' &
            & //'galerkin.direct_limit materials cannot be changed in an open scene: open ' &
            & //'another one')
         if (allocated(error)) return
      end if
      nc = size(scene%cloud%points, 2)
      call new_boundary(self%boundary, scene%cloud, scene%condition, scene%programme%count(), error)
      if (allocated(error)) return
      shear = [(self%mixture%shear_modulus(nc + ip, identity), ip=1, size(self%cells%weight))]
      call set_conditions(self%surface, scene, self%cells, shear, error)
      if (allocated(error)) return
      call self%gradient%set_essential(self%cells, self%surface%essential, self%surface%value)
      if (materials) then
         call share_bulk(self%mixture, self%cells, nc, self%local_bulk, self%bulk, softness)
         call new_pressure(self%pressure, self%cells, softness, scene%cloud%points, curved(self), &
            & error)
         if (allocated(error)) return
         call new_multiplier(self%multiplier, self%cells, self%bulk, shear, &
            & size(scene%cloud%source, 2) + self%surface%plates%count, self%gradient%member)
      end if
      if (allocated(self%held)) call hold_points(self, error)
      if (allocated(error)) return
   end associate
   call set_constants(self, shear)
   if (allocated(self%base)) deallocate (self%base)
   if (allocated(self%origin)) deallocate (self%origin)
end subroutine renew

!> Set what varies over the points and has no place in a deck, at full load of the ramp
subroutine set_point_loads(self, body_force, displacement, stress)
   !> Problem
   class(galerkin_problem), intent(inout) :: self
   !> Body force per undeformed volume, shape (3, n) [force/length^3]
   real(wp), intent(in) :: body_force(:, :)
   !> Displacement of the essential components, shape (3, n) [length]
   real(wp), intent(in) :: displacement(:, :)
   !> Stress P(i, A) whose traction the other components carry, shape (3, 3, n) [stress]
   real(wp), intent(in) :: stress(:, :, :)
   integer :: ms, nd, np

   nd = self%scene%cloud%nd
   np = size(self%cells%weight)
   self%scene%body_force = body_force
   call self%surface%set_varying(self%cells, displacement(:, np + 1:), stress(:, :, np + 1:))
   call self%gradient%set_essential(self%cells, self%surface%essential, self%surface%value)
   self%force = 0.0_wp
   call self%surface%add_forces(self%force)
   call add_body_force(self%inside, self%cells%weight, body_force(:nd, :np), self%force(:, ramp))
   if (.not. allocated(self%held)) return
   ms = np + size(self%cells%set)
   self%held%points%value = 0.0_wp
   self%held%points%value(ramp, :, :) = displacement(:nd, ms + 1:)
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
   call self%matrix%forget()
end subroutine start_step

!> Residual (4.31): internal less external forces
subroutine evaluate(self, x, load, r, seen)
   !> Problem
   class(galerkin_problem), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   call assemble(self, x, load, load, .false., r, seen)
end subroutine evaluate

!> Residual and tangent (4.32)
subroutine linearise(self, x, load, r, seen)
   !> Problem
   class(galerkin_problem), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   call assemble(self, x, load, load, .true., r, seen)
   self%leaps = .false.
end subroutine linearise

!> Residual and tangent with essential values of the last converged state: they jump at the start of
!> a load step, and the gradients into which they are lifted might not even keep J > 0. The jump
!> acts linearly.
subroutine predict(self, x, done, load, residuals, r, seen)
   !> Problem
   class(galerkin_problem), target, intent(inout) :: self
   !> Unknowns of the last converged state, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Its load [-]
   real(wp), intent(in) :: done
   !> Load [-]
   real(wp), intent(in) :: load
   !> The tangent stays what it was
   logical, intent(in) :: residuals
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   ! what is carried to a place is known only on the way to it: a tangent that has it is not kept
   self%leaps = residuals .and. self%matrix%formed
   call assemble(self, x, done, load, .not. self%leaps, r, seen)
end subroutine predict

!> Sum over the groups
subroutine assemble(self, x, held, load, tangent, r, seen)
   !> Problem
   type(galerkin_problem), target, intent(inout) :: self
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
   type(evaluation_type), intent(out) :: seen
   type(field_state) :: at
   real(wp), allocatable :: part(:, :), force(:, :), factor(:), jump(:)
   integer :: g

   call new_state(self, at)
   at%factor = self%scene%factors(held)
   factor = self%scene%factors(load)
   jump = factor - at%factor
   if (.not. any(abs(jump) > 0.0_wp)) jump = [real(wp) ::]
   r = 0.0_wp
   call self%matrix%constant_product(self%constant, x(:self%matrix%n), r(:self%matrix%n))
   r = r - matmul(self%force, factor)
   if (tangent) self%matrix%value = self%constant
   if (tangent .and. allocated(self%matrix%skew)) self%matrix%skew = 0.0_wp
   if (tangent .and. allocated(self%held)) call self%held%resist(self%matrix)
   call self%matrix%groups%attach(self%cells, self%gradient, self%pressure, self%multiplier)
   if (tangent) call self%matrix%carry(x)
   ! parts are added in the order of the groups, so that sums do not depend on the threads
   !$omp parallel do default(none) schedule(static, 1) ordered private(g, part, force) &
   !$omp shared(self, x, jump, load, tangent, r, at)
   do g = 1, size(self%cells%first) - 1
      associate (member => self%gradient%member%index(self%gradient%member%offset(g) + 1: &
         & self%gradient%member%offset(g + 1)))
         call deform_group(self, g, x, at)
         call group_part(self, g, at, jump, load, tangent, force, part)
         !$omp ordered
         call add_forces(member, force, r)
         if (tangent .and. self%matrix%formed) call self%matrix%add(self%matrix%value, member, part)
         !$omp end ordered
      end associate
   end do
   !$omp end parallel do
   call add_pressure(self%surface, self%cells, factor, x, tangent, self%matrix, r)
   if (tangent .and. allocated(self%surface%pressure)) &
      & call self%matrix%keep_followers(self%constant)
   if (allocated(self%held)) call self%held%constrain(x, factor, r)
   seen%worst = minloc(at%j, dim=1)
   seen%min_j = at%j(seen%worst)
   seen%max_j = maxval(at%j)
   ! comparisons that a NaN fails
   seen%valid = all(at%j > 0.0_wp) .and. all(abs(r) <= huge(1.0_wp))
   seen%worst = self%nearest(seen%worst)
   if (tangent .or. size(jump) > 0) call move_alloc(at%f, self%origin)
end subroutine assemble

!> Forces and stiffness of a group of points
subroutine group_part(self, g, at, change, load, tangent, force, part)
   !> Problem; a tangent that is not formed keeps moduli and cofactors of the group
   class(galerkin_problem), intent(inout) :: self
   !> Group
   integer, intent(in) :: g
   !> State with the deformation of the group
   type(field_state), intent(in) :: at
   !> Change of the load factors of the essential values in the gradients up to the load, shape
   !> (factors); without any there is none [-]
   real(wp), intent(in) :: change(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Stiffness wanted
   logical, intent(in) :: tangent
   !> Forces, shape (nd, members) [force]
   real(wp), allocatable, intent(inout) :: force(:, :)
   !> Upper triangle of the stiffness, shape (nd*members, nd*members) [force/length]
   real(wp), allocatable, intent(inout) :: part(:, :)
   real(wp), allocatable :: c4(:, :, :, :, :), volume(:, :)
   real(wp) :: h(self%gradient%nd, self%gradient%nd), p(3, 3), cofactor(3, 3), own
   real(wp) :: linear(size(at%pressure, 1)), jump(size(at%pressure, 1))
   integer :: nc, nd, n, q, o, i, k, members, b
   logical :: formed, jumps, stacked

   formed = tangent .and. self%matrix%formed
   ! what the volume of the group changes by is wanted as rows
   jumps = size(change) > 0
   stacked = formed .or. jumps
   nd = self%gradient%nd
   nc = size(self%scene%cloud%points, 2)
   o = self%cells%first(g)
   n = self%cells%first(g + 1) - o
   b = self%pressure%count(g)
   members = int(self%gradient%member%offset(g + 1) - self%gradient%member%offset(g))
   if (allocated(force)) deallocate (force)
   allocate (force(nd, members), source=0.0_wp)
   if (allocated(part)) then
      if (size(part, 1) /= nd*members) deallocate (part)
   end if
   if (formed .and. .not. allocated(part)) allocate (part(nd*members, nd*members))
   ! no stress exists; the caller rejects the state
   if (.not. all(at%j(o + 1:o + n) > 0.0_wp)) then
      if (formed) part = 0.0_wp
      return
   end if
   jump = 0.0_wp
   if (tangent .or. jumps) then
      linear = at%pressure(:, g)
      if (self%matrix%pressures%carrying .and. .not. self%multiplier%free(g)) then
         linear = self%matrix%pressures%carried(:, g)
      else if (allocated(self%base) .and. .not. self%multiplier%free(g)) then
         if (self%leaps) then
            linear = self%pressure%along_step(g, self%cells, self%bulk(g), self%base, self%base)
         else
            linear = self%pressure%along_step(g, self%cells, self%bulk(g), at%f, self%base)
         end if
      end if
      allocate (c4(3, 3, 3, 3, n))
      if (stacked) allocate (volume(nd*members, b), source=0.0_wp)
   end if
   do q = 1, n
      associate (f => at%f(:, :, o + q), j => at%j(o + q))
         cofactor = 0.5_wp*cross(f, f)
         own = self%local_bulk(nc + o + q)*(j - 1.0_wp)
         if (tangent .or. jumps) then
            call self%mixture%tangent(nc + o + q, f, load, p, c4(:, :, :, :, q), volumetric=.false.)
            call add_cross_form(own + self%pressure%value(g, o + q, linear), f, c4(:, :, :, :, q))
            do k = 1, 3
               do i = 1, 3
                  c4(:, :, i, k, q) = self%cells%weight(o + q)*(c4(:, :, i, k, q) &
                     & + self%local_bulk(nc + o + q)*(cofactor*cofactor(i, k)))
               end do
            end do
         else
            call self%mixture%stress(nc + o + q, f, load, p, volumetric=.false.)
         end if
         p = p + (own + self%pressure%value(g, o + q, at%pressure(:, g)))*cofactor
      end associate
      if (jumps) then
         h = self%gradient%lifted(o + q, change)
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
      if (tangent .and. .not. formed) self%matrix%groups%cofactor(:, :, o + q) = cofactor
      call self%gradient%add_force(o + q, p, force)
      if (stacked) call self%gradient%add_work(o + q, cofactor, self%pressure%basis(:b, o + q), &
         & volume)
   end do
   if (self%multiplier%free(g)) then
      call self%multiplier%set_rows(g, at%volume(:b, g) + jump(:b), force)
   else if (stacked) then
      force = force + self%bulk(g)*reshape(matmul(volume, jump(:b)), shape(force))
   end if
   if (.not. tangent) return
   if (.not. formed) then
      call self%matrix%keep_group(g, self%bulk(g), c4, at%pressure(:, g), jump)
      return
   end if
   if (self%multiplier%free(g)) then
      part = 0.0_wp
      call self%multiplier%set_stiffness(g, volume, part)
   else
      call dsyrk('u', 'n', nd*members, b, self%bulk(g), volume, nd*members, 0.0_wp, part, &
         & nd*members)
   end if
   call self%gradient%add_stiffness(o, c4, part)
end subroutine group_part

!> Pressures on the curve through the last converged states
subroutine extrapolate(self, x, load, share)
   !> Problem, linearised at the last converged state by predict
   class(galerkin_problem), target, intent(inout) :: self
   !> Unknowns of the last states, the latest first, shape (n, states)
   real(wp), contiguous, intent(in) :: x(:, :)
   !> Their loads at equal distances, shape (states) [-]
   real(wp), intent(in) :: load(:)
   !> Way beyond the last state, of that from the one before to it [-]
   real(wp), intent(in) :: share
   real(wp), allocatable :: pressure(:, :, :)
   integer :: k

   if (self%matrix%formed) return
   allocate (pressure(size(self%pressure%total, 1), size(self%pressure%total, 2), size(load)))
   do k = 1, size(load)
      pressure(:, :, k) = pressures_at(self, x(:, k), load(k))
   end do
   call self%matrix%pressures%extrapolate(pressure, share)
end subroutine extrapolate

!> Size of residuals: that of the equations of displacements and pressures where they are solved
subroutine measure(self, r, size)
   !> Problem, linearised
   class(galerkin_problem), target, intent(inout) :: self
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(in) :: r(:)
   !> Their size
   real(wp), intent(out) :: size

   if (self%matrix%formed) then
      size = norm2(r)
   else
      call self%matrix%measure(-r, size)
   end if
end subroutine measure

!> The volume of the next tangent is linear in the step from here
subroutine start_iteration(self)
   !> Problem, linearised
   class(galerkin_problem), intent(inout) :: self

   self%base = self%origin
end subroutine start_iteration

!> Tangent
function operator(self) result(op)
   !> Problem, linearised
   class(galerkin_problem), target, intent(in) :: self
   class(row_operator), pointer :: op

   op => self%matrix
   if (allocated(self%held)) op => self%held%whole
end function operator

!> Newton's step by the tangent itself
subroutine square_step(self, shift, r, dx, found, report, error)
   !> Problem, linearised
   class(galerkin_problem), target, intent(inout) :: self
   !> Damping in units of the diagonal, >= 0 [-]
   real(wp), intent(in) :: shift
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(in) :: r(:)
   !> Step, shape (n) [length]
   real(wp), contiguous, intent(inout) :: dx(:)
   !> Always
   logical, intent(out) :: found
   !> What was used and how good it is
   type(square_report), intent(out) :: report
   !> Error handling: singular matrix, no memory, no convergence
   type(error_type), allocatable, intent(out) :: error

   found = .true.
   if (allocated(self%held)) then
      call self%held%whole%solve_square(shift, -r, dx, report, error)
   else
      self%matrix%wanted = self%scene%solver%tolerance
      call self%matrix%solve_step(shift, -r, dx, report, error)
   end if
end subroutine square_step

!> What may keep the iteration from converging: a skew part that minimal residuals cannot have
function caveat(self) result(text)
   !> Problem
   class(galerkin_problem), intent(in) :: self
   character(len=:), allocatable :: text

   text = ''
   if (self%matrix%formed) return
   if (has_free_rim(self%scene)) text = 'the rim of a surface with boundary.pressure moves ' &
      & //'freely, which makes the tangent unsymmetric, and above galerkin.direct_limit its skew ' &
      & //'part is left out: take galerkin.direct_limit = '//to_text(self%n)//' where memory ' &
      & //'allows, hold the rim, or load it by less'
end function caveat

end module rk_galerkin
