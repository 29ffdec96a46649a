!> Strong form collocation of hyperelasticity in displacements and pressure.
!>
!> With P = P_iso(F) + p cof F, p = dW/dJ (5.39), the unknowns are u and p in the same
!> reproducing kernel space:
!>    momentum   Div P_iso + cof F grad p = 0   at the collocation points (Div cof F = 0),
!>    volume     J - 1 - p/K = 0                at one point for each cell or patch,
!>    traction   (P_iso + p cof F) N = h, displacement u = g   at the boundary points.
!> Volume rows at all collocation points would lock: there must not be more of them than pressure
!> unknowns. Row weights balance the parts as the least squares functional with norms of
!> h Div P, P N and mu u/h does, with the shear modulus mu of the state in which a load step begins.
!> They fade towards edges between clamped and free faces, where the solution is singular, and are
!> lower on faces, edges and corners, where a point stands for less.
module rk_mixed
   use rk_conditions, only : new_boundary
   use rk_discretisation, only : deformation
   use rk_equilibrium, only : add_curvature, equilibrium_problem, new_equilibrium, &
      & point_curvature, point_rows
   use rk_error, only : error_type
   use rk_precision, only : wp
   use rk_options, only : displacement_weight
   use rk_scene, only : scene_type
   use rk_states, only : field_state, point_state
   use rk_tensor, only : cofactor, cross, cross_form, determinant
   use rk_text, only : to_text
   implicit none
   private

   public :: mixed_problem, new_mixed

   !> Mixed problem of a scene; the pressure is the last field
   type, extends(equilibrium_problem) :: mixed_problem
      !> Weight of each volume row, shape (nv) [stress]
      real(wp), allocatable :: volume_weight(:)
      !> The same in shear moduli, shape (nv) [-]
      real(wp), allocatable, private :: volume_share(:)
      !> Spacing of the source points [length]
      real(wp), private :: spacing = 0.0_wp
      !> Norm of pressures that are a shear modulus everywhere [stress]
      real(wp), private :: pressure_extent = 1.0_wp
      !> Collocation points farther from rims than a spacing of source points, shape (nc)
      logical, allocatable, private :: regular(:)
   contains
      procedure :: scaled_norms
      procedure :: start_step
      procedure :: renew
      procedure :: rejection
      procedure :: evaluate_place
      procedure :: curvature
      procedure :: add_pressure
      procedure :: add_traction_pressure
      procedure :: add_pressure_curvature
      procedure :: add_traction_curvature
      procedure :: at_place
   end type mixed_problem

   !> Smallest share of a row's weight, on the edge itself
   real(wp), parameter :: edge_floor = 0.01_wp
   !> Factor of a row's weight for each face its point lies on, one less for traction rows: there
   !> is less body, or less face, around it. Quadrature would have sqrt(1/2); docs/mixed.md has
   !> the measurements behind 1/2
   real(wp), parameter :: face_share = 0.5_wp
   !> Distance of J from 1 + p/K beyond which a state is none, docs/mixed.md: right ones have 0.2
   !> at most, where they are farther from rims than a spacing; a wrong one has 1.3
   real(wp), parameter :: far_off = 0.5_wp
   !> A spacing less rounding [-]
   real(wp), parameter :: one_spacing = 1.0_wp - 1.0e-6_wp

contains

!> Set up the mixed problem of a scene
subroutine new_mixed(self, scene, error)
   !> Problem
   type(mixed_problem), intent(inout) :: self
   !> Scene
   type(scene_type), target, intent(in) :: scene
   !> Error handling
   type(error_type), allocatable, intent(out) :: error

   call new_equilibrium(self, scene, scene%cloud%nd + 1, scene%cloud%volume_points, error)
   if (allocated(error)) return
   call set_extent(self)
   call set_weights(self)
end subroutine new_mixed

!> Norm of pressures of one shear modulus
subroutine set_extent(self)
   !> Problem
   class(mixed_problem), intent(inout) :: self
   integer :: k

   associate (tissue => self%scene%tissue)
      self%pressure_extent = sqrt(real(self%shape%ns, wp)) &
         & *maxval([(tissue(k)%material%shear, k=1, size(tissue))])
   end associate
