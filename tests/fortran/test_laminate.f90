!> Two tissues in layers: tractions that agree, the mean gradient, and the stress and tangent as
!> derivatives of the least energy; TAP for `meson test`.
program test_laminate
   use rk_deck, only : deck_type, open_deck
   use rk_energies, only : new_material
   use rk_error, only : error_type
   use rk_laminate, only : layers_type
   use rk_material, only : material_item, material_point
   use rk_precision, only : wp
   use rk_tensor, only : determinant, identity
   use rk_text, only : to_text
   use tap, only : check, finish
   implicit none

   !> Random states of each pair of tissues
   integer, parameter :: states = 200
   !> Step of differences
   real(wp), parameter :: small = 1.0e-6_wp
   type(material_item) :: soft, stiff
   integer, allocatable :: seed(:)
   integer :: n, nd

   call random_seed(size=n)
   allocate (seed(n), source=11)
   call random_seed(put=seed)
   do nd = 2, 3
      call make(soft, 1.0_wp, 4.0_wp)
      call make(stiff, 20.0_wp, 80.0_wp)
      call test_states(nd, 'stiff, compressible')
      call make(soft, 1.0_wp, 3.0e3_wp)
      call make(stiff, 3.0_wp, 9.0e3_wp)
      call test_states(nd, 'nearly incompressible')
   end do
   call finish()

contains

!> Neo-Hookean solid
subroutine make(item, mu, bulk)
   type(material_item), intent(out) :: item
   !> Shear and bulk modulus [stress]
   real(wp), intent(in) :: mu, bulk
   character(len=*), parameter :: feed = new_line('a')
   type(deck_type) :: deck
   type(error_type), allocatable :: error

   call open_deck(deck, 'test', 'units = {force = "N", length = "cm"}'//feed//'[[material]]'//feed &
      & //'name = "it"'//feed//'model = "neo-hookean"'//feed//'mu = '//to_text(mu)//feed &
      & //'K = '//to_text(bulk), [character(len=1) ::], '', error)
   if (.not. allocated(error)) call new_material(item, deck, 'material.1', error)
   if (allocated(error)) error stop 'no material'
end subroutine make

!> Least energy without the mean change of volume [stress], stress and tangent
subroutine layers_at(f, fraction, normal, nd, energy, p, c4, apart, mean)
   real(wp), intent(in) :: f(3, 3), fraction(2), normal(3)
   integer, intent(in) :: nd
   real(wp), intent(out) :: energy, p(3, 3), c4(3, 3, 3, 3)
   !> Difference of the tractions over the stresses, and of the mean gradient
   real(wp), intent(out) :: apart, mean
   type(layers_type) :: layers
   type(material_point) :: point
   real(wp) :: r(3)
   integer :: k

   call layers%start(f, fraction, normal, nd, [soft%material%bulk, stiff%material%bulk], &
      & [soft%material%shear, stiff%material%shear])
   point%volumetric = .false.
   do while (.not. layers%done)
      do k = 1, 2
         if (.not. all(layers%j > 0.0_wp)) cycle
         point%f = layers%f(:, :, k)
         if (k == 1) call soft%material%stress(point, layers%p(:, :, k), layers%c4(:, :, :, :, k))
         if (k == 2) call stiff%material%stress(point, layers%p(:, :, k), layers%c4(:, :, :, :, k))
      end do
      call layers%next()
   end do
   c4 = layers%tangent()
   p = layers%stress(0)
   r = matmul(layers%p(:, :, 1) - layers%p(:, :, 2), normal)
   apart = norm2(r(:nd))/(sum(abs(layers%p)))
   mean = maxval(abs(fraction(1)*layers%f(:, :, 1) + fraction(2)*layers%f(:, :, 2) - f))
   energy = -0.5_wp*layers%mean*(determinant(f) - 1.0_wp)**2
   do k = 1, 2
      point%f = layers%f(:, :, k)
      if (k == 1) energy = energy + fraction(1)*soft%material%energy(point)
      if (k == 2) energy = energy + fraction(2)*stiff%material%energy(point)
      energy = energy + 0.5_wp*fraction(k)*layers%bulk(k)*(layers%j(k) - 1.0_wp)**2
   end do
end subroutine layers_at

subroutine test_states(nd, name)
   integer, intent(in) :: nd
   character(len=*), intent(in) :: name
   real(wp) :: f(3, 3), h(3, 3), normal(3), fraction(2), p(3, 3), c4(3, 3, 3, 3), way(3, 3)
   real(wp) :: energy(2), q(3, 3, 2), other(3, 3, 3, 3), apart, mean, scale
   real(wp) :: worst(4)
   integer :: k, s
   integer :: lost

   worst = 0.0_wp
   lost = 0
   do k = 1, states
      call random_number(h)
      call random_number(normal)
      call random_number(way)
      call random_number(fraction(1))
      fraction(1) = 0.02_wp + 0.96_wp*fraction(1)
      fraction(2) = 1.0_wp - fraction(1)
      normal = normal - 0.5_wp
      if (nd == 2) normal(3) = 0.0_wp
      normal = normal/norm2(normal)
      f = identity + 0.9_wp*(h - 0.5_wp)
      f = f/determinant(f)**(1.0_wp/3.0_wp)
      if (nd == 2) then
         f(:, 3) = identity(:, 3)
         f(3, :) = identity(3, :)
         f(:2, :2) = f(:2, :2)/sqrt(determinant(f))
         way(:, 3) = 0.0_wp
         way(3, :) = 0.0_wp
      end if
      call layers_at(f, fraction, normal, nd, energy(1), p, c4, apart, mean)
      if (apart > 1.0e-6_wp) lost = lost + 1
      worst(1) = max(worst(1), apart)
      worst(2) = max(worst(2), mean)
      do s = 1, 2
         call layers_at(f + merge(small, -small, s == 1)*way, fraction, normal, nd, energy(s), &
            & q(:, :, s), other, apart, mean)
      end do
      scale = sum(abs(p)) + 1.0_wp
      worst(3) = max(worst(3), abs((energy(1) - energy(2))/(2.0_wp*small) - sum(p*way))/scale)
      scale = sum(abs(c4))/9.0_wp
      worst(4) = max(worst(4), maxval(abs((q(:, :, 1) - q(:, :, 2))/(2.0_wp*small) &
         & - reshape(matmul(reshape(c4, [9, 9]), reshape(way, [9])), [3, 3])))/scale)
   end do
   print '(a,i0,a,4es10.2,i4)', '# '//name//' ', nd, ': ', worst, lost
   call check(name//': tractions agree', worst(1) < 1.0e-7_wp)
   call check(name//': mean gradient', worst(2) < 1.0e-14_wp*10.0_wp)
   call check(name//': stress is the derivative of the energy', worst(3) < 1.0e-5_wp)
   call check(name//': tangent is that of the stress', worst(4) < 1.0e-5_wp)
end subroutine test_states

end program test_laminate
