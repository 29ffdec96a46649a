!> Surface of a body whose points lie on a lattice, as triangles between them.
!>
!> A cell between neighbouring lattice positions is filled by the convex hull of its points; faces
!> between filled cells cancel. So voxels give slopes instead of stairs.
module rk_surface
   use rk_cloud, only : cloud_type
   implicit none
   private

   public :: lattice_places, surface_triangles

   !> Corners of a cell, shape (3, 8)
   integer, parameter :: corner(3, 8) = reshape([0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, &
      & 0, 0, 1, 1, 0, 1, 0, 1, 1, 1, 1, 1], [3, 8])

   !> A facet of a hull
   type :: facet_type
      !> Corners of the cell, counter-clockwise from outside
      integer, allocatable :: corner(:)
      !> Face of the cell in which it lies: twice its direction, one less on the low side; 0 inside
      integer :: face = 0
   end type facet_type

   !> Hull of some corners of a cell; empty if they lie in a plane
   type :: hull_type
      type(facet_type), allocatable :: facet(:)
   end type hull_type

contains

!> Index of each collocation point in a lattice, shape (nd, nc); of size 0 without a lattice
function lattice_places(cloud) result(place)
   type(cloud_type), intent(in) :: cloud
   integer, allocatable :: place(:, :)

   allocate (place(cloud%nd, 0))
   if (allocated(cloud%place)) place = cloud%place
   if (allocated(cloud%voxels%index)) place = cloud%voxels%index
end function lattice_places

!> Triangles of the surface, or of a plane body itself: points in lattice order, counter-clockwise
!> from outside, shape (3, nt)
function surface_triangles(place) result(triangle)
   !> Lattice indices, shape (nd, np)
   integer, intent(in) :: place(:, :)
   integer, allocatable :: triangle(:, :)
   integer, allocatable :: at(:, :, :)
   integer :: low(3), n(3), ip, x(3)

   if (size(place, 2) == 0 .or. size(place, 1) < 2) then
      allocate (triangle(3, 0))
      return
   end if
   low = 0
   n = 1
   low(:size(place, 1)) = minval(place, dim=2)
   n(:size(place, 1)) = maxval(place, dim=2) - minval(place, dim=2) + 1
   allocate (at(n(1), n(2), n(3)), source=0)
   do ip = 1, size(place, 2)
      x = 1
      x(:size(place, 1)) = place(:, ip) - low(:size(place, 1)) + 1
      at(x(1), x(2), x(3)) = ip
   end do
   if (size(place, 1) == 2) then
      triangle = plane_triangles(at(:, :, 1))
   else
      triangle = hull_triangles(at)
   end if
end function surface_triangles

!> Triangles that fill a plane body, shape (3, nt)
pure function plane_triangles(at) result(triangle)
   !> Points by lattice index, 0 for none
   integer, intent(in) :: at(:, :)
   integer, allocatable :: triangle(:, :)
   integer :: i, j, k, nt
   integer, allocatable :: own(:)

   allocate (triangle(3, 2*size(at)))
   nt = 0
   do j = 1, size(at, 2) - 1
      do i = 1, size(at, 1) - 1
         own = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]
         own = pack(own, own > 0)
         do k = 3, size(own)
            nt = nt + 1
            triangle(:, nt) = [own(1), own(k - 1), own(k)]
         end do
      end do
   end do
   triangle = triangle(:, :nt)
end function plane_triangles

!> Triangles around a body in space, shape (3, nt)
function hull_triangles(at) result(triangle)
   !> Points by lattice index, 0 for none
   integer, intent(in) :: at(:, :, :)
   integer, allocatable :: triangle(:, :)
   type(hull_type) :: hull(0:255)
   integer, allocatable :: filled(:, :, :)
   integer :: own(8), i, j, k, f, t, m, nt, pass, near(3)

   do m = 0, 255
      hull(m) = hull_of(pack([(f, f=1, 8)], [(btest(m, f - 1), f=1, 8)]))
   end do
   allocate (filled(0:size(at, 1), 0:size(at, 2), 0:size(at, 3)), source=0)
   allocate (triangle(3, 0))
   ! find the filled cells, count the triangles, store them
   do pass = 1, 3
      nt = 0
      do k = 1, size(at, 3) - 1
         do j = 1, size(at, 2) - 1
            do i = 1, size(at, 1) - 1
               own = reshape(at(i:i + 1, j:j + 1, k:k + 1), [8])
               if (pass == 1) then
                  m = sum(merge([(2**f, f=0, 7)], 0, own > 0))
                  if (size(hull(m)%facet) > 0) filled(i, j, k) = m
                  cycle
               end if
               m = filled(i, j, k)
               do f = 1, size(hull(m)%facet)
                  associate (facet => hull(m)%facet(f))
                     near = [i, j, k]
                     if (facet%face > 0) near((facet%face + 1)/2) = near((facet%face + 1)/2) &
                        & + merge(1, -1, mod(facet%face, 2) == 0)
                     if (facet%face > 0 .and. filled(near(1), near(2), near(3)) > 0) cycle
                     do t = 3, size(facet%corner)
                        nt = nt + 1
                        if (pass == 3) triangle(:, nt) = own(facet%corner([1, t - 1, t]))
                     end do
                  end associate
               end do
            end do
         end do
      end do
      if (pass == 2) then
         deallocate (triangle)
         allocate (triangle(3, nt))
      end if
   end do
end function hull_triangles

!> Hull of some corners of a cell
pure function hull_of(have) result(hull)
   !> Numbers of the corners, ascending
   integer, intent(in) :: have(:)
   type(hull_type) :: hull
   type(facet_type) :: facet
   integer, allocatable :: on(:), off(:)
   integer :: a, b, c, normal(3)

   allocate (hull%facet(0))
   do a = 1, size(have)
      do b = a + 1, size(have)
         do c = b + 1, size(have)
            normal = cross(edge(have(a), have(b)), edge(have(a), have(c)))
            off = matmul(normal, corner(:, have) - spread(corner(:, have(a)), 2, size(have)))
            if (any(off > 0) .eqv. any(off < 0)) cycle
            if (any(off > 0)) normal = -normal
            on = pack(have, off == 0)
            ! a facet of four corners is found from each three of them: keep the first
            if (any(on(:3) /= have([a, b, c]))) cycle
            ! of four corners the last one lies opposite the first
            if (size(on) == 4) on = on([1, 2, 4, 3])
            if (dot_product(cross(edge(on(1), on(2)), edge(on(1), on(3))), normal) < 0) &
               & on(2:) = on(size(on):2:-1)
            facet%corner = on
            facet%face = 0
            if (count(normal /= 0) == 1) &
               & facet%face = 2*findloc(normal /= 0, .true., dim=1) - merge(0, 1, sum(normal) > 0)
            hull%facet = [hull%facet, facet]
         end do
      end do
   end do

contains

   pure function edge(from, to)
      integer, intent(in) :: from, to
      integer :: edge(3)

      edge = corner(:, to) - corner(:, from)
   end function edge

end function hull_of

pure function cross(a, b) result(c)
   integer, intent(in) :: a(3), b(3)
   integer :: c(3)

   c = [a(2)*b(3) - a(3)*b(2), a(3)*b(1) - a(1)*b(3), a(1)*b(2) - a(2)*b(1)]
end function cross

end module rk_surface
