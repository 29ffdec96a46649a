!> Rows of voxels of a level set problem: the scheme of Appendix A and the sums behind the energy.
!>
!> A level set is positive inside (3.1). Its step is that of (3.21)-(3.23) with the curvature (3.3),
!> and with the misfits (3.43) that of (3.42) without its distance term.
!>
!> Level sets are stored in one padded array, so that a neighbour along either axis is at a fixed
!> offset. The signs of n level sets give 2**n combinations p; membership in one is the product over
!> the bits of p of H (bit set: inside) or 1 - H, equation (3.19) for any n. With fewer regions, the
!> last combinations belong to the regions that differ in the highest bit, as for three regions in
!> the reference.
!>
!> Reference: Li et al., IEEE Trans. Image Process. 20 (2011), doi:10.1109/TIP.2011.2146190, and
!> those of rk_levelset; equation numbers are those of the thesis named in the README.
module rk_levelset_rows
   use, intrinsic :: iso_fortran_env, only : real32
   use rk_precision, only : wp, pi
   implicit none
   private

   public :: grid_type, new_grid, advance_row, sum_row

   !> Voxels of a row that are included
   type :: row_type
      !> First and last index in the padded arrays; last < first for an empty row
      integer :: first, last
      !> Index in the padded arrays minus index in the image
      integer :: shift
   end type row_type

   !> Padded grid of a problem
   type :: grid_type
      !> Size of the padded arrays
      integer :: places
      !> Offset to the next voxel along each axis
      integer :: step(2)
      !> Voxel sizes [-]
      real(wp) :: spacing(2)
      !> Rows, shape (rows)
      type(row_type), allocatable :: rows(:)
      !> One for included voxels, zero for others, shape (places) [-]
      real(wp), allocatable :: part(:)
   end type grid_type

   !> Smallest gradient, which avoids a division by zero in flat regions [1/length]
   real(wp), parameter :: flat = 1.0e-4_wp
   !> Bounds of numbers whose roots are taken in single precision: their squares stay normal numbers
   real(wp), parameter :: least = 1.0e-30_wp, most = 1.0e30_wp

contains

!> Lay out the padded grid of a slice
subroutine new_grid(self, weight, spacing)
   type(grid_type), intent(out) :: self
   !> Weight of each voxel, zero if it is excluded, shape (columns, rows) [-]
   real(wp), intent(in) :: weight(:, :)
   !> Voxel sizes [-]
   real(wp), intent(in) :: spacing(2)
   integer :: i, j, n(2), place

   n = shape(weight)
   self%step = [1, n(1) + 2]
   self%places = product(n + 2)
   self%spacing = spacing
   allocate (self%rows(n(2)))
   allocate (self%part(self%places), source=0.0_wp)
   do j = 1, n(2)
      ! Index before the first voxel of the row
      place = 1 + j*self%step(2)
      self%rows(j) = row_type(place + n(1) + 1, place, place - n(1)*(j - 1))
      do i = 1, n(1)
         if (.not. weight(i, j) > 0.0_wp) cycle
         self%part(place + i) = 1.0_wp
         self%rows(j)%first = min(self%rows(j)%first, place + i)
         self%rows(j)%last = place + i
      end do
   end do
end subroutine new_grid

