!> Active contours without edges for any number of level sets and channels.
!>
!> n level sets divide an image into up to 2**n regions, which are uniform in each of N channels:
!> energy (3.29), (4.3) with the means (4.5). Special cases are one channel with one level set
!> (3.11)-(3.15) or several (3.24), and several channels with one level set (3.25)-(3.28). The steps
!> are those of Appendix A with the neighbours and the other level sets of the previous iterate, so
!> that the result depends neither on a direction of sweeping nor on the order of the level sets. A
!> step that would raise the energy is repeated with half the time step.
!>
!> References: 1. Chan, Vese, IEEE Trans. Image Process. 10 (2001), doi:10.1109/83.902291;
!> 2. Vese, Chan, Int. J. Comput. Vis. 50 (2002), doi:10.1023/A:1020874308076;
!> 3. Chan, Sandberg, Vese, J. Vis. Commun. Image R. 11 (2000), doi:10.1006/jvci.1999.0442;
!> equation numbers are those of the thesis named in the README.
module rk_levelset
   use rk_error, only : error_type, fatal_error, err_input
   use rk_levelset_rows, only : grid_type, new_grid, advance_row, sum_row
   use rk_precision, only : pi, wp
   implicit none
   private

   public :: level_set_options, evolve_level_sets

   !> Weights of the energy and parameters of the iteration; their defaults are in the deck schema
   type :: level_set_options
      !> Weight of the areas inside [-]
      real(wp) :: nu
      !> Width of the regularised step function, > 0 [-]
      real(wp) :: epsilon
      !> Maximum artificial time step, > 0 [-]
      real(wp) :: dt
      !> Pixel sizes, > 0 [-]
      real(wp) :: spacing(2)
      !> Part of the voxels that may still change region in `window` iterations at convergence [-]
      real(wp) :: tolerance
      !> Maximum number of iterations
      integer :: iterations
      !> Weight of the length of each level set's contour, >= 0, shape (level sets) [-]
      real(wp), allocatable :: mu(:)
      !> Weight of the misfit of each channel in each region, >= 0, shape (channels, regions): more
      !> than half of 2**n regions, up to 2**n [-]
      real(wp), allocatable :: lambda(:, :)
   end type level_set_options

   !> Why an evolution stopped: iterations used up, regions at rest, no step lowers the energy
   integer, parameter :: ended_at_limit = 0, ended_at_rest = 1, ended_lowest = 2
   !> Number of iterations between two checks of the regions
   integer, parameter :: window = 10
   !> Number of halvings of the time step after which the energy is taken as minimal
   integer, parameter :: halvings = 20

contains

!> Evolve the level sets of each slice until its regions come to rest
subroutine evolve_level_sets(options, channels, weight, phi, energy, means, iterations, ended, &
   error)
   type(level_set_options), intent(in) :: options
   !> Values, shape (columns, rows, slices, channels) [-]
   real(wp), intent(in) :: channels(:, :, :, :)
   !> Weights of the voxels' misfit, zero for voxels excluded, shape (columns, rows, slices)
   real(wp), intent(in) :: weight(:, :, :)
   !> Level sets, shape (columns, rows, slices, level sets); initial guess in, result out [-]
   real(wp), intent(inout) :: phi(:, :, :, :)
   !> Energy (3.29) at the start and after each iteration, shape (options%iterations+1, slices);
   !> entries after the last iteration repeat the last one [-]
   real(wp), intent(out) :: energy(:, :)
   !> Mean values, shape (channels, regions, slices); bit k of a region's number, both counted from
   !> zero, is set if it lies inside level set k + 1 [-]
   real(wp), intent(out) :: means(:, :, :)
   !> Iterations done, shape (slices); 0 for a slice without voxels
   integer, intent(out) :: iterations(:)
   !> Why each slice stopped: one of the `ended_` constants, shape (slices)
   integer, intent(out) :: ended(:)
   type(error_type), allocatable, intent(out) :: error
   integer :: k

   associate (regions => size(options%lambda, 2), most => 2**size(phi, 4))
      if (regions > most .or. 2*regions <= most) then
         call fatal_error(error, err_input, "More than half of the combinations of signs of "// &
            "the level sets must be regions of a segmentation, and none can be more than one")
         return
      end if
   end associate
   if (.not. (all(abs(channels) <= huge(1.0_wp)) .and. all(abs(phi) <= huge(1.0_wp)) .and. &
      all(weight >= 0.0_wp .and. weight <= huge(1.0_wp)))) then
      call fatal_error(error, err_input, "Channels, weights and level sets of a segmentation "// &
         "must be finite, the weights not negative")
      return
   end if

   !$omp parallel do default(none) schedule(dynamic) private(k) &
   !$omp shared(options, channels, weight, phi, energy, means, iterations, ended)
   do k = 1, size(channels, 3)
      call evolve_slice(options, channels(:, :, k, :), weight(:, :, k), phi(:, :, k, :), &
         energy(:, k), means(:, :, k), iterations(k), ended(k))
   end do
   !$omp end parallel do
end subroutine evolve_level_sets

