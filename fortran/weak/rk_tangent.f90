!> Tangent of the Galerkin form: a sparse matrix solved directly or, where its factor would not fit,
!> matrix-free and solved by minimal residuals.
!>
!> The factor of a coupled solid grows like n^(4/3) with n unknowns, and the whole patch of a group
!> is coupled. The tangent that is not formed is A + B^T K B with the stiffness A at constant volume
!> and one row of B for each pressure. With the pressures as unknowns,
!>
!>     (A + B^T k B) u + B^T p = f,   B u - p/(K - k) = 0,
!>
!> no coefficient of the size of K is left. The part k of K stays with the displacements, since A
!> alone need not resist a change of volume: the invariants of most laws are not isochoric, and
!> their longitudinal stiffness is negative in table 4.1 of the thesis. Pressures are preconditioned
!> by that part k, displacements by rk_preconditioner. The number of iterations then does not grow
!> with the number of points, given groups of cells that satisfy the inf-sup condition.
!>
!> Newton steps are solved only as accurately as the iteration needs, and the volume error they
!> leave must not return as a force K times as large. The pressures of such a solve are therefore
!> carried to the next place: its tangent uses them, and its solve starts from them.
!>
!> Reference: Elman, Silvester, Wathen, Finite Elements and Fast Iterative Solvers, Oxford (2014),
!>            section 4.2, doi:10.1093/acprof:oso/9780199678792.001.0001;
!>            Eisenstat, Walker, SIAM J. Sci. Comput. 17 (1996), doi:10.1137/0917003 (choice 2)
module rk_tangent
   use rk_carried_pressure, only : carried_pressure, new_carried_pressure
   use rk_cells, only : cells_type
   use rk_corners, only : has_corners
   use rk_csr, only : csr_type, joined
   use rk_error, only : error_type, fatal_error, err_input, err_linalg
   use rk_gradient, only : gradient_type
   use rk_group_stiffness, only : group_stiffness, new_group_stiffness
   use rk_minres, only : minres, symmetric_system
   use rk_multiplier, only : multiplier_type
   use rk_operator, only : square_report
   use rk_precision, only : i8, wp
   use rk_preconditioner, only : new_preconditioner, preconditioner_type
   use rk_scene, only : scene_type
   use rk_shape, only : shape_type
   use rk_sparse_rows, only : new_sparse_rows, sparse_rows
   use rk_stabilisation, only : stabilise
   use rk_symmetric, only : new_symmetric, symmetric_matrix
   use rk_text, only : to_text
   use rk_weak_conditions, only : surface_type
   implicit none
   private

   public :: tangent_type, new_tangent

   !> Tangent; the matrix is the whole tangent where it is formed, otherwise the part of supports on
   !> the surface, with that of follower pressures in the linearisation
   type, extends(symmetric_matrix) :: tangent_type
      !> The matrix is the whole tangent
      logical :: formed = .true.
      !> Stiffness of the groups where it is not formed
      type(group_stiffness) :: groups
      !> Stabilisation of a component by source points, where the tangent is not formed
      type(sparse_rows), private :: stabilising
      !> Tolerance of Newton's iteration, whose solves need no higher accuracy [-]
      real(wp) :: wanted = 0.0_wp
      !> Pressures carried from one solve to the next where it is not formed
      type(carried_pressure) :: pressures
      !> Norms of the right hand side at the last converged state and of the last solve in this load
      !> step, 0 before
      real(wp), private :: first = 0.0_wp, last = 0.0_wp
      !> Preconditioner of the displacements
      type(preconditioner_type), private :: preconditioner
   contains
      procedure :: forget, measure, keep_group, complete, add_stabilisation, apply, solve_square
   end type tangent_type

   !> Displacements and pressures
   type, extends(symmetric_system) :: saddle_type
      type(tangent_type), pointer :: tangent => null()
      !> Damping in units of the preconditioner's diagonal [-]
      real(wp) :: shift = 0.0_wp
   contains
      procedure :: multiply, precondition
   end type saddle_type

   !> Residual of a solve: that of the displacement form is larger by K over the shear modulus
   real(wp), parameter :: tolerance = 1.0e-7_wp
   !> Residual of the first solve of a load step, relative to that of the last converged state, and
   !> the largest one of all solves
   real(wp), parameter :: first_share = 1.0e-2_wp, largest_share = 0.1_wp
   !> Share of its own right hand side that the first solve leaves, however near the load step
   !> begins: the nonlinear part leaves as much [-]
   real(wp), parameter :: first_least = 1.0e-3_wp
   !> Share of the squared ratio of right hand sides that the next solve leaves; and share of the
   !> tolerance, which must also hold for the residual of the displacement form
   real(wp), parameter :: forcing = 0.9_wp, enough = 1.0e-2_wp
   !> Residual up to which the step of a solve that ran out of iterations is still taken
   real(wp), parameter :: acceptable = 1.0e-3_wp
   !> Largest number of iterations of a solve
   integer, parameter :: most = 3000

