!> The motion of a linear problem in its form.
module rk_new_motion
   use rk_discretisation, only : discretisation_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_galerkin, only : galerkin_problem
   use rk_linear, only : linear_problem
   use rk_motion, only : form_motion
   use rk_strong_motion, only : new_strong_motion, strong_motion
   use rk_weak_motion, only : new_weak_motion, weak_motion
   implicit none
   private

   public :: new_motion

contains

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
      call fatal_error(error, err_input, 'dynamics: only linear problems move')
   end select
   if (.not. allocated(error) .or. .not. associated(body)) return
   deallocate (body)
   nullify (body)
end subroutine new_motion

end module rk_new_motion
