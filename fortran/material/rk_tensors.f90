!> Stress and tangents of a hyperelastic energy W(J, I1, I2, I4) by the chain rule.
!>
!> The invariants are those of C = F^T F, unscaled: J = det F, I1 = tr C = F:F, I2 = tr cof C
!> = cof F : cof F and I4 = N.C.N with the fiber N. All four are polynomials in F, so their
!> derivatives are short and need no inverse of F. A material supplies the derivatives of W by
!> these invariants, as plain numbers; everything with indices happens here, once for all
!> materials, and only for the invariants in use.
!>
!> With A x B the product (A x B)_{iA} = e_ijk e_ABC A_jB B_kC of two matrices,
!> cof F = (F x F)/2 and
!>
!>     J_,F  = cof F               J_,FF[G]  = F x G
!>     I1_,F = 2 F                 I1_,FF[G] = 2 G
!>     I2_,F = 2 cof F x F         I2_,FF[G] = 2 (F x G) x F + 2 cof F x G
!>     I4_,F = 2 (F N) N           I4_,FF[G] = 2 (G N) N
!>
!> Two-dimensional states are plane strain: F_33 = 1, other components with an index 3 are zero.
!>
!> References: thesis Appendix C, (C.1)-(C.17), for J, I1 and I2;
!>             de Boer, Vektor- und Tensorrechnung fuer Ingenieure (1982), for A x B;
!>             Bonet, Gil, Ortigosa, Comput. Methods Appl. Mech. Eng. 283 (2015),
!>             doi:10.1016/j.cma.2014.10.002
module rk_tensors
   use rk_precision, only : wp
   use rk_tensor, only : cross
   implicit none
   private

   public :: invariants_type, derivatives_type, set_invariants
   public :: first_tensor, second_tensor, third_tensor
   public :: kind_j, kind_i1, kind_i2, kind_i4

   !> Names of the invariants; the reduced ones are numbered alike
   integer, parameter :: kind_j = 0, kind_i1 = 1, kind_i2 = 2, kind_i4 = 3

   !> Next and previous index in cyclic order
   integer, parameter :: next(3) = [2, 3, 1], prev(3) = [3, 1, 2]

   !> Invariants of one deformation gradient
   type :: invariants_type
      !> Number of invariants in use, J is the first
      integer :: n
      !> Which ones, kind_*
      integer :: kind(4)
      !> Values [-]
      real(wp) :: value(4)
      !> First derivatives by F_iA, shape (i, A, invariant) [-]
      real(wp) :: gradient(3, 3, 4)
      !> Deformation gradient [-]
      real(wp) :: f(3, 3)
      !> Fiber, unit vector [-]
      real(wp) :: fiber(3)
      !> Fiber in the deformed body, F N [-]
      real(wp) :: pushed(3)
   end type invariants_type

   !> Derivatives of W by the invariants in use, in their order
   type :: derivatives_type
      !> First [stress]
      real(wp) :: first(4)
      !> Second, symmetric [stress]
      real(wp) :: second(4, 4)
      !> Third, symmetric [stress]
      real(wp) :: third(4, 4, 4)
      !> Fourth, symmetric [stress]
      real(wp) :: fourth(4, 4, 4, 4)
   end type derivatives_type

contains

!> Invariants of F and, on request, their first derivatives
pure subroutine set_invariants(self, f, fiber, active, gradients)
   type(invariants_type), intent(out) :: self
   !> Deformation gradient F_iA [-]
   real(wp), intent(in) :: f(3, 3)
   !> Fiber, unit vector; zeros switch I4 off [-]
   real(wp), intent(in) :: fiber(3)
   !> Is I1, I2, I4 used by the energy?
   logical, intent(in) :: active(3)
   !> Are first derivatives wanted?
   logical, intent(in) :: gradients
   real(wp) :: cofactor(3, 3)
   integer :: a

   self%f = f
   cofactor = 0.5_wp*cross(f, f)
   self%n = 1
   self%kind(1) = kind_j
   self%value(1) = f(1, 1)*cofactor(1, 1) + f(1, 2)*cofactor(1, 2) + f(1, 3)*cofactor(1, 3)
   if (gradients) self%gradient(:, :, 1) = cofactor
   if (active(kind_i1)) then
      self%n = self%n + 1
      self%kind(self%n) = kind_i1
      self%value(self%n) = sum(f*f)
      if (gradients) self%gradient(:, :, self%n) = 2.0_wp*f
   end if
   if (active(kind_i2)) then
      self%n = self%n + 1
      self%kind(self%n) = kind_i2
      self%value(self%n) = sum(cofactor*cofactor)
      if (gradients) self%gradient(:, :, self%n) = 2.0_wp*cross(cofactor, f)
   end if
   ! Written so that a NaN is not taken for "no fiber"
   if (active(kind_i4) .and. .not. all(abs(fiber) <= 0.0_wp)) then
      self%n = self%n + 1
      self%kind(self%n) = kind_i4
      self%fiber = fiber
      self%pushed = f(:, 1)*fiber(1) + f(:, 2)*fiber(2) + f(:, 3)*fiber(3)
      self%value(self%n) = sum(self%pushed**2)
      if (gradients) then
         do a = 1, 3
            self%gradient(:, a, self%n) = 2.0_wp*self%pushed*fiber(a)
         end do
      end if
   end if
