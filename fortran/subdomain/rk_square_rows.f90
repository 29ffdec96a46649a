!> A sparse square matrix in compressed rows, without symmetry, solved by LU.
module rk_square_rows
   use rk_envelope, only : envelope_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_lapack, only : solve_band, syrk
   use rk_operator, only : square_operator, square_report
   use rk_precision, only : i8, wp
   use rk_sparse, only : kept_factor, solve_sparse
   use rk_text, only : to_text
   implicit none
   private

   public :: square_rows, new_square_rows

   !> Rows with their entries
   type, extends(square_operator) :: square_rows
      !> Row i has entries start(i)+1 : start(i+1), shape (n + 1)
      integer(i8), allocatable :: start(:)
      !> Column of each entry less 1, ascending in each row
      integer(i8), allocatable :: column(:)
      !> Entries
      real(wp), allocatable :: value(:)
      !> The same by columns: row of each entry less 1, and where its value stands
      integer(i8), allocatable, private :: below(:), row(:), entry(:)
      !> Order of elimination of the factors
      type(kept_factor), pointer, private :: kept => null()
   contains
      procedure :: apply
      procedure :: apply_transposed
      procedure :: envelope
      procedure :: normal
      procedure :: dense
      procedure :: compressed
      procedure :: entries
      procedure :: solve_square
      final :: free
   end type square_rows

contains

!> Places of the entries, whose values are zero
subroutine new_square_rows(self, start, column)
   !> Matrix
   type(square_rows), intent(out) :: self
   !> Row i has entries start(i)+1 : start(i+1), shape (n + 1)
   integer(i8), intent(in) :: start(:)
   !> Column of each entry less 1, ascending in each row
   integer(i8), intent(in) :: column(:)
   integer(i8), allocatable :: at(:)
   integer(i8) :: k
   integer :: i

   allocate (self%kept)
   self%n = size(start) - 1
   self%m = self%n
   self%start = start
   self%column = column
   allocate (self%value(size(column, kind=i8)), source=0.0_wp)
   allocate (self%below(self%n + 1), source=0_i8)
   allocate (self%row, self%entry, mold=column)
   do k = 1, size(column, kind=i8)
      self%below(column(k) + 2) = self%below(column(k) + 2) + 1
   end do
   do i = 1, self%n
      self%below(i + 1) = self%below(i + 1) + self%below(i)
   end do
   at = self%below
   do i = 1, self%n
      do k = start(i) + 1, start(i + 1)
         associate (next => at(column(k) + 1))
            next = next + 1
            self%row(next) = i - 1
            self%entry(next) = k
         end associate
      end do
   end do
end subroutine new_square_rows

!> y = A x
subroutine apply(self, x, y)
   !> Matrix
   class(square_rows), intent(in) :: self
   !> Vector, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Product, shape (n)
   real(wp), contiguous, intent(inout) :: y(:)
   integer(i8) :: k
   integer :: i

   !$omp parallel do default(none) schedule(static) private(k) shared(self, x, y)
   do i = 1, self%n
      y(i) = 0.0_wp
      do k = self%start(i) + 1, self%start(i + 1)
         y(i) = y(i) + self%value(k)*x(self%column(k) + 1)
      end do
   end do
   !$omp end parallel do
end subroutine apply

!> y = A^T x
subroutine apply_transposed(self, x, y)
   !> Matrix
   class(square_rows), intent(in) :: self
   !> Vector, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Product, shape (n)
   real(wp), contiguous, intent(inout) :: y(:)
   integer(i8) :: k
   integer :: j

   !$omp parallel do default(none) schedule(static) private(k) shared(self, x, y)
   do j = 1, self%n
      y(j) = 0.0_wp
      do k = self%below(j) + 1, self%below(j + 1)
         y(j) = y(j) + self%value(self%entry(k))*x(self%row(k) + 1)
      end do
   end do
   !$omp end parallel do
