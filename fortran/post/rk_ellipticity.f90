!> Where a state is nearest to losing its ellipticity, at the collocation points.
module rk_ellipticity
   use rk_acoustic, only : least_acoustic
   use rk_discretisation, only : discretisation_type, deformation
   use rk_precision, only : wp
   use rk_states, only : field_state
   use rk_tensor, only : cross
   implicit none
   private

   public :: ellipticity_type, find_ellipticity

   !> The worst point of a state
   type :: ellipticity_type
      !> Smallest eigenvalue of the acoustic tensor, of the shear modulus at rest [-]
      real(wp) :: value = huge(1.0_wp)
      !> Its collocation point
      integer :: point = 0
   end type ellipticity_type

contains

!> Find the worst point. The mixed form takes the material as incompressible,
!> all forms where K is infinite.
subroutine find_ellipticity(problem, state, worst)
   !> Full nonlinear problem
   class(discretisation_type), intent(in) :: problem
   !> State
   type(field_state), intent(in) :: state
   !> Worst point
   type(ellipticity_type), intent(out) :: worst
   real(wp), allocatable :: least(:)
   real(wp) :: u(problem%fields, problem%shape%nq), f(3, 3), h(3, 3, 3), p(3, 3), c4(3, 3, 3, 3)
   logical :: fixed, mixed
   integer :: ip, nd

   nd = problem%scene%cloud%nd
   mixed = problem%has_pressure()
   allocate (least(size(problem%scene%cloud%points, 2)))
   !$omp parallel do default(none) schedule(static) private(ip, u, f, h, p, c4, fixed) &
   !$omp shared(problem, state, least, nd, mixed)
   do ip = 1, size(least)
      call problem%field(ip, state%x, 1 + nd, u)
      call deformation(nd, u, f, h)
      fixed = mixed .or. problem%mixture%bulk(ip) > huge(1.0_wp)
      call problem%mixture%tangent(ip, f, state%load, p, c4, volumetric=.not. fixed)
      least(ip) = least_acoustic(nd, c4, 0.5_wp*cross(f, f), fixed) &
         & /problem%scene%tissue(problem%scene%tissue_of(ip))%material%shear
   end do
   !$omp end parallel do
   worst%point = minloc(least, dim=1)
   worst%value = least(worst%point)
end subroutine find_ellipticity

end module rk_ellipticity
