!> Nearest points by cell lists.
module rk_nearest
   use rk_error, only : error_type
   use rk_kernel, only : window_radial
   use rk_neighbours, only : find_neighbours, neighbour_type
   use rk_precision, only : i8, wp
   implicit none
   private

   public :: nearest_places

contains

!> The nearest of some points for each place; of equally near ones the first
subroutine nearest_places(point, place, nearest, error)
   !> Points, shape (nd, n) [length]
   real(wp), intent(in) :: point(:, :)
   !> Places, shape (nd, np) [length]
   real(wp), intent(in) :: place(:, :)
   !> Number of a point, shape (np)
   integer, allocatable, intent(out) :: nearest(:)
   !> Error handling: coordinates that are not finite
   type(error_type), allocatable, intent(out) :: error
   type(neighbour_type) :: found
   integer, allocatable :: open(:)
   real(wp) :: reach, extent, distance, least
   integer(i8) :: k
   integer :: i

   allocate (nearest(size(place, 2)), source=0)
   extent = norm2(maxval(point, dim=2) - minval(point, dim=2))
   ! most places find a few points within this reach, the others look farther
   reach = 2.0_wp*extent/real(size(point, 2), wp)**(1.0_wp/size(point, 1))
   do
      open = pack([(i, i=1, size(nearest))], nearest == 0)
      if (size(open) == 0) exit
      call find_neighbours(found, point, spread(spread(reach, 1, size(point, 1)), 2, &
         & size(point, 2)), place(:, open), window_radial, error)
      if (allocated(error)) return
      do i = 1, size(open)
         least = huge(1.0_wp)
         do k = found%offset(i) + 1, found%offset(i + 1)
            distance = sum((point(:, found%index(k)) - place(:, open(i)))**2)
            if (distance >= least) cycle
            least = distance
            nearest(open(i)) = found%index(k)
         end do
      end do
      reach = 2.0_wp*max(reach, epsilon(1.0_wp))
   end do
end subroutine nearest_places

end module rk_nearest
