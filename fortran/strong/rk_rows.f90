!> Linear equations at points: every row is a sum over derivatives of unknown fields at one place.
!>
!> A block holds the rows of one place: row i is sum_c sum_q coefficient(i, c, q) D_q u_c, where u_c
!> are the unknown fields and D_q value, first and second derivatives. With shape functions this is
!> a tall sparse matrix; it is multiplied, squared or written out, but never stored.
!>
!> Reference: George, Liu, Computer Solution of Large Sparse Positive Definite Systems,
!>            Prentice-Hall (1981), chapter 4 (the elimination order)
module rk_rows
   use rk_csr, only : csr_type, envelope_order, group_by
   use rk_envelope, only : envelope_type, new_envelope
   use rk_error, only : error_type
   use rk_lapack, only : syrk
   use rk_operator, only : row_operator
   use rk_precision, only : i8, wp
   use rk_shape, only : shape_type
   use rk_text, only : to_text
   implicit none
   private

   public :: rows_type, new_rows

   !> Rows of all places
   type, extends(row_operator) :: rows_type
      !> Shape functions of the places
      type(shape_type), pointer :: shape => null()
      !> Unknown fields
      integer :: nc = 0
      !> Place of each block, shape (nblock)
      integer, allocatable :: place(:)
      !> Rows of block b are row(b)+1 : row(b+1), shape (nblock + 1)
      integer, allocatable :: row(:)
      !> First and last derivative a block uses, shape (2, nblock)
      integer, allocatable :: range(:, :)
      !> Coefficients, shape (max rows, nc, nq, nblock)
      real(wp), allocatable :: coefficient(:, :, :, :)
      !> Blocks in groups of nearby places, group g is order(group(g)+1 : group(g+1))
      integer, allocatable, private :: order(:), group(:)
      !> Places within the support of each source point, and the column of its shape function there
      type(csr_type), private :: seen
      integer(i8), allocatable, private :: seen_value(:)
      !> Mean position of the places in the support of each source point, shape (nd, ns) [length]
      real(wp), allocatable, private :: centre(:, :)
      !> Position of each source point in the elimination order, along the body, and the first
      !> source point in that order which shares a place with it, shape (ns)
      integer, allocatable, private :: position(:), reach(:)
   contains
      procedure :: apply, apply_transposed, envelope, compressed, get_name
   end type rows_type

   !> Number of groups whose products are formed before they are added: enough work for all threads,
   !> and independent of the number of threads, so that sums are too
   integer, parameter :: batch = 4

contains

!> Rows without coefficients
subroutine new_rows(self, shape, nc, place, rows, range, position, spacing)
   type(rows_type), intent(out) :: self
   !> Shape functions at the places
   type(shape_type), target, intent(in) :: shape
   !> Unknown fields
   integer, intent(in) :: nc
   !> Place of each block, shape (nblock)
   integer, intent(in) :: place(:)
   !> Number of rows of each block, shape (nblock)
   integer, intent(in) :: rows(:)
   !> First and last derivative each block uses, shape (2, nblock)
   integer, intent(in) :: range(:, :)
   !> Coordinates of all places, shape (nd, np) [length]
   real(wp), intent(in) :: position(:, :)
   !> Size of the boxes that gather nearby places, shape (nd) [length]
   real(wp), intent(in) :: spacing(:)
   real(wp) :: least
   integer(i8) :: k
   integer :: b, is

   self%shape => shape
   self%nc = nc
   self%n = nc*shape%ns
   self%place = place
   self%range = range
   allocate (self%row(size(place) + 1))
   self%row(1) = 0
   do b = 1, size(place)
      self%row(b + 1) = self%row(b) + rows(b)
   end do
   self%m = self%row(size(place) + 1)
   allocate (self%coefficient(maxval(rows), nc, shape%nq, size(place)), source=0.0_wp)
   call gather(position, place, spacing, self%order, self%group)
   call shape%transposed(self%seen, self%seen_value)
   allocate (self%centre(size(position, 1), shape%ns), source=0.0_wp)
   do is = 1, shape%ns
      do k = self%seen%offset(is) + 1, self%seen%offset(is + 1)
         self%centre(:, is) = self%centre(:, is) + position(:, self%seen%index(k))
      end do
      self%centre(:, is) = self%centre(:, is) &
         & /max(self%seen%offset(is + 1) - self%seen%offset(is), 1_i8)
   end do
   call envelope_order(shape%neighbour, self%centre, shape%ns, 1, self%position, self%reach, least)
