!> Lines of the test anything protocol, for the test programs of this folder.
module tap
   use, intrinsic :: iso_fortran_env, only : output_unit
   implicit none
   private

   public :: check, finish

   integer, save :: ntest = 0, nfailed = 0

contains

!> One line
subroutine check(name, passed)
   !> What is tested
   character(len=*), intent(in) :: name
   !> Whether it is so
   logical, intent(in) :: passed

   ntest = ntest + 1
   if (.not. passed) nfailed = nfailed + 1
   write (output_unit, '(2a, i0, 2a)') trim(merge('ok    ', 'not ok', passed)), ' ', ntest, &
      & ' - ', name
end subroutine check

!> The plan; a failure ends the program, so that its exit status says so as well
subroutine finish()
   write (output_unit, '(a, i0)') '1..', ntest
   if (nfailed > 0) error stop
end subroutine finish

end module tap
