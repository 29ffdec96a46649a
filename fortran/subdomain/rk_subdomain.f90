!> Subdomain collocation of hyperelasticity: a square system of balances of nodal cells.
!>
!> The divergence of the stress is not collocated at points but taken in the mean over the cell of
!> each source point, as the flux P N through its facets:
!>    momentum   sum P N + B V = 0                            for each cell and free component,
!>    held       u = g at the source point                    in place of that balance,
!>    volume     sum x.cof(F) N / nd - V = int p/K            for each patch of a coarser pressure,
!> with P = P_iso(F) + (p + k (J - 1)) cof F. The reaction is what the balance in whose place a
!> component is held leaves: all forces on a body add up to zero to rounding. Tractions stand in the
!> balances of the cells at the surface. There are no weights, no penalty and no second derivatives.
!> Rows of pointwise second derivatives in least squares hardly measure bending; these do.
!>
!> References: Atluri, Han, Rajendran, CMES 6 (2004), doi:10.3970/cmes.2004.006.491 (mixed meshless
!>             finite volumes); Morganti et al., CMES 129 (2021), doi:10.32604/cmes.2021.016832
module rk_subdomain
   use rk_cells, only : cells_type
   use rk_coarse_pressure, only : local_part, new_coarse_pressure
   use rk_conditions, only : new_boundary
   use rk_csr, only : csr_type
   use rk_error, only : error_type
   use rk_flux_points, only : close_points, flux_terms, ray_points
   use rk_mixture, only : new_mixture
   use rk_neighbours, only : nearest_points
   use rk_nodal_cells, only : nodal_cells
   use rk_octants, only : octant_cells
   use rk_operator, only : row_operator, square_report
   use rk_precision, only : i8, wp
   use rk_problem, only : evaluation_type
   use rk_programme, only : combined, ramp
   use rk_scene, only : scene_type
   use rk_square_rows, only : new_square_rows, square_rows
   use rk_states, only : field_state
   use rk_subdomain_body, only : find_fluxes, subdomain_body
   use rk_subdomain_boundary, only : new_subdomain_boundary
   use rk_surface_sets, only : find_surface_sets
   use rk_tensor, only : cofactor, cross_form, identity
   implicit none
   private

   public :: subdomain_problem, new_subdomain

   !> Subdomain problem of a scene
   type, extends(subdomain_body) :: subdomain_problem
      !> Linearised balances
      type(square_rows) :: matrix
      !> Pressures that the balance of each cell depends on
      type(csr_type) :: pressures
   contains
      procedure :: evaluate
      procedure :: linearise
      procedure :: operator
      procedure :: square_step
      procedure :: load_points
      procedure :: set_point_loads
      procedure :: renew
   end type subdomain_problem

contains

!> Set up the subdomain problem of a scene
subroutine new_subdomain(self, scene, error)
   !> Problem
   type(subdomain_problem), intent(inout) :: self
   !> Scene
   type(scene_type), target, intent(in) :: scene
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   type(cells_type) :: cells
   integer :: ip, k, nc, nd, ns, s

   self%scene => scene
   self%costly = .true.
   nd = scene%cloud%nd
   nc = size(scene%cloud%points, 2)
   ns = size(scene%cloud%source, 2)
   self%fields = nd
   self%extent = sqrt(real(nd*ns, wp))*maxval(maxval(scene%cloud%source, dim=2) &
      & - minval(scene%cloud%source, dim=2))
   self%spacing = scene%cloud%mean_spacing()
   call new_coarse_pressure(self%pressure, scene, error)
   if (allocated(error)) return
   allocate (self%shape)
   call scene%shape_at(scene%cloud%points, self%shape, error)
   if (.not. allocated(error)) call self%pressure%shape_at(scene%cloud%points, self%pressure_out, &
      & error)
   if (allocated(error)) return
   if (allocated(scene%cloud%lattice)) then
      call nodal_cells(cells, scene%cloud, error)
   else
      call octant_cells(cells, scene%cloud, error)
   end if
   if (.not. allocated(error)) call find_surface_sets(cells, scene%cloud, error)
   if (allocated(error)) return
   call take_facets(self, cells)
   call scene%shape_at(self%points%x, self%points%shape, error, first=.true.)
   if (.not. allocated(error)) call self%pressure%shape_at(self%points%x, self%pressure_there, &
      & error)
   if (allocated(error)) then
      error%message = 'facet '//error%message
      return
   end if
   call close_points(self%points, ns)
   call self%points%functions_of(self%pressure_there, self%pressures)
   self%nearest = nearest_points(scene%cloud%centres(), self%points%x)
   call new_mixture(self%mixture, scene, reshape([scene%cloud%points, self%points%x], &
      & [nd, nc + size(self%nearest)]), [[(ip, ip=1, nc)], self%nearest], error)
   if (allocated(error)) return
   self%n = nd*ns + self%pressure%n
   self%m = self%n
   call set_moduli(self)
   call set_conditions(self, reshape([((cells%in_set(s, k), k=1, size(scene%cloud%set_names)), &
      & s=1, size(cells%set))], [size(scene%cloud%set_names), size(cells%set)]), cells%part, error)
