!> Tangent of the Galerkin form: a sparse matrix solved directly or, where its factor would not fit,
!> never formed and solved by minimal residuals.
!>
!> The factor of a coupled solid grows like n^(4/3) with n unknowns and the whole patch of a group
!> couples. Without forming it, the tangent is A + B^T K B with the stiffness A at constant volume
!> and one row of B for each pressure. With the pressures as unknowns,
!>
!>     A u + B^T p = f,   B u - p/K = 0,
!>
!> nothing of the size of K is left. The preconditioner is a Laplacian over the facets of the nodal
!> cells, as stiff as A up to a factor that refinement hardly changes, and the shear modulus for the
!> pressures. With K near the shear modulus the number of iterations hardly grows with the number of
!> points; with a large K it grows like one over the spacing, so the pressures deserve better.
!>
!> Reference: Elman, Silvester, Wathen, Finite Elements and Fast Iterative Solvers, Oxford (2014),
!>            section 4.2, doi:10.1093/acprof:oso/9780199678792.001.0001
module rk_tangent
   use rk_cells, only : cells_type
   use rk_error, only : error_type, fatal_error, err_linalg
   use rk_gradient, only : gradient_type
   use rk_minres, only : minres, symmetric_system
   use rk_operator, only : square_report
   use rk_neighbours, only : neighbour_type
   use rk_precision, only : i8, wp
   use rk_pressure, only : pressure_type
   use rk_sparse, only : factor_upper, sparse_factor
   use rk_surface, only : surface_type
   use rk_symmetric, only : new_symmetric, symmetric_matrix
   use rk_text, only : to_text
   implicit none
   private

   public :: tangent_type, new_tangent, add_forces

   !> Tangent; as a matrix it is the whole of it where it is formed, otherwise the constant part
   type, extends(symmetric_matrix) :: tangent_type
      !> The matrix holds all of it
      logical :: formed = .true.
      !> Of each point: moduli C4(i, A, j, B) and cofactors, both times weight, shapes
      !> (3, 3, 3, 3, np) and (3, 3, np)
      real(wp), allocatable :: moduli(:, :, :, :, :)
      real(wp), allocatable :: cofactor(:, :, :)
      !> Bulk and shear modulus of each group, shape (groups) [stress]
      real(wp), allocatable :: bulk(:)
      real(wp), allocatable :: shear(:)
      !> Points, gradients and pressures of the problem
      type(cells_type), pointer :: cells => null()
      type(gradient_type), pointer :: gradient => null()
      type(pressure_type), pointer :: pressure => null()
      !> Laplacian of each displacement component, shape (nd), and its diagonal, shape (nd, ns)
      !> [force/length]
      real(wp), allocatable, private :: diagonal(:, :)
      type(sparse_factor), allocatable, private :: laplacian(:)
   contains
      procedure :: apply
      procedure :: apply_transposed => apply
      procedure :: dense
      procedure :: solve_square
      final :: free_laplacian
   end type tangent_type

   !> Displacements and pressures
   type, extends(symmetric_system) :: saddle_type
      type(tangent_type), pointer :: tangent => null()
      !> Damping in units of the Laplacian's diagonal [-]
      real(wp) :: shift = 0.0_wp
   contains
      procedure :: multiply
      procedure :: precondition
   end type saddle_type

   !> Residual of a solve: that of the displacement form is K over the shear modulus larger
   real(wp), parameter :: tolerance = 1.0e-7_wp
   !> Iterations of a solve
   integer, parameter :: most = 3000

contains

