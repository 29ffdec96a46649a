!> The label map of a box, geometry.labels, and the materials of its labels.
module rk_deck_labels
   use, intrinsic :: ieee_arithmetic, only : ieee_quiet_nan, ieee_value
   use rk_deck, only : deck_type
   use rk_error, only : error_type
   use rk_label_map, only : label_map_type, open_label_map
   use rk_precision, only : wp
   use rk_scene, only : tissue_type
   use rk_text, only : to_text
   implicit none
   private

   public :: read_labels

   !> Units of length, and millimetres in them [length/mm]
   character(len=*), parameter :: unit(3) = ['mm', 'cm', 'm ']
   real(wp), parameter :: factor(size(unit)) = [1.0_wp, 0.1_wp, 0.001_wp]

contains

!> Parts of the materials that have a label, and their labels where all have one
subroutine read_labels(tissue, deck, error)
   !> Materials in the order of the deck
   type(tissue_type), intent(inout) :: tissue(:)
   !> Deck with a label map
   type(deck_type), intent(in) :: deck
   !> Error handling: what is wrong with the map, one line for each label that does not fit
   type(error_type), allocatable, intent(inout) :: error
   type(label_map_type) :: map
   character(len=:), allocatable :: at, fault, file, list, path, word
   real(wp), allocatable :: edge(:), origin(:)
   integer :: label(size(tissue)), k, u
   logical :: named(size(tissue))

   call deck%get('geometry.labels', file)
   call deck%get('geometry.size', edge)
   call deck%get('geometry.labels_origin', origin)
   if (size(origin) == 0) origin = spread(ieee_value(0.0_wp, ieee_quiet_nan), 1, 3)
   call deck%get('units.length', word)
   do u = 1, size(unit)
      if (unit(u) == word) exit
   end do
   if (u > size(unit)) then
      call deck%complain('units.length', 'must be mm, cm or m, not '//word//': geometry.labels ' &
         & //'lays a map in millimetres over the box', error)
      return
   end if
   path = file
   if (file(1:1) /= '/') path = deck%folder//'/'//file
   call open_label_map(map, path, factor(u), origin, edge, fault)
   if (len(fault) > 0) then
      call deck%complain('geometry.labels', "'"//file//"' "//fault, error)
      return
   end if
   list = to_text(map%label(1))
   do k = 2, size(map%label)
      list = list//', '//to_text(map%label(k))
   end do
   do k = 1, size(tissue)
      at = 'material.'//to_text(k)//'.label'
      named(k) = deck%has(at)
      if (.not. named(k)) cycle
      call deck%get(at, label(k))
      tissue(k)%part%text = map%where_is(label(k))
      tissue(k)%part%where = deck%told(at)
      if (any(map%label == label(k))) cycle
      if (map%knows(label(k))) then
         fault = "of '"//file//"' lies outside of the box"
      else
         fault = "is not in '"//file//"'"
      end if
      call deck%complain(at, 'label '//to_text(label(k))//' '//fault//'; in the box are '//list, &
         & error)
   end do
   if (all(named)) tissue%label = label
   ! the first material fills what no other one holds
   if (.not. tissue(1)%part%given()) return
   do k = 1, size(map%label)
      if (any(named .and. label == map%label(k))) cycle
      if (any([(tissue(u)%part%given() .and. .not. named(u), u=1, size(tissue))])) return
      call deck%complain('geometry.labels', "'"//file//"' has the label "//to_text(map%label(k)) &
         & //' at '//to_text(map%place(:size(edge), k))//', which no [[material]] has: add one, ' &
         & //'or leave label out of the first one, which then fills the rest', error)
   end do
end subroutine read_labels

end module rk_deck_labels
