!> Units of what a solve finds, in the words of the deck: the only place that makes them.
module rk_units
   use rk_deck, only : deck_type
   use rk_json, only : json_type
   use rk_probes, only : quantity_kind
   use rk_text, only : to_text
   implicit none
   private

   public :: probe_unit, put_probe_units, put_units, set_unit

contains

!> Unit of a probe, empty for what has none. In fewer than three dimensions forces, torques and
!> energies are those of a unit of thickness
function probe_unit(deck, i) result(text)
   type(deck_type), intent(in) :: deck
   !> Number of the probe
   integer, intent(in) :: i
   character(len=:), allocatable :: text, quantity, problem

   call deck%get('probe.'//to_text(i)//'.quantity', quantity)
   select case (quantity_kind(quantity))
   case ('force')
      text = composed(deck, 1, dimension_of(deck) - 3)
   case ('torque', 'energy')
      text = composed(deck, 1, dimension_of(deck) - 2)
   case ('length')
      text = composed(deck, 0, 1)
      ! the unknown of Poisson's equation may be anything
      call deck%get('linear.problem', problem)
      if (problem == 'poisson') text = ''
   case ('angle')
      text = 'degree'
   case ('ratio')
      text = ''
   case ('expression')
      text = ''
      call deck%get('probe.'//to_text(i)//'.unit', text)
   case default
      text = composed(deck, 1, -2)
   end select
end function probe_unit

!> Unit of each probe by its name, as an entry of a JSON object
subroutine put_probe_units(json, deck)
   type(json_type), intent(inout) :: json
   type(deck_type), intent(in) :: deck
   character(len=:), allocatable :: name
   integer :: i

   call json%begin_object('probe_units')
   do i = 1, deck%count('probe')
      call deck%get('probe.'//to_text(i)//'.name', name)
      call json%put(name, probe_unit(deck, i))
   end do
   call json%end_object()
end subroutine put_probe_units

!> Units of the deck and of fields and volumes, as an entry of a JSON object
subroutine put_units(json, key, deck)
   type(json_type), intent(inout) :: json
   character(len=*), intent(in) :: key
   type(deck_type), intent(in) :: deck

   call json%begin_object(key)
   call json%put('force', composed(deck, 1, 0))
   call json%put('length', composed(deck, 0, 1))
   call json%put('stress', composed(deck, 1, -2))
   call json%put('volume', composed(deck, 0, 3))
   call json%end_object()
end subroutine put_units

!> Unit of the extent of a boundary set: its area, in the plane its length
function set_unit(deck) result(text)
   type(deck_type), intent(in) :: deck
   character(len=:), allocatable :: text

   text = composed(deck, 0, dimension_of(deck) - 1)
end function set_unit

integer function dimension_of(deck) result(nd)
   type(deck_type), intent(in) :: deck

   nd = 3
   call deck%get('scene.dimension', nd)
end function dimension_of

!> Powers of the deck's units of force and length as text
function composed(deck, force, length) result(text)
   type(deck_type), intent(in) :: deck
   !> Power of the force, 0 or 1
   integer, intent(in) :: force
   !> Power of the length, from -2
   integer, intent(in) :: length
   character(len=:), allocatable :: text, part

   text = ''
   if (force > 0) call deck%get('units.force', text)
   if (length == 0) return
   call deck%get('units.length', part)
   if (abs(length) > 1) part = part//'^'//to_text(abs(length))
   if (length < 0) then
      text = text//'/'//part
   else if (force > 0) then
      text = text//' '//part
   else
      text = part
   end if
end function composed

end module rk_units
