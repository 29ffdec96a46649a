!> A sparse symmetric matrix made of small blocks, assembled from dense parts and solved directly:
!> Cholesky where it is positive definite, LU otherwise, also where a skew part stands beside it.
!>
!> A factor of a large solid takes as long as dozens of solves with it. Matrices that follow one
!> another differ little: minimal residuals with the last factor come first there.
module rk_symmetric
   use rk_csr, only : csr_type, sort
   use rk_cuthill, only : cuthill_mckee
   use rk_error, only : error_type, err_input, err_memory
   use rk_lapack, only : solve_band
   use rk_minres, only : minres, symmetric_system
   use rk_operator, only : square_operator, square_report
   use rk_precision, only : i8, wp
   use rk_sparse, only : solve_sparse, sparse_factor
   implicit none
   private

   public :: symmetric_matrix, new_symmetric

   !> Upper triangle in compressed columns. Unknowns come in blocks of the same size, and so do the
   !> entries: a pair of blocks is there as a whole or not at all.
   type, extends(square_operator) :: symmetric_matrix
      !> Unknowns in a block
      integer :: block = 1
      !> Known not to be definite: no attempt at Cholesky
      logical :: indefinite = .false.
      !> The last factor stays for further solves
      logical :: keeps = .false.
      !> Column j has entries start(j)+1 : start(j+1), shape (n + 1)
      integer(i8), allocatable :: start(:)
      !> Row of each entry less 1
      integer(i8), allocatable :: row(:)
      !> Entries
      real(wp), allocatable :: value(:)
      !> Entries of a skew part in the same places, not allocated where there is none
      real(wp), allocatable :: skew(:)
      !> Blocks of each column of blocks by their row, ascending, the diagonal one last
      type(csr_type), private :: above
      !> What the factors have in common
      type(sparse_factor), pointer, private :: kept => null()
   contains
      procedure :: apply, apply_transposed, compressed, solve_square, solve_with, solve_again
      procedure :: let_go, add, product => product_with, add_skew
      final :: free
   end type symmetric_matrix

   !> A matrix and the factor of another one in the same places
   type, extends(symmetric_system) :: preconditioned_type
      type(symmetric_matrix), pointer :: places => null()
      real(wp), pointer, contiguous :: given(:) => null()
   contains
      procedure :: multiply, precondition
   end type preconditioned_type

   !> Solves that a factor must be worth before the last one is tried, share of them that are made,
   !> and the residual that they must reach: a step of Newton that is off by so much costs no
   !> further iteration [-]
   real(wp), parameter :: worth = 20.0_wp, tried = 0.6_wp, exact = 1.0e-5_wp
   !> Shares of the diagonal that are added to a matrix that is not positive definite, one after the
   !> other, and iterations with the factor of the sum: LU takes several times its time and memory
   real(wp), parameter :: added(3) = [1.0e-3_wp, 1.0e-2_wp, 1.0e-1_wp]
   integer, parameter :: most = 60

contains

