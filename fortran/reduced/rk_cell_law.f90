!> Stress and tangent of one cell of a reduced model in few operations: the polynomial of the
!> reduced invariants, the fibers of its tissues, and the part of the bulk modulus that acts in
!> each cell. The materials' own routines give more derivatives than an iteration needs and call a
!> material for each tissue; here a cell is one polynomial.
!>
!> Tensors are vectors of 9 here, index 3(i-1) + A of F(i, A). The energy is one of I1 = tr C,
!> I2' = |cof F|^2, I4 = |F N|^2 of each fiber and J; its derivatives are sums of products of the
!> invariants' own, 2F, G2, G4 and cof F.
!>
!> References: thesis (4.34)-(4.36), (5.37a)
module rk_cell_law
   use rk_fiber, only : curve_type, evaluate_curve
   use rk_precision, only : wp
   implicit none
   private

   public :: law_type, cell_law

   !> Fibers of one tissue
   type :: law_type
      !> Stretch of optimal length [-]
      real(wp) :: lambda_o = 1.0_wp
      !> Active and passive force
      type(curve_type) :: active, passive
      !> Unit axis about which fibers are turned [-]
      real(wp) :: axis(3) = [0.0_wp, 1.0_wp, 0.0_wp]
   end type law_type

   !> Invariants of a cell with their derivatives
   type :: invariants_type
      !> C = F^T F
      real(wp) :: c(3, 3)
      !> cof F and the derivative of I2'
      real(wp) :: cof(9), g2(9)
      !> Reduced invariants, J^(-2/3), J^(-4/3), 1/J
      real(wp) :: r1, r2, jm, jm2, inverse
      !> First and second derivatives of the polynomial by r1 and r2
      real(wp) :: u1, u2, u11, u12, u22
   end type invariants_type

   real(wp), parameter :: t = 1.0_wp/3.0_wp

contains

!> Invariants; J is their third number
pure subroutine set_invariants(self, f, a, j)
   type(invariants_type), intent(out) :: self
   !> F [-]
   real(wp), intent(in) :: f(9)
   !> A10, A01, A20, A11, A02, A30, A21, A12, A03 [stress]
   real(wp), intent(in) :: a(9)
   !> Volume ratio; without a positive one nothing else is set [-]
   real(wp), intent(out) :: j
   real(wp) :: i1, x, y
   integer :: i, k, l

   self%cof = [f(5)*f(9) - f(6)*f(8), f(6)*f(7) - f(4)*f(9), f(4)*f(8) - f(5)*f(7), &
      & f(3)*f(8) - f(2)*f(9), f(1)*f(9) - f(3)*f(7), f(2)*f(7) - f(1)*f(8), &
      & f(2)*f(6) - f(3)*f(5), f(3)*f(4) - f(1)*f(6), f(1)*f(5) - f(2)*f(4)]
   j = f(1)*self%cof(1) + f(2)*self%cof(2) + f(3)*self%cof(3)
   if (.not. j > 0.0_wp) return
   do k = 1, 3
      do l = 1, k
         self%c(k, l) = f(k)*f(l) + f(3 + k)*f(3 + l) + f(6 + k)*f(6 + l)
         self%c(l, k) = self%c(k, l)
      end do
   end do
   i1 = self%c(1, 1) + self%c(2, 2) + self%c(3, 3)
   do i = 0, 6, 3
      do k = 1, 3
         self%g2(i + k) = 2.0_wp*(i1*f(i + k) - f(i + 1)*self%c(1, k) - f(i + 2)*self%c(2, k) &
            & - f(i + 3)*self%c(3, k))
      end do
   end do
   self%inverse = 1.0_wp/j
   self%jm = exp(-2.0_wp*t*log(j))
   self%jm2 = self%jm**2
   self%r1 = self%jm*i1
   self%r2 = self%jm2*sum(self%cof**2)
   x = self%r1 - 3.0_wp
   y = self%r2 - 3.0_wp
   self%u1 = a(1) + 2.0_wp*a(3)*x + a(4)*y + 3.0_wp*a(6)*x**2 + 2.0_wp*a(7)*x*y + a(8)*y**2
   self%u2 = a(2) + a(4)*x + 2.0_wp*a(5)*y + a(7)*x**2 + 2.0_wp*a(8)*x*y + 3.0_wp*a(9)*y**2
   self%u11 = 2.0_wp*a(3) + 6.0_wp*a(6)*x + 2.0_wp*a(7)*y
   self%u12 = a(4) + 2.0_wp*a(7)*x + 2.0_wp*a(8)*y
   self%u22 = 2.0_wp*a(5) + 2.0_wp*a(8)*x + 6.0_wp*a(9)*y
