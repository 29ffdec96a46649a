!> Units of the results of a solve, in those named in the deck: composed only here.
module rk_units
   use rk_deck, only : deck_type
   use rk_json, only : json_type
   use rk_probes, only : quantity_kind
   use rk_text, only : to_text
   implicit none
   private

   public :: get_probe_unit, get_set_unit, put_probe_units, put_units

contains

!> Unit of a probe, empty if it has none. In fewer than three dimensions forces, torques and
!> energies are per unit of thickness
subroutine get_probe_unit(deck, i, text)
   type(deck_type), intent(in) :: deck
   !> Number of the probe
   integer, intent(in) :: i
   character(len=:), allocatable, intent(out) :: text
   character(len=:), allocatable :: quantity, problem

   call deck%get('probe.'//to_text(i)//'.quantity', quantity)
   select case (quantity_kind(quantity))
   case ('force')
      call compose(deck, 1, dimension_of(deck) - 3, text)
   case ('torque', 'energy')
      call compose(deck, 1, dimension_of(deck) - 2, text)
   case ('length')
      call compose(deck, 0, 1, text)
      ! the unknown of Poisson's equation may be any quantity
      call deck%get('linear.problem', problem)
      if (problem == 'poisson') text = ''
   case ('angle')
      text = 'degree'
   case ('ratio')
      text = ''
   case default
      call compose(deck, 1, -2, text)
   end select
end subroutine get_probe_unit

!> Unit of each probe by its name, as an entry of a JSON object
subroutine put_probe_units(json, deck)
   type(json_type), intent(inout) :: json
   type(deck_type), intent(in) :: deck
   character(len=:), allocatable :: name, unit
   integer :: i

   call json%begin_object('probe_units')
   do i = 1, deck%count('probe')
      call deck%get('probe.'//to_text(i)//'.name', name)
      call get_probe_unit(deck, i, unit)
      call json%put(name, unit)
   end do
   call json%end_object()
end subroutine put_probe_units

!> Units of the deck and of fields and volumes, as an entry of a JSON object
subroutine put_units(json, key, deck)
   type(json_type), intent(inout) :: json
   character(len=*), intent(in) :: key
   type(deck_type), intent(in) :: deck

   call json%begin_object(key)
   call put('force', 1, 0)
   call put('length', 0, 1)
   call put('stress', 1, -2)
   call put('volume', 0, 3)
   call json%end_object()

contains

   subroutine put(name, force, length)
      character(len=*), intent(in) :: name
      !> Powers of force and length
      integer, intent(in) :: force, length
      character(len=:), allocatable :: unit

      call compose(deck, force, length, unit)
      call json%put(name, unit)
   end subroutine put

end subroutine put_units

!> Unit of the extent of a boundary set: that of an area, in the plane that of a length
subroutine get_set_unit(deck, text)
   type(deck_type), intent(in) :: deck
   character(len=:), allocatable, intent(out) :: text

   call compose(deck, 0, dimension_of(deck) - 1, text)
end subroutine get_set_unit

integer function dimension_of(deck) result(nd)
   type(deck_type), intent(in) :: deck

   nd = 3
   call deck%get('scene.dimension', nd)
end function dimension_of

!> Powers of the deck's units of force and length as text
subroutine compose(deck, force, length, text)
   type(deck_type), intent(in) :: deck
   !> Power of the force, 0 or 1
   integer, intent(in) :: force
   !> Power of the length, from -2
   integer, intent(in) :: length
   character(len=:), allocatable, intent(out) :: text
   character(len=:), allocatable :: part

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
end subroutine compose

end module rk_units
