!> Whether an answer is accepted, doubtful or refused, for reasons that were computed.
!>
!> Each check measures a property of the answer itself; none is a remark about a method. An answer
!> is refused where a check shows that it is wrong, doubtful where one cannot exclude it.
module rk_verdict
   use, intrinsic :: ieee_arithmetic, only : ieee_is_finite, ieee_is_nan, ieee_quiet_nan, &
      & ieee_value
   use rk_bars, only : another_form, bars_by_other, bars_by_solution, bars_type, more_points, &
      & new_bars, twice_fewer
   use rk_cloud, only : cloud_type
   use rk_companion, only : companion_type, solve_companion, solved_type
   use rk_deck, only : deck_type
   use rk_discretisation, only : deformation, discretisation_type
   use rk_ellipticity, only : ellipticity_type, find_ellipticity
   use rk_error, only : error_type
   use rk_follower, only : has_free_rim
   use rk_gaps, only : find_gaps
   use rk_precision, only : wp
   use rk_probes, only : quantity_kind, pressed_volume
   use rk_recorder, only : recorder_type
   use rk_refine, only : limited_type, refinement_type
   use rk_run, only : outcome_type
   use rk_states, only : field_state, point_state
   use rk_tensor, only : determinant
   use rk_programme, only : plan_type
   use rk_scene, only : scene_type
   use rk_text, only : to_text
   implicit none
   private

   public :: verdict_type, judge, refused, verdict_names

   !> Verdicts, larger is worse
   integer, parameter :: accepted = 1, doubtful = 2, refused = 3
   !> Their names
   character(len=8), parameter :: verdict_names(3) = ['accepted', 'doubtful', 'refused ']

   !> Bounds from which on an answer is doubtful and refused [-]. Works: cantilevers with errors of
   !> 56 to 98 % have 54 to 92 %, a locking block 49 %, sheets, tubes and straight blocks at most
   !> 1.7 %
   real(wp), parameter :: of_works(2) = [0.02_wp, 0.10_wp]
   !> Where nothing moves against a force the works are small differences of large parts: an
   !> inclined block with an error below 2 % has 5 %, those with 20 to 35 % have 19 to 24 %
   real(wp), parameter :: of_inner_works(2) = [0.10_wp, 0.30_wp]
   !> Imbalance of forces on all boundary sets, relative to the largest of them
   real(wp), parameter :: of_balance(2) = [0.05_wp, 0.25_wp]
   !> Error bar of a probe from another cloud, relative to its size: from fewer points of a lattice
   !> bars are several times the error, from fewer blocks of voxels less; from more points and for
   !> nodal cells they are not
   real(wp), parameter :: of_wide_bar = 0.10_wp, of_block_bar = 0.08_wp, of_bar = 0.05_wp
   !> Change of a probe from fewer points, and from more, which are more accurate, that is too large
   !> for any answer; and change from another form
   real(wp), parameter :: of_change = 0.25_wp, of_finer = 0.125_wp
   real(wp), parameter :: of_forms(2) = [0.05_wp, 0.10_wp]
   !> Change of all displacements against fewer points, mostly the error of a coarse companion:
   !> inclined blocks with errors of 0.3, 0.9 and 1.8 % differ by 8, 24 and 29 % from theirs
   real(wp), parameter :: of_distance(2) = [0.25_wp, 0.50_wp]
   !> Error of a linear problem with a known solution
   real(wp), parameter :: of_error(2) = [0.05_wp, 0.25_wp]
   !> Share of the volume that may lose ellipticity, and distance from a probe within which it may
   !> not, in spacings: a spindle with an error of 1.2 % has such a point on its fixed rim
   real(wp), parameter :: of_places = 0.01_wp, near_spacings = 2.0_wp
   !> Distance from the rim of a prescribed set within which a stress is singular, and from which on
   !> it is regular, in spacings of source points
   real(wp), parameter :: rim_spacings(2) = [1.0_wp, 2.0_wp]
   !> Changes below this count as zero [-]
   real(wp), parameter :: least_change = 1.0e-12_wp
   !> Bar of a probe below which it is zero among its kind [-]
   real(wp), parameter :: of_small = 0.01_wp
   !> Largest ratio of shear moduli up to which layers may be thinner than 1.5 spacings: half a
   !> spacing thick with a point in the middle, one between plates 2, 3.3 and 10 times as stiff was
   !> 2, 6 and 32 % too stiff, within bars of 5 to 9 % [-]
   real(wp), parameter :: most_ratio = 2.5_wp
   !> Share of the volume in which J differs from the J of the pressure, and by how much
   real(wp), parameter :: of_volume(2) = [0.05_wp, 0.25_wp], off_pressure = 0.1_wp
   !> Root mean square of this difference in a weak form, whose stress has the pressure of its cells
   !> and may be right where J at points is not: users of the field are warned, and the error bar of
   !> a probe of J includes it; mean of it above which inverted rims count
   real(wp), parameter :: of_point_volume = 0.05_wp
   !> The same of a model, whose usual blocks leave up to 20 % [-]
   real(wp), parameter :: of_block_volume = 0.2_wp
   !> Share of the surface at narrow gaps from which on they matter [-]
   real(wp), parameter :: least_gaps = 0.01_wp
   !> Why a state is doubtful if its tangent is not positive definite
   character(len=*), parameter :: unstable = 'unstable, its tangent is not ' &
      & //'positive definite: a small disturbance takes the body to another state; add a small ' &
      & //'transverse load and load.steps to get there, reduce the load or constrain the body'

   !> Verdict with its reasons and the error bars
   type :: verdict_type
      !> accepted, doubtful or refused; 0 where nothing was judged
      integer :: state = 0
      !> Reasons, and notes on what was not checked, each with its line feed
      character(len=:), allocatable :: reasons
      !> Error bars; without values if the run stopped early
      type(bars_type) :: bars
      !> Second solution
      type(companion_type) :: companion
      !> A reason can be removed by finer points or another form
      logical, private :: curable = .false.
   contains
      procedure :: get_sentence
      procedure, private :: object, compare
   end type verdict_type

