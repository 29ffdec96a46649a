!> Error bars of probes: the possible error of each, and its size relative to the probe's kind.
!>
!> The size of a probe that vanishes by symmetry is no measure. Errors are therefore taken relative
!> to the size of a probe, but at least to a tenth of that of its kind: the largest displacement of
!> the body, the largest force on a boundary set, the mean norm of the stress over the volume; for
!> stresses inside to three tenths of that. A few singular places, such as corners of fixed faces
!> where J is nearly 0, may make that mean 1e8 times the stress elsewhere: it is limited to the
!> value that nine tenths of the volume stay below.
module rk_bars
   use, intrinsic :: ieee_arithmetic, only : ieee_is_finite, ieee_is_nan, ieee_quiet_nan, ieee_value
   use rk_cloud, only : cloud_type
   use rk_discretisation, only : discretisation_type, judged_state, small_strain
   use rk_error, only : error_type
   use rk_coefficients, only : coefficient_at
   use rk_precision, only : wp
   use rk_probes, only : quantity_kind, quantity, new_probes, place_state, &
      & probe_value, probes_type, quantity_size
   use rk_equation, only : solution_at
   use rk_lattice, only : lattice_coordinates, lattice_frame, place_at
   use rk_scene, only : probe_type, scene_type
   use rk_shape, only : shape_type
   use rk_sort, only : sort
   use rk_states, only : field_state, point_state
   use rk_tensor, only : cofactor
   use rk_voxel_shape, only : end_taper, surface_share
   implicit none
   private

   public :: bars_type, new_bars, bars_by_other, bars_by_solution, bars_by_earlier, printed
   public :: fewer_points, more_points, another_form, twice_fewer, share_of_kind
   public :: holds_part

   !> Second solution of the comparison: the same form on half as many cells in each direction, or
   !> on more, or another form, or both boundary methods on half as many
   integer, parameter :: fewer_points = 1, more_points = 2, another_form = 3, twice_fewer = 4

   !> Bar over the difference from fewer points, for displacements and forces, stresses inside and
   !> at the surface. Errors of order two are a third of it, of order one as large: those at the
   !> surface are nearer the latter; with singular edges displacements and forces are in between.
   !> Errors of stresses inside change sign from place to place: the difference is the root of the
   !> sum of squares, 4.1 times the error, and nineteen errors in twenty are below twice theirs
   real(wp), parameter :: factor_coarse = 0.7_wp, factor_inside = 0.5_wp, factor_surface = 1.0_wp
   !> Factor for displacements in 2D between two or more sets constrained in all directions, where
   !> errors vanish, if no load acts: 95 % of 84 errors of random decks are below .7 of the bars
   !> without it; in 3D free sides ripple, and in annuli free ends beside constrained walls
   real(wp), parameter :: factor_held = 0.7_wp
   !> Bar over the difference in annuli without rims with a basis of order two: displacements, and
   !> stresses inside, within two spacings of a wall and deeper. Errors are largest in the first two
   !> cells at a wall, with fewer points across twice that width. Of 250 random rings with exact
   !> solutions 95 % of 345 and 405 errors of displacements are below .20 and .08 of the difference,
   !> of 236 and 264 of stresses below .34 and .16; with one second solution or two they are alike
   real(wp), parameter :: near_length = 0.2_wp, deep_length = 0.1_wp
   real(wp), parameter :: near_stress = 0.3_wp, deep_stress = 0.2_wp
   !> Distance from a wall to the first place that is deeper, in spacings; less than two, so that
   !> places on the third point are [-]
   real(wp), parameter :: deep = 1.999_wp
   !> The same for all other quantities, and for stresses at the surface
   real(wp), parameter :: factor_polar = 0.3_wp, factor_polar_surface = 0.8_wp
   !> The same for nodal cells of voxels with their stepped surface: 48 of 63 bars contain the error
   real(wp), parameter :: factor_stairs = 2.0_wp
   !> The same for blocks of voxels; possible distance of the surface of the body from their faces,
   !> in voxels; and error of an end that is constrained over its whole slice, relative to the
   !> excess width of the slice. Of 178 bars of probes of random bodies 167 contained the error
   !> without the latter and with 0.05 of a voxel for displacements, 176 with both
   real(wp), parameter :: factor_blocks = 0.5_wp, off_surface = 0.08_wp, off_end = 0.2_wp
   !> Distance of the surface where displacements are prescribed on a curved wall, in voxels: of 42
   !> bars of rings of muscle on a bone of 4 to 13 voxels 37 contained the error with that above,
   !> and 40 with this one
   real(wp), parameter :: off_wall = 0.16_wp
   !> Factor for displacements and forces, in annuli without rims for forces and stresses at the
   !> surface, beside an answer that enforces displacements exactly, where both boundary methods are
   !> solved on fewer points and the one farther away counts: the softer one alone may agree by
   !> chance. 95 % of the errors of forces of random plane bodies are below 2.0 of its difference,
   !> and below .53 of the larger one, of solids below .81. By the order of the basis, which counts
   !> as one where a wall is constrained up to a free end
   real(wp), parameter :: factor_farther(2) = [0.7_wp, 0.5_wp]
   !> Factor there for displacements and stresses in 2D where loads act, with which errors at the
   !> supports accumulate over the body: 95 % of 28 errors of each are below 1.1 and 1.2 of the bars
   !> without it, in 3D below .5
   real(wp), parameter :: factor_loaded = 1.25_wp
   !> The same in annuli without rims, with either boundary method: of 687 errors of displacements
   !> and 628 of stresses of 48 random rings with tractions on a wall, on all lattices of their
   !> searches, 94 and 96 % are within the bars, with 1.25 only 84 and 90 %
   real(wp), parameter :: factor_loaded_polar = 2.0_wp
   !> Factor on that from more points, at the surface
   real(wp), parameter :: factor_outside = 1.5_wp
   !> From more points: errors of order two are 4/3 of the difference, those of order one twice
   real(wp), parameter :: factor_fine = 2.0_wp
   !> Factor where two materials meet: the interface lies at different places between the points of
   !> the two solutions, which may agree by chance. Where kinks represent planes, 95 of 102 bars of
   !> sheets with a target of 2 % contain the error without it. Likewise where part of a side is
   !> constrained, with a singular border; and where materials meet elsewhere, between Gauss points
   real(wp), parameter :: factor_layers = 2.0_wp, factor_between = 3.0_wp
   !> Error that the border of a part of a side leaves if displacements are prescribed there, of
   !> forces and of others, or if loads act there, of forces, relative to the spacing over the width
   !> of the part: it alternates with the position of the border in its cell, and two solutions
   !> agree by chance. Of 90 forces on random pads 63 bars contained the error without, 90 with it
   real(wp), parameter :: of_border(2) = [0.2_wp, 0.07_wp], of_load = 0.007_wp
   !> Collocation against the weak form: 94 % of 388, 2.0 times the error
   real(wp), parameter :: factor_forms = 2.0_wp
   !> Least bar, relative to the size and to the value, for a component to its vector or tensor, so
   !> that it does not depend on the axes: iterations leave errors of 4e-10 in forces, known values
   !> have six digits [-]
   real(wp), parameter :: least_share = 2.0e-6_wp
   !> Least size of a probe, and of a stress inside the body, relative to that of its kind [-]
   real(wp), parameter :: share_of_kind = 0.1_wp, share_inside = 0.3_wp
   !> Least size of forces, relative to the mean stress times the area of a set: without loads all
   !> forces balance to zero [-]
   real(wp), parameter :: share_balanced = 0.01_wp
   !> Least size at the end of a programme, relative to the largest on the way: where loads are
   !> removed again only the errors of iterations remain [-]
   real(wp), parameter :: share_of_peak = 1.0e-3_wp
   !> Part of the pressure that counts as shear stress where the size of displacements is estimated:
   !> those of a body under the same pressure all round are errors, if its volume is preserved [-]
   real(wp), parameter :: share_of_pressure = 0.1_wp
   !> Largest probe below which all of a kind count as zero, relative to the size of the kind [-]
   real(wp), parameter :: near_zero = 0.01_wp
   !> Sets of the ends of a quarter ring
   integer, parameter :: ends(2) = [3, 4]
   !> Share of the volume that is not singular: the mean stress of bodies without collapsed corners,
   !> also in bending or under a point load, is below the value that nine tenths stay below [-]
   real(wp), parameter :: ordinary = 0.9_wp

   !> Bars of all probes
   type :: bars_type
      !> Loads of a programme, whose bars are not proportional to them, or times of a motion; for a
      !> ramp the full load, shape (n)
      real(wp), allocatable :: load(:)
      !> Values and bars there, the last ones at full load; bars are NaN where there are none, shape
      !> (3, probes, n)
      real(wp), allocatable :: values(:, :, :), bars(:, :, :)
      !> Largest difference from another solution, relative to the size; NaN where there is none,
      !> shape (probes) [-]
      real(wp), allocatable :: change(:)
      !> Bar over difference of each probe, shape (probes) [-]
      real(wp), allocatable :: factor(:)
      !> Norm of the vector or tensor of each probe at these loads, shape (probes, n)
      real(wp), allocatable :: whole(:, :)
      !> Difference of a J from that of the pressure at these loads, of a stress on a free wall from
      !> that without its traction, and of tractions beside an interface; 0 for all others, shape
      !> (probes, n)
      real(wp), allocatable :: apart(:, :)
      !> Size of displacements as a kind at these loads: the shear strain that the stress would
      !> cause in a free body, times the size of the body; 0 in linear problems, shape (n) [length]
      real(wp), allocatable :: strained(:)
      !> Size at full load, at least a tenth of that of its kind, three tenths for stresses inside,
      !> shape (probes)
      real(wp), allocatable :: size(:)
      !> The same with a tenth for stresses inside too, the largest of a programme, shape (probes)
      real(wp), allocatable :: small(:)
      !> Size at full load, at least that of its kind, shape (probes)
      real(wp), allocatable :: kind(:)
      !> Size that a reader compares it with: the largest probe of its kind at these loads, unless
      !> that is near zero for its kind, as where all vanish by symmetry, shape (probes)
      real(wp), allocatable :: read(:)
      !> Largest size at these loads, shape (probes)
      real(wp), allocatable :: peak(:)
      !> The loads are removed at the end, whose state says nothing about the answer
      logical :: taken_off = .false.
      !> A motion: quantities that pass through zero are measured by their amplitude, and bars are
      !> the largest so far, as two solutions out of phase agree now and then
      logical :: moves = .false.
      !> Stresses at the surface, shape (probes)
      logical, allocatable :: at_surface(:)
      !> No points around a probe could show that two solutions agree by chance, shape (probes)
      logical, allocatable :: alone(:)
      !> Stresses in 2D, whose errors change sign from place to place, shape (probes). The same
      !> comparison in 3D would take 1.5 times the time
      logical, allocatable :: swings(:)
      !> Part of each bar due to the resolution of the voxels, whatever the points, over the size,
      !> shape (probes) [-]
      real(wp), allocatable :: open(:)
      !> Main part of each bar at full load: "other points", "other form", "points around",
      !> "voxels", "border" of a set, "J of the pressure", "free surface", "known solution",
      !> "interface", "least share", "earlier points" of a search; blank where there is none, and
      !> that of `apart`, shape (probes)
      character(len=17), allocatable :: source(:), source_apart(:)
   contains
      procedure :: at, unresolved
   end type bars_type

