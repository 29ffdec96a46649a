!> A field at points under the name it has in result files.
module rk_point_field
   use rk_precision, only : wp
   implicit none
   private

   public :: point_field

   !> Values of a field at points
   type :: point_field
      !> Name
      character(len=:), allocatable :: name
      !> Values, shape (components, points)
      real(wp), allocatable :: value(:, :)
   end type point_field

end module rk_point_field
