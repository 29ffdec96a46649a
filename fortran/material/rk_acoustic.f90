!> Strong ellipticity of a material at one state: the smallest eigenvalue of the acoustic tensor.
!>
!> For a direction N of the undeformed body Q_ik = C4_iAkB N_A N_B. If one of its eigenvalues is not
!> positive for some N, the equations of equilibrium lose ellipticity: bands of localised strain
!> cost no energy and the solution depends on the discretisation. An incompressible body allows only
!> motions normal to cof F N; there the eigenvalues of Q in that plane are used.
!>
!> Reference: Ogden, Non-Linear Elastic Deformations, Dover (1997), chapter 6;
!>            Swinbank, Purser, Q. J. R. Meteorol. Soc. 132 (2006) 1769, doi:10.1256/qj.05.227,
!>            for the directions
module rk_acoustic
   use rk_precision, only : pi, wp
   use rk_tensor, only : principal_values, vector_product
   implicit none
   private

   public :: least_acoustic

   !> Directions of the first search, about 0.3 rad apart on the half sphere and 0.2 in the plane
   integer, parameter :: directions = 60, in_plane = 15
   !> Refinements: each tries two directions in the plane or four in space by a turn that is halved,
   !> in space only if no direction is better
   integer, parameter :: refinements = 10
   !> First angle of the refinement
   real(wp), parameter :: first_turn = 0.15_wp
   !> Three fixed-point steps eliminate the motion that changes the volume, if its stiffness exceeds
   !> the others by this multiple of the coupling
   real(wp), parameter :: apart = 3.0_wp
   !> Least difference there, relative to the stiffnesses: nothing divides by zero [-]
   real(wp), parameter :: slight = 1.0e-12_wp
   !> The first directions: around in the plane, along a Fibonacci spiral over the half sphere
   integer :: d
   real(wp), parameter :: around(in_plane) = [(pi*(d - 1)/in_plane, d=1, in_plane)]
   real(wp), parameter :: height(directions) = [((d - 0.5_wp)/directions, d=1, directions)]
   real(wp), parameter :: turned(directions) = [(pi*(3.0_wp - sqrt(5.0_wp))*d, d=1, directions)]
   real(wp), parameter :: flat(in_plane, 3) = reshape([cos(around), sin(around), 0.0_wp*around], &
      & [in_plane, 3])
   real(wp), parameter :: spiral(directions, 3) = reshape([sqrt(1.0_wp - height**2)*cos(turned), &
      & sqrt(1.0_wp - height**2)*sin(turned), height], [directions, 3])

contains

!> Smallest eigenvalue of the acoustic tensor over all directions [stress]
pure real(wp) function least_acoustic(nd, c4, cofactor, rigid) result(least)
   !> Space dimension; in the plane directions and motions stay in the plane
   integer, intent(in) :: nd
   !> Tangent C4(i, A, k, B) [stress]
   real(wp), intent(in) :: c4(3, 3, 3, 3)
   !> Cofactors of F [-]
   real(wp), intent(in) :: cofactor(3, 3)
   !> The material is incompressible
   logical, intent(in) :: rigid
   real(wp) :: form(6, 6), best(3), side(3, 2), tries(2*(nd - 1), 3), turn, before
   integer :: i, k

   form = products_form(c4)
   least = huge(1.0_wp)
   best = 0.0_wp
   if (nd == 2) then
      call keep_better(flat, least, best)
   else
      call keep_better(spiral, least, best)
   end if
   turn = first_turn
   do k = 1, refinements
      call sides_of(best, nd, side)
      do i = 1, nd - 1
         tries(2*i - 1, :) = cos(turn)*best + sin(turn)*side(:, i)
         tries(2*i, :) = cos(turn)*best - sin(turn)*side(:, i)
      end do
      before = least
      call keep_better(tries, least, best)
      ! in 2D the smallest value lies within one turn of the best of three directions
      if (nd == 2 .or. .not. least < before) turn = 0.5_wp*turn
   end do

