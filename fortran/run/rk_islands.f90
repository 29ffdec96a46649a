!> Parts of a body that nothing holds: supports do not reach across, so each part needs prescribed
!> displacements of its own.
module rk_islands
   use rk_error, only : error_type, fatal_error, err_input
   use rk_precision, only : i8, wp
   use rk_shape, only : shape_type
   use rk_text, only : to_text
   implicit none
   private

   public :: check_islands

contains

!> Refuse a body with a part where no displacement is prescribed
subroutine check_islands(shape, place, held, error)
   !> Shape functions; places beyond those given are ignored
   type(shape_type), intent(in) :: shape
   !> Collocation points, shape (nd, nc) [length]
   real(wp), intent(in) :: place(:, :)
   !> Whether a displacement is prescribed at a point, shape (nc)
   logical, intent(in) :: held(:)
   !> Error handling: names the part
   type(error_type), allocatable, intent(out) :: error
   integer, allocatable :: part(:)
   logical, allocatable :: fixed(:)
   integer :: ip, first, count
   integer(i8) :: k

   allocate (part(shape%ns), source=[(ip, ip=1, shape%ns)])
   allocate (fixed(shape%ns), source=.false.)
   ! source points that cover one collocation point belong together
   do ip = 1, size(held)
      first = part_of(part, node(ip, 1_i8))
      do k = 2, shape%count(ip)
         part(part_of(part, node(ip, k))) = first
      end do
   end do
   do ip = 1, size(held)
      if (held(ip)) fixed(part_of(part, node(ip, 1_i8))) = .true.
   end do
   do ip = 1, size(held)
      first = part_of(part, node(ip, 1_i8))
      if (fixed(first)) cycle
      count = 0
      do k = 1, size(held)
         if (part_of(part, node(int(k), 1_i8)) == first) count = count + 1
      end do
      call fatal_error(error, err_input, 'no displacement is prescribed on ' &
         & //trim(merge('the body:  ', 'an island: ', count == size(held)))//' '//to_text(count) &
         & //' collocation points around '//to_text(place(:, ip))//' can move freely; hold them ' &
         & //'by a boundary set or leave them out of the model')
      return
   end do

contains

   !> Source point number k of a place
   integer function node(ip, k)
      integer, intent(in) :: ip
      integer(i8), intent(in) :: k

      node = shape%neighbour%index(shape%neighbour%offset(ip) + k)
   end function node

end subroutine check_islands

!> Representative of a source point's part; paths are halved on the way
integer function part_of(part, is)
   !> Next member towards the representative, shape (ns)
   integer, intent(inout) :: part(:)
   !> Source point
   integer, intent(in) :: is

   part_of = is
   do while (part(part_of) /= part_of)
      part(part_of) = part(part(part_of))
      part_of = part(part_of)
   end do
end function part_of

end module rk_islands
