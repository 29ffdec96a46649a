!> Reproducing kernel shape functions with first and second derivatives.
!>
!> Positions whose neighbours lie in the same relative positions share one evaluation and one copy
!> of the values.
!>
!> References: thesis section 4.2.1 and equations (5.1)-(5.5);
!>             Liu, Jun, Zhang, Int. J. Numer. Meth. Fluids 20 (1995), doi:10.1002/fld.1650200824
module rk_shape
   use rk_basis, only : basis_powers, basis_size, max_order
   use rk_csr, only : csr_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_kernel, only : window_polar, window_product
   use rk_margin, only : margin_type
   use rk_neighbours, only : find_neighbours
   use rk_place_shape, only : approximation_type, new_approximation, shape_at_place
   use rk_precision, only : i8, wp
   use rk_text, only : to_text
   implicit none
   private

   public :: approximation_type, new_approximation, shape_type, new_shape, derivative_count

   !> Shape functions at given positions. Derivatives are numbered: 1 the value, then nd first
   !> derivatives, then the nd(nd+1)/2 second derivatives in the order 11, 12, 13, 22, 23, 33.
   type :: shape_type
      !> Space dimension
      integer :: nd = 0
      !> Number of derivatives, value included
      integer :: nq = 0
      !> Number of positions
      integer :: np = 0
      !> Number of source points
      integer :: ns = 0
      !> Source points whose functions may differ from zero at each position
      type(csr_type) :: neighbour
      !> Stencil of each position, shape (np)
      integer, allocatable :: stencil(:)
      !> Values of stencil s are value(:, first(s)+1 : first(s+1)), shape (stencils + 1)
      integer(i8), allocatable, private :: first(:)
      !> Value and derivatives of each neighbour's shape function, shape (nq, entries)
      real(wp), allocatable :: value(:, :)
   contains
      procedure :: count => shape_count, row => shape_row, transposed => shape_transposed
      procedure :: interpolate
   end type shape_type

   !> Offsets over support are compared after rounding to 2**-44, far above rounding errors of
   !> grid coordinates and far below any spacing
   real(wp), parameter :: quantum = 2.0_wp**44
   !> Adding this number rounds to a whole number
   real(wp), parameter :: whole = 1.5_wp*2.0_wp**52

   !> A number of different coordinates that exceeds the needs of any basis
   integer, parameter :: most_planes = 10

contains

!> Number of derivatives, value included, up to second order
pure integer function derivative_count(nd)
   !> Space dimension
   integer, intent(in) :: nd

   derivative_count = 1 + nd + nd*(nd + 1)/2
end function derivative_count

!> Evaluate all shape functions at all positions
recursive subroutine new_shape(self, approximation, source, support, place, error, first, plain, &
   & margin)
   type(shape_type), intent(out) :: self
   !> Order, kernel and window
   type(approximation_type), intent(in) :: approximation
   !> Source points, shape (nd, ns) [length]
   real(wp), intent(in) :: source(:, :)
   !> Support of each source point, shape (nd, ns) [length]
   real(wp), intent(in) :: support(:, :)
   !> Positions, shape (nd, np) [length]
   real(wp), intent(in) :: place(:, :)
   type(error_type), allocatable, intent(out) :: error
   !> First derivatives only, which take a third of the time
   logical, intent(in), optional :: first
   !> Values only
   logical, intent(in), optional :: plain
   !> Layers of points beyond the sides of a lattice, for which source points stand
   type(margin_type), intent(in), optional :: margin
   type(shape_type) :: wide
   integer, allocatable :: example(:), powers(:, :)
   logical, allocatable :: singular(:)
   integer :: ip, is, nb

   if (present(margin)) then
      call new_shape(wide, approximation, margin%point, margin%support, place, error, first, plain)
      if (.not. allocated(error)) call fold(self, wide, margin, size(source, 2))
      return
   end if
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
   if (approximation%window == window_polar) then
      call find_neighbours(self%neighbour, polar(source), angular(source, support), polar(place), &
         & window_product, error)
      if (allocated(error)) return
      ! supports along circles also determine the radius
      call find_stencils(self, approximation, polar(source), support, polar(place), example)
   else
      call find_neighbours(self%neighbour, source, support, place, approximation%window, error)
      if (allocated(error)) return
      call find_stencils(self, approximation, source, support, place, example)
   end if

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
   is = findloc(singular, .true., dim=1)
   if (is > 0) then
      call singular_error(approximation%order, nb, source, place(:, example(is)), example(is), &
         & self%count(example(is)), error)
      return
   end if
   if (approximation%window == window_polar) call turn_stencils(self, place, example)
