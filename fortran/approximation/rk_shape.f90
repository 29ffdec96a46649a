!> Reproducing kernel shape functions with first and second derivatives.
!>
!> The moment matrix is factorised once a place; its derivatives are never formed: the vectors
!> M_,i b and M_,ij b are accumulated from the neighbours. Places whose neighbours lie in the same
!> relative positions share one evaluation and one copy of the values.
!>
!> References: thesis section 4.2.1 and equations (5.1)-(5.5);
!>             Liu, Jun, Zhang, Int. J. Numer. Meth. Fluids 20 (1995), doi:10.1002/fld.1650200824
module rk_shape
   use rk_basis, only : basis_powers, basis_size, max_order, monomials, second_index
   use rk_csr, only : csr_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_kernel, only : window
   use rk_neighbours, only : covers, find_neighbours
   use rk_precision, only : i8, wp
   use rk_text, only : to_text
   implicit none
   private

   public :: approximation_type, shape_type, new_shape, derivative_count

   !> Choice of the approximation
   type :: approximation_type
      !> Order of the basis, 0..6
      integer :: order
      !> One of the kernel_* constants
      integer :: kernel
      !> One of the window_* constants
      integer :: window
   end type approximation_type

   !> Shape functions at places. Derivatives are counted: 1 value, then nd first derivatives, then
   !> the nd(nd+1)/2 second derivatives in the order 11, 12, 13, 22, 23, 33.
   type :: shape_type
      !> Space dimension
      integer :: nd = 0
      !> Number of derivatives, value included
      integer :: nq = 0
      !> Number of places
      integer :: np = 0
      !> Number of source points
      integer :: ns = 0
      !> Source points that cover each place
      type(csr_type) :: neighbour
      !> Stencil of each place, shape (np)
      integer, allocatable :: stencil(:)
      !> Values of stencil s are value(:, first(s)+1 : first(s+1)), shape (stencils + 1)
      integer(i8), allocatable, private :: first(:)
      !> Value and derivatives of each neighbour's shape function, shape (nq, entries)
      real(wp), allocatable :: value(:, :)
   contains
      !> Number of neighbours of a place
      procedure :: count => shape_count
      !> Neighbours of a place and their shape functions
      procedure :: row => shape_row
      !> Places that see each source point
      procedure :: transposed => shape_transposed
      !> Largest number of neighbours
      procedure :: max_count => shape_max_count
      !> Fields from coefficients at one place
      procedure :: interpolate
   end type shape_type

   !> Offsets over support are compared after rounding to 2**-44, far above rounding errors of
   !> grid coordinates and far below any spacing
   real(wp), parameter :: quantum = 2.0_wp**44
   !> Numbers beside it are whole numbers
   real(wp), parameter :: whole = 1.5_wp*2.0_wp**52

   !> More different coordinates than any basis needs
   integer, parameter :: most_planes = 10
   !> A pivot below this share of the unit diagonal means a singular moment matrix
   real(wp), parameter :: pivot_min = 1.0e-13_wp

contains

!> Number of derivatives, value included, up to second order
pure integer function derivative_count(nd)
   !> Space dimension
   integer, intent(in) :: nd

   derivative_count = 1 + nd + nd*(nd + 1)/2
end function derivative_count

