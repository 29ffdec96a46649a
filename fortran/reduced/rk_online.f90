!> States of a Galerkin reduced model in microseconds: Newton's iteration in the amplitudes of
!> modes, with a sample of the cells and the volume of all groups.
!>
!> Amplitudes z: those of the modes, unknown, then those of prescribed values. At a cell
!> F = 1 + sum z_k H_k, whose index is i + 3 (A - 1) for F_iA. The energy has three parts:
!>   - that of the cells, at a sample of them with separate weights;
!>   - K/2 times the squared changes of volume of the groups. Volume is cubic in F, so that these
!>     are T[(1,z), (1,z), (1,z)] with a constant tensor, which includes all cells. Groups formed
!>     from sampled cells alone do not give a solution;
!>   - penalty and stabilisation, a constant matrix.
!> Newton's pressures are linear in the step, as in the full problem (rk_pressure).
!>
!> States run side by side in threads; the products of each are small, and BLAS is called for them
!> on one thread.
!>
!> Reference: Farhat, Chapman, Avery, Int. J. Numer. Meth. Engng 102 (2015),
!>            doi:10.1002/nme.4820 (cells with weights that keep the energy)
module rk_online
   use, intrinsic :: iso_c_binding, only : c_double, c_int
   use rk_blas, only : dgemm, dgemv, dgesv
   use rk_energies, only : muscle_type
   use rk_fiber, only : active_curve, passive_curve
   use rk_material, only : kind_i2, material_point
   use rk_precision, only : wp
   use rk_tensor, only : determinant
   implicit none
   private

   public :: online_model, work_type, new_work, assemble, solve_state, follow, find_forces, &
      & new_online

   !> A reduced model; arrays belong to the caller
   type :: online_model
      !> Modes; all amplitudes
      integer :: r = 0, s = 0
      !> Size of the modes' amplitudes below which they are zero: at rest no step is small [length]
      real(wp) :: least = tiny(1.0_wp)
      !> Displacement gradients of the amplitudes at the cells, shape (s, 9, nc) [1/length]
      real(wp), pointer, contiguous :: h(:, :, :) => null()
      !> Volume times weight of each cell, shape (nc) [length^nd]
      real(wp), pointer, contiguous :: weight(:) => null()
      !> Local bulk modulus of each cell, shape (nc) [stress]
      real(wp), pointer, contiguous :: local_bulk(:) => null()
      !> Coefficients of the polynomial, shape (9, nc) [stress]
      real(wp), pointer, contiguous :: a(:, :) => null()
      !> Fibers of cell q are entries first(q)+1 .. first(q+1), shape (nc + 1)
      integer, pointer, contiguous :: first(:) => null()
      !> Their tissue, fraction and direction, shapes (ne), (ne), (3, ne)
      integer, pointer, contiguous :: tissue(:) => null()
      real(wp), pointer, contiguous :: fraction(:) => null(), fiber(:, :) => null()
      !> Fibers of the tissues, and the unit axes about which they are rotated, shape (3, nt) [-]
      type(muscle_type), allocatable :: laws(:)
      real(wp), allocatable :: axis(:, :)
      !> Penalty and stabilisation, shape (s, s) [force/length]
      real(wp), pointer, contiguous :: constant(:, :) => null()
      !> Changes of volume, in roots of energy, in pieces of 8 directions: symmetric in three
      !> indices 0..s, entries of l <= m <= n with l fastest, shape (8, triples, pieces)
      real(wp), pointer, contiguous :: volume(:, :, :) => null()
      !> Derivatives with respect to material parameters: of the polynomial's coefficients, shape
      !> (9, nc, nm), of the local bulk modulus of each cell, shape (nc, nm), of `constant`, shape
      !> (s, s, nm), and of the factor on the energy of volume in each piece, shape (pieces, nm)
      real(wp), pointer, contiguous :: a_slope(:, :, :) => null(), bulk_slope(:, :) => null()
      real(wp), pointer, contiguous :: constant_slope(:, :, :) => null()
      real(wp), pointer, contiguous :: volume_slope(:, :) => null()
   end type online_model

   !> Workspace for one state at a time
   type :: work_type
      !> Laws of the tissues, which take the parameters of one cell after the other
      type(muscle_type), allocatable :: laws(:)
      !> F, or stresses times weight, shape (3, 3, nc)
      real(wp), allocatable :: f(:, :, :)
      !> Stresses of the amplitudes in a block of cells, shape (s, 9, block)
      real(wp), allocatable :: image(:, :, :)
      !> Residual, tangent, its factor with the row interchanges, step
      real(wp), allocatable :: residual(:), tangent(:, :), factor(:, :), step(:)
      integer, allocatable :: pivot(:)
      !> Volume: pairs of the form, changes, those linear in the step, their derivatives,
      !> shapes (8, pairs + 1), (8, pieces), (8, pieces), (8, s, pieces)
      real(wp), allocatable :: pairs(:, :), y(:, :), along(:, :), dy(:, :, :)
      !> Smallest J
      real(wp) :: min_j = 0.0_wp
   end type work_type

   interface
      subroutine online_volume(pieces, s, t, z, scale, tangent, restart, along, y, dy, pair, &
         & force, stiffness) bind(c, name='rk_online_volume')
         import :: c_double, c_int
         integer(c_int), value :: pieces, s, tangent, restart
         real(c_double), intent(in) :: t(*), z(*), scale(*)
         real(c_double), intent(inout) :: along(*), y(*), dy(*), pair(*), force(*), stiffness(*)
      end subroutine online_volume
   end interface

   !> Number of cells whose stresses are summed at a time: they stay in the cache
   integer, parameter :: block = 8
   !> A step is rejected if its smallest J is below a floor and below this share of the one before
   !> [-]
   real(wp), parameter :: j_share = 0.2_wp, j_floor = 0.02_wp

