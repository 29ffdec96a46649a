!> Energies of materials, by their names in decks. A new one needs a type here and its rows in the
!> schema.
!>
!>     polynomial      W_r = sum A_ij (I1r - 3)^i (I2r - 3)^j,   1 <= i + j <= 3
!>     neo-hookean     W_r = mu/2 (I1r - 3)                                    A10 = mu/2
!>     mooney-rivlin   W_r = C1 (I1r - 3) + C2 (I2r - 3)                       A10 = C1, A01 = C2
!>     yeoh            W_r = C1 (I1r - 3) + C2 (I1r - 3)^2 + C3 (I1r - 3)^3    A10, A20, A30
!>     muscle          polynomial matrix and fibers that carry and produce force,
!>                     dW_f/dlambda* = sigma_max (activation f_active + f_passive)
!>     energy          W_r as an expression in I1r, I2r, I4r, the activation and constants
!>     gent, fung, holzapfel   named expressions
!>
!> all with K/2 (J - 1)^2. Abaqus has the first three named ones, with K = 2/D1. In muscle, lambda*
!> = lambda/lambda_o with lambda^2 = I4r, the reduced square of the fiber stretch; the energy of the
!> fibers is zero at lambda* = 1. Fibers v and -v are the same; a zero fiber vector leaves only the
!> matrix.
!>
!> References: thesis (4.34)-(4.36), (4.39), (5.37a);
!>             Rivlin, Phil. Trans. R. Soc. A 240 (1948), doi:10.1098/rsta.1948.0002;
!>             Rivlin, Saunders, Phil. Trans. R. Soc. A 243 (1951), doi:10.1098/rsta.1951.0004;
!>             Mooney, J. Appl. Phys. 11 (1940), doi:10.1063/1.1712836;
!>             Yeoh, Rubber Chem. Technol. 66 (1993), doi:10.5254/1.3538343;
!>             Gent, Rubber Chem. Technol. 69 (1996), doi:10.5254/1.3538357;
!>             Demiray, J. Biomech. 5 (1972), doi:10.1016/0021-9290(72)90047-4 (Fung's exponential
!>             of I1);
!>             Holzapfel, Gasser, Ogden, J. Elast. 61 (2000), doi:10.1023/A:1010835316564;
!>             Blemker, Pinsky, Delp, J. Biomech. 38 (2005), doi:10.1016/j.jbiomech.2004.04.009
module rk_energies
   use, intrinsic :: ieee_arithmetic, only : ieee_is_finite
   use rk_deck, only : deck_type
   use rk_error, only : err_input, error_type, fatal_error
   use rk_expression, only : new_tape, tape_type
   use rk_fiber, only : active_curve, curve_type, evaluate_curve, passive_curve
   use rk_jets, only : jets_type, new_jets
   use rk_material, only : kind_i1, kind_i2, kind_i4, material_type, &
      & energy_derivatives, invariant_state
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: muscle_type, new_material, polynomial_type

   !> Keys whose numbers may be constants of an expression
   character(len=*), parameter :: constants(7) = ['mu', 'C1', 'C2', 'C3', 'Jm', 'k1', 'k2']

   !> Isotropic material, given by all coefficients or by those of a named law
   type, extends(material_type) :: polynomial_type
      !> Coefficients A_ij, zero where i + j > 3 [stress]
      real(wp) :: a(0:3, 0:3) = 0.0_wp
   contains
      procedure :: set => set_polynomial, reduced => polynomial_energy
   end type polynomial_type

   type, extends(polynomial_type) :: muscle_type
      !> Largest isometric stress, >= 0 [stress]
      real(wp) :: sigma_max
      !> Stretch of optimal length, > 0 [-]
      real(wp) :: lambda_o
      !> Factor, >= 0, and rate, > 0, of the passive force [-]
      real(wp) :: gamma1, gamma2
      type(curve_type) :: active_force
      type(curve_type) :: passive_force
   contains
      procedure :: set => set_muscle, reduced => muscle_energy
   end type muscle_type

   !> An energy that is given as an expression
   type, extends(material_type) :: written_type
      !> The expression with its derivatives
      type(jets_type) :: jets
   contains
      procedure :: set => set_written, reduced => written_energy
   end type written_type

contains

