!> Linear dynamics in the span of modes (6.27)-(6.31), (6.45)-(6.50).
!>
!> The residual of the equations of a time step, L a(n+1) = right hand side, is orthogonal to test
!> vectors W: Galerkin projection takes the modes U, which needs as many equations as unknowns;
!> least squares Galerkin projection takes W = L U (6.48), and the Cholesky factor of (L U)^T L U
!> (6.50) or a Householder QR of L U gives the amplitudes. Everything but loads that change with
!> time is projected once: a time step costs a few r x r products.
!>
!> Reference: Carlberg, Bou-Mosleh, Farhat, Int. J. Numer. Meth. Engng. 86 (2011),
!> doi:10.1002/nme.3050
module rk_reduced_motion
   use rk_error, only : error_type, fatal_error, err_input
   use rk_lapack, only : cholesky, solve_pivoted_qr, solve_triangular
   use rk_matrix, only : matrix_rows
   use rk_motion, only : form_motion, moving_type
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type, problem_type, stage_type
   implicit none
   private

   public :: moving_problem, new_moving_problem, prepare

   !> Body whose unknowns are amplitudes
   type, extends(moving_type) :: reduced_motion
      !> Body in motion
      class(form_motion), pointer :: full => null()
      !> Orthonormal modes, shape (full n, r), and test vectors W, shape (full m, r)
      real(wp), allocatable :: modes(:, :), test(:, :)
      !> L U
      type(matrix_rows) :: image
      !> Whether W = L U, and whether that is solved by QR of L U
      logical :: least_squares = .false.
      logical :: by_qr = .false.
      !> Cholesky factor of W^T L U, shape (r, r)
      real(wp), allocatable :: factor(:, :)
      !> Amplitudes at the new time from those at the last two times, shape (r, r)
      real(wp), allocatable :: from_now(:, :), from_before(:, :)
      !> Contribution of the loads to them, shape (r), if these are constant; not allocated before
      !> it is known
      real(wp), allocatable :: pushed(:)
   contains
      procedure :: start, advance
      final :: free_reduced
   end type reduced_motion

   !> A problem in motion in the span of modes; its rows are those of a time step
   type, extends(problem_type) :: moving_problem
      !> Body in motion
      type(reduced_motion) :: body
   contains
      procedure :: assemble
   end type moving_problem

contains

