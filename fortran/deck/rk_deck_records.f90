!> Records of tables of the deck: the plain values of those that the schema marks with `record`.
!>
!> For each of them make_schema.py generates, at build time, a type TABLE_keys with a component for
!> each key, and its procedure read(deck, at), where `at` is the table or an entry of it. Values
!> missing in the deck are 0 or empty.
module rk_deck_records
   use rk_deck, only : deck_type
   use rk_expression, only : value_type
   use rk_precision, only : wp
   implicit none
   private

   include 'deck_records.inc'

end module rk_deck_records
