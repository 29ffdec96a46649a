!> From the tables [[material]] of a checked deck to materials and their assignment to points.
module rk_deck_materials
   use rk_deck, only : deck_type
   use rk_deck_regions, only : label_regions
   use rk_error, only : error_type
   use rk_energies, only : new_material
   use rk_precision, only : pi, wp
   use rk_scene, only : scene_type, tissue_type
   use rk_text, only : to_text
   implicit none
   private

   public :: read_materials

contains

!> Materials and their assignment to points
subroutine read_materials(scene, deck, error)
   !> Scene with points
   type(scene_type), intent(inout) :: scene
   type(deck_type), intent(in) :: deck
   type(error_type), allocatable, intent(out) :: error
   integer, allocatable :: material_of(:)
   integer :: k, n
   logical :: regions

   n = deck%count('material')
   allocate (scene%tissue(n), scene%tissue_of(size(scene%cloud%points, 2)))
   do k = 1, n
      call deck%get('material.'//to_text(k)//'.where', scene%tissue(k)%part)
   end do
   regions = any(scene%tissue%part%given())
   if (regions) then
      scene%tissue%label = [(k, k=1, n)]
      call label_regions(scene, deck, error)
      if (allocated(error)) return
   end if
   scene%tissue_of = 0
   if (allocated(scene%cloud%fraction)) allocate (material_of(size(scene%cloud%fraction, 1)), &
      & source=0)
   do k = 1, n
      call read_tissue(scene, k, deck, regions, material_of, error)
      if (allocated(error)) return
   end do
   if (allocated(scene%cloud%activation) .and. index(scene%method, 'rkcm') == 1) &
      & call deck%complain('geometry.file', 'its activations vary from point to point, and ' &
      & //'collocation needs their gradients: use scene.method = rkpm-gauss or rkpm-scni', error)
   if (allocated(error)) return
   k = findloc(scene%tissue_of, 0, dim=1)
   if (k > 0) then
      call deck%complain('material.1', 'points with label '//to_text(scene%cloud%label(k)) &
         & //' have no material, the first one lies at '//to_text(scene%cloud%points(:, k)), error)
   else if (allocated(material_of)) then
      call set_parts(scene, material_of, deck, error)
   end if
end subroutine read_materials

!> A material: its law, its points, its fibers and their activation
subroutine read_tissue(scene, k, deck, regions, material_of, error)
   type(scene_type), intent(inout) :: scene
   !> Number of the material
   integer, intent(in) :: k
   type(deck_type), intent(in) :: deck
   !> Whether materials have parts of the body by expressions
   logical, intent(in) :: regions
   !> Material of each fraction, shape (nf); not allocated where points have none
   integer, allocatable, intent(inout) :: material_of(:)
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: at, labels
   real(wp), allocatable :: direction(:)
   type(error_type), allocatable :: fault
   logical :: by_label, found

   at = 'material.'//to_text(k)
   associate (tissue => scene%tissue(k))
      call deck%get(at//'.name', tissue%name)
      by_label = regions .or. deck%has(at//'.label')
      if (.not. regions .and. deck%has(at//'.label')) call deck%get(at//'.label', &
         & tissue%label)
      call new_material(tissue%material, deck, at, fault)
      if (allocated(fault)) call deck%complain(at//'.model', fault%message, error)
      if (allocated(error)) return
      call fill_points(scene%tissue_of, scene%cloud%label, k, tissue, by_label)
      if (allocated(material_of)) call fill_points(material_of, scene%cloud%fraction_label, k, &
         & tissue, by_label)
      found = any(scene%tissue_of == k)
      if (allocated(material_of)) found = found .or. any(spread(material_of == k, 2, &
         & size(scene%tissue_of)) .and. scene%cloud%fraction > 0.0_wp)
      if (.not. found) then
         if (regions) then
            call deck%complain(at//'.where', &
               & 'no point lies there, or materials given later cover it; a thin one needs ' &
               & //'more points across it (geometry.source)', error)
         else
            call list_labels(scene%cloud%label, labels)
            call deck%complain(at//'.label', 'no point has label '//to_text(tissue%label) &
               & //'; the labels of the points are '//labels, error)
         end if
         return
      end if
      if (tissue%material%fibered) then
         call read_direction(deck, at, scene%cloud%nd, direction)
         call set_fibers(scene, k, direction, deck, at, error)
         call read_activation(scene, deck, at, k, error)
      else
         where (spread(scene%tissue_of == k, 1, 3)) scene%cloud%fiber = 0.0_wp
         if (deck%has(at//'.fiber') .or. deck%has(at//'.fiber_angle')) call deck%complain( &
            & at//'.energy', 'has no I4, so that its fibers would do nothing', error)
      end if
   end associate
end subroutine read_tissue

!> Different labels, ascending
pure subroutine list_labels(label, text)
   integer, intent(in) :: label(:)
   character(len=:), allocatable, intent(out) :: text
   integer :: own

   own = minval(label)
   text = to_text(own)
   do while (any(label > own))
      own = minval(label, mask=label > own)
      text = text//', '//to_text(own)
   end do
end subroutine list_labels

!> Fractions of the materials from those of labels
subroutine set_parts(scene, material_of, deck, error)
   type(scene_type), intent(inout) :: scene
   !> Material of each fraction, shape (nf)
   integer, intent(in) :: material_of(:)
   type(deck_type), intent(in) :: deck
   !> Error handling: a label without a material
   type(error_type), allocatable, intent(out) :: error
   integer :: i, k

   allocate (scene%tissue_part(size(scene%tissue), size(scene%tissue_of)), source=0.0_wp)
   do i = 1, size(material_of)
      k = material_of(i)
      if (k > 0) then
         scene%tissue_part(k, :) = scene%tissue_part(k, :) + scene%cloud%fraction(i, :)
         cycle
      end if
      k = maxloc(scene%cloud%fraction(i, :), dim=1)
      if (.not. scene%cloud%fraction(i, k) > 0.0_wp) cycle
      call deck%complain('material.1', 'label '//to_text(scene%cloud%fraction_label(i)) &
         & //' has no material, but fills a part of points; the largest lies at ' &
         & //to_text(scene%cloud%points(:, k)), error)
      return
   end do
end subroutine set_parts

!> Assign a material to points or fractions with its label
pure subroutine fill_points(material_of, label, k, tissue, by_label)
   !> Material of each point or fraction
   integer, intent(inout) :: material_of(:)
   !> Its label
   integer, intent(in) :: label(:)
   integer, intent(in) :: k
   type(tissue_type), intent(in) :: tissue
   !> Whether its label counts; otherwise it fills all
   logical, intent(in) :: by_label

   if (by_label) then
      where (label == tissue%label) material_of = k
   else
      material_of = k
   end if
end subroutine fill_points

!> Activation of a muscle: its own, or that of all muscles
subroutine read_activation(scene, deck, at, k, error)
   !> Scene with its programme and load
   type(scene_type), intent(inout) :: scene
   type(deck_type), intent(in) :: deck
   !> Key of the material
   character(len=*), intent(in) :: at
   !> Tissue
   integer, intent(in) :: k
   !> Error handling: no activation to grow, or one outside of 0 to 1
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: key
   real(wp) :: range(2)

   associate (tissue => scene%tissue(k))
      tissue%activation = scene%load%activation
      call deck%get(at//'.activation', tissue%activation)
      call deck%get(at//'.activation', tissue%level)
      ! an expression gives the whole activation
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

!> Uniform fiber direction of a material, empty where the model's directions apply
subroutine read_direction(deck, at, nd, direction)
   type(deck_type), intent(in) :: deck
   character(len=*), intent(in) :: at
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
   type(scene_type), intent(inout) :: scene
   integer, intent(in) :: k
   !> Uniform direction or nothing
   real(wp), intent(in) :: direction(:)
   type(deck_type), intent(in) :: deck
   character(len=*), intent(in) :: at
   !> Error handling: no direction at a point, or one that is not the model's
   type(error_type), allocatable, intent(inout) :: error
   !> Directions whose cosine differs from one by less are the same [-]
   real(wp), parameter :: same = 1.0e-6_wp
   integer :: ip

   do ip = 1, size(scene%tissue_of)
      if (scene%tissue_of(ip) /= k) cycle
      associate (own => scene%cloud%fiber(:, ip))
         if (size(direction) > 0) then
            if (norm2(own) > 0.5_wp .and. abs(dot_product(own, direction)) < 1.0_wp - same) then
               call deck%complain(at//'.fiber', 'the model has fibers of its own, '//to_text(own) &
                  & //' at '//to_text(scene%cloud%points(:, ip))//': leave out fiber and ' &
                  & //'fiber_angle, or build the model without fibers', error)
               return
            end if
            own = direction
         end if
         if (norm2(own) > 0.5_wp) cycle
      end associate
      call deck%complain(at//'.fiber', 'missing, collocation point '//to_text(ip)//' at ' &
         & //to_text(scene%cloud%points(:, ip))//' has no direction: give fiber or fiber_angle, ' &
         & //'or a model with fibers', error)
      return
   end do
end subroutine set_fibers

end module rk_deck_materials
