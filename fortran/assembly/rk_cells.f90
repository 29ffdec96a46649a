!> Where weak forms are integrated: points with weights in groups, and the surface.
!>
!> Gauss points lie in the cells between the source points of a lattice. Nodal cells belong to one
!> source point each; their gradients are smoothed over the cell's facets, which neighbours share:
!> the integral of a gradient over the body is then exactly the integral of values over the surface.
!> Gauss points get the mean gradient of their cell corrected to the same end. Points come in
!> groups, within which the volume change is projected.
!>
!> Reference: Chen, Wu, Yoon, You, Int. J. Numer. Meth. Engng 50 (2001),
!>            doi:10.1002/1097-0207(20010120)50:2<435::AID-NME32>3.0.CO;2-A
module rk_cells
   use rk_cloud, only : cloud_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_gauss, only : gauss_rule
   use rk_precision, only : pi, wp
   implicit none
   private

   public :: cells_type, gauss_cells, lattice_frame, set_number, digits_of, place_of

   !> Integration points and surface of a body
   type :: cells_type
      !> Gradients are smoothed over facets
      logical :: smoothed = .false.
      !> The facets of each cell close around it to rounding
      logical :: closed = .true.
      !> Points of a cell, which follow each other
      integer :: per_cell = 1
      !> Points, those of a group together, shape (nd, np) [length]
      real(wp), allocatable :: point(:, :)
      !> Source point of each nodal cell, shape (np); not allocated for Gauss points
      integer, allocatable :: node(:)
      !> Volume of each point, shape (np) [length^nd]
      real(wp), allocatable :: weight(:)
      !> Group g has points first(g)+1 : first(g+1), shape (groups + 1)
      integer, allocatable :: first(:)
      !> Points of facets between cells, shape (nd, facets) [length]
      real(wp), allocatable :: facet(:, :)
      !> Area times normal of each, shape (nd, facets) [length^(nd-1)]
      real(wp), allocatable :: area(:, :)
      !> Cells on both sides, the normal points from the first to the second, shape (2, facets)
      integer, allocatable :: side(:, :)
      !> Points of the surface, shape (nd, ms) [length]
      real(wp), allocatable :: surface(:, :)
      !> Outward normal times area, shape (nd, ms) [length^(nd-1)]
      real(wp), allocatable :: outward(:, :)
      !> Boundary set of each, shape (ms)
      integer, allocatable :: set(:)
      !> Values of surface point s lifted into the body reach points
      !> lift_point(lift_first(s)+1 : lift_first(s+1)), shape (ms + 1)
      integer, allocatable :: lift_first(:)
      integer, allocatable :: lift_point(:)
      !> by these factors [1/length^nd]: the weights of the points reproduce polynomials at s
      real(wp), allocatable :: lift(:)
      !> Second moments of each nodal cell about its point, shape (nd, nd, np) [length^(nd+2)]
      real(wp), allocatable :: moment(:, :, :)
   end type cells_type

   !> Cells between source points that make one group, in each direction
   integer, parameter :: group_size = 2

contains

