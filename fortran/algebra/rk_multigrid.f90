!> One cycle of algebraic multigrid by smoothed aggregation, for matrices like those of a Laplacian:
!> symmetric and positive definite, with a nearly constant vector as their softest.
!>
!> Unknowns that are strongly coupled become one on the next level, so that levels follow the long
!> sides of flat cells by themselves. The cycle is a fixed symmetric operator: it may precondition
!> minimal residuals. Memory and work are linear in the unknowns, and sums go by rows: they do not
!> depend on the number of threads.
!>
!> Reference: Vanek, Mandel, Brezina, Computing 56 (1996), doi:10.1007/BF02238511
module rk_multigrid
   use rk_error, only : error_type
   use rk_lapack, only : cholesky, solve_triangular
   use rk_precision, only : i8, wp
   use rk_sparse_rows, only : sparse_rows
   implicit none
   private

   public :: multigrid_type, new_multigrid

   !> A matrix and the way to the next one
   type :: level_type
      !> Matrix
      type(sparse_rows) :: matrix
      !> Unknowns from those of the next level, and the transposed
      type(sparse_rows) :: prolongation, restriction
      !> Factors of the residual in the smoothing steps, shape (n, sweeps)
      real(wp), allocatable :: smooth(:, :)
   end type level_type

   !> Levels, the finest first
   type :: multigrid_type
      type(level_type), allocatable, private :: level(:)
      !> Inverse of the last matrix, or of its diagonal where hardly anything couples
      real(wp), allocatable, private :: inverse(:, :), scale(:)
   contains
      procedure :: apply
   end type multigrid_type

   !> Unknowns that are solved directly
   integer, parameter :: few = 200
   !> Unknowns of a level that are not worth a second thread
   integer, parameter :: alone = 1000
   !> Levels at most
   integer, parameter :: deepest = 12
   !> Entry beside those of the diagonal that couples strongly
   real(wp), parameter :: strong = 0.08_wp
   !> Diagonal that is left without the weak entries, at least, of the whole one
   real(wp), parameter :: remains = 0.1_wp
   !> Smoothing steps before and after, and the lower end of the part of the spectrum that they
   !> smooth, of its upper end
   integer, parameter :: sweeps = 2
   real(wp), parameter :: smoothed = 0.1_wp

contains

!> Set up the levels
subroutine new_multigrid(self, matrix, error)
   type(multigrid_type), intent(out) :: self
   !> Matrix, both triangles
   type(sparse_rows), intent(in) :: matrix
   !> Error handling: not positive definite
   type(error_type), allocatable, intent(out) :: error
   type(level_type), allocatable :: level(:)
   type(sparse_rows) :: right
   real(wp), allocatable :: last(:, :)
   integer(i8) :: k
   integer :: i, l, n

   allocate (level(deepest))
   level(1)%matrix = matrix
   l = 1
   do
      n = size(level(l)%matrix%place%offset) - 1
      if (n <= few .or. l == deepest) exit
      call coarsen(level(l), strong)
      if (stalled()) call coarsen(level(l), 0.0_wp)
      if (stalled()) exit
      call multiply(level(l)%matrix, level(l)%prolongation, right)
      call multiply(level(l)%restriction, right, level(l + 1)%matrix)
      l = l + 1
   end do
   self%level = level(:l - 1)
   associate (a => level(l)%matrix)
      if (n > 10*few) then
         self%scale = diagonal_of(a)
         self%scale = 1.0_wp/self%scale
         return
      end if
      allocate (last(n, n), self%inverse(n, n), source=0.0_wp)
      do i = 1, n
         self%inverse(i, i) = 1.0_wp
         do k = a%place%offset(i) + 1, a%place%offset(i + 1)
            last(i, a%place%index(k)) = a%value(k)
         end do
      end do
   end associate
   call cholesky(last, error)
   if (allocated(error)) return
   do i = 1, n
      call solve_triangular(last, self%inverse(:, i), .true.)
      call solve_triangular(last, self%inverse(:, i), .false.)
   end do

contains

   !> Whether the next level is hardly smaller
   logical function stalled()

      stalled = size(level(l)%restriction%place%offset) - 1 > (9*n)/10
   end function stalled

end subroutine new_multigrid

pure function diagonal_of(a) result(diagonal)
   type(sparse_rows), intent(in) :: a
   real(wp) :: diagonal(size(a%place%offset) - 1)
   integer(i8) :: k
   integer :: i

   diagonal = 0.0_wp
   do i = 1, size(diagonal)
      do k = a%place%offset(i) + 1, a%place%offset(i + 1)
         if (a%place%index(k) == i) diagonal(i) = a%value(k)
      end do
   end do
