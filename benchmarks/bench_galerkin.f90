!> Processor time of the kernels of one Newton iteration of the Galerkin form.
!>
!> Prints one line a kernel: name, seconds, operations, bytes that must move. Operations are those
!> that the formulas need, whatever the code does: products with zeros, and both halves of what is
!> symmetric, count once or not at all. Bytes are those of the arrays that go in and out, once.
!> Where no model is worth its lines there is none. tables/kernels.py prints a table of them.
program bench_galerkin
   use, intrinsic :: iso_c_binding, only : c_double, c_int64_t
   use bench_machine, only : now, open_problem, say, stop_on, time_machine
   use rk_basis, only : basis_size
   use rk_csr, only : csr_type
   use rk_cuthill, only : cuthill_mckee
   use rk_discretisation, only : discretisation_type
   use rk_ellipticity, only : ellipticity_type, find_ellipticity
   use rk_error, only : error_type
   use rk_galerkin, only : galerkin_problem
   use rk_gradient, only : gradient_type, new_gradient
   use rk_operator, only : square_report
   use rk_precision, only : i8, wp
   use rk_problem, only : evaluation_type
   use rk_scene, only : scene_type
   use rk_shape, only : shape_type
   use rk_states, only : field_state
   use rk_tensor, only : identity
   implicit none

   interface
      !> Operations and entries of a Cholesky factor
      subroutine factor_counts(n, start, row, value, order, operations, entries) bind(c)
         import :: c_double, c_int64_t
         integer(c_int64_t), value :: n
         integer(c_int64_t), intent(in) :: start(*), row(*)
         real(c_double), intent(in) :: value(*)
         integer(c_int64_t), intent(in), optional :: order(*)
         real(c_double), intent(out) :: operations, entries
      end subroutine factor_counts
   end interface

   type(scene_type), target :: scene
   class(discretisation_type), allocatable, target :: problem
   type(error_type), allocatable :: error
   integer :: repeats

   call open_problem(problem, scene, repeats)
   select type (problem)
   class is (galerkin_problem)
      print '(a, 2(1x, i0))', 'size', size(problem%cells%weight), problem%n
      call time_machine(repeats)
      call kernels(problem)
   end select

