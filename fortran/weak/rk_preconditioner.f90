!> Preconditioner of the stiffness of cells: a Laplacian of each displacement component, factorised.
!>
!> The Laplacian acts on values (rk_nodal_values), with the shear modulus as conductivity. Values of
!> nodal cells are those at their points, coupled through the facets between the cells. Cells of
!> Gauss points have theirs at the source points in their corners, coupled along their edges: each
!> point contributes to an edge with the weight of multilinear functions of the corners, so that
!> cells which the surface leaves almost empty are as soft as the points in them.
!>
!> The penalty of prescribed values acts on the value interpolated from corners at a surface point.
!> On a nodal cell it acts on the value at its point, which is not on the surface: the geometric
!> mean of the penalty in use and of the cell's own stiffness errs by the same factor in both
!> directions.
!>
!> Reference: Elman, Silvester, Wathen, Finite Elements and Fast Iterative Solvers, Oxford (2014),
!>            section 4.2, doi:10.1093/acprof:oso/9780199678792.001.0001
module rk_preconditioner
   use rk_cells, only : cells_type
   use rk_corners, only : corners_type, new_corners
   use rk_csr, only : csr_type, sort
   use rk_error, only : error_type
   use rk_nodal_values, only : new_nodal_values, nodal_values_type
   use rk_precision, only : i8, wp
   use rk_scene, only : scene_type
   use rk_shape, only : shape_type
   use rk_sparse, only : solve_sparse, sparse_factor
   use rk_symmetric, only : new_symmetric, symmetric_matrix
   use rk_text, only : to_text
   use rk_weak_conditions, only : surface_type
   implicit none
   private

   public :: preconditioner_type, new_preconditioner

   !> Approximate inverse of the stiffness
   type :: preconditioner_type
      !> Diagonal of the Laplacians, shape (n) [force/length]
      real(wp), allocatable :: diagonal(:)
      !> Factors, and that of each component: components constrained at the same places share one,
      !> shape (nd)
      type(sparse_factor), allocatable, private :: laplacian(:)
      integer, allocatable, private :: factor_of(:)
      !> Values on which they act
      type(nodal_values_type), private :: values
   contains
      procedure :: apply
   end type preconditioner_type

   !> Couplings and penalties of values; a pair of source points is ascending
   type :: network_type
      !> Couplings: pairs, shape (2, couplings), and conductances [force/length]
      integer, allocatable :: pair(:, :)
      real(wp), allocatable :: conductance(:)
      !> Small stiffness added to each source point, so that components without any constraint keep
      !> a factor, shape (ns) [force/length]
      real(wp), allocatable :: own(:)
      !> Penalties: surface points, shape (n), pairs, twice the same point where there is only one,
      !> shape (2, n), and stiffness, shape (2, 2, n) [force/length]
      integer, allocatable :: surface(:), holds(:, :)
      real(wp), allocatable :: penalty(:, :, :)
   end type network_type

   !> Added share of a cell's stiffness, so that components without any constraint keep a factor [-]
   real(wp), parameter :: slight = 1.0e-6_wp
   !> Chebyshev steps from values to coefficients: a spindle of voxels whose blocks are cut by the
   !> surface takes 600 iterations to 1e-6 with three of them, 370 with six and 350 with ten
   integer, parameter :: nodal_steps = 3, corner_steps = 6

contains

