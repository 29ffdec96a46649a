!> States as plain records: of a whole body, for post-processing, and of the material at one of its
!> places, from which results are computed.
module rk_states
   use rk_precision, only : wp
   implicit none
   private

   public :: field_state, point_state

   !> State of the material at one place
   type :: point_state
      !> Undeformed place [length]
      real(wp) :: x(3) = 0.0_wp
      !> Displacement [length]
      real(wp) :: u(3) = 0.0_wp
      !> Deformation gradient F(i, A) [-]
      real(wp) :: f(3, 3) = 0.0_wp
      !> Volume ratio [-]
      real(wp) :: j = 1.0_wp
      !> First Piola-Kirchhoff stress P(i, A) [stress]
      real(wp) :: p(3, 3) = 0.0_wp
      !> Cauchy stress [stress]
      real(wp) :: cauchy(3, 3) = 0.0_wp
   end type point_state

   !> A state of a discretised body. The form that created it can evaluate any quantity of it, in
   !> any order and beside other states.
   type :: field_state
      !> Unknowns, shape (n)
      real(wp), allocatable :: x(:)
      !> Load, 0..1 [-]
      real(wp) :: load = 0.0_wp
      !> Tissue whose stress alone is included, 0 for that of all
      integer :: tissue = 0
      !> Load factors, in which prescribed values are linear, shape (factors) [-]
      real(wp), allocatable :: factor(:)
      !> Weak forms at their integration points: deformation gradient F(i, A), shape (3, 3, np) [-]
      real(wp), allocatable :: f(:, :, :)
      !> Volume ratio, shape (np) [-]
      real(wp), allocatable :: j(:)
      !> First Piola-Kirchhoff stress P(i, A), shape (3, 3, np) [stress]
      real(wp), allocatable :: p(:, :, :)
      !> Where the stress is that of one tissue: its fraction, shape (np) [-]
      real(wp), allocatable :: part(:)
      !> Weak forms: coefficients of the pressure, the projected K (J - 1) of each group of points,
      !> shape (1 + nd, groups) [stress length^(nd/2)]
      real(wp), allocatable :: pressure(:, :)
      !> Curvature of the pressure in each group, where it is written, shape (nd, nd, groups)
      !> [stress/length^2]
      real(wp), allocatable :: bend(:, :, :)
      !> States at the collocation points, shape (nc), if they are stored for several evaluations
      type(point_state), allocatable :: place(:)
      !> Forces of the supports on source points, if the stress on walls comes from them, shape
      !> (nd, ns) [force]
      real(wp), allocatable :: push(:, :)
   end type field_state

end module rk_states
