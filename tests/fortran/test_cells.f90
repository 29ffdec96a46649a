!> Cells of integration close around their points and fill the body; TAP for `meson test`.
program test_cells
   use rk_cells, only : cells_type
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type
   use rk_gauss_cells, only : gauss_cells
   use rk_lattice, only : jitter, new_annulus, new_box
   use rk_nodal_cells, only : nodal_cells
   use rk_precision, only : pi, wp
   use rk_scene, only : scene_type
   use tap, only : check, finish
   implicit none

   !> Rounding of sums over some hundred facets of bodies of the size 1 to 3
   real(wp), parameter :: tight = 1.0e-12_wp
   real(wp), parameter :: plane(2) = [2.0_wp, 3.0_wp], solid(3) = [1.0_wp, 2.0_wp, 1.5_wp]

   call test_nodal('lattice in the plane', plane, [4, 6], 0.0_wp)
   call test_nodal('lattice in space', solid, [3, 5, 4], 0.0_wp)
   call test_nodal('moved points in the plane', plane, [6, 7], 0.3_wp)
   call test_nodal('moved points in space', solid, [4, 5, 4], 0.3_wp)
   call test_gauss('Gauss cells in the plane', plane, [4, 6])
   call test_gauss('Gauss cells in space', solid, [3, 4, 4])
   call test_moments
   call test_tube
   call finish()

contains

