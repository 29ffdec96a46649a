!> State of the material at one place, for output.
module rk_point_state
   use rk_precision, only : wp
   implicit none
   private

   public :: point_state

   !> State at one place
   type :: point_state
      !> Undeformed place [length]
      real(wp) :: x(3) = 0.0_wp
      !> Displacement [length]
      real(wp) :: u(3) = 0.0_wp
      !> Deformation gradient F(i, A) [-]
      real(wp) :: f(3, 3) = 0.0_wp
      !> Volume ratio [-]
      real(wp) :: j = 1.0_wp
      !> First Piola-Kirchhoff stress P(i, A) [stress]
      real(wp) :: p(3, 3) = 0.0_wp
      !> Cauchy stress [stress]
      real(wp) :: cauchy(3, 3) = 0.0_wp
   end type point_state

end module rk_point_state
