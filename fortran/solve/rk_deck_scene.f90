!> From a checked deck to a scene.
!>
!> What depends on the deck alone was checked while it was read; errors that depend on the points
!> are found here: unknown boundary sets, labels without points, missing directions.
module rk_deck_scene
   use rk_cloud, only : check_cloud, cloud_type
   use rk_coefficients, only : set_essential_weight
   use rk_deck, only : deck_type
   use rk_deck_blocks, only : put_corners
   use rk_deck_boundary, only : read_conditions, read_probes, read_sets
   use rk_deck_materials, only : read_materials
   use rk_deck_records, only : geometry_keys
   use rk_error, only : error_type, err_memory
   use rk_estimate, only : estimate_cost, estimate_type
   use rk_jumps, only : find_jumps
   use rk_kernel, only : window_polar
   use rk_lattice, only : box_sides, lattice_frame, new_annulus, new_box
   use rk_memory, only : available_bytes
   use rk_precision, only : wp
   use rk_programme, only : programme_type
   use rk_scene, only : displacement_weight, scene_type
   use rk_shape, only : new_approximation
   use rk_text, only : to_text
   use rk_voxel_shape, only : add_side
   implicit none
   private

   public :: new_scene, get_approximation

contains

subroutine new_scene(scene, deck, model, error)
   type(scene_type), intent(out) :: scene
   type(deck_type), intent(in) :: deck
   !> Points of the model file, used where geometry.kind is "model"
   type(cloud_type), intent(in) :: model
   type(error_type), allocatable, intent(out) :: error
   logical :: is_linear

   is_linear = deck%has('linear')
   call deck%get('title', scene%title)
   call deck%get('scene.method', scene%method)
   call deck%get('units.force', scene%force_unit)
   call deck%get('units.length', scene%length_unit)
   call check_size(deck, model, error)
   if (allocated(error)) return
   call read_geometry(scene%cloud, deck, model, error)
   if (allocated(error)) return
   call put_corners(scene%cloud, deck)
   call read_approximation(scene, deck, error)
   if (allocated(error)) return
   call read_programme(scene%programme, deck)
   call scene%load%read(deck, 'load')
   call scene%solver%read(deck, 'solver')
   call scene%mixed%read(deck, 'mixed')
   call scene%galerkin%read(deck, 'galerkin')
   if (is_linear) then
      call read_weights(scene, deck)
      call read_sets(scene, deck, error)
      if (allocated(error)) return
      call read_linear(scene, deck, error)
      if (.not. allocated(error) .and. scene%method == 'rkpm-gauss' .and. scene%equation%varies() &
         & .and. allocated(scene%cloud%lattice) .and. .not. allocated(scene%motion)) &
         & call find_jumps(scene, error)
      call read_probes(scene, deck, error)
      return
   end if
   call read_materials(scene, deck, error)
   if (allocated(error)) return
   call check_cloud(scene%cloud, error)
   call deck%locate(error)
   if (allocated(error)) return
   call read_weights(scene, deck)
   call read_sets(scene, deck, error)
   if (allocated(error)) return
   call read_conditions(scene, deck, error)
   call read_probes(scene, deck, error)
end subroutine new_scene

