!> HDF5 files: arrays by name, rows appended, attributes, text.
!>
!> A Fortran array a(3,n) is a dataset of shape (n,3) for h5py and VTK: same memory, no
!> transposition. A file is written under the name `path.part` and takes its real name when it is
!> closed, so an interrupted run leaves an earlier file as it was. Text datasets are bytes. What
!> reads or appends does nothing after an error: one look at it is enough for a run of such calls.
!>
!> Reference: The HDF Group, HDF5 Reference Manual, https://docs.hdfgroup.org (API 1.10),
!> called through h5.c
module rk_hdf5
   use, intrinsic :: iso_c_binding, only : c_char, c_int, c_int64_t, c_loc, c_null_char, c_ptr
   use, intrinsic :: iso_fortran_env, only : int8
   use rk_h5_shim, only : rkh5_append, rkh5_close, rkh5_exists, rkh5_flush, rkh5_get_text, &
      rkh5_open, rkh5_put_attribute, rkh5_read, rkh5_rename, rkh5_shape
   use rk_error, only : err_file, err_input, error_type, fatal_error
   use rk_precision, only : i8, wp
   use rk_text, only : to_text
   implicit none
   private

   public :: h5_type

   !> Kinds of numbers, as in h5.c
   integer(c_int), parameter :: kind_real = 1, kind_int = 2, kind_byte = 4
   !> Room for the reason of a failure
   integer(c_int), parameter :: nwhy = 400
   !> Largest number of dimensions the shim handles
   integer, parameter :: max_rank = 4

   !> An open file
   type :: h5_type
      private
      !> Handle of the HDF5 library, negative when closed
      integer(c_int64_t) :: handle = -1_c_int64_t
      !> Name for messages; of a file being written, the name it takes at the end
      character(len=:), allocatable :: path
      !> Whether the file is being written
      logical :: writing = .false.
      !> Whether a write has failed: such a file never takes its real name
      logical :: damaged = .false.
   contains
      !> Start a new file under a temporary name
      procedure :: create
      !> Open an existing file for reading
      procedure :: open_read
      !> Hand everything written so far to the operating system
      procedure :: flush => flush_file
      !> Close; a new file takes its real name
      procedure :: close => close_file
      !> Give a closed file its real name
      procedure :: publish
      !> Whether a dataset or group exists
      procedure :: has
      !> Append along the last Fortran dimension; the first call creates the dataset
      procedure :: append
      procedure :: append_text
      !> Read a whole dataset
      generic :: read => read_real1, read_real2, read_int1, read_int2, read_text
      procedure, private :: read_real1, read_real2, read_int1, read_int2, read_text
      !> Set an attribute of a group or dataset
      generic :: put_attribute => put_integers, put_text
      procedure, private :: put_integers, put_text
      !> Get a text attribute
      procedure :: get_attribute
   end type h5_type

contains

