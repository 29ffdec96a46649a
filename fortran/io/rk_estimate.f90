!> What a deck will cost, from its counts alone.
module rk_estimate
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type
   use rk_precision, only : wp
   use rk_shape, only : derivative_count
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
      !> Least squares solver
      character(len=:), allocatable :: solver
      !> Memory at its peak [byte]
      real(wp) :: bytes = 0.0_wp
      !> Floating point operations of one least squares solve
      real(wp) :: flops = 0.0_wp
   end type estimate_type

contains

!> Estimate sizes, memory and operations
function estimate_cost(deck, model) result(self)
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Points of the model file
   type(cloud_type), intent(in) :: model
   type(estimate_type) :: self
   real(wp), allocatable :: support(:)
   integer, allocatable :: source(:), collocation(:)
   character(len=:), allocatable :: problem
   real(wp) :: entries, boundary, width
   integer :: d, nq, fields

   call deck%get('scene.dimension', self%nd)
   call deck%get('solver.linear', self%solver)
   call deck%get('approximation.support', support)
   if (deck%has('geometry.source')) then
      call deck%get('geometry.source', source)
      call deck%get('geometry.collocation', collocation)
      self%ns = product(real(source, wp))
      self%nc = product(real(collocation, wp))
      boundary = self%nc - product(max(real(collocation, wp) - 2.0_wp, 0.0_wp))
   else
      self%ns = size(model%source, 2)
      self%nc = size(model%place, 2)
      boundary = size(model%point)
   end if
   self%neighbours = 1.0_wp
   do d = 1, self%nd
      self%neighbours = self%neighbours*(2.0_wp*support(min(d, size(support))) - 0.5_wp)
   end do
   self%neighbours = min(self%neighbours, self%ns)
   nq = derivative_count(self%nd)
   call deck%get('linear.problem', problem)
   fields = merge(1, self%nd, problem == 'poisson')
   self%unknowns = fields*self%ns
   self%equations = fields*(self%nc + boundary)
   if (problem /= '') self%equations = fields*self%nc

   ! neighbour lists both ways; coefficients of rows; values, at worst one stencil for each point
   entries = self%nc*self%neighbours
   self%bytes = 20.0_wp*entries + 8.0_wp*fields**2*nq*(self%nc + boundary)
   if (.not. deck%has('geometry.source')) self%bytes = self%bytes + 8.0_wp*nq*entries
   if (self%solver == 'dgels') then
      self%bytes = self%bytes + 8.0_wp*self%equations*self%unknowns
      self%flops = 2.0_wp*self%equations*self%unknowns**2
   else
      width = fields*self%neighbours
      self%bytes = self%bytes + 8.0_wp*self%unknowns**2 + 8.0_wp*8.0_wp*width**2
      self%flops = self%equations*width**2 + self%unknowns**3/3.0_wp
   end if
end function estimate_cost

end module rk_estimate
