!> Fields of a converged state at the collocation points.
module rk_fields
   use rk_discretisation, only : discretisation_type
   use rk_precision, only : wp
   use rk_states, only : field_state, point_state
   use rk_tensor, only : principal_values
   implicit none
   private

   public :: fields_type, compute_fields

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

contains

!> Fields at all collocation points
subroutine compute_fields(problem, state, fields)
   !> Full problem
   class(discretisation_type), intent(in) :: problem
   !> State
   type(field_state), intent(in) :: state
   !> Fields
   type(fields_type), intent(out) :: fields
   type(point_state) :: local
   integer :: ip, nc

   nc = size(problem%scene%cloud%points, 2)
   allocate (fields%u(3, nc), fields%f(3, 3, nc), fields%j(nc), fields%cauchy(6, nc), &
      & fields%principal(3, nc), fields%pressure(nc))
   !$omp parallel do default(none) schedule(static) private(ip, local) &
   !$omp shared(problem, state, fields, nc)
   do ip = 1, nc
      call problem%at_point(state, ip, local)
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

end module rk_fields
