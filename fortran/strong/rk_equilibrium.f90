!> Equilibrium of a hyperelastic body at collocation points, with conditions at boundary points.
!>
!> The strong form (5.27) at the points of (5.40)-(5.51). All collocation points carry the
!> equilibrium rows, boundary points carry boundary rows as well.
!> Equation numbers are the thesis's: residuals (5.71)-(5.73), linearisation (5.66)-(5.70). A form
!> with a pressure among its fields adds what the pressure does.
!>
!> The unknowns may be the amplitudes of modes: then rows and second derivatives are those by them.
module rk_equilibrium
   use rk_basis, only : second_index
   use rk_conditions, only : new_boundary
   use rk_discretisation, only : discretisation_type, deformation
   use rk_error, only : error_type
   use rk_lstsq, only : row_operator
   use rk_matrix, only : matrix_rows
   use rk_mixture, only : new_mixture
   use rk_modes, only : modes_type, new_modes
   use rk_neighbours, only : nearest_points
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type
   use rk_programme, only : combined
   use rk_rows, only : new_rows
   use rk_scene, only : scene_type
   use rk_states, only : field_state
   use rk_strong, only : strong_problem
   use rk_tensor, only : determinant
   use rk_work_balance, only : own_work_mismatch
   implicit none
   private

   public :: equilibrium_problem, new_equilibrium, point_rows, point_curvature, add_curvature

   !> Rows: one block for each collocation point, then one for each boundary point, then single rows
   !> at further places
   type, abstract, extends(strong_problem) :: equilibrium_problem
      !> Boundary point of each collocation point, 0 inside, shape (nc)
      integer, allocatable :: boundary_of(:)
      !> Weight of the equilibrium rows of each collocation point, shape (nc)
      real(wp), allocatable :: domain_weight(:)
      !> Weight of the traction rows of each boundary point beside that of the deck, shape (nb)
      real(wp), allocatable :: traction_weight(:)
      !> Weight of the essential rows of each boundary point, shape (nb)
      real(wp), allocatable :: essential_weight(:)
      !> Modes whose amplitudes are the unknowns, where there are any
      type(modes_type), allocatable, private :: modes
      !> Then the linearised rows times the modes
      type(matrix_rows), private :: projected
   contains
      procedure :: field
      procedure :: evaluate
      procedure :: linearise
      procedure :: operator
      procedure :: hessian
      procedure :: set_curvature
      procedure :: apply_curvature
      procedure :: reduce
      procedure :: compare_works
      !> Residuals and rows of one place
      procedure :: evaluate_place => point_rows
      !> Second derivatives of the residuals at one place
      procedure :: curvature => point_curvature
      !> What a pressure adds to stress and divergence
      procedure :: add_pressure
      !> What it adds to a traction
      procedure :: add_traction_pressure
      !> What it adds to the second derivatives of the equilibrium
      procedure :: add_pressure_curvature
      !> What it adds to those of the tractions
      procedure :: add_traction_curvature
   end type equilibrium_problem

contains

!> Work of the stress in the state's own displacement less that of the forces, relative [-]
subroutine compare_works(self, state, mismatch)
   !> Problem
   class(equilibrium_problem), intent(in) :: self
   !> State
   type(field_state), intent(in) :: state
   !> Mismatch
   real(wp), allocatable, intent(out) :: mismatch

   mismatch = own_work_mismatch(self, state)
end subroutine compare_works