end subroutine new_shape

!> Add the functions of points beyond the sides to those of the source points that stand for them
subroutine fold(self, wide, margin, ns)
   !> Shape functions of the source points
   type(shape_type), intent(inout) :: self
   !> Those of the lattice with its layers
   type(shape_type), intent(in) :: wide
   type(margin_type), intent(in) :: margin
   !> Number of source points
   integer, intent(in) :: ns
   !> Source points of a stencil, each with the neighbour, and the number among the points that
   !> stand for it, which first names it
   integer, allocatable :: source(:), own(:, :), named(:, :)
   integer, allocatable :: last(:), before(:), sides(:), example(:)
   real(wp), allocatable :: value(:, :)
   integer(i8) :: k
   integer :: count, ip, is, j, n, reached, widest

   self%nd = wide%nd
   self%nq = wide%nq
   self%np = wide%np
   self%ns = ns
   ! stencils that are equal with the layers differ beside different sides
   allocate (self%stencil(self%np), before(self%np), sides(self%np), example(self%np))
   allocate (last(size(wide%first) - 1), source=0)
   n = 0
   do ip = 1, self%np
      reached = 0
      do k = wide%neighbour%offset(ip) + 1, wide%neighbour%offset(ip + 1)
         reached = ior(reached, margin%beyond(wide%neighbour%index(k)))
      end do
      is = last(wide%stencil(ip))
      do while (is > 0)
         if (sides(is) == reached) exit
         is = before(is)
      end do
      if (is == 0) then
         n = n + 1
         is = n
         sides(n) = reached
         example(n) = ip
         before(n) = last(wide%stencil(ip))
         last(wide%stencil(ip)) = n
      end if
      self%stencil(ip) = is
   end do

   widest = 0
   do is = 1, n
      associate (offset => wide%neighbour%offset(example(is):example(is) + 1))
         widest = max(widest, sum(margin%count(wide%neighbour%index(offset(1) + 1:offset(2)))))
      end associate
   end do
   allocate (source(widest), own(2, widest), value(self%nq, widest), self%first(n + 1))
   ! counted first: on graded lattices nearly every position has a stencil of its own
   self%first(1) = 0
   do is = 1, n
      call gather(example(is))
      self%first(is + 1) = self%first(is) + count
   end do
   allocate (self%value(self%nq, self%first(n + 1)), named(2, self%first(n + 1)))
   do is = 1, n
      call gather(example(is))
      self%value(:, self%first(is) + 1:self%first(is + 1)) = value(:, :count)
      named(:, self%first(is) + 1:self%first(is + 1)) = own(:, :count)
   end do

   allocate (self%neighbour%offset(self%np + 1))
   self%neighbour%offset(1) = 0
   do ip = 1, self%np
      self%neighbour%offset(ip + 1) = self%neighbour%offset(ip) &
         & + self%first(self%stencil(ip) + 1) - self%first(self%stencil(ip))
   end do
   allocate (self%neighbour%index(self%neighbour%offset(self%np + 1)))
   !$omp parallel do default(none) schedule(static) private(ip, j) shared(self, wide, margin, named)
   do ip = 1, self%np
      associate (to => self%neighbour%offset(ip), from => self%first(self%stencil(ip)))
         do j = 1, int(self%neighbour%offset(ip + 1) - to)
            self%neighbour%index(to + j) = margin%source(named(2, from + j), &
               & wide%neighbour%index(wide%neighbour%offset(ip) + named(1, from + j)))
         end do
      end associate
   end do
   !$omp end parallel do