end subroutine set_invariants

!> P_iA = W_,iA, thesis (C.1)
pure subroutine first_tensor(inv, w, p)
   !> Invariants with first derivatives
   type(invariants_type), intent(in) :: inv
   !> Derivatives of W, first order
   type(derivatives_type), intent(in) :: w
   !> First Piola-Kirchhoff stress P(i,A) [stress]
   real(wp), intent(out) :: p(3, 3)
   integer :: n

   p = w%first(1)*inv%gradient(:, :, 1)
   do n = 2, inv%n
      p = p + w%first(n)*inv%gradient(:, :, n)
   end do
end subroutine first_tensor

!> C4_iAjB = W_,iAjB, thesis (C.5)
pure subroutine second_tensor(nd, inv, w, c4)
   !> Space dimension, 2 or 3
   integer, intent(in) :: nd
   !> Invariants with first derivatives
   type(invariants_type), intent(in) :: inv
   !> Derivatives of W, second order
   type(derivatives_type), intent(in) :: w
   !> Tangent C4(i,A,j,B), indices up to nd [stress]
   real(wp), intent(inout) :: c4(3, 3, 3, 3)
   real(wp) :: s(3, 3)
   integer :: n, i, a, j, b

   do n = 1, inv%n
      s = weighted_gradient(inv, w%second(:, n))
      do b = 1, nd
         do j = 1, nd
            if (n == 1) then
               c4(:nd, :nd, j, b) = s(:nd, :nd)*inv%gradient(j, b, n)
            else
               c4(:nd, :nd, j, b) = c4(:nd, :nd, j, b) + s(:nd, :nd)*inv%gradient(j, b, n)
            end if
         end do
      end do
   end do

   do n = 1, inv%n
      select case (inv%kind(n))
      case (kind_j)
         s = w%first(n)*inv%f
         do a = 1, pairs(nd)
            do i = 1, pairs(nd)
               j = next(i)
               b = next(a)
               c4(i, a, j, b) = c4(i, a, j, b) + s(prev(i), prev(a))
               c4(j, b, i, a) = c4(j, b, i, a) + s(prev(i), prev(a))
               c4(i, b, j, a) = c4(i, b, j, a) - s(prev(i), prev(a))
               c4(j, a, i, b) = c4(j, a, i, b) - s(prev(i), prev(a))
            end do
         end do
      case (kind_i1)
         do a = 1, nd
            do i = 1, nd
               c4(i, a, i, a) = c4(i, a, i, a) + 2.0_wp*w%first(n)
            end do
         end do
      case (kind_i2)
         call add_second_i2(nd, inv%f, w%first(n), c4)
      case default
         ! kind_i4
         do b = 1, nd
            do a = 1, nd
               do i = 1, nd
                  c4(i, a, i, b) = c4(i, a, i, b) &
                     & + 2.0_wp*w%first(n)*inv%fiber(a)*inv%fiber(b)
               end do
            end do
         end do
      end select
   end do
end subroutine second_tensor