contains

!> Values at full load, or of a programme, and sizes of their kinds; bars are set later, by
!> comparisons
subroutine new_bars(self, problem, load, x, error)
   type(bars_type), intent(out) :: self
   class(discretisation_type), intent(in) :: problem
   !> Loads of the states, ascending, shape (m) [-]
   real(wp), intent(in) :: load(:)
   !> Unknowns of the states, shape (n, m)
   real(wp), contiguous, intent(in) :: x(:, :)
   !> Error handling: a probe outside the body
   type(error_type), allocatable, intent(out) :: error
   type(probes_type) :: probes
   type(field_state) :: state
   real(wp) :: peak(size(problem%scene%probe))
   integer :: i, k, n

   n = size(problem%scene%probe)
   self%load = load
   allocate (self%values(3, n, size(load)), self%bars(3, n, size(load)))
   allocate (self%whole(n, size(load)), self%apart(n, size(load)), self%strained(size(load)))
   allocate (self%change(n), self%at_surface(n))
   allocate (self%size(n), self%small(n), self%kind(n), self%peak(n), self%open(n), source=0.0_wp)
   peak = 0.0_wp
   allocate (self%factor(n), source=1.0_wp)
   allocate (self%source(n), self%source_apart(n))
   self%source_apart = 'J of the pressure'
   self%source = ''
   self%bars = ieee_value(1.0_wp, ieee_quiet_nan)
   self%change = ieee_value(1.0_wp, ieee_quiet_nan)
   self%at_surface = .false.
   allocate (self%alone(n), source=.true.)
   allocate (self%swings(n), source=.false.)
   call new_probes(probes, problem%scene, error)
   if (allocated(error)) return
   do k = 1, size(load)
      call problem%state(x(:, k), load(k), state)
      call look_at(self, problem, probes, state, self%values(:, :, k), self%whole(:, k), &
         & self%apart(:, k), self%strained(k))
      self%peak = max(self%peak, self%size)
      peak = max(peak, self%kind)
   end do
   self%taken_off = judged_state(problem, x) < size(load)
   ! the end is judged by its own size, whatever the way there
   self%size = max(self%size, share_of_peak*self%peak)
   self%kind = max(self%kind, share_of_peak*peak)
   self%moves = allocated(problem%scene%motion)
   if (self%moves) then
      self%size = self%peak
      self%kind = peak
   end if
   associate (probe => problem%scene%probe)
      self%read = [(maxval(norm2(self%values, dim=1), mask=spread([(quantity_kind( &
         & probe(i)%quantity) == quantity_kind(probe(k)%quantity), i=1, n)], 2, size(load))), &
         & k=1, n)]
   end associate
   where (self%read < near_zero*self%kind) self%read = max(self%size, self%peak)
