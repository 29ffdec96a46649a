!> Two tissues in layers at one place: the stress of the mean deformation.
!>
!> Across an interface the displacement and the traction are continuous, the gradient of the
!> displacement along the normal is not. Where smooth functions spread an interface over a few
!> points, both tissues with the mean gradient F would be a parallel coupling: too stiff, by an
!> error in proportion to the spacing. The tissues take the gradients
!>
!>     F_k = F + s_k a (x) N,   s_1 = x_2, s_2 = -x_1
!>
!> with the jump a at which the energy sum x_k W_k(F_k) is least, so that the tractions P_k N are
!> equal. The mean of F_k is F, that of det F_k is det F. Energies here lack the mean change of
!> volume K/2 (J - 1)^2 with 1/K = sum x_k/K_k, which the weak forms take from the pressure of a
!> group; what remains is that tissues share it as their moduli want.
!>
!> The caller evaluates both laws, so that materials and the cells of reduced models share this:
!>
!>     call layers%start(...)
!>     do while (.not. layers%done)
!>        set layers%p and layers%c4 of both laws at layers%f, where all(layers%j > 0)
!>        call layers%next()
!>     end do
!>
!> Reference: Milton, The Theory of Composites (2002), chapter 9, doi:10.1017/CBO9780511613357
module rk_laminate
   use rk_precision, only : wp
   use rk_tensor, only : add_cross_form, cofactor, determinant, solve_definite
   implicit none
   private

   public :: layers_type, add_volume

   !> Most iterations for the jump, and most halvings of one of them
   integer, parameter :: most = 30, halvings = 12
   !> Difference of the tractions over the stresses at which they are equal [-]
   real(wp), parameter :: equal = 1.0e-12_wp
   !> The same where rounding allows no less [-]
   real(wp), parameter :: rough = 1.0e-7_wp
   !> Bulk moduli count up to so many times the larger shear modulus: where they are larger, the
   !> volume hardly changes, and that of a single integration point, which a group's pressure
   !> leaves free, must not part the tissues. Newton's iteration takes a beam of two layers in one
   !> step with 10, but not with 20 [-]
   real(wp), parameter :: stiffest = 10.0_wp

   !> Both tissues at a place
   type :: layers_type
      !> Deformation gradients, shape (3, 3, 2) [-]
      real(wp) :: f(3, 3, 2)
      !> Volume ratio of each tissue and of both [-]
      real(wp) :: j(2), whole
      !> Stresses, and their derivatives: those of the laws without change of volume before `next`,
      !> with it after, shapes (3, 3, 2), (3, 3, 3, 3, 2) [stress]
      real(wp) :: p(3, 3, 2), c4(3, 3, 3, 3, 2)
      !> Fractions, whose sum is 1 [-]
      real(wp) :: fraction(2)
      !> Bulk moduli, and that at one pressure [stress]
      real(wp) :: bulk(2), mean
      !> Whether the jump is known
      logical :: done
      !> Space dimension: 3, or 2 for plane strain, where the jump lies in the plane
      integer, private :: nd
      !> Normal, mean gradient, jump, the best jump, step from it
      real(wp), private :: normal(3), mean_f(3, 3), jump(3), best(3), step(3)
      !> Difference of the tractions and sum of the stresses at the best jump, and what counts for
      !> none of them [stress]
      real(wp), private :: before, nothing, size
      !> Iterations, halvings of the step
      integer, private :: turn, halved
      !> Whether the tractions agree, whether the next evaluation is the last
      logical, private :: found, last
   contains
      procedure :: start, next, stress, tangent
   end type layers_type

contains

!> Begin without a jump
pure subroutine start(self, f, fraction, normal, nd, bulk, shear)
   class(layers_type), intent(inout) :: self
   !> Mean deformation gradient [-]
   real(wp), intent(in) :: f(3, 3)
   !> Fractions, whose sum is 1, shape (2) [-]
   real(wp), intent(in) :: fraction(2)
   !> Normal of the layers, unit vector in the reference body [-]
   real(wp), intent(in) :: normal(3)
   !> Space dimension
   integer, intent(in) :: nd
   !> Bulk moduli, which may be infinite, and shear moduli, shape (2) [stress]
   real(wp), intent(in) :: bulk(2), shear(2)

   self%fraction = fraction
   self%normal = normal
   self%nd = nd
   self%mean_f = f
   self%whole = determinant(f)
   self%bulk = min(bulk, stiffest*maxval(shear))
   self%mean = 0.0_wp
   if (all(self%bulk > 0.0_wp)) self%mean = 1.0_wp/sum(fraction/self%bulk)
   self%nothing = epsilon(1.0_wp)*sum(shear)
   self%jump = 0.0_wp
   self%turn = 0
   self%halved = 0
   self%found = .false.
   self%last = .false.
   self%done = .false.
   call set_gradients(self)
end subroutine start

