!> Symmetric matrices: envelope factors on several threads; TAP for
!> `meson test`.
program test_symmetric
   use, intrinsic :: omp_lib, only : omp_set_num_threads
   use rk_error, only : error_type
   use rk_precision, only : i8, wp
   use rk_single_envelope, only : envelope_type, new_envelope
   use tap, only : check, finish
   implicit none

   call test_factor
   call finish()

contains

!> A band over several blocks: the same factor on two threads, its solution, and the first minor
!> that is not positive, if there is one
subroutine test_factor
   integer, parameter :: n = 700, reach = 300
   type(envelope_type) :: factor(2)
   type(error_type), allocatable :: error
   real(wp) :: x(n), b(n)
   integer(i8), allocatable :: before(:)
   integer :: c, i, minor, threads

   do minor = 0, 645, 215
      do threads = 1, 2
         call omp_set_num_threads(threads)
         call new_envelope(factor(threads), [(i, i=1, n)], [(max(1, i - reach), i=1, n)], error)
         call factor(threads)%clear()
         before = factor(threads)%columns()
         do c = 1, n
            do i = max(1, c - reach), c
               factor(threads)%value(before(c) + i) = entry(i, c, minor)
            end do
         end do
         call factor(threads)%factorise(error)
         if (minor > 0) then
            call check('not positive definite', allocated(error))
            if (.not. allocated(error)) cycle
            call check('its first minor', index(error%message, minor_text(minor)) > 0)
         else
            call check('positive definite', .not. allocated(error))
         end if
      end do
      if (minor > 0) cycle
      call check('the same bits on two threads', &
         & .not. any(abs(factor(1)%value - factor(2)%value) > 0.0))
      x = [(cos(real(i, wp)), i=1, n)]
      b = 0.0_wp
      do c = 1, n
         do i = max(1, c - reach), c
            b(i) = b(i) + entry(i, c, 0)*x(c)
            if (i < c) b(c) = b(c) + entry(i, c, 0)*x(i)
         end do
      end do
      call factor(2)%solve(b)
      call check('its solution', maxval(abs(b - x)) < 1.0e-4_wp)
   end do
end subroutine test_factor

!> Entry of a diagonally dominant matrix, but for one row
pure real function entry(i, c, minor)
   integer, intent(in) :: i, c, minor

   entry = 0.1*sin(real(i + 3*c))
   if (i == c) entry = merge(-100.0, 100.0, i == minor)
end function entry

pure function minor_text(minor) result(text)
   integer, intent(in) :: minor
   character(len=16) :: number
   character(len=:), allocatable :: text

   write (number, '(i0)') minor
   text = 'minor '//trim(number)//' of'
end function minor_text

end program test_symmetric
