!> Questions about a Galerkin problem for building reduced models: integration points with their
!> tissues and pressures, gradients of displacements, positions of probes, prescribed loads.
module rk_galerkin_questions
   use rk_discretisation, only : discretisation_type
   use rk_energies, only : muscle_type, polynomial_type
   use rk_error, only : err_input, error_type, fatal_error
   use rk_galerkin, only : galerkin_problem
   use rk_handles, only : answer_type
   use rk_precision, only : wp
   use rk_shape, only : shape_type
   use rk_weak_conditions, only : add_load
   implicit none
   private

   public :: ask_galerkin

contains

subroutine ask_galerkin(problem, question, given, answer, error)
   class(discretisation_type), target, intent(in) :: problem
   character(len=*), intent(in) :: question
   !> Input numbers: displacements by their coefficients, shape (n, k); for a position they follow
   !> the number of its probe
   real(wp), contiguous, intent(in) :: given(:)
   type(answer_type), intent(inout) :: answer
   !> Error handling: another form, K = inf, a law not supported by reduced models
   type(error_type), allocatable, intent(out) :: error

   select type (problem)
   type is (galerkin_problem)
      if (problem%linear) then
         call fatal_error(error, err_input, 'only nonlinear problems have trained reduced models')
      else if (problem%multiplier%extra > 0) then
         call fatal_error(error, err_input, 'a trained reduced model needs finite bulk ' &
            & //'moduli; use K = 1e3 times the shear modulus instead of inf')
      end if
      if (allocated(error)) return
      select case (question)
      case ('cells')
         call answer_cells(problem, answer)
      case ('laws')
         call answer_laws(problem, answer, error)
      case ('gradients')
         call answer_gradients(problem, reshape(given, [problem%n, size(given)/problem%n]), answer)
      case ('loads')
         call answer_loads(problem, answer)
      case ('products')
         call answer_products(problem, reshape(given, [problem%n, size(given)/problem%n]), answer)
      case ('place')
         call answer_place(problem, nint(given(1)), reshape(given(2:), &
            & [problem%n, size(given)/problem%n]), answer, error)
      end select
   class default
      call fatal_error(error, err_input, 'a trained reduced model needs one of the Galerkin ' &
         & //'forms: method "rkpm-gauss" or "rkpm-scni"')
   end select
end subroutine ask_galerkin

!> Volumes and bulk moduli of integration points; number of points before each group, its bulk
!> modulus; number, values and integrals of the groups' polynomials; set, prescribed components and
!> penalty of surface points; sets of the probes, 0 for those at points; tissues of the points:
!> entries before each point, tissue, fraction and fiber of each entry
subroutine answer_cells(full, answer)
   type(galerkin_problem), intent(in) :: full
   type(answer_type), intent(inout) :: answer
   integer, allocatable :: of(:), tissue(:), first(:)
   real(wp), allocatable :: part(:), along(:, :), fraction(:), fiber(:, :)
   integer :: nc, q

   associate (cells => full%cells, pressure => full%pressure, surface => full%surface)
      nc = size(full%scene%cloud%points, 2)
      allocate (first(size(cells%weight) + 1), source=0)
      do q = 1, size(cells%weight)
         call full%mixture%parts(nc + q, of, part, along)
         first(q + 1) = first(q) + size(of)
      end do
      allocate (tissue(first(q)), fraction(first(q)), fiber(3, first(q)))
      do q = 1, size(cells%weight)
         call full%mixture%parts(nc + q, of, part, along)
         tissue(first(q) + 1:first(q + 1)) = of
         fraction(first(q) + 1:first(q + 1)) = part
         fiber(:, first(q) + 1:first(q + 1)) = along
      end do
      call answer%put('weight', shape(cells%weight), cells%weight)
      call answer%put('local_bulk', shape(cells%weight), full%local_bulk(nc + 1:))
      call answer%put_whole('group', shape(cells%first), cells%first)
      call answer%put('bulk', shape(full%bulk), full%bulk)
      call answer%put_whole('polynomials', shape(pressure%count), pressure%count)
      call answer%put('basis', shape(pressure%basis), pressure%basis)
      call answer%put('total', shape(pressure%total), pressure%total)
      call answer%put_whole('set', shape(cells%set), cells%set)
      call answer%put_whole('probe_sets', shape(full%scene%probe), full%scene%probe%set)
      call answer%put_whole('essential', shape(surface%essential), merge(1, 0, surface%essential))
      call answer%put('penalty', shape(surface%penalty), surface%penalty)
      call answer%put_whole('first', shape(first), first)
      call answer%put_whole('tissue', shape(tissue), tissue - 1)
      call answer%put('fraction', shape(fraction), fraction)
      call answer%put('fiber', shape(fiber), fiber)
   end associate
end subroutine answer_cells

!> Laws of the tissues: A10, A01, A20, A11, A02, A30, A21, A12, A03; lambda_o, gamma1, gamma2,
!> whether the curves are smooth (1) and the axis about which `fiber_angle` turns fibers; whether
!> there are fibers, largest isometric stress and activation at full load
subroutine answer_laws(full, answer, error)
   type(galerkin_problem), intent(in) :: full
   type(answer_type), intent(inout) :: answer
   !> Error handling: a law other than a polynomial with fibers
   type(error_type), allocatable, intent(out) :: error
   real(wp), dimension(9, size(full%scene%tissue)) :: a
   real(wp) :: fibers(7, size(a, 2)), state(3, size(a, 2))
   integer :: t

   a = 0
   state = 0
   fibers = spread([1.0_wp, 0.0_wp, 1.0_wp, 1.0_wp, 0.0_wp, 1.0_wp, 0.0_wp], 2, size(a, 2))
   ! from the last axis towards x
   if (full%gradient%nd == 2) fibers(5:, :) = spread([0.0_wp, 0.0_wp, -1.0_wp], 2, size(a, 2))
   do t = 1, size(a, 2)
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
            fibers(:4, t) = [law%lambda_o, law%gamma1, law%gamma2, &
               & merge(0.0_wp, 1.0_wp, law%kinked)]
            state(:, t) = [1.0_wp, law%sigma_max, full%scene%activation_at(t, 1.0_wp)]
         end select
      end associate
   end do
   call answer%put('coefficients', shape(a), a)
   call answer%put('fibers', shape(fibers), fibers)
   call answer%put('state', shape(state), state)
end subroutine answer_laws

!> Displacement gradients u_i,A at the integration points, index A running first
subroutine answer_gradients(full, x, answer)
   type(galerkin_problem), intent(in) :: full
   !> Displacements by their coefficients, shape (n, k)
   real(wp), intent(in) :: x(:, :)
   type(answer_type), intent(inout) :: answer
   real(wp), allocatable :: u(:, :), gradient(:, :, :)
   real(wp) :: h(full%gradient%nd, full%gradient%nd), none(0)
   integer :: g, j, nd, q

   nd = full%gradient%nd
   allocate (gradient(9, size(full%cells%weight), size(x, 2)))
   do g = 1, size(full%cells%first) - 1
      associate (member => full%gradient%member%index(full%gradient%member%offset(g) + 1: &
         & full%gradient%member%offset(g + 1)))
         do j = 1, size(x, 2)
            u = reshape(x(:, j), [nd, size(x, 1)/nd])
            u = u(:, member)
            do q = full%cells%first(g) + 1, full%cells%first(g + 1)
               call full%gradient%at(q, u, none, h)
               gradient(:, q, j) = row_by_row(h)
            end do
         end do
      end associate
   end do
   call answer%put('gradient', shape(gradient), gradient)
end subroutine answer_gradients

!> Prescribed values at full load: displacements of surface points, forces of their tractions,
!> gradients u_i,A due to the displacements, A running first, forces on the unknowns
subroutine answer_loads(full, answer)
   type(galerkin_problem), intent(in) :: full
   type(answer_type), intent(inout) :: answer
   real(wp) :: factor(full%scene%programme%count())
   real(wp), allocatable :: value(:, :), push(:, :), given(:, :)
   integer :: a, nd, q

   nd = full%gradient%nd
   factor = full%scene%factors(1.0_wp)
   allocate (value(nd, size(full%cells%set)), push(nd, size(full%cells%set)), &
      & given(9, size(full%cells%weight)), source=0.0_wp)
   do a = 1, size(factor)
      value = value + factor(a)*full%surface%value(a, :, :)
      push = push + factor(a)*full%surface%traction(a, :, :)*spread(full%surface%bearing, 1, nd)
      do q = 1, size(given, 2)
         given(:, q) = given(:, q) + row_by_row(factor(a)*full%gradient%given(:, :, q, a))
      end do
   end do
   call answer%put('value', shape(value), value)
   call answer%put('push', shape(push), push)
   call answer%put('given', shape(given), given)
   call answer%put('force', [full%n], matmul(full%force, factor))
end subroutine answer_loads

!> Forces of penalty and stabilisation for given displacements, and the displacements times the mass
!> matrix of unit density
subroutine answer_products(full, x, answer)
   type(galerkin_problem), intent(in) :: full
   real(wp), contiguous, intent(in) :: x(:, :)
   type(answer_type), intent(inout) :: answer
   real(wp) :: u(full%gradient%nd, full%inside%np), field(full%gradient%nd, full%inside%nq)
   real(wp), allocatable :: stiff(:, :), mass(:, :)
   integer :: j, q

   allocate (stiff(size(x, 1), size(x, 2)), mass(size(x, 1), size(x, 2)), source=0.0_wp)
   do j = 1, size(x, 2)
      call full%constant_product(x(:, j), stiff(:, j))
      do q = 1, size(u, 2)
         call full%inside%interpolate(q, x(:, j), 1, 1, field)
         u(:, q) = field(:, 1)
      end do
      ! inertia forces of this acceleration
      call add_load(full%inside, full%cells%weight, u, mass(:, j))
   end do
   call answer%put('stiff', shape(stiff), stiff)
   call answer%put('mass', shape(mass), mass)
end subroutine answer_products

!> Displacement gradients u_i,A, index A running first, at the position of a probe, or, where these
!> are smoothed over cells, weights of those at the integration points; weights of the pressures'
!> coefficients; part of the bulk modulus that acts at the position; tissues there; on a free face
!> the gradients along it, its normal and the bulk modulus
subroutine answer_place(full, probe, x, answer, error)
   type(galerkin_problem), intent(in) :: full
   integer, intent(in) :: probe
   real(wp), contiguous, intent(in) :: x(:, :)
   type(answer_type), intent(inout) :: answer
   !> Error handling: a position without shape functions
   type(error_type), allocatable, intent(out) :: error
   type(shape_type) :: shape_there
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   real(wp), allocatable :: bend(:, :, :), fraction(:), fiber(:, :), u(:, :)
   integer, allocatable :: tissue(:)
   real(wp), dimension(9, size(x, 2)) :: gradient, face
   real(wp), dimension(full%gradient%nd + 1, size(full%cells%first) - 1) :: one, pressure
   real(wp) :: weight(size(full%cells%weight)), normal(3), bulk, local_bulk
   real(wp) :: place(full%gradient%nd, 1), h(3, 3)
   integer :: b, at, g, ip, j, nd

   gradient = 0
   face = 0
   one = 0
   pressure = 0
   weight = 0
   normal = 0
   bulk = 0
   local_bulk = 0
   nd = full%gradient%nd
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
      call full%scene%shape_at(place, shape_there, error, first=.true.)
      if (allocated(error)) return
      allocate (u(nd, shape_there%nq))
      do j = 1, size(x, 2)
         call shape_there%interpolate(1, x(:, j), 2, 1 + nd, u)
         h = 0
         h(:nd, :nd) = u(:, 2:1 + nd)
         gradient(:, j) = row_by_row(h)
         if (at > 0) call full%faces%smooth(at, x(:, j), h)
         if (at > 0) face(:, j) = row_by_row(h)
      end do
   end if
   do g = 1, size(one, 2)
      do b = 1, full%pressure%count(g)
         one(b, g) = 1
         if (allocated(full%pressure%share)) bend = full%pressure%bends(one)
         pressure(b, g) = full%pressure%at(ip, place(:, 1), one, bend)
         one(b, g) = 0
      end do
   end do
   call full%mixture%parts(full%material_at(ip, place(:, 1)), tissue, fraction, fiber)
   call answer%put('gradient', shape(gradient), gradient)
   call answer%put('weight', shape(weight), weight)
   call answer%put('pressure', shape(pressure), pressure)
   call answer%put('local_bulk', [integer ::], [local_bulk])
   call answer%put_whole('tissue', shape(tissue), tissue - 1)
   call answer%put('fraction', shape(fraction), fraction)
   call answer%put('fiber', shape(fiber), fiber)
   call answer%put('face', shape(face), face)
   call answer%put('normal', shape(normal), normal)
   call answer%put('bulk', [integer ::], [bulk])
end subroutine answer_place

!> Components u_i,A of a gradient, index A running first, zero beyond the space dimension
pure function row_by_row(h) result(flat)
   !> Gradient, shape (nd, nd)
   real(wp), intent(in) :: h(:, :)
   real(wp) :: flat(9), full(3, 3)

   full = 0
   full(:size(h, 1), :size(h, 2)) = h
   flat = reshape(transpose(full), [9])
end function row_by_row

end module rk_galerkin_questions
