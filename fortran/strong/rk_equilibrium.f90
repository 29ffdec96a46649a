!> Strong form collocation of hyperelasticity: equilibrium at collocation points, with conditions at
!> boundary points.
!>
!> The strong form (5.27) at the points of (5.40)-(5.51). All collocation points have equilibrium
!> rows, boundary points have boundary rows in addition.
!> Equation numbers are those of the thesis: residuals (5.71)-(5.73), linearisation (5.66)-(5.70).
!>
!> In displacements alone (RKCM), or with a pressure as the last field. With P = P_iso(F) + p cof F,
!> p = dW/dJ (5.39), u and p are in the same reproducing kernel space:
!>    momentum   Div P_iso + cof F grad p = 0   at the collocation points (Div cof F = 0),
!>    volume     J - 1 - p/K = 0                at the centre of each cell of the lattice,
!>    traction   (P_iso + p cof F) N = h, displacement u = g   at the boundary points.
!> Volume rows at all collocation points would lock: there must not be more of them than pressure
!> unknowns. Row weights balance the parts like the least squares functional with norms of
!> h Div P, P N and mu u/h, with the shear modulus mu at the start of a load step, at full load
!> that of the answer.
!> They fade towards edges between clamped and free faces, where the solution is singular, and are
!> lower on faces, edges and corners, where a point represents less volume or area.
!>
!> The force on a fixed, plane set is the work of the stress in a virtual motion that is 1 on the
!> set and falls to 0 before the next fixed set: R = -integral of P grad w over the body. It
!> involves only interior sections, where stresses are smooth, not the singular tractions at the rim
!> of the set. For a component for which that motion meets other fixed points, or has no room, the
!> traction integral over the set is used instead.
!>
!> Linear problems, -L u = f with B^h u = h and B^g u = g on the boundary (5.7), have the same rows
!> with another law. Their boundary points only have the conditions (5.10): with L there in addition
!> the L2 errors are 4 to 7 times larger and fall more slowly.
!>
!> The unknowns may be the amplitudes of modes: then the rows are expressed in them.
module rk_equilibrium
   use rk_basis, only : second_index
   use rk_conditions, only : boundary_type, new_boundary
   use rk_discretisation, only : deformation, discretisation_type, gradients
   use rk_equation, only : source_at
   use rk_error, only : error_type
   use rk_matrix, only : matrix_rows
   use rk_mixture, only : new_mixture
   use rk_modes, only : modes_type, new_modes
   use rk_neighbours, only : nearest_points
   use rk_precision, only : pi, wp
   use rk_problem, only : evaluation_type, stage_type
   use rk_programme, only : combined
   use rk_rows, only : new_rows, rows_type
   use rk_scene, only : displacement_weight, scene_type
   use rk_states, only : field_state, point_state
   use rk_tensor, only : cofactor, cofactor_slope, determinant, vector_product
   use rk_text, only : to_text
   implicit none
   private

   public :: equilibrium_problem, new_equilibrium, reduce_rows

   !> Rows: one block per collocation point (interior ones only, if linear), then one per boundary
   !> point, then single rows at the points of the volume
   type, extends(discretisation_type) :: equilibrium_problem
      type(rows_type) :: rows
      !> Number of blocks of rows before those of the boundary
      integer :: inside = 0
      !> Block of each collocation point, 0 where it has none, shape (nc)
      integer, allocatable, private :: block_of(:)
      !> Boundary point of each collocation point, 0 inside, shape (nc)
      integer, allocatable :: boundary_of(:)
      !> Weight of the equilibrium rows of each collocation point, shape (nc)
      real(wp), allocatable :: domain_weight(:)
      !> Weight of the traction rows of each boundary point beside that of the deck, shape (nb)
      real(wp), allocatable :: traction_weight(:)
      !> Weight of the displacement rows of each boundary point, shape (nb)
      real(wp), allocatable :: essential_weight(:)
      !> Weight of each volume row, shape (nv) [stress]
      real(wp), allocatable :: volume_weight(:)
      !> The same in shear moduli, shape (nv) [-]
      real(wp), allocatable, private :: volume_share(:)
      !> Spacing of the source points [length]
      real(wp), private :: spacing = 0.0_wp
      !> Collocation points farther from rims than a spacing of source points, shape (nc)
      logical, allocatable, private :: regular(:)
      !> Sources of a linear problem at the collocation points, shape (fields, nc)
      !> [force/length^3]
      real(wp), allocatable, private :: source(:, :)
      !> Modes whose amplitudes are the unknowns, where there are any
      type(modes_type), allocatable, private :: modes
      !> Linearised rows times the modes, with modes
      type(matrix_rows), private :: projected
   contains
      procedure :: field, start, assemble, check_answer, own_side, set_force, section_force
   end type equilibrium_problem

   !> Smallest share of a row's weight, on the edge itself
   real(wp), parameter :: edge_floor = 0.01_wp
   !> Factor of a row's weight for each face its point lies on, one less for traction rows: there
   !> is less body, or less face, around it. Quadrature would give sqrt(1/2); docs/mixed.md has
   !> the measurements behind 1/2
   real(wp), parameter :: face_share = 0.5_wp
   !> Distance of J from 1 + p/K beyond which a state is rejected, docs/mixed.md: correct states
   !> have at most 0.2, farther from rims than a spacing; a wrong one has 1.3
   real(wp), parameter :: far_off = 0.5_wp
   !> A spacing less rounding [-]
   real(wp), parameter :: one_spacing = 1.0_wp - 1.0e-6_wp

