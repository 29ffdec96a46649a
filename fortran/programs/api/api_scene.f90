! Python boundary of scenes: a handle in, arrays out. Python checks shapes before it calls.

!> Open the scene of a deck, whose text is blank where it is a file; the arrays are those of a model
!> and may be empty: by source point its place and spacing; by collocation point place, fiber,
!> volume, activation and fractions, then label and voxel; by boundary entry normal and area, then
!> point and set; size and origin of the voxels. A size of 0 stands for none, and so do fractions
!> of one label and activations below 0. Not threadsafe: gfortran keeps the lengths of character
!> function results in static storage, and keys are made of such results
subroutine scene_open(path, text, nover, overrides, ns, nc, nb, nset, nf, source, point, place, &
   & entry, entry_of, grid, fraction_label, set_names, length_unit, handle, stat, message)
   use rk_cloud, only : cloud_type, take_arrays
   use rk_error, only : error_type
   use rk_pack, only : pack_error
   use rk_session, only : open_session
   implicit none
   integer, intent(in) :: nover, ns, nc, nb, nset, nf
   character(len=*), intent(in) :: path, text, overrides(nover), set_names(nset), length_unit
   double precision, intent(in) :: source(3, 2, ns), point(8 + nf, nc), entry(4, nb), grid(3, 2)
   integer, intent(in) :: place(4, nc), entry_of(2, nb), fraction_label(nf)
   integer, intent(out) :: handle, stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(cloud_type) :: model

   model%nd = 3
   model%source = source(:, 1, :)
   model%spacing = source(:, 2, :)
   model%points = point(:3, :)
   model%fiber = point(4:6, :)
   model%volume = point(7, :)
   if (all(point(8, :) >= 0)) model%activation = point(8, :)
   ! one tissue has no fractions
   if (nf > 1) then
      model%fraction = point(9:, :)
      model%fraction_label = fraction_label
   end if
   model%label = place(1, :)
   if (all(grid(:, 1) > 0)) then
      model%voxels%index = place(2:, :)
      model%voxels%size = grid(:, 1)
      model%voxels%origin = grid(:, 2)
   end if
   model%normal = entry(:3, :)
   model%area = entry(4, :)
   model%boundary_point = entry_of(1, :)
   model%boundary_set = entry_of(2, :)
   allocate (model%set_names(nset))
   model%set_names = set_names
   model%length_unit = trim(length_unit)
   handle = 0
   call take_arrays(model, error)
   if (.not. allocated(error)) call open_session(path, text, overrides, model, handle, error)
   call pack_error(error, stat, message)
end subroutine scene_open

!> Change loads, material parameters, steps, solver or probes of an open scene. Not threadsafe, as
!> scene_open
subroutine scene_update(handle, nover, overrides, stat, message)
   use rk_error, only : error_type
   use rk_pack, only : pack_error
   use rk_session, only : update_session
   implicit none
   integer, intent(in) :: handle, nover
   character(len=*), intent(in) :: overrides(nover)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error

   call update_session(handle, overrides, error)
   call pack_error(error, stat, message)
end subroutine scene_update

!> Close a scene; unknown handles are ignored
subroutine scene_close(handle)
   use rk_error, only : error_type
   use rk_handles, only : close_slot, find_slot, slot_type
   implicit none
   integer, intent(in) :: handle
   type(error_type), allocatable :: error
   type(slot_type), pointer :: slot

   call find_slot(handle, slot, error)
   if (.not. allocated(error)) call close_slot(slot)
end subroutine scene_close

!> What the search for points has changed in the deck, an override "table.key=value" a line; blank
!> where nothing was searched
subroutine scene_found(handle, words, stat, message)
   use rk_handles, only : look_up, slot_type
   implicit none
   integer, intent(in) :: handle
   character(len=512), intent(out) :: words
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(slot_type), pointer :: slot

   words = ''
   call look_up(handle, slot, stat, message)
   if (stat /= 0) return
   if (allocated(slot%refinement%points)) words = slot%refinement%points