contains

!> Model of a record
subroutine new_online(self, whole, number, least)
   !> Model, whose arrays are those of the record
   type(online_model), intent(out) :: self
   !> Sizes: modes, amplitudes, cells, fibers, pieces and entries of the volume, tissues,
   !> parameters; then `first` and `tissue`
   integer, target, contiguous, intent(in) :: whole(:)
   !> The other arrays in the order of the model, and for each tissue lambda_o, gamma1, gamma2,
   !> whether the curves are smooth (1) and the axis about which fibers rotate
   real(wp), target, contiguous, intent(in) :: number(:)
   !> Size of the modes' amplitudes below which they count as zero [length]
   real(wp), intent(in) :: least
   real(wp), pointer, contiguous :: law(:, :)
   integer :: e, o

   self%r = whole(1)
   self%s = whole(2)
   self%least = least
   associate (s => whole(2), nc => whole(3), ne => whole(4), pieces => whole(5), &
      & triples => whole(6), nt => whole(7), nm => whole(8))
      self%first(1:nc + 1) => whole(9:9 + nc)
      self%tissue(1:ne) => whole(10 + nc:9 + nc + ne)
      o = 0
      self%h(1:s, 1:9, 1:nc) => next(s*9*nc)
      self%weight(1:nc) => next(nc)
      self%local_bulk(1:nc) => next(nc)
      self%a(1:9, 1:nc) => next(9*nc)
      self%fraction(1:ne) => next(ne)
      self%fiber(1:3, 1:ne) => next(3*ne)
      self%a_slope(1:9, 1:nc, 1:nm) => next(9*nc*nm)
      self%bulk_slope(1:nc, 1:nm) => next(nc*nm)
      self%constant(1:s, 1:s) => next(s**2)
      self%constant_slope(1:s, 1:s, 1:nm) => next(s**2*nm)
      self%volume(1:8, 1:triples, 1:pieces) => next(8*triples*pieces)
      self%volume_slope(1:pieces, 1:nm) => next(pieces*nm)
      law(1:7, 1:nt) => next(7*nt)
      allocate (self%laws(nt))
      do e = 1, nt
         self%laws(e)%active = .true.
         self%laws(e)%lambda_o = law(1, e)
         self%laws(e)%active_force = active_curve(law(4, e) > 0.5_wp)
         self%laws(e)%passive_force = passive_curve(law(4, e) > 0.5_wp, law(2, e), law(3, e))
      end do
      self%axis = law(5:7, :)
   end associate

