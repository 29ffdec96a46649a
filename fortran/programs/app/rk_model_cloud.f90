!> The points of a model file as a cloud, where a deck asks for one.
module rk_model_cloud
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_error, only : error_type, fatal_error, err_file
   use rk_model_file, only : read_model
   implicit none
   private

   public :: read_model_cloud

contains

!> Read the model file of a deck; nothing happens for decks with a geometry of their own
subroutine read_model_cloud(cloud, deck, out, error)
   !> Points
   type(cloud_type), intent(out) :: cloud
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Output folder, looked into first
   character(len=*), intent(in) :: out
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: kind, file, path, beside
   logical :: found

   call deck%get('geometry.kind', kind)
   if (kind /= 'model') return
   call deck%get('geometry.file', file)
   path = file
   if (index(file, '/') /= 1) path = out//'/'//file
   inquire (file=path, exist=found)
   if (.not. found .and. index(file, '/') /= 1) then
      beside = deck%folder//'/'//file
      inquire (file=beside, exist=found)
      if (found) path = beside
   end if
   if (.not. found) then
      call fatal_error(error, err_file, deck%where('geometry.file')//': geometry.file: no model ' &
         & //file//' in '//out//' or beside the deck: run `myork build` first')
      return
   end if
   call read_model(cloud, path, error)
end subroutine read_model_cloud

end module rk_model_cloud
