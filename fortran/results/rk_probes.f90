!> Probes: numbers of a converged state at points, on boundary sets and through plane sections.
module rk_probes
   use, intrinsic :: ieee_arithmetic, only : ieee_is_finite
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type
   use rk_fields, only : field_value
   use rk_neighbours, only : nearest_points
   use rk_precision, only : pi, wp
   use rk_scene, only : probe_type, scene_type
   use rk_shape, only : shape_type
   use rk_states, only : field_state, point_state
   use rk_tensor, only : principal_values
   implicit none
   private

   public :: probes_type, new_probes, probe_value, pressed_volume, place_state, quantity, &
      & quantity_kind, quantity_size, numbers_of

   !> Shape functions at the positions of point probes
   type :: probes_type
      !> Shape functions, one position for each probe
      type(shape_type) :: shape
      !> Nearest collocation point of each probe: its material and fiber, shape (nprobe)
      integer, allocatable :: nearest(:)
   end type probes_type

contains

!> Prepare the probes of a scene
subroutine new_probes(self, scene, error)
   type(probes_type), intent(out) :: self
   type(scene_type), intent(in) :: scene
   !> Error handling: a probe outside the body
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: place(scene%cloud%nd, size(scene%probe))
   integer :: i, nd

   nd = scene%cloud%nd
   do i = 1, size(scene%probe)
      place(:, i) = scene%cloud%points(:, 1)
      if (.not. scene%probe(i)%at_a_place()) cycle
      place(:, i) = scene%probe(i)%point(:nd)
   end do
   self%nearest = nearest_points(scene%cloud%points, place)
   if (size(scene%probe) == 0) return
   call scene%shape_at(place, self%shape, error)
   if (allocated(error)) error%message = 'probe: '//error%message
end subroutine new_probes

!> Value of a probe, 1 or 3 numbers
subroutine probe_value(problem, probes, i, state, value, whole, apart)
   class(discretisation_type), intent(in) :: problem
   type(probes_type), intent(in) :: probes
   !> Number of the probe
   integer, intent(in) :: i
   type(field_state), intent(in) :: state
   !> Value, shape (3); only the first quantity_size numbers are used
   real(wp), intent(out) :: value(3)
   !> Norm of the vector or tensor of which the value is a component, or of the value itself
   real(wp), intent(out), optional :: whole
   !> For J, its difference from the value that the pressure implies, otherwise 0
   real(wp), intent(out), optional :: apart
   type(field_state) :: own
   type(point_state) :: again, local

   if (present(apart)) apart = 0.0_wp
   associate (probe => problem%scene%probe(i))
      if (probe%of_body()) then
         value = 0.0_wp
         value(1) = muscle_value(problem, probe, state)
         if (present(whole)) whole = abs(value(1))
         return
      end if
      select case (quantity_kind(probe%quantity))
      case ('force')
         if (probe%material > 0) then
            call problem%state(state%x, state%load, own, probe%material)
            value = force_of(problem, probe, own)
         else
            value = force_of(problem, probe, state)
         end if
      case ('torque')
         value = problem%set_force(probe%set, state, 1.0_wp, probe%about)
      case default
         if (probe%set > 0) then
            value = problem%set_displacement(probe%set, state)
         else
            call place_state(problem, probes, i, state, local)
            value = quantity(probe%quantity, local)
            if (present(apart) .and. .not. problem%linear) then
               again = local
               again%j = pressed_volume(problem, probes%nearest(i), local)
               apart = norm2(quantity(probe%quantity, again) - value)
            end if
            if (.not. present(whole)) return
            whole = norm2(value)
            select case (quantity_kind(probe%quantity))
            case ('length')
               whole = norm2(local%u)
            case ('stress')
               whole = max(whole, norm2(local%cauchy))
            end select
            return
         end if
      end select
      if (present(whole)) whole = norm2(value)
      if (quantity_size(probe%quantity) == 1) value(1) = value(component(probe%quantity, &
         & len(probe%quantity)))
   end associate
end subroutine probe_value

!> State of the material at the position of a probe
subroutine place_state(problem, probes, i, state, local)
   class(discretisation_type), intent(in) :: problem
   type(probes_type), intent(in) :: probes
   !> Number of the probe, which has a position
   integer, intent(in) :: i
   type(field_state), intent(in) :: state
   type(point_state), intent(out) :: local
   real(wp) :: u(problem%fields, problem%shape%nq)

   associate (nd => problem%scene%cloud%nd)
      call probes%shape%interpolate(i, state%x, 1, 1 + nd, u)
      call problem%at_place(state, probes%nearest(i), problem%scene%probe(i)%point(:nd), u, local)
   end associate
end subroutine place_state

