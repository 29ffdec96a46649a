!> Whether an answer is accepted, doubtful or refused, for reasons that were computed.
!>
!> Each check measures something of the answer itself; none is a remark about a method. An answer is
!> refused where a check says that it is wrong, doubtful where one cannot exclude it.
module rk_verdict
   use, intrinsic :: ieee_arithmetic, only : ieee_is_nan
   use rk_bars, only : another_form, bars_by_other, bars_by_solution, bars_type, fewer_points, &
      & more_points, new_bars
   use rk_cloud, only : cloud_type
   use rk_companion, only : companion_type, solve_companion
   use rk_deck, only : deck_type
   use rk_discretisation, only : deformation, discretisation_type
   use rk_error, only : error_type
   use rk_precision, only : wp
   use rk_recorder, only : recorder_type
   use rk_run, only : outcome_type
   use rk_states, only : field_state
   use rk_tensor, only : determinant
   use rk_text, only : to_text
   implicit none
   private

   public :: verdict_type, judge, accepted, doubtful, refused, verdict_names

   !> Verdicts, the worse the larger
   integer, parameter :: accepted = 1, doubtful = 2, refused = 3
   !> Their names
   character(len=8), parameter :: verdict_names(3) = ['accepted', 'doubtful', 'refused ']

   !> Bounds from which on an answer is doubtful and refused [-]. Works: cantilevers that are 56 to
   !> 98 % off have 54 to 92 %, a block that locks 49 %, sheets, tubes and straight blocks at most
   !> 1.7 %
   real(wp), parameter :: of_works(2) = [0.02_wp, 0.10_wp]
   !> Where nothing moves against a force the works are small differences of large parts: an
   !> inclined block within 2 % has 5 %, those 20 to 35 % off have 19 to 24 %
   real(wp), parameter :: of_inner_works(2) = [0.10_wp, 0.30_wp]
   !> Forces on all boundary sets, of the largest of them
   real(wp), parameter :: of_balance(2) = [0.05_wp, 0.25_wp]
   !> Error bar of a probe from another cloud, of its size: from fewer points of a lattice bars are
   !> some times the error; from more points, or of voxels, they are not
   real(wp), parameter :: of_wide_bar = 0.10_wp, of_bar = 0.05_wp
   !> Change of a probe from fewer points and from more, which are nearer to the truth, that is too
   !> much for any answer; and change from another form
   real(wp), parameter :: of_change = 0.25_wp, of_finer = 0.125_wp
   real(wp), parameter :: of_forms(2) = [0.05_wp, 0.10_wp]
   !> Change of all displacements against fewer points, which a coarse companion has most of itself:
   !> inclined blocks 0.3, 0.9 and 1.8 % off are 8, 24 and 29 % away from theirs
   real(wp), parameter :: of_distance(2) = [0.25_wp, 0.50_wp]
   !> Error of a linear problem, whose solution is known
   real(wp), parameter :: of_error(2) = [0.05_wp, 0.25_wp]
   !> Share of the volume in which J leaves the J of the pressure, and by how much
   real(wp), parameter :: of_volume(2) = [0.05_wp, 0.25_wp], off_pressure = 0.1_wp

   !> Verdict with its reasons and the error bars
   type :: verdict_type
      !> accepted, doubtful or refused; 0 where nothing was judged
      integer :: state = 0
      !> Reasons, and notes on what was not checked, each with its line feed
      character(len=:), allocatable :: reasons
      !> Error bars; without values where the run ended early
      type(bars_type) :: bars
      !> Second solution
      type(companion_type) :: companion
   contains
      !> The reasons as one line
      procedure :: sentence
      !> Add a reason
      procedure, private :: object
      !> Compare a measure with its bounds
      procedure, private :: compare
   end type verdict_type

contains

