!> Preconditioner of the stiffness of nodal cells: a Laplacian of each displacement component.
!>
!> The Laplacian acts on the values at the cells' points (rk_nodal_values) through the facets
!> between the cells, with the shear modulus as conductivity. The penalty of prescribed values acts
!> on what the values of a surface cell and of the one behind it extrapolate. The approximation
!> extrapolates a little differently, and the difference must not weigh: the geometric mean of the
!> penalty in use and of the cell's own stiffness errs by the same factor in both directions.
!>
!> Reference: Elman, Silvester, Wathen, Finite Elements and Fast Iterative Solvers, Oxford (2014),
!>            section 4.2, doi:10.1093/acprof:oso/9780199678792.001.0001
module rk_preconditioner
   use rk_cells, only : cells_type
   use rk_csr, only : csr_type
   use rk_error, only : error_type
   use rk_multigrid, only : multigrid_type, new_multigrid
   use rk_nodal_values, only : new_nodal_values, nodal_values_type
   use rk_precision, only : i8, wp
   use rk_shape, only : shape_type
   use rk_sparse_rows, only : new_sparse_rows, sparse_rows
   use rk_symmetric, only : new_symmetric, symmetric_matrix
   use rk_text, only : to_text
   use rk_weak_conditions, only : surface_type
   implicit none
   private

   public :: preconditioner_type, new_preconditioner

   !> Inverse of something like the stiffness
   type :: preconditioner_type
      !> Diagonal of the Laplacians, shape (n) [force/length]
      real(wp), allocatable :: diagonal(:)
      !> Cycles, and that of each component: components that are held at the same places share one,
      !> shape (nd)
      type(multigrid_type), allocatable, private :: laplacian(:)
      integer, allocatable, private :: cycle_of(:)
      !> Values, for which they stand
      type(nodal_values_type), private :: values
   contains
      procedure :: apply
   end type preconditioner_type

   !> Stiffness of a cell, of its own, that pieces which nothing holds keep: their factor exists [-]
   real(wp), parameter :: slight = 1.0e-6_wp

contains

!> Assemble, and set the cycles up
subroutine new_preconditioner(self, cells, surface, inside, shear, error)
   !> Preconditioner
   type(preconditioner_type), intent(inout) :: self
   !> Nodal cells
   type(cells_type), intent(in) :: cells
   !> Conditions on the surface
   type(surface_type), intent(in) :: surface
   !> Shape functions at the cells' points
   type(shape_type), intent(in) :: inside
   !> Shear modulus at each point, shape (np) [stress]
   real(wp), intent(in) :: shear(:)
   !> Error handling: a component that nothing holds
   type(error_type), allocatable, intent(out) :: error
   type(symmetric_matrix) :: graph
   type(sparse_rows) :: rows
   integer(i8), allocatable :: start(:), column(:)
   real(wp), allocatable :: free(:), value(:), held(:, :, :)
   integer, allocatable :: pair(:, :), behind(:)
   integer :: i, j, k, n, nd, s

   nd = inside%nd
   n = maxval(cells%node)
   call new_nodal_values(self%values, cells, inside)
   allocate (pair(2, size(cells%side, 2)))
   do k = 1, size(pair, 2)
      pair(:, k) = cells%node(cells%side(:, k))
      if (pair(1, k) > pair(2, k)) pair(:, k) = pair([2, 1], k)
   end do
   ! every cell has a diagonal, also one that touches no other
   call new_symmetric(graph, 1, n, csr_type([(int(2*k, i8), k=0, size(pair, 2)), &
      & (int(2*size(pair, 2) + k, i8), k=1, n)], [reshape(pair, [size(pair)]), (k, k=1, n)]))
   do k = 1, size(cells%node)
      call graph%add(graph%value, [cells%node(k)], reshape([slight*shear(k) &
         & *cells%weight(k)**(1.0_wp - 2.0_wp/nd)], [1, 1]))
   end do
   do k = 1, size(pair, 2)
      associate (a => cells%side(1, k), b => cells%side(2, k))
         call graph%add(graph%value, pair(:, k), norm2(cells%area(:, k)) &
            & /norm2(cells%point(:, a) - cells%point(:, b))*0.5_wp*(shear(a) + shear(b)) &
            & *reshape([1.0_wp, 0.0_wp, -1.0_wp, 1.0_wp], [2, 2]))
      end associate
   end do
   call find_behind(behind, cells)
   call find_penalties(held, cells, surface, shear, behind)
   allocate (self%laplacian(nd), self%cycle_of(nd), self%diagonal(nd*n))
   free = graph%value
   do i = 1, nd
      j = 1
      do while (any(surface%essential(i, :) .neqv. surface%essential(j, :)))
         j = j + 1
      end do
      self%cycle_of(i) = j
      if (j < i) then
         self%diagonal(i::nd) = self%diagonal(j::nd)
         cycle
      end if
      graph%value = free
      do s = 1, size(behind)
         if (.not. surface%essential(i, s)) cycle
         associate (own => cells%node(cells%lift_point(s)))
            if (behind(s) == 0) then
               call graph%add(graph%value, [own], held(1:1, 1:1, s))
            else if (own < cells%node(behind(s))) then
               call graph%add(graph%value, [own, cells%node(behind(s))], held(:, :, s))
            else
               call graph%add(graph%value, [cells%node(behind(s)), own], &
                  & held(2:1:-1, 2:1:-1, s))
            end if
         end associate
      end do
      self%diagonal(i::nd) = graph%value(graph%start(2:))
      call graph%compressed(start, column, value)
      call new_sparse_rows(rows, start, column, value)
      call new_multigrid(self%laplacian(i), rows, error)
      if (allocated(error)) then
         error%message = 'preconditioner of displacement component '//to_text(i)//': ' &
            & //error%message//'; above galerkin.direct_limit the tangent is not factorised'
         return
      end if
   end do
