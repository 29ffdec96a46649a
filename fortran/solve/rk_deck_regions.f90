!> Materials in parts of a box or an annulus, given by expressions in coordinates: labels of the
!> points, and fractions of the materials where a border cuts through the volume of a
!> point. In boxes with Gauss points borders may only be planes across the axes: these are
!> found, and the fractions are not needed there.
module rk_deck_regions
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_error, only : error_type
   use rk_jumps, only : find_jumps
   use rk_kernel, only : window_polar
   use rk_lattice, only : lattice_coordinates, lattice_frame, place_at
   use rk_precision, only : wp
   use rk_scene, only : last_part, scene_type, tissue_type
   use rk_text, only : to_text
   implicit none
   private

   public :: label_regions

   !> Number of sampling places in each direction of the volume of a point where a border cuts it
   integer, parameter :: samples = 6
   !> Halvings of the way between two of them in the search for a border
   integer, parameter :: bisections = 12

contains

!> Label each point by its material; later materials replace earlier ones
subroutine label_regions(scene, deck, error)
   !> Points of a box or an annulus, and materials with their parts
   type(scene_type), intent(inout) :: scene
   type(deck_type), intent(in) :: deck
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(inout) :: error

   associate (cloud => scene%cloud)
      call fill_points(cloud, scene%tissue, deck, error)
      if (allocated(error) .or. .not. allocated(cloud%fraction)) return
      if (scene%method == 'rkpm-gauss' .and. (.not. cloud%polar &
         & .or. scene%approximation%window == window_polar)) call find_jumps(scene, error)
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
   real(wp) :: part(size(tissue)), low(3), high(3), step(3)
   integer :: ip

   call lattice_frame(cloud, low, step)
   high(:cloud%nd) = low(:cloud%nd) + step(:cloud%nd)*(cloud%lattice - 1)
   ! spacing of the collocation points
   step(:cloud%nd) = (high(:cloud%nd) - low(:cloud%nd))/maxval(cloud%place, dim=2)
   if (allocated(cloud%fraction)) deallocate (cloud%fraction)
   allocate (cloud%fraction(size(tissue), size(cloud%points, 2)), source=0.0_wp)
   cloud%fraction_label = tissue%label
   do ip = 1, size(cloud%points, 2)
      call fill(ip)
      if (allocated(error)) return
   end do
   ! volumes of source points contain those of several points: borders between these are mixed too
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
      q(:size(x)) = lattice_coordinates(cloud, x)
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

   !> Parts of a volume sampled at some places in each direction. Between places that differ along
   !> the direction with most such pairs the border is located by bisection: places alone would
   !> leave an interface uncertain by a twelfth of the spacing
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

   !> Volume of a place relative to that of others
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

      material_in = material_at(place_at(cloud, q(:cloud%nd)))
   end function material_in

   !> Last material whose part of the body contains a place
   integer function material_at(x) result(found)
      real(wp), intent(in) :: x(:)

      found = last_part(tissue, x, error)
      if (found == 0 .and. .not. allocated(error)) call deck%complain('material.1.where', &
         & 'no material is given at '//to_text(x)//': leave `where` out of the first ' &
         & //'[[material]], which then fills the rest', error)
      found = max(found, 1)
   end function material_at

end subroutine fill_points

end module rk_deck_regions
