!> Products of gradients with displacements and stresses, with lengths and strides known to the
!> compiler: they take most of the time of solids whose tangent is never formed, and much of that of
!> plane bodies. Volumes of a group are treated like rows of the tangent: one force per polynomial.
!>
!> All take the number of source points in the support, their places among those of the group, shape
!> (n), and the gradients of their shape functions, shape (nd, n) [1/length]: those of a solid,
!> where nothing is lifted, or those of both components of a plane body, which may differ.
module rk_solid_products
   use rk_precision, only : wp
   implicit none
   private

   public :: plane_force, plane_gradient, plane_work, solid_force, solid_gradient, solid_work

contains

!> Add the displacement gradient of a solid
pure subroutine solid_gradient(n, local, value, x, h)
   integer, intent(in) :: n, local(*)
   real(wp), intent(in) :: value(3, *)
   !> Coefficients of the group's source points, shape (3, members) [length]
   real(wp), intent(in) :: x(3, *)
   !> Gradient u_i,A, shape (3, 3) [-]
   real(wp), intent(inout) :: h(3, 3)
   real(wp) :: row(3, 3), v(3)
   integer :: e

   row = 0.0_wp
   do e = 1, n
      v = value(:, e)
      row(:, 1) = row(:, 1) + x(1, local(e))*v
      row(:, 2) = row(:, 2) + x(2, local(e))*v
      row(:, 3) = row(:, 3) + x(3, local(e))*v
   end do
   h = h + transpose(row)
end subroutine solid_gradient

!> Add the forces of a stress in a solid
pure subroutine solid_force(n, local, value, p, force)
   integer, intent(in) :: n, local(*)
   real(wp), intent(in) :: value(3, *)
   !> Stress times weight, shape (3, 3), index (i, A) [stress length^nd]
   real(wp), intent(in) :: p(3, 3)
   !> Forces on the group's source points, shape (3, members) [force]
   real(wp), intent(inout) :: force(3, *)
   real(wp) :: own(3)
   integer :: e, k

   do e = 1, n
      own = force(:, local(e))
      do k = 1, 3
         own = own + p(:, k)*value(k, e)
      end do
      force(:, local(e)) = own
   end do
end subroutine solid_force

!> Add the displacement gradient of a plane body
pure subroutine plane_gradient(n, local, first, second, x, h)
   integer, intent(in) :: n, local(*)
   real(wp), intent(in) :: first(2, *), second(2, *)
   !> Coefficients of the group's source points, shape (2, members) [length]
   real(wp), intent(in) :: x(2, *)
   !> Gradient u_i,A, shape (2, 2) [-]
   real(wp), intent(inout) :: h(2, 2)
   real(wp) :: row(2, 2)
   integer :: e

   row = 0.0_wp
   do e = 1, n
      row(:, 1) = row(:, 1) + x(1, local(e))*first(:, e)
      row(:, 2) = row(:, 2) + x(2, local(e))*second(:, e)
   end do
   h = h + transpose(row)
end subroutine plane_gradient

!> Add the forces of a stress in a plane body
pure subroutine plane_force(n, local, first, second, p, force)
   integer, intent(in) :: n, local(*)
   real(wp), intent(in) :: first(2, *), second(2, *)
   !> Stress times weight, shape (2, 2), index (i, A) [stress length^nd]
   real(wp), intent(in) :: p(2, 2)
   !> Forces on the group's source points, shape (2, members) [force]
   real(wp), intent(inout) :: force(2, *)
   integer :: e

   do e = 1, n
      force(1, local(e)) = force(1, local(e)) + p(1, 1)*first(1, e) + p(1, 2)*first(2, e)
      force(2, local(e)) = force(2, local(e)) + p(2, 1)*second(1, e) + p(2, 2)*second(2, e)
   end do
end subroutine plane_force

!> Add the work of a stress in a plane body on its displacements, with several factors
pure subroutine plane_work(n, local, first, second, p, factor, work)
   integer, intent(in) :: n, local(*)
   real(wp), intent(in) :: first(2, *), second(2, *)
   !> Stress times weight, shape (2, 2), index (i, A) [stress length^nd]
   real(wp), intent(in) :: p(2, 2)
   !> Factors
   real(wp), intent(in) :: factor(4)
   !> Work on the displacements of the group's source points, shape (4, 2, members)
   real(wp), intent(inout) :: work(4, 2, *)
   real(wp) :: force(2)
   integer :: e

   do e = 1, n
      force(1) = p(1, 1)*first(1, e) + p(1, 2)*first(2, e)
      force(2) = p(2, 1)*second(1, e) + p(2, 2)*second(2, e)
      work(:, 1, local(e)) = work(:, 1, local(e)) + force(1)*factor
      work(:, 2, local(e)) = work(:, 2, local(e)) + force(2)*factor
   end do
end subroutine plane_work

!> Add the work of a stress in a solid on its displacements, with several factors
pure subroutine solid_work(n, local, value, p, factor, work)
   integer, intent(in) :: n, local(*)
   real(wp), intent(in) :: value(3, *)
   !> Stress times weight, shape (3, 3), index (i, A) [stress length^nd]
   real(wp), intent(in) :: p(3, 3)
   !> Factors
   real(wp), intent(in) :: factor(4)
   !> Work on the displacements of the group's source points, shape (4, 3, members)
   real(wp), intent(inout) :: work(4, 3, *)
   real(wp) :: force
   integer :: e, i

   do e = 1, n
      do i = 1, 3
         force = p(i, 1)*value(1, e) + p(i, 2)*value(2, e) + p(i, 3)*value(3, e)
         work(:, i, local(e)) = work(:, i, local(e)) + force*factor
      end do
   end do
end subroutine solid_work

end module rk_solid_products
