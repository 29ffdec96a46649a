!> A sparse symmetric matrix made of small blocks, assembled from dense parts and solved directly:
!> by Cholesky if it is positive definite, by LU otherwise and if a skew part is added to it.
!>
!> Factorising a large solid takes as long as dozens of solves. Its factor is in single precision,
!> in half of the memory and time, and minimal residuals recover the remaining digits in two
!> iterations. Successive matrices differ little: the last factor is tried first.
module rk_symmetric
   use rk_csr, only : csr_type, envelope_order, sort
   use rk_error, only : error_type, err_memory
   use rk_minres, only : minres, symmetric_system
   use rk_operator, only : square_operator, square_report
   use rk_precision, only : i8, sp, wp
   use rk_single_envelope, only : envelope_type, new_envelope
   use rk_sparse, only : solve_sparse, sparse_factor
   implicit none
   private

   public :: symmetric_matrix, new_symmetric, packed_entries, new_packed

   !> Factor in single precision, of the matrix scaled to a unit diagonal
   type :: near_factor
      type(envelope_type) :: matrix
      !> Number of operations of a factorisation
      real(wp) :: operations = 0.0_wp
      !> Number of solves with the factor that take as long as a factorisation
      real(wp) :: cost = 0.0_wp
      !> Share of the diagonal that was added before the last factorisation
      real(wp) :: share = 0.0_wp
      !> A factor is available; single precision, or the memory, does not suffice; a matrix was too
      !> far from a positive definite one for any factor
      logical :: ready = .false., coarse = .false., far = .false.
   end type near_factor

   !> Upper triangle in compressed columns. Unknowns come in blocks of the same size, and so do the
   !> entries: the block of a coupled pair is stored in full.
   type, extends(square_operator) :: symmetric_matrix
      !> Unknowns in a block
      integer :: block = 1
      !> Known not to be definite: Cholesky is not tried
      logical :: indefinite = .false.
      !> Linear problem: no later iteration corrects the error that a solve leaves
      logical :: once = .false.
      !> Column j has entries start(j)+1 : start(j+1), shape (n + 1)
      integer(i8), allocatable :: start(:)
      !> Entries
      real(wp), allocatable :: value(:)
      !> Entries of a skew part in the same places, not allocated where there is none
      real(wp), allocatable :: skew(:)
      !> Row numbers of the blocks in each block column, ascending, the diagonal block last
      type(csr_type), private :: above
      !> Place of each block of a solid in the elimination order, and the first place coupled with
      !> it, shape (blocks) each; not allocated if the blocks have no positions
      integer, allocatable, private :: place(:), reach(:)
      !> Number of operations of a factorisation within that envelope, in block operations [-]
      real(wp), private :: work = 0.0_wp
      !> Data shared by the factors
      type(sparse_factor), pointer, private :: kept => null()
      !> Factor in single precision
      type(near_factor), pointer, private :: near => null()
   contains
      procedure :: apply, apply_transposed, compressed, solve_square, solve_with
      procedure :: let_go, definite, rows, shifted, add, product => product_with, add_skew
      final :: free
   end type symmetric_matrix

   !> Entries of a symmetric matrix most of which are zero, with their places among all of them
   type :: packed_entries
      !> Places of those that are not, their rows and columns
      integer(i8), allocatable, private :: place(:)
      integer, allocatable, private :: row(:), column(:)
      real(wp), allocatable, private :: value(:)
   contains
      procedure :: unpack, product => packed_product
   end type packed_entries

   !> A matrix with the factor of a nearby one in the same sparsity pattern
   type, extends(symmetric_system) :: preconditioned_type
      type(symmetric_matrix), pointer :: places => null()
      real(wp), pointer, contiguous :: given(:) => null()
   contains
      procedure :: multiply, precondition
   end type preconditioned_type

   !> Number of operations from which the factor of a solid is in single precision; plane problems
   !> need few operations, and slender bodies need double precision [-]
   real(wp), parameter :: large = 1.0e8_wp
   !> Number of operations from which a matrix that is far from a positive definite one is not
   !> solved: LU takes ten times as long and five times the memory, for a useless Newton step [-]
   real(wp), parameter :: hopeless = 2.0e10_wp
   !> Rate of the factorisation over that of an iteration with it, both in operations a second [-]
   real(wp), parameter :: faster = 30.0_wp
   !> Iterations with the last factor should end within this share of the iterations that cost as
   !> much as a new factor; and relative residual of the iterations: an error of this size in a
   !> Newton step costs no further step [-]
   real(wp), parameter :: tried = 0.8_wp, exact = 1.0e-5_wp
   !> Shares of the diagonal that are added in turn to a matrix that is not positive definite
   real(wp), parameter :: added(3) = [1.0e-3_wp, 1.0e-2_wp, 1.0e-1_wp]
   !> Share with which a failure in single precision rules out a positive definite matrix [-]
   real(wp), parameter :: surely = 1.0e-4_wp
   !> Least size of a negative eigenvalue that is not a rounding error of single precision, and
   !> least eigenvalue of a matrix that is surely positive definite, relative to a nearby factor [-]
   real(wp), parameter :: seen = 1.0e-2_wp, clear = 0.1_wp
   !> Maximum number of iterations with a factor that has an added diagonal, and without one
   integer, parameter :: most = 100, few = 30
   !> Maximum number of refinement solves, and relative error of the solution that may remain [-]
   integer, parameter :: passes = 4
   real(wp), parameter :: same = 1.0e-6_wp
   !> Maximum number of iterations with a skew part, and the step that ends them, relative to the
   !> first one in the norm of the symmetric part: rounding leaves less [-]
   integer, parameter :: most_skew = 100
   real(wp), parameter :: of_skew = 1.0e-8_wp

