!> Prescribed displacements enforced at source points: galerkin.essential = "transformation".
!>
!> Shape functions of a reproducing kernel are not one at their own point and zero at others: a
!> prescribed value is an equation for the coefficients of all nearby source points. The mixed
!> transformation of Chen and Wang solves these equations for the coefficients of the constrained
!> points; here a large penalty enforces each of them, which keeps the stiffness sparse. For this,
!> source points on sides with prescribed values become points of the surface with zero area.
!> Between them u - g is free, lifted into the gradients as with the penalty on the whole side
!> (rk_gradient): constant stress does no work there, and the load left to the penalty is small.
!>
!> Reference: Chen, Wang, Comput. Methods Appl. Mech. Eng. 187 (2000),
!>            doi:10.1016/S0045-7825(00)80007-4
module rk_held
   use rk_cells, only : cells_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_lattice, only : set_number
   use rk_named_sets, only : sets_of
   use rk_neighbours, only : nearest_points
   use rk_nodal_cells, only : lattice_index
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   implicit none
   private

   public :: add_source_points

contains

!> Add the source points of sides with prescribed values to the points of the surface, each once for
!> every such side that it lies on
subroutine add_source_points(self, scene, error)
   type(cells_type), intent(inout) :: self
   type(scene_type), intent(in) :: scene
   !> Error handling: no lattice, a set's expression that is not finite
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: x(:, :), outward(:, :)
   integer, allocatable :: node(:), side_of(:)
   logical, allocatable :: within(:, :)
   logical :: held(scene%cloud%sides())
   integer :: c, d, end, index(3), is, k, n, side

   associate (cloud => scene%cloud)
      if (.not. allocated(cloud%lattice)) then
         call fatal_error(error, err_input, 'galerkin.essential = "transformation" needs the ' &
            & //'lattice of a box or an annulus: use galerkin.essential = "penalty"')
         return
      end if
      held = [(any([(any(scene%condition(c)%prescribes()) .and. cloud%meets_side( &
         & scene%condition(c)%set, side), c=1, size(scene%condition))]), side=1, size(held))]
      allocate (node(0), side_of(0))
      do is = 1, size(cloud%source, 2)
         index = lattice_index(cloud, is)
         do d = 1, cloud%nd
            do end = 0, 1
               side = set_number(cloud%polar, d, end)
               if (index(d) /= end*(cloud%lattice(d) - 1) .or. .not. held(side)) cycle
               node = [node, is]
               side_of = [side_of, side]
            end do
         end do
      end do
      n = size(node)
      x = cloud%source(:, node)
      outward = self%outward(:, [(findloc(self%set, side_of(k), dim=1), k=1, n)])
      do k = 1, n
         ! curved side of an annulus
         if (cloud%polar .and. side_of(k) <= 2) outward(:, k) = x(:, k) &
            & *merge(-1, 1, side_of(k) == 1)
      end do
      if (allocated(self%within)) then
         call sets_of(cloud, x, outward, side_of, within, error)
         if (allocated(error)) return
         self%within = reshape([self%within, within], [size(within, 1), size(self%set) + n])
      end if
   end associate
   self%surface = reshape([self%surface, x], [size(x, 1), size(self%set) + n])
   self%outward = reshape([self%outward, 0.0_wp*x], shape(self%surface))
   self%part = [self%part, spread(0.0_wp, 1, n)]
   self%set = [self%set, side_of]
   self%lift_first = [self%lift_first, size(self%lift_point) + [(k, k=1, n)]]
   self%lift_point = [self%lift_point, nearest_points(self%point, x)]
   self%lift = [self%lift, spread(0.0_wp, 1, n)]
end subroutine add_source_points

end module rk_held
