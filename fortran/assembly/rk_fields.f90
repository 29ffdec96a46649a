!> Fields, probes and forces of a converged state.
module rk_fields
   use rk_body, only : body_type
   use rk_error, only : error_type
   use rk_force, only : reaction
   use rk_local, only : local_type
   use rk_precision, only : pi, wp
   use rk_scene, only : scene_type
   use rk_shape, only : new_shape, shape_type
   implicit none
   private

   public :: fields_type, compute_fields, probes_type, new_probes, probe_value
   public :: quantity, quantity_size

   !> Fields at all collocation points. Components run fastest.
   type :: fields_type
      !> Displacement, shape (3, nc) [length]
      real(wp), allocatable :: u(:, :)
      !> Deformation gradient F(i, A), shape (3, 3, nc) [-]
      real(wp), allocatable :: f(:, :, :)
      !> Volume ratio, shape (nc) [-]
      real(wp), allocatable :: j(:)
      !> Cauchy stress xx, yy, zz, xy, yz, xz, shape (6, nc) [stress]
      real(wp), allocatable :: cauchy(:, :)
      !> Principal Cauchy stresses, descending, shape (3, nc) [stress]
      real(wp), allocatable :: principal(:, :)
      !> Pressure, minus the mean Cauchy stress, shape (nc) [stress]
      real(wp), allocatable :: pressure(:)
   end type fields_type

   !> Shape functions at the places of point probes
   type :: probes_type
      !> Shape functions, one place for each probe
      type(shape_type) :: shape
      !> Nearest collocation point of each probe: its material and fiber, shape (nprobe)
      integer, allocatable :: nearest(:)
   end type probes_type

contains

!> Fields at all collocation points
subroutine compute_fields(problem, x, load, fields)
   !> Full problem
   class(body_type), intent(in) :: problem
   !> Coefficients, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Fields
   type(fields_type), intent(out) :: fields
   type(local_type) :: local
   real(wp) :: u(problem%fields, problem%shape%nq)
   integer :: ip, nc

   nc = size(problem%scene%cloud%place, 2)
   allocate (fields%u(3, nc), fields%f(3, 3, nc), fields%j(nc), fields%cauchy(6, nc), &
      & fields%principal(3, nc), fields%pressure(nc))
   !$omp parallel do default(none) schedule(static) private(ip, u, local) &
   !$omp shared(problem, x, load, fields, nc)
   do ip = 1, nc
      call problem%field(ip, x, 1 + problem%scene%cloud%nd, u)
      call problem%local_state(ip, problem%scene%cloud%place(:, ip), u, load, local)
      associate (s => local%cauchy)
         fields%u(:, ip) = local%u
         fields%f(:, :, ip) = local%f
         fields%j(ip) = local%j
         fields%cauchy(:, ip) = [s(1, 1), s(2, 2), s(3, 3), s(1, 2), s(2, 3), s(1, 3)]
         fields%principal(:, ip) = principal_values(s)
         fields%pressure(ip) = -(s(1, 1) + s(2, 2) + s(3, 3))/3.0_wp
      end associate
   end do
   !$omp end parallel do
end subroutine compute_fields

!> Eigenvalues of a symmetric matrix in descending order.
!> Reference: Smith, Commun. ACM 4 (1961) 168, doi:10.1145/355578.366316
pure function principal_values(a) result(e)
   !> Symmetric matrix
   real(wp), intent(in) :: a(3, 3)
   real(wp) :: e(3)
   real(wp) :: mean, p, angle, b(3, 3), d

   mean = (a(1, 1) + a(2, 2) + a(3, 3))/3.0_wp
   b = a
   b(1, 1) = b(1, 1) - mean
   b(2, 2) = b(2, 2) - mean
   b(3, 3) = b(3, 3) - mean
   p = sqrt(sum(b**2)/6.0_wp)
   e = mean
   if (.not. p > tiny(1.0_wp)) return
   b = b/p
   d = b(1, 1)*(b(2, 2)*b(3, 3) - b(2, 3)*b(3, 2)) - b(1, 2)*(b(2, 1)*b(3, 3) - b(2, 3)*b(3, 1)) &
      & + b(1, 3)*(b(2, 1)*b(3, 2) - b(2, 2)*b(3, 1))
   angle = acos(max(-1.0_wp, min(1.0_wp, 0.5_wp*d)))/3.0_wp
   e(1) = mean + 2.0_wp*p*cos(angle)
   e(3) = mean + 2.0_wp*p*cos(angle + 2.0_wp*pi/3.0_wp)
   e(2) = 3.0_wp*mean - e(1) - e(3)
