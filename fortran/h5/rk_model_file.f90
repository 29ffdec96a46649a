!> Reads `model.h5`, the cloud that Python's `build` makes of an image.
!>
!> Datasets have the names of the cloud's components; pydriver/myork/model_file.py writes them.
!> Indices count from 0 in the file and from 1 here, but for those of voxels, whose grid has no
!> first one. Files of format 2 have other names and centres of voxels instead of their grid.
module rk_model_file
   use rk_cloud, only : cloud_type, voxels_type
   use rk_error, only : err_input, error_type, fatal_error
   use rk_hdf5, only : h5_type
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: read_model

   !> Mark of the files this module reads, and of the older ones that it reads as well
   character(len=*), parameter :: format = "myork-model 3", format_2 = "myork-model 2"
   !> Greatest index of a voxel; no image has more voxels along an edge
   integer, parameter :: max_index = 1000000
   !> Names of datasets: here and in files of format 2
   character(len=*), parameter :: names(2, 11) = reshape([character(len=20) :: &
      "source", "source/points", &
      "spacing", "source/spacing", &
      "points", "collocation/points", &
      "label", "collocation/label", &
      "fiber", "collocation/fiber", &
      "volume", "collocation/volume", &
      "boundary_point", "boundary/point", &
      "boundary_set", "boundary/set", &
      "normal", "boundary/normal", &
      "area", "boundary/area", &
      "set_names", "boundary/names"], [2, 11])

contains