contains

   !> Source points of a position, ascending, and their functions
   subroutine gather(ip)
      integer, intent(in) :: ip
      integer(i8) :: k
      integer :: e, i, j
      logical :: known

      count = 0
      do i = 1, wide%count(ip)
         k = wide%neighbour%offset(ip) + i
         associate (point => wide%neighbour%index(k), &
            & part => wide%value(:, wide%first(wide%stencil(ip)) + i))
            do e = 1, margin%count(point)
               j = count
               do while (j > 0)
                  if (source(j) <= margin%source(e, point)) exit
                  j = j - 1
               end do
               known = .false.
               if (j > 0) known = source(j) == margin%source(e, point)
               if (.not. known) then
                  j = j + 1
                  source(j + 1:count + 1) = source(j:count)
                  own(:, j + 1:count + 1) = own(:, j:count)
                  value(:, j + 1:count + 1) = value(:, j:count)
                  count = count + 1
                  source(j) = margin%source(e, point)
                  own(:, j) = [i, e]
                  value(:, j) = 0.0_wp
               end if
               value(:, j) = value(:, j) + margin%factor(e, point)*part
            end do
         end associate
      end do
   end subroutine gather

end subroutine fold

!> Give each position its own derivatives: those of polar stencils turn with the position
subroutine turn_stencils(self, place, example)
   !> Shape functions of positions that share stencils
   type(shape_type), intent(inout) :: self
   !> Positions, shape (2, np) [length]
   real(wp), intent(in) :: place(:, :)
   !> Position at which each stencil was evaluated, shape (stencils)
   integer, intent(in) :: example(:)
   real(wp), allocatable :: value(:, :)
   integer(i8), allocatable :: first(:)
   real(wp) :: c, s, radii
   integer(i8) :: k
   integer :: ip

   allocate (value(self%nq, size(self%neighbour%index)))
   allocate (first, source=self%neighbour%offset)
   !$omp parallel do default(none) schedule(static) private(ip, k, c, s, radii) &
   !$omp shared(self, place, example, value)
   do ip = 1, self%np
      associate (to => value(:, self%neighbour%offset(ip) + 1:self%neighbour%offset(ip + 1)), &
         & from => self%first(self%stencil(ip)), at => place(:, example(self%stencil(ip))))
         radii = norm2(at)*norm2(place(:, ip))
         c = dot_product(at, place(:, ip))/radii
         s = (at(1)*place(2, ip) - at(2)*place(1, ip))/radii
         do k = 1, size(to, 2)
            call turn(self%value(:, from + k), c, s, to(:, k))
         end do
      end associate
   end do
   !$omp end parallel do
   self%stencil = [(ip, ip=1, self%np)]
   call move_alloc(value, self%value)
   call move_alloc(first, self%first)
end subroutine turn_stencils

!> Value and derivatives in the plane after a rotation of the function
pure subroutine turn(from, c, s, to)
   !> Value, first and second derivatives, as far as given, shape (nq)
   real(wp), intent(in) :: from(:)
   !> Cosine and sine of the angle [-]
   real(wp), intent(in) :: c, s
   !> The same after the rotation, shape (nq)
   real(wp), intent(out) :: to(:)

   to(1) = from(1)
   if (size(from) < 3) return
   to(2:3) = [c*from(2) - s*from(3), s*from(2) + c*from(3)]
   if (size(from) < 6) return
   to(4) = c*c*from(4) - 2.0_wp*c*s*from(5) + s*s*from(6)
   to(5) = c*s*(from(4) - from(6)) + (c*c - s*s)*from(5)
   to(6) = s*s*from(4) + 2.0_wp*c*s*from(5) + c*c*from(6)
end subroutine turn

!> Number of neighbours of a position
pure integer function shape_count(self, ip)
   class(shape_type), intent(in) :: self
   !> Index of the position
   integer, intent(in) :: ip

   shape_count = int(self%neighbour%offset(ip + 1) - self%neighbour%offset(ip))
end function shape_count

!> Neighbours of a position and their shape functions, as pointers that are valid as long as self
subroutine shape_row(self, ip, nodes, values)
   class(shape_type), target, intent(in) :: self
   !> Index of the position
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

!> Positions covered by each source point, and where its shape function there is stored
subroutine shape_transposed(self, places, column)
   class(shape_type), intent(in) :: self
   !> Positions covered by each source point
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