contains

   !> Keep the best of some directions if it is better
   pure subroutine keep_better(direction, least_value, its_direction)
      !> Unit vectors, shape (directions, 3)
      real(wp), intent(in) :: direction(:, :)
      real(wp), intent(inout) :: least_value, its_direction(3)
      real(wp) :: value(size(direction, 1))
      integer :: d

      if (nd == 2) then
         call plane_values(form, direction, cofactor, rigid, value)
      else
         call solid_values(form, direction, cofactor, rigid, value)
      end if
      do d = 1, size(value)
         if (value(d) >= least_value) cycle
         least_value = value(d)
         its_direction = direction(d, :)
      end do
   end subroutine keep_better

end function least_acoustic

!> Two unit vectors normal to a direction
pure subroutine sides_of(n, nd, side)
   !> Unit vector
   real(wp), intent(in) :: n(3)
   integer, intent(in) :: nd
   !> Unit vectors; in the plane only the first one is used
   real(wp), intent(out) :: side(3, 2)

   if (nd == 2) then
      side(:, 1) = [-n(2), n(1), 0.0_wp]
   else if (abs(n(3)) < 0.9_wp) then
      side(:, 1) = [-n(2), n(1), 0.0_wp]/sqrt(n(1)**2 + n(2)**2)
   else
      side(:, 1) = [0.0_wp, -n(3), n(2)]/sqrt(n(2)**2 + n(3)**2)
   end if
   side(:, 2) = vector_product(n, side(:, 1))
end subroutine sides_of

!> Components 11, 22, 33, 23, 13, 12 of Q as forms in the same products of a direction's components
pure function products_form(c4) result(form)
   !> Tangent [stress]
   real(wp), intent(in) :: c4(3, 3, 3, 3)
   !> Factors of the products, shape (component, product) [stress]
   real(wp) :: form(6, 6)
   integer, parameter :: row(6) = [1, 2, 3, 2, 1, 1], column(6) = [1, 2, 3, 3, 3, 2]
   integer :: a, b, c, i, k

   do c = 1, 6
      i = row(c)
      k = column(c)
      form(c, :3) = [(c4(i, a, k, a), a=1, 3)]
      form(c, 4:) = [(c4(i, row(b), k, column(b)) + c4(i, column(b), k, row(b)), b=4, 6)]
   end do
end function products_form

!> Smallest eigenvalue of the acoustic tensor of some directions in 2D, where one motion keeps the
!> volume
pure subroutine plane_values(form, n, cofactor, rigid, value)
   !> Acoustic tensor in terms of the products of a direction's components [stress]
   real(wp), intent(in) :: form(6, 6)
   !> Unit vectors, shape (directions, 3)
   real(wp), intent(in) :: n(:, :)
   !> Cofactors of F: those times a direction are the motion that changes the volume
   real(wp), intent(in) :: cofactor(3, 3)
   !> There are no such motions
   logical, intent(in) :: rigid
   !> Eigenvalues, shape (directions) [stress]
   real(wp), intent(out) :: value(:)
   real(wp) :: q(3), m(2), length, a, b, stiff, least, gap
   integer :: d

   do d = 1, size(value)
      q = n(d, 1)**2*form([1, 2, 6], 1) + n(d, 2)**2*form([1, 2, 6], 2) &
         & + n(d, 1)*n(d, 2)*form([1, 2, 6], 6)
      m = cofactor(:2, 1)*n(d, 1) + cofactor(:2, 2)*n(d, 2)
      length = m(1)**2 + m(2)**2
      a = (q(2)*m(1)**2 - 2.0_wp*q(3)*m(1)*m(2) + q(1)*m(2)**2)/length
      b = ((q(2) - q(1))*m(1)*m(2) + q(3)*(m(1)**2 - m(2)**2))/length
      stiff = (q(1)*m(1)**2 + 2.0_wp*q(3)*m(1)*m(2) + q(2)*m(2)**2)/length
      gap = slight*(abs(stiff) + abs(a)) + tiny(1.0_wp)
      least = a - b**2/max(stiff - a, gap)
      least = a - b**2/max(stiff - least, gap)
      least = a - b**2/max(stiff - least, gap)
      least = merge(least, lower(q(1), q(3), q(2)), stiff - a > apart*abs(b))
      value(d) = merge(a, least, rigid)
   end do
end subroutine plane_values

