!> Second derivatives of a hyperelastic energy W(J, I1, I2, I4), third and fourth ones (5.91)-(5.93)
!> along given directions.
!>
!> The linearised strong form has W_,FFF[H_A] with H_A = H(:, :, A). A row of it is a second
!> derivative of the energy along two directions: a residual weighted by r_i gives the scalar
!> s = r_i C4_iAjB H_jBA, the sum over A of W_,FF[R_A, H_A] with R_A = r x e_A. What the exact
!> Hessian needs are its derivatives
!>
!>     s_,FH = W_,FFF[R_A]          r_i C6_iAjBkC, a 9x9 matrix for every A
!>     s_,FF = W_,FFFF[R_A, H_A]    r_i C8_iAjBkClD H_jBA, a 9x9 matrix
!>
!> and for a traction row with the normal N, W_,FFF[r x N]. Neither C6 nor C8 is formed: by the
!> chain rule both are sums of products of 9-vectors and of the forms I_,FF, I_,FFF[Y] and
!> I_,FFFF[R, G] of the invariants. With K(M) the symmetric matrix of X -> M x X (product of
!> rk_tensor) and the bilinear form B of I2, which is of fourth order in F,
!>
!>     J_,FF = K(F)         J_,FFF[Y] = K(Y)
!>     I2_,FF = B(F, F)     I2_,FFF[Y] = 2 B(F, Y)     I2_,FFFF[R, G] = 2 B(R, G)
!>
!> and I1 and I4 are quadratic. Matrices 9x9 have the index i + 3 (A - 1) for F_iA.
!>
!> References: thesis (5.59) and Appendix C
module rk_curvature
   use rk_precision, only : wp
   use rk_tensor, only : add_cross_form, cross
   use rk_tensors, only : derivatives_type, invariants_type, kind_i1, kind_i2, kind_i4, &
      & kind_j
   implicit none
   private

   public :: second_form, third_form, third_tensor, fourth_form

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
      call third_form(inv, w, h(:, :, a), form, a)
      do c = 1, 3
         t(:, :, c) = t(:, :, c) + form(3*a - 2:3*a, 3*c - 2:3*c)
      end do
   end do
end subroutine third_tensor

!> W_,FFF[R]
pure subroutine third_form(inv, w, r, form, only)
   !> Invariants with first derivatives
   type(invariants_type), intent(in) :: inv
   !> Derivatives of W, third order
   type(derivatives_type), intent(in) :: w
   !> Direction R_iA
   real(wp), intent(in) :: r(3, 3)
   !> Symmetric matrix [stress]
   real(wp), intent(out) :: form(9, 9)
   !> The only A whose rows are wanted, of all without it
   integer, intent(in), optional :: only
   type(directions_type) :: along(4)
   real(wp) :: bend(9, 4), side(9, 4), core(4, 4)
   integer :: rows(2), n, m, l

   rows = all_rows
   if (present(only)) rows = only

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
      call add_form(inv, n, sum(w%second(:inv%n, n)*along(:inv%n)%slope), w%first(n)*r, rows, &
         & form)
   end do
   call add_products(inv, side, core, rows, form)
end subroutine third_form