contains

!> Set up shape functions, materials, conditions and rows
subroutine new_equilibrium(self, scene, mixed, error)
   type(equilibrium_problem), intent(inout) :: self
   type(scene_type), target, intent(in) :: scene
   !> The pressure is a separate field
   logical, intent(in) :: mixed
   type(error_type), allocatable, intent(out) :: error
   integer, allocatable :: place(:), range(:, :)
   real(wp), allocatable :: further(:, :), position(:, :)
   integer :: nd, nc, nb, nv, b, d

   self%scene => scene
   self%linear = allocated(scene%equation%problem)
   nd = scene%cloud%nd
   self%fields = scene%equation%fields(nd) + merge(1, 0, mixed)
   self%weighted = mixed .or. .not. scene%solver%weight_essential > 0.0_wp
   self%compares_works = .not. self%linear
   allocate (further(nd, 0))
   if (mixed) further = scene%cloud%volume_points
   call new_boundary(self%boundary, scene, error)
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

   allocate (self%boundary_of(nc), source=0)
   self%boundary_of(self%boundary%point) = [(b, b=1, nb)]
   place = pack([(b, b=1, nc)], .not. (self%linear .and. self%boundary_of > 0))
   self%inside = size(place)
   allocate (self%block_of(nc), source=0)
   self%block_of(place) = [(b, b=1, self%inside)]
   place = [place, self%boundary%point, [(nc + b, b=1, nv)]]
   allocate (range(2, size(place)))
   ! constant coefficients: second derivatives only
   range(1, :self%inside) = merge(2 + nd, 2, self%linear .and. .not. scene%equation%varies())
   range(2, :self%inside) = self%shape%nq
   range(1, self%inside + 1:) = 1
   range(2, self%inside + 1:) = 1 + nd
   call new_rows(self%rows, self%shape, self%fields, place, [[(scene%equation%fields(nd), b=1, &
      & self%inside + nb)], [(1, b=1, nv)]], range, position, &
      & [(minval(scene%cloud%spacing(d, :)), d=1, nd)])
   self%m = self%rows%m
   self%n = self%rows%n
   allocate (self%domain_weight(nc), self%traction_weight(nb), self%essential_weight(nb), &
      & source=1.0_wp)
   if (self%linear) then
      self%essential_weight = scene%solver%weight_essential
      call set_sources(self, 0.0_wp, error)
      return
   end if
   self%extent = sqrt(real(nd*self%shape%ns, wp))*maxval(maxval(scene%cloud%source, dim=2) &
      & - minval(scene%cloud%source, dim=2))
   if (.not. mixed) return
   self%pressure_first = self%fields
   self%pressure_stride = self%fields
   ! pressures of one shear modulus
   self%pressure_extent = sqrt(real(self%shape%ns, wp)) &
      & *maxval([(scene%tissue(b)%material%shear, b=1, size(scene%tissue))])
   call set_weights(self)
end subroutine new_equilibrium

