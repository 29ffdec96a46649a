!> Least squares Galerkin reduction of a collocation problem (6.60)-(6.67).
!>
!> The shape functions are projected on the modes once. Displacement, F and its derivatives at a
!> collocation point are then sums over the modes, and the rows of A'U follow from them without the
!> full A': the same numbers to rounding, without the number of source points in the cost.
module rk_reduced
   use rk_discretisation, only : discretisation_type
   use rk_displacement, only : displacement_problem
   use rk_error, only : error_type, fatal_error, err_input
   use rk_lstsq, only : row_operator
   use rk_matrix, only : matrix_rows
   use rk_precision, only : wp
   use rk_problem, only : problem_type, evaluation_type
   use rk_text, only : to_text
   implicit none
   private

   public :: reduced_problem, new_reduced

   !> A collocation problem in the span of modes; unknowns are the modes' amplitudes
   type, extends(problem_type) :: reduced_problem
      !> The problem with its fields as sums over modes
      class(displacement_problem), allocatable :: base
      !> A'U
      type(matrix_rows) :: projected
   contains
      procedure :: start_step
      procedure :: evaluate
      procedure :: operator
      procedure :: hessian
   end type reduced_problem

contains

!> Project a full problem on modes
subroutine new_reduced(self, full, modes, error)
   !> Reduced problem; the full one must outlive it
   type(reduced_problem), intent(inout) :: self
   !> Full problem
   class(discretisation_type), intent(in) :: full
   !> Orthonormal modes, shape (full n, r)
   real(wp), intent(in) :: modes(:, :)
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer :: ip, k

   if (size(modes, 1) /= full%n) then
      call fatal_error(error, err_input, 'modes have '//to_text(size(modes, 1)) &
         & //' entries, the model '//to_text(full%n)//' unknowns')
      return
   end if
   select type (full)
   class is (displacement_problem)
      allocate (self%base, source=full)
   class default
      call fatal_error(error, err_input, 'reduced models are made of collocation methods, not of ' &
         & //'method "'//full%scene%method//'"')
      return
   end select
   self%m = full%m
   self%n = size(modes, 2)
   self%extent = full%extent
   self%projected%m = self%m
   self%projected%n = self%n
   allocate (self%projected%a(self%m, self%n))
   allocate (self%base%mode(full%fields, full%shape%nq, self%n, full%shape%np))
   !$omp parallel do default(none) schedule(static) private(ip, k) shared(self, full, modes)
   do ip = 1, full%shape%np
      do k = 1, self%n
         call full%shape%interpolate(ip, modes(:, k), 1, full%shape%nq, &
            & self%base%mode(:, :, k, ip))
      end do
   end do
   !$omp end parallel do
end subroutine new_reduced

!> Fix the row weights of a load step
subroutine start_step(self, x, load)
   !> Problem
   class(reduced_problem), target, intent(inout) :: self
   !> Amplitudes at the start of the step, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load at the end of the step [-]
   real(wp), intent(in) :: load

   call self%base%start_step(x, load)
end subroutine start_step

!> Residuals and, where wanted, the rows of the full problem's fields
subroutine evaluate(self, x, load, tangent, r, state)
   !> Problem
   class(reduced_problem), target, intent(inout) :: self
   !> Amplitudes, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Linearise
   logical, intent(in) :: tangent
   !> Residuals, shape (m)
   real(wp), contiguous, intent(inout) :: r(:)
   !> What was seen
   type(evaluation_type), intent(out) :: state

   call self%base%evaluate(x, load, tangent, r, state)
end subroutine evaluate

!> Linearised rows A'U
function operator(self) result(op)
   !> Problem
   class(reduced_problem), target, intent(inout) :: self
   class(row_operator), pointer :: op
   integer :: b, i, k, q, row

   !$omp parallel do default(none) schedule(static) private(b, i, k, q, row) shared(self)
   do b = 1, size(self%base%rows%place)
      associate (rows => self%base%rows)
         row = rows%row(b)
         do k = 1, self%n
            do i = 1, rows%row(b + 1) - row
               self%projected%a(row + i, k) = 0.0_wp
               do q = rows%range(1, b), rows%range(2, b)
                  self%projected%a(row + i, k) = self%projected%a(row + i, k) &
                     & + dot_product(rows%coefficient(i, :, q, b), &
                     & self%base%mode(:, q, k, rows%place(b)))
               end do
            end do
         end do
      end associate
   end do
   !$omp end parallel do
   op => self%projected
end function operator

!> Second derivatives of r.r/2
subroutine hessian(self, x, load, r, a)
   !> Problem, its operator taken at x
   class(reduced_problem), target, intent(inout) :: self
   !> Amplitudes, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Residuals, shape (m)
   real(wp), contiguous, intent(in) :: r(:)
   !> Upper triangle, shape (r, r)
   real(wp), contiguous, intent(inout) :: a(:, :)
   real(wp), allocatable :: half(:, :)
   real(wp) :: y
   integer :: c, i, ip, k, l, nd, q

   call self%projected%normal(a)
   if (.not. self%base%nonlinear) return
   call self%base%set_curvature(x, load, r)
   nd = self%base%shape%nd
   allocate (half(nd*nd, self%n))
   associate (mode => self%base%mode, second => self%base%rows%second)
      do ip = 1, self%base%shape%np
         half = 0.0_wp
         do k = 1, self%n
            do q = 1, self%base%shape%nq
               do c = 1, self%base%fields
                  half(:, k) = half(:, k) + second(:, c, q, ip)*mode(c, q, k, ip)
               end do
            end do
         end do
         do k = 1, self%n
            do l = 1, self%n
               y = 0.0_wp
               do i = 1, nd
                  y = y + sum(mode(:nd, 1 + i, l, ip)*half(nd*(i - 1) + 1:nd*i, k))
               end do
               if (l <= k) a(l, k) = a(l, k) + y
               if (l >= k) a(k, l) = a(k, l) + y
            end do
         end do
      end do
   end associate
end subroutine hessian

end module rk_reduced
