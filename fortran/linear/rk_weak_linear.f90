!> Galerkin form of linear boundary value problems: the operators of rk_linear, integrated with
!> Gauss points in the cells between the source points of a box.
!>
!> Essential values are lifted into the gradients and held by a penalty, or exactly at source points
!> (rk_held), as in the nonlinear form.
!> Of elasticity, Lame's lambda acts on the change of volume that is projected in each group of
!> cells, so that nearly incompressible bodies do not lock. Source, traction and prescribed values
!> follow from the known solution, or the deck gives them.
module rk_weak_linear
   use rk_blas, only : dsyrk
   use rk_cells, only : cells_type
   use rk_coefficients, only : coefficient_at, coefficients_type, moduli, new_coefficients
   use rk_conditions, only : conditions_at
   use rk_csr, only : joined
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_gauss_cells, only : gauss_cells
   use rk_gradient, only : gradient_type, new_gradient
   use rk_held, only : held_type, new_held
   use rk_linear, only : find_boundary, small_strain
   use rk_operator, only : row_operator
   use rk_precision, only : wp
   use rk_pressure, only : new_pressure, pressure_type
   use rk_problem, only : evaluation_type, stage_type
   use rk_scene, only : scene_type
   use rk_shape, only : shape_type
   use rk_solutions, only : exact_field
   use rk_states, only : field_state, point_state
   use rk_surface_sets, only : find_surface_sets
   use rk_symmetric, only : new_symmetric, symmetric_matrix
   use rk_tensor, only : identity
   use rk_weak_conditions, only : add_body_force, surface_type
   use rk_weak_loads, only : add_pins, body_force
   implicit none
   private

   public :: weak_linear_problem, new_weak_linear
   ! parts of the loads, for motions
   public :: add_given, lift_at, surface_at

   !> Linear problem of a scene
   type, extends(discretisation_type) :: weak_linear_problem
      !> Coefficients at the integration points, and at the collocation points
      type(coefficients_type) :: coefficient, outside
      !> Largest of Lame's lambda, 0 of a scalar problem [stress]
      real(wp) :: lambda = 0.0_wp
      !> Integration points, gradients and shape functions there
      type(cells_type) :: cells
      type(gradient_type) :: gradient
      type(shape_type) :: inside
      !> Polynomials of the change of volume
      type(pressure_type) :: pressure
      !> Surface
      type(surface_type) :: surface
      !> Stiffness, and what stands against it at full load, shape (n, 1)
      type(symmetric_matrix) :: matrix
      real(wp), allocatable :: force(:, :)
      !> Entries of the penalty in the places of the stiffness, of which they are a part
      real(wp), allocatable :: penalty(:)
      !> What is held at source points; not allocated where the penalty holds
      type(held_type), allocatable :: held
   contains
      procedure :: assemble
      procedure :: operator
      procedure :: state
      procedure :: at_place
      procedure :: set_force
   end type weak_linear_problem

contains

