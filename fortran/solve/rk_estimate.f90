!> Estimated cost of a deck, from its counts alone.
module rk_estimate
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_deck_blocks, only : put_corners
   use rk_precision, only : wp
   use rk_shape, only : derivative_count
   use rk_text, only : to_text
   implicit none
   private

   public :: estimate_type, estimate_cost

   !> Sizes and cost of a full solve
   type :: estimate_type
      !> Space dimension
      integer :: nd = 3
      !> Source points, collocation points
      real(wp) :: ns = 0.0_wp
      real(wp) :: nc = 0.0_wp
      !> Unknowns and equations; the boundary rows are an estimate
      real(wp) :: unknowns = 0.0_wp
      real(wp) :: equations = 0.0_wp
      !> Neighbours of a point, inside the body
      real(wp) :: neighbours = 0.0_wp
      !> Places of integration or rows, and source points at each of them
      real(wp) :: places = 0.0_wp
      real(wp) :: members = 0.0_wp
      !> Entries of a tangent that is formed; 0 for least squares
      real(wp) :: entries = 0.0_wp
      !> Least squares solver
      character(len=:), allocatable :: solver
      !> Memory at its peak [byte]
      real(wp) :: bytes = 0.0_wp
      !> Floating point operations of one solve
      real(wp) :: flops = 0.0_wp
      !> The factor of a solid serves several iterations
      logical :: keeps_factor = .false.
   end type estimate_type

   !> Iterations of a solve by minimal residuals, as needed by a block of 80,000 points
   real(wp), parameter :: most_iterations = 600.0_wp
   !> Memory of the program before a problem, and of a point beside its neighbours [byte]
   real(wp), parameter :: of_libraries = 3.0e7_wp, of_point = 1700.0_wp
   !> Operations of UMFPACK's factors over those of a band's Cholesky factor: within a factor of 2
   !> on boxes of 434 to 6338 unknowns in 2D and 3D
   real(wp), parameter :: lu_over_cholesky = 10.0_wp

contains

!> Estimate sizes, memory and operations
function estimate_cost(deck, model) result(self)
   type(deck_type), intent(in) :: deck
   !> Points of the model file
   type(cloud_type), intent(in) :: model
   type(estimate_type) :: self
   type(cloud_type) :: points
   real(wp), allocatable :: support(:)
   integer, allocatable :: source(:), collocation(:)
   character(len=:), allocatable :: method, problem
   real(wp) :: layers(3), entries, boundary, cells, width, reach, dense, envelope, normal
   integer :: d, equations, fields, nq

   call deck%get('scene.dimension', self%nd)
   call deck%get('solver.linear', self%solver)
   call deck%get('approximation.support', support)
   if (deck%has('geometry.source')) then
      call deck%get('geometry.source', source)
      call deck%get('geometry.collocation', collocation)
      self%ns = product(real(source, wp))
      self%nc = product(real(collocation, wp))
      layers(:self%nd) = real(source, wp)
      boundary = self%nc - product(max(real(collocation, wp) - 2.0_wp, 0.0_wp))
   else
      points = model
      call put_corners(points, deck)
      self%ns = size(points%source, 2)
      self%nc = size(points%points, 2)
      boundary = size(points%boundary_point)
      do d = 1, self%nd
         layers(d) = (maxval(points%source(d, :)) - minval(points%source(d, :))) &
            & /minval(points%spacing(d, :)) + 1.0_wp
      end do
   end if
   self%neighbours = 1.0_wp
   reach = 1.0_wp
   do d = 1, self%nd
      ! neighbours of a place, and the part of the body with which a source point shares places
      width = 2.0_wp*support(min(d, size(support)))
      self%neighbours = self%neighbours*(width - 0.5_wp)
      reach = min(reach, width/layers(d))
   end do
   self%neighbours = min(self%neighbours, self%ns)
   nq = derivative_count(self%nd)
   call deck%get('scene.method', method)
   call deck%get('linear.problem', problem)
   fields = merge(1, self%nd, problem == 'poisson')
   if (method(:min(4, len(method))) == 'rkpm') then
      call estimate_galerkin(self, deck, method, fields, support, layers)
      return
   end if
   equations = fields
   cells = 0.0_wp
   if (method == 'rkcm-mixed') then
      fields = self%nd + 1
      cells = self%ns
   end if
   self%unknowns = fields*self%ns
   self%equations = equations*(self%nc + boundary) + cells
   if (problem /= '') self%equations = equations*self%nc
   self%places = self%nc + cells
   self%members = self%neighbours

   ! neighbour lists in both directions; row coefficients; values, at worst one stencil per point
   entries = (self%nc + cells)*self%neighbours
   self%bytes = 32.0_wp*entries + 8.0_wp*equations*fields*nq*(self%nc + boundary + cells)
   if (.not. deck%has('geometry.source')) self%bytes = self%bytes + 8.0_wp*nq*entries
   dense = 8.0_wp*self%equations*self%unknowns
   envelope = 8.0_wp*self%unknowns**2*reach*(1.0_wp - 0.5_wp*reach)
   width = fields*self%neighbours
   normal = self%equations*width**2
   entries = self%equations*width
   select case (self%solver)
   case ('dgels', 'dgelsy')
      self%bytes = self%bytes + dense
      self%flops = 2.0_wp*self%equations*self%unknowns**2
   case ('spqr')
      ! rows and columns, and a triangle that fills
      self%bytes = self%bytes + 32.0_wp*entries + 2.0_wp*envelope
      self%flops = 2.0_wp*self%equations*(self%unknowns*reach)**2
   case default
      self%bytes = self%bytes + envelope + 4.0_wp*8.0_wp*width**2
      self%flops = normal + self%unknowns**3*reach**2*(1.0_wp - 2.0_wp/3.0_wp*reach)
   end select
