!> Numbers to text for messages, logs and tables.
module rk_text
   use rk_precision, only : i8, wp
   implicit none
   private

   public :: line, lines_of, to_text, to_power

   !> Shortest readable text of a number or a list of numbers
   interface to_text
      module procedure :: integer_text, long_text, real_text, reals_text
   end interface to_text

contains

pure function integer_text(value) result(text)
   integer, intent(in) :: value
   character(len=:), allocatable :: text
   character(len=16) :: buffer

   write (buffer, '(i0)') value
   text = trim(buffer)
end function integer_text

pure function long_text(value) result(text)
   integer(i8), intent(in) :: value
   character(len=:), allocatable :: text
   character(len=24) :: buffer

   write (buffer, '(i0)') value
   text = trim(buffer)
end function long_text

!> Text of a real number, six significant digits unless given otherwise
pure function real_text(value, digits) result(text)
   real(wp), intent(in) :: value
   !> Significant digits
   integer, intent(in), optional :: digits
   character(len=:), allocatable :: text
   character(len=40) :: buffer
   character(len=16) :: form
   integer :: n

   n = 6
   if (present(digits)) n = digits
   if (abs(value) >= 1.0e-3_wp .and. abs(value) < 1.0e5_wp) then
      write (form, '(a, i0, a)') '(f40.', max(n - 1 - floor(log10(abs(value))), 0), ')'
      write (buffer, form) value
      text = trim(adjustl(buffer))
      if (index(text, '.') > 0) then
         n = len(text)
         do while (text(n:n) == '0')
            n = n - 1
         end do
         if (text(n:n) == '.') n = n - 1
         text = text(:n)
      end if
   else if (.not. abs(value) <= 0.0_wp) then
      text = to_power(value, n - 1)
   else
      text = '0'
   end if
end function real_text

!> Text of a real number with a power of ten, the E also before an exponent of three digits, which
!> Fortran leaves out
pure function to_power(value, decimals) result(text)
   real(wp), intent(in) :: value
   !> Digits behind the point
   integer, intent(in) :: decimals
   character(len=:), allocatable :: text
   ! those that rounding may lift to 1e100 as well
   real(wp), parameter :: small = 9.0e-100_wp, large = 9.0e99_wp
   character(len=40) :: buffer
   character(len=16) :: form
   logical :: long

   long = abs(value) >= large .or. (abs(value) <= small .and. abs(value) > 0.0_wp)
   write (form, '(a, i0, a)') '(es40.', decimals, trim(merge('e3)', ')  ', long))
   write (buffer, form) value
   text = trim(adjustl(buffer))
end function to_power

!> Text of a list of real numbers, as "(1, 2, 3)"
pure function reals_text(values, digits) result(text)
   real(wp), intent(in) :: values(:)
   !> Significant digits of each
   integer, intent(in), optional :: digits
   character(len=:), allocatable :: text
   integer :: i

   text = '('
   do i = 1, size(values)
      if (i > 1) text = text//', '
      text = text//real_text(values(i), digits)
   end do
   text = text//')'
end function reals_text

!> One line of a text; empty behind the last
pure function line(text, number) result(found)
   character(len=*), intent(in) :: text
   !> Number of the line
   integer, intent(in) :: number
   character(len=:), allocatable :: found
   integer :: i, start

   start = 1
   do i = 2, number
      if (index(text(start:), new_line('a')) == 0) start = len(text) + 1
      start = start + index(text(start:), new_line('a'))
   end do
   found = text(start:start + index(text(start:)//new_line('a'), new_line('a')) - 2)
end function line

!> Lines of a text up to the first empty one
pure subroutine lines_of(text, lines)
   character(len=*), intent(in) :: text
   !> Lines, padded with blanks
   character(len=*), allocatable, intent(inout) :: lines(:)
   integer :: i, n

   n = 0
   do while (len(line(text, n + 1)) > 0)
      n = n + 1
   end do
   if (allocated(lines)) deallocate (lines)
   allocate (lines(n))
   do i = 1, n
      lines(i) = line(text, i)
   end do
end subroutine lines_of

end module rk_text
