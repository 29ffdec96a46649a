!> Values of the approximation at the source points: u = T d with the coefficients d.
!>
!> Stiffness is that of the values, not of the coefficients: a pattern that changes sign from one
!> source point to the next has nearly zero values. A preconditioner made for values is therefore
!> applied between T^-1 and T^-T. A few Chebyshev steps are as good as the inverse there, and they
!> are a fixed polynomial, so that the preconditioner stays linear and symmetric.
!>
!> Reference: Golub, Varga, Numer. Math. 3 (1961), doi:10.1007/BF01386013 (Chebyshev iteration)
module rk_nodal_values
   use rk_precision, only : i8, wp
   use rk_sparse_rows, only : sparse_rows
   use rk_shape, only : shape_type
   implicit none
   private

   public :: nodal_values_type, new_nodal_values

   !> Map from coefficients to values, in the order of the source points
   type :: nodal_values_type
      !> Values of the shape functions of the source points that cover each point, and the
      !> transpose: threads divide its rows too
      type(sparse_rows) :: row, row_t
      !> Centre and half length of the interval that contains the eigenvalues
      real(wp) :: middle = 1.0_wp
      real(wp) :: half = 0.5_wp
      !> Number of Chebyshev steps
      integer, private :: steps = 0
   contains
      !> Apply the inverse map, or its transpose
      procedure :: invert
   end type nodal_values_type

   !> Largest eigenvalue: rows sum to one; slightly larger near edges
   real(wp), parameter :: largest = 1.1_wp
   !> Smallest eigenvalue of one direction that the iteration resolves
   real(wp), parameter :: smallest = 0.3_wp

contains

!> Set up the map
subroutine new_nodal_values(self, shape, place, steps)
   type(nodal_values_type), intent(out) :: self
   !> Shape functions at given positions
   type(shape_type), target, intent(in) :: shape
   !> Number of the position of each source point, shape (ns)
   integer, intent(in) :: place(:)
   !> Number of Chebyshev steps
   integer, intent(in) :: steps
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   real(wp) :: own
   integer :: i, n, ns
   integer(i8), allocatable :: entry(:)

   ns = size(place)
   self%steps = steps
   associate (row => self%row%place)
      allocate (row%offset(ns + 1))
      row%offset(1) = 0
      do i = 1, ns
         row%offset(i + 1) = row%offset(i) + shape%count(place(i))
      end do
      allocate (row%index(row%offset(ns + 1)), self%row%value(row%offset(ns + 1)))
      own = 0.0_wp
      do i = 1, ns
         call shape%row(place(i), nodes, values)
         n = size(nodes)
         associate (at => row%offset(i))
            row%index(at + 1:at + n) = nodes
            self%row%value(at + 1:at + n) = values(1, :)
         end associate
         own = own + sum(values(1, :), mask=nodes == i)/ns
      end do
      call row%transposed(ns, self%row_t%place, entry)
   end associate
   self%row_t%value = self%row%value(entry)
   ! eigenvalue, on a lattice, of the pattern that changes sign in every direction
   own = max(2.0_wp*max(own, 0.0_wp)**(1.0_wp/shape%nd) - 1.0_wp, smallest)**shape%nd
   self%middle = 0.5_wp*(largest + own)
   self%half = 0.5_wp*(largest - own)
end subroutine new_nodal_values

!> x = T^-1 x or T^-T x, approximately
subroutine invert(self, transposed, x)
   class(nodal_values_type), intent(in) :: self
   logical, intent(in) :: transposed
   !> Values, replaced by coefficients, shape (nd, ns)
   real(wp), contiguous, intent(inout) :: x(:, :)
   real(wp), allocatable :: step(:, :), r(:, :), image(:, :)
   real(wp) :: rho, before, keep, gain
   integer :: i, k

   allocate (image, mold=x)
   r = x
   step = x/self%middle
   x = step
   rho = self%half/self%middle
   do k = 1, self%steps
      if (transposed) then
         call self%row_t%product(step, image, .false.)
      else
         call self%row%product(step, image, .false.)
      end if
      before = rho
      rho = 1.0_wp/(2.0_wp*self%middle/self%half - before)
      keep = rho*before
      gain = 2.0_wp*rho/self%half
      !$omp parallel do default(none) schedule(static) private(i) &
      !$omp shared(x, r, step, image, keep, gain)
      do i = 1, size(x, 2)
         r(:, i) = r(:, i) - image(:, i)
         step(:, i) = keep*step(:, i) + gain*r(:, i)
         x(:, i) = x(:, i) + step(:, i)
      end do
      !$omp end parallel do
   end do
end subroutine invert

end module rk_nodal_values
