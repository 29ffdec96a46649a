!> Conditions on the surface of a weak form: penalty of prescribed displacements, tractions, the
!> forces of both and of loads inside, and forces through boundary sets.
module rk_weak_conditions
   use rk_cells, only : cells_type
   use rk_cloud, only : cloud_type
   use rk_conditions, only : conditions_at
   use rk_csr, only : csr_type
   use rk_error, only : error_type
   use rk_neighbours, only : nearest_points
   use rk_plates, only : new_plates, plates_type
   use rk_precision, only : i8, wp
   use rk_programme, only : combined, ramp
   use rk_scene, only : scene_type
   use rk_shape, only : shape_type
   use rk_states, only : field_state
   use rk_symmetric, only : symmetric_matrix
   use rk_tensor, only : cofactor, identity, vector_product
   implicit none
   private

   public :: surface_type, set_conditions, prescribed_at, add_load, new_pins

   !> Penalty of a constrained source point, in shear moduli times spacing^(nd-2): with 1e6
   !> rounding errors keep a tube of 9x51 points from converging [-]
   real(wp), parameter :: firmly = 1.0e4_wp

   !> Conditions at the surface points of integration cells
   type :: surface_type
      !> Shape functions
      type(shape_type) :: shape
      !> Components prescribed at each point, shape (fields, ms)
      logical, allocatable :: essential(:, :)
      !> Their values due to each load factor, shape (factors, fields, ms) [length]
      real(wp), allocatable :: value(:, :, :)
      !> Tractions of the others due to each, shape (factors, fields, ms) [force/area]
      real(wp), allocatable :: traction(:, :, :)
      !> Follower pressures on the surface due to each load factor, shape (factors, ms); not
      !> allocated where there are none [force/area]
      real(wp), allocatable :: pressure(:, :)
      !> Springs on the components that are not prescribed, shape (nd, ms); not allocated where
      !> there are none [force/length/area]
      real(wp), allocatable :: spring(:, :)
      !> Sets at the end of a tendon, to whose motion the values are added
      type(plates_type) :: plates
      !> Area of each point, shape (ms) [length^(nd-1)]
      real(wp), allocatable :: area(:)
      !> Area of the smooth surface it represents, on which loads per area act, shape (ms): faces of
      !> voxels have more, on a cylinder 4/pi times as much [length^(nd-1)]
      real(wp), allocatable :: bearing(:)
      !> Penalty times area of each point, shape (ms) [force/length]
      real(wp), allocatable :: penalty(:)
   contains
      procedure :: set_varying, set_penalty, coupled, add_penalty, add_forces, add_push
      procedure :: held_energy, force_between
      procedure :: force => set_force, pressure_force, gradient_at, held_at, held_force
   end type surface_type

contains

!> Conditions at the points, from those on their sets
subroutine set_conditions(self, scene, cells, shear, error)
   !> Surface with shape functions
   type(surface_type), intent(inout) :: self
   type(scene_type), intent(in) :: scene
   type(cells_type), intent(in) :: cells
   !> Shear modulus at each integration point [stress]
   real(wp), intent(in) :: shear(:)
   !> Error handling: no direction on the axis
   type(error_type), allocatable, intent(out) :: error
   integer :: i, s, n, nd, ms

   n = scene%programme%count()
   nd = scene%cloud%nd
   ms = size(cells%set)
   call prescribed_at(scene, cells, self%essential, self%value, self%traction, error)
   if (allocated(error)) return
   call self%set_penalty(scene, cells, shear)
   call new_plates(self%plates, scene, cells, self%shape%ns)
   if (any(abs(scene%condition%pressure) > 0.0_wp)) allocate (self%pressure(n, ms), source=0.0_wp)
   if (any([(scene%condition(i)%spring > 0.0_wp, i=1, size(scene%condition))])) &
      & allocate (self%spring(nd, ms), source=0.0_wp)
   do i = 1, size(scene%condition)
      associate (condition => scene%condition(i))
         do s = 1, ms
            if (.not. cells%in_set(s, condition%set)) cycle
            if (allocated(self%pressure)) self%pressure(ramp + condition%amplitude, s) &
               & = self%pressure(ramp + condition%amplitude, s) + condition%pressure
            if (allocated(self%spring)) self%spring(:, s) = self%spring(:, s) &
               & + condition%spring(:nd)
         end do
      end associate
   end do
