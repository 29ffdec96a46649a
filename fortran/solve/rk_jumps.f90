!> Planes across the axes of a lattice, in an annulus circles, on which the materials of a body or
!> the coefficients of a linear problem change: there the derivatives of the solution have kinks,
!> which smooth functions miss by an error of order one.
module rk_jumps
   use rk_coefficients, only : coefficient_at
   use rk_error, only : error_type
   use rk_lattice, only : lattice_coordinates, lattice_frame, place_at
   use rk_precision, only : wp
   use rk_scene, only : last_part, scene_type
   implicit none
   private

   public :: find_jumps

   !> Smallest relevant jump, relative to the larger coefficient [-]
   real(wp), parameter :: least_jump = 1.0e-2_wp
   !> Lines of a cell in each direction across an axis, and places on them; the lines avoid its
   !> middle, since bodies are symmetric about it
   integer, parameter :: lines = 2, samples = 12
   real(wp), parameter :: off_middle = 0.382_wp
   !> Bisections between two places, which find a plane to rounding; largest number of planes across
   !> an axis
   integer, parameter :: bisections = 40, most_planes = 8
   !> Distance from a line, relative to that between lines, to which a plane extends on a side [-]
   real(wp), parameter :: beside = 0.3_wp
   !> Least spacings between two planes across an axis: a sheet of 0.04 between plates a hundred
   !> times as stiff was four times too stiff in shear, and sheets of 1.5 spacings are right to 2 %
   real(wp), parameter :: least_gap = 1.5_wp
   !> Planes that differ by less, in spacings, count as one, and so do planes and points: borders of
   !> a map are known to a thousandth of a voxel, and thinner cells have no use [-]
   real(wp), parameter :: same_place = 2.0e-3_wp
   !> Least thickness of a skin, in cells, for a kink of coefficients beneath it: with a source
   !> term in a box of 13 points a kink makes answers worse up to 0.5, and better from 0.8 on [-]
   real(wp), parameter :: least_skin = 0.5_wp

contains

!> Give the shape functions of a scene kinks where materials or coefficients jump across planes, or
!> record that they jump elsewhere
subroutine find_jumps(scene, error)
   !> Scene on a lattice, with the parts of its materials or the coefficients of a linear problem
   type(scene_type), intent(inout) :: scene
   !> Error handling: expressions without a value somewhere
   type(error_type), allocatable, intent(inout) :: error
   integer, allocatable :: axis(:)
   real(wp), allocatable :: plane(:), point(:, :)
   real(wp) :: low(3), step(3), from(scene%cloud%nd), high(scene%cloud%nd), width
   integer :: count_of(scene%cloud%nd), d, i, k, n, nd
   logical :: by_coefficients, elsewhere

   by_coefficients = allocated(scene%equation%problem)
   elsewhere = .false.
   nd = scene%cloud%nd
   call lattice_frame(scene%cloud, low, step)
   high = low(:nd) + step(:nd)*(scene%cloud%lattice - 1)
   point = scene%cloud%points
   do i = 1, size(point, 2)
      point(:, i) = lattice_coordinates(scene%cloud, point(:, i))
   end do
   allocate (axis(0), plane(0))
   do d = 1, nd
      count_of = lines*(scene%cloud%lattice - 1)
      count_of(d) = 1
      n = samples*(scene%cloud%lattice(d) - 1)
      width = step(d)*(scene%cloud%lattice(d) - 1)/n
      do i = 0, product(count_of) - 1
         from = line(i)
         do k = 1, n
            from(d) = low(d) + (k - 1)*width
            ! the end of a part equals the beginning of the next one to the last bit
            call look_between(from, low(d) + k*width)
            if (allocated(error)) return
            if (elsewhere) then
               scene%jumps = by_coefficients
               return
            end if
         end do
      end do
   end do
   if (size(plane) == 0) return
   scene%thin_layers = too_close(axis, plane, step)
   if (.not. by_coefficients .and. nd == 2 .and. scene%cloud%polar .and. any(axis == 2)) then
      scene%thin_layers = .false.
      return
   end if
   call move_alloc(axis, scene%approximation%kink_axis)
   call move_alloc(plane, scene%approximation%kink)

