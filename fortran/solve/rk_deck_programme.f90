!> From a checked deck to the load programme: amplitudes, output times, what follows them.
module rk_deck_programme
   use rk_deck, only : deck_type
   use rk_error, only : error_type
   use rk_precision, only : pi, wp
   use rk_programme, only : programme_type, rotation_type
   use rk_scene, only : condition_type, scene_type
   use rk_text, only : to_text
   implicit none
   private

   public :: read_programme, read_activation, read_motion

contains

!> Amplitudes and output times
subroutine read_programme(programme, deck)
   type(programme_type), intent(out) :: programme
   type(deck_type), intent(in) :: deck
   integer :: k

   allocate (programme%amplitude(deck%count('amplitude')), programme%rotation(0))
   do k = 1, size(programme%amplitude)
      call programme%amplitude(k)%read(deck, 'amplitude.'//to_text(k))
   end do
   if (deck%has('load.at')) call deck%get('load.at', programme%output)
end subroutine read_programme

!> Activation of a muscle: its own, or what holds for all
subroutine read_activation(scene, deck, at, k, error)
   !> Scene with its programme and load
   type(scene_type), intent(inout) :: scene
   type(deck_type), intent(in) :: deck
   !> Key of the material
   character(len=*), intent(in) :: at
   !> Tissue
   integer, intent(in) :: k
   !> Error handling: none to grow, or one outside of 0 to 1
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: key
   real(wp) :: range(2)

   associate (tissue => scene%tissue(k))
      tissue%activation = scene%load%activation
      call deck%get(at//'.activation', tissue%activation)
      call deck%get(at//'.activation', tissue%level)
      ! an expression says all of it
      if (tissue%level%given()) tissue%activation = 1.0_wp
      tissue%amplitude = scene%load%amplitude
      call deck%get(at//'.amplitude', tissue%amplitude)
      key = 'load.amplitude'
      if (deck%has(at//'.amplitude')) key = at//'.amplitude'
      if (tissue%amplitude == 0) return
      if (.not. (deck%given('load.activation') .or. deck%given(at//'.activation'))) then
         call deck%complain(key, 'there is no activation to scale by it: give ' &
            & //'load.activation or material.'//tissue%name//'.activation', error)
         return
      end if
      associate (value => scene%programme%amplitude(tissue%amplitude)%value)
         range = tissue%activation*[minval(value), maxval(value)]
      end associate
      if (range(1) < 0.0_wp .or. range(2) > 1.0_wp) call deck%complain(key, 'leads to an ' &
         & //'activation of '//to_text(merge(range(1), range(2), range(1) < 0.0_wp))//' of ' &
         & //tissue%name//', which must be between 0 and 1', error)
   end associate
end subroutine read_activation

!> Rotation of a boundary set about an axis, beside its translation
subroutine read_motion(condition, programme, deck, at, nd)
   !> Condition with its translation and amplitude
   type(condition_type), intent(inout) :: condition
   !> Programme, to which the rotation is added
   type(programme_type), intent(inout) :: programme
   type(deck_type), intent(in) :: deck
   !> Key of the entry
   character(len=*), intent(in) :: at
   integer, intent(in) :: nd
   real(wp) :: angle

   call deck%get(at//'.rotation', angle)
   if (nd < 3) condition%axis(3) = 1.0_wp
   condition%axis = condition%axis/norm2(condition%axis)
   condition%fixed(:nd) = .true.
   programme%rotation = [programme%rotation, rotation_type(condition%amplitude, angle*pi/180.0_wp)]
   condition%sine = programme%sine_of(size(programme%rotation))
end subroutine read_motion

end module rk_deck_programme
