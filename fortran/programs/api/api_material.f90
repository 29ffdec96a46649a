! Python boundary of the materials: plain arrays in, plain arrays out. A material comes as its name
! and its parameters by the keys of a deck: n keys, their texts (blank for numbers), their numbers.

!> Energy at points
subroutine material_energy(name, n, keys, texts, numbers, volumetric, np, f, fiber, activation, &
   & w, stat, message)
   use rk_error, only : error_type
   use rk_material, only : material_item
   use rk_material_points, only : energy_at_points
   use rk_pack, only : pack_error, unpack_material
   implicit none
   !f2py threadsafe
   integer, intent(in) :: n, volumetric, np
   character(len=*), intent(in) :: name, keys(n), texts(n)
   double precision, intent(in) :: numbers(n), activation
   double precision, intent(in) :: f(3, 3, np), fiber(3, np)
   double precision, intent(out) :: w(np)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(material_item) :: item

   w = 0.0d0
   call unpack_material(item, name, keys, texts, numbers, error)
   call pack_error(error, stat, message)
   if (stat /= 0) return
   call energy_at_points(item%material, f, fiber, activation, volumetric /= 0, w)
end subroutine material_energy

!> Stress at points
subroutine material_stress(name, n, keys, texts, numbers, volumetric, np, f, fiber, activation, &
   & p, stat, message)
   use rk_error, only : error_type
   use rk_material, only : material_item
   use rk_material_points, only : stress_at_points
   use rk_pack, only : pack_error, unpack_material
   implicit none
   !f2py threadsafe
   integer, intent(in) :: n, volumetric, np
   character(len=*), intent(in) :: name, keys(n), texts(n)
   double precision, intent(in) :: numbers(n), activation
   double precision, intent(in) :: f(3, 3, np), fiber(3, np)
   double precision, intent(out) :: p(3, 3, np)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(material_item) :: item

   p = 0.0d0
   call unpack_material(item, name, keys, texts, numbers, error)
   call pack_error(error, stat, message)
   if (stat /= 0) return
   call stress_at_points(item%material, f, fiber, activation, volumetric /= 0, p)
end subroutine material_stress

!> Stress, tangent and contracted third derivative at points
subroutine material_strong(name, n, keys, texts, numbers, volumetric, nd, np, f, h, fiber, &
   & activation, p, c4, t, stat, message)
   use rk_error, only : error_type
   use rk_material, only : material_item
   use rk_material_points, only : strong_at_points
   use rk_pack, only : pack_error, unpack_material
   implicit none
   !f2py threadsafe
   integer, intent(in) :: n, volumetric, nd, np
   character(len=*), intent(in) :: name, keys(n), texts(n)
   double precision, intent(in) :: numbers(n), activation
   double precision, intent(in) :: f(3, 3, np), h(3, 3, 3, np), fiber(3, np)
   double precision, intent(out) :: p(3, 3, np), c4(3, 3, 3, 3, np), t(3, 3, 3, np)
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   type(material_item) :: item

   p = 0.0d0
   c4 = 0.0d0
   t = 0.0d0
   call unpack_material(item, name, keys, texts, numbers, error)
   call pack_error(error, stat, message)
   if (stat /= 0) return
   call strong_at_points(item%material, nd, f, h, fiber, activation, volumetric /= 0, &
      & p, c4, t)
end subroutine material_strong

!> Force of fibers against their stretch: integral, force and three slopes
subroutine fiber_curves(smooth, gamma1, gamma2, n, stretch, active, passive)
   use rk_fiber, only : active_curve, curve_type, evaluate_curve, passive_curve
   implicit none
   !f2py threadsafe
   integer, intent(in) :: smooth, n
   double precision, intent(in) :: gamma1, gamma2, stretch(n)
   double precision, intent(out) :: active(5, n), passive(5, n)
   type(curve_type) :: curve(2)
   integer :: i

   curve = [active_curve(smooth /= 0), passive_curve(smooth /= 0, gamma1, gamma2)]
   do i = 1, n
      call evaluate_curve(curve(1), stretch(i), 4, active(:, i))
      call evaluate_curve(curve(2), stretch(i), 4, passive(:, i))
   end do
end subroutine fiber_curves
