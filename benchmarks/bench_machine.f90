!> What the programs that time kernels share: a clock, a line a kernel, the peaks of the machine.
module bench_machine
   use rk_blas, only : dgemm
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type, open_deck
   use rk_deck_scene, only : new_scene
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type
   use rk_new_problem, only : new_problem
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   implicit none
   private

   public :: now, open_problem, say, stop_on, time_machine

contains

!> Problem of the arguments: a deck, how often to repeat, settings
subroutine open_problem(problem, scene, repeats)
   class(discretisation_type), allocatable, intent(out) :: problem
   !> Its scene
   type(scene_type), target, intent(out) :: scene
   !> Times each kernel is run
   integer, intent(out) :: repeats
   character(len=1000) :: path, word
   character(len=64), allocatable :: settings(:)
   type(deck_type) :: deck
   type(cloud_type) :: model
   type(error_type), allocatable :: error
   integer :: i

   call get_command_argument(1, path)
   call get_command_argument(2, word)
   read (word, *) repeats
   allocate (settings(command_argument_count() - 2))
   do i = 1, size(settings)
      call get_command_argument(i + 2, settings(i))
   end do
   call open_deck(deck, trim(path), '', settings, 'solve', error)
   call stop_on(error)
   call new_scene(scene, deck, model, error)
   call stop_on(error)
   call new_problem(problem, scene, error)
   call stop_on(error)
end subroutine open_problem

!> Peak of matrix products and of memory
subroutine time_machine(repeats)
   !> Times each is tried
   integer, intent(in) :: repeats
   integer, parameter :: n = 1500, long = 20000000
   real(wp), allocatable :: a(:, :), b(:, :), c(:, :), u(:), v(:), w(:)
   real(wp) :: best, start
   integer :: k

   allocate (a(n, n), b(n, n), source=1.0_wp)
   allocate (c(n, n), source=0.0_wp)
   best = huge(1.0_wp)
   do k = 1, repeats
      start = now()
      call dgemm('n', 'n', n, n, n, 1.0_wp, a, n, b, n, 0.0_wp, c, n)
      best = min(best, now() - start)
   end do
   call say('dgemm', best, 2.0_wp*real(n, wp)**3, 32.0_wp*real(n, wp)**2)
   allocate (u(long), v(long), w(long), source=1.0_wp)
   best = huge(1.0_wp)
   do k = 1, repeats
      start = now()
      u = v + 0.5_wp*w
      best = min(best, now() - start)
   end do
   call say('triad', best, 2.0_wp*long, 32.0_wp*long)
   if (u(long/2) < 0.0_wp) print '(a)', 'never'
end subroutine time_machine

!> Processor time [s]
real(wp) function now()
   call cpu_time(now)
end function now

!> One line
subroutine say(name, seconds, flops, bytes)
   !> Kernel
   character(len=*), intent(in) :: name
   !> Its time [s], operations [-] and bytes [byte]
   real(wp), intent(in) :: seconds, flops, bytes

   print '(a, 1x, a, 3(1x, es12.5))', 'kernel', name, seconds, flops, bytes
end subroutine say

!> Leave with a message and exit status 1
subroutine stop_on(error)
   type(error_type), allocatable, intent(in) :: error

   if (.not. allocated(error)) return
   print '(a)', error%message
   error stop 1
end subroutine stop_on

end module bench_machine