!> T_ikC = C6_iAjBkC H_jBA, thesis (5.66) with (C.10)-(C.17), C6 never formed.
!>
!> With G = H(:,:,A) as a direction for every A, T is the sum over A of row (i,A) of the
!> directional derivative of C4, so only I_,FF[G] of each invariant is needed, never I_,FF itself.
pure subroutine third_tensor(nd, inv, w, h, t)
   !> Space dimension, 2 or 3
   integer, intent(in) :: nd
   !> Invariants with first derivatives
   type(invariants_type), intent(in) :: inv
   !> Derivatives of W, third order
   type(derivatives_type), intent(in) :: w
   !> Second derivatives of the displacement H(j,B,A) = u_j,BA, no symmetry is assumed [1/length]
   real(wp), intent(in) :: h(3, 3, 3)
   !> Contraction T(i,k,C), indices up to nd [stress/length]
   real(wp), intent(inout) :: t(3, 3, 3)
   !> I_,FF[G_A] of each invariant, and the same scalar by scalar
   real(wp) :: q(3, 3, 4), slope(4), step(4)
   !> S = W_,I I_,F for the second derivatives of W by invariant n
   real(wp) :: s(3, 3, 4)
   !> Coefficients of I_,FF and of I_,F in the sum
   real(wp) :: along(3, 4), y(3, 4)
   real(wp) :: fg(3, 3)
   integer :: n, m, l, i, a, k, c

   do n = 1, inv%n
      s(:, :, n) = weighted_gradient(inv, w%second(:, n))
   end do
   along = 0.0_wp
   y = 0.0_wp
   t(:nd, :nd, :nd) = 0.0_wp
   do a = 1, nd
      fg = cross(inv%f, h(:, :, a))
      do n = 1, inv%n
         select case (inv%kind(n))
         case (kind_j)
            q(:, :, n) = fg
         case (kind_i1)
            q(:, :, n) = 2.0_wp*h(:, :, a)
         case (kind_i2)
            q(:, :, n) = 2.0_wp*(cross(fg, inv%f) + cross(inv%gradient(:, :, 1), h(:, :, a)))
         case default
            ! kind_i4
            do c = 1, 3
               q(:, c, n) = 2.0_wp*inv%fiber(c)*(h(:, 1, a)*inv%fiber(1) &
                  & + h(:, 2, a)*inv%fiber(2) + h(:, 3, a)*inv%fiber(3))
            end do
         end select
         slope(n) = sum(inv%gradient(:, :, n)*h(:, :, a))
      end do
      do n = 1, inv%n
         along(a, n) = sum(w%second(:inv%n, n)*slope(:inv%n))
         do m = 1, inv%n
            step(m) = 0.0_wp
            do l = 1, inv%n
               step(m) = step(m) + w%third(l, m, n)*slope(l)
            end do
         end do
         do m = 1, inv%n
            y(:, n) = y(:, n) + w%second(m, n)*q(:, a, m) + step(m)*inv%gradient(:, a, m)
         end do
         do c = 1, nd
            do k = 1, nd
               do i = 1, nd
                  t(i, k, c) = t(i, k, c) + s(i, a, n)*q(k, c, n)
               end do
            end do
         end do
      end do
   end do

   do n = 1, inv%n
      do c = 1, nd
         do k = 1, nd
            do i = 1, nd
               t(i, k, c) = t(i, k, c) + y(i, n)*inv%gradient(k, c, n)
            end do
         end do
      end do
      select case (inv%kind(n))
      case (kind_j)
         call add_third_j(nd, inv%f, along(:, n), w%first(n), h, t)
      case (kind_i1)
         do c = 1, nd
            do i = 1, nd
               t(i, i, c) = t(i, i, c) + 2.0_wp*along(c, n)
            end do
         end do
      case (kind_i2)
         call add_third_i2(nd, inv%f, along(:, n), w%first(n), h, t)
      case default
         ! kind_i4
         do c = 1, nd
            do i = 1, nd
               t(i, i, c) = t(i, i, c) + 2.0_wp*inv%fiber(c)*sum(along(:, n)*inv%fiber)
            end do
         end do
      end select
   end do
end subroutine third_tensor

!> Add w I2_,iAjB to C4, thesis (C.9) without the terms of J
pure subroutine add_second_i2(nd, f, w, c4)
   !> Space dimension
   integer, intent(in) :: nd
   !> Deformation gradient [-]
   real(wp), intent(in) :: f(3, 3)
   !> Factor [stress]
   real(wp), intent(in) :: w
   !> Tangent C4(i,A,j,B) [stress]
   real(wp), intent(inout) :: c4(3, 3, 3, 3)
   real(wp) :: f2(3, 3), left(3, 3), right(3, 3), trace
   integer :: i, a, j, b

   f2 = 2.0_wp*w*f
   right = matmul(transpose(f2), f)
   left = matmul(f2, transpose(f))
   trace = right(1, 1) + right(2, 2) + right(3, 3)
   do b = 1, nd
      do j = 1, nd
         do a = 1, nd
            do i = 1, nd
               c4(i, a, j, b) = c4(i, a, j, b) + 2.0_wp*f2(i, a)*f(j, b) - f2(i, b)*f(j, a)
            end do
            c4(j, a, j, b) = c4(j, a, j, b) - right(a, b)
         end do
         c4(:nd, b, j, b) = c4(:nd, b, j, b) - left(:nd, j)
         c4(j, b, j, b) = c4(j, b, j, b) + trace
      end do
   end do
