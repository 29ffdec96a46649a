!> Questions of Python about an open scene: a word and numbers in, arrays by name out.
module rk_questions
   use, intrinsic :: ieee_arithmetic, only : ieee_quiet_nan, ieee_value
   use omp_lib, only : omp_set_num_threads
   use rk_error, only : err_input, error_type, fatal_error
   use rk_fields, only : compute_fields, field_names, field_sizes
   use rk_galerkin_questions, only : ask_galerkin
   use rk_handles, only : slot_type
   use rk_point_field, only : point_field
   use rk_precision, only : wp
   use rk_probes, only : new_probes, probe_value, probes_type, quantity_size
   use rk_problem, only : evaluation_type, problem_type
   use rk_reduced, only : new_reduced
   use rk_session, only : find_problem, solve_session
   use rk_states, only : field_state
   use rk_surface, only : lattice_places, surface_triangles
   use rk_text, only : to_text
   implicit none
   private

   public :: ask

contains

!> Answer a question, in the slot
subroutine ask(slot, question, word, given, error)
   type(slot_type), target, intent(inout) :: slot
   character(len=*), intent(in) :: question
   !> Name that the question needs, blank if none
   character(len=*), intent(in) :: word
   !> Numbers that the question needs, one after the other
   real(wp), contiguous, intent(in) :: given(:)
   !> Error handling: invalid numbers, a failed solve
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: place(:, :), value(:, :, :)
   real(wp) :: none(3, 0), no_stress(3, 3, 0)
   integer, allocatable :: triangle(:, :)
   integer :: k, n

   slot%answer%forms = ''
   slot%answer%value = [real(wp) ::]
   associate (answer => slot%answer, cloud => slot%scene%cloud, shape_of => slot%full%shape)
      select case (question)
      case ('sizes')
         ! dimension, source points, collocation points, unknowns, equations, probes, steps,
         ! stencils
         call answer%put_whole('sizes', [8], [shape_of%nd, shape_of%ns, size(cloud%points, 2), &
            & slot%full%n, slot%full%m, size(slot%scene%probe), slot%scene%steps(), &
            & maxval(shape_of%stencil)])
      case ('found')
         ! changes of the deck by the search for points, one override per line
         call answer%put_text('overrides', slot%refinement%points)
      case ('approximation')
         call answer%put_text('text', slot%approximation)
      case ('points')
         call answer%put('place', shape(cloud%points), cloud%points)
      case ('surface')
         ! triangles, or a plane body itself: points from 0; none without a lattice
         triangle = surface_triangles(lattice_places(cloud)) - 1
         call answer%put_whole('surface', shape(triangle), triangle)
      case ('field_points')
         ! points at which `set_fields` expects values
         call slot%full%set_point_loads(none, none, no_stress, place)
         call answer%put('place', shape(place), place)
      case ('set_fields')
         call set_fields(slot, given, error)
      case ('reduce')
         call reduce(slot, word, given, error)
      case ('solve')
         ! all load steps with the given least squares solver: threads, 0 for all cores; whether of
         ! the reduced model, and with error bars (1); unknowns at which the iteration begins
         if (given(1) > 0) call omp_set_num_threads(nint(given(1)))
         call solve_session(slot, word, given(2) > 0, given(3) > 0, given(4:), error)
      case ('states')
         call answer_states(slot, error)
      case ('fields')
         call answer_fields(slot, given)
      case ('probes')
         ! unknowns of the states, one after the other, then the load of each
         n = slot%full%n
         k = size(given)/(n + 1)
         call probe_values(slot, reshape(given, [n, k]), given(n*k + 1:), value, error)
         call answer%put('value', shape(value), value)
      case ('linearise')
         call linearise(slot, given, error)
      case default
         call ask_galerkin(slot%full, question, given, answer, error)
      end select
   end associate
end subroutine ask

