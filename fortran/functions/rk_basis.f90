!> Monomials (4.9) of total degree up to an order, and their derivatives, in scaled coordinates.
module rk_basis
   use rk_precision, only : wp
   implicit none
   private

   public :: basis_size, basis_powers, monomials, second_index, max_order

   !> Highest total degree
   integer, parameter :: max_order = 6

contains

!> Number of monomials of total degree up to the order
pure integer function basis_size(nd, order)
   !> Space dimension, 1..3
   integer, intent(in) :: nd
   integer, intent(in) :: order
   integer :: i

   basis_size = 1
   do i = 1, nd
      basis_size = basis_size*(order + i)/i
   end do
end function basis_size

!> Position of a second derivative in the list of value, first and second derivatives
!> 1; 1, 2, 3; 11, 12, 13, 22, 23, 33
pure integer function second_index(nd, a, b)
   !> Space dimension, 1..3
   integer, intent(in) :: nd
   !> Directions, in any order
   integer, intent(in) :: a, b

   associate (low => min(a, b), high => max(a, b))
      second_index = 1 + nd + (low - 1)*nd - (low - 1)*(low - 2)/2 + high - low + 1
   end associate
end function second_index

!> Exponents of all monomials, the constant first
pure subroutine basis_powers(nd, order, powers)
   !> Space dimension, 1..3
   integer, intent(in) :: nd
   integer, intent(in) :: order
   !> Exponents, shape (3, basis_size)
   integer, intent(out) :: powers(:, :)
   integer :: degree, i, j, n

   n = 0
   powers = 0
   do degree = 0, order
      do i = degree, 0, -1
         if (nd == 1 .and. i < degree) exit
         do j = degree - i, 0, -1
            if (nd < 3 .and. i + j < degree) exit
            n = n + 1
            powers(:, n) = [i, j, degree - i - j]
         end do
      end do
   end do
end subroutine basis_powers

!> Monomials at one position with first and second derivatives
pure subroutine monomials(nd, order, powers, x, scale, h, dh, ddh)
   !> Space dimension, 1..3
   integer, intent(in) :: nd
   integer, intent(in) :: order
   !> Exponents, shape (3, n)
   integer, intent(in) :: powers(:, :)
   !> Coordinates, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Lengths that make the coordinates dimensionless, shape (nd) [length]
   real(wp), intent(in) :: scale(:)
   !> Values, shape (n) [-]
   real(wp), intent(out) :: h(:)
   !> First derivatives with respect to x, shape (n, nd) [1/length]
   real(wp), intent(out) :: dh(:, :)
   !> Second derivatives in the order of second_index, shape (n, nd(nd+1)/2), or size 0 [1/length^2]
   real(wp), intent(out) :: ddh(:, :)
   ! value, first and second derivative of each power of each coordinate
   real(wp) :: p(0:max_order, 0:2, 3), q
   integer :: d, k, n, i, j, order_d(3)

   p(:, :, nd + 1:) = 0.0_wp
   p(0, 0, :) = 1.0_wp
   do d = 1, nd
      q = 1.0_wp/scale(d)
      p(0, 1:2, d) = 0.0_wp
      do k = 1, order
         p(k, 0, d) = p(k - 1, 0, d)*x(d)*q
         p(k, 1, d) = k*p(k - 1, 0, d)*q
         p(k, 2, d) = k*p(k - 1, 1, d)*q
      end do
   end do
   do n = 1, size(powers, 2)
      associate (a => p(powers(1, n), :, 1), b => p(powers(2, n), :, 2), c => p(powers(3, n), :, 3))
         h(n) = a(1)*b(1)*c(1)
         dh(n, 1) = a(2)*b(1)*c(1)
         if (nd > 1) dh(n, 2) = a(1)*b(2)*c(1)
         if (nd > 2) dh(n, 3) = a(1)*b(1)*c(2)
      end associate
   end do
   if (size(ddh, 2) == 0) return
   do n = 1, size(powers, 2)
      do i = 1, nd
         do j = i, nd
            order_d = 0
            order_d(i) = 1
            order_d(j) = order_d(j) + 1
            ddh(n, second_index(nd, i, j) - 1 - nd) = product_of(order_d)
         end do
      end do
   end do

contains

   pure real(wp) function product_of(o)
      integer, intent(in) :: o(3)
      product_of = p(powers(1, n), o(1), 1)*p(powers(2, n), o(2), 2)*p(powers(3, n), o(3), 3)
   end function product_of

end subroutine monomials

end module rk_basis