!> Assemble and factorise
subroutine new_preconditioner(self, scene, cells, surface, inside, shear, error)
   type(preconditioner_type), intent(inout) :: self
   type(scene_type), intent(in) :: scene
   !> Nodal cells, or cells of Gauss points between source points
   type(cells_type), intent(in) :: cells
   type(surface_type), intent(in) :: surface
   !> Shape functions at the cells' points
   type(shape_type), intent(in) :: inside
   !> Shear modulus at each point, shape (np) [stress]
   real(wp), intent(in) :: shear(:)
   !> Error handling: a component without any constraint
   type(error_type), allocatable, intent(out) :: error
   type(network_type) :: network
   type(symmetric_matrix) :: graph
   type(shape_type) :: at_sources
   integer, allocatable :: cell(:)
   real(wp), allocatable :: free(:)
   integer :: i, j, k, n, nd, s

   nd = inside%nd
   n = size(scene%cloud%source, 2)
   cell = [(i, i=1, n)]
   if (allocated(cells%node)) then
      cell(cells%node) = [(k, k=1, size(cells%node))]
      call new_nodal_values(self%values, inside, cell, nodal_steps)
      call nodal_network(network, cells, surface, shear)
   else
      call scene%shape_at(scene%cloud%source, at_sources, error, plain=.true.)
      if (allocated(error)) return
      call new_nodal_values(self%values, at_sources, cell, corner_steps)
      call corner_network(network, scene, cells, surface, shear)
   end if
   ! every source point has a diagonal entry, even without any coupling
   associate (pair => reshape([network%pair, network%holds], [2, size(network%pair, 2) &
      & + size(network%holds, 2)]))
      call new_symmetric(graph, 1, n, csr_type([(int(2*k, i8), k=0, size(pair, 2)), &
         & (int(2*size(pair, 2) + k, i8), k=1, n)], [reshape(pair, [size(pair)]), (k, k=1, n)]))
   end associate
   do k = 1, n
      call graph%add(graph%value, [k], reshape([slight*network%own(k)], [1, 1]))
   end do
   do k = 1, size(network%conductance)
      call graph%add(graph%value, network%pair(:, k), network%conductance(k) &
         & *reshape([1.0_wp, 0.0_wp, -1.0_wp, 1.0_wp], [2, 2]))
   end do
   allocate (self%laplacian(nd), self%factor_of(nd), self%diagonal(nd*n))
   free = graph%value
   do i = 1, nd
      j = 1
      do while (any(surface%essential(i, :) .neqv. surface%essential(j, :)))
         j = j + 1
      end do
      self%factor_of(i) = j
      if (j < i) then
         self%diagonal(i::nd) = self%diagonal(j::nd)
         cycle
      end if
      graph%value = free
      do s = 1, size(network%surface)
         if (.not. surface%essential(i, network%surface(s))) cycle
         associate (pair => network%holds(:, s))
            k = merge(1, 2, pair(1) == pair(2))
            call graph%add(graph%value, pair(:k), network%penalty(:k, :k, s))
         end associate
      end do
      self%diagonal(i::nd) = graph%value(graph%start(2:))
      call solve_sparse(self%laplacian(i), n, graph%start, graph%rows(), graph%value, .true., error)
      if (allocated(error)) then
         error%message = 'preconditioner of displacement component '//to_text(i)//': ' &
            & //error%message//'; above galerkin.direct_limit the tangent is not factorised'
         return
      end if
   end do
end subroutine new_preconditioner

!> Couplings of nodal cells through their facets, and their penalties
subroutine nodal_network(self, cells, surface, shear)
   type(network_type), intent(out) :: self
   !> Nodal cells
   type(cells_type), intent(in) :: cells
   type(surface_type), intent(in) :: surface
   real(wp), intent(in) :: shear(:)
   integer :: k, nd, s

   nd = size(cells%point, 1)
   allocate (self%own(maxval(cells%node)), source=0.0_wp)
   do k = 1, size(cells%node)
      associate (own => self%own(cells%node(k)))
         own = own + shear(k)*cells%weight(k)**(1.0_wp - 2.0_wp/nd)
      end associate
   end do
   allocate (self%pair(2, size(cells%side, 2)), self%conductance(size(cells%side, 2)))
   do k = 1, size(self%conductance)
      associate (a => cells%side(1, k), b => cells%side(2, k))
         self%pair(:, k) = cells%node([a, b])
         call sort(self%pair(:, k))
         self%conductance(k) = norm2(cells%area(:, k))/norm2(cells%point(:, a) &
            & - cells%point(:, b))*0.5_wp*(shear(a) + shear(b))
      end associate
   end do
   allocate (self%holds(2, size(cells%set)))
   allocate (self%penalty(2, 2, size(cells%set)), source=0.0_wp)
   self%surface = [(s, s=1, size(cells%set))]
   do s = 1, size(cells%set)
      associate (own => cells%lift_point(s))
         self%holds(:, s) = cells%node(own)
         self%penalty(1, 1, s) = sqrt(surface%penalty(s)*shear(own)*sum(cells%outward(:, s)**2) &
            & /cells%weight(own))
      end associate
   end do
end subroutine nodal_network

