!> Boundary sets of the surface points of integration cells.
module rk_surface_sets
   use rk_cells, only : cells_type
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_named_sets, only : sets_of
   use rk_text, only : to_text
   implicit none
   private

   public :: find_surface_sets

contains

!> Find the sets in which each surface point lies: those of its boundary entry in a model, otherwise
!> those of its position
subroutine find_surface_sets(self, cloud, error)
   !> Points with their surface
   type(cells_type), intent(inout) :: self
   type(cloud_type), intent(in) :: cloud
   !> Error handling: a set that contains no surface point
   type(error_type), allocatable, intent(out) :: error
   integer :: k, s

   if (.not. allocated(cloud%region)) return
   if (allocated(self%entry)) then
      allocate (self%within(size(cloud%set_names), size(self%set)), source=.false.)
      do s = 1, size(self%set)
         if (self%entry(s) > 0) self%within(:, s) = cloud%within(:, self%entry(s))
      end do
   else
      call sets_of(cloud, self%surface, self%outward, self%set, self%within, error)
      if (allocated(error)) return
   end if
   do k = cloud%sides() + 1, size(cloud%set_names)
      if (any(self%within(k, :))) cycle
      call fatal_error(error, err_input, 'set '//trim(cloud%set_names(k))//': it contains ' &
         & //to_text(count(cloud%within(k, :)))//' boundary points, but none of the ' &
         & //to_text(size(self%set))//' places where the surface is integrated: enlarge the set, ' &
         & //'or use more points')
      return
   end do
end subroutine find_surface_sets

end module rk_surface_sets
