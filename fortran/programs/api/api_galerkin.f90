!> Parts of a Galerkin problem, of which reduced models are made: integration points with their
!> tissues and pressures, gradients of displacements, places of probes, what loads prescribe. Sizes
!> come first.

!> Integration points, groups, surface points, tissues of all points together, tissues
subroutine galerkin_sizes(handle, sizes, stat, message)
   use rk_galerkin, only : galerkin_problem
   use rk_handles, only : look_up
   use rk_precision, only : wp
   implicit none
   integer, intent(in) :: handle
   integer, intent(out) :: sizes(5), stat
   character(len=2048), intent(out) :: message
   type(galerkin_problem), pointer :: full
   integer, allocatable :: tissue(:)
   real(wp), allocatable :: fraction(:), fiber(:, :)
   integer :: nc, q

   sizes = 0
   call look_up(handle, full, stat, message)
   if (stat /= 0) return
   nc = size(full%scene%cloud%points, 2)
   sizes = [size(full%cells%weight), size(full%cells%first) - 1, size(full%cells%set), 0, &
      & size(full%scene%tissue)]
   do q = 1, sizes(1)
      call full%mixture%parts(nc + q, tissue, fraction, fiber)
      sizes(4) = sizes(4) + size(tissue)
   end do
end subroutine galerkin_sizes

!> Boundary sets of the probes, 0 of those at points
subroutine galerkin_probe_sets(handle, n, sets, stat, message)
   use rk_galerkin, only : galerkin_problem
   use rk_handles, only : look_up
   implicit none
   integer, intent(in) :: handle, n
   integer, intent(out) :: sets(n), stat
   character(len=2048), intent(out) :: message
   type(galerkin_problem), pointer :: full
   integer :: k

   sets = 0
   call look_up(handle, full, stat, message)
   if (stat /= 0) return
   do k = 1, min(n, size(full%scene%probe))
      sets(k) = full%scene%probe(k)%set
   end do
end subroutine galerkin_probe_sets

!> Volumes; points before each group; bulk moduli at points and of groups; number, values and
!> integrals of the groups' polynomials; set, prescribed components and penalty of surface points
subroutine galerkin_cells(handle, nd, np, ng, ms, weight, first, local_bulk, bulk, count, basis, &
   & total, set, essential, penalty, stat, message)
   use rk_galerkin, only : galerkin_problem
   use rk_handles, only : look_up
   implicit none
   integer, intent(in) :: handle, nd, np, ng, ms
   double precision, intent(out) :: weight(np), local_bulk(np), bulk(ng), basis(nd + 1, np)
   double precision, intent(out) :: total(nd + 1, ng), penalty(ms)
   integer, intent(out) :: first(ng + 1), count(ng), set(ms), essential(nd, ms), stat
   character(len=2048), intent(out) :: message
   type(galerkin_problem), pointer :: full
   integer :: nc

   weight = 0; local_bulk = 0; bulk = 0; basis = 0; total = 0; penalty = 0
   first = 0; count = 0; set = 0; essential = 0
   call look_up(handle, full, stat, message)
   if (stat /= 0) return
   nc = size(full%scene%cloud%points, 2)
   weight = full%cells%weight
   first = full%cells%first
   local_bulk = full%local_bulk(nc + 1:)
   bulk = full%bulk
   count = full%pressure%count
   basis = full%pressure%basis
   total = full%pressure%total
   set = full%cells%set
   essential = merge(1, 0, full%surface%essential)
   penalty = full%surface%penalty
end subroutine galerkin_cells

!> Tissues of the points: those before each point, tissue, fraction and fiber of each entry
subroutine galerkin_tissues(handle, np, ne, first, tissue, fraction, fiber, stat, message)
   use rk_galerkin, only : galerkin_problem
   use rk_handles, only : look_up
   use rk_precision, only : wp
   implicit none
   integer, intent(in) :: handle, np, ne
   double precision, intent(out) :: fraction(ne), fiber(3, ne)
   integer, intent(out) :: first(np + 1), tissue(ne), stat
   character(len=2048), intent(out) :: message
   type(galerkin_problem), pointer :: full
   integer, allocatable :: of(:)
   real(wp), allocatable :: part(:), along(:, :)
   integer :: nc, q

   first = 0; tissue = 0; fraction = 0; fiber = 0
   call look_up(handle, full, stat, message)
   if (stat /= 0) return
   nc = size(full%scene%cloud%points, 2)
   do q = 1, np
      call full%mixture%parts(nc + q, of, part, along)
      first(q + 1) = first(q) + size(of)
      tissue(first(q) + 1:first(q + 1)) = of
      fraction(first(q) + 1:first(q + 1)) = part
      fiber(:, first(q) + 1:first(q + 1)) = along
   end do
end subroutine galerkin_tissues