end subroutine add_second_i2

!> Add along_A J_,iAkC + w J_,iAjBkC H_jBA to T
pure subroutine add_third_j(nd, f, along, w, h, t)
   !> Space dimension
   integer, intent(in) :: nd
   !> Deformation gradient [-]
   real(wp), intent(in) :: f(3, 3)
   !> Coefficients of the second derivative [stress/length]
   real(wp), intent(in) :: along(3)
   !> Coefficient of the third derivative [stress]
   real(wp), intent(in) :: w
   !> Second derivatives of the displacement [1/length]
   real(wp), intent(in) :: h(3, 3, 3)
   !> Contraction T(i,k,C) [stress/length]
   real(wp), intent(inout) :: t(3, 3, 3)
   real(wp) :: r
   integer :: i, k, m, c

   do c = 1, nd
      do i = 1, pairs(nd)
         k = next(i)
         m = prev(i)
         r = along(prev(c))*f(m, next(c)) - along(next(c))*f(m, prev(c)) &
            & + w*(h(m, next(c), prev(c)) - h(m, prev(c), next(c)))
         t(i, k, c) = t(i, k, c) + r
         t(k, i, c) = t(k, i, c) - r
      end do
   end do
end subroutine add_third_j

!> Add along_A I2_,iAkC + w I2_,iAjBkC H_jBA to T, thesis (C.15) and (C.16) without J
pure subroutine add_third_i2(nd, f, along, w, h, t)
   !> Space dimension
   integer, intent(in) :: nd
   !> Deformation gradient [-]
   real(wp), intent(in) :: f(3, 3)
   !> Coefficients of the second derivative [stress/length]
   real(wp), intent(in) :: along(3)
   !> Coefficient of the third derivative [stress]
   real(wp), intent(in) :: w
   !> Second derivatives of the displacement [1/length]
   real(wp), intent(in) :: h(3, 3, 3)
   !> Contraction T(i,k,C) [stress/length]
   real(wp), intent(inout) :: t(3, 3, 3)
   !> Derivatives of F F^T: up(k,i,C) = F_iA H_kCA, down(k,i,C) = F_iB H_kBC
   real(wp) :: up(3, 3), down(3, 3)
   real(wp) :: left(3, 3), right(3), bend(3), vector(3), scalar
   integer :: i, k, c, a

   left = matmul(f, transpose(f))
   bend = w*(h(:, 1, 1) + h(:, 2, 2) + h(:, 3, 3))
   vector = matmul(f, along)
   right = matmul(vector + bend, f)
   vector = vector + bend
   do c = 1, nd
      up = 0.0_wp
      down = 0.0_wp
      do a = 1, nd
         do i = 1, nd
            do k = 1, nd
               up(k, i) = up(k, i) + f(i, a)*h(k, c, a)
               down(k, i) = down(k, i) + f(i, a)*h(k, a, c)
            end do
         end do
      end do
      scalar = along(c)*(left(1, 1) + left(2, 2) + left(3, 3)) - right(c)
      do i = 1, nd
         scalar = scalar + w*(2.0_wp*down(i, i) - up(i, i))
      end do
      do k = 1, nd
         do i = 1, nd
            t(i, k, c) = t(i, k, c) + 4.0_wp*vector(i)*f(k, c) - 2.0_wp*f(i, c)*vector(k) &
               & - 2.0_wp*along(c)*left(i, k) + w*(4.0_wp*up(k, i) - 2.0_wp*up(i, k) &
               & - 2.0_wp*(down(k, i) + down(i, k)))
         end do
         t(k, k, c) = t(k, k, c) + 2.0_wp*scalar
      end do
   end do
end subroutine add_third_i2

!> Sum of the gradients, weighted by one column of second derivatives of W
pure function weighted_gradient(inv, weight) result(s)
   !> Invariants with first derivatives
   type(invariants_type), intent(in) :: inv
   !> Factors of the invariants in use [stress]
   real(wp), intent(in) :: weight(4)
   !> Sum S(i,A) [stress]
   real(wp) :: s(3, 3)
   integer :: n

   s = weight(1)*inv%gradient(:, :, 1)
   do n = 2, inv%n
      s = s + weight(n)*inv%gradient(:, :, n)
   end do
end function weighted_gradient

!> Number of cyclic pairs of indices: (1,2), (2,3), (3,1) in space, (1,2) in the plane
pure integer function pairs(nd)
   !> Space dimension
   integer, intent(in) :: nd

   pairs = merge(3, 1, nd == 3)
end function pairs

end module rk_tensors
