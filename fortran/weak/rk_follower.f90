!> Follower pressure on the surface of a weak form: force per deformed area against the deformed
!> normal.
!>
!> By Nanson's formula the force on a point with the area A and normal N at rest is -p cof(F) A N,
!> with F of the approximation there. Its derivative is not symmetric point by point; over a surface
!> whose rim is constrained, or lies in planes of symmetry, it is the second derivative of p times
!> the volume behind the surface, and only its symmetric part counts. Along a rim that moves freely
!> a skew part remains, and the tangent needs it: without it the iteration takes 5 steps at 0.1
!> shear moduli, 9 to 15 at 0.4, and converges very slowly beyond.
!>
!> Reference: Bonet, Wood, Nonlinear Continuum Mechanics for Finite Element Analysis, Cambridge
!>            (2008), section 8.5, doi:10.1017/CBO9780511755446
module rk_follower
   use rk_cells, only : cells_type
   use rk_precision, only : wp
   use rk_scene, only : condition_type, scene_type
   use rk_symmetric, only : symmetric_matrix
   use rk_tensor, only : cofactor_slope
   use rk_weak_conditions, only : surface_type
   implicit none
   private

   public :: add_pressure, has_free_rim

contains

!> Add the forces of pressures to residuals and, where wanted, their stiffness to a matrix
subroutine add_pressure(surface, cells, factor, x, tangent, matrix, r)
   !> Surface with pressures
   type(surface_type), target, intent(in) :: surface
   type(cells_type), intent(in) :: cells
   !> Load factors, shape (factors) [-]
   real(wp), intent(in) :: factor(:)
   !> Unknowns, shape (n) [length]
   real(wp), intent(in) :: x(:)
   !> Stiffness wanted
   logical, intent(in) :: tangent
   !> Tangent to which the stiffness is added, also to its skew part where it has one
   class(symmetric_matrix), intent(inout) :: matrix
   !> Residuals: internal less external forces, to which those of pressures are added [force]
   real(wp), intent(inout) :: r(:)
   real(wp), allocatable :: part(:, :), skew(:, :)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   real(wp) :: normal(3), push(3), turn(3, 3, 3), p, above, below
   integer :: i, j, k, l, n, nd, s

   if (.not. allocated(surface%pressure)) return
   nd = size(cells%outward, 1)
   normal = 0.0_wp
   do s = 1, size(cells%set)
      p = dot_product(surface%pressure(:, s), factor)
      if (.not. abs(p) > 0.0_wp) cycle
      call surface%shape%row(s, nodes, values)
      n = size(nodes)
      push = surface%pressure_force(cells, s, p, x)
      do k = 1, n
         associate (own => r(nd*(nodes(k) - 1) + 1:nd*nodes(k)))
            own = own - values(1, k)*push(:nd)
         end associate
      end do
      if (.not. tangent) cycle
      normal(:nd) = p*cells%part(s)*cells%outward(:, s)
      ! derivative of the force with respect to F(j, B), in the components that carry it
      turn = cofactor_slope(surface%gradient_at(s, x), normal)
      do i = 1, nd
         if (surface%essential(i, s)) turn(i, :, :) = 0.0_wp
      end do
      allocate (part(nd*n, nd*n), skew(nd*n, nd*n), source=0.0_wp)
      do l = 1, n
         do k = 1, l
            do j = 1, nd
               do i = 1, nd
                  above = values(1, k)*dot_product(turn(i, j, :nd), values(2:1 + nd, l))
                  below = values(1, l)*dot_product(turn(j, i, :nd), values(2:1 + nd, k))
                  part(nd*(k - 1) + i, nd*(l - 1) + j) = 0.5_wp*(above + below)
                  skew(nd*(k - 1) + i, nd*(l - 1) + j) = 0.5_wp*(above - below)
               end do
            end do
         end do
      end do
      call matrix%add(matrix%value, nodes, part)
      if (allocated(matrix%skew)) call matrix%add(matrix%skew, nodes, skew)
      deallocate (part, skew)
   end do
end subroutine add_pressure

!> Whether a surface under pressure has a rim along which it moves freely. The skew part is the
!> pressure times the sum over the rim of (u x v).t, with two displacements u, v and the direction t
!> of the rim. It vanishes where the other side of the rim has the same pressure, is a plane in
!> which the rim stays, or leaves at most one component free
pure logical function has_free_rim(scene)
   type(scene_type), intent(in) :: scene
   ! cosine of a zero angle [-]
   real(wp), parameter :: along = 1.0_wp - 1.0e-6_wp
   logical :: mine(size(scene%cloud%points, 2)), inside(scene%cloud%sides()), fixed(3)
   integer :: c, d, e

   has_free_rim = .false.
   associate (cloud => scene%cloud)
      do c = 1, size(scene%condition)
         if (.not. abs(scene%condition(c)%pressure) > 0.0_wp) cycle
         mine = .false.
         do e = 1, size(cloud%boundary_set)
            if (cloud%in_set(e, scene%condition(c)%set)) mine(cloud%boundary_point(e)) = .true.
         end do
         ! the rim of a part of a side lies inside it
         inside = [(cloud%meets_side(scene%condition(c)%set, d), d=1, cloud%sides())]
         do e = 1, size(cloud%boundary_set)
            if (cloud%in_set(e, scene%condition(c)%set)) cycle
            ! sets of a model need not share points where they meet
            if (allocated(cloud%lattice) .and. .not. (mine(cloud%boundary_point(e)) &
               & .or. inside(cloud%boundary_set(e)))) cycle
            fixed = scene%condition(c)%prescribes()
            do d = 1, size(scene%condition)
               if (.not. cloud%in_set(e, scene%condition(d)%set)) cycle
               if (same_pressure(scene%condition(c), scene%condition(d))) exit
               fixed = fixed .or. scene%condition(d)%prescribes()
            end do
            if (d <= size(scene%condition)) cycle
            if (count(fixed(:cloud%nd)) >= cloud%nd - 1) cycle
            if (any(abs(cloud%normal(:, e)) > along .and. fixed(:cloud%nd))) cycle
            has_free_rim = .true.
            return
         end do
      end do
   end associate
end function has_free_rim

!> Whether two sets have the same pressure
pure logical function same_pressure(one, other)
   type(condition_type), intent(in) :: one, other

   same_pressure = one%amplitude == other%amplitude &
      & .and. abs(one%pressure - other%pressure) <= epsilon(1.0_wp)*abs(one%pressure)
end function same_pressure

end module rk_follower