!> Set up the places of the entries and, where it is not formed, the preconditioner
subroutine new_tangent(self, ns, cells, gradient, surface, inside, shear, limit, error)
   !> Tangent
   type(tangent_type), intent(inout) :: self
   !> Source points
   integer, intent(in) :: ns
   !> Integration points
   type(cells_type), intent(in) :: cells
   !> Gradients there
   type(gradient_type), intent(in) :: gradient
   !> Conditions on the surface
   type(surface_type), intent(in) :: surface
   !> Source points that cover each integration point
   type(neighbour_type), intent(in) :: inside
   !> Shear modulus at each point, shape (np) [stress]
   real(wp), intent(in) :: shear(:)
   !> Unknowns up to which it is formed
   integer, intent(in) :: limit
   !> Error handling: no memory, no SuiteSparse
   type(error_type), allocatable, intent(out) :: error
   integer :: g

   self%formed = .not. cells%smoothed .or. gradient%nd*ns <= limit
   if (self%formed) then
      call new_symmetric(self%symmetric_matrix, gradient%nd, ns, gradient%member_start, &
         & gradient%member)
      return
   end if
   ! only what never changes: penalty and stabilisation
   associate (skin => surface%shape%neighbour)
      call new_symmetric(self%symmetric_matrix, gradient%nd, ns, [inside%offset, &
         & inside%offset(size(inside%offset)) + skin%offset(2:)], [inside%index, skin%index])
   end associate
   allocate (self%moduli(3, 3, 3, 3, size(shear)), self%cofactor(3, 3, size(shear)))
   allocate (self%bulk(size(cells%first) - 1), self%shear(size(cells%first) - 1))
   do g = 1, size(self%shear)
      associate (first => cells%first(g) + 1, last => cells%first(g + 1))
         self%shear(g) = dot_product(cells%weight(first:last), shear(first:last)) &
            & /sum(cells%weight(first:last))
      end associate
   end do
   call set_laplacian(self, cells, surface, shear, error)
end subroutine new_tangent

!> Laplacian over the facets of the nodal cells, with the shear modulus as conductivity
subroutine set_laplacian(self, cells, surface, shear, error)
   !> Tangent
   type(tangent_type), intent(inout) :: self
   !> Integration points
   type(cells_type), intent(in) :: cells
   !> Conditions on the surface
   type(surface_type), intent(in) :: surface
   !> Shear modulus at each point, shape (np) [stress]
   real(wp), intent(in) :: shear(:)
   !> Error handling: no memory, no SuiteSparse, a component that nothing holds
   type(error_type), allocatable, intent(out) :: error
   type(symmetric_matrix) :: graph
   real(wp) :: part(2, 2), conductance
   real(wp), allocatable :: value(:)
   integer, allocatable :: pair(:, :)
   integer :: i, k, nd, s

   nd = size(surface%essential, 1)
   allocate (pair(2, size(cells%side, 2)))
   do k = 1, size(pair, 2)
      pair(1, k) = minval(cells%node(cells%side(:, k)))
      pair(2, k) = maxval(cells%node(cells%side(:, k)))
   end do
   call new_symmetric(graph, 1, size(cells%node), [(int(2*k, i8), k=0, size(pair, 2))], &
      & reshape(pair, [size(pair)]))
   do k = 1, size(pair, 2)
      associate (a => cells%side(1, k), b => cells%side(2, k))
         conductance = norm2(cells%area(:, k))/norm2(cells%point(:, a) - cells%point(:, b)) &
            & *0.5_wp*(shear(a) + shear(b))
      end associate
      part = reshape([conductance, 0.0_wp, -conductance, conductance], [2, 2])
      call graph%add(graph%value, pair(:, k), part)
   end do
   allocate (self%laplacian(nd), self%diagonal(nd, size(cells%node)))
   do i = 1, nd
      value = graph%value
      do s = 1, size(surface%penalty)
         if (.not. surface%essential(i, s)) cycle
         associate (at => graph%start(cells%node(cells%lift_point(s)) + 1))
            value(at) = value(at) + surface%penalty(s)
         end associate
      end do
      self%diagonal(i, :) = value(graph%start(2:))
      call factor_upper(self%laplacian(i), graph%n, graph%start, graph%row, value, error)
      if (allocated(error)) return
   end do
end subroutine set_laplacian

!> y = K u with all of the tangent
subroutine apply(self, x, y)
   !> Tangent
   class(tangent_type), intent(in) :: self
   !> Vector, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Product, shape (n)
   real(wp), contiguous, intent(inout) :: y(:)
   real(wp) :: volume(size(self%pressure%total, 1), size(self%pressure%total, 2))

   call self%product(self%value, x, y)
   if (.not. self%formed) call add_groups(self, x, y, volume)
end subroutine apply

