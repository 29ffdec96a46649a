!> Strong ellipticity of a material at one state: the smallest eigenvalue of the acoustic tensor.
!>
!> For a direction N of the undeformed body Q_ik = C4_iAkB N_A N_B. Where one of its eigenvalues is
!> not positive for some N, the equations of equilibrium lose their ellipticity: bands of
!> localised strain cost nothing and the answer depends on the discretisation. A body that keeps
!> its volume allows only motions across cof F N; there the eigenvalues of Q in that plane count.
!>
!> Reference: Ogden, Non-Linear Elastic Deformations, Dover (1997), chapter 6;
!>            Swinbank, Purser, Q. J. R. Meteorol. Soc. 132 (2006) 1769, doi:10.1256/qj.05.227,
!>            for the directions
module rk_acoustic
   use rk_precision, only : pi, wp
   use rk_tensor, only : add_cross_form, cross, principal_values, vector_product
   implicit none
   private

   public :: least_acoustic, surely_above

   !> Directions of the first search, about 0.3 apart on the half sphere
   integer, parameter :: directions = 60
   !> Refinements, each of four tries by a turn that is halved where none is better
   integer, parameter :: refinements = 10
   !> First turn of the refinement
   real(wp), parameter :: first_turn = 0.15_wp
   !> Eliminations of the motion that changes the volume: a fixed point of few, where its stiffness
   !> squared is as many times the coupling
   integer, parameter :: eliminations = 3
   real(wp), parameter :: apart = 10.0_wp
   !> What a bound must clear beyond what is asked, as eliminations end before the last digit, and
   !> stiffness that stands for a kept volume, both of the shear modulus [-]
   real(wp), parameter :: clearance = 0.02_wp, stiffening = 100.0_wp
   !> Forms tested for definiteness, and the step from a bound of s to the next s while there is no
   !> bound on the other side, of the shear modulus [-]
   integer, parameter :: trials = 6
   real(wp), parameter :: beyond = 0.1_wp
   !> The first directions: around in the plane, along a Fibonacci spiral over the half sphere
   integer :: d
   real(wp), parameter :: around(directions) = [(pi*(d - 1)/directions, d=1, directions)]
   real(wp), parameter :: height(directions) = [((d - 0.5_wp)/directions, d=1, directions)]
   real(wp), parameter :: turned(directions) = [(pi*(3.0_wp - sqrt(5.0_wp))*d, d=1, directions)]
   real(wp), parameter :: flat(3, directions) = reshape([(cos(around(d)), sin(around(d)), 0.0_wp, &
      & d=1, directions)], [3, directions])
   real(wp), parameter :: spiral(3, directions) = reshape([(sqrt(1.0_wp - height(d)**2) &
      & *cos(turned(d)), sqrt(1.0_wp - height(d)**2)*sin(turned(d)), height(d), &
      & d=1, directions)], [3, directions])

contains

!> Smallest eigenvalue of the acoustic tensor over all directions [stress]
pure real(wp) function least_acoustic(nd, c4, cofactor, rigid) result(least)
   !> Space dimension; in the plane directions and motions stay in it
   integer, intent(in) :: nd
   !> Tangent C4(i, A, k, B) [stress]
   real(wp), intent(in) :: c4(3, 3, 3, 3)
   !> Cofactors of F [-]
   real(wp), intent(in) :: cofactor(3, 3)
   !> The volume is kept
   logical, intent(in) :: rigid
   real(wp) :: n(3), best(3), centre(3), side(3, 2), form(3, 3, 6), turn, value
   integer :: i, k

   form = products_form(c4)
   least = huge(1.0_wp)
   best = 0.0_wp
   do k = 1, directions
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
      if (.not. least < value) turn = 0.5_wp*turn
   end do

contains

   !> Keep a direction that is better
   pure subroutine keep_better(direction, least_value, its_direction)
      real(wp), intent(in) :: direction(3)
      real(wp), intent(inout) :: least_value, its_direction(3)
      real(wp) :: found
      if (nd == 2) then
         found = smallest_in_plane(form, direction, matmul(cofactor, direction), rigid)
      else
         found = smallest(form, direction, matmul(cofactor, direction), rigid)
      end if
      if (found >= least_value) return
      least_value = found
      its_direction = direction
   end subroutine keep_better

end function least_acoustic

