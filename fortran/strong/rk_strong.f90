!> What all strong forms share: linear equations at points, and forces by the principle of virtual
!> work.
!>
!> The force on a fixed, plane set is the work of the stress in a virtual motion that is 1 on the
!> set and falls to 0 before the next fixed set: R = -integral of P grad w over the body. It sees
!> interior sections only, where stresses are smooth, not the singular tractions at the rim of the
!> set. A component for which that motion meets other fixed points, or has no room, falls back to
!> the traction integral over the set.
module rk_strong
   use rk_discretisation, only : discretisation_type
   use rk_precision, only : pi, wp
   use rk_rows, only : rows_type
   use rk_states, only : field_state, point_state
   use rk_tensor, only : vector_product
   implicit none
   private

   public :: strong_problem

   !> Collocation problem of a scene
   type, abstract, extends(discretisation_type) :: strong_problem
      !> Linearised rows
      type(rows_type) :: rows
   contains
      procedure :: set_force, section_force
   end type strong_problem

contains

!> Force that the surroundings exert on the body through a set, or its moment where the set has
!> moved to, whose virtual motion is a rotation: through the sections below the set, and by the
!> traction integral over it where these have no room
function set_force(self, set, state, share, about) result(force)
   class(strong_problem), intent(in) :: self
   integer, intent(in) :: set
   type(field_state), intent(in) :: state
   !> Part of the way to the next fixed set that is looked at [-]
   real(wp), intent(in) :: share
   real(wp), intent(in), optional :: about(3)
   real(wp) :: force(3), work(3), pull(3), depth, reach
   real(wp) :: normal(self%scene%cloud%nd), origin(self%scene%cloud%nd)
   logical :: usable(3)
   type(point_state) :: local
   integer :: e, ip, nd

   nd = self%scene%cloud%nd
   force = 0.0_wp
   work = 0.0_wp
   pull = 0.0_wp
   call find_reach(self, set, normal, origin, reach, usable)
   ! a rotation moves along both directions across its axis
   if (present(about)) usable = [usable(2) .and. usable(3), usable(1) .and. usable(3), &
      & usable(1) .and. usable(2)]
   associate (cloud => self%scene%cloud)
      do e = 1, size(cloud%boundary_point)
         if (.not. cloud%in_set(e, set)) cycle
         call self%at_point(state, cloud%boundary_point(e), local)
         pull(:nd) = matmul(local%p(:nd, :nd), cloud%normal(:, e))*cloud%area(e)
         force = force + wanted(pull)
      end do
      if (.not. any(usable)) return
      ! half a way makes sense between the ends of a body only
      depth = maxval(-matmul(normal, cloud%points - spread(origin, 2, size(cloud%points, 2))))
      if (share < 1.0_wp .and. reach < depth*(1.0_wp - 1.0e-6_wp)) return
      reach = share*reach
      do ip = 1, size(cloud%points, 2)
         depth = -dot_product(normal, cloud%points(:, ip) - origin)
         if (depth <= 0.0_wp .or. depth >= reach) cycle
         call self%at_point(state, ip, local)
         ! -w'(depth): a raised cosine, which weighs the middle most
         pull(:nd) = matmul(local%p(:nd, :nd), normal)*cloud%volume(ip) &
            & *(1.0_wp - cos(2.0_wp*pi*depth/reach))/reach
         work = work + wanted(pull)
      end do
   end associate
   where (usable) force = work

contains

   !> A force, or its moment, at the place of the state
   pure function wanted(pull)
      real(wp), intent(in) :: pull(3)
      real(wp) :: wanted(3)

      wanted = pull
      if (present(about)) wanted = vector_product(local%x + local%u - about, pull)
   end function wanted

end function set_force

!> Force through a plane section: the mean of those through the sections of a slab of some spacings,
!> which lies inside the body
function section_force(self, place, normal, state) result(force)
   class(strong_problem), intent(in) :: self
   real(wp), intent(in) :: place(:)
   real(wp), intent(in) :: normal(:)
   type(field_state), intent(in) :: state
   real(wp) :: force(3), height(size(self%scene%cloud%points, 2)), half, middle, away
   type(point_state) :: local
   integer :: ip, nd

   force = 0.0_wp
   nd = size(normal)
   associate (cloud => self%scene%cloud)
      height = matmul(normal, cloud%points)
      half = 2.0_wp*dot_product(abs(normal), sum(cloud%spacing, dim=2))/size(cloud%spacing, 2)
      half = min(half, 0.5_wp*(maxval(height) - minval(height)))
      middle = min(max(dot_product(normal, place), minval(height) + half), maxval(height) - half)
      do ip = 1, size(height)
         away = height(ip) - middle
         if (abs(away) >= half) cycle
         call self%at_point(state, ip, local)
         force(:nd) = force(:nd) + matmul(local%p(:nd, :nd), normal)*cloud%volume(ip) &
            & *0.5_wp*(1.0_wp + cos(pi*away/half))/half
      end do
   end associate
end function section_force

!> Depth to which a virtual motion from a set may reach, and the components it may have
subroutine find_reach(self, set, normal, origin, reach, usable)
   class(strong_problem), intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> Its outward normal, shape (nd)
   real(wp), intent(out) :: normal(:)
   !> A point of it, shape (nd) [length]
   real(wp), intent(out) :: origin(:)
   !> Depth below the set, 0 if the set is not plane [length]
   real(wp), intent(out) :: reach
   !> Components for which no other fixed point is met
   logical, intent(out) :: usable(3)
   real(wp) :: across, depth, deepest
   integer :: e, b, first, nd

   nd = size(normal)
   usable = .false.
   reach = 0.0_wp
   associate (cloud => self%scene%cloud)
      first = findloc(cloud%boundary_set, set, dim=1)
      ! a part of a side says nothing of the sections below it
      if (first == 0) return
      normal = cloud%normal(:, first)
      origin = cloud%points(:, cloud%boundary_point(first))
      deepest = maxval(-matmul(normal, cloud%points - spread(origin, 2, size(cloud%points, 2))))
      do e = 1, size(cloud%boundary_point)
         if (.not. cloud%in_set(e, set)) cycle
         if (dot_product(cloud%normal(:, e), normal) < 1.0_wp - 1.0e-9_wp) return
         if (abs(dot_product(normal, cloud%points(:, cloud%boundary_point(e)) - origin)) &
            & > 1.0e-6_wp*deepest) return
      end do
      ! the next set that is fixed as a whole ends the motion
      reach = deepest
      do b = 1, size(self%boundary%point)
         depth = -dot_product(normal, cloud%points(:, self%boundary%point(b)) - origin)
         if (depth < 1.0e-6_wp*deepest) cycle
         if (all(self%boundary%essential(:, b))) reach = min(reach, depth)
      end do
      ! a motion that ends within a cell or two is seen by hardly a point, or by none
      across = dot_product(abs(normal), sum(cloud%spacing, dim=2))/size(cloud%spacing, 2)
      if (reach < 1.5_wp*across) return
      usable(:nd) = .true.
      do b = 1, size(self%boundary%point)
         depth = -dot_product(normal, cloud%points(:, self%boundary%point(b)) - origin)
         if (depth < 1.0e-6_wp*deepest .or. depth > reach*(1.0_wp - 1.0e-6_wp)) cycle
         usable(:nd) = usable(:nd) .and. .not. self%boundary%essential(:, b) &
            & .and. .not. any(abs(self%boundary%traction(:, :, b)) > 0.0_wp, dim=1)
      end do
   end associate
end subroutine find_reach

end module rk_strong
