!> Options of a scene, a record for each table of the deck. They have no values of their own: the
!> schema of the deck is where defaults stand.
module rk_options
   use rk_precision, only : wp
   implicit none
   private

   public :: load_options, solver_options, mixed_options, galerkin_options, interface_options
   public :: displacement_weight

   !> Weight of the displacement rows of the mixed form, and of balanced ones of collocation, in
   !> shear moduli over spacing [-]
   real(wp), parameter :: displacement_weight = 15.0_wp

   !> How the load is applied
   type :: load_options
      !> Load steps
      integer :: steps
      !> Activation of muscles without one of their own, where its amplitude is 1 [-]
      real(wp) :: activation
      !> Its amplitude, 0 for the ramp
      integer :: amplitude
      !> Halvings of a load step before giving up
      integer :: max_halvings
   end type load_options

   !> Iteration, linear solver and weights of boundary rows
   type :: solver_options
      !> Least squares solver
      character(len=:), allocatable :: linear
      !> Matrix of the iteration: "gauss-newton", "full" or "auto"
      character(len=:), allocatable :: newton
      !> Convergence tolerance [-]
      real(wp) :: tolerance
      !> Iterations of one load step
      integer :: max_iterations
      !> Essential weight as a plain number, used where positive
      real(wp) :: weight_essential
      !> Otherwise: this number times max|C4| at the point; 0 means the number of source points
      real(wp) :: weight_c4
      !> Natural weight
      real(wp) :: weight_traction
   end type solver_options

   !> Row weights of the mixed form
   type :: mixed_options
      !> Weight of the volume rows in shear moduli [-]
      real(wp) :: volume_weight
      !> Power of the distance to singular edges in the row weights [-]
      real(wp) :: edge_exponent
   end type mixed_options

   !> Galerkin form
   type :: galerkin_options
      !> Gauss points in each direction of a cell
      integer :: gauss
      !> Prescribed displacements hold exactly at source points, not by the penalty
      logical :: transformation
      !> Penalty of prescribed displacements in shear moduli over spacing [-]
      real(wp) :: penalty
      !> Unknowns up to which the tangent is factorised
      integer :: direct_limit
   end type galerkin_options

   !> Interfaces between materials
   type :: interface_options
      !> Support of the fractions of several materials in spacings of the source points [-]
      real(wp) :: reach
      !> Galerkin form: no fibers at points of a tissue that has none, whatever the fractions there
      logical :: own_fibers
   end type interface_options

end module rk_options