end subroutine apply_transposed

!> The matrix has no tall rows whose product A^T A were worth an envelope
subroutine envelope(self, a, error)
   !> Matrix
   class(square_rows), intent(in) :: self
   !> Unused
   type(envelope_type), intent(inout) :: a
   !> Error handling: always
   type(error_type), allocatable, intent(out) :: error

   associate (unused => a)
   end associate
   call fatal_error(error, err_input, 'a square matrix of '//to_text(self%n) &
      & //' unknowns is solved by LU, or for comparison by solver.linear "dgels" or "dgelsy"')
end subroutine envelope

!> Upper triangle of A^T A
subroutine normal(self, a)
   !> Matrix
   class(square_rows), intent(in) :: self
   !> Product, shape (n, n)
   real(wp), contiguous, intent(inout) :: a(:, :)
   real(wp), allocatable :: full(:, :)

   allocate (full(self%n, self%n))
   call self%dense(full)
   call syrk(full, self%n, self%n, a)
end subroutine normal

!> All entries
subroutine dense(self, a)
   !> Matrix
   class(square_rows), intent(in) :: self
   !> Entries, shape (n, n)
   real(wp), contiguous, intent(inout) :: a(:, :)
   integer(i8) :: k
   integer :: i

   a = 0.0_wp
   do i = 1, self%n
      do k = self%start(i) + 1, self%start(i + 1)
         a(i, self%column(k) + 1) = self%value(k)
      end do
   end do
end subroutine dense

!> The rows
subroutine compressed(self, start, column, value)
   !> Matrix
   class(square_rows), intent(in) :: self
   !> Row i has entries start(i)+1 : start(i+1), shape (n + 1)
   integer(i8), allocatable, intent(out) :: start(:)
   !> Column of each entry less 1
   integer(i8), allocatable, intent(out) :: column(:)
   !> Entries
   real(wp), allocatable, intent(out) :: value(:)

   start = self%start
   column = self%column
   value = self%value
end subroutine compressed

!> Number of entries
pure real(wp) function entries(self)
   !> Matrix
   class(square_rows), intent(in) :: self

   entries = real(self%start(self%n + 1), wp)
end function entries

!> Solve (A + shift D) x = b with the diagonal D of A
recursive subroutine solve_square(self, shift, b, x, report, error)
   !> Matrix
   class(square_rows), target, intent(in) :: self
   !> Damping in units of the diagonal, >= 0 [-]
   real(wp), intent(in) :: shift
   !> Right hand side, shape (n)
   real(wp), contiguous, intent(in) :: b(:)
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> What was used and how good it is
   type(square_report), intent(out) :: report
   !> Error handling: singular matrix, no memory
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: value(:), r(:)
   integer(i8) :: k
   integer :: j

   report%used = 'lu'
   report%why = 'balances of cells make a square matrix without symmetry: LU'
   value = self%value(self%entry)
   do j = 1, self%n
      do k = self%below(j) + 1, self%below(j + 1)
         if (self%row(k) == j - 1) value(k) = (1.0_wp + shift)*value(k)
      end do
   end do
   call solve_sparse(self%n, self%below, self%row, value, .false., .false., b, x, report%rcond, &
      & self%kept, error)
   if (allocated(error)) then
      if (error%code /= err_input) return
      report%used = 'band'
      value(self%entry) = value
      call solve_band(self%start, self%column, value, b, x, report%rcond, error)
   end if
   if (allocated(error)) return
   allocate (r(self%n))
   call self%apply(x, r)
   report%backward_error = norm2(r - b)/max(norm2(self%value)*norm2(x) + norm2(b), &
      & tiny(1.0_wp))
end subroutine solve_square

!> Give back what was kept
subroutine free(self)
   !> Matrix
   type(square_rows), intent(inout) :: self

   if (associated(self%kept)) deallocate (self%kept)
end subroutine free

end module rk_square_rows
