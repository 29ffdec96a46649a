!> From the name of a method to its problem.
module rk_new_problem
   use rk_conditions, only : boundary_type
   use rk_discretisation, only : discretisation_type
   use rk_equilibrium, only : equilibrium_problem, new_equilibrium
   use rk_error, only : error_type, fatal_error, err_input
   use rk_galerkin, only : galerkin_problem, new_galerkin
   use rk_islands, only : check_islands
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   implicit none
   private

   public :: new_problem

contains

!> Set up the problem of a scene by its method
subroutine new_problem(problem, scene, error)
   class(discretisation_type), allocatable, intent(out) :: problem
   !> Scene, which must outlive the problem
   type(scene_type), target, intent(in) :: scene
   type(error_type), allocatable, intent(out) :: error
   type(equilibrium_problem), allocatable :: strong
   type(galerkin_problem), allocatable :: galerkin

   select case (scene%method)
   case ('rkcm', 'rkcm-mixed')
      allocate (strong)
      call new_equilibrium(strong, scene, scene%method == 'rkcm-mixed', error)
      call move_alloc(strong, problem)
   case default
      allocate (galerkin)
      call new_galerkin(galerkin, scene, error)
      call move_alloc(galerkin, problem)
   end select
   if (allocated(error)) return
   ! with inertia, and for other fields than displacements, nothing needs to be prescribed
   if (problem%linear .and. (allocated(scene%motion) .or. problem%fields /= scene%cloud%nd &
      & .or. problem%fields == 1)) return
   select type (problem)
   type is (galerkin_problem)
      ! its collocation points are places of output, and may be few
      call check_islands(problem%shape, problem%inside, scene%cloud%points, &
         & problem%boundary%point, problem%boundary%supported(scene), error)
   class default
      call check_islands(problem%shape, problem%shape, scene%cloud%points, &
         & problem%boundary%point, problem%boundary%supported(scene), error)
   end select
   if (problem%linear) return
   if (.not. allocated(error) .and. keeps_volume(scene, problem%boundary)) &
      & call fatal_error(error, err_input, 'material K = inf: displacements are prescribed all ' &
      & //'around the body, which leaves its pressure undetermined; give a finite K, or leave a ' &
      & //'side free')
end subroutine new_problem

!> Whether the volume of an incompressible body is prescribed: no normal displacement of its surface
!> is free
pure logical function keeps_volume(scene, boundary)
   type(scene_type), intent(in) :: scene
   !> Prescribed components
   type(boundary_type), intent(in) :: boundary
   integer :: b, e, k

   keeps_volume = all([(scene%tissue(k)%material%incompressible(), k=1, size(scene%tissue))]) &
      & .and. .not. any(scene%condition%tendon > 0.0_wp)
   associate (cloud => scene%cloud)
      do e = 1, size(cloud%boundary_point)
         if (.not. keeps_volume) return
         b = findloc(boundary%point, cloud%boundary_point(e), dim=1)
         keeps_volume = all(boundary%essential(:, b) .or. abs(cloud%normal(:, e)) < 1.0e-6_wp)
      end do
   end associate
end function keeps_volume

end module rk_new_problem
