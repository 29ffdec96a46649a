!> What is prescribed on the surface, for balances of cells: components of the displacement that are
!> held at points of cells, in place of these cells' balances, and tractions at points of facets.
module rk_subdomain_boundary
   use rk_cloud, only : cloud_type
   use rk_conditions, only : conditions_at
   use rk_error, only : error_type, fatal_error, err_input
   use rk_flux_points, only : flux_points
   use rk_precision, only : wp
   use rk_programme, only : ramp
   use rk_scene, only : scene_type
   use rk_shape, only : shape_type
   use rk_text, only : to_text
   implicit none
   private

   public :: subdomain_boundary, new_subdomain_boundary

   !> Conditions of a body
   type :: subdomain_boundary
      !> Facet points 1 to this one lie inside, the others on the surface
      integer :: inner = 0
      !> Whether each point of the surface lies in a boundary set, shape (sets, ms)
      logical, allocatable :: inside(:, :)
      !> Area of the body behind each over that of the facet, shape (ms) [-]
      real(wp), allocatable :: part(:)
      !> Components that are prescribed there, shape (nd, ms)
      logical, allocatable :: essential(:, :)
      !> Traction of each load factor there, shape (factors, nd, ms) [force/area]
      real(wp), allocatable :: traction(:, :, :)
      !> Pressure that follows the surface, of each load factor, shape (factors, ms) [force/area],
      !> and stiffness of springs, shape (nd, ms) [force/length^3]; not allocated where there is
      !> none
      real(wp), allocatable :: pressure(:, :), spring(:, :)
      !> Whether what is prescribed there holds its cell, shape (ms): a cell of moved points may
      !> touch a wall that its point does not lie in
      logical, allocatable :: own(:)
      !> Components held in place of the balance of each cell, shape (nd, cells)
      logical, allocatable :: held(:, :)
      !> Cells of which some component is held, and the number of each cell among them
      integer, allocatable :: cell(:), number(:)
      !> Displacement of each load factor, shape (factors, nd, held cells) [length]
      real(wp), allocatable :: value(:, :, :)
      !> Places where they are held, shape (nd, held cells) [length], with functions there
      real(wp), allocatable :: place(:, :)
      type(shape_type) :: shape
      !> Share of each point of the surface in the reaction of its cell, shape (nd, ms) [-]
      real(wp), allocatable :: share(:, :)
   contains
      !> Whether stress acts at a point of the surface in some cell's balance
      procedure :: stressed
      !> Whether the displacement counts there
      procedure :: deforms
   end type subdomain_boundary

   !> Source points nearer to a facet's plane than this lie in it, of the spacing [-]
   real(wp), parameter :: contact = 1.0e-6_wp

contains

!> Find what is prescribed
subroutine new_subdomain_boundary(self, scene, points, inner, inside, part, error)
   !> Conditions
   type(subdomain_boundary), intent(out) :: self
   !> Scene
   type(scene_type), intent(in) :: scene
   !> Points of the facets of all cells, those of the surface last
   type(flux_points), intent(in) :: points
   !> Number of those inside
   integer, intent(in) :: inner
   !> Whether each on the surface lies in a boundary set, shape (sets, ms)
   logical, intent(in) :: inside(:, :)
   !> Area of the body behind each over that of the facet, shape (ms) [-]
   real(wp), intent(in) :: part(:)
   !> Error handling: conditions that contradict each other
   type(error_type), allocatable, intent(out) :: error
   real(wp), dimension(scene%programme%count(), 3) :: value, traction
   integer :: c, i, n, nd, ns, s
   logical :: fixed(3), on_surface(size(scene%cloud%source, 2))

   n = scene%programme%count()
   on_surface = .false.
   nd = scene%cloud%nd
   ns = size(scene%cloud%source, 2)
   self%inner = inner
   self%inside = inside
   self%part = part
   allocate (self%essential(nd, size(part)), self%traction(n, nd, size(part)))
   allocate (self%own(size(part)), self%held(nd, ns), source=.false.)
   do s = 1, size(part)
      associate (x => points%x(:, inner + s), cell => points%side(1, inner + s), &
         & area => points%area(:, inner + s))
         call conditions_at(scene%cloud, scene%condition, inside(scene%condition%set, s), x, &
            & fixed, value, traction, error)
         if (allocated(error)) return
         self%essential(:, s) = fixed(:nd)
         do i = 1, nd
            self%traction(:, i, s) = merge(0.0_wp, traction(:, i), fixed(i))
         end do
         ! a cell of moved points whose own lies off the surface keeps its balance; that of a model,
         ! whose points lie on no curved surface, is held in the middle of its facets there
         if (in_plane(scene%cloud, x, area, cell)) then
            on_surface(cell) = on_surface(cell) .or. any(fixed(:nd))
         else if (allocated(scene%cloud%lattice)) then
            cycle
         end if
         self%own(s) = .true.
         self%held(:, cell) = self%held(:, cell) .or. fixed(:nd)
      end associate
   end do
   self%cell = pack([(i, i=1, ns)], any(self%held, dim=1))
   allocate (self%number(ns), source=0)
   self%number(self%cell) = [(i, i=1, size(self%cell))]
   self%place = scene%cloud%source(:, self%cell)
   do i = 1, size(self%cell)
      if (.not. on_surface(self%cell(i))) self%place(:, i) = middle_of(self, points, self%cell(i))
   end do
   call hold(self, scene, points, error)
   if (allocated(error)) return
   call scene%shape_at(self%place, self%shape, error, first=.true.)
   if (allocated(error)) return
   call share_reactions(self, points)
   if (any(abs(scene%condition%pressure) > 0.0_wp)) &
      & allocate (self%pressure(n, size(part)), source=0.0_wp)
   if (any([(scene%condition(c)%spring > 0.0_wp, c=1, size(scene%condition))])) &
      & allocate (self%spring(nd, size(part)), source=0.0_wp)
   do c = 1, size(scene%condition)
      associate (condition => scene%condition(c))
         do s = 1, size(part)
            if (.not. inside(condition%set, s)) cycle
            if (allocated(self%pressure)) self%pressure(ramp + condition%amplitude, s) &
               & = self%pressure(ramp + condition%amplitude, s) + condition%pressure
            if (allocated(self%spring)) self%spring(:, s) = self%spring(:, s) &
               & + condition%spring(:nd)
         end do
      end associate
   end do
