!> Strong form collocation of hyperelasticity in displacements (RKCM).
!>
!> All collocation points carry the equilibrium rows, boundary points carry boundary rows as well.
!> Equation numbers are the thesis's: residuals (5.71)-(5.73), linearisation (5.66)-(5.70).
module rk_displacement
   use rk_conditions, only : new_boundary
   use rk_discretisation, only : discretisation_type, deformation
   use rk_error, only : error_type
   use rk_lstsq, only : row_operator
   use rk_mixture, only : new_mixture
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type
   use rk_rows, only : new_rows, rows_type
   use rk_scene, only : scene_type
   use rk_section_force, only : section_force
   use rk_states, only : field_state
   use rk_tensor, only : determinant
   implicit none
   private

   public :: displacement_problem, new_displacement, add_curvature

   !> Collocation problem of a scene
   type, extends(discretisation_type) :: displacement_problem
      !> The rows depend on the unknowns
      logical :: nonlinear = .true.
      !> Linearised rows: one block for each collocation point, then one for each boundary point
      type(rows_type) :: rows
      !> Weight of the essential rows of each boundary point, shape (nb)
      real(wp), allocatable :: weight(:)
      !> Boundary point of each collocation point, 0 inside, shape (nc)
      integer, allocatable :: boundary_of(:)
   contains
      procedure :: start_step
      procedure :: evaluate
      !> Residuals and rows of one place; a formulation with other rows overrides it
      procedure :: evaluate_place
      procedure :: operator
      procedure :: hessian
      !> Second derivatives of the residuals at all places
      procedure :: set_curvature
      !> The same at one place
      procedure :: curvature
      procedure :: set_force
   end type displacement_problem

contains

!> Set up the collocation problem of a scene
subroutine new_displacement(self, scene, error)
   !> Problem
   class(displacement_problem), intent(inout) :: self
   !> Scene
   type(scene_type), target, intent(in) :: scene
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer, allocatable :: place(:), range(:, :)
   integer :: nd, nc, nb, b, d

   self%scene => scene
   nd = scene%cloud%nd
   self%fields = nd
   call new_boundary(self%boundary, scene%cloud, scene%condition, error)
   if (allocated(error)) return
   allocate (self%shape)
   call scene%shape_at(scene%cloud%points, self%shape, error)
   if (allocated(error)) return
   nc = size(scene%cloud%points, 2)
   call new_mixture(self%mixture, scene, scene%cloud%points, [(b, b=1, nc)], error)
   if (allocated(error)) return

   nb = size(self%boundary%point)
   place = [[(b, b=1, nc)], self%boundary%point]
   allocate (range(2, nc + nb))
   range(1, :nc) = 2
   range(2, :nc) = self%shape%nq
   range(1, nc + 1:) = 1
   range(2, nc + 1:) = 1 + nd
   call new_rows(self%rows, self%shape, nd, place, [(nd, b=1, nc + nb)], range, &
      & scene%cloud%points, [(minval(scene%cloud%spacing(d, :)), d=1, nd)])
   self%m = self%rows%m
   self%n = self%rows%n
   self%extent = sqrt(real(self%n, wp))*maxval(maxval(scene%cloud%source, dim=2) &
      & - minval(scene%cloud%source, dim=2))
   allocate (self%weight(nb), source=1.0_wp)
   allocate (self%boundary_of(nc), source=0)
   self%boundary_of(self%boundary%point) = [(b, b=1, nb)]
end subroutine new_displacement

!> Force that the surroundings exert on the body through a set
function set_force(self, set, state, share) result(force)
   !> Problem
   class(displacement_problem), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> State
   type(field_state), intent(in) :: state
   !> Part of the way to the next fixed set that is looked at [-]
   real(wp), intent(in) :: share
   real(wp) :: force(3)

   force = section_force(self, set, state, share)
end function set_force

!> Linearised rows
function operator(self) result(op)
   !> Problem
   class(displacement_problem), target, intent(inout) :: self
   class(row_operator), pointer :: op

   op => self%rows
end function operator

!> Second derivatives of r.r/2
subroutine hessian(self, x, load, r, a)
   !> Problem
   class(displacement_problem), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> Upper triangle, shape (n, n)
   real(wp), contiguous, intent(inout) :: a(:, :)

   if (.not. self%nonlinear) then
      call self%rows%normal(a)
      return
   end if
   call self%set_curvature(x, load, r)
   call self%rows%hessian(a)