!> Take stresses at the jump that was asked for, and choose the next one. Where none is found both
!> tissues have the mean gradient.
pure subroutine next(self)
   class(layers_type), intent(inout) :: self
   real(wp) :: r(self%nd), q(self%nd, self%nd), step(self%nd, 1), apart
   integer :: k
   logical :: better

   apart = huge(1.0_wp)
   if (all(self%j > 0.0_wp)) then
      do k = 1, 2
         self%p(:, :, k) = self%p(:, :, k) &
            & + self%bulk(k)*(self%j(k) - 1.0_wp)*cofactor(self%f(:, :, k))
         call add_volume(self%bulk(k), self%f(:, :, k), self%c4(:, :, :, :, k))
      end do
      r = difference(self)
      apart = norm2(r)
   end if
   self%done = self%last .or. self%turn == 0 .and. .not. apart < huge(1.0_wp)
   if (self%done) return
   better = self%turn == 0 .or. apart < self%before
   if (.not. better) then
      self%halved = self%halved + 1
      if (self%halved < halvings) then
         self%jump = self%best + 0.5_wp**self%halved*self%step
      else
         ! rounding, or a state whose layers have no equilibrium
         self%found = self%before <= rough*self%size
         self%last = .true.
         self%jump = merge(self%best, 0.0_wp, self%found)
      end if
      call set_gradients(self)
      return
   end if
   self%best = self%jump
   self%before = apart
   self%turn = self%turn + 1
   self%halved = 0
   self%size = sum(abs(self%p)) + self%nothing
   self%found = apart <= equal*self%size
   self%done = self%found
   if (self%done) return
   q = acoustic(self)
   step(:, 1) = -self%fraction(1)*self%fraction(2)*r
   call solve_definite(q, step)
   if (self%turn > most .or. .not. dot_product(step(:, 1), r) < 0.0_wp) then
      self%last = .true.
      self%jump = 0.0_wp
   else
      self%step = 0.0_wp
      self%step(:self%nd) = step(:, 1)
      self%jump = self%best + self%step
   end if
   call set_gradients(self)
end subroutine next

!> Stress of both tissues or of one of them, times fractions, without the mean change of volume
pure function stress(self, k) result(p)
   class(layers_type), intent(in) :: self
   !> Tissue, 0 for both
   integer, intent(in) :: k
   !> Stress P(i,A) [stress]
   real(wp) :: p(3, 3)
   integer :: l

   p = 0.0_wp
   do l = 1, 2
      if (k > 0 .and. l /= k) cycle
      p = p + self%fraction(l)*(self%p(:, :, l) &
         & - self%mean*(self%whole - 1.0_wp)*cofactor(self%mean_f))
   end do
end function stress

!> Derivative of the stress of both tissues by the mean gradient
pure function tangent(self) result(c4)
   class(layers_type), intent(in) :: self
   !> Tangent C4(i,A,j,B) [stress]
   real(wp) :: c4(3, 3, 3, 3)

   c4 = self%fraction(1)*self%c4(:, :, :, :, 1) + self%fraction(2)*self%c4(:, :, :, :, 2)
   if (self%found) call give_way(self, c4)
   call add_volume(-self%mean, self%mean_f, c4)
end function tangent

!> Gradients of the tissues at the jump
pure subroutine set_gradients(self)
   class(layers_type), intent(inout) :: self
   integer :: b, k

   do k = 1, 2
      self%f(:, :, k) = self%mean_f
      do b = 1, self%nd
         self%f(:, b, k) = self%f(:, b, k) + share(self, k)*self%normal(b)*self%jump
      end do
      self%j(k) = determinant(self%f(:, :, k))
   end do
end subroutine set_gradients

!> Share s_k of the jump that a tissue takes [-]
pure real(wp) function share(self, k)
   class(layers_type), intent(in) :: self
   integer, intent(in) :: k

   share = merge(self%fraction(2), -self%fraction(1), k == 1)
end function share

!> Difference of the tractions [stress]
pure function difference(self) result(r)
   class(layers_type), intent(in) :: self
   real(wp) :: r(self%nd), traction(3)

   traction = matmul(self%p(:, :, 1) - self%p(:, :, 2), self%normal)
   r = traction(:self%nd)
end function difference

!> Second derivatives of the energy by the jump [stress]
pure function acoustic(self) result(q)
   class(layers_type), intent(in) :: self
   real(wp) :: q(self%nd, self%nd)
   integer :: a, b, k

   q = 0.0_wp
   do k = 1, 2
      do b = 1, self%nd
         do a = 1, self%nd
            q = q + self%fraction(k)*share(self, k)**2*self%normal(a)*self%normal(b) &
               & *self%c4(:self%nd, a, :self%nd, b, k)
         end do
      end do
   end do
end function acoustic

!> Take from the tangent what the jump gives way
pure subroutine give_way(self, c4)
   class(layers_type), intent(in) :: self
   !> Tangent of both tissues with the same gradient on entry [stress]
   real(wp), intent(inout) :: c4(3, 3, 3, 3)
   real(wp) :: mixed(self%nd, 3, 3), both(self%nd, 9), solved(self%nd, 9), q(self%nd, self%nd)
   integer :: a, k

   mixed = 0.0_wp
   do k = 1, 2
      do a = 1, self%nd
         mixed = mixed + self%fraction(k)*share(self, k)*self%normal(a) &
            & *self%c4(:self%nd, a, :, :, k)
      end do
   end do
   both = reshape(mixed, [self%nd, 9])
   solved = both
   q = acoustic(self)
   call solve_definite(q, solved)
   c4 = c4 - reshape(matmul(transpose(both), solved), [3, 3, 3, 3])
end subroutine give_way

!> Add the derivative of K (J - 1) cof F
pure subroutine add_volume(bulk, f, c4)
   !> Bulk modulus K [stress]
   real(wp), intent(in) :: bulk
   !> Deformation gradient [-]
   real(wp), intent(in) :: f(3, 3)
   real(wp), intent(inout) :: c4(3, 3, 3, 3)
   real(wp) :: cof(3, 3)
   integer :: b, i

   cof = cofactor(f)
   call add_cross_form(bulk*(determinant(f) - 1.0_wp), f, c4)
   do b = 1, 3
      do i = 1, 3
         c4(:, :, i, b) = c4(:, :, i, b) + bulk*cof(i, b)*cof
      end do
   end do
end subroutine add_volume

end module rk_laminate
