!> Values of a deck that are numbers or expressions in coordinates.
module rk_deck_expression
   use rk_deck, only : deck_type
   use rk_expression, only : expression_type
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: read_expression, read_value, read_values

contains

!> A text that is an expression; nothing where the key has no value
subroutine read_expression(deck, key, expression)
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Full key
   character(len=*), intent(in) :: key
   !> Expression
   type(expression_type), intent(out) :: expression

   if (.not. deck%has(key)) return
   call deck%get(key, expression%text)
   expression%where = deck%told(key)
   call add_tables(expression, deck)
end subroutine read_expression

!> A number or an expression
subroutine read_value(deck, key, value, expression)
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Full key, which has a value
   character(len=*), intent(in) :: key
   !> Number; as it was where there is an expression
   real(wp), intent(inout) :: value
   !> Expression, not given where there is a number
   type(expression_type), intent(out) :: expression

   if (deck%is_text(key)) then
      call read_expression(deck, key, expression)
   else
      call deck%get(key, value)
   end if
end subroutine read_value

!> An array of numbers and expressions; nothing where the key has no value
subroutine read_values(deck, key, value, expression)
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Full key
   character(len=*), intent(in) :: key
   !> Numbers, those that are not in the deck as they were, shape (3)
   real(wp), intent(inout) :: value(:)
   !> Expressions, given for all items where one of them is a text, shape (3)
   type(expression_type), intent(inout) :: expression(:)
   character(len=:), allocatable :: lines
   real(wp), allocatable :: numbers(:)
   integer :: first, i, length

   call deck%get(key, numbers)
   value(:size(numbers)) = numbers
   if (size(numbers) > 0) return
   call deck%get(key, lines)
   first = 1
   do i = 1, size(expression)
      length = index(lines(first:), new_line('a'))
      if (length == 0) return
      expression(i)%text = lines(first:first + length - 2)
      expression(i)%where = deck%told(key)
      call add_tables(expression(i), deck)
      first = first + length
   end do
end subroutine read_values

!> Add the tables of the deck
subroutine add_tables(expression, deck)
   !> Expression that is given
   type(expression_type), intent(inout) :: expression
   !> Deck
   type(deck_type), intent(in) :: deck
   character(len=:), allocatable :: at, curve, name
   real(wp), allocatable :: x(:), value(:)
   integer :: k

   do k = 1, deck%count('table')
      at = 'table.'//to_text(k)
      call deck%get(at//'.name', name)
      if (index(expression%text, name) == 0) cycle
      call deck%get(at//'.x', x)
      call deck%get(at//'.value', value)
      call deck%get(at//'.curve', curve)
      call expression%add_table(name, x, value, curve == 'smooth')
   end do
end subroutine add_tables

end module rk_deck_expression
