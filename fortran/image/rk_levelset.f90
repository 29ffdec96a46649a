!> Two-phase active contours without edges, slice by slice.
!>
!> Every slice is an independent two-dimensional problem: a level set phi, positive inside,
!> minimises the energy (3.12) by the semi-implicit scheme (A.1), (A.2) with the neighbours of
!> the previous iterate, so the result knows no direction of sweeping. Pixels outside the mask
!> take no part; the flux to a neighbour outside the mask is left out.
!>
!> References: 1. Chan, Vese, IEEE Trans. Image Process. 10 (2001), doi:10.1109/83.902291;
!> equation numbers are those of the thesis named in the README.
module rk_levelset
   use rk_error, only : error_type, fatal_error, err_input
   use rk_precision, only : wp, pi
   use rk_text, only : to_text
   implicit none
   private

   public :: level_set_options, evolve_two_phase

   !> Weights of the energy and steering of the iteration
   type :: level_set_options
      !> Weight of the contour's length, >= 0 [-]
      real(wp) :: mu = 0.01_wp
      !> Weight of the area inside [-]
      real(wp) :: nu = 0.0_wp
      !> Weights of the misfit inside and outside, > 0 [-]
      real(wp) :: lambda(2) = 1.0_wp
      !> Width of the regularised step function, > 0 [-]
      real(wp) :: epsilon = 0.5_wp
      !> Artificial time step, > 0 [-]
      real(wp) :: dt = 50.0_wp
      !> Pixel sizes, > 0 [pixel]
      real(wp) :: spacing(2) = 1.0_wp
      !> Largest part of the pixels that may change sides in `window` iterations [-]
      real(wp) :: tolerance = 1.0e-4_wp
      !> Largest number of iterations
      integer :: iterations = 300
   end type level_set_options

   !> Iterations between two looks at the labels
   integer, parameter :: window = 10
   !> Smallest gradient that counts: keeps flat places from dividing by zero [1/pixel]
   real(wp), parameter :: flat = 1.0e-4_wp

contains

!> Evolve the level sets of all slices until their labels rest
subroutine evolve_two_phase(options, image, mask, phi, energy, iterations, error)
   !> Weights and steering
   type(level_set_options), intent(in) :: options
   !> Grey values, shape (columns, rows, slices) [-]
   real(wp), intent(in) :: image(:, :, :)
   !> Pixels that take part, same shape
   logical, intent(in) :: mask(:, :, :)
   !> Level sets, same shape; first guess in, result out [-]
   real(wp), intent(inout) :: phi(:, :, :)
   !> Energy (3.12) of the iterate before each iteration, shape (options%iterations, slices);
   !> entries after the last iteration repeat the last one [-]
   real(wp), intent(out) :: energy(:, :)
   !> Iterations done, shape (slices); 0 for a slice without pixels
   integer, intent(out) :: iterations(:)
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer :: k

   call check_options(options, error)
   if (allocated(error)) return
   if (any(shape(image) /= shape(phi)) .or. any(shape(image) /= shape(mask)) .or. &
      size(energy, 1) /= options%iterations .or. size(energy, 2) /= size(image, 3) .or. &
      size(iterations) /= size(image, 3)) then
      call fatal_error(error, err_input, "Image, mask, level set and records of the "// &
         "segmentation must have matching shapes")
      return
   end if
   do k = 1, size(image, 3)
      if (any(mask(:, :, k) .and. .not. (abs(image(:, :, k)) <= huge(1.0_wp) .and. &
         abs(phi(:, :, k)) <= huge(1.0_wp)))) then
         call fatal_error(error, err_input, "Slice "//to_text(k - 1)// &
            " has values that are not finite inside the mask")
         return
      end if
   end do

   !$omp parallel do default(none) schedule(dynamic) private(k) &
   !$omp shared(options, image, mask, phi, energy, iterations)
   do k = 1, size(image, 3)
      call evolve_slice(options, image(:, :, k), mask(:, :, k), phi(:, :, k), energy(:, k), &
         iterations(k))
   end do
   !$omp end parallel do
