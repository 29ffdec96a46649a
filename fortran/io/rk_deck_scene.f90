!> From a checked deck to a scene.
!>
!> What the deck alone can tell was checked while it was read; here come the complaints that need
!> the points: unknown boundary sets, labels without points, directions that are missing.
module rk_deck_scene
   use rk_cloud, only : check_cloud, cloud_type
   use rk_deck, only : deck_type
   use rk_deck_linear, only : read_linear
   use rk_deck_materials, only : read_materials
   use rk_error, only : error_type, fatal_error, err_input, err_memory
   use rk_estimate, only : estimate_cost, estimate_type
   use rk_kernel, only : find_kernel, find_window
   use rk_lattice, only : jitter, new_annulus, new_box
   use rk_memory, only : available_bytes
   use rk_precision, only : wp
   use rk_scene, only : condition_type, scene_type
   use rk_text, only : to_text
   use rk_volume_points, only : volume_patches
   implicit none
   private

   public :: new_scene

   !> Bulk over shear modulus above which the displacement form is taken to lock [-]
   real(wp), parameter :: locking_ratio = 50.0_wp

contains

!> Build the scene of a deck
subroutine new_scene(scene, deck, model, error)
   !> Scene
   type(scene_type), intent(out) :: scene
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Points of the model file, used where geometry.kind is "model"
   type(cloud_type), intent(in) :: model
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   logical :: is_linear

   call deck%require('solve', error)
   if (allocated(error)) return
   is_linear = deck%has('linear')
   call deck%get('title', scene%title)
   call deck%get('scene.method', scene%method)
   call deck%get('units.force', scene%force_unit)
   call deck%get('units.length', scene%length_unit)
   call check_size(deck, model, error)
   if (allocated(error)) return
   call read_geometry(scene%cloud, deck, model, error)
   if (allocated(error)) return
   call read_approximation(scene, deck, error)
   if (allocated(error)) return
   call read_solver(scene, deck)
   if (is_linear) then
      scene%method = 'rkcm'
      call read_weights(scene, deck)
      call read_linear(scene, deck)
      call read_probes(scene, deck, error)
      return
   end if
   call read_materials(scene, deck, error)
   if (allocated(error)) return
   if (scene%method == 'auto' .and. scene%stiffest_ratio() > locking_ratio) &
      & scene%method = 'rkcm-mixed'
   if (scene%method == 'auto') scene%method = 'rkcm'
   if (scene%method == 'rkpm') scene%method = 'rkpm-scni'
   call check_cloud(scene%cloud, error)
   if (allocated(error)) then
      error%message = deck%where('geometry')//': geometry: '//error%message
      return
   end if
   call read_weights(scene, deck)
   if (scene%method == 'rkcm-mixed' .and. .not. allocated(scene%cloud%volume_points)) &
      & call volume_patches(scene%cloud)
   call read_conditions(scene, deck, error)
   if (allocated(error)) return
   call read_probes(scene, deck, error)
end subroutine new_scene