contains

!> Set up the places of the entries and, where it is not formed, the preconditioner
subroutine new_tangent(self, scene, ns, cells, gradient, multiplier, surface, inside, shear, &
   & error)
   type(tangent_type), intent(inout) :: self
   type(scene_type), intent(in) :: scene
   !> Source points and plates
   integer, intent(in) :: ns
   type(cells_type), intent(in) :: cells
   type(gradient_type), intent(in) :: gradient
   !> Pressures that are unknowns
   type(multiplier_type), intent(in) :: multiplier
   !> Conditions on the surface
   type(surface_type), intent(in) :: surface
   !> Shape functions at the integration points
   type(shape_type), intent(in) :: inside
   !> Shear modulus at each point, shape (np) [stress]
   real(wp), intent(in) :: shear(:)
   !> Error handling: no memory, constraints at source points without a factor
   type(error_type), allocatable, intent(out) :: error
   integer :: k

   self%formed = gradient%nd*ns <= scene%galerkin%direct_limit
   if (.not. cells%smoothed) self%formed = self%formed .or. allocated(scene%equation%problem) &
      & .or. allocated(scene%motion) .or. .not. has_corners(scene%cloud)
   if (scene%galerkin%essential == 'transformation' .and. .not. self%formed) then
      call fatal_error(error, err_input, 'galerkin.essential = "transformation" needs a tangent ' &
         & //'that is factorised: use galerkin.direct_limit = '//to_text(gradient%nd*ns) &
         & //' where memory allows, or galerkin.essential = "penalty"')
      return
   end if
   if (self%formed) then
      call new_symmetric(self%symmetric_matrix, gradient%fields, ns + multiplier%extra, &
         & gradient%member, scene%cloud%source)
      self%indefinite = multiplier%extra > 0
      self%once = allocated(scene%equation%problem)
      return
   end if
   ! a diagonal entry for all
   call new_symmetric(self%symmetric_matrix, gradient%nd, ns, joined(csr_type( &
      & [(int(k, i8), k=0, ns)], [(k, k=1, ns)]), surface%coupled()))
   call new_group_stiffness(self%groups, cells, shear)
   call new_carried_pressure(self%pressures, 1 + gradient%nd, size(self%groups%bulk))
   call new_preconditioner(self%preconditioner, scene, cells, surface, inside, shear, error)
end subroutine new_tangent

!> Begin a load step: nothing is carried from the last one
subroutine forget(self)
   class(tangent_type), intent(inout) :: self

   self%first = 0.0_wp
   self%last = 0.0_wp
   call self%pressures%forget()
   ! a load step must not depend on whether earlier ones were done by this run or another
   call self%let_go()
end subroutine forget

!> Keep the linearisation of a group
subroutine keep_group(self, g, bulk, moduli, pressure, jump)
   !> Tangent, which is not formed
   class(tangent_type), intent(inout) :: self
   !> Group
   integer, intent(in) :: g
   !> Its bulk modulus [stress]
   real(wp), intent(in) :: bulk
   !> Moduli C4(i, A, j, B) of its points, times weight, shape (3, 3, 3, 3, n) [stress length^nd]
   real(wp), intent(in) :: moduli(:, :, :, :, :)
   !> Coefficients of its pressure, shape (1 + nd) [stress length^(nd/2)]
   real(wp), intent(in) :: pressure(:)
   !> Jump of its volume by the polynomials, of which the residual has the pressure, shape (1 + nd)
   !> [length^(nd/2)]
   real(wp), intent(in) :: jump(:)

   self%groups%bulk(g) = bulk
   self%groups%moduli(:, :, :, :, self%groups%cells%first(g) + 1:self%groups%cells%first(g + 1)) &
      & = moduli
   self%pressures%present(:, g) = pressure
   if (.not. self%groups%multiplier%free(g)) self%pressures%present(:, g) = pressure + bulk*jump
   if (.not. self%pressures%carrying) self%pressures%carried(:, g) = pressure
end subroutine keep_group

!> Complete the constant part, which has the supports: stabilise nodal cells in it, or in separate
!> rows where the tangent is not formed
subroutine complete(self, cells, inside, modulus)
   !> Tangent, whose entries are those of the supports
   class(tangent_type), intent(inout) :: self
   type(cells_type), intent(in) :: cells
   !> Shape functions at their points
   type(shape_type), target, intent(in) :: inside
   !> Modulus of the stabilisation of each cell, shape (np) [stress]
   real(wp), intent(in) :: modulus(:)
   type(symmetric_matrix) :: component
   integer(i8), allocatable :: start(:), column(:)
   real(wp), allocatable :: value(:)

   if (self%formed) then
      if (cells%smoothed) call stabilise(self%symmetric_matrix, self%value, cells, inside, &
         & modulus)
      return
   end if
   if (.not. cells%smoothed) return
   call new_symmetric(component, 1, maxval(cells%node), inside%neighbour)
   call stabilise(component, component%value, cells, inside, modulus)
   call component%compressed(start, column, value)
   call new_sparse_rows(self%stabilising, start, column, value)
end subroutine complete

!> Add the product of the stabilisation of a tangent that is not formed with a vector
subroutine add_stabilisation(self, x, y)
   class(tangent_type), intent(in) :: self
   !> Displacements, shape (n) [length]
   real(wp), contiguous, target, intent(in) :: x(:)
   !> Forces, shape (n) [force]
   real(wp), contiguous, target, intent(inout) :: y(:)
   real(wp), pointer, contiguous :: to(:, :), from(:, :)
   integer :: nd, ns

   if (.not. allocated(self%stabilising%value)) return
   nd = self%block
   ns = size(self%stabilising%place%offset) - 1
   from(1:nd, 1:ns) => x(:nd*ns)
   to(1:nd, 1:ns) => y(:nd*ns)
   call self%stabilising%product(from, to, .true.)
end subroutine add_stabilisation

!> y = K u with all of the tangent
subroutine apply(self, x, y)
   class(tangent_type), intent(in) :: self
   !> Vector, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Product, shape (n)
   real(wp), contiguous, intent(inout) :: y(:)
   real(wp), allocatable :: volume(:, :)

   y = 0.0_wp
   if (self%formed) then
      call self%product(self%value, x, y)
   else
      call self%product(self%value, x(:self%n), y(:self%n))
      call self%add_stabilisation(x(:self%n), y(:self%n))
      allocate (volume, mold=self%groups%pressure%total)
      call self%groups%add_product(x, y, volume)
   end if
   call self%add_skew(1.0_wp, x, y)
end subroutine apply

!> Newton step, solved as accurately as the iteration needs
recursive subroutine solve_square(self, shift, b, x, report, error)
   class(tangent_type), target, intent(inout) :: self
   real(wp), intent(in) :: shift
   real(wp), contiguous, intent(in) :: b(:)
   !> Step, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   type(square_report), intent(out) :: report
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: both(:), right(:), start(:), gained(:, :)
   real(wp) :: norm, share
   integer :: g

   if (self%formed) then
      call self%symmetric_matrix%solve_square(shift, b, x, report, error)
      return
   end if
   call begin_solve(self, shift, b, right, start, norm)
   if (.not. self%first > 0.0_wp) self%first = norm
   share = max(first_share*norm/self%first, first_least)
   if (self%last > 0.0_wp) share = forcing*(norm/self%last)**2
   share = max(min(max(share, enough*self%wanted*self%first/norm), largest_share), tolerance)
   allocate (both(size(right)), source=0.0_wp)
   call solve_saddle(self, shift, share, right, both, report, error)
   ! nothing is carried from a solve that failed
   if (allocated(error)) return
   self%last = norm
   both = both + start
   call self%groups%join(self%n, both, x)
   allocate (gained, mold=self%pressures%present)
   do g = 1, size(self%groups%bulk)
      gained(:, g) = both(places(self, g))
      if (.not. self%groups%multiplier%free(g)) gained(:, g) = gained(:, g)/self%groups%beside(g)
   end do
   call self%pressures%note(x, gained)
end subroutine solve_square

!> Size of a right hand side in the norm of the preconditioner, with the carried pressures in place
!> of those of the volume; solves are relative to the first one of a load step
subroutine measure(self, b, norm)
   !> Tangent, which is not formed
   class(tangent_type), target, intent(inout) :: self
   !> Right hand side, shape (n)
   real(wp), contiguous, intent(in) :: b(:)
   !> Its size
   real(wp), intent(out) :: norm
   real(wp), allocatable :: right(:), start(:)

   call begin_solve(self, 0.0_wp, b, right, start, norm)
   if (.not. self%first > 0.0_wp) self%first = norm
end subroutine measure

!> Right hand side that remains with the pressures from which its solve starts
subroutine begin_solve(self, shift, b, right, start, norm)
   class(tangent_type), target, intent(in) :: self
   !> Damping in units of the diagonal, >= 0 [-]
   real(wp), intent(in) :: shift
   !> Right hand side, shape (n)
   real(wp), contiguous, intent(in) :: b(:)
   !> That of displacements and pressures, and these at the start
   real(wp), allocatable, intent(out) :: right(:), start(:)
   !> Norm of the right hand side by the preconditioner, > 0
   real(wp), intent(out) :: norm
   type(saddle_type) :: saddle
   real(wp), allocatable :: image(:)
   integer :: g

   call self%groups%split(self%n, b, right)
   allocate (start(size(right)), source=0.0_wp)
   allocate (image, mold=right)
   do g = 1, size(self%groups%bulk)
      if (.not. self%groups%multiplier%free(g)) start(places(self, g)) = self%groups%beside(g) &
         & *(self%pressures%carried(:, g) - self%pressures%present(:, g))
   end do
   saddle%tangent => self
   saddle%shift = shift
   saddle%size = size(right)
   if (any(abs(start) > 0.0_wp)) then
      call saddle%multiply(start, image)
      right = right - image
   end if
   call saddle%precondition(right, image)
   norm = sqrt(max(dot_product(image, right), tiny(1.0_wp)))
end subroutine begin_solve

!> Minimal residuals with displacements and pressures
subroutine solve_saddle(self, shift, share, right, both, report, error)
   class(tangent_type), target, intent(in) :: self
   !> Damping in units of the diagonal, >= 0 [-]
   real(wp), intent(in) :: shift
   !> Residual that may be left, relative to the right hand side [-]
   real(wp), intent(in) :: share
   !> Right hand side
   real(wp), contiguous, intent(in) :: right(:)
   !> Displacements and pressures
   real(wp), contiguous, intent(inout) :: both(:)
   !> Report on the solver and its accuracy
   type(square_report), intent(out) :: report
   !> Error handling: no convergence
   type(error_type), allocatable, intent(out) :: error
   type(saddle_type) :: saddle

   saddle%tangent => self
   saddle%shift = shift
   saddle%size = size(right)
   call minres(saddle, right, share, most, both, report%iterations, report%backward_error)
   report%used = 'minres'
   report%why = 'a factor of '//to_text(self%n)//' unknowns is large: minimal residuals with ' &
      & //'displacements and pressures, the tangent is not formed'
   if (.not. report%backward_error <= max(acceptable, share)) call fatal_error(error, err_linalg, &
      & 'minimal residuals reached '//to_text(report%backward_error, 2)//' in ' &
      & //to_text(report%iterations)//' iterations: use galerkin.penalty = 10, ' &
      & //'smaller load steps, or a galerkin.direct_limit of ' &
      & //to_text(self%n)//' where memory allows')
end subroutine solve_saddle

!> Indices of a group's pressures after the displacements
pure function places(self, g)
   class(tangent_type), intent(in) :: self
   !> Group
   integer, intent(in) :: g
   integer :: places(size(self%pressures%present, 1)), k

   places = [(self%n + size(places)*(g - 1) + k, k=1, size(places))]
end function places

!> Displacement and pressure rows
subroutine multiply(self, x, y)
   class(saddle_type), intent(in) :: self
   !> Displacements [length], then pressures, shape (size)
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)
   real(wp), allocatable :: volume(:, :), pressure(:, :)
   integer :: g

   associate (tangent => self%tangent, n => self%tangent%n)
      pressure = reshape(x(n + 1:), shape(tangent%groups%pressure%total))
      allocate (volume, mold=pressure)
      call tangent%product(tangent%value, x(:n), y(:n))
      call tangent%add_stabilisation(x(:n), y(:n))
      call tangent%groups%add_product(x(:n), y(:n), volume, pressure)
      if (self%shift > 0.0_wp) y(:n) = y(:n) + self%shift*x(:n) &
         & *[tangent%preconditioner%diagonal, of_plates(tangent)]
      do g = 1, size(volume, 2)
         associate (b => tangent%groups%pressure%count(g))
            volume(:b, g) = volume(:b, g) - pressure(:b, g) &
               & /(tangent%groups%bulk(g) - tangent%groups%kept(g))
            ! polynomials that a small group lacks
            volume(b + 1:, g) = pressure(b + 1:, g)
         end associate
      end do
      y(n + 1:) = reshape(volume, [size(volume)])
   end associate
end subroutine multiply

!> Displacements, then pressures
subroutine precondition(self, x, y)
   class(saddle_type), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)
   integer :: g, own, rows

   associate (tangent => self%tangent, n => self%tangent%n)
      own = size(tangent%preconditioner%diagonal)
      call tangent%preconditioner%apply(x(:own), y(:own))
      ! a penalty couples a plate with its set: a single eigenvalue remains far below the others
      y(own + 1:n) = x(own + 1:n)/of_plates(tangent)
      rows = size(tangent%groups%pressure%total, 1)
      do g = 1, size(tangent%groups%bulk)
         associate (first => n + rows*(g - 1) + 1, last => n + rows*g, &
            & part => tangent%groups%kept(g))
            y(first:last) = x(first:last)/(1.0_wp/part + 1.0_wp/(tangent%groups%bulk(g) - part))
         end associate
      end do
   end associate
end subroutine precondition

!> Diagonal of the unknowns of plates, which follow those of the source points [force/length]
pure function of_plates(self) result(diagonal)
   class(tangent_type), intent(in) :: self
   real(wp) :: diagonal(self%n - size(self%preconditioner%diagonal))
   integer :: k

   do k = 1, size(diagonal)
      diagonal(k) = self%value(self%start(size(self%preconditioner%diagonal) + k + 1))
   end do
end function of_plates

end module rk_tangent
