!> Weighted least squares min |A x - b| by a ladder of methods that give the same answer.
!>
!> `dgels` is the yardstick: Householder QR of the dense matrix. `normal` factorises A^T A, which
!> is accumulated without A. `refined` takes that factor as preconditioner of CGLS with products
!> by A, also without A in memory: the accuracy of QR at nearly the cost of Cholesky.
!>
!> References: Bjorck, Numerical Methods for Least Squares Problems, SIAM (1996),
!>             doi:10.1137/1.9781611971484 (CGLS 7.4, corrected semi-normal equations 2.4.6,
!>             backward error 1.4.3)
module rk_lstsq
   use rk_error, only : error_type, fatal_error, err_input, err_linalg, err_memory
   use rk_lapack, only : cholesky, reciprocal_condition, solve_qr, solve_triangular
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: row_operator, lstsq_report, solve_lstsq, solver_names

   !> Methods by name
   character(len=8), parameter :: solver_names(4) = ['auto    ', 'dgels   ', 'normal  ', 'refined ']

   !> A tall matrix known by what it does
   type, abstract :: row_operator
      !> Rows
      integer :: m = 0
      !> Columns
      integer :: n = 0
   contains
      !> y = A x
      procedure(apply_interface), deferred :: apply
      !> x = A^T y
      procedure(apply_interface), deferred :: apply_transposed
      !> Upper triangle of A^T A
      procedure(matrix_interface), deferred :: normal
      !> A itself
      procedure(matrix_interface), deferred :: dense
   end type row_operator

   abstract interface
      !> Product with a vector
      subroutine apply_interface(self, x, y)
         import :: row_operator, wp
         !> Matrix
         class(row_operator), intent(in) :: self
         !> Vector
         real(wp), contiguous, intent(in) :: x(:)
         !> Product
         real(wp), contiguous, intent(inout) :: y(:)
      end subroutine apply_interface
      !> Entries of a dense matrix
      subroutine matrix_interface(self, a)
         import :: row_operator, wp
         !> Matrix
         class(row_operator), intent(in) :: self
         !> Entries, shape (m, n) or (n, n)
         real(wp), contiguous, intent(inout) :: a(:, :)
      end subroutine matrix_interface
   end interface

   !> What a solve did
   type :: lstsq_report
      !> Method used
      character(len=8) :: used = ''
      !> Why this method, where the ladder was left or a choice was made
      character(len=:), allocatable :: why
      !> Backward error: smallest relative change of A that makes x exact, upper bound [-]
      real(wp) :: backward_error = 0.0_wp
      !> Backward error below which no method is known to be better: rounding of b counts where the
      !> residual is much smaller [-]
      real(wp) :: attainable = 0.0_wp
      !> Reciprocal condition estimate of the column-scaled matrix, 1-norm [-]
      real(wp) :: rcond = 0.0_wp
      !> |A^T r| in column-scaled variables
      real(wp) :: gradient = 0.0_wp
      !> Refinement iterations
      integer :: iterations = 0
   end type lstsq_report

   !> A solution is accepted below this backward error: what QR reaches, with room for the
   !> growth of rounding errors with the number of rows
   real(wp), parameter :: backward_limit = 1.0e-12_wp
   !> Where refinement stops
   real(wp), parameter :: backward_goal = 2.0e-16_wp
   !> Refinement iterations at most
   integer, parameter :: max_refinement = 40
   !> Iterations without halving the gradient before refinement has reached what rounding allows
   integer, parameter :: patience = 3

contains

