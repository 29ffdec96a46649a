!> Small helpers for vectors and matrices of space.
!>
!> The product (A x B)_iA = e_ijk e_ABC A_jB B_kC of two 3x3 matrices gives cof F = (F x F)/2.
!>
!> References: de Boer, Vektor- und Tensorrechnung fuer Ingenieure (1982);
!>             Bonet, Gil, Ortigosa, Comput. Methods Appl. Mech. Eng. 283 (2015),
!>             doi:10.1016/j.cma.2014.10.002;
!>             Smith, Commun. ACM 4 (1961) 168, doi:10.1145/355578.366316 (principal values)
module rk_tensor
   use rk_precision, only : pi, wp
   implicit none
   private

   public :: identity, determinant, cofactor, cofactor_slope, cross, add_cross_form
   public :: principal_values, vector_product, solve_definite

   real(wp), parameter :: identity(3, 3) = reshape([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, &
      & 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], [3, 3])
   !> Next and previous index in cyclic order
   integer, parameter :: next(3) = [2, 3, 1], prev(3) = [3, 1, 2]

contains

pure real(wp) function determinant(f)
   real(wp), intent(in) :: f(3, 3)

   determinant = f(1, 1)*(f(2, 2)*f(3, 3) - f(2, 3)*f(3, 2)) &
      & - f(1, 2)*(f(2, 1)*f(3, 3) - f(2, 3)*f(3, 1)) &
      & + f(1, 3)*(f(2, 1)*f(3, 2) - f(2, 2)*f(3, 1))
end function determinant

!> Cofactors, the derivatives of the determinant
pure function cofactor(f) result(c)
   real(wp), intent(in) :: f(3, 3)
   real(wp) :: c(3, 3)
   integer :: i, a

   do a = 1, 3
      do i = 1, 3
         c(i, a) = f(next(i), next(a))*f(prev(i), prev(a)) - f(next(i), prev(a))*f(prev(i), next(a))
      end do
   end do
end function cofactor

!> Product of two matrices (A x B)_iA = e_ijk e_ABC A_jB B_kC
pure function cross(a, b) result(c)
   real(wp), intent(in) :: a(3, 3)
   real(wp), intent(in) :: b(3, 3)
   !> Product, symmetric in a and b
   real(wp) :: c(3, 3)
   integer :: i, j

   do j = 1, 3
      do i = 1, 3
         c(i, j) = a(next(i), next(j))*b(prev(i), prev(j)) &
            & - a(next(i), prev(j))*b(prev(i), next(j)) &
            & + a(prev(i), prev(j))*b(next(i), next(j)) &
            & - a(prev(i), next(j))*b(next(i), prev(j))
      end do
   end do
end function cross

!> Second derivatives of J contracted with a vector on the second index: J_FF(i, A, k, C) v_A
pure function cofactor_slope(f, v) result(t)
   !> F(i, A)
   real(wp), intent(in) :: f(3, 3)
   !> Vector with index A
   real(wp), intent(in) :: v(3)
   real(wp) :: t(3, 3, 3)
   real(wp) :: form(3, 3, 3, 3)

   form = 0.0_wp
   call add_cross_form(1.0_wp, f, form)
   t = form(:, 1, :, :)*v(1) + form(:, 2, :, :)*v(2) + form(:, 3, :, :)*v(3)
end function cofactor_slope

!> Add a multiple of the symmetric matrix of X -> M x X
pure subroutine add_cross_form(factor, m, k)
   real(wp), intent(in) :: factor
   !> Matrix M
   real(wp), intent(in) :: m(3, 3)
   !> Sum, with index i + 3 (A - 1) of both
   real(wp), intent(inout) :: k(3, 3, 3, 3)
   integer :: i, a

   do a = 1, 3
      do i = 1, 3
         associate (to => k(:, :, i, a), u => next(i), v => prev(i), b => next(a), c => prev(a))
            to(u, b) = to(u, b) + factor*m(v, c)
            to(u, c) = to(u, c) - factor*m(v, b)
            to(v, c) = to(v, c) + factor*m(u, b)
            to(v, b) = to(v, b) - factor*m(u, c)
         end associate
      end do
   end do
end subroutine add_cross_form

!> Eigenvalues of a symmetric matrix in descending order
pure function principal_values(a) result(e)
   !> Symmetric matrix
   real(wp), intent(in) :: a(3, 3)
   real(wp) :: e(3)
   real(wp) :: mean, p, angle, b(3, 3)

   mean = (a(1, 1) + a(2, 2) + a(3, 3))/3.0_wp
   b = a
   b(1, 1) = b(1, 1) - mean
   b(2, 2) = b(2, 2) - mean
   b(3, 3) = b(3, 3) - mean
   p = sqrt(sum(b**2)/6.0_wp)
   e = mean
   if (.not. p > tiny(1.0_wp)) return
   b = b/p
   angle = acos(max(-1.0_wp, min(1.0_wp, 0.5_wp*determinant(b))))/3.0_wp
   e(1) = mean + 2.0_wp*p*cos(angle)
   e(3) = mean + 2.0_wp*p*cos(angle + 2.0_wp*pi/3.0_wp)
   e(2) = 3.0_wp*mean - e(1) - e(3)
end function principal_values

pure function vector_product(a, b) result(c)
   real(wp), intent(in) :: a(3), b(3)
   real(wp) :: c(3)

   c = [a(2)*b(3) - a(3)*b(2), a(3)*b(1) - a(1)*b(3), a(1)*b(2) - a(2)*b(1)]
end function vector_product

!> Solve a symmetric positive definite system of a few unknowns by elimination
pure subroutine solve_definite(a, b)
   !> Matrix, destroyed, shape (n, n)
   real(wp), intent(inout) :: a(:, :)
   !> Right-hand sides on entry, solutions on return, shape (n, :)
   real(wp), intent(inout) :: b(:, :)
   integer :: i, j

   do i = 1, size(a, 1)
      b(i, :) = b(i, :)/a(i, i)
      a(i, i:) = a(i, i:)/a(i, i)
      do j = 1, size(a, 1)
         if (j == i) cycle
         b(j, :) = b(j, :) - a(j, i)*b(i, :)
         a(j, i:) = a(j, i:) - a(j, i)*a(i, i:)
      end do
   end do
end subroutine solve_definite

end module rk_tensor
