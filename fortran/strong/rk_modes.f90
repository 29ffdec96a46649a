!> Unknown fields in the span of modes (6.60)-(6.67).
!>
!> The shape functions are projected on the modes once. Displacement, F and its derivatives at a
!> collocation point are then sums over the modes, and the rows of A'U follow from them without the
!> full A': the same numbers up to rounding, at a cost that does not depend on the source points.
module rk_modes
   use rk_precision, only : wp
   use rk_rows, only : rows_type
   use rk_shape, only : shape_type
   implicit none
   private

   public :: modes_type, new_modes

   !> Modes at the places of rows
   type :: modes_type
      private
      !> Fields and derivatives of each mode at each place, shape (fields, nq, r, np)
      real(wp), allocatable :: value(:, :, :, :)
   contains
      procedure :: field, project
   end type modes_type

contains

!> Project the shape functions
subroutine new_modes(self, shape, fields, vectors)
   type(modes_type), intent(out) :: self
   !> Shape functions at the places
   type(shape_type), intent(in) :: shape
   !> Unknown fields
   integer, intent(in) :: fields
   !> Orthonormal modes, shape (n, r)
   real(wp), intent(in) :: vectors(:, :)
   integer :: ip, k

   allocate (self%value(fields, shape%nq, size(vectors, 2), shape%np))
   !$omp parallel do default(none) schedule(static) private(ip, k) shared(self, shape, vectors)
   do ip = 1, shape%np
      do k = 1, size(vectors, 2)
         call shape%interpolate(ip, vectors(:, k), 1, shape%nq, self%value(:, :, k, ip))
      end do
   end do
   !$omp end parallel do
end subroutine new_modes

!> Fields and derivatives at a place from amplitudes
pure subroutine field(self, ip, x, last, u)
   class(modes_type), intent(in) :: self
   !> Place
   integer, intent(in) :: ip
   !> Amplitudes, shape (r)
   real(wp), intent(in) :: x(:)
   !> Last derivative wanted
   integer, intent(in) :: last
   !> Fields with derivatives, shape (fields, nq)
   real(wp), intent(out) :: u(:, :)
   integer :: k

   u = 0.0_wp
   do k = 1, size(self%value, 3)
      u(:, :last) = u(:, :last) + x(k)*self%value(:, :last, k, ip)
   end do
end subroutine field

!> Rows times the modes, A'U
subroutine project(self, rows, a)
   class(modes_type), intent(in) :: self
   type(rows_type), intent(in) :: rows
   !> Product, shape (m, r)
   real(wp), intent(inout) :: a(:, :)
   integer :: b, i, k, q, row

   !$omp parallel do default(none) schedule(static) private(b, i, k, q, row) shared(self, rows, a)
   do b = 1, size(rows%place)
      row = rows%row(b)
      do k = 1, size(a, 2)
         do i = 1, rows%row(b + 1) - row
            a(row + i, k) = 0.0_wp
            do q = rows%range(1, b), rows%range(2, b)
               a(row + i, k) = a(row + i, k) + dot_product(rows%coefficient(i, :, q, b), &
                  & self%value(:, q, k, rows%place(b)))
            end do
         end do
      end do
   end do
   !$omp end parallel do
end subroutine project

end module rk_modes
