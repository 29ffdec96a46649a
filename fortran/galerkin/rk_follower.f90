!> Pressure on the surface of a weak form that follows it: force per deformed area against the
!> deformed normal.
!>
!> By Nanson's formula the force on a point with the area A and normal N at rest is -p cof(F) A N,
!> with F of the approximation there. Its derivative is not symmetric point by point; over a surface
!> whose rim is held, or lies in planes of symmetry, it is the second derivative of p times the
!> volume behind the surface, and only its symmetric part counts. With a rim that moves freely the
!> iteration takes 5 steps at 0.1 shear moduli, 9 to 15 at 0.4, and crawls beyond.
!>
!> Reference: Bonet, Wood, Nonlinear Continuum Mechanics for Finite Element Analysis, Cambridge
!>            (2008), section 8.5, doi:10.1017/CBO9780511755446
module rk_follower
   use rk_cells, only : cells_type
   use rk_precision, only : wp
   use rk_symmetric, only : symmetric_matrix
   use rk_tensor, only : cross_form
   use rk_weak_conditions, only : surface_type
   implicit none
   private

   public :: add_pressure

contains

!> Add the forces of pressures to residuals, and their stiffness to a matrix where that is wanted
subroutine add_pressure(surface, cells, factor, x, tangent, matrix, value, r)
   !> Surface with pressures
   type(surface_type), target, intent(in) :: surface
   !> Integration points
   type(cells_type), intent(in) :: cells
   !> Load factors, shape (factors) [-]
   real(wp), intent(in) :: factor(:)
   !> Unknowns, shape (n) [length]
   real(wp), intent(in) :: x(:)
   !> Stiffness wanted
   logical, intent(in) :: tangent
   !> Places of its entries
   class(symmetric_matrix), intent(in) :: matrix
   !> Entries, to which it is added [force/length]
   real(wp), intent(inout) :: value(:)
   !> Residuals: internal less external forces, to which those of pressures are added [force]
   real(wp), intent(inout) :: r(:)
   real(wp), allocatable :: part(:, :)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   real(wp) :: c4(3, 3, 3, 3), f(3, 3), normal(3), push(3), turn(3, 3, 3), p
   integer :: a, b, i, j, k, l, n, nd, s

   if (.not. allocated(surface%pressure)) return
   nd = size(cells%outward, 1)
   normal = 0.0_wp
   do s = 1, size(cells%set)
      p = dot_product(surface%pressure(:, s), factor)
      if (.not. abs(p) > 0.0_wp) cycle
      call surface%shape%row(s, nodes, values)
      n = size(nodes)
      push = surface%pressure_force(cells, s, p, x)
      do k = 1, n
         associate (own => r(nd*(nodes(k) - 1) + 1:nd*nodes(k)))
            own = own - values(1, k)*push(:nd)
         end associate
      end do
      if (.not. tangent) cycle
      f = surface%gradient_at(s, x)
      c4 = reshape(cross_form(f), [3, 3, 3, 3])
      normal(:nd) = p*cells%part(s)*cells%outward(:, s)
      ! derivative of the force by F(j, B), of the components that carry it
      turn = 0.0_wp
      do i = 1, nd
         if (surface%essential(i, s)) cycle
         do j = 1, nd
            do b = 1, nd
               do a = 1, nd
                  turn(i, j, b) = turn(i, j, b) + c4(i, a, j, b)*normal(a)
               end do
            end do
         end do
      end do
      allocate (part(nd*n, nd*n), source=0.0_wp)
      do l = 1, n
         do k = 1, l
            do j = 1, nd
               do i = 1, nd
                  part(nd*(k - 1) + i, nd*(l - 1) + j) = 0.5_wp*(values(1, k) &
                     & *dot_product(turn(i, j, :nd), values(2:1 + nd, l)) + values(1, l) &
                     & *dot_product(turn(j, i, :nd), values(2:1 + nd, k)))
               end do
            end do
         end do
      end do
      call matrix%add(value, nodes, part)
      deallocate (part)
   end do
end subroutine add_pressure

end module rk_follower