end subroutine new_bars

!> Values and sizes of a state
subroutine look_at(self, problem, probes, state, value, whole, apart, strained)
   type(bars_type), intent(inout) :: self
   class(discretisation_type), intent(in) :: problem
   type(probes_type), intent(in) :: probes
   type(field_state), intent(in) :: state
   !> Values, shape (3, probes)
   real(wp), intent(out) :: value(:, :)
   !> Norms of the vectors or tensors that they are components of, shape (probes)
   real(wp), intent(out) :: whole(:)
   !> Differences from other evaluations of the same displacements, shape (probes)
   real(wp), intent(out) :: apart(:)
   !> Displacement that the stress would cause in a free body [length]
   real(wp), intent(out) :: strained
   type(point_state) :: local
   real(wp), dimension(size(problem%scene%cloud%points, 2)) :: stresses, strains
   real(wp) :: area, displacement, stress, force, share, own, kind, least
   integer :: e, i, set

   displacement = 0.0_wp
   force = 0.0_wp
   associate (scene => problem%scene)
      do i = 1, size(stresses)
         call problem%at_point(state, i, local)
         stresses(i) = norm2(local%cauchy)
         ! no more than a body can be sheared
         strains(i) = min(shear_strain(scene, i, local%cauchy), 1.0_wp)
         displacement = max(displacement, norm2(local%u))
      end do
      least = problem%negligible_stress(state)
      stress = max(size_of(stresses, scene%cloud%volume), least)
      strained = size_of(strains, scene%cloud%volume)*sum(scene%cloud%volume) &
         & **(1.0_wp/scene%cloud%nd)
      do set = 1, size(scene%cloud%set_names)
         if (problem%fields < scene%cloud%nd) exit
         if (.not. (any(scene%condition%set == set) .or. any(scene%probe%set == set))) cycle
         area = sum(scene%cloud%area, mask=[(scene%cloud%in_set(e, set), &
            & e=1, size(scene%cloud%area))])
         force = max(force, norm2(problem%set_force(set, state, 1.0_wp)), &
            & max(share_balanced*stress, least)*area)
      end do
      do i = 1, size(value, 2)
         call probe_value(problem, probes, i, state, value(:, i), whole(i), apart(i))
         share = share_of_kind
         select case (quantity_kind(scene%probe(i)%quantity))
         case ('force')
            kind = force
         case ('torque')
            ! the arm of a couple on a whole end of the body
            kind = 0.5_wp*force*norm2(maxval(scene%cloud%points, dim=2) &
               & - minval(scene%cloud%points, dim=2))
         case ('length')
            kind = max(displacement, share_of_kind*strained)
         case ('ratio')
            kind = 1.0_wp
         case ('energy', 'angle')
            ! no other quantity is of their kind
            kind = 0.0_wp
         case default
            kind = stress
            self%swings(i) = scene%cloud%nd < 3
            ! in a model that of its tissue: a soft one carries little beside a stiff one
            associate (of => scene%tissue_of)
               if (allocated(scene%cloud%block)) kind = size_of(pack(stresses, of == of(probes &
                  & %nearest(i))), pack(scene%cloud%volume, of == of(probes%nearest(i))))
            end associate
            self%at_surface(i) = on_surface(scene%cloud, scene%probe(i)%point)
            if (.not. self%at_surface(i)) share = share_inside
            if (self%at_surface(i) .and. scene%cloud%polar .and. .not. problem%linear) then
               call place_state(problem, probes, i, state, local)
               apart(i) = off_free(problem, i, local)
               self%source_apart(i) = 'free surface'
            end if
            if (allocated(scene%approximation%kink) .and. problem%fields == scene%cloud%nd) then
               own = off_interface(problem, probes, i, state)
               if (own > apart(i)) self%source_apart(i) = 'interface'
               apart(i) = max(apart(i), own)
            end if
         end select
         own = norm2(value(:quantity_size(scene%probe(i)%quantity), i))
         ! the errors of a stepped surface mix the components
         if (allocated(scene%cloud%block)) own = max(own, whole(i))
         self%kind(i) = max(kind, own)
         self%size(i) = max(share*kind, own)
         self%small(i) = max(self%small(i), share_of_kind*kind, own)
      end do
   end associate