!> Sources of a linear problem at a time
subroutine set_sources(self, time, error)
   class(equilibrium_problem), intent(inout) :: self
   !> Time, unused in a problem at rest
   real(wp), intent(in) :: time
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(inout) :: error
   integer :: ip

   if (.not. allocated(self%source)) allocate (self%source(self%fields, size(self%block_of)), &
      & source=0.0_wp)
   do ip = 1, size(self%block_of)
      if (self%block_of(ip) == 0) cycle
      call source_at(self%scene%equation, self%scene%cloud%points(:, ip), time, &
         & self%source(:, ip), error)
      if (allocated(error)) return
   end do
end subroutine set_sources

!> Weighted right-hand side of a linear problem at a time: sources, values and tractions
subroutine own_side(self, time, side, error)
   class(equilibrium_problem), target, intent(inout) :: self
   real(wp), intent(in) :: time
   !> Right-hand side, shape (m)
   real(wp), contiguous, intent(inout) :: side(:)
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(out) :: error
   type(boundary_type) :: kept
   type(evaluation_type) :: seen

   kept = self%boundary
   call new_boundary(self%boundary, self%scene, error, time)
   if (.not. allocated(error)) call set_sources(self, time, error)
   if (.not. allocated(error)) call self%evaluate(spread(0.0_wp, 1, self%n), 1.0_wp, side, seen)
   side = -side
   self%boundary = kept
end subroutine own_side

!> Row weights and shares of row weights that do not change during a run
subroutine set_weights(self)
   type(equilibrium_problem), intent(inout) :: self
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
   class(equilibrium_problem), intent(in) :: self
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Length [length]
   real(wp), intent(in) :: reach

   closeness = min(max(rim_distance(self, x)/reach, edge_floor), 1.0_wp)
end function closeness

!> Distance to the nearest edge between a clamped and a free face, huge where there is none
pure real(wp) function rim_distance(self, x)
   class(equilibrium_problem), intent(in) :: self
   real(wp), intent(in) :: x(:)
   integer :: b

   rim_distance = sqrt(huge(1.0_wp))
   do b = 1, size(self%boundary%point)
      if (.not. self%boundary%singular(b)) cycle
      rim_distance = min(rim_distance, &
         & norm2(x - self%scene%cloud%points(:, self%boundary%point(b))))
   end do
end function rim_distance

!> Weights from the state at which a load step starts or continues. In displacements, displacement
!> rows (5.52b) by the tangent; with a pressure, volume and displacement rows by the stiffness:
!> otherwise the stresses of a material that stiffens would outweigh them
subroutine start(self, x, load, iteration)
   class(equilibrium_problem), target, intent(inout) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), intent(in) :: load
   logical, intent(in) :: iteration
   real(wp) :: u(self%fields, self%shape%nq), f(3, 3), h(3, 3, 3), p(3, 3)
   real(wp) :: c4(3, 3, 3, 3), factor
   integer :: b, iv, ip, nd

   if (iteration .or. self%linear) return
   nd = self%scene%cloud%nd
   factor = self%scene%solver%weight_c4
   if (.not. factor > 0.0_wp) factor = real(self%shape%ns, wp)
   do b = 1, size(self%boundary%point)
      ip = self%boundary%point(b)
      call self%field(ip, x, 1 + nd, u)
      call deformation(nd, u, f, h)
      associate (weight => self%essential_weight(b))
         if (self%has_pressure()) then
            weight = displacement_weight*self%mixture%shear_modulus(ip, f)/self%spacing
         else if (self%scene%solver%weight_essential > 0.0_wp) then
            weight = self%scene%solver%weight_essential
         else
            call self%mixture%stress(ip, f, load, p, c4, volumetric=.true.)
            weight = factor*maxval(abs(c4(:nd, :nd, :nd, :nd)))
         end if
      end associate
   end do
   if (.not. self%has_pressure()) return
   do iv = 1, size(self%volume_share)
      ip = size(self%domain_weight) + iv
      call self%field(ip, x, 1 + nd, u)
      call deformation(nd, u, f, h)
      self%volume_weight(iv) = self%volume_share(iv)*self%mixture%shear_modulus(ip, f)
   end do
end subroutine start