contains

   function next(count) result(part)
      integer, intent(in) :: count
      real(wp), pointer, contiguous :: part(:)

      part => number(o + 1:o + count)
      o = o + count
   end function next

end subroutine new_online

!> Workspace for the states of a model
subroutine new_work(self, model)
   type(work_type), intent(out) :: self
   type(online_model), intent(in) :: model
   integer :: pieces, s

   s = model%s
   self%laws = model%laws
   pieces = size(model%volume, 3)
   allocate (self%f(3, 3, size(model%weight)), self%image(s, 9, block))
   allocate (self%residual(s), self%tangent(s, s))
   allocate (self%factor(model%r, model%r), self%step(model%r), self%pivot(model%r))
   allocate (self%pairs(8, (s + 1)*(s + 2)/2 + 1), self%y(8, pieces), self%along(8, pieces))
   allocate (self%dy(8, s, pieces))
end subroutine new_work

!> Residual of all amplitudes and, where wanted, its derivatives
subroutine assemble(model, work, z, wish, tangent, restart)
   type(online_model), intent(in) :: model
   !> Workspace, of which residual, tangent and smallest J are set
   type(work_type), intent(inout) :: work
   !> Amplitudes, shape (s)
   real(wp), contiguous, intent(in) :: z(:)
   !> Requested values: for each tissue activation [-], largest isometric stress [stress] and angle
   !> [rad] by which the fibers are rotated about its axis; parameters of the materials less their
   !> values in the model, prescribed amplitudes, shape (3 nt + nm + s - r)
   real(wp), intent(in) :: wish(:)
   !> Derivatives too
   logical, intent(in) :: tangent
   !> The pressures are those of this state; otherwise those linear in the last step
   logical, intent(in) :: restart

   real(wp) :: one(0:model%s), scale(size(model%volume, 3))
   integer :: i, k, nm, nt

   nt = size(model%laws)
   nm = size(model%bulk_slope, 2)
   call assemble_cells(model, work, z, wish(:nt), wish(nt + 1:2*nt), wish(2*nt + 1:3*nt), &
      & wish(3*nt + 1:3*nt + nm), tangent)
   work%residual = work%residual + matmul(model%constant, z)
   do i = 1, nm
      if (.not. abs(wish(3*nt + i)) > 0.0_wp) cycle
      work%residual = work%residual + wish(3*nt + i)*matmul(model%constant_slope(:, :, i), z)
   end do
   scale = 1.0_wp + matmul(model%volume_slope, wish(3*nt + 1:3*nt + nm))
   one(0) = 1.0_wp
   one(1:) = z
   call online_volume(size(scale), model%s, model%volume, one, scale, merge(1, 0, tangent), &
      & merge(1, 0, restart), work%along, work%y, work%dy, work%pairs, work%residual, work%tangent)
   if (.not. tangent) return
   do k = 1, model%s
      work%tangent(:k, k) = work%tangent(:k, k) + model%constant(:k, k)
      do i = 1, nm
         work%tangent(:k, k) = work%tangent(:k, k) + wish(3*nt + i)*model%constant_slope(:k, k, i)
      end do
      work%tangent(k, :k - 1) = work%tangent(:k - 1, k)
   end do
end subroutine assemble