end subroutine look_at

!> Shear strain due to a stress alone, with the shear modulus at rest, 0 in a linear problem; a
!> pressure causes none, and may take any value where the volume is preserved, but its errors do [-]
pure real(wp) function shear_strain(scene, place, cauchy)
   type(scene_type), intent(in) :: scene
   !> Place of output
   integer, intent(in) :: place
   !> Stress there [stress]
   real(wp), intent(in) :: cauchy(3, 3)
   real(wp) :: deviator(3, 3)
   integer :: d

   shear_strain = 0.0_wp
   if (allocated(scene%equation%problem)) return
   deviator = cauchy
   do d = 1, 3
      deviator(d, d) = cauchy(d, d) - (cauchy(1, 1) + cauchy(2, 2) + cauchy(3, 3))/3.0_wp
   end do
   associate (shear => scene%tissue(scene%tissue_of(place))%material%shear)
      if (shear > 0.0_wp) shear_strain = max(norm2(deviator), share_of_pressure*norm2(cauchy)) &
         & /(2.0_wp*shear)
   end associate
end function shear_strain

!> Mean of a norm over the volume where it is finite, at most the value `ordinary` of that is below
pure real(wp) function size_of(norm, volume)
   !> Norm at each place, shape (nc)
   real(wp), intent(in) :: norm(:)
   !> Their volumes, shape (nc) [length^nd]
   real(wp), intent(in) :: volume(:)
   real(wp), allocatable :: value(:), weight(:)
   integer, allocatable :: place(:), order(:)
   real(wp) :: below, total
   integer :: i

   size_of = 0.0_wp
   ! at singular corners J may be zero or less
   value = pack(norm, ieee_is_finite(norm))
   weight = pack(volume, ieee_is_finite(norm))
   call sort(value, place)
   allocate (order(size(place)))
   order(place) = [(i, i=1, size(place))]
   below = 0.0_wp
   total = sum(weight)
   do i = 1, size(order)
      below = below + weight(order(i))
      size_of = value(order(i))
      if (below >= ordinary*total) exit
   end do
   size_of = min(size_of, sum(weight*value)/max(total, tiny(1.0_wp)))
end function size_of

