!> Symmetric positive definite matrices stored by block columns between their first entry and the
!> diagonal, and their Cholesky factors.
!>
!> The Cholesky factor of a matrix fills nothing above the first entry of a column, so unknowns
!> ordered along the body keep memory and work to n b and n b^2, b the reach of an unknown. Block
!> columns make every operation one of matrices; a block belongs to one thread, so that the result
!> does not depend on the number of threads.
!>
!> Reference: George, Liu, Computer Solution of Large Sparse Positive Definite Systems,
!>            Prentice-Hall (1981), chapter 4
module rk_envelope
   use rk_blas, only : dgemm, dgemv, dpotrf, dsyrk, dtrsm, dtrsv
   use rk_error, only : error_type, fatal_error, err_linalg, err_memory
   use rk_precision, only : i8, wp
   use rk_text, only : to_text
   implicit none
   private

   public :: factor_type, envelope_type, new_envelope

   !> Columns of a block
   integer, parameter :: block_width = 128

   !> Something that solves equations with (A D)^T (A D), D the inverse column norms
   type, abstract :: factor_type
      !> Column norms of A, shape (n)
      real(wp), allocatable :: scale(:)
   contains
      !> Solve in place
      procedure(solve_interface), deferred :: solve
   end type factor_type

   abstract interface
      subroutine solve_interface(self, x)
         import :: factor_type, wp
         class(factor_type), intent(in) :: self
         !> Right hand side, replaced by the solution, shape (n)
         real(wp), contiguous, intent(inout) :: x(:)
      end subroutine solve_interface
   end interface

   !> Upper triangle of a symmetric matrix A^T A, or of its factor, in elimination order
   type, extends(factor_type) :: envelope_type
      !> Rows and columns
      integer :: n = 0
      !> Place of each unknown in the elimination order, shape (n)
      integer, allocatable :: position(:)
      !> Block j has columns start(j)+1 : start(j+1), shape (blocks + 1)
      integer, allocatable :: start(:)
      !> Rows before the first one stored of each block, start of a block, shape (blocks)
      integer, allocatable :: first(:)
      !> Block j is value(offset(j)+1 : offset(j+1)), shape (blocks + 1)
      integer(i8), allocatable :: offset(:)
      !> Entries, each block as a matrix of rows first+1 : start(j+1)
      real(wp), allocatable :: value(:)
   contains
      procedure :: clear, add, equilibrate, factorise, solve, expand, share, before
   end type envelope_type

contains

