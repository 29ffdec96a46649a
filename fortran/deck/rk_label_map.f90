!> Label maps laid over a box: which label a place has, by an expression.
!>
!> The files are read in C++ (nifti.cpp), which keeps the maps.
module rk_label_map
   use, intrinsic :: iso_c_binding, only : c_char, c_double, c_int, c_null_char, c_ptr
   use rk_cstring, only : to_fortran
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: label_map_type, open_label_map

   !> A label map over a box
   type :: label_map_type
      !> Number of the map where it is kept
      integer, private :: number = -1
      !> Labels in the box, ascending
      integer, allocatable :: label(:)
      !> A place of each of them, shape (3, labels) [length]
      real(wp), allocatable :: place(:, :)
   contains
      procedure :: where_is
   end type label_map_type

   interface
      function c_open(path, factor, origin, size, nd, fault) result(number) &
         & bind(c, name='rk_label_map_open')
         import :: c_char, c_double, c_int, c_ptr
         character(kind=c_char), intent(in) :: path(*)
         real(c_double), value :: factor
         real(c_double), intent(in) :: origin(3), size(3)
         integer(c_int), value :: nd
         type(c_ptr), intent(out) :: fault
         integer(c_int) :: number
      end function c_open
      function c_label(number, which, place) result(label) bind(c, name='rk_label_map_label')
         import :: c_double, c_int
         integer(c_int), value :: number, which
         real(c_double), intent(inout) :: place(3)
         integer(c_int) :: label
      end function c_label
   end interface

contains

!> Read a label map and lay it over a box
subroutine open_label_map(self, path, factor, origin, size_, fault)
   type(label_map_type), intent(out) :: self
   !> File
   character(len=*), intent(in) :: path
   !> Millimetres in the unit of length [length/mm]
   real(wp), intent(in) :: factor
   !> World coordinates of the box's first corner, NaN for the lowest of the map, shape (3) [length]
   real(wp), intent(in) :: origin(3)
   !> Edges of the box, shape (nd) [length]
   real(wp), intent(in) :: size_(:)
   !> What is wrong, blank where nothing is
   character(len=:), allocatable, intent(out) :: fault
   type(c_ptr) :: text
   real(wp) :: edge(3), place(3)
   integer :: label

   edge = 0.0_wp
   edge(:size(size_)) = size_
   self%number = c_open(path//c_null_char, factor, origin, edge, int(size(size_), c_int), text)
   fault = to_fortran(text)
   allocate (self%label(0), self%place(3, 0))
   if (self%number < 0) return
   do
      label = c_label(int(self%number, c_int), int(size(self%label), c_int), place)
      if (label < 0) return
      self%place = reshape([self%place, place], [3, size(self%label) + 1])
      self%label = [self%label, label]
   end do
end subroutine open_label_map

!> Expression that is true where a place has a label
pure function where_is(self, label) result(text)
   class(label_map_type), intent(in) :: self
   integer, intent(in) :: label
   character(len=:), allocatable :: text

   ! what expression.cpp knows
   text = 'rk_label('//to_text(self%number)//', x, y, z) == '//to_text(label)
end function where_is

end module rk_label_map
