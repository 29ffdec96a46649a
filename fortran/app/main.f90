!> myork-solve: the full model of a deck. The only place that prints errors and sets exit status.
program main
   use, intrinsic :: iso_fortran_env, only : error_unit
   use omp_lib, only : omp_get_max_threads, omp_set_num_threads
   use rk_cli, only : config_type, read_arguments
   use rk_clock, only : tick
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type, open_deck
   use rk_deck_scene, only : new_scene
   use rk_discretisation, only : discretisation_type, free_discretisation
   use rk_error, only : error_type, fatal_error, err_convergence, err_linalg, err_stopped
   use rk_explain, only : explain
   use rk_model_cloud, only : read_model_cloud
   use rk_json_entries, only : json_entry, read_entries
   use rk_new_problem, only : new_problem
   use rk_output, only : output_type
   use rk_precision, only : i8, wp
   use rk_recorder, only : start_type
   use rk_refine, only : refine, refined_before, refinement_type
   use rk_resume, only : resume_points, resume_run, start_from
   use rk_run, only : outcome_type, solve_scene
   use rk_scene, only : scene_type
   use rk_search, only : search_type
   use rk_summary, only : is_complete, mark_summary, write_summary
   use rk_system, only : catch_signals, lock_folder, make_folder, prepare_process, tell, &
      & version_text
   use rk_text, only : to_text
   use rk_verdict, only : judge, refused, verdict_type
   implicit none
   type(config_type) :: config
   type(deck_type) :: deck
   type(cloud_type) :: model
   type(scene_type), target :: scene
   type(error_type), allocatable :: error
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
   call open_deck(deck, config%deck, config%overrides, error)
   call leave_on(error)
   call read_model_cloud(model, deck, config%out, error)
   call leave_on(error)
   call new_scene(scene, deck, model, error)
   call leave_on(error)
   if (config%explain) then
      call explain(deck, model, scene)
   else
      call run()
   end if

contains

   !> Solve and write
   subroutine run()
      class(discretisation_type), allocatable, target :: problem
      type(output_type) :: output
      type(outcome_type) :: outcome
      type(verdict_type) :: verdict
      type(search_type) :: search
      type(refinement_type) :: refinement
      type(error_type), allocatable :: failure
      type(start_type), allocatable :: start
      type(json_entry), allocatable :: earlier(:)
      real(wp) :: shape_s
      character(len=:), allocatable :: history, message
      logical :: damaged, replaces, resumed
      integer(i8) :: began, journal

      call system_clock(began)
      call new_problem(problem, scene, error)
      call deck%locate('geometry', error)
      call leave_on(error)
      shape_s = tick(began)
      call make_folder(config%out, error)
      call leave_on(error)
      call lock_folder(config%out, error)
      call leave_on(error)
      call catch_signals()
      resumed = .false.
      if (deck%has('refine')) then
         search%verbosity = config%verbosity
         if (config%resume) call resume_points(config%out, deck, resumed, error)
         if (.not. allocated(error) .and. .not. resumed) call refine(refinement, deck, model, &
            & search, error)
         call leave_on(error)
         call free_discretisation(problem)
         call new_scene(scene, deck, model, error)
         if (.not. allocated(error)) call new_problem(problem, scene, error)
         call leave_on(error)
      end if
      history = ''
      journal = 0
      if (config%resume) then
         call resume_run(config%out, deck, problem, start, history, output%worst, journal, error)
         call leave_on(error)
         if (allocated(start)) output%repeated = size(start%step)
      end if
      if (config%start /= '' .and. .not. allocated(start)) then
         call start_from(config%start, deck, problem, start, error)
         call leave_on(error)
      end if
      output%verbosity = config%verbosity
      call output%open(problem, config%out, deck, version_text(), error, history, journal)
      call leave_on(error)
      if (allocated(refinement%reason)) call output%say(refinement%levels//refinement%reason, &
         & level=huge(1))
      call output%say(scene%title//': '//to_text(problem%n)//' unknowns, '//to_text(problem%m) &
         & //' equations', level=0)
      if (output%repeated > 0) call output%say('resumed behind load step ' &
         & //to_text(output%repeated), level=0)
      if (config%start /= '' .and. output%repeated == 0) call output%say('begins at ' &
         & //config%start, level=0)
      call solve_scene(problem, '', output, outcome, failure, start)
      call judge(verdict, problem, deck, model, config%estimate, output, outcome)
      call output%tell_verdict(verdict)
      if (resumed) call refined_before(refinement, deck, scene, verdict%bars, error)
      call leave_on(error)
      if (allocated(refinement%reason)) call output%say(refinement%reason, level=0)
      message = ''
      if (allocated(failure)) message = failure%message
      call read_entries(config%out//'/summary.json', earlier, damaged)
      if (damaged) call output%say('the summary.json that was there is damaged: what earlier ' &
         & //'stations wrote into it is lost', level=0)
      replaces = .not. allocated(failure) .or. .not. has_results() &
         & .or. (output%loaded_states() > 0 .and. .not. is_complete(earlier))
      call output%close(error)
      call leave_on(error)
      if (replaces) then
         call write_summary(config%out//'/summary.json', deck, problem, output, outcome, &
            & verdict, refinement, shape_s, tick(clock), omp_get_max_threads(), &
            & .not. allocated(failure), message, earlier, error)
         if (.not. allocated(error)) call output%publish(error)
      else
         call mark_summary(config%out//'/summary.json', earlier, message, error)
      end if
      call leave_on(error)
      if (allocated(failure)) then
         if (replaces) then
            failure%message = failure%message//' (written to '//config%out//')'
         else
            failure%message = failure%message//' (the results of an earlier run in ' &
               & //config%out//' stay; what this one reached is in results.vtkhdf.part)'
         end if
         call leave_on(failure)
      end if
      if (verdict%state == refused) then
         call fatal_error(failure, err_convergence, verdict%sentence()//' (results in ' &
            & //config%out//')')
         call leave_on(failure)
      end if
      if (config%verbosity >= 0) call tell(verdict%sentence()//': '//to_text(tick(clock), 3) &
         & //' s, results in '//config%out)
   end subroutine run

   !> Whether an earlier run left results
   logical function has_results()
      inquire (file=config%out//'/results.vtkhdf', exist=has_results)
   end function has_results

   !> Print an error and leave with its exit status
   subroutine leave_on(error)
      type(error_type), allocatable, intent(in) :: error
      integer :: ignored

      if (.not. allocated(error)) return
      write (error_unit, '(a)', iostat=ignored) error%message
      if (any(error%code == [err_convergence, err_linalg, err_stopped])) stop 1, quiet=.true.
      stop 2, quiet=.true.
   end subroutine leave_on

end program main
