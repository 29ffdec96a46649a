!> Deformation gradient at any place, recovered from those smoothed over nodal cells.
!>
!> Smoothed gradients do not see displacements that alternate from one source point to the next,
!> and these meet little resistance where the body is stiff compared with its stabilisation. Their
!> derivatives between the source points are as large as the strains. The gradients of the cells,
!> which are those in the equilibrium, are interpolated instead, as values at the centres of the
!> cells: linear fields are exact up to the surface.
!>
!> Reference: Chen, Wu, Yoon, You, Int. J. Numer. Meth. Engng 50 (2001),
!>            doi:10.1002/1097-0207(20010120)50:2<435::AID-NME32>3.0.CO;2-A
module rk_recovery
   use rk_cells, only : cells_type
   use rk_error, only : error_type
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   use rk_shape, only : new_shape, shape_type
   use rk_tensor, only : identity
   implicit none
   private

   public :: recovery_type, new_recovery

   !> Shape functions of the cells' centres
   type :: recovery_type
      !> Places where they are known: collocation points, then probes, shape (nd, n) [length]
      real(wp), allocatable :: place(:, :)
      !> Number of collocation points
      integer :: points = 0
      !> Shape functions there
      type(shape_type) :: shape
   contains
      procedure :: at => gradient_at, row
   end type recovery_type

contains

!> Set up the shape functions
subroutine new_recovery(self, scene, cells, error)
   type(recovery_type), intent(out) :: self
   type(scene_type), intent(in) :: scene
   type(cells_type), intent(in) :: cells
   !> Error handling: a place that too few cells cover
   type(error_type), allocatable, intent(out) :: error
   integer, allocatable :: one(:)
   logical :: first(size(cells%node)), seen(size(scene%support, 2))
   integer :: i, n

   associate (cloud => scene%cloud)
      self%points = size(cloud%points, 2)
      n = self%points
      allocate (self%place(cloud%nd, n + size(scene%probe)))
      self%place(:, :n) = cloud%points
      do i = 1, size(scene%probe)
         if (.not. scene%probe(i)%at_a_place()) cycle
         n = n + 1
         self%place(:, n) = scene%probe(i)%point(:cloud%nd)
      end do
      self%place = self%place(:, :n)
   end associate
   ! one point of a cell that is in several groups
   seen = .false.
   do i = 1, size(cells%node)
      first(i) = .not. seen(cells%node(i))
      seen(cells%node(i)) = .true.
   end do
   one = pack([(i, i=1, size(first))], first)
   call new_shape(self%shape, scene%approximation, cells%point(:, one), &
      & scene%support(:, cells%node(one)), self%place, error)
   if (allocated(error)) then
      error%message = 'stress at '//error%message
      return
   end if
   self%shape%neighbour%index = one(self%shape%neighbour%index)
end subroutine new_recovery

!> Deformation gradient at a collocation point or a probe
function gradient_at(self, ip, x, cell) result(f)
   class(recovery_type), target, intent(in) :: self
   !> Collocation point nearest to the place
   integer, intent(in) :: ip
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Deformation gradients of the cells, shape (3, 3, np) [-]
   real(wp), intent(in) :: cell(:, :, :)
   real(wp) :: f(3, 3)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer :: i

   ! the weights sum to one up to rounding
   f = identity
   call self%row(ip, x, nodes, values)
   do i = 1, size(nodes)
      f = f + values(1, i)*(cell(:, :, nodes(i)) - identity)
   end do
end function gradient_at

!> Cells whose gradients give that at a collocation point or a probe, with their weights
subroutine row(self, ip, x, nodes, values)
   class(recovery_type), target, intent(in) :: self
   integer, intent(in) :: ip
   real(wp), intent(in) :: x(:)
   !> Cells, shape (n)
   integer, pointer, contiguous, intent(out) :: nodes(:)
   !> Their weights, the first row, shape (nq, n) [-]
   real(wp), pointer, contiguous, intent(out) :: values(:, :)
   integer :: at, i

   at = ip
   if (any(abs(x - self%place(:, ip)) > 0.0_wp)) then
      do i = self%points + 1, size(self%place, 2)
         if (all(.not. abs(x - self%place(:, i)) > 0.0_wp)) at = i
      end do
   end if
   call self%shape%row(at, nodes, values)
end subroutine row

end module rk_recovery