!> Part of the cells in residual and tangent
subroutine assemble_cells(model, work, z, activation, sigma_max, turn, modulus, tangent)
   type(online_model), intent(in) :: model
   type(work_type), intent(inout) :: work
   !> Amplitudes, and the parts of the requested values
   real(wp), contiguous, intent(in) :: z(:)
   real(wp), intent(in) :: activation(:), sigma_max(:), turn(:), modulus(:)
   logical, intent(in) :: tangent
   real(wp) :: j, p(3, 3), c(3, 3, 3, 3), a(9), bulk, turned(3, 3, size(turn))
   ! a cell has at most one fiber per tissue
   real(wp) :: fiber(3, size(turn)), sigma(size(turn))
   integer :: e, k, l, n, o, q

   do e = 1, size(turn)
      turned(:, :, e) = rotation(model%axis(:, e), turn(e))
   end do
   work%f = 0.0_wp
   do k = 1, 3
      work%f(k, k, :) = 1.0_wp
   end do
   call dgemv('t', model%s, size(work%f), 1.0_wp, model%h, model%s, z, 1, 1.0_wp, work%f, 1)
   work%min_j = huge(1.0_wp)
   work%residual = 0.0_wp
   if (tangent) work%tangent = 0.0_wp
   do o = 0, size(model%weight) - 1, block
      n = min(block, size(model%weight) - o)
      do q = o + 1, o + n
         l = model%first(q + 1) - model%first(q)
         associate (first => model%first(q), f => work%f(:, :, q), &
            & tissue => model%tissue(model%first(q) + 1:model%first(q + 1)))
            do e = 1, l
               fiber(:, e) = matmul(turned(:, :, tissue(e)), model%fiber(:, first + e))
               sigma(e) = model%fraction(first + e)*sigma_max(tissue(e))
            end do
            j = determinant(f)
            work%min_j = min(work%min_j, j)
            p = 0.0_wp
            if (tangent) c = 0.0_wp
            if (.not. j > 0.0_wp) then
               continue
            else
               a = model%a(:, q)
               bulk = model%local_bulk(q)
               do k = 1, size(modulus)
                  a = a + modulus(k)*model%a_slope(:, q, k)
                  bulk = bulk + modulus(k)*model%bulk_slope(q, k)
               end do
               call cell_law(work%laws, f, a, bulk, tissue, fiber(:, :l), sigma(:l), activation, &
                  & tangent, p, c)
            end if
         end associate
         work%f(:, :, q) = model%weight(q)*p
         if (tangent) call dgemm('n', 'n', model%s, 9, 9, model%weight(q), model%h(:, :, q), &
            & model%s, c, 9, 0.0_wp, work%image(:, :, q - o), model%s)
      end do
      if (tangent) call dgemm('n', 't', model%s, model%s, 9*n, 1.0_wp, model%h(:, :, o + 1), &
         & model%s, work%image, model%s, 1.0_wp, work%tangent, model%s)
   end do
   call dgemv('n', model%s, size(work%f), 1.0_wp, model%h, model%s, work%f, 1, 1.0_wp, &
      & work%residual, 1)
end subroutine assemble_cells

