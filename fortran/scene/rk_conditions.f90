!> Conditions at points of the boundary, from conditions on sets: for strong forms one condition for
!> each component at each boundary point, for weak forms at each point of a set.
!>
!> A component is prescribed if any set of the point prescribes it. Otherwise it has a traction row
!> with the normal of the sets that leave it free, the mean normal where these meet.
module rk_conditions
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_precision, only : wp
   use rk_programme, only : combined, plan_type, programme_type, ramp
   use rk_scene, only : scene_type
   use rk_tensor, only : vector_product
   use rk_text, only : to_text
   implicit none
   private

   public :: boundary_type, new_boundary, conditions_at

   !> Boundary points with their conditions
   type :: boundary_type
      !> Collocation point, ascending, shape (nb)
      integer, allocatable :: point(:)
      !> Whether a component is prescribed, shape (nd, nb)
      logical, allocatable :: essential(:, :)
      !> Displacement of each load factor, shape (factors, nd, nb) [length]
      real(wp), allocatable :: value(:, :, :)
      !> Unit normal of each component's traction row, shape (nd, component, nb)
      real(wp), allocatable :: normal(:, :, :)
      !> Traction of each load factor, shape (factors, nd, nb) [force/area]
      real(wp), allocatable :: traction(:, :, :)
      !> Whether a clamped and a free face meet here, where stresses are singular, shape (nb)
      logical, allocatable :: singular(:)
   contains
      procedure :: supported
   end type boundary_type

contains

!> Whether the motion of a component is resisted, by a prescribed displacement or an elastic
!> support, shape (nd, nb)
pure function supported(self, scene)
   class(boundary_type), intent(in) :: self
   !> Scene from which the boundary was made
   type(scene_type), intent(in) :: scene
   logical, allocatable :: supported(:, :)
   integer :: c, e

   supported = self%essential
   associate (cloud => scene%cloud)
      do c = 1, size(scene%condition)
         if (.not. any(scene%condition(c)%spring > 0.0_wp)) cycle
         do e = 1, size(cloud%boundary_point)
            if (.not. cloud%in_set(e, scene%condition(c)%set)) cycle
            associate (own => supported(:, findloc(self%point, cloud%boundary_point(e), dim=1)))
               own = own .or. scene%condition(c)%spring(:cloud%nd) > 0.0_wp
            end associate
         end do
      end do
   end associate
end function supported

