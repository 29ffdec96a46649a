!> Minimal residuals for symmetric systems, definite or not, with a positive definite
!> preconditioner.
!>
!> Reference: Elman, Silvester, Wathen, Finite Elements and Fast Iterative Solvers, Oxford (2014),
!>            algorithm 4.1, doi:10.1093/acprof:oso/9780199678792.001.0001
module rk_minres
   use rk_precision, only : wp
   implicit none
   private

   public :: symmetric_system, minres

   !> A symmetric matrix and its preconditioner, given by their products
   type, abstract :: symmetric_system
      !> Unknowns
      integer :: size = 0
   contains
      !> y = A x
      procedure(product_interface), deferred :: multiply
      !> y = P^-1 x
      procedure(product_interface), deferred :: precondition
   end type symmetric_system

   !> Number of entries summed in one block
   integer, parameter :: block = 2048
   !> Iterations after which the number needed is predicted from the convergence rate, and the
   !> fraction of the required rate that is certainly too slow [-]
   integer, parameter :: seen = 3
   real(wp), parameter :: sure = 0.7_wp

   abstract interface
      subroutine product_interface(self, x, y)
         import :: symmetric_system, wp
         class(symmetric_system), intent(in) :: self
         !> Vector, shape (size)
         real(wp), contiguous, intent(in) :: x(:)
         !> Product, shape (size)
         real(wp), contiguous, intent(inout) :: y(:)
      end subroutine product_interface
   end interface

contains

subroutine minres(system, b, tolerance, limit, x, iterations, reached, lanczos, pace)
   class(symmetric_system), intent(in) :: system
   !> Right hand side, shape (size)
   real(wp), contiguous, intent(in) :: b(:)
   !> Required residual relative to that of x = 0, in the norm of P^-1 [-]
   real(wp), intent(in) :: tolerance
   integer, intent(in) :: limit
   !> Solution, shape (size)
   real(wp), contiguous, intent(inout) :: x(:)
   integer, intent(out) :: iterations
   !> Relative residual reached [-]
   real(wp), intent(out) :: reached
   !> Tridiagonal Lanczos matrix, whose eigenvalues approximate those of P^-1 A: its diagonal and
   !> its off-diagonal, shape (2, limit)
   real(wp), intent(inout), optional :: lanczos(:, :)
   !> Number of iterations that may be spent to reach the tolerance: stops early if clearly slower
   integer, intent(in), optional :: pace
   real(wp), allocatable :: v(:), v_old(:), w(:), w_old(:), z(:), image(:)
   real(wp) :: gamma, gamma_old, delta, eta, first, c, c_old, s, s_old, a0, a1, a2, a3
   integer :: i

   x = 0.0_wp
   iterations = 0
   reached = 0.0_wp
   v = b
   allocate (v_old, w, w_old, mold=b)
   allocate (z, image, mold=b)
   v_old = 0.0_wp
   w = 0.0_wp
   w_old = 0.0_wp
   call system%precondition(v, z)
   gamma = sqrt(max(product_of(z, v), 0.0_wp))
   ! also where the preconditioner gives NaN
   if (any(abs(b) > 0.0_wp)) reached = 1.0_wp
   gamma_old = 1.0_wp
   first = gamma
   eta = gamma
   c = 1.0_wp
   c_old = 1.0_wp
   s = 0.0_wp
   s_old = 0.0_wp
   if (.not. first > 0.0_wp) return
   do iterations = 1, limit
      !$omp parallel do default(none) schedule(static) private(i) shared(z, gamma)
      do i = 1, size(z)
         z(i) = z(i)/gamma
      end do
      !$omp end parallel do
      call system%multiply(z, image)
      delta = product_of(image, z)
      a2 = s*delta + c_old*c*gamma
      a3 = s_old*gamma
      a0 = c*delta - c_old*s*gamma
      ! the new vectors overwrite the old ones
      !$omp parallel do default(none) schedule(static) private(i) &
      !$omp shared(v, v_old, w, w_old, z, image, gamma, gamma_old, delta, a2, a3)
      do i = 1, size(z)
         v_old(i) = image(i) - (delta/gamma)*v(i) - (gamma/gamma_old)*v_old(i)
         w_old(i) = z(i) - a3*w_old(i) - a2*w(i)
      end do
      !$omp end parallel do
      call swap(v, v_old)
      call system%precondition(v, z)
      gamma_old = gamma
      gamma = product_of(z, v)
      if (.not. abs(gamma) <= huge(1.0_wp)) exit
      gamma = sqrt(max(gamma, 0.0_wp))
      if (present(lanczos)) lanczos(:, iterations) = [delta, gamma]
      a1 = hypot(a0, gamma)
      ! the Krylov space is invariant and does not contain the solution: the matrix is singular
      if (.not. a1 > 0.0_wp) exit
      c_old = c
      s_old = s
      c = a0/a1
      s = gamma/a1
      call swap(w, w_old)
      !$omp parallel do default(none) schedule(static) private(i) shared(x, w, a1, c, eta)
      do i = 1, size(x)
         w(i) = w(i)/a1
         x(i) = x(i) + c*eta*w(i)
      end do
      !$omp end parallel do
      eta = -s*eta
      reached = abs(eta)/first
      if (reached <= tolerance .or. .not. gamma > 0.0_wp) exit
      if (present(pace) .and. iterations >= seen) then
         if (reached > tolerance**(sure*min(iterations, pace)/pace)) exit
      end if
   end do
   iterations = min(iterations, limit)
end subroutine minres

!> x.y summed block by block in parallel; the result does not depend on the number of threads
real(wp) function product_of(x, y)
   !> Vectors, shape (size)
   real(wp), intent(in) :: x(:), y(:)
   real(wp) :: part((size(x) + block - 1)/block)
   integer :: i

   !$omp parallel do default(none) schedule(static) private(i) shared(x, y, part)
   do i = 1, size(part)
      associate (last => min(i*block, size(x)))
         part(i) = dot_product(x((i - 1)*block + 1:last), y((i - 1)*block + 1:last))
      end associate
   end do
   !$omp end parallel do
   product_of = sum(part)
end function product_of

pure subroutine swap(x, y)
   real(wp), allocatable, intent(inout) :: x(:), y(:)
   real(wp), allocatable :: other(:)

   call move_alloc(x, other)
   call move_alloc(y, x)
   call move_alloc(other, y)
end subroutine swap

end module rk_minres
