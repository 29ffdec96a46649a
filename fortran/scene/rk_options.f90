!> Options of a scene: records of the deck, whose defaults the schema has, and what follows from
!> them.
module rk_options
   use rk_deck_records, only : galerkin_keys, solver_keys
   use rk_precision, only : wp
   implicit none
   private

   public :: solver_options, galerkin_options
   public :: displacement_weight

   !> Weight of the displacement rows of the mixed form, and of balanced ones of collocation, in
   !> shear moduli over spacing [-]
   real(wp), parameter :: displacement_weight = 15.0_wp

   !> Iteration, linear solver and weights of boundary rows
   type, extends(solver_keys) :: solver_options
      !> Essential weight as a plain number, used where positive
      real(wp) :: weight_essential
      !> Otherwise: this number times max|C4| at the point; 0 means the number of source points
      real(wp) :: weight_c4
      !> Natural weight
      real(wp) :: weight_traction
   end type solver_options

   !> Galerkin form
   type, extends(galerkin_keys) :: galerkin_options
      !> Prescribed displacements hold exactly at source points, not by the penalty
      logical :: transformation
   end type galerkin_options

end module rk_options
