!> Loads of linear problems in the Galerkin form: body forces, and pins that hold what nothing
!> pushes.
module rk_weak_loads
   use rk_basis, only : second_index
   use rk_coefficients, only : moduli
   use rk_error, only : error_type
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   use rk_shape, only : derivative_count, shape_type
   use rk_solutions, only : exact_field, source_at
   use rk_symmetric, only : symmetric_matrix
   implicit none
   private

   public :: add_pins, body_force

contains

!> Body force at places: that of the deck, or minus the operator of the known solution
function body_force(scene, place, pair, fields, time, error) result(b)
   !> Scene with an equation
   type(scene_type), intent(in) :: scene
   !> Places, shape (nd, np) [length]
   real(wp), intent(in) :: place(:, :)
   !> Coefficients of the equation at each, shape (2, np)
   real(wp), intent(in) :: pair(:, :)
   !> Number of fields
   integer, intent(in) :: fields
   !> Time, of no meaning where nothing moves
   real(wp), intent(in) :: time
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(inout) :: error
   !> Body force, shape (fields, np)
   real(wp) :: b(fields, size(place, 2))
   real(wp), allocatable :: c(:, :, :, :)
   real(wp) :: u(fields, derivative_count(size(place, 1)))
   integer :: a, d, nd, q

   nd = size(place, 1)
   b = 0.0_wp
   if (scene%equation%is_own()) then
      do q = 1, size(b, 2)
         call source_at(scene%equation, place(:, q), time, b(:, q), error)
         if (allocated(error)) return
      end do
      return
   end if
   c = moduli(scene%equation, nd, pair(:, 1))
   do q = 1, size(b, 2)
      call exact_field(scene%equation, place(:, q), u)
      do d = 1, nd
         do a = 1, nd
            b(:, q) = b(:, q) - matmul(c(:, a, :, d), u(:, second_index(nd, min(a, d), max(a, d))))
         end do
      end do
   end do
end function body_force

!> Add springs at the pins
subroutine add_pins(scene, shape, stiffness, matrix, force)
   !> Scene with an equation
   type(scene_type), intent(in) :: scene
   !> Shape functions at the collocation points
   type(shape_type), intent(in) :: shape
   !> Penalty of the pins [stress]
   real(wp), intent(in) :: stiffness
   !> Stiffness, to which that of the springs is added
   type(symmetric_matrix), intent(inout) :: matrix
   !> Forces, to which those of the springs are added, shape (n)
   real(wp), intent(inout) :: force(:)
   real(wp), allocatable :: part(:, :), added(:)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   real(wp) :: spring, u(matrix%block, shape%nq)
   integer :: b, i, k, l, nf, pin

   nf = matrix%block
   spring = stiffness*scene%cloud%mean_spacing()**(scene%cloud%nd - 2)
   do pin = 1, size(scene%equation%pin)
      associate (pinned => scene%equation%pin(pin), points => scene%cloud%points)
         b = minloc([(norm2(points(:, k) - pinned%point(:scene%cloud%nd)), k=1, size(points, 2))], &
            & dim=1)
         u = 0.0_wp
         if (.not. scene%equation%is_own()) call exact_field(scene%equation, points(:, b), u)
         call shape%row(b, nodes, values)
         allocate (part(nf*size(nodes), nf*size(nodes)), source=0.0_wp)
         do i = 1, nf
            if (.not. pinned%fixed(i)) cycle
            do l = 1, size(nodes)
               associate (entry => nf*(l - 1) + i, at => nf*(nodes(l) - 1) + i)
                  do k = 1, l
                     part(nf*(k - 1) + i, entry) = spring*values(1, k)*values(1, l)
                  end do
                  force(at) = force(at) + spring*values(1, l)*u(i, 1)
               end associate
            end do
         end do
      end associate
      call move_alloc(matrix%value, added)
      call matrix%add(added, nodes, part)
      call move_alloc(added, matrix%value)
      deallocate (part)
   end do
end subroutine add_pins

end module rk_weak_loads
