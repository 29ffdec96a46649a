!> The result file: a time series of point fields, and the data needed for a restart.
!>
!> /VTKHDF is an unstructured grid of one vertex cell per point, which ParaView (5.12 and later)
!> and PyVista show as a cloud. Geometry, label and fiber are stored once, every step appends its
!> fields, at the offsets in /VTKHDF/Steps. The time of a step is its load. /MyoRK is the project's
!> own group: triangles of the surface and positions of the points in a lattice, if there are any;
!> source points and, for every step, load, activation and coefficients; the deck with its
!> overrides, the approximation, and the version of the program.
!>
!> Reference: VTKHDF file format, version 2.0,
!> https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format
module rk_results
   use, intrinsic :: iso_fortran_env, only : int8
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_error, only : err_input, error_type, fatal_error
   use rk_hdf5, only : as_bytes, h5_type
   use rk_point_field, only : point_field
   use rk_precision, only : i8, wp
   use rk_surface, only : lattice_places, surface_triangles
   implicit none
   private

   public :: results_type, restart_type, read_restart, to_space

   !> Number of VTK_VERTEX in VTK's list of cell types
   integer(int8), parameter :: vtk_vertex = 1_int8
   !> Groups of the file
   character(len=*), parameter :: vtk = "VTKHDF", own = "MyoRK"

   !> A result file being written
   type, extends(h5_type) :: results_type
      !> Number of steps written so far
      integer, private :: nstep = 0
   contains
      procedure :: open => open_results, add_step
   end type results_type

   !> Content of a result file from which a run may start
   type :: restart_type
      !> Approximation to which the coefficients belong
      character(len=:), allocatable :: approximation
      !> Source and collocation points, z = 0 in plane problems, shapes (3, ns), (3, np) [length]
      real(wp), allocatable :: source(:, :), points(:, :)
      !> Load of each state, the state at rest included, shape (states) [-]
      real(wp), allocatable :: load(:)
      !> Coefficients of each state, shape (ndof, states)
      real(wp), allocatable :: x(:, :)
   end type restart_type

contains

