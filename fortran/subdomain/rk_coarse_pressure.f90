!> Pressure on a cloud of its own, coarser than that of the displacement, with one balance of volume
!> for each of its points.
!>
!> Pressures at every source point have modes that no displacement balances; at every second one in
!> each direction they have none, and the smallest singular value of the constraint does not fall
!> with the spacing. The balance of a patch is that of the flux x . cof(F) N / nd through its
!> facets: no second derivatives, and what leaves one patch enters the next.
module rk_coarse_pressure
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_facets, only : facets_type
   use rk_flux_points, only : close_points, flux_points, ray_points
   use rk_lattice, only : new_annulus, new_box
   use rk_lattice_patches, only : lattice_patches
   use rk_mixture, only : mixture_type, new_mixture
   use rk_neighbours, only : nearest_points
   use rk_octants, only : octant_patches
   use rk_precision, only : i8, wp
   use rk_scene, only : scene_type
   use rk_shape, only : approximation_type, new_shape, shape_type
   use rk_voxel_lattice, only : corner_lattice
   implicit none
   private

   public :: coarse_pressure, new_coarse_pressure, local_part

   !> Pressures of a body
   type :: coarse_pressure
      !> Their number
      integer :: n = 0
      !> Points and supports, shape (nd, n) [length]
      real(wp), allocatable :: point(:, :), support(:, :)
      !> Functions
      type(approximation_type) :: approximation
      !> Facets of the patches, with the functions of the displacement
      type(flux_points) :: patch
      !> Volume of each patch, shape (n) [length^nd]
      real(wp), allocatable :: volume(:)
      !> Integral of each pressure function over the bulk modulus, in compressed rows of patches,
      !> and which functions these are; empty where K is infinite [length^nd/stress]
      real(wp), allocatable :: compliance(:)
      integer, allocatable :: column(:)
      integer(i8), allocatable :: first(:)
   contains
      !> Functions at places
      procedure :: shape_at
      !> Bulk moduli, anew
      procedure :: set_compliance
      !> Pressure at a place
      procedure :: at_place
   end type coarse_pressure

contains

!> Set up the pressures of a lattice or of a model of voxels
subroutine new_coarse_pressure(self, scene, error)
   !> Pressures
   type(coarse_pressure), intent(out) :: self
   !> Scene
   type(scene_type), target, intent(in) :: scene
   !> Error handling: neither of both, too few points
   type(error_type), allocatable, intent(out) :: error
   type(facets_type) :: facets
   integer :: d, is, order

   ! one order less than the displacement, where the points are enough for it; the least singular
   ! value of the constraint falls with the spacing for pressures of order 3
   order = max(1, min(2, scene%approximation%order - 1))
   if (allocated(scene%cloud%lattice)) then
      call on_lattice(self, facets, scene, order, error)
      if (allocated(error)) return
      self%support = (order + 1)*self%support
   else if (allocated(scene%cloud%voxels%index) .and. scene%cloud%nd == 3) then
      call on_blocks(self, facets, scene)
      ! places at the surface may lie a spacing beyond the last points: functions of order 1 reach
      ! two layers of these
      order = 1
      self%support = 3.0_wp*self%support
   else
      call fatal_error(error, err_input, 'method "'//scene%method//'" needs the lattice of a ' &
         & //'box or an annulus, or a model of voxels, for its pressures have a coarser one: ' &
         & //trim(merge('use method "rkpm-scni"                        ', &
         & 'build it from a label map, or use "rkcm-mixed"', &
         & allocated(scene%cloud%voxels%index))))
      return
   end if
   self%n = size(self%point, 2)
   self%approximation = scene%approximation
   self%approximation%order = order
   associate (n => facets%n)
      self%patch%x = facets%x(:, :n)
      self%patch%area = facets%area(:, :n)
      self%patch%side = facets%side(:, :n)
   end associate
   call scene%shape_at(self%patch%x, self%patch%shape, error, first=.true.)
   if (allocated(error)) return
   call close_points(self%patch, self%n)
   self%volume = [(0.0_wp, is=1, self%n)]
   do d = 1, size(self%point, 1)
      associate (flux => self%patch%x(d:d, :)*self%patch%area(d:d, :)/size(self%point, 1))
         self%volume = self%volume + reshape(self%patch%balance(flux), [self%n])
      end associate
   end do
   call self%set_compliance(scene, error)
end subroutine new_coarse_pressure

