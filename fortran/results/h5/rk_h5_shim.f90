!> Interfaces of h5.c, which speaks to the HDF5 library; used by rk_hdf5 only.
!>
!> A pointer that a function returns is null, or the reason of its failure as a C string. Names and
!> paths are C strings. `kind`: 1 real(8), 2 integer(4), 3 integer(8), 4 byte.
module rk_h5_shim
   use, intrinsic :: iso_c_binding, only : c_char, c_int, c_int64_t, c_ptr
   implicit none
   private

   public :: rkh5_append, rkh5_close, rkh5_exists, rkh5_flush, rkh5_get_text, rkh5_open
   public :: rkh5_put_attribute, rkh5_read, rkh5_shape

   interface
      !> Open a file for reading (writing = 0) or create it (writing = 1)
      type(c_ptr) function rkh5_open(path, writing, file) bind(c)
         import :: c_char, c_int, c_int64_t, c_ptr
         character(kind=c_char), intent(in) :: path(*)
         integer(c_int), value :: writing
         integer(c_int64_t), intent(out) :: file
      end function rkh5_open

      !> Hand everything written so far to the operating system
      type(c_ptr) function rkh5_flush(file) bind(c)
         import :: c_int64_t, c_ptr
         integer(c_int64_t), value :: file
      end function rkh5_flush

      !> Close the file
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

      !> Append numbers along the last dimension; their descriptor says of which kind and shape
      type(c_ptr) function rkh5_append(file, path, values) bind(c)
         import :: c_char, c_int64_t, c_ptr
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: path(*)
         type(*), intent(in) :: values(..)
      end function rkh5_append

      !> Fortran shape of a dataset whose numbers can be read as those of a kind; of more than four
      !> dimensions only their number
      type(c_ptr) function rkh5_shape(file, path, kind, rank, dims) bind(c)
         import :: c_char, c_int, c_int64_t, c_ptr
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: path(*)
         integer(c_int), value :: kind
         integer(c_int), intent(out) :: rank
         integer(c_int64_t), intent(out) :: dims(*)
      end function rkh5_shape

      !> All numbers of a dataset
      type(c_ptr) function rkh5_read(file, path, kind, data) bind(c)
         import :: c_char, c_int, c_int64_t, c_ptr
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: path(*)
         integer(c_int), value :: kind
         type(c_ptr), value :: data
      end function rkh5_read

      !> Set an attribute of a group or dataset: n numbers, or a text of n bytes
      type(c_ptr) function rkh5_put_attribute(file, object, name, kind, n, values) bind(c)
         import :: c_char, c_int, c_int64_t, c_ptr
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: object(*), name(*)
         integer(c_int), value :: kind, n
         type(c_ptr), value :: values
      end function rkh5_put_attribute

      !> Text attribute; a text longer than `size` is cut, its full length is in `length`
      type(c_ptr) function rkh5_get_text(file, object, name, text, size, length) &
         bind(c)
         import :: c_char, c_int, c_int64_t, c_ptr
         integer(c_int64_t), value :: file
         character(kind=c_char), intent(in) :: object(*), name(*)
         character(kind=c_char), intent(out) :: text(*)
         integer(c_int), value :: size
         integer(c_int), intent(out) :: length
      end function rkh5_get_text
   end interface

end module rk_h5_shim