end subroutine set_extent

!> Take other loads and material parameters from the scene
subroutine renew(self, materials, error)
   !> Problem
   class(mixed_problem), intent(inout) :: self
   !> Material parameters have changed as well
   logical, intent(in) :: materials
   !> Error handling: contradicting conditions
   type(error_type), allocatable, intent(out) :: error

   associate (scene => self%scene, unused => materials)
      call new_boundary(self%boundary, scene%cloud, scene%condition, scene%programme%count(), error)
   end associate
   call set_extent(self)
end subroutine renew

!> Row weights and shares of row weights that do not change during a run
subroutine set_weights(self)
   !> Problem
   type(mixed_problem), intent(inout) :: self
   real(wp) :: near, reach
   integer, allocatable :: faces(:)
   integer :: b, e, ip, iv, nc, nv

   associate (scene => self%scene, cloud => self%scene%cloud)
      nc = size(cloud%points, 2)
      nv = size(cloud%volume_points, 2)
      allocate (self%volume_weight(nv), self%volume_share(nv))
      self%spacing = cloud%mean_spacing()
      reach = 0.5_wp*minval(maxval(cloud%points, dim=2) - minval(cloud%points, dim=2))
      self%regular = [(rim_distance(self, cloud%points(:, ip)) >= one_spacing*self%spacing, &
         & ip=1, nc)]
      allocate (faces(nc), source=0)
      do e = 1, size(cloud%boundary_point)
         faces(cloud%boundary_point(e)) = faces(cloud%boundary_point(e)) + 1
      end do
      do ip = 1, nc
         near = closeness(self, cloud%points(:, ip), reach)
         self%domain_weight(ip) = self%spacing*near**scene%mixed%edge_exponent*face_share**faces(ip)
         b = self%boundary_of(ip)
         if (b == 0) cycle
         self%traction_weight(b) = near**max(scene%mixed%edge_exponent - 0.5_wp, 0.0_wp) &
            & *face_share**(faces(ip) - 1)
      end do
      do iv = 1, nv
         self%volume_share(iv) = scene%mixed%volume_weight &
            & *closeness(self, cloud%volume_points(:, iv), reach)**scene%mixed%edge_exponent
      end do
   end associate
end subroutine set_weights

!> Distance to the nearest edge between a clamped and a free face over a length, at most 1
pure real(wp) function closeness(self, x, reach)
   !> Problem
   type(mixed_problem), intent(in) :: self
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Length [length]
   real(wp), intent(in) :: reach

   closeness = min(max(rim_distance(self, x)/reach, edge_floor), 1.0_wp)
end function closeness

!> Distance to the nearest edge between a clamped and a free face, huge where there is none
pure real(wp) function rim_distance(self, x)
   !> Problem
   class(mixed_problem), intent(in) :: self
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   integer :: b

   rim_distance = sqrt(huge(1.0_wp))
   do b = 1, size(self%boundary%point)
      if (.not. self%boundary%singular(b)) cycle
      rim_distance = min(rim_distance, &
         & norm2(x - self%scene%cloud%points(:, self%boundary%point(b))))
   end do
end function rim_distance

!> Weights of volume and displacement rows by the stiffness at the start of the step: stresses of
!> a material that stiffens would outweigh them
subroutine start_step(self, x, load)
   !> Problem
   class(mixed_problem), target, intent(inout) :: self
   !> Unknowns at the start of the step, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load at the end of the step [-]
   real(wp), intent(in) :: load
   real(wp) :: u(self%fields, self%shape%nq), f(3, 3), h(3, 3, 3)
   integer :: b, iv, ip, nd

   ! activation changes no weight
   associate (unused => load)
   end associate
   nd = self%scene%cloud%nd
   do b = 1, size(self%boundary%point)
      ip = self%boundary%point(b)
      call self%field(ip, x, 1 + nd, u)
      call deformation(nd, u, f, h)
      self%essential_weight(b) = displacement_weight*self%mixture%shear_modulus(ip, f)/self%spacing
   end do
   do iv = 1, size(self%volume_share)
      ip = size(self%domain_weight) + iv
      call self%field(ip, x, 1 + nd, u)
      call deformation(nd, u, f, h)
      self%volume_weight(iv) = self%volume_share(iv)*self%mixture%shear_modulus(ip, f)
   end do
