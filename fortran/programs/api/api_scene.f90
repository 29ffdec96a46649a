! Python boundary of scenes: a handle in, arrays out. Python checks shapes before its calls.

!> Open the scene of a deck, whose text is blank if it is a file; the arrays are those of a model
!> and may be empty: by source point position and spacing; by collocation point position, fiber,
!> volume, activation and fractions, then label and voxel; by boundary entry normal and area, then
!> point and set; size and origin of the voxels. A size of 0 stands for none, and so do fractions of
!> one label and activations below 0. `listener` is the address of a C function that takes a line of
!> the search for points and returns 1 to stop it. Not threadsafe: gfortran keeps the lengths of
!> character function results in static storage, and keys are made of such results
subroutine scene_open(path, text, nover, overrides, ns, nc, nb, nset, nf, source, point, place, &
   & entry, entry_of, grid, fraction_label, set_names, length_unit, listener, handle, stat, message)
   use, intrinsic :: iso_c_binding, only : c_f_procpointer, c_loc, c_null_funptr
   use rk_cloud, only : cloud_type, take_arrays
   use rk_error, only : error_type, pack_error
   use rk_handles, only : listener_interface, slot_type
   use rk_session, only : open_session
   implicit none
   !f2py integer*8 listener, handle
   integer(8), intent(in) :: listener
   integer, intent(in) :: nover, ns, nc, nb, nset, nf
   character(len=*), intent(in) :: path, text, overrides(nover), set_names(nset), length_unit
   double precision, intent(in) :: source(3, 2, ns), point(8 + nf, nc), entry(4, nb), grid(3, 2)
   integer, intent(in) :: place(4, nc), entry_of(2, nb), fraction_label(nf)
   integer(8), intent(out) :: handle
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(slot_type), pointer :: slot
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
   ! a single tissue has no fractions
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
   if (.not. allocated(error)) call open_session(path, text, overrides, model, reader, slot, error)
   if (.not. allocated(error)) handle = transfer(c_loc(slot), handle)
   call pack_error(error, stat, message)
end subroutine scene_open

subroutine scene_close(handle)
   use rk_handles, only : close_slot, slot_of, slot_type
   implicit none
   !f2py integer*8 handle
   integer(8), intent(in) :: handle
   type(slot_type), pointer :: slot

   slot => slot_of(handle)
   call close_slot(slot)
end subroutine scene_close

!> Steps and iterations done so far, readable while a solve runs in another thread, which is asked
!> to stop after its iteration (stop = 1)
subroutine scene_progress(handle, stop, steps, iterations)
   use rk_handles, only : slot_of, slot_type
   implicit none
   !f2py integer*8 handle
   integer(8), intent(in) :: handle
   integer, intent(in) :: stop
   integer, intent(out) :: steps, iterations
   type(slot_type), pointer :: slot

   slot => slot_of(handle)
   if (stop /= 0) slot%states%stop = .true.
   steps = slot%states%steps
   iterations = slot%states%iterations
end subroutine scene_progress

!> Ask about an open scene: a question of rk_questions, the word and the numbers that it needs,
!> followed by one unused number; contents of the answer (rk_handles), and how many numbers
subroutine scene_ask(handle, question, word, n, given, forms, count, stat, message)
   use rk_error, only : error_type, pack_error
   use rk_handles, only : slot_of, slot_type
   use rk_questions, only : ask
   implicit none
   !f2py threadsafe
   !f2py integer*8 handle
   integer(8), intent(in) :: handle
   integer, intent(in) :: n
   character(len=*), intent(in) :: question, word
   double precision, intent(in) :: given(n)
   character(len=2048), intent(out) :: forms, message
   integer, intent(out) :: count, stat
   type(error_type), allocatable :: error
   type(slot_type), pointer :: slot

   slot => slot_of(handle)
   call ask(slot, question, word, given(:n - 1), error)
   forms = slot%answer%forms
   count = size(slot%answer%value)
   call pack_error(error, stat, message)
end subroutine scene_ask

!> Numbers of the last answer, which is released afterwards
subroutine answer_numbers(handle, n, value)
   use rk_handles, only : slot_of, slot_type
   implicit none
   !f2py integer*8 handle
   integer(8), intent(in) :: handle
   integer, intent(in) :: n
   double precision, intent(out) :: value(n)
   type(slot_type), pointer :: slot

   slot => slot_of(handle)
   value = slot%answer%value
   deallocate (slot%answer%value)
end subroutine answer_numbers