end subroutine set_conditions

!> Prescribed values and tractions at surface points
subroutine prescribed_at(scene, cells, essential, value, traction, error, time)
   type(scene_type), intent(in) :: scene
   type(cells_type), intent(in) :: cells
   !> Prescribed components, shape (fields, ms)
   logical, allocatable, intent(out) :: essential(:, :)
   !> Values of these and tractions of the others due to each load factor, shape
   !> (factors, fields, ms) [length], [force/area]
   real(wp), allocatable, intent(out) :: value(:, :, :), traction(:, :, :)
   !> Error handling: no direction on the axis, an expression that is not finite
   type(error_type), allocatable, intent(out) :: error
   !> Time of expressions, 0 without
   real(wp), intent(in), optional :: time
   real(wp), dimension(scene%programme%count(), 3) :: own, push
   logical :: fixed(3)
   integer :: fields, i, ms, s

   fields = scene%equation%fields(scene%cloud%nd)
   ms = size(cells%set)
   allocate (essential(fields, ms), value(size(own, 1), fields, ms))
   allocate (traction(size(own, 1), fields, ms))
   do s = 1, ms
      call conditions_at(scene, cells%in_set(s, scene%condition%set), &
         & cells%place(:, s), fixed, own, push, error, time)
      if (allocated(error)) return
      essential(:, s) = fixed(:fields)
      value(:, :, s) = own(:, :fields)
      do i = 1, fields
         traction(:, i, s) = merge(0.0_wp, push(:, i), fixed(i))
      end do
   end do
end subroutine prescribed_at

!> Springs at the pins of a linear problem, which fix motions that no load drives
subroutine new_pins(self, scene, stiffness, error)
   !> Points at which values are constrained
   type(surface_type), intent(inout) :: self
   !> Scene with an equation
   type(scene_type), intent(in) :: scene
   !> Penalty of the pins [stress]
   real(wp), intent(in) :: stiffness
   !> Error handling: a place that too few source points cover
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: at(scene%cloud%nd, size(scene%equation%pin))
   integer :: b, fields, k, pin, pins

   fields = scene%equation%fields(scene%cloud%nd)
   pins = size(scene%equation%pin)
   allocate (self%essential(fields, pins), self%bearing(pins), self%penalty(pins))
   allocate (self%value(1, fields, pins), self%traction(1, fields, pins), source=0.0_wp)
   self%bearing = 0.0_wp
   self%penalty = stiffness*scene%cloud%mean_spacing()**(scene%cloud%nd - 2)
   associate (points => scene%cloud%points, nd => scene%cloud%nd)
      do pin = 1, pins
         b = minloc([(norm2(points(:, k) - scene%equation%pin(pin)%point(:nd)), &
            & k=1, size(points, 2))], dim=1)
         at(:, pin) = points(:, b)
         self%essential(:, pin) = scene%equation%pin(pin)%fixed(:fields)
      end do
   end associate
   call scene%shape_at(at, self%shape, error, first=.true.)
end subroutine new_pins

!> Deformation gradient of the approximation at a surface point
pure function gradient_at(self, s, x) result(f)
   class(surface_type), intent(in) :: self
   !> Surface point
   integer, intent(in) :: s
   !> Unknowns, shape (n) [length]
   real(wp), intent(in) :: x(:)
   real(wp) :: f(3, 3)
   real(wp) :: u(size(self%value, 2), self%shape%nq)
   integer :: nd

   nd = size(u, 1)
   call self%shape%interpolate(s, x, 2, 1 + nd, u)
   f = identity
   f(:nd, :nd) = f(:nd, :nd) + u(:, 2:1 + nd)
end function gradient_at

!> Force of a pressure on the deformed surface at a point, in components that are not prescribed
pure function pressure_force(self, cells, s, p, x) result(force)
   class(surface_type), intent(in) :: self
   type(cells_type), intent(in) :: cells
   integer, intent(in) :: s
   !> Pressure [force/area]
   real(wp), intent(in) :: p
   real(wp), intent(in) :: x(:)
   real(wp) :: force(3), c(3, 3)
   integer :: nd

   nd = size(cells%outward, 1)
   c = cofactor(self%gradient_at(s, x))
   force = 0.0_wp
   force(:nd) = merge(0.0_wp, -p*cells%part(s)*matmul(c(:nd, :nd), cells%outward(:, s)), &
      & self%essential(:, s))
