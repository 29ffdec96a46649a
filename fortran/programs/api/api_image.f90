! Python boundary of the segmentation: plain arrays in, plain arrays out.

!> Evolve level sets slice by slice; the parameters are nu, epsilon, dt, tolerance, and weight is
!> zero for excluded voxels
subroutine evolve_level_sets(steering, mu, lambda, spacing, limit, ni, nj, nk, nchannel, &
   & nlevel, nregion, channels, weight, start, phi, energy, means, iterations, ended, &
   & stat, message)
   use rk_error, only : error_type, pack_error
   use rk_levelset, only : evolve => evolve_level_sets, level_set_options
   implicit none
   !f2py threadsafe
   integer, intent(in) :: limit, ni, nj, nk, nchannel, nlevel, nregion
   double precision, intent(in) :: steering(4), mu(nlevel), lambda(nchannel, nregion)
   double precision, intent(in) :: spacing(2), channels(ni, nj, nk, nchannel)
   double precision, intent(in) :: weight(ni, nj, nk), start(ni, nj, nk, nlevel)
   double precision, intent(out) :: phi(ni, nj, nk, nlevel), energy(limit + 1, nk)
   double precision, intent(out) :: means(nchannel, nregion, nk)
   integer, intent(out) :: iterations(nk), ended(nk), stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(level_set_options) :: options

   options = level_set_options(nu=steering(1), epsilon=steering(2), dt=steering(3), &
      & tolerance=steering(4), spacing=spacing, iterations=limit, mu=mu, lambda=lambda)
   phi = start
   energy = 0.0d0
   means = 0.0d0
   iterations = 0
   ended = 0
   call evolve(options, channels, weight, phi, energy, means, iterations, ended, error)
   call pack_error(error, stat, message)
end subroutine evolve_level_sets
