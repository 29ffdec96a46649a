!> Prescribed displacements that hold exactly at source points: the transformation method.
!>
!> Shape functions of a reproducing kernel are not one at their own point and zero at others, so a
!> prescribed value is an equation for the coefficients of all source points near: B d = g with a
!> row for each held component of a held point. The mixed transformation of Chen and Wang solves it
!> for the coefficients of the held points, d_b = B_bb^-1 (g - B_bi d_i), and transforms residual
!> and stiffness. Here the same equations are met by multipliers (rk_constraint): residuals are
!> projected across the rows, and the stiffness keeps its places. The multipliers are the forces
!> that do work when held points move.
!>
!> Between held points u - g is free, lifted into the gradients as with the penalty (rk_gradient):
!> constant stress does no work there.
!>
!> Reference: Chen, Wang, Comput. Methods Appl. Mech. Eng. 187 (2000),
!>            doi:10.1016/S0045-7825(00)80007-4
module rk_held
   use rk_cells, only : cells_type
   use rk_cloud, only : cloud_type
   use rk_conditions, only : compare_displacements
   use rk_constraint, only : constrained_matrix, constraint_type, new_constraint
   use rk_csr, only : csr_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_lattice, only : set_number
   use rk_named_sets, only : sets_of
   use rk_neighbours, only : nearest_points
   use rk_nodal_cells, only : lattice_index
   use rk_precision, only : i8, wp
   use rk_programme, only : combined
   use rk_scene, only : scene_type
   use rk_symmetric, only : symmetric_matrix
   use rk_tensor, only : vector_product
   use rk_text, only : to_text
   use rk_weak_conditions, only : prescribed_at, surface_type
   implicit none
   private

   public :: held_type, new_held

   !> What is held
   type :: held_type
      !> Source points on sides of the body that hold something, shape (nd, nh) [length]
      real(wp), allocatable :: x(:, :)
      !> As points of a surface: an entry for each side and point, with its sets
      type(cells_type) :: at
      !> Point of each entry, shape (ne)
      integer, allocatable :: place(:)
      !> Nearest integration point of each, shape (nh)
      integer, allocatable :: nearest(:)
      !> Shape functions, components, values and resistances there
      type(surface_type) :: points
      !> Whether an entry's sets hold a component, shape (nd, ne)
      logical, allocatable :: by(:, :)
      !> Number of each held component's row, 0 of others, shape (nd, nh)
      integer, allocatable :: row(:, :)
      !> Rows
      type(constraint_type) :: rows
      !> Stiffness under them
      type(constrained_matrix) :: whole
   contains
      procedure :: set, resist, constrain, reaction, add_push, force => set_force
   end type held_type

   !> Resistance of a row in shear moduli, and in bulk moduli beside it, over spacing: more takes
   !> fewer iterations for the multipliers and more digits
   real(wp), parameter :: by_shear = 1.0e3_wp, by_bulk = 10.0_wp
   !> Part of the spacing within which places are the same [-]
   real(wp), parameter :: alike = 1.0e-6_wp

contains

subroutine new_held(self, scene, cells, surface, error)
   !> What is held, not allocated where nothing is
   type(held_type), allocatable, intent(out) :: self
   type(scene_type), intent(in) :: scene
   type(cells_type), intent(in) :: cells
   !> What holds at their surface points
   type(surface_type), intent(in) :: surface
   !> Error handling: a place that too few source points cover
   type(error_type), allocatable, intent(out) :: error

   if (.not. any(surface%essential)) return
   allocate (self)
   call find_places(self, scene%cloud, cells, surface, error)
   if (allocated(error)) return
   call scene%shape_at(self%x, self%points%shape, error)
   if (allocated(error)) error%message = 'held '//error%message
   self%nearest = nearest_points(cells%point, self%x)
end subroutine new_held