end subroutine new_subdomain

!> Facets of the cells, those on the surface last
subroutine take_facets(self, cells)
   !> Problem
   type(subdomain_problem), intent(inout) :: self
   !> Nodal cells
   type(cells_type), intent(in) :: cells
   integer :: inner, n, s

   inner = size(cells%side, 2)
   n = inner + size(cells%set)
   self%points%x = reshape([cells%facet, cells%surface], [size(cells%facet, 1), n])
   self%points%area = reshape([cells%area, cells%outward], [size(cells%facet, 1), n])
   allocate (self%points%side(2, n), source=0)
   self%points%side(:, :inner) = reshape(cells%node(reshape(cells%side, [2*inner])), [2, inner])
   self%points%side(1, inner + 1:) = [(cells%node(cells%lift_point(cells%lift_first(s) + 1)), &
      & s=1, n - inner)]
   self%surface%inner = inner
   allocate (self%volume(size(cells%node)))
   self%volume(cells%node) = cells%weight
end subroutine take_facets

!> Moduli by which rows and unknowns are made equals
subroutine set_moduli(self)
   !> Problem with materials
   class(subdomain_problem), intent(inout) :: self
   integer :: nc, q

   nc = size(self%scene%cloud%points, 2)
   associate (n => nc + size(self%nearest))
      self%local_bulk = [(local_part(self%mixture, q, self%scene%subdomain%local_bulk), q=1, n)]
      self%modulus = sum([(self%mixture%shear_modulus(q, identity), q=nc + 1, n)]) &
         & /size(self%nearest)
   end associate
   self%unit = self%modulus/self%spacing
end subroutine set_moduli

!> What is prescribed, and the places of the matrix' entries, which depend on what is held
subroutine set_conditions(self, inside, part, error)
   !> Problem with cells
   class(subdomain_problem), intent(inout) :: self
   !> Whether each point of the surface lies in a boundary set, shape (sets, ms)
   logical, intent(in) :: inside(:, :)
   !> Area of the body behind each over that of the facet, shape (ms) [-]
   real(wp), intent(in) :: part(:)
   !> Error handling: contradicting conditions
   type(error_type), allocatable, intent(out) :: error
   integer :: inner

   associate (scene => self%scene)
      call new_boundary(self%boundary, scene%cloud, scene%condition, scene%programme%count(), error)
      if (allocated(error)) return
      inner = self%surface%inner
      call new_subdomain_boundary(self%surface, scene, self%points, inner, inside, part, error)
   end associate
   if (.not. allocated(error)) call place_entries(self)
end subroutine set_conditions

!> Places of the matrix' entries
subroutine place_entries(self)
   !> Problem
   class(subdomain_problem), intent(inout) :: self
   integer(i8), allocatable :: start(:), column(:)
   integer(i8) :: k, n
   integer :: a, i, l, nd, ns, pass, row

   nd = size(self%points%x, 1)
   ns = size(self%volume)
   allocate (start(self%n + 1))
   start(1) = 0
   do pass = 1, 2
      n = 0
      row = 0
      do i = 1, ns
         do a = 1, nd
            if (self%surface%held(a, i)) then
               call add(self%surface%shape%neighbour, self%surface%number(i), [a], nd, 0)
            else
               call add(self%points%source, i, [(l, l=1, nd)], nd, 0)
               call add(self%pressures, i, [1], 1, nd*ns)
            end if
            row = row + 1
            start(row + 1) = n
         end do
      end do
      do i = 1, self%pressure%n
         call add(self%pressure%patch%source, i, [(l, l=1, nd)], nd, 0)
         do k = self%pressure%first(i) + 1, self%pressure%first(i + 1)
            n = n + 1
            if (pass == 2) column(n) = nd*ns + self%pressure%column(k) - 1
         end do
         row = row + 1
         start(row + 1) = n
      end do
      if (pass == 1) allocate (column(n))
   end do
   call new_square_rows(self%matrix, start, column)