!> Add the forces of all groups, the pressures given or those of the volume's change
subroutine add_groups(self, x, y, volume, pressure)
   !> Tangent
   class(tangent_type), intent(in) :: self
   !> Displacements, shape (n) [length]
   real(wp), contiguous, intent(in) :: x(:)
   !> Forces, to which these are added, shape (n) [force]
   real(wp), contiguous, intent(inout) :: y(:)
   !> Change of volume by the polynomials of each group, B u, shape (1 + nd, groups)
   real(wp), intent(inout) :: volume(:, :)
   !> Pressures of the same shape; without them K B u
   real(wp), intent(in), optional :: pressure(:, :)
   real(wp), allocatable :: force(:, :)
   integer :: g, nd

   nd = self%block
   !$omp parallel do default(none) schedule(static, 1) ordered private(g, force) &
   !$omp shared(self, x, y, volume, pressure, nd)
   do g = 1, size(self%bulk)
      associate (member => self%gradient%member(self%gradient%member_start(g) + 1: &
         & self%gradient%member_start(g + 1)))
         if (present(pressure)) then
            call group_force(self, g, member, reshape(x, [nd, size(x)/nd]), volume(:, g), force, &
               & pressure(:, g))
         else
            call group_force(self, g, member, reshape(x, [nd, size(x)/nd]), volume(:, g), force)
         end if
         !$omp ordered
         call add_forces(member, force, y)
         !$omp end ordered
      end associate
   end do
   !$omp end parallel do
end subroutine add_groups

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
pure subroutine group_force(self, g, member, x, volume, force, pressure)
   !> Tangent
   class(tangent_type), intent(in) :: self
   !> Group
   integer, intent(in) :: g
   !> Its source points
   integer, intent(in) :: member(:)
   !> Displacements of all source points, shape (nd, ns) [length]
   real(wp), intent(in) :: x(:, :)
   !> B u of the group, shape (1 + nd)
   real(wp), intent(out) :: volume(:)
   !> Forces on its source points, shape (nd, members) [force]
   real(wp), allocatable, intent(inout) :: force(:, :)
   !> Pressures, shape (1 + nd); without them K B u
   real(wp), intent(in), optional :: pressure(:)
   real(wp), allocatable :: local(:, :), h(:, :, :)
   real(wp) :: p(3, 3), coefficient(size(volume))
   integer :: b, i, k, m, n, nd, o, q
   integer(i8) :: e

   nd = self%block
   o = self%cells%first(g)
   n = self%cells%first(g + 1) - o
   b = self%pressure%count(g)
   allocate (local(nd, size(member)), h(nd, nd, n))
   local = x(:, member)
   volume = 0.0_wp
   do q = 1, n
      call self%gradient%at(o + q, local, 0.0_wp, h(:, :, q))
      volume(:b) = volume(:b) + sum(self%cofactor(:nd, :nd, o + q)*h(:, :, q)) &
         & *self%pressure%basis(:b, o + q)
   end do
   coefficient = self%bulk(g)*volume
   if (present(pressure)) coefficient = pressure
   if (allocated(force)) deallocate (force)
   allocate (force(nd, size(member)), source=0.0_wp)
   do q = 1, n
      p = dot_product(coefficient(:b), self%pressure%basis(:b, o + q))*self%cofactor(:, :, o + q)
      do k = 1, nd
         do i = 1, nd
            p(:nd, :nd) = p(:nd, :nd) + self%moduli(:nd, :nd, i, k, o + q)*h(i, k, q)
         end do
      end do
      do e = self%gradient%start(o + q) + 1, self%gradient%start(o + q + 1)
         m = int(e - self%gradient%start(o + q))
         do i = 1, nd
            force(i, self%gradient%local(e)) = force(i, self%gradient%local(e)) &
               & + dot_product(p(i, :nd), self%gradient%value(:, self%gradient%first(i, o + q) + m))
         end do
      end do
   end do
end subroutine group_force

!> All entries, both triangles
subroutine dense(self, a)
   !> Tangent
   class(tangent_type), intent(in) :: self
   !> Entries, shape (n, n)
   real(wp), contiguous, intent(inout) :: a(:, :)
   real(wp) :: unit(self%n)
   integer :: j

   unit = 0.0_wp
   do j = 1, self%n
      unit(j) = 1.0_wp
      call self%apply(unit, a(:, j))
      unit(j) = 0.0_wp
   end do
end subroutine dense