end function pressure_force

!> Set values and tractions that vary over the points, at full load of the ramp
subroutine set_varying(self, cells, displacement, stress)
   class(surface_type), intent(inout) :: self
   type(cells_type), intent(in) :: cells
   !> Displacement of the prescribed components, shape (3, ms) [length]
   real(wp), intent(in) :: displacement(:, :)
   !> Stress P(i, A) whose traction the other components carry, shape (3, 3, ms) [stress]
   real(wp), intent(in) :: stress(:, :, :)
   integer :: nd, s

   nd = size(self%value, 2)
   self%value = 0.0_wp
   self%traction = 0.0_wp
   ! stresses are those on the faces themselves
   self%bearing = self%area
   do s = 1, size(cells%set)
      self%value(ramp, :, s) = displacement(:nd, s)
      self%traction(ramp, :, s) = merge(0.0_wp, matmul(stress(:nd, :nd, s), &
         & cells%outward(:, s))/max(self%area(s), tiny(1.0_wp)), self%essential(:, s))
   end do
end subroutine set_varying

!> Areas and penalties of the points
subroutine set_penalty(self, scene, cells, shear)
   class(surface_type), intent(inout) :: self
   type(scene_type), intent(in) :: scene
   type(cells_type), intent(in) :: cells
   !> Modulus at each integration point whose multiple the penalty is, shape (np) [stress]
   real(wp), intent(in) :: shear(:)
   real(wp) :: spacing, stiffest
   logical :: exactly
   integer :: near(size(cells%set)), s

   allocate (self%penalty(size(cells%set)))
   self%area = cells%part*norm2(cells%outward, dim=1)
   self%bearing = self%area
   if (allocated(cells%entry)) call set_bearing(self, scene%cloud, cells)
   exactly = scene%galerkin%essential == 'transformation'
   near = nearest_points(scene%cloud%source, cells%surface)
   do s = 1, size(cells%set)
      ! the stiffest of several tissues behind it
      stiffest = maxval(shear(cells%lift_point(cells%lift_first(s) + 1:cells%lift_first(s + 1))))
      if (.not. norm2(cells%outward(:, s)) > 0.0_wp) then
         self%penalty(s) = firmly*stiffest*scene%cloud%mean_spacing()**(scene%cloud%nd - 2)
         cycle
      end if
      ! the spacing across the surface, which is smaller where points are graded towards a side
      spacing = norm2(cells%outward(:, s)*scene%cloud%spacing(:, near(s))) &
         & /norm2(cells%outward(:, s))
      self%penalty(s) = merge(0.0_wp, scene%galerkin%penalty, exactly)/spacing*self%area(s)*stiffest
   end do
   if (allocated(cells%face)) call relax_borders(self, cells, &
      & scene%galerkin%penalty, allocated(scene%equation%problem))
end subroutine set_penalty

!> Area of the smooth surface behind each facet of a model: that projected along the normal of its
!> voxel, in all the area that the model has for the facets of the voxel, by the normals in their
!> middles; not where a side, of whole faces, has some of them
subroutine set_bearing(self, cloud, cells)
   class(surface_type), intent(inout) :: self
   type(cloud_type), intent(in) :: cloud
   type(cells_type), intent(in) :: cells
   real(wp), dimension(size(cloud%points, 2)) :: known, found
   logical :: wall(size(cloud%set_names)), plane(size(cloud%points, 2))
   integer :: e, s

   wall = cloud%is_wall([(e, e=1, size(wall))])
   known = 0.0_wp
   found = 0.0_wp
   plane = .false.
   do e = 1, size(cloud%area)
      associate (voxel => cloud%boundary_point(e))
         if (wall(cloud%boundary_set(e))) known(voxel) = known(voxel) + cloud%area(e)
      end associate
   end do
   do s = 1, size(self%bearing)
      e = cells%entry(s)
      if (e == 0) cycle
      self%bearing(s) = self%area(s)*max(0.0_wp, dot_product(cells%outward(:, s), &
         & cloud%normal(:, e))/norm2(cells%outward(:, s)))
      associate (voxel => cloud%boundary_point(e))
         if (wall(cells%set(s))) then
            found(voxel) = found(voxel) + self%bearing(s)
         else if (abs(cloud%normal(3, e)) < 1.0_wp) then
            plane(voxel) = .true.
         end if
      end associate
   end do
   do s = 1, size(self%bearing)
      if (cells%entry(s) == 0 .or. .not. wall(cells%set(s))) cycle
      associate (voxel => cloud%boundary_point(cells%entry(s)))
         if (found(voxel) > 0.0_wp .and. .not. plane(voxel)) &
            & self%bearing(s) = self%bearing(s)*known(voxel)/found(voxel)
      end associate
   end do
