!> Parts of the surface of a body that have names of their own, given by side, material or an
!> expression.
module rk_region
   use rk_error, only : error_type
   use rk_expression, only : expression_type
   use rk_precision, only : wp
   implicit none
   private

   public :: region_type, criteria

   !> Part of the surface; all that it names must hold
   type :: region_type
      !> Side of the body, 0 for all
      integer :: side = 0
      !> Label of the tissue behind the surface; not allocated for all
      integer, allocatable :: label
      !> Where the tissue lies, by expressions: its own, not given for everywhere, and those of
      !> tissues that take their place from it; not allocated where labels give it
      type(expression_type), allocatable :: tissue(:)
      !> Where it is not zero; not given for everywhere
      type(expression_type) :: where
   contains
      procedure :: look
   end type region_type

   !> Criteria of a region, in the order in which they are looked at
   character(len=*), parameter :: criteria(3) = ['side ', 'on   ', 'where']

contains

!> Which of the criteria a place of the surface meets; those that a region does not have are met
subroutine look(self, x, normal, side, label, met, error)
   class(region_type), intent(in) :: self
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Outward unit normal, shape (nd) [-]
   real(wp), intent(in) :: normal(:)
   !> Side of the body that it lies on
   integer, intent(in) :: side
   !> Label of the tissue there
   integer, intent(in) :: label
   !> Whether each is met
   logical, intent(out) :: met(size(criteria))
   !> Error handling: an expression that is not finite there
   type(error_type), allocatable, intent(inout) :: error
   real(wp) :: value
   integer :: k

   met = .true.
   if (self%side > 0) met(1) = side == self%side
   if (allocated(self%label)) met(2) = label == self%label
   if (allocated(self%tissue)) then
      do k = 1, size(self%tissue)
         if (.not. self%tissue(k)%given()) cycle
         call self%tissue(k)%at(x, value, error)
         met(2) = met(2) .and. (abs(value) > 0.0_wp .eqv. k == 1)
      end do
   end if
   if (.not. self%where%given()) return
   call self%where%at(x, value, error, normal=normal)
   met(3) = abs(value) > 0.0_wp
end subroutine look

end module rk_region
