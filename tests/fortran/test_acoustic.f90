!> The least eigenvalue of acoustic tensors, which no direction may undercut; TAP for `meson test`.
program test_acoustic
   use rk_acoustic, only : least_acoustic
   use rk_precision, only : wp
   use rk_tensor, only : add_cross_form, cofactor, identity, principal_values
   use tap, only : check, finish
   implicit none

   !> Shear and bulk modulus [stress], random states of each kind
   real(wp), parameter :: shear = 3.0_wp, bulk = 300.0_wp
   integer, parameter :: states = 500
   integer, allocatable :: seed(:)
   integer :: n, nd

   call random_seed(size=n)
   allocate (seed(n), source=7)
   call random_seed(put=seed)
   do nd = 2, 3
      call test_least(nd, .false.)
      call test_least(nd, .true.)
   end do
   call finish()

contains

!> An elastic solid has its shear modulus under any pressure; of other tangents no random direction
!> has less than was found
subroutine test_least(nd, rigid)
   !> Space dimension
   integer, intent(in) :: nd
   !> The volume is kept
   logical, intent(in) :: rigid
   real(wp) :: c4(3, 3, 3, 3), f(3, 3), h(3, 3), noise(3, 3, 3, 3), q(3, 3), e(3), n(3), m(3)
   real(wp) :: pressure, least
   integer :: i, j, k, l, elastic, wrong

   elastic = 0
   wrong = 0
   do k = 1, states
      call random_number(h)
      call random_number(noise)
      call random_number(pressure)
      call random_number(n)
      f = identity + 0.4_wp*(h - 0.5_wp)
      if (nd == 2) f(:, 3) = identity(:, 3)
      if (nd == 2) f(3, :) = identity(3, :)
      h = cofactor(f)
      c4 = 0.0_wp
      do j = 1, 3
         do i = 1, 3
            c4(i, j, i, j) = shear
            if (.not. rigid) c4(:, :, i, j) = c4(:, :, i, j) + bulk*h*h(i, j)
         end do
      end do
      ! a pressure changes no eigenvalue
      call add_cross_form(20.0_wp*shear*(pressure - 0.5_wp), f, c4)
      least = least_acoustic(nd, c4, h, rigid)
      if (abs(least - shear) < 1.0e-6_wp*shear) elastic = elastic + 1
      do j = 1, 3
         do i = 1, 3
            c4(:, :, i, j) = c4(:, :, i, j) + 0.4_wp*shear*(noise(:, :, i, j) - 0.5_wp)
            c4(i, j, :, :) = c4(i, j, :, :) + 0.4_wp*shear*(noise(:, :, i, j) - 0.5_wp)
         end do
      end do
      least = least_acoustic(nd, c4, h, rigid)
      n = n - 0.5_wp
      if (nd == 2) n(3) = 0.0_wp
      n = n/norm2(n)
      q = 0.0_wp
      do l = 1, 3
         do j = 1, 3
            q = q + n(j)*n(l)*c4(:, j, :, l)
         end do
      end do
      ! motions out of the plane, and those that change the volume, are no motions
      if (nd == 2) q(3, 3) = bulk*sum(q**2)
      m = matmul(h, n)
      if (rigid) then
         do j = 1, 3
            q(:, j) = q(:, j) - m*dot_product(m, q(:, j))/dot_product(m, m)
         end do
         q = transpose(q)
         do j = 1, 3
            q(:, j) = q(:, j) - m*dot_product(m, q(:, j))/dot_product(m, m)
            q(:, j) = q(:, j) + 10.0_wp*bulk*m*m(j)
         end do
      end if
      e = principal_values(q)
      ! of 500 rough tangents one has its least in a hollow between the first directions
      if (least > e(3) + 0.1_wp*shear) wrong = wrong + 1
   end do
   call check('an elastic solid has its shear modulus under pressure', elastic == states)
   call check('no direction has less than the least', wrong == 0)
end subroutine test_least

end program test_acoustic
