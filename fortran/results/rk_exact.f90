!> Exact homogeneous solutions for finite K: the deformation gradient for any material.
module rk_exact
   use, intrinsic :: ieee_arithmetic, only : ieee_is_nan, ieee_quiet_nan, ieee_value
   use rk_deck_records, only : exact_keys
   use rk_material, only : material_point, material_type
   use rk_precision, only : wp
   use rk_probes, only : quantity
   use rk_scene, only : scene_type
   use rk_states, only : point_state
   use rk_tensor, only : determinant
   implicit none
   private

   public :: exact_value

contains

!> Value of a probe at full load in an exact solution with the material of the first point; NaN if
!> there is none: a change of volume that K = inf excludes, or no free stretch
real(wp) function exact_value(scene, exact) result(value)
   type(scene_type), intent(in) :: scene
   !> Solution
   type(exact_keys), intent(in) :: exact
   type(point_state) :: local
   real(wp) :: pressure, values(3)
   integer :: i

   call exact_deformation(scene%tissue(scene%tissue_of(1))%material, exact%solution, &
      & exact%amount, scene%cloud%nd, local%f)
   local%j = determinant(local%f)
   value = local%j
   if (ieee_is_nan(value)) return
   associate (material => scene%tissue(scene%tissue_of(1))%material, nd => scene%cloud%nd)
      call material%stress(material_point(local%f, scene%cloud%fiber(:, 1), &
         & scene%activation_at(scene%tissue_of(1), 1.0_wp), .not. material%incompressible()), &
         & local%p)
      if (material%incompressible()) then
         if (abs(local%j - 1.0_wp) > sqrt(epsilon(1.0_wp))) then
            value = ieee_value(value, ieee_quiet_nan)
            return
         end if
         ! pressure that makes the last direction stress-free, as finite K does; not in simple shear
         if (exact%solution /= 'simple_shear') then
            pressure = -local%p(nd, nd)*local%f(nd, nd)
            do i = 1, 3
               local%p(i, i) = local%p(i, i) + pressure/local%f(i, i)
            end do
         end if
      end if
   end associate
   local%cauchy = matmul(local%p, transpose(local%f))/local%j
   values = quantity(scene%probe(exact%probe)%quantity, local)
   value = values(1)
end function exact_value

!> Deformation gradient of a homogeneous solution
subroutine exact_deformation(material, solution, amount, nd, f)
   class(material_type), intent(in) :: material
   !> simple_shear, uniaxial, equibiaxial or dilation
   character(len=*), intent(in) :: solution
   !> Shear or stretch [-]
   real(wp), intent(in) :: amount
   !> Space dimension; in 2-D the third direction is not stretched
   integer, intent(in) :: nd
   !> F(i, A) [-]
   real(wp), intent(out) :: f(3, 3)
   integer :: i

   f = 0.0_wp
   do i = 1, 3
      f(i, i) = 1.0_wp
   end do
   select case (solution)
   case ('simple_shear')
      f(1, 2) = amount
   case ('uniaxial')
      f(1, 1) = amount
      call free_stretch(material, f, 2, nd)
   case ('equibiaxial')
      f(1, 1) = amount
      f(2, 2) = amount
      if (nd == 3) call free_stretch(material, f, 3, nd)
   case ('dilation')
      do i = 1, nd
         f(i, i) = amount
      end do
   end select
end subroutine exact_deformation

!> Stretch of directions first..nd that makes them free of stress, by bisection in its logarithm;
!> NaN if there is none
subroutine free_stretch(material, f, first, nd)
   class(material_type), intent(in) :: material
   !> Diagonal deformation gradient; the free entries are set [-]
   real(wp), intent(inout) :: f(3, 3)
   !> First free direction
   integer, intent(in) :: first
   !> Last free direction
   integer, intent(in) :: nd
   real(wp) :: low, high, middle
   integer :: k

   ! bracket around the incompressible stretch
   middle = -log(product([(f(k, k), k=1, first - 1)]))/(nd - first + 1)
   if (material%incompressible()) then
      do k = first, nd
         f(k, k) = exp(middle)
      end do
      return
   end if
   low = middle - 1.0_wp
   high = middle + 1.0_wp
   if (stress_at(low)*stress_at(high) > 0.0_wp) then
      f(first, first) = ieee_value(middle, ieee_quiet_nan)
      return
   end if
   do k = 1, 80
      middle = 0.5_wp*(low + high)
      if (stress_at(low)*stress_at(middle) <= 0.0_wp) then
         high = middle
      else
         low = middle
      end if
   end do
   high = stress_at(0.5_wp*(low + high))

contains

   !> Stress in the free direction
   real(wp) function stress_at(logarithm)
      real(wp), intent(in) :: logarithm
      real(wp) :: p(3, 3)
      integer :: i
      do i = first, nd
         f(i, i) = exp(logarithm)
      end do
      call material%stress(material_point(f), p)
      stress_at = p(nd, nd)
   end function stress_at

end subroutine free_stretch

end module rk_exact
