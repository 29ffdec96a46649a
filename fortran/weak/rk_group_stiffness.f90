!> Matrix-free stiffness of groups of points: moduli and cofactors at the points, the bulk modulus
!> on the projected change of volume, and products with them.
!>
!> Pressures may be unknowns beside the displacements. A part k of the bulk modulus K then stays
!> with the displacements (rk_tangent), and the pressures are those of the rest.
module rk_group_stiffness
   use rk_cells, only : cells_type
   use rk_csr, only : csr_type
   use rk_gradient, only : gradient_type
   use rk_multiplier, only : multiplier_type
   use rk_precision, only : i8, wp
   use rk_pressure, only : pressure_type
   implicit none
   private

   public :: group_stiffness, new_group_stiffness, add_forces

   !> Linearisation of all groups
   type :: group_stiffness
      !> Of each point: moduli C4(i, A, j, B) and cofactors, both times weight, shapes
      !> (3, 3, 3, 3, np) and (3, 3, np)
      real(wp), allocatable :: moduli(:, :, :, :, :)
      real(wp), allocatable :: cofactor(:, :, :)
      !> Bulk and shear modulus of each group, shape (groups) [stress]
      real(wp), allocatable :: bulk(:)
      real(wp), allocatable, private :: shear(:)
      !> Groups that contain each source point, and its position in the lists of all groups
      type(csr_type), private :: groups
      integer(i8), allocatable, private :: entry(:)
      !> Points, gradients and pressures of the problem
      type(cells_type), pointer :: cells => null()
      type(gradient_type), pointer :: gradient => null()
      type(pressure_type), pointer :: pressure => null()
      type(multiplier_type), pointer :: multiplier => null()
   contains
      procedure :: attach, add_product, split, join, kept, beside
   end type group_stiffness

   !> Part of the bulk modulus that stays with the displacements, in shear moduli; never more than
   !> half of it
   real(wp), parameter :: stays = 2.0_wp

contains

!> Allocate the linearisation
subroutine new_group_stiffness(self, cells, shear)
   type(group_stiffness), intent(inout) :: self
   type(cells_type), intent(in) :: cells
   !> Shear modulus at each point, shape (np) [stress]
   real(wp), intent(in) :: shear(:)
   integer :: g

   allocate (self%moduli(3, 3, 3, 3, size(shear)), self%cofactor(3, 3, size(shear)))
   allocate (self%bulk(size(cells%first) - 1), self%shear(size(cells%first) - 1))
   do g = 1, size(self%shear)
      associate (first => cells%first(g) + 1, last => cells%first(g + 1))
         self%shear(g) = dot_product(cells%weight(first:last), shear(first:last)) &
            & /sum(cells%weight(first:last))
      end associate
   end do
end subroutine new_group_stiffness

!> Point to the cells, gradients and pressures of the stiffness
subroutine attach(self, cells, gradient, pressure, multiplier)
   class(group_stiffness), intent(inout) :: self
   type(cells_type), target, intent(in) :: cells
   type(gradient_type), target, intent(in) :: gradient
   type(pressure_type), target, intent(in) :: pressure
   type(multiplier_type), target, intent(in) :: multiplier

   self%cells => cells
   self%gradient => gradient
   self%pressure => pressure
   self%multiplier => multiplier
   if (allocated(self%bulk) .and. .not. allocated(self%entry)) &
      & call gradient%member%transposed(maxval(gradient%member%index), self%groups, self%entry)
end subroutine attach

!> Split a right hand side into those of displacements and pressures
subroutine split(self, n, b, right)
   class(group_stiffness), intent(in) :: self
   !> Number of unknowns that are displacements
   integer, intent(in) :: n
   !> Right hand side of the unknowns
   real(wp), contiguous, intent(in) :: b(:)
   !> That of displacements and pressures
   real(wp), allocatable, intent(out) :: right(:)
   real(wp), allocatable :: volume(:, :), pressure(:, :)
   integer :: g

   allocate (right(n + size(self%pressure%total)), source=0.0_wp)
   right(:n) = b(:n)
   if (self%multiplier%extra == 0) return
   allocate (pressure, volume, mold=self%pressure%total)
   call self%multiplier%from_rows(b(n + 1:), pressure)
   right(n + 1:) = reshape(pressure, [size(pressure)])
   ! the part of K that is kept with the displacements acts on the prescribed volume as well
   do g = 1, size(self%bulk)
      pressure(:, g) = self%kept(g)*pressure(:, g)
   end do
   call self%add_product(0.0_wp*right(:n), right(:n), volume, pressure)
end subroutine split

!> Unknowns from displacements and pressures
subroutine join(self, n, both, x)
   class(group_stiffness), intent(in) :: self
   integer, intent(in) :: n
   !> Displacements and pressures
   real(wp), contiguous, intent(in) :: both(:)
   !> Unknowns
   real(wp), contiguous, intent(inout) :: x(:)

   x(:n) = both(:n)
   if (self%multiplier%extra > 0) call self%multiplier%to_unknowns(reshape(both(n + 1:), &
      & shape(self%pressure%total)), x(n + 1:))
end subroutine join

