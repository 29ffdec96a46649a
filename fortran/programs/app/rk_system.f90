!> Signals, folders, memory and version, from system.cpp.
module rk_system
   use, intrinsic :: iso_c_binding, only : c_associated, c_bool, c_char, c_double, c_int, &
      & c_null_char, c_ptr
   use, intrinsic :: iso_fortran_env, only : output_unit
   use rk_cstring, only : c_strlen, to_fortran
   use rk_error, only : error_type, fatal_error, err_file
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: catch_signals, prepare_process, interrupted, peak_bytes, cpu_seconds
   public :: make_folder, lock_folder, version_text, tell, process_number

   interface
      !> Install the handlers
      subroutine catch_signals() bind(c, name='rk_catch_signals')
      end subroutine catch_signals
      !> Settings of the process: limits, and the parent whose end stops it
      subroutine prepare_process() bind(c, name='rk_prepare_process')
      end subroutine prepare_process
      function c_lock_folder(path, owner) result(why) bind(c, name='rk_lock_folder')
         import :: c_char, c_int, c_ptr
         character(kind=c_char), intent(in) :: path(*)
         integer(c_int), intent(out) :: owner
         type(c_ptr) :: why
      end function c_lock_folder
      !> Number of this process
      function process_number() result(number) bind(c, name='getpid')
         import :: c_int
         integer(c_int) :: number
      end function process_number
      !> Whether the user asked the program to stop
      function interrupted() result(yes) bind(c, name='rk_interrupted')
         import :: c_bool
         logical(c_bool) :: yes
      end function interrupted
      !> Peak memory of the program [byte]
      function peak_bytes() result(bytes) bind(c, name='rk_peak_bytes')
         import :: c_double
         real(c_double) :: bytes
      end function peak_bytes
      function c_make_folder(path) result(why) bind(c, name='rk_make_folder')
         import :: c_char, c_ptr
         character(kind=c_char), intent(in) :: path(*)
         type(c_ptr) :: why
      end function c_make_folder
      pure function c_version_text() result(text) bind(c, name='rk_version_text')
         import :: c_ptr
         type(c_ptr) :: text
      end function c_version_text
   end interface

contains

!> User and system time of the program so far [s]
real(wp) function cpu_seconds()
   call cpu_time(cpu_seconds)
end function cpu_seconds

!> Make a folder that can be written to
subroutine make_folder(path, error)
   character(len=*), intent(in) :: path
   type(error_type), allocatable, intent(out) :: error
   type(c_ptr) :: why

   why = c_make_folder(path//c_null_char)
   if (c_associated(why)) call fatal_error(error, err_file, 'folder '//path &
      & //' cannot be used for output: '//to_fortran(why))
end subroutine make_folder

!> Lock a folder until the program ends: two runs would mix their files
subroutine lock_folder(path, error)
   !> Folder, which exists
   character(len=*), intent(in) :: path
   !> Error handling: locked by another process
   type(error_type), allocatable, intent(out) :: error
   type(c_ptr) :: why
   integer(c_int) :: owner

   why = c_lock_folder(path//c_null_char, owner)
   if (.not. c_associated(why)) return
   if (owner > 0) then
      call fatal_error(error, err_file, 'folder '//path//' is in use by another run (process ' &
         & //to_text(int(owner))//'): wait until it finishes or choose another folder')
   else
      call fatal_error(error, err_file, path//'/.lock: cannot be written: ' &
         & //to_fortran(why))
   end if
end subroutine lock_folder

!> Print a line; do not stop if its reader has gone away
subroutine tell(line)
   character(len=*), intent(in) :: line
   integer :: ignored

   write (output_unit, '(a)', iostat=ignored) line
   flush (output_unit, iostat=ignored)
end subroutine tell

function version_text() result(text)
   character(len=c_strlen(c_version_text())) :: text

   text = to_fortran(c_version_text())
end function version_text

end module rk_system
