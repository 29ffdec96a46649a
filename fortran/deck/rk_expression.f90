!> Values given as expressions in coordinates, as in `u_x = "0.1*sin(pi*x)"`, and energies as
!> expressions in invariants.
!>
!> Invalid expressions were refused by the check of the deck; muParser evaluates the others.
!> Energies are differentiated, so they are passed as the operations of which they consist.
module rk_expression
   use, intrinsic :: iso_c_binding, only : c_char, c_double, c_int, c_null_char, c_ptr
   use rk_cstring, only : to_fortran
   use rk_error, only : error_type, fatal_error, err_input
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: expression_type, value_type, tape_type, new_tape

   !> Maximum number of values of a tape
   integer, parameter :: most = 400

   !> Operations of an energy, in the order in which they are computed. The first values are I1, I2,
   !> I4 and the activation, then the constants
   type :: tape_type
      !> Operation that computes a value, 0 for names and numbers; the operations of rk_jets
      integer, allocatable :: operation(:)
      !> Values to which it is applied, 0 for none
      integer, allocatable :: left(:), right(:)
      !> Value if there is no operation
      real(wp), allocatable :: number(:)
      !> Number of the value that is the energy
      integer :: result = 0
   end type tape_type

   !> An expression in x, y, z, r, theta, the time t and the outward normal nx, ny, nz
   type :: expression_type
      !> Its text; not allocated if no expression was given
      character(len=:), allocatable :: text
      !> Place where it was written, and its key, for messages
      character(len=:), allocatable :: where
   contains
      procedure :: given
      procedure :: at => value_at, gradient, uses
   end type expression_type

   !> A number, or an expression instead
   type, extends(expression_type) :: value_type
      !> The number, not used if there is an expression
      real(wp) :: number = 0.0_wp
   contains
      procedure :: acts, at => number_at
   end type value_type

   interface
      function c_value(text, values) result(value) bind(c, name='rk_expression_value')
         import :: c_char, c_double
         character(kind=c_char), intent(in) :: text(*)
         real(c_double), intent(in) :: values(*)
         real(c_double) :: value
      end function c_value
      function c_names(text) result(names) bind(c, name='rk_expression_names')
         import :: c_char, c_ptr
         character(kind=c_char), intent(in) :: text(*)
         type(c_ptr) :: names
      end function c_names
      function c_tape(text, constants, most, count, operation, left, right, number, result) &
         & result(fault) bind(c, name='rk_energy_tape')
         import :: c_char, c_double, c_int, c_ptr
         character(kind=c_char), intent(in) :: text(*), constants(*)
         integer(c_int), value :: most
         integer(c_int), intent(out) :: count, operation(*), left(*), right(*), result
         real(c_double), intent(out) :: number(*)
         type(c_ptr) :: fault
      end function c_tape
   end interface

contains

elemental logical function given(self)
   class(expression_type), intent(in) :: self

   given = allocated(self%text)
end function given

!> Whether a name occurs in it, such as t, the time
logical function uses(self, name)
   class(expression_type), intent(in) :: self
   character(len=*), intent(in) :: name

   uses = .false.
   if (self%given()) uses = index(to_fortran(c_names(self%text//c_null_char)), ' '//name//' ') > 0
end function uses

!> Value at a position
subroutine value_at(self, x, value, error, time, normal)
   class(expression_type), intent(in) :: self
   real(wp), intent(in) :: x(:)
   real(wp), intent(out) :: value
   !> Error handling: value not finite
   type(error_type), allocatable, intent(inout) :: error
   !> Time, 0 if absent
   real(wp), intent(in), optional :: time
   !> Outward unit normal, shape (nd) [-]
   real(wp), intent(in), optional :: normal(:)
   real(wp) :: place(9)

   place = 0.0_wp
   if (present(time)) place(6) = time
   if (present(normal)) place(7:6 + size(normal)) = normal
   call set_place(x, place)
   value = c_value(self%text//c_null_char, place)
   if (abs(value) <= huge(value) .or. allocated(error)) return
   call fatal_error(error, err_input, self%where//": '"//self%text//"' is not finite at " &
      & //to_text(x))
end subroutine value_at

!> Value at a position: that of the expression, or the number if there is none
subroutine number_at(self, x, value, error, time, normal)
   class(value_type), intent(in) :: self
   real(wp), intent(in) :: x(:)
   real(wp), intent(out) :: value
   type(error_type), allocatable, intent(inout) :: error
   real(wp), intent(in), optional :: time
   real(wp), intent(in), optional :: normal(:)

   value = self%number
   if (self%given()) call self%expression_type%at(x, value, error, time, normal)
end subroutine number_at

!> Whether the value may be nonzero at some position
elemental logical function acts(self)
   class(value_type), intent(in) :: self

   acts = allocated(self%text) .or. abs(self%number) > 0.0_wp
end function acts

!> Coordinates of a position, including r and theta
pure subroutine set_place(x, place)
   real(wp), intent(in) :: x(:)
   !> All variables, of which the coordinates are set, shape (9)
   real(wp), intent(inout) :: place(9)

   place(:size(x)) = x
   if (size(x) > 1) then
      place(4) = norm2(x(:2))
      if (place(4) > 0.0_wp) place(5) = atan2(x(2), x(1))
   end if
end subroutine set_place

!> First derivatives at a position, by sixth-order central differences
subroutine gradient(self, x, step, slope, error, time)
   class(expression_type), intent(in) :: self
   real(wp), intent(in) :: x(:)
   !> Distance of the difference points, small against the lengths over which it varies [length]
   real(wp), intent(in) :: step
   !> Derivatives, shape (nd) [1/length]
   real(wp), intent(out) :: slope(:)
   !> Error handling: values not finite nearby
   type(error_type), allocatable, intent(inout) :: error
   real(wp), intent(in), optional :: time
   real(wp), parameter :: weight(3) = [45.0_wp, -9.0_wp, 1.0_wp]/60.0_wp
   real(wp) :: there(size(x)), up, down
   integer :: d, k

   slope = 0.0_wp
   do d = 1, size(x)
      do k = 1, 3
         there = x
         there(d) = x(d) + k*step
         call self%at(there, up, error, time)
         there(d) = x(d) - k*step
         call self%at(there, down, error, time)
         slope(d) = slope(d) + weight(k)*(up - down)/step
      end do
   end do
end subroutine gradient

subroutine new_tape(tape, text, constants, values, fault)
   type(tape_type), intent(out) :: tape
   character(len=*), intent(in) :: text
   !> Names of the constants, with blanks between
   character(len=*), intent(in) :: constants
   !> Their values, shape (n)
   real(wp), intent(in) :: values(:)
   !> Why it is not an expression; not allocated if it is one
   character(len=:), allocatable, intent(out) :: fault
   integer(c_int), dimension(most) :: operation, left, right
   integer(c_int) :: n, result
   real(wp) :: number(most)
   character(len=:), allocatable :: why

   why = to_fortran(c_tape(text//c_null_char, constants//c_null_char, int(most, c_int), n, &
      & operation, left, right, number, result))
   if (len(why) > 0) then
      fault = "'"//text//"' "//why
      return
   end if
   tape%operation = int(operation(:n))
   tape%left = int(left(:n)) + 1
   tape%right = int(right(:n)) + 1
   tape%number = number(:n)
   tape%number(5:4 + size(values)) = values
   tape%result = int(result) + 1
end subroutine new_tape

end module rk_expression
