!> The product (A x B)_iA = e_ijk e_ABC A_jB B_kC of two 3x3 matrices: cof F = (F x F)/2.
!>
!> References: de Boer, Vektor- und Tensorrechnung fuer Ingenieure (1982);
!>             Bonet, Gil, Ortigosa, Comput. Methods Appl. Mech. Eng. 283 (2015),
!>             doi:10.1016/j.cma.2014.10.002
module rk_cross
   use rk_precision, only : wp
   implicit none
   private

   public :: cross, cross_form

   !> Next and previous index in cyclic order
   integer, parameter :: next(3) = [2, 3, 1], prev(3) = [3, 1, 2]

contains

!> Product of two matrices (A x B)_iA = e_ijk e_ABC A_jB B_kC
pure function cross(a, b) result(c)
   !> Left matrix
   real(wp), intent(in) :: a(3, 3)
   !> Right matrix
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

!> Symmetric matrix of X -> M x X, with index i + 3 (A - 1) of both
pure function cross_form(m) result(k)
   !> Matrix M
   real(wp), intent(in) :: m(3, 3)
   real(wp) :: k(9, 9)
   real(wp) :: x(3, 3)
   integer :: i, a

   do a = 1, 3
      do i = 1, 3
         x = 0.0_wp
         x(i, a) = 1.0_wp
         k(:, i + 3*(a - 1)) = reshape(cross(m, x), [9])
      end do
   end do
end function cross_form

end module rk_cross