!> Refuse a scene that does not fit into memory, before anything is allocated for it
subroutine check_size(deck, model, error)
   type(deck_type), intent(in) :: deck
   !> Points of the model file
   type(cloud_type), intent(in) :: model
   type(error_type), allocatable, intent(out) :: error
   type(estimate_type) :: estimate
   character(len=:), allocatable :: less

   estimate = estimate_cost(deck, model)
   if (estimate%bytes < available_bytes()) return
   less = ''
   if (estimate%solver == 'direct') less = ', or galerkin.direct_limit = 0'
   if (any(estimate%solver == ['dgels ', 'dgelsy', 'spqr  '])) less = ', or solver "refined"'
   call deck%complain('geometry', 'the model needs about '//to_text(1.0e-9_wp*estimate%bytes, 3) &
      & //' GB with solver "'//estimate%solver//'", '//to_text(1.0e-9_wp*available_bytes(), 3) &
      & //' GB are free: use fewer source points'//less, error)
   error%code = err_memory
end subroutine check_size

subroutine read_geometry(cloud, deck, model, error)
   type(cloud_type), intent(out) :: cloud
   type(deck_type), intent(in) :: deck
   type(cloud_type), intent(in) :: model
   type(error_type), allocatable, intent(out) :: error
   type(geometry_keys) :: body
   character(len=:), allocatable :: graded

   call body%read(deck, 'geometry')
   select case (body%kind)
   case ('box')
      call deck%get('geometry.graded', graded)
      call new_box(cloud, body%size(:size(body%source)), body%source, body%collocation, &
         & box_sides(graded))
   case ('annulus')
      call new_annulus(cloud, body%inner_radius, body%outer_radius, body%source, body%collocation)
   case default
      call check_unit(deck, model, error)
      if (allocated(error)) return
      cloud = model
      call add_sides(cloud, deck)
   end select
end subroutine read_geometry

!> Add the sides of a model that the deck names
subroutine add_sides(cloud, deck)
   !> Points of the model
   type(cloud_type), intent(inout) :: cloud
   type(deck_type), intent(in) :: deck
   character(len=*), parameter :: table(3) = ['set     ', 'boundary', 'probe   '], &
      & key(3) = ['.side', '.set ', '.set ']
   character(len=:), allocatable :: at, name
   logical :: other
   integer :: i, k, t

   do t = 1, size(table)
      do k = 1, deck%count(trim(table(t)))
         at = trim(table(t))//'.'//to_text(k)//trim(key(t))
         if (.not. deck%has(at)) cycle
         call deck%get(at, name)
         other = .false.
         do i = 1, deck%count('set')
            call deck%get('set.'//to_text(i)//'.name', at)
            other = other .or. at == name
         end do
         if (.not. other) call add_side(cloud, name)
      end do
   end do
end subroutine add_sides

!> Refuse points in another unit than the deck's
subroutine check_unit(deck, model, error)
   type(deck_type), intent(in) :: deck
   type(cloud_type), intent(in) :: model
   !> Error handling: another unit
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: unit

   if (.not. allocated(model%length_unit)) return
   call deck%get('units.length', unit)
   if (model%length_unit == '' .or. model%length_unit == unit) return
   call deck%complain('units.length', "'"//unit//"', but the lengths of the points are in " &
      & //model%length_unit, error)
end subroutine check_unit

!> Order, kernel, window and support
subroutine read_approximation(scene, deck, error)
   !> Scene with points
   type(scene_type), intent(inout) :: scene
   type(deck_type), intent(in) :: deck
   !> Error handling: a name that the deck's check knows and this one does not
   type(error_type), allocatable, intent(out) :: error
   real(wp) :: low(3), step(3)
   integer :: d

   call scene%basis%read(deck, 'approximation')
   associate (basis => scene%basis, cloud => scene%cloud)
      if (basis%interface <= 1.0_wp .and. (basis%interface > 0.0_wp &
         & .or. scene%method /= 'rkpm-gauss')) then
         call deck%complain('approximation.interface', 'must be above 1; 0, tissues as they are ' &
            & //'at each place, is for method "rkpm-gauss"', error)
         return
      end if
      call new_approximation(scene%approximation, basis%order, basis%kernel, basis%window, error)
      if (allocated(error)) return
      allocate (scene%support, mold=cloud%spacing)
      do d = 1, cloud%nd
         scene%support(d, :) = basis%support(d)*cloud%spacing(d, :)
      end do
      if (scene%approximation%window /= window_polar) return
      call lattice_frame(cloud, low, step)
      scene%support(1, :) = basis%support(1)*step(1)
      ! equal to the last bit all around
      scene%support(2, :) = basis%support(2)*step(2)*(low(1) + step(1) &
         & *nint((norm2(cloud%source, dim=1) - low(1))/step(1)))
   end associate
end subroutine read_approximation

!> Shape functions of a deck in words, to which coefficients belong
subroutine get_approximation(deck, text)
   type(deck_type), intent(in) :: deck
   character(len=:), allocatable, intent(out) :: text
   character(len=:), allocatable :: word
   real(wp), allocatable :: support(:)
   integer :: order

   call deck%get('approximation.order', order)
   text = 'order '//to_text(order)
   call deck%get('approximation.kernel', word)
   text = text//', kernel '//word
   call deck%get('approximation.window', word)
   text = text//', window '//word
   call deck%get('approximation.support', support)
   text = text//', support '//to_text(support)
   if (word /= 'product' .or. order /= 1) return
   call deck%get('scene.method', word)
   if (word /= 'rkpm-gauss') return
   if (.not. deck%has('geometry.kind')) return
   ! as scene%runs_out
   call deck%get('geometry.kind', word)
   if (word == 'box' .and. all(support <= 2.0_wp)) text = text//', parabolic at sides'
end subroutine get_approximation

!> Amplitudes
subroutine read_programme(programme, deck)
   type(programme_type), intent(out) :: programme
   type(deck_type), intent(in) :: deck
   integer :: k

   allocate (programme%amplitude(deck%count('amplitude')), programme%rotation(0))
   do k = 1, size(programme%amplitude)
      call programme%amplitude(k)%read(deck, 'amplitude.'//to_text(k))
   end do
end subroutine read_programme

!> Weights of boundary rows beside equilibrium rows of weight 1. The residuals are stress over
!> length, stress and length: balanced weights have units such that all terms of the sum have the
!> same unit, so that the choice of units does not matter
subroutine read_weights(scene, deck)
   !> Scene with points and method
   type(scene_type), intent(inout) :: scene
   type(deck_type), intent(in) :: deck
   character(len=:), allocatable :: weight
   real(wp) :: h

   h = scene%cloud%mean_spacing()
   associate (solver => scene%solver)
      if (.not. deck%is_text('solver.weight_traction')) then
         call deck%get('solver.weight_traction', solver%weight_traction)
      else if (scene%method == 'rkcm-mixed') then
         solver%weight_traction = 1.0_wp
      else
         solver%weight_traction = 1.0_wp/h
      end if
      solver%weight_essential = 0.0_wp
      solver%weight_c4 = 0.0_wp
      if (.not. deck%is_text('solver.weight_essential')) then
         call deck%get('solver.weight_essential', solver%weight_essential)
         return
      end if
      call deck%get('solver.weight_essential', weight)
      if (weight == 'c4') solver%weight_c4 = 1.0_wp
      if (weight == 'balanced') solver%weight_c4 = displacement_weight/h**2
   end associate
end subroutine read_weights

!> Operators, loads and where the solution is prescribed
subroutine read_linear(scene, deck, error)
   !> Scene with points and solver
   type(scene_type), intent(inout) :: scene
   type(deck_type), intent(in) :: deck
   !> Error handling, one line more for each unknown side
   type(error_type), allocatable, intent(inout) :: error
   character(len=:), allocatable :: at, word
   integer :: k

   associate (equation => scene%equation)
      call equation%read(deck, 'linear')
      equation%extent(:scene%cloud%nd) = maxval(scene%cloud%points, dim=2)
      allocate (equation%pin(deck%count('pin')))
      do k = 1, size(equation%pin)
         at = 'pin.'//to_text(k)
         call deck%get_vector(at//'.point', equation%pin(k)%point)
         call deck%get(at//'.components', word)
         equation%pin(k)%fixed = [index(word, 'x') > 0, index(word, 'y') > 0, index(word, 'z') > 0]
      end do
   end associate
   call read_conditions(scene, deck, error)
   if (deck%has('dynamics')) then
      allocate (scene%motion)
      call scene%motion%read(deck, 'dynamics')
      call deck%get('solver.weight_essential', word)
      scene%motion%published = word == 'ns-c4'
   end if
   ! no materials or load steps
   allocate (scene%tissue(0), scene%tissue_of(0))
   scene%load%steps = 1
   scene%load%activation = 0.0_wp
   if (.not. allocated(error)) call set_essential_weight(scene, error)
end subroutine read_linear

end module rk_deck_scene