end subroutine scene_found

!> Sizes: dimension, source points, collocation points, unknowns, equations, probes, steps, stencils
subroutine scene_sizes(handle, sizes, stat, message)
   use rk_handles, only : look_up, slot_type
   implicit none
   integer, intent(in) :: handle
   integer, intent(out) :: sizes(8), stat
   character(len=2048), intent(out) :: message
   type(slot_type), pointer :: slot

   sizes = 0
   call look_up(handle, slot, stat, message)
   if (stat /= 0) return
   sizes = [slot%full%shape%nd, slot%full%shape%ns, size(slot%scene%cloud%points, 2), &
      & slot%full%n, slot%full%m, size(slot%scene%probe), &
      & slot%scene%steps(), maxval(slot%full%shape%stencil)]
end subroutine scene_sizes

!> Project the full problem on modes, by a projection (auto, galerkin, least-squares) and with rows
!> that are assembled in full (assembled = 1) or not; gives the number of equations that are left
subroutine scene_reduce(handle, n, r, modes, projection, assembled, rows, stat, message)
   use rk_error, only : error_type
   use rk_handles, only : look_up, slot_type
   use rk_pack, only : pack_error
   use rk_reduced, only : new_reduced, reduction_type
   implicit none
   !f2py threadsafe
   integer, intent(in) :: handle, n, r, assembled
   double precision, intent(in) :: modes(n, r)
   character(len=*), intent(in) :: projection
   integer, intent(out) :: rows, stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(slot_type), pointer :: slot

   rows = 0
   call look_up(handle, slot, stat, message)
   if (stat /= 0) return
   if (associated(slot%reduced)) deallocate (slot%reduced)
   call new_reduced(slot%reduced, slot%full, modes, reduction_type(projection, assembled /= 0), &
      & error)
   if (.not. allocated(error)) rows = slot%reduced%m
   call pack_error(error, stat, message)
end subroutine scene_reduce

!> Collocation points
subroutine scene_points(handle, nd, nc, place, stat, message)
   use rk_handles, only : look_up, slot_type
   implicit none
   integer, intent(in) :: handle, nd, nc
   double precision, intent(out) :: place(nd, nc)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(slot_type), pointer :: slot

   place = 0
   call look_up(handle, slot, stat, message)
   if (stat == 0) place = slot%scene%cloud%points
end subroutine scene_points

!> Triangles of the surface, or of a plane body itself: their number, and as many as there is room
!> for, points from 0
subroutine scene_surface(handle, room, n, triangle, stat, message)
   use rk_handles, only : look_up, slot_type
   use rk_surface, only : lattice_places, surface_triangles
   implicit none
   integer, intent(in) :: handle, room
   integer, intent(out) :: n, triangle(3, room), stat
   character(len=2048), intent(out) :: message
   type(slot_type), pointer :: slot
   integer, allocatable :: found(:, :)

   n = 0
   triangle = 0
   call look_up(handle, slot, stat, message)
   if (stat /= 0) return
   found = surface_triangles(lattice_places(slot%scene%cloud)) - 1
   n = size(found, 2)
   triangle(:, :min(n, room)) = found(:, :min(n, room))
end subroutine scene_surface

!> How the collocation points hang together: the place of each in a lattice, from 0, or -1 without
!> one; its label and its fiber, a unit vector or zero
subroutine scene_body(handle, nd, nc, place, label, fiber, stat, message)
   use rk_handles, only : look_up, slot_type
   use rk_surface, only : lattice_places
   implicit none
   integer, intent(in) :: handle, nd, nc
   integer, intent(out) :: place(nd, nc), label(nc), stat
   double precision, intent(out) :: fiber(3, nc)
   character(len=2048), intent(out) :: message
   type(slot_type), pointer :: slot
   integer, allocatable :: found(:, :)

   place = -1
   label = 0
   fiber = 0
   call look_up(handle, slot, stat, message)
   if (stat /= 0) return
   label = slot%scene%cloud%label
   fiber = slot%scene%cloud%fiber
   found = lattice_places(slot%scene%cloud)
   if (size(found, 2) == nc) place = found - spread(minval(found, dim=2), 2, nc)
