!> Stress on walls: sides of an annulus on which all components are constrained.
!>
!> Support forces on the source points of a wall are as accurate as the energy; near each place a
!> quadratic traction is fitted to them. The derivative of the displacement along the wall is the
!> prescribed one; that across it puts the stress of the material law in equilibrium with the
!> traction. Derivatives of the approximation and pressures of groups are far less accurate there.
!>
!> Where a wall meets a plane of symmetry at a right angle, the traction normal to the plane is an
!> odd function across it, the other component an even one: one-sided fits to forces that alternate
!> from point to point have a first-order error there.
module rk_walls
   use rk_cells, only : cells_type
   use rk_conditions, only : conditions_at
   use rk_error, only : error_type
   use rk_free_faces, only : free_faces_type
   use rk_lattice, only : lattice_coordinates, lattice_frame, set_number
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   use rk_slides, only : moments, slides_on
   use rk_weak_conditions, only : surface_type
   implicit none
   private

   public :: walls_type, new_walls

   !> Places on walls
   type, extends(free_faces_type) :: walls_type
      !> Sides that are walls, shape (sides)
      logical, allocatable :: side(:)
      !> Source points whose forces give each traction component at a place, and their weights
      !> [1/length], shape (fit, nd, places)
      integer, allocatable :: node(:, :, :)
      real(wp), allocatable :: share(:, :, :)
      !> Derivatives along the wall of the displacement prescribed by each load factor, shape
      !> (factors, nd, places) [-]
      real(wp), allocatable :: slope(:, :, :)
   contains
      procedure :: traction, follow
   end type walls_type

   !> Source points per fit
   integer, parameter :: fit = 5
   !> Distance up to which a place is on a side, in spacings [-]
   real(wp), parameter :: on_side = 1.0e-6_wp
   !> Half the step of difference quotients, in spacings [-]
   real(wp), parameter :: small = 1.0e-4_wp
   !> Derivatives of prescribed displacements up to which these count as even or constant, given the
   !> rounding of their difference quotients [-]
   real(wp), parameter :: level = 1.0e-8_wp

contains

!> Find the places and the weights of their tractions. A side with few source points that no other
!> side constrains is not a wall. A place on two walls, or at an end of one beside a free side, has
!> no traction; fits of a component the adjacent side constrains omit the source points of both
subroutine new_walls(self, scene, cells, surface, error)
   type(walls_type), intent(out) :: self
   type(scene_type), intent(in) :: scene
   type(cells_type), intent(in) :: cells
   !> Surface with its conditions
   type(surface_type), intent(in) :: surface
   !> Error handling: an expression that is not finite
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: place(2, size(scene%cloud%points, 2) + size(scene%probe))
   real(wp) :: low(3), step(3)
   real(wp), allocatable :: moment(:, :)
   integer, allocatable :: own(:), wall(:), odd(:)
   logical :: holds(2, scene%cloud%sides()), on(scene%cloud%sides(), size(scene%cloud%source, 2))
   logical :: here(scene%cloud%sides())
   integer :: i, k, n, side

   associate (cloud => scene%cloud)
      call lattice_frame(cloud, low, step)
      place = reshape([cloud%points, (scene%probe(i)%point(:2), i=1, size(scene%probe))], &
         & shape(place))
      do side = 1, size(holds, 2)
         holds(:, side) = [(any(surface%essential(k, :) .and. cells%set == side), k=1, 2)]
      end do
      self%side = [(any(cells%set == side) .and. all(cells%set /= side &
         & .or. all(surface%essential, dim=1)), side=1, size(holds, 2))]
      do k = 1, size(on, 2)
         on(:, k) = [(meets(side, cloud%source(:, k)), side=1, size(on, 1))]
      end do
      do side = 1, size(self%side)
         self%side(side) = self%side(side) &
            & .and. minval([(size(own_points(side, k)), k=1, 2)]) >= fit
      end do
      ! derivatives along a wall are not smoothed
      allocate (self%pair(2, 0))
      allocate (self%number(size(place, 2)), source=0)
      allocate (self%normal(3, size(place, 2)), self%share(fit, 2, size(place, 2)), source=0.0_wp)
      allocate (self%node(fit, 2, size(place, 2)), source=1)
      allocate (self%slope(scene%programme%count(), 2, size(place, 2)))
      allocate (wall(size(place, 2)), odd(size(place, 2)), source=0)
      n = 0
      do i = 1, size(place, 2)
         k = i - size(cloud%points, 2)
         if (k > 0) then
            if (.not. scene%probe(k)%at_a_place()) cycle
         end if
         here = [(meets(side, place(:, i)), side=1, size(here))]
         if (count(here .and. self%side) /= 1 .or. any(here .and. .not. any(holds, dim=1))) cycle
         n = n + 1
         self%number(i) = n
         wall(i) = findloc(here .and. self%side, .true., dim=1)
         self%normal(:2, n) = outward(wall(i), place(:, i))
         call set_slope(scene, cells, wall(i), place(:, i), self%normal(:2, n), &
            & self%slope(:, :, n), error)
         if (allocated(error)) return
         side = findloc(here .and. .not. self%side, .true., dim=1)
         if (side > 0) odd(i) = mirrored(scene, cells, surface, side, self%slope(:, :, n))
      end do
      do side = 1, size(self%side)
         if (.not. self%side(side)) cycle
         moment = moments(cells, surface, side, size(cloud%source, 2))
         do k = 1, 2
            own = own_points(side, k)
            do i = 1, size(wall)
               if (wall(i) /= side) cycle
               ! an odd traction vanishes
               if (odd(i) == k) cycle
               n = self%number(i)
               call fit_traction(cloud%source(:, own), moment(:, own), place(:, i), &
                  & self%normal(:2, n), odd(i) > 0, self%node(:, k, n), self%share(:, k, n))
               self%node(:, k, n) = own(self%node(:, k, n))
            end do
         end do
      end do
      self%probe = pack([(k, k=1, size(scene%probe))], self%number(size(cloud%points, 2) + 1:) > 0)
   end associate

