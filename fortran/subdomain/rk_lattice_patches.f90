!> Facets of the cells of a coarse lattice, with points as dense as those of a lattice twice as
!> fine: what goes through them varies with the displacement, not with the pressure.
module rk_lattice_patches
   use rk_cloud, only : cloud_type
   use rk_facets, only : facets_type
   use rk_lattice, only : digits_of, lattice_frame, place_of, set_number
   use rk_precision, only : wp
   implicit none
   private

   public :: lattice_patches

   !> Pieces of a facet along each of its directions
   integer, parameter :: pieces = 2
   !> Gauss points of a piece, from -1 to 1
   real(wp), parameter :: gauss(2) = [-1.0_wp, 1.0_wp]/sqrt(3.0_wp)

contains

!> Facets of all cells; those of an annulus are straight between corners of the pieces
subroutine lattice_patches(facets, cloud)
   !> Facets
   type(facets_type), intent(inout) :: facets
   !> Coarse cloud with a lattice
   type(cloud_type), intent(in) :: cloud
   real(wp) :: low(3), step(3), from(3), to(3), last(3), face
   integer :: base(3), index(3), next(3), d, end, is, nd, other, set

   nd = cloud%nd
   call lattice_frame(cloud, low, step)
   base = 1
   base(:nd) = cloud%lattice
   last = base - 1
   do is = 1, size(cloud%source, 2)
      index = digits_of(is - 1, base)
      from = max(index - 0.5_wp, 0.0_wp)
      to = min(index + 0.5_wp, last)
      do d = 1, nd
         do end = 0, 1
            next = index
            next(d) = index(d) + 2*end - 1
            if (end == 0 .and. next(d) >= 0) cycle
            face = merge(to(d), from(d), end == 1)
            other = 0
            set = set_number(cloud%polar, d, end)
            if (next(d) >= 0 .and. next(d) < base(d)) then
               other = place_of(next, base)
               set = 0
            end if
            if (nd == 2) then
               call add_edges()
            else
               call add_rectangles()
            end if
         end do
      end do
   end do

contains

   !> Place of coordinates of the lattice
   pure function corner(at) result(x)
      real(wp), intent(in) :: at(2)
      real(wp) :: x(2)

      x = low(:2) + step(:2)*at
      if (cloud%polar) x = x(1)*[cos(x(2)), sin(x(2))]
   end function corner

   !> Pieces of an edge
   subroutine add_edges()
      real(wp) :: a(2), b(2), at(2), normal(2)
      integer :: i, k, o

      o = 3 - d
      do i = 1, pieces
         at(d) = face
         at(o) = from(o) + (to(o) - from(o))*(i - 1)/pieces
         a = corner(at)
         at(o) = from(o) + (to(o) - from(o))*i/pieces
         b = corner(at)
         normal = [b(2) - a(2), a(1) - b(1)]
         if (d == 2) normal = -normal
         if (end == 0) normal = -normal
         do k = 1, 2
            call facets%add(0.5_wp*(a + b) + 0.5_wp*gauss(k)*(b - a), 0.5_wp*normal, is, other, set)
         end do
      end do
   end subroutine add_edges

   !> Pieces of a rectangle
   subroutine add_rectangles()
      real(wp) :: x(3), area(3)
      integer :: i, j, o, p

      o = modulo(d, 3) + 1
      p = modulo(d + 1, 3) + 1
      x(d) = low(d) + step(d)*face
      area = 0.0_wp
      area(d) = (2*end - 1)*step(o)*(to(o) - from(o))*step(p)*(to(p) - from(p))/(2*pieces)**2
      do i = 0, 2*pieces - 1
         do j = 0, 2*pieces - 1
            x(o) = low(o) + step(o)*(from(o) + (to(o) - from(o))*along(i))
            x(p) = low(p) + step(p)*(from(p) + (to(p) - from(p))*along(j))
            call facets%add(x, area, is, other, set)
         end do
      end do
   end subroutine add_rectangles

   !> Gauss points of all pieces, from 0 to 1
   pure real(wp) function along(k)
      integer, intent(in) :: k

      along = (k/2 + 0.5_wp + 0.5_wp*gauss(1 + mod(k, 2)))/pieces
   end function along

end subroutine lattice_patches

end module rk_lattice_patches