contains

!> Set the sparsity pattern: all blocks of one group are coupled. Values are zero.
subroutine new_symmetric(self, block, blocks, group, x)
   type(symmetric_matrix), intent(out) :: self
   !> Unknowns in a block
   integer, intent(in) :: block
   !> Number of blocks along the diagonal
   integer, intent(in) :: blocks
   !> Blocks of each group, ascending
   type(csr_type), intent(in) :: group
   !> Positions of the first blocks, shape (nd, located) [length]
   real(wp), intent(in), optional :: x(:, :)
   !> Groups that contain each block
   type(csr_type) :: groups
   integer, allocatable :: mark(:)
   integer(i8) :: k, l
   integer :: i, j, n, pass

   self%block = block
   allocate (self%kept, self%near)
   if (present(x) .and. block == 3) call envelope_order(group, x, blocks, 2, self%place, &
      & self%reach, self%work)
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
   allocate (self%value(self%start(self%n + 1)), source=0.0_wp)
end subroutine new_symmetric

!> Row of each entry less 1
pure function rows(self) result(row)
   class(symmetric_matrix), intent(in) :: self
   integer(i8) :: row(self%start(self%n + 1))
   integer(i8) :: k, l
   integer :: b, i, j, n

   b = self%block
   k = 0
   do j = 1, self%n/b
      do i = 1, b
         do l = self%above%offset(j) + 1, self%above%offset(j + 1)
            do n = 1, merge(i, b, l == self%above%offset(j + 1))
               k = k + 1
               row(k) = int(self%above%index(l) - 1, i8)*b + n - 1
            end do
         end do
      end do
   end do
end function rows

!> Add a dense part, of which only the upper triangle is used
subroutine add(self, value, member, a)
   !> Matrix with the sparsity pattern
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
         ! entries i to k are contiguous in both
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

   call self%apply(x, y)
   call self%add_skew(-2.0_wp, x, y)
end subroutine apply_transposed

