!> Nodal cells of a lattice: centres and moments, which no patch test sees; TAP for `meson test`.
program test_cells
   use rk_cells, only : cells_type
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type
   use rk_lattice, only : new_box
   use rk_nodal_cells, only : nodal_cells
   use rk_precision, only : wp
   use tap, only : check, finish
   implicit none

   !> Rounding of sums over some facets of bodies of the size 1 to 3
   real(wp), parameter :: tight = 1.0e-12_wp
   real(wp), parameter :: solid(3) = [1.0_wp, 2.0_wp, 1.5_wp]

   call test_moments
   call finish()

contains

!> Cells inside of a lattice are boxes of a spacing: their second moments are known
subroutine test_moments
   type(cloud_type) :: cloud
   type(cells_type) :: cells
   type(error_type), allocatable :: error
   real(wp) :: h(3), expected(3, 3), found(3, 3), volume
   integer :: d, q

   call new_box(cloud, solid, [5, 5, 5], [5, 5, 5])
   call nodal_cells(cells, cloud, error)
   h = solid/4.0_wp
   expected = 0.0_wp
   do d = 1, 3
      expected(d, d) = product(h)*h(d)**2/12.0_wp
   end do
   ! the source point in the middle, number 63 of 125
   q = findloc(cells%node, 63, dim=1)
   call check('a cell in the middle is centred at its source point', &
      & all(abs(cells%point(:, q) - 0.5_wp*solid) <= tight))
   ! rows of five are divided in both orders, so that the cell has a point in several groups
   found = 0.0_wp
   volume = 0.0_wp
   do q = 1, size(cells%node)
      if (cells%node(q) /= 63) cycle
      found = found + cells%moment(:, :, q)
      volume = volume + cells%weight(q)
   end do
   call check('its points have the volume of a box', abs(volume - product(h)) <= tight)
   call check('and its moments', all(abs(found - expected) <= tight))
   call check('and stand in eight groups', count(cells%node == 63) == 8)
   ! a corner has an eighth of it
   q = findloc(cells%node, 1, dim=1)
   call check('a corner has an eighth', abs(cells%weight(q) - product(h)/8.0_wp) <= tight)
   call check('centred a quarter of the spacing inside', all(abs(cells%point(:, q) - 0.25_wp*h) &
      & <= tight))
end subroutine test_moments

end program test_cells