end subroutine new_preconditioner

!> Penalty of the value at each surface point, by those of its cell and the one behind
pure subroutine find_penalties(held, cells, surface, shear, behind)
   !> Penalties, shape (2, 2, ms) [force/length]
   real(wp), allocatable, intent(out) :: held(:, :, :)
   !> Nodal cells
   type(cells_type), intent(in) :: cells
   !> Conditions on the surface
   type(surface_type), intent(in) :: surface
   !> Shear modulus at each point, shape (np) [stress]
   real(wp), intent(in) :: shear(:)
   !> Cell behind each surface point, 0 if there is none, shape (ms)
   integer, intent(in) :: behind(:)
   real(wp) :: across(size(cells%point, 1)), share(2), penalty
   integer :: s

   allocate (held(2, 2, size(behind)))
   do s = 1, size(behind)
      associate (own => cells%lift_point(s))
         across = cells%outward(:, s)
         penalty = sqrt(surface%penalty(s)*shear(own)*dot_product(across, across)/cells%weight(own))
         share = [1.0_wp, 0.0_wp]
         if (behind(s) > 0) then
            across = cells%point(:, own) - cells%point(:, behind(s))
            share(2) = -dot_product(cells%surface(:, s) - cells%point(:, own), across) &
               & /dot_product(across, across)
            share(1) = 1.0_wp - share(2)
         end if
      end associate
      held(:, :, s) = penalty*spread(share, 2, 2)*spread(share, 1, 2)
   end do
end subroutine find_penalties

!> Cell on the other side of each surface point's cell, 0 if there is none
pure subroutine find_behind(behind, cells)
   !> Cells, shape (ms)
   integer, allocatable, intent(out) :: behind(:)
   !> Nodal cells
   type(cells_type), intent(in) :: cells
   integer :: facing(2, size(cells%point, 1), size(cells%weight)), d, k, s

   facing = 0
   do k = 1, size(cells%side, 2)
      d = maxloc(abs(cells%area(:, k)), dim=1)
      facing(merge(1, 2, cells%area(d, k) > 0.0_wp), d, cells%side(2, k)) = cells%side(1, k)
      facing(merge(2, 1, cells%area(d, k) > 0.0_wp), d, cells%side(1, k)) = cells%side(2, k)
   end do
   allocate (behind(size(cells%lift_point)))
   do s = 1, size(behind)
      d = maxloc(abs(cells%outward(:, s)), dim=1)
      behind(s) = facing(merge(1, 2, cells%outward(d, s) > 0.0_wp), d, cells%lift_point(s))
   end do
end subroutine find_behind

!> y = P^-1 x
subroutine apply(self, x, y)
   !> Preconditioner
   class(preconditioner_type), intent(in) :: self
   !> Forces, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Displacements, shape (n)
   real(wp), contiguous, intent(inout) :: y(:)

   call apply_to_values(self, size(self%cycle_of), size(x)/size(self%cycle_of), x, y)
end subroutine apply

!> The same point by point
subroutine apply_to_values(self, nd, n, x, y)
   !> Preconditioner
   class(preconditioner_type), intent(in) :: self
   !> Components and source points
   integer, intent(in) :: nd, n
   !> Forces
   real(wp), intent(in) :: x(nd, n)
   !> Displacements
   real(wp), intent(inout) :: y(nd, n)
   real(wp), allocatable :: value(:, :), right(:, :), found(:, :)
   integer, allocatable :: own(:)
   integer :: c, i

   allocate (value, source=x)
   call self%values%invert(.true., value)
   do c = 1, nd
      own = pack([(i, i=1, nd)], self%cycle_of == c)
      if (size(own) == nd) then
         call self%laplacian(c)%apply(value, y)
      else if (size(own) > 0) then
         right = value(own, :)
         found = right
         call self%laplacian(c)%apply(right, found)
         y(own, :) = found
      end if
   end do
   call self%values%invert(.false., y)
end subroutine apply_to_values

end module rk_preconditioner
