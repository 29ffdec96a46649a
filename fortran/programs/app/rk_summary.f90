!> summary.json of a solve.
module rk_summary
   use, intrinsic :: ieee_arithmetic, only : ieee_quiet_nan, ieee_value
   use, intrinsic :: ieee_arithmetic, only : ieee_is_nan
   use rk_bars, only : another_form, bars_type, printed
   use rk_borders, only : extent_of
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type
   use rk_error_norms, only : norms_type
   use rk_exact, only : exact_value
   use rk_json, only : json_type
   use rk_json_entries, only : json_entry, read_entries
   use rk_output, only : output_type, step_record
   use rk_precision, only : wp
   use rk_probes, only : numbers_of
   use rk_refine, only : refinement_type
   use rk_run, only : outcome_type
   use rk_scene, only : scene_type
   use rk_system, only : cpu_seconds, peak_bytes, version_text
   use rk_text_file, only : move_file
   use rk_units, only : get_set_unit, put_probe_units, put_units
   use rk_verdict, only : refused, verdict_names, verdict_type
   implicit none
   private

   public :: write_summary, write_refusal, set_aside, put_back, earlier_entries

   !> Entries of the stations before a solve, which stay valid for any solution; all others,
   !> including `rom`, describe one solution, and are dropped with it
   character(len=*), parameter :: kept(*) = [character(len=14) :: 'segmentation', 'tissue', &
      & 'model', 'resampled', 'damaged_slices']

contains

subroutine write_summary(path, deck, output, outcome, verdict, refinement, shape_s, total_s, &
   & threads, earlier, error)
   character(len=*), intent(in) :: path
   type(deck_type), intent(in) :: deck
   !> States of a problem with their probes
   type(output_type), intent(in) :: output
   !> Results and outcome of the run
   type(outcome_type), intent(in) :: outcome
   !> Verdict: whether it can be trusted, and how far
   type(verdict_type), intent(in) :: verdict
   !> Search for the points, if one was requested
   type(refinement_type), intent(in) :: refinement
   !> Wall times of shape functions and of everything [s]
   real(wp), intent(in) :: shape_s, total_s
   integer, intent(in) :: threads
   !> Entries of the existing file
   type(json_entry), intent(in) :: earlier(:)
   type(error_type), allocatable, intent(out) :: error
   type(json_type) :: json
   character(len=:), allocatable :: asked, kind, unit
   integer :: k

   asked = deck%overrides
   if (allocated(refinement%asked)) asked = refinement%asked
   associate (problem => output%problem, scene => output%problem%scene, &
      & converged => .not. allocated(outcome%ended))
      call json%begin_object()
      call json%put('title', scene%title)
      call json%put('deck_sha256', deck%sha256)
      call json%put_lines('overrides', asked)
      call put_units(json, 'units', deck)
      call json%put('method', scene%method)
      call json%put('dimension', scene%cloud%nd)
      call json%put('version', version_text())
      call json%begin_object('solver')
      call json%put('asked', scene%solver%linear)
      if (allocated(output%last%solver%used)) then
         call json%put('used', output%last%solver%used)
         call json%put('why', output%last%solver%why)
      end if
      call json%put('backward_error', output%backward_error)
      call json%put('misfit', output%misfit)
      call json%put('reciprocal_condition', output%rcond)
      call json%end_object()
      call json%put('source_points', problem%shape%ns)
      call json%put('collocation_points', size(scene%cloud%points, 2))
      call get_set_unit(deck, unit)
      if (allocated(scene%cloud%region)) call write_sets(json, scene%cloud, unit)
      call json%put('stencils', maxval(problem%shape%stencil))
      call json%put('dofs', problem%n)
      call json%put('rows', problem%m)
      call json%put('threads', threads)
      call json%put('converged', converged)
      if (.not. converged) call json%put('message', outcome%ended)
      call write_verdict(json, verdict)
      if (allocated(refinement%reason)) call write_refinement(json, refinement, problem, verdict)
      call put_probe_units(json, deck)
      call write_steps(json, problem, output, verdict)
      if (converged) call write_exact(json, problem, output)
      if (allocated(outcome%norms)) call write_norms(json, outcome%norms)
      call write_references(json, problem, output)
      call json%put('force_imbalance', outcome%imbalance)
      if (allocated(outcome%work_mismatch)) call json%put('work_mismatch', outcome%work_mismatch)
      call json%begin_object('timings_s')
      call json%put('shape', shape_s)
      call json%put('assemble', outcome%timer%assemble)
      call json%put('solve', outcome%timer%solve)
      call json%put('output', output%seconds + outcome%seconds)
      if (allocated(outcome%norms)) call json%put('errors', outcome%norms%seconds)
      if (verdict%companion%seconds > 0.0_wp) call json%put('companion', verdict%companion%seconds)
      call json%put('total', total_s)
      call json%end_object()
      call json%put('cpu_s', cpu_seconds())
      call json%put('memory_peak_bytes', peak_bytes())
      call json%put_lines('warnings', outcome%warnings)
      call deck%get('geometry.kind', kind)
      ! the model of a folder is not the body of a deck with a box
      call put_kept(json, pack(earlier, kind == 'model' &
         & .or. [(earlier(k)%key /= 'model', k=1, size(earlier))]))
      call json%put_json('deck', deck%json)
      call json%end_object()
   end associate
   call json%save(path, error)
