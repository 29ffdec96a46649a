!> Interfaces of h5.c, which speaks to the HDF5 library; used by rk_hdf5 only.
!>
!> Every function with `why` returns 0, or -1 with the reason as a C string in `why`, cut to `nwhy`
!> characters. Names and paths are C strings. `kind`: 1 real(8), 2 integer(4), 3 integer(8), 4 byte.
module rk_h5_shim
   use, intrinsic :: iso_c_binding, only : c_char, c_int, c_int64_t, c_ptr
   implicit none
   private

   public :: rkh5_append, rkh5_close, rkh5_exists, rkh5_flush, rkh5_get_text, rkh5_open
   public :: rkh5_put_attribute, rkh5_read, rkh5_rename, rkh5_shape

   interface
      !> Open a file for reading (writing = 0) or create it (writing = 1)
      integer(c_int) function rkh5_open(path, writing, file, why, nwhy) bind(c)
         import :: c_char, c_int, c_int64_t
         character(kind=c_char), intent(in) :: path(*)
         integer(c_int), value :: writing
         integer(c_int64_t), intent(out) :: file
         character(kind=c_char), intent(out) :: why(*)
         integer(c_int), value :: nwhy
      end function rkh5_open

      !> Hand everything written so far to the operating system
      integer(c_int) function rkh5_flush(file, why, nwhy) bind(c)
         import :: c_char, c_int, c_int64_t
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(out) :: why(*)
         integer(c_int), value :: nwhy
      end function rkh5_flush

      !> Close the file
      integer(c_int) function rkh5_close(file, why, nwhy) bind(c)
         import :: c_char, c_int, c_int64_t
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(out) :: why(*)
         integer(c_int), value :: nwhy
      end function rkh5_close

      !> Give a closed file another name, replacing the file that has it
      integer(c_int) function rkh5_rename(from, to, why, nwhy) bind(c, name='rkf_rename')
         import :: c_char, c_int
         character(kind=c_char), intent(in) :: from(*), to(*)
         character(kind=c_char), intent(out) :: why(*)
         integer(c_int), value :: nwhy
      end function rkh5_rename

      !> 1 if a group or dataset exists, otherwise 0
      integer(c_int) function rkh5_exists(file, path) bind(c)
         import :: c_char, c_int, c_int64_t
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: path(*)
      end function rkh5_exists

      !> Append numbers along the last dimension; their descriptor says of which kind and shape
      integer(c_int) function rkh5_append(file, path, values, why, nwhy) bind(c)
         import :: c_char, c_int, c_int64_t
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: path(*)
         type(*), intent(in) :: values(..)
         character(kind=c_char), intent(out) :: why(*)
         integer(c_int), value :: nwhy
      end function rkh5_append

      !> Fortran shape of a dataset whose numbers can be read as those of a kind; of more than four
      !> dimensions only their number
      integer(c_int) function rkh5_shape(file, path, kind, rank, dims, why, nwhy) bind(c)
         import :: c_char, c_int, c_int64_t
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: path(*)
         integer(c_int), value :: kind
         integer(c_int), intent(out) :: rank
         integer(c_int64_t), intent(out) :: dims(*)
         character(kind=c_char), intent(out) :: why(*)
         integer(c_int), value :: nwhy
      end function rkh5_shape

      !> All numbers of a dataset
      integer(c_int) function rkh5_read(file, path, kind, data, why, nwhy) bind(c)
         import :: c_char, c_int, c_int64_t, c_ptr
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: path(*)
         integer(c_int), value :: kind
         type(c_ptr), value :: data
         character(kind=c_char), intent(out) :: why(*)
         integer(c_int), value :: nwhy
      end function rkh5_read

      !> Set an attribute of a group or dataset: n numbers, or a text of n bytes
      integer(c_int) function rkh5_put_attribute(file, object, name, kind, n, values, why, &
         nwhy) bind(c)
         import :: c_char, c_int, c_int64_t, c_ptr
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: object(*), name(*)
         integer(c_int), value :: kind, n
         type(c_ptr), value :: values
         character(kind=c_char), intent(out) :: why(*)
         integer(c_int), value :: nwhy
      end function rkh5_put_attribute

      !> Text attribute; a text longer than `size` is cut, its full length is in `length`
      integer(c_int) function rkh5_get_text(file, object, name, text, size, length, why, nwhy) &
         bind(c)
         import :: c_char, c_int, c_int64_t
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: object(*), name(*)
         character(kind=c_char), intent(out) :: text(*)
         integer(c_int), value :: size
         integer(c_int), intent(out) :: length
         character(kind=c_char), intent(out) :: why(*)
         integer(c_int), value :: nwhy
      end function rkh5_get_text
   end interface

end module rk_h5_shim