!> Add the product of the skew part, if there is one, with a vector
subroutine add_skew(self, sign, x, y)
   class(symmetric_matrix), intent(in) :: self
   !> 1, or -1 for its transpose
   real(wp), intent(in) :: sign
   real(wp), contiguous, intent(in) :: x(:)
   !> Sum, shape (n)
   real(wp), contiguous, intent(inout) :: y(:)
   integer(i8), allocatable :: row(:)
   integer(i8) :: k, i
   integer :: j

   if (.not. allocated(self%skew)) return
   allocate (row, source=self%rows())
   do j = 1, self%n
      do k = self%start(j) + 1, self%start(j + 1) - 1
         i = row(k) + 1
         y(i) = y(i) + sign*self%skew(k)*x(j)
         y(j) = y(j) - sign*self%skew(k)*x(i)
      end do
   end do
end subroutine add_skew

!> Keep the entries of a matrix that are not zero
subroutine new_packed(self, matrix)
   type(packed_entries), intent(out) :: self
   class(symmetric_matrix), intent(in) :: matrix
   integer(i8), allocatable :: row(:)
   integer(i8) :: k, n
   integer :: j

   allocate (row, source=matrix%rows())
   n = count(abs(matrix%value) > 0.0_wp, kind=i8)
   allocate (self%place(n), self%row(n), self%column(n), self%value(n))
   n = 0
   do j = 1, matrix%n
      do k = matrix%start(j) + 1, matrix%start(j + 1)
         if (.not. abs(matrix%value(k)) > 0.0_wp) cycle
         n = n + 1
         self%place(n) = k
         self%row(n) = int(row(k)) + 1
         self%column(n) = j
         self%value(n) = matrix%value(k)
      end do
   end do
end subroutine new_packed

!> All entries in the sparsity pattern of the matrix
subroutine unpack(self, value)
   class(packed_entries), intent(in) :: self
   !> Entries, shape (entries)
   real(wp), intent(out) :: value(:)

   value = 0.0_wp
   value(self%place) = self%value
end subroutine unpack

!> Product with a vector
subroutine packed_product(self, x, y)
   class(packed_entries), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)
   integer(i8) :: k

   y = 0.0_wp
   do k = 1, size(self%value, kind=i8)
      associate (i => self%row(k), j => self%column(k))
         y(i) = y(i) + self%value(k)*x(j)
         if (i /= j) y(j) = y(j) + self%value(k)*x(i)
      end associate
   end do
end subroutine packed_product

!> Product of other entries in the same sparsity pattern with a vector
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
      ! blocks k to l are contiguous; reading their row numbers would take as long as their entries
      do while (k < last)
         l = k
         do while (l + 1 < last .and. self%above%index(l + 1) == self%above%index(l) + 1)
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
      i = b*(j - 1)
      do c = i + 1, b*j
         call add_column(c - i - 1, value(self%start(c) + at + 1:), x(i + 1:), x(c), y(i + 1:), &
            & y(c))
         y(c) = y(c) + value(self%start(c + 1))*x(c)
      end do
   end do
end subroutine product_with

!> Products of some entries of a column above the diagonal, and of their transpose
pure subroutine add_column(n, a, x, x_own, y, y_own)
   !> Entries
   integer, intent(in) :: n
   !> Entries of the vector in their rows and in that of the column
   real(wp), intent(in) :: a(n), x(n), x_own
   !> Products in the same rows
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