end subroutine new_subdomain_boundary

!> Whether the source point of a cell lies in the plane of a facet of it
pure logical function in_plane(cloud, x, area, cell)
   !> Cloud
   type(cloud_type), intent(in) :: cloud
   !> Point of the facet, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Area times normal, shape (nd) [length^(nd-1)]
   real(wp), intent(in) :: area(:)
   !> Cell
   integer, intent(in) :: cell

   in_plane = abs(dot_product(area, x - cloud%source(:, cell))) &
      & < contact*minval(cloud%spacing(:, cell))*norm2(area)
end function in_plane

!> Middle of the facets of a cell that are held
pure function middle_of(self, points, cell) result(x)
   !> Conditions
   type(subdomain_boundary), intent(in) :: self
   !> Points of facets
   type(flux_points), intent(in) :: points
   !> Cell
   integer, intent(in) :: cell
   !> Place [length]
   real(wp) :: x(size(points%x, 1))
   real(wp) :: area
   integer :: s

   x = 0.0_wp
   area = 0.0_wp
   do s = 1, size(self%part)
      associate (q => self%inner + s)
         if (points%side(1, q) /= cell .or. .not. any(self%essential(:, s))) cycle
         area = area + norm2(points%area(:, q))
         x = x + norm2(points%area(:, q))*points%x(:, q)
      end associate
   end do
   x = x/area
end function middle_of

!> Displacements of the held cells
subroutine hold(self, scene, points, error)
   !> Conditions with held cells
   type(subdomain_boundary), intent(inout) :: self
   !> Scene
   type(scene_type), intent(in) :: scene
   !> Points of facets
   type(flux_points), intent(in) :: points
   !> Error handling: conditions that contradict each other
   type(error_type), allocatable, intent(out) :: error
   real(wp), dimension(scene%programme%count(), 3) :: value, traction
   logical, allocatable :: given(:, :)
   logical :: fixed(3)
   integer :: cell, i, k, nd, s

   nd = scene%cloud%nd
   allocate (self%value(size(value, 1), nd, size(self%cell)), source=0.0_wp)
   allocate (given(nd, size(self%cell)), source=.false.)
   do s = 1, size(self%part)
      if (.not. (any(self%essential(:, s)) .and. self%own(s))) cycle
      cell = points%side(1, self%inner + s)
      k = self%number(cell)
      call conditions_at(scene%cloud, scene%condition, self%inside(scene%condition%set, s), &
         & self%place(:, k), fixed, value, traction, error)
      if (allocated(error)) return
      do i = 1, nd
         if (.not. (fixed(i) .and. self%held(i, cell))) cycle
         if (given(i, k) .and. any(abs(self%value(:, i, k) - value(:, i)) > 1.0e-9_wp &
            & *max(maxval(abs(value(:, i))), 1.0e-3_wp))) then
            call fatal_error(error, err_input, 'boundary sets prescribe two displacements for ' &
               & //'component '//to_text(i)//' at '//to_text(self%place(:, k)))
            return
         end if
         given(i, k) = .true.
         self%value(:, i, k) = value(:, i)
      end do
   end do
end subroutine hold

!> What the balance of a held cell leaves belongs to the facets in which it is held, by their area:
!> another wall that the cell touches bears the stress there alone
subroutine share_reactions(self, points)
   !> Conditions with held cells
   type(subdomain_boundary), intent(inout) :: self
   !> Points of facets
   type(flux_points), intent(in) :: points
   real(wp) :: total(size(self%held, 1), size(self%held, 2)), area(size(self%part))
   integer :: s

   total = 0.0_wp
   allocate (self%share(size(self%held, 1), size(self%part)), source=0.0_wp)
   do s = 1, size(self%part)
      associate (cell => points%side(1, self%inner + s))
         area(s) = self%part(s)*norm2(points%area(:, self%inner + s))
         total(:, cell) = total(:, cell) + merge(area(s), 0.0_wp, self%essential(:, s) &
            & .and. self%own(s))
      end associate
   end do
   do s = 1, size(self%part)
      where (self%essential(:, s) .and. self%own(s)) self%share(:, s) = area(s) &
         & /total(:, points%side(1, self%inner + s))
   end do
end subroutine share_reactions

!> Whether stress acts at a point of the surface in its cell's balance: a wall holds it there, but
!> not the cell
pure logical function stressed(self, s, cell)
   !> Conditions
   class(subdomain_boundary), intent(in) :: self
   !> Point of the surface
   integer, intent(in) :: s
   !> Its cell
   integer, intent(in) :: cell

   stressed = any(self%essential(:, s) .and. .not. self%held(:, cell))
end function stressed

!> Whether forces at a point of the surface depend on the displacement there
pure logical function deforms(self, s)
   !> Conditions
   class(subdomain_boundary), intent(in) :: self
   !> Point of the surface
   integer, intent(in) :: s

   deforms = .false.
   if (allocated(self%pressure)) deforms = any(abs(self%pressure(:, s)) > 0.0_wp)
   if (allocated(self%spring)) deforms = deforms .or. any(self%spring(:, s) > 0.0_wp)
end function deforms

end module rk_subdomain_boundary
