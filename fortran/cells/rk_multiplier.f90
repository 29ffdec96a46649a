!> Pressures of incompressible groups of points, which no change of volume determines: additional
!> unknowns.
!>
!> With K finite the pressure of a group follows from its projected volume and never appears as an
!> unknown. Where all points of a group have K = infinity, the coefficients of its pressure are
!> stored after the displacements, in blocks as large as those of the source points, and their rows
!> are the projected changes of volume: the tangent is a saddle. Both are scaled to lengths and
!> forces by the shear modulus, like displacements.
module rk_multiplier
   use rk_cells, only : cells_type
   use rk_csr, only : csr_type, lengthened
   use rk_precision, only : i8, wp
   implicit none
   private

   public :: multiplier_type, new_multiplier

   !> Number of blocks for the 1 + nd coefficients of a group; unused entries are zero
   integer, parameter :: blocks = 2

   !> Layout of the pressure unknowns
   type :: multiplier_type
      !> Space dimension, the number of unknowns in a block
      integer, private :: nd = 0
      !> Number of blocks after those of the source points
      integer :: extra = 0
      !> Whether the pressure of each group is an unknown, shape (groups)
      logical, allocatable :: free(:)
      !> Unit of the pressure's coefficients, shape (groups) [stress length^(nd/2-1)]
      real(wp), allocatable :: scale(:)
      !> Stiffness of unused entries, shape (groups) [force/length]
      real(wp), allocatable, private :: idle(:)
      !> Norm of the unknowns if every pressure equals the shear modulus [length]
      real(wp) :: extent = 0.0_wp
   contains
      procedure :: pressure, set_rows, set_stiffness, set_idle, from_rows, to_unknowns
   end type multiplier_type

contains

!> Find the groups
subroutine new_multiplier(self, cells, bulk, shear, ns, member)
   type(multiplier_type), intent(out) :: self
   type(cells_type), intent(in) :: cells
   !> Bulk modulus of each group, shape (groups) [stress]
   real(wp), intent(in) :: bulk(:)
   !> Shear modulus at each point, shape (np) [stress]
   real(wp), intent(in) :: shear(:)
   !> Number of source points
   integer, intent(in) :: ns
   !> Source points of each group, ascending; on return followed by the blocks of its pressure
   type(csr_type), intent(inout) :: member
   real(wp) :: modulus, volume
   integer :: g, nd

   nd = size(cells%point, 1)
   self%nd = nd
   self%free = bulk > huge(1.0_wp)
   self%extra = blocks*count(self%free)
   allocate (self%scale(size(bulk)), self%idle(size(bulk)))
   do g = 1, size(bulk)
      associate (first => cells%first(g) + 1, last => cells%first(g + 1))
         volume = sum(cells%weight(first:last))
         modulus = dot_product(cells%weight(first:last), shear(first:last))/volume
         self%scale(g) = modulus*volume**(0.5_wp - 1.0_wp/nd)
         self%idle(g) = modulus*volume**(1.0_wp - 2.0_wp/nd)
         ! a constant pressure equal to the shear modulus has the coefficient modulus volume^(1/2)
         if (self%free(g)) self%extent = self%extent + volume**(2.0_wp/nd)
      end associate
   end do
   self%extent = sqrt(self%extent)
   if (self%extra > 0) member = lengthened(member, csr_type([0_i8, (int(blocks, i8) &
      & *count(self%free(:g)), g=1, size(bulk))], [(ns + g, g=1, self%extra)]))
end subroutine new_multiplier

!> Coefficients of the pressure of a group whose pressure is an unknown
pure function pressure(self, g, local) result(value)
   class(multiplier_type), intent(in) :: self
   !> Group
   integer, intent(in) :: g
   !> Unknowns of its source points and blocks, shape (nd, members) [length]
   real(wp), intent(in) :: local(:, :)
   !> Coefficients [stress length^(nd/2)]
   real(wp) :: value(1 + size(local, 1))
   real(wp) :: tail(size(local, 1)*blocks)

   tail = reshape(local(:, size(local, 2) - blocks + 1:), [size(tail)])
   value = self%scale(g)*tail(:size(value))