!> Step (A.1) of all level sets along a row
subroutine advance_row(grid, row, mu, nu, epsilon, dt, lambda, means, channels, weight, old, &
   inside, new)
   type(grid_type), intent(in) :: grid
   type(row_type), intent(in) :: row
   !> Weights of length, shape (level sets) [-]
   real(wp), intent(in) :: mu(:)
   !> Weight of area, width of the step function, time step [-]
   real(wp), intent(in) :: nu, epsilon, dt
   !> Weights of the misfits over the number of channels, shape (channels, 0:regions-1) [-]
   real(wp), intent(in) :: lambda(:, 0:)
   !> Mean values, shape (channels, 0:regions-1) [-]
   real(wp), intent(in) :: means(:, 0:)
   !> Values, shape (voxels, channels), and weights, shape (voxels) [-]
   real(wp), intent(in), contiguous :: channels(:, :), weight(:)
   !> Level sets before and their step functions, shape (places, level sets) [-]
   real(wp), intent(in), contiguous :: old(:, :), inside(:, :)
   !> Level sets after, same shape; only the row is written [-]
   real(wp), intent(inout), contiguous :: new(:, :)
   real(wp), dimension(row%first:row%last) :: force, pull, drawn
   ! One face more than voxels: the face behind a voxel is the one ahead of the voxel before
   real(wp) :: ahead(row%first - 1:row%last), behind(row%first - 1:row%last)
   real(wp) :: misfit(row%first:row%last, 0:size(lambda, 2) - 1), rate, scale
   ! Working space
   real(wp) :: tree(row%first:row%last, 0:2**size(old, 2) - 1)
   integer :: a, b, p, channel, level, axis, i, s, shift

   a = row%first
   b = row%last
   shift = row%shift
   do p = 0, size(lambda, 2) - 1
      misfit(:, p) = 0.0_wp
      do channel = 1, size(lambda, 1)
         do i = a, b
            misfit(i, p) = misfit(i, p) + &
               lambda(channel, p)*(channels(i - shift, channel) - means(channel, p))**2
         end do
      end do
      do i = a, b
         misfit(i, p) = weight(i - shift)*misfit(i, p)
      end do
   end do

   scale = dt*epsilon/pi
   do level = 1, size(old, 2)
      ! (B.1), (B.2): cost of the regions outside minus that of the regions inside
      call contract(a, b, inside, level, misfit, tree, force)
      force = force - nu*grid%part(a:b)

      pull = 0.0_wp
      drawn = 0.0_wp
      do axis = 1, size(grid%step)
         s = grid%step(axis)
         rate = mu(level)/grid%spacing(axis)**2
         if (axis == 1) then
            call faces(grid, axis, a - 1, b, old(:, level), ahead)
            behind(a:b) = ahead(a - 1:b - 1)
         else
            call faces(grid, axis, a, b, old(:, level), ahead(a:))
            call faces(grid, axis, a - s, b - s, old(:, level), behind(a:))
         end if
         do i = a, b
            pull(i) = pull(i) + rate*(ahead(i) + behind(i))
            drawn(i) = drawn(i) + rate*(ahead(i)*old(i + s, level) + behind(i)*old(i - s, level))
         end do
      end do
      ! (A.1) times 1/delta, which saves a division
      do i = a, b
         new(i, level) = old(i, level) + scale*(drawn(i) - pull(i)*old(i, level) + force(i))/ &
            (epsilon**2 + old(i, level)**2 + scale*pull(i))
      end do
   end do
end subroutine advance_row

!> Squared length of a gradient, averaged over both sides of a voxel along each axis
pure subroutine squared_slope(grid, a, b, values, square)
   type(grid_type), intent(in) :: grid
   integer, intent(in) :: a, b
   !> Values, shape (places) [-]
   real(wp), intent(in), contiguous :: values(:)
   !> Squares, shape (b - a + 1) [1/length^2]
   real(wp), intent(out) :: square(a:b)
   real(wp) :: rate, ahead, behind
   integer :: axis, i, s

   square = 0.0_wp
   do axis = 1, size(grid%step)
      s = grid%step(axis)
      rate = 0.5_wp/grid%spacing(axis)**2
      do i = a, b
         ahead = grid%part(i + s)*(values(i + s) - values(i))
         behind = grid%part(i - s)*(values(i) - values(i - s))
         square(i) = square(i) + rate*(ahead**2 + behind**2)
      end do
   end do
end subroutine squared_slope