!> Sum over A of W_,FFFF[r x e_A, H(:, :, A)]
pure subroutine fourth_form(nd, inv, w, r, h, form)
   !> Space dimension, 2 or 3
   integer, intent(in) :: nd
   !> Invariants with first derivatives
   type(invariants_type), intent(in) :: inv
   !> Derivatives of W, fourth order
   type(derivatives_type), intent(in) :: w
   !> Weighted residual r_i
   real(wp), intent(in) :: r(3)
   !> Second derivatives of the displacement H(j,B,A) = u_j,BA [1/length]
   real(wp), intent(in) :: h(3, 3, 3)
   !> Symmetric matrix [stress/length]
   real(wp), intent(out) :: form(9, 9)
   type(directions_type) :: along(4), across(4)
   !> R_A
   real(wp) :: ra(3, 3)
   !> Factors of I_,FF, directions of I_,FFF
   real(wp) :: factor(4), y(3, 3, 4)
   !> Factors of products of gradients with vectors and with each other
   real(wp) :: side(9, 4), core(4, 4), c(4), mixed
   integer :: a, l, m, n, p

   form = 0.0_wp
   factor = 0.0_wp
   y = 0.0_wp
   side = 0.0_wp
   core = 0.0_wp
   do a = 1, nd
      ra = 0.0_wp
      ra(:, a) = r
      call set_directions(inv, ra, along)
      call set_directions(inv, h(:, :, a), across)
      do n = 1, inv%n
         c(n) = sum(along(n)%bend*h(:, :, a))
      end do
      do n = 1, inv%n
         do m = 1, inv%n
            factor(n) = factor(n) + w%second(m, n)*c(m)
            y(:, :, n) = y(:, :, n) + w%second(m, n)*(across(m)%slope*ra &
               & + along(m)%slope*h(:, :, a))
            side(:, n) = side(:, n) + w%second(m, n)*twist(inv, m, ra, h(:, :, a))
            call add_outer(w%second(m, n), flat(along(m)%bend), flat(across(n)%bend), all_rows, &
               & form)
            do l = 1, inv%n
               mixed = along(m)%slope*across(l)%slope
               factor(n) = factor(n) + w%third(l, m, n)*mixed
               side(:, n) = side(:, n) + w%third(l, m, n)*(across(l)%slope*flat(along(m)%bend) &
                  & + along(l)%slope*flat(across(m)%bend))
               core(m, n) = core(m, n) + w%third(l, m, n)*c(l)
               do p = 1, inv%n
                  core(m, n) = core(m, n) + w%fourth(p, l, m, n)*along(l)%slope*across(p)%slope
               end do
            end do
         end do
         if (inv%kind(n) == kind_i2) call add_i2(ra, 2.0_wp*w%first(n)*h(:, :, a), &
            & all_rows, form)
      end do
   end do
   do n = 1, inv%n
      call add_form(inv, n, factor(n), y(:, :, n), all_rows, form)
   end do
   call add_products(inv, side, core, all_rows, form)
end subroutine fourth_form

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

!> I_,FFF[R, G] of one invariant
pure function twist(inv, n, r, g) result(v)
   type(invariants_type), intent(in) :: inv
   !> Which one
   integer, intent(in) :: n
   !> Directions
   real(wp), intent(in) :: r(3, 3), g(3, 3)
   real(wp) :: v(9)

   select case (inv%kind(n))
   case (kind_j)
      v = flat(cross(r, g))
   case (kind_i2)
      v = flat(2.0_wp*(cross(cross(r, g), inv%f) + cross(cross(inv%f, g), r) &
         & + cross(cross(inv%f, r), g)))
   case default
      v = 0.0_wp
   end select
end function twist

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

!> Add side_n x I_n,F + I_n,F x side_n + core_mn I_m,F x I_n,F
pure subroutine add_products(inv, side, core, rows, form)
   type(invariants_type), intent(in) :: inv
   !> Vectors
   real(wp), intent(in) :: side(9, 4)
   !> Symmetric factors
   real(wp), intent(in) :: core(4, 4)
   integer, intent(in) :: rows(2)
   real(wp), intent(inout) :: form(9, 9)
   real(wp) :: v(9), g(9, 4)
   integer :: m, n

   do n = 1, inv%n
      g(:, n) = flat(inv%gradient(:, :, n))
   end do
   do n = 1, inv%n
      v = side(:, n)
      do m = 1, inv%n
         v = v + 0.5_wp*core(m, n)*g(:, m)
      end do
      call add_outer(1.0_wp, v, g(:, n), rows, form)
   end do
end subroutine add_products

!> Add factor (a x b + b x a)
pure subroutine add_outer(factor, a, b, rows, form)
   real(wp), intent(in) :: factor
   !> Vectors
   real(wp), intent(in) :: a(9), b(9)
   integer, intent(in) :: rows(2)
   real(wp), intent(inout) :: form(9, 9)
   integer :: c, j

   do j = 1, 9
      do c = 3*rows(1) - 2, 3*rows(2), 3
         form(c:c + 2, j) = form(c:c + 2, j) + factor*(a(c:c + 2)*b(j) + b(c:c + 2)*a(j))
      end do
   end do
end subroutine add_outer

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