!> Create a material from a table of a deck, which was checked against the schema
subroutine new_material(material, deck, at, error)
   class(material_type), allocatable, intent(out) :: material
   type(deck_type), intent(in) :: deck
   !> The table, such as material.1
   character(len=*), intent(in) :: at
   !> Error handling: a modulus that is not positive, an expression that is not an energy
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: model

   call deck%get(at//'.model', model)
   select case (model)
   case ('muscle')
      allocate (muscle_type :: material)
   case ('energy', 'gent', 'fung', 'holzapfel')
      allocate (written_type :: material)
   case default
      allocate (polynomial_type :: material)
   end select
   call deck%get(at//'.name', material%name)
   ! an infinite K makes the material incompressible
   call deck%get(at//'.K', material%bulk)
   call material%set(deck, at, error)
end subroutine new_material

!> Read the coefficients and derive the moduli from them
subroutine set_polynomial(self, deck, at, error)
   class(polynomial_type), intent(inout) :: self
   type(deck_type), intent(in) :: deck
   character(len=*), intent(in) :: at
   type(error_type), allocatable, intent(out) :: error
   !> Half the shear modulus in terms of the parameters, for messages
   character(len=:), allocatable :: half, model
   integer :: i, j

   call deck%get(at//'.model', model)
   select case (model)
   case ('neo-hookean')
      half = 'mu/2'
      call deck%get(at//'.mu', self%a(1, 0))
      self%a(1, 0) = 0.5_wp*self%a(1, 0)
   case ('mooney-rivlin')
      half = 'C1 + C2'
      call deck%get(at//'.C1', self%a(1, 0))
      call deck%get(at//'.C2', self%a(0, 1))
   case ('yeoh')
      half = 'C1'
      do i = 1, 3
         call deck%get(at//'.C'//to_text(i), self%a(i, 0))
      end do
   case default
      half = 'A10 + A01'
      do i = 0, 3
         do j = merge(1, 0, i == 0), 3 - i
            call deck%get(at//'.A'//to_text(i)//to_text(j), self%a(i, j))
         end do
      end do
   end select
   associate (a => self%a)
      self%shear = 2.0_wp*(a(1, 0) + a(0, 1))
      self%active(kind_i1) = any(abs(a(1:, :)) > 0.0_wp)
      self%active(kind_i2) = any(abs(a(:, 1:)) > 0.0_wp)
      if (.not. self%shear > 0.0_wp) call fatal_error(error, err_input, "material '"//self%name &
         & //"': "//half//" = "//to_text(a(1, 0) + a(0, 1))//" must be positive, it is half " &
         & //"the shear modulus")
   end associate
end subroutine set_polynomial

!> Polynomial and its derivatives
pure subroutine polynomial_energy(self, state, order, w)
   class(polynomial_type), intent(in) :: self
   type(invariant_state), intent(in) :: state
   integer, intent(in) :: order
   type(energy_derivatives), intent(out) :: w
   real(wp) :: x, y

   x = state%reduced(kind_i1) - 3.0_wp
   y = state%reduced(kind_i2) - 3.0_wp
   associate (a => self%a)
      w%energy = x*(a(1, 0) + x*(a(2, 0) + x*a(3, 0))) + y*(a(0, 1) + y*(a(0, 2) + y*a(0, 3))) &
         & + x*y*(a(1, 1) + x*a(2, 1) + y*a(1, 2))
      if (order < 1) return
      w%first(1) = a(1, 0) + x*(2.0_wp*a(2, 0) + x*3.0_wp*a(3, 0))
      w%second(1, 1) = 2.0_wp*a(2, 0) + x*6.0_wp*a(3, 0)
      if (.not. self%active(kind_i2)) return

      w%first(1) = w%first(1) + y*(a(1, 1) + 2.0_wp*x*a(2, 1) + y*a(1, 2))
      w%first(2) = a(0, 1) + y*(2.0_wp*a(0, 2) + y*3.0_wp*a(0, 3)) &
         & + x*(a(1, 1) + x*a(2, 1) + 2.0_wp*y*a(1, 2))
      w%second(1, 1) = w%second(1, 1) + 2.0_wp*y*a(2, 1)
      w%second(1, 2) = a(1, 1) + 2.0_wp*(x*a(2, 1) + y*a(1, 2))
      w%second(2, 1) = w%second(1, 2)
      w%second(2, 2) = 2.0_wp*(a(0, 2) + x*a(1, 2)) + y*6.0_wp*a(0, 3)
   end associate
end subroutine polynomial_energy

!> Read the parameters of the matrix and of the fibers
subroutine set_muscle(self, deck, at, error)
   class(muscle_type), intent(inout) :: self
   type(deck_type), intent(in) :: deck
   character(len=*), intent(in) :: at
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: curve
   logical :: smooth

   call self%polynomial_type%set(deck, at, error)
   call deck%get(at//'.sigma_max', self%sigma_max)
   call deck%get(at//'.lambda_o', self%lambda_o)
   call deck%get(at//'.gamma1', self%gamma1)
   call deck%get(at//'.gamma2', self%gamma2)
   call deck%get(at//'.curve', curve)
   smooth = curve == 'smooth'
   self%active_force = active_curve(smooth)
   self%passive_force = passive_curve(smooth, self%gamma1, self%gamma2)
   self%active(kind_i4) = self%sigma_max > 0.0_wp
   self%fibered = .true.
   self%kinked = .not. smooth
end subroutine set_muscle

!> Energy of matrix and fibers and its derivatives
pure subroutine muscle_energy(self, state, order, w)
   class(muscle_type), intent(in) :: self
   type(invariant_state), intent(in) :: state
   integer, intent(in) :: order
   type(energy_derivatives), intent(out) :: w
   !> Integral of the force over lambda*, the force and its derivatives [-]
   real(wp) :: f(0:2), passive(0:2)
   !> lambda*, and d lambda*/d I4r = c/lambda* [-]
   real(wp) :: stretch, c

   call self%polynomial_type%reduced(state, order, w)
   if (.not. state%fibered) return
   stretch = sqrt(state%reduced(kind_i4))/self%lambda_o
   c = 0.5_wp/self%lambda_o**2
   call evaluate_curve(self%active_force, stretch, order, f)
   call evaluate_curve(self%passive_force, stretch, order, passive)
   f(:order) = self%sigma_max*(state%activation*f(:order) + passive(:order))

   w%energy = w%energy + f(0)
   if (order < 1) return
   w%first(kind_i4) = c*f(1)/stretch
   if (order < 2) return
   w%second(kind_i1:kind_i2, kind_i4) = 0.0_wp
   w%second(kind_i4, kind_i1:kind_i2) = 0.0_wp
   w%second(kind_i4, kind_i4) = c**2*(f(2) - f(1)/stretch)/stretch**2
end subroutine muscle_energy

!> Read the expression and its constants, and check it at rest
subroutine set_written(self, deck, at, error)
   class(written_type), intent(inout) :: self
   type(deck_type), intent(in) :: deck
   character(len=*), intent(in) :: at
   type(error_type), allocatable, intent(out) :: error
   type(tape_type) :: tape
   type(energy_derivatives) :: w
   type(invariant_state) :: rest
   character(len=:), allocatable :: model, text, names, fault
   real(wp) :: values(size(constants))
   integer :: i, n

   call deck%get(at//'.model', model)
   select case (model)
   case ('gent')
      text = '-mu*Jm/2*ln(1 - (I1 - 3)/Jm)'
   case ('fung')
      text = 'mu/(2*k2)*(exp(k2*(I1 - 3)) - 1)'
   case ('holzapfel')
      text = 'mu/2*(I1 - 3) + k1/(2*k2)*(exp(k2*max(I4 - 1, 0)^2) - 1)'
   case default
      call deck%get(at//'.energy', text)
   end select
   names = ''
   n = 0
   do i = 1, size(constants)
      if (.not. deck%has(at//'.'//trim(constants(i)))) cycle
      n = n + 1
      names = names//trim(constants(i))//' '
      call deck%get(at//'.'//trim(constants(i)), values(n))
   end do
   call new_tape(tape, text, names, values(:n), fault)
   if (.not. allocated(fault)) then
      call new_jets(self%jets, tape)
      self%active = self%jets%uses(:3)
      self%fibered = self%jets%uses(kind_i4)
      self%kinked = self%jets%kinked
      w = energy_derivatives(0.0_wp, 0.0_wp, 0.0_wp)
      rest = invariant_state([3.0_wp, 3.0_wp, 1.0_wp], self%fibered, 0.0_wp)
      call self%jets%derivatives(rest, 2, w)
      self%shear = 2.0_wp*(w%first(kind_i1) + w%first(kind_i2))
      if (.not. (all(ieee_is_finite(w%first)) .and. all(ieee_is_finite(w%second)))) then
         fault = "'"//text//"' has no finite derivatives up to the second at rest, I1 = I2 = 3 " &
            & //'and I4 = 1'
      else if (.not. self%shear > 0.0_wp) then
         fault = "'"//text//"' has dW/dI1 + dW/dI2 = "//to_text(0.5_wp*self%shear)//' at rest, ' &
            & //'which must be positive: it is half the shear modulus'
      else if (.not. all([(i == tape%result .or. any(tape%left == i .or. tape%right == i), &
         & i=5, 4 + n)])) then
         fault = "'"//text//"' does not use all of its constants: "//trim(names)
      else if (self%jets%uses(4) .and. .not. self%fibered) then
         fault = "'"//text//"' has an activation but no fibers, I4, which it activates"
      end if
   end if
   if (allocated(fault)) call fatal_error(error, err_input, "material '"//self%name &
      & //"': energy = "//fault)
end subroutine set_written

!> Energy of an expression and its derivatives
pure subroutine written_energy(self, state, order, w)
   class(written_type), intent(in) :: self
   type(invariant_state), intent(in) :: state
   integer, intent(in) :: order
   type(energy_derivatives), intent(out) :: w

   call self%jets%derivatives(state, order, w)
end subroutine written_energy

end module rk_energies
