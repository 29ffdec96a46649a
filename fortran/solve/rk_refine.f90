!> Refinement of source points where it pays, until probes are accurate enough or the cost too high.
!>
!> A scene is solved, and a companion on half as many cells gives error bars. Where they are too
!> wide, one more solution with half as many cells in a single direction shows how much of them
!> comes from that direction. Errors fall like the square of the spacing, so that the fewest points
!> for a target error give equal errors in all directions: the next lattice has these, with at most
!> twice as many cells in a direction. At corners and clamped edges errors fall more slowly; then
!> one more lattice follows. The last solution of the search is the answer, whose run begins where
!> the search ended.
module rk_refine
   use rk_bars, only : bars_by_earlier, bars_by_other, bars_type, new_bars
   use rk_clock, only : timer_type
   use rk_cloud, only : cloud_type
   use rk_companion, only : companion_type, lattice_words, list, other_number, kept_run, &
      & solve_beside, solve_companion, solved_type
   use rk_deck, only : deck_type
   use rk_deck_scene, only : new_scene
   use rk_discretisation, only : discretisation_type, free_discretisation
   use rk_error, only : error_type, fatal_error, err_convergence, err_linalg, err_stopped
   use rk_new_problem, only : new_problem
   use rk_precision, only : wp
   use rk_probes, only : quantity_size
   use rk_recorder, only : recorder_type, start_type
   use rk_run, only : never_strained, solve_problem
   use rk_scene, only : scene_type
   use rk_text, only : to_text
   implicit none
   private

   public :: refinement_type, limited_type, refine, refined_before

   !> Assumed order of the bars in the spacing
   real(wp), parameter :: order = 2.0_wp
   !> Error of a probe, or the target if that is larger, that is also met relative to a tenth of its
   !> kind, and to the largest probe of its kind: three tenths of the mean stress alone would leave
   !> a fifth of a small stress uncertain [-]
   real(wp), parameter :: of_tenth = 0.05_wp
   !> Part of the target error that is aimed at, so that one more lattice is seldom needed [-]
   real(wp), parameter :: aim = 0.8_wp
   !> Growth of the cells in a direction from one lattice to the next
   real(wp), parameter :: most_growth = 2.0_wp
   !> Growth of all cells that is worth another solution where the cost allows no more
   real(wp), parameter :: least_growth = 1.3_wp
   !> Power of the points with which the time of factors grows, in 2D and 3D: that of the total time
   !> grows from one towards it
   real(wp), parameter :: growth_of_factors(2:3) = [1.5_wp, 2.0_wp]
   !> Largest number of lattices that are tried
   integer, parameter :: most_levels = 12

   !> Results of the search
   type :: refinement_type
      !> Target bar over the size of a probe; 0 without a target [-]
      real(wp) :: wanted = 0.0_wp
      !> The target as the beginning of a sentence on whether it is met
      character(len=:), allocatable, private :: target
      !> The points are those of a search
      logical :: searched = .false.
      !> The target is met by the points that were found
      logical :: met = .false.
      !> The body is not strained: its bars compare rounding errors
      logical, private :: unstrained = .false.
      !> How it ended, in words
      character(len=:), allocatable :: reason
      !> Overrides of the deck before the search, a line each
      character(len=:), allocatable :: asked
      !> The points as overrides of the deck, a line each
      character(len=:), allocatable :: points
      !> A line for each lattice
      character(len=:), allocatable :: levels
      !> CPU time of the search [s]
      real(wp) :: seconds = 0.0_wp
      !> CPU time that it may take, including the checks of its answer [s]
      real(wp) :: cost = huge(1.0_wp)
      !> Widest bar of the answer over the size of its probe; negative where none is known [-]
      real(wp) :: reached = -1.0_wp
      !> Solution on the points that were found, or on the first ones as far as it converged
      type(start_type), allocatable :: start
      !> Its second solution, or why there is none, and its bars, which account for earlier points
      type(companion_type), allocatable :: companion
      type(bars_type), allocatable :: bars
   contains
      !> How well the answer meets the target
      procedure :: look_back
      procedure :: limited
   end type refinement_type

   !> Receiver that stops every solution of a search when its cost is used up
   type, extends(recorder_type) :: limited_type
      !> CPU time at which solutions are stopped [s]
      real(wp) :: deadline = huge(1.0_wp)
   contains
      procedure :: late, stopped
   end type limited_type