!> Start a new file; nothing stands at `path` itself until `close`
subroutine create(self, path, error)
   !> File to be created
   class(h5_type), intent(inout) :: self
   !> Name the file takes when it is closed
   character(len=*), intent(in) :: path
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   character(kind=c_char) :: why(nwhy)
   logical :: folder

   self%path = trim(path)
   self%writing = .true.
   self%damaged = .false.
   inquire (file=self%path//"/.", exist=folder)
   if (folder) then
      call fatal_error(error, err_file, self%path//": cannot be written: it is a folder; "// &
         "remove it or choose another output folder")
      return
   end if
   if (rkh5_open(c_text(part_of(self%path)), 1_c_int, self%handle, why, nwhy) /= 0) then
      call fatal_error(error, err_file, part_of(self%path)//": cannot be created: "// &
         f_text(why)//"; choose an output folder that exists and can be written")
   end if
end subroutine create

!> Open an existing file for reading
subroutine open_read(self, path, error)
   !> File to be opened
   class(h5_type), intent(inout) :: self
   !> Name of the file
   character(len=*), intent(in) :: path
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   character(kind=c_char) :: why(nwhy)

   self%path = trim(path)
   self%writing = .false.
   if (rkh5_open(c_text(self%path), 0_c_int, self%handle, why, nwhy) /= 0) then
      call fatal_error(error, err_file, self%path//": cannot be opened: "//f_text(why))
   end if
end subroutine open_read

!> Hand everything written so far to the operating system; a full disk shows here
subroutine flush_file(self, error)
   !> Open file
   class(h5_type), intent(inout) :: self
   !> Error handling
   type(error_type), allocatable, intent(inout) :: error
   character(kind=c_char) :: why(nwhy)

   if (allocated(error)) return
   if (rkh5_flush(self%handle, why, nwhy) /= 0) call write_error(self, "", why, error)
end subroutine flush_file

!> Close; a new file takes its real name unless a write has failed or it is to be left unfinished
subroutine close_file(self, error, unfinished)
   !> Open file; nothing happens to a closed one
   class(h5_type), intent(inout) :: self
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   !> Keep the temporary name
   logical, intent(in), optional :: unfinished
   character(kind=c_char) :: why(nwhy)
   integer(c_int) :: stat

   if (self%handle < 0) return
   stat = rkh5_close(self%handle, why, nwhy)
   self%handle = -1_c_int64_t
   if (.not. self%writing) return
   if (stat /= 0) then
      call write_error(self, "", why, error)
      return
   end if
   if (present(unfinished)) then
      if (unfinished) return
   end if
   call self%publish(error)
end subroutine close_file

!> Give a closed file that was written its real name, unless a write has failed
subroutine publish(self, error)
   !> Closed file
   class(h5_type), intent(in) :: self
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   character(kind=c_char) :: why(nwhy)

   if (self%damaged) then
      call fatal_error(error, err_file, self%path//": not replaced, because writing "// &
         part_of(self%path)//" has failed")
   else if (rkh5_rename(c_text(part_of(self%path)), c_text(self%path), why, nwhy) /= 0) then
      call fatal_error(error, err_file, self%path//": cannot take the place of the file: "// &
         f_text(why)//"; the results are in "//part_of(self%path))
   end if
end subroutine publish

!> Whether a dataset or group exists
function has(self, name)
   !> Open file
   class(h5_type), intent(in) :: self
   !> Path in the file, as "boundary/names"
   character(len=*), intent(in) :: name
   logical :: has

   has = rkh5_exists(self%handle, c_text(name)) /= 0
end function has

!> Append numbers of any kind and shape along the last Fortran dimension
subroutine append(self, name, values, error)
   !> File being written
   class(h5_type), intent(inout) :: self
   !> Path in the file
   character(len=*), intent(in) :: name
   !> Numbers: real, integers of 4 or 8 bytes, or bytes; all dimensions but the last one are the
   !> same in every call
   type(*), intent(in), contiguous :: values(..)
   !> Error handling
   type(error_type), allocatable, intent(inout) :: error
   character(kind=c_char) :: why(nwhy)

   if (allocated(error)) return
   if (rkh5_append(self%handle, c_text(name), values, why, nwhy) /= 0) then
      call write_error(self, name, why, error)
   end if
end subroutine append

!> Append a text as bytes
subroutine append_text(self, name, text, error)
   !> File being written
   class(h5_type), intent(inout) :: self
   !> Path in the file
   character(len=*), intent(in) :: name
   !> Text, UTF-8
   character(len=*), intent(in) :: text
   !> Error handling
   type(error_type), allocatable, intent(inout) :: error

   call self%append(name, transfer(text, [0_int8]), error)
end subroutine append_text

!> Read a list of real numbers
subroutine read_real1(self, name, values, error)
   !> Open file
   class(h5_type), intent(in) :: self
   !> Path in the file
   character(len=*), intent(in) :: name
   !> Numbers, shape (n)
   real(wp), allocatable, target, intent(out) :: values(:)
   !> Error handling
   type(error_type), allocatable, intent(inout) :: error
   integer(i8) :: dims(1)

   call get_shape(self, name, kind_real, dims, error)
   if (allocated(error)) return
   allocate (values(dims(1)))
   call read_any(self, name, kind_real, c_loc(values), error)
end subroutine read_real1

!> Read a table of real numbers
subroutine read_real2(self, name, values, error)
   !> Open file
   class(h5_type), intent(in) :: self
   !> Path in the file
   character(len=*), intent(in) :: name
   !> Numbers, shape (m,n)
   real(wp), allocatable, target, intent(out) :: values(:, :)
   !> Error handling
   type(error_type), allocatable, intent(inout) :: error
   integer(i8) :: dims(2)

   call get_shape(self, name, kind_real, dims, error)
   if (allocated(error)) return
   allocate (values(dims(1), dims(2)))
   call read_any(self, name, kind_real, c_loc(values), error)
end subroutine read_real2

!> Read a list of integers
subroutine read_int1(self, name, values, error)
   !> Open file
   class(h5_type), intent(in) :: self
   !> Path in the file
   character(len=*), intent(in) :: name
   !> Numbers, shape (n)
   integer, allocatable, target, intent(out) :: values(:)
   !> Error handling
   type(error_type), allocatable, intent(inout) :: error
   integer(i8) :: dims(1)

   call get_shape(self, name, kind_int, dims, error)
   if (allocated(error)) return
   allocate (values(dims(1)))
   call read_any(self, name, kind_int, c_loc(values), error)
end subroutine read_int1

!> Read a table of integers
subroutine read_int2(self, name, values, error)
   !> Open file
   class(h5_type), intent(in) :: self
   !> Path in the file
   character(len=*), intent(in) :: name
   !> Numbers, shape (m,n)
   integer, allocatable, target, intent(out) :: values(:, :)
   !> Error handling
   type(error_type), allocatable, intent(inout) :: error
   integer(i8) :: dims(2)

   call get_shape(self, name, kind_int, dims, error)
   if (allocated(error)) return
   allocate (values(dims(1), dims(2)))
   call read_any(self, name, kind_int, c_loc(values), error)
end subroutine read_int2

!> Read a text stored as bytes
subroutine read_text(self, name, text, error)
   !> Open file
   class(h5_type), intent(in) :: self
   !> Path in the file
   character(len=*), intent(in) :: name
   !> Text, UTF-8
   character(len=:), allocatable, target, intent(out) :: text
   !> Error handling
   type(error_type), allocatable, intent(inout) :: error
   integer(i8) :: dims(1)

   call get_shape(self, name, kind_byte, dims, error)
   if (allocated(error)) return
   allocate (character(len=dims(1)) :: text)
   call read_any(self, name, kind_byte, c_loc(text), error)
end subroutine read_text

!> Fortran shape of a dataset, with the wanted number of dimensions and kind of numbers
subroutine get_shape(self, name, kind, dims, error)
   !> Open file
   class(h5_type), intent(in) :: self
   !> Path in the file
   character(len=*), intent(in) :: name
   !> Kind of the numbers
   integer(c_int), intent(in) :: kind
   !> Shape
   integer(i8), intent(out) :: dims(:)
   !> Error handling
   type(error_type), allocatable, intent(inout) :: error
   character(kind=c_char) :: why(nwhy)
   integer(c_int64_t) :: found(max_rank)
   integer(c_int) :: rank

   if (allocated(error)) return
   if (.not. self%has(name)) then
      call fatal_error(error, err_input, self%path//": dataset '"//name//"' is missing")
      return
   end if
   if (rkh5_shape(self%handle, c_text(name), kind, rank, found, why, nwhy) /= 0) then
      call fatal_error(error, err_input, self%path//": '"//name//"': "//f_text(why))
   else if (rank /= size(dims)) then
      call fatal_error(error, err_input, self%path//": '"//name//"' has "//to_text(int(rank))// &
         " dimension(s), but "//to_text(size(dims))//" are needed")
   else
      dims = found(:rank)
   end if
end subroutine get_shape

!> Read all numbers of a dataset
subroutine read_any(self, name, kind, values, error)
   !> Open file
   class(h5_type), intent(in) :: self
   !> Path in the file
   character(len=*), intent(in) :: name
   !> Kind of the numbers
   integer(c_int), intent(in) :: kind
   !> First number
   type(c_ptr), intent(in) :: values
   !> Error handling
   type(error_type), allocatable, intent(inout) :: error
   character(kind=c_char) :: why(nwhy)

   if (rkh5_read(self%handle, c_text(name), kind, values, why, nwhy) /= 0) then
      call fatal_error(error, err_file, self%path//": '"//name//"' cannot be read: "// &
         f_text(why))
   end if
end subroutine read_any

!> Set whole numbers as an attribute
subroutine put_integers(self, object, name, values, error)
   !> File being written
   class(h5_type), intent(inout) :: self
   !> Group or dataset
   character(len=*), intent(in) :: object
   !> Name of the attribute
   character(len=*), intent(in) :: name
   !> Numbers, shape (n); one is stored as a scalar
   integer, intent(in), contiguous, target :: values(:)
   !> Error handling
   type(error_type), allocatable, intent(inout) :: error
   character(kind=c_char) :: why(nwhy)

   if (allocated(error)) return
   if (rkh5_put_attribute(self%handle, c_text(object), c_text(name), kind_int, size(values), &
      c_loc(values), why, nwhy) /= 0) then
      call write_error(self, name, why, error)
   end if
end subroutine put_integers

!> Set a text as an attribute
subroutine put_text(self, object, name, text, error)
   !> File being written
   class(h5_type), intent(inout) :: self
   !> Group or dataset
   character(len=*), intent(in) :: object
   !> Name of the attribute
   character(len=*), intent(in) :: name
   !> Text, ASCII, not empty
   character(len=*), intent(in), target :: text
   !> Error handling
   type(error_type), allocatable, intent(inout) :: error
   character(kind=c_char) :: why(nwhy)

   if (allocated(error)) return
   if (rkh5_put_attribute(self%handle, c_text(object), c_text(name), kind_byte, len(text), &
      c_loc(text), why, nwhy) /= 0) then
      call write_error(self, name, why, error)
   end if
end subroutine put_text

!> Get a text attribute
subroutine get_attribute(self, object, name, text, error)
   !> Open file
   class(h5_type), intent(in) :: self
   !> Group or dataset
   character(len=*), intent(in) :: object
   !> Name of the attribute
   character(len=*), intent(in) :: name
   !> Text
   character(len=:), allocatable, intent(out) :: text
   !> Error handling
   type(error_type), allocatable, intent(inout) :: error
   character(kind=c_char) :: why(nwhy), buffer(4096)
   integer(c_int) :: length
   integer :: i

   if (allocated(error)) return
   if (rkh5_get_text(self%handle, c_text(object), c_text(name), buffer, size(buffer), length, &
      why, nwhy) /= 0) then
      call fatal_error(error, err_input, self%path//": text attribute '"//name//"' of '"// &
         object//"': "//f_text(why))
      return
   end if
   length = min(length, size(buffer))
   allocate (character(len=length) :: text)
   do i = 1, length
      text(i:i) = buffer(i)
   end do
end subroutine get_attribute

!> A write has failed: the file will not take its real name
subroutine write_error(self, name, why, error)
   !> File being written
   class(h5_type), intent(inout) :: self
   !> Path in the file or name of the attribute; empty for the whole file
   character(len=*), intent(in) :: name
   !> Reason given by the shim
   character(kind=c_char), intent(in) :: why(:)
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: what

   self%damaged = .true.
   what = part_of(self%path)//": writing "
   if (len(name) > 0) what = what//"'"//name//"' "
   call fatal_error(error, err_file, what//"failed: "//f_text(why)// &
      "; an earlier "//self%path//" is as it was")
end subroutine write_error

!> Name of a file while it is being written
pure function part_of(path) result(part)
   !> Name it takes at the end
   character(len=*), intent(in) :: path
   character(len=:), allocatable :: part

   part = path//".part"
end function part_of

!> Text for C
pure function c_text(text) result(chars)
   !> Fortran text
   character(len=*), intent(in) :: text
   character(kind=c_char, len=:), allocatable :: chars

   chars = trim(text)//c_null_char
end function c_text

!> Text from C
pure function f_text(chars) result(text)
   !> Characters up to a null
   character(kind=c_char), intent(in) :: chars(:)
   character(len=:), allocatable :: text
   integer :: i

   text = ""
   do i = 1, size(chars)
      if (chars(i) == c_null_char) exit
      text = text//chars(i)
   end do
end function f_text

end module rk_hdf5
