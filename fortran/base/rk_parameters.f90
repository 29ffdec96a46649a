!> Named numbers and texts from which something makes itself, whether they come from a table of a
!> deck or from a caller in memory.
!>
!> Who makes itself asks for what it knows, within limits; what nobody asked for is an error. So
!> the names of parameters stand with those who use them, and nobody carries them on the way. After
!> an error nothing is looked for, so that a run of calls needs one look at it.
module rk_parameters
   use, intrinsic :: ieee_arithmetic, only : ieee_is_finite
   use rk_error, only : err_input, error_type, fatal_error
   use rk_precision, only : wp
   use rk_text, only : to_text
   implicit none
   private

   public :: parameters_type

   !> A number or a text
   type :: value_type
      !> Name
      character(len=:), allocatable :: key
      character(len=:), allocatable :: text
      real(wp) :: number = 0.0_wp
      !> Which of the two?
      logical :: is_text = .false.
      !> Was it asked for?
      logical :: asked = .false.
   end type value_type

   !> Named values
   type :: parameters_type
      !> What they belong to, such as "material", and its name
      character(len=:), allocatable :: kind, name
      type(value_type), allocatable, private :: value(:)
   contains
      procedure :: add
      !> Value of a key, within limits
      generic :: get => get_number, get_text
      procedure :: other_numbers, check_all_asked
      procedure, private :: get_number, get_text
      procedure, private :: find, refuse
   end type parameters_type

contains

!> Add a value
subroutine add(self, key, value)
   class(parameters_type), intent(inout) :: self
   character(len=*), intent(in) :: key
   !> Number or text
   class(*), intent(in) :: value

   if (.not. allocated(self%value)) allocate (self%value(0))
   select type (value)
   type is (real(wp))
      self%value = [self%value, value_type(key, number=value)]
   type is (character(len=*))
      self%value = [self%value, value_type(key, value, is_text=.true.)]
   end select
end subroutine add

!> A number. Its limits are checked here, so that a caller in memory meets those of a deck
subroutine get_number(self, key, number, error, above, least, infinite)
   class(parameters_type), intent(inout) :: self
   character(len=*), intent(in) :: key
   real(wp), intent(out) :: number
   !> Error handling: missing, no number, or out of its limits
   type(error_type), allocatable, intent(inout) :: error
   !> The number must be greater
   real(wp), intent(in), optional :: above
   !> The number must be greater or equal
   real(wp), intent(in), optional :: least
   !> May it be infinite? Default false
   logical, intent(in), optional :: infinite
   character(len=:), allocatable :: wanted
   integer :: i

   number = 0.0_wp
   if (allocated(error)) return
   call self%find(key, i, error)
   if (allocated(error)) return
   if (self%value(i)%is_text) then
      call self%refuse(key//" = '"//self%value(i)%text//"' must be a number", error)
      return
   end if
   number = self%value(i)%number
   if (present(infinite)) then
      if (infinite .and. number > huge(number)) return
   end if
   if (.not. ieee_is_finite(number)) then
      wanted = 'a finite number'
   else if (present(above)) then
      if (.not. number > above) wanted = 'greater than '//to_text(above)
   else if (present(least)) then
      if (.not. number >= least) wanted = 'at least '//to_text(least)
   end if
   if (allocated(wanted)) call self%refuse(key//' = '//to_text(number)//' must be '//wanted, error)
end subroutine get_number

!> A text that is one of several words
subroutine get_text(self, key, text, choices, error)
   class(parameters_type), intent(inout) :: self
   character(len=*), intent(in) :: key
   character(len=:), allocatable, intent(out) :: text
   !> Words it may be; any without them
   character(len=*), intent(in), optional :: choices(:)
   !> Error handling: missing, no text, or none of the words
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: words
   integer :: i

   text = ''
   if (allocated(error)) return
   call self%find(key, i, error)
   if (allocated(error)) return
   if (self%value(i)%is_text) then
      text = self%value(i)%text
      if (.not. present(choices)) return
      if (any(choices == text)) return
   else
      text = to_text(self%value(i)%number)
      if (.not. present(choices)) then
         call self%refuse(key//' = '//text//' must be a text', error)
         return
      end if
   end if
   words = "'"//trim(choices(1))//"'"
   do i = 2, size(choices)
      words = words//" or '"//trim(choices(i))//"'"
   end do
   call self%refuse(key//" = '"//text//"' must be "//words, error)
end subroutine get_text

!> Names of all numbers that nobody has asked for yet, and what they are. They count as asked for
subroutine other_numbers(self, names, numbers)
   class(parameters_type), intent(inout) :: self
   !> Names with a blank after each
   character(len=:), allocatable, intent(out) :: names
   !> Numbers, shape (n)
   real(wp), allocatable, intent(out) :: numbers(:)
   integer :: i

   associate (value => self%value)
      numbers = pack(value%number, .not. (value%is_text .or. value%asked))
      names = ''
      do i = 1, size(value)
         if (value(i)%is_text .or. value(i)%asked) cycle
         names = names//value(i)%key//' '
         value(i)%asked = .true.
      end do
   end associate
end subroutine other_numbers

!> Error where there are values nobody asked for: keys that are not known
subroutine check_all_asked(self, error)
   class(parameters_type), intent(in) :: self
   !> Error handling: names the first such key
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: known
   integer :: i

   if (allocated(error)) return
   known = ''
   do i = 1, size(self%value)
      if (self%value(i)%asked) known = known//' '//self%value(i)%key
   end do
   do i = 1, size(self%value)
      if (self%value(i)%asked) cycle
      call self%refuse(self%value(i)%key//' is not known here; there are:'//known, error)
      return
   end do
end subroutine check_all_asked

!> Number of the value of a key, which from now on is asked for
subroutine find(self, key, number, error)
   class(parameters_type), intent(inout) :: self
   character(len=*), intent(in) :: key
   !> Number of the value
   integer, intent(out) :: number
   !> Error handling: missing
   type(error_type), allocatable, intent(inout) :: error

   if (.not. allocated(self%value)) allocate (self%value(0))
   do number = 1, size(self%value)
      if (self%value(number)%key /= key) cycle
      self%value(number)%asked = .true.
      return
   end do
   number = 0
   call self%refuse(key//' is missing', error)
end subroutine find

!> Error of whom the values belong to
subroutine refuse(self, what, error)
   class(parameters_type), intent(in) :: self
   character(len=*), intent(in) :: what
   type(error_type), allocatable, intent(out) :: error

   call fatal_error(error, err_input, self%kind//" '"//self%name//"': "//what)
end subroutine refuse

end module rk_parameters