!> Places of the entries: blocks of one group are all coupled. Values are zero.
subroutine new_symmetric(self, block, blocks, group)
   type(symmetric_matrix), intent(out) :: self
   !> Unknowns in a block
   integer, intent(in) :: block
   !> Number of blocks along the diagonal
   integer, intent(in) :: blocks
   !> Blocks of each group, ascending
   type(csr_type), intent(in) :: group
   !> Groups of each block
   type(csr_type) :: groups
   integer, allocatable :: mark(:)
   integer(i8) :: k, l
   integer :: i, j, n, pass

   self%block = block
   allocate (self%kept)
   self%n = block*blocks
   self%m = self%n
   call group%transposed(blocks, groups)
   allocate (self%above%offset(blocks + 1), mark(blocks))
   self%above%offset(1) = 0
   do pass = 1, 2
      mark = 0
      do j = 1, blocks
         n = 0
         do k = groups%offset(j) + 1, groups%offset(j + 1)
            do l = group%offset(groups%index(k)) + 1, group%offset(groups%index(k) + 1)
               i = group%index(l)
               if (i > j) exit
               if (mark(i) == j) cycle
               mark(i) = j
               n = n + 1
               if (pass == 2) self%above%index(self%above%offset(j) + n) = i
            end do
         end do
         if (pass == 1) then
            self%above%offset(j + 1) = self%above%offset(j) + n
         else
            call sort(self%above%index(self%above%offset(j) + 1:self%above%offset(j + 1)))
         end if
      end do
      if (pass == 1) allocate (self%above%index(self%above%offset(blocks + 1)))
   end do

   allocate (self%start(self%n + 1))
   self%start(1) = 0
   do j = 1, blocks
      n = int(self%above%offset(j + 1) - self%above%offset(j))
      do i = 1, block
         k = (j - 1)*block + i
         self%start(k + 1) = self%start(k) + block*(n - 1) + i
      end do
   end do
   allocate (self%row(self%start(self%n + 1)))
   allocate (self%value(self%start(self%n + 1)), source=0.0_wp)
   do j = 1, blocks
      do i = 1, block
         k = self%start((j - 1)*block + i)
         do l = self%above%offset(j) + 1, self%above%offset(j + 1)
            do n = 1, merge(i, block, l == self%above%offset(j + 1))
               k = k + 1
               self%row(k) = int(self%above%index(l) - 1, i8)*block + n - 1
            end do
         end do
      end do
   end do
end subroutine new_symmetric

!> Add a dense part; of a the upper triangle counts
subroutine add(self, value, member, a)
   !> Places of the entries
   class(symmetric_matrix), intent(in) :: self
   !> Entries, shape (entries)
   real(wp), intent(inout) :: value(:)
   !> Blocks of the part, ascending, shape (k)
   integer, intent(in) :: member(:)
   !> Part, shape (block*k, block*k)
   real(wp), contiguous, intent(in) :: a(:, :)
   integer(i8) :: l, to
   integer :: b, i, j, k, n, c

   b = self%block
   do j = 1, size(member)
      l = self%above%offset(member(j))
      i = 1
      do while (i <= j)
         l = l + 1
         do while (self%above%index(l) < member(i))
            l = l + 1
         end do
         ! i to k stand side by side in both
         do k = i, j - 1
            if (self%above%index(l + 1) /= member(k + 1)) exit
            l = l + 1
         end do
         do c = 1, b
            n = merge((k - 1)*b + c, k*b, k == j) - (i - 1)*b
            to = self%start(member(j)*b - b + c) + b*(l - self%above%offset(member(j)) - 1 - k + i)
            value(to + 1:to + n) = value(to + 1:to + n) &
               & + a((i - 1)*b + 1:(i - 1)*b + n, (j - 1)*b + c)
         end do
         i = k + 1
      end do
   end do
end subroutine add

subroutine apply(self, x, y)
   class(symmetric_matrix), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)

   call self%product(self%value, x, y)
   call self%add_skew(1.0_wp, x, y)
end subroutine apply

subroutine apply_transposed(self, x, y)
   class(symmetric_matrix), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)

   call self%product(self%value, x, y)
   call self%add_skew(-1.0_wp, x, y)
end subroutine apply_transposed

!> Add the product of the skew part, where there is one, with a vector
subroutine add_skew(self, sign, x, y)
   class(symmetric_matrix), intent(in) :: self
   !> 1, or -1 for its transpose
   real(wp), intent(in) :: sign
   real(wp), contiguous, intent(in) :: x(:)
   !> Sum, shape (n)
   real(wp), contiguous, intent(inout) :: y(:)
   integer(i8) :: k, i
   integer :: j

   if (.not. allocated(self%skew)) return
   do j = 1, self%n
      do k = self%start(j) + 1, self%start(j + 1) - 1
         i = self%row(k) + 1
         y(i) = y(i) + sign*self%skew(k)*x(j)
         y(j) = y(j) - sign*self%skew(k)*x(i)
      end do
   end do
end subroutine add_skew