end subroutine set_invariants

!> Fiber: derivative of I4, and those of its energy by the reduced I4
pure subroutine set_fiber(f, jm, fiber, law, passive, active, g4, r4, u4, u44)
   real(wp), intent(in) :: f(9)
   !> J^(-2/3)
   real(wp), intent(in) :: jm
   !> Direction
   real(wp), intent(in) :: fiber(3)
   type(law_type), intent(in) :: law
   !> Largest isometric stress times fraction; the same times activation [stress]
   real(wp), intent(in) :: passive, active
   !> Derivative of I4
   real(wp), intent(out) :: g4(9)
   !> Reduced I4, first and second derivative of the energy by it
   real(wp), intent(out) :: r4, u4, u44
   real(wp) :: along(3), stretch, k, d(0:2), e(0:2)
   integer :: i

   do i = 1, 3
      along(i) = f(3*i - 2)*fiber(1) + f(3*i - 1)*fiber(2) + f(3*i)*fiber(3)
      g4(3*i - 2:3*i) = 2.0_wp*along(i)*fiber
   end do
   r4 = jm*sum(along**2)
   stretch = sqrt(r4)/law%lambda_o
   call evaluate_curve(law%active, stretch, 2, d)
   call evaluate_curve(law%passive, stretch, 2, e)
   d = active*d + passive*e
   k = 0.5_wp/law%lambda_o**2
   u4 = k*d(1)/stretch
   u44 = k**2*(d(2) - d(1)/stretch)/stretch**2
end subroutine set_fiber

!> First Piola-Kirchhoff stress and, where wanted, its derivative by F
pure subroutine cell_law(f, a, local_bulk, laws, tissue, fiber, passive, active, p, j, c)
   !> F [-]
   real(wp), intent(in) :: f(9)
   !> A10, A01, A20, A11, A02, A30, A21, A12, A03 [stress]
   real(wp), intent(in) :: a(9)
   !> Bulk modulus of the cell itself [stress]
   real(wp), intent(in) :: local_bulk
   !> Fibers of all tissues
   type(law_type), intent(in) :: laws(:)
   !> Tissues with fibers in the cell, shape (k)
   integer, intent(in) :: tissue(:)
   !> Their directions, shape (3, k)
   real(wp), intent(in) :: fiber(:, :)
   !> Largest isometric stress times fraction, and that times activation, shape (k) [stress]
   real(wp), intent(in) :: passive(:), active(:)
   !> Stress [stress]
   real(wp), intent(out) :: p(9)
   !> Volume ratio [-]
   real(wp), intent(out) :: j
   !> Symmetric tangent [stress]
   real(wp), intent(out), optional :: c(9, 9)
   type(invariants_type) :: at
   real(wp) :: g4(9), r4, u4, u44, s, wj, wjj, w1, w2, w11, w12, w22, w1j, w2j, w4j, i1
   real(wp) :: left(9, 3)
   integer :: e, k, l, m

   p = 0.0_wp
   if (present(c)) c = 0.0_wp
   call set_invariants(at, f, a, j)
   if (.not. j > 0.0_wp) return
   w1 = at%jm*at%u1
   w2 = at%jm2*at%u2
   s = 2.0_wp*t*at%r1*at%u1 + 4.0_wp*t*at%r2*at%u2
   wj = -at%inverse*s + local_bulk*(j - 1.0_wp)
   wjj = at%inverse**2*(s + 4.0_wp*t**2*at%r1*at%u1 + 16.0_wp*t**2*at%r2*at%u2 &
      & + 4.0_wp*t**2*at%r1**2*at%u11 + 16.0_wp*t**2*at%r1*at%r2*at%u12 &
      & + 16.0_wp*t**2*at%r2**2*at%u22) + local_bulk
   w11 = at%jm**2*at%u11
   w12 = at%jm*at%jm2*at%u12
   w22 = at%jm2**2*at%u22
   w1j = -at%inverse*at%jm*(2.0_wp*t*(at%u1 + at%r1*at%u11) + 4.0_wp*t*at%r2*at%u12)
   w2j = -at%inverse*at%jm2*(4.0_wp*t*(at%u2 + at%r2*at%u22) + 2.0_wp*t*at%r1*at%u12)
   p = 2.0_wp*w1*f + w2*at%g2
   do e = 1, size(tissue)
      call set_fiber(f, at%jm, fiber(:, e), laws(tissue(e)), passive(e), active(e), g4, r4, u4, u44)
      p = p + at%jm*u4*g4
      wj = wj - 2.0_wp*t*at%inverse*r4*u4
      if (.not. present(c)) cycle
      wjj = wjj + at%inverse**2*(2.0_wp*t*r4*u4 + 4.0_wp*t**2*r4*(u4 + r4*u44))
      w4j = -at%inverse*at%jm*2.0_wp*t*(u4 + r4*u44)
      do k = 1, 9
         c(:, k) = c(:, k) + at%jm**2*u44*g4(k)*g4 + w4j*(at%cof(k)*g4 + g4(k)*at%cof)
      end do
      do k = 1, 3
         do l = 1, 3
            do m = 0, 6, 3
               c(m + l, m + k) = c(m + l, m + k) + 2.0_wp*at%jm*u4*fiber(l, e)*fiber(k, e)
            end do
         end do
      end do
   end do
   p = p + wj*at%cof
   if (.not. present(c)) return
   left(:, 1) = 4.0_wp*(w11 + w2)*f + 2.0_wp*w12*at%g2 + 2.0_wp*w1j*at%cof
   left(:, 2) = 2.0_wp*w12*f + w22*at%g2 + w2j*at%cof
   left(:, 3) = 2.0_wp*w1j*f + w2j*at%g2 + wjj*at%cof
   do k = 1, 9
      c(:, k) = c(:, k) + left(:, 1)*f(k) + left(:, 2)*at%g2(k) + left(:, 3)*at%cof(k)
   end do
   i1 = at%c(1, 1) + at%c(2, 2) + at%c(3, 3)
   call add_second(c, f, at%c, w2, 2.0_wp*(w1 + w2*i1), wj)