!> Contribution of a row to the integrals of means and energy: areas and lengths (3.4)-(3.6)
subroutine sum_row(grid, row, mu, nu, regions, channels, weight, inside, sums)
   type(grid_type), intent(in) :: grid
   type(row_type), intent(in) :: row
   !> Weights of length, shape (level sets), and of area [-]
   real(wp), intent(in) :: mu(:), nu
   integer, intent(in) :: regions
   !> Values, shape (voxels, channels), and weights, shape (voxels) [-]
   real(wp), intent(in), contiguous :: channels(:, :), weight(:)
   !> Step functions of the level sets, shape (places, level sets) [-]
   real(wp), intent(in), contiguous :: inside(:, :)
   !> Energy of contours and areas; then for each region the integrals of its membership, and of
   !> membership times values and times squared values per channel; shape
   !> (1 + regions*(1 + 2*channels)) [-]
   real(wp), intent(out) :: sums(:)
   real(wp), dimension(row%first:row%last) :: part, slope
   real(wp) :: member(row%first:row%last, 0:2**size(inside, 2) - 1)
   integer :: a, b, p, r, channel, level, i, place, shift

   sums = 0.0_wp
   a = row%first
   b = row%last
   shift = row%shift
   do level = 1, size(inside, 2)
      ! Length as integral of |grad H|, (3.39): delta |grad phi| is the same, but delta is narrower
      ! than a voxel where the level set is steep, and its sum would depend on the grid
      call squared_slope(grid, a, b, inside(:, level), slope)
      call inverse_roots(slope, part)
      do i = a, b
         part(i) = mu(level)*slope(i)*part(i) + nu*inside(i, level)
      end do
      sums(1) = sums(1) + total(grid%part(a:b), part)
   end do

   call memberships(a, b, inside, member)
   do p = regions, 2**size(inside, 2) - 1
      r = region_of(p, regions)
      do i = a, b
         member(i, r) = member(i, r) + member(i, p)
      end do
   end do
   place = 1
   do r = 0, regions - 1
      do i = a, b
         part(i) = member(i, r)*weight(i - shift)
      end do
      sums(place + 1) = total(part, grid%part(a:b))
      associate (n => size(channels, 2))
         do channel = 1, n
            sums(place + 1 + channel) = total(part, channels(a - shift:b - shift, channel))
            sums(place + 1 + n + channel) = total(part, channels(a - shift:b - shift, channel)**2)
         end do
         place = place + 1 + 2*n
      end associate
   end do
end subroutine sum_row

!> Region of a combination of signs: its number, without the highest bit if there is no such region
pure integer function region_of(combination, regions)
   !> Number of the combination: bit k - 1 is set if it lies inside level set k
   integer, intent(in) :: combination
   !> Number of regions, more than half of the combinations
   integer, intent(in) :: regions
   integer :: highest

   region_of = combination
   if (combination < regions) return
   highest = bit_size(combination) - 1 - leadz(combination)
   region_of = ibclr(combination, highest)
end function region_of

!> Memberships in all combinations of signs, (3.19); each level set doubles their number
pure subroutine memberships(a, b, inside, member)
   integer, intent(in) :: a, b
   !> Step functions, shape (places, level sets) [-]
   real(wp), intent(in), contiguous :: inside(:, :)
   !> Products, shape (b - a + 1, 0:2**level sets - 1) [-]
   real(wp), intent(out) :: member(a:b, 0:2**size(inside, 2) - 1)
   integer :: level, p, i, known

   member(:, 0) = 1.0_wp
   do level = 1, size(inside, 2)
      known = 2**(level - 1)
      do p = 0, known - 1
         do i = a, b
            member(i, p + known) = member(i, p)*inside(i, level)
            member(i, p) = member(i, p) - member(i, p + known)
         end do
      end do
   end do
end subroutine memberships