!> Solve min |A x - b|
subroutine solve_lstsq(op, b, method, x, report, error)
   !> Matrix
   class(row_operator), intent(in) :: op
   !> Right hand side, shape (m)
   real(wp), contiguous, intent(in) :: b(:)
   !> One of solver_names
   character(len=*), intent(in) :: method
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> What was done
   type(lstsq_report), intent(out) :: report
   !> Error handling: rank deficient, fewer rows than columns
   type(error_type), allocatable, intent(out) :: error

   report%why = 'asked for'
   if (op%m < op%n) then
      call fatal_error(error, err_input, 'fewer equations ('//to_text(op%m)//') than unknowns (' &
         & //to_text(op%n)//'): use more collocation points than source points')
      return
   end if
   select case (method)
   case ('dgels')
      call solve_dense(op, b, x, report, error)
   case ('normal', 'refined')
      call solve_normal(op, b, method == 'refined', x, report, error)
   case ('auto')
      report%why = 'no matrix in memory, accuracy of QR'
      call solve_normal(op, b, .true., x, report, error)
   case default
      call fatal_error(error, err_input, 'unknown least squares solver '//trim(method))
   end select
   if (allocated(error)) return
   if (report%used == 'refined' .and. report%backward_error > report%attainable) &
      & call fall_back(op, b, x, report)
end subroutine solve_lstsq

!> QR where refinement did not reach its level; the better of the two answers is kept
subroutine fall_back(op, b, x, report)
   !> Matrix
   class(row_operator), intent(in) :: op
   !> Right hand side, shape (m)
   real(wp), contiguous, intent(in) :: b(:)
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> What was done
   type(lstsq_report), intent(inout) :: report
   type(error_type), allocatable :: failure
   type(lstsq_report) :: other
   real(wp), allocatable :: y(:)

   allocate (y(op%n))
   call solve_dense(op, b, y, other, failure)
   if (allocated(failure)) then
      report%why = 'refined reached a backward error of '//to_text(report%backward_error, 2) &
         & //', dgels failed: '//failure%message
      return
   end if
   report%why = 'refined reached a backward error of '//to_text(report%backward_error, 2) &
      & //', dgels '//to_text(other%backward_error, 2)//', at a reciprocal condition of ' &
      & //to_text(report%rcond, 2)
   if (other%backward_error >= report%backward_error) return
   other%why = report%why
   report = other
   x = y
end subroutine fall_back

!> Householder QR of the dense, column-scaled matrix
subroutine solve_dense(op, b, x, report, error)
   !> Matrix
   class(row_operator), intent(in) :: op
   !> Right hand side, shape (m)
   real(wp), contiguous, intent(in) :: b(:)
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> What was done
   type(lstsq_report), intent(inout) :: report
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: a(:, :), y(:), scale(:)
   integer :: j, stat

   allocate (a(op%m, op%n), stat=stat)
   if (stat /= 0) then
      call fatal_error(error, err_memory, 'no memory for a dense matrix of ' &
         & //to_text(8.0e-9_wp*op%m*op%n, 3)//' GB: use solver "refined"')
      return
   end if
   allocate (y, source=b)
   allocate (scale(op%n))
   call op%dense(a)
   do j = 1, op%n
      scale(j) = norm2(a(:, j))
      if (.not. scale(j) > 0.0_wp) then
         call column_error(j, scale(j), error)
         return
      end if
      a(:, j) = a(:, j)/scale(j)
   end do
   call solve_qr(a, y, report%rcond, error)
   if (allocated(error)) return
   x = y(:op%n)/scale
   report%used = 'dgels'
   call judge(op, b, x, scale, report)
end subroutine solve_dense

!> Cholesky of the column-scaled normal matrix, then, where wanted, CGLS with it as preconditioner
subroutine solve_normal(op, b, refine, x, report, error)
   !> Matrix
   class(row_operator), intent(in) :: op
   !> Right hand side, shape (m)
   real(wp), contiguous, intent(in) :: b(:)
   !> Refine to the accuracy of QR
   logical, intent(in) :: refine
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> What was done
   type(lstsq_report), intent(inout) :: report
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: a(:, :), scale(:)
   real(wp) :: shift
   integer :: attempt, i, j

   allocate (a(op%n, op%n), scale(op%n))
   report%used = merge('refined ', 'normal  ', refine)
   shift = 0.0_wp
   do attempt = 1, 4
      call op%normal(a)
      do j = 1, op%n
         scale(j) = sqrt(a(j, j))
         if (.not. scale(j) > 0.0_wp) then
            call column_error(j, scale(j), error)
            return
         end if
      end do
      !$omp parallel do default(none) schedule(static) private(i, j) shared(a, scale, op, shift)
      do j = 1, op%n
         do i = 1, j
            a(i, j) = a(i, j)/(scale(i)*scale(j))
         end do
         a(j, j) = 1.0_wp + shift
      end do
      !$omp end parallel do
      call cholesky(a, error)
      if (.not. allocated(error)) exit
      ! the matrix is singular to rounding when squared; refinement undoes a small shift
      if (.not. refine .or. attempt == 4) then
         error%message = 'normal equations: '//error%message//'; solver "dgels" does not square ' &
            & //'the condition number'
         return
      end if
      shift = merge(op%n*epsilon(1.0_wp), 100.0_wp*shift, attempt == 1)
   end do
   call reciprocal_condition(a, report%rcond)
   call refinement(op, b, a, scale, merge(max_refinement, 0, refine), x, report%iterations)
   call judge(op, b, x, scale, report)
end subroutine solve_normal

!> Semi-normal equations followed by preconditioned CGLS
subroutine refinement(op, b, r, scale, limit, x, iterations)
   !> Matrix
   class(row_operator), intent(in) :: op
   !> Right hand side, shape (m)
   real(wp), contiguous, intent(in) :: b(:)
   !> Cholesky factor of the column-scaled normal matrix, shape (n, n)
   real(wp), contiguous, intent(in) :: r(:, :)
   !> Column norms, shape (n)
   real(wp), intent(in) :: scale(:)
   !> Iterations at most
   integer, intent(in) :: limit
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> Iterations done
   integer, intent(out) :: iterations
   real(wp), allocatable :: residual(:), s(:), p(:), t(:), q(:), best(:)
   real(wp) :: gamma, gamma_old, gradient, least, matrix_norm
   integer :: last_gain

   allocate (residual(op%m), q(op%m), s(op%n), p(op%n), t(op%n))
   iterations = 0
   call gradient_of(b)
   call solve_triangular(r, t, transposed=.true.)
   call solve_triangular(r, t, transposed=.false.)
   x = t/scale
   if (limit == 0) return

   ! restart from the true residual of the semi-normal solution
   call op%apply(x, q)
   residual = b - q
   matrix_norm = sqrt(real(op%n, wp))
   best = x
   least = huge(1.0_wp)
   last_gain = 0
   do iterations = 0, limit
      call gradient_of(residual)
      gradient = norm2(t)
      if (gradient < least) then
         if (gradient < 0.5_wp*least) last_gain = iterations
         least = gradient
         best = x
      end if
      if (iterations > last_gain + patience) exit
      if (gradient <= backward_goal*matrix_norm*norm2(residual)) exit
      if (iterations == limit) exit
      s = t
      call solve_triangular(r, s, transposed=.true.)
      gamma = dot_product(s, s)
      if (iterations == 0) then
         p = s
      else
         p = s + (gamma/gamma_old)*p
      end if
      gamma_old = gamma
      t = p
      call solve_triangular(r, t, transposed=.false.)
      t = t/scale
      call op%apply(t, q)
      if (.not. dot_product(q, q) > 0.0_wp) exit
      gamma = gamma/dot_product(q, q)
      x = x + gamma*t
      residual = residual - gamma*q
   end do
   x = best

contains

   !> t = D^-1 A^T v, the gradient in column-scaled variables
   subroutine gradient_of(v)
      real(wp), contiguous, intent(in) :: v(:)
      call op%apply_transposed(v, t)
      t = t/scale
   end subroutine gradient_of

end subroutine refinement

!> Backward error of a solution in column-scaled variables, Frobenius norm of the matrix
subroutine judge(op, b, x, scale, report)
   !> Matrix
   class(row_operator), intent(in) :: op
   !> Right hand side, shape (m)
   real(wp), contiguous, intent(in) :: b(:)
   !> Solution, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Column norms, shape (n)
   real(wp), intent(in) :: scale(:)
   !> Report
   type(lstsq_report), intent(inout) :: report
   real(wp), allocatable :: residual(:), gradient(:)
   real(wp) :: norm, matrix_norm

   allocate (residual(op%m), gradient(op%n))
   call op%apply(x, residual)
   residual = b - residual
   call op%apply_transposed(residual, gradient)
   report%gradient = norm2(gradient/scale)
   norm = norm2(residual)
   matrix_norm = sqrt(real(op%n, wp))
   report%backward_error = 0.0_wp
   report%attainable = backward_limit + 10.0_wp*epsilon(1.0_wp)*norm2(b)/max(norm, tiny(1.0_wp))
   ! both are bounds; the second is the one that counts where the equations are consistent
   if (norm > 0.0_wp) report%backward_error = min(report%gradient/norm, &
      & norm/max(norm2(scale*x), tiny(1.0_wp)))/matrix_norm
end subroutine judge

!> An unknown that no equation sees
subroutine column_error(j, norm, error)
   !> Column
   integer, intent(in) :: j
   !> Its norm
   real(wp), intent(in) :: norm
   !> Error handling
   type(error_type), allocatable, intent(out) :: error

   if (norm < 1.0_wp) then
      call fatal_error(error, err_input, 'unknown '//to_text(j)//' appears in no equation: a ' &
         & //'source point whose support holds no collocation point; use more collocation points')
   else
      call fatal_error(error, err_linalg, 'equations contain numbers that are not finite')
   end if
end subroutine column_error

end module rk_lstsq
