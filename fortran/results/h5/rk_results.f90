!> The result file: a time series of point fields, and what is needed to start again.
!>
!> /VTKHDF is an unstructured grid of one vertex cell per point, which ParaView (5.12 and later)
!> and PyVista show as a cloud. Geometry, label and fiber are stored once, every step appends its
!> fields; the offsets in /VTKHDF/Steps are the places. The time of a step is its load.
!> /MyoRK is ours: triangles of the surface and places of the points in a lattice, where there are
!> any; source points and, for every step, load, activation, coefficients, numbers of the step and
!> what it hands on to the next one (rk_restart); the deck with its overrides, the approximation,
!> and the version of the program.
!>
!> Reference: VTKHDF file format, version 2.0,
!> https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format
module rk_results
   use, intrinsic :: iso_fortran_env, only : int8
   use rk_error, only : err_input, error_type, fatal_error
   use rk_hdf5, only : h5_type
   use rk_point_field, only : point_field
   use rk_precision, only : i8, wp
   use rk_text, only : to_text
   implicit none
   private

   public :: results_type

   !> Number of VTK_VERTEX in VTK's list of cell types
   integer(int8), parameter :: vtk_vertex = 1_int8
   !> Groups of the file
   character(len=*), parameter :: vtk = "VTKHDF", own = "MyoRK"

   !> A result file being written
   type :: results_type
      private
      !> The file
      type(h5_type) :: file
      !> Number of points
      integer :: npoint = 0
      !> Number of coefficients, known from the first step on
      integer :: ncoefficient = 0
      !> Steps written so far
      integer :: nstep = 0
      !> Load of the last step
      real(wp) :: load = 0.0_wp
   contains
      procedure :: open => open_results, describe, add_lattice, add_step, close => close_results
      procedure :: publish
   end type results_type

contains