end function diagonal_of

!> Aggregates of strongly coupled unknowns, and smoothed interpolation from them
subroutine coarsen(level, least)
   !> Level with its matrix
   type(level_type), intent(inout) :: level
   !> Entry beside those of the diagonal that couples strongly [-]
   real(wp), intent(in) :: least
   real(wp), allocatable :: diagonal(:), filtered(:), largest(:)
   logical, allocatable :: couples(:)
   integer, allocatable :: aggregate(:), at(:), column(:)
   real(wp) :: bound, best, factor
   integer(i8), allocatable :: entry(:)
   integer(i8) :: entries, k
   integer :: i, j, n, number

   associate (place => level%matrix%place, value => level%matrix%value)
      n = size(place%offset) - 1
      diagonal = diagonal_of(level%matrix)
      allocate (filtered(n), largest(n), couples(size(value)), aggregate(n))
      do i = 1, n
         associate (row => value(place%offset(i) + 1:place%offset(i + 1)))
            largest(i) = sum(abs(row))/diagonal(i)
         end associate
         filtered(i) = diagonal(i)
         do k = place%offset(i) + 1, place%offset(i + 1)
            j = place%index(k)
            couples(k) = abs(value(k)) >= least*sqrt(diagonal(i)*diagonal(j)) .and. i /= j
            if (.not. couples(k) .and. i /= j) filtered(i) = filtered(i) + value(k)
         end do
         filtered(i) = max(filtered(i), remains*diagonal(i))
      end do
      ! Chebyshev's steps on the upper part of the spectrum
      bound = maxval(largest)
      if (allocated(level%smooth)) deallocate (level%smooth)
      allocate (level%smooth(n, sweeps))
      do j = 1, sweeps
         level%smooth(:, j) = 1.0_wp/(0.5_wp*bound*diagonal*(1.0_wp + smoothed &
            & + (1.0_wp - smoothed)*cos(acos(-1.0_wp)*(j - 0.5_wp)/sweeps)))
      end do

      ! whole neighbourhoods first, then what is left beside them, then the rest
      aggregate = 0
      number = 0
      do i = 1, n
         associate (near => place%index(place%offset(i) + 1:place%offset(i + 1)), &
            & tied => couples(place%offset(i) + 1:place%offset(i + 1)))
            if (aggregate(i) > 0 .or. any(tied .and. aggregate(near) > 0)) cycle
            number = number + 1
            aggregate(i) = number
            aggregate(pack(near, tied)) = number
         end associate
      end do
      at = aggregate
      do i = 1, n
         if (aggregate(i) > 0) cycle
         best = 0.0_wp
         do k = place%offset(i) + 1, place%offset(i + 1)
            if (.not. couples(k) .or. aggregate(place%index(k)) == 0) cycle
            if (abs(value(k)) <= best) cycle
            best = abs(value(k))
            at(i) = aggregate(place%index(k))
         end do
      end do
      aggregate = at
      do i = 1, n
         if (aggregate(i) > 0) cycle
         number = number + 1
         aggregate(i) = number
         do k = place%offset(i) + 1, place%offset(i + 1)
            if (couples(k) .and. aggregate(place%index(k)) == 0) aggregate(place%index(k)) = number
         end do
      end do

      ! a Jacobi step on the aggregates, without the weak entries
      associate (p => level%prolongation)
         if (allocated(p%value)) deallocate (p%place%offset, p%place%index, p%value)
         allocate (p%place%offset(n + 1), p%place%index(size(value)), p%value(size(value)))
         allocate (column(number), source=0)
         p%place%offset(1) = 0
         entries = 0
         do i = 1, n
            factor = 4.0_wp/(3.0_wp*bound)
            call add_entry(aggregate(i), 1.0_wp - factor)
            factor = factor/filtered(i)
            do k = place%offset(i) + 1, place%offset(i + 1)
               if (couples(k)) call add_entry(aggregate(place%index(k)), -factor*value(k))
            end do
            column(p%place%index(p%place%offset(i) + 1:entries)) = 0
            p%place%offset(i + 1) = entries
         end do
         p%place%index = p%place%index(:entries)
         p%value = p%value(:entries)
         call p%place%transposed(number, level%restriction%place, entry)
         level%restriction%value = p%value(entry)
      end associate
   end associate