contains

!> Find the points of a deck that has a table refine, and write them into it
subroutine refine(self, deck, model, receiver, error)
   type(refinement_type), intent(out) :: self
   !> Deck, replaced by one with the points that were found
   type(deck_type), target, intent(inout) :: deck
   !> Points of the model file, where the deck uses one
   type(cloud_type), target, intent(in) :: model
   !> Receiver of the caller, which gets a note of each lattice and may stop the search
   class(recorder_type), target, intent(inout) :: receiver
   !> Error handling: a scene that cannot be refined, a solution that failed
   type(error_type), allocatable, intent(out) :: error
   type(scene_type), target :: scene
   class(discretisation_type), allocatable, target :: problem
   type(limited_type), target :: within
   type(start_type) :: run
   type(solved_type) :: answer
   type(companion_type) :: companion
   type(bars_type) :: bars
   type(deck_type) :: coarser, finer
   real(wp) :: start, before, growth, now, worst, power, points, points_before, solving, &
      & solving_before
   real(wp), allocatable :: bar(:), left(:), share(:, :)
   integer, allocatable :: before_cells(:), cells(:), next(:), limit(:)
   integer :: level, halvings
   logical :: insoluble, ends
   character(len=:), allocatable :: words

   self%searched = deck%has('refine')
   if (.not. self%searched) return
   self%asked = deck%overrides
   call begin(self, deck)
   call deck%get('refine.cost', self%cost)
   self%points = ''
   call cpu_time(start)
   within = self%limited(receiver)
   before = start
   halvings = 0
   growth = 1.0_wp
   points = 0.0_wp
   solving = 0.0_wp
   do level = 1, most_levels
      call new_scene(scene, deck, model, error)
      if (allocated(error)) return
      call check(scene, deck, error)
      if (allocated(error)) return
      call cells_of(scene, cells, limit)
      if (level == 1 .and. allocated(scene%cloud%lattice)) call get_words(deck, scene%cloud, &
         & cells, self%points)
      call solve_lattice()
      if (allocated(error)) then
         if (insoluble) return
         if (receiver%stopped()) return
         call cpu_time(now)
         self%seconds = now - start
         if (level > 1) then
            call end_at_earlier()
         else
            call end_at_first()
         end if
         return
      end if
      call note_lattice()
      if (worst <= self%wanted) then
         self%met = .true.
         self%reason = self%target//'met'
         return
      end if
      call choose_cells(ends)
      if (ends) return
      if (level == most_levels) exit
      call get_words(deck, scene%cloud, next, words)
      call deck%vary(words, finer, error)
      if (allocated(error)) return
      coarser = deck
      deck = finer
      growth = maxval(real(next, wp)/cells)
      self%points = words
      before = now
      before_cells = cells
   end do
   self%reason = self%target//'not met after '//to_text(most_levels)//' lattices'

