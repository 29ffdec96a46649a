!> Force through a plane section of the body, as work: that of the internal forces in a motion of
!> one side against the other.
!>
!> Source points move by a share that grows from 0 to 1 within one spacing across the plane. In
!> equilibrium the work is exactly that of all forces behind it, however coarse the points are.
module rk_section
   use rk_kernel, only : window_polar
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   implicit none
   private

   public :: cut_through

contains

!> Share of each source point in the motion. No surface point at the ends of the body may see the
!> cut: near an end the plane is taken farther inside, and where there is no such room, the share
!> grows all the way through the body
function cut_through(scene, place, normal) result(share)
   !> Scene
   type(scene_type), intent(in) :: scene
   !> Point of the plane, shape (nd) [length]
   real(wp), intent(in) :: place(:)
   !> Its unit normal, shape (nd)
   real(wp), intent(in) :: normal(:)
   !> Share, 0 before the plane and 1 behind it, shape (ns) [-]
   real(wp), allocatable :: share(:)
   real(wp) :: first, last, margin, middle, width

   associate (cloud => scene%cloud)
      share = matmul(normal, cloud%source)
      first = minval(share)
      last = maxval(share)
      width = dot_product(abs(normal), sum(cloud%spacing, dim=2))/size(share)
      margin = dot_product(abs(normal), maxval(scene%support, dim=2))
      ! supports that turn reach as far as their corners
      if (scene%approximation%window == window_polar) margin = norm2(maxval(scene%support, dim=2))
      margin = margin - 0.5_wp*width
      middle = dot_product(normal, place)
      if (last - first >= 2.0_wp*margin) then
         middle = min(max(middle, first + margin), last - margin)
      else
         middle = 0.5_wp*(first + last)
         width = last - first
      end if
      share = min(max(0.5_wp + (share - middle)/width, 0.0_wp), 1.0_wp)
   end associate
end function cut_through

end module rk_section