!> Start the file with everything that does not change
subroutine open_results(self, path, cloud, deck, approximation, version, error)
   class(results_type), intent(inout) :: self
   !> Final name of the file
   character(len=*), intent(in) :: path
   !> Undeformed points with their labels and fibers
   type(cloud_type), intent(in) :: cloud
   !> The deck as it was read, with its overrides
   type(deck_type), intent(in) :: deck
   !> Description of the shape functions to which the coefficients belong
   character(len=*), intent(in) :: approximation
   character(len=*), intent(in) :: version
   type(error_type), allocatable, intent(out) :: error
   integer, allocatable :: place(:, :), triangle(:, :)
   integer(i8) :: np, i

   self%nstep = 0
   call self%create(path, error)
   if (allocated(error)) return
   np = size(cloud%points, 2, i8)
   call self%append(vtk//"/Points", to_space(cloud%points), error)
   call self%put_attribute(vtk, "Version", [2, 0], error)
   call self%put_attribute(vtk, "Type", as_bytes("UnstructuredGrid"), error)
   call self%append(vtk//"/NumberOfPoints", [np], error)
   call self%append(vtk//"/NumberOfCells", [np], error)
   call self%append(vtk//"/NumberOfConnectivityIds", [np], error)
   call self%append(vtk//"/Connectivity", [(i, i = 0, np - 1)], error)
   call self%append(vtk//"/Offsets", [(i, i = 0, np)], error)
   call self%append(vtk//"/Types", spread(vtk_vertex, 1, int(np)), error)
   call self%append(vtk//"/PointData/label", cloud%label, error)
   call self%append(vtk//"/PointData/fiber", cloud%fiber, error)
   call self%append(own//"/source", to_space(cloud%source), error)
   call self%append(own//"/deck", as_bytes(deck%text), error)
   call self%put_attribute(own, "version", as_bytes(version), error)
   place = lattice_places(cloud)
   triangle = surface_triangles(place)
   if (size(place) > 0) call self%append(own//"/lattice", place, error)
   if (size(triangle) > 0) call self%append(own//"/surface", triangle - 1, error)
   ! texts in the file must not be empty
   call self%append(own//"/overrides", as_bytes(deck%overrides//new_line('a')), error)
   call self%append(own//"/approximation", as_bytes(approximation), error)
end subroutine open_results

!> Points with a third coordinate, z = 0 in plane problems
pure function to_space(x) result(y)
   !> Points, shape (nd, n) [length]
   real(wp), intent(in) :: x(:, :)
   real(wp) :: y(3, size(x, 2))

   y = 0.0_wp
   y(:size(x, 1), :) = x
end function to_space

!> Append a converged state; the first one is the undeformed state
subroutine add_step(self, load, activation, fields, coefficients, error)
   class(results_type), intent(inout) :: self
   !> Fraction of the full load, greater than that of the step before, the time of the step [-]
   real(wp), intent(in) :: load
   !> Activation of the muscle fibers [-]
   real(wp), intent(in) :: activation
   !> Fields at the points, the same fields in every step
   type(point_field), intent(in), target :: fields(:)
   !> Coefficients of the approximation, shape (ndof)
   real(wp), intent(in), contiguous :: coefficients(:)
   type(error_type), allocatable, intent(inout) :: error
   character(len=*), parameter :: steps = vtk//"/Steps/"
   character(len=*), parameter :: fixed(*) = [character(len=22) :: "PartOffsets", &
      "PointOffsets", "CellOffsets", "ConnectivityIdOffsets", "PointDataOffsets/label", &
      "PointDataOffsets/fiber"]
   real(wp), pointer, contiguous :: flat(:)
   integer :: k

   do k = 1, size(fields)
      associate (field => fields(k))
         if (size(field%value, 1) == 1) then
            ! a field with one component has no axis for it in the file
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
   ! the row of the step: readers look up its offsets here
   call self%append(steps//"Values", [load], error)
   call self%append(steps//"NumberOfParts", [1_i8], error)
   do k = 1, size(fixed)
      call self%append(steps//trim(fixed(k)), [0_i8], error)
   end do
   do k = 1, size(fields)
      call self%append(steps//"PointDataOffsets/"//fields(k)%name, &
         [int(self%nstep, i8)*size(fields(k)%value, 2)], error)
   end do
   if (allocated(error)) return

   ! The number of steps comes last: a reader never sees an incomplete step
   self%nstep = self%nstep + 1
   call self%put_attribute(vtk//"/Steps", "NSteps", [self%nstep], error)
   call self%flush(error)
end subroutine add_step

!> Read the whole file; incomplete states are left out
subroutine read_restart(self, path, error)
   type(restart_type), intent(out) :: self
   !> Result file, complete or not
   character(len=*), intent(in) :: path
   !> Error handling: missing file, damaged file, file of an earlier version
   type(error_type), allocatable, intent(out) :: error
   type(error_type), allocatable :: trouble
   type(h5_type) :: file
   integer :: states

   call file%open_read(path, error)
   if (allocated(error)) return
   if (.not. file%has(own//'/coefficients')) then
      call fatal_error(error, err_input, path//': contains no state to start from: it was ' &
         & //'written by an earlier version, or by another program')
   else
      call file%read(own//'/approximation', self%approximation, error)
      call file%read(own//'/source', self%source, error)
      call file%read('VTKHDF/Points', self%points, error)
      call file%read(own//'/load', self%load, error)
      call file%read(own//'/coefficients', self%x, error)
   end if
   call file%close(trouble)
   if (allocated(error)) return
   states = min(size(self%load), size(self%x, 2))
   self%load = self%load(:states)
   self%x = self%x(:, :states)
end subroutine read_restart

end module rk_results
