! Python boundary of the decks: a path or a text in, one JSON text out.

!> Values of a deck as JSON, or all its complaints; `deck_text` is blank if the deck is a file.
!> `length` is that of the whole answer; if it exceeds `capacity`, the answer is cut off and the
!> caller must ask again with a larger capacity.
subroutine deck_json(path, deck_text, n, overrides, command, capacity, text, length, stat, message)
   use rk_deck, only : deck_type, open_deck
   use rk_error, only : error_type, pack_error
   use rk_json, only : json_type
   use rk_units, only : put_probe_units, put_units
   implicit none
   integer, intent(in) :: n, capacity
   character(len=*), intent(in) :: path, deck_text, overrides(n), command
   character(len=capacity), intent(out) :: text
   integer, intent(out) :: length, stat
   character(len=2048), intent(out) :: message
   type(deck_type) :: deck
   type(error_type), allocatable :: error
   type(json_type) :: json
   character(len=:), allocatable :: all

   call open_deck(deck, path, deck_text, overrides, command, error)
   if (allocated(error)) then
      all = error%message
   else
      call json%begin_object()
      call json%put_json('tables', deck%json)
      call put_probe_units(json, deck)
      call put_units(json, 'result_units', deck)
      call json%put('path', deck%path)
      call json%put('folder', deck%folder)
      call json%put('sha256', deck%sha256)
      call json%end_object()
      all = json%text()
   end if
   length = len(all)
   text = all
   call pack_error(error, stat, message)
end subroutine deck_json

!> The key that an override would set, with the name of its entry; `deck_text` as above
subroutine deck_key(path, deck_text, n, overrides, key, full, stat, message)
   use rk_deck, only : resolve_key
   use rk_error, only : error_type, fatal_error, err_input, pack_error
   implicit none
   integer, intent(in) :: n
   character(len=*), intent(in) :: path, deck_text, overrides(n), key
   character(len=1024), intent(out) :: full
   integer, intent(out) :: stat
   character(len=2048), intent(out) :: message
   type(error_type), allocatable :: error
   character(len=:), allocatable :: found

   call resolve_key(path, deck_text, overrides, key, found, error)
   full = found
   if (len(found) > len(full)) call fatal_error(error, err_input, key//': the name of its entry ' &
      & //'is too long: shorten it')
   call pack_error(error, stat, message)
end subroutine deck_key