!> Set up shape functions, materials, conditions and rows
subroutine new_equilibrium(self, scene, fields, further, error)
   !> Problem
   class(equilibrium_problem), intent(inout) :: self
   !> Scene
   type(scene_type), target, intent(in) :: scene
   !> Unknown fields, the displacement first
   integer, intent(in) :: fields
   !> Places beside the collocation points with one row each, shape (nd, nv) [length]
   real(wp), intent(in) :: further(:, :)
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer, allocatable :: place(:), range(:, :), rows(:)
   real(wp), allocatable :: position(:, :)
   integer :: nd, nc, nb, nv, b, d

   self%scene => scene
   nd = scene%cloud%nd
   self%fields = fields
   self%curved = .true.
   call new_boundary(self%boundary, scene%cloud, scene%condition, scene%programme%count(), error)
   if (allocated(error)) return
   nc = size(scene%cloud%points, 2)
   nb = size(self%boundary%point)
   nv = size(further, 2)
   position = reshape([scene%cloud%points, further], [nd, nc + nv])
   allocate (self%shape)
   call scene%shape_at(position, self%shape, error)
   if (allocated(error)) return
   call new_mixture(self%mixture, scene, position, &
      & [[(b, b=1, nc)], nearest_points(scene%cloud%points, further)], error)
   if (allocated(error)) return

   place = [[(b, b=1, nc)], self%boundary%point, [(nc + b, b=1, nv)]]
   rows = [[(nd, b=1, nc + nb)], [(1, b=1, nv)]]
   allocate (range(2, nc + nb + nv))
   range(1, :nc) = 2
   range(2, :nc) = self%shape%nq
   range(1, nc + 1:) = 1
   range(2, nc + 1:) = 1 + nd
   call new_rows(self%rows, self%shape, fields, place, rows, range, position, &
      & [(minval(scene%cloud%spacing(d, :)), d=1, nd)])
   self%m = self%rows%m
   self%n = self%rows%n
   self%extent = sqrt(real(nd*self%shape%ns, wp))*maxval(maxval(scene%cloud%source, dim=2) &
      & - minval(scene%cloud%source, dim=2))
   allocate (self%boundary_of(nc), source=0)
   self%boundary_of(self%boundary%point) = [(b, b=1, nb)]
   allocate (self%domain_weight(nc), self%traction_weight(nb), self%essential_weight(nb), &
      & source=1.0_wp)
end subroutine new_equilibrium

!> The same problem in terms of the amplitudes of modes
subroutine reduce(self, modes, problem, error)
   !> Full problem
   class(equilibrium_problem), intent(in) :: self
   !> Orthonormal modes, shape (n, r)
   real(wp), intent(in) :: modes(:, :)
   !> Its copy in modes
   class(discretisation_type), allocatable, intent(out) :: problem
   !> Error handling: none here
   type(error_type), allocatable, intent(out) :: error
   class(equilibrium_problem), allocatable :: copy

   allocate (copy, source=self)
   allocate (copy%modes)
   call new_modes(copy%modes, self%shape, self%fields, modes)
   copy%n = size(modes, 2)
   copy%projected%m = copy%m
   copy%projected%n = copy%n
   allocate (copy%projected%a(copy%m, copy%n))
   call move_alloc(copy, problem)
end subroutine reduce

!> Unknown fields and derivatives at a place from the unknowns
subroutine field(self, ip, x, last, u)
   !> Problem
   class(equilibrium_problem), intent(in) :: self
   !> Place
   integer, intent(in) :: ip
   !> Unknowns: coefficients, or amplitudes of the modes, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Last derivative wanted
   integer, intent(in) :: last
   !> Fields with derivatives, shape (fields, nq); displacement [length], [-], [1/length]
   real(wp), intent(out) :: u(:, :)

   if (allocated(self%modes)) then
      call self%modes%field(ip, x, last, u)
   else
      call self%shape%interpolate(ip, x, 1, last, u)
   end if
end subroutine field

!> Residuals (5.71)-(5.73)
subroutine evaluate(self, x, load, r, seen)
   !> Problem
   class(equilibrium_problem), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   call evaluate_places(self, x, load, .false., r, seen)
end subroutine evaluate

!> Residuals and rows (5.66)-(5.69)
subroutine linearise(self, x, load, r, seen)
   !> Problem
   class(equilibrium_problem), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   call evaluate_places(self, x, load, .true., r, seen)
   if (allocated(self%modes)) call self%modes%project(self%rows, self%projected%a)
end subroutine linearise

!> Residuals and, where wanted, rows of all places
subroutine evaluate_places(self, x, load, tangent, r, seen)
   !> Problem
   class(equilibrium_problem), intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Linearise
   logical, intent(in) :: tangent
   !> Residuals, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen
   real(wp), allocatable :: volume(:)
   integer :: ip

   allocate (volume(self%shape%np))
   !$omp parallel do default(none) schedule(static) private(ip) &
   !$omp shared(self, x, load, tangent, r, volume)
   do ip = 1, self%shape%np
      call self%evaluate_place(ip, x, load, tangent, r, volume(ip))
   end do
   !$omp end parallel do
   seen%worst = minloc(volume, dim=1)
   seen%min_j = volume(seen%worst)
   seen%max_j = maxval(volume)
   ! comparisons that a NaN fails
   seen%valid = all(volume > 0.0_wp) .and. all(abs(r) <= huge(1.0_wp))
end subroutine evaluate_places

