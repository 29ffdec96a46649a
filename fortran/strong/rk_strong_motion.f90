!> Motion of a body by collocation, (6.38)-(6.43): rows of mass inside, rows of the boundary at the
!> new time, solved in the least squares sense at each step by the pseudo-inverse.
!>
!> With displacement rows of weight (6.41b) the motion of a string grows by 4e-4 per step for time
!> steps of 0.2, and by 2e-2 for steps of 0.02; with a weight of 100 times the density, which is
!> "balanced" here, by less than 2e-7. The published weight is that of "ns-c4".
module rk_strong_motion
   use rk_equilibrium, only : equilibrium_problem
   use rk_error, only : error_type, fatal_error, err_memory
   use rk_lapack, only : svd
   use rk_motion, only : form_motion, loads_vary
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type
   use rk_spectrum, only : spectral_radius
   use rk_text, only : to_text
   implicit none
   private

   public :: strong_motion, new_strong_motion

   !> Most equations of the dense pseudo-inverse, and most unknowns for the stability limit
   integer, parameter :: most_rows = 5000, most_judged = 400
   !> Weight of displacement rows in densities; growth of a whole motion that counts as stable [-]
   real(wp), parameter :: heavy = 100.0_wp, harmless = 1.05_wp

   !> Body in motion
   type, extends(form_motion) :: strong_motion
      !> Problem with its rows
      type(equilibrium_problem), pointer :: problem => null()
      !> Rows of a time step, shape (m, n), and their pseudo-inverse, shape (n, m)
      real(wp), allocatable :: row(:, :), inverse(:, :)
      !> Density of each row inside, shape (rows inside)
      real(wp), allocatable :: density(:)
      !> Weight of each row on the boundary relative to that in the static problem, shape (m)
      real(wp), allocatable :: weight(:)
      !> Values of the fields at the rows' points, and rows of the operator, shape (m, n)
      real(wp), allocatable :: values(:, :), operator(:, :)
   contains
      procedure :: start, product, loads, solve, limit
   end type strong_motion

contains