!> Laws of the tissues: A10, A01, A20, A11, A02, A30, A21, A12, A03; lambda_o, gamma1, gamma2,
!> whether the curves are smooth (1) and the axis about which `fiber_angle` turns fibers; whether
!> there are fibers, largest isometric stress and activation at full load
subroutine galerkin_laws(handle, nt, a, fibers, state, stat, message)
   use rk_energies, only : muscle_type, polynomial_type
   use rk_error, only : err_input, error_type, fatal_error
   use rk_galerkin, only : galerkin_problem
   use rk_handles, only : look_up
   use rk_pack, only : pack_error
   implicit none
   integer, intent(in) :: handle, nt
   double precision, intent(out) :: a(9, nt), fibers(7, nt), state(3, nt)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(galerkin_problem), pointer :: full
   integer :: t

   a = 0; state = 0
   fibers = spread([1d0, 0d0, 1d0, 1d0, 0d0, 1d0, 0d0], 2, nt)
   call look_up(handle, full, stat, message)
   if (stat /= 0) return
   ! from the last axis towards x
   if (full%gradient%nd == 2) fibers(5:, :) = spread([0d0, 0d0, -1d0], 2, nt)
   do t = 1, nt
      associate (tissue => full%scene%tissue(t))
         select type (law => tissue%material)
         class is (polynomial_type)
            a(:, t) = [law%a(1, 0), law%a(0, 1), law%a(2, 0), law%a(1, 1), law%a(0, 2), &
               & law%a(3, 0), law%a(2, 1), law%a(1, 2), law%a(0, 3)]
         class default
            call fatal_error(error, err_input, "material '"//tissue%name &
               & //"': reduced models support polynomial energies and muscle")
         end select
         select type (law => tissue%material)
         class is (muscle_type)
            fibers(:4, t) = [law%lambda_o, law%gamma1, law%gamma2, merge(0d0, 1d0, law%kinked)]
            state(:, t) = [1d0, law%sigma_max, tissue%activation]
         end select
      end associate
   end do
   call pack_error(error, stat, message)
end subroutine galerkin_laws

!> Displacement gradients u_i,A at the integration points, A running first, of displacements by
!> their coefficients
subroutine galerkin_gradients(handle, n, np, k, x, gradient, stat, message)
   use rk_galerkin, only : galerkin_problem
   use rk_handles, only : look_up
   use rk_precision, only : wp
   implicit none
   !f2py threadsafe
   integer, intent(in) :: handle, n, np, k
   double precision, intent(in) :: x(n, k)
   double precision, intent(out) :: gradient(9, np, k)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(galerkin_problem), pointer :: full
   real(wp), allocatable :: u(:, :)
   real(wp) :: h(3, 3), none(0)
   integer :: g, j, nd, q

   gradient = 0
   call look_up(handle, full, stat, message)
   if (stat /= 0) return
   nd = full%gradient%nd
   do g = 1, size(full%cells%first) - 1
      associate (member => full%gradient%member%index(full%gradient%member%offset(g) + 1: &
         & full%gradient%member%offset(g + 1)))
         do j = 1, k
            u = reshape(x(:, j), [nd, n/nd])
            u = u(:, member)
            do q = full%cells%first(g) + 1, full%cells%first(g + 1)
               h = 0
               call full%gradient%at(q, u, none, h(:nd, :nd))
               gradient(:, q, j) = reshape(transpose(h), [9])
            end do
         end do
      end associate
   end do
end subroutine galerkin_gradients

!> What the scene prescribes at full load: displacements of surface points, forces of their
!> tractions, gradients u_i,A that the displacements make, A running first, forces on the unknowns
subroutine galerkin_loads(handle, nd, n, np, ms, value, push, given, force, stat, message)
   use rk_galerkin, only : galerkin_problem
   use rk_handles, only : look_up
   use rk_precision, only : wp
   implicit none
   integer, intent(in) :: handle, nd, n, np, ms
   double precision, intent(out) :: value(nd, ms), push(nd, ms), given(9, np), force(n)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(galerkin_problem), pointer :: full
   real(wp), allocatable :: factor(:)
   real(wp) :: h(3, 3)
   integer :: a, q

   value = 0; push = 0; given = 0; force = 0
   call look_up(handle, full, stat, message)
   if (stat /= 0) return
   factor = full%scene%factors(1.0_wp)
   force = matmul(full%force, factor)
   do a = 1, size(factor)
      value = value + factor(a)*full%surface%value(a, :, :)
      push = push + factor(a)*full%surface%traction(a, :, :)*spread(full%surface%bearing, 1, nd)
      do q = 1, np
         h = 0
         h(:nd, :nd) = factor(a)*full%gradient%given(:, :, q, a)
         given(:, q) = given(:, q) + reshape(transpose(h), [9])
      end do
   end do
end subroutine galerkin_loads

!> What penalty and stabilisation make of displacements, and their product with the mass of density
!> one
subroutine galerkin_products(handle, n, k, x, stiff, mass, stat, message)
   use rk_galerkin, only : galerkin_problem
   use rk_handles, only : look_up
   use rk_precision, only : wp
   implicit none
   !f2py threadsafe
   integer, intent(in) :: handle, n, k
   double precision, intent(in) :: x(n, k)
   double precision, intent(out) :: stiff(n, k), mass(n, k)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(galerkin_problem), pointer :: full
   real(wp), pointer, contiguous :: psi(:, :)
   integer, pointer, contiguous :: nodes(:)
   real(wp), allocatable :: u(:, :)
   integer :: i, j, l, nd, q

   stiff = 0; mass = 0
   call look_up(handle, full, stat, message)
   if (stat /= 0) return
   nd = full%gradient%nd
   do j = 1, k
      call full%matrix%constant_product(full%constant, x(:, j), stiff(:, j))
   end do
   allocate (u(nd, k))
   do q = 1, size(full%cells%weight)
      call full%inside%row(q, nodes, psi)
      u = 0
      do l = 1, size(nodes)
         do i = 1, nd
            u(i, :) = u(i, :) + psi(1, l)*x(nd*(nodes(l) - 1) + i, :)
         end do
      end do
      do l = 1, size(nodes)
         do i = 1, nd
            associate (row => nd*(nodes(l) - 1) + i)
               mass(row, :) = mass(row, :) + full%cells%weight(q)*psi(1, l)*u(i, :)
            end associate
         end do
      end do
   end do
end subroutine galerkin_products

!> Displacement gradients u_i,A, A running first, of displacements by their coefficients, or, where
!> these are smoothed over cells, weights of those at the integration points; weights of the
!> pressures' coefficients; part of the bulk modulus that acts at the place; tissues there; on a
!> free face the gradients along it, its normal and the bulk modulus
subroutine galerkin_place(handle, probe, n, k, np, nd, ng, nt, x, gradient, weight, pressure, &
   & local_bulk, count, tissue, fraction, fiber, face, normal, bulk, stat, message)
   use rk_error, only : error_type
   use rk_galerkin, only : galerkin_problem
   use rk_handles, only : look_up
   use rk_pack, only : pack_error
   use rk_precision, only : wp
   use rk_shape, only : shape_type
   implicit none
   integer, intent(in) :: handle, probe, n, k, np, nd, ng, nt
   double precision, intent(in) :: x(n, k)
   double precision, intent(out) :: gradient(9, k), weight(np), pressure(nd + 1, ng), local_bulk
   integer, intent(out) :: count, tissue(nt)
   double precision, intent(out) :: fraction(nt), fiber(3, nt), face(9, k)
   double precision, intent(out) :: normal(3), bulk
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(galerkin_problem), pointer :: full
   type(shape_type) :: shape
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   real(wp), allocatable :: part(:), along(:, :), u(:, :), one(:, :)
   integer, allocatable :: of(:)
   real(wp) :: place(nd, 1), h(3, 3)
   integer :: b, at, g, ip, j

   gradient = 0; weight = 0; pressure = 0; local_bulk = 0; face = 0; normal = 0; bulk = 0
   count = 0; tissue = 0; fraction = 0; fiber = 0
   call look_up(handle, full, stat, message)
   if (stat /= 0) return
   place(:, 1) = full%scene%probe(probe)%point(:nd)
   ip = minloc(sum((full%scene%cloud%points - spread(place(:, 1), 2, &
      & size(full%scene%cloud%points, 2)))**2, dim=1), dim=1)
   at = 0
   if (allocated(full%faces)) at = full%faces%find(full%scene, ip, place(:, 1))
   if (at > 0) normal = full%faces%normal(:, at)
   if (at > 0) bulk = full%mixture%bulk(ip)
   if (full%cells%smoothed) then
      call full%recovery%row(ip, place(:, 1), nodes, values)
      weight(nodes) = values(1, :size(nodes))
      local_bulk = full%local_bulk(ip)
   else
      call full%scene%shape_at(place, shape, error, first=.true.)
      call pack_error(error, stat, message)
      if (stat /= 0) return
      allocate (u(nd, shape%nq))
      do j = 1, k
         call shape%interpolate(1, x(:, j), 2, 1 + nd, u)
         h = 0
         h(:nd, :nd) = u(:, 2:1 + nd)
         gradient(:, j) = reshape(transpose(h), [9])
         if (at > 0) call full%faces%smooth(at, x(:, j), h)
         if (at > 0) face(:, j) = reshape(transpose(h), [9])
      end do
   end if
   allocate (one(nd + 1, ng), source=0.0_wp)
   do g = 1, ng
      do b = 1, full%pressure%count(g)
         one(b, g) = 1
         pressure(b, g) = full%pressure%at(ip, place(:, 1), one)
         one(b, g) = 0
      end do
   end do
   call full%mixture%parts(ip, of, part, along)
   count = size(of)
   tissue(:count) = of
   fraction(:count) = part
   fiber(:, :count) = along
end subroutine galerkin_place