!> Product of other entries in the same places with a vector
subroutine product_with(self, value, x, y)
   class(symmetric_matrix), intent(in) :: self
   real(wp), contiguous, intent(in) :: value(:)
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)
   integer(i8) :: at, k, l, last
   integer :: b, c, i, j

   y = 0.0_wp
   b = self%block
   do j = 1, self%n/b
      k = self%above%offset(j) + 1
      last = self%above%offset(j + 1)
      at = 0
      ! blocks k to l stand side by side; reading their rows would take as long as their entries
      do while (k < last)
         l = k
         do while (l + 1 < last)
            if (self%above%index(l + 1) /= self%above%index(l) + 1) exit
            l = l + 1
         end do
         i = b*(self%above%index(k) - 1)
         do c = b*(j - 1) + 1, b*j
            call add_column(b*int(l - k + 1), value(self%start(c) + at + 1:), x(i + 1:), x(c), &
               & y(i + 1:), y(c))
         end do
         at = at + b*(l - k + 1)
         k = l + 1
      end do
      do c = b*(j - 1) + 1, b*j
         i = b*(j - 1)
         call add_column(c - i - 1, value(self%start(c) + at + 1:), x(i + 1:), x(c), y(i + 1:), &
            & y(c))
         y(c) = y(c) + value(self%start(c + 1))*x(c)
      end do
   end do
end subroutine product_with

!> Some entries of a column above the diagonal, and of its row
pure subroutine add_column(n, a, x, x_own, y, y_own)
   !> Entries
   integer, intent(in) :: n
   !> Entries, vector in their rows and in that of the column
   real(wp), intent(in) :: a(n), x(n), x_own
   !> Products there
   real(wp), intent(inout) :: y(n), y_own
   real(wp) :: sum
   integer :: k

   sum = 0.0_wp
   !$omp simd reduction(+: sum)
   do k = 1, n
      sum = sum + a(k)*x(k)
      y(k) = y(k) + a(k)*x_own
   end do
   y_own = y_own + sum
end subroutine add_column

!> Both triangles in compressed rows
subroutine compressed(self, start, column, value)
   class(symmetric_matrix), intent(in) :: self
   integer(i8), allocatable, intent(out) :: start(:)
   integer(i8), allocatable, intent(out) :: column(:)
   real(wp), allocatable, intent(out) :: value(:)

   call both_triangles(self, self%value, 1.0_wp, start, column, value)
end subroutine compressed

!> Other entries in the same places, both triangles in compressed rows; with the skew part, or its
!> transpose, whose rows are the columns
subroutine both_triangles(self, given, sign, start, column, value)
   class(symmetric_matrix), intent(in) :: self
   !> Entries of the upper triangle, shape (entries)
   real(wp), intent(in) :: given(:)
   !> 1 for rows of the skew part, -1 for those of its transpose
   real(wp), intent(in) :: sign
   !> Row i has entries start(i)+1 : start(i+1), shape (m + 1)
   integer(i8), allocatable, intent(out) :: start(:)
   integer(i8), allocatable, intent(out) :: column(:)
   !> Entries
   real(wp), allocatable, intent(out) :: value(:)
   !> Columns of blocks in which each row of blocks has an entry, the diagonal one first
   type(csr_type) :: later
   integer(i8), allocatable :: entry(:)
   integer(i8) :: at, k, l, place
   integer :: b, c, i, j, row

   b = self%block
   call self%above%transposed(self%n/b, later, entry)
   allocate (start(self%n + 1))
   start(1) = 0
   do j = 1, self%n
      start(j + 1) = start(j) + self%start(j + 1) - self%start(j) + b*((j + b - 1)/b) - j &
         & + b*(later%offset((j + b - 1)/b + 1) - later%offset((j + b - 1)/b) - 1)
   end do
   allocate (column(start(self%n + 1)), value(start(self%n + 1)))
   do j = 1, self%n/b
      do i = 1, b
         row = (j - 1)*b + i
         ! by symmetry a row begins with the entries of its column; those of later columns follow
         at = start(row) + self%start(row + 1) - self%start(row)
         column(start(row) + 1:at) = self%row(self%start(row) + 1:self%start(row + 1))
         value(start(row) + 1:at) = given(self%start(row) + 1:self%start(row + 1))
         if (allocated(self%skew)) value(start(row) + 1:at) = value(start(row) + 1:at) &
            & - sign*self%skew(self%start(row) + 1:self%start(row + 1))
         do k = later%offset(j) + 1, later%offset(j + 1)
            do c = merge(i + 1, 1, later%index(k) == j), b
               l = (later%index(k) - 1)*b + c
               at = at + 1
               column(at) = l - 1
               place = self%start(l) + b*(entry(k) - self%above%offset(later%index(k)) - 1) + i
               value(at) = given(place)
               if (allocated(self%skew)) value(at) = value(at) + sign*self%skew(place)
            end do
         end do
      end do
   end do
