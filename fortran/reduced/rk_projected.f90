!> A full problem that is assembled and then projected on orthonormal modes V.
!>
!> Where it has an energy E, Galerkin reduction (6.27)-(6.31): E(V a) has the residual V^T r(V a)
!> and the tangent V^T K V, so that the volume is projected as in the full problem, and essential
!> values are lifted and held by the penalty there. The pressures stay linear in Newton's step as
!> well: every state of the iteration passes through the full problem. Otherwise least squares
!> Galerkin reduction as it is published (6.62)-(6.67): residuals r(V a) and rows A V. rk_reduced
!> gives the same rows without the full ones; this form is what it is measured against.
!>
!> Reference: Kunisch, Volkwein, Numer. Math. 90 (2001), doi:10.1007/s002110100282
module rk_projected
   use rk_discretisation, only : discretisation_type
   use rk_matrix, only : matrix_rows
   use rk_operator, only : row_operator
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type, problem_type, stage_type
   implicit none
   private

   public :: projected_problem, new_projected

   !> A problem in the span of modes; unknowns are the modes' amplitudes
   type, extends(problem_type) :: projected_problem
      private
      !> Full problem
      class(discretisation_type), pointer :: full => null()
      !> Orthonormal modes, shape (full n, r)
      real(wp), allocatable :: modes(:, :)
      !> Residual of the full problem, shape (full m)
      real(wp), allocatable :: residual(:)
      !> Projected tangent, shape (r, r), or rows, shape (m, r)
      type(matrix_rows) :: rows
   contains
      procedure :: start
      procedure :: assemble
   end type projected_problem

contains

!> Project a full problem on modes
subroutine new_projected(self, full, modes)
   !> Reduced problem; the full one must outlive it, and serves it in each of its evaluations
   type(projected_problem), intent(inout) :: self
   class(discretisation_type), target, intent(inout) :: full
   !> Orthonormal modes, shape (full n, r)
   real(wp), intent(in) :: modes(:, :)

   self%full => full
   self%scene => full%scene
   self%modes = modes
   self%n = size(modes, 2)
   self%m = merge(self%n, full%m, full%energetic)
   self%square = full%energetic
   ! amplitudes of orthonormal modes have the norm of the unknowns they stand for
   self%extent = full%extent
   self%costly = full%costly
   self%weighted = full%weighted
   allocate (self%residual(full%m))
   allocate (self%rows%a(self%m, self%n))
   self%rows%m = self%m
   self%rows%n = self%n
end subroutine new_projected

!> Begin a load step or an iteration
subroutine start(self, x, load, iteration)
   class(projected_problem), target, intent(inout) :: self
   !> Amplitudes there, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), intent(in) :: load
   logical, intent(in) :: iteration

   call self%full%start(matmul(self%modes, x), load, iteration)
end subroutine start

!> Projected residuals and, where wanted, rows
subroutine assemble(self, x, stage, r, seen)
   class(projected_problem), target, intent(inout) :: self
   !> Amplitudes, shape (r)
   real(wp), contiguous, intent(in) :: x(:)
   type(stage_type), intent(in) :: stage
   real(wp), contiguous, intent(inout) :: r(:)
   type(evaluation_type), intent(out) :: seen
   class(row_operator), pointer :: full_rows
   real(wp), allocatable :: image(:)
   integer :: j

   self%linearised => self%rows
   call self%full%assemble(matmul(self%modes, x), stage, self%residual, seen)
   ! the size of what modes can balance, not of all
   seen%size = -1.0_wp
   if (self%square) then
      r = matmul(self%residual, self%modes)
   else
      r = self%residual
   end if
   ! no rows exist where the state is not valid, which the caller rejects
   if (.not. (stage%tangent .and. seen%valid)) return
   full_rows => self%full%operator()
   allocate (image(self%full%m))
   do j = 1, self%n
      call full_rows%apply(self%modes(:, j), image)
      if (self%square) then
         self%rows%a(:, j) = matmul(image, self%modes)
      else
         self%rows%a(:, j) = image
      end if
   end do
end subroutine assemble

end module rk_projected