contains

!> Judge the answer of a run by one check after the other, as far as earlier ones leave something to
!> check. The reasons are added to the warnings of the run; the remedy is named once, at their end.
subroutine judge(self, problem, deck, model, with_companion, search, receiver, outcome)
   type(verdict_type), intent(out) :: self
   class(discretisation_type), target, intent(in) :: problem
   type(deck_type), target, intent(in) :: deck
   !> Points of the model file, where the deck uses one
   type(cloud_type), target, intent(in) :: model
   !> Whether a second solution may be computed
   logical, intent(in) :: with_companion
   !> Search for the points, which reports itself why it failed
   type(refinement_type), intent(in) :: search
   !> Receiver of the caller, asked whether to stop
   class(recorder_type), target, intent(inout) :: receiver
   !> Results of the run
   type(outcome_type), intent(inout) :: outcome
   type(limited_type), target :: within
   type(solved_type) :: answer
   type(error_type), allocatable :: error
   character(len=:), allocatable :: text
   real(wp) :: off

   self%state = accepted
   self%reasons = ''
   off = 0.0_wp
   call warn_of_units(deck, outcome, receiver)
   call warn_of_unused(deck, problem%scene, outcome, receiver)
   call warn_of_references(problem%scene, outcome, receiver)
   call warn_of_moduli(problem, outcome, receiver)
   if (allocated(outcome%ended)) then
      ! already given as a warning
      self%state = refused
      self%reasons = outcome%ended//new_line('a')
      if (allocated(outcome%broken)) then
         if (any(outcome%broken)) then
            call describe_broken(problem, outcome, text)
            call outcome%warn(text, receiver)
         end if
      end if
      return
   end if
   if (problem%linear) then
      if (allocated(outcome%norms)) call self%compare(outcome%norms%largest_l2/max( &
         & outcome%norms%largest_l2_solution, tiny(1.0_wp)), of_error, 'the norm of the error is ' &
         & //'# of the norm of the known solution')
   else if (.not. outcome%unstrained) then
      ! without strain, rounding errors would be compared with each other
      call judge_works(self, problem, outcome)
      call self%compare(outcome%imbalance, of_balance, 'the forces on all boundary ' &
         & //'sets do not balance: the residual is # of the largest', curable=.true.)
      ! with pressures that follow a free rim only the symmetric part of the tangent is known
      if (outcome%unstable) call self%object(doubtful, 'the equilibrium '//trim(merge('may be', &
         & 'is    ', has_free_rim(problem%scene)))//' '//unstable)
      if (problem%has_pressure()) call judge_volume(self, problem, outcome%peak)
      if (index(problem%scene%method, 'rkpm') == 1) call warn_of_volume(problem, outcome, &
         & receiver, off)
   end if
   outcome%warnings = outcome%warnings//self%reasons
   if (has_thin_layers(problem)) then
      call self%object(doubtful, 'a material layer is thinner than 1.5 spacings of the source ' &
         & //'points and may be too stiff across its thickness')
      self%curable = .true.
   end if
   call judge_gaps(self, problem%scene%cloud)
   call judge_broken(self, problem, off, outcome)
   ! the run has already warned of this
   if (allocated(outcome%lost)) call judge_lost(self, problem, outcome)
   call new_bars(self%bars, problem, outcome%load, outcome%x, error)
   if (.not. allocated(error)) then
      within = search%limited(receiver)
      answer = solved_type(problem, deck, model)
      answer%receiver => within
      answer%load = outcome%load
      answer%x = outcome%x
      call judge_by_others(self, answer, with_companion, search, outcome)
   end if
   if (self%curable .and. .not. search%searched) then
      text = ''
      if (index(problem%scene%method, 'rkpm') /= 1 .or. self%companion%kind == another_form) &
         & text = 'method "rkpm-gauss", whose bars come ' &
         & //'from fewer points, or '
      if (allocated(problem%scene%cloud%lattice)) then
         text = text//'more points (geometry.source, or accuracy without it)'
      else if (allocated(problem%scene%cloud%voxels%index)) then
         text = text//'more points (geometry.blocks or build.source_stride)'
      else
         text = text//'a denser cloud'
      end if
      self%reasons = self%reasons//'remedy: '//text//new_line('a')
   end if
end subroutine judge

!> Warn of the default muscle stress in a deck with units other than N and cm
subroutine warn_of_units(deck, outcome, receiver)
   type(deck_type), intent(in) :: deck
   type(outcome_type), intent(inout) :: outcome
   class(recorder_type), intent(inout) :: receiver
   character(len=:), allocatable :: key, name, model, force, length
   real(wp) :: stress
   integer :: i

   call deck%get('units.force', force)
   call deck%get('units.length', length)
   if (force == 'N' .and. length == 'cm') return
   do i = 1, deck%count('material')
      key = 'material.'//to_text(i)
      call deck%get(key//'.model', model)
      if (model /= 'muscle' .or. deck%given(key//'.sigma_max')) cycle
      call deck%get(key//'.name', name)
      call deck%get(key//'.sigma_max', stress)
      call outcome%warn('material '//name//': sigma_max is the default, '//to_text(stress, 3) &
         & //' N/cm^2, but its unit in this deck is '//force//'/'//length//'^2: give its value', &
         & receiver)
   end do
end subroutine warn_of_units

!> Warn of load programmes and sets that nothing refers to: with a forgotten reference the load is a
!> ramp; and of an activation that no muscle has
subroutine warn_of_unused(deck, scene, outcome, receiver)
   type(deck_type), intent(in) :: deck
   !> Its scene
   type(scene_type), intent(in) :: scene
   type(outcome_type), intent(inout) :: outcome
   class(recorder_type), intent(inout) :: receiver
   character(len=:), allocatable :: name
   integer :: i

   do i = 1, deck%count('amplitude')
      call deck%get('amplitude.'//to_text(i)//'.name', name)
      if (.not. (refers('load.amplitude') .or. among('boundary', '.amplitude') &
         & .or. among('material', '.amplitude'))) call outcome%warn('amplitude '//name &
         & //': no amplitude key of a boundary, a material or the load refers to it', receiver)
   end do
   do i = 1, deck%count('set')
      call deck%get('set.'//to_text(i)//'.name', name)
      if (.not. (among('boundary', '.set') .or. among('probe', '.set'))) call outcome%warn('set ' &
         & //name//': no boundary and no probe refers to it', receiver)
   end do
   associate (fibered => [(scene%tissue(i)%material%fibered, i=1, size(scene%tissue))])
      if (deck%given('load.activation') .and. any(fibered) .and. .not. any(fibered .and. &
         & [(.not. deck%given('material.'//to_text(i)//'.activation'), i=1, size(fibered))])) &
         & call outcome%warn('load.activation has no effect: every material with fibers has its ' &
         & //'own activation; change material.NAME.activation, or leave it out there', receiver)
   end associate

contains

   !> Whether a key has this name
   logical function refers(key)
      character(len=*), intent(in) :: key
      character(len=:), allocatable :: own

      refers = deck%has(key)
      if (.not. refers) return
      call deck%get(key, own)
      refers = own == name
   end function refers

   !> Whether a key of any entry has it
   logical function among(table, key)
      character(len=*), intent(in) :: table, key
      integer :: k

      among = .false.
      do k = 1, deck%count(table)
         among = among .or. refers(table//'.'//to_text(k)//key)
      end do
   end function among

end subroutine warn_of_unused

!> Warn of reference values that are compared with nothing, because no load step ends there
subroutine warn_of_references(scene, outcome, receiver)
   type(scene_type), intent(in) :: scene
   type(outcome_type), intent(inout) :: outcome
   class(recorder_type), intent(inout) :: receiver
   !> Loads that differ by less are the same [-]
   real(wp), parameter :: same = 1.0e-9_wp
   type(plan_type) :: planned
   real(wp), allocatable :: without(:)
   character(len=:), allocatable :: names
   integer :: i, k

   if (size(scene%reference) == 0) return
   planned = scene%programme%plan(scene%load%steps)
   allocate (without(0))
   names = ''
   do k = 1, size(scene%reference)
      associate (load => scene%reference(k)%load, &
         & name => scene%probe(scene%reference(k)%probe)%name)
         do i = 1, size(load)
            if (minval(abs(planned%load - load(i))) <= same) cycle
            if (index(names//',', ' '//name//',') == 0) names = names//', '//name
            if (all(abs(without - load(i)) > same)) without = [without, load(i)]
         end do
      end associate
   end do
   if (size(without) > 0) call outcome%warn('reference of'//names(2:)//': the values at load ' &
      & //to_text(without)//' are compared with nothing, because the load steps end at ' &
      & //to_text(planned%load)//': change load.steps, or give an [[amplitude]] these times', &
      & receiver)
end subroutine warn_of_references

!> Warn of a bulk modulus with which Poisson's ratio is below -1/4, as with K in another unit
subroutine warn_of_moduli(problem, outcome, receiver)
   class(discretisation_type), intent(in) :: problem
   type(outcome_type), intent(inout) :: outcome
   class(recorder_type), intent(inout) :: receiver
   integer :: k

   if (problem%linear) return
   do k = 1, size(problem%scene%tissue)
      associate (material => problem%scene%tissue(k)%material)
         if (3.0_wp*material%bulk >= material%shear) cycle
         call outcome%warn('material '//problem%scene%tissue(k)%name//': K = ' &
            & //to_text(material%bulk)//' is less than a third of the shear modulus, ' &
            & //to_text(material%shear)//', so that the material widens when it is pulled: ' &
            & //'check the unit of K', receiver)
      end associate
   end do
end subroutine warn_of_moduli

!> Compare an answer with the known solution, or with a second one
subroutine judge_by_others(self, answer, with_companion, search, outcome)
   type(verdict_type), intent(inout) :: self
   type(solved_type), intent(in) :: answer
   !> Whether a second solution may be computed
   logical, intent(in) :: with_companion
   !> Search for the points, which may already have the second solution
   type(refinement_type), intent(in) :: search
   type(outcome_type), intent(inout) :: outcome
   type(error_type), allocatable :: error
   real(wp), dimension(size(answer%problem%scene%probe)) :: lower, widest
   character(len=:), allocatable :: from
   logical :: adrift

   adrift = self%state == refused
   call judge_values(self, answer%problem, outcome)
   associate (problem => answer%problem)
      if (allocated(outcome%norms)) then
         call bars_by_solution(self%bars, problem, error)
         lower = of_error(1)
         call judge_probes(self, problem, lower, of_error(2), self%bars%size, &
            & ' from the known solution', outcome)
         return
      end if
      if (.not. with_companion) then
         self%companion%why_not = 'the second solution was switched off'
      else if (allocated(search%companion)) then
         self%companion = search%companion
      else
         call solve_companion(self%companion, answer, self%bars)
      end if
      if (allocated(self%companion%why_not)) then
         call no_estimate(self, outcome)
         return
      end if
      call bars_by_other(self%bars, problem, self%companion%seen, self%companion%kind, &
         & self%companion%around)
      if (allocated(search%bars)) then
         if (size(search%bars%load) == size(self%bars%load)) self%bars = search%bars
      end if
      if (outcome%unstrained) return
      if (self%companion%unstable .and. .not. outcome%unstable) call self%object(doubtful, &
         & 'the equilibrium is unstable with '//self%companion%lattice//': with fewer cells ' &
         & //'across it, the body is too stiff to buckle; use more points')
      if (self%companion%single) call self%object(doubtful, 'the body has one voxel across: no ' &
         & //'second solution shows its error in bending; use smaller voxels')
      lower = of_forms(1)
      if (self%companion%kind /= another_form) then
         lower = of_bar
         if (allocated(problem%scene%cloud%block)) lower = of_block_bar
         if (allocated(problem%scene%cloud%lattice) .and. self%companion%kind /= more_points) &
            & lower = of_wide_bar
         lower = max(0.0_wp, lower - self%bars%open)/self%bars%factor
      end if
      widest = self%bars%size
      ! the mean stress of a body in bending may be several times the largest probed one
      if (search%searched .and. allocated(problem%scene%cloud%lattice)) &
         & widest = max(of_bar, search%wanted)*self%bars%read
      call describe_other(self%companion, from)
      call judge_probes(self, problem, lower, most_change(self%companion), widest, from, outcome)
      ! off equilibrium collocation has several minima, and the iteration may stop at any of them
      if (adrift) call withhold(self%bars)
   end associate
end subroutine judge_by_others

!> Change of a probe from a second solution that is too large for any answer; too few cells may have
!> large errors themselves, and with two second solutions their difference is included [-]
pure real(wp) function most_change(companion)
   type(companion_type), intent(in) :: companion

   most_change = of_change
   if (companion%kind == twice_fewer) most_change = 2.0_wp*of_change
   if (companion%kind == more_points) most_change = of_finer
   if (companion%coarse) most_change = huge(1.0_wp)
   if (companion%kind == another_form) most_change = of_forms(2)
end function most_change

!> Description of a second solution, to follow a difference in a sentence
subroutine describe_other(companion, text)
   type(companion_type), intent(in) :: companion
   character(len=:), allocatable, intent(out) :: text

   text = ' from a solution'
   if (companion%kind == another_form) text = text//' by method "'//companion%method//'"'
   if (allocated(companion%lattice)) then
      text = text//' with '//companion%lattice
   else
      text = text//' on the same points'
   end if
end subroutine describe_other

!> Remove the bars of an answer where they would measure nothing
subroutine withhold(bars)
   type(bars_type), intent(inout) :: bars

   bars%change = ieee_value(1.0_wp, ieee_quiet_nan)
   bars%bars = ieee_value(1.0_wp, ieee_quiet_nan)
   bars%source = ''
end subroutine withhold

!> Compare works of stress and forces, where the form does not make them equal by construction
subroutine judge_works(self, problem, outcome)
   type(verdict_type), intent(inout) :: self
   class(discretisation_type), intent(in) :: problem
   type(outcome_type), intent(in) :: outcome
   real(wp) :: bounds(2)
   integer :: k

   if (.not. allocated(outcome%work_mismatch)) return
   bounds = of_inner_works
   associate (condition => problem%scene%condition)
      do k = 1, size(condition)
         if (condition(k)%acts()) bounds = of_works
      end do
   end associate
   call self%compare(abs(outcome%work_mismatch), bounds, 'the ' &
      & //'stress does # '//merge('less', 'more', outcome%work_mismatch < 0.0_wp)//' work than ' &
      & //'the forces: the state is not in equilibrium, and displacements may be as far off', &
      & curable=.true.)
end subroutine judge_works

!> Volume in which J differs from that of the pressure, where the pressure is a separate field
subroutine judge_volume(self, problem, state)
   type(verdict_type), intent(inout) :: self
   !> Problem with displacements and pressure
   class(discretisation_type), intent(in) :: problem
   type(field_state), intent(in) :: state
   real(wp) :: u(problem%fields, problem%shape%nq), f(3, 3), h(3, 3, 3), off, total, wanted
   integer :: ip, nd

   nd = problem%scene%cloud%nd
   off = 0.0_wp
   total = 0.0_wp
   associate (volume => problem%scene%cloud%volume)
      do ip = 1, size(volume)
         call problem%field(ip, state%x, 1 + nd, u)
         call deformation(nd, u, f, h)
         wanted = 1.0_wp + u(nd + 1, 1)/problem%mixture%bulk(ip)
         total = total + volume(ip)
         if (abs(determinant(f) - wanted) > off_pressure) off = off + volume(ip)
      end do
   end associate
   call self%compare(off/max(total, tiny(1.0_wp)), of_volume, 'in # of the volume J differs by ' &
      & //'more than '//to_text(off_pressure)//' from the value given by the pressure', &
      & curable=.true.)
end subroutine judge_volume

!> Warn where J at points differs from that of the pressure, which weak forms match only over cells
subroutine warn_of_volume(problem, outcome, receiver, off)
   class(discretisation_type), intent(in) :: problem
   type(outcome_type), intent(inout) :: outcome
   class(recorder_type), intent(inout) :: receiver
   !> Mean of the difference over the volume, where rims of fixed sets count little [-]
   real(wp), intent(out) :: off
   type(point_state) :: local
   real(wp) :: difference, square
   integer :: ip

   off = 0.0_wp
   square = 0.0_wp
   associate (volume => problem%scene%cloud%volume, sound => .not. outcome%broken)
      do ip = 1, size(volume)
         ! singular places are judged separately
         if (outcome%broken(ip)) cycle
         call problem%at_point(outcome%peak, ip, local)
         difference = abs(determinant(local%f) - pressed_volume(problem, ip, local))
         off = off + volume(ip)*difference
         square = square + difference**2
      end do
      off = off/max(sum(volume, mask=sound), tiny(1.0_wp))
      square = sqrt(square/max(count(sound), 1))
   end associate
   if (square <= merge(of_block_volume, of_point_volume, allocated(problem%scene%cloud%block))) &
      & return
   call outcome%warn('J at points differs by '//to_text(100.0_wp*square, 2)//' % (root mean ' &
      & //'square) from the value given by the pressure: stresses and forces use its mean over ' &
      & //'cells; use more points before you use J or F', receiver)
end subroutine warn_of_volume

!> Places of output that are inverted or whose stress is not finite. Corners of fixed faces are
!> singular, whatever the points: a few places there are reported but not counted, unless volumes
!> are wrong everywhere: fewer points have the same error, which bars then do not show
subroutine judge_broken(self, problem, off, outcome)
   type(verdict_type), intent(inout) :: self
   class(discretisation_type), intent(in) :: problem
   !> Mean difference of J at points from that of the pressure [-]
   real(wp), intent(in) :: off
   type(outcome_type), intent(inout) :: outcome
   character(len=:), allocatable :: found
   integer, allocatable :: bad(:)
   integer :: i

   if (.not. allocated(outcome%broken)) return
   if (.not. any(outcome%broken)) return
   call describe_broken(problem, outcome, found)
   outcome%warnings = outcome%warnings//found//new_line('a')
   bad = pack([(i, i=1, size(outcome%broken))], outcome%broken)
   associate (cloud => problem%scene%cloud)
      if (off <= of_point_volume .and. .not. matters(problem, outcome%broken) .and. &
         & all([(rim_near(problem, cloud%points(:, bad(i)), rim_spacings(2) &
         & *cloud%mean_spacing()) > 0, i=1, size(bad))])) then
         self%reasons = self%reasons//'not counted, since it is at the rim of a fixed set and ' &
            & //'far from the probes: '//found//new_line('a')
      else
         call self%object(doubtful, found)
      end if
   end associate
end subroutine judge_broken

!> Those places in words
subroutine describe_broken(problem, outcome, text)
   class(discretisation_type), intent(in) :: problem
   type(outcome_type), intent(in) :: outcome
   character(len=:), allocatable, intent(out) :: text
   character(len=:), allocatable :: extent

   text = 'the stress is not finite'
   if (.not. outcome%min_j > 0.0_wp) text = 'the volume ratio falls to ' &
      & //to_text(outcome%min_j, 2)//': the material is inverted'
   call get_extent(problem, outcome%broken, extent)
   text = text//extent//'; values there are meaningless: use more points there'
end subroutine describe_broken

!> Whether layers thinner than 1.5 spacings differ so much from their surroundings that it matters
logical function has_thin_layers(problem) result(thin)
   class(discretisation_type), intent(in) :: problem
   real(wp) :: shear(size(problem%scene%tissue))
   integer :: k

   thin = problem%scene%thin_layers
   if (problem%linear) return
   shear = [(problem%scene%tissue(k)%material%shear, k=1, size(shear))]
   thin = thin .and. maxval(shear) > most_ratio*minval(shear)
end function has_thin_layers

!> Gaps of the body that shape functions bridge
subroutine judge_gaps(self, cloud)
   type(verdict_type), intent(inout) :: self
   type(cloud_type), intent(in) :: cloud
   real(wp) :: share, place(3)

   call find_gaps(cloud, share, place)
   if (share < least_gaps) return
   call self%object(doubtful, to_text(100.0_wp*share, 2)//' % of the surface faces another part ' &
      & //'of the body (doubtful above '//to_text(100.0_wp*least_gaps, 2)//' %) across a gap ' &
      & //'narrower than 1.5 spacings of the source points, for example ' &
      & //'near '//to_text(place)//': the shape functions join the two parts; fill the gap with ' &
      & //'a material, or use finer points (build.source_stride, geometry.blocks)')
end subroutine judge_gaps

!> Places of output where the material has lost its ellipticity
subroutine judge_lost(self, problem, outcome)
   type(verdict_type), intent(inout) :: self
   class(discretisation_type), intent(in) :: problem
   type(outcome_type), intent(in) :: outcome
   type(ellipticity_type) :: worst
   logical, allocatable :: lost(:)
   character(len=:), allocatable :: found

   if (outcome%judged < size(outcome%load)) then
      call find_ellipticity(problem, outcome%peak, worst)
      allocate (lost, source=worst%lost)
   else
      allocate (lost, source=outcome%lost_last)
   end if
   call get_extent(problem, lost, found)
   found = outcome%lost//found
   ! a loss on the way may have led to another branch
   if (matters(problem, lost) .or. .not. any(lost)) then
      call self%object(doubtful, found//': the solution is not unique; reduce activation or ' &
         & //'load, let an end move, or stiffen the matrix; more points do not help')
   else
      self%reasons = self%reasons//'not counted, since it is small and far from the probes: ' &
         & //found//new_line('a')
   end if
end subroutine judge_lost

!> Whether bad places are a considerable part of the body, or near a probe
logical function matters(problem, bad)
   class(discretisation_type), intent(in) :: problem
   !> Places of output, shape (nc)
   logical, intent(in) :: bad(:)

   matters = share_of(problem, bad) > of_places .or. probe_near(problem, bad) > 0
end function matters

!> Share of the volume in bad places [-]
real(wp) function share_of(problem, bad) result(share)
   class(discretisation_type), intent(in) :: problem
   logical, intent(in) :: bad(:)

   associate (volume => problem%scene%cloud%volume)
      share = sum(volume, mask=bad)/sum(volume)
   end associate
end function share_of

!> A probe at a point near bad places, 0 where there is none
integer function probe_near(problem, bad) result(near)
   class(discretisation_type), intent(in) :: problem
   logical, intent(in) :: bad(:)
   integer :: i, ip

   near = 0
   associate (cloud => problem%scene%cloud, probe => problem%scene%probe)
      do i = 1, size(probe)
         if (.not. probe(i)%at_a_place()) cycle
         do ip = 1, size(bad)
            if (bad(ip) .and. norm2(probe(i)%point(:cloud%nd) - cloud%points(:, ip)) &
               & < near_spacings*cloud%mean_spacing()) near = i
            if (near == i) return
         end do
      end do
   end associate
end function probe_near

!> Share of bad places in the body, in words
subroutine get_extent(problem, bad, words)
   class(discretisation_type), intent(in) :: problem
   logical, intent(in) :: bad(:)
   character(len=:), allocatable, intent(out) :: words
   integer :: near

   words = ' (in '//to_text(100.0_wp*share_of(problem, bad), 2)//' % of the volume'
   near = probe_near(problem, bad)
   if (near > 0) words = words//', near probe '//problem%scene%probe(near)%name
   words = words//')'
end subroutine get_extent

!> Probes without a value, such as stresses at inverted places
subroutine judge_values(self, problem, outcome)
   type(verdict_type), intent(inout) :: self
   class(discretisation_type), intent(in) :: problem
   type(outcome_type), intent(inout) :: outcome
   character(len=:), allocatable :: reason
   integer :: i

   do i = 1, size(self%bars%change)
      if (all(ieee_is_finite(self%bars%values(:, i, :)))) cycle
      reason = 'probe '//problem%scene%probe(i)%name//' is not a finite number'
      outcome%warnings = outcome%warnings//reason//new_line('a')
      call self%object(refused, reason)
   end do
end subroutine judge_values

!> Judge the displacements as a whole, and the probe with the largest change
subroutine judge_probes(self, problem, lower, most, widest, from, outcome)
   type(verdict_type), intent(inout) :: self
   class(discretisation_type), intent(in) :: problem
   !> Change of each probe from where on the answer is doubtful, shape (probes) [-]
   real(wp), intent(in) :: lower(:)
   !> From where on it is refused [-]
   real(wp), intent(in) :: most
   !> Bar from where on it is doubtful, shape (probes)
   real(wp), intent(in) :: widest(:)
   !> Reference of all comparisons, to follow a difference in a sentence
   character(len=*), intent(in) :: from
   type(outcome_type), intent(inout) :: outcome
   type(verdict_type) :: found
   character(len=:), allocatable :: reference, rim, small
   real(wp), allocatable :: upper(:)
   real(wp) :: bar, limits(2)
   integer :: i, worst

   found%state = accepted
   found%reasons = ''
   small = ''
   limits = of_distance
   if (self%companion%kind == more_points) limits = [of_bar, of_finer]
   if (self%companion%kind == another_form) limits = of_forms
   if (self%companion%coarse) limits(2) = huge(1.0_wp)
   reference = from
   if (self%companion%tissue > 0) reference = reference//', most of it in ' &
      & //problem%scene%tissue(self%companion%tissue)%name
   call found%compare(self%companion%distance, limits, 'the displacements differ by # of their ' &
      & //'norm'//reference, curable=.true.)
   if (self%companion%distance > of_distance(2) .and. .not. (self%companion%coarse &
      & .or. self%companion%kind == another_form)) then
      ! the difference from another branch does not measure an error
      call withhold(self%bars)
      call found%object(refused, 'no error bars: a solution this different is on another branch')
   else
      associate (bars => self%bars, last => size(self%bars%load))
         allocate (upper(size(bars%change)))
         ! a probe that is small relative to its kind is no reason to refuse the rest
         upper = most*(bars%kind/max(bars%size, tiny(1.0_wp)))
         ! at the surface it may be the other form that is wrong
         if (self%companion%kind == another_form) where (bars%at_surface) upper = huge(1.0_wp)
         ! where the uncertainty due to voxels exceeds the limit, any change is too large
         worst = maxloc(merge(max(bars%change, least_change)/max(lower, least_change), -1.0_wp, &
            & bars%change >= 0.0_wp), dim=1)
         if (any(bars%change > upper)) worst = maxloc(bars%change, dim=1, mask=bars%change > upper)
         if (any(bars%change >= 0.0_wp)) then
            reference = from
            if (bars%source(worst) == 'J of the pressure') reference = ' from the value given ' &
               & //'by the pressure'
            if (bars%source(worst) == 'free surface') reference = ' from that without the ' &
               & //'traction on its free face'
            call describe_rim(problem, worst, rim)
            if (lower(worst) > 0.0_wp .or. bars%change(worst) > upper(worst)) then
               call found%compare(bars%change(worst), [lower(worst), upper(worst)], 'probe ' &
                  & //problem%scene%probe(worst)%name//' differs by # of its size'//reference &
                  & //rim, curable=len(rim) == 0)
            else
               ! components of one force leave it alike, also those that are zero by symmetry
               worst = maxloc(norm2(bars%values(:, :, last), dim=1), dim=1, &
                  & mask=bars%open >= bars%open(worst))
               call found%compare(bars%open(worst), [0.0_wp, huge(1.0_wp)], 'the surface of the ' &
                  & //'voxels leaves probe '//problem%scene%probe(worst)%name &
                  & //' uncertain by # of its size', curable=.true.)
            end if
         end if
         do i = 1, size(bars%change)
            if (ieee_is_nan(bars%change(i))) then
               call found%object(doubtful, 'probe '//problem%scene%probe(i)%name//' has no error ' &
                  & //'bar: its value'//from//' is not a finite number')
               cycle
            end if
            bar = maxval(bars%bars(:, i, last), mask=.not. ieee_is_nan(bars%bars(:, i, last)))
            if (found%state == accepted .and. bar > widest(i)) then
               call describe_rim(problem, i, rim)
               call found%compare(bar/max(bars%read(i), tiny(1.0_wp)), &
                  & [widest(i)/max(bars%read(i), tiny(1.0_wp)), huge(1.0_wp)], &
                  & 'the error bar of probe '//problem%scene%probe(i)%name//' is # of the ' &
                  & //'largest probe of its kind'//rim, curable=len(rim) == 0)
            else if (bar > max(of_small*bars%kind(i), norm2(bars%values(:, i, last)))) then
               small = small//', '//problem%scene%probe(i)%name
            end if
         end do
      end associate
   end if
   outcome%warnings = outcome%warnings//found%reasons
   self%reasons = self%reasons//found%reasons
   if (len(small) > 0) self%reasons = self%reasons//'smaller than the error bar, and so possibly ' &
      & //'zero: '//small(3:)//new_line('a')
   self%state = max(self%state, found%state)
   self%curable = self%curable .or. found%curable
end subroutine judge_probes

!> Remedy for a stress at the rim of a prescribed set, where stresses have no limit as points become
!> finer; blank for all other probes
subroutine describe_rim(problem, i, text)
   class(discretisation_type), intent(in) :: problem
   !> Probe
   integer, intent(in) :: i
   character(len=:), allocatable, intent(out) :: text
   integer :: of

   text = ''
   associate (scene => problem%scene, h => problem%scene%cloud%mean_spacing())
      if (.not. scene%probe(i)%at_a_place() &
         & .or. quantity_kind(scene%probe(i)%quantity) /= 'stress') return
      of = rim_near(problem, scene%probe(i)%point(:scene%cloud%nd), rim_spacings(1)*h)
      if (of > 0) text = ': it lies at the rim of '//trim(scene%cloud%set_names(of)) &
         & //', where the stress is singular; move it inside the body, at least ' &
         & //to_text(rim_spacings(2)*h, 2)//' '//scene%length_unit//' away from the rim'
   end associate
end subroutine describe_rim

!> Set whose rim lies within a distance of a place: its points are constrained in all components,
!> others of the surface are not; 0 where there is none
integer function rim_near(problem, place, distance) result(of)
   class(discretisation_type), intent(in) :: problem
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: place(:)
   !> Distance [length]
   real(wp), intent(in) :: distance
   integer :: e, k
   logical :: free

   of = 0
   free = .false.
   associate (cloud => problem%scene%cloud, condition => problem%scene%condition)
      do e = 1, size(cloud%boundary_point)
         if (norm2(place - cloud%points(:, cloud%boundary_point(e))) > distance) cycle
         do k = 1, size(condition)
            if (cloud%in_set(e, condition(k)%set) .and. all(condition(k)%fixed(:cloud%nd))) exit
         end do
         if (k <= size(condition)) then
            of = condition(k)%set
         else
            free = .true.
         end if
      end do
   end associate
   if (.not. free) of = 0
end function rim_near

!> Without a second solution: a note where none was requested or possible, a reason for doubt where
!> one failed
subroutine no_estimate(self, outcome)
   type(verdict_type), intent(inout) :: self
   type(outcome_type), intent(inout) :: outcome
   character(len=:), allocatable :: note

   note = 'no error estimate: '//self%companion%why_not
   if (self%companion%missed) then
      outcome%warnings = outcome%warnings//note//new_line('a')
      call self%object(doubtful, note)
   else
      self%reasons = self%reasons//note//new_line('a')
   end if
end subroutine no_estimate

!> Compare a measure with its bounds
subroutine compare(self, measure, bounds, what, curable)
   class(verdict_type), intent(inout) :: self
   !> Measure [-]
   real(wp), intent(in) :: measure
   !> From where on the answer is doubtful and refused [-]
   real(wp), intent(in) :: bounds(2)
   !> The sentence, with # for the measure
   character(len=*), intent(in) :: what
   !> Whether finer points or another form would remove the reason
   logical, intent(in), optional :: curable
   character(len=:), allocatable :: limit
   integer :: at
   logical :: beyond

   if (measure <= bounds(1)) return
   at = index(what, '#')
   beyond = measure > bounds(2) .or. ieee_is_nan(measure)
   limit = ''
   if (bounds(1) > 0.0_wp) limit = ' (doubtful above '//to_text(100.0_wp*bounds(1), 2)//' %)'
   if (beyond) limit = ' (refused above '//to_text(100.0_wp*bounds(2), 2)//' %)'
   call self%object(merge(refused, doubtful, beyond), &
      & what(:at - 1)//to_text(100.0_wp*measure, 2)//' %'//limit//what(at + 1:))
   if (present(curable)) self%curable = self%curable .or. curable
end subroutine compare

!> Add a reason
subroutine object(self, state, reason)
   class(verdict_type), intent(inout) :: self
   !> How bad it is
   integer, intent(in) :: state
   !> Why
   character(len=*), intent(in) :: reason

   self%state = max(self%state, state)
   self%reasons = self%reasons//reason//new_line('a')
end subroutine object

!> The reasons as one line
subroutine get_sentence(self, text)
   class(verdict_type), intent(in) :: self
   character(len=:), allocatable, intent(out) :: text
   integer :: i

   text = trim(verdict_names(self%state))
   if (self%state == accepted) text = text//' (numerical error only, not fibers or attachments)'
   if (len(self%reasons) == 0) return
   text = text//': '
   do i = 1, len(self%reasons) - 1
      if (self%reasons(i:i) == new_line('a')) then
         text = text//'; '
      else
         text = text//self%reasons(i:i)
      end if
   end do
end subroutine get_sentence

end module rk_verdict