end subroutine write_summary

!> Sets that are parts of the surface
subroutine write_sets(json, cloud, unit)
   type(json_type), intent(inout) :: json
   type(cloud_type), intent(in) :: cloud
   character(len=*), intent(in) :: unit
   type(error_type), allocatable :: error
   real(wp) :: area, middle(cloud%nd)
   integer :: k

   call json%begin_array('sets')
   do k = cloud%sides() + 1, size(cloud%set_names)
      ! an expression without a value was refused before the solve
      call extent_of(cloud, k, area, middle, error)
      call json%begin_object()
      call json%put('name', trim(cloud%set_names(k)))
      call json%put('boundary_points', count(cloud%within(k, :)))
      call json%put('area', area)
      call json%put('unit', unit)
      call json%put('middle', middle)
      call json%end_object()
   end do
   call json%end_array()
end subroutine write_sets

!> Rename the summary of a finished solution until a later run has finished, so that it is not taken
!> for that of the current run
subroutine set_aside(folder, earlier, finished, error)
   !> Folder, locked by this process
   character(len=*), intent(in) :: folder
   !> Entries of the summary in it
   type(json_entry), intent(in) :: earlier(:)
   !> Whether it was renamed
   logical, intent(out) :: finished
   type(error_type), allocatable, intent(out) :: error
   integer :: k

   ! it may exist only under its other name
   inquire (file=folder//'/summary.json', exist=finished)
   if (.not. finished) return
   finished = any([(earlier(k)%key == 'converged' .and. earlier(k)%value == 'true', &
      & k=1, size(earlier))])
   do k = 1, size(earlier)
      ! quotation marks inside a text are preceded by a backslash
      if (earlier(k)%key == 'verdict') finished = finished .and. index(earlier(k)%value, &
         & '"'//trim(verdict_names(refused))//'"') == 0
   end do
   if (finished) call move_file(folder//'/summary.json', folder//'/summary.json.previous', error)
end subroutine set_aside

!> Put the summary of an earlier solution back after a request that was refused
subroutine put_back(folder, earlier, aside, done, error)
   !> Folder, locked by this process
   character(len=*), intent(in) :: folder
   !> Entries of the earlier summary
   type(json_entry), intent(in) :: earlier(:)
   !> Whether this run renamed it
   logical, intent(in) :: aside
   !> Whether there was a solution
   logical, intent(out) :: done
   type(error_type), allocatable, intent(out) :: error
   type(json_type) :: json
   integer :: k

   done = any([(earlier(k)%key == 'steps' .and. verify(earlier(k)%value, '[] ') > 0, &
      & k=1, size(earlier))])
   if (.not. done) return
   if (aside) then
      call move_file(folder//'/summary.json.previous', folder//'/summary.json', error)
      return
   end if
   call json%begin_object()
   do k = 1, size(earlier)
      call json%put_json(earlier(k)%key, earlier(k)%value)
   end do
   call json%end_object()
   call json%save(folder//'/summary.json', error)
end subroutine put_back

!> Write a summary that states why a run has no solution
subroutine write_refusal(folder, reason, earlier, error)
   !> Folder, locked by this process
   character(len=*), intent(in) :: folder
   !> Why there is no solution
   character(len=*), intent(in) :: reason
   !> Entries of an earlier summary
   type(json_entry), intent(in) :: earlier(:)
   type(error_type), allocatable, intent(out) :: error
   type(json_type) :: json

   call json%begin_object()
   call json%put('version', version_text())
   call json%put('converged', .false.)
   call json%put('message', reason)
   call json%begin_object('verdict')
   call json%put('state', trim(verdict_names(refused)))
   call json%put('reasons', [reason])
   call json%end_object()
   call json%put_lines('steps', '')
   call json%put('cpu_s', cpu_seconds())
   call json%put('memory_peak_bytes', peak_bytes())
   call json%put_lines('warnings', '')
   call put_kept(json, earlier)
   call json%end_object()
   call json%save(folder//'/summary.json', error)
end subroutine write_refusal

!> Entries of the summary in a folder, or, if there is none, of the one set aside
subroutine earlier_entries(folder, entries, damaged)
   character(len=*), intent(in) :: folder
   type(json_entry), allocatable, intent(out) :: entries(:)
   !> The file exists and is not a JSON object
   logical, intent(out) :: damaged

   call read_entries(folder//'/summary.json', entries, damaged)
   if (.not. damaged .and. size(entries) == 0) call read_entries(folder &
      & //'/summary.json.previous', entries, damaged)
end subroutine earlier_entries

!> Entries of earlier stations that stay valid for any solution
subroutine put_kept(json, earlier)
   type(json_type), intent(inout) :: json
   !> Entries of an earlier summary
   type(json_entry), intent(in) :: earlier(:)
   integer :: k

   do k = 1, size(earlier)
      if (any(kept == earlier(k)%key)) call json%put_json(earlier(k)%key, earlier(k)%value)
   end do
end subroutine put_kept

subroutine write_refinement(json, refinement, problem, verdict)
   type(json_type), intent(inout) :: json
   type(refinement_type), intent(in) :: refinement
   !> Problem on the points found
   class(discretisation_type), intent(in) :: problem
   !> Verdict with bars
   type(verdict_type), intent(in) :: verdict
   integer :: points(3), i, n

   associate (cloud => problem%scene%cloud)
      n = cloud%nd
      points = 0
      if (allocated(cloud%lattice)) then
         points(:n) = cloud%lattice
      else if (allocated(cloud%block)) then
         points(:n) = maxval(cloud%block, dim=2) + 1
      end if
   end associate
   call json%begin_object('refine')
   call json%put('asked', refinement%wanted)
   if (refinement%reached >= 0.0_wp) call json%put('reached', refinement%reached)
   call json%put('points', points(:n))
   call json%put('met', refinement%met)
   call json%put('reason', refinement%reason)
   call json%put('cpu_s', refinement%seconds)
   call json%put_lines('levels', refinement%levels)
   call json%begin_object('sources')
   if (allocated(verdict%bars%change)) then
      do i = 1, size(verdict%bars%change)
         call json%put(problem%scene%probe(i)%name, trim(verdict%bars%source(i)))
      end do
   end if
   call json%end_object()
   call json%end_object()
end subroutine write_refinement

!> Error against the known solution
subroutine write_norms(json, norms)
   type(json_type), intent(inout) :: json
   type(norms_type), intent(in) :: norms

   call json%begin_object('errors')
   call json%put('L2', norms%l2)
   call json%put('H1', norms%h1)
   call json%put('relative_L2', norms%l2/max(norms%l2_solution, tiny(1.0_wp)))
   call json%put('relative_H1', norms%h1/max(norms%h1_solution, tiny(1.0_wp)))
   call json%end_object()
end subroutine write_norms

!> Load steps with probes
subroutine write_steps(json, problem, output, verdict)
   type(json_type), intent(inout) :: json
   class(discretisation_type), intent(in) :: problem
   type(output_type), intent(in) :: output
   !> Verdict with error bars
   type(verdict_type), intent(in) :: verdict
   integer :: i, k

   call json%begin_array('steps')
   do k = 1, size(output%record)
      associate (record => output%record(k))
         if (record%step%step == 0) cycle
         call json%begin_object()
         call json%put('load', record%step%load)
         call json%put('activation', problem%scene%common_activation(record%step%load))
         call write_activations(json, problem%scene, record%step%load)
         call json%put('iterations', record%step%iterations)
         call json%put('newton_decrement', record%step%step_norm)
         call json%put('relative_gradient', record%step%gradient)
         call json%put('min_J', record%step%min_j)
         call json%put('max_J', record%step%max_j)
         if (.not. record%step%planned) call json%put('planned', .false.)
         if (allocated(record%step%energy)) then
            call json%begin_object('energy')
            call json%put('kinetic', record%step%energy(1))
            ! which collocation does not provide
            if (.not. ieee_is_nan(record%step%energy(2))) then
               call json%put('strain', record%step%energy(2))
               call json%put('work', record%step%energy(3))
            end if
            call json%end_object()
         end if
         if (record%step%acoustic_point > 0) then
            call json%begin_object('min_acoustic')
            call json%put('value', record%step%min_acoustic)
            call json%put('point', problem%scene%cloud%points(:, record%step%acoustic_point))
            call json%end_object()
         end if
         call json%begin_object('probes')
         do i = 1, size(problem%scene%probe)
            call put_values(json, problem%scene%probe(i)%name, &
               & record%probe(:numbers_of(problem, i), i))
         end do
         call json%end_object()
         call write_bars(json, problem, record, verdict%bars)
         call json%end_object()
      end associate
   end do
   call json%end_array()
end subroutine write_steps

!> Activation of each muscle, if some muscles have their own
subroutine write_activations(json, scene, load)
   type(json_type), intent(inout) :: json
   type(scene_type), intent(in) :: scene
   !> Load [-]
   real(wp), intent(in) :: load
   integer :: k

   if (.not. scene%has_own_activations()) return
   call json%begin_object('activations')
   do k = 1, size(scene%tissue)
      if (scene%tissue(k)%material%fibered) &
         & call json%put(scene%tissue(k)%name, scene%activation_at(k, load))
   end do
   call json%end_object()
end subroutine write_activations

!> Error bars of the probes of a step, and values whose printed form differs
subroutine write_bars(json, problem, record, bars)
   type(json_type), intent(inout) :: json
   class(discretisation_type), intent(in) :: problem
   type(step_record), intent(in) :: record
   type(bars_type), intent(in) :: bars
   real(wp) :: bar(3, size(problem%scene%probe)), shown(3, size(problem%scene%probe))
   logical :: known(size(problem%scene%probe)), other(size(problem%scene%probe))
   integer :: i, n

   known = .false.
   if (allocated(bars%change)) known = .not. ieee_is_nan(bars%change)
   other = .false.
   call json%begin_object('probe_errors')
   do i = 1, size(known)
      if (.not. known(i)) cycle
      n = numbers_of(problem, i)
      associate (value => record%probe(:n, i))
         bar(:n, i) = bars%at(i, record%step%load, value)
         shown(:n, i) = printed(value, bar(:n, i))
         other(i) = any(abs(shown(:n, i) - value) > 0.0_wp)
      end associate
      call put_values(json, problem%scene%probe(i)%name, bar(:n, i))
   end do
   call json%end_object()
   if (.not. any(other)) return
   call json%begin_object('printed')
   do i = 1, size(other)
      if (other(i)) call put_values(json, problem%scene%probe(i)%name, &
         & shown(:numbers_of(problem, i), i))
   end do
   call json%end_object()
end subroutine write_bars

!> A number, or several as an array
subroutine put_values(json, name, values)
   type(json_type), intent(inout) :: json
   character(len=*), intent(in) :: name
   real(wp), intent(in) :: values(:)

   if (size(values) == 1) then
      call json%put(name, values(1))
   else
      call json%put(name, values)
   end if
end subroutine put_values

!> Verdict, its reasons and the second solution
subroutine write_verdict(json, verdict)
   type(json_type), intent(inout) :: json
   type(verdict_type), intent(in) :: verdict

   call json%begin_object('verdict')
   call json%put('state', trim(verdict_names(verdict%state)))
   call json%put_lines('reasons', verdict%reasons)
   call json%end_object()
   associate (companion => verdict%companion)
      if (.not. allocated(companion%seen%values)) return
      call json%begin_object('companion')
      call json%put('method', companion%method)
      call json%put('same_points', companion%kind == another_form &
         & .and. .not. allocated(companion%lattice))
      call json%put('source_points', companion%points)
      call json%put('dofs', companion%unknowns)
      call json%put('difference', companion%difference)
      call json%put('seconds', companion%seconds)
      call json%end_object()
   end associate
end subroutine write_verdict

!> Exact solutions at full load
subroutine write_exact(json, problem, output)
   type(json_type), intent(inout) :: json
   class(discretisation_type), intent(in) :: problem
   type(output_type), intent(in) :: output
   real(wp) :: exact, value
   integer :: k

   if (size(problem%scene%exact) == 0) return
   call json%begin_object('exact')
   do k = 1, size(problem%scene%exact)
      associate (item => problem%scene%exact(k))
         exact = exact_value(problem%scene, item)
         value = output%record(size(output%record))%probe(1, item%probe)
         call json%begin_object(problem%scene%probe(item%probe)%name)
         call json%put('solution', item%solution)
         call json%put('value', value)
         call json%put('reference', exact)
         call json%put('relative_error', relative_error(value, exact))
         call json%end_object()
      end associate
   end do
   call json%end_object()
end subroutine write_exact

!> Distance from a reference, NaN (null in the summary) from one that is zero [-]
elemental real(wp) function relative_error(value, reference)
   real(wp), intent(in) :: value, reference

   relative_error = ieee_value(value, ieee_quiet_nan)
   if (abs(reference) > 0.0_wp) relative_error = abs(value - reference)/abs(reference)
end function relative_error

!> Reference values at the loads solved
subroutine write_references(json, problem, output)
   type(json_type), intent(inout) :: json
   class(discretisation_type), intent(in) :: problem
   type(output_type), intent(in) :: output
   real(wp), allocatable :: load(:), value(:), reference(:)
   integer :: i, j, k

   if (size(problem%scene%reference) == 0) return
   call json%begin_object('reference')
   do k = 1, size(problem%scene%reference)
      associate (item => problem%scene%reference(k))
         allocate (load(0), value(0), reference(0))
         do i = 1, size(item%load)
            do j = 1, size(output%record)
               if (abs(output%record(j)%step%load - item%load(i)) > 1.0e-9_wp) cycle
               load = [load, item%load(i)]
               value = [value, output%record(j)%probe(1, item%probe)]
               reference = [reference, item%value(i)]
            end do
         end do
         call json%begin_object(problem%scene%probe(item%probe)%name)
         call json%put('load', load)
         call json%put('activation', problem%scene%common_activation(load))
         call json%put('value', value)
         call json%put('reference', reference)
         call json%put('relative_error', relative_error(value, reference))
         call json%put('source', item%source)
         call json%end_object()
         deallocate (load, value, reference)
      end associate
   end do
   call json%end_object()
end subroutine write_references

end module rk_summary