!> Bars from a second solution
subroutine bars_by_other(self, problem, other, kind, around)
   type(bars_type), intent(inout) :: self
   class(discretisation_type), intent(in) :: problem
   !> Values of the second solution
   type(bars_type), intent(in) :: other
   !> fewer_points, more_points, another_form or twice_fewer
   integer, intent(in) :: kind
   !> Its difference around each probe at the same loads, negative where it is not known,
   !> shape (3, probes, loads)
   real(wp), intent(in) :: around(:, :, :)
   real(wp) :: border, left, loaded_border, open
   real(wp) :: beside(3, size(self%load))
   logical :: blocks, farther, held, inside, length, loaded, rim, singular, smooth, wall
   integer :: i, order

   blocks = allocated(problem%scene%cloud%block) .and. kind /= another_form
   if (blocks) open = merge(off_wall, off_surface, holds_wall(problem%scene)) &
      & *surface_share(problem%scene%cloud) + off_end*taper_of(problem%scene)
   border = 0.0_wp
   loaded_border = 0.0_wp
   if (allocated(problem%scene%cloud%lattice)) then
      border = border_share(problem%scene, prescribed=.true.)
      loaded_border = border_share(problem%scene, prescribed=.false.)
   end if
   singular = problem%mixture%meets() .or. problem%scene%jumps .or. holds_part(problem%scene) &
      & .or. allocated(problem%scene%approximation%kink) .or. problem%mixture%activation_jumps()
   call find_supports(problem%scene, held, loaded)
   ! errors where materials or conditions meet do not vanish at the sides
   held = held .and. .not. singular .and. problem%scene%cloud%nd == 2
   order = min(2, problem%scene%approximation%order)
   smooth = .false.
   wall = .false.
   if (problem%scene%cloud%polar) then
      call find_rims(problem%scene, rim, wall)
      ! at the ends of a loaded part displacements converge like the spacing: 20 of 36 there lay
      ! outside .3 of the difference, 2 of 72 lie outside 1.4 of that which includes points around
      singular = singular .or. loaded_border > 0.0_wp
      smooth = problem%scene%approximation%order == 2 .and. .not. (rim .or. loaded_border > 0.0_wp)
      if (wall) order = 1
   end if
   do i = 1, size(self%change)
      associate (quantity => problem%scene%probe(i)%quantity, factor => self%factor(i))
         left = of_border(2)*border
         if (quantity_kind(quantity) == 'force') left = max(of_border(1)*border, &
            & of_load*loaded_border)
         factor = factor_of(smooth, problem%scene, i, self%at_surface(i))
         length = quantity_kind(quantity) == 'length'
         if (length .and. held .and. .not. wall) factor = factor_held*factor
         beside = around(:, i, :)
         if (kind == another_form) beside = -1.0_wp
         if (.not. allocated(problem%scene%cloud%lattice)) factor = factor_stairs
         if (blocks) then
            factor = factor_blocks
            ! others are of the order of one, or without a size
            if (all(['ratio', 'angle'] /= quantity_kind(quantity))) left = open
         end if
         farther = kind == twice_fewer .and. problem%scene%galerkin%essential == 'transformation'
         inside = smooth .and. (length .or. self%swings(i) .and. .not. self%at_surface(i))
         if (farther .and. .not. inside .and. (smooth .or. quantity_kind(quantity) /= 'stress' &
            & .and. .not. (wall .and. length))) factor = factor_farther(order)*factor
         if (loaded .and. (length .or. self%swings(i)) .and. problem%scene%cloud%nd == 2) then
            if (farther .and. .not. smooth) factor = factor_loaded*factor
            if (kind == twice_fewer .and. smooth) factor = factor_loaded_polar*factor
         end if
         if (kind == more_points) factor = factor_fine
         if (kind == more_points .and. self%at_surface(i)) factor = factor_outside*factor
         if (singular) factor = merge(factor_between, factor_layers, problem%mixture%meets())*factor
         if (kind == another_form) then
            factor = factor_forms
            self%size(i) = max(self%size(i), other%size(i))
            self%kind(i) = max(self%kind(i), other%kind(i))
         end if
         call set_bar(self, i, quantity_size(quantity), other%values(:, i, :), beside, left, &
            & merge('other form  ', 'other points', kind == another_form), merge('voxels', &
            & 'border', blocks))
      end associate
   end do
end subroutine bars_by_other

!> Whether displacements are prescribed on a part of a side; a set may be a whole side
pure logical function holds_part(scene)
   type(scene_type), intent(in) :: scene

   holds_part = border_share(scene, prescribed=.true.) > 0.0_wp
end function holds_part

!> Whether displacements are prescribed on the curved surface of a model, or a part of it
pure logical function holds_wall(scene)
   type(scene_type), intent(in) :: scene
   integer :: k, side

   holds_wall = .false.
   do k = 1, size(scene%condition)
      if (.not. any(scene%condition(k)%prescribes())) cycle
      do side = 1, scene%cloud%sides()
         if (scene%cloud%is_wall(side)) holds_wall = holds_wall &
            & .or. scene%cloud%meets_side(scene%condition(k)%set, side)
      end do
   end do
end function holds_wall

!> Spacing of the source points over the width of the smallest part of a side with conditions, 0
!> where there is none [-]
pure real(wp) function border_share(scene, prescribed)
   type(scene_type), intent(in) :: scene
   !> Displacements are prescribed there; otherwise loads act
   logical, intent(in) :: prescribed
   logical :: inside(size(scene%cloud%boundary_set))
   integer :: e, k, side

   border_share = 0.0_wp
   associate (cloud => scene%cloud, condition => scene%condition)
      do k = 1, size(condition)
         if (condition(k)%set <= cloud%sides()) cycle
         if (any(condition(k)%fixed) .neqv. prescribed) cycle
         inside = cloud%in_set([(e, e=1, size(inside))], condition(k)%set)
         do side = 1, cloud%sides()
            associate (here => cloud%boundary_set == side)
               if (.not. (any(inside .and. here) .and. any(here .and. .not. inside))) cycle
               border_share = max(border_share, cloud%mean_spacing()/max(sum(cloud%area, &
                  & mask=inside .and. here)**(1.0_wp/(cloud%nd - 1)), tiny(1.0_wp)))
            end associate
         end do
      end do
   end associate
end function border_share

!> Where a set constrained in all directions meets an unconstrained face: the stress is singular
!> there, and convergence is slower than the order of the basis
subroutine find_rims(scene, rim, wall)
   type(scene_type), intent(in) :: scene
   !> There are such rims
   logical, intent(out) :: rim
   !> Also on sets other than the ends of an annulus
   logical, intent(out) :: wall
   logical, dimension(size(scene%cloud%points, 2)) :: end_held, free, wall_held
   logical, dimension(size(scene%condition)) :: here, holds
   logical :: at_end
   integer :: e, k

   end_held = .false.
   wall_held = .false.
   free = .false.
   associate (cloud => scene%cloud, condition => scene%condition)
      do e = 1, size(cloud%boundary_point)
         here = [(cloud%in_set(e, condition(k)%set), k=1, size(here))]
         holds = here .and. [(all(condition(k)%fixed(:cloud%nd)), k=1, size(here))]
         at_end = any(cloud%boundary_set(e) == ends)
         associate (ip => cloud%boundary_point(e))
            end_held(ip) = end_held(ip) .or. any(holds) .and. at_end
            wall_held(ip) = wall_held(ip) .or. any(holds) .and. .not. at_end
            if (.not. any(here .and. [(any(condition(k)%fixed) .or. condition(k)%is_radial, &
               & k=1, size(here))])) free(ip) = .true.
         end associate
      end do
   end associate
   rim = any((end_held .or. wall_held) .and. free)
   wall = any(wall_held .and. free)
end subroutine find_rims