contains

   !> Entries of some fields of the functions of a row
   subroutine add(functions, i, field, fields, offset)
      type(csr_type), intent(in) :: functions
      integer, intent(in) :: i, field(:), fields, offset
      integer(i8) :: at

      do at = functions%offset(i) + 1, functions%offset(i + 1)
         if (pass == 2) column(n + 1:n + size(field)) = offset + fields*(functions%index(at) - 1) &
            & + field - 1
         n = n + size(field)
      end do
   end subroutine add

end subroutine place_entries

!> Residuals: balances, displacements of what is held, changes of volume
subroutine evaluate(self, x, load, r, seen)
   !> Problem
   class(subdomain_problem), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   call assemble(self, x, load, .false., r, seen)
end subroutine evaluate

!> Residuals and matrix
subroutine linearise(self, x, load, r, seen)
   !> Problem
   class(subdomain_problem), target, intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen

   call assemble(self, x, load, .true., r, seen)
end subroutine linearise

!> Residuals, and the matrix where it is wanted
subroutine assemble(self, x, load, tangent, r, seen)
   !> Problem
   class(subdomain_problem), intent(inout) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Matrix wanted
   logical, intent(in) :: tangent
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: seen
   type(field_state) :: at
   type(flux_terms) :: momentum, volume
   real(wp), allocatable :: balance(:, :), growth(:, :)
   real(wp) :: u(size(self%points%x, 1), self%points%shape%nq)
   integer(i8) :: k
   integer :: a, i, nd, ns

   nd = size(self%points%x, 1)
   ns = size(self%volume)
   at%factor = self%scene%factors(load)
   call find_fluxes(self, x, load, tangent, .false., at, momentum)
   call find_growth(self, x, tangent, volume)
   balance = self%points%balance(momentum%flux)
   if (allocated(self%body_force)) balance = balance + at%factor(ramp)*self%body_force
   do i = 1, size(self%surface%cell)
      call self%surface%shape%interpolate(i, x, 1, 1, u)
      do a = 1, nd
         if (self%surface%held(a, self%surface%cell(i))) balance(a, self%surface%cell(i)) = &
            & held_stiffness(self)*(u(a, 1) - combined(self%surface%value(:, a, i), at%factor))
      end do
   end do
   r(:nd*ns) = reshape(balance, [nd*ns])
   growth = self%pressure%patch%balance(volume%flux)
   do i = 1, self%pressure%n
      growth(1, i) = growth(1, i) - self%pressure%volume(i)
      do k = self%pressure%first(i) + 1, self%pressure%first(i + 1)
         growth(1, i) = growth(1, i) - self%pressure%compliance(k)*self%unit &
            & *x(nd*ns + self%pressure%column(k))
      end do
      r(nd*ns + i) = self%unit*growth(1, i)
   end do
   associate (j => at%j(:))
      seen%worst = minloc(j, dim=1)
      seen%min_j = j(seen%worst)
      seen%max_j = maxval(j)
      ! comparisons that a NaN fails
      seen%valid = all(j > 0.0_wp) .and. all(abs(r) <= huge(1.0_wp))
   end associate
   seen%worst = self%nearest(seen%worst)
   if (tangent .and. seen%valid) call fill(self, momentum, volume)
end subroutine assemble

!> Stiffness that makes the rows of held components equals of the others [force/length]
pure real(wp) function held_stiffness(self) result(stiffness)
   !> Problem
   class(subdomain_problem), intent(in) :: self

   stiffness = self%modulus*self%spacing**(size(self%points%x, 1) - 2)
end function held_stiffness

