!> Gradients of fiber directions that vary from point to point.
!>
!> P depends on the position through F and through the fiber direction N, so that
!>    P_iA,A = C4_iAkC u_k,CA + dP_iA/dN_k N_k,A.
!> The second term is the pull of fibers that converge or bend; without it a pennate muscle is out
!> of balance by the spread of its fibers. N and -N are the same fiber: the slope is that of the
!> tensor N N, of which N_k,A = (N_k N_l),A N_l because N has unit length.
module rk_fiber_gradient
   use rk_csr, only : csr_type
   use rk_error, only : error_type
   use rk_kernel, only : window_product
   use rk_neighbours, only : find_neighbours
   use rk_precision, only : i8, wp
   use rk_scene, only : scene_type
   use rk_tensor, only : solve_definite
   implicit none
   private

   public :: fiber_gradients

   !> Window of the fit in source spacings: the resolution of the unknowns; noise is averaged out
   real(wp), parameter :: reach = 1.5_wp
   !> Share of the squared distances added to each direction of the fit, so that the slope is zero
   !> in a direction in which a point has no neighbours
   real(wp), parameter :: damping = 1.0e-8_wp
   !> Turn over a window below which fibers count as parallel [-]
   real(wp), parameter :: rounding = 1.0e-9_wp

contains

!> Slopes of the fiber directions, from a linear fit to the surrounding fibers of the same tissue
subroutine fiber_gradients(scene, slope, error)
   !> Scene with fibers and tissues
   type(scene_type), intent(in) :: scene
   !> N_k,A of each collocation point, shape (3, nd, nc) [1/length]; not allocated if no form or no
   !> tissue needs them
   real(wp), allocatable, intent(out) :: slope(:, :, :)
   type(error_type), allocatable, intent(out) :: error
   type(csr_type) :: near
   real(wp), allocatable :: window(:, :)
   integer :: ip, nc, nd

   ! weak forms contain no derivatives of the stress
   if (index(scene%method, 'rkcm') /= 1 .or. .not. any(abs(scene%cloud%fiber) > 0.0_wp)) return
   associate (cloud => scene%cloud)
      nc = size(cloud%points, 2)
      nd = cloud%nd
      allocate (window, source=reach*cloud%spacing(:, cloud%nearest_source()))
      call find_neighbours(near, cloud%points, window, cloud%points, window_product, error)
      if (allocated(error)) return
      allocate (slope(3, nd, nc))
      do ip = 1, nc
         slope(:, :, ip) = fitted_slope(scene, window, &
            & near%index(near%offset(ip) + 1_i8:near%offset(ip + 1)), ip)
      end do
   end associate
end subroutine fiber_gradients

!> Slope at one point
pure function fitted_slope(scene, window, near, ip) result(slope)
   type(scene_type), intent(in) :: scene
   !> Half widths of the windows, shape (nd, nc) [length]
   real(wp), intent(in) :: window(:, :)
   !> Points whose windows cover this one
   integer, intent(in) :: near(:)
   !> Point
   integer, intent(in) :: ip
   real(wp) :: slope(3, size(window, 1))
   !> One and the distance in windows, their products, and those with (N N) n of the neighbours
   real(wp) :: x(0:size(window, 1)), moment(0:size(window, 1), 0:size(window, 1))
   real(wp) :: right(0:size(window, 1), 3), n(3), w
   integer :: j, d, nd

   nd = size(window, 1)
   n = scene%cloud%fiber(:, ip)
   moment = 0.0_wp
   right = 0.0_wp
   do j = 1, size(near)
      if (scene%tissue_of(near(j)) /= scene%tissue_of(ip)) cycle
      x(0) = 1.0_wp
      x(1:) = (scene%cloud%points(:, near(j)) - scene%cloud%points(:, ip))/window(:, ip)
      w = product(max(1.0_wp - abs(x(1:)), 0.0_wp))
      associate (fiber => scene%cloud%fiber(:, near(j)))
         do d = 0, nd
            moment(:, d) = moment(:, d) + w*x(d)*x
            right(d, :) = right(d, :) + w*x(d)*fiber*dot_product(fiber, n)
         end do
      end associate
   end do
   w = damping*sum([(moment(d, d), d=1, nd)]) + tiny(1.0_wp)
   do d = 1, nd
      moment(d, d) = moment(d, d) + w
   end do
   call solve_definite(moment, right)
   do d = 1, nd
      slope(:, d) = right(d, :)/window(d, ip)
      ! a unit vector only rotates
      slope(:, d) = slope(:, d) - n*dot_product(n, slope(:, d))
   end do
   where (abs(slope) < rounding/maxval(window(:, ip))) slope = 0.0_wp
end function fitted_slope

end module rk_fiber_gradient
