!> A second solution beside an answer, cheap and independent enough to estimate the answer's error.
!>
!> Weak forms converge regularly from one side: the error of the same form on half as many points in
!> each direction is a few times as large, and the difference is an error bar that contains the
!> error. Where that leaves hardly any points, the second solution has twice as many, if they are
!> few in all; in a solid with directions of both kinds there is one solution with more points and
!> one with fewer, since their errors would cancel in a single one. Collocation forms do not: where
!> they fail they fail on all clouds alike, so they are compared with the weak form on the same
!> points.
module rk_companion
   use, intrinsic :: ieee_arithmetic, only : ieee_is_finite
   use rk_bars, only : another_form, bars_type, fewer_points, holds_part, more_points, &
      & new_bars, share_of_kind, twice_fewer
   use rk_clock, only : tick, timer_type
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type, word_length
   use rk_deck_scene, only : new_scene
   use rk_discretisation, only : discretisation_type, free_discretisation, has_few_cells
   use rk_error, only : error_type, err_input, err_memory
   use rk_neighbours, only : nearest_points
   use rk_new_problem, only : new_problem
   use rk_precision, only : i8, wp
   use rk_probes, only : quantity_kind, quantity
   use rk_recorder, only : iteration_type, recorder_type, start_type, step_type
   use rk_run, only : solve_problem
   use rk_scene, only : scene_type
   use rk_shape, only : shape_type
   use rk_states, only : field_state, point_state
   use rk_text, only : to_text
   use rk_voxel_shape, only : thin_directions
   implicit none
   private

   public :: companion_type, solved_type, solve_companion, solve_beside, choose_companion
   public :: other_number
   public :: lattice_words, list, kept_run

   !> End of an override
   character, parameter :: nl = new_line('a')
   !> Prescribed displacements of a companion beside an answer by the penalty
   character(len=*), parameter :: exactly = 'galerkin.essential="transformation"'//nl
   !> The same beside an answer that enforces them exactly
   character(len=*), parameter :: softly = 'galerkin.essential="penalty"'//nl
   !> Halvings of its load steps (more would only locate the load at which it stops more
   !> accurately), and steps of its second attempt
   integer, parameter :: halvings = 6, least_steps = 5
   !> Cells across a body that are too few to refute a finer answer: two, and three, of which one
   !> does not share its pressure
   integer, parameter :: few_cells = 3
   !> Points across a plane body up to which half of the cells are too few for a comparison: twice
   !> as many, which cost little there, are used instead
   integer, parameter :: least_cells = 2*few_cells + 2
   !> Cells across a solid with which its warping under torsion and its bending are resolved, those
   !> from which on the others of such a solid are not doubled, and the part of a difference from
   !> half as many cells that has the same ratio to the error as one from twice as many [-]
   integer, parameter :: enough_cells = 4, many_cells = 8
   real(wp), parameter :: of_halved = 0.35_wp
   !> Blocks of voxels across a layer of which half are too few for a comparison; three quarters
   !> are kept there
   integer, parameter :: least_blocks = 4
   !> Radius around a probe in which its quantity is compared, in spacings; with a multiple of half
   !> a spacing rounding would decide which points lie inside [-]
   real(wp), parameter :: vicinity = 1.1_wp
   !> Least difference of each stress component there, relative to that of all components, in 3D:
   !> two twisted bars agreed in one component and were accepted with errors of 11 and 15 % [-]
   real(wp), parameter :: share_around = 0.5_wp
   !> Distance from which on the companion itself is solved again [-]
   real(wp), parameter :: suspect = 0.05_wp

   !> An answer, and the data for a second solution beside it
   type :: solved_type
      !> Its problem
      class(discretisation_type), pointer :: problem => null()
      !> Its deck
      type(deck_type), pointer :: deck => null()
      !> Points of the model file, where the deck uses one
      type(cloud_type), pointer :: model => null()
      !> Receiver of the caller, asked whether to stop
      class(recorder_type), pointer :: receiver => null()
      !> Loads of its states that are compared, shape (m) [-]
      real(wp), allocatable :: load(:)
      !> Their unknowns, shape (n, m)
      real(wp), allocatable :: x(:, :)
   end type solved_type

   !> Results of the second solution
   type :: companion_type
      !> Why there is none; not allocated where there is one
      character(len=:), allocatable :: why_not
      !> A second solution was due, but failed
      logical :: missed = .false.
      !> Its form
      character(len=:), allocatable :: method
      !> How it differs from the answer: fewer_points, more_points, which are the better answer of
      !> the two, another_form or twice_fewer
      integer :: kind = fewer_points
      !> Its source points or blocks along each direction, in words; not allocated where they are
      !> those of the answer
      character(len=:), allocatable :: lattice
      !> So few in some direction that its error may be much larger than that of the answer
      logical :: coarse = .false.
      !> A single voxel across the answer's body, so that no second solution has more blocks there
      logical :: single = .false.
      !> Beside an answer of few cells, with more points in some direction: its last state is not a
      !> stable equilibrium. A body with one or two cells across locks in bending and seems stable
      logical :: unstable = .false.
      !> Source points and unknowns
      integer :: points = 0
      integer :: unknowns = 0
      !> Wall time [s]
      real(wp) :: seconds = 0.0_wp
      !> Probes
      type(bars_type) :: seen
      !> Largest norm of the difference of the displacements over the largest of the displacements,
      !> which is for the same form at least a tenth of that of a free body under the stress [-]
      real(wp) :: distance = 0.0_wp
      !> Tissue with most of that difference, of several; 0 where none has more than half of it
      integer :: tissue = 0
      !> Root mean square of that difference over the volume, the largest of all loads [length]
      real(wp) :: difference = 0.0_wp
      !> Root mean square difference of the probed quantity at points around each probe,
      !> negative if there are none, shape (3, probes, loads)
      real(wp), allocatable :: around(:, :, :)
   end type companion_type

   !> Receiver that keeps a run
   type, extends(recorder_type) :: kept_run
      !> The run
      type(start_type) :: run
      !> Loads of the states that are kept; all of them where it is not allocated, shape (m) [-]
      real(wp), allocatable :: load(:)
      !> Distance up to which a load is one of them [-], for a motion [time]
      real(wp) :: within = 1.0e-9_wp
   contains
      procedure :: begin, iteration, step
   end type kept_run

