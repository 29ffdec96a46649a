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
   !> Number of eliminations of the motion that changes the volume: few fixed-point steps suffice if
   !> its stiffness exceeds the others by this multiple of the coupling
   integer, parameter :: eliminations = 3
   real(wp), parameter :: apart = 3.0_wp
   !> The first directions: around in the plane, along a Fibonacci spiral over the half sphere
   integer :: d
   real(wp), parameter :: around(in_plane) = [(pi*(d - 1)/in_plane, d=1, in_plane)]
   real(wp), parameter :: height(directions) = [((d - 0.5_wp)/directions, d=1, directions)]
   real(wp), parameter :: turned(directions) = [(pi*(3.0_wp - sqrt(5.0_wp))*d, d=1, directions)]
   real(wp), parameter :: flat(3, in_plane) = reshape([(cos(around(d)), sin(around(d)), 0.0_wp, &
      & d=1, in_plane)], [3, in_plane])
   real(wp), parameter :: spiral(3, directions) = reshape([(sqrt(1.0_wp - height(d)**2) &
      & *cos(turned(d)), sqrt(1.0_wp - height(d)**2)*sin(turned(d)), height(d), &
      & d=1, directions)], [3, directions])

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
   real(wp) :: n(3), best(3), centre(3), side(3, 2), form(3, 3, 6), turn, value
   integer :: i, k

   form = products_form(c4)
   least = huge(1.0_wp)
   best = 0.0_wp
   do k = 1, merge(in_plane, directions, nd == 2)
      if (nd == 2) then
         call keep_better(flat(:, k), least, best)
      else
         call keep_better(spiral(:, k), least, best)
      end if
   end do
   turn = first_turn
   do k = 1, refinements
      centre = best
      call sides_of(centre, nd, side)
      value = least
      do i = 1, nd - 1
         n = cos(turn)*centre + sin(turn)*side(:, i)
         call keep_better(n, least, best)
         n = cos(turn)*centre - sin(turn)*side(:, i)
         call keep_better(n, least, best)
      end do
      ! in the plane the minimum lies within one turn of the best of three directions
      if (nd == 2 .or. .not. least < value) turn = 0.5_wp*turn
   end do

contains

   !> Keep a direction if it is better
   pure subroutine keep_better(direction, least_value, its_direction)
      real(wp), intent(in) :: direction(3)
      real(wp), intent(inout) :: least_value, its_direction(3)
      real(wp) :: found
      found = smallest(nd, form, direction, matmul(cofactor, direction), rigid)
      if (found >= least_value) return
      least_value = found
      its_direction = direction
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

!> Q(i, k) as a linear form in the products 11, 22, 33, 23, 13, 12 of a direction's components
pure function products_form(c4) result(form)
   !> Tangent [stress]
   real(wp), intent(in) :: c4(3, 3, 3, 3)
   !> Coefficients of the products [stress]
   real(wp) :: form(3, 3, 6)
   integer :: a

   do a = 1, 3
      form(:, :, a) = c4(:, a, :, a)
   end do
   form(:, :, 4) = c4(:, 2, :, 3) + c4(:, 3, :, 2)
   form(:, :, 5) = c4(:, 1, :, 3) + c4(:, 3, :, 1)
   form(:, :, 6) = c4(:, 1, :, 2) + c4(:, 2, :, 1)
end function products_form

!> Smallest eigenvalue of the acoustic tensor of one direction [stress]
pure real(wp) function smallest(nd, form, n, m, rigid)
   !> Space dimension; in the plane one motion preserves the volume
   integer, intent(in) :: nd
   !> Acoustic tensor, as coefficients of the products of a direction's components [stress]
   real(wp), intent(in) :: form(3, 3, 6)
   !> Direction, unit vector
   real(wp), intent(in) :: n(3)
   !> Direction of the motions that change the volume, of any length
   real(wp), intent(in) :: m(3)
   !> The material is incompressible, so that there are no such motions
   logical, intent(in) :: rigid
   real(wp) :: q(3, 3), image(3, 2), side(3, 2), coupling(2), share(2), across(3), a, b, c, stiff
   real(wp) :: principal(3)
   integer :: i, trial

   if (nd == 2) then
      q(:2, :2) = n(1)**2*form(:2, :2, 1) + n(2)**2*form(:2, :2, 2) + n(1)*n(2)*form(:2, :2, 6)
      across = m/sqrt(m(1)**2 + m(2)**2)
      image(:2, 1) = q(:2, 2)*across(1) - q(:2, 1)*across(2)
      smallest = image(2, 1)*across(1) - image(1, 1)*across(2)
      if (rigid) return
      a = smallest
      b = image(1, 1)*across(1) + image(2, 1)*across(2)
      stiff = dot_product(across(:2), q(:2, 1)*across(1) + q(:2, 2)*across(2))
      if (.not. stiff - a > apart*abs(b)) smallest = lower(q(1, 1), q(1, 2), q(2, 2))
      do trial = 1, merge(eliminations, 0, stiff - a > apart*abs(b))
         smallest = a - b**2/(stiff - smallest)
      end do
      return
   end if
   q = n(1)**2*form(:, :, 1) + n(2)**2*form(:, :, 2) + n(3)**2*form(:, :, 3) &
      & + n(2)*n(3)*form(:, :, 4) + n(1)*n(3)*form(:, :, 5) + n(1)*n(2)*form(:, :, 6)
   across = m/sqrt(dot_product(m, m))
   call sides_of(across, 3, side)
   image = matmul(q, side)
   a = dot_product(side(:, 1), image(:, 1))
   b = dot_product(side(:, 1), image(:, 2))
   c = dot_product(side(:, 2), image(:, 2))
   smallest = lower(a, b, c)
   if (rigid) return
   ! elimination preserves the digits of shear beside a bulk modulus 1e8 times as large
   stiff = dot_product(across, matmul(q, across))
   coupling = [(dot_product(across, image(:, i)), i=1, 2)]
   if (.not. stiff - smallest > apart*sqrt(dot_product(coupling, coupling))) then
      principal = principal_values(q)
      smallest = principal(3)
      return
   end if
   do trial = 1, eliminations
      share = coupling/sqrt(stiff - smallest)
      smallest = lower(a - share(1)**2, b - share(1)*share(2), c - share(2)**2)
   end do
end function smallest

!> Smaller eigenvalue of a symmetric 2x2 matrix
pure real(wp) function lower(a, b, c)
   !> Entries 11, 12, 22
   real(wp), intent(in) :: a, b, c

   lower = 0.5_wp*(a + c) - sqrt((0.5_wp*(a - c))**2 + b**2)
end function lower

end module rk_acoustic