end function principal_values

!> Prepare the probes of a scene
subroutine new_probes(self, scene, error)
   !> Probes
   type(probes_type), intent(out) :: self
   !> Scene
   type(scene_type), intent(in) :: scene
   !> Error handling: a probe outside the body
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: place(scene%cloud%nd, size(scene%probe))
   integer :: i, nd

   nd = scene%cloud%nd
   allocate (self%nearest(size(scene%probe)))
   do i = 1, size(scene%probe)
      self%nearest(i) = 1
      place(:, i) = scene%cloud%place(:, 1)
      if (scene%probe(i)%set > 0) cycle
      place(:, i) = scene%probe(i)%point(:nd)
      self%nearest(i) = minloc(sum((scene%cloud%place - spread(place(:, i), 2, &
         & size(scene%cloud%place, 2)))**2, dim=1), dim=1)
   end do
   if (size(scene%probe) == 0) return
   call new_shape(self%shape, scene%approximation, scene%cloud%source, scene%support, place, error)
   if (allocated(error)) error%message = 'probe: '//error%message
end subroutine new_probes

!> Value of a probe, 1 or 3 numbers
subroutine probe_value(problem, probes, i, x, load, value)
   !> Full problem
   class(body_type), intent(in) :: problem
   !> Probes
   type(probes_type), intent(in) :: probes
   !> Number of the probe
   integer, intent(in) :: i
   !> Coefficients, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Value, shape (3); the first quantity_size numbers count
   real(wp), intent(out) :: value(3)
   type(local_type) :: local
   real(wp) :: u(problem%fields, problem%shape%nq)

   associate (probe => problem%scene%probe(i))
      if (probe%set > 0) then
         value = reaction(problem, probe%set, x, load)
         if (probe%quantity /= 'force') value(1) = value(component(probe%quantity, 7))
      else
         call probes%shape%interpolate(i, x, 1, 1 + problem%scene%cloud%nd, u)
         call problem%local_state(probes%nearest(i), probe%point(:problem%scene%cloud%nd), u, &
            & load, local)
         value = quantity(probe%quantity, local)
      end if
   end associate
end subroutine probe_value

!> How many numbers a quantity has
pure integer function quantity_size(name)
   !> Quantity
   character(len=*), intent(in) :: name

   quantity_size = merge(3, 1, name == 'u' .or. name == 'force')
end function quantity_size

!> Index 1..3 of the letter x, y or z at a place of a name
pure integer function component(name, at)
   !> Name, such as u_x
   character(len=*), intent(in) :: name
   !> Position of the letter
   integer, intent(in) :: at

   component = index('xyz', name(at:at))
end function component

!> A quantity of a local state
pure function quantity(name, local) result(value)
   !> Quantity
   character(len=*), intent(in) :: name
   !> State
   type(local_type), intent(in) :: local
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
      value(1) = -(local%cauchy(1, 1) + local%cauchy(2, 2) + local%cauchy(3, 3))/3.0_wp
   case ('principal_max')
      e = principal_values(local%cauchy)
      value(1) = e(1)
   case ('cauchy_rr', 'cauchy_tt')
      ! directions of the undeformed place about the third axis
      t = local%x(:2)/norm2(local%x(:2))
      if (name == 'cauchy_tt') t = [-t(2), t(1)]
      value(1) = dot_product(t, matmul(local%cauchy(:2, :2), t))
   case default
      value(1) = local%cauchy(component(name, 8), component(name, 9))
   end select
end function quantity

end module rk_fields
