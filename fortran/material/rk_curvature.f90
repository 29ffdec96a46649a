!> Second derivatives of a hyperelastic energy W(J, I1, I2, I4).
!>
!> By the chain rule they are a sum of products of 9-vectors and of the forms I_,FF of the
!> invariants: J_,FF is the symmetric matrix K(F) of X -> F x X (product of rk_tensor), I2_,FF the
!> bilinear form of (C.9), and I1 and I4 are quadratic. Matrices 9x9 have the index i + 3 (A - 1)
!> for F_iA.
!>
!> References: thesis Appendix C
module rk_curvature
   use rk_precision, only : wp
   use rk_tensor, only : add_cross_form
   use rk_tensors, only : derivatives_type, invariants_type, kind_i1, kind_i2, kind_i4, &
      & kind_j
   implicit none
   private

   public :: second_form

contains

!> C4_iAjB = W_,iAjB, thesis (C.5)
pure subroutine second_form(inv, w, form)
   !> Invariants with first derivatives
   type(invariants_type), intent(in) :: inv
   !> Derivatives of W, second order
   type(derivatives_type), intent(in) :: w
   !> Symmetric matrix [stress]
   real(wp), intent(out) :: form(9, 9)
   real(wp) :: v(9), g(9)
   integer :: j, m, n

   form = 0.0_wp
   do n = 1, inv%n
      v = 0.0_wp
      do m = 1, inv%n
         v = v + w%second(m, n)*flat(inv%gradient(:, :, m))
      end do
      g = flat(inv%gradient(:, :, n))
      do j = 1, 9
         form(:, j) = form(:, j) + v*g(j)
      end do
      call add_form(inv, n, w%first(n), form)
   end do
end subroutine second_form

!> Add a multiple of I_,FF
pure subroutine add_form(inv, n, factor, form)
   type(invariants_type), intent(in) :: inv
   integer, intent(in) :: n
   real(wp), intent(in) :: factor
   !> Matrix
   real(wp), intent(inout) :: form(9, 9)
   integer :: i, a, b

   select case (inv%kind(n))
   case (kind_j)
      call add_cross_form(factor, inv%f, form)
   case (kind_i1)
      do i = 1, 9
         form(i, i) = form(i, i) + 2.0_wp*factor
      end do
   case (kind_i2)
      call add_i2(inv%f, factor, form)
   case (kind_i4)
      do b = 1, 3
         do a = 1, 3
            do i = 1, 3
               form(i + 3*(a - 1), i + 3*(b - 1)) = form(i + 3*(a - 1), i + 3*(b - 1)) &
                  & + 2.0_wp*factor*inv%fiber(a)*inv%fiber(b)
            end do
         end do
      end do
   end select
end subroutine add_form

!> Add a multiple of I2_,FF, thesis (C.9) without the terms of J
pure subroutine add_i2(f, factor, form)
   !> Deformation gradient [-]
   real(wp), intent(in) :: f(3, 3)
   real(wp), intent(in) :: factor
   !> Sum, with indices (i, A, j, B)
   real(wp), intent(inout) :: form(3, 3, 3, 3)
   real(wp) :: left(3, 3), right(3, 3), trace
   integer :: i, a, j, b

   left = 2.0_wp*factor*matmul(f, transpose(f))
   right = 2.0_wp*factor*matmul(transpose(f), f)
   trace = right(1, 1) + right(2, 2) + right(3, 3)
   do b = 1, 3
      do j = 1, 3
         do a = 1, 3
            do i = 1, 3
               form(i, a, j, b) = form(i, a, j, b) &
                  & + 2.0_wp*factor*(2.0_wp*f(i, a)*f(j, b) - f(i, b)*f(j, a))
            end do
            form(j, a, j, b) = form(j, a, j, b) - right(a, b)
         end do
         form(:, b, j, b) = form(:, b, j, b) - left(:, j)
         form(j, b, j, b) = form(j, b, j, b) + trace
      end do
   end do
end subroutine add_i2

!> Matrix as a vector
pure function flat(m) result(v)
   !> Matrix
   real(wp), intent(in) :: m(3, 3)
   real(wp) :: v(9)

   ! three times as fast as reshape
   v(1:3) = m(:, 1)
   v(4:6) = m(:, 2)
   v(7:9) = m(:, 3)
end function flat

end module rk_curvature
