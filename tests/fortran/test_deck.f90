!> Decks as the programs read them, and JSON as they write it; TAP for `meson test`.
!>
!> What a deck may contain and what is said about a wrong one is tested in tests/unit/test_deck.py.
program test_deck
   use, intrinsic :: ieee_arithmetic, only : ieee_is_nan, ieee_quiet_nan, ieee_value
   use rk_deck, only : deck_type, parse_deck
   use rk_error, only : err_file, error_type
   use rk_json, only : json_type
   use rk_precision, only : i8, wp
   use tap, only : check, finish
   implicit none

   character(len=*), parameter :: nl = new_line('a')
   character(len=*), parameter :: none(0) = [character(len=1) ::]
   !> A sheet of two materials
   character(len=*), parameter :: sheet = &
      & 'title = "sheet"'//nl// &
      & '[units]'//nl//'force = "N"'//nl//'length = "cm"'//nl// &
      & '[scene]'//nl//'dimension = 2'//nl//'method = "rkcm"'//nl// &
      & '[geometry]'//nl//'kind = "box"'//nl//'size = [2, 1.5]'//nl//'source = [5, 4]'//nl// &
      & 'collocation = [9, 7]'//nl// &
      & '[[material]]'//nl//'name = "fat"'//nl//'label = 1'//nl//'model = "polynomial"'//nl// &
      & 'A10 = 3'//nl//'K = 1e3'//nl// &
      & '[[material]]'//nl//'name = "skin"'//nl//'label = 2'//nl//'model = "polynomial"'//nl// &
      & 'K = 5e3'//nl

   call test_values
   call test_json_text
   call test_json_numbers
   call test_json_file
   call finish

contains

!> Values, defaults, and what comes where nothing is there
subroutine test_values
   type(deck_type) :: deck, copy
   type(error_type), allocatable :: error
   character(len=:), allocatable :: text
   real(wp), allocatable :: reals(:)
   integer, allocatable :: integers(:)
   real(wp) :: number
   integer :: whole

   call parse_deck(deck, sheet, 'folder/sheet.toml', none, error)
   call check('a good deck', .not. allocated(error))
   call deck%get('title', text)
   call check('text', text == 'sheet')
   call deck%get('scene.dimension', whole)
   call check('integer', whole == 2)
   call deck%get('material.2.K', number)
   call check('real', abs(number - 5.0e3_wp) <= 0.0_wp)
   call deck%get('material.1.A10', number)
   call check('an integer where a real is wanted', abs(number - 3.0_wp) <= 0.0_wp)
   call deck%get('geometry.size', reals)
   call check('array of reals', size(reals) == 2 .and. all(abs(reals - [2.0_wp, 1.5_wp]) <= 0.0_wp))
   call deck%get('geometry.source', integers)
   call check('array of integers', size(integers) == 2 .and. all(integers == [5, 4]))
   call deck%get('approximation.support', reals)
   call check('one number for all directions', size(reals) == 2 .and. &
      & all(abs(reals - 3.0_wp) <= 0.0_wp))
   call deck%get('load.steps', whole)
   call check('default of a table that is absent', whole == 10)
   call check('a text or a number: text', deck%is_text('solver.weight_essential'))
   call check('entries of an array of tables', deck%count('material') == 2)
   call check('no entries', deck%count('probe') == 0 .and. .not. deck%has('probe'))
   call check('has', deck%has('material.1.K') .and. deck%has('load') .and. deck%has('material'))
   call check('has not', .not. (deck%has('geometry.file') .or. deck%has('image.seed') .or. &
      & deck%has('material.3')))
   call deck%get('geometry.file', text)
   call deck%get('geometry.inner_radius', number)
   call deck%get('image.seed', reals)
   call check('nothing is there', text == '' .and. ieee_is_nan(number) .and. size(reals) == 0)
   call check('place of a key', deck%where('material.2.K') == 'folder/sheet.toml:23')
   call check('place of a default is its table', deck%where('material.2.A10') == &
      & 'folder/sheet.toml:19')
   call check('place of a key that is absent', deck%where('material.2.fiber') == &
      & 'folder/sheet.toml:19')
   call check('folder', deck%folder == 'folder' .and. deck%path == 'folder/sheet.toml')
   call check('text of the deck', deck%text == sheet)
   copy = deck
   call parse_deck(deck, sheet, 'sheet.toml', [character(len=40) :: 'solver.weight_essential=2.5'], &
      & error)
   call deck%get('solver.weight_essential', number)
   call check('a text or a number: number', abs(number - 2.5_wp) <= 0.0_wp .and. &
      & .not. deck%is_text('solver.weight_essential'))
   call parse_deck(deck, '', 'empty.toml', none, error)
   call copy%get('material.2.name', text)
   call check('a copy stands alone', text == 'skin')
