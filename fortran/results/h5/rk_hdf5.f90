!> HDF5 files: arrays by name, rows appended, attributes, text.
!>
!> A Fortran array a(3,n) is a dataset of shape (n,3) for h5py and VTK: same memory, no
!> transposition. A file is written under the name `path.part` and takes its real name when it is
!> published, so an interrupted run leaves an earlier file unchanged. Text datasets are bytes. After
!> an error, reading and appending do nothing: a series of such calls needs only one check.
!>
!> Reference: The HDF Group, HDF5 Reference Manual, https://docs.hdfgroup.org (API 1.10),
!> called through h5.c
module rk_hdf5
   use, intrinsic :: iso_c_binding, only : c_associated, c_char, c_double, c_int, c_int8_t, &
      c_int64_t, c_null_char, c_ptr
   use rk_cstring, only : to_fortran
   use rk_error, only : err_file, error_type, fatal_error
   use rk_precision, only : wp
   use rk_text_file, only : move_file
   implicit none
   private

   public :: h5_type, as_bytes

   !> An open file
   type :: h5_type
      private
      !> Handle of the HDF5 library, negative when closed
      integer(c_int64_t) :: handle = -1_c_int64_t
      !> Name for messages; for a file being written, its final name
      character(len=:), allocatable :: path
      !> Whether the file is being written
      logical :: writing = .false.
   contains
      procedure :: create, open_read, flush => flush_file, close => close_file, publish, has
      !> Append numbers to a dataset, or set them as an attribute; texts are bytes
      procedure :: append, put_attribute
      !> Read a whole dataset
      generic :: read => read_reals, read_integers, read_text
      procedure, private :: read_reals, read_integers, read_text
   end type h5_type

   !> h5.c: each function returns a null pointer, or the reason of its failure as a C string; names
   !> and paths are C strings
   interface
      !> Open a file for reading (writing = 0) or create it (writing = 1)
      type(c_ptr) function rkh5_open(path, writing, file) bind(c)
         import :: c_char, c_int, c_int64_t, c_ptr
         character(kind=c_char), intent(in) :: path(*)
         integer(c_int), value :: writing
         integer(c_int64_t), intent(out) :: file
      end function rkh5_open

      !> Pass everything written so far to the operating system
      type(c_ptr) function rkh5_flush(file) bind(c)
         import :: c_int64_t, c_ptr
         integer(c_int64_t), value :: file
      end function rkh5_flush

      type(c_ptr) function rkh5_close(file) bind(c)
         import :: c_int64_t, c_ptr
         integer(c_int64_t), value :: file
      end function rkh5_close

      !> 1 if a group or dataset exists, otherwise 0
      integer(c_int) function rkh5_exists(file, path) bind(c)
         import :: c_char, c_int, c_int64_t
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: path(*)
      end function rkh5_exists

      !> Append numbers along the last dimension; their kind and shape are in the descriptor
      type(c_ptr) function rkh5_append(file, path, values) bind(c)
         import :: c_char, c_int64_t, c_ptr
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: path(*)
         type(*), intent(in) :: values(..)
      end function rkh5_append

      !> All numbers of a dataset, in an array that is allocated there, if the dataset has this rank
      type(c_ptr) function read_c_reals(file, path, values) bind(c, name='rkh5_read')
         import :: c_char, c_double, c_int64_t, c_ptr
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: path(*)
         real(c_double), allocatable, intent(inout) :: values(..)
      end function read_c_reals

      !> The same for integers
      type(c_ptr) function read_c_integers(file, path, values) bind(c, name='rkh5_read')
         import :: c_char, c_int, c_int64_t, c_ptr
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: path(*)
         integer(c_int), allocatable, intent(inout) :: values(..)
      end function read_c_integers

      type(c_ptr) function rkh5_put_attribute(file, object, name, values) bind(c)
         import :: c_char, c_int64_t, c_ptr
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: object(*), name(*)
         type(*), intent(in) :: values(..)
      end function rkh5_put_attribute

   end interface

contains