!> Other entries in the same sparsity pattern, both triangles in compressed rows; with the skew
!> part, or with its transpose, whose rows are the columns
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
   !> Rows of each column of the upper triangle, and columns of each of its rows
   type(csr_type) :: upper, later
   integer(i8), allocatable :: entry(:)
   integer(i8) :: at, k
   integer :: j

   allocate (upper%offset, source=self%start)
   upper%index = int(self%rows()) + 1
   call upper%transposed(self%n, later, entry)
   ! both triangles contain the diagonal
   start = upper%offset + later%offset - [(int(j, i8), j=0, self%n)]
   allocate (column(start(self%n + 1)), value(start(self%n + 1)))
   do j = 1, self%n
      ! by symmetry a row begins with the entries of its own column; those of later columns follow
      at = start(j) + self%start(j + 1) - self%start(j)
      column(start(j) + 1:at) = upper%index(self%start(j) + 1:self%start(j + 1)) - 1
      value(start(j) + 1:at) = given(self%start(j) + 1:self%start(j + 1))
      if (allocated(self%skew)) value(start(j) + 1:at) = value(start(j) + 1:at) &
         & - sign*self%skew(self%start(j) + 1:self%start(j + 1))
      do k = later%offset(j) + 2, later%offset(j + 1)
         at = at + 1
         column(at) = later%index(k) - 1
         value(at) = given(entry(k))
         if (allocated(self%skew)) value(at) = value(at) + sign*self%skew(entry(k))
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

   if (shift > 0.0_wp) then
      call solve_with(self, self%shifted(shift), b, x, report, error)
   else
      call solve_with(self, self%value, b, x, report, error)
   end if
end subroutine solve_square

!> Entries of A + shift |D|
function shifted(self, shift) result(value)
   class(symmetric_matrix), intent(in) :: self
   !> Share of the diagonal
   real(wp), intent(in) :: shift
   real(wp) :: value(size(self%value, kind=i8))
   integer :: j

   value = self%value
   do j = 1, self%n
      associate (diagonal => value(self%start(j + 1)))
         diagonal = diagonal + shift*abs(diagonal)
      end associate
   end do
end function shifted

!> Solve with other entries in the same sparsity pattern
subroutine solve_with(self, given, b, x, report, error)
   class(symmetric_matrix), target, intent(in) :: self
   real(wp), contiguous, target, intent(in) :: given(:)
   !> Right hand side, shape (n)
   real(wp), contiguous, intent(in) :: b(:)
   !> Solution, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   !> Method used and quality reached
   type(square_report), intent(out) :: report
   !> Error handling: singular matrix, matrix far from a positive definite one, no memory
   type(error_type), allocatable, intent(out) :: error
   integer(i8), allocatable :: start(:), column(:)
   real(wp), allocatable :: value(:), r(:)
   real(wp) :: norm
   logical :: again, symmetric, found

   symmetric = .not. (self%indefinite .or. allocated(self%skew))
   found = .false.
   again = self%again .and. .not. self%near%ready
   if (symmetric) call solve_near(self, given, b, x, report, found)
   if (found) return
   report%used = 'cholesky'
   report%why = 'the tangent is square and symmetric: Cholesky, or LU where it is not positive ' &
      & //'definite'
   if (allocated(self%skew)) then
      report%why = 'the tangent has the skew part of a pressure whose surface has a free rim: LU'
      if (.not. self%indefinite) call solve_skew(self, given, b, x, report, found)
      if (found) return
   else if (self%indefinite) then
      report%why = 'the tangent has pressures as unknowns and is not definite: LU'
   end if
   if (again) then
      x = b
      call self%kept%solve(x)
   else if (symmetric) then
      call solve_sparse(self%kept, self%n, self%start, self%rows(), given, .true., error, b, x, &
         & report%rcond)
   end if
   if (.not. symmetric .or. allocated(error)) then
      if (allocated(error)) then
         if (error%code == err_memory) return
         report%indefinite = .true.
         if (self%near%far .and. (self%impatient .or. self%near%operations > hopeless)) then
            error%message = 'the tangent is far from positive definite'
            return
         end if
      end if
      report%used = 'lu'
      ! compressed columns, as rows of the transpose
      call both_triangles(self, given, -1.0_wp, start, column, value)
      call solve_sparse(self%kept, self%n, start, column, value, .false., error, b, x, &
         & report%rcond)
   end if
   if (allocated(error)) return
   allocate (r(self%n))
   call self%product(given, x, r)
   call self%add_skew(1.0_wp, x, r)
   norm = sqrt(sum(given**2))
   report%backward_error = norm2(r - b)/max(norm*norm2(x) + norm2(b), tiny(1.0_wp))
