!> Result files and model files, and what happens when they cannot be written or read.
program test_h5
   use rk_cloud, only : cloud_type
   use rk_error, only : err_file, err_input, error_type
   use rk_hdf5, only : h5_type
   use rk_model_file, only : read_model
   use rk_point_field, only : point_field
   use rk_precision, only : wp
   use rk_results, only : results_type
   use tap, only : check, finish
   implicit none

   type(error_type), allocatable :: error

   call test_round_trip
   call test_old_file_stays
   call test_refused_paths
   call test_refused_steps
   call test_foreign_model
   call finish()

contains

!> Three points in a plane of the (x,y,z) space; the numbers tell where they belong
subroutine write_sample(path, nstep, error)
   !> Name of the result file
   character(len=*), intent(in) :: path
   !> Number of steps, the undeformed one included
   integer, intent(in) :: nstep
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   type(results_type) :: res
   type(error_type), allocatable :: ignored
   real(wp), parameter :: points(3, 3) = reshape([0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, &
      0.0_wp, 0.0_wp, 2.0_wp, 3.0_wp], [3, 3])
   real(wp), parameter :: fiber(3, 3) = reshape([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.6_wp, &
      0.8_wp, 0.0_wp, 0.0_wp, 0.0_wp], [3, 3])
   integer :: i

   call res%open(path, points, [1, 1, 2], fiber, points(:, :2), 'title = "sample"'//achar(10), &
      "0.1.0", error)
   if (allocated(error)) return
   do i = 0, nstep - 1
      call add_sheared(res, points, real(i, wp)/3.0_wp, 0.1_wp*i, error)
      if (allocated(error)) exit
   end do
   if (allocated(error)) then
      call res%close(ignored)
   else
      call res%close(error)
   end if
end subroutine write_sample

!> Simple shear u_x = gamma y, u_z = 2 gamma y with gamma = load: F differs from its transpose
subroutine add_sheared(res, points, load, activation, error)
   !> Result file
   type(results_type), intent(inout) :: res
   !> Points, shape (3,np)
   real(wp), intent(in) :: points(:, :)
   !> Load and amount of shear
   real(wp), intent(in) :: load
   !> Activation
   real(wp), intent(in) :: activation
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   type(point_field) :: fields(6)
   real(wp) :: f(3, 3)
   integer :: ip, np

   np = size(points, 2)
   fields = [zeros('u', 3, np), zeros('F', 9, np), zeros('J', 1, np), zeros('cauchy', 6, np), &
      zeros('principal_stress', 3, np), zeros('pressure', 1, np)]
   f = reshape([1.0_wp, 0.0_wp, 0.0_wp, load, 1.0_wp, 2.0_wp*load, 0.0_wp, 0.0_wp, 1.0_wp], [3, 3])
   do ip = 1, np
      fields(1)%value(:, ip) = matmul(f, points(:, ip)) - points(:, ip)
      fields(2)%value(:, ip) = reshape(transpose(f), [9])
      fields(3)%value(:, ip) = 1.0_wp + 0.01_wp*(ip - 1)
      fields(4)%value(:, ip) = load*[1.0_wp, 2.0_wp, 3.0_wp, 4.0_wp, 5.0_wp, 6.0_wp] + ip - 1
      fields(5)%value(:, ip) = load*[3.0_wp, 2.0_wp, 1.0_wp] + ip - 1
      fields(6)%value(:, ip) = -load - ip + 1
   end do
   call res%add_step(load, activation, fields, &
      [load, 2.0_wp*load, 3.0_wp*load, 4.0_wp*load], error)
end subroutine add_sheared

!> A field without values
type(point_field) function zeros(name, components, np)
   !> Name
   character(len=*), intent(in) :: name
   !> Components and points
   integer, intent(in) :: components, np

   zeros%name = name
   allocate (zeros%value(components, np), source=0.0_wp)
end function zeros