!> Empty matrix
subroutine new_envelope(self, position, reach, error)
   type(envelope_type), intent(inout) :: self
   !> Place of each unknown in the elimination order, shape (n)
   integer, intent(in) :: position(:)
   !> First row with an entry of each column, both in elimination order, shape (n)
   integer, intent(in) :: reach(:)
   !> Error handling: no memory
   type(error_type), allocatable, intent(out) :: error
   integer :: j, blocks, low, stat

   self%n = size(position)
   self%position = position
   blocks = (self%n + block_width - 1)/block_width
   self%start = [(min(block_width*j, self%n), j=0, blocks)]
   if (allocated(self%first)) deallocate (self%first, self%offset)
   allocate (self%first(blocks), self%offset(blocks + 1))
   self%offset(1) = 0
   do j = 1, blocks
      low = minval(reach(self%start(j) + 1:self%start(j + 1)))
      self%first(j) = block_width*((low - 1)/block_width)
      self%offset(j + 1) = self%offset(j) + int(self%start(j + 1) - self%first(j), i8) &
         & *(self%start(j + 1) - self%start(j))
   end do
   if (allocated(self%value)) deallocate (self%value)
   allocate (self%value(self%offset(blocks + 1)), stat=stat)
   if (stat /= 0) call fatal_error(error, err_memory, 'no memory for normal equations of ' &
      & //to_text(8.0e-9_wp*real(self%offset(blocks + 1), wp), 3)//' GB')
end subroutine new_envelope

!> Part of the upper triangle that is stored [-]
pure real(wp) function share(self)
   class(envelope_type), intent(in) :: self

   share = 2.0_wp*real(self%offset(size(self%offset)), wp)/(real(self%n, wp)*(self%n + block_width))
end function share

!> Where the entry of row 0 of a column would stand among the values
pure integer(i8) function before(self, j, c)
   class(envelope_type), intent(in) :: self
   !> Block, and a column of it
   integer, intent(in) :: j, c

   before = self%offset(j) + int(c - self%start(j) - 1, i8)*(self%start(j + 1) - self%first(j)) &
      & - self%first(j)
end function before

subroutine clear(self)
   class(envelope_type), intent(inout) :: self
   integer :: j

   !$omp parallel do default(none) schedule(dynamic, 1) private(j) shared(self)
   do j = 1, size(self%first)
      self%value(self%offset(j) + 1:self%offset(j + 1)) = 0.0_wp
   end do
   !$omp end parallel do
end subroutine clear

!> Add the columns of a small symmetric matrix that fall into one block
pure subroutine add(self, j, row, run, matrix)
   class(envelope_type), intent(inout) :: self
   !> Block
   integer, intent(in) :: j
   !> Places of the small matrix's unknowns in the elimination order, ascending
   integer, intent(in) :: row(:)
   !> Where runs of consecutive places begin, and size(row) + 1 at the end
   integer, intent(in) :: run(:)
   !> Its upper triangle, shape (>= size(row), >= size(row))
   real(wp), intent(in) :: matrix(:, :)
   integer(i8) :: at
   integer :: c, r, low, high

   do c = 1, size(row)
      if (row(c) <= self%start(j)) cycle
      if (row(c) > self%start(j + 1)) exit
      at = self%before(j, row(c))
      do r = 1, size(run) - 1
         low = run(r)
         if (low > c) exit
         high = min(run(r + 1) - 1, c)
         associate (to => self%value(at + row(low):at + row(high)))
            to = to + matrix(low:high, c)
         end associate
      end do
   end do
end subroutine add

!> Write the upper triangle in the order of the unknowns
subroutine expand(self, a)
   class(envelope_type), intent(in) :: self
   !> Dense matrix, zero below the diagonal, shape (n, n)
   real(wp), contiguous, intent(inout) :: a(:, :)
   integer :: unknown(self%n)
   integer(i8) :: at
   integer :: c, i, j

   unknown(self%position) = [(i, i=1, self%n)]
   a = 0.0_wp
   do j = 1, size(self%first)
      do c = self%start(j) + 1, self%start(j + 1)
         at = self%before(j, c)
         do i = self%first(j) + 1, c
            a(min(unknown(i), unknown(c)), max(unknown(i), unknown(c))) = self%value(at + i)
         end do
      end do
   end do
end subroutine expand

!> Scale to a unit diagonal, whose square roots become the scale
subroutine equilibrate(self)
   class(envelope_type), intent(inout) :: self
   real(wp) :: d(self%n)
   integer(i8) :: at
   integer :: c, i, j

   do j = 1, size(self%first)
      do c = self%start(j) + 1, self%start(j + 1)
         d(c) = sqrt(self%value(self%before(j, c) + c))
      end do
   end do
   self%scale = d(self%position)
   if (.not. all(d > 0.0_wp)) return
   !$omp parallel do default(none) schedule(dynamic, 1) private(j, c, i, at) shared(self, d)
   do j = 1, size(self%first)
      do c = self%start(j) + 1, self%start(j + 1)
         at = self%before(j, c)
         do i = self%first(j) + 1, c
            self%value(at + i) = self%value(at + i)/(d(i)*d(c))
         end do
      end do
   end do
   !$omp end parallel do
end subroutine equilibrate

!> Cholesky factor U of U^T U in place
subroutine factorise(self, error)
   class(envelope_type), intent(inout) :: self
   !> Error handling: not positive definite
   type(error_type), allocatable, intent(out) :: error
   integer(i8) :: at, to
   integer :: i, j, k, low, ni, nj, di, dj, info

   ! the threads stay together: BLAS called by one of several threads does not use more
   info = 0
   !$omp parallel default(none) private(i, j, k, low, ni, nj, di, dj, at, to) shared(self, info)
   do i = 1, size(self%first)
      ni = self%start(i + 1) - self%start(i)
      di = self%start(i + 1) - self%first(i)
      k = self%start(i) - self%first(i)
      at = self%offset(i) + 1 + k
      !$omp single
      if (k > 0) call dsyrk('u', 't', ni, k, -1.0_wp, self%value(self%offset(i) + 1), di, &
         & 1.0_wp, self%value(at), di)
      call dpotrf('u', ni, self%value(at), di, info)
      if (info /= 0) info = self%start(i) + info
      !$omp end single
      if (info /= 0) exit
      !$omp do schedule(dynamic, 1)
      do j = i + 1, size(self%first)
         if (self%first(j) > self%start(i)) cycle
         nj = self%start(j + 1) - self%start(j)
         dj = self%start(j + 1) - self%first(j)
         low = max(self%first(i), self%first(j))
         k = self%start(i) - low
         to = self%offset(j) + 1 + self%start(i) - self%first(j)
         if (k > 0) call dgemm('t', 'n', ni, nj, k, -1.0_wp, &
            & self%value(self%offset(i) + 1 + low - self%first(i)), di, &
            & self%value(self%offset(j) + 1 + low - self%first(j)), dj, 1.0_wp, self%value(to), dj)
         call dtrsm('l', 'u', 't', 'n', ni, nj, 1.0_wp, self%value(at), di, self%value(to), dj)
      end do
      !$omp end do
   end do
   !$omp end parallel
   if (info /= 0) call fatal_error(error, err_linalg, 'matrix is not positive definite, minor ' &
      & //to_text(info)//' of '//to_text(self%n))
end subroutine factorise

!> Solve U^T U x = b with a factor, in place and in the order of the unknowns
subroutine solve(self, x)
   class(envelope_type), intent(in) :: self
   real(wp), contiguous, intent(inout) :: x(:)
   real(wp), allocatable :: y(:)
   integer(i8) :: at
   integer :: j, k, n, d

   allocate (y(self%n))
   y(self%position) = x
   ! as above: one thread, and BLAS with no more
   !$omp parallel default(none) private(j, k, n, d, at) shared(self, y)
   !$omp single
   do j = 1, size(self%first)
      n = self%start(j + 1) - self%start(j)
      d = self%start(j + 1) - self%first(j)
      k = self%start(j) - self%first(j)
      at = self%offset(j) + 1
      if (k > 0) call dgemv('t', k, n, -1.0_wp, self%value(at), d, y(self%first(j) + 1), 1, &
         & 1.0_wp, y(self%start(j) + 1), 1)
      call dtrsv('u', 't', 'n', n, self%value(at + k), d, y(self%start(j) + 1), 1)
   end do
   do j = size(self%first), 1, -1
      n = self%start(j + 1) - self%start(j)
      d = self%start(j + 1) - self%first(j)
      k = self%start(j) - self%first(j)
      at = self%offset(j) + 1
      call dtrsv('u', 'n', 'n', n, self%value(at + k), d, y(self%start(j) + 1), 1)
      if (k > 0) call dgemv('n', k, n, -1.0_wp, self%value(at), d, y(self%start(j) + 1), 1, &
         & 1.0_wp, y(self%first(j) + 1), 1)
   end do
   !$omp end single
   !$omp end parallel
   x = y(self%position)
end subroutine solve

end module rk_envelope
