!> Materials in parts of a box or an annulus, given by expressions in coordinates: labels of the
!> points, and fractions of the materials where a border cuts through the volume of a
!> point. In boxes with Gauss points borders may be planes across the axes and nothing else: these
!> are found, and the fractions are not wanted there.
module rk_deck_regions
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_deck_records, only : geometry_keys
   use rk_error, only : error_type
   use rk_kernel, only : window_polar
   use rk_lattice, only : lattice_frame, place_of
   use rk_precision, only : pi, wp
   use rk_scene, only : last_part, scene_type, tissue_type
   use rk_text, only : to_text
   implicit none
   private

   public :: label_regions
   public :: fine_bisections, most_planes, same_place, too_close

   !> Places in each direction at which the volume of a point is looked at where a border cuts it
   integer, parameter :: samples = 6
   !> Halvings of the way between two of them in the search for a border
   integer, parameter :: bisections = 12
   !> The same for planes, which are wanted to rounding; most of them across an axis
   integer, parameter :: fine_bisections = 40, most_planes = 8
   !> Spacings between two planes across an axis at least: a sheet of 0.04 between plates a hundred
   !> times as stiff was sheared four times too stiffly, and sheets of 1.5 spacings are right to 2 %
   real(wp), parameter :: least_gap = 1.5_wp
   !> Planes that differ by less, in spacings, are the same, as those beside points: borders of a
   !> map are known to a thousandth of a voxel, and thinner cells have no use [-]
   real(wp), parameter :: same_place = 2.0e-3_wp
   !> Points on a circle are by rounding on either side of it: all are taken so far beyond, of the
   !> radius [-]
   real(wp), parameter :: off_circle = 1.0e-12_wp

contains

!> Label each point by its material, of which later ones replace earlier ones
subroutine label_regions(scene, deck, error)
   !> Points of a box or an annulus, and materials with their parts
   type(scene_type), intent(inout) :: scene
   type(deck_type), intent(in) :: deck
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(inout) :: error
   logical :: close

   close = .false.
   associate (cloud => scene%cloud)
      call fill_points(cloud, scene%tissue, deck, error)
      if (allocated(error) .or. .not. allocated(cloud%fraction)) return
      if (scene%method == 'rkpm-gauss' .and. (.not. cloud%polar &
         & .or. scene%approximation%window == window_polar)) call find_planes(cloud, scene%tissue, &
         & scene%approximation%kink_axis, scene%approximation%kink, close, error)
      scene%thin_layers = close .and. cloud%nd == 3
   end associate
end subroutine label_regions

!> Label points, and find the fractions of their volumes
subroutine fill_points(cloud, tissue, deck, error)
   !> Points of a box or an annulus
   type(cloud_type), intent(inout) :: cloud
   !> Materials with their parts
   type(tissue_type), intent(in) :: tissue(:)
   type(deck_type), intent(in) :: deck
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(inout) :: error
   type(geometry_keys) :: body
   real(wp) :: part(size(tissue)), low(3), high(3), step(3)
   integer :: d, ip

   call body%read(deck, 'geometry')
   low = 0.0_wp
   high = body%size
   if (cloud%polar) then
      low(1) = body%inner_radius
      high(:2) = [body%outer_radius, 0.5_wp*pi]
   end if
   do d = 1, cloud%nd
      step(d) = (high(d) - low(d))/(body%collocation(d) - 1)
   end do
   if (allocated(cloud%fraction)) deallocate (cloud%fraction)
   allocate (cloud%fraction(size(tissue), size(cloud%points, 2)), source=0.0_wp)
   cloud%fraction_label = tissue%label
   do ip = 1, size(cloud%points, 2)
      call fill(ip)
      if (allocated(error)) return
   end do
   ! volumes of source points hold those of several points: borders between these are mixed as well
   if (all(cloud%label == cloud%label(1)) .and. all(maxval(cloud%fraction, dim=1) >= 1.0_wp)) &
      & deallocate (cloud%fraction, cloud%fraction_label)