!> Rows of one collocation point and, where it lies on the boundary, of its boundary conditions
subroutine point_rows(self, ip, x, load, tangent, r, volume)
   !> Problem
   class(equilibrium_problem), intent(inout) :: self
   !> Collocation point
   integer, intent(in) :: ip
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Linearise
   logical, intent(in) :: tangent
   !> Residuals, shape (m)
   real(wp), intent(inout) :: r(:)
   !> Volume ratio J [-]
   real(wp), intent(out) :: volume
   real(wp) :: u(self%fields, self%shape%nq), f(3, 3), h(3, 3, 3), p(3, 3)
   real(wp) :: c4(3, 3, 3, 3), t(3, 3, 3), divergence(3)
   integer :: nd, b, i, k, q, ca, cb, row

   nd = self%scene%cloud%nd
   call self%field(ip, x, self%shape%nq, u)
   call deformation(nd, u, f, h)
   volume = determinant(f)
   row = self%rows%row(ip)
   b = self%boundary_of(ip)
   if (.not. volume > 0.0_wp) then
      ! no stress exists; the caller rejects the state
      r(row + 1:row + nd) = 0.0_wp
      if (b > 0) then
         row = self%rows%row(size(self%boundary_of) + b)
         r(row + 1:row + nd) = 0.0_wp
      end if
      return
   end if
   call self%mixture%strong(ip, nd, f, h, load, divergence, p, c4, t, &
      & volumetric=.not. self%has_pressure())
   call self%add_pressure(ip, u, f, tangent, p, divergence, t)
   if (allocated(self%scene%body_force)) divergence = divergence &
      & + load*self%scene%body_force(:, ip)
   associate (w => self%domain_weight(ip))
      r(row + 1:row + nd) = w*divergence(:nd)
      if (tangent) then
         do ca = 1, nd
            self%rows%coefficient(:nd, :nd, 1 + ca, ip) = w*t(:nd, :nd, ca)
            do cb = ca, nd
               q = second_index(nd, ca, cb)
               do k = 1, nd
                  do i = 1, nd
                     self%rows%coefficient(i, k, q, ip) = w*merge(c4(i, ca, k, ca), &
                        & c4(i, ca, k, cb) + c4(i, cb, k, ca), ca == cb)
                  end do
               end do
            end do
         end do
      end if
   end associate
   if (b > 0) call boundary_rows(self, b, u, load, f, p, c4, tangent, r)
end subroutine point_rows

!> Rows of one boundary point
subroutine boundary_rows(self, b, u, load, f, p, c4, tangent, r)
   !> Problem
   class(equilibrium_problem), intent(inout) :: self
   !> Boundary point
   integer, intent(in) :: b
   !> Fields with derivatives, shape (fields, nq)
   real(wp), intent(in) :: u(:, :)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Deformation gradient F(i, A) [-]
   real(wp), intent(in) :: f(3, 3)
   !> First Piola-Kirchhoff stress P(i, A), with that of a pressure
   real(wp), intent(in) :: p(3, 3)
   !> Tangent C4(i, A, j, B), without that of a pressure
   real(wp), intent(in) :: c4(3, 3, 3, 3)
   !> Linearise
   logical, intent(in) :: tangent
   !> Residuals, shape (m)
   real(wp), intent(inout) :: r(:)
   real(wp) :: n(3), slope(3, 3), factor(size(self%boundary%value, 1))
   integer :: nd, block, row, i, k, cb

   factor = self%scene%factors(load)
   nd = self%scene%cloud%nd
   block = size(self%boundary_of) + b
   row = self%rows%row(block)
   do i = 1, nd
      if (tangent) self%rows%coefficient(i, :, :, block) = 0.0_wp
      if (self%boundary%essential(i, b)) then
         associate (w => self%essential_weight(b))
            r(row + i) = w*(u(i, 1) - combined(self%boundary%value(:, i, b), factor))
            if (tangent) self%rows%coefficient(i, i, 1, block) = w
         end associate
         cycle
      end if
      n = 0.0_wp
      n(:nd) = self%boundary%normal(:, i, b)
      associate (w => self%traction_weight(b)*self%scene%solver%weight_traction)
         r(row + i) = w*(dot_product(p(i, :nd), n(:nd)) &
            & - combined(self%boundary%traction(:, i, b), factor))
         if (.not. tangent) cycle
         do cb = 1, nd
            do k = 1, nd
               slope(k, cb) = dot_product(c4(i, :nd, k, cb), n(:nd))
            end do
         end do
         call self%add_traction_pressure(block, i, u, f, n, w, slope)
         self%rows%coefficient(i, :nd, 2:1 + nd, block) = w*slope(:nd, :nd)
      end associate
   end do
end subroutine boundary_rows