end subroutine new_rows

subroutine apply(self, x, y)
   class(rows_type), intent(in) :: self
   !> Coefficients of the unknowns, field fastest, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Rows, shape (m)
   real(wp), contiguous, intent(inout) :: y(:)
   real(wp) :: u(self%nc, self%shape%nq)
   integer :: b, i, q, row

   !$omp parallel do default(none) schedule(static) private(b, i, q, row, u) shared(self, x, y)
   do b = 1, size(self%place)
      call self%shape%interpolate(self%place(b), x, self%range(1, b), self%range(2, b), u)
      row = self%row(b)
      do i = 1, self%row(b + 1) - row
         y(row + i) = 0.0_wp
         do q = self%range(1, b), self%range(2, b)
            y(row + i) = y(row + i) + dot_product(self%coefficient(i, :, q, b), u(:, q))
         end do
      end do
   end do
   !$omp end parallel do
end subroutine apply

subroutine apply_transposed(self, x, y)
   class(rows_type), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)
   real(wp), allocatable :: dual(:, :, :)
   real(wp) :: total(self%nc)
   integer(i8) :: k
   integer :: b, c, i, ip, is, q

   allocate (dual(self%shape%nq, self%nc, self%shape%np), source=0.0_wp)
   do b = 1, size(self%place)
      ip = self%place(b)
      do i = 1, self%row(b + 1) - self%row(b)
         do c = 1, self%nc
            do q = self%range(1, b), self%range(2, b)
               dual(q, c, ip) = dual(q, c, ip) + self%coefficient(i, c, q, b)*x(self%row(b) + i)
            end do
         end do
      end do
   end do
   ! every source point sums over the places in its support, so that threads never conflict
   !$omp parallel do default(none) schedule(dynamic, 16) private(is, k, c, total) &
   !$omp shared(self, dual, y)
   do is = 1, self%shape%ns
      total = 0.0_wp
      do k = self%seen%offset(is) + 1, self%seen%offset(is + 1)
         do c = 1, self%nc
            total(c) = total(c) + dot_product(self%shape%value(:, self%seen_value(k)), &
               & dual(:, c, self%seen%index(k)))
         end do
      end do
      y(self%nc*(is - 1) + 1:self%nc*is) = total
   end do
   !$omp end parallel do
end subroutine apply_transposed

