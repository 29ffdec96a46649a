!> Elimination orders of a sparse symmetric matrix along the body: reverse Cuthill-McKee, whose
!> levels begin at an end of the graph, and layers along an axis.
!>
!> Bodies that are a few supports thick have no separators that would be smaller than a level, and
!> there this order fills less than minimum degree or nested dissection.
!>
!> References: Cuthill, McKee, Proc. 24th ACM Nat. Conf. (1969), doi:10.1145/800195.805928;
!>             George, Liu, ACM TOMS 5 (1979) 284, doi:10.1145/355841.355845 (the ends)
module rk_cuthill
   use rk_csr, only : csr_type
   use rk_precision, only : i8, wp
   use rk_sort, only : sort
   implicit none
   private

   public :: cuthill_mckee, order_along

   !> Both triangles of a pattern, and what a search through its levels leaves behind
   type :: graph_type
      type(csr_type) :: above, below
      !> Neighbours of each node, shape (nodes)
      integer, allocatable :: degree(:)
      !> Last search that has seen each node, shape (nodes)
      integer, allocatable :: seen(:)
      integer :: searches = 0
   end type graph_type

contains

!> Place of each point in an order along an axis
subroutine order_along(x, axis, place)
   !> Coordinates, shape (nd, n) [length]
   real(wp), intent(in) :: x(:, :)
   integer, intent(in) :: axis
   !> Places, shape (n)
   integer, allocatable, intent(out) :: place(:)
   real(wp) :: weight(size(x, 1))
   integer :: e

   ! points of a layer are distinguished by their other coordinates
   weight = [(merge(1.0_wp, 1.0e-5_wp**modulo(e - axis, size(x, 1)), e == axis), &
      & e=1, size(x, 1))]/max(maxval(x, dim=2) - minval(x, dim=2), tiny(1.0_wp))
   call sort(matmul(weight, x), place)
end subroutine order_along

!> Order in which nodes are eliminated
function cuthill_mckee(above) result(order)
   !> Nodes of each column of the upper triangle, the diagonal one included
   type(csr_type), intent(in) :: above
   !> Nodes in their order, shape (nodes)
   integer, allocatable :: order(:)
   type(graph_type) :: graph
   integer, allocatable :: done(:)
   integer :: n, j, found, first, last, root, levels, deepest

   n = size(above%offset) - 1
   graph%above = above
   call above%transposed(n, graph%below)
   graph%degree = [(int(above%offset(j + 1) - above%offset(j) + graph%below%offset(j + 1) &
      & - graph%below%offset(j)), j=1, n)]
   allocate (graph%seen(n), done(n), source=0)
   allocate (order(n))
   found = 0
   do j = 1, n
      if (done(j) > 0) cycle
      ! an end of this part: a node of few neighbours in the last level, as long as there are more
      root = j
      deepest = 0
      do
         call search(graph, root, order(found + 1:), last, first, levels)
         if (levels <= deepest) exit
         deepest = levels
         associate (ends => order(found + first:found + last))
            root = ends(minloc(graph%degree(ends), dim=1))
         end associate
      end do
      done(order(found + 1:found + last)) = 1
      found = found + last
   end do
   order = order(n:1:-1)
end function cuthill_mckee

!> Nodes by their distance from one of them, those of few neighbours first among the equally near
!> that one node brings in
subroutine search(graph, root, order, last, first, levels)
   type(graph_type), intent(inout) :: graph
   !> Where it begins
   integer, intent(in) :: root
   !> Nodes that are connected with it, shape (>= last)
   integer, intent(inout) :: order(:)
   !> Their number, the place of the first one of the last level, and the number of levels
   integer, intent(out) :: last, first, levels
   integer :: k, before, ends

   graph%searches = graph%searches + 1
   order(1) = root
   graph%seen(root) = graph%searches
   last = 1
   levels = 0
   k = 1
   do while (k <= last)
      levels = levels + 1
      first = k
      ends = last
      do k = first, ends
         before = last
         call add(graph%above)
         call add(graph%below)
         call sort_by_degree(order(before + 1:last))
      end do
   end do

contains

   !> Add the neighbours of node k that no node has brought in
   subroutine add(half)
      !> One triangle
      type(csr_type), intent(in) :: half
      integer(i8) :: e

      do e = half%offset(order(k)) + 1, half%offset(order(k) + 1)
         associate (node => half%index(e))
            if (graph%seen(node) == graph%searches) cycle
            graph%seen(node) = graph%searches
            last = last + 1
            order(last) = node
         end associate
      end do
   end subroutine add

   !> Insertion: nodes bring in few
   subroutine sort_by_degree(nodes)
      integer, intent(inout) :: nodes(:)
      integer :: a, b, node

      do a = 2, size(nodes)
         node = nodes(a)
         do b = a - 1, 1, -1
            if (graph%degree(nodes(b)) <= graph%degree(node)) exit
            nodes(b + 1) = nodes(b)
         end do
         nodes(b + 1) = node
      end do
   end subroutine sort_by_degree

end subroutine search

end module rk_cuthill
