!> Resistance to gradients and volume changes that vary within cells and groups of them.
!>
!> With one gradient for each cell, deformations that change sign from cell to cell meet no
!> resistance. Their second derivatives do not vanish: these are given the energy of a gradient that
!> varies linearly over the cell. Linear displacements have none.
!>
!> Cells of a group share few pressures. Within a group, only shear would resist an exchange of
!> volume between cells; a part of the bulk modulus that is too small to lock acts in each nodal
!> cell, and at each Gauss point of boxes whose functions run out at the sides. Without it bodies
!> are too soft where a clamped side meets a free one, and the iteration is slow there.
!>
!> Reference: Hillman, Chen, Int. J. Numer. Meth. Engng 107 (2016), doi:10.1002/nme.5183
module rk_stabilisation
   use rk_basis, only : second_index
   use rk_cells, only : cells_type
   use rk_mixture, only : mixture_type
   use rk_precision, only : wp
   use rk_shape, only : shape_type
   use rk_symmetric, only : symmetric_matrix
   use rk_tensor, only : identity
   implicit none
   private

   public :: stabilise, share_bulk, bulk_within, judged_share

   !> Bulk modulus in each nodal cell over its shear modulus: that of a Poisson's ratio of 0.35
   real(wp), parameter :: local_share = 3.0_wp
   !> The same at Gauss points, and in groups with a single cell in some direction, which have no
   !> pressure that varies along it: more stiffens bending, and with less the force of a sheared
   !> column of an even number of points falls below that of the next odd one
   real(wp), parameter :: group_share = 1.0_wp, thin_share = 8.0_wp/3.0_wp
   !> What is added to it where the stability of a tangent is judged: blocks pressed between rollers
   !> have false negative modes with 0.3 and none from 0.9 on; more stiffens bending with few cells
   !> across
   real(wp), parameter :: judged_share = 1.0_wp
   !> Relative difference below which the bulk moduli of a group count as equal
   real(wp), parameter :: equal = 1.0e-12_wp
   !> Least softness of stiff points: polynomials that only they distinguish keep a norm
   real(wp), parameter :: least = 1.0e-6_wp

contains

!> Add modulus/2 times the integral of |grad F (X - X_c)|^2 over each cell, for all components that
!> the matrix has
subroutine stabilise(matrix, value, cells, inside, modulus)
   !> Places of the entries
   type(symmetric_matrix), intent(in) :: matrix
   !> Entries [force/length]
   real(wp), intent(inout) :: value(:)
   !> Cells with their second moments
   type(cells_type), intent(in) :: cells
   !> Shape functions at the integration points
   type(shape_type), target, intent(in) :: inside
   !> Modulus of each cell, shape (np) [stress]
   real(wp), intent(in) :: modulus(:)
   real(wp), allocatable :: part(:, :), scaled(:, :), bend(:, :)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   real(wp) :: energy
   integer :: c, i, k, l, n, nb, nd, q, a

   nd = inside%nd
   nb = matrix%block
   do q = 1, size(modulus)
      call inside%row(q, nodes, values)
      n = size(nodes)
      allocate (part(nb*n, nb*n), source=0.0_wp)
      do c = 1, nd
         bend = values([(second_index(nd, a, c), a=1, nd)], :)
         scaled = modulus(q)*matmul(cells%moment(:, :, q), bend)
         do l = 1, n
            do k = 1, l
               energy = dot_product(bend(:, k), scaled(:, l))
               do i = 1, nb
                  part(nb*(k - 1) + i, nb*(l - 1) + i) = part(nb*(k - 1) + i, nb*(l - 1) + i) &
                     & + energy
               end do
            end do
         end do
      end do
      call matrix%add(value, nodes, part)
      deallocate (part)
   end do
end subroutine stabilise

