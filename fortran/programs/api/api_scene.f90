! Python boundary of scenes: a handle in, arrays out. Python checks shapes before it calls.

!> Open the scene of a deck, whose text is blank where it is a file; the arrays are those of a model
!> and may be empty: by source point its place and spacing; by collocation point place, fiber,
!> volume, activation and fractions, then label and voxel; by boundary entry normal and area, then
!> point and set; size and origin of the voxels. A size of 0 stands for none, and so do fractions
!> of one label and activations below 0. `listener` is the address of a C function that takes a line
!> of the search for points and returns 1 to stop it. Not threadsafe: gfortran keeps the lengths of
!> character function results in static storage, and keys are made of such results
subroutine scene_open(path, text, nover, overrides, ns, nc, nb, nset, nf, source, point, place, &
   & entry, entry_of, grid, fraction_label, set_names, length_unit, listener, handle, stat, message)
   use, intrinsic :: iso_c_binding, only : c_f_procpointer, c_null_funptr
   use rk_cloud, only : cloud_type, take_arrays
   use rk_error, only : error_type, pack_error
   use rk_handles, only : listener_interface
   use rk_session, only : open_session
   implicit none
   !f2py integer*8 listener
   integer(8), intent(in) :: listener
   integer, intent(in) :: nover, ns, nc, nb, nset, nf
   character(len=*), intent(in) :: path, text, overrides(nover), set_names(nset), length_unit
   double precision, intent(in) :: source(3, 2, ns), point(8 + nf, nc), entry(4, nb), grid(3, 2)
   integer, intent(in) :: place(4, nc), entry_of(2, nb), fraction_label(nf)
   integer, intent(out) :: handle, stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(cloud_type) :: model
   procedure(listener_interface), pointer :: reader

   call c_f_procpointer(transfer(listener, c_null_funptr), reader)
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
   if (.not. allocated(error)) call open_session(path, text, overrides, model, reader, handle, &
      & error)
   call pack_error(error, stat, message)
end subroutine scene_open

!> Change loads, material parameters, steps, solver or probes of an open scene. Not threadsafe, as
!> scene_open
subroutine scene_update(handle, nover, overrides, stat, message)
   use rk_error, only : error_type, pack_error
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

!> Solve all load steps of the full (reduced = 0) or the reduced problem with a number of threads,
!> 0 for all cores, without (estimate = 0) or with error bars; threads are a matter of the calling
!> thread, so it is set here. The iteration begins at `start`, unknowns that may all be zero
subroutine scene_solve(handle, n, linear, reduced, threads, estimate, start, stat, message)
   use omp_lib, only : omp_set_num_threads
   use rk_error, only : error_type, pack_error
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

!> Ask about an open scene: a question of rk_questions, the word and the numbers that it needs,
!> behind them one that does not count; the number of arrays of the answer
subroutine scene_ask(handle, question, word, n, given, count, stat, message)
   use rk_error, only : error_type, pack_error
   use rk_handles, only : slot_type
   use rk_questions, only : ask
   implicit none
   !f2py threadsafe
   integer, intent(in) :: handle, n
   character(len=*), intent(in) :: question, word
   double precision, intent(in) :: given(n)
   integer, intent(out) :: count, stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(slot_type), pointer :: slot

   count = 0
   call ask(handle, question, word, given(:n - 1), slot, error)
   if (.not. allocated(error)) count = slot%answer%count
   call pack_error(error, stat, message)
end subroutine scene_ask

!> An array of the last answer: its name, what its numbers are (rk_handles), its rank and shape
subroutine answer_form(handle, number, name, kind, rank, extent)
   use rk_error, only : error_type
   use rk_handles, only : find_slot, slot_type
   implicit none
   integer, intent(in) :: handle, number
   character(len=16), intent(out) :: name
   integer, intent(out) :: kind, rank, extent(3)
   type(error_type), allocatable :: error
   type(slot_type), pointer :: slot

   name = ''
   kind = 0
   rank = 0
   extent = 0
   call find_slot(handle, slot, error)
   if (allocated(error)) return
   associate (array => slot%answer%array(number))
      name = array%name
      kind = array%kind
      rank = size(array%shape)
      extent(:rank) = array%shape
   end associate
end subroutine answer_form

!> Its numbers, which the core gives away
subroutine answer_numbers(handle, number, n, value)
   use rk_error, only : error_type
   use rk_handles, only : find_slot, slot_type
   implicit none
   integer, intent(in) :: handle, number, n
   double precision, intent(out) :: value(n)
   type(error_type), allocatable :: error
   type(slot_type), pointer :: slot

   value = 0
   call find_slot(handle, slot, error)
   if (allocated(error)) return
   value = slot%answer%array(number)%value
   deallocate (slot%answer%array(number)%value)
end subroutine answer_numbers
