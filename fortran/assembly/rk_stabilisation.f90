!> Resistance of nodal cells to gradients that vary within them.
!>
!> One gradient for each cell leaves deformations without resistance that change sign from cell to
!> cell. Their second derivatives do not vanish: these are resisted as the energy of a gradient that
!> varies linearly over the cell is. Linear displacements have none.
!>
!> Reference: Hillman, Chen, Int. J. Numer. Meth. Engng 107 (2016), doi:10.1002/nme.5183
module rk_stabilisation
   use rk_cells, only : cells_type
   use rk_precision, only : i8, wp
   use rk_shape, only : shape_type
   use rk_symmetric, only : symmetric_matrix
   implicit none
   private

   public :: stabilise

contains

!> Add modulus/2 times the integral of |grad F (X - X_c)|^2 over each cell
subroutine stabilise(matrix, value, cells, inside, modulus)
   !> Places of the entries
   type(symmetric_matrix), intent(in) :: matrix
   !> Entries [force/length]
   real(wp), intent(inout) :: value(:)
   !> Cells with their second moments
   type(cells_type), intent(in) :: cells
   !> Shape functions at the integration points
   type(shape_type), intent(in) :: inside
   !> Modulus of each cell, shape (np) [stress]
   real(wp), intent(in) :: modulus(:)
   real(wp), allocatable :: part(:, :), scaled(:, :), bend(:, :)
   real(wp) :: energy
   integer :: c, i, k, l, n, nd, q, a
   integer(i8) :: at, first

   nd = inside%nd
   do q = 1, size(modulus)
      at = inside%neighbour%offset(q)
      first = inside%first(inside%stencil(q))
      n = inside%count(q)
      allocate (part(nd*n, nd*n), source=0.0_wp)
      do c = 1, nd
         bend = inside%value([(pair(nd, a, c), a=1, nd)], first + 1:first + n)
         scaled = modulus(q)*matmul(cells%moment(:, :, q), bend)
         do l = 1, n
            do k = 1, l
               energy = dot_product(bend(:, k), scaled(:, l))
               do i = 1, nd
                  part(nd*(k - 1) + i, nd*(l - 1) + i) = part(nd*(k - 1) + i, nd*(l - 1) + i) &
                     & + energy
               end do
            end do
         end do
      end do
      call matrix%add(value, inside%neighbour%index(at + 1:at + n), part)
      deallocate (part)
   end do
end subroutine stabilise

!> Number of a second derivative among all of a shape function
pure integer function pair(nd, a, b)
   !> Space dimension
   integer, intent(in) :: nd
   !> Directions
   integer, intent(in) :: a, b

   associate (low => min(a, b), high => max(a, b))
      pair = 1 + nd + (low - 1)*nd - (low - 1)*(low - 2)/2 + high - low + 1
   end associate
end function pair

end module rk_stabilisation