contains

   !> Solve the scene and its companion, and find how much of the bars comes from each direction
   subroutine solve_lattice()
      call new_problem(problem, scene, error)
      call deck%locate(error)
      insoluble = allocated(error) .and. .not. allocated(self%start)
      if (insoluble) return
      if (.not. allocated(error)) call solve(problem, scene, deck, model, within, halvings, run, &
         & answer, companion, bars, error)
      if (.not. allocated(error)) then
         ! where the load had to be halved, finer points need that as well
         halvings = maxval(run%step%halvings)
         if (allocated(self%bars)) call bars_by_earlier(bars, scene%cloud%nd == 3, self%bars, &
            & growth)
         bar = relative(bars, self%wanted)
         self%unstrained = never_strained(problem, answer%load, answer%x)
         if (self%unstrained) bar = 0.0_wp
         worst = maxval(bar)
         ! the uncertainty due to voxels remains with any number of blocks
         left = bar - bars%open
         call forecast()
         if (another()) then
            if (any(left > self%wanted)) call shares(answer, cells, bars, share)
         else if (.not. allocated(share)) then
            allocate (share(size(cells), size(bar)), source=1.0_wp/size(cells))
         end if
         self%start = run
         self%companion = companion
         self%bars = bars
      end if
      if (allocated(problem)) then
         call free_discretisation(problem)
         deallocate (problem)
      end if
      if (receiver%stopped()) call fatal_error(error, err_stopped, 'stopped while the points ' &
         & //'were refined')
   end subroutine solve_lattice

   !> A line about the lattice
   subroutine note_lattice()
      character(len=:), allocatable :: line

      call cpu_time(now)
      line = 'refine '//to_text(level)//': '//list(merge(cells + 1, cells, &
         & allocated(scene%cloud%lattice)))//merge(' points', ' blocks', &
         & allocated(scene%cloud%lattice))//', '//scene%probe(maxloc(bar, &
         & dim=1))%name//' within '//to_text(100.0_wp*worst, 2)//' %, '// &
         & to_text(now - before, 2)//' CPU s'
      self%levels = self%levels//line//new_line('a')
      call receiver%note(line, warning=.false.)
      self%seconds = now - start
   end subroutine note_lattice

   !> Cells of the next lattice, or why there is none
   subroutine choose_cells(ends)
      logical, intent(out) :: ends
      integer, allocatable :: aimed(:)
      integer :: d

      ends = .true.
      if (.not. any(left > self%wanted)) then
         self%reason = self%target//'not met: the voxels leave an uncertainty of ' &
            & //to_text(100.0_wp*maxval(bars%open), 2)//' %, however many ' &
            & //'points there are; give a label map of finer voxels'
         return
      end if
      next = next_cells(cells, share, left, aim*self%wanted)
      ! blocks of equal numbers of voxels: otherwise errors are larger than the bars
      if (allocated(scene%cloud%block)) next = divisor_from(next, limit)
      if (all(next == cells)) then
         self%reason = self%target//'not met: every voxel has its own source points; give a ' &
            & //'label map of finer voxels'
         return
      end if
      if (.not. possible(next)) then
         self%reason = self%target//'not met: the next points, '//list(next)//' cells, '
         if (factorised(next)) then
            self%reason = self%reason//'would take about '//to_text(self%seconds &
               & + expected(next), 2)//' CPU s, more than refine.cost'
         else
            self%reason = self%reason//'have more unknowns than galerkin.direct_limit'
         end if
         if (allocated(scene%cloud%block)) return
         ! as many points as possible, if they are worth another solution
         aimed = next
         do while (.not. possible(next))
            d = maxloc(real(next, wp)/aimed, dim=1, mask=next > cells)
            next(d) = max(cells(d), next(d) - 2)
            if (product(real(next, wp)) < least_growth*product(real(cells, wp))) return
         end do
      end if
      ends = .false.
   end subroutine choose_cells

   !> End with the points before, whose answer is kept
   subroutine end_at_earlier()
      self%reason = self%target//'not met: the next points, '//list(cells)//' cells, ' &
         & //'have no solution within refine.cost: '//error%message
      deallocate (error)
      call get_words(coarser, scene%cloud, before_cells, self%points)
      deck = coarser
   end subroutine end_at_earlier

   !> End with the first points, whose answer has no second solution, or which have no answer: then
   !> the run has the states that converged, and the error that stopped it
   subroutine end_at_first()
      if (allocated(answer%x)) then
         self%start = run
         self%companion = companion
         if (within%late()) self%companion%why_not = companion%why_not//': refine.cost = ' &
            & //to_text(self%cost, 3)//' CPU s was used up'
         self%reason = self%target//'not met: the first points, '//list(cells)//' cells, have no ' &
            & //'second solution'
         if (within%late()) self%reason = self%reason//' within refine.cost'
         deallocate (error)
         return
      end if
      if (.not. any(error%code == [err_convergence, err_linalg, err_stopped])) return
      if (within%late()) then
         error%message = 'the first points of the search, '//list(cells)//' cells, have no ' &
            & //'solution within refine.cost = '//to_text(self%cost, 3)//' CPU s: '//error%message &
            & //'; raise the cost limit, give fewer points (geometry.source) or reduce the load'
         error%code = err_convergence
      end if
      self%reason = self%target//'not met: the first points, '//list(cells)//' cells, have no ' &
         & //'answer'
      call move_alloc(error, run%ended)
      self%start = run
   end subroutine end_at_first

   !> Time of the solutions on this lattice, and the power of the points with which this time grows
   !> to the next one: the mean of that observed between the last two lattices and that of factors;
   !> after the first lattice that of factors
   subroutine forecast()
      real(wp) :: seen

      call cpu_time(now)
      self%seconds = now - start
      points_before = points
      solving_before = solving
      points = product(real(cells, wp) + 1.0_wp)
      solving = now - before
      power = growth_of_factors(scene%cloud%nd)
      if (points_before <= 0.0_wp) return
      seen = log(solving/solving_before)/log(points/points_before)
      power = 0.5_wp*(power + min(power, max(1.0_wp, seen)))
   end subroutine forecast

   !> Whether the cost allows another lattice after the solutions that show where it needs points
   logical function another()
      real(wp) :: sharing

      ! one for each direction, with half of the points
      sharing = size(cells)*solving*0.5_wp**power
      another = self%seconds + sharing + solving*least_growth**power <= self%cost
   end function another

   !> Whether a lattice can be solved within the cost
   logical function possible(cells_then)
      !> Its cells, shape (nd)
      integer, intent(in) :: cells_then(:)

      possible = factorised(cells_then) .and. self%seconds + expected(cells_then) <= self%cost
   end function possible

   !> Whether a lattice has few enough unknowns for exact values, which need a factorised tangent
   logical function factorised(cells_then)
      !> Its cells, shape (nd)
      integer, intent(in) :: cells_then(:)

      factorised = scene%galerkin%essential /= 'transformation' .or. scene%cloud%nd &
         & *product(real(cells_then, wp) + 1.0_wp) <= scene%galerkin%direct_limit
   end function factorised

   !> CPU time that a lattice is expected to take [s]
   real(wp) function expected(cells_then)
      !> Its cells, shape (nd)
      integer, intent(in) :: cells_then(:)

      expected = solving*(product(real(cells_then, wp) + 1.0_wp)/points)**power
   end function expected