!> Gauss points in the cells between the source points of a lattice
subroutine gauss_cells(self, cloud, count, degree, error)
   !> Points
   type(cells_type), intent(out) :: self
   !> Cloud with a lattice
   type(cloud_type), intent(in) :: cloud
   !> Gauss points in each direction of a cell
   integer, intent(in) :: count
   !> Degree of the polynomials that lifted values reproduce
   integer, intent(in) :: degree
   !> Error handling: no lattice
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: rule(count), share(count), low(3), step(3), map(3, 3), jacobian
   real(wp) :: outer(3)
   integer :: cells(3), groups(3), at(3), cell(3), sub(3), from(3), to(3), g(3)
   integer, allocatable :: number(:)
   integer :: nd, np, ng, i, j, d, k, side, faces, ms, mf, nl, own

   if (.not. allocated(cloud%lattice)) then
      call fatal_error(error, err_input, 'Gauss cells need the lattice of a box or an annulus: ' &
         & //'use method "rkpm-scni"')
      return
   end if
   nd = cloud%nd
   call gauss_rule(rule, share)
   call lattice_frame(cloud, low, step)
   cells = 1
   cells(:nd) = cloud%lattice - 1
   groups = group_count(cells)
   ng = product(groups)
   own = count**nd
   np = product(cells)*own
   faces = 0
   mf = 0
   do d = 1, nd
      faces = faces + 2*product(cells)/cells(d)*count**(nd - 1)
      mf = mf + (product(cells) - product(cells)/cells(d))*count**(nd - 1)
   end do
   ! arcs do not close around a cell to rounding: polar cells keep their plain gradients
   self%closed = .not. cloud%polar
   if (cloud%polar) mf = 0
   self%per_cell = own
   allocate (self%facet(nd, mf), self%area(nd, mf), self%side(2, mf), number(product(cells)))
   allocate (self%point(nd, np), self%weight(np), self%first(ng + 1))
   allocate (self%surface(nd, faces), self%outward(nd, faces), self%set(faces))
   allocate (self%lift_first(faces + 1), self%lift_point(faces*own), self%lift(faces*own))
   self%first(1) = 0
   self%lift_first(1) = 0
   np = 0
   do i = 1, ng
      g = digits_of(i - 1, groups)
      from = group_start(g, cells)
      to = group_start(g + 1, cells) - 1
      do j = 1, product(to - from + 1)
         np = np + 1
         number(place_of(from + digits_of(j - 1, to - from + 1), cells)) = np
      end do
   end do
   np = 0
   ms = 0
   mf = 0
   nl = 0
   do i = 1, ng
      g = digits_of(i - 1, groups)
      from = group_start(g, cells)
      to = group_start(g + 1, cells) - 1
      do j = 1, product(to - from + 1)
         cell = from + digits_of(j - 1, to - from + 1)
         do k = 1, own
            at = digits_of(k - 1, [count, count, merge(count, 1, nd == 3)])
            call place(cell, rule(at(:nd) + 1))
            self%point(:, np + k) = outer(:nd)
            self%weight(np + k) = jacobian*product(share(at(:nd) + 1))
         end do
         do d = 1, nd
            do side = 0, 1
               do k = 1, count**(nd - 1)
                  sub = digits_of(k - 1, [count, merge(count, 1, nd == 3), 1])
                  if (cell(d) == side*(cells(d) - 1)) then
                     call add_surface(cell, d, side, sub)
                  else if (side == 1 .and. .not. cloud%polar) then
                     call add_facet(cell, d, sub)
                  end if
               end do
            end do
         end do
         np = np + own
      end do
      self%first(i + 1) = np
   end do
   self%lift_point = self%lift_point(:nl)
   self%lift = self%lift(:nl)

contains

   !> Place and Jacobian of a point of a cell
   subroutine place(index, xi)
      integer, intent(in) :: index(3)
      real(wp), intent(in) :: xi(:)
      real(wp) :: q(3)
      integer :: e

      q = 0.0_wp
      q(:nd) = low(:nd) + step(:nd)*(index(:nd) + 0.5_wp*(1.0_wp + xi))
      map = 0.0_wp
      if (cloud%polar) then
         outer = [q(1)*cos(q(2)), q(1)*sin(q(2)), 0.0_wp]
         map(:2, 1) = 0.5_wp*step(1)*[cos(q(2)), sin(q(2))]
         map(:2, 2) = 0.5_wp*step(2)*q(1)*[-sin(q(2)), cos(q(2))]
         jacobian = 0.25_wp*step(1)*step(2)*q(1)
      else
         outer = q
         do e = 1, nd
            map(e, e) = 0.5_wp*step(e)
         end do
         jacobian = product(0.5_wp*step(:nd))
      end if
   end subroutine place

   !> A Gauss point of a face of a cell
   subroutine face_point(index, axis, end, sub, xi, area)
      integer, intent(in) :: index(3), axis, end, sub(3)
      real(wp), intent(out) :: xi(:), area(:)
      real(wp) :: length
      integer :: e, n

      n = 0
      length = 1.0_wp
      do e = 1, nd
         if (e == axis) then
            xi(e) = 2.0_wp*end - 1.0_wp
         else
            n = n + 1
            xi(e) = rule(sub(n) + 1)
            length = length*share(sub(n) + 1)
         end if
      end do
      call place(index, xi)
      ! columns of the map are orthogonal: the face's area is the product of the others' lengths
      area = xi(axis)*length*jacobian*map(:nd, axis)/sum(map(:, axis)**2)
   end subroutine face_point

   !> A Gauss point of a face between two cells, at the upper end of the first
   subroutine add_facet(index, axis, sub)
      integer, intent(in) :: index(3), axis, sub(3)
      real(wp) :: xi(nd)
      integer :: next(3)

      mf = mf + 1
      call face_point(index, axis, 1, sub, xi, self%area(:, mf))
      self%facet(:, mf) = outer(:nd)
      next = index
      next(axis) = index(axis) + 1
      self%side(:, mf) = [number(place_of(index, cells)), number(place_of(next, cells))]
   end subroutine add_facet

   !> A Gauss point of a face on the surface
   subroutine add_surface(index, axis, end, sub)
      integer, intent(in) :: index(3), axis, end, sub(3)
      real(wp) :: xi(nd), eta(nd)
      integer :: digit(3), q

      ms = ms + 1
      call face_point(index, axis, end, sub, xi, self%outward(:, ms))
      self%surface(:, ms) = outer(:nd)
      self%set(ms) = set_number(cloud%polar, axis, end)
      do q = 1, own
         digit = digits_of(q - 1, [count, count, merge(count, 1, nd == 3)])
         eta = rule(digit(:nd) + 1)
         nl = nl + 1
         self%lift_point(nl) = np + q
         self%lift(nl) = product(kernel(eta, xi)*share(digit(:nd) + 1))/self%weight(np + q)
      end do
      self%lift_first(ms + 1) = nl
   end subroutine add_surface

   !> Reproducing kernel of Legendre polynomials up to the degree, in each direction
   elemental real(wp) function kernel(x, y)
      real(wp), intent(in) :: x, y

      kernel = 0.5_wp
      if (degree > 0) kernel = kernel + 1.5_wp*x*y
   end function kernel

end subroutine gauss_cells

!> Corner and spacing of a lattice, in radius and angle where it is polar
pure subroutine lattice_frame(cloud, low, step)
   !> Cloud with a lattice
   type(cloud_type), intent(in) :: cloud
   !> Corner and spacing [length], [radian]
   real(wp), intent(out) :: low(3), step(3)
   integer :: d

   low = 0.0_wp
   step = 1.0_wp
   if (cloud%polar) then
      low(1) = minval(cloud%source(1, :), mask=cloud%source(2, :) <= 0.0_wp)
      step(1) = (maxval(cloud%source(1, :)) - low(1))/(cloud%lattice(1) - 1)
      step(2) = 0.5_wp*pi/(cloud%lattice(2) - 1)
   else
      do d = 1, cloud%nd
         low(d) = minval(cloud%source(d, :))
         step(d) = (maxval(cloud%source(d, :)) - low(d))/(cloud%lattice(d) - 1)
      end do
   end if
end subroutine lattice_frame

!> Groups of cells in one direction: so many that they can lie symmetrically
elemental integer function group_count(cells)
   !> Cells in this direction
   integer, intent(in) :: cells

   group_count = max(1, cells/group_size)
   ! an odd cell is in the middle of a symmetric row of groups, or there is no such row; groups of
   ! one cell would make the pressure oscillate
   if (mod(cells, 2) == 1 .and. mod(group_count, 2) == 0 .and. group_count > 2) &
      & group_count = group_count - 1
end function group_count

!> First cell of a group, from 0
elemental integer function group_start(group, cells)
   !> Group, from 0
   integer, intent(in) :: group
   !> Cells in this direction
   integer, intent(in) :: cells

   group_start = nint(real(group*cells, wp)/group_count(cells))
end function group_start

!> Boundary set of a face of a lattice, as rk_cloud numbers them
pure integer function set_number(polar, axis, end)
   !> Radius and angle
   logical, intent(in) :: polar
   !> Direction of the face's normal
   integer, intent(in) :: axis
   !> 0 at the low end, 1 at the high end
   integer, intent(in) :: end

   set_number = 2*axis - 1 + end
   if (polar .and. axis == 2) set_number = 4 - end
end function set_number

!> Number, from 1, of digits
pure integer function place_of(digit, base)
   !> Digits, the last one fastest
   integer, intent(in) :: digit(3)
   !> Values of each digit
   integer, intent(in) :: base(3)

   place_of = 1 + digit(3) + base(3)*(digit(2) + base(2)*digit(1))
end function place_of

!> Digits of a number, the last one fastest
pure function digits_of(number, base) result(digit)
   !> Number, from 0
   integer, intent(in) :: number
   !> Values of each digit
   integer, intent(in) :: base(3)
   integer :: digit(3)
   integer :: d, rest

   rest = number
   do d = 3, 1, -1
      digit(d) = mod(rest, base(d))
      rest = rest/base(d)
   end do
end function digits_of

end module rk_cells