!> Source points on the sides of the body where something is held: of a lattice those of its faces;
!> of a model corners of blocks in the plane of a side's voxel faces, or what nodal cells have there
!> of their source points
subroutine find_places(self, cloud, cells, surface, error)
   type(held_type), intent(inout) :: self
   type(cloud_type), intent(in) :: cloud
   type(cells_type), intent(in) :: cells
   type(surface_type), target, intent(in) :: surface
   !> Error handling: a set's expression that is not finite
   type(error_type), allocatable, intent(out) :: error
   real(wp), allocatable :: x(:, :), outward(:, :)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   logical, allocatable :: on(:, :), member(:, :, :)
   integer, allocatable :: node(:)
   integer :: d, is, k, s, side

   allocate (x, source=cloud%source)
   allocate (on(cloud%sides(), size(x, 2)), source=.false.)
   if (allocated(cells%within)) &
      & allocate (member(size(cloud%set_names), cloud%sides(), size(x, 2)), source=.false.)
   do s = 1, size(cells%set)
      if (.not. any(surface%essential(:, s))) cycle
      side = cells%set(s)
      d = maxloc(abs(cells%outward(:, s)), dim=1)
      associate (y => cells%surface(:, s))
         if (allocated(cloud%lattice)) then
            on(side, :) = .true.
         else if (allocated(cells%node)) then
            is = cells%node(cells%lift_point(cells%lift_first(s) + 1))
            ! source points in the middle of voxels are half a spacing inside
            if (.not. on(side, is)) x(d, is) = y(d)
            call mark(is)
         else
            call surface%shape%row(s, nodes, values)
            do k = 1, size(nodes)
               associate (away => abs(x(:, nodes(k)) - y), step => cloud%spacing(:, nodes(k)))
                  if (away(d) <= alike*step(d) .and. all(away < (1.0_wp - alike)*step)) &
                     & call mark(nodes(k))
               end associate
            end do
         end if
      end associate
   end do
   if (allocated(cloud%lattice)) on = on .and. on_faces(cloud)
   self%x = x(:, pack([(is, is=1, size(x, 2))], any(on, dim=1)))
   allocate (self%place(count(on)), self%at%set(count(on)), node(count(on)))
   s = 0
   k = 0
   do is = 1, size(x, 2)
      if (any(on(:, is))) k = k + 1
      do side = 1, size(on, 1)
         if (.not. on(side, is)) cycle
         s = s + 1
         self%place(s) = k
         self%at%set(s) = side
         node(s) = is
      end do
   end do
   self%at%surface = self%x(:, self%place)
   if (.not. allocated(cloud%region)) return
   if (allocated(cloud%lattice)) then
      allocate (outward(cloud%nd, size(node)))
      do s = 1, size(node)
         outward(:, s) = cells%outward(:, findloc(cells%set, self%at%set(s), dim=1))
         ! the side of an annulus that is no plane
         if (cloud%polar .and. self%at%set(s) <= 2) outward(:, s) = x(:, node(s)) &
            & *merge(-1, 1, self%at%set(s) == 1)
      end do
      call sets_of(cloud, x(:, node), outward, self%at%set, nearest_points(cloud%points, &
         & x(:, node)), self%at%within, error)
   else
      allocate (self%at%within(size(member, 1), size(node)))
      do s = 1, size(node)
         self%at%within(:, s) = member(:, self%at%set(s), node(s))
      end do
   end if

contains

   !> A source point belongs to the side of the surface point, and to its sets
   subroutine mark(source)
      integer, intent(in) :: source

      on(side, source) = .true.
      if (allocated(member)) member(:, side, source) = member(:, side, source) &
         & .or. cells%within(:, s)
   end subroutine mark

end subroutine find_places

!> Faces of a lattice that each of its source points is on, shape (sides, ns)
pure function on_faces(cloud) result(on)
   !> Cloud with a lattice
   type(cloud_type), intent(in) :: cloud
   logical :: on(2*cloud%nd, size(cloud%source, 2))
   integer :: d, end, index(3), is

   do is = 1, size(on, 2)
      index = lattice_index(cloud, is)
      do d = 1, cloud%nd
         do end = 0, 1
            on(set_number(cloud%polar, d, end), is) = index(d) == end*(cloud%lattice(d) - 1)
         end do
      end do
   end do
