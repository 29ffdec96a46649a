!> Fields of a converged state at the collocation points.
!>
!> They form a list: result files, the Python boundary and their readers go through it by name, so a
!> new field needs a name, its number of components and its value at one position, all of them here.
module rk_fields
   use rk_discretisation, only : discretisation_type
   use rk_point_field, only : point_field
   use rk_precision, only : wp
   use rk_states, only : field_state, point_state
   use rk_tensor, only : principal_values
   implicit none
   private

   public :: compute_fields, field_names, field_sizes, field_value

   !> Names of the fields of a body: displacement [length], deformation gradient row by row and
   !> volume ratio [-], Cauchy stress xx, yy, zz, xy, yz, xz, principal Cauchy stresses, descending,
   !> and pressure, minus the mean Cauchy stress [stress]
   character(len=*), parameter :: field_names(6) = ['u               ', 'F               ', &
      & 'J               ', 'cauchy          ', 'principal_stress', 'pressure        ']
   !> Numbers of components
   integer, parameter :: field_sizes(size(field_names)) = [3, 9, 1, 6, 3, 1]

contains

!> Fields at all collocation points; a problem with a scalar unknown has only that one
subroutine compute_fields(problem, state, fields)
   class(discretisation_type), intent(in) :: problem
   type(field_state), intent(in) :: state
   type(point_field), allocatable, intent(out) :: fields(:)
   type(point_state) :: local
   integer :: ip, k, nc

   nc = size(problem%scene%cloud%points, 2)
   allocate (fields(merge(1, size(field_names), problem%fields == 1)))
   do k = 1, size(fields)
      fields(k)%name = trim(field_names(k))
      allocate (fields(k)%value(merge(1, field_sizes(k), problem%fields == 1), nc))
   end do
   !$omp parallel do default(none) schedule(static) private(ip, k, local) &
   !$omp shared(problem, state, fields, nc)
   do ip = 1, nc
      call problem%at_point(state, ip, local)
      do k = 1, size(fields)
         associate (value => fields(k)%value)
            value(:, ip) = field_value(fields(k)%name, local, size(value, 1))
         end associate
      end do
   end do
   !$omp end parallel do
end subroutine compute_fields

!> Value of a field at one position
pure function field_value(name, local, components) result(value)
   character(len=*), intent(in) :: name
   type(point_state), intent(in) :: local
   integer, intent(in) :: components
   real(wp) :: value(components)

   associate (s => local%cauchy)
      select case (name)
      case ('u')
         value = local%u(:components)
      case ('F')
         value = reshape(transpose(local%f), [9])
      case ('J')
         value = local%j
      case ('cauchy')
         value = [s(1, 1), s(2, 2), s(3, 3), s(1, 2), s(2, 3), s(1, 3)]
      case ('principal_stress')
         value = principal_values(s)
      case ('pressure')
         value = -(s(1, 1) + s(2, 2) + s(3, 3))/3.0_wp
      end select
   end associate
end function field_value

end module rk_fields
