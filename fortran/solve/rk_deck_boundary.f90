!> From a checked deck to boundary sets that are parts of the surface, to conditions on sets, and to
!> probes at points and on sets with their exact and reference values.
module rk_deck_boundary
   use rk_borders, only : adopt_nearest, extent_of
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_error, only : error_type
   use rk_exact, only : has_solution
   use rk_lattice, only : outside_lattice
   use rk_named_sets, only : add_set
   use rk_precision, only : pi, wp
   use rk_programme, only : programme_type, rotation_type
   use rk_region, only : region_type
   use rk_scene, only : condition_type, scene_type
   use rk_text, only : to_text
   implicit none
   private

   public :: read_conditions, read_probes, read_sets

contains

subroutine read_conditions(scene, deck, error)
   !> Scene with points
   type(scene_type), intent(inout) :: scene
   type(deck_type), intent(in) :: deck
   !> Error handling, one line more for each unknown set
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: at, name
   character(len=*), parameter :: component(3) = ['.u_x', '.u_y', '.u_z']
   integer :: i, k

   allocate (scene%condition(deck%count('boundary')))
   do k = 1, size(scene%condition)
      at = 'boundary.'//to_text(k)
      associate (condition => scene%condition(k))
         call deck%get(at//'.set', name)
         call find_named_set(scene%cloud, deck, at//'.set', name, condition%set, error)
         do i = 1, scene%cloud%nd
            condition%fixed(i) = deck%has(at//component(i))
            call deck%get(at//component(i), condition%value(i))
         end do
         call condition%read(deck, at)
         ! the only component of a scalar problem
         condition%fixed(1) = condition%fixed(1) .or. deck%has(at//'.u')
         call deck%get(at//'.u', condition%value(1))
         call deck%get(at//'.flux', condition%traction(1))
         condition%is_radial = deck%has(at//'.radial')
         if (condition%tendon > 0.0_wp) then
            condition%direction = condition%direction/norm2(condition%direction)
            condition%fixed = condition%fixed .or. abs(condition%direction) > 0.0_wp
         end if
         if (deck%has(at//'.rotation')) &
            & call read_motion(condition, scene%programme, deck, at, scene%cloud%nd)
      end associate
   end do
end subroutine read_conditions

!> Rotation of a boundary set about an axis, beside its translation
subroutine read_motion(condition, programme, deck, at, nd)
   !> Condition with its translation and amplitude
   type(condition_type), intent(inout) :: condition
   !> Programme, to which the rotation is added
   type(programme_type), intent(inout) :: programme
   type(deck_type), intent(in) :: deck
   !> Key of the entry
   character(len=*), intent(in) :: at
   integer, intent(in) :: nd
   type(rotation_type) :: own
   real(wp) :: angle
   integer :: same

   call deck%get(at//'.rotation', angle)
   own = rotation_type(condition%amplitude, angle*pi/180.0_wp)
   if (nd < 3) condition%axis(3) = 1.0_wp
   condition%axis = condition%axis/norm2(condition%axis)
   condition%fixed(:nd) = .true.
   ! sets that turn alike share the factors, so that they agree where they meet
   same = findloc(programme%rotation%amplitude == own%amplitude .and. &
      & abs(programme%rotation%angle - own%angle) <= 0.0_wp, .true., dim=1)
   if (same == 0) then
      programme%rotation = [programme%rotation, own]
      same = size(programme%rotation)
   end if
   condition%sine = programme%sine_of(same)
end subroutine read_motion

!> Probes with exact and reference values
subroutine read_probes(scene, deck, error)
   !> Scene with points
   type(scene_type), intent(inout) :: scene
   type(deck_type), intent(in) :: deck
   !> Error handling, one line more for each unknown set and each point outside
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: at, body, name
   type(error_type), allocatable :: fault
   real(wp) :: area
   integer :: i, k

   allocate (scene%probe(deck%count('probe')), scene%exact(deck%count('exact')), &
      & scene%reference(deck%count('reference')))
   do k = 1, size(scene%probe)
      at = 'probe.'//to_text(k)
      associate (probe => scene%probe(k))
         call probe%read(deck, at)
         if (deck%has(at//'.normal')) probe%normal = probe%normal/norm2(probe%normal)
         if (any(probe%quantity == [character(len=13) :: 'fiber_stretch', 'pennation'])) then
            if (.not. scene%tissue(probe%material)%material%fibered) call deck%complain( &
               & at//'.material', scene%tissue(probe%material)%material%name &
               & //' has no fibers whose '//probe%quantity//' could be measured', error)
         end if
         if (deck%has(at//'.set')) then
            call deck%get(at//'.set', name)
            call find_named_set(scene%cloud, deck, at//'.set', name, probe%set, error)
            if (probe%set > 0) then
               call extent_of(scene%cloud, probe%set, area, probe%about(:scene%cloud%nd), fault)
               if (allocated(fault)) call move_alloc(fault, error)
            end if
            call deck%get_vector(at//'.about', probe%about)
         else if (allocated(scene%cloud%lattice) .and. deck%has(at//'.point')) then
            call deck%get('geometry.kind', body)
            associate (point => probe%point(:scene%cloud%nd))
               if (outside_lattice(scene%cloud, point)) call deck%complain(at//'.point', &
                  & to_text(point)//' lies outside the '//body, error)
            end associate
         else if (deck%has(at//'.point')) then
            if (scene%cloud%is_outside(probe%point)) call deck%complain(at//'.point', &
               & to_text(probe%point)//' is more than half a voxel outside the body, which has ' &
               & //'its points from '//to_text(minval(scene%cloud%points, dim=2))//' to ' &
               & //to_text(maxval(scene%cloud%points, dim=2)), error)
         end if
      end associate
   end do
   do k = 1, size(scene%exact)
      at = 'exact.'//to_text(k)
      call scene%exact(k)%read(deck, at)
      if (.not. has_solution(scene, scene%exact(k))) call deck%complain(at//'.solution', &
         & scene%exact(k)%solution//' is homogeneous only if the fibers lie along x, y or z ' &
         & //'everywhere, and with K = inf along the stretch: leave it out', error)
   end do
   do k = 1, size(scene%reference)
      at = 'reference.'//to_text(k)
      associate (reference => scene%reference(k))
         call reference%read(deck, at)
         if (size(reference%activation) == 0) cycle
         i = scene%common_tissue()
         if (i == 0) then
            call deck%complain(at//'.activation', 'the muscles have different activations: give ' &
               & //'load instead', error)
         else if (scene%tissue(i)%amplitude > 0) then
            call deck%complain(at//'.activation', 'needs an activation that grows with the ' &
               & //'load, not by an amplitude: give load', error)
         else
            reference%load = reference%activation/max(scene%tissue(i)%activation, tiny(1.0_wp))
         end if
      end associate
   end do
end subroutine read_probes

!> Number of a boundary set that a key names
subroutine find_named_set(cloud, deck, key, name, set, error)
   type(cloud_type), intent(in) :: cloud
   type(deck_type), intent(in) :: deck
   !> Key that holds the name
   character(len=*), intent(in) :: key
   character(len=*), intent(in) :: name
   !> Number of the set, 0 where there is none
   integer, intent(out) :: set
   !> Error handling, one line more for an unknown set
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: body, known
   integer :: i

   set = cloud%find_set(name)
   if (set > 0) return
   known = ''
   do i = 1, size(cloud%set_names)
      if (i > 1) known = known//', '
      known = known//trim(cloud%set_names(i))
   end do
   call deck%get('geometry.kind', body)
   call deck%complain(key, "'"//trim(name)//"' is not a side of this "//body//', which has only: ' &
      & //known, error)
end subroutine find_named_set

!> Add the sets of a deck to those of the body
subroutine read_sets(scene, deck, error)
   !> Scene with points and tissues
   type(scene_type), intent(inout) :: scene
   type(deck_type), intent(in) :: deck
   !> Error handling, one line more for each side that is not known and each set without a place
   type(error_type), allocatable, intent(inout) :: error
   type(region_type), allocatable :: region
   character(len=:), allocatable :: at, name
   integer :: k, n
   logical :: found

   n = size(scene%cloud%set_names)
   do k = 1, deck%count('set')
      at = 'set.'//to_text(k)
      call deck%get(at//'.name', name)
      if (len(name) > len(scene%cloud%set_names)) then
         call deck%complain(at//'.name', 'must not be longer than ' &
            & //to_text(len(scene%cloud%set_names))//' bytes, not '//to_text(len(name)), error)
      else if (any(scene%cloud%set_names(:n) == name)) then
         call deck%complain(at//'.name', "'"//name//"' is a side of this body: take another name", &
            & error)
      end if
      allocate (region)
      call read_region(region, scene, deck, at, error)
      if (allocated(error)) return
      call add_set(scene%cloud, name, region, found, error)
      if (allocated(error)) return
      ! Galerkin forms integrate over the set wherever it lies
      if (.not. found .and. allocated(scene%cloud%lattice) .and. index(scene%method, 'rkpm') == 1) &
         & call adopt_nearest(scene%cloud, size(scene%cloud%set_names), found, error)
      if (allocated(error)) return
      deallocate (region)
      if (.not. found) call deck%complain(at, 'no place of the surface lies in it; coordinates ' &
         & //'are those of the body at rest, and normals point out of it; a set that lies ' &
         & //'between points of the surface needs more of them', error)
   end do
end subroutine read_sets

!> Criteria of a set
subroutine read_region(region, scene, deck, at, error)
   type(region_type), intent(inout) :: region
   type(scene_type), intent(in) :: scene
   type(deck_type), intent(in) :: deck
   !> Key of the set
   character(len=*), intent(in) :: at
   !> Error handling, one line more for an unknown side
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: word
   integer :: k

   if (deck%has(at//'.side')) then
      call deck%get(at//'.side', word)
      call find_named_set(scene%cloud, deck, at//'.side', word, region%side, error)
      if (region%side > scene%cloud%sides()) call deck%complain(at//'.side', "'"//word &
         & //"' is not a side, but another [[set]]: say with `where` what both hold", error)
   end if
   if (deck%has(at//'.on')) then
      call deck%get(at//'.on', k)
      if (any(scene%tissue%part%given())) then
         ! labels of points would put the border half way between the points
         region%tissue = scene%tissue(k:)%part
      else if (size(scene%tissue) > 1) then
         region%label = scene%tissue(k)%label
      end if
   end if
   call deck%get(at//'.where', region%where)
end subroutine read_region

end module rk_deck_boundary