end function on_faces

!> Values and rows
subroutine set(self, scene, shear, bulk, n, error)
   !> What is held, with places and their shape functions
   class(held_type), target, intent(inout) :: self
   type(scene_type), intent(in) :: scene
   !> Shear modulus at each place, and bulk modulus, which may be infinite, shape (nh) [stress]
   real(wp), intent(in) :: shear(:), bulk(:)
   !> Unknowns in all
   integer, intent(in) :: n
   !> Error handling: two values of one point, more points held than there are to hold them
   type(error_type), allocatable, intent(out) :: error
   type(csr_type) :: unknown
   real(wp), allocatable :: value(:, :, :), push(:, :, :), weight(:), resistance(:)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer(i8) :: k
   character(len=:), allocatable :: both
   integer :: e, h, i, nf, nh

   call prescribed_at(scene, self%at, self%by, value, push, error)
   if (allocated(error)) return
   nf = size(self%by, 1)
   nh = size(shear)
   associate (points => self%points)
      if (allocated(points%essential)) deallocate (points%essential, points%value)
      allocate (points%essential(nf, nh), source=.false.)
      allocate (points%value(size(value, 1), nf, nh), source=0.0_wp)
      do e = 1, size(self%place)
         h = self%place(e)
         do i = 1, nf
            if (.not. self%by(i, e)) cycle
            if (points%essential(i, h)) call compare_displacements(scene%programme, &
               & points%value(:, i, h), value(:, i, e), both)
            if (allocated(both)) then
               call fatal_error(error, err_input, 'boundary sets prescribe two displacements, ' &
                  & //both//', for component '//to_text(i)//' at '//to_text(self%x(:, h)))
               return
            end if
            points%essential(i, h) = .true.
            points%value(:, i, h) = value(:, i, e)
         end do
      end do
      points%penalty = (by_shear*shear + by_bulk*merge(0.0_wp, bulk, bulk > huge(1.0_wp))) &
         & *scene%cloud%mean_spacing()**(scene%cloud%nd - 2)
      k = count(points%essential)
      allocate (unknown%offset(k + 1), resistance(k))
      k = sum([(points%shape%count(h)*count(points%essential(:, h)), h=1, nh)])
      allocate (unknown%index(k), weight(k))
      if (allocated(self%row)) deallocate (self%row)
      allocate (self%row(nf, nh), source=0)
      unknown%offset(1) = 0
      k = 0
      do h = 1, nh
         call points%shape%row(h, nodes, values)
         do i = 1, nf
            if (.not. points%essential(i, h)) cycle
            k = k + 1
            self%row(i, h) = int(k)
            unknown%offset(k + 1) = unknown%offset(k) + size(nodes)
            unknown%index(unknown%offset(k) + 1:unknown%offset(k + 1)) = nf*(nodes - 1) + i
            weight(unknown%offset(k) + 1:unknown%offset(k + 1)) = values(1, :)
            resistance(k) = points%penalty(h)
         end do
      end do
   end associate
   call new_constraint(self%rows, n, unknown, weight, resistance, error)
   if (allocated(error)) error%message = 'galerkin.essential = "transformation": the constrained ' &
      & //'points depend on each other: '//error%message
end subroutine set

!> Add the resistance of the rows to the stiffness, which the stiffness under them then knows
subroutine resist(self, matrix)
   class(held_type), target, intent(inout) :: self
   !> Stiffness
   class(symmetric_matrix), target, intent(inout) :: matrix
   real(wp), allocatable :: value(:)

   call move_alloc(matrix%value, value)
   call self%points%add_penalty(matrix, value)
   call move_alloc(value, matrix%value)
   self%whole%m = matrix%n
   self%whole%n = matrix%n
   self%whole%matrix => matrix
   self%whole%constraint => self%rows
end subroutine resist

!> Residuals under the constraints: forces without those of the multipliers that balance them best,
!> and the resistance of what is missed
subroutine constrain(self, x, factor, r)
   class(held_type), intent(in) :: self
   !> Unknowns, shape (n) [length]
   real(wp), intent(in) :: x(:)
   !> Load factors, shape (factors) [-]
   real(wp), intent(in) :: factor(:)
   !> Internal less external forces, then residuals, shape (n) [force]
   real(wp), intent(inout) :: r(:)
   real(wp) :: missed(self%rows%rows)
   integer :: h, i

   missed = self%rows%times(x)
   do h = 1, size(self%row, 2)
      do i = 1, size(self%row, 1)
         associate (k => self%row(i, h))
            if (k > 0) missed(k) = missed(k) - combined(self%points%value(:, i, h), factor)
         end associate
      end do
   end do
   call self%rows%add_transposed(self%rows%resistance*missed - self%rows%multipliers(r), r)
end subroutine constrain

!> Forces of the supports on held points, which balance internal less external forces
function reaction(self, f) result(force)
   class(held_type), intent(in) :: self
   !> Internal less external forces, shape (n) [force]
   real(wp), intent(in) :: f(:)
   !> Forces, shape (fields, nh) [force]
   real(wp) :: force(size(self%row, 1), size(self%row, 2))

   force = unpack(self%rows%multipliers(f), self%row > 0, 0.0_wp)
end function reaction

!> Add the forces of the supports on the source points of some sides; sides that hold the same
!> component of a point share it equally
subroutine add_push(self, side, held, push)
   class(held_type), target, intent(in) :: self
   !> Sides, shape (sides)
   logical, intent(in) :: side(:)
   !> Forces on held points, shape (fields, nh) [force]
   real(wp), intent(in) :: held(:, :)
   !> Forces, shape (fields, ns) [force]
   real(wp), intent(inout) :: push(:, :)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer :: e, i, k

   do e = 1, size(self%at%set)
      if (.not. side(self%at%set(e))) cycle
      call self%points%shape%row(self%place(e), nodes, values)
      do i = 1, size(held, 1)
         if (.not. self%by(i, e)) cycle
         do k = 1, size(nodes)
            push(i, nodes(k)) = push(i, nodes(k)) + values(1, k)*held(i, self%place(e)) &
               & /count(self%by(i, :) .and. self%place == self%place(e))
         end do
      end do
   end do
end subroutine add_push

!> Force of the supports through a boundary set, or its moment in the deformed position, or its
!> work in a motion of the source points; sets that hold the same component of a point share it
!> equally
function set_force(self, set, held, x, about, motion) result(force)
   class(held_type), target, intent(in) :: self
   !> Boundary set
   integer, intent(in) :: set
   !> Forces on held points, shape (fields, nh) [force]
   real(wp), intent(in) :: held(:, :)
   real(wp), intent(in) :: x(:)
   !> Point about which the moment is wanted [length]
   real(wp), intent(in), optional :: about(3)
   !> Motion of each source point, shape (ns) [-]
   real(wp), intent(in), optional :: motion(:)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   real(wp) :: force(3), own(3), arm(3), u(size(held, 1), self%points%shape%nq)
   integer :: e, i

   force = 0.0_wp
   do e = 1, size(self%at%set)
      if (.not. self%at%in_set(e, set)) cycle
      own = 0.0_wp
      do i = 1, size(held, 1)
         if (self%by(i, e)) own(i) = held(i, self%place(e)) &
            & /count(self%by(i, :) .and. self%place == self%place(e))
      end do
      if (present(about)) then
         associate (h => self%place(e))
            call self%points%shape%interpolate(h, x, 1, 1, u)
            arm = -about
            arm(:size(self%x, 1)) = arm(:size(self%x, 1)) + self%x(:, h)
            arm(:size(u, 1)) = arm(:size(u, 1)) + u(:, 1)
         end associate
         own = vector_product(arm, own)
      else if (present(motion)) then
         call self%points%shape%row(self%place(e), nodes, values)
         own = dot_product(values(1, :), motion(nodes))*own
      end if
      force = force + own
   end do
end function set_force

end module rk_held
