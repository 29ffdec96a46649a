!> Rows of voxels of a level set problem: the scheme of Appendix A and the sums behind the energy.
!>
!> Level sets lie in one padded array, so that a neighbour along any axis is a fixed step away:
!> the same lines serve two and three dimensions. Signs of n level sets make 2**n combinations p;
!> membership in one is the product over the bits of p of H (bit set: inside) or 1 - H, equation
!> (3.19) for any n. Where fewer regions are wanted, the last combinations belong to the regions
!> that differ in the highest bit, as for three regions in reference 3.
!>
!> References: 1. Chan, Vese, IEEE Trans. Image Process. 10 (2001), doi:10.1109/83.902291;
!> 2. Vese, Chan, Int. J. Comput. Vis. 50 (2002), doi:10.1023/A:1020874308076;
!> 3. Li et al., IEEE Trans. Image Process. 20 (2011), doi:10.1109/TIP.2011.2146190;
!> equation numbers are those of the thesis named in the README.
module rk_levelset_rows
   use rk_precision, only : wp, pi
   implicit none
   private

   public :: grid_type, row_type, new_grid, advance_row, step_row, sum_row, sums_of_row

   !> Voxels of a row that take part
   type :: row_type
      !> First and last place in the padded arrays; last < first for an empty row
      integer :: first, last
      !> Place in the padded arrays less place in the image
      integer :: shift
   end type row_type

   !> Padded grid of a problem
   type :: grid_type
      !> Axes along which there are neighbours, 2 or 3
      integer :: axes
      !> Places in the padded arrays
      integer :: places
      !> Steps to the next voxel along each axis, shape (3)
      integer :: step(3)
      !> Voxel sizes, shape (3) [-]
      real(wp) :: spacing(3)
      !> Rows, shape (rows)
      type(row_type), allocatable :: rows(:)
      !> One for voxels that take part, zero for others, shape (places) [-]
      real(wp), allocatable :: part(:)
   end type grid_type

   !> Smallest gradient that counts: keeps flat places from dividing by zero [1/length]
   real(wp), parameter :: flat = 1.0e-4_wp

contains

!> Lay out the padded grid of an image
subroutine new_grid(self, weight, spacing)
   !> Grid
   type(grid_type), intent(out) :: self
   !> Weight of each voxel, zero where it takes no part, shape (columns, rows, slices) [-]
   real(wp), intent(in) :: weight(:, :, :)
   !> Voxel sizes, shape (3) [-]
   real(wp), intent(in) :: spacing(3)
   integer :: i, j, k, n(3), pad(3), row, place

   n = shape(weight)
   self%axes = merge(3, 2, n(3) > 1)
   pad = [1, 1, self%axes - 2]
   self%step = [1, n(1) + 2, (n(1) + 2)*(n(2) + 2)]
   self%places = product(n + 2*pad)
   self%spacing = spacing
   allocate (self%rows(n(2)*n(3)))
   allocate (self%part(self%places), source=0.0_wp)
   do k = 1, n(3)
      do j = 1, n(2)
         row = j + n(2)*(k - 1)
         ! Place of the voxel before the first of the row
         place = 1 + j*self%step(2) + (k - 1 + pad(3))*self%step(3)
         self%rows(row) = row_type(place + n(1) + 1, place, place - n(1)*(row - 1))
         do i = 1, n(1)
            if (.not. weight(i, j, k) > 0.0_wp) cycle
            self%part(place + i) = 1.0_wp
            self%rows(row)%first = min(self%rows(row)%first, place + i)
            self%rows(row)%last = place + i
         end do
      end do
   end do
end subroutine new_grid

