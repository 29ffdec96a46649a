!> Answer to a question of Python about an open scene: arrays and texts by name, which the boundary
!> hands over one after the other.
module rk_answer
   use rk_precision, only : wp
   implicit none
   private

   public :: answer_type

   !> Arrays of an answer at most
   integer, parameter :: most = 48

   !> An array, flat
   type :: array_type
      character(len=16) :: name = ''
      !> What its numbers are: 0 real, 1 whole, 2 the letters of a text
      integer :: kind = 0
      !> At most three numbers
      integer, allocatable :: shape(:)
      real(wp), allocatable :: value(:)
   end type array_type

   !> Answer
   type :: answer_type
      !> Arrays so far
      integer :: count = 0
      type(array_type) :: array(most)
   contains
      procedure :: put, put_whole, put_text
   end type answer_type

contains

!> Add real numbers
subroutine put(self, name, shape, value)
   class(answer_type), intent(inout) :: self
   character(len=*), intent(in) :: name
   integer, intent(in) :: shape(:)
   !> Numbers, the first index of the shape running first
   real(wp), intent(in) :: value(*)

   self%count = self%count + 1
   self%array(self%count) = array_type(name, 0, shape, value(:product(shape)))
end subroutine put

!> Add whole numbers
subroutine put_whole(self, name, shape, value)
   class(answer_type), intent(inout) :: self
   character(len=*), intent(in) :: name
   integer, intent(in) :: shape(:)
   integer, intent(in) :: value(*)

   call self%put(name, shape, real(value(:product(shape)), wp))
   self%array(self%count)%kind = 1
end subroutine put_whole

subroutine put_text(self, name, text)
   class(answer_type), intent(inout) :: self
   character(len=*), intent(in) :: name
   !> Not allocated counts as empty
   character(len=:), allocatable, intent(in) :: text
   integer :: i

   if (allocated(text)) then
      call self%put_whole(name, [len(text)], [(iachar(text(i:i)), i=1, len(text))])
   else
      call self%put_whole(name, [0], [integer ::])
   end if
   self%array(self%count)%kind = 2
end subroutine put_text

end module rk_answer