!> Nodal cells of a box whose points may have left their lattice
subroutine test_nodal(name, edges, source, share)
   !> Name of the case
   character(len=*), intent(in) :: name
   !> Edge lengths, shape (nd) [length]
   real(wp), intent(in) :: edges(:)
   !> Source points in each direction, shape (nd)
   integer, intent(in) :: source(:)
   !> Largest move of a source point in spacings [-]
   real(wp), intent(in) :: share
   type(cloud_type) :: cloud
   type(cells_type) :: cells
   type(error_type), allocatable :: error
   integer :: i

   call new_box(cloud, edges, source, 2*source - 1)
   if (share > 0.0_wp) call jitter(cloud, share)
   call nodal_cells(cells, cloud, error)
   call check(name//': cells', .not. allocated(error))
   if (allocated(error)) return
   call check(name//': one for each source point', maxval(cells%node) == product(source) &
      & .and. all([(same_place(cells, i), i=1, product(source))]))
   call check(name//': in one group, but for rows of five', size(cells%node) == product(source) &
      & .or. any(source == 5))
   call check_box(name, cells, edges)
end subroutine test_nodal

!> Whether a source point has points of its cell, all of them at one place
logical function same_place(cells, node)
   !> Nodal cells
   type(cells_type), intent(in) :: cells
   !> Source point
   integer, intent(in) :: node
   integer :: q, first

   first = findloc(cells%node, node, dim=1)
   same_place = first > 0
   do q = 1, size(cells%node)
      if (cells%node(q) == node) same_place = same_place &
         & .and. all(abs(cells%point(:, q) - cells%point(:, first)) <= 0.0_wp)
   end do
end function same_place

!> Gauss cells between the source points of a box
subroutine test_gauss(name, edges, source)
   !> Name of the case
   character(len=*), intent(in) :: name
   !> Edge lengths, shape (nd) [length]
   real(wp), intent(in) :: edges(:)
   !> Source points in each direction, shape (nd)
   integer, intent(in) :: source(:)
   type(scene_type) :: scene
   type(cells_type) :: cells
   type(error_type), allocatable :: error

   call new_box(scene%cloud, edges, source, 2*source - 1)
   call third_order(scene)
   call gauss_cells(cells, scene, error)
   call check(name//': cells', .not. allocated(error))
   if (allocated(error)) return
   call check(name//': points in all', size(cells%weight) == product(source - 1)*3**size(edges))
   call check_box(name, cells, edges)
   call check(name//': lifted polynomials', lifts(cells))
end subroutine test_gauss

!> What holds of all cells of a box
subroutine check_box(name, cells, edges)
   !> Name of the case
   character(len=*), intent(in) :: name
   type(cells_type), intent(in) :: cells
   !> Edge lengths, shape (nd) [length]
   real(wp), intent(in) :: edges(:)
   real(wp), allocatable :: loop(:, :), tensor(:, :, :), volume(:), flux(:)
   real(wp) :: face
   integer :: c, d, k, nd, n, s
   logical :: good

   nd = size(edges)
   n = size(cells%weight)/cells%per_cell
   call check(name//': volumes are positive', all(cells%weight > 0.0_wp))
   call check(name//': and those of the body', abs(sum(cells%weight) - product(edges)) <= tight)
   call check(name//': groups hold all points and none is empty', cells%first(1) == 0 &
      & .and. cells%first(size(cells%first)) == size(cells%weight) &
      & .and. all(cells%first(2:) > cells%first(:size(cells%first) - 1)))
   call check(name//': normals of the surface sum to zero', &
      & all(abs(sum(cells%outward, dim=2)) <= tight))
   good = .true.
   do d = 1, nd
      face = product(edges)/edges(d)
      do k = 0, 1
         ! sets x0, x1, y0, y1, z0, z1: faces at 0 and at the edge's length, normals outward
         do s = 1, size(cells%set)
            if (cells%set(s) /= 2*d - 1 + k) cycle
            good = good .and. abs(cells%surface(d, s) - k*edges(d)) <= tight
         end do
         good = good .and. abs(sum(cells%outward(d, :), mask=cells%set == 2*d - 1 + k) &
            & - (2*k - 1)*face) <= tight
      end do
   end do
   call check(name//': each set is its face', good)

   ! facets close around each cell, and the integral of x outer N over them is the volume
   allocate (loop(nd, n), tensor(nd, nd, n), volume(n), flux(n), source=0.0_wp)
   do k = 1, size(cells%side, 2)
      do d = 1, 2
         c = cells%side(d, k)
         call add(cells%facet(:, k), (3 - 2*d)*cells%area(:, k), loop(:, c), tensor(:, :, c), &
            & flux(c))
      end do
   end do
   do s = 1, size(cells%set)
      c = 1 + (cells%lift_point(cells%lift_first(s) + 1) - 1)/cells%per_cell
      call add(cells%surface(:, s), cells%outward(:, s), loop(:, c), tensor(:, :, c), &
         & flux(c))
   end do
   volume = sum(reshape(cells%weight, [cells%per_cell, n]), dim=1)
   call check(name//': cells are closed', all(abs(loop) <= tight))
   good = .true.
   do c = 1, n
      do d = 1, nd
         tensor(d, d, c) = tensor(d, d, c) - volume(c)
      end do
      good = good .and. all(abs(tensor(:, :, c)) <= tight)
   end do
   call check(name//': facets tell the volume of each cell', good)
   call check(name//': facets integrate quadratic functions', all(abs(flux) <= tight))
end subroutine check_box

!> Add a facet to the sums of its cell
subroutine add(x, area, loop, tensor, flux)
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Area times outward normal, shape (nd) [length^(nd-1)]
   real(wp), intent(in) :: area(:)
   !> Sum of areas, shape (nd) [length^(nd-1)]
   real(wp), intent(inout) :: loop(:)
   !> Sum of x outer area, shape (nd, nd) [length^nd]
   real(wp), intent(inout) :: tensor(:, :)
   !> Flux of (x^2, -2 x y), which has no sources [length^(nd+1)]
   real(wp), intent(inout) :: flux

   flux = flux + x(1)**2*area(1) - 2.0_wp*x(1)*x(2)*area(2)
   loop = loop + area
   tensor = tensor + spread(x, 2, size(area))*spread(area, 1, size(x))
end subroutine add

!> Whether the lifting of each surface point integrates polynomials of degree 2 over its cell to
!> their values at that point
logical function lifts(cells)
   !> Gauss cells
   type(cells_type), intent(in) :: cells
   real(wp) :: x(size(cells%point, 1)), there(size(x))
   real(wp) :: total(3)
   integer :: k, q, s

   lifts = .true.
   do s = 1, size(cells%set)
      total = 0.0_wp
      there = cells%surface(:, s)
      do k = cells%lift_first(s) + 1, cells%lift_first(s + 1)
         q = cells%lift_point(k)
         x = cells%point(:, q)
         total = total + cells%weight(q)*cells%lift(k)*[1.0_wp, sum(x), x(1)*x(2)]
      end do
      lifts = lifts .and. all(abs(total - [1.0_wp, sum(there), there(1)*there(2)]) <= 1.0e-10_wp)
   end do
end function lifts

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

!> Functions of order three with as many Gauss points, and a surface without conditions
subroutine third_order(scene)
   type(scene_type), intent(inout) :: scene

   scene%galerkin%gauss = 3
   scene%approximation%order = 3
   allocate (scene%condition(0))
end subroutine third_order

!> Polar cells of a quarter of a tube
subroutine test_tube
   type(scene_type) :: scene
   type(cells_type) :: cells
   type(error_type), allocatable :: error
   integer :: d

   call new_annulus(scene%cloud, 1.0_wp, 2.0_wp, [4, 7], [7, 13])
   call third_order(scene)
   call gauss_cells(cells, scene, error)
   call check('tube: cells', .not. allocated(error))
   if (allocated(error)) return
   call check('tube: area of the quarter', abs(sum(cells%weight) - 0.75_wp*pi) <= tight)
   do d = 1, 2
      call check('tube: normals of the outer arc add up to its chord', &
         & abs(sum(cells%outward(d, :), mask=cells%set == 2) - 2.0_wp) <= tight)
   end do
   ! two Gauss points see the cosine of half a step h of the angle off by h^4/270
   call check('tube: length of the outer arc', abs(sum(norm2(cells%outward, dim=1), &
      & mask=cells%set == 2) - pi) <= pi*(pi/24.0_wp)**4/250.0_wp)
   call check('tube: the outer arc points outward', all(pack(sum(cells%outward*cells%surface, &
      & dim=1), cells%set == 2) > 0.0_wp))
   call check('tube: the inner one to the axis', all(pack(sum(cells%outward*cells%surface, &
      & dim=1), cells%set == 1) < 0.0_wp))
end subroutine test_tube

end program test_cells