end subroutine hessian

!> Second derivatives of the residuals, weighted with the residuals
subroutine set_curvature(self, x, load, r)
   !> Problem
   class(displacement_problem), intent(inout) :: self
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

!> Second derivatives of the residuals at one place
subroutine curvature(self, ip, x, load, r, form)
   !> Problem
   class(displacement_problem), intent(in) :: self
   !> Place
   integer, intent(in) :: ip
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> Form as in rk_rows, shape (nd*nd, fields, nq)
   real(wp), contiguous, intent(inout) :: form(:, :, :)
   real(wp) :: u(self%scene%cloud%nd, self%shape%nq), f(3, 3), h(3, 3, 3), weighted(3, 3)
   real(wp) :: ff(9, 9), fh(9, 9, 3)
   integer :: nd, i, b, row

   nd = self%scene%cloud%nd
   call self%field(ip, x, self%shape%nq, u)
   call deformation(nd, u, f, h)
   weighted = 0.0_wp
   row = self%rows%row(ip)
   weighted(:nd, 1) = r(row + 1:row + nd)
   form = 0.0_wp
   call self%mixture%strong_curvature(ip, nd, f, h, weighted(:, 1), load, ff, fh, &
      & volumetric=.true.)
   call add_curvature(nd, ff, fh, form)
   b = self%boundary_of(ip)
   if (b == 0) return
   weighted = 0.0_wp
   row = self%rows%row(self%shape%np + b)
   do i = 1, nd
      if (self%boundary%essential(i, b)) cycle
      weighted(i, :nd) = self%scene%solver%weight_traction*r(row + i)*self%boundary%normal(:, i, b)
   end do
   call self%mixture%stress_curvature(ip, f, weighted, load, ff, volumetric=.true.)
   fh = 0.0_wp
   call add_curvature(nd, ff, fh, form)
end subroutine curvature

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
   integer :: a, b, c, i, j, q, row

   do a = 1, nd
      do i = 1, nd
         row = i + nd*(a - 1)
         do j = 1, nd
            q = 1 + nd
            do c = 1, nd
               ! the form counts products of first derivatives twice
               form(row, j, 1 + c) = form(row, j, 1 + c) &
                  & + 0.5_wp*ff(i + 3*(a - 1), j + 3*(c - 1))
               do b = c, nd
                  q = q + 1
                  form(row, j, q) = form(row, j, q) + fh(i + 3*(a - 1), j + 3*(b - 1), c)
                  if (b /= c) form(row, j, q) = form(row, j, q) &
                     & + fh(i + 3*(a - 1), j + 3*(c - 1), b)
               end do
            end do
         end do
      end do
   end do
end subroutine add_curvature

!> Weights of the essential rows (5.52b), from the tangent at the start of the step
subroutine start_step(self, x, load)
   !> Problem
   class(displacement_problem), target, intent(inout) :: self
   !> Unknowns at the start of the step, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load at the end of the step [-]
   real(wp), intent(in) :: load
   real(wp) :: u(self%scene%cloud%nd, self%shape%nq), f(3, 3), h(3, 3, 3), p(3, 3)
   real(wp) :: c4(3, 3, 3, 3), factor
   integer :: b, ip, nd

   if (self%scene%solver%weight_essential > 0.0_wp) then
      self%weight = self%scene%solver%weight_essential
      return
   end if
   factor = self%scene%solver%weight_c4
   if (.not. factor > 0.0_wp) factor = real(self%shape%ns, wp)
   nd = self%scene%cloud%nd
   do b = 1, size(self%boundary%point)
      ip = self%boundary%point(b)
      call self%field(ip, x, 1 + nd, u)
      call deformation(nd, u, f, h)
      call self%mixture%tangent(ip, f, load, p, c4, volumetric=.true.)
      self%weight(b) = factor*maxval(abs(c4(:nd, :nd, :nd, :nd)))
   end do
end subroutine start_step