end subroutine set_bearing

!> Lower the penalty on faces of Gauss cells that the border of a held part of a side cuts.
!> Displacements are singular there, and smooth functions that are held up to the border are held
!> beyond it: a sheet held over a part of a side was up to 12 % too stiff with cells of a twentieth
!> of its height, as if held up to the next points; with the lower penalty it is right to 1.2 %.
subroutine relax_borders(self, cells, penalty, linear)
   class(surface_type), intent(inout) :: self
   type(cells_type), intent(in) :: cells
   !> Penalty elsewhere [-]
   real(wp), intent(in) :: penalty
   logical, intent(in) :: linear
   !> Penalty there, in nonlinear and in linear problems [-]
   real(wp), parameter :: at_border(2) = [10.0_wp, 5.0_wp]
   !> Shares of a face below this are rounding errors [-]
   real(wp), parameter :: rounded = 1.0e-6_wp
   real(wp), allocatable :: share(:, :), area(:)
   integer :: f, s

   f = maxval(cells%face)
   allocate (share(size(self%essential, 1), f), area(f), source=0.0_wp)
   do s = 1, size(cells%face)
      f = cells%face(s)
      area(f) = area(f) + self%area(s)
      where (self%essential(:, s)) share(:, f) = share(:, f) + self%area(s)
   end do
   do s = 1, size(cells%face)
      f = cells%face(s)
      if (any(share(:, f) > rounded*area(f) .and. share(:, f) < (1.0_wp - rounded)*area(f))) &
         & self%penalty(s) = min(1.0_wp, at_border(merge(2, 1, linear))/penalty)*self%penalty(s)
   end do
end subroutine relax_borders

!> Source points and plates coupled by each surface point, none where it is free
pure function coupled(self) result(list)
   class(surface_type), intent(in) :: self
   type(csr_type) :: list
   type(csr_type) :: all
   logical :: holds(size(self%penalty))
   integer(i8) :: n
   integer :: s

   all = self%plates%coupled(self%shape%neighbour)
   holds = any(self%essential, dim=1)
   if (allocated(self%spring)) holds = holds .or. any(self%spring > 0.0_wp, dim=1)
   if (allocated(self%pressure)) holds = holds .or. any(abs(self%pressure) > 0.0_wp, dim=1)
   allocate (list%offset, mold=all%offset)
   list%offset(1) = 0
   do s = 1, size(holds)
      n = merge(all%offset(s + 1) - all%offset(s), 0_i8, holds(s))
      list%offset(s + 1) = list%offset(s) + n
   end do
   allocate (list%index(list%offset(size(list%offset))))
   do s = 1, size(holds)
      if (holds(s)) list%index(list%offset(s) + 1:list%offset(s + 1)) &
         & = all%index(all%offset(s) + 1:all%offset(s + 1))
   end do
end function coupled

