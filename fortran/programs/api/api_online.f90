!> Reduced models in real time: model records that Python packs once (`whole`, `number`, as unpacked
!> by new_online), and their states, for the quantities requested (`wish`, as in assemble).

!> States of a model, with forces by a second set of cells; a state is followed in `parts` from a
!> known one, or for 0 parts found from the given amplitudes. `limits` has the size below which
!> amplitudes count as zero, and the tolerance; `wanted` is a single 0 if no force is requested
subroutine online_states(ni, nr, whole, number, mi, mr, all_whole, all_number, s, nk, n, wish, &
   & known, start, parts, limits, most_steps, threads, r, nf, wanted, lift, z, iterations, change, &
   & min_j, force)
   use, intrinsic :: ieee_arithmetic, only : ieee_quiet_nan, ieee_value
   use omp_lib, only : omp_get_max_threads
   use rk_online, only : find_forces, follow, new_online, new_work, online_model, solve_state, &
      & work_type
   use rk_threads, only : hold_threads, release_threads, threads_type
   implicit none
   !f2py threadsafe
   integer, intent(in) :: ni, nr, mi, mr, s, nk, n, most_steps, threads, r, nf
   integer, intent(in), target :: whole(ni), all_whole(mi)
   double precision, intent(in), target :: number(nr), all_number(mr)
   double precision, intent(in) :: wish(nk, n), known(nk, n), start(s, n), limits(2)
   double precision, intent(in) :: lift(r, nf, n)
   integer, intent(in) :: parts(n), wanted(nf)
   double precision, intent(out) :: z(s, n), change(n), min_j(n), force(nf, n)
   integer, intent(out) :: iterations(n)
   type(online_model) :: model, every
   type(work_type) :: work, room
   type(threads_type) :: kept
   integer :: i, team
   logical :: with_forces

   with_forces = all(wanted > 0)
   call new_online(model, whole, number, limits(1))
   call new_online(every, all_whole, all_number, limits(1))
   z = start
   force = ieee_value(1.0d0, ieee_quiet_nan)
   team = threads
   if (team == 0) team = omp_get_max_threads()
   ! libraries called from a team of several threads use one thread each
   if (team == 1) call hold_threads(kept)
   !$omp parallel default(shared) private(i, work, room) num_threads(team)
   call new_work(work, model)
   if (with_forces) call new_work(room, every)
   !$omp do schedule(dynamic, 8)
   do i = 1, n
      if (parts(i) > 0) then
         call follow(model, work, known(:, i), wish(:, i), parts(i), limits(2), most_steps, &
            & z(:, i), iterations(i), change(i))
      else
         call solve_state(model, work, wish(:, i), limits(2), most_steps, z(:, i), iterations(i), &
            & change(i))
      end if
      min_j(i) = work%min_j
      if (with_forces .and. iterations(i) > 0) call find_forces(every, room, wish(:, i), z(:, i), &
         & wanted, lift(:, :, i), force(:, i))
   end do
   !$omp end do
   !$omp end parallel
   if (team == 1) call release_threads(kept)
end subroutine online_states

!> Residual and tangent of one state, and the stresses times weights of its cells
subroutine online_assemble(ni, nr, whole, number, nk, wish, s, nc, z, residual, tangent, stress, &
   & min_j)
   use rk_online, only : assemble, new_online, new_work, online_model, work_type
   use rk_threads, only : hold_threads, release_threads, threads_type
   implicit none
   !f2py threadsafe
   integer, intent(in) :: ni, nr, nk, s, nc
   integer, intent(in), target :: whole(ni)
   double precision, intent(in), target :: number(nr)
   double precision, intent(in) :: wish(nk), z(s)
   double precision, intent(out) :: residual(s), tangent(s, s), stress(9, nc), min_j
   type(online_model) :: model
   type(work_type) :: work
   type(threads_type) :: kept

   call new_online(model, whole, number, tiny(1.0d0))
   call new_work(work, model)
   call hold_threads(kept)
   call assemble(model, work, z, wish, .true., .true.)
   call release_threads(kept)
   residual = work%residual
   tangent = work%tangent
   stress = reshape(work%f, [9, nc])
   min_j = work%min_j
end subroutine online_assemble
