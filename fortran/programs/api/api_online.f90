!> Reduced models in real time: arrays of a model that Python holds, and its states.
!>
!> Sizes in this order: modes, all amplitudes, the same padded, cells, fibers of all cells,
!> pieces and entries of the volume, tissues, parameters of the materials. `law` holds lambda_o,
!> gamma1, gamma2, whether the curves are smooth (1) and the axis about which fibers turn, of each
!> tissue; `state` and `known` activation, sigma_max and angle of each tissue.

!> States of a model, with forces by a second set of cells; a state is followed in `parts` from a
!> known one, or for 0 parts found from the amplitudes given
subroutine online_states(r, s, wide, nc, ne, kept, triples, nt, nm, h, weight, local_bulk, a, &
   & first, tissue, fraction, fiber, a_slope, bulk_slope, constant, constant_slope, volume, &
   & volume_slope, law, nq, nqe, all_h, all_weight, all_local, all_a, all_first, all_tissue, &
   & all_fraction, all_fiber, all_a_slope, all_bulk_slope, n, state, modulus, given, start, parts, &
   & known_state, known_modulus, known_given, least, tolerance, most_steps, threads, nf, wanted, &
   & lift, z, iterations, change, min_j, force)
   use, intrinsic :: ieee_arithmetic, only : ieee_quiet_nan, ieee_value
   use omp_lib, only : omp_get_max_threads
   use rk_cell_law, only : law_type
   use rk_fiber, only : active_curve, passive_curve
   use rk_online, only : find_forces, follow, new_work, online_model, prescribed_type, &
      & solve_state, work_type
   implicit none
   !f2py threadsafe
   integer, intent(in) :: r, s, wide, nc, ne, kept, triples, nt, nm, nq, nqe, n, most_steps
   integer, intent(in) :: threads, nf
   double precision, intent(in), target :: h(wide, 9, nc), weight(nc), local_bulk(nc), a(9, nc)
   integer, intent(in), target :: first(nc + 1), tissue(ne)
   double precision, intent(in), target :: fraction(ne), fiber(3, ne), constant(s, s)
   double precision, intent(in), target :: volume(8, triples, kept), law(7, nt)
   double precision, intent(in), target :: a_slope(9, nc, nm), bulk_slope(nc, nm)
   double precision, intent(in), target :: constant_slope(s, s, nm), volume_slope(kept, nm)
   double precision, intent(in), target :: all_a_slope(9, nq, nm), all_bulk_slope(nq, nm)
   double precision, intent(in), target :: all_h(wide, 9, nq), all_weight(nq), all_local(nq)
   double precision, intent(in), target :: all_a(9, nq), all_fraction(nqe), all_fiber(3, nqe)
   integer, intent(in), target :: all_first(nq + 1), all_tissue(nqe)
   double precision, intent(in) :: state(nt, 3, n), modulus(nm, n), given(s - r, n)
   double precision, intent(in) :: start(s, n), known_state(nt, 3, n), known_modulus(nm, n)
   double precision, intent(in) :: known_given(s - r, n), least, tolerance
   double precision, intent(in) :: lift(r, nf, n)
   integer, intent(in) :: parts(n), wanted(nf)
   double precision, intent(out) :: z(s, n), change(n), min_j(n), force(nf, n)
   integer, intent(out) :: iterations(n)
   type(law_type), target :: laws(nt)
   type(online_model) :: model, whole
   type(work_type) :: work, room
   type(prescribed_type) :: known, wish
   integer :: i, team

   do i = 1, nt
      laws(i) = law_type(law(1, i), active_curve(law(4, i) > 0.5d0), &
         & passive_curve(law(4, i) > 0.5d0, law(2, i), law(3, i)), law(5:7, i))
   end do
   model = online_model(r, s, least, h, weight, local_bulk, a, first, tissue, fraction, fiber, &
      & laws, constant, volume, a_slope, bulk_slope, constant_slope, volume_slope)
   whole = online_model(r, s, least, all_h, all_weight, all_local, all_a, all_first, all_tissue, &
      & all_fraction, all_fiber, laws, constant, volume, all_a_slope, all_bulk_slope, &
      & constant_slope, volume_slope)
   z = start
   force = ieee_value(1.0d0, ieee_quiet_nan)
   team = threads
   if (team == 0) team = omp_get_max_threads()
   !$omp parallel default(shared) private(i, work, room, known, wish) num_threads(team)
   call new_work(work, model)
   if (nf > 0) call new_work(room, whole)
   !$omp do schedule(dynamic, 8)
   do i = 1, n
      wish = prescribed_type(state(:, 1, i), state(:, 2, i), state(:, 3, i), modulus(:, i), &
         & given(:, i))
      if (parts(i) > 0) then
         known = prescribed_type(known_state(:, 1, i), known_state(:, 2, i), &
            & known_state(:, 3, i), known_modulus(:, i), known_given(:, i))
         z(r + 1:, i) = known%given
         call follow(model, work, known, wish, parts(i), tolerance, most_steps, z(:, i), &
            & iterations(i), change(i))
      else
         call solve_state(model, work, wish, tolerance, most_steps, z(:, i), iterations(i), &
            & change(i))
      end if
      min_j(i) = work%min_j
      if (nf > 0 .and. iterations(i) > 0) call find_forces(whole, room, wish, z(:, i), wanted, &
         & lift(:, :, i), force(:, i))
   end do
   !$omp end do
   !$omp end parallel
