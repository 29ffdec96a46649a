!> Bodies and parts of them that prescribed displacements and springs leave free to move as a whole.
!> Shape functions do not reach across gaps, so each part must be constrained; in statics there is
!> no solution with an unconstrained rigid motion, whatever the loads.
module rk_islands
   use rk_error, only : error_type, fatal_error, err_input
   use rk_precision, only : wp
   use rk_shape, only : shape_type
   use rk_text, only : to_text
   implicit none
   private

   public :: check_islands

   !> Motion of supported components, relative to the body's size, below which a motion is free [-]
   real(wp), parameter :: free = 1.0e-5_wp
   !> Names of the axes
   character(len=1), parameter :: axis(3) = ['x', 'y', 'z']

contains

!> Refuse a body with a part that can move as a whole
subroutine check_islands(shape, link, place, point, supported, error)
   !> Shape functions; places beyond those given are ignored
   type(shape_type), target, intent(in) :: shape
   !> Those at the points that join source points: where rows or integrals are
   type(shape_type), target, intent(in) :: link
   !> Collocation points, shape (nd, nc) [length]
   real(wp), intent(in) :: place(:, :)
   !> Collocation point of each boundary point, shape (nb)
   integer, intent(in) :: point(:)
   !> Whether a component of the displacement is prescribed or sprung there, shape (nd, nb)
   logical, intent(in) :: supported(:, :)
   !> Error handling: names the part and its motions
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: motions, where_
   integer, allocatable :: part(:), of_place(:), of_boundary(:), mine(:)
   real(wp), pointer, contiguous :: values(:, :)
   integer, pointer, contiguous :: nodes(:)
   integer :: i, ip, first, k, members

   allocate (part(shape%ns), source=[(ip, ip=1, shape%ns)])
   ! source points that cover one of these points belong together
   do ip = 1, link%np
      call link%row(ip, nodes, values)
      first = part_of(part, nodes(1))
      do k = 2, size(nodes)
         part(part_of(part, nodes(k))) = first
      end do
   end do
   allocate (of_place(size(place, 2)))
   do ip = 1, size(place, 2)
      call shape%row(ip, nodes, values)
      of_place(ip) = part_of(part, nodes(1))
   end do
   of_boundary = of_place(point)
   do ip = 1, size(place, 2)
      first = of_place(ip)
      ! each part once, at its first point
      if (findloc(of_place, first, dim=1) /= ip) cycle
      mine = pack([(i, i=1, size(point))], of_boundary == first)
      call get_free_motions(place(:, point(mine)), supported(:, mine), motions)
      if (len(motions) == 0) cycle
      members = count(of_place == first)
      if (any(supported(:, mine))) then
         where_ = 'the body'
         if (members < size(place, 2)) where_ = 'the '//to_text(members)//' collocation points ' &
            & //'around '//to_text(place(:, ip))//', which are not connected to the rest,'
         call fatal_error(error, err_input, 'prescribed displacements and springs leave '//where_ &
            & //' free to '//motions//'; prescribe components that prevent it, as on a ' &
            & //'symmetry plane')
      else
         where_ = 'the body, which can move freely: hold it by a boundary set'
         if (members < size(place, 2)) where_ = 'the '//to_text(members)//' points around ' &
            & //to_text(place(:, ip))//', which are not connected to the rest and can move ' &
            & //'freely: hold them by a boundary set, or leave them out of the model'
         call fatal_error(error, err_input, 'no displacement is prescribed on '//where_)
      end if
      return
   end do

end subroutine check_islands

!> Rigid motions that supported components do not prevent, in words; empty where there are none. The
!> quadratic form of the motions of these components is eliminated motion by motion: where a pivot
!> vanishes, that motion is free, combined with the motions before it that the elimination gives.
subroutine get_free_motions(place, supported, text)
   !> Boundary points, shape (nd, n) [length]
   real(wp), intent(in) :: place(:, :)
   !> Whether a component is prescribed or sprung, shape (nd, n)
   logical, intent(in) :: supported(:, :)
   character(len=:), allocatable, intent(out) :: text
   real(wp) :: form(6, 6), row(6), motion(6), x(3), centre(3), size_
   logical :: held(6)
   integer :: nd, i, j, k, n, p

   nd = size(place, 1)
   n = merge(3, 6, nd == 2)
   centre = 0.0_wp
   size_ = 1.0_wp
   if (size(place, 2) > 0) then
      centre(:nd) = sum(place, dim=2)/size(place, 2)
      size_ = max(maxval(maxval(place, dim=2) - minval(place, dim=2)), tiny(1.0_wp))
   end if
   form = 0.0_wp
   do p = 1, size(place, 2)
      x = 0.0_wp
      x(:nd) = (place(:, p) - centre(:nd))/size_
      do i = 1, nd
         if (.not. supported(i, p)) cycle
         row = 0.0_wp
         row(i) = 1.0_wp
         if (nd == 2) then
            row(3) = merge(-x(2), x(1), i == 1)
         else
            ! component i of a rotation about axis k: e_k x x
            row(4 + modulo(i, 3)) = x(1 + modulo(i + 1, 3))
            row(4 + modulo(i + 1, 3)) = -x(1 + modulo(i, 3))
         end if
         do j = 1, n
            form(:, j) = form(:, j) + row*row(j)
         end do
      end do
   end do
   form = form/max(size(place, 2), 1)
   text = ''
   held = .false.
   do j = 1, n
      if (form(j, j) > free**2) then
         held(j) = .true.
         do k = j + 1, n
            form(j + 1:n, k) = form(j + 1:n, k) - form(j + 1:n, j)*form(j, k)/form(j, j)
         end do
         cycle
      end if
      motion = 0.0_wp
      motion(j) = 1.0_wp
      do k = j - 1, 1, -1
         if (held(k)) motion(k) = -dot_product(form(k, k + 1:j), motion(k + 1:j))/form(k, k)
      end do
      if (len(text) > 0) text = text//', to '
      if (j <= nd) then
         text = text//'slide along '
         call append_direction(text, motion(:nd))
      else if (nd == 2) then
         text = text//'turn in its plane'
      else
         text = text//'turn about an axis along '
         call append_direction(text, motion(4:))
      end if
   end do
end subroutine get_free_motions

!> Append a direction in words
subroutine append_direction(text, v)
   character(len=:), allocatable, intent(inout) :: text
   !> Vector, its last entry of length one
   real(wp), intent(in) :: v(:)
   integer :: i, k

   i = maxloc(abs(v), dim=1)
   if (all(abs(pack(v, [(k, k=1, size(v))] /= i)) < 1.0e-3_wp)) then
      text = text//axis(i)
   else
      text = text//to_text(v)
   end if
end subroutine append_direction

!> Representative of a source point's part, with path halving
integer function part_of(part, is)
   !> Next member towards the representative, shape (ns)
   integer, intent(inout) :: part(:)
   !> Source point
   integer, intent(in) :: is

   part_of = is
   do while (part(part_of) /= part_of)
      part(part_of) = part(part(part_of))
      part_of = part(part_of)
   end do
end function part_of

end module rk_islands