!> Project a motion on modes
subroutine new_moving_problem(self, full, modes, projection, error)
   type(moving_problem), intent(inout) :: self
   !> Body in motion, owned by the reduced problem from now on
   class(form_motion), pointer, intent(in) :: full
   !> Orthonormal modes, shape (full n, r)
   real(wp), intent(in) :: modes(:, :)
   !> auto, galerkin or least-squares
   character(len=*), intent(in) :: projection
   !> Error handling: Galerkin projection of more equations than unknowns
   type(error_type), allocatable, intent(out) :: error
   integer :: j

   associate (body => self%body)
      body%full => full
      body%n = size(modes, 2)
      body%modes = modes
      allocate (body%image%a(full%m, body%n))
      body%image%m = full%m
      body%image%n = body%n
      do j = 1, body%n
         call full%product('left', modes(:, j), body%image%a(:, j))
      end do
      body%least_squares = projection == 'least-squares' .or. (projection == 'auto' &
         & .and. .not. full%symmetric)
      if (body%least_squares) then
         body%test = body%image%a
      else if (full%symmetric) then
         body%test = modes
      else
         call fatal_error(error, err_input, 'projection: collocation has more equations ' &
            & //'than unknowns, which "galerkin" cannot project: use "least-squares"')
         return
      end if
      self%linear = .true.
      self%m = full%m
      self%n = body%n
   end associate
end subroutine new_moving_problem

!> Project the equations of a time step and solve them for the effect of each amplitude
subroutine prepare(self, solver, error)
   type(moving_problem), intent(inout) :: self
   !> normal for a Cholesky factor of the projected equations, else QR where they are least squares
   character(len=*), intent(in) :: solver
   !> Error handling: modes that the equations do not distinguish
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: zero(:), side(:)
   integer :: j

   associate (body => self%body)
      body%by_qr = body%least_squares .and. index(solver, 'normal') == 0
      if (allocated(body%pushed)) deallocate (body%pushed)
      if (.not. body%by_qr) then
         body%factor = matmul(transpose(body%test), body%image%a)
         call cholesky(body%factor, error)
         if (allocated(error)) return
      end if
      allocate (zero(body%full%n), side(body%full%m), source=0.0_wp)
      if (.not. allocated(body%from_now)) allocate (body%from_now(body%n, body%n), &
         & body%from_before(body%n, body%n))
      do j = 1, body%n
         call body%full%carry(zero, body%modes(:, j), side)
         call amplitudes(body, side, body%from_now(:, j), error)
         if (allocated(error)) return
         call body%full%carry(body%modes(:, j), zero, side)
         call amplitudes(body, side, body%from_before(:, j), error)
         if (allocated(error)) return
      end do
   end associate
end subroutine prepare

!> Amplitudes of a right hand side of the full equations
subroutine amplitudes(self, side, x, error)
   type(reduced_motion), intent(in) :: self
   !> Right hand side, shape (full m)
   real(wp), contiguous, intent(in) :: side(:)
   !> Amplitudes, shape (r)
   real(wp), contiguous, intent(inout) :: x(:)
   !> Error handling: numbers that are not finite
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: a(:, :), b(:, :)
   integer :: pivot(self%n), rank

   if (.not. self%by_qr) then
      x = matmul(side, self%test)
      call solve_triangular(self%factor, x, transposed=.true.)
      call solve_triangular(self%factor, x, transposed=.false.)
      return
   end if
   a = self%image%a
   b = reshape(side, [size(side), 1])
   call solve_pivoted_qr(a, b, pivot, rank, error)
   if (.not. allocated(error)) x = b(:self%n, 1)
end subroutine amplitudes

!> Amplitudes at the start and one time step later: the full coefficients projected on the modes
subroutine start(self, first, second, error)
   class(reduced_motion), intent(inout) :: self
   !> Amplitudes at both times, shape (r)
   real(wp), contiguous, intent(inout) :: first(:), second(:)
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: one(:), other(:)

   allocate (one(self%full%n), other(self%full%n))
   call self%full%start(one, other, error)
   if (allocated(error)) return
   first = matmul(one, self%modes)
   second = matmul(other, self%modes)
end subroutine start

!> Amplitudes at the next time
subroutine advance(self, before, now, time, next, error)
   class(reduced_motion), intent(inout) :: self
   real(wp), contiguous, intent(in) :: before(:), now(:)
   real(wp), intent(in) :: time
   real(wp), contiguous, intent(inout) :: next(:)
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: side(:)

   if (self%full%varies .or. .not. allocated(self%pushed)) then
      allocate (side(self%full%m), source=0.0_wp)
      if (.not. allocated(self%pushed)) allocate (self%pushed(self%n))
      call self%full%add_loads(time, side, error)
      if (.not. allocated(error)) call amplitudes(self, side, self%pushed, error)
      if (allocated(error)) return
   end if
   next = matmul(self%from_now, now) + matmul(self%from_before, before) + self%pushed
end subroutine advance

!> Free the full body
subroutine free_reduced(self)
   type(reduced_motion), intent(inout) :: self

   if (associated(self%full)) deallocate (self%full)
end subroutine free_reduced

!> Rows of a time step times amplitudes
subroutine assemble(self, x, stage, r, seen)
   class(moving_problem), target, intent(inout) :: self
   real(wp), contiguous, intent(in) :: x(:)
   !> Unused
   type(stage_type), intent(in) :: stage
   !> L U x, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   type(evaluation_type), intent(out) :: seen

   associate (unused => stage)
   end associate
   self%linearised => self%body%image
   call self%body%image%apply(x, r)
   seen%valid = all(abs(r) <= huge(1.0_wp))
end subroutine assemble

end module rk_reduced_motion
