!> Second derivatives of a hyperelastic energy W(J, I1, I2, I4), third ones along given directions.
!>
!> The linearised strong form has W_,FFF[H_A] with H_A = H(:, :, A). The sixth-order tensor is not
!> formed: by the chain rule its contraction is a sum of products of 9-vectors and of the forms
!> I_,FF and I_,FFF[Y] of the invariants. With K(M) the symmetric matrix of X -> M x X (product of
!> rk_tensor) and the bilinear form B of I2,
!>
!>     J_,FF = K(F)         J_,FFF[Y] = K(Y)
!>     I2_,FF = B(F, F)     I2_,FFF[Y] = 2 B(F, Y)
!>
!> and I1 and I4 are quadratic. Matrices 9x9 have the index i + 3 (A - 1) for F_iA.
!>
!> References: thesis Appendix C
module rk_curvature
   use rk_precision, only : wp
   use rk_tensor, only : add_cross_form, cross
   use rk_tensors, only : derivatives_type, invariants_type, kind_i1, kind_i2, kind_i4, &
      & kind_j
   implicit none
   private

   public :: second_form, third_tensor

   !> First and last A of the rows of a matrix
   integer, parameter :: all_rows(2) = [1, 3]

   !> Directions of one invariant
   type :: directions_type
      !> I_,F : X
      real(wp) :: slope
      !> I_,FF[X]
      real(wp) :: bend(3, 3)
   end type directions_type

contains

!> C4_iAjB = W_,iAjB, thesis (C.5)
pure subroutine second_form(inv, w, form)
   !> Invariants with first derivatives
   type(invariants_type), intent(in) :: inv
   !> Derivatives of W, second order
   type(derivatives_type), intent(in) :: w
   !> Symmetric matrix [stress]
   real(wp), intent(out) :: form(9, 9)
   real(wp), parameter :: none(3, 3) = 0.0_wp
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
      call add_form(inv, n, w%first(n), none, all_rows, form)
   end do
end subroutine second_form

!> T_ikC = C6_iAjBkC H_jBA, thesis (5.66) with (C.10)-(C.17): the sum over A of row (i, A) of
!> W_,FFF[H(:, :, A)]
pure subroutine third_tensor(nd, inv, w, h, t)
   !> Space dimension, 2 or 3
   integer, intent(in) :: nd
   !> Invariants with first derivatives
   type(invariants_type), intent(in) :: inv
   !> Derivatives of W, third order
   type(derivatives_type), intent(in) :: w
   !> Second derivatives of the displacement H(j,B,A) = u_j,BA, no symmetry is assumed [1/length]
   real(wp), intent(in) :: h(3, 3, 3)
   !> Contraction T(i,k,C) [stress/length]
   real(wp), intent(out) :: t(3, 3, 3)
   real(wp) :: form(9, 9)
   integer :: a, c

   t = 0.0_wp
   do a = 1, nd
      call third_rows(inv, w, h(:, :, a), a, form)
      do c = 1, 3
         t(:, :, c) = t(:, :, c) + form(3*a - 2:3*a, 3*c - 2:3*c)
      end do
   end do
end subroutine third_tensor

!> Rows (i, A) of W_,FFF[R]
pure subroutine third_rows(inv, w, r, a, form)
   !> Invariants with first derivatives
   type(invariants_type), intent(in) :: inv
   !> Derivatives of W, third order
   type(derivatives_type), intent(in) :: w
   !> Direction R_iA
   real(wp), intent(in) :: r(3, 3)
   !> A of the rows
   integer, intent(in) :: a
   !> Matrix, whose other rows are not complete [stress]
   real(wp), intent(out) :: form(9, 9)
   type(directions_type) :: along(4)
   real(wp) :: bend(9, 4), side(9, 4), core(4, 4)
   integer :: n, m, l

   call set_directions(inv, r, along)
   form = 0.0_wp
   do n = 1, inv%n
      bend(:, n) = flat(along(n)%bend)
   end do
   do n = 1, inv%n
      side(:, n) = 0.0_wp
      do m = 1, inv%n
         side(:, n) = side(:, n) + w%second(m, n)*bend(:, m)
         core(m, n) = 0.0_wp
         do l = 1, inv%n
            core(m, n) = core(m, n) + w%third(l, m, n)*along(l)%slope
         end do
      end do
      call add_form(inv, n, sum(w%second(:inv%n, n)*along(:inv%n)%slope), w%first(n)*r, [a, a], &
         & form)
   end do
   call add_products(inv, side, core, a, form)
end subroutine third_rows

