!> Output of a solve: progress lines, history.csv, run.log and results.vtkhdf.
module rk_output
   use, intrinsic :: ieee_arithmetic, only : ieee_is_nan
   use rk_bars, only : printed
   use rk_clock, only : tick
   use rk_deck, only : deck_type
   use rk_deck_scene, only : get_approximation
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type
   use rk_fields, only : compute_fields
   use rk_journal, only : journal_type, run_type
   use rk_point_field, only : point_field
   use rk_precision, only : i8, wp
   use rk_probes, only : new_probes, numbers_of, probe_value, probes_type
   use rk_recorder, only : iteration_type, recorder_type, step_type
   use rk_results, only : results_type
   use rk_states, only : field_state
   use rk_system, only : interrupted, tell, version_text
   use rk_text, only : to_power, to_text
   use rk_text_file, only : drop_file, text_file
   use rk_units, only : get_probe_unit
   use rk_verdict, only : verdict_type
   implicit none
   private

   public :: output_type, step_record

   !> A load step with its probes
   type :: step_record
      !> The step
      type(step_type) :: step
      !> Probe values, shape (3, probes)
      real(wp), allocatable :: probe(:, :)
   end type step_record

   !> Files of a run; before they are open, during a search for points, lines go to the terminal
   type, extends(recorder_type) :: output_type
      !> Problem whose states are recorded
      class(discretisation_type), pointer :: problem => null()
      !> Probes
      type(probes_type) :: probes
      !> Result file
      type(results_type) :: results
      !> Number of steps so far
      type(step_record), allocatable :: record(:)
      !> Number of states that converged under load, without the state at rest
      integer :: loaded = 0
      !> Last iteration
      type(iteration_type) :: last
      !> Worst backward error, distance from the best fit and condition of the run [-]
      real(wp) :: backward_error = 0.0_wp
      real(wp) :: misfit = 0.0_wp
      real(wp) :: rcond = 1.0_wp
      !> -1 quiet, 0 one line per step, 1 one line per iteration
      integer :: verbosity = 0
      !> Number of load steps of an earlier run to be recorded again
      integer :: repeated = 0
      !> Wall time of writing [s]
      real(wp) :: seconds = 0.0_wp
      !> First error of writing
      type(error_type), allocatable :: error
      type(text_file), private :: history
      type(text_file), private :: log
      type(journal_type), private :: journal
   contains
      procedure :: open => open_output, close => close_output, publish
      procedure :: iteration, step, stopped, say, note, tell_verdict
   end type output_type

contains