!> Whether the eigenvalues of all acoustic tensors are above a level, by a bound that most points
!> of a body reach and that costs a fraction of the search: the form C4 + s dcof F/dF is positive
!> definite. Motions m N do not change the cofactors, so that any s will do. The first s gives
!> rotations the stiffness of a linear elastic solid; a motion that is resisted too little shows on
!> which side of it to search
pure logical function surely_above(nd, c4, f, rigid, level, modulus)
   !> Space dimension; in the plane directions and motions stay in it
   integer, intent(in) :: nd
   !> Tangent C4(i, A, k, B) [stress]
   real(wp), intent(in) :: c4(3, 3, 3, 3)
   !> Deformation gradient [-]
   real(wp), intent(in) :: f(3, 3)
   !> The volume is kept
   logical, intent(in) :: rigid
   !> Level, of the shear modulus at rest [-]
   real(wp), intent(in) :: level
   !> Shear modulus at rest [stress]
   real(wp), intent(in) :: modulus
   real(wp) :: minors(3, 3, 3, 3), a(nd*nd, nd*nd), x(nd*nd, nd*nd), turn(3, 3)
   real(wp) :: w(nd*nd), kept, resisted, length, cofactor(nd*nd), s, low, high, lacking
   integer :: i, j, k, n, trial

   surely_above = .false.
   if (.not. (abs(level) < huge(1.0_wp) .and. modulus > 0.0_wp)) return
   n = nd*nd
   minors = 0.0_wp
   call add_cross_form(1.0_wp, f, minors)
   a = reshape(c4(:nd, :nd, :nd, :nd), [n, n])
   x = reshape(minors(:nd, :nd, :nd, :nd), [n, n])
   kept = 0.0_wp
   resisted = 0.0_wp
   length = 0.0_wp
   do k = 1, merge(1, 3, nd == 2)
      ! rotations about the third axis first
      i = 1 + mod(k - 1, 3)
      j = 1 + mod(k, 3)
      turn = 0.0_wp
      turn(i, :) = -f(j, :)
      turn(j, :) = f(i, :)
      w = reshape(turn(:nd, :nd), [n])
      kept = kept + dot_product(w, matmul(a, w))
      resisted = resisted + dot_product(w, matmul(x, w))
      length = length + dot_product(w, w)
   end do
   if (.not. abs(resisted) > 0.0_wp) return
   if (rigid) then
      turn = 0.5_wp*cross(f, f)
      cofactor = reshape(turn(:nd, :nd), [n])
      do k = 1, n
         a(:, k) = a(:, k) + stiffening*modulus*cofactor(k)*cofactor
      end do
   end if
   do k = 1, n
      a(k, k) = a(k, k) - (level + clearance)*modulus
   end do
   s = (modulus*length - kept)/resisted
   low = -huge(1.0_wp)
   high = huge(1.0_wp)
   do trial = 1, trials
      call find_weak(a + s*x, w, lacking, surely_above)
      if (surely_above) return
      resisted = dot_product(w, matmul(x, w))
      if (.not. abs(resisted) > 0.0_wp) return
      if (resisted > 0.0_wp) then
         low = max(low, s + lacking/resisted)
         s = low + beyond*modulus
      else
         high = min(high, s + lacking/resisted)
         s = high - beyond*modulus
      end if
      if (.not. low < high) return
      if (low > -huge(1.0_wp) .and. high < huge(1.0_wp)) s = 0.5_wp*(low + high)
   end do
end function surely_above

!> A motion that a symmetric form does not resist, if a pivot of its Cholesky factor is not
!> positive beyond rounding
pure subroutine find_weak(form, motion, lacking, definite)
   !> Only its lower triangle is used
   real(wp), intent(in) :: form(:, :)
   !> Motion, shape (size(form, 1)), and the stiffness missing, if there is one
   real(wp), intent(out) :: motion(:), lacking
   !> There is no such motion
   logical, intent(out) :: definite
   real(wp) :: a(size(form, 1), size(form, 1)), small
   integer :: j, k, n

   a = form
   n = size(a, 1)
   small = 0.0_wp
   do k = 1, n
      small = max(small, epsilon(1.0_wp)*n*abs(a(k, k)))
   end do
   motion = 0.0_wp
   lacking = 0.0_wp
   definite = .false.
   do k = 1, n
      if (.not. a(k, k) > small) exit
      do j = k + 1, n
         a(j:, j) = a(j:, j) - a(j:, k)*(a(j, k)/a(k, k))
      end do
   end do
   definite = k > n
   if (definite) return
   lacking = small - a(k, k)
   motion(k) = 1.0_wp
   do j = k - 1, 1, -1
      motion(j) = -dot_product(a(j + 1:k, j), motion(j + 1:k))/a(j, j)
   end do
end subroutine find_weak

