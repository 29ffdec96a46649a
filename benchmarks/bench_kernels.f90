!> Processor time of the kernels of one Gauss-Newton iteration against what this machine can do.
!>
!> Prints one line a kernel: name, seconds, operations, bytes that must move. Run with one thread:
!> processor time then is a fair measure even where others use the machine. docs/performance.md
!> has the tables that tables/kernels.py makes of these lines.
program bench_kernels
   use bench_machine, only : now, open_problem, say, stop_on, time_machine
   use rk_cgls, only : refine, semi_normal
   use rk_discretisation, only : discretisation_type
   use rk_envelope, only : envelope_type
   use rk_error, only : error_type
   use rk_lapack, only : syrk
   use rk_lstsq, only : lstsq_report, row_operator, solve_lstsq
   use rk_precision, only : i8, wp
   use rk_problem, only : evaluation_type
   use rk_rows, only : rows_type
   use rk_scene, only : scene_type
   implicit none
   type(scene_type), target :: scene
   class(discretisation_type), allocatable, target :: problem
   class(row_operator), pointer :: op
   type(error_type), allocatable :: error
   type(evaluation_type) :: state
   real(wp), allocatable :: x(:), r(:), y(:)
   integer :: repeats

   call open_problem(problem, scene, repeats)
   allocate (x(problem%n), source=0.0_wp)
   allocate (r(problem%m), y(problem%n))
   print '(a, 2(1x, i0))', 'size', problem%m, problem%n

   call time_machine(repeats)
   call problem%start(x, 0.1_wp, .false.)
   call problem%evaluate(x, 0.1_wp, r, state, tangent=.true.)
   op => problem%linearised
   call kernels()

contains

   !> Every kernel of a solve
   subroutine kernels()
      type(envelope_type) :: factor
      type(lstsq_report) :: report
      real(wp), allocatable :: q(:), t(:), best(:)
      character(len=13), allocatable :: name(:)
      real(wp) :: start, width, flops, entries
      integer :: k, its, j

      allocate (q(op%m), t(op%n))
      allocate (best(8), source=huge(1.0_wp))
      do k = 1, repeats
         start = now()
         call problem%evaluate(x, 0.1_wp, r, state, tangent=.true.)
         best(1) = min(best(1), now() - start)
         start = now()
         call op%envelope(factor, error)
         best(2) = min(best(2), now() - start)
         call stop_on(error)
         start = now()
         call factor%equilibrate()
         best(3) = min(best(3), now() - start)
         start = now()
         call factor%factorise(error)
         best(4) = min(best(4), now() - start)
         call stop_on(error)
         start = now()
         call semi_normal(op, r, factor, y)
         call refine(op, r, factor, 40, y, its)
         best(5) = min(best(5), now() - start)
      end do
      do k = 1, 5*repeats
         start = now()
         call op%apply(y, q)
         best(6) = min(best(6), now() - start)
         start = now()
         call op%apply_transposed(r, t)
         best(7) = min(best(7), now() - start)
         start = now()
         call factor%solve(t)
         best(8) = min(best(8), now() - start)
      end do
      entries = 0.0_wp
      width = 0.0_wp
      select type (op)
      class is (rows_type)
         do k = 1, size(op%place)
            associate (columns => real(op%nc*op%shape%count(op%place(k)), wp))
               entries = entries + (op%row(k + 1) - op%row(k))*columns
               width = width + (op%row(k + 1) - op%row(k))*columns**2
            end associate
         end do
      end select
      flops = 0.0_wp
      associate (m => factor)
         do j = 1, size(m%first)
            do k = m%start(j) + 1, m%start(j + 1)
               flops = flops + real(k - m%first(j), wp)**2
            end do
         end do
         call say('evaluate', best(1), 0.0_wp, 0.0_wp)
         call say('normal', best(2), width, 8.0_wp*size(m%value, kind=i8))
         call say('equilibrate', best(3), 0.0_wp, 16.0_wp*size(m%value, kind=i8))
         call say('cholesky', best(4), flops, 16.0_wp*size(m%value, kind=i8))
         call say('solve', best(8), 4.0_wp*size(m%value, kind=i8), 16.0_wp*size(m%value, kind=i8))
      end associate
      call say('apply', best(6), 2.0_wp*entries, 0.0_wp)
      call say('apply_transposed', best(7), 2.0_wp*entries, 0.0_wp)
      call say('cgls', best(5), 0.0_wp, 0.0_wp)
      deallocate (factor%value)
      name = names()
      do k = 1, size(name)
         best(1) = huge(1.0_wp)
         do j = 1, merge(1, repeats, index(name(k), 'dgels') + index(name(k), 'sp') > 0)
            start = now()
            call solve_lstsq(op, r, trim(name(k)), y, report, error)
            best(1) = min(best(1), now() - start)
            call stop_on(error)
         end do
         print '(a, 1x, a, 1x, 5(es10.3, 1x), i0)', 'solver', name(k), best(1), &
            & report%backward_error, report%misfit, report%rcond, norm2(y), report%iterations
      end do
   end subroutine kernels

   !> Solvers to time
   function names() result(list)
      character(len=13), allocatable :: list(:)
      character(len=200) :: value
      integer :: i, stat

      call get_environment_variable('BENCH_SOLVERS', value, status=stat)
      if (stat /= 0) value = 'auto normal'
      allocate (list(count([(value(i:i) /= ' ' .and. value(i + 1:i + 1) == ' ', i=1, 199)])))
      read (value, *) list
   end function names

end program bench_kernels
