! Python boundary of the materials: plain arrays in, plain arrays out. A material is given by the
! text of a deck, of which it is the first material.

!> Energy, stress, tangent and contracted third derivative at points, each of which writes only its
!> own part of the result
subroutine material_at_points(deck_text, volumetric, nd, np, f, h, fiber, activation, w, p, c4, t, &
   & stat, message)
   use rk_deck, only : deck_type, open_deck
   use rk_energies, only : new_material
   use rk_error, only : error_type, pack_error
   use rk_material, only : material_point, material_type
   implicit none
   !f2py threadsafe
   integer, intent(in) :: volumetric, nd, np
   character(len=*), intent(in) :: deck_text
   double precision, intent(in) :: activation
   double precision, intent(in) :: f(3, 3, np), h(3, 3, 3, np), fiber(3, np)
   double precision, intent(out) :: w(np), p(3, 3, np), c4(3, 3, 3, 3, np), t(3, 3, 3, np)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(deck_type) :: deck
   type(error_type), allocatable :: error
   class(material_type), allocatable :: material
   type(material_point) :: at
   double precision :: pull(3)
   double precision, parameter :: still(3, 3) = 0.0d0
   integer :: ip

   w = 0.0d0
   p = 0.0d0
   c4 = 0.0d0
   t = 0.0d0
   call open_deck(deck, 'tables', deck_text, [character(len=1) ::], '', error)
   if (.not. allocated(error)) call new_material(material, deck, 'material.1', error)
   call pack_error(error, stat, message)
   if (stat /= 0) return
   !$omp parallel do default(none) schedule(static) private(ip, at, pull) &
   !$omp shared(material, nd, np, f, h, fiber, activation, volumetric, w, p, c4, t)
   do ip = 1, np
      at = material_point(f(:, :, ip), fiber(:, ip), activation, volumetric /= 0)
      w(ip) = material%energy(at)
      call material%strong(nd, at, h(:, :, :, ip), still, p(:, :, ip), c4(:, :, :, :, ip), pull, &
         & t(:, :, :, ip))
   end do
   !$omp end parallel do
end subroutine material_at_points
