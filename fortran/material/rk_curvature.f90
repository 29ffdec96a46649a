!> Third and fourth derivatives (5.91)-(5.93) of a hyperelastic energy along given directions.
!>
!> A row of the strong form is a second derivative of the energy along two directions: a residual
!> weighted by r_i gives the scalar s = r_i C4_iAjB H_jBA, the sum over A of W_,FF[R_A, H_A] with
!> R_A = r x e_A and H_A = H(:, :, A). What the exact Hessian needs are its derivatives
!>
!>     s_,FH = W_,FFF[R_A]          r_i C6_iAjBkC, a 9x9 matrix for every A
!>     s_,FF = W_,FFFF[R_A, H_A]    r_i C8_iAjBkClD H_jBA, a 9x9 matrix
!>
!> and for a traction row with the normal N, W_,FFF[r x N]. Neither C6 nor C8 is formed: by the
!> chain rule both are sums of products of 9-vectors and of the forms I_,FF, I_,FFF[Y] and
!> I_,FFFF[R, G] of the invariants. With K(M) the symmetric matrix of X -> M x X (product of
!> rk_tensor),
!>
!>     J_,FF = K(F)                            J_,FFF[Y] = K(Y)
!>     I2_,FF = 2 K(F) K(F) + 2 K(cof F)       I2_,FFF[Y] = 2 K(F) K(Y) + 2 K(Y) K(F) + 2 K(F x Y)
!>     I2_,FFFF[R, G] = 2 K(R) K(G) + 2 K(G) K(R) + 2 K(R x G)
!>
!> and I1 and I4 are quadratic. Matrices 9x9 have the index i + 3 (A - 1) for F_iA.
!>
!> References: thesis (5.59) and Appendix C
module rk_curvature
   use rk_precision, only : wp
   use rk_tensor, only : cross, cross_form
   use rk_tensors, only : derivatives_type, invariants_type, kind_i1, kind_i2, kind_i4, &
      & kind_j
   implicit none
   private

   public :: third_form, fourth_form

   !> Directions of one invariant
   type :: directions_type
      !> I_,F : X
      real(wp) :: slope
      !> I_,FF[X]
      real(wp) :: bend(3, 3)
   end type directions_type

contains

!> W_,FFF[R]
pure subroutine third_form(inv, w, r, form)
   !> Invariants with first derivatives
   type(invariants_type), intent(in) :: inv
   !> Derivatives of W, third order
   type(derivatives_type), intent(in) :: w
   !> Direction R_iA
   real(wp), intent(in) :: r(3, 3)
   !> Symmetric matrix [stress]
   real(wp), intent(out) :: form(9, 9)
   type(directions_type) :: along(4)
   real(wp) :: side(9, 4), core(4, 4)
   integer :: n, m, l

   call set_directions(inv, r, along)
   form = 0.0_wp
   do n = 1, inv%n
      side(:, n) = 0.0_wp
      do m = 1, inv%n
         side(:, n) = side(:, n) + w%second(m, n)*flat(along(m)%bend)
         core(m, n) = 0.0_wp
         do l = 1, inv%n
            core(m, n) = core(m, n) + w%third(l, m, n)*along(l)%slope
         end do
      end do
      call add_form(inv, n, sum(w%second(:inv%n, n)*along(:inv%n)%slope), w%first(n)*r, form)
   end do
   call add_products(inv, side, core, form)
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
            call add_outer(w%second(m, n), flat(along(m)%bend), flat(across(n)%bend), form)
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
         if (inv%kind(n) == kind_i2) call add_fourth_i2(w%first(n), ra, h(:, :, a), form)
      end do
   end do
   do n = 1, inv%n
      call add_form(inv, n, factor(n), y(:, :, n), form)
   end do
   call add_products(inv, side, core, form)
end subroutine fourth_form

!> First and second derivatives of the invariants along a direction
pure subroutine set_directions(inv, x, along)
   !> Invariants with first derivatives
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
pure subroutine add_form(inv, n, factor, y, form)
   type(invariants_type), intent(in) :: inv
   !> Which one
   integer, intent(in) :: n
   !> Factor of the second derivative
   real(wp), intent(in) :: factor
   !> Direction of the third derivative
   real(wp), intent(in) :: y(3, 3)
   !> Matrix
   real(wp), intent(inout) :: form(9, 9)
   real(wp) :: left(9, 9)
   integer :: i, a, b

   select case (inv%kind(n))
   case (kind_j)
      form = form + cross_form(factor*inv%f + y)
   case (kind_i1)
      do i = 1, 9
         form(i, i) = form(i, i) + 2.0_wp*factor
      end do
   case (kind_i2)
      ! K(F) K(factor F + 2 Y), made symmetric
      left = product_of(inv%f, factor*inv%f + 2.0_wp*y)
      form = form + left + transpose(left) &
         & + cross_form(2.0_wp*(factor*inv%gradient(:, :, 1) + cross(inv%f, y)))
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

!> Add factor I2_,FFFF[R, G]
pure subroutine add_fourth_i2(factor, r, g, form)
   real(wp), intent(in) :: factor
   !> Directions
   real(wp), intent(in) :: r(3, 3), g(3, 3)
   !> Matrix
   real(wp), intent(inout) :: form(9, 9)
   real(wp) :: left(9, 9)

   left = product_of(r, 2.0_wp*factor*g)
   form = form + left + transpose(left) + cross_form(2.0_wp*factor*cross(r, g))
end subroutine add_fourth_i2

!> K(A) K(B)
pure function product_of(a, b) result(k)
   !> Matrices
   real(wp), intent(in) :: a(3, 3), b(3, 3)
   real(wp) :: k(9, 9)
   real(wp) :: left(9, 9), right(9, 9)

   left = cross_form(a)
   right = cross_form(b)
   k = matmul(left, right)
end function product_of

!> Add side_n x I_n,F + I_n,F x side_n + core_mn I_m,F x I_n,F
pure subroutine add_products(inv, side, core, form)
   !> Invariants with first derivatives
   type(invariants_type), intent(in) :: inv
   !> Vectors
   real(wp), intent(in) :: side(9, 4)
   !> Symmetric factors
   real(wp), intent(in) :: core(4, 4)
   !> Matrix
   real(wp), intent(inout) :: form(9, 9)
   real(wp) :: v(9)
   integer :: m, n

   do n = 1, inv%n
      v = side(:, n)
      do m = 1, inv%n
         v = v + 0.5_wp*core(m, n)*flat(inv%gradient(:, :, m))
      end do
      call add_outer(1.0_wp, v, flat(inv%gradient(:, :, n)), form)
   end do
end subroutine add_products

!> Add factor (a x b + b x a)
pure subroutine add_outer(factor, a, b, form)
   real(wp), intent(in) :: factor
   !> Vectors
   real(wp), intent(in) :: a(9), b(9)
   !> Matrix
   real(wp), intent(inout) :: form(9, 9)
   integer :: j

   do j = 1, 9
      form(:, j) = form(:, j) + factor*(a*b(j) + b*a(j))
   end do
end subroutine add_outer

!> Matrix as a vector
pure function flat(m) result(v)
   !> Matrix
   real(wp), intent(in) :: m(3, 3)
   real(wp) :: v(9)

   v = reshape(m, [9])
end function flat

end module rk_curvature