!> Body force, prescribed displacement and the stress whose traction is prescribed, all at full load
!> and at the field points; the last two are used if the deck has conditions of their kind
subroutine set_fields(slot, given, error)
   type(slot_type), intent(inout) :: slot
   !> Their components, shapes (3, n), (3, n) and (3, 3, n)
   real(wp), intent(in) :: given(:)
   type(error_type), allocatable, intent(out) :: error
   integer :: n

   n = size(given)/15
   if (slot%full%linear) then
      call fatal_error(error, err_input, 'the loads of a linear problem are those of its deck: ' &
         & //'give linear.source and the boundary as expressions instead of set_fields')
   else
      call slot%full%set_point_loads(reshape(given(:3*n), [3, n]), &
         & reshape(given(3*n + 1:6*n), [3, n]), reshape(given(6*n + 1:), [3, 3, n]))
   end if
end subroutine set_fields

!> Project the full problem on modes
subroutine reduce(slot, projection, given, error)
   type(slot_type), intent(inout) :: slot
   !> auto, galerkin or least-squares
   character(len=*), intent(in) :: projection
   !> Whether rows are assembled in full (1) or not, then the modes
   real(wp), contiguous, intent(in) :: given(:)
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: modes(:, :)

   modes = reshape(given(2:), [slot%full%n, (size(given) - 1)/slot%full%n])
   if (associated(slot%reduced)) deallocate (slot%reduced)
   call new_reduced(slot%reduced, slot%full, modes, projection, given(1) > 0, error)
end subroutine reduce

!> States of the last solve, including a failed one, and the verdict on it
subroutine answer_states(slot, error)
   type(slot_type), intent(inout) :: slot
   !> Error handling: no solve yet
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: bar(:, :, :), value(:, :, :)
   real(wp) :: seconds(3), worst(3), norms(4)
   integer :: i, j, n, steps

   if (.not. allocated(slot%states%x)) then
      call fatal_error(error, err_input, 'this scene has not been solved yet')
      return
   end if
   steps = min(slot%states%steps, size(slot%states%x, 2))
   seconds = [slot%outcome%timer%assemble, slot%outcome%timer%solve, slot%outcome%seconds]
   ! NaN without a solve
   worst = [slot%states%backward_error, slot%outcome%imbalance, ieee_value(worst(3), &
      & ieee_quiet_nan)]
   if (allocated(slot%outcome%work_mismatch)) worst(3) = slot%outcome%work_mismatch
   norms = -1
   if (allocated(slot%outcome%norms)) then
      associate (found => slot%outcome%norms)
         seconds(3) = seconds(3) + found%seconds
         norms = [found%l2, found%h1, found%l2_solution, found%h1_solution]
      end associate
   end if
   allocate (bar(3, size(slot%scene%probe), steps), source=ieee_value(1.0_wp, ieee_quiet_nan))
   associate (bars => slot%verdict%bars, x => slot%states%x(:, :steps), &
      & info => slot%states%info(:, :steps), answer => slot%answer, cloud => slot%scene%cloud)
      if (allocated(bars%change)) then
         call probe_values(slot, x, info(1, :), value, error)
         if (allocated(error)) return
         do j = 1, steps
            do i = 1, size(bar, 2)
               n = quantity_size(slot%scene%probe(i)%quantity)
               if (bars%change(i) >= 0) bar(:n, i, j) = bars%at(i, info(1, j), value(:n, i, j))
            end do
         end do
      end if
      call answer%put('x', shape(x), x)
      ! load, iterations, smallest and largest J, eigenvalue of the acoustic tensor and its point
      call answer%put('info', shape(info), info)
      call answer%put('place', shape(cloud%points), cloud%points)
      ! assembly, least squares and checks
      call answer%put('seconds', [3], seconds)
      ! backward error, imbalance of forces, mismatch of works
      call answer%put('worst', [3], worst)
      ! those of the error and of the solution of a linear problem, negative for others
      call answer%put('norms', [4], norms)
      call answer%put_text('warnings', slot%outcome%warnings)
      ! 0 for none, 1 accepted, 2 doubtful, 3 refused
      call answer%put_whole('verdict', [integer ::], [merge(slot%verdict%state, 0, &
         & allocated(slot%verdict%reasons))])
      ! whether the equilibrium is unstable
      call answer%put_whole('unstable', [integer ::], [merge(1, 0, slot%outcome%unstable)])
      call answer%put_text('reasons', slot%verdict%reasons)
      ! three numbers per probe, NaN if there is none
      call answer%put('bars', shape(bar), bar)
   end associate
end subroutine answer_states

!> All fields at all collocation points for one state of the full problem, zero if it has none
subroutine answer_fields(slot, given)
   type(slot_type), intent(inout) :: slot
   !> Load, then the unknowns
   real(wp), contiguous, intent(in) :: given(:)
   type(field_state) :: state
   type(point_field), allocatable :: fields(:)
   real(wp), allocatable :: value(:, :)
   integer :: k

   call slot%full%state(given(2:), given(1), state)
   call compute_fields(slot%full, state, fields)
   do k = 1, size(field_names)
      allocate (value(field_sizes(k), size(fields(1)%value, 2)), source=0.0_wp)
      if (k <= size(fields)) value(:size(fields(k)%value, 1), :) = fields(k)%value
      call slot%answer%put(field_names(k), shape(value), value)
      deallocate (value)
   end do
end subroutine answer_fields

!> Values of all probes, three numbers each, for states of the full problem
subroutine probe_values(slot, x, load, value, error)
   type(slot_type), intent(in) :: slot
   !> Unknowns of each state, shape (n, states)
   real(wp), contiguous, intent(in) :: x(:, :)
   !> Load of each, shape (states)
   real(wp), intent(in) :: load(:)
   !> Values, shape (3, probes, states)
   real(wp), allocatable, intent(out) :: value(:, :, :)
   !> Error handling: a probe without a position
   type(error_type), allocatable, intent(out) :: error
   type(field_state) :: state
   type(probes_type) :: probes
   integer :: i, j

   allocate (value(3, size(slot%scene%probe), size(load)), source=0.0_wp)
   call new_probes(probes, slot%scene, error)
   if (allocated(error)) return
   do j = 1, size(load)
      call slot%full%state(x(:, j), load(j), state)
      do i = 1, size(value, 2)
         call probe_value(slot%full, probes, i, state, value(:, i, j))
      end do
   end do
end subroutine probe_values

!> Residual and linearised rows times a direction
subroutine linearise(slot, given, error)
   type(slot_type), intent(inout) :: slot
   !> 1 for the reduced problem, load; unknowns at the start of the load step, which determine the
   !> row weights, those of the state, and the direction
   real(wp), contiguous, intent(in) :: given(:)
   !> Error handling: no reduced model, J <= 0
   type(error_type), allocatable, intent(out) :: error
   class(problem_type), pointer :: problem
   type(evaluation_type) :: seen
   real(wp), allocatable :: r(:), y(:)
   integer :: n

   n = (size(given) - 2)/3
   call find_problem(slot, given(1) > 0, problem, error)
   if (allocated(error)) return
   allocate (r(problem%m), y(problem%m))
   call problem%start(given(3:2 + n), given(2), .false.)
   call problem%evaluate(given(3 + n:2 + 2*n), given(2), r, seen, tangent=.true.)
   if (.not. seen%valid) call fatal_error(error, err_input, 'the state is not valid: smallest J ' &
      & //to_text(seen%min_j, 4)//' at collocation point '//to_text(seen%worst))
   if (allocated(error)) return
   call problem%linearised%apply(given(3 + 2*n:), y)
   call slot%answer%put('residual', shape(r), r)
   call slot%answer%put('product', shape(y), y)
end subroutine linearise

end module rk_questions