!> Open the files of a run
subroutine open_output(self, problem, folder, deck, run, error)
   class(output_type), intent(inout) :: self
   class(discretisation_type), target, intent(inout) :: problem
   !> Folder, which exists
   character(len=*), intent(in) :: folder
   !> Deck, stored with the results
   type(deck_type), intent(in) :: deck
   !> Run to be resumed, not allocated for a new run
   type(run_type), allocatable, intent(in) :: run
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: approximation

   self%problem => problem
   allocate (self%record(0))
   call new_probes(self%probes, problem%scene, error)
   if (allocated(error)) return
   call self%history%create(folder//'/history.csv', error)
   if (.not. allocated(error)) call self%log%create(folder//'/run.log', error)
   if (.not. allocated(error)) call self%history%line('step,load,iteration,residual,gradient,' &
      & //'step_norm,min_J,max_J,backward_error,solver,seconds', error)
   if (allocated(error)) return
   if (allocated(run)) then
      self%repeated = size(run%step) - 1
      call self%history%line(run%history(:len(run%history) - 1), error)
      if (allocated(error)) return
   end if
   call get_approximation(deck, approximation)
   call self%results%open(folder//'/results.vtkhdf', problem%scene%cloud, deck, approximation, &
      & version_text(), error)
   if (allocated(error) .or. problem%linear) return
   call self%journal%open(folder, run, deck, approximation, problem%scene%cloud, &
      & problem%n, error)
end subroutine open_output

!> Complete the files under their temporary names
subroutine close_output(self, error)
   class(output_type), intent(inout) :: self
   !> Error handling: the first write error
   type(error_type), allocatable, intent(out) :: error
   integer(i8) :: clock

   call system_clock(clock)
   call self%history%close(error)
   call keep(self, error)
   call self%log%close(error)
   call keep(self, error)
   call self%results%close(error)
   call keep(self, error)
   self%seconds = self%seconds + tick(clock)
   if (allocated(self%error)) call move_alloc(self%error, error)
end subroutine close_output

!> Rename the completed files to their final names, in place of those of an earlier run
subroutine publish(self, folder, error)
   !> Closed files, all of them complete
   class(output_type), intent(inout) :: self
   !> Folder they are in
   character(len=*), intent(in) :: folder
   type(error_type), allocatable, intent(out) :: error
   logical :: earlier

   inquire (file=folder//'/results.vtkhdf', exist=earlier)
   if (earlier .and. self%loaded == 0) then
      ! a state at rest is not a result: the files of the earlier run are kept
      call drop_file(folder//'/results.vtkhdf.part')
      call drop_file(folder//'/history.csv.part')
   else
      call self%results%publish(error)
      if (.not. allocated(error)) call self%history%publish(error)
   end if
   if (.not. allocated(error)) call self%log%publish(error)
end subroutine publish

!> Keep the first write error
subroutine keep(self, error)
   class(output_type), intent(inout) :: self
   !> Failure, if any
   type(error_type), allocatable, intent(inout) :: error

   if (allocated(error) .and. .not. allocated(self%error)) call move_alloc(error, self%error)
end subroutine keep

subroutine iteration(self, it)
   class(output_type), intent(inout) :: self
   type(iteration_type), intent(in) :: it
   type(error_type), allocatable :: error
   character(len=300) :: line

   self%last = it
   self%backward_error = max(self%backward_error, it%solver%backward_error)
   self%misfit = max(self%misfit, it%solver%misfit)
   ! a factor that is reused has none of its own
   if (it%solver%rcond > 0.0_wp) self%rcond = min(self%rcond, it%solver%rcond)
   write (line, '(i0, ",", es23.16e3, ",", i0, 5(",", es15.8e3), ",", es9.2e3, '// &
      & '",", a, ",", f0.3)') it%step, it%load, it%iteration, it%residual, it%gradient, &
      & it%step_norm, it%min_j, it%max_j, it%solver%backward_error, it%solver%used, it%seconds
   call self%history%line(trim(line), error)
   call keep(self, error)
   call self%journal%add_line(trim(line))
   write (line, '("  iteration ", i0, "  |r|  ", a, "  |A''r|  ", a, "  |da|  ", a, '// &
      & '"  J ", a, "..", a, "  ", a, "  ", a)') it%iteration, to_power(it%residual, 1), &
      & to_power(it%gradient, 1), to_power(it%step_norm, 1), to_text(it%min_j), &
      & to_text(it%max_j), it%solver%used, to_power(it%solver%backward_error, 0)
   if (it%solver%iterations > 0) line = trim(line)//' in ' &
      & //to_text(it%solver%iterations)//' iterations'
   call self%say(trim(line), level=1)
end subroutine iteration

subroutine step(self, st, x)
   class(output_type), intent(inout) :: self
   type(step_type), intent(in) :: st
   real(wp), contiguous, intent(in) :: x(:)
   type(step_record) :: record
   type(field_state) :: state
   type(point_field), allocatable :: fields(:)
   type(error_type), allocatable :: error
   character(len=200) :: line
   integer(i8) :: clock
   integer :: i

   call system_clock(clock)
   call self%problem%state(x, st%load, state)
   record%step = st
   allocate (record%probe(3, size(self%problem%scene%probe)))
   do i = 1, size(record%probe, 2)
      call probe_value(self%problem, self%probes, i, state, record%probe(:, i))
   end do
   self%record = [self%record, record]
   if (st%step > 0) self%loaded = self%loaded + 1
   call compute_fields(self%problem, state, fields)
   call self%results%add_step(st%load, self%problem%scene%common_activation(st%load), fields, x, &
      & error)
   call keep(self, error)
   call self%journal%add_step(st, x)
   self%seconds = self%seconds + tick(clock)
   if (st%step == 0 .or. self%loaded <= self%repeated) return
   if (allocated(self%problem%scene%motion)) then
      write (line, '("time ", a, " of ", a, "  ", a, " s")') to_text(st%load), &
         & to_text(self%problem%scene%motion%end_time), to_text(self%last%seconds, 3)
      call self%say(trim(line), level=1)
      return
   else if (self%problem%linear) then
      write (line, '("linear: one least squares solve, ", a, "  relative |A''r| ", a, '// &
         & '"  ", a, " s")') self%last%solver%used, to_power(st%gradient, 1), &
         & to_text(self%last%seconds, 3)
      call self%say(trim(line), level=0)
      return
   end if
   write (line, '("step ", i3, "/", i0, "  load ", f6.4, "  iterations ", i0, "  ", a, " ", '// &
      & 'a, "  |da| ", a, "  J ", a, "..", a, "  ", a, " s")') st%step, st%steps, st%load, &
      & st%iterations, trim(merge('|r|  ', '|A''r|', self%problem%square)), &
      & to_power(st%gradient, 1), to_power(st%step_norm, 1), to_text(st%min_j), &
      & to_text(st%max_j), to_text(self%last%seconds, 3)
   call self%say(trim(line), level=0)
end subroutine step

!> Stop on Ctrl-C, but not before all states of a resumed run are recorded again, and stop if
!> results cannot be written any more
logical function stopped(self)
   class(output_type), intent(inout) :: self

   stopped = (interrupted() .and. self%loaded >= self%repeated) .or. allocated(self%error)
end function stopped

!> Write a line to the log and, depending on its level, to the terminal
subroutine say(self, line, level)
   class(output_type), intent(inout) :: self
   character(len=*), intent(in) :: line
   !> Smallest verbosity that shows it
   integer, intent(in) :: level
   type(error_type), allocatable :: error

   call self%log%line(line, error)
   call keep(self, error)
   if (self%verbosity >= level) call tell(line)
end subroutine say

!> Note an event between two steps, or a warning
subroutine note(self, line, warning)
   class(output_type), intent(inout) :: self
   character(len=*), intent(in) :: line
   logical, intent(in) :: warning

   if (.not. allocated(self%record)) then
      ! the run that follows a search repeats its warnings
      if (.not. warning) call self%say(line, level=0)
   else if (warning) then
      call self%say('warning: '//line, level=0)
   else
      call self%say('  '//line, level=0)
   end if
end subroutine note

!> Write probes with their error bars, and the verdict, to the log
subroutine tell_verdict(self, deck, verdict)
   class(output_type), intent(inout) :: self
   type(deck_type), intent(in) :: deck
   type(verdict_type), intent(in) :: verdict
   character(len=:), allocatable :: line, unit
   integer :: i, n

   if (allocated(verdict%bars%values)) then
      do i = 1, size(verdict%bars%change)
         associate (probe => self%problem%scene%probe(i), bars => verdict%bars, &
            & last => size(verdict%bars%load))
            n = numbers_of(self%problem, i)
            line = '  '//probe%name//' '
            if (ieee_is_nan(bars%change(i))) then
               call append_numbers(line, bars%values(:n, i, last), 6)
            else
               call append_numbers(line, printed(bars%values(:n, i, last), &
                  & bars%bars(:n, i, last)), 6)
               line = line//' +- '
               call append_numbers(line, bars%bars(:n, i, last), 2)
            end if
            call get_probe_unit(deck, i, unit)
            line = line//' '//unit
            if (bars%unresolved(i)) line = trim(line)//'  not resolved'
            call self%say(trim(line), level=0)
         end associate
      end do
   end if
   ! the terminal shows it as the last line
   call verdict%get_sentence(line)
   call self%say(line, level=huge(1))
end subroutine tell_verdict

!> Append one number or a list of them
subroutine append_numbers(text, values, digits)
   character(len=:), allocatable, intent(inout) :: text
   real(wp), intent(in) :: values(:)
   !> Significant digits of each
   integer, intent(in) :: digits

   if (size(values) > 1) then
      text = text//to_text(values, digits)
   else
      text = text//to_text(values(1), digits)
   end if
end subroutine append_numbers

end module rk_output