!> Set up the motion of a problem
subroutine new_strong_motion(self, problem, error)
   type(strong_motion), intent(out) :: self
   type(equilibrium_problem), target, intent(inout) :: problem
   !> Error handling: too many rows for a dense matrix, a density that is not positive
   type(error_type), allocatable, intent(out) :: error
   real(wp), pointer, contiguous :: psi(:, :)
   integer, pointer, contiguous :: nodes(:)
   type(evaluation_type) :: seen
   real(wp) :: density, natural, modulus, side(problem%m)
   integer :: b, i, row

   self%problem => problem
   self%motion = problem%scene%motion
   self%n = problem%n
   self%m = problem%m
   self%varies = loads_vary(problem%scene)
   if (problem%m > most_rows) then
      call fatal_error(error, err_memory, 'motions by collocation take a dense matrix of at most ' &
         & //to_text(most_rows)//' rows, not '//to_text(problem%m)//': use method "rkpm-gauss"')
      return
   end if
   allocate (self%values(problem%m, self%n), self%operator(problem%m, self%n), source=0.0_wp)
   allocate (self%weight(problem%m), self%density(problem%m), source=1.0_wp)
   call problem%evaluate(spread(0.0_wp, 1, self%n), 0.0_wp, side, seen, tangent=.true.)
   call problem%rows%dense(self%operator)
   self%row = self%operator
   modulus = maxval(problem%mixture%pair)
   do b = 1, size(problem%rows%place)
      row = problem%rows%row(b)
      call self%motion%density_at(problem%scene%cloud%points(:, problem%rows%place(b)), density, &
         & error)
      if (allocated(error)) return
      self%density(row + 1:row + problem%fields) = density
      call problem%shape%row(problem%rows%place(b), nodes, psi)
      do i = 1, problem%fields
         self%values(row + i, problem%fields*(nodes - 1) + i) = psi(1, :)
         if (b <= problem%inside) then
            self%row(row + i, :) = density*self%values(row + i, :)
            cycle
         end if
         ! the rows have the weights of the static problem
         natural = heavy*density*problem%scene%cloud%mean_spacing()/modulus
         if (problem%boundary%essential(i, b - problem%inside)) then
            self%weight(row + i) = essential(density)/problem%scene%solver%weight_essential
         else
            self%weight(row + i) = natural/problem%scene%solver%weight_traction
         end if
         self%row(row + i, :) = self%weight(row + i)*self%operator(row + i, :)
      end do
   end do
   call invert(self%row, self%inverse, error)

contains

   !> Weight of a displacement row
   real(wp) function essential(density)
      real(wp), intent(in) :: density

      essential = heavy*density
      if (problem%scene%motion%published) essential = max(density, (self%motion%time_step &
         & *size(problem%scene%cloud%source, 2))**2)/size(problem%scene%cloud%source, 2)
   end function essential

end subroutine new_strong_motion

!> Pseudo-inverse by singular value decomposition
subroutine invert(a, inverse, error)
   !> Matrix, shape (m, n)
   real(wp), intent(in) :: a(:, :)
   !> Its pseudo-inverse, shape (n, m)
   real(wp), allocatable, intent(out) :: inverse(:, :)
   !> Error handling: no convergence
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: u(:, :), s(:), vt(:, :)
   integer :: k

   call svd(a, u, s, vt, error)
   if (allocated(error)) return
   do k = 1, size(s)
      vt(k, :) = merge(vt(k, :)/max(s(k), tiny(1.0_wp)), 0.0_wp, s(k) > 1.0e-13_wp*s(1))
   end do
   inverse = matmul(transpose(vt), transpose(u))
end subroutine invert

!> Largest stable time step, where there are few enough unknowns for the eigenvalues of a step
subroutine limit(self, step, error)
   class(strong_motion), intent(in) :: self
   real(wp), intent(out) :: step
   type(error_type), allocatable, intent(out) :: error
   integer, parameter :: trials = 12
   real(wp), allocatable :: mass(:, :), stiff(:, :)
   real(wp) :: high, low, middle
   integer :: inside, k

   step = huge(1.0_wp)
   if (self%n > most_judged) return
   inside = self%problem%rows%row(self%problem%inside + 1)
   allocate (mass(self%n, self%n), stiff(self%n, self%n))
   mass = matmul(self%inverse(:, :inside), spread(self%density(:inside), 2, self%n) &
      & *self%values(:inside, :))
   ! the rows are those of div(c grad u), minus the operator of (6.36a)
   stiff = -matmul(self%inverse(:, :inside), self%operator(:inside, :))
   low = self%motion%time_step
   high = low
   if (is_stable(low)) then
      do k = 1, trials
         high = 1.5_wp*low
         if (.not. is_stable(high) .or. allocated(error)) exit
         low = high
      end do
   else
      low = 0.0_wp
   end if
   do k = 1, trials
      if (allocated(error)) return
      middle = 0.5_wp*(low + high)
      if (is_stable(middle)) then
         low = middle
      else
         high = middle
      end if
   end do
   step = low

contains

   !> Whether the growth of a motion with these steps is negligible
   logical function is_stable(dt)
      real(wp), intent(in) :: dt
      real(wp) :: companion(2*self%n, 2*self%n), radius
      integer :: i

      companion = 0.0_wp
      companion(:self%n, :self%n) = 2.0_wp*mass - dt**2*stiff
      companion(:self%n, self%n + 1:) = -mass
      do i = 1, self%n
         companion(self%n + i, i) = 1.0_wp
      end do
      call spectral_radius(companion, radius, error)
      is_stable = radius**(self%motion%end_time/dt) <= harmless
   end function is_stable

end subroutine limit

!> Coefficients at the start, in the rest position, and one time step later
subroutine start(self, first, second, error)
   class(strong_motion), intent(inout) :: self
   real(wp), contiguous, intent(inout) :: first(:), second(:)
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: given(size(self%values, 1)), value(3)
   real(wp), allocatable :: fit(:, :)
   integer :: b, inside, row

   associate (problem => self%problem)
      do b = 1, size(problem%rows%place)
         row = problem%rows%row(b)
         call self%motion%initial(problem%scene%cloud%points(:, problem%rows%place(b)), value, &
            & error)
         if (allocated(error)) return
         given(row + 1:row + problem%fields) = value(:problem%fields)
      end do
      inside = problem%rows%row(problem%inside + 1)
   end associate
   call invert(self%values, fit, error)
   if (.not. allocated(error)) call self%loads(0.0_wp, self%force, self%held, error)
   if (allocated(error)) return
   first = 0.0_wp
   ! (6.42b), with the half step due to the loads
   second = self%motion%time_step*matmul(fit, given) + 0.5_wp*self%motion%time_step**2 &
      & *matmul(fit(:, :inside), self%force(:inside)/self%density(:inside))
   if (self%varies) call self%loads(self%motion%time_step, self%force, self%held, error)
end subroutine start

!> Product of rows with coefficients: those of the new time (6.40), or of mass and stiffness
!> (6.38a), which have no rows on the boundary
subroutine product(self, what, x, y)
   class(strong_motion), intent(in) :: self
   character(len=*), intent(in) :: what
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)
   integer :: inside

   if (what == 'left') then
      y = matmul(self%row, x)
      return
   end if
   inside = self%problem%rows%row(self%problem%inside + 1)
   y(inside + 1:) = 0.0_wp
   if (what == 'mass') then
      y(:inside) = self%density(:inside)*matmul(self%values(:inside, :), x)
   else
      y(:inside) = -matmul(self%operator(:inside, :), x)
   end if
end subroutine product

!> Loads inside, and boundary values
subroutine loads(self, time, force, held, error)
   class(strong_motion), intent(in) :: self
   real(wp), intent(in) :: time
   !> Loads, and weighted boundary values, shape (m)
   real(wp), allocatable, intent(out) :: force(:), held(:)
   type(error_type), allocatable, intent(out) :: error
   integer :: inside

   inside = self%problem%rows%row(self%problem%inside + 1)
   allocate (held(self%m), force(self%m), source=0.0_wp)
   call self%problem%own_side(time, held, error)
   if (allocated(error)) return
   force(:inside) = -held(:inside)
   held(:inside) = 0.0_wp
   held(inside + 1:) = self%weight(inside + 1:)*held(inside + 1:)
end subroutine loads

!> Least squares solution of the rows
subroutine solve(self, y, x)
   class(strong_motion), intent(in) :: self
   real(wp), contiguous, intent(in) :: y(:)
   real(wp), contiguous, intent(inout) :: x(:)

   x = matmul(self%inverse, y)
end subroutine solve

end module rk_strong_motion
