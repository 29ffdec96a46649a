!> Largest eigenvalues, which limit the time steps of explicit schemes.
module rk_spectrum
   use rk_blas, only : dsteqr
   use rk_error, only : error_type, fatal_error, err_linalg
   use rk_operator, only : square_report
   use rk_precision, only : wp
   use rk_symmetric, only : symmetric_matrix
   use rk_text, only : to_text
   implicit none
   private

   public :: spectral_radius, largest_eigenvalue

   !> Maximum number of Lanczos vectors, and relative change at which the iteration stops [-]
   integer, parameter :: most_vectors = 150
   real(wp), parameter :: settled = 1.0e-8_wp

   interface
      subroutine dgeev(jobvl, jobvr, n, a, lda, wr, wi, vl, ldvl, vr, ldvr, work, lwork, info)
         import :: wp
         character, intent(in) :: jobvl, jobvr
         integer, intent(in) :: n, lda, ldvl, ldvr, lwork
         real(wp), intent(inout) :: a(lda, *)
         real(wp), intent(out) :: wr(*), wi(*), vl(ldvl, *), vr(ldvr, *), work(*)
         integer, intent(out) :: info
      end subroutine dgeev
   end interface

contains

!> Largest modulus of the eigenvalues of a matrix
subroutine spectral_radius(a, radius, error)
   !> Matrix, destroyed, shape (n, n)
   real(wp), contiguous, intent(inout) :: a(:, :)
   !> Largest modulus
   real(wp), intent(out) :: radius
   !> Error handling: no convergence
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: wr(size(a, 1)), wi(size(a, 1)), work(8*size(a, 1)), left(1, 1), right(1, 1)
   integer :: info, n

   n = size(a, 1)
   call dgeev('n', 'n', n, a, n, wr, wi, left, 1, right, 1, work, size(work), info)
   radius = maxval(hypot(wr, wi))
   if (info /= 0) call fatal_error(error, err_linalg, 'eigenvalues were not found, info ' &
      & //to_text(info))
end subroutine spectral_radius

!> Largest eigenvalue of A x = lambda M x, by Lanczos vectors that are M-orthogonal
subroutine largest_eigenvalue(matrix, a, m, value, error)
   !> Matrix with the sparsity pattern of both
   type(symmetric_matrix), intent(in) :: matrix
   !> Entries of A
   real(wp), contiguous, intent(in) :: a(:)
   !> Entries of M, positive definite
   real(wp), contiguous, intent(in) :: m(:)
   !> Largest eigenvalue
   real(wp), intent(out) :: value
   !> Error handling: M is singular, no convergence
   type(error_type), allocatable, intent(out) :: error
   type(square_report) :: report
   real(wp), allocatable :: v(:, :), w(:), image(:)
   real(wp) :: alpha(most_vectors), beta(most_vectors), d(most_vectors), e(most_vectors)
   real(wp) :: none(1, 1), work(1), last
   integer :: i, info, k, n

   n = matrix%n
   allocate (v(n, most_vectors), w(n), image(n))
   ! a start vector without the symmetries of the points has a part in every mode
   v(:, 1) = [(1.0_wp + 0.5_wp*sin(12.9898_wp*i)*(-1)**i, i=1, n)]
   call matrix%product(m, v(:, 1), image)
   v(:, 1) = v(:, 1)/sqrt(dot_product(v(:, 1), image))
   value = 0.0_wp
   do k = 1, min(n, most_vectors)
      call matrix%product(a, v(:, k), image)
      alpha(k) = dot_product(v(:, k), image)
      call matrix%solve_with(m, image, w, report, error)
      if (allocated(error)) return
      ! orthogonalising twice is enough
      do i = 1, 2
         call matrix%product(m, w, image)
         w = w - matmul(v(:, :k), matmul(transpose(v(:, :k)), image))
      end do
      call matrix%product(m, w, image)
      beta(k) = sqrt(max(dot_product(w, image), 0.0_wp))
      last = value
      d(:k) = alpha(:k)
      e(:k) = beta(:k)
      call dsteqr('n', k, d, e, none, 1, work, info)
      if (info /= 0) call fatal_error(error, err_linalg, 'eigenvalues were not found, info ' &
         & //to_text(info))
      if (allocated(error)) return
      value = d(k)
      if (k == most_vectors .or. beta(k) <= epsilon(1.0_wp)*abs(value)) exit
      if (k > 20 .and. abs(value - last) <= settled*abs(value)) exit
      v(:, min(k + 1, most_vectors)) = w/beta(k)
   end do
end subroutine largest_eigenvalue

end module rk_spectrum