!> Judge the answer of a run. What speaks against it joins the warnings of the run.
subroutine judge(self, problem, deck, model, with_companion, receiver, outcome)
   !> Verdict
   type(verdict_type), intent(out) :: self
   !> Full problem
   class(discretisation_type), intent(in) :: problem
   !> Its deck
   type(deck_type), intent(in) :: deck
   !> Points of the model file, where the deck wants one
   type(cloud_type), intent(in) :: model
   !> Whether a second solution may be computed
   logical, intent(in) :: with_companion
   !> Receiver of the caller, asked whether to stop
   class(recorder_type), target, intent(inout) :: receiver
   !> What the run found out
   type(outcome_type), intent(inout) :: outcome
   type(error_type), allocatable :: error

   self%state = accepted
   self%reasons = ''
   if (allocated(outcome%ended)) then
      ! which is a warning already
      self%state = refused
      self%reasons = outcome%ended//new_line('a')
      return
   end if
   if (problem%is_linear()) then
      call judge_norms(self, outcome)
   else
      call judge_works(self, problem, outcome)
      call self%compare(outcome%imbalance, of_balance, 'the forces on all boundary ' &
         & //'sets do not balance: # of the largest is left')
      if (problem%has_pressure()) call judge_volume(self, problem, outcome%peak)
      if (.not. outcome%min_j > 0.0_wp) call self%object(doubtful, 'the volume ratio falls to ' &
         & //to_text(outcome%min_j, 2)//': material is turned inside out in a place, as at the ' &
         & //'corner of a held face; what is measured near there means nothing, take more points ' &
         & //'there for the rest')
   end if
   outcome%warnings = outcome%warnings//self%reasons
   ! of which the run has warned on its way
   if (allocated(outcome%lost)) call self%object(doubtful, outcome%lost)
   call new_bars(self%bars, problem, outcome%load, outcome%x, error)
   if (allocated(error)) return
   if (allocated(outcome%norms)) then
      call bars_by_solution(self%bars, problem, outcome%last%load, error)
      call judge_probes(self, problem, spread(of_error(1), 1, size(self%bars%change)), &
         & of_error(2), ' from the known solution', outcome)
      return
   end if
   if (.not. with_companion) then
      self%companion%why_not = 'no second solution was wanted'
   else
      call solve_companion(self%companion, problem, outcome%load, outcome%x, deck, model, &
         & receiver)
   end if
   if (allocated(self%companion%why_not)) then
      call no_estimate(self, outcome)
      return
   end if
   call bars_by_other(self%bars, problem, self%companion%seen, merge(another_form, &
      & merge(more_points, fewer_points, self%companion%finer), self%companion%same_points), &
      & self%companion%difference)
   if (self%companion%same_points) then
      call judge_probes(self, problem, spread(of_forms(1), 1, size(self%bars%change)), &
         & of_forms(2), ' from method "'//self%companion%method//'" on the same points', outcome)
   else
      call judge_probes(self, problem, merge(of_wide_bar, of_bar, .not. self%companion%finer &
         & .and. allocated(problem%scene%cloud%lattice))/self%bars%factor, &
         & merge(of_finer, of_change, self%companion%finer), ' from the same with ' &
         & //self%companion%lattice//' points', outcome)
   end if
end subroutine judge

!> Error of a linear problem against its known solution
subroutine judge_norms(self, outcome)
   !> Verdict
   type(verdict_type), intent(inout) :: self
   !> What the run found out
   type(outcome_type), intent(in) :: outcome

   if (.not. allocated(outcome%norms)) return
   call self%compare(outcome%norms%l2/max(outcome%norms%l2_solution, tiny(1.0_wp)), of_error, &
      & 'the norm of the error is # of that of the known solution')
end subroutine judge_norms

!> Work of the stress against that of the forces, where the form does not keep it by construction
subroutine judge_works(self, problem, outcome)
   !> Verdict
   type(verdict_type), intent(inout) :: self
   !> Problem
   class(discretisation_type), intent(in) :: problem
   !> What the run found out
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
      & //'the forces: the state is off equilibrium, and displacements may be as far off')
end subroutine judge_works

!> Volume in which J is not that of the pressure, where the pressure is a field of its own
subroutine judge_volume(self, problem, state)
   !> Verdict
   type(verdict_type), intent(inout) :: self
   !> Problem with displacements and pressure
   class(discretisation_type), intent(in) :: problem
   !> State
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
   call self%compare(off/max(total, tiny(1.0_wp)), of_volume, 'in # of the volume J is ' &
      & //'more than '//to_text(off_pressure)//' away from what the pressure allows')
end subroutine judge_volume

!> Displacements as a whole, and the probe that is farthest off
subroutine judge_probes(self, problem, lower, most, from, outcome)
   !> Verdict with bars
   type(verdict_type), intent(inout) :: self
   !> Problem
   class(discretisation_type), intent(in) :: problem
   !> Change of each probe from where on the answer is doubtful, shape (probes) [-]
   real(wp), intent(in) :: lower(:)
   !> From where on it is refused [-]
   real(wp), intent(in) :: most
   !> What it is compared with
   character(len=*), intent(in) :: from
   !> What the run found out
   type(outcome_type), intent(inout) :: outcome
   type(verdict_type) :: found
   real(wp), allocatable :: upper(:)
   real(wp) :: limits(2)
   integer :: worst

   found%state = accepted
   found%reasons = ''
   limits = of_distance
   if (self%companion%same_points) limits = of_forms
   if (self%companion%finer) limits = [of_bar, of_finer]
   if (self%companion%coarse) limits(2) = huge(1.0_wp)
   call found%compare(self%companion%distance, limits, 'the displacements are # of ' &
      & //'their norm away'//from)
   associate (bars => self%bars)
      allocate (upper(size(bars%change)))
      ! what is small among its kind does not speak against the rest
      upper = most*bars%kind/max(bars%size, tiny(1.0_wp))
      ! at the surface the other form may be the one that is off
      if (self%companion%same_points) where (bars%at_surface) upper = huge(1.0_wp)
      if (self%companion%coarse) upper = huge(1.0_wp)
      worst = maxloc(bars%change/lower, dim=1)
      if (any(bars%change > upper)) worst = maxloc(bars%change, dim=1, mask=bars%change > upper)
      if (any(bars%change >= 0.0_wp)) call found%compare(bars%change(worst), &
         & [lower(worst), upper(worst)], 'probe '//problem%scene%probe(worst)%name &
         & //' is # of its size away'//from)
   end associate
   outcome%warnings = outcome%warnings//found%reasons
   self%reasons = self%reasons//found%reasons
   self%state = max(self%state, found%state)
end subroutine judge_probes

!> There is no second solution: a note where none was wanted or none is possible, a reason for doubt
!> where one failed
subroutine no_estimate(self, outcome)
   !> Verdict
   type(verdict_type), intent(inout) :: self
   !> What the run found out
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
subroutine compare(self, measure, bounds, what)
   !> Verdict
   class(verdict_type), intent(inout) :: self
   !> Measure [-]
   real(wp), intent(in) :: measure
   !> From where on the answer is doubtful and refused [-]
   real(wp), intent(in) :: bounds(2)
   !> The sentence, with # for the measure
   character(len=*), intent(in) :: what
   integer :: at

   if (measure <= bounds(1)) return
   at = index(what, '#')
   call self%object(merge(refused, doubtful, measure > bounds(2) .or. ieee_is_nan(measure)), &
      & what(:at - 1)//to_text(100.0_wp*measure, 2)//' %'//what(at + 1:))
end subroutine compare

!> Add a reason
subroutine object(self, state, reason)
   !> Verdict
   class(verdict_type), intent(inout) :: self
   !> How bad it is
   integer, intent(in) :: state
   !> Why
   character(len=*), intent(in) :: reason

   self%state = max(self%state, state)
   self%reasons = self%reasons//reason//new_line('a')
end subroutine object

!> The reasons as one line
pure function sentence(self) result(text)
   !> Verdict
   class(verdict_type), intent(in) :: self
   character(len=:), allocatable :: text
   integer :: i

   text = trim(verdict_names(self%state))
   if (len(self%reasons) == 0) return
   text = text//': '
   do i = 1, len(self%reasons) - 1
      if (self%reasons(i:i) == new_line('a')) then
         text = text//'; '
      else
         text = text//self%reasons(i:i)
      end if
   end do
end function sentence

end module rk_verdict