contains

   !> Add to the entry of an aggregate in the row that is made
   subroutine add_entry(j, part)
      integer, intent(in) :: j
      real(wp), intent(in) :: part

      if (column(j) == 0) then
         entries = entries + 1
         column(j) = int(entries - level%prolongation%place%offset(i))
         level%prolongation%place%index(entries) = j
         level%prolongation%value(entries) = part
      else
         associate (own => level%prolongation%value(level%prolongation%place%offset(i) + column(j)))
            own = own + part
         end associate
      end if
   end subroutine add_entry

end subroutine coarsen

subroutine multiply(a, b, c)
   !> Factors
   type(sparse_rows), intent(in) :: a, b
   type(sparse_rows), intent(out) :: c
   integer(i8), allocatable :: at(:)
   integer(i8) :: entries, k, l
   integer :: i, j, pass

   allocate (at(maxval(b%place%index)), c%place%offset(size(a%place%offset)))
   c%place%offset(1) = 0
   do pass = 1, 2
      at = 0
      entries = 0
      do i = 1, size(a%place%offset) - 1
         do k = a%place%offset(i) + 1, a%place%offset(i + 1)
            associate (row => a%place%index(k))
               do l = b%place%offset(row) + 1, b%place%offset(row + 1)
                  j = b%place%index(l)
                  ! an entry of this row lies behind those of the rows before
                  if (at(j) <= c%place%offset(i)) then
                     entries = entries + 1
                     at(j) = entries
                     if (pass == 2) c%place%index(entries) = j
                     if (pass == 2) c%value(entries) = 0.0_wp
                  end if
                  if (pass == 2) c%value(at(j)) = c%value(at(j)) + a%value(k)*b%value(l)
               end do
            end associate
         end do
         c%place%offset(i + 1) = entries
      end do
      if (pass == 1) allocate (c%place%index(entries), c%value(entries))
   end do
end subroutine multiply

!> x = M b of one cycle, for several vectors at once
subroutine apply(self, b, x)
   class(multigrid_type), intent(in) :: self
   !> Right hand sides, shape (vectors, n)
   real(wp), contiguous, intent(in) :: b(:, :)
   !> Approximate solutions, shape (vectors, n)
   real(wp), contiguous, intent(inout) :: x(:, :)

   call cycle_from(self, 1, b, x)
end subroutine apply

!> One cycle from a level on
recursive subroutine cycle_from(self, l, b, x)
   class(multigrid_type), intent(in) :: self
   !> Level
   integer, intent(in) :: l
   real(wp), contiguous, intent(in) :: b(:, :)
   real(wp), contiguous, intent(inout) :: x(:, :)
   real(wp), allocatable :: image(:, :), coarse(:, :), part(:, :)
   integer :: i, k

   if (l > size(self%level)) then
      do k = 1, size(b, 1)
         if (allocated(self%scale)) then
            x(k, :) = self%scale*b(k, :)
         else
            x(k, :) = matmul(self%inverse, b(k, :))
         end if
      end do
      return
   end if
   associate (level => self%level(l))
      allocate (image, mold=b)
      allocate (coarse(size(b, 1), size(level%restriction%place%offset) - 1))
      allocate (part, mold=coarse)
      !$omp parallel do default(none) schedule(static) private(i) shared(self, l, b, x) &
      !$omp if (size(b, 2) > alone)
      do i = 1, size(b, 2)
         x(:, i) = self%level(l)%smooth(i, 1)*b(:, i)
      end do
      !$omp end parallel do
      do k = 2, sweeps
         call smooth_again(k)
      end do
      call level%matrix%product(x, image, .false.)
      !$omp parallel do default(none) schedule(static) private(i) shared(b, image) &
      !$omp if (size(b, 2) > alone)
      do i = 1, size(b, 2)
         image(:, i) = b(:, i) - image(:, i)
      end do
      !$omp end parallel do
      call level%restriction%product(image, coarse, .false.)
      call cycle_from(self, l + 1, coarse, part)
      call level%prolongation%product(part, x, .true.)
      do k = sweeps, 1, -1
         call smooth_again(k)
      end do
   end associate

contains

   !> A smoothing step
   subroutine smooth_again(step)
      integer, intent(in) :: step
      integer :: row

      call self%level(l)%matrix%product(x, image, .false.)
      !$omp parallel do default(none) schedule(static) private(row) &
      !$omp shared(self, l, step, b, x, image) if (size(b, 2) > alone)
      do row = 1, size(b, 2)
         x(:, row) = x(:, row) + self%level(l)%smooth(row, step)*(b(:, row) - image(:, row))
      end do
      !$omp end parallel do
   end subroutine smooth_again

end subroutine cycle_from

end module rk_multigrid
