!> Named parts of the surface of a body, given by side, material or an expression.
module rk_region
   use rk_error, only : error_type
   use rk_expression, only : expression_type
   use rk_precision, only : wp
   implicit none
   private

   public :: region_type

   !> Part of the surface; all conditions given must be satisfied
   type :: region_type
      !> Side of the body, 0 for all
      integer :: side = 0
      !> Label of the tissue behind the surface; not allocated for all
      integer, allocatable :: label
      !> Where the tissue lies, by expressions: its own (not given means everywhere), and those of
      !> tissues that replace it in part; not allocated if labels define it
      type(expression_type), allocatable :: tissue(:)
      !> The region is where this is not zero; not given means everywhere
      type(expression_type) :: where
   contains
      procedure :: holds
   end type region_type

contains

!> Whether a region contains a position on the surface
logical function holds(self, x, normal, side, label, error)
   class(region_type), intent(in) :: self
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Outward unit normal, shape (nd) [-]
   real(wp), intent(in) :: normal(:)
   !> Side of the body on which it lies
   integer, intent(in) :: side
   !> Label of the tissue there
   integer, intent(in) :: label
   !> Error handling: an expression that is not finite there
   type(error_type), allocatable, intent(inout) :: error
   real(wp) :: value
   integer :: k

   holds = .true.
   if (self%side > 0) holds = side == self%side
   if (allocated(self%label)) holds = holds .and. label == self%label
   if (allocated(self%tissue)) then
      do k = 1, size(self%tissue)
         if (.not. self%tissue(k)%given()) cycle
         call self%tissue(k)%at(x, value, error)
         holds = holds .and. (abs(value) > 0.0_wp .eqv. k == 1)
      end do
   end if
   ! an expression need not be finite where the set cannot lie
   if (.not. (holds .and. self%where%given())) return
   call self%where%at(x, value, error, normal=normal)
   holds = abs(value) > 0.0_wp
end function holds

end module rk_region