!> Add stress and tangent of a cell: one polynomial of all its tissues, and the fibers of each
subroutine cell_law(laws, f, a, bulk, tissue, fiber, sigma, activation, tangent, p, c)
   !> Laws of all tissues, which take the parameters
   type(muscle_type), intent(inout) :: laws(:)
   !> F, with a positive determinant [-]
   real(wp), intent(in) :: f(3, 3)
   !> A10, A01, A20, A11, A02, A30, A21, A12, A03 [stress]
   real(wp), intent(in) :: a(9)
   !> Local bulk modulus of the cell [stress]
   real(wp), intent(in) :: bulk
   !> Tissues with fibers in the cell, shape (k)
   integer, intent(in) :: tissue(:)
   !> Their directions, shape (3, k), and largest isometric stress times fraction, shape (k)
   !> [stress]
   real(wp), intent(in) :: fiber(:, :), sigma(:)
   !> Activation of all tissues [-]
   real(wp), intent(in) :: activation(:)
   logical, intent(in) :: tangent
   !> Stress and tangent, to which they are added [stress]
   real(wp), intent(inout) :: p(3, 3), c(3, 3, 3, 3)
   type(material_point) :: at
   real(wp) :: one(3, 3), form(3, 3, 3, 3)
   integer :: e, t

   at%f = f
   t = 1
   do e = 1, max(size(tissue), 1)
      if (size(tissue) > 0) then
         t = tissue(e)
         at%fiber = fiber(:, e)
         at%activation = activation(t)
         laws(t)%sigma_max = sigma(e)
      end if
      if (e == 1) then
         laws(t)%a(1:3, 0) = a([1, 3, 6])
         laws(t)%a(0:2, 1) = a([2, 4, 7])
         laws(t)%a(0:1, 2) = a([5, 8])
         laws(t)%a(0, 3) = a(9)
         laws(t)%bulk = bulk
      else
         laws(t)%a = 0.0_wp
         laws(t)%bulk = 0.0_wp
      end if
      laws(t)%active(kind_i2) = e == 1 .and. any(abs(a([2, 4, 5, 7, 8, 9])) > 0.0_wp)
      if (tangent) then
         call laws(t)%stress(at, one, form)
         c = c + form
      else
         call laws(t)%stress(at, one)
      end if
      p = p + one
   end do
end subroutine cell_law

!> Rotation about a unit axis
pure function rotation(axis, angle) result(q)
   !> Axis [-]
   real(wp), intent(in) :: axis(3)
   !> Angle [rad]
   real(wp), intent(in) :: angle
   !> Rotation [-]
   real(wp) :: q(3, 3)
   integer :: i

   do i = 1, 3
      q(:, i) = (1.0_wp - cos(angle))*axis(i)*axis
      q(i, i) = q(i, i) + cos(angle)
   end do
   q(2:3, 1) = q(2:3, 1) + sin(angle)*[axis(3), -axis(2)]
   q(1:3:2, 2) = q(1:3:2, 2) + sin(angle)*[-axis(3), axis(1)]
   q(1:2, 3) = q(1:2, 3) + sin(angle)*[axis(2), -axis(1)]
end function rotation

!> Newton's iteration from given amplitudes
subroutine solve_state(model, work, wish, tolerance, most_steps, z, iterations, change)
   type(online_model), intent(in) :: model
   type(work_type), intent(inout) :: work
   !> Requested values as in `assemble`
   real(wp), intent(in) :: wish(:)
   !> Relative size of a step at which the iteration stops; 0 for as many iterations as allowed [-]
   real(wp), intent(in) :: tolerance
   !> Largest number of iterations
   integer, intent(in) :: most_steps
   !> Amplitudes, start and answer, shape (s)
   real(wp), intent(inout) :: z(:)
   !> Iterations; negative if it did not converge
   integer, intent(out) :: iterations
   !> Relative size of the last step [-]
   real(wp), intent(out) :: change
   real(wp) :: before(model%r), j_before
   integer :: halvings, info, k
   logical :: restart

   z(model%r + 1:) = wish(size(wish) - model%s + model%r + 1:)
   iterations = 0
   change = huge(1.0_wp)
   j_before = 1.0_wp
   halvings = 0
   restart = .true.
   do
      if (iterations >= most_steps) then
         if (.not. tolerance > 0.0_wp) return
         exit
      end if
      iterations = iterations + 1
      call assemble(model, work, z, wish, .true., restart)
      if (.not. work%min_j > min(j_floor, j_share*j_before)) then
         halvings = halvings + 1
         if (iterations == 1 .or. halvings > 12) exit
         work%step = 0.5_wp*work%step
         z(:model%r) = before + work%step
         restart = .true.
         cycle
      end if
      j_before = work%min_j
      work%factor = work%tangent(:model%r, :model%r)
      work%step = -work%residual(:model%r)
      call dgesv(model%r, 1, work%factor, model%r, work%pivot, work%step, model%r, info)
      if (info > 0) exit
      before = z(:model%r)
      z(:model%r) = before + work%step
      do k = 1, size(work%y, 2)
         work%along(:, k) = work%y(:, k) + matmul(work%dy(:, :model%r, k), work%step)
      end do
      restart = .false.
      change = norm2(work%step)/max(norm2(z(:model%r)), model%least)
      if (change < tolerance) return
      if (.not. change < 1.0e6_wp) exit
   end do
   iterations = -iterations