!> Refuse a scene that does not fit into memory, before anything is allocated for it
subroutine check_size(deck, model, error)
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Points of the model file
   type(cloud_type), intent(in) :: model
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   type(estimate_type) :: estimate
   character(len=:), allocatable :: advice

   estimate = estimate_cost(deck, model)
   if (estimate%bytes < available_bytes()) return
   advice = 'use fewer source points'
   if (all(estimate%solver /= ['auto   ', 'normal ', 'refined'])) advice = advice &
      & //', or solver "refined"'
   call fatal_error(error, err_memory, deck%where('geometry')//': geometry: the model needs ' &
      & //'about '//to_text(1.0e-9_wp*estimate%bytes, 3)//' GB with solver "'//estimate%solver &
      & //'", '//to_text(1.0e-9_wp*available_bytes(), 3)//' GB are free: '//advice)
end subroutine check_size

!> Points
subroutine read_geometry(cloud, deck, model, error)
   !> Points
   type(cloud_type), intent(out) :: cloud
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Points of the model file
   type(cloud_type), intent(in) :: model
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: kind
   real(wp), allocatable :: size_(:)
   integer, allocatable :: source(:), collocation(:)
   real(wp) :: inner, outer, share

   call deck%get('geometry.kind', kind)
   call deck%get('geometry.source', source)
   call deck%get('geometry.collocation', collocation)
   select case (kind)
   case ('box')
      call deck%get('geometry.size', size_)
      call new_box(cloud, size_, source, collocation, error)
      call deck%get('geometry.jitter', share)
      if (share > 0.0_wp .and. .not. allocated(error)) call jitter(cloud, share)
   case ('annulus')
      call deck%get('geometry.inner_radius', inner)
      call deck%get('geometry.outer_radius', outer)
      call new_annulus(cloud, inner, outer, source, collocation, error)
   case default
      cloud = model
   end select
   if (allocated(error)) error%message = deck%where('geometry')//': geometry: '//error%message
end subroutine read_geometry

!> Order, kernel, window and support
subroutine read_approximation(scene, deck, error)
   !> Scene with points
   type(scene_type), intent(inout) :: scene
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Error handling: a name that the deck's check knows and this one does not
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: kernel, window, fibers
   real(wp), allocatable :: support(:)
   integer :: d

   call deck%get('approximation.order', scene%approximation%order)
   call deck%get('approximation.kernel', kernel)
   call deck%get('approximation.window', window)
   call deck%get('approximation.support', support)
   call deck%get('approximation.interface', scene%interface%reach)
   call deck%get('approximation.interface_fibers', fibers)
   scene%interface%own_fibers = fibers == 'own'
   call find_kernel(kernel, scene%approximation%kernel, error)
   if (allocated(error)) return
   call find_window(window, scene%approximation%window, error)
   if (allocated(error)) return
   allocate (scene%support, mold=scene%cloud%spacing)
   do d = 1, scene%cloud%nd
      scene%support(d, :) = support(min(d, size(support)))*scene%cloud%spacing(d, :)
   end do
end subroutine read_approximation


!> Number of a boundary set named in the deck
subroutine find_named_set(cloud, deck, key, set, error)
   !> Points
   type(cloud_type), intent(in) :: cloud
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Key that holds the name
   character(len=*), intent(in) :: key
   !> Number of the set
   integer, intent(out) :: set
   !> Error handling: unknown set
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: name, known
   integer :: i

   call deck%get(key, name)
   set = cloud%find_set(name)
   if (set > 0) return
   known = ''
   do i = 1, size(cloud%set_name)
      known = known//' '//trim(cloud%set_name(i))
   end do
   call fatal_error(error, err_input, deck%where(key)//': '//key//": no boundary set '"//name &
      & //"', the sets are:"//known)
end subroutine find_named_set

!> Boundary conditions
subroutine read_conditions(scene, deck, error)
   !> Scene with points
   type(scene_type), intent(inout) :: scene
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: at
   character(len=*), parameter :: component(3) = ['.u_x', '.u_y', '.u_z']
   real(wp), allocatable :: traction(:)
   integer :: i, k

   allocate (scene%condition(deck%count('boundary')))
   do k = 1, size(scene%condition)
      at = 'boundary.'//to_text(k)
      associate (condition => scene%condition(k))
         call find_named_set(scene%cloud, deck, at//'.set', condition%set, error)
         if (allocated(error)) return
         do i = 1, scene%cloud%nd
            condition%fixed(i) = deck%has(at//component(i))
            if (condition%fixed(i)) call deck%get(at//component(i), condition%value(i))
         end do
         condition%is_radial = deck%has(at//'.radial')
         if (condition%is_radial) call deck%get(at//'.radial', condition%radial)
         call deck%get(at//'.traction', traction)
         condition%traction(:size(traction)) = traction
      end associate
   end do
   if (.not. any_fixed(scene%condition)) call fatal_error(error, err_input, &
      & deck%where('boundary.1')//': boundary: no displacement is prescribed anywhere: the body ' &
      & //'can move freely')
end subroutine read_conditions

!> Whether anything holds the body
pure logical function any_fixed(condition)
   !> Conditions
   type(condition_type), intent(in) :: condition(:)
   integer :: k

   any_fixed = .false.
   do k = 1, size(condition)
      any_fixed = any_fixed .or. any(condition(k)%fixed) .or. condition(k)%is_radial
   end do
end function any_fixed

!> Loads, iteration, weights
subroutine read_solver(scene, deck)
   !> Scene
   type(scene_type), intent(inout) :: scene
   !> Deck
   type(deck_type), intent(in) :: deck

   call deck%get('load.steps', scene%load%steps)
   call deck%get('load.activation', scene%load%activation)
   call deck%get('load.max_halvings', scene%load%max_halvings)
   call deck%get('solver.linear', scene%solver%linear)
   call deck%get('solver.newton', scene%solver%newton)
   call deck%get('solver.tolerance', scene%solver%tolerance)
   call deck%get('solver.max_iterations', scene%solver%max_iterations)
   call deck%get('mixed.volume_weight', scene%mixed%volume_weight)
   call deck%get('mixed.displacement_weight', scene%mixed%displacement_weight)
   call deck%get('mixed.edge_exponent', scene%mixed%edge_exponent)
   call deck%get('mixed.edge_length', scene%mixed%edge_length)
   call deck%get('galerkin.gauss', scene%galerkin%gauss)
   call deck%get('galerkin.penalty', scene%galerkin%penalty)
   call deck%get('galerkin.direct_limit', scene%galerkin%direct_limit)
   call deck%get('galerkin.stabilisation', scene%galerkin%stabilisation)
   call deck%get('galerkin.pressure_degree', scene%galerkin%pressure_degree)
end subroutine read_solver

!> Weights of boundary rows beside equilibrium rows of weight 1. The residuals are stress over
!> length, stress and length: balanced weights have the units that make the sum one of equals, so
!> that no unit counts
subroutine read_weights(scene, deck)
   !> Scene with points and method
   type(scene_type), intent(inout) :: scene
   !> Deck
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
      if (weight == 'balanced') solver%weight_c4 = scene%mixed%displacement_weight/h**2
   end associate
end subroutine read_weights

!> Probes with exact and reference values
subroutine read_probes(scene, deck, error)
   !> Scene with points
   type(scene_type), intent(inout) :: scene
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Error handling
   type(error_type), allocatable, intent(out) :: error
   character(len=:), allocatable :: at
   real(wp), allocatable :: point(:)
   integer :: k

   allocate (scene%probe(deck%count('probe')), scene%exact(deck%count('exact')), &
      & scene%reference(deck%count('reference')))
   do k = 1, size(scene%probe)
      at = 'probe.'//to_text(k)
      associate (probe => scene%probe(k))
         call deck%get(at//'.name', probe%name)
         call deck%get(at//'.quantity', probe%quantity)
         call deck%get(at//'.point', point)
         probe%point(:size(point)) = point
         if (deck%has(at//'.set')) call find_named_set(scene%cloud, deck, at//'.set', probe%set, &
            & error)
         if (allocated(error)) return
      end associate
   end do
   do k = 1, size(scene%exact)
      at = 'exact.'//to_text(k)
      scene%exact(k)%probe = probe_number(scene, deck, at)
      call deck%get(at//'.solution', scene%exact(k)%solution)
      call deck%get(at//'.amount', scene%exact(k)%amount)
   end do
   do k = 1, size(scene%reference)
      at = 'reference.'//to_text(k)
      associate (reference => scene%reference(k))
         reference%probe = probe_number(scene, deck, at)
         call deck%get(at//'.value', reference%value)
         call deck%get(at//'.source', reference%source)
         if (deck%has(at//'.activation')) then
            call deck%get(at//'.activation', reference%load)
            reference%load = reference%load/max(scene%load%activation, tiny(1.0_wp))
         else
            call deck%get(at//'.load', reference%load)
         end if
      end associate
   end do
end subroutine read_probes

!> Number of the probe that an entry names; the deck check knows that it exists
integer function probe_number(scene, deck, at)
   !> Scene with probes
   type(scene_type), intent(in) :: scene
   !> Deck
   type(deck_type), intent(in) :: deck
   !> Key of the entry
   character(len=*), intent(in) :: at
   character(len=:), allocatable :: name

   call deck%get(at//'.probe', name)
   do probe_number = 1, size(scene%probe)
      if (scene%probe(probe_number)%name == name) return
   end do
end function probe_number

end module rk_deck_scene