!> Evolve the level sets of a slice
subroutine evolve_slice(options, channels, weight, phi, energy, means, iterations, ended)
   type(level_set_options), intent(in) :: options
   real(wp), intent(in), contiguous, target :: channels(:, :, :)
   !> Weights of the voxels, shape (columns, rows) [-]
   real(wp), intent(in), contiguous, target :: weight(:, :)
   !> Level sets, shape (columns, rows, level sets) [-]
   real(wp), intent(inout), contiguous, target :: phi(:, :, :)
   !> Energy at the start and after each iteration, shape (options%iterations+1) [-]
   real(wp), intent(out) :: energy(:)
   !> Mean values, shape (channels, regions) [-]
   real(wp), intent(out) :: means(:, :)
   integer, intent(out) :: iterations
   !> One of the `ended_` constants
   integer, intent(out) :: ended
   type(grid_type) :: grid
   !> Level sets and their step functions, shape (places, level sets), of two alternating iterates
   real(wp), allocatable :: level(:, :, :), inside(:, :, :)
   real(wp), pointer :: values(:, :), weights(:), image(:, :)
   logical, allocatable :: looked(:, :)
   real(wp), dimension(size(means, 1), size(means, 2)) :: lambda, next_means
   real(wp) :: dt, next_energy, lowest
   integer :: iteration, attempt, now, next, voxels, levels, n, row, first

   energy = 0.0_wp
   means = 0.0_wp
   iterations = 0
   ended = ended_at_rest
   call new_grid(grid, weight, options%spacing)
   voxels = nint(sum(grid%part))
   if (voxels == 0) return
   levels = size(phi, 3)
   values(1:size(weight), 1:size(channels, 3)) => channels
   weights(1:size(weight)) => weight
   image(1:size(weight), 1:levels) => phi
   n = size(phi, 1)
   allocate (level(grid%places, levels, 2), inside(grid%places, levels, 2), source=0.0_wp)
   do row = 1, size(grid%rows)
      first = n*(row - 1) + 1
      associate (to => first + grid%rows(row)%shift)
         level(to:to + n - 1, :, 1) = image(first:first + n - 1, :)
      end associate
   end do
   level(:, :, 2) = level(:, :, 1)

   now = 1
   next = 2
   dt = options%dt
   lambda = options%lambda/size(means, 1)
   call measure(options, grid, values, weights, level(:, :, now), inside(:, :, now), means, &
      energy(1))
   lowest = energy(1)
   looked = level(:, :, now) > 0.0_wp
   ended = ended_at_limit
   iterate: do iteration = 1, options%iterations
      iterations = iteration
      do attempt = 0, halvings
         do row = 1, size(grid%rows)
            if (grid%rows(row)%last < grid%rows(row)%first) cycle
            call advance_row(grid, grid%rows(row), options%mu, options%nu, options%epsilon, dt, &
               lambda, means, values, weights, level(:, :, now), inside(:, :, now), &
               level(:, :, next))
         end do
         call measure(options, grid, values, weights, level(:, :, next), inside(:, :, next), &
            next_means, next_energy)
         if (next_energy <= lowest) exit
         dt = 0.5_wp*dt
      end do
      if (.not. next_energy <= lowest) then
         energy(iteration + 1) = lowest
         ended = ended_lowest
         exit iterate
      end if
      if (attempt == 0) dt = min(2.0_wp*dt, options%dt)
      lowest = next_energy
      energy(iteration + 1) = lowest
      means = next_means
      now = next
      next = 3 - now
      if (modulo(iteration, window) /= 0) cycle
      if (count(any(looked .neqv. level(:, :, now) > 0.0_wp, dim=2)) <= &
         options%tolerance*voxels) then
         ended = ended_at_rest
         exit iterate
      end if
      looked = level(:, :, now) > 0.0_wp
   end do iterate
   energy(iterations + 2:) = lowest
   do row = 1, size(grid%rows)
      first = n*(row - 1) + 1
      associate (from => first + grid%rows(row)%shift)
         image(first:first + n - 1, :) = level(from:from + n - 1, :, now)
      end associate
   end do
end subroutine evolve_slice

!> Step functions, means (4.5) and energy (3.29) of level sets
subroutine measure(options, grid, values, weights, phi, inside, means, energy)
   type(level_set_options), intent(in) :: options
   type(grid_type), intent(in) :: grid
   real(wp), intent(in), contiguous :: values(:, :), weights(:)
   !> Level sets, shape (places, level sets) [-]
   real(wp), intent(in), contiguous :: phi(:, :)
   !> Their step functions, same shape [-]
   real(wp), intent(inout), contiguous :: inside(:, :)
   real(wp), intent(out) :: means(:, :)
   !> Energy with these means [-]
   real(wp), intent(out) :: energy
   real(wp), allocatable :: of_row(:, :)
   real(wp) :: sums(1 + size(means, 2)*(1 + 2*size(means, 1)))
   integer :: row, region, place, channels

   channels = size(means, 1)
   allocate (of_row(size(sums), size(grid%rows)), source=0.0_wp)
   do row = 1, size(grid%rows)
      associate (a => grid%rows(row)%first, b => grid%rows(row)%last)
         ! (3.16)
         inside(a:b, :) = 0.5_wp + atan(phi(a:b, :)/options%epsilon)/pi
      end associate
   end do
   do row = 1, size(grid%rows)
      if (grid%rows(row)%last < grid%rows(row)%first) cycle
      call sum_row(grid, grid%rows(row), options%mu, options%nu, &
         size(means, 2), values, weights, inside, of_row(:, row))
   end do
   sums = 0.0_wp
   do row = 1, size(grid%rows)
      sums = sums + of_row(:, row)
   end do

   energy = sums(1)
   do region = 1, size(means, 2)
      place = 2 + (region - 1)*(1 + 2*channels)
      associate (part => sums(place), first => sums(place + 1:place + channels), &
         square => sums(place + 1 + channels:place + 2*channels), lambda => options%lambda)
         means(:, region) = first/max(part, tiny(1.0_wp))
         ! sum of (u - c)^2, which is smallest for the mean c
         energy = energy + sum(lambda(:, region)*(square - first*means(:, region)))/channels
      end associate
   end do
   energy = energy*product(grid%spacing)
end subroutine measure

end module rk_levelset