!> Reject states whose volume is far from that of the pressure, away from rims. Rows may balance at
!> such a state, which has the right volume at the centres of cells but not between them.
subroutine check_answer(self, x, reason)
   class(equilibrium_problem), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   character(len=:), allocatable, intent(out) :: reason
   real(wp) :: u(self%fields, self%shape%nq), f(3, 3), h(3, 3, 3), volume, given, stray
   integer :: ip, nd

   reason = ''
   if (self%reduced .or. .not. self%has_pressure()) return
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
      reason = 'the iteration stopped at a stationary point that is not a solution: off the ' &
         & //'rims, at collocation point '//to_text(ip)//', J is '//to_text(volume, 4) &
         & //', by its pressure '//to_text(given, 4)//'; use smaller load steps or more points'
   end do
end subroutine check_answer

!> The same problem in terms of the amplitudes of modes
subroutine reduce_rows(self, modes, copy)
   class(equilibrium_problem), intent(in) :: self
   !> Orthonormal modes, shape (n, r)
   real(wp), intent(in) :: modes(:, :)
   !> Copy in modes, which uses the shape functions of the full problem
   class(equilibrium_problem), pointer, intent(out) :: copy

   allocate (copy, source=self)
   allocate (copy%modes)
   call new_modes(copy%modes, self%shape, self%fields, modes)
   copy%reduced = .true.
   copy%pressure_first = 0
   copy%n = size(modes, 2)
   copy%projected%m = copy%m
   copy%projected%n = copy%n
   allocate (copy%projected%a(copy%m, copy%n))
end subroutine reduce_rows

!> Unknown fields and derivatives at a place from the unknowns
subroutine field(self, ip, x, last, u)
   class(equilibrium_problem), intent(in) :: self
   integer, intent(in) :: ip
   !> Unknowns: coefficients, or amplitudes of the modes, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   integer, intent(in) :: last
   real(wp), intent(out) :: u(:, :)

   if (allocated(self%modes)) then
      call self%modes%field(ip, x, last, u)
   else
      call self%shape%interpolate(ip, x, 1, last, u)
   end if
end subroutine field

!> Residuals (5.71)-(5.73) and, where wanted, rows (5.66)-(5.69) of all places
subroutine assemble(self, x, stage, r, seen)
   class(equilibrium_problem), target, intent(inout) :: self
   real(wp), contiguous, intent(in) :: x(:)
   type(stage_type), intent(in) :: stage
   real(wp), contiguous, intent(inout) :: r(:)
   type(evaluation_type), intent(out) :: seen
   real(wp), allocatable :: volume(:)
   integer :: ip

   self%linearised => self%rows
   if (allocated(self%modes)) self%linearised => self%projected
   allocate (volume(self%shape%np))
   !$omp parallel do default(none) schedule(static) private(ip) &
   !$omp shared(self, x, stage, r, volume)
   do ip = 1, self%shape%np
      if (ip <= size(self%domain_weight)) then
         call point_rows(self, ip, x, stage%load, stage%tangent, r, volume(ip))
      else
         call volume_row(self, ip, x, stage%tangent, r, volume(ip))
      end if
   end do
   !$omp end parallel do
   if (stage%tangent .and. allocated(self%modes)) call self%modes%project(self%rows, &
      & self%projected%a)
   seen%worst = minloc(volume, dim=1)
   seen%min_j = volume(seen%worst)
   seen%max_j = maxval(volume)
   ! comparisons that a NaN fails
   seen%valid = all(volume > 0.0_wp) .and. all(abs(r) <= huge(1.0_wp))
end subroutine assemble

