!> Interfaces of the C functions in deck_c.cpp; all pointers live until rk_deck_close.
module rk_deck_c
   use, intrinsic :: iso_c_binding, only : c_char, c_int, c_ptr
   implicit none
   private

   public :: entry_view, deck_view
   public :: rk_deck_open, rk_deck_defaults, rk_deck_look, rk_deck_close, rk_deck_needed, &
      & rk_deck_resolve

   !> A table, or a key with its value
   type, bind(c) :: entry_view
      type(c_ptr) :: key, where, address, text, numbers
      !> How many numbers; kind; number, from 0, of the entry that has this place by its key
      integer(c_int) :: count, kind, sorted
   end type entry_view

   !> A deck
   type, bind(c) :: deck_view
      type(c_ptr) :: message, name, text, sha256, folder, entries
      integer(c_int) :: count, status
   end type deck_view

   interface
      function rk_deck_open(path, text, overrides) result(handle) bind(c)
         import :: c_char, c_ptr
         character(kind=c_char), intent(in) :: path(*), text(*), overrides(*)
         type(c_ptr) :: handle
      end function rk_deck_open

      function rk_deck_defaults(table, key, value) result(handle) bind(c)
         import :: c_char, c_ptr
         character(kind=c_char), intent(in) :: table(*), key(*), value(*)
         type(c_ptr) :: handle
      end function rk_deck_defaults

      function rk_deck_look(handle) result(view) bind(c)
         import :: c_ptr
         type(c_ptr), value :: handle
         type(c_ptr) :: view
      end function rk_deck_look

      function rk_deck_resolve(handle, key) result(full) bind(c)
         import :: c_char, c_ptr
         type(c_ptr), value :: handle
         character(kind=c_char), intent(in) :: key(*)
         type(c_ptr) :: full
      end function rk_deck_resolve

      subroutine rk_deck_close(handle) bind(c)
         import :: c_ptr
         type(c_ptr), value :: handle
      end subroutine rk_deck_close

      function rk_deck_needed(command) result(tables) bind(c)
         import :: c_char, c_ptr
         character(kind=c_char), intent(in) :: command(*)
         type(c_ptr) :: tables
      end function rk_deck_needed
   end interface

end module rk_deck_c
