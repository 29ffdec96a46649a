!> What a result file keeps beside its fields for a run that goes on from one of its states.
module rk_restart
   use rk_error, only : err_input, error_type, fatal_error
   use rk_hdf5, only : h5_type
   use rk_precision, only : wp
   implicit none
   private

   public :: restart_type, read_restart

   !> Group of the file
   character(len=*), parameter :: own = 'MyoRK/'

   !> Content of a result file that a run may start from
   type :: restart_type
      !> Deck, its overrides as lines, and the approximation to which the coefficients belong
      character(len=:), allocatable :: deck, overrides, approximation
      !> Source and collocation points, z = 0 in plane problems, shapes (3, ns), (3, np) [length]
      real(wp), allocatable :: source(:, :), points(:, :)
      !> Load of each state, the state at rest included, shape (states) [-]
      real(wp), allocatable :: load(:)
      !> Numbers of the step of each state, as the caller gave them, shape (numbers, states)
      real(wp), allocatable :: step(:, :)
      !> Coefficients of each state, shape (ndof, states)
      real(wp), allocatable :: x(:, :)
      !> What steps carried, as the caller gave it, shape (ndof, columns)
      real(wp), allocatable :: carried(:, :)
   end type restart_type

contains

!> Read all of it; states that were not written as a whole are left out
subroutine read_restart(self, path, error)
   type(restart_type), intent(out) :: self
   !> Result file, whole or unfinished
   character(len=*), intent(in) :: path
   !> Error handling: no such file, damaged, of an earlier version
   type(error_type), allocatable, intent(out) :: error
   type(error_type), allocatable :: trouble
   type(h5_type) :: file
   integer :: states

   call file%open_read(path, error)
   if (allocated(error)) return
   if (.not. file%has(own//'step')) then
      call fatal_error(error, err_input, path//': holds no state to start from: it was written ' &
         & //'by an earlier version, or by another program')
   else
      call file%read(own//'deck', self%deck, error)
      call file%read(own//'overrides', self%overrides, error)
      call file%read(own//'approximation', self%approximation, error)
      call file%read(own//'source', self%source, error)
      call file%read('VTKHDF/Points', self%points, error)
      call file%read(own//'load', self%load, error)
      call file%read(own//'step', self%step, error)
      call file%read(own//'coefficients', self%x, error)
      if (file%has(own//'carried')) call file%read(own//'carried', self%carried, error)
   end if
   call file%close(trouble)
   if (allocated(error)) return
   self%overrides = self%overrides(:len(self%overrides) - 1)
   if (.not. allocated(self%carried)) allocate (self%carried(size(self%x, 1), 0))
   states = min(size(self%load), size(self%step, 2), size(self%x, 2))
   self%load = self%load(:states)
   self%step = self%step(:, :states)
   self%x = self%x(:, :states)
end subroutine read_restart

end module rk_restart
