!> A problem in the span of modes: least squares Galerkin reduction (6.60)-(6.67) of rows, which
!> ends by (6.68), (6.69) and whose rows are formed in the span at once or in full
!> (rk_projected), as are the derivatives of an energy, and motions (rk_reduced_motion).
module rk_reduced
   use rk_discretisation, only : discretisation_type
   use rk_equilibrium, only : equilibrium_problem, reduce_rows
   use rk_error, only : error_type, fatal_error, err_input
   use rk_galerkin, only : galerkin_problem
   use rk_linear, only : linear_problem
   use rk_motion, only : form_motion
   use rk_precision, only : wp
   use rk_problem, only : problem_type
   use rk_projected, only : new_projected, projected_problem
   use rk_reduced_motion, only : moving_problem, new_moving_problem
   use rk_strong_motion, only : new_strong_motion, strong_motion
   use rk_text, only : to_text
   use rk_weak_motion, only : new_weak_motion, weak_motion
   implicit none
   private

   public :: new_motion, new_reduced, reduction_type

   !> How a problem is reduced
   type :: reduction_type
      !> auto, galerkin or least-squares: what the residual is orthogonal to
      character(len=:), allocatable :: projection
      !> Rows of collocation assembled in full and then projected, as published, and not in the span
      !> of the modes at once
      logical :: assembled = .false.
   end type reduction_type

contains

!> Project a full problem on modes
subroutine new_reduced(reduced, full, modes, way, error)
   !> Reduced problem, not associated after an error; the full one must outlive it
   class(problem_type), pointer, intent(out) :: reduced
   class(discretisation_type), target, intent(inout) :: full
   !> Orthonormal modes, shape (full n, r)
   real(wp), intent(in) :: modes(:, :)
   !> How it is projected and assembled
   type(reduction_type), intent(in) :: way
   !> Error handling: modes of another model, a form that cannot be reduced so
   type(error_type), allocatable, intent(out) :: error
   class(equilibrium_problem), pointer :: rows
   type(projected_problem), pointer :: projected

   nullify (reduced)
   if (size(modes, 1) /= full%n) then
      call fatal_error(error, err_input, 'modes have '//to_text(size(modes, 1)) &
         & //' entries, the model '//to_text(full%n)//' unknowns')
      return
   end if
   if (full%linear) then
      call new_reduced_motion(reduced, full, modes, way%projection, error)
      return
   end if
   if (way%projection == 'galerkin' .and. .not. full%energetic) then
      call fatal_error(error, err_input, 'projection: collocation has more equations than ' &
         & //'unknowns, which "galerkin" cannot project: take "least-squares"')
   else if (way%projection == 'least-squares' .and. full%energetic) then
      call fatal_error(error, err_input, 'projection: nonlinear Galerkin forms have as many ' &
         & //'equations as unknowns and are projected by "galerkin"')
   end if
   if (allocated(error)) return
   if (full%energetic .or. way%assembled) then
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
      if (full%scene%galerkin%essential == 'transformation') then
         call fatal_error(error, err_input, 'modes do not reduce galerkin.essential = ' &
            & //'"transformation": take "penalty"')
      else
         call fatal_error(error, err_input, 'modes do not reduce method "'//full%scene%method &
            & //'" with a material of K = inf, whose pressures are unknowns: take a finite K, ' &
            & //'1e3 times the shear modulus, or method "rkcm-mixed"')
      end if
   end select
end subroutine new_reduced

!> Project a motion on modes
subroutine new_reduced_motion(reduced, full, modes, projection, error)
   !> Reduced problem, not associated after an error
   class(problem_type), pointer, intent(out) :: reduced
   !> Linear problem
   class(discretisation_type), target, intent(inout) :: full
   real(wp), intent(in) :: modes(:, :)
   !> How it is projected
   character(len=*), intent(in) :: projection
   !> Error handling: a problem that does not move, Galerkin projection of collocation
   type(error_type), allocatable, intent(out) :: error
   type(moving_problem), pointer :: moving
   class(form_motion), pointer :: body

   nullify (reduced)
   if (.not. allocated(full%scene%motion)) then
      call fatal_error(error, err_input, 'reduced models are made of nonlinear problems and of ' &
         & //'motions: a linear problem at rest is solved once, which leaves nothing to save')
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
end subroutine new_reduced_motion

!> Set up the motion of a problem, whose scene has one
subroutine new_motion(body, problem, error)
   !> Body in motion, not associated after an error; the problem must outlive it
   class(form_motion), pointer, intent(out) :: body
   !> Linear problem
   class(discretisation_type), target, intent(inout) :: problem
   !> Error handling: a mass that is not positive, too many rows, a problem that cannot move
   type(error_type), allocatable, intent(out) :: error
   type(weak_motion), pointer :: weak
   type(strong_motion), pointer :: strong

   nullify (body)
   select type (problem)
   type is (galerkin_problem)
      allocate (weak)
      call new_weak_motion(weak, problem, error)
      body => weak
   type is (linear_problem)
      allocate (strong)
      call new_strong_motion(strong, problem, error)
      body => strong
   class default
      call fatal_error(error, err_input, 'dynamics: only linear problems can be marched in time')
   end select
   if (.not. allocated(error) .or. .not. associated(body)) return
   deallocate (body)
   nullify (body)
end subroutine new_motion

end module rk_reduced
