!> Reads `model.h5`, the cloud that `build` of Python makes from an image.
!>
!> Datasets have the names of the cloud's components; pydriver/myork/model_file.py writes them.
!> Indices count from 0 in the file and from 1 here, except those of voxels, whose grid has no fixed
!> origin.
module rk_model_file
   use rk_cloud, only : cloud_type, take_arrays, voxels_type
   use rk_deck, only : deck_type
   use rk_error, only : err_file, err_input, error_type, fatal_error
   use rk_hdf5, only : h5_type
   use rk_precision, only : wp
   use rk_text, only : lines_of
   implicit none
   private

   public :: read_model_cloud

   !> Format mark of the files this module reads
   character(len=*), parameter :: format = "myork-model 4"

contains

!> Read the model file of a deck; nothing is done if the deck itself gives the geometry
subroutine read_model_cloud(cloud, deck, out, error)
   type(cloud_type), intent(out) :: cloud
   type(deck_type), intent(in) :: deck
   !> Output folder, searched first
   character(len=*), intent(in) :: out
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
      call deck%complain('geometry.file', 'no model '//file//' in '//out//' or beside the deck: ' &
         & //'run `myork build` first', error)
      error%code = err_file
      return
   end if
   call read_model(cloud, path, error)
end subroutine read_model_cloud

!> Read a model and check that its parts fit together
subroutine read_model(cloud, path, error)
   type(cloud_type), intent(out) :: cloud
   character(len=*), intent(in) :: path
   type(error_type), allocatable, intent(out) :: error
   type(error_type), allocatable :: ignored
   type(h5_type) :: file
   character(len=:), allocatable :: mark

   call file%open_read(path, error)
   if (allocated(error)) return
   call file%read("format", mark, error)
   if (allocated(error)) mark = ""
   if (mark /= format) then
      call fatal_error(error, err_input, path//": not a model written by 'myork build' of this "// &
         "version ('format' must be '"//format//"'); run 'myork build' again")
   else
      call read_parts(cloud, file, path, error)
   end if
   call file%close(ignored)
   if (allocated(error)) return
   call take_arrays(cloud, error)
   if (allocated(error)) error%message = path//": "//error%message//"; run 'myork build' again"
end subroutine read_model

!> Read all datasets
subroutine read_parts(cloud, file, path, error)
   type(cloud_type), intent(inout) :: cloud
   type(h5_type), intent(in) :: file
   character(len=*), intent(in) :: path
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: text

   cloud%nd = 3
   call file%read("length_unit", cloud%length_unit, error)
   call file%read("source", cloud%source, error)
   call file%read("spacing", cloud%spacing, error)
   call file%read("points", cloud%points, error)
   call file%read("label", cloud%label, error)
   call file%read("fiber", cloud%fiber, error)
   call file%read("volume", cloud%volume, error)
   call file%read("boundary_point", cloud%boundary_point, error)
   call file%read("boundary_set", cloud%boundary_set, error)
   call file%read("normal", cloud%normal, error)
   call file%read("area", cloud%area, error)
   call file%read("set_names", text, error)
   if (file%has("fraction")) then
      call file%read("fraction", cloud%fraction, error)
      call file%read("fraction_label", cloud%fraction_label, error)
   end if
   if (file%has("activation")) call file%read("activation", cloud%activation, error)
   if (file%has("voxels")) call read_voxels(cloud%voxels, file, path, error)
   if (.not. allocated(error)) call lines_of(text, cloud%set_names)
end subroutine read_parts

subroutine read_voxels(voxels, file, path, error)
   type(voxels_type), intent(inout) :: voxels
   type(h5_type), intent(in) :: file
   character(len=*), intent(in) :: path
   type(error_type), allocatable, intent(inout) :: error
   real(wp), allocatable :: edges(:), origin(:)
   integer, allocatable :: index(:, :)

   call file%read("voxels/index", index, error)
   call file%read("voxels/size", edges, error)
   call file%read("voxels/origin", origin, error)
   if (allocated(error)) return
   if (size(edges) /= 3 .or. size(origin) /= 3) then
      call fatal_error(error, err_input, path//": 'voxels/size' and 'voxels/origin' must "// &
         "have 3 numbers each; run 'myork build' again")
      return
   end if
   voxels = voxels_type(index, edges, origin)
end subroutine read_voxels

end module rk_model_file