end subroutine solve_with

!> Solve a system with a skew part by the Cholesky factor of its symmetric part S. In the norm of S
!> the skew part is normal, and three terms give the Galerkin solution in a Krylov space (Widlund
!> 1978, doi:10.1137/0715053).
subroutine solve_skew(self, given, b, x, report, found)
   type(symmetric_matrix), target, intent(in) :: self
   !> Entries of S
   real(wp), contiguous, target, intent(in) :: given(:)
   !> Right hand side, shape (n)
   real(wp), contiguous, intent(in) :: b(:)
   !> Solution where it was found, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   type(square_report), intent(inout) :: report
   !> Whether a solution was found: false if S is not positive definite, or after too many steps
   logical, intent(out) :: found
   type(error_type), allocatable :: error
   real(wp), dimension(self%n) :: before, next, left, step
   real(wp) :: energy, first, last, share
   integer :: k

   found = .false.
   x = 0.0_wp
   before = 0.0_wp
   left = b
   share = 1.0_wp
   last = 0.0_wp
   call solve_sparse(self%kept, self%n, self%start, self%rows(), given, .true., error, b, step, &
      & report%rcond)
   if (allocated(error)) return
   do k = 1, most_skew
      if (k > 1) then
         step = left
         call self%kept%solve(step)
      end if
      energy = dot_product(step, left)
      if (k == 1) first = energy
      found = energy <= of_skew**2*first
      if (found) exit
      if (k > 1) share = 1.0_wp/(1.0_wp + energy/(last*share))
      last = energy
      next = before + share*(step + x - before)
      before = x
      x = next
      call self%product(given, x, left)
      call self%add_skew(1.0_wp, x, left)
      left = b - left
   end do
   if (.not. found) return
   report%used = 'cgw'
   report%why = 'the tangent has the skew part of a pressure whose surface has a free rim: ' &
      & //'generalised conjugate gradients with the Cholesky factor of its symmetric part'
   report%iterations = k - 1
   report%backward_error = norm2(left)/max(sqrt(sum(given**2))*norm2(x) + norm2(b), &
      & tiny(1.0_wp))
end subroutine solve_skew

!> Solve a large system by minimal residuals with a single precision factor: the last one, or one of
!> this matrix, if necessary with a larger diagonal
subroutine solve_near(self, given, b, x, report, found)
   type(symmetric_matrix), target, intent(in) :: self
   real(wp), contiguous, target, intent(in) :: given(:)
   !> Right hand side, shape (n)
   real(wp), contiguous, intent(in) :: b(:)
   !> Solution where it was found, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   type(square_report), intent(inout) :: report
   !> Whether a solution was found: false if the system is small, single precision does not suffice,
   !> or the matrix is too far from a positive definite one
   logical, intent(out) :: found
   type(preconditioned_type) :: system
   logical :: close
   integer :: k

   found = .false.
   close = .false.
   if (self%block < 3) return
   system%size = self%n
   system%places => self
   system%given => given
   associate (near => self%near)
      if (.not. allocated(near%matrix%start)) call lay_out(self)
      if (near%operations < large .or. near%coarse .or. near%far) return
      report%why = 'the tangent is near one that was factorised: minimal residuals with its ' &
         & //'Cholesky factor'
      if (near%ready .and. .not. near%share > 0.0_wp) then
         call iterate(b, nint(near%cost), x, pace=nint(tried*near%cost))
         if (found) return
      end if
      report%why = 'the tangent is large: minimal residuals with its Cholesky factor in single ' &
         & //'precision'
      call factorise(self, given, 0.0_wp)
      if (near%ready) then
         call refine(few)
         if (found) report%used = 'cholesky'
      else
         do k = 1, size(added)
            call factorise(self, given, added(k))
            if (near%ready) exit
         end do
         if (near%ready) call refine(most)
         ! not merely for lack of digits
         near%far = .not. (found .or. close)
      end if
      if (found) return
      ! forget the report of the attempts that failed
      if (allocated(report%used)) deallocate (report%used)
      report%iterations = 0
      near%coarse = .true.
      near%ready = .false.
      deallocate (near%matrix%value)
   end associate