!> Matrix of the penalty and of springs, or of a multiple of the penalty alone
subroutine add_penalty(self, matrix, value, times)
   class(surface_type), target, intent(in) :: self
   !> Places of the entries
   class(symmetric_matrix), intent(in) :: matrix
   !> Entries, to which those of the penalty are added [force/length]
   real(wp), intent(inout) :: value(:)
   !> This multiple [-]
   real(wp), intent(in), optional :: times
   real(wp), allocatable :: part(:, :), psi(:, :)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer, allocatable :: blocks(:)
   real(wp) :: resistance(size(self%value, 2))
   integer :: nd, s, i, k, l, n, plate

   nd = size(self%value, 2)
   do s = 1, size(self%penalty)
      resistance = merge(self%penalty(s), 0.0_wp, self%essential(:, s))
      if (present(times)) then
         resistance = times*resistance
      else if (allocated(self%spring)) then
         resistance = merge(resistance, &
            & self%bearing(s)*self%spring(:, s), self%essential(:, s))
      end if
      if (.not. any(abs(resistance) > 0.0_wp)) cycle
      call self%shape%row(s, nodes, values)
      blocks = nodes
      plate = 0
      if (self%plates%count > 0) plate = maxval(self%plates%follows(:, s))
      if (plate > 0) blocks = [nodes, plate]
      n = size(blocks)
      psi = spread(values(1, :), 2, nd)
      ! the displacement relative to the plate is constrained
      if (plate > 0) psi = reshape([transpose(psi), merge(-1.0_wp, 0.0_wp, &
         & self%plates%follows(:, s) > 0)], [n, nd], order=[2, 1])
      allocate (part(nd*n, nd*n), source=0.0_wp)
      do l = 1, n
         do k = 1, l
            do i = 1, nd
               part(nd*(k - 1) + i, nd*(l - 1) + i) = resistance(i)*psi(k, i)*psi(l, i)
            end do
         end do
      end do
      call matrix%add(value, blocks, part)
      deallocate (part)
   end do
end subroutine add_penalty

!> Forces of tractions and of the prescribed values in the penalty, due to each load factor
subroutine add_forces(self, force)
   class(surface_type), intent(in) :: self
   !> Forces, to which these are added, shape (n, factors) [force]
   real(wp), intent(inout) :: force(:, :)
   real(wp) :: push(size(self%value, 2), size(self%penalty))
   integer :: a, s

   do a = 1, size(force, 2)
      do s = 1, size(self%penalty)
         push(:, s) = merge(self%penalty(s)*self%value(a, :, s), &
            & self%bearing(s)*self%traction(a, :, s), self%essential(:, s))
      end do
      call add_load(self%shape, spread(1.0_wp, 1, size(push, 2)), push, force(:, a))
   end do
end subroutine add_forces

!> Forces of a load at points, such as a body force
subroutine add_load(shape, weight, load, force)
   !> Shape functions at the points
   type(shape_type), target, intent(in) :: shape
   !> Volumes of the points, or areas, shape (np) [length^nd]
   real(wp), intent(in) :: weight(:)
   !> Load per volume, or area, shape (fields, np) [force/length^nd]
   real(wp), intent(in) :: load(:, :)
   !> Forces, to which these are added, shape (n) [force]
   real(wp), intent(inout) :: force(:)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer :: k, nd, q

   nd = size(load, 1)
   do q = 1, size(weight)
      call shape%row(q, nodes, values)
      do k = 1, size(nodes)
         associate (own => force(nd*(nodes(k) - 1) + 1:nd*nodes(k)))
            own = own + weight(q)*values(1, k)*load(:, q)
         end associate
      end do
   end do
end subroutine add_load

!> Force that the surroundings exert on the body through a set, from the work when the set moves; or
!> its moment in the deformed position, from the work when it turns there; or its work in a motion
!> of the source points
function set_force(self, cells, set, state, value, traction, about, motion) result(force)
   class(surface_type), target, intent(in) :: self
   type(cells_type), intent(in) :: cells
   !> Boundary set
   integer, intent(in) :: set
   type(field_state), intent(in) :: state
   !> Prescribed values and tractions of the state's time, in place of those of the load factors,
   !> shape (1, fields, ms) [length], [force/area]
   real(wp), intent(in), optional :: value(:, :, :), traction(:, :, :)
   !> Point about which the moment is wanted [length]
   real(wp), intent(in), optional :: about(3)
   !> Motion of each source point, shape (ns) [-]
   real(wp), intent(in), optional :: motion(:)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   real(wp) :: force(3), own(3), arm(3), u(3)
   integer :: nd, s

   nd = size(cells%surface, 1)
   force = 0.0_wp
   do s = 1, size(cells%set)
      if (.not. cells%in_set(s, set)) cycle
      own = merge(0.0_wp, force, present(about) .or. present(motion))
      if (present(value)) then
         call add_point_force(self, cells, s, state, value(1, :, s), traction(1, :, s), own, u)
      else
         call add_point_force(self, cells, s, state, self%held_at(s, state), &
            & by_factors(self%traction(:, :, s), state%factor), own, u)
      end if
      if (present(about)) then
         arm = u - about
         arm(:nd) = arm(:nd) + cells%place(:, s)
         own = force + vector_product(arm, own)
      else if (present(motion)) then
         call self%shape%row(s, nodes, values)
         own = force + dot_product(values(1, :), motion(nodes))*own
      end if
      force = own
   end do