!> Rows of one collocation point and, where it lies on the boundary, of its boundary conditions
subroutine point_rows(self, ip, x, load, tangent, r, volume)
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
   real(wp) :: c4(3, 3, 3, 3), t(3, 3, 3), divergence(3), c(3, 3)
   integer :: nd, nf, b, i, k, q, ca, cb, block, row

   nd = self%scene%cloud%nd
   nf = min(self%fields, nd)
   b = self%boundary_of(ip)
   block = self%block_of(ip)
   row = 0
   if (block > 0) row = self%rows%row(block)
   volume = 1.0_wp
   if (self%linear) then
      u = 0.0_wp
      associate (used => self%rows%range(:, merge(block, self%inside + b, block > 0)))
         call self%shape%interpolate(ip, x, used(1), used(2), u)
      end associate
      call gradients(nd, u, f, h)
   else
      call self%field(ip, x, self%shape%nq, u)
      call deformation(nd, u, f, h)
      volume = determinant(f)
   end if
   if (.not. volume > 0.0_wp) then
      ! no stress exists; the caller rejects the state
      r(row + 1:row + nd) = 0.0_wp
      if (b > 0) then
         row = self%rows%row(self%inside + b)
         r(row + 1:row + nd) = 0.0_wp
      end if
      return
   end if
   if (tangent) then
      call self%mixture%strong(ip, nd, f, h, load, .not. self%has_pressure(), divergence, p, c4, t)
   else
      call self%mixture%strong(ip, nd, f, h, load, .not. self%has_pressure(), divergence, p, c4)
   end if
   if (self%has_pressure()) call add_pressure(nd, u, f, tangent, p, divergence, t, c)
   if (self%linear) divergence(:nf) = divergence(:nf) + load*self%source(:, ip)
   if (allocated(self%scene%body_force)) divergence = divergence &
      & + load*self%scene%body_force(:, ip)
   if (block > 0) then
      associate (w => self%domain_weight(ip), a => self%rows%coefficient(:, :, :, block))
         r(row + 1:row + nf) = w*divergence(:nf)
         if (tangent) then
            do ca = 1, nd
               a(:nf, :nf, 1 + ca) = w*t(:nf, :nf, ca)
               if (self%has_pressure()) a(:nd, nd + 1, 1 + ca) = w*c(:nd, ca)
               do cb = ca, nd
                  q = second_index(nd, ca, cb)
                  do k = 1, nf
                     do i = 1, nf
                        a(i, k, q) = w*merge(c4(i, ca, k, ca), &
                           & c4(i, ca, k, cb) + c4(i, cb, k, ca), ca == cb)
                     end do
                  end do
               end do
            end do
         end if
      end associate
   end if
   if (b > 0) call boundary_rows(self, b, u, load, f, p, c4, tangent, r)
end subroutine point_rows

!> Stress of the pressure p: p cof F, whose divergence is cof F grad p
pure subroutine add_pressure(nd, u, f, tangent, p, divergence, t, c)
   integer, intent(in) :: nd
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
   !> Derivative of the divergence with respect to F(k, C)
   real(wp), intent(inout) :: t(3, 3, 3)
   !> Derivatives of the divergence with respect to those of the pressure: cof F
   real(wp), intent(out) :: c(3, 3)
   real(wp) :: slope(3)

   c = cofactor(f)
   p = p + u(nd + 1, 1)*c
   slope = 0.0_wp
   slope(:nd) = u(nd + 1, 2:1 + nd)
   divergence(:nd) = divergence(:nd) + matmul(c(:nd, :nd), slope(:nd))
   if (tangent) t = t + cofactor_slope(f, slope)
end subroutine add_pressure

subroutine boundary_rows(self, b, u, load, f, p, c4, tangent, r)
   class(equilibrium_problem), intent(inout) :: self
   !> Boundary point
   integer, intent(in) :: b
   !> Fields with derivatives, shape (fields, nq)
   real(wp), intent(in) :: u(:, :)
   real(wp), intent(in) :: load
   !> Deformation gradient F(i, A), unused in a linear problem [-]
   real(wp), intent(in) :: f(3, 3)
   !> First Piola-Kirchhoff stress P(i, A), with that of a pressure
   real(wp), intent(in) :: p(3, 3)
   !> Tangent C4(i, A, j, B), without that of a pressure
   real(wp), intent(in) :: c4(3, 3, 3, 3)
   logical, intent(in) :: tangent
   real(wp), intent(inout) :: r(:)
   real(wp) :: n(3), slope(3, 3), factor(size(self%boundary%value, 1)), t(3, 3, 3), c(3, 3)
   integer :: nd, nf, block, row, i, k, cb

   factor = self%scene%factors(load)
   nd = self%scene%cloud%nd
   nf = min(self%fields, nd)
   block = self%inside + b
   row = self%rows%row(block)
   do i = 1, nf
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
            do k = 1, nf
               slope(k, cb) = dot_product(c4(i, :nd, k, cb), n(:nd))
            end do
         end do
         if (self%has_pressure()) then
            ! p cof F N
            t = cofactor_slope(f, n)
            slope(:nd, :nd) = slope(:nd, :nd) + u(nd + 1, 1)*t(i, :nd, :nd)
            c = cofactor(f)
            self%rows%coefficient(i, nd + 1, 1, block) = w*dot_product(c(i, :), n)
         end if
         self%rows%coefficient(i, :nf, 2:1 + nd, block) = w*slope(:nf, :nd)
      end associate
   end do
