!> Load programmes: growth of prescribed values over load time, which runs from 0 to 1.
!>
!> A programme begins at rest, or loaded if amplitudes begin with values other than 0, usually at a
!> state of an earlier run. If there is no such state, the body is brought there from rest, by loads
!> from -1 to 0 over which these values grow.
!>
!> All prescribed values are linear in a few load factors, so that forms keep a column for each: the
!> ramp, which is the load itself; one for each amplitude; and two for each rotation by an angle
!> theta about a fixed axis n, since (R - I)d = sin(theta) n x d + (1 - cos(theta)) n x (n x d).
module rk_programme
   use rk_deck_records, only : amplitude_keys
   use rk_precision, only : wp
   use rk_sort, only : sort
   implicit none
   private

   public :: programme_type, rotation_type, plan_type, combined, ramp

   !> Number of the ramp among the factors, and of the default amplitude, which has no name
   integer, parameter :: ramp = 1, no_amplitude = 0
   !> Loads closer than this count as equal [-]
   real(wp), parameter :: same = 1.0e-9_wp
   !> Maximum rotation in one load step [rad]. A bar twisted by half a turn takes 48 iterations in
   !> steps of 15 degrees, 40 of 22, 24 of 45; of 60 degrees and more some fail and are halved
   real(wp), parameter :: largest_turn = 0.8_wp

   !> An angle that grows with an amplitude
   type :: rotation_type
      !> Amplitude, 0 for the ramp
      integer :: amplitude = no_amplitude
      !> Angle where the amplitude is 1 [rad]
      real(wp) :: angle = 0.0_wp
   end type rotation_type

   !> The programme of a scene
   type :: programme_type
      !> Functions of load time: between their knots linear, or smooth with zero slope and curvature
      !> at the knots; after the last knot constant
      type(amplitude_keys), allocatable :: amplitude(:)
      !> Rotations
      type(rotation_type), allocatable :: rotation(:)
   contains
      procedure :: count => count_factors, factors, value => value_at, sine_of, plan
      procedure :: begins_loaded
   end type programme_type

   !> Planned load steps
   type :: plan_type
      !> Whether the programme begins loaded
      logical :: loaded = .false.
      !> Largest single change of load on the way there from rest [-]
      real(wp) :: first_most = 1.0_wp
      !> Load at the end of each step, ascending, the last one 1, shape (n) [-]
      real(wp), allocatable :: load(:)
      !> Largest single change of load on the way there, shape (n) [-]
      real(wp), allocatable :: most(:)
      !> Whether rates jump at its end, so that the last step cannot be extrapolated to the next
      !> one, shape (n)
      logical, allocatable :: knot(:)
   end type plan_type

contains

pure integer function count_factors(self)
   class(programme_type), intent(in) :: self

   count_factors = self%sine_of(1) - 1 + 2*size(self%rotation)
end function count_factors

!> Number of the sine factor of a rotation
pure integer function sine_of(self, rotation)
   class(programme_type), intent(in) :: self
   integer, intent(in) :: rotation

   sine_of = ramp + size(self%amplitude) + 2*rotation - 1
end function sine_of

!> Factors at a load: the ramp, the amplitudes, sine and 1 - cos of the rotations
pure function factors(self, load) result(factor)
   class(programme_type), intent(in) :: self
   !> Load [-]
   real(wp), intent(in) :: load
   !> Factors, shape (count) [-]
   real(wp) :: factor(count_factors(self))
   real(wp) :: angle
   integer :: a, r

   factor(ramp) = max(load, 0.0_wp)
   do a = 1, size(self%amplitude)
      factor(ramp + a) = self%value(a, load)
   end do
   do r = 1, size(self%rotation)
      angle = self%rotation(r)%angle*self%value(self%rotation(r)%amplitude, load)
      factor(self%sine_of(r)) = sin(angle)
      ! 1 - cos without loss of digits
      factor(self%sine_of(r) + 1) = 2.0_wp*sin(0.5_wp*angle)**2
   end do
end function factors

