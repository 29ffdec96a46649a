!> Sets that move as rigid plates at the end of a tendon: a single spring along a direction.
!>
!> The displacement of a plate is an unknown. It forms a separate block after those of the source
!> points, and the prescribed values of its set are this unknown: they are lifted into the gradients
!> and enforced by the penalty like given values. Residual and tangent are still derivatives of one
!> energy, which includes that of the spring; the points of the set pull at the spring.
module rk_plates
   use rk_cells, only : cells_type
   use rk_csr, only : csr_type, lengthened
   use rk_precision, only : i8, wp
   use rk_programme, only : ramp
   use rk_scene, only : scene_type
   use rk_symmetric, only : symmetric_matrix
   implicit none
   private

   public :: plates_type, new_plates

   !> Plates of a scene
   type :: plates_type
      !> Number of plates
      integer :: count = 0
      !> Number of blocks before theirs
      integer, private :: before = 0
      !> Condition of each, shape (plates)
      integer, allocatable, private :: condition(:)
      !> Block whose unknown a component of a surface point follows, 0 where it follows none, shape
      !> (nd, ms)
      integer, allocatable :: follows(:, :)
   contains
      procedure :: motion, coupled, add_tendons
   end type plates_type

   !> Stiffness across the direction of a tendon, relative to the penalty of its whole set; with 1e6
   !> rounding errors keep the iteration from converging [-]
   real(wp), parameter :: guide = 1.0e4_wp

contains

subroutine new_plates(self, scene, cells, before)
   type(plates_type), intent(out) :: self
   type(scene_type), intent(in) :: scene
   type(cells_type), intent(in) :: cells
   !> Number of source points, after which the plates follow
   integer, intent(in) :: before
   integer :: c, i, k, nd, s

   nd = scene%cloud%nd
   self%before = before
   self%condition = pack([(c, c=1, size(scene%condition))], scene%condition%tendon > 0.0_wp)
   self%count = size(self%condition)
   allocate (self%follows(nd, size(cells%set)), source=0)
   do k = 1, self%count
      associate (mine => scene%condition(self%condition(k)))
         do i = 1, nd
            if (.not. abs(mine%direction(i)) > 0.0_wp) cycle
            do s = 1, size(cells%set)
               if (cells%in_set(s, mine%set)) self%follows(i, s) = before + k
            end do
         end do
      end associate
   end do
end subroutine new_plates

!> Displacement of a surface point with its plate, in the components that follow it [length]
pure function motion(self, s, x) result(u)
   class(plates_type), intent(in) :: self
   !> Surface point
   integer, intent(in) :: s
   !> Unknowns, shape (n) [length]
   real(wp), intent(in) :: x(:)
   real(wp) :: u(size(self%follows, 1))
   integer :: i

   u = 0.0_wp
   do i = 1, size(u)
      if (self%follows(i, s) > 0) u(i) = x(size(u)*(self%follows(i, s) - 1) + i)
   end do
end function motion

!> Source points that cover each surface point, and after them the plate that it follows
pure function coupled(self, neighbour) result(list)
   class(plates_type), intent(in) :: self
   !> Source points that cover each surface point
   type(csr_type), intent(in) :: neighbour
   type(csr_type) :: list
   integer :: plate(size(self%follows, 2)), s

   list = neighbour
   if (self%count == 0) return
   plate = maxval(self%follows, dim=1)
   list = lengthened(neighbour, csr_type([0_i8, (count(plate(:s) > 0, kind=i8), &
      & s=1, size(plate))], pack(plate, plate > 0)))
end function coupled

!> Add the stiffness of the tendons, and the forces of tendon ends that are moved
subroutine add_tendons(self, scene, cells, penalty, matrix, value, force)
   class(plates_type), intent(in) :: self
   type(scene_type), intent(in) :: scene
   type(cells_type), intent(in) :: cells
   !> Penalty times area of each, shape (ms) [force/length]
   real(wp), intent(in) :: penalty(:)
   !> Places of the entries
   type(symmetric_matrix), intent(in) :: matrix
   !> Entries, to which those of the tendons are added [force/length]
   real(wp), intent(inout) :: value(:)
   !> Forces of each load factor, to which those of the pulls are added, shape (n, factors) [force]
   real(wp), intent(inout) :: force(:, :)
   real(wp), allocatable :: part(:, :)
   real(wp) :: across, all
   integer :: i, k, nd, o, s

   nd = scene%cloud%nd
   allocate (part(nd, nd))
   do k = 1, self%count
      associate (mine => scene%condition(self%condition(k)), &
         & d => scene%condition(self%condition(k))%direction(:nd))
         all = sum(penalty, mask=[(cells%in_set(s, mine%set), s=1, size(penalty))])
         ! the tendon acts along it; motion across it and in unused components is constrained
         across = merge(guide*all, 0.0_wp, count(abs(d) > 0.0_wp) > 1)
         do i = 1, nd
            part(:, i) = (mine%tendon - across)*d*d(i)
            part(i, i) = part(i, i) + merge(across, all, abs(d(i)) > 0.0_wp)
         end do
         call matrix%add(value, [self%before + k], part)
         o = nd*(self%before + k - 1)
         associate (own => force(o + 1:o + nd, ramp + mine%amplitude))
            own = own + mine%tendon*mine%pull*d
         end associate
      end associate
   end do
end subroutine add_tendons

end module rk_plates