!> The same in 3D; the loop is written so that processors take several directions at a time
pure subroutine solid_values(form, n, cofactor, rigid, value)
   real(wp), intent(in) :: form(6, 6)
   real(wp), intent(in) :: n(:, :)
   real(wp), intent(in) :: cofactor(3, 3)
   logical, intent(in) :: rigid
   real(wp), intent(out) :: value(:)
   !> A direction, that of the motion that changes the volume, unit vectors across it, and their
   !> products with Q
   real(wp), dimension(3) :: m, u, v, qu, qv, e
   real(wp) :: p(6), q(6), a, b, c, stiff, side, share, least, gap, couple(2)
   !> Positive where elimination converges, shape (directions) [stress^2]
   real(wp) :: excess(size(value)), free
   integer :: d

   free = merge(0.0_wp, 1.0_wp, rigid)
   do d = 1, size(value)
      p = [n(d, 1)**2, n(d, 2)**2, n(d, 3)**2, n(d, 2)*n(d, 3), n(d, 1)*n(d, 3), n(d, 1)*n(d, 2)]
      q = form(:, 1)*p(1) + form(:, 2)*p(2) + form(:, 3)*p(3) + form(:, 4)*p(4) + form(:, 5)*p(5) &
         & + form(:, 6)*p(6)
      m = cofactor(:, 1)*n(d, 1) + cofactor(:, 2)*n(d, 2) + cofactor(:, 3)*n(d, 3)
      m = m/sqrt(m(1)**2 + m(2)**2 + m(3)**2)
      side = sign(1.0_wp, m(3))
      share = -1.0_wp/(side + m(3))
      u = [1.0_wp + side*share*m(1)**2, side*share*m(1)*m(2), -side*m(1)]
      v = [share*m(1)*m(2), side + share*m(2)**2, -m(2)]
      qu = [q(1)*u(1) + q(6)*u(2) + q(5)*u(3), q(6)*u(1) + q(2)*u(2) + q(4)*u(3), &
         & q(5)*u(1) + q(4)*u(2) + q(3)*u(3)]
      qv = [q(1)*v(1) + q(6)*v(2) + q(5)*v(3), q(6)*v(1) + q(2)*v(2) + q(4)*v(3), &
         & q(5)*v(1) + q(4)*v(2) + q(3)*v(3)]
      a = u(1)*qu(1) + u(2)*qu(2) + u(3)*qu(3)
      b = u(1)*qv(1) + u(2)*qv(2) + u(3)*qv(3)
      c = v(1)*qv(1) + v(2)*qv(2) + v(3)*qv(3)
      couple(1) = m(1)*qu(1) + m(2)*qu(2) + m(3)*qu(3)
      couple(2) = m(1)*qv(1) + m(2)*qv(2) + m(3)*qv(3)
      stiff = q(1) + q(2) + q(3) - a - c
      least = lower(a, b, c)
      gap = slight*(abs(stiff) + abs(a) + abs(c)) + tiny(1.0_wp)
      excess(d) = (stiff - least)*abs(stiff - least) - apart**2*(couple(1)**2 + couple(2)**2)
      ! elimination keeps the digits of shear beside a bulk modulus 1e8 times as large
      share = free/max(stiff - least, gap)
      least = lower(a - share*couple(1)**2, b - share*couple(1)*couple(2), c - share*couple(2)**2)
      share = free/max(stiff - least, gap)
      least = lower(a - share*couple(1)**2, b - share*couple(1)*couple(2), c - share*couple(2)**2)
      share = free/max(stiff - least, gap)
      least = lower(a - share*couple(1)**2, b - share*couple(1)*couple(2), c - share*couple(2)**2)
      value(d) = least
   end do
   if (rigid .or. all(excess > 0.0_wp)) return
   do d = 1, size(value)
      if (excess(d) > 0.0_wp) cycle
      q = matmul(form, [n(d, 1)**2, n(d, 2)**2, n(d, 3)**2, n(d, 2)*n(d, 3), n(d, 1)*n(d, 3), &
         & n(d, 1)*n(d, 2)])
      e = principal_values(reshape(q([1, 6, 5, 6, 2, 4, 5, 4, 3]), [3, 3]))
      value(d) = e(3)
   end do
end subroutine solid_values

!> Smaller eigenvalue of a symmetric 2x2 matrix
pure real(wp) function lower(a, b, c)
   !> Entries 11, 12, 22
   real(wp), intent(in) :: a, b, c

   lower = 0.5_wp*(a + c) - sqrt((0.5_wp*(a - c))**2 + b**2)
end function lower

end module rk_acoustic