end subroutine scene_body

!> Share of a label in the volume of each collocation point [-]
subroutine scene_share(handle, label, nc, share, stat, message)
   use rk_handles, only : look_up, slot_type
   implicit none
   integer, intent(in) :: handle, label, nc
   double precision, intent(out) :: share(nc)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(slot_type), pointer :: slot
   integer :: k

   share = 0
   call look_up(handle, slot, stat, message)
   if (stat /= 0) return
   associate (cloud => slot%scene%cloud)
      if (allocated(cloud%fraction)) then
         do k = 1, size(cloud%fraction_label)
            if (cloud%fraction_label(k) == label) share = share + cloud%fraction(k, :)
         end do
      else
         where (cloud%label == label) share = 1
      end if
   end associate
end subroutine scene_share

!> Collocation points of a boundary set, from 0, with the area of each: their number, none where
!> there is no such set, and as many as there is room for
subroutine scene_set(handle, name, room, n, point, area, stat, message)
   use rk_handles, only : look_up, slot_type
   implicit none
   integer, intent(in) :: handle, room
   character(len=*), intent(in) :: name
   integer, intent(out) :: n, point(room), stat
   double precision, intent(out) :: area(room)
   character(len=2048), intent(out) :: message
   type(slot_type), pointer :: slot
   integer :: e, set

   n = 0
   point = 0
   area = 0
   call look_up(handle, slot, stat, message)
   if (stat /= 0) return
   associate (cloud => slot%scene%cloud)
      set = cloud%find_set(name)
      if (set == 0) return
      do e = 1, size(cloud%boundary_point)
         if (.not. cloud%in_set(e, set)) cycle
         n = n + 1
         if (n > room) cycle
         point(n) = cloud%boundary_point(e) - 1
         area(n) = cloud%area(e)
      end do
   end associate
end subroutine scene_set

!> Number of points where scene_set_fields wants values
subroutine scene_count_field_points(handle, n, stat, message)
   use rk_handles, only : look_up, slot_type
   implicit none
   integer, intent(in) :: handle
   integer, intent(out) :: n, stat
   character(len=2048), intent(out) :: message
   type(slot_type), pointer :: slot
   double precision, allocatable :: place(:, :)
   double precision :: none(3, 0), no_stress(3, 3, 0)

   n = 0
   call look_up(handle, slot, stat, message)
   if (stat /= 0) return
   call slot%full%set_point_loads(none, none, no_stress, place)
   n = size(place, 2)
end subroutine scene_count_field_points

!> Points where scene_set_fields wants values
subroutine scene_field_points(handle, nd, n, place, stat, message)
   use rk_handles, only : look_up, slot_type
   implicit none
   integer, intent(in) :: handle, nd, n
   double precision, intent(out) :: place(nd, n)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(slot_type), pointer :: slot
   double precision, allocatable :: points(:, :)
   double precision :: none(3, 0), no_stress(3, 3, 0)

   place = 0
   call look_up(handle, slot, stat, message)
   if (stat /= 0) return
   call slot%full%set_point_loads(none, none, no_stress, points)
   place = points
end subroutine scene_field_points