!> Supports of the body and loads on it
pure subroutine find_supports(scene, held, loaded)
   type(scene_type), intent(in) :: scene
   !> All conditions constrain all directions, there are two or more, and no force acts
   logical, intent(out) :: held
   !> Forces act on the body
   logical, intent(out) :: loaded
   integer :: k

   ! the effect of a source in a linear problem is not known
   held = size(scene%condition) > 1 .and. .not. allocated(scene%equation%problem)
   loaded = allocated(scene%body_force)
   do k = 1, size(scene%condition)
      associate (condition => scene%condition(k))
         held = held .and. all(condition%fixed(:scene%cloud%nd))
         loaded = loaded .or. any(condition%traction%acts()) .or. abs(condition%pressure) > 0.0_wp &
            & .or. abs(condition%pull) > 0.0_wp
      end associate
   end do
   held = held .and. .not. loaded
end subroutine find_supports

!> Bar over the difference from fewer points of a probe on a lattice [-]
real(wp) function factor_of(smooth, scene, i, at_surface) result(factor)
   !> Basis of order two in an annulus without rims
   logical, intent(in) :: smooth
   type(scene_type), intent(in) :: scene
   !> Number of the probe
   integer, intent(in) :: i
   !> A stress at the surface
   logical, intent(in) :: at_surface
   logical :: near

   near = .false.
   if (smooth) near = near_wall(scene%cloud, scene%probe(i))
   associate (kind => quantity_kind(scene%probe(i)%quantity))
      if (at_surface) then
         factor = merge(factor_polar_surface, factor_surface, smooth)
      else if (kind == 'stress') then
         factor = factor_inside
         if (smooth) factor = merge(near_stress, deep_stress, near)
      else
         factor = merge(factor_polar, factor_coarse, smooth)
         if (smooth .and. kind == 'length') factor = merge(near_length, deep_length, near)
      end if
   end associate
end function factor_of

!> Whether a probe of an annulus is within two spacings of its walls, or of a set on them
logical function near_wall(cloud, probe)
   type(cloud_type), intent(in) :: cloud
   type(probe_type), intent(in) :: probe
   real(wp) :: low(3), step(3)

   near_wall = probe%set > 0
   if (near_wall) return
   call lattice_frame(cloud, low, step)
   associate (depth => (norm2(probe%point(:2)) - low(1))/step(1))
      near_wall = min(depth, cloud%lattice(1) - 1 - depth) < deep
   end associate
end function near_wall

!> How much narrower the ends of a voxel body with conditions are than their slices [-]
pure real(wp) function taper_of(scene) result(most)
   type(scene_type), intent(in) :: scene
   character(len=*), parameter :: names(2, 2) = reshape([character(len=6) :: 'bottom', 'z0', &
      & 'top', 'z1'], [2, 2])
   real(wp) :: taper(2)
   integer :: end, k, set

   taper = end_taper(scene%cloud)
   most = 0.0_wp
   do end = 1, 2
      do k = 1, 2
         set = scene%cloud%find_set(trim(names(k, end)))
         if (set > 0 .and. any(scene%condition%set == set)) most = max(most, taper(end))
      end do
   end do
end function taper_of

!> Bars from the known solution of a linear problem; forces by its stress at the boundary points
subroutine bars_by_solution(self, problem, error)
   type(bars_type), intent(inout) :: self
   !> Linear problem
   class(discretisation_type), intent(in) :: problem
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(inout) :: error
   type(point_state) :: local
   real(wp) :: pair(2)
   real(wp) :: exact(3, size(self%load)), u(problem%fields, problem%shape%nq)
   integer :: e, i, k, nd

   nd = problem%scene%cloud%nd
   exact = 0.0_wp
   associate (cloud => problem%scene%cloud)
      do i = 1, size(self%change)
         associate (probe => problem%scene%probe(i))
            do k = 1, size(self%load)
               if (probe%set == 0) then
                  call exact_state(probe%point(:nd))
                  exact(:, k) = quantity(probe%quantity, local)
                  cycle
               end if
               exact(:, k) = 0.0_wp
               do e = 1, size(cloud%boundary_point)
                  if (.not. cloud%in_set(e, probe%set)) cycle
                  call exact_state(cloud%points(:, cloud%boundary_point(e)))
                  exact(:nd, k) = exact(:nd, k) + matmul(local%p(:nd, :nd), cloud%normal(:, e)) &
                     & *cloud%area(e)
               end do
               if (probe%quantity /= 'force') &
                  & exact(1, k) = exact(index('xyz', probe%quantity(7:7)), k)
            end do
            call set_bar(self, i, quantity_size(probe%quantity), exact, &
               & 0.0_wp*exact - 1.0_wp, 0.0_wp, 'known solution', '')
         end associate
      end do
   end associate

contains

   !> Known state at a place
   subroutine exact_state(place)
      !> Place, shape (nd) [length]
      real(wp), intent(in) :: place(:)

      call solution_at(problem%scene%equation, place, self%load(k), u, error)
      call coefficient_at(problem%scene%equation, place, pair, error)
      call small_strain(problem%scene%equation, pair, place, u, local)
   end subroutine exact_state

end subroutine bars_by_solution

