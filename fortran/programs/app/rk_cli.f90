!> Arguments of the program.
module rk_cli
   use omp_lib, only : omp_get_max_threads
   use rk_error, only : error_type, fatal_error, err_input
   use rk_system, only : version_text
   use rk_text, only : to_text
   implicit none
   private

   public :: config_type, read_arguments

   !> More threads than any shared-memory machine has; the system would refuse to start them
   integer, parameter :: most_threads = 1024
   character(len=*), parameter :: nl = new_line('a'), usage_text = &
      & 'usage: myork-solve DECK [-o DIR | --out DIR] [-t N | --threads N] [--set ' &
      & //'table.key=value]...'//nl &
      & //'                   [-q | -v] [--resume] [--start-from FILE[:STEP]] [--no-error] ' &
      & //'[--explain]'//nl//nl &
      & //'Solve the full model of a deck and write summary.json, results.vtkhdf, ' &
      & //'history.csv and run.log.'//nl//nl &
      & //'  -o, --out DIR'//nl &
      & //'                folder of the results; default out/<deck>'//nl &
      & //'  -t, --threads N'//nl &
      & //'                threads; default all cores'//nl &
      & //'  --set K=V     override a key of the deck; may be repeated'//nl &
      & //'  -q, -v        no progress, or a line for every iteration'//nl &
      & //'  --no-error    no second solution, so no error bars of the probes'//nl &
      & //'  --resume      continue from the last complete load step of an earlier run in ' &
      & //'the folder'//nl &
      & //'  --start-from FILE[:STEP]'//nl &
      & //'                start from a state in a result file instead of at rest'//nl &
      & //'  --explain     print what will be modelled and what it costs, and stop'//nl &
      & //'  --version     version'//nl &
      & //'  --help        this text'//nl//nl &
      & //'exit status: 0 done; 1 ended without convergence, the last converged state is ' &
      & //'written, or the answer is refused; 2 bad input; 3 broken installation'

   !> Settings of a run
   type :: config_type
      !> Deck
      character(len=:), allocatable :: deck
      !> Output folder
      character(len=:), allocatable :: out
      !> Overrides "table.key=value"
      character(len=512), allocatable :: overrides(:)
      !> Threads, 0 for all cores
      integer :: threads = 0
      !> -1 quiet, 0 one line per step, 1 one line per iteration
      integer :: verbosity = 0
      !> Whether to compute a second solution for the error bars
      logical :: estimate = .true.
      !> Whether to resume an interrupted run in the output folder
      logical :: resume = .false.
      !> Initial state, "FILE" or "FILE:STEP"; blank for none
      character(len=:), allocatable :: start
      !> Whether only to explain the run
      logical :: explain = .false.
      !> Text to print instead of a run
      character(len=:), allocatable :: answer
   end type config_type

contains

subroutine read_arguments(config, error)
   !> Settings given by the arguments
   type(config_type), intent(out) :: config
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: word, value
   integer :: i, stat

   config%deck = ''
   config%out = ''
   config%start = ''
   allocate (config%overrides(0))
   i = 0
   do while (i < command_argument_count())
      i = i + 1
      call get_argument(i, word)
      select case (word)
      case ('-h', '--help')
         config%answer = usage_text
         return
      case ('--version')
         config%answer = 'myork-solve '//version_text()
         return
      case ('--explain')
         config%explain = .true.
      case ('--resume')
         config%resume = .true.
      case ('--no-error')
         config%estimate = .false.
      case ('-q')
         config%verbosity = -1
      case ('-v')
         config%verbosity = 1
      case ('-o', '--out', '-t', '--threads', '--set', '--start-from')
         i = i + 1
         call get_argument(i, value)
         if (i > command_argument_count() .or. len(value) == 0) then
            call fatal_error(error, err_input, word//' needs a value'//new_line('a')//usage_text)
            return
         end if
         select case (word)
         case ('-o', '--out')
            config%out = value
         case ('--start-from')
            config%start = value
         case ('--set')
            if (len(value) > len(config%overrides)) then
               call fatal_error(error, err_input, '--set '//value(:40)//'...: too long')
               return
            end if
            if (scan(value, new_line('a')//achar(13)) > 0) then
               call fatal_error(error, err_input, '--set '//value//': an override must be a ' &
                  & //'single line')
               return
            end if
            config%overrides = [character(len=len(config%overrides)) :: config%overrides, value]
         case default
            read (value, *, iostat=stat) config%threads
            if (stat /= 0 .or. config%threads < 1 .or. config%threads > most_threads &
               & .or. verify(value, '0123456789') > 0) then
               call fatal_error(error, err_input, word//' '//value//': the number of threads ' &
                  & //'must be between 1 and 1024')
               return
            end if
         end select
      case default
         if (index(word, '-') == 1 .or. len(config%deck) > 0 .or. len(word) == 0) then
            call fatal_error(error, err_input, "unknown argument '"//word//"'"//new_line('a') &
               & //usage_text)
            return
         end if
         config%deck = word
      end select
   end do
   if (len(config%deck) == 0) then
      call fatal_error(error, err_input, 'no deck given'//new_line('a')//usage_text)
      return
   end if
   if (config%threads == 0 .and. omp_get_max_threads() > most_threads) then
      call fatal_error(error, err_input, 'OMP_NUM_THREADS is '//to_text(omp_get_max_threads()) &
         & //': the number of threads must be between 1 and 1024')
      return
   end if
   if (len(config%out) > 0) return
   ! name of the deck without folder and extension
   word = config%deck(index(config%deck, '/', back=.true.) + 1:)
   i = index(word, '.', back=.true.)
   if (i > 1) word = word(:i - 1)
   config%out = 'out/'//word
end subroutine read_arguments

subroutine get_argument(i, word)
   !> Its number
   integer, intent(in) :: i
   character(len=:), allocatable, intent(out) :: word
   integer :: n

   call get_command_argument(i, length=n)
   allocate (character(len=n) :: word)
   if (n > 0) call get_command_argument(i, word)
end subroutine get_argument

end module rk_cli
