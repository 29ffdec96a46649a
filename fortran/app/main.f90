!> myork-solve: the full model of a deck. The only place that prints errors and sets exit status.
program main
   use, intrinsic :: iso_fortran_env, only : error_unit
   use omp_lib, only : omp_get_max_threads, omp_set_num_threads
   use rk_cli, only : config_type, read_arguments
   use rk_clock, only : tick, timer_type
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type, open_deck
   use rk_deck_scene, only : new_scene, stiffest_ratio
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type, err_convergence, err_linalg, err_stopped
   use rk_error_norms, only : error_norms, norms_type
   use rk_explain, only : explain
   use rk_linear, only : linear_problem
   use rk_linear_solve, only : solve_linear
   use rk_model_cloud, only : read_model_cloud
   use rk_new_problem, only : new_problem
   use rk_newton, only : newton_type
   use rk_output, only : output_type
   use rk_precision, only : i8, wp
   use rk_recorder, only : step_type
   use rk_scene, only : scene_type
   use rk_static, only : solve_static
   use rk_summary, only : write_summary
   use rk_system, only : catch_signals, make_folder, version_text
   use rk_text, only : to_text
   implicit none
   !> Imbalance of forces that deserves a warning [-]
   real(wp), parameter :: max_imbalance = 0.05_wp
   !> Bulk over shear modulus from which on the displacement form is known to be off by per cents
   real(wp), parameter :: doubtful_ratio = 10.0_wp
   type(config_type) :: config
   type(deck_type) :: deck
   type(cloud_type) :: model
   type(scene_type), target :: scene
   type(error_type), allocatable :: error
   integer(i8) :: clock

   call system_clock(clock)
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
      type(newton_type) :: newton
      type(timer_type) :: timer
      type(error_type), allocatable :: failure, trouble
      real(wp), allocatable :: x(:)
      type(norms_type), allocatable :: norms
      real(wp) :: shape_s
      character(len=:), allocatable :: message
      integer(i8) :: start

      call system_clock(start)
      call new_problem(problem, scene, error)
      if (allocated(error)) error%message = deck%where('geometry')//': '//error%message
      call leave_on(error)
      shape_s = tick(start)
      call make_folder(config%out, error)
      call leave_on(error)
      output%verbosity = config%verbosity
      call output%open(problem, config%out, deck%text, version_text(), error)
      call leave_on(error)
      call catch_signals()
      call output%say(scene%title//': '//to_text(problem%n)//' unknowns, '//to_text(problem%m) &
         & //' equations', level=0)
      if (scene%method == 'rkcm') then
         if (stiffest_ratio(scene) > doubtful_ratio) call output%warn('K is ' &
            & //to_text(stiffest_ratio(scene), 2)//' shear moduli: the displacement form may ' &
            & //'lock, compare with method "rkcm-mixed"')
      end if

      allocate (x(problem%n), source=0.0_wp)
      call system_clock(timer%start)
      select type (problem)
      type is (linear_problem)
         call solve_linear(problem, scene%solver%linear, x, output, timer, failure)
         if (.not. allocated(failure)) then
            allocate (norms)
            call system_clock(start)
            call error_norms(problem, x, norms, failure)
            norms%seconds = tick(start)
         end if
      class default
         newton%linear = scene%solver%linear
         newton%damping%method = scene%solver%newton
         newton%tolerance = scene%solver%tolerance
         newton%max_iterations = scene%solver%max_iterations
         call output%step(step_type(load=0.0_wp), x)
         call solve_static(problem, newton, scene%load%steps, scene%load%max_halvings, x, output, &
            & timer, failure)
      end select
      message = ''
      if (output%imbalance > max_imbalance) call output%warn('the forces on all boundary sets ' &
         & //'leave '//to_text(100.0_wp*output%imbalance, 2)//' % of the largest unbalanced: do ' &
         & //'not trust them; refine, raise the order'//trim(merge(' or use method "rkcm-mixed"', &
         & '                           ', scene%method == 'rkcm')))
      if (allocated(failure)) message = failure%message
      if (len(message) > 0) call output%warn(message)
      call output%close(trouble)
      call write_summary(config%out//'/summary.json', deck, problem, output, timer, shape_s, &
         & tick(clock), omp_get_max_threads(), .not. allocated(failure), message, error, norms)
      call leave_on(trouble)
      call leave_on(error)
      if (allocated(failure)) then
         failure%message = failure%message//' (written to '//config%out//')'
         call leave_on(failure)
      end if
      if (config%verbosity >= 0) print '(a)', 'converged: '//to_text(tick(clock), 3) &
         & //' s, results in '//config%out
   end subroutine run

   !> Print an error and leave with its exit status
   subroutine leave_on(error)
      type(error_type), allocatable, intent(in) :: error

      if (.not. allocated(error)) return
      write (error_unit, '(a)') error%message
      if (any(error%code == [err_convergence, err_linalg, err_stopped])) stop 1, quiet=.true.
      stop 2, quiet=.true.
   end subroutine leave_on

end program main
