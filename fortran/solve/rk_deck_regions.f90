!> Materials in parts of a box or an annulus, given by expressions in coordinates or by a label map:
!> labels of the points, and fractions of the materials where a border cuts through the volume of a
!> point.
module rk_deck_regions
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_deck_labels, only : read_labels
   use rk_deck_records, only : geometry_keys
   use rk_error, only : error_type
   use rk_precision, only : pi, wp
   use rk_scene, only : tissue_type
   use rk_text, only : to_text
   implicit none
   private

   public :: has_regions, label_regions, read_parts

   !> Places in each direction at which the volume of a point is looked at where a border cuts it
   integer, parameter :: samples = 6

contains

!> Whether the deck gives parts of the body by expressions or a label map
logical function has_regions(deck)
   type(deck_type), intent(in) :: deck
   integer :: k

   has_regions = deck%has('geometry.labels')
   do k = 1, deck%count('material')
      has_regions = has_regions .or. deck%has('material.'//to_text(k)//'.where')
   end do
end function has_regions

!> Which part of the body each material may fill, and its label: that of the label map where all
!> have one, its number otherwise
subroutine read_parts(tissue, deck, error)
   !> Materials in the order of the deck
   type(tissue_type), intent(inout) :: tissue(:)
   type(deck_type), intent(in) :: deck
   !> Error handling: what is wrong with the label map
   type(error_type), allocatable, intent(inout) :: error
   integer :: k

   do k = 1, size(tissue)
      tissue(k)%label = k
      call deck%get('material.'//to_text(k)//'.where', tissue(k)%part)
   end do
   if (deck%has('geometry.labels')) call read_labels(tissue, deck, error)
end subroutine read_parts

!> Label each point by its material, of which later ones replace earlier ones
subroutine label_regions(cloud, tissue, deck, error)
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
   ! borders between the volumes of points leave nothing to mix
   if (all(maxval(cloud%fraction, dim=1) >= 1.0_wp)) deallocate (cloud%fraction, &
      & cloud%fraction_label)

contains

   !> Label and fractions of a point
   subroutine fill(ip)
      integer, intent(in) :: ip
      real(wp) :: from(3), to(3)
      integer :: own

      own = material_at(cloud%points(:, ip))
      cloud%label(ip) = tissue(own)%label
      call cell(cloud%points(:, ip), from, to)
      part = 0.0_wp
      call look(from, to, 2)
      if (count(part > 0.0_wp) > 1 .or. part(own) <= 0.0_wp) then
         part = 0.0_wp
         call look(from, to, samples)
      end if
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

   !> Add the parts that are seen at so many places in each direction
   subroutine look(from, to, n)
      real(wp), intent(in) :: from(3), to(3)
      integer, intent(in) :: n
      real(wp) :: q(3), weight
      integer :: digit(3), e, i, rest

      do i = 0, n**cloud%nd - 1
         rest = i
         do e = 1, 3
            digit(e) = mod(rest, n)
            rest = rest/n
         end do
         q = from + (digit + 0.5_wp)/n*(to - from)
         weight = 1.0_wp
         if (cloud%polar) then
            weight = q(1)
            q(:2) = q(1)*[cos(q(2)), sin(q(2))]
         end if
         associate (k => material_at(q(:cloud%nd)))
            if (k > 0) part(k) = part(k) + weight
         end associate
      end do
   end subroutine look

   !> Last material whose part of the body holds a place
   integer function material_at(x) result(found)
      real(wp), intent(in) :: x(:)
      real(wp) :: value

      do found = size(tissue), 1, -1
         if (.not. tissue(found)%part%given()) return
         call tissue(found)%part%at(x, value, error)
         if (allocated(error)) exit
         if (abs(value) > 0.0_wp) return
      end do
      found = max(found, 0)
      if (found == 0 .and. .not. allocated(error)) call deck%complain('material.1.where', &
         & 'no material is given at '//to_text(x)//': leave `where` out of the first ' &
         & //'[[material]], which then fills the rest', error)
      found = max(found, 1)
   end function material_at

end subroutine label_regions

end module rk_deck_regions
