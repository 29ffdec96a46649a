!> Interfaces of the C functions in deck_c.cpp; all pointers live until rk_deck_close.
module rk_deck_c
   use, intrinsic :: iso_c_binding, only : c_char, c_int, c_ptr
   implicit none
   private

   public :: rk_deck_read, rk_deck_parse, rk_deck_defaults, rk_deck_status, rk_deck_property
   public :: rk_deck_size, rk_deck_entry, rk_deck_close, rk_deck_needed, rk_deck_resolve

   interface
      function rk_deck_read(path, overrides) result(handle) bind(c)
         import :: c_char, c_ptr
         implicit none
         character(kind=c_char), intent(in) :: path(*), overrides(*)
         type(c_ptr) :: handle
      end function rk_deck_read

      function rk_deck_parse(text, name, overrides) result(handle) bind(c)
         import :: c_char, c_ptr
         implicit none
         character(kind=c_char), intent(in) :: text(*), name(*), overrides(*)
         type(c_ptr) :: handle
      end function rk_deck_parse

      function rk_deck_defaults(table, key, value) result(handle) bind(c)
         import :: c_char, c_ptr
         implicit none
         character(kind=c_char), intent(in) :: table(*), key(*), value(*)
         type(c_ptr) :: handle
      end function rk_deck_defaults

      function rk_deck_status(handle) result(status) bind(c)
         import :: c_int, c_ptr
         implicit none
         type(c_ptr), value :: handle
         integer(c_int) :: status
      end function rk_deck_status

      function rk_deck_property(handle, which) result(text) bind(c)
         import :: c_int, c_ptr
         implicit none
         type(c_ptr), value :: handle
         integer(c_int), value :: which
         type(c_ptr) :: text
      end function rk_deck_property

      function rk_deck_size(handle) result(size) bind(c)
         import :: c_int, c_ptr
         implicit none
         type(c_ptr), value :: handle
         integer(c_int) :: size
      end function rk_deck_size

      function rk_deck_entry(handle, index, key, where, address, text, count, numbers, sorted) &
         & result(kind) bind(c)
         import :: c_int, c_ptr
         implicit none
         type(c_ptr), value :: handle
         integer(c_int), value :: index
         type(c_ptr), intent(out) :: key, where, address, text, numbers
         integer(c_int), intent(out) :: count, sorted
         integer(c_int) :: kind
      end function rk_deck_entry

      function rk_deck_resolve(handle, key) result(full) bind(c)
         import :: c_char, c_ptr
         implicit none
         type(c_ptr), value :: handle
         character(kind=c_char), intent(in) :: key(*)
         type(c_ptr) :: full
      end function rk_deck_resolve

      subroutine rk_deck_close(handle) bind(c)
         import :: c_ptr
         implicit none
         type(c_ptr), value :: handle
      end subroutine rk_deck_close

      function rk_deck_needed(command) result(tables) bind(c)
         import :: c_char, c_ptr
         implicit none
         character(kind=c_char), intent(in) :: command(*)
         type(c_ptr) :: tables
      end function rk_deck_needed
   end interface

end module rk_deck_c