!> Radius and angle of points, shape (2, n) [length], [radian]
pure function polar(x) result(at)
   !> Points, shape (2, n) [length]
   real(wp), intent(in) :: x(:, :)
   real(wp) :: at(2, size(x, 2))

   at(1, :) = norm2(x, dim=1)
   at(2, :) = atan2(x(2, :), x(1, :))
end function polar

!> Supports in radius and angle, shape (2, n) [length], [radian]
pure function angular(x, support) result(at)
   !> Points, shape (2, n) [length]
   real(wp), intent(in) :: x(:, :)
   !> Supports, radial and circumferential, shape (2, n) [length]
   real(wp), intent(in) :: support(:, :)
   real(wp) :: at(2, size(x, 2))

   at = support
   at(2, :) = support(2, :)/norm2(x, dim=1)
end function angular

!> Fields and derivatives at one position from coefficients at the source points
pure subroutine interpolate(self, ip, x, first, last, field)
   class(shape_type), intent(in) :: self
   !> Index of the position
   integer, intent(in) :: ip
   !> Coefficients, field fastest, shape (fields*ns)
   real(wp), intent(in) :: x(:)
   !> First and last derivative to be computed
   integer, intent(in) :: first, last
   !> Value and derivatives of each field, zero if not computed, shape (fields, nq)
   real(wp), intent(out) :: field(:, :)
   !> Fields stored side by side, a number known to the compiler
   integer, parameter :: wide = 4
   real(wp) :: sums(wide, size(field, 2)), u(wide)
   integer(i8) :: k, to_value
   integer :: q, c, at, n

   field = 0.0_wp
   to_value = self%first(self%stencil(ip)) - self%neighbour%offset(ip)
   do c = 1, size(field, 1), wide
      n = min(wide, size(field, 1) - c + 1)
      u = 0.0_wp
      sums = 0.0_wp
      do k = self%neighbour%offset(ip) + 1, self%neighbour%offset(ip + 1)
         at = size(field, 1)*(self%neighbour%index(k) - 1) + c
         u(:n) = x(at:at + n - 1)
         do q = first, last
            sums(:, q) = sums(:, q) + u*self%value(q, k + to_value)
         end do
      end do
      field(c:c + n - 1, first:last) = sums(:n, first:last)
   end do
end subroutine interpolate

!> Group positions whose neighbours, and the planes among them, have the same relative positions and
!> the same supports
subroutine find_stencils(self, approximation, source, support, place, example)
   !> Shape functions with neighbours; the stencil of each position is set
   type(shape_type), intent(inout) :: self
   type(approximation_type), intent(in) :: approximation
   !> Source points, shape (nd, ns) [length]
   real(wp), intent(in) :: source(:, :)
   !> Support, shape (nd, ns) [length]
   real(wp), intent(in) :: support(:, :)
   !> Positions, shape (nd, np) [length]
   real(wp), intent(in) :: place(:, :)
   !> One position of each stencil, shape (stencils)
   integer, allocatable, intent(out) :: example(:)
   integer(i8), allocatable :: key(:)
   integer, allocatable :: table(:), found(:)
   real(wp) :: reach(self%nd)
   integer :: ip, slot, n, bits, kinks

   kinks = 0
   if (allocated(approximation%kink)) kinks = size(approximation%kink)
   reach = maxval(support, dim=2)
   allocate (key(self%np), self%stencil(self%np), found(self%np))
   !$omp parallel do default(none) schedule(static) private(ip) &
   !$omp shared(self, approximation, source, support, place, key, reach, kinks)
   do ip = 1, self%np
      key(ip) = stencil_key(ip)
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
            if (same_stencil(found(table(slot)), ip)) exit
         end if
         slot = iand(slot + 1, 2**bits - 1)
      end do
      self%stencil(ip) = table(slot)
   end do
   example = found(:n)