end subroutine start_step

!> Where the volume is far from that of the pressure, away from rims. Rows may balance at such a
!> state, which keeps the volume at the centres of cells but not between them.
function rejection(self, x) result(reason)
   !> Problem
   class(mixed_problem), intent(in) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   character(len=:), allocatable :: reason
   real(wp) :: u(self%fields, self%shape%nq), f(3, 3), h(3, 3, 3), volume, given, stray
   integer :: ip, nd

   reason = ''
   nd = self%scene%cloud%nd
   stray = far_off
   do ip = 1, size(self%regular)
      if (.not. self%regular(ip)) cycle
      call self%field(ip, x, 1 + nd, u)
      call deformation(nd, u, f, h)
      volume = determinant(f)
      given = 1.0_wp + u(nd + 1, 1)/self%mixture%bulk(ip)
      if (abs(volume - given) <= stray) cycle
      stray = abs(volume - given)
      reason = 'the iteration ended at a stationary point that is no solution: off the rims, at ' &
         & //'collocation point '//to_text(ip)//', J is '//to_text(volume, 4) &
         & //', by its pressure '//to_text(given, 4)//'; take smaller load steps or more points'
   end do
end function rejection

!> Norms of displacements in sizes of the body and of pressures in shear moduli
pure function scaled_norms(self, x) result(norms)
   !> Problem
   class(mixed_problem), intent(in) :: self
   !> Unknowns or their change, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   real(wp) :: norms(2)

   norms(2) = norm2(x(self%fields::self%fields))
   norms(1) = sqrt(max(sum(x**2) - norms(2)**2, 0.0_wp))
   norms = norms/[self%extent, self%pressure_extent]
end function scaled_norms

!> Stress and deformation at a place
subroutine at_place(self, state, ip, x, u, local)
   !> Problem
   class(mixed_problem), intent(in) :: self
   !> State of the body
   type(field_state), intent(in) :: state
   !> Collocation point whose material and fiber hold there
   integer, intent(in) :: ip
   !> Undeformed place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Displacement and pressure with derivatives, shape (nd + 1, nq)
   real(wp), intent(in) :: u(:, :)
   !> State there
   type(point_state), intent(out) :: local
   real(wp) :: h(3, 3, 3)
   integer :: nd

   nd = size(x)
   local%x(:nd) = x
   local%u(:nd) = u(:nd, 1)
   call deformation(nd, u, local%f, h)
   local%j = determinant(local%f)
   call self%mixture%stress(ip, local%f, state%load, local%p, volumetric=.false.)
   local%p = local%p + u(nd + 1, 1)*cofactor(local%f)
   local%cauchy = matmul(local%p, transpose(local%f))/local%j
end subroutine at_place

!> Second derivatives of J contracted with a vector on the second index: J_FF(i, A, k, C) v_A
pure function cofactor_slope(f, v) result(t)
   !> F(i, A)
   real(wp), intent(in) :: f(3, 3)
   !> Vector with index A
   real(wp), intent(in) :: v(3)
   real(wp) :: t(3, 3, 3)
   integer, parameter :: next(3) = [2, 3, 1], prev(3) = [3, 1, 2]
   integer :: i, c, ln

   ! eps_ikm eps_ACB F_mB v_A
   t = 0.0_wp
   do c = 1, 3
      do i = 1, 3
         ln = i
         t(ln, next(i), c) = v(prev(c))*f(prev(i), next(c)) - v(next(c))*f(prev(i), prev(c))
         t(ln, prev(i), c) = -(v(prev(c))*f(next(i), next(c)) - v(next(c))*f(next(i), prev(c)))
      end do
   end do
end function cofactor_slope

