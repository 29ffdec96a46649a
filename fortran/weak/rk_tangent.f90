!> Tangent of the Galerkin form: a sparse matrix solved directly or, where its factor would not fit,
!> never formed and solved by minimal residuals.
!>
!> The factor of a coupled solid grows like n^(4/3) with n unknowns and the whole patch of a group
!> couples. Without forming it, the tangent is A + B^T K B with the stiffness A at constant volume
!> and one row of B for each pressure. With the pressures as unknowns,
!>
!>     (A + B^T k B) u + B^T p = f,   B u - p/(K - k) = 0,
!>
!> nothing of the size of K is left. The part k of K stays with the displacements, since A alone
!> need not resist a change of volume: the invariants of most laws are not isochoric, and their
!> longitudinal stiffness is negative in table 4.1 of the thesis. Pressures are preconditioned by
!> that part k, displacements as rk_preconditioner says. The number of iterations then does not
!> grow with the number of points, given groups of cells that satisfy the inf-sup condition.
!>
!> Reference: Elman, Silvester, Wathen, Finite Elements and Fast Iterative Solvers, Oxford (2014),
!>            section 4.2, doi:10.1093/acprof:oso/9780199678792.001.0001
module rk_tangent
   use rk_cells, only : cells_type
   use rk_csr, only : csr_type, joined
   use rk_error, only : error_type, fatal_error, err_input, err_linalg
   use rk_gradient, only : gradient_type
   use rk_minres, only : minres, symmetric_system
   use rk_multiplier, only : multiplier_type
   use rk_operator, only : square_report
   use rk_precision, only : i8, wp
   use rk_preconditioner, only : new_preconditioner, preconditioner_type
   use rk_pressure, only : pressure_type
   use rk_shape, only : shape_type
   use rk_symmetric, only : new_symmetric, symmetric_matrix
   use rk_text, only : to_text
   use rk_weak_conditions, only : surface_type
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
      real(wp), allocatable, private :: shear(:)
      !> Points, gradients and pressures of the problem
      type(cells_type), pointer :: cells => null()
      type(gradient_type), pointer :: gradient => null()
      type(pressure_type), pointer :: pressure => null()
      type(multiplier_type), pointer :: multiplier => null()
      !> For the displacements
      type(preconditioner_type), private :: preconditioner
   contains
      procedure :: apply
      procedure :: apply_transposed
      procedure :: dense
      procedure :: solve_square
   end type tangent_type

   !> Displacements and pressures
   type, extends(symmetric_system) :: saddle_type
      type(tangent_type), pointer :: tangent => null()
      !> Damping in units of the preconditioner's diagonal [-]
      real(wp) :: shift = 0.0_wp
   contains
      procedure :: multiply
      procedure :: precondition
   end type saddle_type

   !> Part of the bulk modulus that stays with the displacements, in shear moduli; never more than
   !> half of it
   real(wp), parameter :: kept = 2.0_wp
   !> Residual of a solve: that of the displacement form is K over the shear modulus larger
   real(wp), parameter :: tolerance = 1.0e-7_wp
   !> Residual of a solve that ran out of iterations and still makes a step worth taking
   real(wp), parameter :: acceptable = 1.0e-3_wp
   !> Iterations of a solve
   integer, parameter :: most = 3000

contains