contains

   !> Source points where no other side constrains a component
   pure function own_points(side, k) result(own)
      integer, intent(in) :: side, k
      integer, allocatable :: own(:)
      integer :: i

      own = pack([(i, i=1, size(on, 2))], on(side, :) &
         & .and. count(on .and. spread(holds(k, :), 2, size(on, 2)), dim=1) == 1)
   end function own_points

   !> Whether a place lies on a side of the lattice
   pure logical function meets(side, x)
      integer, intent(in) :: side
      real(wp), intent(in) :: x(2)
      real(wp) :: at(2)
      integer :: d

      at = lattice_coordinates(scene%cloud, x)
      d = (side + 1)/2
      if (set_number(.true., d, 1) == side) at(d) = at(d) - (scene%cloud%lattice(d) - 1)*step(d)
      meets = abs(at(d) - low(d)) <= on_side*step(d)
   end function meets

end subroutine new_walls

!> Component normal to a side beside a wall that is a plane of symmetry of an isotropic body; 0 if
!> the side is no such plane, or the displacement prescribed on the wall has a kink there
pure integer function mirrored(scene, cells, surface, side, slope) result(i)
   type(scene_type), intent(in) :: scene
   type(cells_type), intent(in) :: cells
   type(surface_type), intent(in) :: surface
   integer, intent(in) :: side
   !> Derivatives along the wall prescribed by each load factor, shape (factors, 2) [-]
   real(wp), intent(in) :: slope(:, :)
   integer :: k, s

   i = 0
   if (allocated(surface%pressure) .or. allocated(surface%spring)) return
   if (any([(scene%tissue(k)%material%fibered, k=1, size(scene%tissue))])) return
   i = slides_on(scene%cloud, surface, cells, side)
   if (i == 0) return
   if (any(abs(slope(:, 3 - i)) > level)) i = 0
   do s = 1, size(cells%set)
      if (i == 0) return
      if (cells%set(s) == side .and. (any(abs(surface%value(:, i, s)) > 0.0_wp) &
         & .or. any(abs(surface%traction(:, :, s)) > 0.0_wp))) i = 0
   end do
end function mirrored

!> Outward normal of a side at a place on it
pure function outward(side, x) result(normal)
   integer, intent(in) :: side
   real(wp), intent(in) :: x(2)
   real(wp) :: normal(2)
   integer :: d

   normal = 0.0_wp
   d = (side + 1)/2
   normal(d) = merge(1.0_wp, -1.0_wp, set_number(.true., d, 1) == side)
   normal = matmul(reshape([x(1), x(2), -x(2), x(1)], [2, 2])/norm2(x), normal)
end function outward

