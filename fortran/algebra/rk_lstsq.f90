!> Weighted least squares min |A x - b| by a sequence of methods that give the same answer.
!>
!> `dgels` is the reference: Householder QR of the dense matrix; `dgelsy` is its rank revealing
!> form, which names the undetermined unknowns. `normal` factorises A^T A, accumulated without A;
!> `refined` uses that factor as preconditioner of CGLS with products by A: the accuracy of QR at
!> nearly the cost of Cholesky. `spqr` is sparse QR. If the backward error of an answer is above the
!> level of QR, the answer is rejected and the next method is tried.
!>
!> The backward error is the smallest of three upper bounds, relative to the Frobenius norm of the
!> column-scaled matrix: |A^T r|/|r| and |r|/|x| (Stewart), and |P r|/|x| with P the projector on
!> the range of A (Karlson, Walden), which matters where r is small but not yet at rounding level.
!>
!> References: Bjorck, Numerical Methods for Least Squares Problems, SIAM (1996), 1.4.3,
!>             doi:10.1137/1.9781611971484;
!>             Karlson, Walden, BIT 37 (1997) 862, doi:10.1007/BF02510356;
!>             Cox, Higham, BIT 38 (1998) 34, doi:10.1007/BF02510913 (heavy rows first)
module rk_lstsq
   use rk_cgls, only : refine
   use rk_csr, only : csr_type, group_by
   use rk_envelope, only : envelope_type
   use rk_error, only : error_type, fatal_error, err_input, err_linalg, err_memory
   use rk_lapack, only : solve_pivoted_qr, solve_qr, solve_triangular
   use rk_memory, only : available_bytes
   use rk_operator, only : factor_type, row_operator, shortest, square_report
   use rk_precision, only : wp
   use rk_sparse, only : sparse_factor, sparse_qr
   use rk_text, only : to_text
   implicit none
   private

   public :: row_operator, lstsq_report, solve_lstsq, solver_names

   !> Names of the methods
   character(len=*), parameter :: solver_names(*) = [character(len=13) :: 'auto', 'dgels', &
      & 'dgelsy', 'normal', 'refined', 'spqr', 'sparse-normal']

   !> Upper triangle of a QR factorisation
   type, extends(factor_type) :: dense_factor
      !> R in the leading rows, shape (m, n)
      real(wp), allocatable :: a(:, :)
      !> Unknown of each column, shape (n)
      integer, allocatable :: pivot(:)
   contains
      procedure :: solve
   end type dense_factor

   !> Report of a solve. The backward error is an upper bound of the smallest relative change of A
   !> that makes x exact; rcond is the smallest singular value of the column-scaled matrix over its
   !> Frobenius norm
   type, extends(square_report) :: lstsq_report
      !> Distance |A (x - x*)| to the best fit x* over the residual: it shows the errors of the
      !> light rows where some rows are much heavier than others [-]
      real(wp) :: misfit = 0.0_wp
      !> The backward error and the misfit are at the level of QR
      logical :: accepted = .false.
   end type lstsq_report

   !> A solution is accepted below this backward error: the level of QR, with a margin for the
   !> growth of rounding errors with the number of rows
   real(wp), parameter :: backward_limit = 1.0e-12_wp
   !> With rows of very different weights a small backward error does not bound the errors of the
   !> light ones. So the distance to the best fit must be below this part of the residual,
   real(wp), parameter :: misfit_limit = 1.0e-8_wp
   !> or below this part of the terms of a row, a rounding error that QR makes too
   real(wp), parameter :: rounding_limit = 30*epsilon(1.0_wp)
   !> Maximum number of refinement iterations
   integer, parameter :: max_refinement = 40
   !> Number of operations below which dense QR is chosen: it takes milliseconds
   real(wp), parameter :: small_work = 1.0e8_wp
   !> Maximum number of undetermined unknowns named in a message
   integer, parameter :: max_named = 4

contains

