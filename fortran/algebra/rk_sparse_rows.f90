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

   !> Rows that are not worth a second thread
   integer, parameter :: few = 1000

contains

!> Take compressed rows without their zeros
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
   !> Add to y what is there
   logical, intent(in) :: add

   ! lengths that the compiler knows: one loop for all takes 1.2 to 1.6 times as long on rows of
   ! 7 entries
   associate (offset => self%place%offset, index => self%place%index)
      if (size(x, 1) == 3) then
         call three(size(offset) - 1, offset, index, self%value, x, y, add)
      else
         call some(size(x, 1), size(offset) - 1, offset, index, self%value, x, y, add)
      end if
   end associate
end subroutine product_with

!> The same for three vectors
subroutine three(rows, offset, index, value, x, y, add)
   integer, intent(in) :: rows
   !> Row i has entries offset(i)+1 : offset(i+1), shape (rows + 1)
   integer(i8), intent(in) :: offset(rows + 1)
   !> Columns
   integer, intent(in) :: index(*)
   !> Entries
   real(wp), intent(in) :: value(*)
   !> Factor
   real(wp), intent(in) :: x(3, *)
   !> Product
   real(wp), intent(inout) :: y(3, rows)
   !> Add to what is there
   logical, intent(in) :: add
   real(wp) :: sum(3)
   integer(i8) :: k
   integer :: i

   !$omp parallel do default(none) schedule(static) private(k, sum) if (rows > few) &
   !$omp shared(rows, offset, index, value, x, y, add)
   do i = 1, rows
      sum = 0.0_wp
      if (add) sum = y(:, i)
      do k = offset(i) + 1, offset(i + 1)
         sum = sum + value(k)*x(:, index(k))
      end do
      y(:, i) = sum
   end do
   !$omp end parallel do
end subroutine three

!> The same for any number of vectors
subroutine some(vectors, rows, offset, index, value, x, y, add)
   !> Vectors, rows
   integer, intent(in) :: vectors, rows
   integer(i8), intent(in) :: offset(rows + 1)
   integer, intent(in) :: index(*)
   real(wp), intent(in) :: value(*)
   !> Factor
   real(wp), intent(in) :: x(vectors, *)
   !> Product
   real(wp), intent(inout) :: y(vectors, rows)
   logical, intent(in) :: add
   real(wp) :: sum(vectors)
   integer(i8) :: k
   integer :: i

   !$omp parallel do default(none) schedule(static) private(k, sum) if (rows > few) &
   !$omp shared(rows, offset, index, value, x, y, add)
   do i = 1, rows
      sum = 0.0_wp
      if (add) sum = y(:, i)
      do k = offset(i) + 1, offset(i + 1)
         sum = sum + value(k)*x(:, index(k))
      end do
      y(:, i) = sum
   end do
   !$omp end parallel do
end subroutine some

end module rk_sparse_rows