end subroutine boundary_rows

!> Volume row of one cell
subroutine volume_row(self, ip, x, tangent, r, volume)
   class(equilibrium_problem), intent(inout) :: self
   !> Place among the shape functions
   integer, intent(in) :: ip
   real(wp), contiguous, intent(in) :: x(:)
   logical, intent(in) :: tangent
   real(wp), intent(inout) :: r(:)
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
end subroutine volume_row

!> Force that the surroundings exert on the body through a set, or its moment in the deformed
!> position, whose virtual motion is a rotation: from the sections below the set and the body force
!> before them, or from the traction integral over it where there is no room for these
function set_force(self, set, state, share, about) result(force)
   class(equilibrium_problem), intent(in) :: self
   integer, intent(in) :: set
   type(field_state), intent(in) :: state
   !> Part of the distance to the next fixed set that is used [-]
   real(wp), intent(in) :: share
   real(wp), intent(in), optional :: about(3)
   real(wp) :: force(3), pull(3), reach
   real(wp) :: normal(self%scene%cloud%nd), origin(self%scene%cloud%nd)
   real(wp) :: depth(size(self%scene%cloud%points, 2))
   logical :: usable(3)
   type(point_state) :: local
   integer :: e, nd

   nd = self%scene%cloud%nd
   force = 0.0_wp
   call find_reach(self, set, normal, origin, reach, usable)
   ! a rotation involves both directions across its axis
   if (present(about)) usable = [usable(2) .and. usable(3), usable(1) .and. usable(3), &
      & usable(1) .and. usable(2)]
   associate (cloud => self%scene%cloud)
      do e = 1, size(cloud%boundary_point)
         if (.not. cloud%in_set(e, set)) cycle
         call self%at_point(state, cloud%boundary_point(e), local)
         pull = 0.0_wp
         pull(:nd) = matmul(local%p(:nd, :nd), cloud%normal(:, e))*cloud%area(e)
         if (present(about)) pull = vector_product(local%x + local%u - about, pull)
         force = force + pull
      end do
      if (.not. any(usable)) return
      depth = -matmul(normal, cloud%points - spread(origin, 2, size(depth)))
   end associate
   ! half the distance only makes sense between the ends of a body
   if (share < 1.0_wp .and. reach < maxval(depth)*(1.0_wp - 1.0e-6_wp)) return
   reach = 0.5_wp*share*reach
   where (usable) force = slab_force(self, state, normal, depth - reach, reach, about) &
      & - body_load(self, state, depth - reach, reach, about)
end function set_force

!> Force through a plane section: the mean over the sections of a slab of a few spacings, which lies
!> inside the body
function section_force(self, place, normal, state) result(force)
   class(equilibrium_problem), intent(in) :: self
   real(wp), intent(in) :: place(:)
   real(wp), intent(in) :: normal(:)
   type(field_state), intent(in) :: state
   real(wp) :: force(3), height(size(self%scene%cloud%points, 2)), half, middle

   associate (cloud => self%scene%cloud)
      height = matmul(normal, cloud%points)
      half = 2.0_wp*dot_product(abs(normal), sum(cloud%spacing, dim=2))/size(cloud%spacing, 2)
      half = min(half, 0.5_wp*(maxval(height) - minval(height)))
      middle = min(max(dot_product(normal, place), minval(height) + half), maxval(height) - half)
   end associate
   force = slab_force(self, state, normal, height - middle, half)
end function section_force

!> Mean force through the sections of a slab, or its moment in the deformed position: the work of
!> the stress in a motion whose slope is a raised cosine, with the largest weight in the middle
function slab_force(self, state, normal, away, half, about) result(force)
   class(equilibrium_problem), intent(in) :: self
   type(field_state), intent(in) :: state
   !> Unit normal of the sections, shape (nd)
   real(wp), intent(in) :: normal(:)
   !> Distance of each collocation point from the middle, shape (nc) [length]
   real(wp), intent(in) :: away(:)
   !> Half the width of the slab [length]
   real(wp), intent(in) :: half
   real(wp), intent(in), optional :: about(3)
   real(wp) :: force(3), pull(3)
   type(point_state) :: local
   integer :: ip, nd

   nd = size(normal)
   force = 0.0_wp
   do ip = 1, size(away)
      if (abs(away(ip)) >= half) cycle
      call self%at_point(state, ip, local)
      pull = 0.0_wp
      pull(:nd) = matmul(local%p(:nd, :nd), normal)*self%scene%cloud%volume(ip) &
         & *0.5_wp*(1.0_wp + cos(pi*away(ip)/half))/half
      if (present(about)) pull = vector_product(local%x + local%u - about, pull)
      force = force + pull
   end do