!> Start the file with everything that does not change
subroutine open_results(self, path, points, label, fiber, source, deck_text, version, error)
   class(results_type), intent(inout) :: self
   !> Name of the file once it is complete
   character(len=*), intent(in) :: path
   !> Undeformed collocation points, shape (3,np), z = 0 in plane problems [length]
   real(wp), intent(in), contiguous :: points(:, :)
   !> Label of each point, shape (np)
   integer, intent(in), contiguous :: label(:)
   !> Fiber directions, unit vectors or zero, shape (3,np) [-]
   real(wp), intent(in), contiguous :: fiber(:, :)
   !> Undeformed source points, shape (3,ns) [length]
   real(wp), intent(in), contiguous :: source(:, :)
   !> The deck as it was read
   character(len=*), intent(in) :: deck_text
   character(len=*), intent(in) :: version
   type(error_type), allocatable, intent(out) :: error

   self%npoint = size(label)
   self%ncoefficient = 0
   self%nstep = 0
   call check_shape("points", shape(points), [3, self%npoint], error)
   call check_shape("fiber", shape(fiber), [3, self%npoint], error)
   if (allocated(error)) return
   call self%file%create(path, error)
   if (allocated(error)) return
   call write_geometry(self%file, points, error)
   call self%file%append(vtk//"/PointData/label", label, error)
   call self%file%append(vtk//"/PointData/fiber", fiber, error)
   call self%file%append(own//"/source", source, error)
   call self%file%append_text(own//"/deck", deck_text, error)
   call self%file%put_attribute(own, "version", version, error)
end subroutine open_results

!> What the coefficients belong to, for runs that start from them
subroutine describe(self, overrides, approximation, error)
   class(results_type), intent(inout) :: self
   !> Overrides of the deck, each with its line feed
   character(len=*), intent(in) :: overrides
   !> Shape functions in words
   character(len=*), intent(in) :: approximation
   type(error_type), allocatable, intent(out) :: error

   ! no text is empty in the file
   call self%file%append_text(own//"/overrides", overrides//new_line('a'), error)
   call self%file%append_text(own//"/approximation", approximation, error)
end subroutine describe

!> How the points hang together; nothing is written of what is empty
subroutine add_lattice(self, place, triangle, error)
   class(results_type), intent(inout) :: self
   !> Place of each point in a lattice, shape (nd,np) or (nd,0)
   integer, intent(in), contiguous :: place(:, :)
   !> Points at the corners of the surface's triangles, or of those that fill a plane body, from 1,
   !> shape (3,nt)
   integer, intent(in), contiguous :: triangle(:, :)
   type(error_type), allocatable, intent(out) :: error

   if (size(place) > 0) call self%file%append(own//"/lattice", place, error)
   if (size(triangle) > 0) call self%file%append(own//"/surface", triangle - 1, error)
end subroutine add_lattice

!> The cloud as one part of an unstructured grid
subroutine write_geometry(file, points, error)
   type(h5_type), intent(inout) :: file
   !> Points, shape (3,np) [length]
   real(wp), intent(in), contiguous :: points(:, :)
   type(error_type), allocatable, intent(inout) :: error
   integer(i8) :: np, i

   np = size(points, 2, i8)
   call file%append(vtk//"/Points", points, error)
   call file%put_attribute(vtk, "Version", [2, 0], error)
   call file%put_attribute(vtk, "Type", "UnstructuredGrid", error)
   call file%append(vtk//"/NumberOfPoints", [np], error)
   call file%append(vtk//"/NumberOfCells", [np], error)
   call file%append(vtk//"/NumberOfConnectivityIds", [np], error)
   call file%append(vtk//"/Connectivity", [(i, i = 0, np - 1)], error)
   call file%append(vtk//"/Offsets", [(i, i = 0, np)], error)
   call file%append(vtk//"/Types", spread(vtk_vertex, 1, size(points, 2)), error)
end subroutine write_geometry

!> Append a converged state; the first one is the undeformed state
subroutine add_step(self, load, activation, fields, coefficients, error, step, carried)
   class(results_type), intent(inout) :: self
   !> Fraction of the full load, greater than that of the step before [-]
   real(wp), intent(in) :: load
   !> Activation of the muscle fibers [-]
   real(wp), intent(in) :: activation
   !> Fields at the points, the same in every step
   type(point_field), intent(in), target :: fields(:)
   !> Coefficients of the approximation, shape (ndof)
   real(wp), intent(in), contiguous :: coefficients(:)
   type(error_type), allocatable, intent(out) :: error
   !> Numbers of the step, as many as in every step
   real(wp), intent(in), contiguous, optional :: step(:)
   !> What it hands on, shape (ndof, columns)
   real(wp), intent(in), contiguous, optional :: carried(:, :)
   real(wp), pointer, contiguous :: flat(:)
   integer :: k

   call start_step(self, load, coefficients, error)
   if (allocated(error)) return
   if (present(step)) call self%file%append(own//"/step", reshape(step, [size(step), 1]), error)
   if (present(carried)) then
      ! a step whose successor begins with nothing but its state has no columns
      if (size(carried) > 0) call self%file%append(own//"/carried", carried, error)
   end if
   do k = 1, size(fields)
      associate (field => fields(k))
         call check_shape(field%name, shape(field%value), [size(field%value, 1), self%npoint], &
            error)
         if (allocated(error)) return
         if (size(field%value, 1) == 1) then
            ! one number a point has no axis of its own in the file
            flat(1:self%npoint) => fields(k)%value
            call self%file%append(vtk//"/PointData/"//field%name, flat, error)
         else
            call self%file%append(vtk//"/PointData/"//field%name, field%value, error)
         end if
      end associate
   end do
   call finish_step(self, load, activation, coefficients, fields, error)
end subroutine add_step

!> Refuse what cannot follow the steps before
subroutine start_step(self, load, coefficients, error)
   class(results_type), intent(inout) :: self
   !> Fraction of the full load [-]
   real(wp), intent(in) :: load
   real(wp), intent(in), contiguous :: coefficients(:)
   type(error_type), allocatable, intent(out) :: error

   if (self%nstep == 0) self%ncoefficient = size(coefficients)
   if (self%nstep > 0 .and. .not. load > self%load) then
      call fatal_error(error, err_input, "results: the load of a step must exceed that of the "// &
         "step before, but "//to_text(load)//" follows "//to_text(self%load))
      return
   end if
   call check_shape("coefficients", shape(coefficients), [self%ncoefficient], error)
end subroutine start_step

!> Write what stands beside the fields of a step
subroutine finish_step(self, load, activation, coefficients, fields, error)
   class(results_type), intent(inout) :: self
   real(wp), intent(in) :: load
   real(wp), intent(in) :: activation
   real(wp), intent(in), contiguous :: coefficients(:)
   !> Fields that were written
   type(point_field), intent(in) :: fields(:)
   type(error_type), allocatable, intent(inout) :: error

   call add_state(self%file, load, activation, coefficients, error)
   call add_offsets(self%file, load, int(self%nstep, i8)*self%npoint, fields, error)
   if (allocated(error)) return

   ! The number of steps comes last: a reader never sees half a step
   self%nstep = self%nstep + 1
   self%load = load
   call self%file%put_attribute(vtk//"/Steps", "NSteps", [self%nstep], error)
   call self%file%flush(error)
end subroutine finish_step

!> Complete the file and give it its name; after a failed write, or where it is to be left
!> unfinished, it keeps the name `path.part`
subroutine close_results(self, error, unfinished)
   class(results_type), intent(inout) :: self
   type(error_type), allocatable, intent(out) :: error
   !> Keep the temporary name
   logical, intent(in), optional :: unfinished

   call self%file%close(error, unfinished)
end subroutine close_results

!> Give a closed file its name
subroutine publish(self, error)
   class(results_type), intent(inout) :: self
   type(error_type), allocatable, intent(out) :: error

   call self%file%publish(error)
end subroutine publish

!> What a later run needs to go on from this step
subroutine add_state(file, load, activation, coefficients, error)
   type(h5_type), intent(inout) :: file
   real(wp), intent(in) :: load
   real(wp), intent(in) :: activation
   real(wp), intent(in), contiguous :: coefficients(:)
   type(error_type), allocatable, intent(inout) :: error

   call file%append(own//"/load", [load], error)
   call file%append(own//"/activation", [activation], error)
   call file%append(own//"/coefficients", reshape(coefficients, [size(coefficients), 1]), error)
end subroutine add_state

!> The row of /VTKHDF/Steps of a step: where the readers find what belongs to it
subroutine add_offsets(file, load, first, fields, error)
   type(h5_type), intent(inout) :: file
   !> Time of the step
   real(wp), intent(in) :: load
   !> Index, from 0, of the step's first value in every field
   integer(i8), intent(in) :: first
   type(point_field), intent(in) :: fields(:)
   type(error_type), allocatable, intent(inout) :: error
   character(len=*), parameter :: steps = vtk//"/Steps/"
   character(len=*), parameter :: fixed(*) = [character(len=22) :: "PartOffsets", &
      "PointOffsets", "CellOffsets", "ConnectivityIdOffsets", "PointDataOffsets/label", &
      "PointDataOffsets/fiber"]
   integer :: i

   call file%append(steps//"Values", [load], error)
   call file%append(steps//"NumberOfParts", [1_i8], error)
   do i = 1, size(fixed)
      call file%append(steps//trim(fixed(i)), [0_i8], error)
   end do
   do i = 1, size(fields)
      call file%append(steps//"PointDataOffsets/"//fields(i)%name, [first], error)
   end do
end subroutine add_offsets

!> An array must have the shape its file promises
subroutine check_shape(name, found, wanted, error)
   character(len=*), intent(in) :: name
   !> Shape it has
   integer, intent(in) :: found(:)
   !> Shape it must have
   integer, intent(in) :: wanted(:)
   type(error_type), allocatable, intent(inout) :: error

   if (allocated(error) .or. all(found == wanted)) return
   call fatal_error(error, err_input, "results: '"//name//"' has shape "// &
      to_text(real(found, wp))//", but "//to_text(real(wanted, wp))//" is needed")
end subroutine check_shape

end module rk_results