!> Every second point of a lattice
subroutine on_lattice(self, facets, scene, order, error)
   !> Pressures, of which points and spacings (for supports) are set
   type(coarse_pressure), intent(inout) :: self
   !> Facets of their patches
   type(facets_type), intent(inout) :: facets
   !> Scene
   type(scene_type), intent(in) :: scene
   !> Order of the functions, lower where the points are too few
   integer, intent(inout) :: order
   !> Error handling: too few points
   type(error_type), allocatable, intent(out) :: error
   type(cloud_type) :: coarse
   real(wp) :: radius(2)
   integer, allocatable :: count(:)

   associate (cloud => scene%cloud)
      if (any(cloud%lattice < 3)) then
         call fatal_error(error, err_input, 'method "'//scene%method//'" needs 3 source points ' &
            & //'in each direction, for pressures stand at every second one: raise geometry.source')
         return
      end if
      count = max(2, (cloud%lattice - 1)/scene%subdomain%pressure_spacing + 1)
      if (cloud%polar) then
         radius = [minval(norm2(cloud%source, dim=1)), maxval(norm2(cloud%source, dim=1))]
         call new_annulus(coarse, radius(1), radius(2), count, count, error)
      else
         call new_box(coarse, maxval(cloud%source, dim=2), count, count, error)
      end if
      if (allocated(error)) return
   end associate
   if (any(count <= order)) order = 1
   self%point = coarse%source
   self%support = coarse%spacing
   call lattice_patches(facets, coarse)
end subroutine on_lattice

!> Every second corner of the blocks of a model
subroutine on_blocks(self, facets, scene)
   !> Pressures, of which points and spacings (for supports) are set
   type(coarse_pressure), intent(inout) :: self
   !> Facets of their patches
   type(facets_type), intent(inout) :: facets
   !> Scene
   type(scene_type), intent(in) :: scene
   real(wp) :: low(3), step(3)
   integer :: blocks(3), coarse(3)

   call corner_lattice(scene%cloud, [integer ::], spread(.false., 1, 3), low, step, blocks)
   coarse = max(1, blocks/scene%subdomain%pressure_spacing)
   call octant_patches(facets, scene%cloud, coarse, self%point)
   self%support = spread(step*blocks/coarse, 2, size(self%point, 2))
end subroutine on_blocks

!> Functions of the pressure at places
subroutine shape_at(self, place, shape, error)
   !> Pressures
   class(coarse_pressure), intent(in) :: self
   !> Places, shape (nd, np) [length]
   real(wp), intent(in) :: place(:, :)
   !> Functions
   type(shape_type), intent(out) :: shape
   !> Error handling: a place that too few points cover
   type(error_type), allocatable, intent(out) :: error

   call new_shape(shape, self%approximation, self%point, self%support, place, error, &
      & first=.true.)
   if (allocated(error)) error%message = 'pressures: '//error%message
end subroutine shape_at

!> Part of the bulk modulus that acts at each place and not through the pressures: a share of the
!> shear modulus
pure real(wp) function local_part(mixture, ip, share) result(bulk)
   !> Materials
   type(mixture_type), intent(in) :: mixture
   !> Place
   integer, intent(in) :: ip
   !> Share [-]
   real(wp), intent(in) :: share
   real(wp), parameter :: rest(3, 3) = reshape([1, 0, 0, 0, 1, 0, 0, 0, 1], [3, 3])

   ! the pressures need a modulus of their own
   bulk = min(0.5_wp*mixture%bulk_at_one_pressure(ip), share*mixture%shear_modulus(ip, rest))
end function local_part

!> Integrals of the pressures' functions over the bulk modulus that they stand for
subroutine set_compliance(self, scene, error)
   !> Pressures with their patches
   class(coarse_pressure), intent(inout) :: self
   !> Scene
   type(scene_type), target, intent(in) :: scene
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   type(mixture_type) :: mixture
   type(shape_type), target :: shape
   real(wp), allocatable :: x(:, :), weight(:), total(:)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer, allocatable :: cell(:)
   real(wp) :: stiffness
   integer :: b, i, k, m, q

   call ray_points(self%patch, self%point, x, weight, cell)
   call new_mixture(mixture, scene, x, nearest_points(scene%cloud%centres(), x), error)
   if (.not. allocated(error)) call self%shape_at(x, shape, error)
   if (allocated(error)) return
   self%first = [(0_i8, i=0, self%n)]
   self%column = [integer ::]
   self%compliance = [real(wp) ::]
   allocate (total(self%n), source=0.0_wp)
   q = 0
   do i = 1, self%n
      m = int(self%patch%cell%offset(i + 1) - self%patch%cell%offset(i))
      do k = 1, 2*m
         q = q + 1
         stiffness = mixture%bulk_at_one_pressure(q) &
            & - local_part(mixture, q, scene%subdomain%local_bulk)
         if (stiffness > huge(1.0_wp)) cycle
         call shape%row(q, nodes, values)
         total(nodes) = total(nodes) + weight(q)/stiffness*values(1, :)
      end do
      self%column = [self%column, pack([(b, b=1, self%n)], abs(total) > 0.0_wp)]
      self%compliance = [self%compliance, pack(total, abs(total) > 0.0_wp)]
      self%first(i + 1) = size(self%column, kind=i8)
      total = 0.0_wp
   end do
end subroutine set_compliance

!> Pressure at a place
real(wp) function at_place(self, x, value) result(pressure)
   !> Pressures
   class(coarse_pressure), intent(in) :: self
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Coefficients, shape (n) [stress]
   real(wp), intent(in) :: value(:)
   type(error_type), allocatable :: error
   type(shape_type) :: shape
   real(wp) :: field(1, 10)

   pressure = 0.0_wp
   call self%shape_at(reshape(x, [size(x), 1]), shape, error)
   if (allocated(error)) return
   call shape%interpolate(1, value, 1, 1, field(:, :shape%nq))
   pressure = field(1, 1)
end function at_place

end module rk_coarse_pressure