!> Read a model and check that its parts fit together
subroutine read_model(cloud, path, error)
   !> Cloud that was read
   type(cloud_type), intent(out) :: cloud
   !> Name of the file
   character(len=*), intent(in) :: path
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   type(error_type), allocatable :: ignored
   type(h5_type) :: file
   character(len=:), allocatable :: mark

   call file%open_read(path, error)
   if (allocated(error)) return
   call file%get_attribute("/", "format", mark, error)
   if (allocated(error)) mark = ""
   if (mark /= format .and. mark /= format_2) then
      call fatal_error(error, err_input, path//": not a model written by 'myork build' of this "// &
         "version (attribute 'format' must be '"//format//"' or '"//format_2//"')")
   else
      call read_parts(cloud, file, merge(1, 2, mark == format), path, error)
   end if
   call file%close(ignored)
   if (.not. allocated(error)) call check_model(cloud, merge(1, 2, mark == format), path, error)
   if (allocated(error)) return
   cloud%boundary_point = cloud%boundary_point + 1
   cloud%boundary_set = cloud%boundary_set + 1
end subroutine read_model

!> Read all datasets
subroutine read_parts(cloud, file, column, path, error)
   !> Cloud that was read
   type(cloud_type), intent(inout) :: cloud
   !> Open file
   type(h5_type), intent(in) :: file
   !> Of the names
   integer, intent(in) :: column
   !> Name of the file
   character(len=*), intent(in) :: path
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: text

   cloud%nd = 3
   call file%get_attribute("/", "length_unit", cloud%length_unit, error)
   if (allocated(error)) return
   call file%read(name_of("source", column), cloud%source, error)
   if (allocated(error)) return
   call file%read(name_of("spacing", column), cloud%spacing, error)
   if (allocated(error)) return
   call file%read(name_of("points", column), cloud%points, error)
   if (allocated(error)) return
   call file%read(name_of("label", column), cloud%label, error)
   if (allocated(error)) return
   call file%read(name_of("fiber", column), cloud%fiber, error)
   if (allocated(error)) return
   call file%read(name_of("volume", column), cloud%volume, error)
   if (allocated(error)) return
   call file%read(name_of("boundary_point", column), cloud%boundary_point, error)
   if (allocated(error)) return
   call file%read(name_of("boundary_set", column), cloud%boundary_set, error)
   if (allocated(error)) return
   call file%read(name_of("normal", column), cloud%normal, error)
   if (allocated(error)) return
   call file%read(name_of("area", column), cloud%area, error)
   if (allocated(error)) return
   call file%read(name_of("set_names", column), text, error)
   if (allocated(error)) return
   call split_lines(text, cloud%set_names)
   if (column == 1) then
      if (file%has("fraction")) then
         call file%read("fraction", cloud%fraction, error)
         if (allocated(error)) return
         call file%read("fraction_label", cloud%fraction_label, error)
         if (allocated(error)) return
      end if
      if (file%has("activation")) then
         call file%read("activation", cloud%activation, error)
         if (allocated(error)) return
      end if
      call read_voxels(cloud%voxels, file, path, error)
   else
      call recover_voxels(cloud, file, error)
   end if
end subroutine read_parts

!> Name of a dataset in files of a format
pure function name_of(name, column) result(dataset)
   !> Component of the cloud
   character(len=*), intent(in) :: name
   !> Of the names
   integer, intent(in) :: column
   character(len=:), allocatable :: dataset

   dataset = trim(names(column, findloc(names(1, :), name, dim=1)))
end function name_of

!> Read the grid of the voxels, where the file has one
subroutine read_voxels(voxels, file, path, error)
   !> Grid
   type(voxels_type), intent(inout) :: voxels
   !> Open file
   type(h5_type), intent(in) :: file
   !> Name of the file
   character(len=*), intent(in) :: path
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: edges(:), origin(:)
   integer, allocatable :: index(:, :)

   if (.not. file%has("voxels")) return
   call file%read("voxels/index", index, error)
   if (allocated(error)) return
   call file%read("voxels/size", edges, error)
   if (allocated(error)) return
   call file%read("voxels/origin", origin, error)
   if (allocated(error)) return
   if (size(edges) /= 3 .or. size(origin) /= 3) then
      call fatal_error(error, err_input, path//": 'voxels/size' and 'voxels/origin' must "// &
         "have 3 numbers each; run 'myork build' again")
      return
   end if
   voxels = voxels_type(index, edges, origin)
end subroutine read_voxels

!> Recover the grid from the centres of voxels: their smallest distance along each direction is the
!> size. Bodies whose points have other volumes were not made of voxels and have no grid.
subroutine recover_voxels(cloud, file, error)
   !> Cloud
   type(cloud_type), intent(inout) :: cloud
   !> Open file
   type(h5_type), intent(in) :: file
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: centre(:, :)
   type(voxels_type) :: grid
   integer :: d

   call file%read("collocation/centre", centre, error)
   if (allocated(error)) return
   ! what does not fit together is told by who checks the cloud
   if (size(centre) == 0 .or. any(shape(centre) /= shape(cloud%points))) return
   if (size(cloud%spacing) == 0 .or. size(cloud%volume) /= size(centre, 2)) return
   if (.not. all(abs(centre) <= huge(centre))) return
   do d = 1, 3
      grid%origin(d) = minval(centre(d, :))
      grid%size(d) = least_gap(centre(d, :), 1.0e-6_wp*minval(cloud%spacing(d, :)))
      if (.not. grid%size(d) > 0.0_wp) grid%size(d) = minval(cloud%spacing(d, :))
   end do
   if (.not. all(abs(cloud%volume - product(grid%size)) < 1.0e-6_wp*product(grid%size))) return
   if (any(maxval(centre, dim=2) - grid%origin > max_index*grid%size)) return
   grid%index = nint((centre - spread(grid%origin, 2, size(centre, 2))) &
      /spread(grid%size, 2, size(centre, 2)))
   cloud%voxels = grid
end subroutine recover_voxels

!> Smallest distance of different numbers, 0 if all are the same
pure real(wp) function least_gap(x, tolerance)
   !> Numbers
   real(wp), intent(in) :: x(:)
   !> Numbers nearer than this are the same
   real(wp), intent(in) :: tolerance
   real(wp) :: here, next

   least_gap = 0.0_wp
   here = minval(x)
   do
      if (.not. any(x > here + tolerance)) return
      next = minval(x, mask=x > here + tolerance)
      if (least_gap > 0.0_wp) then
         least_gap = min(least_gap, next - here)
      else
         least_gap = next - here
      end if
      here = next
   end do
end function least_gap

!> Shapes and indices must fit, numbers must be finite
subroutine check_model(cloud, column, path, error)
   !> Cloud that was read, indices from 0 still: one more may be no integer
   type(cloud_type), intent(in) :: cloud
   !> Of the names
   integer, intent(in) :: column
   !> Name of the file
   character(len=*), intent(in) :: path
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer :: nb, np

   np = size(cloud%label)
   nb = size(cloud%boundary_point)
   if (size(cloud%source, 2) == 0) call complain("it has no source points")
   call check_columns("source", cloud%source, size(cloud%source, 2))
   call check_columns("points", cloud%points, np)
   call check_columns("fiber", cloud%fiber, np)
   call check_columns("normal", cloud%normal, nb)
   call check_columns("spacing", cloud%spacing, size(cloud%source, 2))
   call check_length("volume", cloud%volume, np)
   call check_length("area", cloud%area, nb)
   if (size(cloud%boundary_set) /= nb) call complain("'"//name_of("boundary_set", column)// &
      "' has "//to_text(size(cloud%boundary_set))//" entries, but '"// &
      name_of("boundary_point", column)//"' has "//to_text(nb))
   call check_range("boundary_point", cloud%boundary_point, np)
   call check_range("boundary_set", cloud%boundary_set, size(cloud%set_names))
   if (np == 0) call complain("it has no collocation points")
   if (allocated(cloud%activation)) then
      if (size(cloud%activation) /= np) then
         call complain("'activation' has "//to_text(size(cloud%activation))//" entries, but "// &
            to_text(np)//" are needed")
      else if (.not. all(cloud%activation >= 0.0_wp .and. cloud%activation <= 1.0_wp)) then
         call complain("'activation' must be between 0 and 1, but entry "//to_text(first_bad( &
            .not. (cloud%activation >= 0.0_wp .and. cloud%activation <= 1.0_wp)))//" is not")
      end if
   end if
   if (allocated(cloud%fraction)) then
      if (any(shape(cloud%fraction) /= [size(cloud%fraction_label), np])) &
         call complain("'fraction' has shape ("//to_text(size(cloud%fraction, 2))//", "// &
            to_text(size(cloud%fraction, 1))//"), but ("//to_text(np)//", "// &
            to_text(size(cloud%fraction_label))//") is needed")
   end if
   if (allocated(cloud%voxels%index)) call check_voxels(cloud%voxels)

contains

   !> Three finite numbers for each of n entries
   subroutine check_columns(name, values, n)
      !> Component of the cloud
      character(len=*), intent(in) :: name
      !> Numbers
      real(wp), intent(in) :: values(:, :)
      !> Entries there must be
      integer, intent(in) :: n

      if (size(values, 1) /= 3 .or. size(values, 2) /= n) then
         call complain("'"//name_of(name, column)//"' has shape ("//to_text(size(values, 2))// &
            ", "//to_text(size(values, 1))//"), but ("//to_text(n)//", 3) is needed")
      else if (.not. all(abs(values) <= huge(values))) then
         call complain("'"//name_of(name, column)//"' has a number that is not finite, first "// &
            "in entry "//to_text(first_bad(any(.not. abs(values) <= huge(values), dim=1))))
      end if
   end subroutine check_columns

   !> One finite number, not below zero, for each of n entries
   subroutine check_length(name, values, n)
      !> Component of the cloud
      character(len=*), intent(in) :: name
      !> Numbers
      real(wp), intent(in) :: values(:)
      !> Entries there must be
      integer, intent(in) :: n

      if (size(values) /= n) then
         call complain("'"//name_of(name, column)//"' has "//to_text(size(values))// &
            " entries, but "//to_text(n)//" are needed")
      else if (.not. all(abs(values) <= huge(values))) then
         call complain("'"//name_of(name, column)//"' has a number that is not finite, first "// &
            "in entry "//to_text(first_bad(.not. abs(values) <= huge(values))))
      else if (any(values < 0.0_wp)) then
         call complain("'"//name_of(name, column)//"' has a negative number, first in entry "// &
            to_text(first_bad(values < 0.0_wp)))
      end if
   end subroutine check_length

   !> Indices from 0 to n - 1
   subroutine check_range(name, indices, n)
      !> Component of the cloud
      character(len=*), intent(in) :: name
      !> Indices
      integer, intent(in) :: indices(:)
      !> What they count
      integer, intent(in) :: n
      integer :: at

      at = first_bad(indices < 0 .or. indices >= n)
      if (at < 0) return
      call complain("'"//name_of(name, column)//"' must hold indices from 0 to "// &
         to_text(n - 1)//", but entry "//to_text(at)//" is "//to_text(indices(at + 1)))
   end subroutine check_range

   !> A voxel for each collocation point, in a grid that can be
   subroutine check_voxels(voxels)
      !> Grid
      type(voxels_type), intent(in) :: voxels

      if (size(voxels%index, 1) /= 3 .or. size(voxels%index, 2) /= np) then
         call complain("'voxels/index' has shape ("//to_text(size(voxels%index, 2))//", "// &
            to_text(size(voxels%index, 1))//"), but ("//to_text(np)//", 3) is needed")
      else if (any(abs(voxels%index) > max_index)) then
         call complain("'voxels/index' has an index beyond any image in entry "// &
            to_text(first_bad(any(abs(voxels%index) > max_index, dim=1))))
      else if (.not. all(voxels%size > 0.0_wp .and. voxels%size <= huge(1.0_wp) &
         .and. abs(voxels%origin) <= huge(1.0_wp))) then
         call complain("'voxels/size' must be positive and finite, 'voxels/origin' finite")
      end if
   end subroutine check_voxels

   !> The first complaint is kept
   subroutine complain(what)
      !> What is wrong
      character(len=*), intent(in) :: what

      if (allocated(error)) return
      call fatal_error(error, err_input, path//": "//what//"; run 'myork build' again")
   end subroutine complain

end subroutine check_model

!> Index, from 0 as in the file, of the first true value; -1 without one
pure function first_bad(bad) result(at)
   !> Values
   logical, intent(in) :: bad(:)
   integer :: at

   at = findloc(bad, .true., dim=1) - 1
end function first_bad

!> Lines of a text, empty ones left out
pure subroutine split_lines(text, lines)
   !> Text with newlines
   character(len=*), intent(in) :: text
   !> Lines, padded with blanks
   character(len=*), allocatable, intent(inout) :: lines(:)
   character(len=1), parameter :: newline = achar(10)
   integer :: first, last, n

   n = 1 + count(transfer(text, newline, len(text)) == newline)
   if (allocated(lines)) deallocate (lines)
   allocate (lines(n))
   n = 0
   first = 1
   do while (first <= len(text))
      last = index(text(first:), newline) + first - 2
      if (last < first - 1) last = len(text)
      if (last >= first) then
         n = n + 1
         lines(n) = text(first:last)
      end if
      first = last + 2
   end do
   lines = lines(:n)
end subroutine split_lines

end module rk_model_file
