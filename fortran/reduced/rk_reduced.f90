!> A problem in the span of orthonormal modes V: least squares Galerkin reduction (6.60)-(6.67) of
!> rows, which stops by (6.68), (6.69) and whose rows A V are formed directly in the span or in
!> full, and motions (rk_reduced_motion).
!>
!> A problem with an energy E is assembled in full and projected, (6.27)-(6.31): E(V a) has the
!> residual V^T r(V a) and the tangent V^T K V, so that the volume is projected as in the full
!> problem, where prescribed values are lifted and enforced by the penalty. The pressures remain
!> linear in the Newton step: every state of the iteration is evaluated by the full problem.
!>
!> Reference: Kunisch, Volkwein, Numer. Math. 90 (2001), doi:10.1007/s002110100282
module rk_reduced
   use rk_discretisation, only : discretisation_type
   use rk_equilibrium, only : equilibrium_problem, reduce_rows
   use rk_error, only : error_type, fatal_error, err_input
   use rk_galerkin, only : galerkin_problem
   use rk_matrix, only : matrix_rows
   use rk_motion, only : form_motion
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type, problem_type, stage_type
   use rk_reduced_motion, only : moving_problem, new_moving_problem
   use rk_strong_motion, only : new_strong_motion, strong_motion
   use rk_weak_motion, only : new_weak_motion, weak_motion
   implicit none
   private

   public :: new_motion, new_reduced

   !> A problem in the span of modes; unknowns are the modes' amplitudes
   type, extends(problem_type) :: projected_problem
      private
      class(discretisation_type), pointer :: full => null()
      !> Orthonormal modes, shape (full n, r)
      real(wp), allocatable :: modes(:, :)
      !> Residual of the full problem, shape (full m)
      real(wp), allocatable :: residual(:)
      !> Projected tangent, shape (r, r), or rows, shape (m, r)
      type(matrix_rows) :: rows
   contains
      procedure :: start, assemble
   end type projected_problem

contains

!> Project a full problem on modes
subroutine new_reduced(reduced, full, modes, projection, assembled, error)
   !> Reduced problem, not associated after an error; the full one must outlive it
   class(problem_type), pointer, intent(out) :: reduced
   class(discretisation_type), target, intent(inout) :: full
   !> Orthonormal modes, shape (full n, r)
   real(wp), intent(in) :: modes(:, :)
   !> auto, galerkin or least-squares: the space to which the residual is orthogonal
   character(len=*), intent(in) :: projection
   !> Rows of collocation are assembled in full and then projected, as published, instead of being
   !> formed directly in the span of the modes
   logical, intent(in) :: assembled
   !> Error handling: a form that cannot be reduced in this way
   type(error_type), allocatable, intent(out) :: error
   class(equilibrium_problem), pointer :: rows
   type(projected_problem), pointer :: projected
   type(moving_problem), pointer :: moving
   class(form_motion), pointer :: body

   nullify (reduced)
   if (full%linear) then
      if (.not. allocated(full%scene%motion)) then
         call fatal_error(error, err_input, 'reduced models are for nonlinear problems and ' &
            & //'of motions: a static linear problem takes one solve, so there is nothing to gain')
         return
      end if
      call new_motion(body, full, error)
      if (allocated(error)) return
      allocate (moving)
      call new_moving_problem(moving, body, modes, projection, error)
      if (allocated(error)) then
         deallocate (moving)
      else
         reduced => moving
      end if
      return
   end if
   if (projection == 'galerkin' .and. .not. full%energetic) then
      call fatal_error(error, err_input, 'projection: collocation has more equations than ' &
         & //'unknowns, which "galerkin" cannot project: use "least-squares"')
   else if (projection == 'least-squares' .and. full%energetic) then
      call fatal_error(error, err_input, 'projection: nonlinear Galerkin forms have as many ' &
         & //'equations as unknowns and are projected by "galerkin"')
   end if
   if (allocated(error)) return
   if (full%energetic .or. assembled) then
      allocate (projected)
      call new_projected(projected, full, modes)
      reduced => projected
      return
   end if
   select type (full)
   class is (equilibrium_problem)
      call reduce_rows(full, modes, rows)
      reduced => rows
   class default
      call fatal_error(error, err_input, 'modes do not reduce method "'//full%scene%method &
         & //'" with a material of K = inf, whose pressures are unknowns: use a finite K, ' &
         & //'1e3 times the shear modulus, or method "rkcm-mixed"')
   end select
end subroutine new_reduced

!> Set up the motion of a problem, whose scene has one
subroutine new_motion(body, problem, error)
   !> Body in motion, not associated after an error; the problem must outlive it
   class(form_motion), pointer, intent(out) :: body
   !> Linear problem
   class(discretisation_type), target, intent(inout) :: problem
   !> Error handling: a mass that is not positive, too many rows
   type(error_type), allocatable, intent(out) :: error
   type(weak_motion), pointer :: weak
   type(strong_motion), pointer :: strong

   nullify (body)
   select type (problem)
   type is (galerkin_problem)
      allocate (weak)
      call new_weak_motion(weak, problem, error)
      body => weak
   type is (equilibrium_problem)
      allocate (strong)
      call new_strong_motion(strong, problem, error)
      body => strong
   end select
   if (.not. allocated(error) .or. .not. associated(body)) return
   deallocate (body)
   nullify (body)
end subroutine new_motion

!> Project a full problem on modes
subroutine new_projected(self, full, modes)
   !> Reduced problem; the full one must outlive it, and is used in each of its evaluations
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
   ! amplitudes of orthonormal modes have the norm of the unknowns they represent
   self%extent = full%extent
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
   real(wp), allocatable :: image(:)
   integer :: j

   self%linearised => self%rows
   call self%full%assemble(matmul(self%modes, x), stage, self%residual, seen)
   ! the size of the part that modes can balance, not of the whole residual
   seen%size = -1.0_wp
   if (self%square) then
      r = matmul(self%residual, self%modes)
   else
      r = self%residual
   end if
   ! an invalid state, which the caller rejects, has no rows
   if (.not. (stage%tangent .and. seen%valid)) return
   allocate (image(self%full%m))
   do j = 1, self%n
      call self%full%linearised%apply(self%modes(:, j), image)
      if (self%square) then
         self%rows%a(:, j) = matmul(image, self%modes)
      else
         self%rows%a(:, j) = image
      end if
   end do
end subroutine assemble

end module rk_reduced