contains

   !> Repeat solves for the remaining residual until the solution settles: residuals in the norm of
   !> the preconditioner hardly show motions that are softer than its digits or its added diagonal
   subroutine refine(limit)
      integer, intent(in) :: limit
      real(wp) :: left(self%n), step(self%n), image(self%n), lanczos(2, limit)
      real(wp) :: last, size_of_step
      integer :: pass, done
      logical :: indefinite

      x = 0.0_wp
      left = b
      last = huge(1.0_wp)
      done = 0
      indefinite = .false.
      do pass = 1, passes
         call iterate(left, limit, step, lanczos)
         done = done + report%iterations
         indefinite = indefinite .or. has_below(lanczos(:, :report%iterations), -seen)
         close = found
         found = .false.
         if (.not. close) exit
         x = x + step
         size_of_step = norm2(step)
         ! next correction predicted from the last two; a matrix that is surely not positive
         ! definite belongs to a Newton step, which need not be more accurate than the first solve
         found = ((indefinite .or. self%near%share > added(1)) .and. .not. self%once) &
            & .or. (pass > 1 .and. size_of_step**2 <= same*norm2(x)*last)
         if (found .or. size_of_step > 0.5_wp*last) exit
         last = size_of_step
         call system%multiply(x, image)
         left = b - image
      end do
      report%iterations = done
   end subroutine refine

   subroutine iterate(right, limit, solution, lanczos, pace)
      real(wp), contiguous, intent(in) :: right(:)
      integer, intent(in) :: limit
      real(wp), contiguous, intent(inout) :: solution(:)
      real(wp), intent(inout), optional :: lanczos(:, :)
      integer, intent(in), optional :: pace

      call minres(system, right, exact, limit, solution, report%iterations, &
         & report%backward_error, lanczos, pace)
      found = report%backward_error <= exact
      if (found) report%used = 'minres'
   end subroutine iterate

end subroutine solve_near

!> Whether a tridiagonal matrix has an eigenvalue below a bound: then so does the matrix that it
!> approximates
pure logical function has_below(lanczos, bound)
   !> Diagonal and off-diagonal, shape (2, steps)
   real(wp), intent(in) :: lanczos(:, :)
   real(wp), intent(in) :: bound
   real(wp) :: pivot
   integer :: k

   has_below = .false.
   pivot = 1.0_wp
   do k = 1, size(lanczos, 2)
      pivot = lanczos(1, k) - bound &
         & - merge(lanczos(2, max(k - 1, 1))**2/pivot, 0.0_wp, k > 1)
      has_below = pivot <= 0.0_wp
      if (has_below) return
   end do
end function has_below