end function set_force

!> Add the forces of supports on the source points of some sides
subroutine add_push(self, cells, side, state, push)
   class(surface_type), target, intent(in) :: self
   type(cells_type), intent(in) :: cells
   !> Sides, shape (sides)
   logical, intent(in) :: side(:)
   type(field_state), intent(in) :: state
   !> Forces, shape (fields, ns) [force]
   real(wp), intent(inout) :: push(:, :)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   real(wp) :: force(3), u(3)
   integer :: k, s

   do s = 1, size(cells%set)
      if (.not. side(cells%set(s))) cycle
      force = 0.0_wp
      call add_point_force(self, cells, s, state, self%held_at(s, state), &
         & by_factors(self%traction(:, :, s), state%factor), force, u)
      call self%shape%row(s, nodes, values)
      do k = 1, size(nodes)
         push(:, nodes(k)) = push(:, nodes(k)) + values(1, k)*force(:size(push, 1))
      end do
   end do
end subroutine add_push

!> Displacement prescribed at a point, by load factors and by the plate it belongs to
pure function held_at(self, s, state) result(u)
   class(surface_type), intent(in) :: self
   integer, intent(in) :: s
   type(field_state), intent(in) :: state
   !> Displacement, shape (nd) [length]
   real(wp) :: u(size(self%value, 2))

   u = by_factors(self%value(:, :, s), state%factor)
   if (self%plates%count > 0) u = u + self%plates%motion(s, state%x)
end function held_at

!> Sum of parts times load factors, component by component
pure function by_factors(part, factor) result(all)
   !> Part of each factor, shape (factors, fields)
   real(wp), intent(in) :: part(:, :)
   !> Load factors, shape (factors) [-]
   real(wp), intent(in) :: factor(:)
   real(wp) :: all(size(part, 2))
   integer :: i

   all = [(combined(part(:, i), factor), i=1, size(all))]
end function by_factors

!> Energy of the penalty, as supports yield slightly [force length]
real(wp) function held_energy(self, state) result(energy)
   class(surface_type), intent(in) :: self
   type(field_state), intent(in) :: state
   real(wp) :: u(size(self%value, 2), self%shape%nq), held(size(self%value, 2))
   integer :: i, s

   energy = 0.0_wp
   do s = 1, size(self%penalty)
      if (.not. any(self%essential(:, s))) cycle
      call self%shape%interpolate(s, state%x, 1, 1, u)
      held = self%held_at(s, state)
      do i = 1, size(u, 1)
         if (self%essential(i, s)) energy = energy + 0.5_wp*self%penalty(s)*(u(i, 1) - held(i))**2
      end do
   end do
end function held_energy

!> Force on the body at a surface point, and the displacement there
subroutine add_point_force(self, cells, s, state, held, traction, force, displacement)
   class(surface_type), intent(in) :: self
   type(cells_type), intent(in) :: cells
   integer, intent(in) :: s
   type(field_state), intent(in) :: state
   !> Prescribed displacement and traction there, shape (nd) [length], [force/area]
   real(wp), intent(in) :: held(:), traction(:)
   !> Force, to which that of the point is added [force]
   real(wp), intent(inout) :: force(3)
   !> Displacement [length]
   real(wp), intent(out) :: displacement(3)
   real(wp) :: u(size(self%value, 2), self%shape%nq), p(3, 3), part
   integer :: i

   call self%shape%interpolate(s, state%x, 1, 1, u)
   p = lifted_stress(cells, s, state)
   part = 1.0_wp
   associate (behind => cells%lift_point(cells%lift_first(s) + 1:cells%lift_first(s + 1)))
      if (allocated(state%part)) part = sum(state%part(behind))/size(behind)
   end associate
   do i = 1, size(u, 1)
      if (self%essential(i, s)) then
         force(i) = force(i) + dot_product(p(i, :size(cells%outward, 1)), cells%outward(:, s)) &
            & - part*self%penalty(s)*(u(i, 1) - held(i))
      else
         force(i) = force(i) + part*traction(i)*self%bearing(s)
      end if
   end do
   if (allocated(self%spring)) force(:size(u, 1)) = force(:size(u, 1)) - merge(0.0_wp, &
      & part*self%bearing(s)*self%spring(:, s)*u(:, 1), self%essential(:, s))
   if (allocated(self%pressure)) force = force + part*self%pressure_force(cells, s, &
      & dot_product(self%pressure(:, s), state%factor), state%x)
   ! a support moves as prescribed, the body a little less
   displacement = 0.0_wp
   displacement(:size(u, 1)) = merge(held, u(:, 1), self%essential(:, s))