!> Set up the places of the entries and, where it is not formed, the preconditioner
subroutine new_tangent(self, ns, cells, gradient, multiplier, surface, inside, held, shear, limit, &
   & error)
   !> Tangent
   type(tangent_type), intent(inout) :: self
   !> Source points and plates
   integer, intent(in) :: ns
   !> Integration points
   type(cells_type), intent(in) :: cells
   !> Gradients there
   type(gradient_type), intent(in) :: gradient
   !> Pressures that are unknowns
   type(multiplier_type), intent(in) :: multiplier
   !> Conditions on the surface
   type(surface_type), intent(in) :: surface
   !> Shape functions at the integration points
   type(shape_type), intent(in) :: inside
   !> Source points that cover each held one
   type(csr_type), intent(in) :: held
   !> Shear modulus at each point, shape (np) [stress]
   real(wp), intent(in) :: shear(:)
   !> Unknowns up to which it is formed
   integer, intent(in) :: limit
   !> Error handling: no memory, no SuiteSparse, held points without a factor
   type(error_type), allocatable, intent(out) :: error
   integer :: g

   self%formed = .not. cells%smoothed .or. gradient%nd*ns <= limit
   self%keeps = size(held%offset) > 1
   if (self%keeps .and. .not. self%formed) then
      call fatal_error(error, err_input, 'galerkin.essential = "transformation" needs a tangent ' &
         & //'that is factorised: take galerkin.direct_limit = '//to_text(gradient%nd*ns) &
         & //' where memory allows, or galerkin.essential = "penalty"')
      return
   end if
   if (self%formed) then
      call new_symmetric(self%symmetric_matrix, gradient%nd, ns + multiplier%extra, &
         & joined(gradient%member, held))
      self%indefinite = multiplier%extra > 0
      return
   end if
   ! only what never changes: penalty and stabilisation
   call new_symmetric(self%symmetric_matrix, gradient%nd, ns, joined(inside%neighbour, &
      & surface%plates%coupled(surface%shape%neighbour)))
   allocate (self%moduli(3, 3, 3, 3, size(shear)), self%cofactor(3, 3, size(shear)))
   allocate (self%bulk(size(cells%first) - 1), self%shear(size(cells%first) - 1))
   do g = 1, size(self%shear)
      associate (first => cells%first(g) + 1, last => cells%first(g + 1))
         self%shear(g) = dot_product(cells%weight(first:last), shear(first:last)) &
            & /sum(cells%weight(first:last))
      end associate
   end do
   call new_preconditioner(self%preconditioner, cells, surface, inside, shear, error)
end subroutine new_tangent

!> y = K u with all of the tangent
subroutine apply(self, x, y)
   !> Tangent
   class(tangent_type), intent(in) :: self
   !> Vector, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Product, shape (n)
   real(wp), contiguous, intent(inout) :: y(:)
   real(wp) :: volume(size(self%pressure%total, 1), size(self%pressure%total, 2))

   y = 0.0_wp
   call self%product(self%value, x(:self%n), y(:self%n))
   if (.not. self%formed) call add_groups(self, x, y, volume)
   call self%add_skew(1.0_wp, x, y)
end subroutine apply

!> y = K^T u
subroutine apply_transposed(self, x, y)
   !> Tangent
   class(tangent_type), intent(in) :: self
   !> Vector, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Product, shape (n)
   real(wp), contiguous, intent(inout) :: y(:)

   call self%apply(x, y)
   call self%add_skew(-2.0_wp, x, y)
end subroutine apply_transposed

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
      associate (member => self%gradient%member%index(self%gradient%member%offset(g) + 1: &
         & self%gradient%member%offset(g + 1)))
         if (present(pressure)) then
            call group_force(self, g, pack(member, member <= self%n/nd), x, volume(:, g), force, &
               & pressure(:, g))
         else
            call group_force(self, g, member, x, volume(:, g), force)
         end if
         !$omp ordered
         call add_forces(member(:size(force, 2)), force, y)
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
   !> Displacements of all source points [length]
   real(wp), intent(in) :: x(self%block, *)
   !> B u of the group, shape (1 + nd)
   real(wp), intent(out) :: volume(:)
   !> Forces on its source points, shape (nd, members) [force]
   real(wp), allocatable, intent(inout) :: force(:, :)
   !> Pressures, shape (1 + nd), beside those of the part of K that is kept; without them K B u
   real(wp), intent(in), optional :: pressure(:)
   real(wp), allocatable :: local(:, :), h(:, :, :)
   real(wp) :: p(3, 3), coefficient(size(volume))
   integer :: b, i, k, n, nd, o, q

   nd = self%block
   o = self%cells%first(g)
   n = self%cells%first(g + 1) - o
   b = self%pressure%count(g)
   allocate (local(nd, size(member)), h(nd, nd, n))
   local = x(:, member)
   volume = 0.0_wp
   do q = 1, n
      call self%gradient%at(o + q, local, [real(wp) ::], h(:, :, q))
      volume(:b) = volume(:b) + sum(self%cofactor(:nd, :nd, o + q)*h(:, :, q)) &
         & *self%pressure%basis(:b, o + q)
   end do
   if (present(pressure)) then
      coefficient = kept_part(self, g)*volume + pressure
   else if (self%multiplier%free(g)) then
      coefficient = self%multiplier%pressure(g, local)
   else
      coefficient = self%bulk(g)*volume
   end if
   if (allocated(force)) deallocate (force)
   allocate (force(nd, size(member)), source=0.0_wp)
   do q = 1, n
      p = dot_product(coefficient(:b), self%pressure%basis(:b, o + q))*self%cofactor(:, :, o + q)
      do k = 1, nd
         do i = 1, nd
            p(:nd, :nd) = p(:nd, :nd) + self%moduli(:nd, :nd, i, k, o + q)*h(i, k, q)
         end do
      end do
      call self%gradient%add_force(o + q, p, force)
   end do
   if (self%multiplier%free(g) .and. .not. present(pressure)) &
      & call self%multiplier%set_rows(g, volume(:b), force)
end subroutine group_force

!> All entries, both triangles
subroutine dense(self, a)
   !> Tangent
   class(tangent_type), intent(in) :: self
   !> Entries, shape (n, n)
   real(wp), contiguous, intent(inout) :: a(:, :)
   real(wp) :: unit(size(a, 1))
   integer :: j

   unit = 0.0_wp
   do j = 1, size(unit)
      unit(j) = 1.0_wp
      call self%apply(unit, a(:, j))
      unit(j) = 0.0_wp
   end do
end subroutine dense

!> Solve with the tangent, plus a shift times its diagonal or the preconditioner's
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
   integer :: g
   real(wp), allocatable :: both(:), right(:), volume(:, :), pressure(:, :)

   if (self%formed) then
      call self%symmetric_matrix%solve_square(shift, b, x, report, error)
      return
   end if
   saddle%tangent => self
   saddle%shift = shift
   saddle%size = self%n + size(self%pressure%total)
   allocate (both(saddle%size), right(saddle%size), source=0.0_wp)
   right(:self%n) = b(:self%n)
   if (self%multiplier%extra > 0) then
      allocate (pressure, volume, mold=self%pressure%total)
      call self%multiplier%from_rows(b(self%n + 1:), pressure)
      right(self%n + 1:) = reshape(pressure, [size(pressure)])
      ! the part of K that is kept with the displacements acts on the prescribed volume as well
      do g = 1, size(self%bulk)
         pressure(:, g) = kept_part(self, g)*pressure(:, g)
      end do
      call add_groups(self, 0.0_wp*right(:self%n), right(:self%n), volume, pressure)
   end if
   call minres(saddle, right, tolerance, most, both, report%iterations, report%backward_error)
   x(:self%n) = both(:self%n)
   if (self%multiplier%extra > 0) call self%multiplier%to_unknowns(reshape(both(self%n + 1:), &
      & shape(pressure)), x(self%n + 1:))
   report%used = 'minres'
   report%why = 'a factor of '//to_text(self%n)//' unknowns is large: minimal residuals with ' &
      & //'displacements and pressures, the tangent is not formed'
   if (.not. report%backward_error <= acceptable) call fatal_error(error, err_linalg, &
      & 'minimal residuals reached '//to_text(report%backward_error, 2)//' in ' &
      & //to_text(report%iterations)//' iterations: take galerkin.stabilisation = 1, ' &
      & //'galerkin.penalty = 10, smaller load steps, or a galerkin.direct_limit of ' &
      & //to_text(self%n)//' where memory allows')
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
         & *[tangent%preconditioner%diagonal, of_plates(tangent)]
      do g = 1, size(volume, 2)
         associate (b => tangent%pressure%count(g))
            volume(:b, g) = volume(:b, g) - pressure(:b, g) &
               & /(tangent%bulk(g) - kept_part(tangent, g))
            ! polynomials that a small group does not have
            volume(b + 1:, g) = pressure(b + 1:, g)
         end associate
      end do
      y(n + 1:) = reshape(volume, [size(volume)])
   end associate
end subroutine multiply

!> Displacements, then pressures
subroutine precondition(self, x, y)
   !> System
   class(saddle_type), intent(in) :: self
   !> Vector, shape (size)
   real(wp), contiguous, intent(in) :: x(:)
   !> Product, shape (size)
   real(wp), contiguous, intent(inout) :: y(:)
   integer :: g, own, rows

   associate (tangent => self%tangent, n => self%tangent%n)
      own = size(tangent%preconditioner%diagonal)
      call tangent%preconditioner%apply(x(:own), y(:own))
      ! a penalty couples a plate with its set: a single eigenvalue is left far below the others
      y(own + 1:n) = x(own + 1:n)/of_plates(tangent)
      rows = size(tangent%pressure%total, 1)
      do g = 1, size(tangent%bulk)
         associate (first => n + rows*(g - 1) + 1, last => n + rows*g, &
            & part => kept_part(tangent, g))
            y(first:last) = x(first:last)/(1.0_wp/part + 1.0_wp/(tangent%bulk(g) - part))
         end associate
      end do
   end associate
end subroutine precondition

!> Diagonal of the unknowns of plates, which stand behind those of the source points [force/length]
pure function of_plates(self) result(diagonal)
   !> Tangent
   class(tangent_type), intent(in) :: self
   real(wp) :: diagonal(self%n - size(self%preconditioner%diagonal))
   integer :: k

   do k = 1, size(diagonal)
      diagonal(k) = self%value(self%start(size(self%preconditioner%diagonal) + k + 1))
   end do
end function of_plates

!> Part of a group's bulk modulus that stays with the displacements
pure real(wp) function kept_part(self, g)
   !> Tangent
   class(tangent_type), intent(in) :: self
   !> Group
   integer, intent(in) :: g

   kept_part = min(kept*self%shear(g), 0.5_wp*self%bulk(g))
end function kept_part

end module rk_tangent