end function slab_force

!> Mean body force before the sections of a slab, or its moment in the deformed position: its work
!> in the motion of `slab_force`
function body_load(self, state, away, half, about) result(force)
   class(equilibrium_problem), intent(in) :: self
   type(field_state), intent(in) :: state
   !> Distance of each collocation point from the middle of the slab, shape (nc) [length]
   real(wp), intent(in) :: away(:)
   !> Half the width of the slab [length]
   real(wp), intent(in) :: half
   real(wp), intent(in), optional :: about(3)
   real(wp) :: force(3), pull(3), place
   type(point_state) :: local
   integer :: ip

   force = 0.0_wp
   if (.not. allocated(self%scene%body_force)) return
   do ip = 1, size(away)
      place = min(max(away(ip)/half, -1.0_wp), 1.0_wp)
      pull = state%load*self%scene%body_force(:, ip)*self%scene%cloud%volume(ip) &
         & *0.5_wp*(1.0_wp - place - sin(pi*place)/pi)
      if (present(about)) then
         call self%at_point(state, ip, local)
         pull = vector_product(local%x + local%u - about, pull)
      end if
      force = force + pull
   end do
end function body_load

!> Depth to which a virtual motion from a set may extend, and the components it may have
subroutine find_reach(self, set, normal, origin, reach, usable)
   class(equilibrium_problem), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> Its outward normal, shape (nd)
   real(wp), intent(out) :: normal(:)
   !> A point of it, shape (nd) [length]
   real(wp), intent(out) :: origin(:)
   !> Depth below the set, 0 if the set is not plane [length]
   real(wp), intent(out) :: reach
   !> Components for which no other fixed point is met
   logical, intent(out) :: usable(3)
   real(wp) :: across, depth, deepest
   integer :: e, b, first, nd

   nd = size(normal)
   usable = .false.
   reach = 0.0_wp
   associate (cloud => self%scene%cloud)
      first = findloc(cloud%boundary_set, set, dim=1)
      ! a part of a side does not determine the force of the sections below it
      if (first == 0) return
      normal = cloud%normal(:, first)
      origin = cloud%points(:, cloud%boundary_point(first))
      deepest = maxval(-matmul(normal, cloud%points - spread(origin, 2, size(cloud%points, 2))))
      do e = 1, size(cloud%boundary_point)
         if (.not. cloud%in_set(e, set)) cycle
         if (dot_product(cloud%normal(:, e), normal) < 1.0_wp - 1.0e-9_wp) return
         if (abs(dot_product(normal, cloud%points(:, cloud%boundary_point(e)) - origin)) &
            & > 1.0e-6_wp*deepest) return
      end do
      ! the next set that is fixed as a whole limits the motion
      reach = deepest
      do b = 1, size(self%boundary%point)
         depth = -dot_product(normal, cloud%points(:, self%boundary%point(b)) - origin)
         if (depth < 1.0e-6_wp*deepest) cycle
         if (all(self%boundary%essential(:, b))) reach = min(reach, depth)
      end do
      ! a motion that ends within one or two cells contains hardly any points
      across = dot_product(abs(normal), sum(cloud%spacing, dim=2))/size(cloud%spacing, 2)
      if (reach < 1.5_wp*across) return
      usable(:nd) = .true.
      do b = 1, size(self%boundary%point)
         depth = -dot_product(normal, cloud%points(:, self%boundary%point(b)) - origin)
         if (depth < 1.0e-6_wp*deepest .or. depth > reach*(1.0_wp - 1.0e-6_wp)) cycle
         usable(:nd) = usable(:nd) .and. .not. self%boundary%essential(:, b) &
            & .and. .not. any(abs(self%boundary%traction(:, :, b)) > 0.0_wp, dim=1)
      end do
   end associate
end subroutine find_reach

end module rk_equilibrium