contains

   !> Where a line along the axis begins
   function line(number) result(x)
      integer, intent(in) :: number
      real(wp) :: x(nd)
      integer :: left, c

      left = number
      do c = 1, nd
         x(c) = low(c)
         if (c == d) cycle
         x(c) = low(c) + (mod(left, count_of(c)) + off_middle)*step(c)/lines
         left = left/count_of(c)
      end do
   end function line

   !> Look for a jump between two places on a line
   subroutine look_between(place, end)
      !> The first one
      real(wp), intent(in) :: place(:)
      !> Coordinate of the second one
      real(wp), intent(in) :: end
      real(wp) :: a, b, middle, before, after, off_surface, width
      integer :: round

      a = place(d)
      b = end
      if (.not. jump(place, a, b) > least_jump) return
      do round = 1, bisections
         middle = 0.5_wp*(a + b)
         before = jump(place, a, middle)
         after = jump(place, middle, b)
         if (allocated(error)) return
         ! a change that divides between the halves is not a jump
         if (.not. max(before, after) > least_jump) return
         if (before >= after) then
            b = middle
         else
            a = middle
         end if
      end do
      ! a plane through points passes through them to the last bit
      middle = point(d, minloc(abs(point(d, :) - b), dim=1))
      if (abs(b - middle) < same_place*step(d)) b = middle
      ! on the surface
      off_surface = min(b - low(d), high(d) - b)
      if (off_surface < same_place*step(d)) return
      width = least_skin*step(d)
      ! a skin is there a cell aside as well; a wedge at an edge is not
      if (by_coefficients .and. off_surface < width) scene%thin_layers = goes_on(place, &
         & max(low(d), b - width), min(high(d), b + width), 1.0_wp)
      width = same_place*step(d)
      elsewhere = scene%thin_layers .or. .not. goes_on(place, b - width, b + width, beside/lines)
      if (elsewhere .or. any(axis == d .and. abs(plane - b) < same_place*step(d))) return
      axis = [axis, d]
      plane = [plane, b]
      elsewhere = count(axis == d) > most_planes
   end subroutine look_between

   !> Largest difference of the coefficients between two places on a line, relative to the larger
   !> ones; one where they have different materials [-]
   real(wp) function jump(place, a, b)
      !> A place on the line
      real(wp), intent(in) :: place(:)
      !> Coordinates of the two
      real(wp), intent(in) :: a, b
      real(wp) :: x(nd), pair(2, 2)
      integer :: part(2)

      jump = 0.0_wp
      x = place
      x(d) = a
      if (by_coefficients) then
         call coefficient_at(scene%equation, x, pair(:, 1), error)
         x(d) = b
         call coefficient_at(scene%equation, x, pair(:, 2), error)
         if (.not. allocated(error)) jump = maxval(abs(pair(:, 2) - pair(:, 1)))/maxval(abs(pair))
         return
      end if
      part(1) = last_part(scene%tissue, place_at(scene%cloud, x), error)
      x(d) = b
      part(2) = last_part(scene%tissue, place_at(scene%cloud, x), error)
      if (part(1) /= part(2)) jump = 1.0_wp
   end function jump

   !> Whether the jump at a place is that of a plane: it extends to at least one side of the line
   logical function goes_on(place, from, to, aside)
      !> A place on the line, and the coordinates between which the jump lies
      real(wp), intent(in) :: place(:), from, to
      !> Distance from the line at which it is sought, in cells [-]
      real(wp), intent(in) :: aside
      real(wp) :: x(nd)
      integer :: c, side

      goes_on = .true.
      do c = 1, nd
         if (c == d) cycle
         goes_on = .false.
         do side = -1, 1, 2
            x = place
            x(c) = x(c) + side*aside*step(c)
            if (x(c) < low(c) .or. x(c) > high(c)) cycle
            goes_on = goes_on .or. jump(x, from, to) > least_jump
         end do
         if (.not. goes_on) return
      end do
   end function goes_on

end subroutine find_jumps

!> Whether two planes are closer than two kinks allow: the layer between them would be as stiff as
!> its surroundings
pure logical function too_close(axis, plane, spacing)
   !> Axis across each plane, and its place, shape (n) [length]
   integer, intent(in) :: axis(:)
   real(wp), intent(in) :: plane(:)
   !> Distance of source points along each axis, shape (nd) [length]
   real(wp), intent(in) :: spacing(:)
   integer :: i, k

   too_close = .false.
   do k = 2, size(plane)
      do i = 1, k - 1
         too_close = too_close .or. (axis(i) == axis(k) .and. abs(plane(i) - plane(k)) &
            & < least_gap*spacing(axis(k)))
      end do
   end do
end function too_close

end module rk_jumps