!> Add what a pressure among the fields does to the stress
subroutine add_pressure(self, ip, u, f, tangent, p, divergence, t)
   !> Problem, whose rows get their coefficients of the pressure
   class(equilibrium_problem), intent(inout) :: self
   !> Collocation point
   integer, intent(in) :: ip
   !> Fields with derivatives, shape (fields, nq)
   real(wp), intent(in) :: u(:, :)
   !> Deformation gradient F(i, A) [-]
   real(wp), intent(in) :: f(3, 3)
   !> Linearise
   logical, intent(in) :: tangent
   !> First Piola-Kirchhoff stress P(i, A)
   real(wp), intent(inout) :: p(3, 3)
   !> Its divergence P_iA,A
   real(wp), intent(inout) :: divergence(3)
   !> Derivative of the divergence by F(k, C)
   real(wp), intent(inout) :: t(3, 3, 3)

   associate (unused => self, a => ip, b => u, c => f, d => tangent, e => p, g => divergence, &
      & h => t)
   end associate
end subroutine add_pressure

!> Add what a pressure among the fields does to the derivatives of a traction
subroutine add_traction_pressure(self, block, i, u, f, n, w, slope)
   !> Problem, whose rows get their coefficients of the pressure
   class(equilibrium_problem), intent(inout) :: self
   !> Block of rows
   integer, intent(in) :: block
   !> Component
   integer, intent(in) :: i
   !> Fields with derivatives, shape (fields, nq)
   real(wp), intent(in) :: u(:, :)
   !> Deformation gradient F(i, A) [-]
   real(wp), intent(in) :: f(3, 3)
   !> Normal
   real(wp), intent(in) :: n(3)
   !> Weight of the row
   real(wp), intent(in) :: w
   !> Derivative of the traction by F(k, C)
   real(wp), intent(inout) :: slope(3, 3)

   associate (unused => self, a => block, b => i, c => u, d => f, e => n, g => w, h => slope)
   end associate
end subroutine add_traction_pressure

!> Linearised rows, or their product with the modes
function operator(self) result(op)
   !> Problem, linearised
   class(equilibrium_problem), target, intent(in) :: self
   class(row_operator), pointer :: op

   op => self%rows
   if (allocated(self%modes)) op => self%projected
end function operator

!> Second derivatives of r.r/2
subroutine hessian(self, x, load, r, a)
   !> Problem, linearised at x
   class(equilibrium_problem), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> Upper triangle, shape (n, n)
   real(wp), contiguous, intent(inout) :: a(:, :)

   call self%set_curvature(x, load, r)
   if (allocated(self%modes)) then
      call self%projected%normal(a)
      call self%modes%add_second(self%rows%second, a)
   else
      call self%rows%expand(.true., a)
   end if
end subroutine hessian

!> Find the second derivatives of the residuals, weighted with the residuals
subroutine set_curvature(self, x, load, r)
   !> Problem
   class(equilibrium_problem), intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   integer :: ip, nd

   nd = self%scene%cloud%nd
   if (.not. allocated(self%rows%second)) allocate (self%rows%second(nd*nd, self%fields, &
      & self%shape%nq, self%shape%np))
   !$omp parallel do default(none) schedule(static) private(ip) shared(self, x, load, r)
   do ip = 1, self%shape%np
      call self%curvature(ip, x, load, r, self%rows%second(:, :, :, ip))
   end do
   !$omp end parallel do
end subroutine set_curvature

!> Product of these second derivatives with a vector of the full problem
subroutine apply_curvature(self, x, y)
   !> Problem
   class(equilibrium_problem), intent(in) :: self
   !> Vector, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Product, shape (n)
   real(wp), contiguous, intent(inout) :: y(:)

   call self%rows%apply_second(x, y)
end subroutine apply_curvature