!> Solve with the tangent, plus a shift times its diagonal or the Laplacian's
recursive subroutine solve_square(self, shift, b, x, report, error)
   !> Tangent
   class(tangent_type), target, intent(in) :: self
   !> Damping in units of the diagonal, >= 0 [-]
   real(wp), intent(in) :: shift
   !> Right hand side, shape (n)
   real(wp), contiguous, intent(in) :: b(:)
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> What was used and how good it is
   type(square_report), intent(out) :: report
   !> Error handling: singular matrix, no memory, no convergence
   type(error_type), allocatable, intent(out) :: error
   type(saddle_type) :: saddle
   real(wp), allocatable :: both(:), image(:)

   if (self%formed) then
      call self%symmetric_matrix%solve_square(shift, b, x, report, error)
      return
   end if
   saddle%tangent => self
   saddle%shift = shift
   saddle%size = self%n + size(self%pressure%total)
   allocate (both(saddle%size), image(self%n))
   call minres(saddle, [b, spread(0.0_wp, 1, saddle%size - self%n)], tolerance, most, both, &
      & report%iterations, report%backward_error)
   x = both(:self%n)
   report%used = 'minres'
   report%why = 'a factor of '//to_text(self%n)//' unknowns is large: minimal residuals with ' &
      & //'displacements and pressures, the tangent is not formed'
   if (.not. report%backward_error <= sqrt(tolerance)) call fatal_error(error, err_linalg, &
      & 'minimal residuals reached '//to_text(report%backward_error, 2)//' in ' &
      & //to_text(report%iterations)//' iterations')
end subroutine solve_square

!> Displacement and pressure rows
subroutine multiply(self, x, y)
   !> System
   class(saddle_type), intent(in) :: self
   !> Displacements [length], then pressures, shape (size)
   real(wp), contiguous, intent(in) :: x(:)
   !> Product, shape (size)
   real(wp), contiguous, intent(inout) :: y(:)
   real(wp), allocatable :: volume(:, :), pressure(:, :)
   integer :: g

   associate (tangent => self%tangent, n => self%tangent%n)
      pressure = reshape(x(n + 1:), shape(tangent%pressure%total))
      allocate (volume, mold=pressure)
      call tangent%product(tangent%value, x(:n), y(:n))
      call add_groups(tangent, x(:n), y(:n), volume, pressure)
      if (self%shift > 0.0_wp) y(:n) = y(:n) + self%shift*x(:n) &
         & *reshape(tangent%diagonal, [n])
      do g = 1, size(volume, 2)
         associate (b => tangent%pressure%count(g))
            volume(:b, g) = volume(:b, g) - pressure(:b, g)/tangent%bulk(g)
            ! polynomials that a small group does not have
            volume(b + 1:, g) = pressure(b + 1:, g)
         end associate
      end do
      y(n + 1:) = reshape(volume, [size(volume)])
   end associate
end subroutine multiply

!> Laplacian for each component, shear modulus for the pressures
subroutine precondition(self, x, y)
   !> System
   class(saddle_type), intent(in) :: self
   !> Vector, shape (size)
   real(wp), contiguous, intent(in) :: x(:)
   !> Product, shape (size)
   real(wp), contiguous, intent(inout) :: y(:)
   real(wp), allocatable :: component(:)
   integer :: g, i, nd, rows

   associate (tangent => self%tangent, n => self%tangent%n)
      nd = tangent%block
      do i = 1, nd
         component = x(i:n:nd)
         call tangent%laplacian(i)%solve(component)
         y(i:n:nd) = component
      end do
      rows = size(tangent%pressure%total, 1)
      do g = 1, size(tangent%bulk)
         associate (first => n + rows*(g - 1) + 1, last => n + rows*g)
            y(first:last) = x(first:last)/(1.0_wp/tangent%shear(g) + 1.0_wp/tangent%bulk(g))
         end associate
      end do
   end associate
end subroutine precondition

!> Give the factors back
subroutine free_laplacian(self)
   !> Tangent
   type(tangent_type), intent(inout) :: self
   integer :: i

   if (.not. allocated(self%laplacian)) return
   do i = 1, size(self%laplacian)
      call self%laplacian(i)%free()
   end do
end subroutine free_laplacian

end module rk_tangent
