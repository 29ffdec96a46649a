!> Rows of a sparse matrix for products with several vectors at once, which threads share by rows.
module rk_sparse_rows
   use rk_csr, only : csr_type
   use rk_precision, only : i8, wp
   implicit none
   private

   public :: sparse_rows, new_sparse_rows

   !> Rows with their entries
   type :: sparse_rows
      !> Columns of the entries of each row
      type(csr_type) :: place
      !> Entries
      real(wp), allocatable :: value(:)
   contains
      !> Product with vectors
      procedure :: product => product_with
   end type sparse_rows

contains

!> Take compressed rows without their zeros
subroutine new_sparse_rows(self, start, column, value)
   !> Rows
   type(sparse_rows), intent(out) :: self
   !> Row i has entries start(i)+1 : start(i+1), shape (m + 1)
   integer(i8), intent(in) :: start(:)
   !> Column of each entry less 1
   integer(i8), intent(in) :: column(:)
   !> Entries
   real(wp), intent(in) :: value(:)
   integer(i8) :: k, n
   integer :: i

   n = count(abs(value) > 0.0_wp, kind=i8)
   allocate (self%place%offset(size(start)), self%place%index(n), self%value(n))
   n = 0
   self%place%offset(1) = 0
   do i = 1, size(start) - 1
      do k = start(i) + 1, start(i + 1)
         if (.not. abs(value(k)) > 0.0_wp) cycle
         n = n + 1
         self%place%index(n) = int(column(k)) + 1
         self%value(n) = value(k)
      end do
      self%place%offset(i + 1) = n
   end do
end subroutine new_sparse_rows

!> y = A x or y + A x
subroutine product_with(self, x, y, add)
   !> Rows
   class(sparse_rows), intent(in) :: self
   !> Vectors, entry by entry, shape (k, columns)
   real(wp), contiguous, intent(in) :: x(:, :)
   !> Products, shape (k, rows)
   real(wp), contiguous, intent(inout) :: y(:, :)
   !> Add to y what is there
   logical, intent(in) :: add
   real(wp) :: solid(3), plane(2), line
   integer(i8) :: k
   integer :: i

   !$omp parallel do default(none) schedule(static) private(k, solid, plane, line) &
   !$omp shared(self, x, y, add)
   do i = 1, size(self%place%offset) - 1
      ! lengths that the compiler knows
      select case (size(x, 1))
      case (3)
         solid = 0.0_wp
         if (add) solid = y(:3, i)
         do k = self%place%offset(i) + 1, self%place%offset(i + 1)
            solid = solid + self%value(k)*x(:3, self%place%index(k))
         end do
         y(:3, i) = solid
      case (2)
         plane = 0.0_wp
         if (add) plane = y(:2, i)
         do k = self%place%offset(i) + 1, self%place%offset(i + 1)
            plane = plane + self%value(k)*x(:2, self%place%index(k))
         end do
         y(:2, i) = plane
      case default
         line = 0.0_wp
         if (add) line = y(1, i)
         do k = self%place%offset(i) + 1, self%place%offset(i + 1)
            line = line + self%value(k)*x(1, self%place%index(k))
         end do
         y(1, i) = line
      end select
   end do
   !$omp end parallel do
end subroutine product_with

end module rk_sparse_rows