!> Prescribed derivatives along a wall
subroutine set_slope(scene, cells, side, x, normal, slope, error)
   type(scene_type), intent(in) :: scene
   type(cells_type), intent(in) :: cells
   integer, intent(in) :: side
   !> Place and the normal there, shape (2) [length], [-]
   real(wp), intent(in) :: x(:), normal(:)
   !> Derivatives of each load factor, shape (factors, 2) [-]
   real(wp), intent(out) :: slope(:, :)
   !> Error handling: an expression that is not finite
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: value(size(slope, 1), 3, 2), push(size(slope, 1), 3), way(2)
   logical :: fixed(3)
   integer :: k, s

   s = minloc(sum((cells%surface - spread(x, 2, size(cells%set)))**2, dim=1), dim=1, &
      & mask=cells%set == side)
   way = small*scene%cloud%mean_spacing()*[-normal(2), normal(1)]
   do k = 1, 2
      call conditions_at(scene, cells%in_set(s, scene%condition%set), &
         & x + (2*k - 3)*way, fixed, value(:, :, k), push, error)
      if (allocated(error)) return
   end do
   slope = (value(:, :2, 2) - value(:, :2, 1))/(2.0_wp*norm2(way))
end subroutine set_slope

!> Weights of forces on source points for the traction at a place: least squares fit of a quadratic
!> traction
subroutine fit_traction(source, moment, x, normal, even, node, share)
   !> Source points, and the moments of their shape functions, shape (2, n) and (6, n)
   real(wp), intent(in) :: source(:, :), moment(:, :)
   !> Place and the normal there, shape (2) [length], [-]
   real(wp), intent(in) :: x(:), normal(:)
   !> The traction is an even function along the wall
   logical, intent(in) :: even
   !> The nearest source points, and their weights
   integer, intent(out) :: node(:)
   real(wp), intent(out) :: share(:)
   real(wp) :: away(size(source, 2)), a(size(node), 3), m(3, 3), t(2), at, reach
   integer :: k

   away = norm2(source - spread(x, 2, size(away)), dim=1)
   do k = 1, size(node)
      node(k) = minloc(away, dim=1)
      reach = away(node(k))
      away(node(k)) = huge(1.0_wp)
   end do
   t = [-normal(2), normal(1)]/reach
   at = dot_product(t, x)
   do k = 1, size(node)
      associate (own => moment(:, node(k)))
         a(k, 1) = own(1)
         a(k, 2) = dot_product(t, own(2:3)) - at*own(1)
         a(k, 3) = t(1)**2*own(4) + 2.0_wp*t(1)*t(2)*own(5) + t(2)**2*own(6) &
            & - 2.0_wp*at*dot_product(t, own(2:3)) + at**2*own(1)
      end associate
   end do
   m = matmul(transpose(a), a)
   if (even) m(2, :) = [0.0_wp, 1.0_wp, 0.0_wp]
   if (even) m(:, 2) = [0.0_wp, 1.0_wp, 0.0_wp]
   ! the first row of the inverse
   share = matmul(a, [m(2, 2)*m(3, 3) - m(2, 3)*m(3, 2), m(1, 3)*m(3, 2) - m(1, 2)*m(3, 3), &
      & m(1, 2)*m(2, 3) - m(1, 3)*m(2, 2)])
   share = share/dot_product(share, a(:, 1))
end subroutine fit_traction

!> Traction of the supports at a place [stress]
pure function traction(self, i, push) result(t)
   class(walls_type), intent(in) :: self
   !> Number of the place
   integer, intent(in) :: i
   !> Forces on source points, shape (nd, ns) [force]
   real(wp), intent(in) :: push(:, :)
   real(wp) :: t(3)
   integer :: k

   t = 0.0_wp
   do k = 1, 2
      t(k) = dot_product(self%share(:, k, i), push(k, self%node(:, k, i)))
   end do
end function traction

!> Replace the derivatives along the wall by the prescribed ones
pure subroutine follow(self, i, factor, f)
   class(walls_type), intent(in) :: self
   !> Number of the place
   integer, intent(in) :: i
   !> Load factors, shape (factors) [-]
   real(wp), intent(in) :: factor(:)
   !> Deformation gradient [-]
   real(wp), intent(inout) :: f(3, 3)
   real(wp) :: along(2), lacking(2)

   along = [-self%normal(2, i), self%normal(1, i)]
   lacking = along + matmul(factor, self%slope(:, :, i)) - matmul(f(:2, :2), along)
   f(:2, :2) = f(:2, :2) + spread(lacking, 2, 2)*spread(along, 1, 2)
end subroutine follow

end module rk_walls