end subroutine online_states

!> Residual and tangent of one state, and the stresses times weights of its cells
subroutine online_assemble(r, s, wide, nc, ne, kept, triples, nt, nm, h, weight, local_bulk, a, &
   & first, tissue, fraction, fiber, a_slope, bulk_slope, constant, constant_slope, volume, &
   & volume_slope, law, state, modulus, z, residual, tangent, stress, min_j)
   use rk_cell_law, only : law_type
   use rk_fiber, only : active_curve, passive_curve
   use rk_online, only : assemble, new_work, online_model, prescribed_type, work_type
   implicit none
   !f2py threadsafe
   integer, intent(in) :: r, s, wide, nc, ne, kept, triples, nt, nm
   double precision, intent(in), target :: h(wide, 9, nc), weight(nc), local_bulk(nc), a(9, nc)
   integer, intent(in), target :: first(nc + 1), tissue(ne)
   double precision, intent(in), target :: fraction(ne), fiber(3, ne), constant(s, s)
   double precision, intent(in), target :: volume(8, triples, kept), law(7, nt)
   double precision, intent(in), target :: a_slope(9, nc, nm), bulk_slope(nc, nm)
   double precision, intent(in), target :: constant_slope(s, s, nm), volume_slope(kept, nm)
   double precision, intent(in) :: state(nt, 3), modulus(nm), z(s)
   double precision, intent(out) :: residual(s), tangent(s, s), stress(9, nc), min_j
   type(law_type), target :: laws(nt)
   type(online_model) :: model
   type(work_type) :: work
   integer :: i

   do i = 1, nt
      laws(i) = law_type(law(1, i), active_curve(law(4, i) > 0.5d0), &
         & passive_curve(law(4, i) > 0.5d0, law(2, i), law(3, i)), law(5:7, i))
   end do
   model = online_model(r, s, tiny(1.0d0), h, weight, local_bulk, a, first, tissue, fraction, &
      & fiber, laws, constant, volume, a_slope, bulk_slope, constant_slope, volume_slope)
   call new_work(work, model)
   call assemble(model, work, z, prescribed_type(state(:, 1), state(:, 2), state(:, 3), modulus, &
      & z(r + 1:)), .true., .true.)
   residual = work%residual
   tangent = work%tangent
   stress = work%f
   min_j = work%min_j
end subroutine online_assemble