end subroutine refine

!> Whether the bars of an answer meet the target of an earlier search that is not repeated
subroutine refined_before(self, deck, bars)
   !> Known results of the search
   type(refinement_type), intent(out) :: self
   !> Deck with a table refine
   type(deck_type), intent(in) :: deck
   !> Bars of the answer
   type(bars_type), intent(in) :: bars

   self%searched = .true.
   call begin(self, deck)
   call self%look_back(bars)
   self%met = self%reached >= 0.0_wp .and. self%reached <= self%wanted
   self%reason = self%target//trim(merge('met    ', 'not met', self%met))//' by the points of ' &
      & //'the run that is resumed'
end subroutine refined_before

!> Read the target
subroutine begin(self, deck)
   type(refinement_type), intent(inout) :: self
   type(deck_type), intent(in) :: deck

   call deck%get('refine.accuracy', self%wanted)
   self%target = 'the target error of '//to_text(100.0_wp*self%wanted, 3)//' % is '
   self%levels = ''
end subroutine begin

!> Widest bar of the probes, over the size
subroutine look_back(self, bars)
   class(refinement_type), intent(inout) :: self
   !> Bars of the answer
   type(bars_type), intent(in) :: bars

   self%reached = -1.0_wp
   if (.not. allocated(bars%size)) return
   associate (bar => relative(bars, self%wanted))
      if (all(bar >= 0.0_wp)) self%reached = merge(0.0_wp, maxval(bar), self%unstrained)
   end associate
end subroutine look_back

!> Refuse scenes without a lattice of cells or a second solution
subroutine check(scene, deck, error)
   type(scene_type), intent(in) :: scene
   !> Its deck
   type(deck_type), intent(in) :: deck
   !> Error handling: another form, a known solution, a motion, no probes
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: complaint

   if (scene%equation%is_known()) then
      complaint = 'is not for linear problems whose solution is known'
   else if (allocated(scene%motion)) then
      complaint = 'is not for motions, whose time step depends on the points'
   else if (scene%method /= 'rkpm-gauss' .or. .not. (allocated(scene%cloud%lattice) &
      & .or. allocated(scene%cloud%block))) then
      complaint = 'needs scene.method = "rkpm-gauss" on a box, an annulus or a model of voxels'
   else if (size(scene%probe) == 0) then
      complaint = 'needs a probe whose error is to be met'
   else
      return
   end if
   call deck%complain('refine', complaint, error)
end subroutine check