!> A^T A in its envelope, summed over groups of nearby places
subroutine envelope(self, a, error)
   class(rows_type), intent(in) :: self
   type(envelope_type), intent(out) :: a
   !> Error handling: no memory
   type(error_type), allocatable, intent(out) :: error
   type :: piece_type
      integer, allocatable :: row(:), run(:)
      real(wp), allocatable :: rows(:, :), product(:, :)
   end type piece_type
   type(piece_type), allocatable :: piece(:)
   integer :: reach(self%n)
   integer :: first, last, c, g, is, j, m, n, groups

   do c = 1, self%nc
      reach(self%nc*(self%position - 1) + c) = self%nc*(self%reach - 1) + 1
   end do
   call new_envelope(a, [((self%nc*(self%position(is) - 1) + c, c=1, self%nc), is=1, &
      & self%shape%ns)], reach, error)
   if (allocated(error)) return
   call a%clear()
   groups = size(self%group) - 1
   allocate (piece(min(batch, groups)))
   do first = 1, groups, batch
      last = min(first + batch - 1, groups)
      !$omp parallel default(none) shared(self, piece, first, last, a) private(g, j, m, n)
      !$omp do schedule(dynamic, 1)
      do g = first, last
         associate (p => piece(g - first + 1))
            call group_rows(self, g, p%row, p%run, p%rows, m)
            n = size(p%row)
            if (allocated(p%product)) then
               if (size(p%product, 1) < n) deallocate (p%product)
            end if
            if (.not. allocated(p%product)) allocate (p%product(n, n))
            call syrk(p%rows, m, n, p%product)
         end associate
      end do
      !$omp end do
      ! every block of columns is summed by one thread, in the order of the groups
      !$omp do schedule(dynamic, 1)
      do j = 1, size(a%first)
         do g = 1, last - first + 1
            call a%add(j, piece(g)%row, piece(g)%run, piece(g)%product)
         end do
      end do
      !$omp end do
      !$omp end parallel
   end do
end subroutine envelope

!> Dense rows of a group over its unknowns
subroutine group_rows(self, g, unknown, run, rows, m)
   class(rows_type), intent(in) :: self
   integer, intent(in) :: g
   !> Unknowns by their position in the elimination order, ascending
   integer, allocatable, intent(inout) :: unknown(:)
   !> Where runs of consecutive unknowns begin, and the end
   integer, allocatable, intent(inout) :: run(:)
   !> Rows, shape (>= m, size(unknown)); kept from call to call
   real(wp), allocatable, intent(inout) :: rows(:, :)
   !> Rows in use
   integer, intent(out) :: m
   integer, allocatable :: column(:), node(:)
   integer :: b, c, i, k, n, ip, low, high
   integer(i8) :: e

   associate (s => self%shape)
      allocate (column(s%ns), source=0)
      m = 0
      low = s%ns
      high = 1
      do i = self%group(g) + 1, self%group(g + 1)
         b = self%order(i)
         ip = self%place(b)
         m = m + self%row(b + 1) - self%row(b)
         do e = s%neighbour%offset(ip) + 1, s%neighbour%offset(ip + 1)
            k = self%position(s%neighbour%index(e))
            column(k) = 1
            low = min(low, k)
            high = max(high, k)
         end do
      end do
      node = pack([(k, k=low, high)], column(low:high) == 1)
      n = 0
      do k = low, high
         if (column(k) == 0) cycle
         n = n + 1
         column(k) = n
      end do
      unknown = [((self%nc*(node(k) - 1) + c, c=1, self%nc), k=1, n)]
      run = [1, pack([(self%nc*(k - 1) + 1, k=2, n)], node(2:n) > node(:n - 1) + 1), self%nc*n + 1]
      if (allocated(rows)) then
         if (size(rows, 1) < m .or. size(rows, 2) < self%nc*n) deallocate (rows)
      end if
      if (.not. allocated(rows)) allocate (rows(m, self%nc*n))
      rows(:, :self%nc*n) = 0.0_wp
      m = 0
      do i = self%group(g) + 1, self%group(g + 1)
         b = self%order(i)
         call write_block(self, b, column, rows, m)
         m = m + self%row(b + 1) - self%row(b)
      end do
   end associate
end subroutine group_rows

!> Write the rows of one block into a dense matrix
subroutine write_block(self, b, column, rows, row)
   class(rows_type), intent(in) :: self
   !> Block
   integer, intent(in) :: b
   !> Position of each source point among the columns, in the elimination order, shape (ns)
   integer, intent(in) :: column(:)
   !> Dense matrix
   real(wp), intent(inout) :: rows(:, :)
   !> Row before the first one of the block
   integer, intent(in) :: row
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: near(:)
   integer :: c, i, k, q, at

   call self%shape%row(self%place(b), near, values)
   do k = 1, size(near)
      at = self%nc*(column(self%position(near(k))) - 1)
      do q = self%range(1, b), self%range(2, b)
         do c = 1, self%nc
            do i = 1, self%row(b + 1) - self%row(b)
               rows(row + i, at + c) = rows(row + i, at + c) &
                  & + self%coefficient(i, c, q, b)*values(q, k)
            end do
         end do
      end do
   end do
