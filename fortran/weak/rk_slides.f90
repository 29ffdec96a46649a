!> Force on a side that slides, such as a plane of symmetry, where an adjacent side constrains the
!> same component.
!>
!> Support forces from work in a motion of source points are as accurate as the energy. A motion of
!> one side alone jumps at the corner, where the force has errors of the penalty and of the lifted
!> values. The motion used here continues on the adjacent side such that neither constant nor linear
!> tractions do work there: what remains is the force of the slide.
module rk_slides
   use rk_cells, only : cells_type
   use rk_cloud, only : cloud_type
   use rk_lattice, only : set_number
   use rk_nodal_cells, only : lattice_index
   use rk_precision, only : wp
   use rk_weak_conditions, only : surface_type
   implicit none
   private

   public :: moments, slides_on, slide_motion

   !> Number of lines of source points parallel to the slide that move
   integer, parameter :: lines = 3
   !> Least number of lines of a body: with fewer, motions in it and in a second solution on half of
   !> them would reach across it, with similar errors
   integer, parameter :: least_lines = 2*lines + 1
   !> A determinant below this share of its products is zero
   real(wp), parameter :: dependent = 1.0e-6_wp

contains

!> Component that a flat side of a lattice constrains if that is only its normal one, and
!> everywhere; 0 otherwise
pure integer function slides_on(cloud, surface, cells, side) result(i)
   type(cloud_type), intent(in) :: cloud
   type(surface_type), intent(in) :: surface
   type(cells_type), intent(in) :: cells
   integer, intent(in) :: side
   integer :: s

   i = 0
   if (.not. allocated(cloud%lattice) .or. size(surface%essential, 1) /= cloud%nd) return
   i = (side + 1)/2
   ! flat sides of an annulus have normals x and y, the others none
   if (cloud%polar) i = max(side - 2, 0)
   if (i == 0) return
   do s = 1, size(cells%set)
      if (cells%set(s) /= side) cycle
      if (count(surface%essential(:, s)) == 1 .and. surface%essential(i, s)) cycle
      i = 0
      return
   end do
end function slides_on

!> Motion of source points that is one on a slide, and in which neither constant nor linear
!> tractions on an adjacent side do work, shape (ns) [-]; zero in 3-D, and if that side does not
!> meet the slide, does not constrain its component everywhere, has too few points, or has a free
!> side at its other end, where the singular rim makes its tractions far from linear
function slide_motion(cloud, surface, cells, slide, i, other) result(motion)
   type(cloud_type), intent(in) :: cloud
   type(surface_type), intent(in) :: surface
   type(cells_type), intent(in) :: cells
   !> Side that slides, and its component
   integer, intent(in) :: slide, i
   !> Adjacent side
   integer, intent(in) :: other
   real(wp) :: motion(size(cloud%source, 2))
   real(wp) :: of_node(6, size(motion)), m(2, 0:lines - 1), share(0:lines - 1), scale, mean
   integer :: line(size(motion)), axis, end, index(3), k

   motion = 0.0_wp
   axis = (slide + 1)/2
   if (cloud%nd > 2 .or. (other + 1)/2 == axis .or. cloud%lattice(axis) < least_lines) return
   if (.not. any(cells%set == other)) return
   end = set_number(cloud%polar, axis, 0) + set_number(cloud%polar, axis, 1) - slide
   if (.not. any(any(surface%essential, dim=1) .and. cells%set == end)) return
   if (.not. all(surface%essential(i, :) .or. cells%set /= other)) return
   do k = 1, size(line)
      index = lattice_index(cloud, k)
      line(k) = index(axis)
      if (set_number(cloud%polar, axis, 0) /= slide) line(k) = cloud%lattice(axis) - 1 - line(k)
   end do
   of_node = moments(cells, surface, other, size(line))
   do k = 0, lines - 1
      m(:, k) = [sum(of_node(1, :), mask=line == k), sum(of_node(1 + i, :), mask=line == k)]
   end do
   scale = m(1, 1)*m(2, 2) - m(1, 2)*m(2, 1)
   if (abs(scale) <= dependent*(abs(m(1, 1)*m(2, 2)) + abs(m(1, 2)*m(2, 1)))) return
   share = [1.0_wp, (m(1, 2)*m(2, 0) - m(2, 2)*m(1, 0))/scale, &
      & (m(2, 1)*m(1, 0) - m(1, 1)*m(2, 0))/scale]
   where (line < lines) motion = share(line)
   ! what lies beyond a side follows its three nearest points
   of_node = moments(cells, surface, slide, size(line))
   mean = dot_product(of_node(1, :), motion)/sum(of_node(1, :))
   if (abs(mean) > dependent) motion = motion/mean
end function slide_motion

!> Integrals of shape functions over a side, times 1, x, y, x^2, x y and y^2, shape (6, ns)
!> [length], [length^2], [length^3]
function moments(cells, surface, side, ns) result(moment)
   type(cells_type), intent(in) :: cells
   type(surface_type), target, intent(in) :: surface
   integer, intent(in) :: side
   !> Number of points
   integer, intent(in) :: ns
   real(wp) :: moment(6, ns)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer :: k, s

   moment = 0.0_wp
   do s = 1, size(cells%set)
      if (cells%set(s) /= side) cycle
      call surface%shape%row(s, nodes, values)
      associate (x => cells%place(:, s))
         do k = 1, size(nodes)
            moment(:, nodes(k)) = moment(:, nodes(k)) + surface%area(s)*values(1, k) &
               & *[1.0_wp, x(1), x(2), x(1)**2, x(1)*x(2), x(2)**2]
         end do
      end associate
   end do
end function moments

end module rk_slides
