!> Signals, folders, memory and version, from system.c.
module rk_system
   use, intrinsic :: iso_c_binding, only : c_char, c_double, c_int, c_null_char, c_ptr
   use, intrinsic :: iso_fortran_env, only : output_unit
   use rk_cstring, only : to_fortran
   use rk_error, only : error_type, fatal_error, err_file
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: catch_signals, prepare_process, interrupted, peak_bytes, cpu_seconds
   public :: make_folder, lock_folder, usage_text, version_text, tell

   interface
      !> Install the handlers
      subroutine catch_signals() bind(c, name='rk_catch_signals')
      end subroutine catch_signals
      !> Settings of the process: limits, and the parent to end with
      subroutine prepare_process() bind(c, name='rk_prepare_process')
      end subroutine prepare_process
      function c_lock_folder(path, owner) result(status) bind(c, name='rk_lock_folder')
         import :: c_char, c_int
         character(kind=c_char), intent(in) :: path(*)
         integer(c_int), intent(out) :: owner
         integer(c_int) :: status
      end function c_lock_folder
      function c_interrupted() result(yes) bind(c, name='rk_interrupted')
         import :: c_int
         integer(c_int) :: yes
      end function c_interrupted
      function c_peak_bytes() result(bytes) bind(c, name='rk_peak_bytes')
         import :: c_double
         real(c_double) :: bytes
      end function c_peak_bytes
      function c_cpu_seconds() result(seconds) bind(c, name='rk_cpu_seconds')
         import :: c_double
         real(c_double) :: seconds
      end function c_cpu_seconds
      function c_make_folder(path) result(status) bind(c, name='rk_make_folder')
         import :: c_char, c_int
         character(kind=c_char), intent(in) :: path(*)
         integer(c_int) :: status
      end function c_make_folder
      function c_error_text(number) result(text) bind(c, name='rk_error_text')
         import :: c_int, c_ptr
         integer(c_int), value :: number
         type(c_ptr) :: text
      end function c_error_text
      function c_usage_text() result(text) bind(c, name='rk_usage_text')
         import :: c_ptr
         type(c_ptr) :: text
      end function c_usage_text
      function c_version_text() result(text) bind(c, name='rk_version_text')
         import :: c_ptr
         type(c_ptr) :: text
      end function c_version_text
   end interface

contains

!> Whether the user asked the program to stop
logical function interrupted()
   interrupted = c_interrupted() /= 0
end function interrupted

!> Peak memory of the program [byte]
real(wp) function peak_bytes()
   peak_bytes = real(c_peak_bytes(), wp)
end function peak_bytes

!> User and system time of the program so far [s]
real(wp) function cpu_seconds()
   cpu_seconds = real(c_cpu_seconds(), wp)
end function cpu_seconds

!> Make a folder that can be written to
subroutine make_folder(path, error)
   !> Folder
   character(len=*), intent(in) :: path
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer(c_int) :: status

   status = c_make_folder(path//c_null_char)
   if (status /= 0) call fatal_error(error, err_file, 'folder '//path &
      & //' cannot be used for output: '//to_fortran(c_error_text(status)))
end subroutine make_folder

!> Claim a folder until the program ends: two runs would mix their files
subroutine lock_folder(path, error)
   !> Folder, which exists
   character(len=*), intent(in) :: path
   !> Error handling: another process has it
   type(error_type), allocatable, intent(out) :: error
   integer(c_int) :: owner, status

   status = c_lock_folder(path//c_null_char, owner)
   if (status == 0) return
   if (owner > 0) then
      call fatal_error(error, err_file, 'folder '//path//' is in use by another run (process ' &
         & //to_text(int(owner))//'): wait for its end or name another folder')
   else
      call fatal_error(error, err_file, 'folder '//path//' cannot be claimed for output: ' &
         & //to_fortran(c_error_text(status)))
   end if
end subroutine lock_folder

!> Print a line; a reader that has gone away is no reason to end
subroutine tell(line)
   !> Line
   character(len=*), intent(in) :: line
   integer :: ignored

   write (output_unit, '(a)', iostat=ignored) line
   flush (output_unit, iostat=ignored)
end subroutine tell

!> Help text
function usage_text() result(text)
   character(len=:), allocatable :: text

   text = to_fortran(c_usage_text())
end function usage_text

!> Version of the program
function version_text() result(text)
   character(len=:), allocatable :: text

   text = to_fortran(c_version_text())
end function version_text

end module rk_system
