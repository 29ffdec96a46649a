!> What the subdomain form knows of its body beside the iteration: fluxes through the facets of the
!> cells, and states with the answers to questions about them.
module rk_subdomain_body
   use rk_coarse_pressure, only : coarse_pressure, local_part
   use rk_discretisation, only : deformation, discretisation_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_flux_points, only : flux_points, flux_terms
   use rk_precision, only : i8, wp
   use rk_programme, only : combined, ramp
   use rk_shape, only : shape_type
   use rk_states, only : field_state, point_state
   use rk_subdomain_boundary, only : subdomain_boundary
   use rk_tensor, only : cofactor, cross_form, determinant, identity, vector_product
   use rk_work_balance, only : own_work_mismatch
   implicit none
   private

   public :: subdomain_body, find_fluxes

   !> Balances of a scene
   type, abstract, extends(discretisation_type) :: subdomain_body
      !> Points on the facets of the cells
      type(flux_points) :: points
      !> What is prescribed on the surface
      type(subdomain_boundary) :: surface
      !> Pressures
      type(coarse_pressure) :: pressure
      !> Their functions at the points of facets, and at the collocation points
      type(shape_type) :: pressure_there, pressure_out
      !> Unit of the pressures' unknowns: they stand beside displacements as equals [stress/length]
      real(wp) :: unit = 1.0_wp
      !> Modulus of the body, and the spacing of its source points [stress], [length]
      real(wp) :: modulus = 1.0_wp, spacing = 1.0_wp
      !> Part of the bulk modulus that acts at each place itself, shape (nc + n) [stress]
      real(wp), allocatable :: local_bulk(:)
      !> Volume of the cells, shape (ns) [length^nd]
      real(wp), allocatable :: volume(:)
      !> Forces on the cells by body forces at full load of the ramp, shape (nd, ns) [force]; not
      !> allocated where there are none
      real(wp), allocatable :: body_force(:, :)
      !> Nearest collocation point of each facet point, shape (n)
      integer, allocatable :: nearest(:)
   contains
      procedure :: reduce
      procedure :: scaled_norms
      procedure :: state
      procedure :: at_place
      procedure :: of_tissue
      procedure :: strain_energy
      procedure :: set_force
      procedure :: set_torque
      procedure :: section_force
      procedure :: compare_works
   end type subdomain_body

contains

