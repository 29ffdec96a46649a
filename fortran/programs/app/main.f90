!> myork-solve: the full model of a deck. Errors are printed and the exit status is set only here.
program main
   use, intrinsic :: iso_fortran_env, only : error_unit
   use omp_lib, only : omp_get_max_threads, omp_set_num_threads
   use rk_cli, only : config_type, read_arguments
   use rk_clock, only : tick
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type, open_deck
   use rk_deck_scene, only : new_scene
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type, fatal_error, err_convergence, err_input, err_linalg, &
      & err_stopped
   use rk_explain, only : explain
   use rk_journal, only : run_type
   use rk_model_file, only : read_model_cloud
   use rk_json_entries, only : json_entry
   use rk_new_problem, only : new_problem
   use rk_output, only : output_type
   use rk_precision, only : i8, wp
   use rk_recorder, only : start_type
   use rk_refine, only : refine, refined_before, refinement_type
   use rk_resume, only : resume_points, resume_run, start_from
   use rk_run, only : outcome_type, solve_scene
   use rk_scene, only : scene_type
   use rk_summary, only : earlier_entries, put_back, set_aside, write_refusal, write_summary
   use rk_system, only : catch_signals, cpu_seconds, lock_folder, make_folder, peak_bytes, &
      & prepare_process, process_number, tell
   use rk_text, only : to_text
   use rk_text_file, only : drop_file
   use rk_verdict, only : judge, refused, verdict_type
   implicit none
   type(config_type) :: config
   type(deck_type) :: deck
   type(cloud_type) :: model
   type(scene_type), target :: scene
   type(error_type), allocatable :: error
   class(discretisation_type), allocatable, target :: problem
   type(output_type), target :: output
   type(refinement_type) :: refinement
   type(start_type), allocatable :: start
   type(json_entry), allocatable :: earlier(:)
   !> Wall time of the shape functions [s]
   real(wp) :: shape_s
   !> Whether an earlier summary is damaged, and whether the points are those of an interrupted run
   logical :: damaged, resumed = .false.
   !> Whether there is a deck of that name
   logical :: found
   !> Whether the output folder is claimed, and whether its summary is that of this run
   logical :: claimed = .false., written = .false.
   !> Whether the summary of an earlier solution is renamed
   logical :: aside = .false.
   integer(i8) :: clock

   call system_clock(clock)
   call prepare_process()
   call read_arguments(config, error)
   call leave_on(error)
   if (allocated(config%answer)) then
      print '(a)', config%answer
      stop
   end if
   if (config%threads > 0) call omp_set_num_threads(config%threads)
   ! a mistyped name must not create a folder or change a summary
   inquire (file=config%deck, exist=found)
   if (found .and. .not. config%explain) then
      call make_folder(config%out, error)
      call leave_on(error)
      call claim()
   end if
   call open_deck(deck, config%deck, '', config%overrides, 'solve', error)
   call leave_on(error)
   call read_model_cloud(model, deck, config%out, error)
   call leave_on(error)
   if (config%explain) then
      call new_scene(scene, deck, model, error)
      call leave_on(error)
      call explain(deck, model, scene)
   else
      call set_up()
      call begin()
      call solve()
   end if