!> Volume ratio implied by the pressure at a position; J differs from it where a form preserves only
!> the volume of cells or patches
real(wp) function pressed_volume(problem, ip, local) result(ratio)
   class(discretisation_type), intent(in) :: problem
   !> Collocation point whose material applies there
   integer, intent(in) :: ip
   type(point_state), intent(in) :: local
   real(wp) :: mean

   ratio = 1.0_wp
   mean = (local%cauchy(1, 1) + local%cauchy(2, 2) + local%cauchy(3, 3))/3.0_wp
   if (ieee_is_finite(mean)) ratio = ratio + mean/problem%mixture%bulk(ip)
end function pressed_volume

!> Force through a boundary set or a plane section
function force_of(problem, probe, state) result(value)
   class(discretisation_type), intent(in) :: problem
   type(probe_type), intent(in) :: probe
   type(field_state), intent(in) :: state
   real(wp) :: value(3)

   associate (nd => problem%scene%cloud%nd)
      if (probe%set > 0) then
         value = problem%set_force(probe%set, state, 1.0_wp)
      else
         value = problem%section_force(probe%point(:nd), probe%normal(:nd), state)
      end if
   end associate
end function force_of

!> Energy of a muscle, or a mean over its volume: of the stretch of its fibers, or of their angle to
!> a direction [degree]
real(wp) function muscle_value(problem, probe, state) result(value)
   class(discretisation_type), intent(in) :: problem
   type(probe_type), intent(in) :: probe
   type(field_state), intent(in) :: state
   type(point_state) :: local
   real(wp), allocatable :: fraction(:), along(:, :)
   integer, allocatable :: tissue(:)
   real(wp) :: fiber(3), part, total, one
   integer :: ip, k

   if (probe%quantity == 'energy') then
      value = problem%strain_energy(state, probe%material)
      return
   end if
   value = 0.0_wp
   total = 0.0_wp
   do ip = 1, size(problem%scene%cloud%points, 2)
      call problem%mixture%parts(ip, tissue, fraction, along)
      k = findloc(tissue, probe%material, dim=1)
      if (k == 0) cycle
      part = problem%scene%cloud%volume(ip)*fraction(k)
      if (.not. part*norm2(along(:, k)) > 0.0_wp) cycle
      call problem%at_point(state, ip, local)
      fiber = matmul(local%f, along(:, k))
      one = norm2(fiber)
      if (probe%quantity == 'pennation') one = 180.0_wp/pi &
         & *acos(min(abs(dot_product(fiber, probe%normal))/one, 1.0_wp))
      value = value + part*one
      total = total + part
   end do
   value = value/max(total, tiny(1.0_wp))
end function muscle_value

!> Kind of a quantity: length, ratio, stress, force, torque, energy or angle
pure function quantity_kind(name) result(kind)
   character(len=*), intent(in) :: name
   character(len=10) :: kind

   kind = 'stress'
   if (any(name == [character(len=13) :: 'J', 'fiber_stretch'])) kind = 'ratio'
   if (name == 'energy') kind = 'energy'
   if (name == 'pennation') kind = 'angle'
   if (name(1:1) == 'u') kind = 'length'
   if (index(name, 'force') > 0) kind = 'force'
   if (index(name, 'torque') == 1) kind = 'torque'
end function quantity_kind

!> Number of components of a quantity
pure integer function quantity_size(name)
   character(len=*), intent(in) :: name

   quantity_size = merge(3, 1, any(name == [character(len=13) :: 'u', 'force', 'section_force']))
end function quantity_size

!> Number of components of a probe in the dimensions of its problem
pure integer function numbers_of(problem, i)
   class(discretisation_type), intent(in) :: problem
   !> Number of the probe
   integer, intent(in) :: i

   numbers_of = 1
   if (quantity_size(problem%scene%probe(i)%quantity) > 1 .and. problem%fields > 1) &
      & numbers_of = problem%scene%cloud%nd
end function numbers_of

!> Index 1..3 of the letter x, y or z in a name
pure integer function component(name, at)
   !> Name, such as u_x
   character(len=*), intent(in) :: name
   !> Position of the letter
   integer, intent(in) :: at

   component = index('xyz', name(at:at))
end function component

!> A quantity of a local state
pure function quantity(name, local) result(value)
   character(len=*), intent(in) :: name
   type(point_state), intent(in) :: local
   real(wp) :: value(3)
   real(wp) :: e(3), t(2)

   value = 0.0_wp
   select case (name)
   case ('u')
      value = local%u
   case ('u_x', 'u_y', 'u_z')
      value(1) = local%u(component(name, 3))
   case ('J')
      value(1) = local%j
   case ('pressure')
      value(1:1) = field_value('pressure', local, 1)
   case ('principal_max')
      e = principal_values(local%cauchy)
      value(1) = e(1)
   case ('cauchy_rr', 'cauchy_tt')
      ! polar directions of the undeformed position about the third axis
      t = local%x(:2)/norm2(local%x(:2))
      if (name == 'cauchy_tt') t = [-t(2), t(1)]
      value(1) = dot_product(t, matmul(local%cauchy(:2, :2), t))
   case default
      value(1) = local%cauchy(component(name, 8), component(name, 9))
   end select
end function quantity

end module rk_probes
