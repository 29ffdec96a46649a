! Python boundary of the shape functions: plain arrays in, plain arrays out; kernel and window by
! their names in decks.

!> Neighbours and shape functions of every position in compressed rows: the number of neighbours of
!> each position, and as many rows as fit; if there are more, the caller must ask again
subroutine shape_values(order, kernel, window, nd, ns, np, nq, room, source, support, place, &
   & counts, stencils, neighbours, values, stat, message)
   use rk_error, only : error_type, pack_error
   use rk_shape, only : approximation_type, new_approximation, new_shape, shape_type
   implicit none
   !f2py threadsafe
   character(len=*), intent(in) :: kernel, window
   integer, intent(in) :: order, nd, ns, np, nq, room
   double precision, intent(in) :: source(nd, ns), support(nd, ns), place(nd, np)
   integer, intent(out) :: counts(np), stencils, neighbours(room), stat
   double precision, intent(out) :: values(nq, room)
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(approximation_type) :: choice
   type(shape_type), target :: shape
   double precision, pointer, contiguous :: row(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer :: ip, k

   counts = 0
   stencils = 0
   call new_approximation(choice, order, kernel, window, error)
   if (.not. allocated(error)) call new_shape(shape, choice, source, support, place, error)
   call pack_error(error, stat, message)
   if (stat /= 0) return
   stencils = maxval(shape%stencil)
   k = 0
   do ip = 1, np
      call shape%row(ip, nodes, row)
      counts(ip) = size(nodes)
      if (k + counts(ip) <= room) then
         neighbours(k + 1:k + counts(ip)) = nodes - 1
         values(:, k + 1:k + counts(ip)) = row
      end if
      k = k + counts(ip)
   end do
end subroutine shape_values
