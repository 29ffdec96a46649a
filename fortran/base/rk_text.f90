!> Numbers to text for messages, logs and tables.
module rk_text
   use, intrinsic :: iso_c_binding, only : c_char, c_double, c_int
   use rk_precision, only : wp
   implicit none
   private

   public :: line, lines_of, to_text, to_power, written

   !> Shortest readable text of a number or a list of numbers
   interface to_text
      module procedure :: integer_text, real_text, digits_text, reals_text, list_text, &
         & integers_text
   end interface to_text

   interface
      !> number.c
      pure subroutine rkf_number(value, digits, power, text) bind(c)
         import :: c_char, c_double, c_int
         real(c_double), value :: value
         integer(c_int), value :: digits, power
         character(kind=c_char), intent(out) :: text(*)
      end subroutine rkf_number
   end interface

   !> Significant digits by default
   integer, parameter :: usual_digits = 6
   !> Longest text of a real number
   integer, parameter :: longest = 40

contains

!> Digits of an integer with its sign
elemental integer function width(value)
   integer, intent(in) :: value
   integer :: rest

   width = merge(2, 1, value < 0)
   rest = value/10
   do while (rest /= 0)
      width = width + 1
      rest = rest/10
   end do
end function width

pure function integer_text(value) result(text)
   integer, intent(in) :: value
   character(len=width(value)) :: text

   write (text, '(i0)') value
end function integer_text

!> Text of a number from number.c, padded with blanks
pure function written(value, digits, power) result(text)
   real(wp), intent(in) :: value
   !> Significant digits, or digits after the point with a power of ten (power = 1); 0 without a
   !> power of ten for the shortest text that reads back the same number
   integer, intent(in) :: digits, power
   character(len=longest) :: text

   call rkf_number(value, digits, power, text)
end function written

!> Text of a list of integers, as "(1, 2, 3)"
pure function integers_text(values) result(text)
   integer, intent(in) :: values(:)
   character(len=max(2*size(values), 2) + sum(width(values))) :: text

   write (text, '("(", *(i0, :, ", "))') values
   text(len(text):) = ')'
end function integers_text

!> Text of a real number, six significant digits
pure function real_text(value) result(text)
   real(wp), intent(in) :: value
   character(len=len_trim(written(value, usual_digits, 0))) :: text

   text = written(value, usual_digits, 0)
end function real_text

!> Text of a real number
pure function digits_text(value, digits) result(text)
   real(wp), intent(in) :: value
   !> Significant digits
   integer, intent(in) :: digits
   character(len=len_trim(written(value, digits, 0))) :: text

   text = written(value, digits, 0)
end function digits_text

!> Text of a real number with a power of ten
pure function to_power(value, decimals) result(text)
   real(wp), intent(in) :: value
   !> Digits after the point
   integer, intent(in) :: decimals
   character(len=len_trim(written(value, decimals, 1))) :: text

   text = written(value, decimals, 1)
end function to_power

pure integer function list_length(values, digits)
   real(wp), intent(in) :: values(:)
   integer, intent(in) :: digits
   integer :: i

   list_length = max(2*size(values), 2)
   do i = 1, size(values)
      list_length = list_length + len_trim(written(values(i), digits, 0))
   end do
end function list_length

!> Text of a list of real numbers, as "(1, 2, 3)"
pure function reals_text(values) result(text)
   real(wp), intent(in) :: values(:)
   character(len=list_length(values, usual_digits)) :: text

   text = list_text(values, usual_digits)
end function reals_text

!> The same with a given number of digits
pure function list_text(values, digits) result(text)
   real(wp), intent(in) :: values(:)
   !> Significant digits of each
   integer, intent(in) :: digits
   character(len=list_length(values, digits)) :: text
   integer :: i, at

   text = '('
   at = 2
   do i = 1, size(values)
      associate (number => written(values(i), digits, 0))
         text(at:) = trim(number)//', '
         at = at + len_trim(number) + 2
      end associate
   end do
   text(len(text):) = ')'
end function list_text

!> Where a line of a text begins
pure integer function start_of(text, number) result(start)
   character(len=*), intent(in) :: text
   integer, intent(in) :: number
   integer :: i

   start = 1
   do i = 2, number
      if (index(text(start:), new_line('a')) == 0) start = len(text) + 1
      start = start + index(text(start:), new_line('a'))
   end do
end function start_of

!> One line of a text; empty after the last
pure function line(text, number) result(found)
   character(len=*), intent(in) :: text
   !> Number of the line
   integer, intent(in) :: number
   character(len=index(text(start_of(text, number):)//new_line('a'), new_line('a')) - 1) :: found

   found = text(start_of(text, number):)
end function line

!> Lines of a text up to the first empty one
pure subroutine lines_of(text, lines)
   character(len=*), intent(in) :: text
   !> Lines, padded with blanks
   character(len=*), allocatable, intent(inout) :: lines(:)
   integer :: pass, length, n, start

   ! the first pass only counts, both in one run over the text
   do pass = 1, 2
      n = 0
      start = 1
      do while (start <= len(text))
         length = index(text(start:), new_line('a')) - 1
         if (length < 0) length = len(text) - start + 1
         if (length == 0) exit
         n = n + 1
         if (pass == 2) lines(n) = text(start:start + length - 1)
         start = start + length + 1
      end do
      if (pass == 2) exit
      if (allocated(lines)) deallocate (lines)
      allocate (lines(n))
   end do
end subroutine lines_of

end module rk_text