end subroutine add_point_force

!> Stress at a surface point as used by the lifting
pure function lifted_stress(cells, s, state) result(p)
   type(cells_type), intent(in) :: cells
   integer, intent(in) :: s
   type(field_state), intent(in) :: state
   real(wp) :: p(3, 3)
   integer :: k, q

   p = 0.0_wp
   do k = cells%lift_first(s) + 1, cells%lift_first(s + 1)
      q = cells%lift_point(k)
      p = p + cells%lift(k)*cells%weight(q)*state%p(:, :, q)
   end do
end function lifted_stress

!> Contribution of lifting, penalty and springs to the forces on source points, taken by a cut: it
!> belongs to the supports of the surface and is not a force inside the body. Of one tissue only the
!> lifting contributes, by its stress
function held_force(self, cells, cut, state) result(force)
   class(surface_type), target, intent(in) :: self
   type(cells_type), intent(in) :: cells
   !> Share of each source point, shape (ns) [-]
   real(wp), intent(in) :: cut(:)
   type(field_state), intent(in) :: state
   real(wp) :: force(3), u(size(self%value, 2), self%shape%nq), p(3, 3), share, stiffness
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer :: i, s

   force = 0.0_wp
   do s = 1, size(cells%set)
      if (.not. (any(self%essential(:, s)) .or. allocated(self%spring))) cycle
      call self%shape%row(s, nodes, values)
      share = dot_product(values(1, :), cut(nodes))
      call self%shape%interpolate(s, state%x, 1, 1, u)
      p = lifted_stress(cells, s, state)
      if (self%plates%count > 0) u(:, 1) = u(:, 1) - self%plates%motion(s, state%x)
      do i = 1, size(u, 1)
         if (self%essential(i, s)) force(i) = force(i) + share*dot_product(p(i, &
            & :size(cells%outward, 1)), cells%outward(:, s))
         stiffness = 0.0_wp
         if (self%essential(i, s)) then
            stiffness = self%penalty(s)
         else if (allocated(self%spring)) then
            stiffness = self%bearing(s)*self%spring(i, s)
         end if
         if (state%tissue == 0) force(i) = force(i) - share*stiffness*u(i, 1)
      end do
   end do
end function held_force

!> Forces on the surface between a plane and a cut
function force_between(self, cells, cut, place, normal, width, state) result(force)
   class(surface_type), target, intent(in) :: self
   type(cells_type), intent(in) :: cells
   !> Share of each source point behind the cut, shape (ns) [-]
   real(wp), intent(in) :: cut(:)
   !> Plane by its distance from the origin along its unit normal [length]
   real(wp), intent(in) :: place
   real(wp), intent(in) :: normal(:)
   !> Distance over which a point of a face that it cuts passes it [length]
   real(wp), intent(in) :: width
   type(field_state), intent(in) :: state
   real(wp) :: force(3), own(3), u(3), behind
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer :: s

   force = 0.0_wp
   do s = 1, size(cells%set)
      call self%shape%row(s, nodes, values)
      own = 0.0_wp
      call add_point_force(self, cells, s, state, self%held_at(s, state), &
         & by_factors(self%traction(:, :, s), state%factor), own, u)
      behind = dot_product(normal, cells%surface(:, s)) - place
      ! faces that the plane cuts pass it one after the other, those along it at once
      if (abs(dot_product(normal, cells%outward(:, s))) < 0.7_wp*norm2(cells%outward(:, s))) then
         behind = min(max(0.5_wp + behind/width, 0.0_wp), 1.0_wp)
      else
         behind = merge(1.0_wp, 0.0_wp, behind > 0.0_wp)
      end if
      force = force + (behind - dot_product(values(1, :), cut(nodes)))*own
   end do
end function force_between

end module rk_weak_conditions