!> Cost of the regions outside a level set minus that of the regions inside: the misfits are
!> averaged over the other level sets, each of which halves their number
pure subroutine contract(a, b, inside, level, misfit, tree, force)
   integer, intent(in) :: a, b
   real(wp), intent(in), contiguous :: inside(:, :)
   !> The level set
   integer, intent(in) :: level
   !> Misfits of the regions, shape (b - a + 1, 0:regions - 1) [-]
   real(wp), intent(in), contiguous :: misfit(a:, 0:)
   !> Working space, shape (b - a + 1, 0:2**level sets - 1) [-]
   real(wp), intent(inout) :: tree(a:b, 0:2**size(inside, 2) - 1)
   !> Difference, shape (b - a + 1) [-]
   real(wp), intent(out) :: force(a:b)
   integer :: other, p, i, from, bit, left

   do p = 0, 2**size(inside, 2) - 1
      tree(:, p) = misfit(:, region_of(p, size(misfit, 2)))
   end do
   ! From the highest bit down; bits above the eliminated one move down by one.
   left = size(inside, 2)
   do other = size(inside, 2), 1, -1
      if (other == level) cycle
      left = left - 1
      bit = 2**(other - 1)
      do p = 0, 2**left - 1
         from = modulo(p, bit) + 2*bit*(p/bit)
         do i = a, b
            tree(i, p) = tree(i, from) + inside(i, other)*(tree(i, from + bit) - tree(i, from))
         end do
      end do
   end do
   force = tree(:, 0) - tree(:, 1)
end subroutine contract

!> Inverse lengths of the gradient at faces by central differences (3.44), (A.2): A for the face
!> ahead of a voxel along the first axis, B for the same face seen from the voxel ahead; no flux to
!> voxels outside
pure subroutine faces(grid, axis, a, b, phi, inverse)
   type(grid_type), intent(in) :: grid
   !> Axis across the faces, and the first and last voxel before them
   integer, intent(in) :: axis, a, b
   !> Level set, shape (places) [-]
   real(wp), intent(in), contiguous :: phi(:)
   !> Inverse lengths, shape (b - a + 1) [length]
   real(wp), intent(out) :: inverse(a:b)
   real(wp) :: square(a:b), rate
   integer :: other, s, i

   s = grid%step(axis)
   rate = 1.0_wp/grid%spacing(axis)**2
   do i = a, b
      square(i) = flat**2 + rate*(phi(i + s) - phi(i))**2
   end do
   associate (takes => grid%part)
      do other = 1, size(grid%step)
         if (other == axis) cycle
         s = grid%step(other)
         rate = 0.25_wp/grid%spacing(other)**2
         do i = a, b
            square(i) = square(i) + rate*(takes(i + s)*(phi(i + s) - phi(i)) - &
               takes(i - s)*(phi(i - s) - phi(i)))**2
         end do
      end do
      call inverse_roots(square, inverse)
      s = grid%step(axis)
      do i = a, b
         inverse(i) = takes(i)*takes(i + s)*inverse(i)
      end do
   end associate
end subroutine faces

!> Inverse square roots of non-negative numbers, to about 1e-14: in single precision, which is
!> several times faster, followed by a Newton step in double precision
pure subroutine inverse_roots(numbers, roots)
   !> Numbers; values outside `least` to `most` are clipped [-]
   real(wp), intent(in), contiguous :: numbers(:)
   !> One over their square roots, same shape [-]
   real(wp), intent(out), contiguous :: roots(:)
   real(wp) :: number, root
   integer :: i

   do i = 1, size(numbers)
      number = min(max(numbers(i), least), most)
      root = 1.0_real32/sqrt(real(number, real32))
      roots(i) = root*(1.5_wp - 0.5_wp*number*root**2)
   end do
end subroutine inverse_roots

!> Sum of products, in an order that depends only on the length
pure real(wp) function total(left, right)
   !> Factors, equal shapes [-]
   real(wp), intent(in), contiguous :: left(:), right(:)
   integer, parameter :: lanes = 8
   integer :: i, first
   real(wp) :: lane(lanes)

   lane = 0.0_wp
   do first = 1, size(left) - lanes + 1, lanes
      do i = 1, lanes
         lane(i) = lane(i) + left(first + i - 1)*right(first + i - 1)
      end do
   end do
   do i = 1 + lanes*(size(left)/lanes), size(left)
      lane(1) = lane(1) + left(i)*right(i)
   end do
   total = sum(lane)
end function total

end module rk_levelset_rows
