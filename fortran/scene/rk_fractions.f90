!> Fractions of tissues at given positions, and the points whose fibers a tissue has there.
module rk_fractions
   use rk_error, only : error_type
   use rk_neighbours, only : all_nearest, nearest_points
   use rk_place_shape, only : on_plane
   use rk_precision, only : wp
   use rk_scene, only : last_part, scene_type
   use rk_shape, only : shape_type
   implicit none
   private

   public :: own_parts, parts_at, shares, fractions, has_fibers, fibered_points

   !> Fractions below this are set to zero [-]
   real(wp), parameter :: nothing = 1.0e-8_wp
   !> Offset beyond a plane on which tissues meet, in supports, at which the tissue is evaluated [-]
   real(wp), parameter :: beyond = 1.0e-7_wp

contains

!> Fractions of the tissues at a collocation point
pure function own_parts(scene, ip) result(part)
   type(scene_type), intent(in) :: scene
   !> Collocation point
   integer, intent(in) :: ip
   real(wp) :: part(size(scene%tissue))

   if (allocated(scene%tissue_part)) then
      part = scene%tissue_part(:, ip)
   else if (size(part) == 1) then
      part = 1.0_wp
   else
      part = 0.0_wp
      part(scene%tissue_of(ip)) = 1.0_wp
   end if
end function own_parts

!> Fractions of the tissues at a position of a body whose tissues are given by regions: 0 or 1; on a
!> plane on which they meet those beyond it, the side of the derivatives of shape functions
subroutine parts_at(scene, place, part, error)
   type(scene_type), intent(in) :: scene
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: place(:)
   real(wp), intent(out) :: part(:)
   !> Error handling: an expression without a value there
   type(error_type), allocatable, intent(inout) :: error
   real(wp) :: x(size(place))
   integer :: k, planes

   x = place
   planes = 0
   if (allocated(scene%approximation%kink)) planes = size(scene%approximation%kink)
   do k = 1, planes
      associate (a => scene%approximation%kink_axis(k), at => scene%approximation%kink(k), &
         & here => scene%approximation%across(k, place))
         if (.not. abs(here - at) < on_plane*maxval(scene%support(a, :))) cycle
         if (scene%cloud%polar) then
            x = place/here*(at + beyond*maxval(scene%support(a, :)))
         else
            x(a) = at + beyond*maxval(scene%support(a, :))
         end if
      end associate
   end do
   part = 0.0_wp
   k = last_part(scene%tissue, x, error)
   if (k > 0) part(k) = 1.0_wp
end subroutine parts_at

!> Fractions of the tissues that belong to each source point
function shares(scene) result(share)
   type(scene_type), intent(in) :: scene
   real(wp), allocatable :: share(:, :)
   real(wp) :: volume(size(scene%cloud%source, 2)), part
   integer, allocatable :: near(:, :), owner(:, :)
   integer :: ip, is, k, n

   allocate (share(size(scene%tissue), size(volume)), source=0.0_wp)
   volume = 0.0_wp
   if (allocated(scene%tissue_part)) then
      owner = scene%cloud%nearest_sources()
      do ip = 1, size(owner, 2)
         n = count(owner(:, ip) > 0)
         part = scene%cloud%volume(ip)/n
         do k = 1, n
            associate (at => owner(k, ip))
               volume(at) = volume(at) + part
               share(:, at) = share(:, at) + part*scene%tissue_part(:, ip)
            end associate
         end do
      end do
   end if
   call all_nearest(scene%cloud%points, scene%cloud%source, near)
   do is = 1, size(volume)
      if (volume(is) > 0.0_wp) then
         share(:, is) = share(:, is)/volume(is)
      else
         n = count(near(:, is) > 0)
         do k = 1, n
            share(:, is) = share(:, is) + own_parts(scene, near(k, is))/n
         end do
      end if
   end do
end function shares

!> Fractions of all tissues at a position with their gradients
subroutine fractions(shape, share, ip, part, gradient)
   !> Shape functions of order 0
   type(shape_type), target, intent(in) :: shape
   !> Fractions that belong to each source point, shape (nt, ns) [-]
   real(wp), intent(in) :: share(:, :)
   !> Index of the position
   integer, intent(in) :: ip
   !> Fractions, shape (nt) [-]
   real(wp), intent(out) :: part(:)
   !> Gradients, shape (3, nt) [1/length]
   real(wp), intent(out) :: gradient(:, :)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer :: j, k

   part = 0.0_wp
   gradient = 0.0_wp
   call shape%row(ip, nodes, values)
   do j = 1, size(nodes)
      do k = 1, size(part)
         part(k) = part(k) + share(k, nodes(j))*values(1, j)
         gradient(:shape%nd, k) = gradient(:shape%nd, k) &
            & + share(k, nodes(j))*values(2:1 + shape%nd, j)
      end do
   end do
   where (part < nothing) part = 0.0_wp
end subroutine fractions

!> Whether a tissue has fibers at a collocation point
pure logical function has_fibers(scene, k, at)
   type(scene_type), intent(in) :: scene
   !> Tissue
   integer, intent(in) :: k
   !> Collocation point
   integer, intent(in) :: at

   has_fibers = scene%tissue(k)%material%fibered
   if (has_fibers .and. scene%basis%interface_fibers == 'own') &
      & has_fibers = scene%tissue(scene%tissue_of(at))%material%fibered
end function has_fibers

!> For each collocation point, the one whose fibers a tissue has there: the point itself, or the
!> nearest of the tissue
function fibered_points(scene, k) result(at)
   type(scene_type), intent(in) :: scene
   !> Tissue with fibers
   integer, intent(in) :: k
   integer :: at(size(scene%tissue_of))
   integer, allocatable :: own(:), other(:)
   integer :: ip

   at = [(ip, ip=1, size(at))]
   own = pack(at, scene%tissue_of == k)
   other = pack(at, scene%tissue_of /= k)
   if (size(own) == 0) return
   at(other) = own(nearest_points(scene%cloud%points(:, own), scene%cloud%points(:, other)))
end function fibered_points

end module rk_fractions