end subroutine both_triangles

!> Solve (A + shift |D|) x = b with the diagonal D of A
recursive subroutine solve_square(self, shift, b, x, report, error)
   class(symmetric_matrix), target, intent(inout) :: self
   real(wp), intent(in) :: shift
   real(wp), contiguous, intent(in) :: b(:)
   real(wp), contiguous, intent(inout) :: x(:)
   type(square_report), intent(out) :: report
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: shifted(:)
   integer :: j

   if (.not. shift > 0.0_wp) then
      call solve_with(self, self%value, b, x, report, error)
      return
   end if
   shifted = self%value
   do j = 1, self%n
      associate (diagonal => shifted(self%start(j + 1)))
         diagonal = diagonal + shift*abs(diagonal)
      end associate
   end do
   call solve_with(self, shifted, b, x, report, error)
end subroutine solve_square

!> Solve with other entries in the same places
subroutine solve_with(self, given, b, x, report, error)
   class(symmetric_matrix), target, intent(in) :: self
   real(wp), contiguous, target, intent(in) :: given(:)
   !> Right hand side, shape (n)
   real(wp), contiguous, intent(in) :: b(:)
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> What was used and how good it is
   type(square_report), intent(out) :: report
   !> Error handling: singular matrix, no memory
   type(error_type), allocatable, intent(out) :: error
   integer(i8), allocatable :: start(:), column(:), order(:)
   real(wp), allocatable :: value(:), r(:)
   real(wp) :: norm
   logical :: definite, found

   definite = .not. (self%indefinite .or. allocated(self%skew))
   found = .false.
   if (definite .and. .not. self%keeps) call solve_by_last(self, given, &
      & nint(tried*self%kept%cost()), b, x, report, found)
   if (found) return
   report%used = 'cholesky'
   report%why = 'the tangent is square and symmetric: Cholesky, or LU where it is not positive ' &
      & //'definite'
   if (allocated(self%skew)) then
      report%why = 'the tangent has the skew part of a pressure whose surface has a free rim: LU'
   else if (self%indefinite) then
      report%why = 'the tangent has pressures as unknowns and is not definite: LU'
   end if
   if (definite) then
      ! not allocated it is no argument
      if (.not. self%kept%cost() > 0.0_wp) order = unknowns_along(self)
      call solve_sparse(self%n, self%start, self%row, given, .true., self%keeps, b, x, &
         & report%rcond, self%kept, error, order)
   end if
   if (.not. definite .or. allocated(error)) then
      if (allocated(error)) then
         if (error%code == err_memory) return
         report%indefinite = error%code /= err_input
         call solve_beside(self, given, b, x, report, found)
         if (found) deallocate (error)
         if (found) return
      end if
      report%used = 'lu'
      ! columns
      call both_triangles(self, given, -1.0_wp, start, column, value)
      call solve_sparse(self%n, start, column, value, .false., self%keeps, b, x, report%rcond, &
         & self%kept, error)
   end if
   if (allocated(error)) then
      if (error%code /= err_input) return
      report%used = 'band'
      call both_triangles(self, given, 1.0_wp, start, column, value)
      call solve_band(start, column, value, b, x, report%rcond, error)
   end if
   if (allocated(error)) return
   allocate (r(self%n))
   call self%product(given, x, r)
   call self%add_skew(1.0_wp, x, r)
   norm = sqrt(sum(given**2))
   report%backward_error = norm2(r - b)/max(norm*norm2(x) + norm2(b), tiny(1.0_wp))
