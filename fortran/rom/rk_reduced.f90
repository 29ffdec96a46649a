!> Least squares Galerkin reduction of a collocation problem (6.60)-(6.67).
!>
!> The shape functions are projected on the modes once. Displacement, F and its derivatives at a
!> collocation point are then sums over the modes, and the rows of A'U follow from them without the
!> full A': the same numbers to rounding, without the number of source points in the cost.
module rk_reduced
   use rk_collocation, only : collocation_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_lstsq, only : row_operator
   use rk_matrix, only : matrix_rows
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: reduced_type, new_reduced

   !> A collocation problem in the span of modes; unknowns are the modes' amplitudes
   type, extends(collocation_type) :: reduced_type
      !> Displacement and derivatives of each mode at each place, shape (nd, nq, r, np)
      real(wp), allocatable :: mode(:, :, :, :)
      !> A'U
      type(matrix_rows) :: projected
   contains
      procedure :: displacement
      procedure :: operator
   end type reduced_type

contains

!> Project a full problem on modes
subroutine new_reduced(self, full, modes, error)
   !> Reduced problem; the full one must outlive it
   type(reduced_type), intent(inout) :: self
   !> Full problem
   type(collocation_type), intent(in) :: full
   !> Orthonormal modes, shape (full n, r)
   real(wp), intent(in) :: modes(:, :)
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   integer :: ip, k, nd

   if (size(modes, 1) /= full%n) then
      call fatal_error(error, err_input, 'modes have '//to_text(size(modes, 1)) &
         & //' entries, the model '//to_text(full%n)//' unknowns')
      return
   end if
   self%collocation_type = full
   nd = full%scene%cloud%nd
   self%n = size(modes, 2)
   self%projected%m = self%m
   self%projected%n = self%n
   allocate (self%projected%a(self%m, self%n), self%mode(nd, self%shape%nq, self%n, self%shape%np))
   !$omp parallel do default(none) schedule(static) private(ip, k) shared(self, modes)
   do ip = 1, self%shape%np
      do k = 1, self%n
         call self%shape%interpolate(ip, modes(:, k), 1, self%shape%nq, self%mode(:, :, k, ip))
      end do
   end do
   !$omp end parallel do
end subroutine new_reduced

!> Displacement and derivatives at a collocation point from the modes' amplitudes
subroutine displacement(self, ip, x, last, u)
   !> Problem
   class(reduced_type), intent(in) :: self
   !> Collocation point
   integer, intent(in) :: ip
   !> Amplitudes, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   !> Last derivative wanted
   integer, intent(in) :: last
   !> Displacement with derivatives, shape (nd, nq) [length], [-], [1/length]
   real(wp), intent(out) :: u(:, :)
   integer :: k

   u = 0.0_wp
   do k = 1, self%n
      u(:, :last) = u(:, :last) + x(k)*self%mode(:, :last, k, ip)
   end do
end subroutine displacement

!> Linearised rows A'U
function operator(self) result(op)
   !> Problem
   class(reduced_type), target, intent(inout) :: self
   class(row_operator), pointer :: op
   integer :: b, i, k, q, row

   !$omp parallel do default(none) schedule(static) private(b, i, k, q, row) shared(self)
   do b = 1, size(self%rows%place)
      row = self%rows%row(b)
      do k = 1, self%n
         do i = 1, self%rows%row(b + 1) - row
            self%projected%a(row + i, k) = 0.0_wp
            do q = self%rows%range(1, b), self%rows%range(2, b)
               self%projected%a(row + i, k) = self%projected%a(row + i, k) &
                  & + dot_product(self%rows%coefficient(i, :, q, b), &
                  & self%mode(:, q, k, self%rows%place(b)))
            end do
         end do
      end do
   end do
   !$omp end parallel do
   op => self%projected
end function operator

end module rk_reduced