!> Residuals and rows of one place: a collocation point, or behind them the centre of a cell
subroutine evaluate_place(self, ip, x, load, tangent, r, volume)
   !> Problem
   class(mixed_problem), intent(inout) :: self
   !> Place among the shape functions
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

   if (ip <= size(self%domain_weight)) then
      call point_rows(self, ip, x, load, tangent, r, volume)
   else
      call evaluate_cell(self, ip, x, tangent, r, volume)
   end if
end subroutine evaluate_place

!> Volume row of one cell
subroutine evaluate_cell(self, ip, x, tangent, r, volume)
   !> Problem
   class(mixed_problem), intent(inout) :: self
   !> Place among the shape functions
   integer, intent(in) :: ip
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Linearise
   logical, intent(in) :: tangent
   !> Residuals, shape (m)
   real(wp), intent(inout) :: r(:)
   !> Volume ratio J [-]
   real(wp), intent(out) :: volume
   real(wp) :: u(self%fields, self%shape%nq), f(3, 3), h(3, 3, 3), c(3, 3), compliance
   integer :: nd, iv, block, k, a

   nd = self%scene%cloud%nd
   iv = ip - size(self%domain_weight)
   block = size(self%domain_weight) + size(self%boundary%point) + iv
   call self%field(ip, x, 1 + nd, u)
   call deformation(nd, u, f, h)
   volume = determinant(f)
   compliance = 1.0_wp/self%mixture%bulk(ip)
   associate (w => self%volume_weight(iv), row => self%rows%row(block) + 1)
      r(row) = w*(volume - 1.0_wp - compliance*u(nd + 1, 1))
      if (.not. tangent) return
      c = cofactor(f)
      do a = 1, nd
         do k = 1, nd
            self%rows%coefficient(1, k, 1 + a, block) = w*c(k, a)
         end do
      end do
      self%rows%coefficient(1, nd + 1, 1, block) = -w*compliance
   end associate
end subroutine evaluate_cell

!> Stress of the pressure p: p cof F, whose divergence is cof F grad p
subroutine add_pressure(self, ip, u, f, tangent, p, divergence, t)
   !> Problem, whose rows get their coefficients of the pressure
   class(mixed_problem), intent(inout) :: self
   !> Collocation point
   integer, intent(in) :: ip
   !> Displacement and pressure with derivatives, shape (nd + 1, nq)
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
   real(wp) :: c(3, 3), slope(3)
   integer :: a, nd

   nd = self%scene%cloud%nd
   c = cofactor(f)
   p = p + u(nd + 1, 1)*c
   slope = 0.0_wp
   slope(:nd) = u(nd + 1, 2:1 + nd)
   divergence(:nd) = divergence(:nd) + matmul(c(:nd, :nd), slope(:nd))
   if (.not. tangent) return
   t = t + cofactor_slope(f, slope)
   do a = 1, nd
      self%rows%coefficient(:nd, nd + 1, 1 + a, ip) = self%domain_weight(ip)*c(:nd, a)
   end do
end subroutine add_pressure

!> Derivatives of the traction p cof F N by F and by p
subroutine add_traction_pressure(self, block, i, u, f, n, w, slope)
   !> Problem, whose rows get their coefficients of the pressure
   class(mixed_problem), intent(inout) :: self
   !> Block of rows
   integer, intent(in) :: block
   !> Component
   integer, intent(in) :: i
   !> Displacement and pressure with derivatives, shape (nd + 1, nq)
   real(wp), intent(in) :: u(:, :)
   !> Deformation gradient F(i, A) [-]
   real(wp), intent(in) :: f(3, 3)
   !> Normal
   real(wp), intent(in) :: n(3)
   !> Weight of the row
   real(wp), intent(in) :: w
   !> Derivative of the traction by F(k, C)
   real(wp), intent(inout) :: slope(3, 3)
   real(wp) :: c(3, 3), t(3, 3, 3)
   integer :: nd

   nd = self%scene%cloud%nd
   c = cofactor(f)
   t = cofactor_slope(f, n)
   slope(:nd, :nd) = slope(:nd, :nd) + u(nd + 1, 1)*t(i, :nd, :nd)
   self%rows%coefficient(i, nd + 1, 1, block) = w*dot_product(c(i, :), n)
end subroutine add_traction_pressure