end subroutine cell_law

!> Second derivatives of I1, I2' (without 4 F F, which is with the products) and J by F
pure subroutine add_second(c, f, right, w2, w1, wj)
   !> Tangent, to which they are added
   real(wp), intent(inout) :: c(9, 9)
   !> F and C = F^T F
   real(wp), intent(in) :: f(9), right(3, 3)
   !> Derivative of the energy by I2'; factor of the unit tensor; derivative by J
   real(wp), intent(in) :: w2, w1, wj
   real(wp) :: left
   integer :: i, k, a, b
   !> Entries of the second derivative of the determinant above the diagonal: plus or minus F
   integer, parameter :: row(18) = [1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 5, 5, 6, 6]
   integer, parameter :: column(18) = [5, 6, 8, 9, 4, 6, 7, 9, 4, 5, 7, 8, 8, 9, 7, 9, 7, 8]
   integer, parameter :: entry(18) = [9, -8, -6, 5, -9, 7, 6, -4, 8, -7, -5, 4, 3, -2, -3, 1, 2, -1]

   do k = 0, 6, 3
      do i = 0, 6, 3
         left = f(i + 1)*f(k + 1) + f(i + 2)*f(k + 2) + f(i + 3)*f(k + 3)
         do b = 1, 3
            do a = 1, 3
               c(i + a, k + b) = c(i + a, k + b) - 2.0_wp*w2*f(i + b)*f(k + a)
            end do
            c(i + b, k + b) = c(i + b, k + b) - 2.0_wp*w2*left
         end do
         if (i /= k) cycle
         do b = 1, 3
            c(i + 1:i + 3, k + b) = c(i + 1:i + 3, k + b) - 2.0_wp*w2*right(:, b)
            c(i + b, k + b) = c(i + b, k + b) + w1
         end do
      end do
   end do
   do i = 1, size(row)
      k = abs(entry(i))
      left = merge(wj, -wj, entry(i) > 0)*f(k)
      c(row(i), column(i)) = c(row(i), column(i)) + left
      c(column(i), row(i)) = c(column(i), row(i)) + left
   end do
end subroutine add_second

end module rk_cell_law