!> Body force, prescribed displacement and the stress whose traction is prescribed, all at full load
!> and at the field points; the last two count where the deck has conditions of their kind
subroutine scene_set_fields(handle, nc, body_force, displacement, stress, stat, message)
   use rk_error, only : err_input, error_type, fatal_error
   use rk_handles, only : look_up, slot_type
   use rk_pack, only : pack_error
   implicit none
   integer, intent(in) :: handle, nc
   double precision, intent(in) :: body_force(3, nc), displacement(3, nc), stress(3, 3, nc)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(slot_type), pointer :: slot

   call look_up(handle, slot, stat, message)
   if (stat /= 0) return
   if (slot%full%linear) then
      call fatal_error(error, err_input, 'the loads of a linear problem are those of its deck: ' &
         & //'give linear.source and the boundary as expressions instead of set_fields')
   else
      call slot%full%set_point_loads(body_force, displacement, stress)
   end if
   call pack_error(error, stat, message)
end subroutine scene_set_fields

!> Solve all load steps of the full (reduced = 0) or the reduced problem with a number of threads,
!> 0 for all cores, without (estimate = 0) or with error bars; threads are a matter of the calling
!> thread, so it is set here. The iteration begins at `start`, unknowns that may all be zero
subroutine scene_solve(handle, n, linear, reduced, threads, estimate, start, stat, message)
   use omp_lib, only : omp_set_num_threads
   use rk_error, only : error_type
   use rk_pack, only : pack_error
   use rk_session, only : solve_session
   implicit none
   !f2py threadsafe
   integer, intent(in) :: handle, n, reduced, threads, estimate
   character(len=*), intent(in) :: linear
   double precision, intent(in) :: start(n)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error

   if (threads > 0) call omp_set_num_threads(threads)
   call solve_session(handle, linear, reduced /= 0, estimate /= 0, start, error)
   call pack_error(error, stat, message)
end subroutine scene_solve

!> Steps and iterations done so far, readable while a solve runs in another thread
subroutine scene_progress(handle, steps, iterations)
   use rk_error, only : error_type
   use rk_handles, only : find_slot, slot_type
   implicit none
   integer, intent(in) :: handle
   integer, intent(out) :: steps, iterations
   type(error_type), allocatable :: error
   type(slot_type), pointer :: slot

   steps = 0
   iterations = 0
   call find_slot(handle, slot, error)
   if (allocated(error)) return
   steps = slot%states%steps
   iterations = slot%states%iterations
end subroutine scene_progress

!> Shape functions in words: coefficients belong to them
subroutine scene_approximation(handle, text, stat, message)
   use rk_deck_scene, only : approximation_text
   use rk_handles, only : look_up, slot_type
   implicit none
   integer, intent(in) :: handle
   character(len=200), intent(out) :: text
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(slot_type), pointer :: slot

   text = ''
   call look_up(handle, slot, stat, message)
   if (stat == 0) text = approximation_text(slot%deck)
end subroutine scene_approximation

!> Ask a running solve to end after its iteration
subroutine scene_stop(handle)
   use rk_error, only : error_type
   use rk_handles, only : find_slot, slot_type
   implicit none
   integer, intent(in) :: handle
   type(error_type), allocatable :: error
   type(slot_type), pointer :: slot

   call find_slot(handle, slot, error)
   if (.not. allocated(error)) slot%states%stop = .true.
end subroutine scene_stop

!> States of the last solve: unknowns; load, iterations, smallest and largest J, smallest eigenvalue
!> of the acoustic tensor and its point, from 1; wall times of assembly, least squares and checks;
!> largest backward error, imbalance of forces, mismatch of works, not a number without one; L2 and
!> H1 norms of the error and of the solution of a linear problem, negative for others
subroutine scene_states(handle, n, steps, x, info, seconds, worst, norms, stat, message)
   use, intrinsic :: ieee_arithmetic, only : ieee_quiet_nan, ieee_value
   use rk_error, only : error_type, fatal_error, err_input
   use rk_handles, only : find_slot, slot_type
   use rk_pack, only : pack_error
   implicit none
   integer, intent(in) :: handle, n, steps
   double precision, intent(out) :: x(n, steps), info(6, steps), seconds(3), worst(3), norms(4)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(slot_type), pointer :: slot

   x = 0
   info = 0
   seconds = 0
   worst = 0
   norms = -1
   call find_slot(handle, slot, error)
   if (.not. allocated(error)) then
      if (.not. allocated(slot%states%x)) then
         call fatal_error(error, err_input, 'this scene has not been solved yet')
      else if (size(slot%states%x, 1) /= n .or. slot%states%steps < steps) then
         call fatal_error(error, err_input, 'the last solve of this scene was of another model')
      end if
   end if
   call pack_error(error, stat, message)
   if (stat /= 0) return
   x = slot%states%x(:n, :steps)
   info = slot%states%info(:, :steps)
   seconds = [slot%outcome%timer%assemble, slot%outcome%timer%solve, &
      & slot%outcome%seconds]
   worst = [slot%states%backward_error, slot%outcome%imbalance, ieee_value(worst(3), &
      & ieee_quiet_nan)]
   if (allocated(slot%outcome%work_mismatch)) worst(3) = slot%outcome%work_mismatch
   if (.not. allocated(slot%outcome%norms)) return
   associate (found => slot%outcome%norms)
      seconds(3) = seconds(3) + found%seconds
      norms = [found%l2, found%h1, found%l2_solution, found%h1_solution]
   end associate
end subroutine scene_states

!> Warnings of the last solve, also of one that failed, each with its line feed. `length` is that of
!> the whole text; where it is above `capacity` the caller asks again with more.
subroutine scene_warnings(handle, capacity, text, length, stat, message)
   use rk_handles, only : look_up, slot_type
   implicit none
   integer, intent(in) :: handle, capacity
   character(len=capacity), intent(out) :: text
   integer, intent(out) :: length, stat
   character(len=2048), intent(out) :: message
   type(slot_type), pointer :: slot

   text = ''
   length = 0
   call look_up(handle, slot, stat, message)
   if (stat /= 0 .or. .not. allocated(slot%outcome%warnings)) return
   length = len(slot%outcome%warnings)
   text = slot%outcome%warnings
end subroutine scene_warnings

!> Verdict on the last solve: 0 for none, 1 accepted, 2 doubtful, 3 refused; its reasons, each with
!> its line feed; error bars of the probes, three numbers each, at loads and values, not a number
!> where there is none. `length` is that of the whole text, see scene_warnings.
subroutine scene_verdict(handle, np, k, load, value, capacity, verdict, bar, text, length, stat, &
   & message)
   use, intrinsic :: ieee_arithmetic, only : ieee_quiet_nan, ieee_value
   use rk_handles, only : look_up, slot_type
   use rk_probes, only : quantity_size
   implicit none
   integer, intent(in) :: handle, np, k, capacity
   double precision, intent(in) :: load(k), value(3, np, k)
   integer, intent(out) :: verdict, length, stat
   double precision, intent(out) :: bar(3, np, k)
   character(len=capacity), intent(out) :: text
   character(len=2048), intent(out) :: message
   type(slot_type), pointer :: slot
   integer :: i, j, n

   verdict = 0
   bar = ieee_value(1.0d0, ieee_quiet_nan)
   text = ''
   length = 0
   call look_up(handle, slot, stat, message)
   if (stat /= 0 .or. .not. allocated(slot%verdict%reasons)) return
   verdict = slot%verdict%state
   length = len(slot%verdict%reasons)
   text = slot%verdict%reasons
   if (.not. allocated(slot%verdict%bars%change)) return
   do j = 1, k
      do i = 1, min(np, size(slot%scene%probe))
         n = quantity_size(slot%scene%probe(i)%quantity)
         if (slot%verdict%bars%change(i) >= 0) bar(:n, i, j) = slot%verdict%bars%at(i, load(j), &
            & value(:n, i, j))
      end do
   end do
end subroutine scene_verdict

!> Names and components of the fields of a body, a line each
subroutine scene_field_list(text)
   use rk_fields, only : field_names, field_sizes
   use rk_text, only : to_text
   implicit none
   character(len=1024), intent(out) :: text
   integer :: k

   text = ''
   do k = 1, size(field_names)
      text = trim(text)//trim(field_names(k))//' '//to_text(field_sizes(k))//new_line('a')
   end do
end subroutine scene_field_list

!> All fields at all collocation points for one state of the full problem, one under the other in
!> the order of the list
subroutine scene_fields(handle, n, nc, rows, x, load, values, stat, message)
   use rk_fields, only : compute_fields
   use rk_handles, only : look_up, slot_type
   use rk_point_field, only : point_field
   use rk_states, only : field_state
   implicit none
   !f2py threadsafe
   integer, intent(in) :: handle, n, nc, rows
   double precision, intent(in) :: x(n), load
   double precision, intent(out) :: values(rows, nc)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(slot_type), pointer :: slot
   type(field_state) :: state
   type(point_field), allocatable :: fields(:)
   integer :: k, row

   values = 0
   call look_up(handle, slot, stat, message)
   if (stat /= 0) return
   call slot%full%state(x, load, state)
   call compute_fields(slot%full, state, fields)
   row = 0
   do k = 1, size(fields)
      values(row + 1:row + size(fields(k)%value, 1), :) = fields(k)%value
      row = row + size(fields(k)%value, 1)
   end do
end subroutine scene_fields

!> Gradient A^T r and second derivatives (upper triangle) of r.r/2, with the row weights of a load
!> step that starts at `start`
subroutine scene_hessian(handle, reduced, n, start, x, load, gradient, second, stat, message)
   use rk_error, only : error_type
   use rk_operator, only : row_operator
   use rk_pack, only : pack_error
   use rk_problem, only : problem_type
   use rk_session, only : evaluate_session
   implicit none
   !f2py threadsafe
   integer, intent(in) :: handle, reduced, n
   double precision, intent(in) :: start(n), x(n), load
   double precision, intent(out) :: gradient(n), second(n, n)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   class(problem_type), pointer :: problem
   class(row_operator), pointer :: op
   double precision, allocatable :: r(:)

   gradient = 0
   second = 0
   call evaluate_session(handle, reduced /= 0, start, x, load, problem, r, error)
   call pack_error(error, stat, message)
   if (stat /= 0) return
   op => problem%operator()
   call op%apply_transposed(r, gradient)
   call problem%hessian(x, load, r, second)
end subroutine scene_hessian

!> Residual and linearised rows times a direction, of the full (reduced = 0) or the reduced problem;
!> the row weights are those of a load step that starts at `start`
subroutine scene_linearise(handle, reduced, n, m, start, x, load, dx, r, y, stat, message)
   use rk_error, only : error_type
   use rk_operator, only : row_operator
   use rk_pack, only : pack_error
   use rk_problem, only : problem_type
   use rk_session, only : evaluate_session
   implicit none
   !f2py threadsafe
   integer, intent(in) :: handle, reduced, n, m
   double precision, intent(in) :: start(n), x(n), load, dx(n)
   double precision, intent(out) :: r(m), y(m)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   class(problem_type), pointer :: problem
   class(row_operator), pointer :: op
   double precision, allocatable :: residual(:)

   r = 0
   y = 0
   call evaluate_session(handle, reduced /= 0, start, x, load, problem, residual, error)
   call pack_error(error, stat, message)
   if (stat /= 0) return
   r = residual
   op => problem%operator()
   call op%apply(dx, y)
end subroutine scene_linearise

!> Values of all probes, three numbers each, for states of the full problem
subroutine scene_probes(handle, n, k, np, x, load, value, stat, message)
   use rk_error, only : error_type
   use rk_handles, only : look_up, slot_type
   use rk_pack, only : pack_error
   use rk_probes, only : new_probes, probe_value, probes_type
   use rk_states, only : field_state
   implicit none
   !f2py threadsafe
   integer, intent(in) :: handle, n, k, np
   double precision, intent(in) :: x(n, k), load(k)
   double precision, intent(out) :: value(3, np, k)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(slot_type), pointer :: slot
   type(field_state) :: state
   type(probes_type) :: probes
   integer :: i, j

   value = 0
   call look_up(handle, slot, stat, message)
   if (stat /= 0) return
   call new_probes(probes, slot%scene, error)
   call pack_error(error, stat, message)
   if (stat /= 0) return
   do j = 1, k
      call slot%full%state(x(:, j), load(j), state)
      do i = 1, size(slot%scene%probe)
         call probe_value(slot%full, probes, i, state, value(:, i, j))
      end do
   end do
end subroutine scene_probes