contains

   !> Every kernel of an iteration, and of the set-up and the output
   subroutine kernels(problem)
      class(galerkin_problem), target, intent(inout) :: problem
      type(shape_type) :: shape, facet
      type(gradient_type) :: gradient
      type(evaluation_type) :: seen
      type(square_report) :: report
      type(field_state) :: state
      type(ellipticity_type) :: worst
      real(wp), allocatable :: c4(:, :, :, :, :), x(:), r(:), y(:)
      real(wp) :: best(11), p(3, 3), start, fill(2)
      integer :: k, q, nc, nd, ns

      nd = scene%cloud%nd
      nc = size(scene%cloud%points, 2)
      ns = size(scene%cloud%source, 2)
      allocate (x(problem%n), source=0.0_wp)
      allocate (r(problem%m), y(problem%n))
      allocate (c4(3, 3, 3, 3, size(problem%cells%weight)))
      best = huge(1.0_wp)
      problem%matrix%keeps = .true.
      call problem%start(x, 0.1_wp, .false.)
      do k = 1, repeats
         start = now()
         call scene%shape_at(problem%cells%point, shape, error, first=.true.)
         best(1) = min(best(1), now() - start)
         call stop_on(error)
         call scene%shape_at(problem%cells%facet, facet, error)
         call stop_on(error)
         start = now()
         call new_gradient(gradient, problem%cells, ns, shape, facet, problem%surface%shape, &
            & problem%surface%essential)
         best(2) = min(best(2), now() - start)
         start = now()
         do q = 1, size(problem%cells%weight)
            call problem%mixture%stress(nc + q, identity, 0.1_wp, p, c4(:, :, :, :, q), &
               & volumetric=.false.)
         end do
         best(3) = min(best(3), now() - start)
         best(4:5) = min(best(4:5), stiffness_and_scatter(problem, c4))
         start = now()
         call problem%evaluate(x, 0.1_wp, r, seen, tangent=.true.)
         best(6) = min(best(6), now() - start)
         start = now()
         call problem%evaluate(x, 0.1_wp, r, seen)
         best(7) = min(best(7), now() - start)
         ! the first factor finds its order
         start = now()
         call problem%matrix%solve_square(0.0_wp, r, y, report, error)
         if (k > 1) best(8) = min(best(8), now() - start)
         call stop_on(error)
         start = now()
         call problem%matrix%solve_again(y)
         best(9) = min(best(9), now() - start)
         start = now()
         call problem%matrix%apply(r, y)
         best(10) = min(best(10), now() - start)
         call problem%state(x, 0.1_wp, state)
         start = now()
         call find_ellipticity(problem, state, worst)
         best(11) = min(best(11), now() - start)
      end do

      associate (entries => real(size(problem%gradient%local), wp), &
         & values => real(size(problem%gradient%value), wp), &
         & places => real(size(problem%cells%weight), wp), &
         & sparse => real(size(problem%matrix%value), wp))
         fill = counts(problem)
         call say('shape', best(1), shape_operations(shape), 8.0_wp*size(shape%value))
         call say('gradients', best(2), 0.0_wp, 8.0_wp*(size(shape%value) + values) &
            & + 4.0_wp*entries)
         call say('moduli', best(3), 0.0_wp, 8.0_wp*90*places)
         call say('stiffness', best(4), products(problem), 8.0_wp*(values + 81*places) &
            & + 16.0_wp*parts(problem))
         call say('scatter', best(5), parts(problem), 24.0_wp*parts(problem))
         call say('linearise', best(6), products(problem) + parts(problem), 0.0_wp)
         call say('evaluate', best(7), 4.0_wp*nd*nd*entries, 16.0_wp*values)
         call say('factor', best(8), fill(1), 16.0_wp*fill(2))
         call say('solve', best(9), 4.0_wp*fill(2), 16.0_wp*fill(2))
         call say('product', best(10), 4.0_wp*sparse, 16.0_wp*sparse)
         call say('ellipticity', best(11), 0.0_wp, 0.0_wp)
      end associate

   end subroutine kernels

   !> Times of the stiffness of all groups, and of adding it to the matrix [s]
   function stiffness_and_scatter(problem, c4) result(seconds)
      class(galerkin_problem), intent(inout) :: problem
      real(wp), intent(in) :: c4(:, :, :, :, :)
      real(wp) :: seconds(2), start
      real(wp), allocatable :: part(:, :)
      integer :: g, nd

      nd = scene%cloud%nd
      seconds = 0.0_wp
      do g = 1, size(problem%cells%first) - 1
         associate (member => problem%gradient%member%index(problem%gradient%member%offset(g) &
            & + 1:problem%gradient%member%offset(g + 1)), o => problem%cells%first(g))
            allocate (part(nd*size(member), nd*size(member)), source=0.0_wp)
            start = now()
            call problem%gradient%add_stiffness(o, c4(:, :, :, :, o + 1: &
               & problem%cells%first(g + 1)), part)
            seconds(1) = seconds(1) + now() - start
            start = now()
            call problem%matrix%add(problem%matrix%value, member, part)
            seconds(2) = seconds(2) + now() - start
            deallocate (part)
         end associate
      end do
   end function stiffness_and_scatter

   !> Operations of shape functions with first derivatives: 2 (1 + nd) for each monomial, its share
   !> in the moments, value and slopes, one factor and 1 + nd solves a place
   real(wp) function shape_operations(shape)
      type(shape_type), intent(in) :: shape
      real(wp) :: nb, n, nd, stencils

      nd = shape%nd
      nb = basis_size(shape%nd, scene%approximation%order)
      n = size(shape%value, 2)
      stencils = maxval(shape%stencil)
      shape_operations = n*(2*nb*(1 + nd) + nb*(nb + 1) + 2*nb*(1 + nd) + 4*nb*nd + 2*nb*nd) &
         & + stencils*(nb**3/3 + 2*(1 + nd)*nb**2)
   end function shape_operations

   !> Operations of the stiffness, cell by cell: the moduli times the gradients of one side, and the
   !> upper triangle of the products with the other
   real(wp) function products(problem)
      class(galerkin_problem), intent(in) :: problem
      integer :: nd, o, n
      real(wp) :: m
      logical :: seen(size(scene%cloud%source))

      nd = scene%cloud%nd
      n = problem%cells%per_cell
      products = 0.0_wp
      do o = 0, size(problem%cells%weight) - 1, n
         seen = .false.
         seen(problem%gradient%local(problem%gradient%start(o + 1) + 1: &
            & problem%gradient%start(o + n + 1))) = .true.
         m = count(seen)
         products = products + nd*n*m*(nd*(nd + 1)/2*(2*nd - 1) + nd*(nd*m + 1))
      end do
   end function products

   !> Entries of the upper triangles of all groups
   real(wp) function parts(problem)
      class(galerkin_problem), intent(in) :: problem
      integer :: g
      real(wp) :: n

      parts = 0.0_wp
      do g = 1, size(problem%cells%first) - 1
         n = scene%cloud%nd*real(problem%gradient%member%offset(g + 1) &
            & - problem%gradient%member%offset(g), wp)
         parts = parts + 0.5_wp*n*(n + 1.0_wp)
      end do
   end function parts

   !> Operations and entries of the factor
   function counts(problem) result(fill)
      class(galerkin_problem), intent(in) :: problem
      real(wp) :: fill(2)
      integer(i8), allocatable :: order(:), row(:)
      type(csr_type) :: above
      integer, allocatable :: along(:)
      integer(i8) :: e
      integer :: i, j, b

      ! the blocks of each block column, from its first column
      b = problem%matrix%block
      above = csr_type([0_i8], [integer ::])
      allocate (row, source=problem%matrix%rows())
      do j = 1, problem%matrix%n, b
         associate (first => problem%matrix%start(j) + 1, last => problem%matrix%start(j + 1))
            above%index = [above%index, [(int(row(e))/b + 1, e=first, last, b)]]
            above%offset = [above%offset, size(above%index, kind=i8)]
         end associate
      end do
      along = cuthill_mckee(above)
      allocate (order(problem%matrix%n))
      do i = 1, b
         order(i::b) = b*(along - 1_i8) + i - 1
      end do
      call factor_counts(int(problem%matrix%n, i8), problem%matrix%start, row, &
         & problem%matrix%value, order, fill(1), fill(2))
   end function counts

end program bench_galerkin