!> First and second derivatives of the invariants along a direction
pure subroutine set_directions(inv, x, along)
   type(invariants_type), intent(in) :: inv
   !> Direction
   real(wp), intent(in) :: x(3, 3)
   !> Derivatives of the invariants in use
   type(directions_type), intent(out) :: along(4)
   real(wp) :: fx(3, 3), push(3)
   integer :: n, c

   fx = cross(inv%f, x)
   do n = 1, inv%n
      along(n)%slope = sum(inv%gradient(:, :, n)*x)
      select case (inv%kind(n))
      case (kind_j)
         along(n)%bend = fx
      case (kind_i1)
         along(n)%bend = 2.0_wp*x
      case (kind_i2)
         along(n)%bend = 2.0_wp*(cross(fx, inv%f) + cross(inv%gradient(:, :, 1), x))
      case (kind_i4)
         push = matmul(x, inv%fiber)
         do c = 1, 3
            along(n)%bend(:, c) = 2.0_wp*push*inv%fiber(c)
         end do
      end select
   end do
end subroutine set_directions

!> Add factor I_,FF + I_,FFF[Y]
pure subroutine add_form(inv, n, factor, y, rows, form)
   type(invariants_type), intent(in) :: inv
   integer, intent(in) :: n
   !> Factor of the second derivative
   real(wp), intent(in) :: factor
   !> Direction of the third derivative
   real(wp), intent(in) :: y(3, 3)
   !> First and last A whose rows are wanted
   integer, intent(in) :: rows(2)
   !> Matrix
   real(wp), intent(inout) :: form(9, 9)
   integer :: i, a, b

   select case (inv%kind(n))
   case (kind_j)
      call add_cross_form(1.0_wp, factor*inv%f + y, form)
   case (kind_i1)
      do i = 1, 9
         form(i, i) = form(i, i) + 2.0_wp*factor
      end do
   case (kind_i2)
      call add_i2(inv%f, factor*inv%f + 2.0_wp*y, rows, form)
   case (kind_i4)
      do b = 1, 3
         do a = rows(1), rows(2)
            do i = 1, 3
               form(i + 3*(a - 1), i + 3*(b - 1)) = form(i + 3*(a - 1), i + 3*(b - 1)) &
                  & + 2.0_wp*factor*inv%fiber(a)*inv%fiber(b)
            end do
         end do
      end do
   end select
end subroutine add_form

!> Add B(X, Y), the bilinear form of which I2_,FF is B(F, F), thesis (C.9) without the terms of J
pure subroutine add_i2(x, y, rows, form)
   !> Matrices
   real(wp), intent(in) :: x(3, 3), y(3, 3)
   integer, intent(in) :: rows(2)
   !> Sum, with indices (i, A, j, B)
   real(wp), intent(inout) :: form(3, 3, 3, 3)
   real(wp) :: left(3, 3), right(3, 3), trace
   integer :: i, a, j, b

   left = matmul(x, transpose(y))
   left = left + transpose(left)
   right = matmul(transpose(x), y)
   right = right + transpose(right)
   trace = right(1, 1) + right(2, 2) + right(3, 3)
   do b = 1, 3
      do j = 1, 3
         do a = rows(1), rows(2)
            do i = 1, 3
               form(i, a, j, b) = form(i, a, j, b) + 2.0_wp*(x(i, a)*y(j, b) + y(i, a)*x(j, b)) &
                  & - x(i, b)*y(j, a) - y(i, b)*x(j, a)
            end do
            form(j, a, j, b) = form(j, a, j, b) - right(a, b)
         end do
         form(:, b, j, b) = form(:, b, j, b) - left(:, j)
         form(j, b, j, b) = form(j, b, j, b) + trace
      end do
   end do
end subroutine add_i2

!> Add rows (i, A) of side_n x I_n,F + I_n,F x side_n + core_mn I_m,F x I_n,F
pure subroutine add_products(inv, side, core, a, form)
   type(invariants_type), intent(in) :: inv
   !> Vectors
   real(wp), intent(in) :: side(9, 4)
   !> Symmetric factors
   real(wp), intent(in) :: core(4, 4)
   integer, intent(in) :: a
   real(wp), intent(inout) :: form(9, 9)
   real(wp) :: v(9), g(9, 4)
   integer :: j, m, n

   do n = 1, inv%n
      g(:, n) = flat(inv%gradient(:, :, n))
   end do
   do n = 1, inv%n
      v = side(:, n)
      do m = 1, inv%n
         v = v + 0.5_wp*core(m, n)*g(:, m)
      end do
      associate (rows => form(3*a - 2:3*a, :))
         do j = 1, 9
            rows(:, j) = rows(:, j) + (v(3*a - 2:3*a)*g(j, n) + g(3*a - 2:3*a, n)*v(j))
         end do
      end associate
   end do
end subroutine add_products

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
