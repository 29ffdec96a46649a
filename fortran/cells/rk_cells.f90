!> Integration of weak forms: points with weights in groups, and the surface.
!>
!> Gauss points lie in the cells between the source points of a lattice. Nodal cells belong to one
!> source point each; their gradients are smoothed over the cell's facets, which neighbours share:
!> the integral of a gradient over the body is then exactly the integral of values over the surface.
!> Cells cut by the surface of the body keep their gradients and are weighted by their filled
!> fraction: constant gradients are still exact, and the energy is that of the body's volume. At
!> Gauss points the mean gradient of each cell is corrected to the same end. Points come in groups,
!> within which the volume change is projected.
!>
!> Reference: Chen, Wu, Yoon, You, Int. J. Numer. Meth. Engng 50 (2001),
!>            doi:10.1002/1097-0207(20010120)50:2<435::AID-NME32>3.0.CO;2-A
module rk_cells
   use rk_precision, only : wp
   implicit none
   private

   public :: cells_type

   !> Integration points and surface of a body
   type :: cells_type
      !> Gradients are smoothed over facets
      logical :: smoothed = .false.
      !> The facets of each cell close to rounding
      logical :: closed = .true.
      !> The linear part of the gradient in a cell follows from its facets as well
      logical :: linear = .false.
      !> Number of points of a cell, which are stored consecutively
      integer :: per_cell = 1
      !> Points, those of a group together, shape (nd, np) [length]
      real(wp), allocatable :: point(:, :)
      !> Source point of each nodal cell, shape (np), repeated for a cell that belongs to several
      !> groups; not allocated for Gauss points
      integer, allocatable :: node(:)
      !> Volume of each point, shape (np) [length^nd]
      real(wp), allocatable :: weight(:)
      !> Volume of each point over the volume enclosed by its facets, shape (np) [-]; not allocated
      !> where they are equal
      real(wp), allocatable :: filled(:)
      !> Group g has points first(g)+1 : first(g+1), shape (groups + 1)
      integer, allocatable :: first(:)
      !> Directions in which a group is too thin for a pressure that varies, shape (nd, groups); not
      !> allocated if there are none
      logical, allocatable :: thin(:, :)
      !> Points of facets between cells, shape (nd, facets) [length]
      real(wp), allocatable :: facet(:, :)
      !> Area times normal of each, shape (nd, facets) [length^(nd-1)]
      real(wp), allocatable :: area(:, :)
      !> Cells on both sides; the normal points from the first to the second, shape (2, facets)
      integer, allocatable :: side(:, :)
      !> Points of the surface, shape (nd, ms) [length]
      real(wp), allocatable :: surface(:, :)
      !> Places where conditions act, shape (nd, ms) [length]: those of the surface, in a model the
      !> nearest ones of its smooth surface. Values prescribed on the steps between voxels would
      !> hold the body at their edges, a quarter to half of a voxel inside
      real(wp), allocatable :: place(:, :)
      !> Outward normal times area, shape (nd, ms) [length^(nd-1)]
      real(wp), allocatable :: outward(:, :)
      !> Area of the body behind each over that of the facet, shape (ms) [-]
      real(wp), allocatable :: part(:)
      !> Side of the body that each lies on, shape (ms)
      integer, allocatable :: set(:)
      !> Face of a Gauss cell in a lattice that each lies on, shape (ms); not allocated elsewhere
      integer, allocatable :: face(:)
      !> Boundary entry represented by each, 0 for none, shape (ms); not allocated where surface
      !> points have positions of their own
      integer, allocatable :: entry(:)
      !> Whether each lies in a boundary set, shape (sets, ms); not allocated where it lies only in
      !> the set of its side
      logical, allocatable :: within(:, :)
      !> Values of surface point s lifted into the body reach points
      !> lift_point(lift_first(s)+1 : lift_first(s+1)), shape (ms + 1)
      integer, allocatable :: lift_first(:)
      integer, allocatable :: lift_point(:)
      !> with these factors [1/length^nd], which with the points' weights reproduce polynomials at s
      real(wp), allocatable :: lift(:)
      !> Second moments of each nodal cell about its point, shape (nd, nd, np) [length^(nd+2)]
      real(wp), allocatable :: moment(:, :, :)
   contains
      procedure :: in_set
   end type cells_type

contains

!> Whether a surface point lies in a boundary set
elemental logical function in_set(self, s, set)
   class(cells_type), intent(in) :: self
   !> Surface point
   integer, intent(in) :: s
   integer, intent(in) :: set

   if (allocated(self%within)) then
      in_set = self%within(set, s)
   else
      in_set = self%set(s) == set
   end if
end function in_set

end module rk_cells
