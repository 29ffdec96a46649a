!> Reads `model.h5`, the cloud that Python's `build` makes of an image.
!>
!> What the file holds is written down in pydriver/myork/model/store.py, which writes it. Indices
!> count from 0 in the file and from 1 here.
module rk_model_file
   use rk_error, only : err_input, error_type, fatal_error
   use rk_hdf5, only : h5_type
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: model_type, read_model

   !> Mark of the files this module reads
   character(len=*), parameter :: format = "myork-model 2"

   !> A cloud with labels, fibers and boundary sets; np collocation and ns source points
   type :: model_type
      !> Source points, shape (3,ns) [length]
      real(wp), allocatable :: source(:, :)
      !> Distance of neighbouring source points in each direction, shape (3,ns) [length]
      real(wp), allocatable :: spacing(:, :)
      !> Collocation points, shape (3,np) [length]
      real(wp), allocatable :: points(:, :)
      !> Centres of the voxels that belong to them, shape (3,np) [length]
      real(wp), allocatable :: centre(:, :)
      !> Label of each collocation point, shape (np)
      integer, allocatable :: label(:)
      !> Unit fiber direction, zero where the label has none, shape (3,np) [-]
      real(wp), allocatable :: fiber(:, :)
      !> Volume that belongs to each collocation point, shape (np) [length^3]
      real(wp), allocatable :: volume(:)
      !> Collocation point of each boundary entry, from 1, shape (nb)
      integer, allocatable :: boundary_point(:)
      !> Boundary set of each boundary entry, from 1, shape (nb)
      integer, allocatable :: boundary_set(:)
      !> Outward unit normal of each boundary entry, shape (3,nb) [-]
      real(wp), allocatable :: boundary_normal(:, :)
      !> Surface that belongs to each boundary entry, shape (nb) [length^2]
      real(wp), allocatable :: boundary_area(:)
      !> Names of the boundary sets, shape (nset)
      character(len=:), allocatable :: set_names(:)
      !> Lines "number name", one for each label, shape (nlabel)
      character(len=:), allocatable :: label_names(:)
      !> Unit of all lengths, as "mm"
      character(len=:), allocatable :: length_unit
   end type model_type

contains

!> Read a model and check that its parts fit together
subroutine read_model(model, path, error)
   !> Model that was read
   type(model_type), intent(out) :: model
   !> Name of the file
   character(len=*), intent(in) :: path
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   type(error_type), allocatable :: ignored
   type(h5_type) :: file

   call file%open_read(path, error)
   if (allocated(error)) return
   call read_parts(model, file, path, error)
   call file%close(ignored)
   if (.not. allocated(error)) call check_model(model, path, error)
end subroutine read_model

