!> Error of a linear problem's solution in the norms (5.20) and (5.21).
!>
!> Gauss integration over the cells between source points, one slab of cells after another, so that
!> memory does not grow with the number of cells.
module rk_error_norms
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type
   use rk_gauss, only : gauss_rule
   use rk_precision, only : wp
   use rk_shape, only : shape_type
   use rk_equation, only : solution_at
   implicit none
   private

   public :: norms_type, error_norms

   !> Norms of the error and of the solution
   type :: norms_type
      !> L2 norm of the error and of the known solution
      real(wp) :: l2 = 0.0_wp
      real(wp) :: l2_solution = 0.0_wp
      !> H1 norm of the error and of the known solution
      real(wp) :: h1 = 0.0_wp
      real(wp) :: h1_solution = 0.0_wp
      !> Largest ones over a motion, which may pass through rest at its end
      real(wp) :: largest_l2 = 0.0_wp
      real(wp) :: largest_l2_solution = 0.0_wp
      !> Wall time of the integration [s]
      real(wp) :: seconds = 0.0_wp
   end type norms_type

   !> Maximum number of Gauss points in a slab
   integer, parameter :: slab = 4000

contains

subroutine error_norms(problem, x, time, norms, error)
   !> Linear problem
   class(discretisation_type), intent(in) :: problem
   !> Coefficients, shape (n)
   real(wp), contiguous, intent(in) :: x(:)
   !> Time, not used if nothing moves
   real(wp), intent(in) :: time
   type(norms_type), intent(out) :: norms
   !> Error handling: a point without shape functions, a solution that is not finite
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: place(:, :), weight(:), node(:), node_weight(:)
   type(shape_type) :: shape
   real(wp), dimension(problem%fields, problem%shape%nq) :: u, exact
   real(wp) :: sums(4), total(4)
   integer :: first, last, cells, per_cell, ip, n, nd

   associate (scene => problem%scene)
      nd = scene%cloud%nd
      ! exact for squares of polynomials of the order of the basis
      n = scene%approximation%order + 1
      allocate (node(n), node_weight(n))
      call gauss_rule(node, node_weight)
      per_cell = n**nd
      cells = size(scene%cloud%volume_points, 2)
      total = 0.0_wp
      do first = 1, cells, max(slab/per_cell, 1)
         last = min(first + max(slab/per_cell, 1) - 1, cells)
         call gauss_points(scene%cloud%volume_points(:, first:last), scene%cloud%spacing(:, 1), &
            & node, node_weight, place, weight)
         call scene%shape_at(place, shape, error)
         if (allocated(error)) return
         sums = 0.0_wp
         do ip = 1, shape%np
            call shape%interpolate(ip, x, 1, 1 + nd, u)
            call solution_at(scene%equation, place(:, ip), time, exact, error)
            if (allocated(error)) return
            u = u - exact
            ! error, solution, and their gradients
            sums = sums + weight(ip)*[sum(u(:, 1)**2), sum(exact(:, 1)**2), &
               & sum(u(:, 2:1 + nd)**2), sum(exact(:, 2:1 + nd)**2)]
         end do
         total = total + sums
      end do
   end associate
   total(3:) = total(3:) + total(:2)
   total = sqrt(total)
   norms = norms_type(l2=total(1), l2_solution=total(2), h1=total(3), h1_solution=total(4))
end subroutine error_norms

!> Gauss points of boxes
pure subroutine gauss_points(centre, edge, node, node_weight, place, weight)
   !> Centres of the boxes, shape (nd, cells) [length]
   real(wp), intent(in) :: centre(:, :)
   !> Edge lengths of all boxes, shape (nd) [length]
   real(wp), intent(in) :: edge(:)
   !> One-dimensional rule, shape (n) [-]
   real(wp), intent(in) :: node(:), node_weight(:)
   !> Points, shape (nd, cells*n**nd) [length]
   real(wp), allocatable, intent(out) :: place(:, :)
   !> Weights, shape (cells*n**nd) [length^nd]
   real(wp), allocatable, intent(out) :: weight(:)
   integer :: c, d, g, k, n, rest

   n = size(node)
   g = n**size(edge)
   allocate (place(size(edge), g*size(centre, 2)), weight(g*size(centre, 2)))
   do c = 1, size(centre, 2)
      do k = 1, g
         rest = k - 1
         weight((c - 1)*g + k) = 1.0_wp
         do d = 1, size(edge)
            associate (i => mod(rest, n) + 1)
               place(d, (c - 1)*g + k) = centre(d, c) + 0.5_wp*edge(d)*node(i)
               weight((c - 1)*g + k) = weight((c - 1)*g + k)*0.5_wp*edge(d)*node_weight(i)
            end associate
            rest = rest/n
         end do
      end do
   end do
end subroutine gauss_points

end module rk_error_norms
