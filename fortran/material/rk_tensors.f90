!> Invariants of a deformation; stress and tangent of an energy W(J, I1, I2, I4) by the chain rule.
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
!> Matrices 9x9 have the index i + 3 (A - 1) for F_iA.
!> Two-dimensional states are plane strain: F_33 = 1, other components with an index 3 are zero.
!>
!> References: thesis Appendix C, (C.1)-(C.17), for J, I1 and I2;
!>             de Boer, Vektor- und Tensorrechnung fuer Ingenieure (1982), for A x B;
!>             Bonet, Gil, Ortigosa, Comput. Methods Appl. Mech. Eng. 283 (2015),
!>             doi:10.1016/j.cma.2014.10.002
module rk_tensors
   use rk_precision, only : wp
   use rk_tensor, only : add_cross_form, cross
   implicit none
   private

   public :: invariants_type, derivatives_type, set_invariants, first_tensor, second_form
   public :: kind_i1, kind_i2, kind_i4

   !> Numbers of the invariants; the reduced ones are numbered in the same way
   integer, parameter :: kind_j = 0, kind_i1 = 1, kind_i2 = 2, kind_i4 = 3

   !> Invariants of one deformation gradient
   type :: invariants_type
      !> Number of invariants in use; J is the first
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
   end type derivatives_type

contains

!> Invariants of F and, on request, their first derivatives
pure subroutine set_invariants(self, f, fiber, active, gradients)
   type(invariants_type), intent(out) :: self
   !> Deformation gradient F_iA [-]
   real(wp), intent(in) :: f(3, 3)
   !> Fiber, unit vector; zeros switch I4 off [-]
   real(wp), intent(in) :: fiber(3)
   !> Whether I1, I2, I4 are used by the energy
   logical, intent(in) :: active(3)
   !> Whether to compute first derivatives
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
   real(wp), intent(in) :: m(3, 3)
   real(wp) :: v(9)

   ! three times as fast as reshape
   v(1:3) = m(:, 1)
   v(4:6) = m(:, 2)
   v(7:9) = m(:, 3)
end function flat

end module rk_tensors