!> Step (A.1) of all level sets along a row
subroutine advance_row(grid, row, mu, nu, epsilon, dt, lambda, share, means, channels, weight, &
   old, inside, new)
   !> Grid
   type(grid_type), intent(in) :: grid
   !> Row
   type(row_type), intent(in) :: row
   !> Weights of length and area, width of the step function, time step [-]
   real(wp), intent(in) :: mu, nu, epsilon, dt
   !> Weights of the regions' misfits, shape (0:regions-1) [-]
   real(wp), intent(in) :: lambda(0:)
   !> Weights of the channels over their number, shape (channels) [-]
   real(wp), intent(in) :: share(:)
   !> Mean values, shape (channels, 0:regions-1) [-]
   real(wp), intent(in) :: means(:, 0:)
   !> Values, shape (voxels, channels), and weights, shape (voxels) [-]
   real(wp), intent(in) :: channels(:, :), weight(:)
   !> Level sets before and their step functions, shape (places, level sets) [-]
   real(wp), intent(in) :: old(:, :), inside(:, :)
   !> Level sets after, same shape; only the row is written [-]
   real(wp), intent(inout) :: new(:, :)
   real(wp), dimension(row%last - row%first + 1) :: force, pull, drawn, ahead, behind, delta
   real(wp) :: misfit(row%last - row%first + 1, 0:size(lambda) - 1), rate
   integer :: a, b, p, channel, level, axis, x, y, s

   a = row%first
   b = row%last
   x = a - row%shift
   y = b - row%shift
   do p = 0, size(lambda) - 1
      misfit(:, p) = 0.0_wp
      do channel = 1, size(share)
         misfit(:, p) = misfit(:, p) + &
            share(channel)*(channels(x:y, channel) - means(channel, p))**2
      end do
      misfit(:, p) = lambda(p)*weight(x:y)*misfit(:, p)
   end do

   do level = 1, size(old, 2)
      ! (B.1), (B.2): what the regions outside cost more than those inside
      force = -nu*grid%part(a:b)
      do p = 0, 2**size(old, 2) - 1
         call membership(p, inside(a:b, :), level, delta)
         if (btest(p, level - 1)) then
            force = force - misfit(:, region_of(p, size(lambda)))*delta
         else
            force = force + misfit(:, region_of(p, size(lambda)))*delta
         end if
      end do

      delta = dt*epsilon/(pi*(epsilon**2 + old(a:b, level)**2))
      pull = 0.0_wp
      drawn = 0.0_wp
      do axis = 1, grid%axes
         s = grid%step(axis)
         rate = mu/grid%spacing(axis)**2
         call faces(grid, axis, a, b, old(:, level), ahead)
         call faces(grid, axis, a - s, b - s, old(:, level), behind)
         pull = pull + rate*(ahead + behind)
         drawn = drawn + rate*(ahead*old(a + s:b + s, level) + behind*old(a - s:b - s, level))
      end do
      new(a:b, level) = (old(a:b, level) + delta*(drawn + force))/(1.0_wp + delta*pull)
   end do
end subroutine advance_row

!> Number of sums that `sum_row` makes
pure integer function sums_of_row(regions, channels)
   !> Numbers of regions and channels
   integer, intent(in) :: regions, channels

   sums_of_row = 1 + regions*(2 + channels)
end function sums_of_row

!> Step functions along a row, (3.16)
subroutine step_row(row, epsilon, phi, inside)
   !> Row
   type(row_type), intent(in) :: row
   !> Width of the step function [-]
   real(wp), intent(in) :: epsilon
   !> Level sets, shape (places, level sets) [-]
   real(wp), intent(in) :: phi(:, :)
   !> Step functions, same shape; only the row is written [-]
   real(wp), intent(inout) :: inside(:, :)

   inside(row%first:row%last, :) = 0.5_wp + atan(phi(row%first:row%last, :)/epsilon)/pi
end subroutine step_row

