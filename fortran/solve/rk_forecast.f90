!> CPU time of a solve and of its error bars, from counts alone.
module rk_forecast
   use rk_basis, only : basis_size
   use rk_cloud, only : cloud_type
   use rk_companion, only : choose_companion, companion_type
   use rk_deck, only : deck_type
   use rk_deck_scene, only : new_scene
   use rk_error, only : error_type
   use rk_estimate, only : estimate_cost, estimate_type
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   implicit none
   private

   public :: forecast_solve, forecast_bars

   !> Iterations of a run and of each further load step, as needed by the decks in inputs
   real(wp), parameter :: first_iterations = 2.0_wp, step_iterations = 3.0_wp
   !> Factorisations of the first and of each further load step of a solid, and what its iterations
   !> with them cost, in factorisations
   real(wp), parameter :: first_factors = 2.0_wp, step_factors = 1.0_wp
   !> Integration points along each direction of a cell for the error against a known solution
   integer, parameter :: norm_rule = 5
   !> Cost of a count in operations of a matrix product, fitted to the CPU times of eleven decks:
   !> shape functions, assembly, factor of a tangent, least squares, entries of a tangent, fields of
   !> a state, error norms, an iteration or time step, start
   real(wp), parameter :: price(9) = [440.0_wp, 620.0_wp, 0.53_wp, 1.4_wp, 1200.0_wp, 1.5e5_wp, &
      & 1400.0_wp, 6.0e7_wp, 6.0e8_wp]

contains

!> Operations of a solve without its error bars
real(wp) function forecast_solve(scene, cost) result(operations)
   type(scene_type), intent(in) :: scene
   type(estimate_type), intent(in) :: cost
   real(wp) :: counts(9), iterations, steps
   integer :: nd

   nd = cost%nd
   steps = scene%steps()
   iterations = first_iterations + step_iterations*steps
   counts = 0.0_wp
   if (allocated(scene%equation%problem)) then
      iterations = 1.0_wp
      if (scene%equation%is_known()) counts(7) = cost%ns*norm_rule**nd*cost%neighbours
   end if
   counts(1) = (cost%places + cost%nc)*cost%members*basis_size(nd, scene%approximation%order)
   counts(2) = iterations*cost%places*cost%members*nd
   counts(merge(3, 4, index(scene%method, 'rkpm') == 1)) = merge(first_factors &
      & + step_factors*steps, iterations, cost%keeps_factor)*cost%flops
   counts(5) = iterations*cost%entries
   counts(6) = steps*cost%nc*nd**2
   counts(8) = max(iterations, steps)
   counts(9) = 1.0_wp
   operations = dot_product(price, counts)
end function forecast_solve

!> Operations of the second solution, which gives the error bars; 0 where there is none
real(wp) function forecast_bars(deck, model, scene) result(operations)
   type(deck_type), intent(in) :: deck
   !> Points of the model file
   type(cloud_type), intent(in) :: model
   type(scene_type), intent(in) :: scene
   type(companion_type) :: companion
   type(deck_type) :: other
   type(scene_type) :: second
   type(error_type), allocatable :: error
   character(len=:), allocatable :: words

   operations = 0.0_wp
   if (allocated(scene%equation%problem)) then
      if (scene%equation%is_known()) return
   end if
   companion%method = scene%method
   call choose_companion(companion, scene, deck, words)
   if (allocated(companion%why_not)) return
   call deck%vary(words, other, error)
   if (.not. allocated(error)) call new_scene(second, other, model, error)
   if (.not. allocated(error)) operations = forecast_solve(second, estimate_cost(other, model))
end function forecast_bars

end module rk_forecast
