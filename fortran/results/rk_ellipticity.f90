!> Search for the collocation point at which a state is nearest to losing ellipticity.
module rk_ellipticity
   use, intrinsic :: ieee_arithmetic, only : ieee_is_finite
   use rk_acoustic, only : least_acoustic
   use rk_discretisation, only : discretisation_type
   use rk_precision, only : wp
   use rk_states, only : field_state, point_state
   use rk_tensor, only : cofactor
   implicit none
   private

   public :: ellipticity_type, find_ellipticity

   !> The worst point of a state
   type :: ellipticity_type
      !> Smallest eigenvalue of the acoustic tensor over the shear modulus at rest [-]
      real(wp) :: value = huge(1.0_wp)
      !> Its collocation point
      integer :: point = 0
      !> Whether ellipticity is lost, shape (nc)
      logical, allocatable :: lost(:)
      !> Whether J is not positive or the Cauchy stress not finite, shape (nc)
      logical, allocatable :: broken(:)
      !> Smallest and largest volume ratio J = det F there, as in fields and probes [-]
      real(wp) :: min_j = 1.0_wp
      real(wp) :: max_j = 1.0_wp
   end type ellipticity_type

contains

!> Find the worst point. The material is taken as incompressible in the mixed form, and in all forms
!> where K is infinite
subroutine find_ellipticity(problem, state, worst)
   !> Full nonlinear problem
   class(discretisation_type), intent(in) :: problem
   type(field_state), intent(in) :: state
   type(ellipticity_type), intent(out) :: worst
   type(point_state) :: local
   real(wp), allocatable :: least(:), j(:)
   real(wp) :: p(3, 3), c4(3, 3, 3, 3), modulus
   logical :: fixed, mixed
   integer :: ip, nd

   nd = problem%scene%cloud%nd
   mixed = problem%has_pressure()
   allocate (least(size(problem%scene%cloud%points, 2)), j(size(problem%scene%cloud%points, 2)), &
      & worst%broken(size(problem%scene%cloud%points, 2)))
   least = huge(1.0_wp)
   !$omp parallel do default(none) schedule(static) private(ip, local, p, c4, fixed, &
   !$omp& modulus) shared(problem, state, worst, least, j, nd, mixed)
   do ip = 1, size(least)
      call problem%at_point(state, ip, local)
      j(ip) = local%j
      worst%broken(ip) = .not. (local%j > 0.0_wp .and. all(ieee_is_finite(local%cauchy)))
      fixed = mixed .or. problem%mixture%bulk(ip) > huge(1.0_wp)
      modulus = problem%scene%tissue(problem%scene%tissue_of(ip))%material%shear
      call problem%mixture%stress(ip, local%f, state%load, p, c4, volumetric=.not. fixed)
      least(ip) = min(least(ip), least_acoustic(nd, c4, cofactor(local%f), fixed)/modulus)
   end do
   !$omp end parallel do
   worst%point = minloc(least, dim=1)
   worst%value = least(worst%point)
   worst%lost = .not. least > 0.0_wp
   worst%min_j = minval(j)
   worst%max_j = maxval(j)
end subroutine find_ellipticity

end module rk_ellipticity