!> Value of an amplitude, or of the ramp, at a load [-]
pure real(wp) function value_at(self, amplitude, load) result(value)
   class(programme_type), intent(in) :: self
   !> Amplitude, 0 for the ramp
   integer, intent(in) :: amplitude
   real(wp), intent(in) :: load
   real(wp) :: s
   integer :: k

   value = max(load, 0.0_wp)
   if (amplitude == no_amplitude) return
   associate (time => self%amplitude(amplitude)%time, values => self%amplitude(amplitude)%value)
      k = count(time <= load)
      value = values(max(k, 1))
      ! from rest to the beginning of the programme
      if (load < 0.0_wp) value = (1.0_wp + load)*value
      if (k == 0 .or. k == size(time)) return
      s = (load - time(k))/(time(k + 1) - time(k))
      if (self%amplitude(amplitude)%curve == 'smooth') s = s**3*(10.0_wp - s*(15.0_wp - 6.0_wp*s))
      value = value + s*(values(k + 1) - value)
   end associate
end function value_at

!> Load steps: equal ones and all knots of amplitudes. Steps with large rotations are divided
pure function plan(self, steps) result(planned)
   class(programme_type), intent(in) :: self
   !> Number of equal steps
   integer, intent(in) :: steps
   type(plan_type) :: planned
   integer, allocatable :: place(:)
   real(wp) :: before
   integer :: a, k

   allocate (planned%load, source=[(real(k, wp)/real(steps, wp), k=1, steps)])
   do a = 1, size(self%amplitude)
      associate (time => self%amplitude(a)%time)
         do k = 1, size(time)
            ! 0 is rest and not a step
            if (time(k) < same .or. any(abs(planned%load - time(k)) < same)) cycle
            planned%load = [planned%load, time(k)]
         end do
      end associate
   end do
   call sort(planned%load, place)
   planned%load(place) = [planned%load]
   allocate (planned%most(size(planned%load)), planned%knot(size(planned%load)))
   before = 0.0_wp
   do k = 1, size(planned%load)
      planned%most(k) = (planned%load(k) - before)/turns(self, before, planned%load(k))
      planned%knot(k) = is_knot(self, planned%load(k))
      before = planned%load(k)
   end do
   ! loads reached by halving this are exact
   if (self%count() == 1) planned%most = 1.0_wp/real(steps, wp)
   planned%loaded = self%begins_loaded()
   planned%first_most = 1.0_wp/turns(self, -1.0_wp, 0.0_wp)
end function plan

!> Whether the programme begins in a state other than rest
pure logical function begins_loaded(self) result(loaded)
   class(programme_type), intent(in) :: self
   integer :: a

   loaded = any([(abs(self%amplitude(a)%value(1)) > 0.0_wp, a=1, size(self%amplitude))])
end function begins_loaded

!> Whether the rate of an amplitude may jump at a load
pure logical function is_knot(self, load)
   class(programme_type), intent(in) :: self
   real(wp), intent(in) :: load
   integer :: a, k

   is_knot = .false.
   do a = 1, size(self%amplitude)
      associate (time => self%amplitude(a)%time)
         k = count(time <= load)
         is_knot = is_knot .or. any(abs(time(max(k, 1):min(k + 1, size(time))) - load) < same)
      end associate
   end do
end function is_knot

!> Number of parts into which a change of load is divided, so that rotations in each remain small
pure integer function turns(self, from, to)
   class(programme_type), intent(in) :: self
   !> Loads before and after [-]
   real(wp), intent(in) :: from, to
   real(wp) :: angle
   integer :: r

   turns = 1
   do r = 1, size(self%rotation)
      associate (rotation => self%rotation(r))
         angle = rotation%angle &
            & *(self%value(rotation%amplitude, to) - self%value(rotation%amplitude, from))
      end associate
      turns = max(turns, ceiling(abs(angle)/largest_turn))
   end do
end function turns

!> A value as the sum of its columns times the load factors
pure real(wp) function combined(column, factor)
   !> Part for each factor, shape (n)
   real(wp), intent(in) :: column(:)
   !> Load factors, shape (n) [-]
   real(wp), intent(in) :: factor(:)
   integer :: a

   combined = factor(ramp)*column(ramp)
   do a = ramp + 1, size(column)
      combined = combined + factor(a)*column(a)
   end do
end function combined

end module rk_programme
