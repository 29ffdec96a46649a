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

   !> Number of rows up to which a second thread does not pay off
   integer, parameter :: few = 1000

contains

!> Copy compressed rows without their zeros
subroutine new_sparse_rows(self, start, column, value)
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
   class(sparse_rows), intent(in) :: self
   !> Vectors, entry by entry, shape (k, columns)
   real(wp), contiguous, intent(in) :: x(:, :)
   !> Products, shape (k, rows)
   real(wp), contiguous, intent(inout) :: y(:, :)
   !> Add the product to y
   logical, intent(in) :: add
   integer :: i, rows

   rows = size(self%place%offset) - 1
   !$omp parallel do default(none) schedule(static) if (rows > few) shared(rows, self, x, y, add)
   do i = 1, rows
      associate (first => self%place%offset(i) + 1, last => self%place%offset(i + 1))
         ! a size known to the compiler: rows of 7 entries take 1.2 to 1.6 times as long without
         if (size(x, 1) == 3) then
            call add_row(3, self%place%index(first:last), self%value(first:last), x, add, y(:, i))
         else
            call add_row(size(x, 1), self%place%index(first:last), self%value(first:last), x, add, &
               & y(:, i))
         end if
      end associate
   end do
   !$omp end parallel do
end subroutine product_with

!> The same for one row
pure subroutine add_row(vectors, index, value, x, add, y)
   !> Vectors, at most three
   integer, intent(in) :: vectors
   !> Columns and entries of the row
   integer, contiguous, intent(in) :: index(:)
   real(wp), contiguous, intent(in) :: value(:)
   real(wp), intent(in) :: x(vectors, *)
   logical, intent(in) :: add
   !> Products of the row
   real(wp), intent(inout) :: y(vectors)
   real(wp) :: sum(3)
   integer :: k

   sum = 0.0_wp
   if (add) sum(:vectors) = y
   do k = 1, size(index)
      sum(:vectors) = sum(:vectors) + value(k)*x(:, index(k))
   end do
   y = sum(:vectors)
end subroutine add_row

end module rk_sparse_rows