!> Second derivatives of the residuals at one collocation point, weighted with the residuals
subroutine point_curvature(self, ip, x, load, r, form)
   !> Problem
   class(equilibrium_problem), intent(in) :: self
   !> Collocation point
   integer, intent(in) :: ip
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> Form as in rk_rows, shape (nd*nd, fields, nq)
   real(wp), contiguous, intent(inout) :: form(:, :, :)
   real(wp) :: u(self%fields, self%shape%nq), f(3, 3), h(3, 3, 3), weighted(3, 3), rho(3)
   real(wp) :: ff(9, 9), fh(9, 9, 3)
   integer :: nd, i, b, row

   nd = self%scene%cloud%nd
   call self%field(ip, x, self%shape%nq, u)
   call deformation(nd, u, f, h)
   row = self%rows%row(ip)
   rho = 0.0_wp
   rho(:nd) = self%domain_weight(ip)*r(row + 1:row + nd)
   form = 0.0_wp
   call self%mixture%strong_curvature(ip, nd, f, h, rho, load, ff, fh, &
      & volumetric=.not. self%has_pressure())
   call self%add_pressure_curvature(u, f, rho, ff, form)
   call add_curvature(nd, ff, fh, form)
   b = self%boundary_of(ip)
   if (b == 0) return
   weighted = 0.0_wp
   row = self%rows%row(size(self%boundary_of) + b)
   do i = 1, nd
      if (self%boundary%essential(i, b)) cycle
      weighted(i, :nd) = self%traction_weight(b)*self%scene%solver%weight_traction*r(row + i) &
         & *self%boundary%normal(:, i, b)
   end do
   call self%mixture%stress_curvature(ip, f, weighted, load, ff, &
      & volumetric=.not. self%has_pressure())
   call self%add_traction_curvature(u, f, weighted, ff, form)
   fh = 0.0_wp
   call add_curvature(nd, ff, fh, form)
end subroutine point_curvature

!> Add what a pressure among the fields does to the second derivatives of rho_i P_iA,A
subroutine add_pressure_curvature(self, u, f, rho, ff, form)
   !> Problem
   class(equilibrium_problem), intent(in) :: self
   !> Fields with derivatives, shape (fields, nq)
   real(wp), intent(in) :: u(:, :)
   !> Deformation gradient F(i, A) [-]
   real(wp), intent(in) :: f(3, 3)
   !> Residuals times weight
   real(wp), intent(in) :: rho(3)
   !> Second derivatives by F_iA and F_jB, index i + 3 (A - 1)
   real(wp), intent(inout) :: ff(9, 9)
   !> Form as in rk_rows, shape (nd*nd, fields, nq)
   real(wp), intent(inout) :: form(:, :, :)

   associate (unused => self, a => u, b => f, c => rho, d => ff, e => form)
   end associate
end subroutine add_pressure_curvature

!> Add what a pressure among the fields does to the second derivatives of R_iA P_iA
subroutine add_traction_curvature(self, u, f, weighted, ff, form)
   !> Problem
   class(equilibrium_problem), intent(in) :: self
   !> Fields with derivatives, shape (fields, nq)
   real(wp), intent(in) :: u(:, :)
   !> Deformation gradient F(i, A) [-]
   real(wp), intent(in) :: f(3, 3)
   !> Residuals times weight and normal, R(i, A)
   real(wp), intent(in) :: weighted(3, 3)
   !> Second derivatives by F_iA and F_jB, index i + 3 (A - 1)
   real(wp), intent(inout) :: ff(9, 9)
   !> Form as in rk_rows, shape (nd*nd, fields, nq)
   real(wp), intent(inout) :: form(:, :, :)

   associate (unused => self, a => u, b => f, c => weighted, d => ff, e => form)
   end associate
end subroutine add_traction_curvature

!> Add second derivatives by F and its derivatives to the form of a place
pure subroutine add_curvature(nd, ff, fh, form)
   !> Space dimension
   integer, intent(in) :: nd
   !> Second derivatives by F_iA and F_jB, index i + 3 (A - 1)
   real(wp), intent(in) :: ff(9, 9)
   !> Second derivatives by F_iA and u_j,BC, indices (iA, jB, C)
   real(wp), intent(in) :: fh(9, 9, 3)
   !> Form as in rk_rows, shape (nd*nd, fields, nq)
   real(wp), intent(inout) :: form(:, :, :)
   integer :: a, b, c, j, q

   do c = 1, nd
      do j = 1, nd
         do a = 1, nd
            associate (rows => form(nd*(a - 1) + 1:nd*a, j, 1 + c))
               ! the form counts products of first derivatives twice
               rows = rows + 0.5_wp*ff(3*(a - 1) + 1:3*(a - 1) + nd, j + 3*(c - 1))
            end associate
         end do
      end do
      do b = c, nd
         q = second_index(nd, c, b)
         do j = 1, nd
            do a = 1, nd
               associate (rows => form(nd*(a - 1) + 1:nd*a, j, q))
                  rows = rows + fh(3*(a - 1) + 1:3*(a - 1) + nd, j + 3*(b - 1), c)
                  if (b /= c) rows = rows + fh(3*(a - 1) + 1:3*(a - 1) + nd, j + 3*(c - 1), b)
               end associate
            end do
         end do
      end do
   end do
end subroutine add_curvature

end module rk_equilibrium