!> Set up the problem of a scene
subroutine new_weak_linear(self, scene, error)
   !> Problem
   type(weak_linear_problem), intent(inout) :: self
   !> Scene with an equation
   type(scene_type), target, intent(in) :: scene
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   type(shape_type) :: facet
   real(wp), allocatable :: stiffness(:)
   integer :: nd, ns, q

   self%scene => scene
   self%linear = .true.
   self%square = .true.
   nd = scene%cloud%nd
   ns = size(scene%cloud%source, 2)
   if (allocated(scene%motion) .and. scene%galerkin%transformation) then
      call fatal_error(error, err_input, 'galerkin.essential = "transformation" is for problems ' &
         & //'at rest: motions take galerkin.essential = "penalty"')
      return
   end if
   self%fields = merge(1, nd, scene%equation%kind == 'poisson')
   self%n = self%fields*ns
   self%m = self%n
   call find_boundary(self, error)
   if (allocated(error)) return
   allocate (self%shape)
   call scene%shape_at(scene%cloud%points, self%shape, error)
   if (allocated(error)) return
   call gauss_cells(self%cells, scene%cloud, scene%galerkin%gauss, &
      & min(scene%approximation%order - 1, 1), error)
   if (.not. allocated(error)) call find_surface_sets(self%cells, scene%cloud, error)
   if (.not. allocated(error)) call scene%shape_at(self%cells%point, self%inside, error)
   if (.not. allocated(error)) call scene%shape_at(self%cells%surface, self%surface%shape, error)
   if (.not. allocated(error)) call scene%shape_at(self%cells%facet, facet, error, plain=.true.)
   if (.not. allocated(error)) call new_coefficients(self%coefficient, scene, self%cells%point, &
      & .false., error)
   if (.not. allocated(error)) call new_coefficients(self%outside, scene, scene%cloud%points, &
      & .false., error)
   if (allocated(error)) return
   self%lambda = maxval(self%coefficient%pair(1, :))
   stiffness = [(maxval(modulus(self, q)), q=1, size(self%cells%weight))]
   allocate (self%surface%essential(self%fields, size(self%cells%set)))
   call surface_at(self, 0.0_wp, self%surface%essential, self%surface%value, &
      & self%surface%traction, error)
   if (allocated(error)) return
   call self%surface%set_penalty(scene, self%cells, stiffness)
   call set_gradient(self, ns, facet)
   call new_pressure(self%pressure, self%cells, softness(self), scene%cloud%points, .false., error)
   if (allocated(error)) return
   if (scene%galerkin%transformation) then
      call hold_points(self, stiffness, error)
      if (allocated(error)) return
   end if
   if (allocated(self%held)) then
      call new_symmetric(self%matrix, self%fields, ns, joined(self%gradient%member, &
         & self%held%points%shape%neighbour))
      self%matrix%keeps = .true.
      call self%held%resist(self%matrix)
   else
      call new_symmetric(self%matrix, self%fields, ns, self%gradient%member)
   end if
   allocate (self%force(self%n, 1), source=0.0_wp)
   call self%surface%add_penalty(self%matrix, self%matrix%value)
   call self%surface%add_forces(self%force)
   call add_body_force(self%inside, self%cells%weight, body_force(scene, self%cells%point, &
      & self%coefficient%pair, self%fields, 0.0_wp, error), self%force(:, 1))
   if (allocated(error)) return
   call add_pins(scene, self%shape, scene%galerkin%penalty*maxval(stiffness), self%matrix, &
      & self%force(:, 1))
   if (allocated(scene%motion)) self%penalty = self%matrix%value
   call add_groups(self)
   call add_given(self, self%gradient, self%force(:, 1))
end subroutine new_weak_linear

!> Hold source points, with the values of the known solution or of the deck
subroutine hold_points(self, stiffness, error)
   !> Problem with its surface
   type(weak_linear_problem), intent(inout) :: self
   !> Modulus at each integration point, shape (np)
   real(wp), intent(in) :: stiffness(:)
   !> Error handling: places that cannot be held together
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: value(:, :, :)
   logical, allocatable :: by(:, :)
   real(wp) :: u(self%fields, self%shape%nq)
   integer :: e

   call new_held(self%held, self%scene, self%cells, self%surface, error)
   if (allocated(error) .or. .not. allocated(self%held)) return
   call self%held%deck_values(self%scene, by, value, error)
   if (allocated(error)) return
   by = by(:self%fields, :)
   value = value(:, :self%fields, :)
   associate (at => self%held%at, equation => self%scene%equation, near => self%held%nearest)
      do e = 1, size(at%side)
         if (equation%is_own()) exit
         call exact_field(equation, at%x(:, at%place(e)), u)
         by(:, e) = any(at%in_set(e, equation%essential))
         value(1, :, e) = u(:, 1)
      end do
      call self%held%set(by, value, self%scene, stiffness(near), self%coefficient%pair(1, near), &
         & self%n, error)
   end associate
end subroutine hold_points

!> Moduli c(i, A, k, B) without lambda at an integration point, shape (nd, nd, nd, nd); of a scalar
!> problem the first component is the field
pure function modulus(self, q) result(c)
   !> Problem
   class(weak_linear_problem), intent(in) :: self
   !> Integration point
   integer, intent(in) :: q
   real(wp) :: c(self%shape%nd, self%shape%nd, self%shape%nd, self%shape%nd)

   c = 0.0_wp
   c(:self%fields, :, :self%fields, :) = moduli(self%scene%equation, self%shape%nd, &
      & [0.0_wp, self%coefficient%pair(2, q)])
end function modulus

!> Largest lambda over that of each point: where it is none, as much as counts for none [-]
pure function softness(self) result(ratio)
   !> Problem
   class(weak_linear_problem), intent(in) :: self
   real(wp), parameter :: least = 1.0e-6_wp
   real(wp) :: ratio(size(self%cells%weight))

   ratio = 1.0_wp
   if (self%lambda > 0.0_wp) ratio = self%lambda/max(self%coefficient%pair(1, :), &
      & least*self%lambda)
end function softness

!> Prescribed values and tractions at the surface points, of the known solution or of the deck
subroutine surface_at(self, time, essential, value, traction, error)
   !> Problem with its cells
   class(weak_linear_problem), intent(in) :: self
   !> Time, of no meaning where nothing moves
   real(wp), intent(in) :: time
   !> Prescribed components, shape (fields, ms)
   logical, intent(out) :: essential(:, :)
   !> Values and tractions, shape (1, fields, ms) [length], [force/area]
   real(wp), allocatable, intent(out) :: value(:, :, :), traction(:, :, :)
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: u(self%fields, self%shape%nq), p(self%shape%nd, self%shape%nd)
   real(wp) :: g(1, 3), h(1, 3)
   logical :: fixed(3)
   integer :: s

   allocate (value(1, self%fields, size(self%cells%set)))
   allocate (traction(1, self%fields, size(self%cells%set)))
   associate (equation => self%scene%equation)
      do s = 1, size(self%cells%set)
         if (equation%is_own()) then
            call conditions_at(self%scene%cloud, self%scene%condition, &
               & self%cells%in_set(s, self%scene%condition%set), self%cells%surface(:, s), fixed, &
               & g, h, error, time)
            if (allocated(error)) return
            essential(:, s) = fixed(:self%fields)
            value(:, :, s) = g(:, :self%fields)
            traction(:, :, s) = h(:, :self%fields)
            cycle
         end if
         call exact_field(equation, self%cells%surface(:, s), u)
         p = plain_stress(self, u)
         essential(:, s) = any(self%cells%in_set(s, equation%essential))
         value(1, :, s) = u(:, 1)
         traction(1, :, s) = matmul(p(:self%fields, :), self%cells%outward(:, s)) &
            & /norm2(self%cells%outward(:, s))
      end do
   end associate
end subroutine surface_at

!> Stress of a displacement gradient, without projection, where coefficients are constant
pure function plain_stress(self, u) result(p)
   !> Problem
   class(weak_linear_problem), intent(in) :: self
   !> Fields with derivatives, shape (fields, nq)
   real(wp), intent(in) :: u(:, :)
   !> Stress, index (i, A)
   real(wp) :: p(self%shape%nd, self%shape%nd)
   real(wp) :: h(size(p, 1), size(p, 1))
   integer :: a

   h = 0.0_wp
   h(:self%fields, :) = u(:, 2:1 + size(h, 2))
   p = stress(modulus(self, 1), h)
   do a = 1, size(p, 1)
      p(a, a) = p(a, a) + self%lambda*sum([(h(a, a), a=1, size(h, 1))])
   end do
end function plain_stress

!> Stress of a displacement gradient
pure function stress(c, h) result(p)
   !> Moduli c(i, A, k, B)
   real(wp), intent(in) :: c(:, :, :, :)
   !> Gradient, index (i, A) [-]
   real(wp), intent(in) :: h(:, :)
   real(wp) :: p(size(h, 1), size(h, 1))
   integer :: b, k

   p = 0.0_wp
   do b = 1, size(h, 1)
      do k = 1, size(h, 1)
         p = p + c(:, :, k, b)*h(k, b)
      end do
   end do
end function stress

!> Lifted gradients; components that a scalar problem has not are none
subroutine set_gradient(self, ns, facet)
   !> Problem with its surface
   type(weak_linear_problem), intent(inout) :: self
   !> Source points
   integer, intent(in) :: ns
   !> Shape functions at the facets
   type(shape_type), intent(in) :: facet
   logical :: essential(self%shape%nd, size(self%cells%set))
   real(wp) :: value(1, self%shape%nd, size(self%cells%set))

   essential = .false.
   value = 0.0_wp
   essential(:self%fields, :) = self%surface%essential
   value(:, :self%fields, :) = self%surface%value
   call new_gradient(self%gradient, self%cells, ns, self%inside, facet, self%surface%shape, &
      & essential)
   call self%gradient%set_essential(self%cells, essential, value)
end subroutine set_gradient

!> Add the stiffness of all groups
subroutine add_groups(self)
   !> Problem
   type(weak_linear_problem), intent(inout) :: self
   real(wp), allocatable :: part(:, :), volume(:, :), c4(:, :, :, :, :)
   integer :: b, g, members, n, nd, o, q

   nd = self%shape%nd
   do g = 1, size(self%cells%first) - 1
      o = self%cells%first(g)
      n = self%cells%first(g + 1) - o
      b = self%pressure%count(g)
      associate (member => self%gradient%member%index(self%gradient%member%offset(g) + 1: &
         & self%gradient%member%offset(g + 1)))
         members = size(member)
         allocate (part(nd*members, nd*members), volume(nd*members, b), source=0.0_wp)
         allocate (c4(3, 3, 3, 3, n), source=0.0_wp)
         do q = 1, n
            associate (w => self%cells%weight(o + q))
               c4(:nd, :nd, :nd, :nd, q) = w*modulus(self, o + q)
               if (self%fields > 1) call self%gradient%add_work(o + q, w*identity, &
                  & self%pressure%basis(:b, o + q), volume)
            end associate
         end do
         call dsyrk('u', 'n', nd*members, b, self%lambda, volume, nd*members, 0.0_wp, part, &
            & nd*members)
         call self%gradient%add_stiffness(o, c4, part)
         if (self%fields < nd) part = part(1::nd, 1::nd)
         call self%matrix%add(self%matrix%value, member, part)
      end associate
      deallocate (part, volume, c4)
   end do
end subroutine add_groups

!> Add the forces of the essential values that are lifted into the gradients
subroutine add_given(self, lift, total)
   !> Problem
   class(weak_linear_problem), intent(in) :: self
   !> Gradients, of which what is given counts
   type(gradient_type), intent(in) :: lift
   !> Forces, to which these are added, shape (n)
   real(wp), intent(inout) :: total(:)
   real(wp), allocatable :: volume(:, :), force(:, :)
   real(wp) :: given(size(self%pressure%total, 1)), p(3, 3)
   integer :: b, g, k, members, n, nd, o, q

   nd = self%shape%nd
   do g = 1, size(self%cells%first) - 1
      o = self%cells%first(g)
      n = self%cells%first(g + 1) - o
      if (.not. any(abs(lift%given(:, :, o + 1:o + n, 1)) > 0.0_wp)) cycle
      b = self%pressure%count(g)
      associate (member => self%gradient%member%index(self%gradient%member%offset(g) + 1: &
         & self%gradient%member%offset(g + 1)))
         members = size(member)
         allocate (volume(nd*members, b), force(nd, members), source=0.0_wp)
         given = 0.0_wp
         do q = 1, n
            associate (w => self%cells%weight(o + q), h => lift%given(:, :, o + q, 1))
               p = 0.0_wp
               p(:nd, :nd) = w*stress(modulus(self, o + q), h)
               call self%gradient%add_force(o + q, p, force)
               if (self%fields == 1) cycle
               call self%gradient%add_work(o + q, w*identity, self%pressure%basis(:b, o + q), &
                  & volume)
               given(:b) = given(:b) + w*sum([(h(k, k), k=1, nd)])*self%pressure%basis(:b, o + q)
            end associate
         end do
         force = force + self%lambda*reshape(matmul(volume, given(:b)), shape(force))
         do k = 1, members
            associate (own => total(self%fields*(member(k) - 1) + 1:self%fields*member(k)))
               own = own - force(:self%fields, k)
            end associate
         end do
      end associate
      deallocate (volume, force)
   end do
end subroutine add_given

!> What is lifted into the gradients at a time
subroutine lift_at(self, time, lift, error)
   !> Problem
   class(weak_linear_problem), intent(in) :: self
   !> Time
   real(wp), intent(in) :: time
   !> Gradients of which only what is given is there
   type(gradient_type), intent(out) :: lift
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(out) :: error
   logical :: fixed(self%fields, size(self%cells%set))
   logical :: essential(self%shape%nd, size(self%cells%set))
   real(wp), allocatable :: value(:, :, :), traction(:, :, :), whole(:, :, :)

   call surface_at(self, time, fixed, value, traction, error)
   if (allocated(error)) return
   essential = .false.
   essential(:self%fields, :) = fixed
   allocate (whole(1, self%shape%nd, size(self%cells%set)), source=0.0_wp)
   whole(:, :self%fields, :) = value
   lift%nd = self%shape%nd
   lift%start = self%gradient%start
   call lift%set_essential(self%cells, essential, whole)
end subroutine lift_at

!> Residuals: internal less external forces
subroutine assemble(self, x, stage, r, seen)
   !> Problem
   class(weak_linear_problem), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load
   type(stage_type), intent(in) :: stage
   !> Residuals, shape (n)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   call self%matrix%apply(x, r)
   r = r - stage%load*self%force(:, 1)
   if (allocated(self%held)) then
      call self%held%constrain(x, [stage%load], r)
      ! the problem may have been moved since it was made
      call self%held%bind(self%matrix)
   end if
   seen%valid = all(abs(r) <= huge(1.0_wp))
end subroutine assemble

!> Stiffness
function operator(self) result(op)
   !> Problem
   class(weak_linear_problem), target, intent(in) :: self
   class(row_operator), pointer :: op

   op => self%matrix
   if (allocated(self%held)) op => self%held%whole
end function operator

!> State of the body: gradients and stresses at the integration points, and the projected change of
!> volume times lambda
subroutine state(self, x, load, at, tissue)
   !> Problem
   class(weak_linear_problem), intent(in) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> State
   type(field_state), intent(out) :: at
   !> Of no meaning: a linear problem has no tissues
   integer, intent(in), optional :: tissue
   type(gradient_type) :: lift
   type(error_type), allocatable :: error
   real(wp), allocatable :: local(:, :), h(:, :, :), f(:)
   integer :: b, g, k, n, nd, o, q

   nd = self%shape%nd
   at%x = x
   at%load = load
   at%factor = [load]
   if (present(tissue)) at%tissue = tissue
   ! of a motion the load is the time; its expressions had values then
   if (allocated(self%scene%motion)) then
      at%factor = [0.0_wp]
      call lift_at(self, load, lift, error)
   end if
   allocate (at%p(3, 3, size(self%cells%weight)), source=0.0_wp)
   allocate (at%pressure, mold=self%pressure%total)
   at%pressure = 0.0_wp
   do g = 1, size(self%cells%first) - 1
      o = self%cells%first(g)
      n = self%cells%first(g + 1) - o
      b = self%pressure%count(g)
      associate (member => self%gradient%member%index(self%gradient%member%offset(g) + 1: &
         & self%gradient%member%offset(g + 1)), value => at%pressure(:b, g))
         allocate (local(nd, size(member)), h(nd, nd, n), source=0.0_wp)
         do k = 1, size(member)
            local(:self%fields, k) = x(self%fields*(member(k) - 1) + 1:self%fields*member(k))
         end do
         do q = 1, n
            call self%gradient%at(o + q, local, at%factor, h(:, :, q))
            if (allocated(lift%given)) h(:, :, q) = h(:, :, q) + lift%given(:, :, o + q, 1)
            value = value + self%lambda*self%cells%weight(o + q) &
               & *sum([(h(k, k, q), k=1, nd)])*self%pressure%basis(:b, o + q)
         end do
         do q = 1, n
            at%p(:nd, :nd, o + q) = stress(modulus(self, o + q), h(:, :, q)) &
               & + identity(:nd, :nd)*self%pressure%value(g, o + q, at%pressure(:, g))
         end do
      end associate
      deallocate (local, h)
   end do
   if (.not. allocated(self%held)) return
   allocate (f(self%n))
   call self%matrix%apply(x, f)
   f = f - load*self%force(:, 1)
   associate (rows => self%held%rows)
      call rows%add_transposed(-rows%resistance*rows%times(x), f)
   end associate
   at%held = self%held%reaction(f)
end subroutine state

!> Small strain stress at a place; of a scalar problem the value alone
subroutine at_place(self, state, ip, x, u, local)
   !> Problem
   class(weak_linear_problem), intent(in) :: self
   !> State of the body
   type(field_state), intent(in) :: state
   !> Collocation point nearest to the place
   integer, intent(in) :: ip
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Fields with derivatives, shape (fields, nq)
   real(wp), intent(in) :: u(:, :)
   !> State there
   type(point_state), intent(out) :: local
   type(error_type), allocatable :: error
   real(wp) :: pressure, pair(2)
   integer :: a

   ! what is interpolated is not known between collocation points
   if (self%scene%equation%smoothing > 0.0_wp) then
      pair = self%outside%pair(:, ip)
   else
      call coefficient_at(self%scene%equation, x, pair, error)
   end if
   pair(1) = 0.0_wp
   call small_strain(self%scene%equation, pair, x, u, local)
   if (self%fields == 1) return
   pressure = self%pressure%at(ip, x, state%pressure)
   do a = 1, size(x)
      local%p(a, a) = local%p(a, a) + pressure
   end do
   if (size(x) == 2 .and. .not. self%scene%equation%plane_stress) local%p(3, 3) = pressure
   local%cauchy = local%p
end subroutine at_place

!> Force that the surroundings exert on the body through a set
function set_force(self, set, state, share, about) result(force)
   !> Problem
   class(weak_linear_problem), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> State
   type(field_state), intent(in) :: state
   !> Of no meaning: the work of the surface's own points is exact
   real(wp), intent(in) :: share
   !> Point about which the moment is wanted: linear forms know none [length]
   real(wp), intent(in), optional :: about(3)
   real(wp) :: force(3)
   type(error_type), allocatable :: error
   logical :: essential(self%fields, size(self%cells%set))
   real(wp), allocatable :: value(:, :, :), traction(:, :, :)

   associate (unused => share)
   end associate
   force = 0.0_wp
   if (present(about)) return
   ! of a motion the load is the time; its expressions had values then
   if (allocated(self%scene%motion)) call surface_at(self, state%load, essential, value, traction, &
      & error)
   force = self%surface%force(self%cells, set, state, value, traction)
   if (allocated(self%held)) force = force + self%held%force(set, state%held)
end function set_force

end module rk_weak_linear