!> Modes of this form would need tests of their own, and have none
subroutine reduce(self, modes, problem, error)
   !> Full problem
   class(subdomain_body), intent(in) :: self
   !> Orthonormal modes, shape (n, r)
   real(wp), intent(in) :: modes(:, :)
   !> Never allocated
   class(discretisation_type), allocatable, intent(out) :: problem
   !> Error handling: always
   type(error_type), allocatable, intent(out) :: error

   associate (unused => modes, unused_too => problem)
   end associate
   call fatal_error(error, err_input, 'modes do not reduce method "'//self%scene%method &
      & //'", whose balances are the derivatives of no energy: use method "rkpm-gauss"')
end subroutine reduce

!> Norms of displacements and pressures
pure function scaled_norms(self, x) result(norms)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> Unknowns or their change, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   real(wp) :: norms(2)

   associate (nu => self%n - self%pressure%n)
      norms = [norm2(x(:nu))/self%extent, norm2(x(nu + 1:))*self%unit/(self%modulus &
         & *sqrt(real(self%pressure%n, wp)))]
   end associate
end function scaled_norms

!> Fluxes of momentum through the facets, outward of the first cell: P N inside, what is prescribed
!> on the surface
subroutine find_fluxes(self, x, load, tangent, walls, at, terms)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Derivatives wanted
   logical, intent(in) :: tangent
   !> P N wanted also where a cell is held, whose balance it does not enter
   logical, intent(in) :: walls
   !> State with its load factors; F, J and P are set. On the surface these are 1, 1 and 0 where
   !> nothing depends on them
   type(field_state), intent(inout) :: at
   !> Fluxes [force]
   type(flux_terms), intent(out) :: terms
   real(wp) :: normal(3)
   integer :: n, nd, q, s

   nd = size(self%points%x, 1)
   n = size(self%points%x, 2)
   allocate (at%f(3, 3, n), at%j(n), at%p(3, 3, n), terms%flux(nd, n))
   if (tangent) then
      allocate (terms%slope(nd, nd, nd, n), terms%pressure(nd, n), source=0.0_wp)
      if (allocated(self%surface%spring)) allocate (terms%plain(nd, nd, n), source=0.0_wp)
   end if
   !$omp parallel do default(none) schedule(static) private(q, s, normal) &
   !$omp shared(self, x, load, tangent, walls, at, terms, n, nd)
   do q = 1, n
      at%f(:, :, q) = identity
      at%j(q) = 1.0_wp
      at%p(:, :, q) = 0.0_wp
      terms%flux(:, q) = 0.0_wp
      s = q - self%surface%inner
      if (s > 0) then
         if (.not. (self%surface%stressed(s, self%points%side(1, q)) &
            & .or. self%surface%deforms(s) &
            & .or. (walls .and. any(self%surface%essential(:, s))))) then
            call add_tractions(self, s, at%factor, terms%flux(:, q))
            cycle
         end if
      end if
      normal = 0.0_wp
      normal(:nd) = self%points%area(:, q)
      call flux_at(self, q, x, load, normal, tangent, at, terms)
   end do
   !$omp end parallel do
end subroutine find_fluxes

!> Prescribed tractions at a point of the surface
pure subroutine add_tractions(self, s, factor, flux)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> Point of the surface
   integer, intent(in) :: s
   !> Load factors [-]
   real(wp), intent(in) :: factor(:)
   !> Flux, to which they are added [force]
   real(wp), intent(inout) :: flux(:)
   integer :: i

   associate (area => self%surface%part(s)*norm2(self%points%area(:, self%surface%inner + s)))
      do i = 1, size(flux)
         flux(i) = flux(i) + area*combined(self%surface%traction(:, i, s), factor)
      end do
   end associate
end subroutine add_tractions

!> Flux at a point where the displacement counts
subroutine flux_at(self, q, x, load, normal, tangent, at, terms)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> Point
   integer, intent(in) :: q
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Its normal times area [length^(nd-1)]
   real(wp), intent(in) :: normal(3)
   !> Derivatives wanted
   logical, intent(in) :: tangent
   !> State
   type(field_state), intent(inout) :: at
   !> Fluxes
   type(flux_terms), intent(inout) :: terms
   real(wp) :: u(size(terms%flux, 1), self%points%shape%nq), c4(3, 3, 3, 3), c(3, 3)
   real(wp) :: p(1, self%points%shape%nq), form(3, 3, 3, 3), total, push
   integer :: a, i, k, nc, nd, s
   logical :: wall(size(terms%flux, 1))

   nd = size(u, 1)
   nc = size(self%scene%cloud%points, 2)
   s = q - self%surface%inner
   call self%points%shape%interpolate(q, x, 1, 1 + nd, u)
   at%f(:nd, :nd, q) = at%f(:nd, :nd, q) + u(:, 2:1 + nd)
   at%j(q) = determinant(at%f(:, :, q))
   ! no stress exists; the caller rejects the state
   if (.not. at%j(q) > 0.0_wp) return
   call self%pressure_there%interpolate(q, x(nd*self%points%shape%ns + 1:), 1, 1, p)
   associate (f => at%f(:, :, q), stress => at%p(:, :, q), local => self%local_bulk(nc + q))
      total = self%unit*p(1, 1) + local*(at%j(q) - 1.0_wp)
      c = cofactor(f)
      if (tangent) then
         form = reshape(cross_form(f), [3, 3, 3, 3])
         call self%mixture%tangent(nc + q, f, load, stress, c4, volumetric=.false.)
         c4 = c4 + total*form + local*reshape(matmul(reshape(c, [9, 1]), reshape(c, [1, 9])), &
            & [3, 3, 3, 3])
      else
         call self%mixture%stress(nc + q, f, load, stress, volumetric=.false.)
      end if
      stress = stress + total*c
      wall = .true.
      if (s > 0) wall = self%surface%essential(:, s)
      terms%flux(:, q) = merge(matmul(stress(:nd, :), normal), 0.0_wp, wall)
   end associate
   if (tangent) then
      do k = 1, nd
         do i = 1, nd
            if (.not. wall(i)) cycle
            do a = 1, nd
               terms%slope(i, k, a, q) = dot_product(c4(i, :, k, a), normal)
            end do
         end do
      end do
      terms%pressure(:, q) = merge(self%unit*matmul(c(:nd, :), normal), 0.0_wp, wall)
   end if
   if (s < 1) return
   call add_tractions(self, s, at%factor, terms%flux(:, q))
   if (allocated(self%surface%pressure)) then
      push = self%surface%part(s)*dot_product(self%surface%pressure(:, s), at%factor)
      where (.not. wall) terms%flux(:, q) = terms%flux(:, q) - push*matmul(c(:nd, :), normal)
      if (tangent) then
         do k = 1, nd
            do i = 1, nd
               if (wall(i)) cycle
               do a = 1, nd
                  terms%slope(i, k, a, q) = -push*dot_product(form(i, :, k, a), normal)
               end do
            end do
         end do
      end if
   end if
   if (allocated(self%surface%spring)) then
      do i = 1, nd
         if (wall(i)) cycle
         push = self%surface%part(s)*norm2(normal)*self%surface%spring(i, s)
         terms%flux(i, q) = terms%flux(i, q) - push*u(i, 1)
         if (tangent) terms%plain(i, i, q) = -push
      end do
   end if
end subroutine flux_at

!> State of the body with stresses at the points of facets
subroutine state(self, x, load, at)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> State
   type(field_state), intent(out) :: at
   type(flux_terms) :: terms

   at%x = x
   at%load = load
   at%factor = self%scene%factors(load)
   call find_fluxes(self, x, load, .false., .true., at, terms)
   call move_alloc(terms%flux, at%flux)
end subroutine state

!> The state with the stress of one tissue alone, which has its fraction of the pressure
subroutine of_tissue(self, state, tissue, own)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> State of the body
   type(field_state), intent(in) :: state
   !> Tissue
   integer, intent(in) :: tissue
   !> The same with other stresses
   type(field_state), intent(out) :: own
   real(wp) :: p(1, self%points%shape%nq)
   integer :: nc, nd, q

   nc = size(self%scene%cloud%points, 2)
   nd = self%scene%cloud%nd
   own = state
   own%part = [(self%mixture%part_of(nc + q, tissue), q=1, size(state%j))]
   do q = 1, size(state%j)
      if (q > self%surface%inner) then
         ! what is prescribed pulls at each tissue by its share
         own%flux(:, q) = own%part(q)*own%flux(:, q)
         cycle
      end if
      if (.not. state%j(q) > 0.0_wp) cycle
      call self%pressure_there%interpolate(q, state%x(nd*self%points%shape%ns + 1:), 1, 1, p)
      call self%mixture%stress(nc + q, state%f(:, :, q), state%load, own%p(:, :, q), &
         & volumetric=.false., tissue=tissue)
      own%p(:, :, q) = own%p(:, :, q) + own%part(q)*(self%unit*p(1, 1) &
         & + self%local_bulk(nc + q)*(state%j(q) - 1.0_wp))*cofactor(state%f(:, :, q))
      own%flux(:, q) = matmul(own%p(:nd, :nd, q), self%points%area(:, q))
   end do
end subroutine of_tissue

!> Pressure at a place, of which the collocation points have functions at hand
real(wp) function pressure_at(self, ip, x, unknown) result(pressure)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> Collocation point that may be the place
   integer, intent(in) :: ip
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Unknowns, shape (n)
   real(wp), contiguous, intent(in) :: unknown(:)
   real(wp) :: field(1, self%points%shape%nq)

   associate (nu => self%n - self%pressure%n)
      if (all(abs(x - self%scene%cloud%points(:, ip)) <= 0.0_wp)) then
         call self%pressure_out%interpolate(ip, unknown(nu + 1:), 1, 1, field)
         pressure = self%unit*field(1, 1)
      else
         pressure = self%unit*self%pressure%at_place(x, unknown(nu + 1:))
      end if
   end associate
end function pressure_at

!> Stress and deformation at a place from the displacement and the pressure there
subroutine at_place(self, state, ip, x, u, local)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> State of the body
   type(field_state), intent(in) :: state
   !> Collocation point whose material and fiber hold there
   integer, intent(in) :: ip
   !> Undeformed place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Displacement with derivatives, shape (nd, nq)
   real(wp), intent(in) :: u(:, :)
   !> State there
   type(point_state), intent(out) :: local
   real(wp) :: h(3, 3, 3), pressure

   local%x(:size(x)) = x
   local%u(:size(x)) = u(:size(x), 1)
   call deformation(size(x), u, local%f, h)
   local%j = determinant(local%f)
   pressure = pressure_at(self, ip, x, state%x) + self%local_bulk(ip)*(local%j - 1.0_wp)
   call self%mixture%stress(ip, local%f, state%load, local%p, volumetric=.false.)
   local%p = local%p + pressure*cofactor(local%f)
   local%cauchy = matmul(local%p, transpose(local%f))/local%j
end subroutine at_place

!> Energy of the deformation, with that of the pressure
real(wp) function strain_energy(self, state, tissue) result(energy)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> State of the body
   type(field_state), intent(in) :: state
   !> Tissue whose part is wanted, 0 for all
   integer, intent(in) :: tissue
   type(point_state) :: local
   real(wp) :: density, part, pressure, stiffness
   integer :: ip

   energy = 0.0_wp
   do ip = 1, size(self%scene%cloud%points, 2)
      part = 1.0_wp
      if (tissue > 0) part = self%mixture%part_of(ip, tissue)
      if (.not. part > 0.0_wp) cycle
      call self%at_point(state, ip, local)
      density = 0.5_wp*self%local_bulk(ip)*(local%j - 1.0_wp)**2
      stiffness = self%mixture%bulk_at_one_pressure(ip) - self%local_bulk(ip)
      pressure = pressure_at(self, ip, self%scene%cloud%points(:, ip), state%x)
      if (stiffness < huge(1.0_wp)) density = density + 0.5_wp*pressure**2/stiffness
      energy = energy + self%scene%cloud%volume(ip)*(part*density + self%mixture%energy(ip, &
         & local%f, state%load, tissue, volumetric=.false.))
   end do
end function strain_energy

!> Force of the surroundings at each point of the surface: what is prescribed, or the stress on a
!> wall, with its share of what the balance of a held cell leaves. Where the cell touches two walls
!> the stress tells what each of them bears
function point_forces(self, state) result(force)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> State
   type(field_state), intent(in) :: state
   !> Forces, shape (nd, ms) [force]
   real(wp) :: force(size(self%points%x, 1), size(self%surface%part))
   real(wp), allocatable :: left(:, :)
   integer :: s

   left = self%points%balance(state%flux)
   if (allocated(self%body_force)) left = left + state%factor(ramp)*self%body_force
   associate (inner => self%surface%inner)
      do s = 1, size(force, 2)
         force(:, s) = state%flux(:, inner + s) &
            & - self%surface%share(:, s)*left(:, self%points%side(1, inner + s))
      end do
   end associate
end function point_forces

!> Force that the surroundings exert on the body through a set
function set_force(self, set, state, share) result(force)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> State
   type(field_state), intent(in) :: state
   !> Of no meaning: the balances of the cells at the set tell its force
   real(wp), intent(in) :: share
   real(wp) :: force(3)
   real(wp) :: all(size(self%points%x, 1), size(self%surface%part))
   integer :: s

   associate (unused => share)
   end associate
   all = point_forces(self, state)
   force = 0.0_wp
   do s = 1, size(all, 2)
      if (self%surface%inside(set, s)) force(:size(all, 1)) = force(:size(all, 1)) + all(:, s)
   end do
end function set_force

!> Moment of the forces that the surroundings exert on the body through a set. The reaction on a
!> cell has the moment that its fluxes leave: where in the cell it acts is not known otherwise
function set_torque(self, set, state, about) result(torque)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> State
   type(field_state), intent(in) :: state
   !> Point about which it turns [length]
   real(wp), intent(in) :: about(3)
   real(wp) :: torque(3), area(size(self%volume), 2)
   integer(i8) :: k
   integer :: i, s

   area = 0.0_wp
   torque = 0.0_wp
   associate (inner => self%surface%inner)
      do s = 1, size(self%surface%part)
         if (self%surface%inside(set, s)) torque = torque + moment(inner + s)
         associate (cell => self%points%side(1, inner + s))
            if (.not. any(self%surface%share(:, s) > 0.0_wp)) cycle
            area(cell, 1) = area(cell, 1) + norm2(self%points%area(:, inner + s))
            if (self%surface%inside(set, s)) area(cell, 2) = area(cell, 2) &
               & + norm2(self%points%area(:, inner + s))
         end associate
      end do
   end associate
   do i = 1, size(area, 1)
      if (.not. area(i, 2) > 0.0_wp) cycle
      do k = self%points%cell%offset(i) + 1, self%points%cell%offset(i + 1)
         associate (q => self%points%cell%index(k))
            torque = torque - area(i, 2)/area(i, 1)*self%points%sign(q, i)*moment(q)
         end associate
      end do
   end do

contains

   !> Moment of a flux where its point has moved to
   function moment(q) result(value)
      integer, intent(in) :: q
      real(wp) :: value(3), arm(3), force(3)
      real(wp) :: u(size(self%points%x, 1), self%points%shape%nq)

      call self%points%shape%interpolate(q, state%x, 1, 1, u)
      arm = -about
      arm(:size(u, 1)) = arm(:size(u, 1)) + self%points%x(:, q) + u(:, 1)
      force = 0.0_wp
      force(:size(u, 1)) = state%flux(:, q)
      value = vector_product(arm, force)
   end function moment

end function set_torque

!> Force through a plane section: that of the part behind the normal on the part before it. The
!> section goes between cells along the plane: what it cuts off is in balance to rounding
function section_force(self, place, normal, state) result(force)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> Point of the plane, shape (nd) [length]
   real(wp), intent(in) :: place(:)
   !> Its unit normal, shape (nd)
   real(wp), intent(in) :: normal(:)
   !> State
   type(field_state), intent(in) :: state
   real(wp) :: force(3), height(size(self%volume)), middle
   integer :: nd, q

   nd = size(place)
   height = matmul(normal, self%scene%cloud%source)
   ! a plane at an end cuts the last cells off
   middle = min(max(dot_product(normal, place), minval(height) + 0.25_wp*self%spacing), &
      & maxval(height) - 0.25_wp*self%spacing)
   force = 0.0_wp
   do q = 1, self%surface%inner
      associate (behind => height(self%points%side(:, q)) > middle)
         if (behind(2) .and. .not. behind(1)) force(:nd) = force(:nd) + state%flux(:, q)
         if (behind(1) .and. .not. behind(2)) force(:nd) = force(:nd) - state%flux(:, q)
      end associate
   end do
end function section_force

!> Work of the stress in the state's own displacement less that of the forces, relative
subroutine compare_works(self, state, mismatch)
   !> Problem
   class(subdomain_body), intent(in) :: self
   !> State
   type(field_state), intent(in) :: state
   !> Mismatch [-]
   real(wp), allocatable, intent(out) :: mismatch

   mismatch = own_work_mismatch(self, state)
end subroutine compare_works

end module rk_subdomain_body