!> Add the forces of displacements and pressures, either given ones or those of the volume change
subroutine add_product(self, x, y, volume, pressure)
   class(group_stiffness), intent(in) :: self
   !> Displacements, or without pressures all unknowns, shape (n) [length]
   real(wp), contiguous, intent(in) :: x(:)
   !> Forces, to which these are added, shape (n) [force]
   real(wp), contiguous, intent(inout) :: y(:)
   !> Change of volume by the polynomials of each group, B u, shape (1 + nd, groups)
   !> [length^(nd/2)]
   real(wp), intent(inout) :: volume(:, :)
   !> Pressures beside those of the kept part, of the same shape; without them K B u
   !> [stress length^(nd/2)]
   real(wp), intent(in), optional :: pressure(:, :)
   real(wp), allocatable :: force(:, :), local(:, :), h(:, :, :)
   integer(i8) :: k, o
   integer :: blocks, g, i, most, n, nd, points

   nd = self%gradient%nd
   blocks = size(y)/nd
   associate (offset => self%gradient%member%offset, first => self%cells%first)
      most = int(maxval(offset(2:) - offset(:size(offset) - 1)))
      points = maxval(first(2:) - first(:size(first) - 1))
   end associate
   allocate (force(nd, size(self%gradient%member%index, kind=i8)))
   !$omp parallel default(none) private(g, i, k, local, h, n, o) &
   !$omp shared(self, x, y, volume, pressure, nd, blocks, most, points, force)
   allocate (local(nd, most), h(nd, nd, points))
   !$omp do schedule(static)
   do g = 1, size(self%bulk)
      o = self%gradient%member%offset(g)
      n = int(self%gradient%member%offset(g + 1) - o)
      ! blocks of pressures follow those of the source points
      do while (self%gradient%member%index(o + n) > blocks)
         n = n - 1
      end do
      associate (member => self%gradient%member%index(o + 1:o + n))
         if (present(pressure)) then
            call group_force(self, g, member, x, volume(:, g), local, h, force(:, o + 1:o + n), &
               & pressure(:, g))
         else
            call group_force(self, g, member, x, volume(:, g), local, h, force(:, o + 1:o + n))
         end if
      end associate
   end do
   !$omp end do
   ! parts of a source point are added in the order of the groups: sums do not depend on the threads
   !$omp do schedule(static)
   do i = 1, blocks
      do k = self%groups%offset(i) + 1, self%groups%offset(i + 1)
         y(nd*(i - 1) + 1:nd*i) = y(nd*(i - 1) + 1:nd*i) + force(:, self%entry(k))
      end do
   end do
   !$omp end do
   !$omp end parallel
end subroutine add_product

!> Add forces on some source points to those on all
pure subroutine add_forces(member, force, y)
   !> Source points
   integer, intent(in) :: member(:)
   !> Forces on them, shape (nd, members) [force]
   real(wp), intent(in) :: force(:, :)
   !> Forces, shape (n) [force]
   real(wp), intent(inout) :: y(:)
   integer :: k, nd

   nd = size(force, 1)
   do k = 1, size(member)
      y(nd*(member(k) - 1) + 1:nd*member(k)) = y(nd*(member(k) - 1) + 1:nd*member(k)) + force(:, k)
   end do
end subroutine add_forces

!> Forces of one group
pure subroutine group_force(self, g, member, x, volume, local, h, force, pressure)
   class(group_stiffness), intent(in) :: self
   !> Group
   integer, intent(in) :: g
   !> Its source points
   integer, intent(in) :: member(:)
   !> Displacements of all source points [length]
   real(wp), intent(in) :: x(self%gradient%nd, *)
   !> B u of the group, shape (1 + nd)
   real(wp), intent(out) :: volume(:)
   !> Room for displacements of its source points [length], shape (nd, members at most)
   real(wp), contiguous, intent(inout) :: local(:, :)
   !> Room for their gradients at its points, shape (nd, nd, points at most)
   real(wp), contiguous, intent(inout) :: h(:, :, :)
   !> Forces on its source points, shape (nd, members) [force]
   real(wp), contiguous, intent(inout) :: force(:, :)
   !> Pressures, shape (1 + nd), beside those of the part of K that is kept; without them K B u
   real(wp), intent(in), optional :: pressure(:)
   real(wp) :: p(3, 3), coefficient(size(volume))
   integer :: b, i, k, n, nd, o, q

   nd = self%gradient%nd
   o = self%cells%first(g)
   n = self%cells%first(g + 1) - o
   b = self%pressure%count(g)
   do k = 1, size(member)
      local(:, k) = x(:, member(k))
   end do
   volume = 0.0_wp
   do q = 1, n
      call self%gradient%at(o + q, local, [real(wp) ::], h(:, :, q))
      volume(:b) = volume(:b) + sum(self%cofactor(:nd, :nd, o + q)*h(:, :, q)) &
         & *self%pressure%basis(:b, o + q)
   end do
   if (present(pressure)) then
      coefficient = self%kept(g)*volume + pressure
   else if (self%multiplier%free(g)) then
      coefficient = self%multiplier%pressure(g, local(:, :size(member)))
   else
      coefficient = self%bulk(g)*volume
   end if
   force = 0.0_wp
   do q = 1, n
      p = dot_product(coefficient(:b), self%pressure%basis(:b, o + q))*self%cofactor(:, :, o + q)
      do k = 1, nd
         do i = 1, nd
            p = p + self%moduli(:, :, i, k, o + q)*h(i, k, q)
         end do
      end do
      call self%gradient%add_force(o + q, p, force)
   end do
   if (self%multiplier%free(g) .and. .not. present(pressure)) &
      & call self%multiplier%set_rows(g, volume(:b), force)
end subroutine group_force

!> Part of a group's bulk modulus that stays with the displacements
pure real(wp) function kept(self, g)
   class(group_stiffness), intent(in) :: self
   integer, intent(in) :: g

   kept = min(stays*self%shear(g), 0.5_wp*self%bulk(g))
end function kept

!> Share of a group's bulk modulus that acts on its pressures [-]
pure real(wp) function beside(self, g)
   class(group_stiffness), intent(in) :: self
   integer, intent(in) :: g

   beside = 1.0_wp - self%kept(g)/self%bulk(g)
end function beside

end module rk_group_stiffness