!> What was written is read back, the steps one behind the other
subroutine test_round_trip
   type(h5_type) :: file
   real(wp), allocatable :: table(:, :), list(:)
   integer, allocatable :: label(:)
   character(len=:), allocatable :: text
   real(wp), parameter :: third = 1.0_wp/3.0_wp

   call write_sample("round_trip.vtkhdf", 4, error)
   call check("sample is written", .not. allocated(error))
   call file%open_read("round_trip.vtkhdf", error)
   call check("sample is opened", .not. allocated(error))
   call file%read("VTKHDF/Points", table, error)
   call check("geometry is stored once", all(shape(table) == [3, 3]))
   call file%read("VTKHDF/PointData/F", table, error)
   call check("a step is appended to the one before", all(shape(table) == [9, 12]))
   ! Row by row: xx, xy = load, xz, yx, yy, yz, zx, zy = 2 load, zz
   call check("tensors are stored by rows", all(abs(table(:, 4) - [1.0_wp, third, 0.0_wp, 0.0_wp, &
      1.0_wp, 0.0_wp, 0.0_wp, 2*third, 1.0_wp]) <= epsilon(1.0_wp)))
   call file%read("VTKHDF/PointData/J", list, error)
   call check("scalars are lists", size(list) == 12)
   call file%read("VTKHDF/PointData/label", label, error)
   call check("integers come back", all(label == [1, 1, 2]))
   call file%read("MyoRK/coefficients", table, error)
   call check("coefficients have a row a step", all(shape(table) == [4, 4]))
   call file%read("MyoRK/deck", text, error)
   call check("text comes back", text == 'title = "sample"'//achar(10))
   call file%get_attribute("MyoRK", "version", text, error)
   call check("attribute comes back", text == "0.1.0")
   call file%read("MyoRK/deck", table, error)
   call check_error("wrong number of dimensions", err_input, "round_trip.vtkhdf: 'MyoRK/deck' has")
   call file%read("MyoRK/nothing/here", list, error)
   call check_error("missing dataset", err_input, "'MyoRK/nothing/here' is missing")
   call file%close(error)
end subroutine test_round_trip

!> Until it is complete, a new file does not touch the one before
subroutine test_old_file_stays
   type(results_type) :: res
   logical :: old, part

   call write_sample("old.vtkhdf", 4, error)
   call res%open("old.vtkhdf", reshape([0.0_wp, 0.0_wp, 0.0_wp], [3, 1]), [7], &
      reshape([1.0_wp, 0.0_wp, 0.0_wp], [3, 1]), reshape([0.0_wp, 0.0_wp, 0.0_wp], [3, 1]), &
      "", "0.1.0", error)
   call add_sheared(res, reshape([0.0_wp, 0.0_wp, 0.0_wp], [3, 1]), 0.5_wp, 0.0_wp, error)
   call check("new file is being written", .not. allocated(error))
   inquire (file="old.vtkhdf.part", exist=part)
   call check("under a temporary name", part)
   call check("old file is as it was", points_in("old.vtkhdf") == 3)
   call res%close(error)
   call check("new file takes its place", points_in("old.vtkhdf") == 1)
   inquire (file="old.vtkhdf.part", exist=part)
   inquire (file="old.vtkhdf", exist=old)
   call check("nothing else is left", old .and. .not. part)
   call res%close(error)
   call check("closing twice is harmless", .not. allocated(error))
end subroutine test_old_file_stays

!> Number of points of a result file, -1 if it cannot be read
integer function points_in(path)
   !> Name of the file
   character(len=*), intent(in) :: path
   type(h5_type) :: file
   real(wp), allocatable :: points(:, :)

   points_in = -1
   call file%open_read(path, error)
   if (allocated(error)) return
   call file%read("VTKHDF/Points", points, error)
   if (.not. allocated(error)) points_in = size(points, 2)
   call file%close(error)
end function points_in

!> Places where no file can be written or none is found
subroutine test_refused_paths
   type(h5_type) :: file

   call write_sample("no/such/folder/results.vtkhdf", 1, error)
   call check_error("missing folder", err_file, "no/such/folder/results.vtkhdf.part: cannot be "// &
      "created: No such file or directory")
   call write_sample(".", 1, error)
   call check_error("folder in the way", err_file, ".: cannot be written: it is a folder")
   call file%open_read("nowhere.h5", error)
   call check_error("missing file", err_file, "nowhere.h5: cannot be opened: No such file")
end subroutine test_refused_paths

!> Steps that do not fit to the file
subroutine test_refused_steps
   type(results_type) :: res
   real(wp), parameter :: origin(3, 1) = 0.0_wp

   call res%open("refused.vtkhdf", origin, [1], origin, origin, "", "0.1.0", error)
   call add_sheared(res, reshape(spread(0.0_wp, 1, 6), [3, 2]), 0.0_wp, 0.0_wp, error)
   call check_error("wrong number of points", err_input, "'u' has shape (3, 2), but (3, 1)")
   call add_sheared(res, origin, 0.5_wp, 0.0_wp, error)
   call check("good step", .not. allocated(error))
   call add_sheared(res, origin, 0.5_wp, 0.0_wp, error)
   call check_error("load does not grow", err_input, "but 0.5 follows 0.5")
   call res%close(error)
   call res%open("refused.vtkhdf", origin, [1, 2], origin, origin, "", "0.1.0", error)
   call check_error("labels without points", err_input, "'points' has shape (3, 1), but (3, 2)")
end subroutine test_refused_steps

!> A file that is not a model
subroutine test_foreign_model
   type(cloud_type) :: model

   call write_sample("foreign.h5", 1, error)
   call read_model(model, "foreign.h5", error)
   call check_error("not a model", err_input, "foreign.h5: not a model written by 'myork build'")
   call read_model(model, "nowhere.h5", error)
   call check_error("missing model", err_file, "nowhere.h5: cannot be opened")
end subroutine test_foreign_model

!> The last call must have failed in this way
subroutine check_error(name, code, part)
   !> What is tested
   character(len=*), intent(in) :: name
   !> Kind of error
   integer, intent(in) :: code
   !> Part of the message
   character(len=*), intent(in) :: part

   if (.not. allocated(error)) then
      call check(name//": an error", .false.)
   else
      call check(name, error%code == code .and. index(error%message, part) > 0)
   end if
end subroutine check_error

end program test_h5
