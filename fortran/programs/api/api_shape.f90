! Python boundary of the shape functions: plain arrays in, plain arrays out; kernel and window by
! the names they have in decks.

!> Number of neighbours of every place
subroutine shape_count(order, kernel, window, nd, ns, np, source, support, place, &
   & counts, stencils, stat, message)
   use rk_error, only : error_type
   use rk_pack, only : pack_error, unpack_approximation
   use rk_shape, only : approximation_type, new_shape, shape_type
   implicit none
   !f2py threadsafe
   character(len=*), intent(in) :: kernel, window
   integer, intent(in) :: order, nd, ns, np
   double precision, intent(in) :: source(nd, ns), support(nd, ns), place(nd, np)
   integer, intent(out) :: counts(np), stencils, stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(approximation_type) :: choice
   type(shape_type) :: shape
   integer :: ip

   counts = 0
   stencils = 0
   call unpack_approximation(choice, order, kernel, window, error)
   if (.not. allocated(error)) call new_shape(shape, choice, source, support, place, error)
   call pack_error(error, stat, message)
   if (stat /= 0) return
   counts = [(shape%count(ip), ip=1, np)]
   stencils = maxval(shape%stencil)
end subroutine shape_count

!> Neighbours and shape functions of every place, in compressed rows of known size
subroutine shape_fill(order, kernel, window, nd, ns, np, nq, nnz, source, support, place, &
   & neighbours, values, stat, message)
   use rk_error, only : error_type
   use rk_pack, only : pack_error, unpack_approximation
   use rk_shape, only : approximation_type, new_shape, shape_type
   implicit none
   !f2py threadsafe
   character(len=*), intent(in) :: kernel, window
   integer, intent(in) :: order, nd, ns, np, nq, nnz
   double precision, intent(in) :: source(nd, ns), support(nd, ns), place(nd, np)
   integer, intent(out) :: neighbours(nnz), stat
   double precision, intent(out) :: values(nq, nnz)
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(approximation_type) :: choice
   type(shape_type), target :: shape
   double precision, pointer, contiguous :: row(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer :: ip, k

   call unpack_approximation(choice, order, kernel, window, error)
   if (.not. allocated(error)) call new_shape(shape, choice, source, support, place, error)
   call pack_error(error, stat, message)
   if (stat /= 0) return
   k = 0
   do ip = 1, np
      call shape%row(ip, nodes, row)
      neighbours(k + 1:k + size(nodes)) = nodes - 1
      values(:, k + 1:k + size(nodes)) = row
      k = k + size(nodes)
   end do
end subroutine shape_fill