!> Residuals (5.71)-(5.73) and rows (5.66)-(5.69)
subroutine evaluate(self, x, load, tangent, r, state)
   !> Problem
   class(displacement_problem), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Linearise
   logical, intent(in) :: tangent
   !> Residuals, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: state
   real(wp), allocatable :: volume(:)
   integer :: ip

   allocate (volume(self%shape%np))
   !$omp parallel do default(none) schedule(static) private(ip) &
   !$omp shared(self, x, load, tangent, r, volume)
   do ip = 1, self%shape%np
      call self%evaluate_place(ip, x, load, tangent, r, volume(ip))
   end do
   !$omp end parallel do
   state%worst = minloc(volume, dim=1)
   state%min_j = volume(state%worst)
   state%max_j = maxval(volume)
   ! comparisons that a NaN fails
   state%valid = all(volume > 0.0_wp) .and. all(abs(r) <= huge(1.0_wp))
end subroutine evaluate

!> Rows of one collocation point and, where it lies on the boundary, of its boundary conditions
subroutine evaluate_place(self, ip, x, load, tangent, r, volume)
   !> Problem
   class(displacement_problem), intent(inout) :: self
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
   real(wp) :: u(self%scene%cloud%nd, self%shape%nq), f(3, 3), h(3, 3, 3), p(3, 3)
   real(wp) :: c4(3, 3, 3, 3), t(3, 3, 3), divergence(3)
   integer :: nd, i, k, q, ca, cb, row

   nd = self%scene%cloud%nd
   call self%field(ip, x, self%shape%nq, u)
   call deformation(nd, u, f, h)
   volume = determinant(f)
   row = self%rows%row(ip)
   if (.not. volume > 0.0_wp) then
      ! no stress exists; the caller rejects the state
      r(row + 1:row + nd) = 0.0_wp
      if (self%boundary_of(ip) > 0) then
         row = self%rows%row(self%shape%np + self%boundary_of(ip))
         r(row + 1:row + nd) = 0.0_wp
      end if
      return
   end if
   call self%mixture%strong(ip, nd, f, h, load, divergence, p, c4, t, volumetric=.true.)
   if (allocated(self%scene%body_force)) divergence = divergence &
      & + load*self%scene%body_force(:, ip)
   r(row + 1:row + nd) = divergence(:nd)
   if (tangent) then
      do k = 1, nd
         do i = 1, nd
            q = 1 + nd
            do ca = 1, nd
               self%rows%coefficient(i, k, 1 + ca, ip) = t(i, k, ca)
               do cb = ca, nd
                  q = q + 1
                  self%rows%coefficient(i, k, q, ip) = merge(c4(i, ca, k, ca), &
                     & c4(i, ca, k, cb) + c4(i, cb, k, ca), ca == cb)
               end do
            end do
         end do
      end do
   end if
   if (self%boundary_of(ip) > 0) call evaluate_boundary(self, self%boundary_of(ip), u(:, 1), &
      & load, p, c4, tangent, r)
end subroutine evaluate_place

!> Rows of one boundary point
subroutine evaluate_boundary(self, b, u, load, p, c4, tangent, r)
   !> Problem
   class(displacement_problem), intent(inout) :: self
   !> Boundary point
   integer, intent(in) :: b
   !> Displacement, shape (nd) [length]
   real(wp), intent(in) :: u(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> First Piola-Kirchhoff stress P(i, A)
   real(wp), intent(in) :: p(3, 3)
   !> Tangent C4(i, A, j, B)
   real(wp), intent(in) :: c4(3, 3, 3, 3)
   !> Linearise
   logical, intent(in) :: tangent
   !> Residuals, shape (m)
   real(wp), intent(inout) :: r(:)
   integer :: nd, block, row, i, k, cb

   nd = size(u)
   block = self%shape%np + b
   row = self%rows%row(block)
   do i = 1, nd
      if (tangent) self%rows%coefficient(i, :, :, block) = 0.0_wp
      if (self%boundary%essential(i, b)) then
         r(row + i) = self%weight(b)*(u(i) - load*self%boundary%value(i, b))
         if (tangent) self%rows%coefficient(i, i, 1, block) = self%weight(b)
      else
         associate (n => self%boundary%normal(:, i, b), w => self%scene%solver%weight_traction)
            r(row + i) = w*(dot_product(p(i, :nd), n) - load*self%boundary%traction(i, b))
            if (.not. tangent) cycle
            do cb = 1, nd
               do k = 1, nd
                  self%rows%coefficient(i, k, 1 + cb, block) = w*dot_product(c4(i, :nd, k, cb), n)
               end do
            end do
         end associate
      end if
   end do
end subroutine evaluate_boundary

end module rk_displacement