!> Second derivatives of the residuals at one place
subroutine curvature(self, ip, x, load, r, form)
   !> Problem
   class(mixed_problem), intent(in) :: self
   !> Place
   integer, intent(in) :: ip
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> Form as in rk_rows, shape (nd*nd, nd + 1, nq)
   real(wp), contiguous, intent(inout) :: form(:, :, :)
   real(wp) :: u(self%fields, self%shape%nq), f(3, 3), h(3, 3, 3), fh(9, 9, 3)
   integer :: iv, nd, row

   if (ip <= size(self%domain_weight)) then
      call point_curvature(self, ip, x, load, r, form)
      return
   end if
   ! J in the volume row
   nd = self%scene%cloud%nd
   iv = ip - size(self%domain_weight)
   row = self%rows%row(size(self%boundary%point) + ip) + 1
   call self%field(ip, x, self%shape%nq, u)
   call deformation(nd, u, f, h)
   form = 0.0_wp
   fh = 0.0_wp
   call add_curvature(nd, self%volume_weight(iv)*r(row)*cross_form(f), fh, form)
end subroutine curvature

!> Second derivatives of rho_i (cof F)_iA p_,A
subroutine add_pressure_curvature(self, u, f, rho, ff, form)
   !> Problem
   class(mixed_problem), intent(in) :: self
   !> Displacement and pressure with derivatives, shape (nd + 1, nq)
   real(wp), intent(in) :: u(:, :)
   !> Deformation gradient F(i, A) [-]
   real(wp), intent(in) :: f(3, 3)
   !> Residuals times weight
   real(wp), intent(in) :: rho(3)
   !> Second derivatives by F_iA and F_jB, index i + 3 (A - 1)
   real(wp), intent(inout) :: ff(9, 9)
   !> Form as in rk_rows, shape (nd*nd, nd + 1, nq)
   real(wp), intent(inout) :: form(:, :, :)
   real(wp) :: slope(3, 3), weighted(3, 3)
   integer :: a, nd

   nd = self%scene%cloud%nd
   slope = 0.0_wp
   do a = 1, nd
      slope(:, a) = rho*u(nd + 1, 1 + a)
      weighted = 0.0_wp
      weighted(:, a) = rho
      call add_mixed_curvature(nd, cross(f, weighted), 1 + a, form)
   end do
   ff = ff + cross_form(slope)
end subroutine add_pressure_curvature

!> Second derivatives of R_iA p (cof F)_iA
subroutine add_traction_curvature(self, u, f, weighted, ff, form)
   !> Problem
   class(mixed_problem), intent(in) :: self
   !> Displacement and pressure with derivatives, shape (nd + 1, nq)
   real(wp), intent(in) :: u(:, :)
   !> Deformation gradient F(i, A) [-]
   real(wp), intent(in) :: f(3, 3)
   !> Residuals times weight and normal, R(i, A)
   real(wp), intent(in) :: weighted(3, 3)
   !> Second derivatives by F_iA and F_jB, index i + 3 (A - 1)
   real(wp), intent(inout) :: ff(9, 9)
   !> Form as in rk_rows, shape (nd*nd, nd + 1, nq)
   real(wp), intent(inout) :: form(:, :, :)
   integer :: nd

   nd = self%scene%cloud%nd
   ff = ff + u(nd + 1, 1)*cross_form(weighted)
   call add_mixed_curvature(nd, cross(f, weighted), 1, form)
end subroutine add_traction_curvature

!> Add second derivatives by F and a derivative of the pressure to the form of a place
pure subroutine add_mixed_curvature(nd, slope, q, form)
   !> Space dimension
   integer, intent(in) :: nd
   !> Second derivatives by F(i, A)
   real(wp), intent(in) :: slope(3, 3)
   !> Derivative of the pressure
   integer, intent(in) :: q
   !> Form as in rk_rows, shape (nd*nd, nd + 1, nq)
   real(wp), intent(inout) :: form(:, :, :)

   form(:, nd + 1, q) = form(:, nd + 1, q) + reshape(slope(:nd, :nd), [nd*nd])
end subroutine add_mixed_curvature

end module rk_mixed