!> Bars of one probe from other values of it
subroutine set_bar(self, i, n, other, around, left, from, left_from)
   type(bars_type), intent(inout) :: self
   !> Probe
   integer, intent(in) :: i
   !> Number of its components
   integer, intent(in) :: n
   !> The other values at the same loads, shape (3, loads)
   real(wp), intent(in) :: other(:, :)
   !> Root mean square of the difference around the probe, negative where it is not known, shape
   !> (3, loads)
   real(wp), intent(in) :: around(:, :)
   !> Share of the value, for a component of its vector or tensor, that stays uncertain [-]
   real(wp), intent(in) :: left
   !> Source of the other values, and why that share stays uncertain
   character(len=*), intent(in) :: from, left_from
   real(wp) :: difference(n, size(self%load))
   integer :: k, last

   self%bars(:, i, :) = ieee_value(1.0_wp, ieee_quiet_nan)
   self%change(i) = self%bars(1, i, 1)
   if (.not. all(ieee_is_finite(self%values(:n, i, :) - other(:n, :)))) return
   difference = abs(self%values(:n, i, :) - other(:n, :))
   last = size(self%load)
   self%source(i) = from
   if (maxval(around(:n, last)) > maxval(difference(:, last))) self%source(i) = 'points around'
   ! two clouds agree by chance where their difference changes sign; points around one at the
   ! surface are mostly inside, where stresses are more accurate
   if (self%swings(i)) then
      difference = max(difference, around(:n, :))
   else
      where (around(:n, :) >= 0.0_wp .and. .not. (self%at_surface(i) .and. around(:n, :) &
         & < difference)) difference = sqrt(0.5_wp*(difference**2 + around(:n, :)**2))
   end if
   self%alone(i) = any(around(:n, last) < 0.0_wp)
   do k = 1, size(self%load)
      if (self%moves) difference(:, k) = maxval(difference(:, :k), dim=2)
      self%bars(:n, i, k) = max(self%factor(i)*difference(:, k) &
         & + left*self%whole(i, k), self%apart(i, k), least(self, i, self%whole(i, k)))
   end do
   if (left*self%whole(i, last) > self%factor(i)*maxval(difference(:, last))) &
      & self%source(i) = left_from
   if (maxval(self%bars(:n, i, last)) <= self%apart(i, last)) self%source(i) &
      & = self%source_apart(i)
   if (maxval(self%bars(:n, i, last)) <= least(self, i, self%whole(i, last))) &
      & self%source(i) = 'least share'
   self%change(i) = max(maxval(difference(:, last)), self%apart(i, last)) &
      & /max(self%size(i), tiny(1.0_wp))
   if (self%taken_off) self%change(i) = max(self%change(i), &
      & maxval(difference)/max(self%size(i), self%peak(i), tiny(1.0_wp)))
   if (left_from == 'voxels') self%open(i) = left*self%whole(i, last) &
      & /max(self%size(i), tiny(1.0_wp))
end subroutine set_bar

!> Bars of a search. Where the answer has moved outside its bars on fewer points, they are widened
!> by the same factor, up to the whole change. Where no points around a probe could show agreement
!> by chance, and in 3D, they are at least those on fewer points over the squared ratio of cells
subroutine bars_by_earlier(self, solid, earlier, growth)
   type(bars_type), intent(inout) :: self
   !> Whether the body is 3D
   logical, intent(in) :: solid
   !> Bars of the answer on fewer points, at the same loads
   type(bars_type), intent(in) :: earlier
   !> Ratio of cells to those then in one direction, the largest of all directions [-]
   real(wp), intent(in) :: growth
   real(wp) :: least(3, size(self%load)), moved(3, size(self%load))
   integer :: i, last

   last = size(self%load)
   if (last /= size(earlier%load)) return
   do i = 1, size(self%change)
      if (ieee_is_nan(self%bars(1, i, last)) .or. ieee_is_nan(earlier%bars(1, i, last))) cycle
      moved = abs(self%values(:, i, :) - earlier%values(:, i, :))
      least = min(moved, self%bars(:, i, :)*moved/max(earlier%bars(:, i, :), tiny(1.0_wp)))
      if (solid .or. self%alone(i)) least = max(least, earlier%bars(:, i, :)/growth**2)
      if (any(least(:, last) > self%bars(:, i, last))) self%source(i) = 'earlier points'
      ! a probe has no bars beyond its components
      where (self%bars(:, i, :) < least) self%bars(:, i, :) = least
   end do
end subroutine bars_by_earlier

!> Least bar of a probe
pure real(wp) function least(self, i, whole)
   type(bars_type), intent(in) :: self
   !> Probe
   integer, intent(in) :: i
   !> Norm of the vector or tensor that it is a component of
   real(wp), intent(in) :: whole

   least = least_share*max(whole, self%size(i))
end function least

!> Bars of a probe at a load: for a ramp those of full load in proportion to it
pure function at(self, i, load, value) result(bar)
   class(bars_type), intent(in) :: self
   !> Probe
   integer, intent(in) :: i
   !> Load [-]
   real(wp), intent(in) :: load
   !> Value there
   real(wp), intent(in) :: value(:)
   real(wp) :: bar(size(value))

   if (self%moves) then
      bar = self%bars(:size(value), i, min(1 + count(self%load < load), size(self%load)))
      return
   else if (size(self%load) > 1) then
      bar = self%bars(:size(value), i, minloc(abs(self%load - load), dim=1))
      return
   end if
   bar = self%bars(:size(value), i, 1)
   where (.not. ieee_is_nan(bar)) bar = max(load*bar, least(self, i, max(norm2(value), &
      & load*self%whole(i, 1))))
end function at

!> Value as printed beside its bar: values far below the bar are rounding errors
elemental real(wp) function printed(value, bar)
   real(wp), intent(in) :: value
   !> Its bar, NaN where there is none
   real(wp), intent(in) :: bar

   printed = merge(0.0_wp, value, abs(value) < 1.0e-6_wp*bar)
end function printed

!> Whether the bar is more than a tenth of the size
pure logical function unresolved(self, i)
   class(bars_type), intent(in) :: self
   !> Probe
   integer, intent(in) :: i

   unresolved = .false.
   if (ieee_is_nan(self%change(i))) return
   ! a probe has no bars beyond its components, and a comparison with none is false
   unresolved = any(self%bars(:, i, size(self%load)) > 0.1_wp*self%size(i))