!> A row's part of the integrals behind means and energy
subroutine sum_row(grid, row, mu, nu, regions, share, channels, weight, inside, sums)
   !> Grid
   type(grid_type), intent(in) :: grid
   !> Row
   type(row_type), intent(in) :: row
   !> Weights of length and area [-]
   real(wp), intent(in) :: mu, nu
   !> Number of regions
   integer, intent(in) :: regions
   !> Weights of the channels over their number, shape (channels) [-]
   real(wp), intent(in) :: share(:)
   !> Values, shape (voxels, channels), and weights, shape (voxels) [-]
   real(wp), intent(in) :: channels(:, :), weight(:)
   !> Step functions of the level sets, shape (places, level sets) [-]
   real(wp), intent(in) :: inside(:, :)
   !> Energy of contours and areas; then for each region the integrals of its membership, of
   !> membership times squared values, and of membership times values per channel;
   !> shape (sums_of_row) [-]
   real(wp), intent(out) :: sums(:)
   real(wp), dimension(row%last - row%first + 1) :: square, part, slope, ahead, behind
   real(wp) :: member(row%last - row%first + 1, 0:regions - 1)
   integer :: a, b, p, channel, level, axis, x, y, place, s

   sums = 0.0_wp
   a = row%first
   b = row%last
   x = a - row%shift
   y = b - row%shift
   do level = 1, size(inside, 2)
      ! Length as integral of |grad H|, (3.39): delta |grad phi| is the same, but delta is narrower
      ! than a voxel where the level set is steep, and its sum would depend on the grid
      slope = 0.0_wp
      do axis = 1, grid%axes
         s = grid%step(axis)
         ahead = grid%part(a + s:b + s)*(inside(a + s:b + s, level) - inside(a:b, level))
         behind = grid%part(a - s:b - s)*(inside(a:b, level) - inside(a - s:b - s, level))
         slope = slope + 0.5_wp*(ahead**2 + behind**2)/grid%spacing(axis)**2
      end do
      sums(1) = sums(1) + total(grid%part(a:b), mu*sqrt(slope) + nu*inside(a:b, level))
   end do

   square = 0.0_wp
   do channel = 1, size(share)
      square = square + share(channel)*channels(x:y, channel)**2
   end do
   member = 0.0_wp
   do p = 0, 2**size(inside, 2) - 1
      call membership(p, inside(a:b, :), 0, part)
      member(:, region_of(p, regions)) = member(:, region_of(p, regions)) + part
   end do
   place = 1
   do p = 0, regions - 1
      part = member(:, p)*weight(x:y)
      sums(place + 1) = total(part, grid%part(a:b))
      sums(place + 2) = total(part, square)
      do channel = 1, size(share)
         sums(place + 2 + channel) = total(part, channels(x:y, channel))
      end do
      place = place + 2 + size(share)
   end do
end subroutine sum_row

!> Region of a combination of signs: its number, less the highest bit where there is no such region
pure integer function region_of(combination, regions)
   !> Number of the combination: bit k - 1 tells whether it lies inside of level set k
   integer, intent(in) :: combination
   !> Number of regions, more than half of the combinations
   integer, intent(in) :: regions
   integer :: highest

   region_of = combination
   if (combination < regions) return
   highest = bit_size(combination) - 1 - leadz(combination)
   region_of = ibclr(combination, highest)
end function region_of

!> Membership in a combination of signs, or its derivative without the sign
pure subroutine membership(combination, inside, without, part)
   !> Number of the combination: bit k - 1 tells whether it lies inside of level set k
   integer, intent(in) :: combination
   !> Step functions, shape (voxels, level sets) [-]
   real(wp), intent(in) :: inside(:, :)
   !> Level set whose factor is left out; zero for none
   integer, intent(in) :: without
   !> Product, shape (voxels) [-]
   real(wp), intent(out) :: part(:)
   integer :: level

   part = 1.0_wp
   do level = 1, size(inside, 2)
      if (level == without) cycle
      if (btest(combination, level - 1)) then
         part = part*inside(:, level)
      else
         part = part*(1.0_wp - inside(:, level))
      end if
   end do
end subroutine membership

!> Inverse lengths of the gradient at faces, (A.2): A for the face ahead of a voxel along the
!> first axis, B for the same face seen from the voxel ahead; no flux to voxels outside
pure subroutine faces(grid, axis, a, b, phi, inverse)
   !> Grid
   type(grid_type), intent(in) :: grid
   !> Axis across the faces, and the first and last voxel before them
   integer, intent(in) :: axis, a, b
   !> Level set, shape (places) [-]
   real(wp), intent(in) :: phi(:)
   !> Inverse lengths, shape (b - a + 1) [length]
   real(wp), intent(out) :: inverse(:)
   integer :: other, s

   s = grid%step(axis)
   inverse = flat**2 + ((phi(a + s:b + s) - phi(a:b))/grid%spacing(axis))**2
   do other = 1, grid%axes
      if (other == axis) cycle
      s = grid%step(other)
      inverse = inverse + ((grid%part(a + s:b + s)*(phi(a + s:b + s) - phi(a:b)) - &
         grid%part(a - s:b - s)*(phi(a - s:b - s) - phi(a:b)))/(2.0_wp*grid%spacing(other)))**2
   end do
   s = grid%step(axis)
   inverse = grid%part(a:b)*grid%part(a + s:b + s)/sqrt(inverse)
end subroutine faces

!> Sum of products, in an order that depends on nothing but the length
pure real(wp) function total(left, right)
   !> Factors, equal shapes [-]
   real(wp), intent(in) :: left(:), right(:)
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