!> Solve min |A x - b|
subroutine solve_lstsq(op, b, method, x, report, error)
   class(row_operator), intent(in) :: op
   !> Right hand side, shape (m)
   real(wp), contiguous, intent(in) :: b(:)
   !> One of solver_names
   character(len=*), intent(in) :: method
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   type(lstsq_report), intent(out) :: report
   !> Error handling: rank deficient, fewer rows than columns
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: work

   report%why = 'asked for'
   report%used = trim(method)
   ! the envelope is the sparse form of the normal matrix
   if (method == 'sparse-normal') report%used = 'normal'
   if (.not. any(solver_names == method)) then
      call fatal_error(error, err_input, 'unknown least squares solver '//trim(method))
   else if (op%m < op%n) then
      call fatal_error(error, err_input, 'fewer equations ('//to_text(op%m)//') than unknowns (' &
         & //to_text(op%n)//'): use more collocation points than source points')
   end if
   if (allocated(error)) return
   if (method == 'auto') then
      work = 2.0_wp*op%m*real(op%n, wp)**2
      if (work < small_work) then
         report%used = 'dgels'
         report%why = 'dense QR of '//to_text(op%m)//' x '//to_text(op%n)//' takes milliseconds'
      else
         report%used = 'refined'
         report%why = 'dense QR would take '//to_text(1.0e-9_wp*work, 2)//' Gflop'
      end if
   end if
   select case (report%used)
   case ('dgels')
      call solve_dense(op, b, x, report, error)
      return
   case ('dgelsy')
      call solve_pivoted(op, b, x, report, error)
      return
   case ('spqr')
      call solve_spqr(op, b, x, report, error)
   case default
      call solve_normal(op, b, x, report, error)
   end select
   if (allocated(error)) then
      if (error%code == err_linalg) call fall_back(op, b, x, report, error)
   else if (.not. report%accepted) then
      call fall_back(op, b, x, report, error)
   end if
end subroutine solve_lstsq

!> Try QR where a method did not reach the level of QR; the better of the two answers is kept
subroutine fall_back(op, b, x, report, error)
   class(row_operator), intent(in) :: op
   real(wp), contiguous, intent(in) :: b(:)
   real(wp), contiguous, intent(inout) :: x(:)
   type(lstsq_report), intent(inout) :: report
   !> Error handling: error of the first method on entry, remaining error after the second on return
   type(error_type), allocatable, intent(inout) :: error
   type(lstsq_report) :: other
   type(error_type), allocatable :: failure
   real(wp), allocatable :: y(:)
   character(len=:), allocatable :: quality, story

   if (allocated(error)) then
      story = report%used//': '//error%message
   else
      call get_quality(report, quality)
      story = report%used//' '//quality
   end if
   allocate (y(op%n))
   other%used = 'dgels'
   call solve_dense(op, b, y, other, failure)
   if (allocated(failure)) then
      if (failure%code == err_memory .and. report%used /= 'spqr') then
         other%used = 'spqr'
         call solve_spqr(op, b, y, other, failure)
      end if
   end if
   if (allocated(failure)) then
      report%why = story//'; '//other%used//': '//failure%message
      if (.not. allocated(error)) return
      ! QR gives the better diagnosis, except where it ran out of memory
      if (failure%code /= err_linalg) failure%message = report%why
      call move_alloc(failure, error)
   else
      report%why = story//'; '//other%used//' reached '//to_text(other%backward_error, 2)
      if (.not. (allocated(error) .or. other%misfit < report%misfit)) return
      if (allocated(error)) deallocate (error)
      other%why = report%why
      report = other
      x = y
   end if
end subroutine fall_back

!> Describe the quality that a method reached
subroutine get_quality(report, text)
   type(lstsq_report), intent(in) :: report
   character(len=:), allocatable, intent(out) :: text

   text = 'reached a backward error of '//to_text(report%backward_error, 2)//', '// &
      & to_text(report%misfit, 2)//' of the residual from the best fit, at a reciprocal ' &
      & //'condition of '//to_text(report%rcond, 2)
end subroutine get_quality

!> Householder QR of the dense, column-scaled matrix
subroutine solve_dense(op, b, x, report, error)
   class(row_operator), intent(in) :: op
   real(wp), contiguous, intent(in) :: b(:)
   real(wp), contiguous, intent(inout) :: x(:)
   type(lstsq_report), intent(inout) :: report
   type(error_type), allocatable, intent(out) :: error
   type(error_type), allocatable :: failure
   type(dense_factor) :: factor
   type(lstsq_report) :: other
   real(wp), allocatable :: y(:)
   integer :: j

   allocate (y, source=b)
   call write_dense(op, factor, y, error)
   if (allocated(error)) return
   factor%pivot = [(j, j=1, op%n)]
   call solve_qr(factor%a, y, failure)
   if (.not. allocated(failure)) then
      x = y(:op%n)/factor%scale
      call check_rank(op, factor, report%rcond, failure)
   end if
   if (.not. allocated(failure)) then
      call judge(op, b, x, factor, report)
      return
   end if
   ! name the undetermined unknowns
   deallocate (factor%a)
   other = report
   call solve_pivoted(op, b, x, other, error)
   if (allocated(error)) return
   if (other%rcond > 0.0_wp) then
      other%used = 'dgelsy'
      other%why = 'dgels: '//failure%message
      report = other
   else
      call fatal_error(error, err_linalg, other%why)
   end if
end subroutine solve_dense

!> Dense matrix with columns of unit length and heavy rows first, b in the same order
subroutine write_dense(op, factor, b, error)
   class(row_operator), intent(in) :: op
   !> Its entries and column norms
   type(dense_factor), intent(inout) :: factor
   real(wp), contiguous, intent(inout) :: b(:)
   !> Error handling: no memory, a zero column
   type(error_type), allocatable, intent(out) :: error
   integer, allocatable :: order(:)
   real(wp), allocatable :: size_of(:)
   integer :: j, stat

   stat = merge(0, 1, 8.0_wp*op%m*op%n < available_bytes())
   if (stat == 0) allocate (factor%a(op%m, op%n), stat=stat)
   if (stat /= 0) then
      call fatal_error(error, err_memory, 'no memory for a dense matrix of ' &
         & //to_text(8.0e-9_wp*op%m*op%n, 3)//' GB: use solver "refined"')
      return
   end if
   allocate (factor%scale(op%n), size_of(op%m))
   call op%dense(factor%a)
   size_of = 0.0_wp
   do j = 1, op%n
      factor%scale(j) = norm2(factor%a(:, j))
      size_of = max(size_of, abs(factor%a(:, j)))
   end do
   call check_columns(op, factor%scale, error)
   if (allocated(error)) return
   call heavy_first(size_of, order)
   do j = 1, op%n
      factor%a(:, j) = factor%a(order, j)/factor%scale(j)
   end do
   b = b(order)
end subroutine write_dense

!> Order rows by falling size, rounded to a power of two
subroutine heavy_first(size_of, order)
   !> Largest entry of each row, shape (m)
   real(wp), intent(in) :: size_of(:)
   !> Rows, the heaviest first, shape (m)
   integer, allocatable, intent(out) :: order(:)
   type(csr_type) :: rows
   integer :: level(size(size_of))

   level = exponent(size_of)
   level = 1 + maxval(level) - level
   call group_by(maxval(level), level, rows)
   call move_alloc(rows%index, order)
end subroutine heavy_first

!> Rank revealing QR: the minimum-norm solution, and the names of undetermined unknowns
subroutine solve_pivoted(op, b, x, report, error)
   class(row_operator), intent(in) :: op
   real(wp), contiguous, intent(in) :: b(:)
   real(wp), contiguous, intent(inout) :: x(:)
   !> Report; if the rank is not full, `why` names the undetermined unknowns and `rcond` is 0
   type(lstsq_report), intent(inout) :: report
   type(error_type), allocatable, intent(out) :: error
   type(dense_factor) :: factor
   real(wp), allocatable :: y(:, :), probe(:), image(:)
   character(len=:), allocatable :: names
   integer :: j, rank

   ! a vector with a part in every direction: the part that its solution lacks is in the null space
   allocate (y(op%m, 2), probe(op%n), image(op%m))
   probe = [(1.0_wp + modulo(0.6180339887498949_wp*j, 1.0_wp), j=1, op%n)]
   y(:, 1) = b
   call write_dense(op, factor, y(:, 1), error)
   if (allocated(error)) return
   image = matmul(factor%a, probe)
   y(:, 2) = image
   allocate (factor%pivot(op%n))
   call solve_pivoted_qr(factor%a, y, factor%pivot, rank, error)
   if (allocated(error)) return
   x = y(:op%n, 1)/factor%scale
   if (rank < op%n) then
      call get_names(op, abs(y(:op%n, 2) - probe), names)
      report%why = 'rank '//to_text(rank)//' of '//to_text(op%n)//', undetermined: '//names
      factor%singular = .true.
      report%rcond = 0.0_wp
   else
      call check_rank(op, factor, report%rcond, error)
      if (allocated(error)) return
   end if
   call judge(op, b, x, factor, report)
end subroutine solve_pivoted

!> Names of the unknowns with the largest part in the null space
subroutine get_names(op, part, text)
   class(row_operator), intent(in) :: op
   !> Part of each unknown in the null space, shape (n)
   real(wp), intent(in) :: part(:)
   character(len=:), allocatable, intent(out) :: text
   character(len=:), allocatable :: name
   real(wp) :: rest(size(part))
   integer :: j, k, total

   total = count(part > 1.0e-6_wp*maxval(part))
   text = ''
   rest = part
   do k = 1, min(total, max_named)
      j = maxloc(rest, dim=1)
      rest(j) = -1.0_wp
      if (k > 1) text = text//', '
      call op%get_name(j, name)
      text = text//name
   end do
   if (total > max_named) text = text//' and '//to_text(total - max_named)//' more'
   text = text//'; fix rigid motions by displacements, or use more collocation points'
end subroutine get_names

subroutine solve_spqr(op, b, x, report, error)
   class(row_operator), intent(in) :: op
   real(wp), contiguous, intent(in) :: b(:)
   real(wp), contiguous, intent(inout) :: x(:)
   type(lstsq_report), intent(inout) :: report
   type(error_type), allocatable, intent(out) :: error
   type(sparse_factor) :: factor

   call sparse_qr(factor, op, b, x, error)
   if (.not. allocated(error)) call check_columns(op, factor%scale, error)
   if (.not. allocated(error)) call check_rank(op, factor, report%rcond, error)
   if (.not. allocated(error)) call judge(op, b, x, factor, report)
end subroutine solve_spqr

!> Cholesky of the column-scaled normal matrix, then, if requested or needed, CGLS with it as
!> preconditioner
subroutine solve_normal(op, b, x, report, error)
   class(row_operator), intent(in) :: op
   real(wp), contiguous, intent(in) :: b(:)
   real(wp), contiguous, intent(inout) :: x(:)
   !> Report; on entry `used` selects the method
   type(lstsq_report), intent(inout) :: report
   type(error_type), allocatable, intent(out) :: error
   type(envelope_type) :: factor
   character(len=:), allocatable :: quality

   call op%envelope(factor, error)
   if (allocated(error)) return
   call factor%equilibrate()
   call check_columns(op, factor%scale, error)
   if (allocated(error)) return
   call factor%factorise(error)
   if (.not. allocated(error)) call check_rank(op, factor, report%rcond, error)
   if (allocated(error)) return
   ! solution of the normal equations
   call op%apply_transposed(b, x)
   x = x/factor%scale
   call factor%solve(x)
   x = x/factor%scale
   if (report%used == 'normal') then
      call judge(op, b, x, factor, report)
      if (report%accepted) return
      call get_quality(report, quality)
      report%why = 'normal '//quality
      report%used = 'refined'
   end if
   call refine(op, b, factor, max_refinement, x, report%iterations)
   call judge(op, b, x, factor, report)
end subroutine solve_normal

subroutine solve(self, x)
   class(dense_factor), intent(in) :: self
   real(wp), contiguous, intent(inout) :: x(:)
   real(wp) :: y(size(x))

   y = x(self%pivot)
   call solve_triangular(self%a, y, transposed=.true.)
   call solve_triangular(self%a, y, transposed=.false.)
   x(self%pivot) = y
end subroutine solve

!> Backward error of a solution in column-scaled variables, relative to the Frobenius norm
subroutine judge(op, b, x, factor, report)
   class(row_operator), intent(in) :: op
   real(wp), contiguous, intent(in) :: b(:)
   real(wp), contiguous, intent(in) :: x(:)
   class(factor_type), intent(in) :: factor
   type(lstsq_report), intent(inout) :: report
   real(wp), allocatable :: residual(:), gradient(:), z(:)
   real(wp) :: norm, matrix_norm, length, bound, distance

   allocate (residual(op%m), gradient(op%n))
   call op%apply(x, residual)
   residual = b - residual
   call op%apply_transposed(residual, gradient)
   gradient = gradient/factor%scale
   distance = huge(1.0_wp)
   if (.not. factor%singular) then
      z = gradient
      call factor%solve(z)
      distance = sqrt(abs(dot_product(gradient, z)))
   end if
   norm = norm2(residual)
   length = max(norm2(factor%scale*x), tiny(1.0_wp))
   matrix_norm = sqrt(real(op%n, wp))
   report%backward_error = 0.0_wp
   report%misfit = 0.0_wp
   report%accepted = .not. norm > 0.0_wp
   if (report%accepted) return
   bound = min(norm2(gradient)/norm, norm/length)
   if (distance < huge(1.0_wp)) then
      bound = min(bound, distance/length)
      report%misfit = distance/norm
   end if
   report%backward_error = bound/matrix_norm
   report%accepted = report%backward_error <= backward_limit .and. (report%misfit <= misfit_limit &
      & .or. distance <= rounding_limit*matrix_norm*length)
end subroutine judge

!> Check by means of a factor whether the equations leave an unknown undetermined
subroutine check_rank(op, factor, rcond, error)
   class(row_operator), intent(in) :: op
   class(factor_type), intent(in) :: factor
   !> Smallest singular value of the column-scaled matrix over its Frobenius norm [-]
   real(wp), intent(out) :: rcond
   !> Error handling: rank deficient to n roundings
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: v(op%n)
   character(len=:), allocatable :: names

   call shortest(op, factor, v, rcond)
   rcond = rcond/sqrt(real(op%n, wp))
   ! written so that NaN, from a factor with zeros on its diagonal, fails the comparison
   if (rcond > op%n*epsilon(1.0_wp)) return
   call get_names(op, abs(v), names)
   call fatal_error(error, err_linalg, 'the equations do not determine '//names//' (rank below ' &
      & //to_text(op%n)//'): prescribe more displacements, or use more collocation points')
end subroutine check_rank

!> Check that every unknown appears in an equation
subroutine check_columns(op, scale, error)
   class(row_operator), intent(in) :: op
   !> Column norms, shape (n)
   real(wp), intent(in) :: scale(:)
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: name
   integer :: j

   do j = 1, size(scale)
      if (scale(j) > 0.0_wp) cycle
      if (scale(j) < 1.0_wp) then
         call op%get_name(j, name)
         call fatal_error(error, err_input, name//' appears in no equation: its support ' &
            & //'contains no collocation point; use more collocation points')
      else
         call fatal_error(error, err_linalg, 'the equations contain NaN or infinite values')
      end if
      return
   end do
end subroutine check_columns

end module rk_lstsq
