!> One material at many points, in parallel: energy, stress, tangents.
!>
!> Each point owns its part of the result, so the answer does not depend on the number of threads.
module rk_material_points
   use rk_material, only : material_type
   use rk_precision, only : wp
   implicit none
   private

   public :: energy_at_points, stress_at_points, strong_at_points

contains

!> Energy per reference volume at points
subroutine energy_at_points(material, f, fiber, activation, volumetric, w)
   !> Material
   class(material_type), intent(in) :: material
   !> Deformation gradients F(i,A), shape (3, 3, np) [-]
   real(wp), intent(in), contiguous :: f(:, :, :)
   !> Fibers, shape (3, np) [-]
   real(wp), intent(in), contiguous :: fiber(:, :)
   !> Activation, 0..1 [-]
   real(wp), intent(in) :: activation
   !> Include K/2 (J-1)^2?
   logical, intent(in) :: volumetric
   !> Energies, shape (np) [stress]
   real(wp), intent(out) :: w(:)
   integer :: ip

   !$omp parallel do default(none) schedule(static) private(ip) &
   !$omp& shared(material, f, fiber, activation, volumetric, w)
   do ip = 1, size(w)
      w(ip) = material%energy(f(:, :, ip), fiber(:, ip), activation, volumetric)
   end do
end subroutine energy_at_points

!> First Piola-Kirchhoff stress at points
subroutine stress_at_points(material, f, fiber, activation, volumetric, p)
   !> Material
   class(material_type), intent(in) :: material
   !> Deformation gradients F(i,A), shape (3, 3, np) [-]
   real(wp), intent(in), contiguous :: f(:, :, :)
   !> Fibers, shape (3, np) [-]
   real(wp), intent(in), contiguous :: fiber(:, :)
   !> Activation, 0..1 [-]
   real(wp), intent(in) :: activation
   !> Include K/2 (J-1)^2?
   logical, intent(in) :: volumetric
   !> Stresses P(i,A), shape (3, 3, np) [stress]
   real(wp), intent(out), contiguous :: p(:, :, :)
   integer :: ip

   !$omp parallel do default(none) schedule(static) private(ip) &
   !$omp& shared(material, f, fiber, activation, volumetric, p)
   do ip = 1, size(p, 3)
      call material%stress(f(:, :, ip), fiber(:, ip), activation, p(:, :, ip), volumetric)
   end do
end subroutine stress_at_points

!> Stress, tangent and contracted third derivative at points
subroutine strong_at_points(material, nd, f, h, fiber, activation, volumetric, p, c4, t)
   !> Material
   class(material_type), intent(in) :: material
   !> Space dimension, 2 (plane strain) or 3
   integer, intent(in) :: nd
   !> Deformation gradients F(i,A), shape (3, 3, np) [-]
   real(wp), intent(in), contiguous :: f(:, :, :)
   !> Second derivatives of the displacement H(j,B,A) = u_j,BA, shape (3, 3, 3, np) [1/length]
   real(wp), intent(in), contiguous :: h(:, :, :, :)
   !> Fibers, shape (3, np) [-]
   real(wp), intent(in), contiguous :: fiber(:, :)
   !> Activation, 0..1 [-]
   real(wp), intent(in) :: activation
   !> Include K/2 (J-1)^2?
   logical, intent(in) :: volumetric
   !> Stresses P(i,A), shape (3, 3, np) [stress]
   real(wp), intent(out), contiguous :: p(:, :, :)
   !> Tangents C4(i,A,j,B), shape (3, 3, 3, 3, np) [stress]
   real(wp), intent(out), contiguous :: c4(:, :, :, :, :)
   !> Contractions T(i,k,C), shape (3, 3, 3, np) [stress/length]
   real(wp), intent(out), contiguous :: t(:, :, :, :)
   integer :: ip

   !$omp parallel do default(none) schedule(static) private(ip) &
   !$omp& shared(material, nd, f, h, fiber, activation, volumetric, p, c4, t)
   do ip = 1, size(p, 3)
      call material%strong(nd, f(:, :, ip), h(:, :, :, ip), fiber(:, ip), activation, &
         & p(:, :, ip), c4(:, :, :, :, ip), t(:, :, :, ip), volumetric)
   end do
end subroutine strong_at_points

end module rk_material_points