contains

   !> Set up the problem on the points of the deck, or on those found by the search
   subroutine set_up()
      integer(i8) :: began

      call catch_signals()
      output%verbosity = config%verbosity
      if (config%resume .and. deck%has('refine')) call resume_points(config%out, deck, resumed, &
         & error)
      call leave_on(error)
      if (.not. resumed) call refine(refinement, deck, model, output, error)
      call leave_on(error)
      call new_scene(scene, deck, model, error)
      call leave_on(error)
      call system_clock(began)
      call new_problem(problem, scene, error)
      call deck%locate(error)
      call leave_on(error)
      shape_s = tick(began)
   end subroutine set_up

   !> Find the state at which the run begins, open its files, and print what precedes the solve
   subroutine begin()
      type(run_type), allocatable :: before

      if (config%resume) call resume_run(before, start, config%out, deck, problem, error)
      call leave_on(error)
      if (config%start /= '' .and. .not. allocated(start)) then
         call start_from(config%start, deck, problem, start, error)
         call leave_on(error)
      end if
      if (allocated(refinement%start) .and. .not. allocated(start)) &
         & call move_alloc(refinement%start, start)
      call output%open(problem, config%out, deck, before, error)
      call leave_on(error)
      if (allocated(refinement%reason)) call output%say(refinement%levels//refinement%reason, &
         & level=huge(1))
      call output%say(scene%title//': '//to_text(problem%n)//' unknowns, '//to_text(problem%m) &
         & //' equations', level=0)
      if (damaged) call output%note('the earlier summary.json is damaged: what other stations ' &
         & //'wrote into it is lost', warning=.true.)
      if (output%repeated > 0) call output%say('resumed after load step ' &
         & //to_text(output%repeated), level=0)
      if (config%resume .and. output%repeated == 0) call output%say('no load step to resume: ' &
         & //'starts at the beginning', level=0)
      if (config%start /= '' .and. output%repeated == 0) call output%say('starts from ' &
         & //config%start, level=0)
   end subroutine begin

   !> Solve, judge and write
   subroutine solve()
      type(outcome_type) :: outcome
      type(verdict_type) :: verdict
      type(error_type), allocatable :: failure
      character(len=:), allocatable :: message, sentence

      call solve_scene(problem, '', output, outcome, failure, start)
      refinement%searched = deck%has('refine')
      call judge(verdict, problem, deck, model, config%estimate, refinement, output, outcome)
      call output%tell_verdict(deck, verdict)
      if (resumed) then
         call refined_before(refinement, deck, verdict%bars)
      else if (allocated(refinement%reason)) then
         call refinement%look_back(verdict%bars)
      end if
      if (allocated(refinement%reason)) call output%say(refinement%reason, level=0)
      call output%close(error)
      call leave_on(error)
      call write_summary(config%out//'/summary.json', deck, output, outcome, verdict, refinement, &
         & shape_s, tick(clock), omp_get_max_threads(), earlier, error)
      call leave_on(error)
      written = .true.
      call output%publish(config%out, error)
      call leave_on(error)
      call verdict%get_sentence(sentence)
      if (allocated(failure)) then
         failure%message = failure%message//' (written to '//config%out//')'
         call leave_on(failure)
      end if
      if (verdict%state == refused) then
         call fatal_error(failure, err_convergence, sentence//' (results in '//config%out//')')
         call leave_on(failure)
      end if
      call drop_file(config%out//'/summary.json.previous')
      message = to_text(tick(clock), 3)//' s, '//to_text(cpu_seconds(), 3)//' CPU s, '
      if (verdict%companion%seconds > 0.0_wp) message = message//'error bars ' &
         & //to_text(verdict%companion%seconds, 3)//' s, '
      message = message//to_text(1.0e-6_wp*peak_bytes(), 3)//' MB, results in '//config%out
      if (config%verbosity >= 0) call tell(sentence//': '//message)
   end subroutine solve

   !> Lock the output folder, and write a summary that states that this run has not finished
   subroutine claim()
      call lock_folder(config%out, error)
      call leave_on(error)
      call earlier_entries(config%out, earlier, damaged)
      call set_aside(config%out, earlier, aside, error)
      call leave_on(error)
      claimed = .true.
      call write_refusal(config%out, 'the run of process '//to_text(int(process_number())) &
         & //' has not ended, or was killed', earlier, error)
      call leave_on(error)
   end subroutine claim

   !> Print an error and stop with its exit status; the summary gives the reason
   subroutine leave_on(error)
      type(error_type), allocatable, intent(in) :: error
      type(error_type), allocatable :: unwritten
      logical :: kept
      integer :: ignored

      if (.not. allocated(error)) return
      write (error_unit, '(a)', iostat=ignored) error%message
      kept = written .or. .not. claimed
      ! a mistyped setting must not replace a result
      if (.not. kept .and. error%code == err_input) call put_back(config%out, earlier, aside, &
         & kept, unwritten)
      if (.not. kept) call write_refusal(config%out, error%message, earlier, unwritten)
      if (any(error%code == [err_convergence, err_linalg, err_stopped])) stop 1, quiet=.true.
      stop 2, quiet=.true.
   end subroutine leave_on

end program main
