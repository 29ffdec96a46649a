!> Proper orthogonal decomposition of snapshots by singular values (6.22).
!>
!> Reference: Kunisch, Volkwein, Numer. Math. 90 (2001), doi:10.1007/s002110100282
module rk_pod
   use rk_error, only : error_type, fatal_error, err_input
   use rk_lapack, only : svd
   use rk_precision, only : wp
   implicit none
   private

   public :: pod_modes

contains

!> Modes and proper orthogonal values of snapshots
subroutine pod_modes(snapshots, modes, values, error)
   !> Snapshots in columns, shape (n, s)
   real(wp), intent(in) :: snapshots(:, :)
   !> Orthonormal modes, the most energetic first, shape (n, min(n, s))
   real(wp), allocatable, intent(out) :: modes(:, :)
   !> Proper orthogonal values, singular values squared over s (6.22), shape (min(n, s))
   real(wp), allocatable, intent(out) :: values(:)
   !> Error handling: no snapshots, not finite
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: vt(:, :)

   if (size(snapshots) == 0 .or. .not. all(abs(snapshots) <= huge(1.0_wp))) then
      call fatal_error(error, err_input, 'snapshots must be finite numbers, at least one column')
      return
   end if
   call svd(snapshots, modes, values, vt, error)
   if (allocated(error)) return
   values = values**2/size(snapshots, 2)
end subroutine pod_modes

end module rk_pod