end subroutine write_block

!> A in compressed rows
subroutine compressed(self, start, column, value)
   class(rows_type), intent(in) :: self
   integer(i8), allocatable, intent(out) :: start(:)
   integer(i8), allocatable, intent(out) :: column(:)
   real(wp), allocatable, intent(out) :: value(:)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: near(:)
   integer(i8) :: to
   integer :: b, c, i, k

   allocate (start(self%m + 1))
   start(1) = 0
   do b = 1, size(self%place)
      do i = self%row(b) + 1, self%row(b + 1)
         start(i + 1) = start(i) + self%nc*self%shape%count(self%place(b))
      end do
   end do
   allocate (column(start(self%m + 1)), value(start(self%m + 1)))
   !$omp parallel do default(none) schedule(static) private(b, c, i, k, to, near, values) &
   !$omp shared(self, start, column, value)
   do b = 1, size(self%place)
      call self%shape%row(self%place(b), near, values)
      associate (first => self%range(1, b), last => self%range(2, b))
         do i = 1, self%row(b + 1) - self%row(b)
            to = start(self%row(b) + i)
            do k = 1, size(near)
               do c = 1, self%nc
                  to = to + 1
                  column(to) = self%nc*(near(k) - 1) + c - 1
                  value(to) = dot_product(self%coefficient(i, c, first:last, b), &
                     & values(first:last, k))
               end do
            end do
         end do
      end associate
   end do
   !$omp end parallel do
end subroutine compressed

!> Source point and field of an unknown, and its position
subroutine get_name(self, j, text)
   class(rows_type), intent(in) :: self
   integer, intent(in) :: j
   character(len=:), allocatable, intent(out) :: text
   integer :: is

   is = (j - 1)/self%nc + 1
   text = 'field '//to_text(j - self%nc*(is - 1))//' of source point '//to_text(is)//' near ' &
      & //to_text(self%centre(:, is))
end subroutine get_name

!> Gather items whose places lie in the same box
pure subroutine gather(position, place, spacing, order, group)
   !> Coordinates of all places, shape (nd, np) [length]
   real(wp), intent(in) :: position(:, :)
   !> Place of each item, shape (n)
   integer, intent(in) :: place(:)
   !> Size of the boxes, shape (nd) [length]
   real(wp), intent(in) :: spacing(:)
   !> Items by their boxes, shape (n)
   integer, allocatable, intent(out) :: order(:)
   !> Box g holds order(group(g)+1 : group(g+1)); no box is empty
   integer, allocatable, intent(out) :: group(:)
   type(csr_type) :: box
   real(wp) :: low(size(spacing))
   integer :: box_of(size(place)), n(3), c(3), b, d

   low = minval(position, dim=2)
   n = 1
   do d = 1, size(spacing)
      n(d) = 1 + int((maxval(position(d, :)) - low(d))/spacing(d) + 1.0e-9_wp)
   end do
   do b = 1, size(place)
      c = 0
      do d = 1, size(spacing)
         ! the last layer of points joins the box below it
         c(d) = min(int((position(d, place(b)) - low(d))/spacing(d) + 1.0e-9_wp), &
            & max(n(d) - 2, 0))
      end do
      box_of(b) = 1 + c(1) + n(1)*(c(2) + n(2)*c(3))
   end do
   call group_by(product(n), box_of, box)
   order = box%index
   ! empty boxes form no group
   associate (offset => box%offset)
      group = [0, pack(int(offset(2:)), offset(2:) > offset(:size(offset) - 1))]
   end associate
end subroutine gather

end module rk_rows
