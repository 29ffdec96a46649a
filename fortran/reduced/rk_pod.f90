!> Proper orthogonal decomposition of snapshots (6.13)-(6.26): by singular values, or by one of two
!> eigenvalue problems that have the same modes, of the size of the unknowns or of the snapshots.
!> Eigenvalues are squares: modes whose values are below rounding of the largest are lost in them,
!> which is half of the digits that singular values see.
!>
!> References: Kunisch, Volkwein, Numer. Math. 90 (2001), doi:10.1007/s002110100282; Sirovich,
!> Quart. Appl. Math. 45 (1987), doi:10.1090/qam/910462
module rk_pod
   use rk_error, only : error_type, fatal_error, err_input
   use rk_lapack, only : svd
   use rk_precision, only : wp
   use rk_spectrum, only : symmetric_eigenvectors
   implicit none
   private

   public :: pod_modes

contains

!> Modes and proper orthogonal values of snapshots
subroutine pod_modes(snapshots, way, modes, values, error)
   !> Snapshots in columns, shape (n, s)
   real(wp), intent(in) :: snapshots(:, :)
   !> svd (6.22), eigen for the averaged autocorrelation (6.15), snapshots for their method (6.19)
   character(len=*), intent(in) :: way
   !> Orthonormal modes, the most energetic first, shape (n, k), k <= min(n, s)
   real(wp), allocatable, intent(out) :: modes(:, :)
   !> Proper orthogonal values, singular values squared over s (6.26), shape (k)
   real(wp), allocatable, intent(out) :: values(:)
   !> Error handling: no snapshots, not finite
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: vt(:, :), matrix(:, :), lambda(:)
   integer :: j, kept, n, s

   if (size(snapshots) == 0 .or. .not. all(abs(snapshots) <= huge(1.0_wp))) then
      call fatal_error(error, err_input, 'snapshots must be finite numbers, at least one column')
      return
   end if
   n = size(snapshots, 1)
   s = size(snapshots, 2)
   if (way == 'svd') then
      call svd(snapshots, modes, values, vt, error)
      if (.not. allocated(error)) values = values**2/s
      return
   end if
   if (way == 'eigen') then
      matrix = matmul(snapshots, transpose(snapshots))/s
   else
      matrix = matmul(transpose(snapshots), snapshots)/s
   end if
   allocate (lambda(size(matrix, 1)))
   call symmetric_eigenvectors(matrix, lambda, error)
   if (allocated(error)) return
   ! ascending; what is below rounding of the largest is no mode
   kept = count(lambda > size(matrix, 1)*epsilon(1.0_wp)*maxval(lambda))
   kept = min(kept, n, s)
   allocate (modes(n, kept), values(kept))
   do j = 1, kept
      associate (vector => matrix(:, size(lambda) + 1 - j))
         values(j) = lambda(size(lambda) + 1 - j)
         if (way == 'eigen') then
            modes(:, j) = vector
         else
            ! (6.21)
            modes(:, j) = matmul(snapshots, vector)/sqrt(s*values(j))
         end if
      end associate
   end do
end subroutine pod_modes

end module rk_pod
