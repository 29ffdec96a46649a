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
   use rk_hdf5, only : as_bytes, h5_type
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
   type, extends(h5_type) :: results_type
      !> Number of points
      integer, private :: npoint = 0
      !> Number of coefficients, known from the first step on
      integer, private :: ncoefficient = 0
      !> Steps written so far
      integer, private :: nstep = 0
      !> Load of the last step
      real(wp), private :: load = 0.0_wp
   contains
      procedure :: open => open_results, add_step
   end type results_type

contains

!> Start the file with everything that does not change
subroutine open_results(self, path, points, label, fiber, source, place, triangle, deck_text, &
   overrides, approximation, version, error)
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
   !> Place of each point in a lattice, shape (nd,np) or (nd,0)
   integer, intent(in), contiguous :: place(:, :)
   !> Points at the corners of the surface's triangles, or of those that fill a plane body, from 1,
   !> shape (3,nt), nt possibly 0
   integer, intent(in), contiguous :: triangle(:, :)
   !> The deck as it was read, its overrides, each with its line feed, and the shape functions in
   !> words, to which the coefficients belong
   character(len=*), intent(in) :: deck_text, overrides, approximation
   character(len=*), intent(in) :: version
   type(error_type), allocatable, intent(out) :: error
   integer(i8) :: np, i

   self%npoint = size(label)
   self%ncoefficient = 0
   self%nstep = 0
   call check_shape("points", shape(points), [3, self%npoint], error)
   call check_shape("fiber", shape(fiber), [3, self%npoint], error)
   if (allocated(error)) return
   call self%create(path, error)
   if (allocated(error)) return
   np = size(points, 2, i8)
   call self%append(vtk//"/Points", points, error)
   call self%put_attribute(vtk, "Version", [2, 0], error)
   call self%put_attribute(vtk, "Type", as_bytes("UnstructuredGrid"), error)
   call self%append(vtk//"/NumberOfPoints", [np], error)
   call self%append(vtk//"/NumberOfCells", [np], error)
   call self%append(vtk//"/NumberOfConnectivityIds", [np], error)
   call self%append(vtk//"/Connectivity", [(i, i = 0, np - 1)], error)
   call self%append(vtk//"/Offsets", [(i, i = 0, np)], error)
   call self%append(vtk//"/Types", spread(vtk_vertex, 1, size(points, 2)), error)
   call self%append(vtk//"/PointData/label", label, error)
   call self%append(vtk//"/PointData/fiber", fiber, error)
   call self%append(own//"/source", source, error)
   call self%append(own//"/deck", as_bytes(deck_text), error)
   call self%put_attribute(own, "version", as_bytes(version), error)
   if (size(place) > 0) call self%append(own//"/lattice", place, error)
   if (size(triangle) > 0) call self%append(own//"/surface", triangle - 1, error)
   ! no text is empty in the file
   call self%append(own//"/overrides", as_bytes(overrides//new_line('a')), error)
   call self%append(own//"/approximation", as_bytes(approximation), error)
end subroutine open_results

!> Append a converged state; the first one is the undeformed state
subroutine add_step(self, load, activation, fields, coefficients, step, carried, error)
   class(results_type), intent(inout) :: self
   !> Fraction of the full load, greater than that of the step before, the time of the step [-]
   real(wp), intent(in) :: load
   !> Activation of the muscle fibers [-]
   real(wp), intent(in) :: activation
   !> Fields at the points, the same in every step
   type(point_field), intent(in), target :: fields(:)
   !> Coefficients of the approximation, shape (ndof)
   real(wp), intent(in), contiguous :: coefficients(:)
   !> Numbers of the step, as many as in every step
   real(wp), intent(in), contiguous :: step(:)
   !> What it hands on, shape (ndof, columns); a step whose successor begins with nothing but its
   !> state has no columns
   real(wp), intent(in), contiguous :: carried(:, :)
   type(error_type), allocatable, intent(out) :: error
   character(len=*), parameter :: steps = vtk//"/Steps/"
   character(len=*), parameter :: fixed(*) = [character(len=22) :: "PartOffsets", &
      "PointOffsets", "CellOffsets", "ConnectivityIdOffsets", "PointDataOffsets/label", &
      "PointDataOffsets/fiber"]
   real(wp), pointer, contiguous :: flat(:)
   integer :: k

   if (self%nstep == 0) self%ncoefficient = size(coefficients)
   if (self%nstep > 0 .and. .not. load > self%load) then
      call fatal_error(error, err_input, "results: the load of a step must exceed that of the "// &
         "step before, but "//to_text(load)//" follows "//to_text(self%load))
      return
   end if
   call check_shape("coefficients", shape(coefficients), [self%ncoefficient], error)
   call self%append(own//"/step", reshape(step, [size(step), 1]), error)
   if (size(carried) > 0) call self%append(own//"/carried", carried, error)
   do k = 1, size(fields)
      associate (field => fields(k))
         call check_shape(field%name, shape(field%value), [size(field%value, 1), self%npoint], &
            error)
         if (size(field%value, 1) == 1) then
            ! one number a point has no axis of its own in the file
            flat(1:size(field%value)) => fields(k)%value
            call self%append(vtk//"/PointData/"//field%name, flat, error)
         else
            call self%append(vtk//"/PointData/"//field%name, field%value, error)
         end if
      end associate
   end do
   call self%append(own//"/load", [load], error)
   call self%append(own//"/activation", [activation], error)
   call self%append(own//"/coefficients", reshape(coefficients, [size(coefficients), 1]), error)
   ! the row of the step: where readers find what belongs to it
   call self%append(steps//"Values", [load], error)
   call self%append(steps//"NumberOfParts", [1_i8], error)
   do k = 1, size(fixed)
      call self%append(steps//trim(fixed(k)), [0_i8], error)
   end do
   do k = 1, size(fields)
      call self%append(steps//"PointDataOffsets/"//fields(k)%name, &
         [int(self%nstep, i8)*self%npoint], error)
   end do
   if (allocated(error)) return

   ! The number of steps comes last: a reader never sees half a step
   self%nstep = self%nstep + 1
   self%load = load
   call self%put_attribute(vtk//"/Steps", "NSteps", [self%nstep], error)
   call self%flush(error)
end subroutine add_step

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
