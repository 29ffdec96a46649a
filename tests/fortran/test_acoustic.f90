!> The bound that spares most points the search for their least acoustic eigenvalue, beside that
!> search; TAP for `meson test`.
program test_acoustic
   use rk_acoustic, only : least_acoustic, surely_above
   use rk_precision, only : wp
   use rk_tensor, only : add_cross_form, cross, identity
   use tap, only : check, finish
   implicit none

   !> Shear and bulk modulus [stress], random states of each kind
   real(wp), parameter :: shear = 3.0_wp, bulk = 300.0_wp
   integer, parameter :: states = 2000
   integer, allocatable :: seed(:)
   integer :: n, nd

   call random_seed(size=n)
   allocate (seed(n), source=7)
   call random_seed(put=seed)
   do nd = 2, 3
      call test_bound(nd, .false.)
      call test_bound(nd, .true.)
   end do
   call finish()

contains

!> It never claims too much, and a linear elastic solid has nearly all of its shear modulus
subroutine test_bound(nd, rigid)
   !> Space dimension
   integer, intent(in) :: nd
   !> The volume is kept
   logical, intent(in) :: rigid
   real(wp) :: c4(3, 3, 3, 3), f(3, 3), h(3, 3), noise(3, 3, 3, 3), pressure, level, least
   integer :: i, j, k, l, bounded, wrong, missed, stiff

   bounded = 0
   wrong = 0
   missed = 0
   stiff = 0
   do k = 1, states
      call random_number(h)
      call random_number(noise)
      call random_number(pressure)
      call random_number(level)
      f = identity + 0.4_wp*(h - 0.5_wp)
      if (nd == 2) f(:, 3) = identity(:, 3)
      if (nd == 2) f(3, :) = identity(3, :)
      c4 = 0.0_wp
      do j = 1, 3
         do i = 1, 3
            c4(i, j, i, j) = shear
         end do
      end do
      if (.not. rigid) then
         h = 0.5_wp*cross(f, f)
         do l = 1, 3
            do j = 1, 3
               c4(:, :, j, l) = c4(:, :, j, l) + bulk*h*h(j, l)
            end do
         end do
      end if
      ! a pressure changes no eigenvalue
      call add_cross_form(20.0_wp*shear*(pressure - 0.5_wp), f, c4)
      if (.not. surely_above(nd, c4, f, rigid, 0.7_wp, shear)) missed = missed + 1
      if (surely_above(nd, 1.5_wp*c4, f, rigid, 1.2_wp, shear)) stiff = stiff + 1
      do j = 1, 3
         do i = 1, 3
            c4(:, :, i, j) = c4(:, :, i, j) + 0.4_wp*shear*(noise(:, :, i, j) - 0.5_wp)
            c4(i, j, :, :) = c4(i, j, :, :) + 0.4_wp*shear*(noise(:, :, i, j) - 0.5_wp)
         end do
      end do
      if (.not. surely_above(nd, c4, f, rigid, level, shear)) cycle
      bounded = bounded + 1
      least = least_acoustic(nd, c4, 0.5_wp*cross(f, f), rigid)/shear
      if (.not. least > level) wrong = wrong + 1
   end do
   call check('no eigenvalue is below what is surely so', wrong == 0)
   call check('something is surely above', bounded > states/20)
   call check('of an elastic solid under pressure most of its shear modulus is', missed < states/20)
   call check('of one that has grown stiffer most of what it has now is', stiff > states/2)
end subroutine test_bound

end program test_acoustic