end function unresolved

!> Whether a place is on the surface
pure logical function on_surface(cloud, place)
   !> Points
   type(cloud_type), intent(in) :: cloud
   !> Place, shape (3) [length]
   real(wp), intent(in) :: place(3)
   real(wp) :: h, normal(3)
   integer :: e

   on_surface = .false.
   h = maxval(cloud%spacing)
   do e = 1, size(cloud%boundary_point)
      call look_at_face(cloud, e, place, h, on_surface, normal)
      if (on_surface) return
   end do
end function on_surface

!> Whether a place is on the face of a boundary point, and its normal there
pure subroutine look_at_face(cloud, e, place, h, on_face, normal)
   !> Points
   type(cloud_type), intent(in) :: cloud
   !> Entry of the boundary
   integer, intent(in) :: e
   !> Place, shape (3) [length]
   real(wp), intent(in) :: place(3)
   !> Largest spacing [length]
   real(wp), intent(in) :: h
   logical, intent(out) :: on_face
   !> Outward unit normal
   real(wp), intent(out) :: normal(3)
   real(wp) :: away(3), off, point(3)

   point = 0.0_wp
   normal = 0.0_wp
   point(:cloud%nd) = cloud%points(:, cloud%boundary_point(e))
   normal(:cloud%nd) = cloud%normal(:, e)
   away = place - point
   if (cloud%nd == 2) away(3) = 0.0_wp
   off = dot_product(away, normal)
   if (cloud%polar .and. abs(dot_product(point, normal)) > 0.5_wp*norm2(point)) then
      ! between its points a wall is an arc
      off = norm2(place(:2)) - norm2(point)
      normal(:2) = sign(1.0_wp, dot_product(point, normal))*place(:2)/norm2(place(:2))
   end if
   on_face = norm2(away) < h .and. abs(off) < 1.0e-3_wp*h
end subroutine look_at_face

!> Change of a stress when its traction on a face without conditions is removed: this part of its
!> error is known
real(wp) function off_free(problem, i, local) result(off)
   class(discretisation_type), intent(in) :: problem
   !> Number of the probe
   integer, intent(in) :: i
   !> State at its place
   type(point_state), intent(in) :: local
   type(point_state) :: free
   real(wp) :: h, normal(3), traction(3)
   logical :: on_face
   integer :: a, b, e, k

   off = 0.0_wp
   associate (scene => problem%scene, probe => problem%scene%probe(i))
      h = maxval(scene%cloud%spacing)
      do e = 1, size(scene%cloud%boundary_point)
         call look_at_face(scene%cloud, e, probe%point, h, on_face, normal)
         if (.not. on_face .or. any([(scene%cloud%in_set(e, scene%condition(k)%set), &
            & k=1, size(scene%condition))])) cycle
         normal = matmul(cofactor(local%f), normal)
         normal = normal/norm2(normal)
         traction = matmul(local%cauchy, normal)
         free = local
         do b = 1, 3
            do a = 1, 3
               free%cauchy(a, b) = local%cauchy(a, b) - traction(a)*normal(b) - normal(a) &
                  & *traction(b) + dot_product(normal, traction)*normal(a)*normal(b)
            end do
         end do
         off = max(off, norm2(quantity(probe%quantity, free) &
            & - quantity(probe%quantity, local)))
      end do
   end associate
end function off_free

!> Stress near a plane or circle on which materials meet: tractions of both sides differ by their
!> errors, which are largest in the cell beside it, in the stiffer material
real(wp) function off_interface(problem, probes, i, state) result(off)
   class(discretisation_type), intent(in) :: problem
   type(probes_type), intent(in) :: probes
   !> Number of the probe
   integer, intent(in) :: i
   type(field_state), intent(in) :: state
   !> Distances of both places from the interface, and greatest one of the probe, in spacings [-]
   real(wp), parameter :: to_side = 1.0e-3_wp, reach = 1.0_wp
   !> Error over the difference of tractions
   real(wp), parameter :: factor = 2.5_wp
   type(error_type), allocatable :: error
   type(shape_type) :: shape
   type(point_state) :: local(2)
   real(wp) :: low(3), step(3), normal(3), place(problem%scene%cloud%nd, 2)
   real(wp) :: q(problem%scene%cloud%nd), u(problem%fields, problem%shape%nq)
   integer :: k, nd, side

   off = 0.0_wp
   nd = problem%scene%cloud%nd
   associate (scene => problem%scene)
      call lattice_frame(scene%cloud, low, step)
      do k = 1, size(scene%approximation%kink)
         associate (d => scene%approximation%kink_axis(k), &
            & kink => scene%approximation%kink(k))
            q = lattice_coordinates(scene%cloud, scene%probe(i)%point(:nd))
            if (abs(q(d) - kink) > reach*step(d)) cycle
            do side = 1, 2
               q(d) = kink + (2*side - 3)*to_side*step(d)
               place(:, side) = place_at(scene%cloud, q)
            end do
         end associate
         call scene%shape_at(place, shape, error)
         if (allocated(error)) return
         do side = 1, 2
            call shape%interpolate(side, state%x, 1, 1 + nd, u)
            call problem%at_place(state, probes%nearest(i), place(:, side), u, local(side))
         end do
         normal = 0.0_wp
         normal(:nd) = place(:, 2) - place(:, 1)
         normal = matmul(cofactor(local(1)%f), normal)
         off = max(off, factor*norm2(matmul(local(2)%cauchy - local(1)%cauchy, normal)) &
            & /norm2(normal))
      end do
   end associate
end function off_interface

end module rk_bars
