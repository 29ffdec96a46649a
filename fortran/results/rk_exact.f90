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

   public :: exact_value, has_solution

contains

!> Value of a probe at full load in an exact solution with the material of the first point; NaN if
!> there is none: a change of volume that K = inf excludes, or no free stretch
real(wp) function exact_value(scene, exact) result(value)
   type(scene_type), intent(in) :: scene
   !> Solution
   type(exact_keys), intent(in) :: exact
   !> Stresses below this share of the largest one are those of the bisection: 0
   real(wp), parameter :: nothing = 1.0e-9_wp
   type(point_state) :: local
   type(material_point) :: point
   real(wp) :: pressure, values(3)
   integer :: i

   associate (material => scene%tissue(scene%tissue_of(1))%material, nd => scene%cloud%nd, &
      & probed => scene%probe(exact%probe)%quantity)
      point = material_point(0.0_wp, scene%cloud%fiber(:, 1), &
         & scene%activation_at(scene%tissue_of(1), 1.0_wp), .not. material%incompressible())
      call exact_deformation(material, exact%solution, exact%amount, nd, point)
      local%f = point%f
      local%j = determinant(local%f)
      value = local%j
      if (ieee_is_nan(value)) return
      call material%stress(point, local%p)
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
      local%cauchy = matmul(local%p, transpose(local%f))/local%j
      values = quantity(probed, local)
      value = values(1)
      if (probed /= 'J' .and. abs(value) < nothing*maxval(abs(local%cauchy))) value = 0.0_wp
   end associate
end function exact_value

!> Whether the homogeneous solution exists, in which sides that are not held are free of stress:
!> with fibers only if they lie along one of the axes, and with K = inf along that of the stretch
pure logical function has_solution(scene, exact)
   type(scene_type), intent(in) :: scene
   type(exact_keys), intent(in) :: exact
   !> Directions whose components differ by less are the same [-]
   real(wp), parameter :: same = 1.0e-6_wp

   has_solution = .true.
   if (all(exact%solution /= [character(len=11) :: 'uniaxial', 'equibiaxial'])) return
   associate (material => scene%tissue(scene%tissue_of(1))%material, fiber => scene%cloud%fiber)
      if (.not. material%fibered) return
      has_solution = maxval(abs(fiber(:, 1))) > 1.0_wp - same .and. &
         & all(abs(abs(fiber) - spread(abs(fiber(:, 1)), 2, size(fiber, 2))) < same)
      if (material%incompressible() .and. exact%solution == 'uniaxial' .and. scene%cloud%nd == 3) &
         & has_solution = has_solution .and. abs(fiber(1, 1)) > 1.0_wp - same
   end associate
end function has_solution

!> Deformation gradient of a homogeneous solution
subroutine exact_deformation(material, solution, amount, nd, point)
   class(material_type), intent(in) :: material
   !> simple_shear, uniaxial, equibiaxial or dilation
   character(len=*), intent(in) :: solution
   !> Shear or stretch [-]
   real(wp), intent(in) :: amount
   !> Space dimension; in 2-D the third direction is not stretched
   integer, intent(in) :: nd
   !> Point, whose deformation gradient is set
   type(material_point), intent(inout) :: point
   integer :: i

   point%f = 0.0_wp
   do i = 1, 3
      point%f(i, i) = 1.0_wp
   end do
   select case (solution)
   case ('simple_shear')
      point%f(1, 2) = amount
   case ('uniaxial')
      point%f(1, 1) = amount
      call free_stretches(material, point, 2, nd)
   case ('equibiaxial')
      point%f(1, 1) = amount
      point%f(2, 2) = amount
      call free_stretches(material, point, 3, nd)
   case ('dilation')
      do i = 1, nd
         point%f(i, i) = amount
      end do
   end select
end subroutine exact_deformation

!> Stretches of directions first..last that make them free of stress, each by bisection in its
!> logarithm: across fibers they differ. NaN if there are none
recursive subroutine free_stretches(material, point, first, last)
   class(material_type), intent(in) :: material
   !> Point with a diagonal deformation gradient; the free entries are set
   type(material_point), intent(inout) :: point
   integer, intent(in) :: first, last
   real(wp) :: low, high, middle, at_low, here
   integer :: k

   if (first > last) return
   ! bracket around the incompressible stretch
   middle = -log(product([(point%f(k, k), k=1, first - 1)]))/(last - first + 1)
   if (material%incompressible()) then
      do k = first, last
         point%f(k, k) = exp(middle)
      end do
      return
   end if
   low = middle - 1.0_wp
   high = middle + 1.0_wp
   call stress_at(high, here)
   call stress_at(low, at_low)
   if (.not. at_low*here <= 0.0_wp) then
      point%f(first, first) = ieee_value(middle, ieee_quiet_nan)
      return
   end if
   do k = 1, 60
      middle = 0.5_wp*(low + high)
      call stress_at(middle, here)
      if (at_low*here <= 0.0_wp) then
         high = middle
      else
         low = middle
      end if
   end do

contains

   !> Stress in the first direction, those after it being free
   subroutine stress_at(logarithm, stress)
      real(wp), intent(in) :: logarithm
      real(wp), intent(out) :: stress
      real(wp) :: p(3, 3)

      point%f(first, first) = exp(logarithm)
      call free_stretches(material, point, first + 1, last)
      call material%stress(point, p)
      stress = p(first, first)
   end subroutine stress_at

end subroutine free_stretches

end module rk_exact