!> Prescribe components at the pins of a linear problem
subroutine add_pins(self, scene, error)
   type(boundary_type), intent(inout) :: self
   !> Scene with an equation
   type(scene_type), intent(in) :: scene
   !> Error handling: a pin that is no boundary point, nothing prescribed
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: distance(size(self%point))
   integer :: b, k

   associate (cloud => scene%cloud, equation => scene%equation)
      do k = 1, size(equation%pin)
         distance = [(norm2(cloud%points(:, self%point(b)) &
            & - equation%pin(k)%point(:cloud%nd)), b=1, size(distance))]
         b = minloc(distance, dim=1)
         if (distance(b) > 1.0e-6_wp*minval(cloud%spacing)) then
            call fatal_error(error, err_input, 'pin: no boundary point lies at ' &
               & //to_text(equation%pin(k)%point(:cloud%nd))//', the nearest one is ' &
               & //to_text(cloud%points(:, self%point(b))))
            return
         end if
         where (equation%pin(k)%fixed(:cloud%nd)) self%essential(:, b) = .true.
      end do
      ! with inertia nothing needs to be prescribed
      if (allocated(scene%motion)) return
      if (.not. any(self%essential(:equation%fields(cloud%nd), :))) &
         & call fatal_error(error, err_input, 'linear: no value is prescribed anywhere: give u ' &
         & //'in a [[boundary]], or a pin')
   end associate
end subroutine add_pins

!> Resolve the conditions of a scene
subroutine new_boundary(self, scene, error, time)
   type(boundary_type), intent(out) :: self
   type(scene_type), target, intent(in) :: scene
   !> Error handling: contradictory conditions; in a linear problem a pin that is not a boundary
   !> point, or nothing prescribed
   type(error_type), allocatable, intent(out) :: error
   !> Time for expressions in it; 0 if absent
   real(wp), intent(in), optional :: time
   integer, allocatable :: number(:)
   real(wp), allocatable :: traction(:, :, :)
   logical, allocatable :: fixed(:, :)
   type(cloud_type), pointer :: cloud
   real(wp) :: value(scene%programme%count(), 3)
   character(len=:), allocatable :: both
   integer :: b, e, factors, i, nd, n, other

   cloud => scene%cloud
   nd = cloud%nd
   factors = size(value, 1)
   allocate (number(size(cloud%points, 2)), source=0)
   number(cloud%boundary_point) = 1
   n = 0
   do i = 1, size(number)
      if (number(i) == 0) cycle
      n = n + 1
      number(i) = n
   end do
   allocate (self%point(n), self%essential(nd, n), self%value(factors, nd, n), &
      & self%normal(nd, nd, n), self%traction(factors, nd, n), self%singular(n))
   self%essential = .false.
   self%value = 0.0_wp
   self%normal = 0.0_wp
   self%traction = 0.0_wp
   self%point(number(cloud%boundary_point)) = cloud%boundary_point

   allocate (fixed(3, size(cloud%boundary_point)))
   allocate (traction(factors, 3, size(cloud%boundary_point)))
   do e = 1, size(cloud%boundary_point)
      b = number(cloud%boundary_point(e))
      associate (x => cloud%points(:, cloud%boundary_point(e)))
         call conditions_at(scene, cloud%in_set(e, scene%condition%set), x, fixed(:, e), &
            & value, traction(:, :, e), error, time)
         if (allocated(error)) return
         do i = 1, nd
            if (.not. fixed(i, e)) cycle
            if (self%essential(i, b)) then
               call compare_displacements(scene%programme, self%value(:, i, b), value(:, i), both)
               if (allocated(both)) then
                  other = findloc(number(cloud%boundary_point(:e - 1)) == b .and. &
                     & fixed(i, :e - 1), .true., dim=1)
                  call fatal_error(error, err_input, 'boundary sets ' &
                     & //trim(cloud%set_names(cloud%boundary_set(other)))//' and ' &
                     & //trim(cloud%set_names(cloud%boundary_set(e)))//' meet and prescribe two ' &
                     & //'displacements, '//both &
                     & //', for component '//to_text(i)//' at ' &
                     & //to_text(x)//': leave one of them out there, by a [[set]] with where')
                  return
               end if
            end if
            self%essential(i, b) = .true.
            self%value(:, i, b) = value(:, i)
         end do
      end associate
   end do
   call mean_normals(self, cloud, number, fixed, traction, error)
   if (.not. allocated(error) .and. allocated(scene%equation%pin)) call add_pins(self, scene, error)
end subroutine new_boundary

!> Normals and tractions of the components that are not prescribed, averaged over the faces that
!> meet, and points where constrained faces meet free ones
subroutine mean_normals(self, cloud, number, fixed, traction, error)
   !> Boundary points with their prescribed components
   type(boundary_type), intent(inout) :: self
   type(cloud_type), intent(in) :: cloud
   !> Boundary point of each collocation point, shape (nc)
   integer, intent(in) :: number(:)
   !> Prescribed components of each boundary entry, shape (3, nb)
   logical, intent(in) :: fixed(:, :)
   !> Its tractions, shape (factors, 3, nb)
   real(wp), intent(in) :: traction(:, :, :)
   !> Error handling: a body one point thin
   type(error_type), allocatable, intent(inout) :: error
   real(wp) :: length
   integer :: b, e, i, nd

   nd = cloud%nd
   ! a clamped face meets a free one; symmetry planes, free to slide, do no harm
   self%singular = .false.
   do e = 1, size(cloud%boundary_point)
      b = number(cloud%boundary_point(e))
      self%singular(b) = self%singular(b) .or. &
         & (all(self%essential(:, b)) .and. .not. any(fixed(:nd, e)))
      do i = 1, nd
         if (fixed(i, e)) cycle
         self%normal(:, i, b) = self%normal(:, i, b) + cloud%normal(:, e)
         self%traction(:, i, b) = self%traction(:, i, b) + traction(:, i, e)
      end do
   end do
   do b = 1, size(self%point)
      do i = 1, nd
         if (self%essential(i, b)) cycle
         length = norm2(self%normal(:, i, b))
         if (.not. length > 1.0e-6_wp) then
            call fatal_error(error, err_input, 'boundary point '//to_text(self%point(b))//' at ' &
               & //to_text(cloud%points(:, self%point(b)))//' has opposite normals: the body is ' &
               & //'only one point thick there')
            return
         end if
         self%normal(:, i, b) = self%normal(:, i, b)/length
         ! the sum of the rows of the faces that meet, scaled like its normal
         self%traction(:, i, b) = self%traction(:, i, b)/length
      end do
   end do
end subroutine mean_normals

!> For a message, two displacements where they differ most during a programme; nothing if they
!> agree, even as sums of other load factors
pure subroutine compare_displacements(programme, one, other, both)
   type(programme_type), intent(in) :: programme
   !> Displacement of each load factor, shape (factors) [length]
   real(wp), intent(in) :: one(:), other(:)
   !> Both displacements
   character(len=:), allocatable, intent(out) :: both
   !> Number of loads compared, besides the beginning of a programme and the times of its
   !> amplitudes: an odd number avoids common periods
   integer, parameter :: looks = 23
   type(plan_type) :: planned
   real(wp) :: factor(size(one)), largest, u(2)
   integer :: k

   if (.not. any(abs(one - other) > 0.0_wp)) return
   planned = programme%plan(looks)
   largest = 0.0_wp
   do k = 0, size(planned%load)
      factor = programme%factors(merge(0.0_wp, planned%load(max(k, 1)), k == 0))
      u = [combined(one, factor), combined(other, factor)]
      if (.not. abs(u(1) - u(2)) > max(largest, 1.0e-9_wp*max(abs(u(2)), 1.0e-3_wp))) cycle
      largest = abs(u(1) - u(2))
      both = to_text(u(1))//' and '//to_text(u(2))
   end do
end subroutine compare_displacements

!> Values prescribed by conditions at a point of their sets, for strong and for weak forms:
!> tractions are added, displacements must agree
subroutine conditions_at(scene, here, x, fixed, value, traction, error, time)
   type(scene_type), intent(in) :: scene
   !> Whether the point lies in the set of each, shape (conditions)
   logical, intent(in) :: here(:)
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Prescribed components
   logical, intent(out) :: fixed(3)
   !> Their displacement for each load factor, shape (factors, 3) [length]
   real(wp), intent(out) :: value(:, :)
   !> Traction for each load factor, which acts where nothing is prescribed, shape (factors, 3)
   !> [force/area]
   real(wp), intent(out) :: traction(:, :)
   !> Error handling: no direction on the axis, an expression that is not finite, overlapping sets
   !> that prescribe two displacements
   type(error_type), allocatable, intent(out) :: error
   !> Time for expressions in it; 0 if absent
   real(wp), intent(in), optional :: time
   logical :: own(3)
   real(wp) :: g(size(value, 1), 3), h(3), arm(3), turn(3)
   character(len=:), allocatable :: both
   integer :: a, c, i, other, owner(3)

   fixed = .false.
   value = 0.0_wp
   traction = 0.0_wp
   do c = 1, size(scene%condition)
      if (.not. here(c)) cycle
      a = ramp + scene%condition(c)%amplitude
      own = scene%condition(c)%fixed
      g = 0.0_wp
      h = 0.0_wp
      do i = 1, scene%cloud%nd
         call scene%condition(c)%value(i)%at(x, g(a, i), error, time)
         call scene%condition(c)%traction(i)%at(x, h(i), error, time)
         if (allocated(error)) return
      end do
      if (scene%condition(c)%is_radial) then
         own(:2) = .true.
         if (.not. norm2(x(:2)) > 0.0_wp) then
            call fatal_error(error, err_input, 'boundary set ' &
               & //trim(scene%cloud%set_names(scene%condition(c)%set)) &
               & //': a radial displacement has no direction at '//to_text(x)//' on the axis')
            return
         end if
         g(a, :2) = scene%condition(c)%radial*x(:2)/norm2(x(:2))
      end if
      if (scene%condition(c)%sine > 0) then
         ! (R - I)d = sin(theta) n x d + (1 - cos(theta)) n x (n x d)
         arm = -scene%condition(c)%about
         arm(:size(x)) = arm(:size(x)) + x
         turn = vector_product(scene%condition(c)%axis, arm)
         g(scene%condition(c)%sine, :) = turn
         g(scene%condition(c)%sine + 1, :) = vector_product(scene%condition(c)%axis, turn)
      end if
      do i = 1, 3
         if (.not. own(i)) cycle
         if (fixed(i)) then
            other = owner(i)
            call compare_displacements(scene%programme, value(:, i), g(:, i), both)
            if (max(scene%condition(c)%tendon, scene%condition(other)%tendon) > 0.0_wp) both = &
               & 'one of them by a tendon, as a plate'
            if (allocated(both)) then
               call fatal_error(error, err_input, 'boundary sets ' &
                  & //trim(scene%cloud%set_names(scene%condition(other)%set))//' and ' &
                  & //trim(scene%cloud%set_names(scene%condition(c)%set))//' overlap and ' &
                  & //'prescribe two displacements, '//both &
                  & //', for component '//to_text(i)//' at '//to_text(x)//': give one of them, ' &
                  & //'or separate them by `where`')
               return
            end if
         end if
         fixed(i) = .true.
         owner(i) = c
         value(:, i) = g(:, i)
      end do
      traction(a, :) = traction(a, :) + h
   end do
end subroutine conditions_at

end module rk_conditions
