! Python boundary of the segmentation: plain arrays in, plain arrays out.

!> Evolve the level sets of all slices; weights are mu, nu, lambda1, lambda2, epsilon, dt,
!> tolerance, and mask is zero for pixels that take no part
subroutine evolve_two_phase(weights, spacing, limit, ni, nj, nk, image, mask, start, phi, &
   & energy, iterations, stat, message)
   use rk_error, only : error_type
   use rk_levelset, only : evolve => evolve_two_phase, level_set_options
   use rk_pack, only : pack_error
   implicit none
   !f2py threadsafe
   integer, intent(in) :: limit, ni, nj, nk
   double precision, intent(in) :: weights(7), spacing(2)
   double precision, intent(in) :: image(ni, nj, nk), start(ni, nj, nk)
   integer, intent(in) :: mask(ni, nj, nk)
   double precision, intent(out) :: phi(ni, nj, nk), energy(limit, nk)
   integer, intent(out) :: iterations(nk), stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(level_set_options) :: options

   options = level_set_options(mu=weights(1), nu=weights(2), lambda=weights(3:4), &
      & epsilon=weights(5), dt=weights(6), tolerance=weights(7), spacing=spacing, &
      & iterations=limit)
   phi = start
   energy = 0.0d0
   iterations = 0
   call evolve(options, image, mask /= 0, phi, energy, iterations, error)
   call pack_error(error, stat, message)
end subroutine evolve_two_phase
