!> What a pressure p among the fields adds to the rows of collocation: P = P_iso(F) + p cof F.
module rk_mixed
   use rk_precision, only : wp
   use rk_tensor, only : cofactor, cross, cross_form
   implicit none
   private

   public :: add_pressure, add_pressure_curvature, cofactor_slope

contains

!> Second derivatives of J contracted with a vector on the second index: J_FF(i, A, k, C) v_A
pure function cofactor_slope(f, v) result(t)
   !> F(i, A)
   real(wp), intent(in) :: f(3, 3)
   !> Vector with index A
   real(wp), intent(in) :: v(3)
   real(wp) :: t(3, 3, 3)
   integer, parameter :: next(3) = [2, 3, 1], prev(3) = [3, 1, 2]
   integer :: i, c, ln

   ! eps_ikm eps_ACB F_mB v_A
   t = 0.0_wp
   do c = 1, 3
      do i = 1, 3
         ln = i
         t(ln, next(i), c) = v(prev(c))*f(prev(i), next(c)) - v(next(c))*f(prev(i), prev(c))
         t(ln, prev(i), c) = -(v(prev(c))*f(next(i), next(c)) - v(next(c))*f(next(i), prev(c)))
      end do
   end do
end function cofactor_slope

!> Stress of the pressure p: p cof F, whose divergence is cof F grad p
pure subroutine add_pressure(nd, u, f, tangent, p, divergence, t, c)
   integer, intent(in) :: nd
   !> Displacement and pressure with derivatives, shape (nd + 1, nq)
   real(wp), intent(in) :: u(:, :)
   !> Deformation gradient F(i, A) [-]
   real(wp), intent(in) :: f(3, 3)
   !> Linearise
   logical, intent(in) :: tangent
   !> First Piola-Kirchhoff stress P(i, A)
   real(wp), intent(inout) :: p(3, 3)
   !> Its divergence P_iA,A
   real(wp), intent(inout) :: divergence(3)
   !> Derivative of the divergence by F(k, C)
   real(wp), intent(inout) :: t(3, 3, 3)
   !> Derivatives of the divergence by those of the pressure: cof F
   real(wp), intent(out) :: c(3, 3)
   real(wp) :: slope(3)

   c = cofactor(f)
   p = p + u(nd + 1, 1)*c
   slope = 0.0_wp
   slope(:nd) = u(nd + 1, 2:1 + nd)
   divergence(:nd) = divergence(:nd) + matmul(c(:nd, :nd), slope(:nd))
   if (tangent) t = t + cofactor_slope(f, slope)
end subroutine add_pressure

!> Second derivatives of rho_i (cof F)_iA p_,A
pure subroutine add_pressure_curvature(nd, u, f, rho, ff, form)
   integer, intent(in) :: nd
   !> Displacement and pressure with derivatives, shape (nd + 1, nq)
   real(wp), intent(in) :: u(:, :)
   !> Deformation gradient F(i, A) [-]
   real(wp), intent(in) :: f(3, 3)
   !> Residuals times weight
   real(wp), intent(in) :: rho(3)
   !> Second derivatives by F_iA and F_jB, index i + 3 (A - 1)
   real(wp), intent(inout) :: ff(9, 9)
   !> Form as in rk_rows, shape (nd*nd, nd + 1, nq)
   real(wp), intent(inout) :: form(:, :, :)
   real(wp) :: slope(3, 3), weighted(3, 3), second(3, 3)
   integer :: a

   slope = 0.0_wp
   do a = 1, nd
      slope(:, a) = rho*u(nd + 1, 1 + a)
      weighted = 0.0_wp
      weighted(:, a) = rho
      second = cross(f, weighted)
      form(:, nd + 1, 1 + a) = form(:, nd + 1, 1 + a) + reshape(second(:nd, :nd), [nd*nd])
   end do
   ff = ff + cross_form(slope)
end subroutine add_pressure_curvature

end module rk_mixed