!> Start a new file; no file appears at `path` itself until it is published
subroutine create(self, path, error)
   class(h5_type), intent(inout) :: self
   !> Name of the file when it is published
   character(len=*), intent(in) :: path
   type(error_type), allocatable, intent(out) :: error
   type(c_ptr) :: why
   logical :: folder

   self%path = trim(path)
   self%writing = .true.
   inquire (file=self%path//"/.", exist=folder)
   if (folder) then
      call fatal_error(error, err_file, self%path//": cannot be written: it is a folder; "// &
         "remove it or choose another output folder")
      return
   end if
   why = rkh5_open(part_of(self%path)//c_null_char, 1_c_int, self%handle)
   if (c_associated(why)) call fatal_error(error, err_file, part_of(self%path)// &
      ": cannot be created: "//to_fortran(why)// &
      "; choose an output folder that exists and can be written")
end subroutine create

!> Open an existing file for reading
subroutine open_read(self, path, error)
   class(h5_type), intent(inout) :: self
   character(len=*), intent(in) :: path
   type(error_type), allocatable, intent(out) :: error
   type(c_ptr) :: why

   self%path = trim(path)
   self%writing = .false.
   why = rkh5_open(self%path//c_null_char, 0_c_int, self%handle)
   if (c_associated(why)) call fatal_error(error, err_file, self%path//": cannot be opened: "// &
      to_fortran(why))
end subroutine open_read

!> Pass everything written so far to the operating system; a full disk is detected here
subroutine flush_file(self, error)
   class(h5_type), intent(inout) :: self
   type(error_type), allocatable, intent(inout) :: error

   if (.not. allocated(error)) call check(self, "", rkh5_flush(self%handle), error)
end subroutine flush_file

!> Close; a new file keeps its temporary name
subroutine close_file(self, error)
   !> Open file; a closed one is left as it is
   class(h5_type), intent(inout) :: self
   type(error_type), allocatable, intent(out) :: error
   type(c_ptr) :: why

   if (self%handle < 0) return
   why = rkh5_close(self%handle)
   self%handle = -1_c_int64_t
   if (self%writing) call check(self, "", why, error)
end subroutine close_file

!> Rename a closed file that was written to its real name
subroutine publish(self, error)
   class(h5_type), intent(in) :: self
   type(error_type), allocatable, intent(out) :: error

   call move_file(self%path//'.part', self%path, error)
end subroutine publish

function has(self, name)
   class(h5_type), intent(in) :: self
   !> Path in the file, as "boundary/names"
   character(len=*), intent(in) :: name
   logical :: has

   has = rkh5_exists(self%handle, name//c_null_char) /= 0
end function has

!> Append numbers of any kind and shape along the last Fortran dimension
subroutine append(self, name, values, error)
   class(h5_type), intent(inout) :: self
   !> Path in the file
   character(len=*), intent(in) :: name
   !> Numbers: real, integers of 4 or 8 bytes, or bytes; all dimensions except the last are the same
   !> in every call
   type(*), intent(in), contiguous :: values(..)
   type(error_type), allocatable, intent(inout) :: error

   if (.not. allocated(error)) call check(self, name, rkh5_append(self%handle, &
      name//c_null_char, values), error)
end subroutine append

!> A text as it is stored
pure function as_bytes(text) result(bytes)
   !> Text, UTF-8; ASCII and not empty in attributes
   character(len=*), intent(in) :: text
   integer(c_int8_t), allocatable :: bytes(:)

   bytes = transfer(text, [0_c_int8_t])
end function as_bytes

subroutine read_reals(self, name, values, error)
   class(h5_type), intent(in) :: self
   character(len=*), intent(in) :: name
   !> Numbers, of the same rank as the dataset
   real(wp), allocatable, intent(out) :: values(..)
   type(error_type), allocatable, intent(inout) :: error

   if (.not. allocated(error)) call check(self, name, read_c_reals(self%handle, &
      name//c_null_char, values), error)
end subroutine read_reals

subroutine read_integers(self, name, values, error)
   class(h5_type), intent(in) :: self
   character(len=*), intent(in) :: name
   integer, allocatable, intent(out) :: values(..)
   type(error_type), allocatable, intent(inout) :: error

   if (.not. allocated(error)) call check(self, name, read_c_integers(self%handle, &
      name//c_null_char, values), error)
end subroutine read_integers

subroutine read_text(self, name, text, error)
   class(h5_type), intent(in) :: self
   character(len=*), intent(in) :: name
   character(len=:), allocatable, intent(out) :: text
   type(error_type), allocatable, intent(inout) :: error
   integer, allocatable :: letters(:)
   integer :: i

   call self%read(name, letters, error)
   if (allocated(error)) return
   allocate (character(len=size(letters)) :: text)
   do i = 1, len(text)
      text(i:i) = achar(letters(i))
   end do
end subroutine read_text

!> Set an attribute
subroutine put_attribute(self, object, name, values, error)
   class(h5_type), intent(inout) :: self
   !> Group or dataset
   character(len=*), intent(in) :: object
   character(len=*), intent(in) :: name
   !> Integers, of which a single one is stored as a scalar, or bytes, shape (n)
   type(*), intent(in), contiguous :: values(..)
   type(error_type), allocatable, intent(inout) :: error

   if (.not. allocated(error)) call check(self, name, rkh5_put_attribute(self%handle, &
      object//c_null_char, name//c_null_char, values), error)
end subroutine put_attribute

!> Convert the return value of C to an error
subroutine check(self, name, why, error)
   class(h5_type), intent(in) :: self
   !> Path in the file or name of the attribute; empty for the whole file
   character(len=*), intent(in) :: name
   !> Reason of a failure, null for success
   type(c_ptr), intent(in) :: why
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: what

   if (.not. c_associated(why)) return
   if (self%writing) then
      what = ''
      if (len(name) > 0) what = " '"//name//"'"
      call fatal_error(error, err_file, part_of(self%path)//': writing'//what//' failed: ' &
         & //to_fortran(why)//'; an earlier '//self%path//' is as it was')
   else
      call fatal_error(error, err_file, self%path//": dataset '"//name//"': "//to_fortran(why))
   end if
end subroutine check

!> Name of a file while it is being written
pure function part_of(path) result(part)
   !> Its final name
   character(len=*), intent(in) :: path
   character(len=len(path) + 5) :: part

   part = path//".part"
end function part_of

end module rk_hdf5