!> Volume that each patch has, as fluxes x . cof(F) N / nd through its facets
subroutine find_growth(self, x, tangent, terms)
   !> Problem
   class(subdomain_problem), intent(in) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Derivatives wanted
   logical, intent(in) :: tangent
   !> Fluxes [length^nd]
   type(flux_terms), intent(out) :: terms
   real(wp) :: u(size(self%points%x, 1), self%points%shape%nq), f(3, 3), c(3, 3), place(3), area(3)
   real(wp) :: form(3, 3, 3, 3)
   integer :: a, i, k, n, nd, q

   nd = size(u, 1)
   n = size(self%pressure%patch%x, 2)
   allocate (terms%flux(1, n))
   if (tangent) allocate (terms%slope(1, nd, nd, n), terms%plain(1, nd, n))
   !$omp parallel do default(none) schedule(static) &
   !$omp private(a, i, k, q, u, f, c, place, area, form) shared(self, x, tangent, terms, n, nd)
   do q = 1, n
      associate (patch => self%pressure%patch)
         call patch%shape%interpolate(q, x, 1, 1 + nd, u)
         f = identity
         f(:nd, :nd) = f(:nd, :nd) + u(:, 2:1 + nd)
         c = cofactor(f)
         place = 0.0_wp
         place(:nd) = patch%x(:, q) + u(:, 1)
         area = 0.0_wp
         area(:nd) = patch%area(:, q)/nd
         terms%flux(1, q) = dot_product(place, matmul(c, area))
         if (.not. tangent) cycle
         terms%plain(1, :, q) = matmul(c(:nd, :), area)
         form = reshape(cross_form(f), [3, 3, 3, 3])
         do a = 1, nd
            do k = 1, nd
               terms%slope(1, k, a, q) = 0.0_wp
               do i = 1, nd
                  terms%slope(1, k, a, q) = terms%slope(1, k, a, q) + place(i)*dot_product( &
                     & form(i, :, k, a), area)
               end do
            end do
         end do
      end associate
   end do
   !$omp end parallel do
end subroutine find_growth

!> Entries of the matrix; each row is of one thread
subroutine fill(self, momentum, volume)
   !> Problem
   class(subdomain_problem), target, intent(inout) :: self
   !> Fluxes of momentum and volume, linearised
   type(flux_terms), intent(in) :: momentum, volume
   real(wp), allocatable :: part(:, :, :), column(:, :)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer, allocatable :: mark(:)
   integer(i8) :: at
   integer :: a, i, m, nd, np, ns, row

   nd = size(self%points%x, 1)
   ns = size(self%volume)
   !$omp parallel default(none) shared(self, momentum, volume, nd, ns) &
   !$omp private(part, column, values, nodes, mark, at, a, i, m, np, row)
   allocate (mark(max(ns, self%pressure%n)), source=0)
   !$omp do schedule(dynamic, 16)
   do i = 1, ns
      m = int(self%points%source%offset(i + 1) - self%points%source%offset(i))
      np = int(self%pressures%offset(i + 1) - self%pressures%offset(i))
      allocate (part(nd, nd, m), column(nd, np))
      if (.not. all(self%surface%held(:, i))) call self%points%rows(i, momentum, &
         & self%pressure_there, self%pressures, mark, part, column)
      do a = 1, nd
         row = nd*(i - 1) + a
         at = self%matrix%start(row)
         if (self%surface%held(a, i)) then
            call self%surface%shape%row(self%surface%number(i), nodes, values)
            self%matrix%value(at + 1:at + size(nodes)) = held_stiffness(self)*values(1, :)
         else
            self%matrix%value(at + 1:at + nd*m) = reshape(part(a, :, :), [nd*m])
            self%matrix%value(at + nd*m + 1:at + nd*m + np) = column(a, :)
         end if
      end do
      deallocate (part, column)
   end do
   !$omp end do
   !$omp do schedule(dynamic, 16)
   do i = 1, self%pressure%n
      associate (patch => self%pressure%patch, first => self%pressure%first)
         m = int(patch%source%offset(i + 1) - patch%source%offset(i))
         np = int(first(i + 1) - first(i))
         allocate (part(1, nd, m), column(1, 0))
         call patch%rows(i, volume, self%pressure_there, self%pressures, mark, part, column)
         at = self%matrix%start(nd*ns + i)
         self%matrix%value(at + 1:at + nd*m) = self%unit*reshape(part, [nd*m])
         self%matrix%value(at + nd*m + 1:at + nd*m + np) = &
            & -self%unit**2*self%pressure%compliance(first(i) + 1:first(i + 1))
         deallocate (part, column)
      end associate
   end do
   !$omp end do
   !$omp end parallel