!> Two unit vectors across a direction
pure subroutine sides_of(n, nd, side)
   !> Unit vector
   real(wp), intent(in) :: n(3)
   integer, intent(in) :: nd
   !> Unit vectors; in the plane only the first counts
   real(wp), intent(out) :: side(3, 2)

   if (nd == 2) then
      side(:, 1) = [-n(2), n(1), 0.0_wp]
   else if (abs(n(3)) < 0.9_wp) then
      side(:, 1) = [-n(2), n(1), 0.0_wp]/norm2(n(:2))
   else
      side(:, 1) = [0.0_wp, -n(3), n(2)]/norm2(n(2:))
   end if
   side(:, 2) = vector_product(n, side(:, 1))
end subroutine sides_of

!> Q(i, k) as a form in the products 11, 22, 33, 23, 13, 12 of a direction's components
pure function products_form(c4) result(form)
   !> Tangent [stress]
   real(wp), intent(in) :: c4(3, 3, 3, 3)
   !> Factors of the products [stress]
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
pure real(wp) function smallest(form, n, m, rigid)
   !> Acoustic tensor by the products of a direction's components [stress]
   real(wp), intent(in) :: form(3, 3, 6)
   !> Direction, unit vector
   real(wp), intent(in) :: n(3)
   !> Direction of the motions that change the volume, of any length
   real(wp), intent(in) :: m(3)
   !> There are no such motions
   logical, intent(in) :: rigid
   real(wp) :: q(3, 3), image(3, 2), side(3, 2), coupling(2), share(2), across(3), a, b, c, stiff
   real(wp) :: principal(3)
   integer :: i, trial

   q = n(1)**2*form(:, :, 1) + n(2)**2*form(:, :, 2) + n(3)**2*form(:, :, 3) &
      & + n(2)*n(3)*form(:, :, 4) + n(1)*n(3)*form(:, :, 5) + n(1)*n(2)*form(:, :, 6)
   across = m/norm2(m)
   call sides_of(across, 3, side)
   image = matmul(q, side)
   a = dot_product(side(:, 1), image(:, 1))
   b = dot_product(side(:, 1), image(:, 2))
   c = dot_product(side(:, 2), image(:, 2))
   smallest = lower(a, b, c)
   if (rigid) return
   ! elimination keeps the digits of shear beside a bulk modulus 1e8 times as large
   stiff = dot_product(across, matmul(q, across))
   coupling = [(dot_product(across, image(:, i)), i=1, 2)]
   if (.not. (stiff - smallest)**2 > apart*dot_product(coupling, coupling)) then
      principal = principal_values(q)
      smallest = principal(3)
      return
   end if
   do trial = 1, eliminations
      share = coupling/sqrt(stiff - smallest)
      smallest = lower(a - share(1)**2, b - share(1)*share(2), c - share(2)**2)
   end do
end function smallest

!> The same in the plane, where one motion keeps the volume
pure real(wp) function smallest_in_plane(form, n, m, rigid) result(smallest)
   real(wp), intent(in) :: form(3, 3, 6)
   real(wp), intent(in) :: n(3)
   !> Direction of the motion that changes the volume, of any length
   real(wp), intent(in) :: m(3)
   !> There is no such motion
   logical, intent(in) :: rigid
   real(wp) :: q(2, 2), along(2), side(2), image(2), a, coupling, half, stiff

   q = n(1)**2*form(:2, :2, 1) + n(2)**2*form(:2, :2, 2) + n(1)*n(2)*form(:2, :2, 6)
   along = m(:2)/sqrt(m(1)**2 + m(2)**2)
   side = [-along(2), along(1)]
   image = q(:, 1)*side(1) + q(:, 2)*side(2)
   a = side(1)*image(1) + side(2)*image(2)
   smallest = a
   if (rigid) return
   coupling = along(1)*image(1) + along(2)*image(2)
   image = q(:, 1)*along(1) + q(:, 2)*along(2)
   stiff = along(1)*image(1) + along(2)*image(2)
   ! both ways keep the digits of the smaller one
   half = 0.5_wp*(stiff - a)
   if (.not. abs(coupling) > 0.0_wp) then
      smallest = min(a, stiff)
   else if (half > 0.0_wp) then
      smallest = a - coupling**2/(half + hypot(half, coupling))
   else
      smallest = stiff - coupling**2/(hypot(half, coupling) - half)
   end if
end function smallest_in_plane

!> Smaller eigenvalue of a symmetric 2x2 matrix
pure real(wp) function lower(a, b, c)
   !> Entries 11, 12, 22
   real(wp), intent(in) :: a, b, c

   lower = 0.5_wp*(a + c) - sqrt((0.5_wp*(a - c))**2 + b**2)
end function lower

end module rk_acoustic