!> Read all datasets
subroutine read_parts(model, file, path, error)
   !> Model that was read
   type(model_type), intent(inout) :: model
   !> Open file
   type(h5_type), intent(in) :: file
   !> Name of the file
   character(len=*), intent(in) :: path
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: mark, text

   call file%get_attribute("/", "format", mark, error)
   if (allocated(error)) mark = ""
   if (mark /= format) then
      call fatal_error(error, err_input, path//": not a model written by 'myork build' of this "// &
         "version (attribute 'format' must be '"//format//"')")
      return
   end if
   call file%get_attribute("/", "length_unit", model%length_unit, error)
   if (allocated(error)) return
   call file%read("source/points", model%source, error)
   if (allocated(error)) return
   call file%read("source/spacing", model%spacing, error)
   if (allocated(error)) return
   call file%read("collocation/points", model%points, error)
   if (allocated(error)) return
   call file%read("collocation/centre", model%centre, error)
   if (allocated(error)) return
   call file%read("collocation/label", model%label, error)
   if (allocated(error)) return
   call file%read("collocation/fiber", model%fiber, error)
   if (allocated(error)) return
   call file%read("collocation/volume", model%volume, error)
   if (allocated(error)) return
   call file%read("boundary/point", model%boundary_point, error)
   if (allocated(error)) return
   call file%read("boundary/set", model%boundary_set, error)
   if (allocated(error)) return
   call file%read("boundary/normal", model%boundary_normal, error)
   if (allocated(error)) return
   call file%read("boundary/area", model%boundary_area, error)
   if (allocated(error)) return
   call file%read("boundary/names", text, error)
   if (allocated(error)) return
   call split_lines(text, model%set_names)
   call file%read("labels/names", text, error)
   if (allocated(error)) return
   call split_lines(text, model%label_names)
   model%boundary_point = model%boundary_point + 1
   model%boundary_set = model%boundary_set + 1
end subroutine read_parts

!> Shapes and indices must fit, numbers must be finite
subroutine check_model(model, path, error)
   !> Model that was read
   type(model_type), intent(in) :: model
   !> Name of the file
   character(len=*), intent(in) :: path
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer :: nb, np

   np = size(model%label)
   nb = size(model%boundary_point)
   if (size(model%source, 2) == 0) call complain("it has no source points")
   call check_columns("source/points", model%source, size(model%source, 2))
   call check_columns("collocation/points", model%points, np)
   call check_columns("collocation/centre", model%centre, np)
   call check_columns("collocation/fiber", model%fiber, np)
   call check_columns("boundary/normal", model%boundary_normal, nb)
   call check_columns("source/spacing", model%spacing, size(model%source, 2))
   call check_length("collocation/volume", model%volume, np)
   call check_length("boundary/area", model%boundary_area, nb)
   if (size(model%boundary_set) /= nb) call complain("'boundary/set' has "// &
      to_text(size(model%boundary_set))//" entries, but 'boundary/point' has "//to_text(nb))
   call check_range("boundary/point", model%boundary_point, np)
   call check_range("boundary/set", model%boundary_set, size(model%set_names))
   if (np == 0) call complain("it has no collocation points")

contains

   !> Three finite numbers for each of n entries
   subroutine check_columns(name, values, n)
      !> Path in the file
      character(len=*), intent(in) :: name
      !> Numbers
      real(wp), intent(in) :: values(:, :)
      !> Entries there must be
      integer, intent(in) :: n

      if (size(values, 1) /= 3 .or. size(values, 2) /= n) then
         call complain("'"//name//"' has shape ("//to_text(size(values, 2))//", "// &
            to_text(size(values, 1))//"), but ("//to_text(n)//", 3) is needed")
      else if (.not. all(abs(values) <= huge(values))) then
         call complain("'"//name//"' has a number that is not finite, first in entry "// &
            to_text(first_bad(any(.not. abs(values) <= huge(values), dim=1))))
      end if
   end subroutine check_columns

   !> One finite number for each of n entries
   subroutine check_length(name, values, n)
      !> Path in the file
      character(len=*), intent(in) :: name
      !> Numbers
      real(wp), intent(in) :: values(:)
      !> Entries there must be
      integer, intent(in) :: n

      if (size(values) /= n) then
         call complain("'"//name//"' has "//to_text(size(values))//" entries, but "// &
            to_text(n)//" are needed")
      else if (.not. all(abs(values) <= huge(values))) then
         call complain("'"//name//"' has a number that is not finite, first in entry "// &
            to_text(first_bad(.not. abs(values) <= huge(values))))
      end if
   end subroutine check_length

   !> Indices from 1 to n
   subroutine check_range(name, indices, n)
      !> Path in the file
      character(len=*), intent(in) :: name
      !> Indices
      integer, intent(in) :: indices(:)
      !> Greatest index
      integer, intent(in) :: n
      integer :: at

      at = first_bad(indices < 1 .or. indices > n)
      if (at < 0) return
      call complain("'"//name//"' must hold indices from 0 to "//to_text(n - 1)//", but entry "// &
         to_text(at)//" is "//to_text(indices(at + 1) - 1))
   end subroutine check_range

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
   character(len=:), allocatable, intent(out) :: lines(:)
   character(len=1), parameter :: newline = achar(10)
   integer :: first, last, n

   n = 1 + count(transfer(text, newline, len(text)) == newline)
   allocate (character(len=len(text)) :: lines(n))
   n = 0
   first = 1
   do while (first <= len(text))
      last = index(text(first:)//newline, newline) + first - 2
      if (last >= first) then
         n = n + 1
         lines(n) = text(first:last)
      end if
      first = last + 2
   end do
   lines = lines(:n)
end subroutine split_lines

end module rk_model_file