!> Cells along each direction, and their upper limit
subroutine cells_of(scene, cells, limit)
   type(scene_type), intent(in) :: scene
   !> Cells, shape (nd)
   integer, allocatable, intent(out) :: cells(:)
   !> Upper limit, shape (nd)
   integer, allocatable, intent(out) :: limit(:)

   if (allocated(scene%cloud%lattice)) then
      cells = scene%cloud%lattice - 1
      limit = spread(ishft(huge(1), -2), 1, size(cells))
   else
      cells = maxval(scene%cloud%block, dim=2) + 1
      limit = maxval(scene%cloud%voxels%index, dim=2) - minval(scene%cloud%voxels%index, dim=2) + 1
   end if
end subroutine cells_of

!> Overrides for a number of cells, a line each
subroutine get_words(deck, cloud, cells, words)
   type(deck_type), intent(in) :: deck
   !> Its points
   type(cloud_type), intent(in) :: cloud
   !> Cells along each direction, shape (nd)
   integer, intent(in) :: cells(:)
   character(len=:), allocatable, intent(out) :: words
   character(len=:), allocatable :: essential

   if (.not. allocated(cloud%lattice)) then
      words = 'geometry.blocks='//list(cells)//new_line('a')
      return
   end if
   words = ''
   call lattice_words(deck, cells + 1, words)
   call deck%get('galerkin.essential', essential)
   if (essential == 'transformation') words = words//'galerkin.essential="'//essential//'"' &
      & //new_line('a')
end subroutine get_words

!> Solve a scene and its companion
subroutine solve(problem, scene, deck, model, receiver, halvings, run, answer, companion, bars, &
   & error)
   class(discretisation_type), target, intent(inout) :: problem
   !> Its scene
   type(scene_type), intent(inout) :: scene
   !> Its deck
   type(deck_type), target, intent(in) :: deck
   !> Points of the model file
   type(cloud_type), target, intent(in) :: model
   !> Asked whether to stop
   class(recorder_type), target, intent(inout) :: receiver
   !> Halvings with which the load begins
   integer, intent(in) :: halvings
   !> All load steps, as far as they converged
   type(start_type), intent(out) :: run
   !> States that are compared: for a programme, which may end at rest, all of them, for a ramp the
   !> last one; without unknowns where they did not converge
   type(solved_type), intent(out) :: answer
   type(companion_type), intent(out) :: companion
   type(bars_type), intent(out) :: bars
   !> Error handling: a solution failed
   type(error_type), allocatable, intent(out) :: error
   type(kept_run) :: recorder
   type(start_type) :: begin
   type(timer_type) :: timer
   integer :: first

   call recorder%begin(problem%n, receiver)
   allocate (begin%step(0), begin%x(problem%n, 1))
   begin%x = 0.0_wp
   begin%halvings = halvings
   call solve_problem(problem, scene, '', recorder, timer, error, begin)
   run = recorder%run
   if (allocated(error)) return
   first = merge(1, size(run%step), scene%programme%count() > 1)
   answer = solved_type(problem, deck, model, receiver)
   ! gfortran 12 loses them as arguments of the line above
   answer%load = run%step(first:)%load
   answer%x = run%x(:, first:)
   call new_bars(bars, problem, answer%load, answer%x, error)
   if (allocated(error)) return
   call solve_companion(companion, answer, bars)
   if (allocated(companion%why_not)) then
      call deck%complain('refine', companion%why_not, error)
      return
   end if
   call bars_by_other(bars, problem, companion%seen, companion%kind, companion%around)
end subroutine solve