end subroutine solve_state

!> Solve on the path from a known state, in equal parts, each with the tangent as predictor: a jump
!> of prescribed values at the old amplitudes would raise pressures without bound
subroutine follow(model, work, known, wish, parts, tolerance, most_steps, z, iterations, &
   & change)
   type(online_model), intent(in) :: model
   type(work_type), intent(inout) :: work
   !> Requested values of the known state, and those requested now, as in `assemble`
   real(wp), intent(in) :: known(:), wish(:)
   !> Number of parts of the path
   integer, intent(in) :: parts
   !> Relative size of a step at which an iteration stops [-]
   real(wp), intent(in) :: tolerance
   !> Largest number of iterations of a part
   integer, intent(in) :: most_steps
   !> Amplitudes, of the known state and answer, shape (s)
   real(wp), intent(inout) :: z(:)
   !> Iterations; negative if one did not converge
   integer, intent(out) :: iterations
   !> Relative size of the last step [-]
   real(wp), intent(out) :: change
   real(wp) :: target(size(wish))
   integer :: given, i, info, some

   iterations = 0
   change = huge(1.0_wp)
   given = size(wish) - model%s + model%r + 1
   z(model%r + 1:) = known(given:)
   do i = 1, parts
      target = known + real(i, wp)/real(parts, wp)*(wish - known)
      ! residual with new activation at old amplitudes, and its change by new prescribed ones
      call assemble(model, work, z, target, .true., .true.)
      if (.not. work%min_j > 0.0_wp) then
         iterations = -1 - iterations
         return
      end if
      work%factor = work%tangent(:model%r, :model%r)
      work%step = -work%residual(:model%r) - matmul(work%tangent(:model%r, model%r + 1:), &
         & target(given:) - z(model%r + 1:))
      call dgesv(model%r, 1, work%factor, model%r, work%pivot, work%step, model%r, info)
      if (info > 0) then
         iterations = -1 - iterations
         return
      end if
      z(:model%r) = z(:model%r) + work%step
      call solve_state(model, work, target, tolerance, most_steps, z, some, change)
      iterations = iterations + abs(some) + 1
      if (some < 0) then
         iterations = -iterations
         return
      end if
   end do
end subroutine follow

!> Forces that do work on the wanted amplitudes, stationary in those of the modes if these follow
!> the wanted ones as in equilibrium: an error of the modes' amplitudes enters squared
subroutine find_forces(whole, room, wish, z, wanted, lift, force)
   !> Model with all its cells, or with a sample made for forces
   type(online_model), intent(in) :: whole
   type(work_type), intent(inout) :: room
   !> Requested values as in `assemble`
   real(wp), intent(in) :: wish(:)
   !> Amplitudes, shape (s)
   real(wp), intent(in) :: z(:)
   !> Amplitudes whose forces are wanted, shape (nf)
   integer, intent(in) :: wanted(:)
   !> How the modes follow them, shape (r, nf) [-]
   real(wp), intent(in) :: lift(:, :)
   !> Forces, shape (nf) [force]
   real(wp), intent(out) :: force(:)
   integer :: i

   call assemble(whole, room, z, wish, .false., .true.)
   do i = 1, size(wanted)
      force(i) = room%residual(wanted(i)) + dot_product(lift(:, i), room%residual(:whole%r))
   end do
end subroutine find_forces

end module rk_online
