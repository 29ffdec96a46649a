!> Interface of a factor for the solvers.
module rk_factor
   use rk_precision, only : wp
   implicit none
   private

   public :: factor_type

   !> A factor that solves equations with (A D)^T (A D), where D holds the inverse column norms
   type, abstract :: factor_type
      !> Column norms of A, shape (n)
      real(wp), allocatable :: scale(:)
      !> A has fewer independent columns than unknowns: the factor cannot be used to solve
      logical :: singular = .false.
   contains
      !> Solve in place
      procedure(solve_interface), deferred :: solve
   end type factor_type

   abstract interface
      subroutine solve_interface(self, x)
         import :: factor_type, wp
         class(factor_type), intent(in) :: self
         !> Right hand side, replaced by the solution, shape (n)
         real(wp), contiguous, intent(inout) :: x(:)
      end subroutine solve_interface
   end interface

end module rk_factor
