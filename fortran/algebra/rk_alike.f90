!> Find equal rows of numbers: on a lattice most stencils differ only by rounding, and if each is
!> stored once they stay in the cache.
module rk_alike
   use rk_csr, only : csr_type, group_by
   use rk_precision, only : i8, wp
   implicit none
   private

   public :: find_alike

   !> Tolerance for numbers that are equal up to rounding, relative to the largest of the row [-]
   real(wp), parameter :: equal = 1.0e-11_wp

contains

!> For each row, find the first row that is equal to it (itself if there is none before it)
pure subroutine find_alike(first, number, value, same)
   !> Row i has the numbers value(first(i)+1 : first(i)+number(i)), shape (rows) each
   integer(i8), intent(in) :: first(:), number(:)
   !> Numbers
   real(wp), intent(in) :: value(*)
   !> First row that is equal to each one, shape (rows)
   integer, allocatable, intent(out) :: same(:)
   type(csr_type) :: places
   integer, allocatable :: bucket(:)
   real(wp), allocatable :: key(:), weight(:)
   real(wp) :: unit
   integer(i8) :: k
   integer :: i

   allocate (key(size(first)), same(size(first)))
   ! equal rows have equal weighted sums up to rounding, whatever the weights
   weight = [(modulo(0.618_wp*k, 1.0_wp), k=1, maxval([0_i8, number]))]
   do i = 1, size(first)
      key(i) = 0.0_wp
      do k = 1, number(i)
         key(i) = key(i) + weight(k)*value(first(i) + k)
      end do
   end do
   unit = max(100.0_wp*equal*maxval(abs(key)), tiny(1.0_wp))
   bucket = 1 + int(modulo(floor(key/unit, i8), size(first, kind=i8)))
   call group_by(size(first), bucket, places)
   do i = 1, size(first)
      same(i) = i
      do k = places%offset(bucket(i)) + 1, places%offset(bucket(i) + 1)
         associate (other => places%index(k))
            if (other == i) exit
            if (same(other) /= other .or. number(other) /= number(i)) cycle
            if (.not. near(int(number(i)), value(first(i) + 1), value(first(other) + 1))) cycle
            same(i) = other
            exit
         end associate
      end do
   end do
end subroutine find_alike

!> Whether two rows are equal up to rounding
pure logical function near(n, x, y)
   !> Numbers of each
   integer, intent(in) :: n
   !> Rows
   real(wp), intent(in) :: x(n), y(n)

   near = all(abs(x - y) <= equal*maxval(abs(y)))
end function near

end module rk_alike
