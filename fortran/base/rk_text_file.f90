!> Text files that are either complete or absent.
!>
!> A file is written under the name `path.part` and takes its real name when it is published; until
!> then an earlier file is left unchanged. Every write reaches the operating system at once, and a
!> full disk is reported as an error.
module rk_text_file
   use, intrinsic :: iso_c_binding, only : c_associated, c_char, c_int, c_null_char, &
      & c_null_ptr, c_ptr, c_size_t
   use rk_cstring, only : to_fortran
   use rk_error, only : error_type, fatal_error, err_file
   implicit none
   private

   public :: text_file, make_file, move_file, drop_file, save_text, load_text

   !> A file being written
   type :: text_file
      private
      !> Name that it takes at the end
      character(len=:), allocatable :: path
      !> Open stream of C
      type(c_ptr) :: handle = c_null_ptr
   contains
      procedure :: create, line, close => close_file, publish
   end type text_file

   !> files.c: null, or the reason of a failure as a C string
   interface
      type(c_ptr) function rkf_make(path, keep) bind(c)
         import :: c_char, c_int, c_ptr
         character(kind=c_char), intent(in) :: path(*)
         integer(c_int), value :: keep
      end function rkf_make
      type(c_ptr) function rkf_create(path, handle) bind(c)
         import :: c_char, c_ptr
         character(kind=c_char), intent(in) :: path(*)
         type(c_ptr), intent(out) :: handle
      end function rkf_create
      type(c_ptr) function rkf_write(handle, text, length) bind(c)
         import :: c_char, c_ptr, c_size_t
         type(c_ptr), value :: handle
         character(kind=c_char), intent(in) :: text(*)
         integer(c_size_t), value :: length
      end function rkf_write
      type(c_ptr) function rkf_close(handle) bind(c)
         import :: c_ptr
         type(c_ptr), value :: handle
      end function rkf_close
      type(c_ptr) function rkf_rename(from, to) bind(c)
         import :: c_char, c_ptr
         character(kind=c_char), intent(in) :: from(*), to(*)
      end function rkf_rename
   end interface

contains

!> Start a file under a temporary name
subroutine create(self, path, error)
   class(text_file), intent(inout) :: self
   !> Name that it takes when it is published
   character(len=*), intent(in) :: path
   type(error_type), allocatable, intent(out) :: error

   self%path = path
   call check(self, rkf_create(path//'.part'//c_null_char, self%handle), error)
   if (allocated(error)) error%message = self%path//'.part'//error%message(len(self%path) + 1:)
end subroutine create

!> Write a line
subroutine line(self, text, error)
   !> Open file; nothing is written to any other
   class(text_file), intent(inout) :: self
   character(len=*), intent(in) :: text
   type(error_type), allocatable, intent(out) :: error

   if (c_associated(self%handle)) call check(self, rkf_write(self%handle, text//new_line('a'), &
      & len(text, c_size_t) + 1), error)
end subroutine line

!> Close; the file keeps its temporary name
subroutine close_file(self, error)
   !> File; a closed one is left as it is
   class(text_file), intent(inout) :: self
   type(error_type), allocatable, intent(out) :: error

   if (.not. c_associated(self%handle)) return
   call check(self, rkf_close(self%handle), error)
   self%handle = c_null_ptr
end subroutine close_file

!> Give a closed file its name
subroutine publish(self, error)
   class(text_file), intent(in) :: self
   type(error_type), allocatable, intent(out) :: error

   call move_file(self%path//'.part', self%path, error)
end subroutine publish

!> Rename a file, replacing any file of that name
subroutine move_file(from, to, error)
   character(len=*), intent(in) :: from, to
   type(error_type), allocatable, intent(out) :: error
   type(c_ptr) :: why

   why = rkf_rename(from//c_null_char, to//c_null_char)
   if (c_associated(why)) call fatal_error(error, err_file, to//': cannot be replaced: ' &
      & //to_fortran(why)//'; what was to have its name is in '//from)
end subroutine move_file

!> Remove a file, if it is there
subroutine drop_file(path)
   character(len=*), intent(in) :: path
   integer :: stat, unit

   open (newunit=unit, file=path, status='old', iostat=stat)
   if (stat == 0) close (unit, status='delete', iostat=stat)
end subroutine drop_file

!> Write a text to a file, which is either complete or does not exist
subroutine save_text(path, text, error)
   character(len=*), intent(in) :: path
   !> Text, without the last line feed
   character(len=*), intent(in) :: text
   type(error_type), allocatable, intent(out) :: error
   type(error_type), allocatable :: trouble
   type(text_file) :: file

   call file%create(path, error)
   if (allocated(error)) return
   call file%line(text, error)
   call file%close(trouble)
   if (allocated(trouble) .and. .not. allocated(error)) call move_alloc(trouble, error)
   if (.not. allocated(error)) call file%publish(error)
end subroutine save_text

!> Create a file for another unit to write to, replacing any file of that name
subroutine make_file(path, keep, error)
   character(len=*), intent(in) :: path
   !> Keep an existing file of that name
   logical, intent(in) :: keep
   !> Error handling: the name is that of a link or a pipe, or cannot be written to
   type(error_type), allocatable, intent(out) :: error
   type(text_file) :: file

   file%path = path
   call check(file, rkf_make(path//c_null_char, merge(1_c_int, 0_c_int, keep)), error)
end subroutine make_file

!> Read a text file; a missing one is empty
subroutine load_text(path, text)
   character(len=*), intent(in) :: path
   !> Its content
   character(len=:), allocatable, intent(out) :: text
   integer :: length, stat, unit

   text = ''
   ! opening a pipe, which has no length, would wait for its other end
   inquire (file=path, size=length)
   if (length <= 0) return
   open (newunit=unit, file=path, access='stream', form='unformatted', status='old', &
      & action='read', iostat=stat)
   if (stat /= 0) return
   deallocate (text)
   allocate (character(len=length) :: text)
   read (unit, iostat=stat) text
   close (unit)
   if (stat /= 0) text = ''
end subroutine load_text

!> Convert the return value of C to an error
subroutine check(self, why, error)
   class(text_file), intent(in) :: self
   !> Reason of a failure, null for success
   type(c_ptr), intent(in) :: why
   type(error_type), allocatable, intent(out) :: error

   if (c_associated(why)) call fatal_error(error, err_file, self%path//': cannot be written: ' &
      & //to_fortran(why))
end subroutine check

end module rk_text_file