!> Whether all eigenvalues are positive: for a large solid by its single precision factor, or by
!> that of an earlier matrix, with which this one is preconditioned to nearly the identity
logical function definite(self)
   class(symmetric_matrix), target, intent(in) :: self
   type(error_type), allocatable :: error
   type(preconditioned_type) :: system
   real(wp) :: b(self%n), x(self%n), rcond, lanczos(2, few)
   integer :: iterations, k

   associate (near => self%near)
      if (allocated(near%matrix%start) .and. near%operations >= large .and. .not. near%coarse) then
         if (near%ready .and. .not. near%share > 0.0_wp) then
            system%size = self%n
            system%places => self
            system%given => self%value
            ! a vector without the symmetry of any mode
            b = [(sin(real(k, wp)**2), k=1, self%n)]
            call minres(system, b, exact, min(few, nint(tried*near%cost)), x, iterations, rcond, &
               & lanczos, pace=min(few, nint(tried*near%cost)))
            definite = rcond <= exact .and. .not. has_below(lanczos(:, :iterations), clear)
            if (definite) return
         end if
         call factorise(self, self%value, 0.0_wp)
         definite = near%ready
         if (definite) return
         call factorise(self, self%value, surely)
         if (.not. near%ready) return
      end if
   end associate
   call solve_sparse(self%kept, self%n, self%start, self%rows(), self%value, .true., error)
   definite = .not. allocated(error)
end function definite

!> Elimination order and envelope of the single precision factor
subroutine lay_out(self)
   type(symmetric_matrix), intent(in) :: self
   type(error_type), allocatable :: error
   integer :: position(self%n), low(self%n)
   integer :: b, c

   b = self%block
   associate (near => self%near)
      near%operations = 0.0_wp
      if (.not. allocated(self%place)) return
      near%operations = real(b, wp)**3*self%work
      do c = 1, b
         position(c::b) = b*(self%place - 1) + c
         low(position(c::b)) = b*(self%reach - 1) + 1
      end do
      near%cost = near%operations/(4.0_wp*b**2*sum(self%place - self%reach + 1.0_wp))/faster
      if (near%operations < large) return
      call new_envelope(near%matrix, position, low, error)
      if (allocated(error)) near%operations = 0.0_wp
   end associate
end subroutine lay_out

!> Compute the factor in single precision
subroutine factorise(self, given, share)
   type(symmetric_matrix), intent(in) :: self
   real(wp), intent(in) :: given(:)
   !> Share of the diagonal that is added to the matrix
   real(wp), intent(in) :: share
   type(error_type), allocatable :: error
   real(wp) :: root(self%n)
   integer(i8), allocatable :: before(:)
   integer(i8) :: k, l
   integer :: b, c, i, j, stat

   associate (near => self%near, position => self%near%matrix%position)
      near%ready = .false.
      near%share = share
      root = sqrt(given(self%start(2:)))
      if (.not. all(root > 0.0_wp)) return
      near%matrix%scale = root
      if (.not. allocated(near%matrix%value)) then
         associate (offset => near%matrix%offset)
            allocate (near%matrix%value(offset(size(offset))), stat=stat)
         end associate
         if (stat /= 0) return
      end if
      call near%matrix%clear()
      before = near%matrix%columns()
      b = self%block
      do c = 1, self%n
         k = self%start(c)
         j = (c - 1)/b + 1
         do l = self%above%offset(j) + 1, self%above%offset(j + 1)
            do i = (self%above%index(l) - 1)*b + 1, min(self%above%index(l)*b, c)
               k = k + 1
               near%matrix%value(before(max(position(i), position(c))) + min(position(i), &
                  & position(c))) = real(given(k)/(root(i)*root(c)), sp)
            end do
         end do
      end do
      call near%matrix%shift(share)
      call near%matrix%factorise(error)
      near%ready = .not. allocated(error)
   end associate
end subroutine factorise

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

   associate (factor => self%places%near%matrix)
      y = x/factor%scale
      call factor%solve(y)
      y = y/factor%scale
   end associate
end subroutine precondition

!> Drop the factor, so that the next equations are solved with a new one
subroutine let_go(self)
   class(symmetric_matrix), intent(in) :: self

   if (.not. associated(self%near)) return
   self%near%ready = .false.
   self%near%far = .false.
   self%near%coarse = .false.
end subroutine let_go

subroutine free(self)
   type(symmetric_matrix), intent(inout) :: self

   if (associated(self%kept)) deallocate (self%kept)
   if (associated(self%near)) deallocate (self%near)
end subroutine free

end module rk_symmetric