contains

   !> Offset of a position from a neighbour in units of its support along an axis, as an integer
   pure integer(i8) function offset(ip, is, d)
      integer, intent(in) :: ip, is, d

      ! the sum is rounded to a whole number, whose bits are used
      offset = transfer((place(d, ip) - source(d, is))/support(d, is)*quantum + whole, 0_i8)
   end function offset

   !> Distance of a position from a plane over the largest support, as an integer; the same for all
   !> positions whose neighbours cannot reach across
   pure integer(i8) function distance(ip, kink)
      integer, intent(in) :: ip, kink
      real(wp) :: away

      associate (a => approximation%kink_axis(kink))
         away = (place(a, ip) - approximation%kink(kink))/reach(a)
      end associate
      distance = transfer(min(max(away, -1.0_wp), 1.0_wp)*quantum + whole, 0_i8)
      if (abs(away) >= 1.0_wp) distance = 0
   end function distance

   !> Hash of the relative positions of the neighbours of a position
   pure integer(i8) function stencil_key(ip)
      integer, intent(in) :: ip
      integer(i8) :: q, k
      integer :: d

      stencil_key = 1469598103934665603_i8
      do d = 1, kinks
         stencil_key = ieor(ishftc(stencil_key, 9), distance(ip, d))
      end do
      do k = self%neighbour%offset(ip) + 1, self%neighbour%offset(ip + 1)
         associate (is => self%neighbour%index(k))
            q = 0
            do d = 1, self%nd
               q = ieor(ieor(ishftc(q, 21), offset(ip, is, d)), &
                  & ishftc(transfer(support(d, is), 0_i8), 11))
            end do
         end associate
         stencil_key = ieor(ishftc(stencil_key, 5), ieor(q, ishft(q, -31)))
         stencil_key = ieor(stencil_key, ishft(stencil_key, 13))
         stencil_key = ieor(stencil_key, ishft(stencil_key, -7))
         stencil_key = ieor(stencil_key, ishft(stencil_key, 17))
      end do
   end function stencil_key

   !> Whether two positions have the same stencil
   pure logical function same_stencil(ip, jp)
      integer, intent(in) :: ip, jp
      integer(i8) :: k, shift
      integer :: d

      same_stencil = self%count(ip) == self%count(jp)
      do d = 1, kinks
         same_stencil = same_stencil .and. distance(ip, d) == distance(jp, d)
      end do
      if (.not. same_stencil) return
      shift = self%neighbour%offset(jp) - self%neighbour%offset(ip)
      do k = self%neighbour%offset(ip) + 1, self%neighbour%offset(ip + 1)
         associate (is => self%neighbour%index(k), js => self%neighbour%index(k + shift))
            do d = 1, self%nd
               same_stencil = offset(ip, is, d) == offset(jp, js, d) .and. &
                  & transfer(support(d, is), 0_i8) == transfer(support(d, js), 0_i8)
               if (.not. same_stencil) return
            end do
         end associate
      end do
   end function same_stencil

end subroutine find_stencils

!> Report the position of a singular moment matrix and a remedy
subroutine singular_error(order, least, source, x, ip, n, error)
   !> Order of the basis, and minimum number of neighbours that it needs
   integer, intent(in) :: order, least
   !> Source points, shape (nd, ns) [length]
   real(wp), intent(in) :: source(:, :)
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Index of the position
   integer, intent(in) :: ip
   !> Number of its neighbours
   integer, intent(in) :: n
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: cure
   character(len=1), parameter :: axes(3) = ['x', 'y', 'z']
   integer :: i, across

   cure = 'use a larger support; where that does not help, source points lie on a line or plane, ' &
      & //'or some of them coincide'
   do i = 1, size(x)
      across = planes(source(i, :))
      if (across == 1 .or. across > order) cycle
      cure = 'a basis of that order needs '//to_text(order + 1)//' source points ' &
         & //'across in each direction, along '//axes(i)//' there are '//to_text(across) &
         & //': use more of them, or order '//to_text(max(across - 1, 1))
      exit
   end do
   call fatal_error(error, err_input, 'point '//to_text(ip)//' at '//to_text(x) &
      & //': singular moment matrix with '//to_text(n)//' neighbours (order ' &
      & //to_text(order)//' needs at least '//to_text(least)//'); '//cure)
end subroutine singular_error

!> Number of different coordinates, up to the maximum that a basis may need
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
