!> Functions that run out at the sides of a lattice; TAP for `meson test`.
program test_margin
   use rk_error, only : error_type
   use rk_margin, only : margin_type, new_margin
   use rk_precision, only : wp
   use rk_shape, only : approximation_type, new_approximation, new_shape, shape_type
   use tap, only : check, finish
   implicit none

   !> Graded lattice of 4 x 5 points, the last axis fastest
   real(wp), parameter :: x(4) = [0.0_wp, 0.8_wp, 1.8_wp, 3.0_wp]
   real(wp), parameter :: y(5) = [0.0_wp, 0.5_wp, 1.0_wp, 1.4_wp, 2.0_wp]
   real(wp), parameter :: small = 1.0e-6_wp
   type(approximation_type) :: spline
   type(margin_type) :: margin
   type(shape_type) :: shape
   type(error_type), allocatable :: error
   real(wp) :: source(2, 20), support(2, 20), place(2, 5), field(3, 6)
   integer, pointer, contiguous :: nodes(:)
   real(wp), pointer, contiguous :: values(:, :)
   integer :: i, j

   do i = 1, 4
      do j = 1, 5
         source(:, 5*(i - 1) + j) = [x(i), y(j)]
      end do
   end do
   support(1, :) = 2.0_wp
   support(2, :) = 1.0_wp
   call new_approximation(spline, 1, 'cubic', 'product', error)
   ! a corner, its neighbourhood with differences in x, a side and the inside
   place(:, 1) = [0.0_wp, 0.0_wp]
   place(:, 2) = [0.3_wp, 0.1_wp]
   place(:, 3) = [0.3_wp + small, 0.1_wp]
   place(:, 4) = [3.0_wp, 1.2_wp]
   place(:, 5) = [1.7_wp, 1.1_wp]

   call new_margin(margin, [4, 5], source, support)
   call new_shape(shape, spline, source, support, place, error, margin=margin)
   call check('no error', .not. allocated(error))
   do i = 1, 5
      call shape%row(i, nodes, values)
      call check('neighbours ascend', all(nodes(2:) > nodes(:size(nodes) - 1)))
      call shape%interpolate(i, pack(spread([1.0_wp], 1, 20), .true.), 1, 6, field(1:1, :))
      call shape%interpolate(i, reshape(source, [40]), 1, 6, field(2:3, :))
      call check('linear fields are reproduced', all(abs(field(1, :) - [1, 0, 0, 0, 0, 0]) &
         & < 1e-12_wp) .and. all(abs(field(2:, 1) - place(:, i)) < 1e-12_wp) &
         & .and. all(abs(field(2:, 2:3) - reshape([1, 0, 0, 1], [2, 2])) < 1e-12_wp))
   end do
   call shape%interpolate(2, sin(source(1, :)*source(2, :)), 1, 6, field(1:1, :))
   call shape%interpolate(3, sin(source(1, :)*source(2, :)), 1, 6, field(2:2, :))
   call check('derivatives', abs((field(2, 1) - field(1, 1))/small - field(1, 2)) < 1e-6_wp &
      & .and. all(abs((field(2, 2:3) - field(1, 2:3))/small - field(1, 4:5)) < 1e-5_wp))
   ! with equal spacings the second derivative is constant in the outermost one
   source(1, :) = [((real(i, wp), j=1, 5), i=0, 3)]
   call new_margin(margin, [4, 5], source, support)
   call new_shape(shape, spline, source, support, place, error, margin=margin)
   call shape%interpolate(1, source(1, :)**3, 1, 6, field(1:1, :))
   call shape%interpolate(2, source(1, :)**3, 1, 6, field(2:2, :))
   call check('parabola', abs(field(1, 4) - field(2, 4)) < 1e-12_wp .and. field(1, 4) > 1.0_wp)
   ! no layer where materials meet within two spacings, or across two points
   call new_margin(margin, [4, 5], source, support, [1], [1.5_wp])
   call check('sides without layer', size(margin%count) == 4*7 &
      & .and. all(margin%count == merge(1, 3, margin%beyond == 0)))
   call new_margin(margin, [2, 5], source(:, :10), support(:, :10))
   call check('two points', size(margin%count) == 2*7)
   call finish()

end program test_margin
