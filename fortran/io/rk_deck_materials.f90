!> From the tables [[material]] of a checked deck to materials, and which one fills which point.
module rk_deck_materials
   use rk_deck, only : deck_type, word_length
   use rk_error, only : error_type, fatal_error, err_input
   use rk_material, only : material_item
   use rk_material_list, only : new_material
   use rk_parameters, only : parameters_type
   use rk_precision, only : pi, wp
   use rk_scene, only : scene_type
   use rk_text, only : to_text
   implicit none
   private

   public :: read_materials

   !> Keys that place a material in the body; all others are parameters of its law
   character(len=*), parameter :: placing(4) = ['name       ', 'label      ', 'fiber      ', &
      & 'fiber_angle']

contains

!> Materials, and which one fills which point
subroutine read_materials(scene, deck, error)
   !> Scene with points
   type(scene_type), intent(inout) :: scene
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   type(material_item) :: item
   type(parameters_type) :: parameters
   character(len=:), allocatable :: at
   real(wp), allocatable :: direction(:)
   integer :: k, n

   n = deck%count('material')
   allocate (scene%tissue(n), scene%tissue_of(size(scene%cloud%points, 2)))
   scene%tissue_of = 0
   do k = 1, n
      at = 'material.'//to_text(k)
      associate (tissue => scene%tissue(k))
         call deck%get(at//'.name', tissue%name)
         if (deck%has(at//'.label')) call deck%get(at//'.label', tissue%label)
         call read_parameters(deck, at, tissue%name, parameters)
         call new_material(item, parameters, error)
         if (allocated(error)) then
            error%message = deck%where(at//'.model')//': '//error%message
            return
         end if
         call move_alloc(item%material, tissue%material)
         call fill_points(scene, k, deck%has(at//'.label'))
         if (.not. any(scene%tissue_of == k)) then
            call deck%complain(at//'.label', 'no point has label '//to_text(tissue%label), error)
            return
         end if
         if (tissue%material%fibered) then
            call read_direction(deck, at, scene%cloud%nd, direction)
            call set_fibers(scene, k, direction, deck, at, error)
         else
            call clear_fibers(scene, k)
         end if
         if (allocated(error)) return
      end associate
   end do
   k = findloc(scene%tissue_of, 0, dim=1)
   if (k > 0) call fatal_error(error, err_input, deck%where('material.1')//': material: points ' &
      & //'with label '//to_text(scene%cloud%label(k))//' have no material, the first one lies ' &
      & //'at '//to_text(scene%cloud%points(:, k)))
end subroutine read_materials

!> Parameters of a material's law
subroutine read_parameters(deck, at, name, parameters)
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Key of the material
   character(len=*), intent(in) :: at
   !> Name of the material
   character(len=*), intent(in) :: name
   !> Parameters by their keys
   type(parameters_type), intent(out) :: parameters
   character(len=word_length), allocatable :: key(:)
   character(len=:), allocatable :: word
   real(wp) :: number
   integer :: i

   parameters%kind = 'material'
   parameters%name = name
   call deck%keys(at, key)
   do i = 1, size(key)
      if (any(placing == key(i))) cycle
      if (deck%is_text(at//'.'//trim(key(i)))) then
         call deck%get(at//'.'//trim(key(i)), word)
         call parameters%add(trim(key(i)), word)
      else
         call deck%get(at//'.'//trim(key(i)), number)
         call parameters%add(trim(key(i)), number)
      end if
   end do
end subroutine read_parameters

!> Give a material to its points
subroutine fill_points(scene, k, by_label)
   !> Scene
   type(scene_type), intent(inout) :: scene
   !> Material
   integer, intent(in) :: k
   !> Whether its label counts; otherwise it fills all points
   logical, intent(in) :: by_label

   if (by_label) then
      where (scene%cloud%label == scene%tissue(k)%label) scene%tissue_of = k
   else
      scene%tissue_of = k
   end if
end subroutine fill_points

!> Uniform fiber direction of a material, empty where the model's directions hold
subroutine read_direction(deck, at, nd, direction)
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Key of the material
   character(len=*), intent(in) :: at
   !> Space dimension
   integer, intent(in) :: nd
   !> Unit vector, shape (3) or (0) [-]
   real(wp), allocatable, intent(out) :: direction(:)
   real(wp) :: angle

   if (deck%has(at//'.fiber_angle')) then
      call deck%get(at//'.fiber_angle', angle)
      angle = angle*pi/180.0_wp
      direction = [sin(angle), 0.0_wp, 0.0_wp]
      direction(nd) = cos(angle)
   else
      call deck%get(at//'.fiber', direction)
      if (size(direction) > 0) direction = direction/norm2(direction)
   end if
end subroutine read_direction

!> Fibers of a muscle's points
subroutine set_fibers(scene, k, direction, deck, at, error)
   !> Scene
   type(scene_type), intent(inout) :: scene
   !> Material
   integer, intent(in) :: k
   !> Uniform direction or nothing
   real(wp), intent(in) :: direction(:)
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Key of the material
   character(len=*), intent(in) :: at
   !> Error handling: no direction at a point
   type(error_type), allocatable, intent(inout) :: error
   integer :: ip

   do ip = 1, size(scene%tissue_of)
      if (scene%tissue_of(ip) /= k) cycle
      if (size(direction) > 0) scene%cloud%fiber(:, ip) = direction
      if (norm2(scene%cloud%fiber(:, ip)) > 0.5_wp) cycle
      call deck%complain(at//'.fiber', 'missing, collocation point '//to_text(ip)//' at ' &
         & //to_text(scene%cloud%points(:, ip))//' has no direction: give fiber or fiber_angle, ' &
         & //'or a model with fibers', error)
      return
   end do
end subroutine set_fibers

!> No fibers where the material has none
subroutine clear_fibers(scene, k)
   !> Scene
   type(scene_type), intent(inout) :: scene
   !> Material
   integer, intent(in) :: k
   integer :: ip

   do ip = 1, size(scene%tissue_of)
      if (scene%tissue_of(ip) == k) scene%cloud%fiber(:, ip) = 0.0_wp
   end do
end subroutine clear_fibers

end module rk_deck_materials