contains

!> Solve the companion of an answer and evaluate the same probes
subroutine solve_companion(self, answer, bars)
   type(companion_type), intent(out) :: self
   type(solved_type), intent(in) :: answer
   !> Its probes
   type(bars_type), intent(in) :: bars
   type(companion_type) :: alike
   character(len=:), allocatable :: words, opposite, halved

   self%method = answer%problem%scene%method
   if (allocated(answer%problem%scene%body_force)) then
      self%missed = .true.
      self%why_not = 'the loads were set point by point, which a deck cannot express'
      return
   end if
   call choose_companion(self, answer%problem%scene, answer%deck, words, halved)
   if (allocated(self%why_not)) return
   call solve_beside(self, answer, words)
   if (allocated(halved) .and. .not. (allocated(self%why_not) .or. answer%receiver%stopped())) then
      alike%method = self%method
      call solve_beside(alike, answer, words//halved)
      if (.not. allocated(alike%why_not)) then
         call add_change(self, alike, bars)
      else
         call move_alloc(alike%why_not, self%why_not)
         self%missed = alike%missed
      end if
      return
   end if
   opposite = ''
   if (index(words, exactly) > 0) opposite = softly
   if (index(words, softly) > 0) opposite = exactly
   if (opposite /= '' .and. allocated(answer%problem%scene%cloud%lattice) .and. .not. ( &
      & allocated(self%why_not) .or. self%kind /= fewer_points .or. answer%receiver%stopped())) then
      alike%method = self%method
      ! of two overrides of a key the last one counts
      call solve_beside(alike, answer, words//opposite)
      if (.not. allocated(alike%why_not)) call take_farther(self, alike, bars)
      return
   end if
   if (.not. self%missed .or. opposite /= softly) return
   if (answer%receiver%stopped()) return
   ! with exact values at points it did not converge: the penalty alone is compared
   self%missed = .false.
   deallocate (self%why_not)
   call solve_beside(self, answer, words//softly)
end subroutine solve_companion

!> Of two companions take the probes that are farther from an answer, moved away by the difference
!> of the two: fewer points may make a body too stiff by as much as the penalty makes it too soft,
!> and then only this difference shows the error at singular rims
subroutine take_farther(self, other, bars)
   type(companion_type), intent(inout) :: self
   !> Companion on the same points by the other boundary method
   type(companion_type), intent(in) :: other
   !> Probes of the answer
   type(bars_type), intent(in) :: bars
   real(wp) :: between(3, size(bars%values, 2), size(bars%values, 3))

   self%kind = twice_fewer
   between = abs(other%seen%values - self%seen%values)
   where (abs(other%seen%values - bars%values) > abs(self%seen%values - bars%values)) &
      & self%seen%values = other%seen%values
   self%seen%values = self%seen%values + sign(between, self%seen%values - bars%values)
   self%difference = max(self%difference, other%difference)
   self%around = max(self%around, other%around)
   self%seconds = self%seconds + other%seconds
end subroutine take_farther

!> Add the difference from a companion with half as many cells in some directions to that from one
!> with more cells in the others
subroutine add_change(self, other, bars)
   type(companion_type), intent(inout) :: self
   !> Companion with half as many cells in some directions
   type(companion_type), intent(in) :: other
   !> Probes of the answer
   type(bars_type), intent(in) :: bars

   self%seen%values = self%seen%values + sign(of_halved*(other%seen%values - bars%values), &
      & self%seen%values - bars%values)
   self%difference = self%difference + of_halved*other%difference
   self%distance = self%distance + of_halved*other%distance
   self%around = merge(self%around + of_halved*other%around, self%around, &
      & self%around >= 0.0_wp .and. other%around >= 0.0_wp)
   self%seconds = self%seconds + other%seconds
end subroutine add_change

!> Solve the deck of an answer with overrides, and evaluate the same probes
subroutine solve_beside(self, answer, words)
   type(companion_type), intent(inout) :: self
   type(solved_type), intent(in) :: answer
   !> Overrides of its deck, a line each
   character(len=*), intent(in) :: words
   type(deck_type) :: other
   type(scene_type), target :: scene
   class(discretisation_type), allocatable :: second
   type(kept_run) :: keeper
   type(timer_type) :: timer
   type(error_type), allocatable :: error
   real(wp) :: ratio, step
   integer(i8) :: clock
   integer :: steps

   call system_clock(clock)
   call answer%deck%vary(words, other, error)
   if (.not. allocated(error)) call new_scene(scene, other, answer%model, error)
   if (.not. allocated(error)) call new_problem(second, scene, error)
   if (.not. allocated(error)) then
      self%points = second%shape%ns
      self%unknowns = second%n
      keeper%load = answer%load
      ! errors of steps twice as long are four times as large, but waves cross half as wide cells in
      ! half the time
      ratio = merge(0.5_wp, 2.0_wp, self%kind == more_points)
      do
         if (allocated(scene%motion)) then
            step = ratio*scene%motion%time_step
            scene%motion%time_step = step
            scene%motion%end_time = step*ceiling(maxval(answer%load)/step - 1.0e-6_wp)
            scene%motion%every = 1
            ! states between which those of the answer are interpolated
            keeper%within = 3.1_wp*step
         end if
         call keeper%begin(second%n, answer%receiver)
         call solve_problem(second, scene, '', keeper, timer, error)
         if (.not. (allocated(error) .and. allocated(scene%motion))) exit
         ! a step that is not stable, where cells are hardly wider than those of the answer
         if (error%code /= err_input .or. step <= answer%problem%scene%motion%time_step) exit
         ratio = 0.75_wp
      end do
      if (.not. allocated(error)) call look(self, second, keeper%run, answer, error)
      ! one step may be too long, or lead to another branch. Steps are divided, so that a programme
      ! still has the states that are compared
      steps = scene%load%steps
      steps = steps*((max(least_steps, answer%problem%scene%load%steps) + steps - 1)/steps)
      if ((allocated(error) .or. self%distance > suspect) .and. scene%load%steps < steps .and. &
         & .not. (second%linear .or. answer%receiver%stopped())) then
         scene%load%steps = steps
         call keeper%begin(second%n, answer%receiver)
         call solve_problem(second, scene, '', keeper, timer, error)
         if (.not. allocated(error)) call look(self, second, keeper%run, answer, error)
      end if
      if (.not. (allocated(error) .or. second%linear) .and. has_few_cells(answer%problem%scene) &
         & .and. allocated(scene%cloud%lattice)) then
         associate (run => keeper%run, own => answer%problem%scene%cloud%lattice)
            if (any(scene%cloud%lattice > own)) self%unstable = second%is_unstable( &
               & run%x(:, size(run%step)), run%step(size(run%step))%load)
         end associate
      end if
      call free_discretisation(second)
   end if
   if (allocated(error)) then
      self%missed = error%code /= err_memory
      self%why_not = 'the solution to compare with, method "'//self%method//'", ended: ' &
         & //error%message
   end if
   self%seconds = tick(clock)
end subroutine solve_beside

!> Form and points of the companion as overrides of the deck
subroutine choose_companion(self, scene, deck, words, halved)
   type(companion_type), intent(inout) :: self
   !> Scene of the answer
   type(scene_type), intent(in) :: scene
   !> Its deck
   type(deck_type), intent(in) :: deck
   !> Overrides, a line each
   character(len=:), allocatable, intent(out) :: words
   !> Further ones of a companion to add; not allocated if there is none
   character(len=:), allocatable, intent(out), optional :: halved
   integer, allocatable :: source(:), other(:)
   integer :: blocks(3), steps, voxels(3)
   logical, allocatable :: thin(:), long(:)

   ! all planned states of a programme are compared, but only the last one of a ramp
   steps = 1
   if (scene%programme%count() > 1) steps = scene%load%steps
   words = 'load.steps='//to_text(steps)//nl//'load.max_halvings='//to_text(halvings)//nl
   ! exact values make a body stiffer, the penalty makes it softer: this shows the method's effect
   if (scene%galerkin%essential == 'transformation') words = words//softly
   if (index(scene%method, 'rkcm') == 1 .or. blends(scene)) then
      self%kind = another_form
      if (allocated(scene%motion)) then
         self%why_not = 'motions by collocation have no second solution'
         return
      end if
      self%method = 'rkpm-scni'
      if (allocated(scene%cloud%lattice)) self%method = 'rkpm-gauss'
      words = words//'scene.method='//self%method//nl
      if (self%method == 'rkpm-gauss') words = words//'approximation.interface=0'//nl
      ! on few cells the error of the weak form has the size and sign of that of the answer
      if (self%method == 'rkpm-gauss' .and. scene%cloud%nd == 2) then
         if (any(scene%cloud%lattice <= least_cells)) then
            self%lattice = list(2*scene%cloud%lattice - 1)//' points'
            call lattice_words(deck, 2*scene%cloud%lattice - 1, words)
         end if
      end if
      ! on annuli the error of stresses at the surface is 0.3 % instead of 10 % at little cost
      if (scene%cloud%polar) then
         words = words//'approximation.kernel=quintic'//nl//'approximation.order=2'//nl &
            & //'approximation.support=3'//nl//'galerkin.gauss=3'//nl
      else
         words = words//'approximation.kernel=cubic'//nl//'approximation.order=1'//nl &
            & //'approximation.support=2'//nl//'galerkin.gauss=2'//nl
      end if
      return
   end if
   if (.not. allocated(scene%cloud%lattice)) then
      if (.not. allocated(scene%cloud%voxels%index)) then
         self%why_not = 'the model has no voxels to make fewer blocks of'
         return
      end if
      ! nodal cells have errors from the stepped surface that fewer of them do not reveal
      self%method = 'rkpm-gauss'
      call fewer_blocks(scene%cloud, blocks, other, voxels)
      thin = blocks < few_cells .and. voxels > blocks
      long = .not. thin .and. other < blocks
      self%single = any(voxels == 1)
      if (any(thin) .and. index(scene%method, 'rkpm-gauss') == 1) then
         self%kind = more_points
         if (any(long) .and. present(halved)) halved = 'geometry.blocks=' &
            & //list(merge(other, blocks, long))//nl
         other = merge(min(enough_cells, voxels), blocks, thin)
      else
         self%coarse = .true.
      end if
      words = words//'scene.method='//self%method//nl//'geometry.blocks='//list(other)//nl
      self%lattice = list(other)//' blocks'
      return
   end if
   call deck%get('geometry.source', source)
   other = other_number(source, scene%approximation%order)
   thin = other > source
   long = .not. thin .and. source - 1 > many_cells
   if (scene%cloud%nd == 2 .and. any(source <= least_cells)) other = 2*source - 1
   if (scene%cloud%nd == 3 .and. any(thin) .and. .not. allocated(scene%motion)) then
      self%kind = more_points
      other = merge(max(other, 1 + enough_cells), merge(source, 2*source - 1, long), thin)
      if (any(long) .and. present(halved)) then
         halved = ''
         call lattice_words(deck, merge(1 + (source - 1)/2, source, long), halved)
      end if
   end if
   if (all(other > source)) self%kind = more_points
   ! in any direction they need shorter time steps
   if (allocated(scene%motion) .and. any(other > source)) self%kind = more_points
   self%lattice = list(other)//' points'
   self%coarse = any(other < source .and. other - 1 <= few_cells)
   words = words//'scene.method='//self%method//nl
   call lattice_words(deck, other, words)
   ! with more points both methods come too close to each other, and a search from given points
   ! would pay for what its answer lacks; in 3D only few cells agree by chance, and the bars of more
   ! would double; few points in a narrow user-defined set constrain too little
   if (can_hold(scene) .and. (scene%cloud%nd == 2 .or. self%coarse .and. all(other < source)) &
      & .and. .not. (holds_part(scene) &
      & .or. self%kind == more_points .or. deck%has('refine'))) words = words//exactly
end subroutine choose_companion

!> Whether an answer blends materials over nodal cells of a lattice: fewer cells would blend them
!> alike, and three layers with forces 7 to 10 % off had bars of 3 to 4 %. Gauss points separate
!> materials; with few cells in a solid its bending is as uncertain
pure logical function blends(scene)
   type(scene_type), intent(in) :: scene

   blends = scene%method == 'rkpm-scni' .and. allocated(scene%cloud%lattice) &
      & .and. size(scene%tissue) > 1
   if (blends) blends = scene%cloud%nd == 2 .or. all(scene%cloud%lattice > few_cells)
end function blends

!> Whether displacements prescribed by the penalty can also be enforced exactly
pure logical function can_hold(scene)
   type(scene_type), intent(in) :: scene

   can_hold = scene%method == 'rkpm-gauss' .and. scene%galerkin%essential == 'penalty' &
      & .and. .not. allocated(scene%motion) .and. .not. any(scene%condition%tendon > 0.0_wp) &
      & .and. .not. any(abs(scene%condition%pressure) > 0.0_wp)
end function can_hold

!> Half as many blocks in each direction, three quarters of them where they are few across the body
!> or its tissues
subroutine fewer_blocks(cloud, blocks, other, voxels)
   !> Points of the answer, with voxels
   type(cloud_type), intent(in) :: cloud
   !> Its blocks along each axis, those of the companion, and voxels
   integer, intent(out) :: blocks(3)
   integer, allocatable, intent(out) :: other(:)
   integer, intent(out) :: voxels(3)
   logical :: thin(3)

   voxels = maxval(cloud%voxels%index, dim=2) - minval(cloud%voxels%index, dim=2) + 1
   if (allocated(cloud%block)) then
      blocks = maxval(cloud%block, dim=2) + 1
   else
      blocks = max(1, nint(voxels*cloud%voxels%size/minval(cloud%spacing, dim=2)))
   end if
   thin = thin_directions(cloud, max(2, (least_blocks*voxels)/blocks))
   other = (blocks + 1)/2
   ! pairs of blocks share their pressures
   where (thin) other = min(blocks, max(2, 2*((3*blocks + 2)/8)))
   ! a voxel in the middle of an even number of blocks would belong to one half of the body
   where (mod(voxels, 2) == 1 .and. mod(other, 2) == 0) other = &
      & merge(other + 1, other - 1, thin .and. other < blocks)
end subroutine fewer_blocks

!> Add overrides that give a deck another lattice, with matching collocation points
subroutine lattice_words(deck, source, words)
   !> Deck of a box or an annulus
   type(deck_type), intent(in) :: deck
   !> Source points along each edge, shape (nd)
   integer, intent(in) :: source(:)
   !> Overrides, a line each
   character(len=:), allocatable, intent(inout) :: words
   character(len=word_length), allocatable :: graded(:)
   character(len=:), allocatable :: sides
   integer, allocatable :: collocation(:)
   integer :: k

   call deck%get('geometry.collocation', collocation)
   call deck%get('geometry.graded', graded)
   sides = ''
   do k = 1, size(graded)
      sides = sides//trim(merge(',', ' ', k > 1))//'"'//trim(graded(k))//'"'
   end do
   words = words//'geometry.source='//list(source)//nl//'geometry.collocation=' &
      & //list(max(source, min(collocation, 2*source - 1)))//nl
   ! sides that were chosen with the points
   if (sides /= '') words = words//'geometry.graded=['//sides//']'//nl
end subroutine lattice_words

!> Half as many cells in a direction; twice as many where there are too few for a comparison
elemental integer function other_number(source, order) result(points)
   !> Source points in this direction
   integer, intent(in) :: source
   !> Order of the basis, which needs more points than its order
   integer, intent(in) :: order

   associate (cells => source - 1)
      points = 1 + max(cells/2, 2)
      if (cells < 3 .or. points <= order) points = 1 + 2*cells
   end associate
end function other_number

pure integer function list_length(values)
   integer, intent(in) :: values(:)

   ! to_text puts blanks after commas
   list_length = len(to_text(values)) - size(values) + 1
end function list_length

!> Integers in the notation of a deck
pure function list(values) result(text)
   integer, intent(in) :: values(:)
   character(len=list_length(values)) :: text

   write (text, '("[", *(i0, :, ","))') values
   text(len(text):) = ']'
end function list

!> Probes of the companion, and the distance of its displacements from those of the answer
subroutine look(self, problem, run, answer, error)
   type(companion_type), intent(inout) :: self
   !> Its problem
   class(discretisation_type), intent(in) :: problem
   !> Its load steps
   type(start_type), intent(in) :: run
   type(solved_type), intent(in) :: answer
   !> Error handling: a probe outside the body
   type(error_type), allocatable, intent(out) :: error
   type(field_state) :: own, state
   type(point_state) :: local, here
   type(shape_type) :: shape
   real(wp) :: u(answer%problem%fields, answer%problem%shape%nq), difference, total, most(2), off
   real(wp) :: of_tissue(size(problem%scene%tissue)), apart(size(problem%scene%probe))
   real(wp), allocatable :: x(:, :)
   integer :: nearest(size(problem%scene%cloud%points, 2))
   logical :: near(size(nearest), size(problem%scene%probe))
   integer :: i, ip, k, n

   x = reshape([(at_load(run, answer%load(k)), k=1, size(answer%load))], [problem%n, &
      & size(answer%load)])
   call new_bars(self%seen, problem, answer%load, x, error)
   if (allocated(error)) return
   associate (cloud => problem%scene%cloud, first => answer%problem, load => answer%load)
      n = min(cloud%nd, first%fields)
      nearest = nearest_points(first%scene%cloud%points, cloud%points)
      do i = 1, size(near, 2)
         associate (probe => problem%scene%probe(i))
            near(:, i) = [(norm2(cloud%points(:, ip) - probe%point(:cloud%nd)), ip=1, &
               & size(nearest))] < vicinity*cloud%mean_spacing() .and. probe%at_a_place()
            ! nodal cells have one stress each: halfway between two it is that of either one, and in
            ! a mirrored body that of the other
            if (first%scene%method /= 'rkpm-gauss' &
               & .and. quantity_kind(probe%quantity) /= 'length') near(:, i) = .false.
         end associate
      end do
      call first%scene%shape_at(cloud%points, shape, error, first=.true.)
      if (allocated(error)) return
      most = 0.0_wp
      of_tissue = 0.0_wp
      self%difference = 0.0_wp
      if (allocated(self%around)) deallocate (self%around)
      allocate (self%around(3, size(near, 2), size(load)), source=0.0_wp)
      do k = 1, size(load)
         call problem%state(x(:, k), load(k), state)
         call first%state(answer%x(:, k), load(k), own)
         difference = 0.0_wp
         total = 0.0_wp
         apart = 0.0_wp
         do ip = 1, size(cloud%points, 2)
            call problem%at_point(state, ip, local)
            call shape%interpolate(ip, answer%x(:, k), 1, 1 + cloud%nd, u)
            if (any(near(ip, :))) call first%at_place(own, nearest(ip), cloud%points(:, ip), u, &
               & here)
            do i = 1, size(near, 2)
               if (near(ip, i)) self%around(:, i, k) = self%around(:, i, k) + cloud%volume(ip) &
                  & *(quantity(problem%scene%probe(i)%quantity, local) &
                  & - quantity(first%scene%probe(i)%quantity, here))**2
               if (near(ip, i)) apart(i) = apart(i) + cloud%volume(ip) &
                  & *sum((here%cauchy - local%cauchy)**2)
            end do
            off = cloud%volume(ip)*sum((u(:n, 1) - local%u(:n))**2)
            difference = difference + off
            if (size(of_tissue) > 1) of_tissue(problem%scene%tissue_of(ip)) &
               & = of_tissue(problem%scene%tissue_of(ip)) + off
            total = total + cloud%volume(ip)*max(sum(u(:n, 1)**2), sum(local%u(:n)**2))
         end do
         ! a body constrained all round hardly moves, and a ratio of two small numbers means
         ! nothing: as for probes, the size is at least a tenth of that of its kind. Off
         ! equilibrium collocation may have the right stress; only its displacements are wrong
         if (index(first%scene%method, 'rkcm') /= 1) total = max(total, sum(cloud%volume) &
            & *(share_of_kind*self%seen%strained(k))**2)
         most = max(most, [difference, total])
         self%difference = max(self%difference, sqrt(difference/sum(cloud%volume)))
         do i = 1, size(near, 2)
            ! in 3D two solutions may agree in one component of a stress where others differ
            if (cloud%nd == 3 .and. index(problem%scene%probe(i)%quantity, 'cauchy') == 1) &
               & self%around(:, i, k) = max(self%around(:, i, k), share_around**2*apart(i))
            self%around(:, i, k) = sqrt(self%around(:, i, k) &
               & /max(sum(cloud%volume, mask=near(:, i)), tiny(1.0_wp)))
            if (.not. (any(near(:, i)) .and. all(ieee_is_finite(self%around(:, i, k))))) &
               & self%around(:, i, k) = -1.0_wp
         end do
      end do
   end associate
   self%distance = sqrt(most(1)/max(most(2), tiny(1.0_wp)))
   self%tissue = findloc(of_tissue > 0.5_wp*sum(of_tissue), .true., dim=1)
end subroutine look

!> Unknowns at a load, or at a time: between those of steps by a cubic polynomial
pure function at_load(run, load) result(x)
   type(start_type), intent(in) :: run
   real(wp), intent(in) :: load
   real(wp) :: x(size(run%x, 1)), off(size(run%step))
   logical :: near(size(off))
   integer :: i, k

   off = run%step%load - load
   i = minloc(abs(off), dim=1)
   x = run%x(:, i)
   if (abs(off(i)) <= 1.0e-6_wp*abs(load)) return
   near = .false.
   do k = 1, min(4, size(off))
      near(minloc(abs(off), dim=1, mask=.not. near)) = .true.
   end do
   x = 0.0_wp
   do i = 1, size(off)
      if (near(i)) x = x + run%x(:, i)*product(off/merge(off - off(i), off, &
         & [(k /= i, k=1, size(off))]), mask=near)
   end do
end function at_load

!> Begin without any step
subroutine begin(self, n, receiver)
   class(kept_run), intent(inout) :: self
   !> Unknowns
   integer, intent(in) :: n
   !> Receiver of the caller
   class(recorder_type), target, intent(inout) :: receiver

   self%receiver => receiver
   self%run = start_type()
   allocate (self%run%step(0), self%run%iteration(0), self%run%x(n, 0))
end subroutine begin

!> Keep an iteration if the whole run is kept
subroutine iteration(self, it)
   class(kept_run), intent(inout) :: self
   type(iteration_type), intent(in) :: it

   if (.not. allocated(self%load)) self%run%iteration = [self%run%iteration, it]
end subroutine iteration

!> Keep a load step that is wanted
subroutine step(self, st, x)
   class(kept_run), intent(inout) :: self
   type(step_type), intent(in) :: st
   real(wp), contiguous, intent(in) :: x(:)

   if (st%step == 0) then
      self%run%begin = st
      self%run%first = x
      return
   end if
   if (allocated(self%load)) then
      if (.not. any(abs(self%load - st%load) < self%within)) return
   end if
   self%run%step = [self%run%step, st]
   self%run%x = reshape([self%run%x, x], [size(x), size(self%run%step)])
end subroutine step

end module rk_companion