!> Evaluate all shape functions at all places
subroutine new_shape(self, approximation, source, support, place, error, first, plain)
   !> Shape functions
   type(shape_type), intent(out) :: self
   !> Order, kernel and window
   type(approximation_type), intent(in) :: approximation
   !> Source points, shape (nd, ns) [length]
   real(wp), intent(in) :: source(:, :)
   !> Support of each source point, shape (nd, ns) [length]
   real(wp), intent(in) :: support(:, :)
   !> Places, shape (nd, np) [length]
   real(wp), intent(in) :: place(:, :)
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   !> First derivatives will do, which take a third of the time
   logical, intent(in), optional :: first
   !> Values will do
   logical, intent(in), optional :: plain
   integer, allocatable :: example(:), powers(:, :)
   logical, allocatable :: singular(:)
   integer :: ip, is, nb

   if (approximation%order < 0 .or. approximation%order > max_order) then
      call fatal_error(error, err_input, 'order of the basis must lie in 0..' &
         & //to_text(max_order)//', not '//to_text(approximation%order))
      return
   end if
   self%nd = size(source, 1)
   self%nq = derivative_count(self%nd)
   if (present(first)) self%nq = merge(1 + self%nd, self%nq, first)
   if (present(plain)) self%nq = merge(1, self%nq, plain)
   self%np = size(place, 2)
   self%ns = size(source, 2)
   call find_neighbours(self%neighbour, source, support, place, approximation%window, error)
   if (allocated(error)) return
   call find_stencils(self, source, support, place, example)

   nb = basis_size(self%nd, approximation%order)
   allocate (powers(3, nb), self%first(size(example) + 1), singular(size(example)))
   call basis_powers(self%nd, approximation%order, powers)
   self%first(1) = 0
   do is = 1, size(example)
      self%first(is + 1) = self%first(is) + self%count(example(is))
   end do
   allocate (self%value(self%nq, self%first(size(example) + 1)))
   !$omp parallel do default(none) schedule(dynamic, 16) private(is, ip) &
   !$omp shared(self, approximation, powers, example, source, support, place, singular)
   do is = 1, size(example)
      ip = example(is)
      associate (neighbours => self%neighbour%index(self%neighbour%offset(ip) + 1: &
         & self%neighbour%offset(ip + 1)))
         call shape_at_place(approximation, powers, source, support, neighbours, place(:, ip), &
            & self%value(:, self%first(is) + 1:self%first(is + 1)), singular(is))
      end associate
   end do
   !$omp end parallel do
   do is = 1, size(example)
      if (.not. singular(is)) cycle
      call singular_error(approximation, powers, source, support, place(:, example(is)), &
         & example(is), self%count(example(is)), error)
      return
   end do
end subroutine new_shape

!> Number of neighbours of a place
pure integer function shape_count(self, ip)
   !> Shape functions
   class(shape_type), intent(in) :: self
   !> Place
   integer, intent(in) :: ip

   shape_count = int(self%neighbour%offset(ip + 1) - self%neighbour%offset(ip))
end function shape_count

!> Neighbours of a place and their shape functions, as views that live as long as these do
subroutine shape_row(self, ip, nodes, values)
   !> Shape functions
   class(shape_type), target, intent(in) :: self
   !> Place
   integer, intent(in) :: ip
   !> Source points that cover it, ascending, shape (n)
   integer, pointer, contiguous, intent(out) :: nodes(:)
   !> Value and derivatives of their shape functions there, shape (nq, n)
   real(wp), pointer, contiguous, intent(out) :: values(:, :)

   associate (offset => self%neighbour%offset, first => self%first(self%stencil(ip)))
      nodes => self%neighbour%index(offset(ip) + 1:offset(ip + 1))
      values => self%value(:, first + 1:first + size(nodes))
   end associate
end subroutine shape_row

!> Places that see each source point, and where its shape function there is kept
subroutine shape_transposed(self, places, column)
   !> Shape functions
   class(shape_type), intent(in) :: self
   !> Places that see each source point
   type(csr_type), intent(out) :: places
   !> Its shape function there is value(:, column), shape (entries)
   integer(i8), allocatable, intent(out) :: column(:)
   integer(i8) :: k

   call self%neighbour%transposed(self%ns, places, column)
   do k = 1, size(column, kind=i8)
      column(k) = column(k) + self%first(self%stencil(places%index(k))) &
         & - self%neighbour%offset(places%index(k))
   end do
end subroutine shape_transposed

!> Largest number of neighbours
pure integer function shape_max_count(self)
   !> Shape functions
   class(shape_type), intent(in) :: self

   shape_max_count = int(maxval(self%neighbour%offset(2:) - self%neighbour%offset(:self%np)))
end function shape_max_count

!> Fields and derivatives at one place from coefficients at the source points
pure subroutine interpolate(self, ip, x, first, last, field)
   !> Shape functions
   class(shape_type), intent(in) :: self
   !> Place
   integer, intent(in) :: ip
   !> Coefficients, field fastest, shape (fields*ns)
   real(wp), intent(in) :: x(:)
   !> First and last derivative wanted
   integer, intent(in) :: first, last
   !> Value and derivatives of each field, zero where not wanted, shape (fields, nq)
   real(wp), intent(out) :: field(:, :)
   integer(i8) :: k, to_value
   integer :: q, c, at

   field = 0.0_wp
   to_value = self%first(self%stencil(ip)) - self%neighbour%offset(ip)
   do k = self%neighbour%offset(ip) + 1, self%neighbour%offset(ip + 1)
      at = size(field, 1)*(self%neighbour%index(k) - 1)
      do q = first, last
         do c = 1, size(field, 1)
            field(c, q) = field(c, q) + x(at + c)*self%value(q, k + to_value)
         end do
      end do
   end do
end subroutine interpolate

!> Group places whose neighbours lie in the same relative positions with the same supports
subroutine find_stencils(self, source, support, place, example)
   !> Shape functions with neighbours; the stencil of each place is set
   type(shape_type), intent(inout) :: self
   !> Source points, shape (nd, ns) [length]
   real(wp), intent(in) :: source(:, :)
   !> Support, shape (nd, ns) [length]
   real(wp), intent(in) :: support(:, :)
   !> Places, shape (nd, np) [length]
   real(wp), intent(in) :: place(:, :)
   !> One place of each stencil, shape (stencils)
   integer, allocatable, intent(out) :: example(:)
   integer(i8), allocatable :: key(:)
   integer, allocatable :: table(:), found(:)
   integer :: ip, slot, n, bits

   allocate (key(self%np), self%stencil(self%np), found(self%np))
   !$omp parallel do default(none) schedule(static) private(ip) &
   !$omp shared(self, source, support, place, key)
   do ip = 1, self%np
      key(ip) = stencil_key(self, source, support, place, ip)
   end do
   !$omp end parallel do
   bits = 4
   do while (2**bits < 2*self%np)
      bits = bits + 1
   end do
   allocate (table(0:2**bits - 1), source=0)
   n = 0
   do ip = 1, self%np
      slot = int(iand(ieor(key(ip), ishft(key(ip), -29)), int(2**bits - 1, i8)))
      do
         if (table(slot) == 0) then
            n = n + 1
            table(slot) = n
            found(n) = ip
            exit
         end if
         if (key(found(table(slot))) == key(ip)) then
            if (same_stencil(self, source, support, place, found(table(slot)), ip)) exit
         end if
         slot = iand(slot + 1, 2**bits - 1)
      end do
      self%stencil(ip) = table(slot)
   end do
   example = found(:n)
end subroutine find_stencils

!> Offset of a neighbour in units of its support along an axis as an integer
pure integer(i8) function quantised(offset, support)
   !> Place minus source point [length]
   real(wp), intent(in) :: offset
   !> Support [length]
   real(wp), intent(in) :: support

   ! the sum is rounded to a whole number, as which its bits tell it
   quantised = transfer(offset/support*quantum + whole, 0_i8)
end function quantised

!> Hash of the relative positions of a place's neighbours
pure integer(i8) function stencil_key(self, source, support, place, ip)
   !> Shape functions with neighbours
   type(shape_type), intent(in) :: self
   !> Source points, shape (nd, ns) [length]
   real(wp), intent(in) :: source(:, :)
   !> Support, shape (nd, ns) [length]
   real(wp), intent(in) :: support(:, :)
   !> Places, shape (nd, np) [length]
   real(wp), intent(in) :: place(:, :)
   !> Place
   integer, intent(in) :: ip
   integer(i8) :: q(2), k
   integer :: d, i

   stencil_key = 1469598103934665603_i8
   do k = self%neighbour%offset(ip) + 1, self%neighbour%offset(ip + 1)
      associate (is => self%neighbour%index(k))
         do d = 1, self%nd
            q = [quantised(place(d, ip) - source(d, is), support(d, is)), &
               & transfer(support(d, is), 0_i8)]
            do i = 1, 2
               stencil_key = ieor(ishftc(stencil_key, 5), q(i) + ishft(q(i), -31))
               stencil_key = ieor(stencil_key, ishft(stencil_key, 13))
               stencil_key = ieor(stencil_key, ishft(stencil_key, -7))
               stencil_key = ieor(stencil_key, ishft(stencil_key, 17))
            end do
         end do
      end associate
   end do
end function stencil_key

!> Whether two places have the same stencil
pure logical function same_stencil(self, source, support, place, ip, jp)
   !> Shape functions with neighbours
   type(shape_type), intent(in) :: self
   !> Source points, shape (nd, ns) [length]
   real(wp), intent(in) :: source(:, :)
   !> Support, shape (nd, ns) [length]
   real(wp), intent(in) :: support(:, :)
   !> Places, shape (nd, np) [length]
   real(wp), intent(in) :: place(:, :)
   !> First place
   integer, intent(in) :: ip
   !> Second place
   integer, intent(in) :: jp
   integer(i8) :: k, shift
   integer :: d

   same_stencil = self%count(ip) == self%count(jp)
   if (.not. same_stencil) return
   shift = self%neighbour%offset(jp) - self%neighbour%offset(ip)
   do k = self%neighbour%offset(ip) + 1, self%neighbour%offset(ip + 1)
      associate (is => self%neighbour%index(k), js => self%neighbour%index(k + shift))
         do d = 1, self%nd
            same_stencil = quantised(place(d, ip) - source(d, is), support(d, is)) == &
               & quantised(place(d, jp) - source(d, js), support(d, js)) .and. &
               & transfer(support(d, is), 0_i8) == transfer(support(d, js), 0_i8)
            if (.not. same_stencil) return
         end do
      end associate
   end do
end function same_stencil

!> Shape functions of all neighbours at one place
subroutine shape_at_place(approximation, powers, source, support, neighbours, x, value, singular)
   !> Order, kernel and window
   type(approximation_type), intent(in) :: approximation
   !> Exponents of the basis, shape (3, nb)
   integer, intent(in) :: powers(:, :)
   !> Source points, shape (nd, ns) [length]
   real(wp), intent(in) :: source(:, :)
   !> Support, shape (nd, ns) [length]
   real(wp), intent(in) :: support(:, :)
   !> Neighbours, shape (n)
   integer, intent(in) :: neighbours(:)
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Value and derivatives, shape (nq, n); nq = 1 + nd for first ones only, 1 for none
   real(wp), intent(out) :: value(:, :)
   !> Whether the moment matrix is singular
   logical, intent(out) :: singular
   real(wp), allocatable :: h(:, :), dh(:, :, :), ddh(:, :, :)
   real(wp), allocatable :: m(:, :), phi(:), dphi(:, :), ddphi(:, :, :)
   real(wp), allocatable :: s(:), ds(:, :), dds(:, :), t(:, :), dt(:, :, :)
   real(wp), allocatable :: b(:), db(:, :), ddb(:, :)
   real(wp) :: scale(size(x)), w(size(powers, 2)), r(3)
   integer :: nd, nb, n, i, j, k, q, seconds

   nd = size(x)
   nb = size(powers, 2)
   n = size(neighbours)
   seconds = max(size(value, 1) - 1 - nd, 0)
   value = 0.0_wp
   singular = n < nb
   if (singular) return
   allocate (h(nb, n), dh(nb, nd, n), ddh(nb, seconds, n))
   allocate (m(nb, nb), phi(n), dphi(nd, n), ddphi(nd, merge(nd, 0, seconds > 0), n))
   scale = maxval(support(:, neighbours), dim=2)

   m = 0.0_wp
   do k = 1, n
      r(:nd) = x - source(:, neighbours(k))
      call monomials(nd, approximation%order, powers, r(:nd), scale, h(:, k), dh(:, :, k), &
         & ddh(:, :, k))
      call window(approximation%kernel, approximation%window, nd, r(:nd), &
         & support(:, neighbours(k)), phi(k), dphi(:, k), ddphi(:, :, k))
      do j = 1, nb
         m(:j, j) = m(:j, j) + phi(k)*h(j, k)*h(:j, k)
      end do
   end do
   call factorise(m, w, singular)
   if (singular) return

   ! M b = H(0) (4.21)
   allocate (b(nb), db(nb, nd), ddb(nb, seconds))
   b = 0.0_wp
   b(1) = 1.0_wp
   call solve(m, w, b)
   if (size(value, 1) == 1) then
      do k = 1, n
         value(1, k) = phi(k)*dot_product(h(:, k), b)
      end do
      return
   end if
   allocate (s(n), ds(nd, n), dds(seconds, n), t(nd, n), dt(nd, nd, n))
   do k = 1, n
      s(k) = dot_product(h(:, k), b)
      do i = 1, nd
         ds(i, k) = dot_product(b, dh(:, i, k))
      end do
      do q = 1, seconds
         dds(q, k) = dot_product(b, ddh(:, q, k))
      end do
   end do
   ! M b_,i = -M_,i b
   do i = 1, nd
      db(:, i) = 0.0_wp
      do k = 1, n
         db(:, i) = db(:, i) - phi(k)*s(k)*dh(:, i, k) &
            & - (phi(k)*ds(i, k) + dphi(i, k)*s(k))*h(:, k)
      end do
      call solve(m, w, db(:, i))
   end do
   if (seconds == 0) then
      do k = 1, n
         value(1, k) = phi(k)*s(k)
         do i = 1, nd
            value(1 + i, k) = dphi(i, k)*s(k) + phi(k)*(ds(i, k) + dot_product(h(:, k), db(:, i)))
         end do
      end do
      return
   end if
   do k = 1, n
      do j = 1, nd
         t(j, k) = dot_product(h(:, k), db(:, j))
         do i = 1, nd
            ! dt(i, j) = H_,i . b_,j
            dt(i, j, k) = dot_product(dh(:, i, k), db(:, j))
         end do
      end do
   end do
   ! M b_,ij = -(M_,ij b + M_,i b_,j + M_,j b_,i)
   do i = 1, nd
      do j = i, nd
         q = second_index(nd, i, j) - 1 - nd
         ddb(:, q) = 0.0_wp
         do k = 1, n
            ddb(:, q) = ddb(:, q) - phi(k)*s(k)*ddh(:, q, k) &
               & - (phi(k)*(ds(j, k) + t(j, k)) + dphi(j, k)*s(k))*dh(:, i, k) &
               & - (phi(k)*(ds(i, k) + t(i, k)) + dphi(i, k)*s(k))*dh(:, j, k) &
               & - (phi(k)*(dds(q, k) + dt(i, j, k) + dt(j, i, k)) &
               & + dphi(j, k)*(ds(i, k) + t(i, k)) + dphi(i, k)*(ds(j, k) + t(j, k)) &
               & + ddphi(i, j, k)*s(k))*h(:, k)
         end do
         call solve(m, w, ddb(:, q))
      end do
   end do
   do k = 1, n
      value(1, k) = phi(k)*s(k)
      do i = 1, nd
         value(1 + i, k) = dphi(i, k)*s(k) + phi(k)*(ds(i, k) + t(i, k))
         do j = i, nd
            q = second_index(nd, i, j) - 1 - nd
            value(1 + nd + q, k) = ddphi(i, j, k)*s(k) &
               & + dphi(i, k)*(ds(j, k) + t(j, k)) + dphi(j, k)*(ds(i, k) + t(i, k)) &
               & + phi(k)*(dds(q, k) + dt(i, j, k) + dt(j, i, k) &
               & + dot_product(h(:, k), ddb(:, q)))
         end do
      end do
   end do
end subroutine shape_at_place

!> Cholesky factor of the moment matrix scaled to a unit diagonal
pure subroutine factorise(m, w, singular)
   !> Upper triangle of the matrix, replaced by its factor, shape (nb, nb)
   real(wp), intent(inout) :: m(:, :)
   !> Reciprocal square roots of the diagonal, shape (nb)
   real(wp), intent(out) :: w(:)
   !> Whether the matrix is singular to rounding
   logical, intent(out) :: singular
   integer :: i, j

   singular = .true.
   do j = 1, size(m, 1)
      if (.not. m(j, j) > 0.0_wp) return
      w(j) = 1.0_wp/sqrt(m(j, j))
   end do
   do j = 1, size(m, 1)
      m(:j, j) = m(:j, j)*w(:j)*w(j)
      do i = 1, j - 1
         m(i, j) = (m(i, j) - dot_product(m(:i - 1, i), m(:i - 1, j)))/m(i, i)
      end do
      m(j, j) = m(j, j) - dot_product(m(:j - 1, j), m(:j - 1, j))
      if (.not. m(j, j) > pivot_min) return
      m(j, j) = sqrt(m(j, j))
   end do
   singular = .false.
end subroutine factorise

!> Solve with the factor of the moment matrix
pure subroutine solve(m, w, b)
   !> Factor, shape (nb, nb)
   real(wp), intent(in) :: m(:, :)
   !> Scaling, shape (nb)
   real(wp), intent(in) :: w(:)
   !> Right hand side, replaced by the solution, shape (nb)
   real(wp), intent(inout) :: b(:)
   integer :: i

   b = b*w
   do i = 1, size(b)
      b(i) = (b(i) - dot_product(m(:i - 1, i), b(:i - 1)))/m(i, i)
   end do
   do i = size(b), 1, -1
      b(i) = b(i)/m(i, i)
      b(:i - 1) = b(:i - 1) - b(i)*m(:i - 1, i)
   end do
   b = b*w
end subroutine solve

!> Name the place of a singular moment matrix and the support that would cure it
subroutine singular_error(approximation, powers, source, support, x, ip, n, error)
   !> Order, kernel and window
   type(approximation_type), intent(in) :: approximation
   !> Exponents of the basis, shape (3, nb)
   integer, intent(in) :: powers(:, :)
   !> Source points, shape (nd, ns) [length]
   real(wp), intent(in) :: source(:, :)
   !> Support, shape (nd, ns) [length]
   real(wp), intent(in) :: support(:, :)
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Number of the place
   integer, intent(in) :: ip
   !> Number of its neighbours
   integer, intent(in) :: n
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: wide(:, :), value(:, :)
   integer, allocatable :: near(:)
   character(len=:), allocatable :: cure
   real(wp) :: factor
   character(len=1), parameter :: axes(3) = ['x', 'y', 'z']
   logical :: singular
   integer :: i, trial, across

   factor = 1.0_wp
   cure = 'no larger support cures it: do the source points lie in a line or plane, or are' &
      & //' some of them equal?'
   do i = 1, size(x)
      across = planes(source(i, :))
      if (across == 1 .or. across > approximation%order) cycle
      cure = 'a basis of that order needs '//to_text(approximation%order + 1)//' source points ' &
         & //'across in each direction, along '//axes(i)//' there are '//to_text(across) &
         & //': use more of them, or order '//to_text(max(across - 1, 1))
      exit
   end do
   do trial = 1, 16
      factor = factor*1.1_wp
      wide = factor*support
      near = pack([(i, i=1, size(source, 2))], &
         & [(covers(x - source(:, i), wide(:, i), approximation%window), i=1, size(source, 2))])
      allocate (value(derivative_count(size(x)), size(near)))
      call shape_at_place(approximation, powers, source, wide, near, x, value, singular)
      deallocate (value)
      if (singular) cycle
      cure = 'a support '//to_text(factor, 3)//' times as large cures it'
      exit
   end do
   call fatal_error(error, err_input, 'point '//to_text(ip)//' at '//to_text(x) &
      & //': singular moment matrix with '//to_text(n)//' neighbours (order ' &
      & //to_text(approximation%order)//' needs at least '//to_text(size(powers, 2)) &
      & //'); '//cure)
end subroutine singular_error

!> Number of different coordinates, as far as a basis may need them
pure integer function planes(coordinate)
   !> Coordinates, shape (ns) [length]
   real(wp), intent(in) :: coordinate(:)
   real(wp) :: least, apart

   apart = 1.0e-9_wp*(maxval(coordinate) - minval(coordinate))
   least = minval(coordinate)
   do planes = 1, most_planes
      if (.not. any(coordinate > least + apart)) exit
      least = minval(coordinate, mask=coordinate > least + apart)
   end do
end function planes

end module rk_shape