end function pressure

!> Forces on the blocks of a group: the change of its volume
pure subroutine set_rows(self, g, volume, force)
   class(multiplier_type), intent(in) :: self
   !> Group, whose pressure is an unknown
   integer, intent(in) :: g
   !> Change of volume by polynomial, shape (count) [length^(nd/2)]
   real(wp), intent(in) :: volume(:)
   !> Forces on its source points and blocks; those on blocks are set, shape (nd, members) [force]
   real(wp), intent(inout) :: force(:, :)
   real(wp) :: tail(size(force, 1)*blocks)

   tail = 0.0_wp
   tail(:size(volume)) = self%scale(g)*volume
   force(:, size(force, 2) - blocks + 1:) = reshape(tail, [size(force, 1), blocks])
end subroutine set_rows

!> Stiffness of the blocks of a group: the derivatives of the change of its volume
pure subroutine set_stiffness(self, g, volume, part)
   class(multiplier_type), intent(in) :: self
   integer, intent(in) :: g
   !> Derivatives of the change of volume, shape (nd*members, count)
   real(wp), intent(in) :: volume(:, :)
   !> Upper triangle of the stiffness, shape (nd*members, nd*members) [force/length]
   real(wp), intent(inout) :: part(:, :)
   integer :: b, o

   b = size(volume, 2)
   o = size(part, 1) - blocks*self%nd
   part(:o, o + 1:o + b) = self%scale(g)*volume(:o, :)
   call self%set_idle(g, b, part)
end subroutine set_stiffness

!> Stiffness of the unknowns of the blocks of a group that are not used
pure subroutine set_idle(self, g, b, part)
   class(multiplier_type), intent(in) :: self
   integer, intent(in) :: g
   !> Number of unknowns that are used
   integer, intent(in) :: b
   !> Upper triangle of the stiffness, shape (nd*members, nd*members) [force/length]
   real(wp), intent(inout) :: part(:, :)
   integer :: k

   do k = size(part, 1) - blocks*self%nd + b + 1, size(part, 1)
      part(k, k) = self%idle(g)
   end do
end subroutine set_idle

!> Prescribed changes of volume from the right-hand sides of the blocks; zero for other groups
pure subroutine from_rows(self, rows, volume)
   class(multiplier_type), intent(in) :: self
   !> Right-hand sides, shape (nd*extra) [force]
   real(wp), intent(in) :: rows(:)
   !> Changes of volume by polynomial, shape (1 + nd, groups) [length^(nd/2)]
   real(wp), intent(out) :: volume(:, :)
   integer :: g, o

   volume = 0.0_wp
   o = 0
   do g = 1, size(volume, 2)
      if (.not. self%free(g)) cycle
      volume(:, g) = rows(o + 1:o + size(volume, 1))/self%scale(g)
      o = o + blocks*self%nd
   end do
end subroutine from_rows

!> Unknowns of the blocks from the coefficients of the pressures
pure subroutine to_unknowns(self, pressure, x)
   class(multiplier_type), intent(in) :: self
   !> Coefficients, shape (1 + nd, groups) [stress length^(nd/2)]
   real(wp), intent(in) :: pressure(:, :)
   !> Unknowns, shape (nd*extra) [length]
   real(wp), intent(inout) :: x(:)
   integer :: g, o

   x = 0.0_wp
   o = 0
   do g = 1, size(pressure, 2)
      if (.not. self%free(g)) cycle
      x(o + 1:o + size(pressure, 1)) = pressure(:, g)/self%scale(g)
      o = o + blocks*self%nd
   end do
end subroutine to_unknowns

end module rk_multiplier
