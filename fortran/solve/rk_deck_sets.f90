!> From the tables [[set]] of a checked deck to boundary sets that are parts of the surface.
module rk_deck_sets
   use rk_deck, only : deck_type
   use rk_deck_boundary, only : find_named_set
   use rk_deck_regions, only : has_regions
   use rk_error, only : error_type
   use rk_named_sets, only : add_set
   use rk_region, only : criteria, region_type
   use rk_scene, only : scene_type
   use rk_text, only : to_text
   implicit none
   private

   public :: read_sets

contains

!> Add the sets of a deck to those of the body
subroutine read_sets(scene, deck, error)
   !> Scene with points and tissues
   type(scene_type), intent(inout) :: scene
   type(deck_type), intent(in) :: deck
   !> Error handling, one line more for each side that is not known and each set without a place
   type(error_type), allocatable, intent(inout) :: error
   type(region_type), allocatable :: region
   character(len=:), allocatable :: at, name
   integer :: k, left(size(criteria)), n

   n = size(scene%cloud%set_names)
   do k = 1, deck%count('set')
      at = 'set.'//to_text(k)
      call deck%get(at//'.name', name)
      if (len(name) > len(scene%cloud%set_names)) then
         call deck%complain(at//'.name', 'must not be longer than ' &
            & //to_text(len(scene%cloud%set_names))//' bytes, not '//to_text(len(name)), error)
      else if (any(scene%cloud%set_names(:n) == name)) then
         call deck%complain(at//'.name', "'"//name//"' is a side of this body: take another name", &
            & error)
      end if
      allocate (region)
      call read_region(region, scene, deck, at, error)
      if (allocated(error)) return
      call add_set(scene%cloud, name, region, left, error)
      if (allocated(error)) return
      deallocate (region)
      if (left(size(left)) == 0) call deck%complain(at, 'no place of the surface lies in it: ' &
         & //what_is_left(deck, at, size(scene%cloud%boundary_set), left), error)
   end do
end subroutine read_sets

!> Criteria of a set
subroutine read_region(region, scene, deck, at, error)
   type(region_type), intent(inout) :: region
   type(scene_type), intent(in) :: scene
   type(deck_type), intent(in) :: deck
   !> Key of the set
   character(len=*), intent(in) :: at
   !> Error handling, one line more for an unknown side
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: word
   integer :: k

   if (deck%has(at//'.side')) then
      call deck%get(at//'.side', word)
      call find_named_set(scene%cloud, deck, at//'.side', word, region%side, error)
      if (region%side > scene%cloud%sides()) call deck%complain(at//'.side', "'"//word &
         & //"' is not a side, but another [[set]]: say with `where` what both hold", error)
   end if
   if (deck%has(at//'.on')) then
      call deck%get(at//'.on', k)
      if (has_regions(deck)) then
         ! labels of points would put the border half way between these
         region%tissue = scene%tissue(k:)%part
      else if (size(scene%tissue) > 1) then
         region%label = scene%tissue(k)%label
      end if
   end if
   call deck%get(at//'.where', region%where)
end subroutine read_region

!> How many boundary points each criterion of an empty set leaves
function what_is_left(deck, at, all_, left) result(text)
   type(deck_type), intent(in) :: deck
   character(len=*), intent(in) :: at
   !> Boundary points
   integer, intent(in) :: all_
   !> Those left after each criterion, shape (criteria)
   integer, intent(in) :: left(:)
   character(len=:), allocatable :: text
   integer :: c

   text = 'of '//to_text(all_)//' boundary points'
   do c = 1, size(left)
      if (.not. deck%has(at//'.'//trim(criteria(c)))) cycle
      text = text//', `'//trim(criteria(c))//'` leaves '//to_text(left(c))
      if (left(c) > 0) cycle
      if (criteria(c) == 'where') text = text//'; coordinates are those of the body at rest, and ' &
         & //'normals point out of it'
      return
   end do
end function what_is_left

end module rk_deck_sets