!> How much of each probe's bar comes from each direction
subroutine shares(answer, cells, bars, share)
   type(solved_type), intent(in) :: answer
   !> Cells along each direction, shape (nd)
   integer, intent(in) :: cells(:)
   type(bars_type), intent(in) :: bars
   !> Shares, which add up to one, shape (nd, probes) [-]
   real(wp), allocatable, intent(out) :: share(:, :)
   type(companion_type) :: companion
   character(len=:), allocatable :: steps, words
   integer :: d, i, n, other(size(cells))

   associate (scene => answer%problem%scene)
      steps = 'load.steps='//to_text(merge(scene%load%steps, 1, scene%programme%count() > 1)) &
         & //new_line('a')
      allocate (share(size(cells), size(scene%probe)))
      do d = 1, size(cells)
         other = cells
         other(d) = other_number(cells(d) + 1, scene%approximation%order) - 1
         companion = companion_type()
         call get_words(answer%deck, scene%cloud, other, words)
         call solve_beside(companion, answer, words//steps)
         if (allocated(companion%why_not)) then
            ! unknown: the same as the others
            share(d, :) = 1.0_wp
            cycle
         end if
         do i = 1, size(scene%probe)
            n = quantity_size(scene%probe(i)%quantity)
            share(d, i) = maxval(abs(bars%values(:n, i, :) - companion%seen%values(:n, i, :)))
            ! with twice as many cells the change is a quarter of that with half as many
            if (other(d) > cells(d)) share(d, i) = 4.0_wp*share(d, i)
         end do
      end do
      do i = 1, size(scene%probe)
         share(:, i) = share(:, i) + tiny(1.0_wp)
         share(:, i) = share(:, i)/sum(share(:, i))
      end do
   end associate
end subroutine shares

!> Bars over the sizes of their probes, for a programme over the largest on the way [-]
pure function relative(bars, wanted) result(bar)
   type(bars_type), intent(in) :: bars
   !> Target error [-]
   real(wp), intent(in) :: wanted
   real(wp) :: bar(size(bars%size))
   integer :: i

   do i = 1, size(bar)
      associate (all_bars => bars%bars(:, i, :))
         bar(i) = maxval(all_bars, mask=all_bars >= 0.0_wp)/max(min(max(bars%size(i), &
            & bars%peak(i)), max(1.0_wp, of_tenth/wanted)*min(bars%small(i), bars%read(i))), &
            & tiny(1.0_wp))
      end associate
   end do
end function relative

!> Fewest cells with which all probes are accurate enough, at most twice as many
pure function next_cells(cells, share, bar, wanted) result(next)
   !> Cells, shape (nd)
   integer, intent(in) :: cells(:)
   !> Share of each direction, shape (nd, probes) [-]
   real(wp), intent(in) :: share(:, :)
   !> Bar of each probe [-]
   real(wp), intent(in) :: bar(:)
   !> Target error [-]
   real(wp), intent(in) :: wanted
   integer :: next(size(cells))
   real(wp) :: part(size(cells)), left
   logical :: grows(size(cells))
   integer :: d, i

   next = cells
   do i = 1, size(bar)
      if (bar(i) <= wanted) cycle
      part = bar(i)*share(:, i)
      ! directions with errors below their part keep their cells and leave more to the others
      grows = .true.
      do d = 1, size(cells)
         left = (wanted - sum(part, mask=.not. grows))/count(grows)
         if (all(part > left .or. .not. grows)) exit
         grows = grows .and. part > left
      end do
      do d = 1, size(cells)
         if (grows(d)) next(d) = max(next(d), ceiling(cells(d)*min(most_growth, &
            & (part(d)/left)**(1.0_wp/order))))
      end do
   end do
   ! pairs of cells share their pressures
   where (next > cells) next = 2*((next + 1)/2)
end function next_cells

!> Smallest divisor of a number that is not below another number
elemental integer function divisor_from(least, number) result(divisor)
   !> Lower limit
   integer, intent(in) :: least
   !> Number, itself the largest divisor
   integer, intent(in) :: number

   do divisor = min(least, number), number - 1
      if (mod(number, divisor) == 0) return
   end do
   divisor = number
end function divisor_from

!> Receiver for further solutions within the cost of a search
function limited(self, receiver) result(within)
   class(refinement_type), intent(in) :: self
   !> Receiver of the caller
   class(recorder_type), target, intent(in) :: receiver
   type(limited_type) :: within
   real(wp) :: now

   call cpu_time(now)
   within%receiver => receiver
   within%deadline = now + self%cost - self%seconds
end function limited

!> Whether the cost is used up
logical function late(self)
   class(limited_type), intent(in) :: self
   real(wp) :: now

   call cpu_time(now)
   late = now > self%deadline
end function late

!> Whether a solution must stop: the cost is used up, or the caller wants to stop
logical function stopped(self)
   class(limited_type), intent(inout) :: self

   stopped = self%late()
   if (.not. stopped) stopped = self%receiver%stopped()
end function stopped

end module rk_refine