!> Couplings of source points along the edges of cells of Gauss points, and their penalties
subroutine corner_network(self, scene, cells, surface, shear)
   type(network_type), intent(out) :: self
   !> Scene whose source points are corners
   type(scene_type), intent(in) :: scene
   !> Cells of Gauss points
   type(cells_type), intent(in) :: cells
   type(surface_type), intent(in) :: surface
   real(wp), intent(in) :: shear(:)
   type(corners_type) :: corners
   real(wp) :: xi(size(cells%point, 1)), share(2)
   integer :: c, cell, d, e, edges, k, nd, q, s

   nd = size(cells%point, 1)
   call new_corners(corners, scene%cloud, cells)
   edges = 2**(nd - 1)
   allocate (self%pair(2, nd*edges*size(corners%of, 2)), self%holds(2, edges*size(cells%set)))
   allocate (self%conductance(size(self%pair, 2)), source=0.0_wp)
   allocate (self%penalty(2, 2, size(self%holds, 2)), source=0.0_wp)
   allocate (self%own(size(scene%cloud%source, 2)), source=0.0_wp)
   k = 0
   do cell = 1, size(corners%of, 2)
      do d = 1, nd
         do e = 0, edges - 1
            k = k + 1
            self%pair(:, k) = ends(cell, d, e)
            call sort(self%pair(:, k))
            do q = cells%per_cell*(cell - 1) + 1, cells%per_cell*cell
               self%conductance(k) = self%conductance(k) + shear(q)*cells%weight(q) &
                  & /corners%step(d)**2*weight_of(corners%within(cell, cells%point(:, q)), d, e)
            end do
            do c = 1, 2
               self%own(self%pair(c, k)) = self%own(self%pair(c, k)) + self%conductance(k)
            end do
         end do
      end do
   end do
   self%surface = [((s, e=1, edges), s=1, size(cells%set))]
   do s = 1, size(cells%set)
      cell = 1 + (cells%lift_point(cells%lift_first(s) + 1) - 1)/cells%per_cell
      d = maxloc(abs(cells%outward(:, s)), dim=1)
      xi = corners%within(cell, cells%surface(:, s))
      share = [1.0_wp - xi(d), xi(d)]
      do e = 0, edges - 1
         associate (to => edges*(s - 1) + e + 1)
            self%holds(:, to) = ends(cell, d, e)
            self%penalty(:, :, to) = surface%penalty(s)*weight_of(xi, d, e) &
               & *spread(share, 2, 2)*spread(share, 1, 2)
            if (self%holds(1, to) < self%holds(2, to)) cycle
            self%holds(:, to) = self%holds(2:1:-1, to)
            self%penalty(:, :, to) = self%penalty(2:1:-1, 2:1:-1, to)
         end associate
      end do
   end do

contains

   !> Source points at the ends of an edge of a cell
   pure function ends(cell, along, edge)
      integer, intent(in) :: cell, along, edge
      integer :: ends(2)

      associate (low => iand(edge, 2**(along - 1) - 1) + 2*(edge - iand(edge, 2**(along - 1) - 1)))
         ends = corners%of([low, low + 2**(along - 1)] + 1, cell)
      end associate
   end function ends

   !> Weight of an edge at a place of a cell, in the directions across
   pure real(wp) function weight_of(xi, along, edge)
      real(wp), intent(in) :: xi(:)
      integer, intent(in) :: along, edge
      integer :: b, o

      weight_of = 1.0_wp
      b = 0
      do o = 1, size(xi)
         if (o == along) cycle
         weight_of = weight_of*merge(xi(o), 1.0_wp - xi(o), btest(edge, b))
         b = b + 1
      end do
   end function weight_of

end subroutine corner_network

subroutine apply(self, x, y)
   class(preconditioner_type), intent(in) :: self
   !> Forces, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Displacements, shape (n)
   real(wp), contiguous, target, intent(inout) :: y(:)
   real(wp), allocatable, target :: right(:, :)
   real(wp), allocatable :: value(:, :)
   real(wp), pointer, contiguous :: u(:, :), vectors(:)
   integer, allocatable :: own(:)
   integer :: c, i, nd

   ! point by point
   nd = size(self%factor_of)
   u(1:nd, 1:size(y)/nd) => y
   value = reshape(x, shape(u))
   call self%values%invert(.true., value)
   do c = 1, nd
      own = pack([(i, i=1, nd)], self%factor_of == c)
      if (size(own) == 0) cycle
      right = transpose(value(own, :))
      vectors(1:size(right)) => right
      call self%laplacian(c)%solve(vectors)
      u(own, :) = transpose(right)
   end do
   call self%values%invert(.false., u)
end subroutine apply

end module rk_preconditioner
