!> Planes on which the coefficients of a linear problem jump, such as the walls of layers: there the
!> derivatives of the solution have kinks, which smooth functions miss by an error of order one.
module rk_jumps
   use rk_coefficients, only : coefficient_at
   use rk_deck_regions, only : fine_bisections, most_planes, same_place, too_close
   use rk_error, only : error_type
   use rk_lattice, only : lattice_frame
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   implicit none
   private

   public :: find_jumps

   !> Jump that counts, of the larger coefficient [-]
   real(wp), parameter :: least_jump = 1.0e-2_wp
   !> Lines of a cell in each direction across an axis, and places on them; the lines lie off its
   !> middle, since bodies are symmetric about that
   integer, parameter :: lines = 2, samples(2:3) = [8, 4]
   real(wp), parameter :: off_middle = 0.382_wp
   !> Distance from a line, of that between two, in which a plane goes on to one side at least [-]
   real(wp), parameter :: beside = 0.3_wp
   !> Thickness of a skin, in cells, that a kink beneath it needs: with a source term in a box of 13
   !> points a kink makes answers worse up to 0.5, and better from 0.8 on [-]
   real(wp), parameter :: least_skin = 0.5_wp

contains

!> Give the shape functions of a linear problem kinks where its coefficients jump across planes, or
!> note that they jump elsewhere
subroutine find_jumps(scene, error)
   !> Scene of a linear problem on a lattice
   type(scene_type), intent(inout) :: scene
   !> Error handling: coefficients without a value somewhere
   type(error_type), allocatable, intent(inout) :: error
   integer, allocatable :: axis(:)
   real(wp), allocatable :: plane(:)
   real(wp) :: low(3), step(3), from(scene%cloud%nd), width
   integer :: count_of(scene%cloud%nd), d, i, k, n, nd

   if (.not. scene%equation%varies() .or. .not. allocated(scene%cloud%lattice)) return
   nd = scene%cloud%nd
   call lattice_frame(scene%cloud, low, step)
   allocate (axis(0), plane(0))
   do d = 1, nd
      count_of = lines*(scene%cloud%lattice - 1)
      count_of(d) = 1
      n = samples(max(nd, 2))*(scene%cloud%lattice(d) - 1)
      width = step(d)*(scene%cloud%lattice(d) - 1)/n
      do i = 0, product(count_of) - 1
         from = line(i)
         do k = 1, n
            from(d) = low(d) + (k - 1)*width
            call look_between(from, width)
            if (allocated(error)) return
            if (scene%jumps) return
         end do
      end do
   end do
   if (size(plane) == 0) return
   scene%thin_layers = too_close(axis, plane, step)
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
   subroutine look_between(place, width)
      real(wp), intent(in) :: place(:), width
      real(wp) :: a, b, middle, before, after, off_surface
      integer :: round

      a = place(d)
      b = a + width
      if (.not. jump(place, a, b) > least_jump) return
      do round = 1, fine_bisections
         middle = 0.5_wp*(a + b)
         before = jump(place, a, middle)
         after = jump(place, middle, b)
         if (allocated(error)) return
         ! a change that parts share is no jump
         if (.not. max(before, after) > least_jump) return
         if (before >= after) then
            b = middle
         else
            a = middle
         end if
      end do
      ! a plane through points or half way between them lies there to the last bit
      middle = low(d) + 0.5_wp*step(d)*nint((b - low(d))/(0.5_wp*step(d)))
      if (abs(b - middle) < same_place*step(d)) b = middle
      ! on the surface
      off_surface = min(b - low(d), low(d) + step(d)*(scene%cloud%lattice(d) - 1) - b)
      if (off_surface < same_place*step(d)) return
      ! a skin thinner than half a cell has no room for a kink
      scene%thin_layers = off_surface < least_skin*step(d)
      scene%jumps = scene%thin_layers .or. .not. goes_on(place, b)
      if (scene%jumps .or. any(axis == d .and. abs(plane - b) < same_place*step(d))) return
      axis = [axis, d]
      plane = [plane, b]
      scene%jumps = count(axis == d) > most_planes
   end subroutine look_between

   !> Largest difference of the coefficients between two places on a line, of the larger ones [-]
   real(wp) function jump(place, a, b)
      !> A place on the line
      real(wp), intent(in) :: place(:)
      !> Coordinates of the two
      real(wp), intent(in) :: a, b
      real(wp) :: x(nd), pair(2, 2)

      jump = 0.0_wp
      x = place
      x(d) = a
      call coefficient_at(scene%equation, x, pair(:, 1), error)
      x(d) = b
      call coefficient_at(scene%equation, x, pair(:, 2), error)
      if (.not. allocated(error)) jump = maxval(abs(pair(:, 2) - pair(:, 1))) &
         & /maxval(abs(pair))
   end function jump

   !> Whether the jump at a place is one of a plane: it goes on to one side of the line at least
   logical function goes_on(place, at)
      real(wp), intent(in) :: place(:), at
      real(wp) :: x(nd), near
      integer :: c, side

      goes_on = .true.
      near = same_place*step(d)
      do c = 1, nd
         if (c == d) cycle
         goes_on = .false.
         do side = -1, 1, 2
            x = place
            x(c) = x(c) + side*beside*step(c)/lines
            goes_on = goes_on .or. jump(x, at - near, at + near) > least_jump
         end do
         if (.not. goes_on) return
      end do
   end function goes_on

end subroutine find_jumps

end module rk_jumps