end subroutine fill

!> Linearised balances
function operator(self) result(op)
   !> Problem, linearised
   class(subdomain_problem), target, intent(in) :: self
   class(row_operator), pointer :: op

   op => self%matrix
end function operator

!> Newton's step by LU; least squares solvers that are named in the deck solve it as well, as
!> reference
subroutine square_step(self, shift, r, dx, found, report, error)
   !> Problem, linearised
   class(subdomain_problem), target, intent(inout) :: self
   !> Damping in units of the diagonal, >= 0 [-]
   real(wp), intent(in) :: shift
   !> Residuals, shape (n) [force]
   real(wp), contiguous, intent(in) :: r(:)
   !> Step, shape (n)
   real(wp), contiguous, intent(inout) :: dx(:)
   !> Whether there is such a step
   logical, intent(out) :: found
   !> What was used and how good it is
   type(square_report), intent(out) :: report
   !> Error handling: singular matrix, no memory
   type(error_type), allocatable, intent(out) :: error

   found = index(self%scene%solver%linear, 'dgels') /= 1
   if (found) call self%matrix%solve_square(shift, -r, dx, report, error)
end subroutine square_step

!> Points where set_point_loads wants values: inside the cells, on the surface, at what is held
function load_points(self) result(x)
   !> Problem
   class(subdomain_problem), intent(in) :: self
   !> Points, shape (nd, n) [length]
   real(wp), allocatable :: x(:, :)
   real(wp), allocatable :: inside(:, :), weight(:)
   integer, allocatable :: cell(:)

   call ray_points(self%points, self%scene%cloud%source, inside, weight, cell)
   associate (surface => self%points%x(:, self%surface%inner + 1:), held => self%surface%place)
      x = reshape([inside, surface, held], [size(inside, 1), size(weight) + size(surface, 2) &
         & + size(held, 2)])
   end associate
end function load_points

!> Set what varies over the points and has no place in a deck, at full load of the ramp
subroutine set_point_loads(self, body_force, displacement, stress)
   !> Problem
   class(subdomain_problem), intent(inout) :: self
   !> Body force per undeformed volume, shape (3, n) [force/length^3]
   real(wp), intent(in) :: body_force(:, :)
   !> Displacement of the essential components, shape (3, n) [length]
   real(wp), intent(in) :: displacement(:, :)
   !> Stress P(i, A) whose traction the other components carry, shape (3, 3, n) [stress]
   real(wp), intent(in) :: stress(:, :, :)
   real(wp), allocatable :: inside(:, :), weight(:)
   integer, allocatable :: cell(:)
   integer :: m, ms, nd, q, s

   nd = size(self%points%x, 1)
   call ray_points(self%points, self%scene%cloud%source, inside, weight, cell)
   m = size(weight)
   ms = size(self%surface%part)
   if (.not. allocated(self%body_force)) allocate (self%body_force(nd, size(self%volume)))
   self%body_force = 0.0_wp
   do q = 1, m
      self%body_force(:, cell(q)) = self%body_force(:, cell(q)) + weight(q)*body_force(:nd, q)
   end do
   self%surface%traction = 0.0_wp
   do s = 1, ms
      associate (area => self%points%area(:, self%surface%inner + s))
         self%surface%traction(ramp, :, s) = merge(0.0_wp, matmul(stress(:nd, :nd, m + s), area) &
            & /norm2(area), self%surface%essential(:, s))
      end associate
   end do
   self%surface%value = 0.0_wp
   self%surface%value(ramp, :, :) = displacement(:nd, m + ms + 1:)
end subroutine set_point_loads

!> Take other loads and material parameters from the scene
subroutine renew(self, materials, error)
   !> Problem
   class(subdomain_problem), intent(inout) :: self
   !> Material parameters have changed as well
   logical, intent(in) :: materials
   !> Error handling: contradicting conditions
   type(error_type), allocatable, intent(out) :: error
   logical, allocatable :: inside(:, :)
   real(wp), allocatable :: part(:)

   if (materials) then
      call set_moduli(self)
      call self%pressure%set_compliance(self%scene, error)
      if (allocated(error)) return
   end if
   inside = self%surface%inside
   part = self%surface%part
   call set_conditions(self, inside, part, error)
end subroutine renew

end module rk_subdomain