!> Share the bulk modulus among the volume ratio at each point and its projection in each group. At
!> one pressure the changes of volume of soft and stiff points add up: the modulus of a group is the
!> harmonic mean; otherwise stiff points would suppress the change of volume of the others.
subroutine share_bulk(mixture, cells, nc, everywhere, local, projected, whole, softness)
   !> Materials of the collocation points and, after them, of the integration points
   type(mixture_type), intent(in) :: mixture
   type(cells_type), intent(in) :: cells
   !> Number of collocation points
   integer, intent(in) :: nc
   !> Whether a part acts at Gauss points
   logical, intent(in) :: everywhere
   !> Part that acts at each collocation point of nodal cells, zero at others, and at each
   !> integration point, shape (nc + np) [stress]
   real(wp), allocatable, intent(out) :: local(:)
   !> Part that acts on the projection in each group, shape (groups) [stress]
   real(wp), allocatable, intent(out) :: projected(:)
   !> Factor from the projected pressure of each group to the total one: the local parts, which vary
   !> between Gauss points, are written as their mean, shape (groups) [-]
   real(wp), allocatable, intent(out) :: whole(:)
   !> Modulus of the group over that of each integration point, shape (np) [-]
   real(wp), allocatable, intent(out) :: softness(:)
   real(wp) :: bulk(size(cells%weight)), share
   integer :: g, i

   allocate (local(nc + size(cells%weight)), source=0.0_wp)
   if (cells%smoothed) then
      do i = 1, size(local)
         local(i) = bulk_within(mixture, i, local_share)
      end do
   else if (everywhere) then
      do g = 1, size(cells%first) - 1
         share = group_share
         if (allocated(cells%thin)) share = merge(thin_share, share, any(cells%thin(:, g)))
         do i = cells%first(g) + 1, cells%first(g + 1)
            local(nc + i) = bulk_within(mixture, nc + i, share)
         end do
      end do
   end if
   bulk = [(mixture%bulk_at_one_pressure(nc + i) - local(nc + i), i=1, size(bulk))]
   allocate (projected(size(cells%first) - 1))
   allocate (softness(size(bulk)), source=1.0_wp)
   do g = 1, size(projected)
      associate (first => cells%first(g) + 1, last => cells%first(g + 1))
         projected(g) = sum(cells%weight(first:last)*bulk(first:last)) &
            & /sum(cells%weight(first:last))
         ! a harmonic mean needs positive moduli
         if (.not. minval(bulk(first:last)) > 0.0_wp) cycle
         ! moduli that differ by rounding count as equal
         if (minval(bulk(first:last)) >= (1.0_wp - equal)*projected(g)) cycle
         projected(g) = sum(cells%weight(first:last)) &
            & /sum(cells%weight(first:last)/bulk(first:last))
         softness(first:last) = max(projected(g)/bulk(first:last), least)
      end associate
   end do
   allocate (whole(size(projected)), source=1.0_wp)
   if (cells%smoothed) return
   do g = 1, size(projected)
      associate (first => cells%first(g) + 1, last => cells%first(g + 1))
         if (minval(bulk(first:last)) > 0.0_wp) whole(g) = 1.0_wp + sum(cells%weight(first:last) &
            & *local(nc + first:nc + last)/bulk(first:last))/sum(cells%weight(first:last))
      end associate
   end do
end subroutine share_bulk

!> Bulk modulus with which a place may resist volume changes that its group's pressure leaves free:
!> no more than in a material that does not lock, and part of it is left for pressures [stress]
real(wp) function bulk_within(mixture, i, share)
   type(mixture_type), intent(in) :: mixture
   !> Collocation or integration point
   integer, intent(in) :: i
   !> Its upper limit, relative to the shear modulus [-]
   real(wp), intent(in) :: share
   real(wp) :: shear

   shear = mixture%shear_modulus(i, identity)
   if (allocated(mixture%pair)) shear = mixture%pair(2, i)
   bulk_within = max(0.0_wp, min(0.5_wp*mixture%bulk_at_one_pressure(i), share*shear))
end function bulk_within

end module rk_stabilisation