contains

   !> Label and fractions of a point
   subroutine fill(ip)
      integer, intent(in) :: ip
      real(wp) :: from(3), to(3)
      integer :: own

      own = material_at(cloud%points(:, ip))
      cloud%label(ip) = tissue(own)%label
      call cell(cloud%points(:, ip), from, to)
      if (is_whole(from, to, own)) then
         part = 0.0_wp
         part(own) = 1.0_wp
      else
         call look(from, to)
      end if
      if (allocated(error)) return
      if (.not. part(own) > 0.0_wp) call deck%complain('material.'//to_text(own)//'.where', &
         & 'is thinner than can be seen at ' &
         & //to_text(cloud%points(:, ip))//': more points across it (geometry.source), or a ' &
         & //'thicker sheet with moduli in proportion', error)
      if (allocated(error)) return
      cloud%fraction(:, ip) = part/sum(part)
   end subroutine fill

   !> Volume of a point between lattice lines half way to its neighbours
   subroutine cell(x, from, to)
      real(wp), intent(in) :: x(:)
      real(wp), intent(out) :: from(3), to(3)
      real(wp) :: q(3)

      q = 0.0_wp
      q(:size(x)) = x
      if (cloud%polar) q(:2) = [norm2(x(:2)), atan2(x(2), x(1))]
      from = 0.0_wp
      to = 0.0_wp
      from(:cloud%nd) = max(q(:cloud%nd) - 0.5_wp*step(:cloud%nd), low(:cloud%nd))
      to(:cloud%nd) = min(q(:cloud%nd) + 0.5_wp*step(:cloud%nd), high(:cloud%nd))
   end subroutine cell

   !> Whether the corners of a volume, and the middles of its edges and faces, have the material of
   !> its point
   logical function is_whole(from, to, own)
      real(wp), intent(in) :: from(3), to(3)
      integer, intent(in) :: own
      integer :: i

      is_whole = .true.
      do i = 0, 3**cloud%nd - 1
         is_whole = material_in(from + 0.5_wp*mod(i/[1, 3, 9], 3)*(to - from)) == own
         if (.not. is_whole) return
      end do
   end function is_whole

   !> Parts of a volume that are seen at some places in each direction. Between places that differ
   !> along the direction with most such pairs the border is searched for: places alone would leave
   !> an interface unknown by a twelfth of the spacing
   subroutine look(from, to)
      real(wp), intent(in) :: from(3), to(3)
      integer :: seen(samples**cloud%nd), pairs(cloud%nd), d, i, next
      real(wp) :: moved

      part = 0.0_wp
      do i = 1, size(seen)
         seen(i) = material_in(place(from, to, i))
         if (allocated(error)) return
         part(seen(i)) = part(seen(i)) + weight(place(from, to, i))
      end do
      do d = 1, cloud%nd
         pairs(d) = count([(differ(seen, i, d), i=1, size(seen))])
      end do
      d = maxloc(pairs, dim=1)
      do i = 1, size(seen)
         if (.not. differ(seen, i, d)) cycle
         next = i + samples**(d - 1)
         moved = weight(place(from, to, i))*(border(place(from, to, i), place(from, to, next), &
            & seen(i)) - 0.5_wp)
         if (allocated(error)) return
         part(seen(i)) = part(seen(i)) + moved
         part(seen(next)) = part(seen(next)) - moved
      end do
   end subroutine look

   !> Whether a place and the next one in a direction differ
   pure logical function differ(seen, i, d)
      integer, intent(in) :: seen(:), i, d

      differ = mod((i - 1)/samples**(d - 1), samples) < samples - 1
      if (differ) differ = seen(i) /= seen(i + samples**(d - 1))
   end function differ

   !> Place of a number in a volume, in the coordinates of the lattice
   pure function place(from, to, i) result(q)
      real(wp), intent(in) :: from(3), to(3)
      integer, intent(in) :: i
      real(wp) :: q(3)
      integer :: d

      q = from
      do d = 1, cloud%nd
         q(d) = from(d) + (mod((i - 1)/samples**(d - 1), samples) + 0.5_wp)/samples &
            & *(to(d) - from(d))
      end do
   end function place

   !> Volume of a place beside that of others
   pure real(wp) function weight(q)
      real(wp), intent(in) :: q(3)

      weight = 1.0_wp
      if (cloud%polar) weight = q(1)
   end function weight

   !> Share of the way from one place to another at which the material of the former ends
   real(wp) function border(a, b, own)
      real(wp), intent(in) :: a(3), b(3)
      integer, intent(in) :: own
      real(wp) :: step
      integer :: k

      border = 0.0_wp
      step = 1.0_wp
      do k = 1, bisections
         step = 0.5_wp*step
         if (material_in(a + (border + step)*(b - a)) == own) border = border + step
         if (allocated(error)) return
      end do
      border = border + 0.5_wp*step
   end function border

   !> Material at a place in the coordinates of the lattice
   integer function material_in(q)
      real(wp), intent(in) :: q(3)

      if (cloud%polar) then
         material_in = material_at([q(1)*cos(q(2)), q(1)*sin(q(2)), q(3:cloud%nd)])
      else
         material_in = material_at(q(:cloud%nd))
      end if
   end function material_in

   !> Last material whose part of the body holds a place
   integer function material_at(x) result(found)
      real(wp), intent(in) :: x(:)

      found = last_part(tissue, x, error)
      if (found == 0 .and. .not. allocated(error)) call deck%complain('material.1.where', &
         & 'no material is given at '//to_text(x)//': leave `where` out of the first ' &
         & //'[[material]], which then fills the rest', error)
      found = max(found, 1)
   end function material_at

end subroutine fill_points

!> Planes across the axes of a box on which materials meet, or circles of an annulus, if these meet
!> nowhere else
subroutine find_planes(cloud, tissue, axis, plane, close, error)
   !> Points with fractions
   type(cloud_type), intent(in) :: cloud
   !> Materials with their parts
   type(tissue_type), intent(in) :: tissue(:)
   !> Axis across each plane, and its place, of a circle its radius [length]; not allocated where
   !> borders are not planes
   integer, allocatable, intent(out) :: axis(:)
   real(wp), allocatable, intent(out) :: plane(:)
   !> Borders are planes, but two of them too near each other
   logical, intent(out) :: close
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(inout) :: error
   real(wp), dimension(cloud%nd) :: near, wide
   !> Points in the coordinates of the lattice, shape (nd, nc) [length], of angles [radian]
   real(wp), allocatable :: point(:, :)
   real(wp) :: low(3), step(3)
   integer, allocatable :: own(:)
   integer :: base(3), counts(3), d, ip

   near = same_place*minval(cloud%spacing, dim=2)
   wide = maxval(cloud%spacing, dim=2)
   point = cloud%points
   if (cloud%polar) then
      call lattice_frame(cloud, low, step)
      wide = step(:cloud%nd)
      near = same_place*wide
      point = reshape([norm2(cloud%points, dim=1), atan2(cloud%points(2, :), cloud%points(1, :))], &
         & shape(point), order=[2, 1])
   end if
   counts = 1
   counts(:cloud%nd) = maxval(cloud%place, dim=2) + 1
   allocate (axis(0), plane(0))
   close = .false.
   do ip = 1, size(cloud%points, 2)
      do d = 1, cloud%nd
         associate (next => beside(ip, d, 1))
            call look_between(d, point(:, ip), point(:, next), &
               & all(maxval(cloud%fraction(:, [ip, next]), dim=1) >= 1.0_wp))
         end associate
         if (allocated(error)) return
         if (count(axis == d) > most_planes) exit
      end do
      if (d <= cloud%nd) exit
   end do
   if (ip > size(cloud%points, 2)) then
      ! each box between planes has one material
      base = 1
      base(:cloud%nd) = [(1 + count(axis == d), d=1, cloud%nd)]
      allocate (own(product(base)), source=0)
      do ip = 1, size(cloud%points, 2)
         if (.not. agrees(ip)) exit
         if (allocated(error)) return
      end do
   end if
   close = ip > size(cloud%points, 2) .and. too_close(axis, plane, wide)
   ! layers in the plane know the way across them; in space nothing better is at hand
   if (ip <= size(cloud%points, 2) .or. size(plane) == 0 .or. (close .and. cloud%nd == 2) &
      & .or. (cloud%polar .and. any(axis == 2))) deallocate (axis, plane)

contains

   !> Point beside another one along an axis, itself at the ends of the body
   pure integer function beside(ip, d, step)
      integer, intent(in) :: ip, d
      !> Forward or backward: 1 or -1
      integer, intent(in) :: step
      integer :: at(3)

      at = 0
      at(:cloud%nd) = cloud%place(:, ip)
      at(d) = min(max(at(d) + step, 0), counts(d) - 1)
      beside = place_of(at, counts)
   end function beside

   !> Material at a place in the coordinates of the lattice
   integer function part_at(q)
      real(wp), intent(in) :: q(:)

      if (cloud%polar) then
         part_at = last_part(tissue, (1.0_wp + off_circle)*q(1)*[cos(q(2)), sin(q(2))], error)
      else
         part_at = last_part(tissue, q, error)
      end if
   end function part_at

   !> Planes between two points that follow each other along an axis
   subroutine look_between(d, a, b, whole)
      integer, intent(in) :: d
      real(wp), intent(in) :: a(:), b(:)
      !> Their volumes have one material each
      logical, intent(in) :: whole
      real(wp) :: from(size(a)), to(size(a)), middle(size(a)), last(size(a))
      integer :: i, k, parts, before, after
      logical :: new

      parts = merge(1, samples, whole)
      from = a
      before = part_at(from)
      do k = 1, parts
         to = a + (b - a)*k/parts
         after = part_at(to)
         last = to
         new = after /= before
         if (new) new = .not. known(d, from, to, before, after)
         if (new) then
            do i = 1, fine_bisections
               middle = 0.5_wp*(from + to)
               if (part_at(middle) == before) then
                  from = middle
               else
                  to = middle
               end if
            end do
            if (allocated(error)) return
            ! a plane through points lies there to the last bit
            if (abs(to(d) - a(d)) < near(d)) to(d) = a(d)
            if (abs(to(d) - b(d)) < near(d)) to(d) = b(d)
            if (.not. any(axis == d .and. abs(plane - to(d)) < near(d))) then
               axis = [axis, d]
               plane = [plane, to(d)]
            end if
         end if
         before = after
         from = last
      end do
   end subroutine look_between

   !> Whether a plane that was found parts two places
   logical function known(d, a, b, before, after)
      integer, intent(in) :: d
      real(wp), intent(in) :: a(:), b(:)
      !> Their materials
      integer, intent(in) :: before, after
      real(wp) :: x(size(a))
      integer :: k

      known = .false.
      do k = 1, size(plane)
         if (axis(k) /= d .or. plane(k) < a(d) - near(d) .or. plane(k) > b(d) + near(d)) cycle
         x = a
         x(d) = plane(k) - near(d)
         known = part_at(x) == before
         x(d) = plane(k) + near(d)
         if (known) known = part_at(x) == after
         if (known) return
      end do
   end function known

   !> Whether all places of a point's volume have the material of their box between planes
   logical function agrees(ip)
      integer, intent(in) :: ip
      real(wp) :: from(cloud%nd), to(cloud%nd), x(cloud%nd)
      integer :: at, box(3), d, i, k, n

      agrees = .true.
      n = merge(1, samples, maxval(cloud%fraction(:, ip)) >= 1.0_wp)
      do d = 1, cloud%nd
         ! half way to the neighbours
         from(d) = 0.5_wp*(point(d, ip) + point(d, beside(ip, d, -1)))
         to(d) = 0.5_wp*(point(d, ip) + point(d, beside(ip, d, 1)))
      end do
      do i = 0, n**cloud%nd - 1
         box = 0
         do d = 1, cloud%nd
            x(d) = from(d) + (mod(i/n**(d - 1), n) + 0.5_wp)/n*(to(d) - from(d))
            box(d) = count(axis == d .and. plane < x(d))
            if (any(axis == d .and. abs(plane - x(d)) < near(d))) exit
         end do
         ! on a plane
         if (d <= cloud%nd) cycle
         at = place_of(box, base)
         k = part_at(x)
         if (own(at) == 0) own(at) = k
         agrees = agrees .and. own(at) == k
      end do
   end function agrees

end subroutine find_planes

!> Whether two planes leave fewer spacings between them than two kinks need: what lies between would
!> be as stiff as what lies around it
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

end module rk_deck_regions