end subroutine solve_with

!> Solve with the last factor of another matrix, which is not far from this one
subroutine solve_by_last(self, given, limit, b, x, report, found)
   type(symmetric_matrix), target, intent(in) :: self
   real(wp), contiguous, target, intent(in) :: given(:)
   integer, intent(in) :: limit
   real(wp), contiguous, intent(in) :: b(:)
   !> Solution where it was found, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   type(square_report), intent(inout) :: report
   !> Whether it was found
   logical, intent(out) :: found
   type(preconditioned_type) :: system

   found = .false.
   if (.not. self%kept%ready .or. self%kept%cost() < worth) return
   system%size = self%n
   system%places => self
   system%given => given
   call minres(system, b, exact, limit, x, report%iterations, report%backward_error)
   found = report%backward_error <= exact
   if (.not. found) then
      report%iterations = 0
      return
   end if
   report%used = 'minres'
   report%why = 'the tangent is near one that was factorised: minimal residuals with its ' &
      & //'Cholesky factor'
end subroutine solve_by_last

!> Solve where the matrix is not positive definite with the factor of one that is
subroutine solve_beside(self, given, b, x, report, found)
   type(symmetric_matrix), target, intent(in) :: self
   real(wp), contiguous, target, intent(in) :: given(:)
   real(wp), contiguous, intent(in) :: b(:)
   real(wp), contiguous, intent(inout) :: x(:)
   type(square_report), intent(inout) :: report
   logical, intent(out) :: found
   type(error_type), allocatable :: error
   real(wp), allocatable :: sum(:)
   integer :: j, k

   found = .false.
   if (self%keeps .or. self%kept%far .or. self%kept%cost() < worth) return
   do k = 1, size(added)
      sum = given
      do j = 1, self%n
         associate (diagonal => sum(self%start(j + 1)))
            diagonal = diagonal + added(k)*abs(diagonal)
         end associate
      end do
      call solve_sparse(self%n, self%start, self%row, sum, .true., .false., b, x, report%rcond, &
         & self%kept, error)
      if (.not. allocated(error)) exit
      deallocate (error)
   end do
   call solve_by_last(self, given, most, b, x, report, found)
   self%kept%far = .not. found
end subroutine solve_beside

subroutine multiply(self, x, y)
   class(preconditioned_type), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)

   call self%places%product(self%given, x, y)
end subroutine multiply

subroutine precondition(self, x, y)
   class(preconditioned_type), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)

   y = x
   call self%places%solve_again(y)
end subroutine precondition

!> Unknowns less 1 along the body, an order of elimination
function unknowns_along(self) result(order)
   class(symmetric_matrix), intent(in) :: self
   !> Unknowns less 1, shape (n)
   integer(i8), allocatable :: order(:)
   integer, allocatable :: along(:)
   integer :: i

   allocate (order(self%n))
   along = cuthill_mckee(self%above)
   do i = 1, self%block
      order(i::self%block) = self%block*(along - 1_i8) + i - 1
   end do
end function unknowns_along

!> Solve in place with the factor of the last solve, which is there where the matrix keeps it
subroutine solve_again(self, x)
   class(symmetric_matrix), intent(in) :: self
   !> Right hand side, replaced by the solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)

   call self%kept%solve(x)
end subroutine solve_again

!> Solve the next equations by a factor of their own
subroutine let_go(self)
   class(symmetric_matrix), intent(in) :: self

   if (.not. associated(self%kept)) return
   self%kept%ready = .false.
   self%kept%far = .false.
end subroutine let_go

subroutine free(self)
   type(symmetric_matrix), intent(inout) :: self

   if (associated(self%kept)) deallocate (self%kept)
end subroutine free

end module rk_symmetric