end subroutine test_values

!> Nesting, keys and escapes
subroutine test_json_text
   type(json_type) :: json

   call json%begin_object()
   call json%put('text', 'a "b" \ c'//nl//achar(9))
   call json%put('yes', .true.)
   call json%put('whole', -7)
   call json%put('long', 12345678901_i8)
   call json%put('list', [1, 2])
   call json%put('reals', [0.5_wp, -2.0_wp])
   call json%put('none', [real(wp) ::])
   call json%begin_array('items')
   call json%put('x')
   call json%begin_object()
   call json%end_object()
   call json%put([1.0_wp])
   call json%end_array()
   call json%end_object()
   call check('nested text', json%text() == '{'//nl// &
      & '  "text": "a \"b\" \\ c\n\u0009",'//nl// &
      & '  "yes": true,'//nl//'  "whole": -7,'//nl//'  "long": 12345678901,'//nl// &
      & '  "list": [1, 2],'//nl//'  "reals": [0.5, -2.0],'//nl//'  "none": [],'//nl// &
      & '  "items": ['//nl//'    "x",'//nl//'    {},'//nl//'    [1.0]'//nl//'  ]'//nl//'}')
end subroutine test_json_text

!> Numbers read back the same
subroutine test_json_numbers
   real(wp), parameter :: numbers(*) = [0.0_wp, 1.0_wp, 0.1_wp, 1.0_wp/3.0_wp, 8198.25_wp, &
      & 1.0e8_wp, 123456789012345680.0_wp, 1.0e15_wp, 9.999999999999999e15_wp, 1.0e16_wp, &
      & 1.2e-5_wp, 1.0e-4_wp, 1.7e308_wp, &
      & 2.2250738585072014e-308_wp, 0.30000000000000004_wp, -4.5e-7_wp]
   real(wp) :: back
   character(len=:), allocatable :: text
   logical :: same
   integer :: i, stat

   same = .true.
   do i = 1, size(numbers)
      text = written(numbers(i))
      read (text, *, iostat=stat) back
      if (stat /= 0 .or. abs(back - numbers(i)) > 0.0_wp) same = .false.
   end do
   call check('numbers read back the same', same)
   call check('short numbers', written(0.1_wp) == '0.1' .and. written(1.0e8_wp) == '100000000.0' &
      & .and. written(1.0e-6_wp) == '1e-6' .and. written(-2.5e20_wp) == '-2.5e20' .and. &
      & written(0.0_wp) == '0.0')
   call check('what is not a number', written(ieee_value(1.0_wp, ieee_quiet_nan)) == 'null')
end subroutine test_json_numbers

!> JSON text of a number
function written(number) result(text)
   !> Number
   real(wp), intent(in) :: number
   character(len=:), allocatable :: text
   type(json_type) :: json

   call json%put(number)
   text = json%text()
end function written

!> Files
subroutine test_json_file
   type(json_type) :: json
   type(error_type), allocatable :: error
   character(len=20) :: line
   integer :: unit
   logical :: there

   call json%put('first')
   call json%save('test_deck.json', error)
   json = json_type()
   call json%put('second')
   call json%save('test_deck.json', error)
   call check('saved over an older file', .not. allocated(error))
   open (newunit=unit, file='test_deck.json', action='read', status='old')
   read (unit, '(a)') line
   close (unit, status='delete')
   call check('what was saved', line == '"second"')
   inquire (file='test_deck.json.part', exist=there)
   call check('nothing is left over', .not. there)
   call json%save('no/such/folder/test_deck.json', error)
   call check('no folder', allocated(error))
   if (.not. allocated(error)) return
   ! the rest is the system's
   call check('and it says so', error%code == err_file .and. &
      & index(error%message, 'no/such/folder/test_deck.json') == 1 .and. &
      & index(error%message, 'cannot be written: ') > 0)
end subroutine test_json_file

end program test_deck