end function estimate_cost

!> Sizes, memory and operations of the Galerkin form
subroutine estimate_galerkin(self, deck, method, fields, support, layers)
   !> Estimate with dimension, points and neighbours
   type(estimate_type), intent(inout) :: self
   type(deck_type), intent(in) :: deck
   character(len=*), intent(in) :: method
   !> Unknowns of a source point
   integer, intent(in) :: fields
   !> Support in spacings
   real(wp), intent(in) :: support(:)
   !> Source points along each direction
   real(wp), intent(in) :: layers(:)
   character(len=:), allocatable :: kind
   logical :: single
   real(wp) :: coupled, most, band, width, factor, bulk, displacements
   integer :: d, gauss, limit

   self%places = self%ns
   call deck%get('galerkin.direct_limit', limit)
   call deck%get('geometry.kind', kind)
   gauss = 1
   if (method == 'rkpm-gauss') then
      call deck%get('galerkin.gauss', gauss)
      self%places = self%ns*gauss**self%nd
   end if
   self%solver = 'direct'
   ! a plate at the end of a tendon moves as one more point
   self%unknowns = fields*(self%ns + count([(deck%has('boundary.'//to_text(d)//'.tendon'), &
      & d=1, deck%count('boundary'))]))
   displacements = self%unknowns
   ! K = inf: two blocks of unknowns for the pressures of a group, and LU in place of Cholesky
   factor = 1.0_wp
   do d = 1, deck%count('material')
      bulk = 0.0_wp
      call deck%get('material.'//to_text(d)//'.K', bulk)
      if (bulk > huge(1.0_wp)) factor = lu_over_cholesky
   end do
   if (factor > 1.0_wp) self%unknowns = self%unknowns &
      & + 2*self%nd*product(ceiling(0.5_wp*(layers(:self%nd) - 1.0_wp)))
   self%equations = self%unknowns
   ! source points of a group of 2 x 2 (x 2) cells, and those coupled with one of them, at most and
   ! on average: every second one shares one group with those on a side, and few lie beyond sides
   self%members = 1.0_wp
   coupled = 1.0_wp
   most = 1.0_wp
   do d = 1, self%nd
      width = 2.0_wp*support(min(d, size(support)))
      self%members = self%members*min(width + 1.0_wp, layers(d))
      most = most*min(2.0_wp*width + 1.0_wp, layers(d))
      coupled = coupled*merge(2.0_wp*width - width**2/layers(d), layers(d), layers(d) > width)
   end do
   ! unknowns of the layers that couple through a section, the band of the factor at worst
   band = self%unknowns*min(1.0_wp, 0.5_wp*(most**(1.0_wp/self%nd))/maxval(layers(:self%nd)))
   ! neighbours and gradients at the points, materials and states; entries, for nodal cells twice
   ! for their stabilisation; the factor, in single precision for solids, otherwise with rows of the
   ! entries
   single = fields == 3 .and. factor <= 1.0_wp
   self%keeps_factor = single
   self%entries = 0.5_wp*fields**2*self%ns*coupled
   self%bytes = of_libraries + self%places*(self%neighbours*8.0_wp*(self%nd + 1.0_wp) + of_point) &
      & + 4.0_wp*self%nc*self%neighbours &
      & + merge(8.0_wp, 16.0_wp, method == 'rkpm-gauss')*self%entries &
      & + merge(4.0_wp*self%unknowns*band, 8.0_wp*(self%unknowns*band + self%entries), single)
   self%flops = merge(0.5_wp, factor, single)*self%unknowns*band**2
   if (displacements <= limit .or. (method == 'rkpm-gauss' .and. kind == 'annulus')) return
   ! not formed: moduli, gradients at the points, the constant part of one component, matrices of
   ! seven entries per point with their levels and vectors, and the work of an iteration over all
   ! points
   self%solver = 'minres'
   self%keeps_factor = .false.
   self%bytes = self%places*8.0_wp*(2.0_wp*81.0_wp + self%members*(3.0_wp*self%nd + 2.0_wp)) &
      & + 12.0_wp*self%ns*(coupled + 25.0_wp*self%nd)
   self%entries = 0.0_wp
   self%flops = most_iterations*self%places*(self%nd**4 + self%members*4.0_wp*self%nd**2)
end subroutine estimate_galerkin

end module rk_estimate