end subroutine evolve_two_phase

!> Refuse impossible parameters
subroutine check_options(options, error)
   !> Weights and steering
   type(level_set_options), intent(in) :: options
   !> Error handling
   type(error_type), allocatable, intent(out) :: error

   if (.not. options%mu >= 0.0_wp) then
      call fatal_error(error, err_input, "mu must not be negative, not "//to_text(options%mu))
   else if (.not. all(options%lambda > 0.0_wp)) then
      call fatal_error(error, err_input, "lambda1 and lambda2 must be positive, not "// &
         to_text(options%lambda))
   else if (.not. options%epsilon > 0.0_wp) then
      call fatal_error(error, err_input, "epsilon must be positive, not "// &
         to_text(options%epsilon))
   else if (.not. options%dt > 0.0_wp) then
      call fatal_error(error, err_input, "dt must be positive, not "//to_text(options%dt))
   else if (.not. all(options%spacing > 0.0_wp)) then
      call fatal_error(error, err_input, "Pixel sizes must be positive, not "// &
         to_text(options%spacing))
   else if (options%iterations < 1) then
      call fatal_error(error, err_input, "iterations must be at least 1, not "// &
         to_text(options%iterations))
   end if
end subroutine check_options

!> Evolve the level set of one slice
subroutine evolve_slice(options, image, mask, phi, energy, iterations)
   !> Weights and steering
   type(level_set_options), intent(in) :: options
   !> Grey values, shape (columns, rows) [-]
   real(wp), intent(in) :: image(:, :)
   !> Pixels that take part, same shape
   logical, intent(in) :: mask(:, :)
   !> Level set, same shape [-]
   real(wp), intent(inout) :: phi(:, :)
   !> Energy before each iteration, shape (options%iterations) [-]
   real(wp), intent(out) :: energy(:)
   !> Iterations done
   integer, intent(out) :: iterations
   real(wp), allocatable :: old(:, :)
   logical, allocatable :: inside(:, :), looked(:, :)
   integer :: iteration, ni, nj
   real(wp) :: c(2)

   energy = 0.0_wp
   iterations = 0
   if (.not. any(mask)) return

   ni = size(image, 1)
   nj = size(image, 2)
   allocate (old(0:ni + 1, 0:nj + 1), source=0.0_wp)
   allocate (inside(0:ni + 1, 0:nj + 1), source=.false.)
   inside(1:ni, 1:nj) = mask
   looked = phi > 0.0_wp

   do iteration = 1, options%iterations
      iterations = iteration
      old(1:ni, 1:nj) = phi
      call region_means(options%epsilon, image, mask, phi, c)
      call sweep(options, c, image, inside, old, phi, energy(iteration))
      if (modulo(iteration, window) /= 0) cycle
      if (count(mask .and. (looked .neqv. phi > 0.0_wp)) <= &
         options%tolerance*count(mask)) exit
      looked = phi > 0.0_wp
   end do
   energy(iterations + 1:) = energy(iterations)
end subroutine evolve_slice

!> Mean grey values inside and outside, (3.13) and (3.14)
pure subroutine region_means(epsilon, image, mask, phi, c)
   !> Width of the regularised step [-]
   real(wp), intent(in) :: epsilon
   !> Grey values, shape (columns, rows) [-]
   real(wp), intent(in) :: image(:, :)
   !> Pixels that take part, same shape
   logical, intent(in) :: mask(:, :)
   !> Level set, same shape [-]
   real(wp), intent(in) :: phi(:, :)
   !> Means inside and outside, shape (2) [-]
   real(wp), intent(out) :: c(2)
   integer :: i, j
   real(wp) :: h, total(2), weight(2)

   total = 0.0_wp
   weight = 0.0_wp
   do j = 1, size(image, 2)
      do i = 1, size(image, 1)
         if (.not. mask(i, j)) cycle
         h = step(phi(i, j), epsilon)
         total = total + [h, 1.0_wp - h]*image(i, j)
         weight = weight + [h, 1.0_wp - h]
      end do
   end do
   c = total/max(weight, tiny(1.0_wp))
end subroutine region_means

!> One iteration of (A.1) and the energy (3.12) of the old level set
pure subroutine sweep(options, c, image, inside, old, new, energy)
   !> Weights and steering
   type(level_set_options), intent(in) :: options
   !> Means inside and outside, shape (2) [-]
   real(wp), intent(in) :: c(2)
   !> Grey values, shape (columns, rows) [-]
   real(wp), intent(in) :: image(:, :)
   !> Pixels that take part with a ring of .false. around, shape (0:columns+1, 0:rows+1)
   logical, intent(in) :: inside(0:, 0:)
   !> Level set before, shape (0:columns+1, 0:rows+1) [-]
   real(wp), intent(in) :: old(0:, 0:)
   !> Level set after, shape (columns, rows); untouched outside the mask [-]
   real(wp), intent(inout) :: new(:, :)
   !> Energy of the old level set [-]
   real(wp), intent(out) :: energy
   integer :: i, j
   real(wp) :: centre, east, west, north, south, delta, h, misfit(2), pull(4), hx, hy

   hx = options%spacing(1)
   hy = options%spacing(2)
   energy = 0.0_wp
   do j = 1, size(image, 2)
      do i = 1, size(image, 1)
         if (.not. inside(i, j)) cycle
         centre = old(i, j)
         east = merge(old(i + 1, j), centre, inside(i + 1, j))
         west = merge(old(i - 1, j), centre, inside(i - 1, j))
         north = merge(old(i, j + 1), centre, inside(i, j + 1))
         south = merge(old(i, j - 1), centre, inside(i, j - 1))

         delta = options%epsilon/(pi*(options%epsilon**2 + centre**2))
         h = step(centre, options%epsilon)
         misfit = options%lambda*(image(i, j) - c)**2
         energy = energy + hx*hy*(options%nu*h + misfit(1)*h + misfit(2)*(1.0_wp - h) + &
            options%mu*delta*hypot((east - west)/(2.0_wp*hx), (north - south)/(2.0_wp*hy)))

         ! Weights of the four neighbours: mu/(h^2 A), B, C, D of (A.2)
         pull(1) = slope((east - centre)/hx, (north - south)/(2.0_wp*hy))
         pull(2) = slope((centre - west)/hx, (beside(i - 1, j + 1, west) - &
            beside(i - 1, j - 1, west))/(2.0_wp*hy))
         pull(3) = slope((east - west)/(2.0_wp*hx), (north - centre)/hy)
         pull(4) = slope((beside(i + 1, j - 1, south) - beside(i - 1, j - 1, south))/ &
            (2.0_wp*hx), (centre - south)/hy)
         pull = options%dt*delta*options%mu/(pull*[hx, hx, hy, hy]**2)
         where (.not. [inside(i + 1, j), inside(i - 1, j), inside(i, j + 1), inside(i, j - 1)]) &
            pull = 0.0_wp

         new(i, j) = (centre + pull(1)*east + pull(2)*west + pull(3)*north + pull(4)*south + &
            options%dt*delta*(misfit(2) - misfit(1) - options%nu))/(1.0_wp + sum(pull))
      end do
   end do

contains

   !> Value of a diagonal neighbour, or of the side it lies beyond when it takes no part
   pure real(wp) function beside(ip, jp, side)
      !> Place of the neighbour
      integer, intent(in) :: ip, jp
      !> Value to use instead [-]
      real(wp), intent(in) :: side

      beside = merge(old(ip, jp), side, inside(ip, jp))
   end function beside

   !> Length of a gradient, kept away from zero
   pure real(wp) function slope(gx, gy)
      !> Components [1/pixel]
      real(wp), intent(in) :: gx, gy

      slope = sqrt(gx**2 + gy**2 + flat**2)
   end function slope

end subroutine sweep

!> Regularised step function (3.16)
elemental real(wp) function step(z, epsilon)
   !> Level set [-]
   real(wp), intent(in) :: z
   !> Width [-]
   real(wp), intent(in) :: epsilon

   step = 0.5_wp + atan(z/epsilon)/pi
end function step

end module rk_levelset
