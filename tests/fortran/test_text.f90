!> Numbers as text, also on several threads at once; TAP for `meson test`.
program test_text
   use, intrinsic :: ieee_arithmetic, only : ieee_positive_inf, ieee_value
   use rk_precision, only : wp
   use rk_text, only : line, to_power, to_text
   use tap, only : check, finish
   implicit none

   call test_numbers
   call test_threads
   call finish()

contains

!> Texts are as long as their content
subroutine test_numbers
   character(len=*), parameter :: break = new_line('a')

   call check('integers', '|'//to_text(0)//'|'//to_text(-10)//'|'//to_text(huge(1))//'|' &
      & //to_text(-huge(1) - 1)//'|' == '|0|-10|2147483647|-2147483648|')
   call check('real numbers', '|'//to_text(0.5_wp)//'|'//to_text(-100.0_wp)//'|' &
      & //to_text(99999.96_wp)//'|'//to_text(1.0_wp/3.0_wp, 2)//'|'//to_text(2.0e-4_wp)//'|' &
      & == '|0.5|-100|100000|0.33|0.0002|')
   call check('infinity', to_text(ieee_value(1.0_wp, ieee_positive_inf)) == 'inf')
   call check('powers of ten', '|'//to_power(1.26e-5_wp, 1)//'|'//to_power(-2.0e100_wp, 0)//'|' &
      & == '|1.3E-05|-2E+100|')
   call check('lists', '|'//to_text([1, 20, -3])//'|'//to_text([integer ::])//'|' &
      & //to_text([0.5_wp, 20.0_wp])//'|'//to_text([1.0_wp/3.0_wp], 3)//'|' &
      & == '|(1, 20, -3)|()|(0.5, 20)|(0.333)|')
   call check('lines', '|'//line('a'//break//'b c'//break, 2)//'|'//line('a', 2)//'|' == '|b c||')
end subroutine test_numbers

!> Numbers on many threads at once
subroutine test_threads
   integer :: i, wrong

   wrong = 0
   !$omp parallel do num_threads(8) reduction(+:wrong)
   do i = 1, 500000
      if (.not. reads_back(i)) wrong = wrong + 1
   end do
   !$omp end parallel do
   call check('threads do not share lengths', wrong == 0)
end subroutine test_threads

logical function reads_back(number)
   integer, intent(in) :: number
   character(len=:), allocatable :: text
   integer :: back, stat

   text = 'n '//to_text(number)
   read (text(3:), *, iostat=stat) back
   reads_back = stat == 0 .and. back == number
end function reads_back

end program test_text
