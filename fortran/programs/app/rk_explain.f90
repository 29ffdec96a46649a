!> Explanation of a deck: what it models and what that costs, before anything is computed.
module rk_explain
   use rk_borders, only : extent_of
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type, word_length
   use rk_deck_blocks, only : finer_directions
   use rk_error, only : error_type
   use rk_estimate, only : estimate_cost, estimate_type
   use rk_forecast, only : forecast_bars, forecast_solve
   use rk_lapack, only : syrk
   use rk_memory, only : available_bytes
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   use rk_system, only : cpu_seconds
   use rk_text, only : to_text
   implicit none
   private

   public :: explain

contains

!> Print the explanation
subroutine explain(deck, model, scene)
   type(deck_type), intent(in) :: deck
   !> Points of the model file
   type(cloud_type), intent(in) :: model
   type(scene_type), intent(in) :: scene
   type(estimate_type) :: cost
   character(len=word_length), allocatable :: sides(:)
   character(len=:), allocatable :: text
   real(wp) :: bars, most, speed, wanted, whole
   integer :: k

   cost = estimate_cost(deck, model)
   print '(a)', scene%title
   print '(a)', '  units         '//scene%force_unit//', '//scene%length_unit
   if (allocated(scene%equation%problem)) then
      print '(a)', '  dimension     '//to_text(scene%cloud%nd)
      print '(a)', '  equation      linear '//scene%equation%problem//trim(merge( &
         & ' in plane strain', '                ', scene%equation%problem == 'elasticity' .and. &
         & scene%cloud%nd == 2))//': one assembly, one '//trim(merge('least squares ', &
         & '              ', scene%method == 'rkcm'))//' solve'
   else
      print '(a)', '  dimension     '//trim(merge('3              ', '2, plane strain', &
         & scene%cloud%nd == 3))
   end if
   print '(a)', '  method        '//scene%method//', basis of order ' &
      & //to_text(scene%approximation%order)//', about '//to_text(nint(cost%neighbours)) &
      & //' neighbours per point'
   print '(a)', '  points        '//to_text(nint(cost%ns))//' source, '//to_text(nint(cost%nc)) &
      & //' collocation, '//to_text(size(scene%cloud%boundary_point))//' boundary entries'
   if (allocated(scene%cloud%block)) call explain_blocks(deck, model, scene)
   call deck%get('geometry.graded', sides)
   if (size(sides) > 0) print '(*(a))', '  graded        points lie closer to', &
      & (' '//trim(sides(k)), k=1, size(sides))
   if (deck%has('refine')) then
      call deck%get('refine.accuracy', wanted)
      call deck%get('refine.cost', most)
      print '(a)', '  search        these points are the first; more are added until the probes ' &
         & //'are accurate to '//to_text(100.0_wp*wanted, 3)//' %, within '//to_text(most, 3) &
         & //' CPU s'
   end if
   print '(a)', '  equations     '//to_text(nint(cost%equations))//' for ' &
      & //to_text(nint(cost%unknowns))//' unknowns'
   call explain_sets(scene)
   do k = 1, size(scene%tissue)
      print '(a)', '  material      '//scene%tissue(k)%name//': ' &
         & //to_text(count(scene%tissue_of == k))//' points'
   end do
   if (.not. allocated(scene%equation%problem)) call explain_load(scene)
   print '(a)', '  solver        '//cost%solver//', '//to_text(1.0e-9_wp*cost%flops, 3) &
      & //' Gflop per solution'
   print '(a)', '  memory        '//to_text(1.0e-6_wp*cost%bytes, 3)//' MB of ' &
      & //to_text(1.0e-6_wp*available_bytes(), 3)//' MB free'
   speed = rate()
   bars = forecast_bars(deck, model, scene)/speed
   whole = forecast_solve(scene, cost)/speed + bars
   text = 'about '//to_text(whole, 2)//' CPU s, of which error bars '//to_text(bars, 2)
   if (deck%has('refine')) text = text//'; finer points of the search take more'
   print '(a)', '  time          '//text
end subroutine explain

!> Blocks of voxels between the source points, and where they were refined automatically
subroutine explain_blocks(deck, model, scene)
   type(deck_type), intent(in) :: deck
   type(cloud_type), intent(in) :: model
   !> Scene with blocks
   type(scene_type), intent(in) :: scene
   character(len=*), parameter :: axes = 'xyz'
   character(len=:), allocatable :: single, text
   logical :: finer(3)
   integer :: blocks, d

   finer = finer_directions(model, deck)
   text = ''
   single = ''
   do d = 1, 3
      blocks = maxval(scene%cloud%block(d, :)) + 1
      text = text//' x '//to_text(blocks)
      if (finer(d)) single = single//' and '//axes(d:d)
   end do
   text = text(4:)//' of voxels, whose corners are the source points'
   if (any(finer)) text = text//'; single voxels along '//single(6:)//', since layers are thin'
   print '(a)', '  blocks        '//text
end subroutine explain_blocks

!> Sets that are parts of the surface
subroutine explain_sets(scene)
   type(scene_type), intent(in) :: scene
   type(error_type), allocatable :: error
   character(len=:), allocatable :: text
   real(wp) :: area, middle(scene%cloud%nd)
   integer :: k

   associate (cloud => scene%cloud)
      do k = cloud%sides() + 1, size(cloud%set_names)
         call extent_of(cloud, k, area, middle, error)
         text = trim(cloud%set_names(k))//': '//to_text(count(cloud%within(k, :)))//' of ' &
            & //to_text(size(cloud%boundary_set))//' boundary points, ' &
            & //trim(merge('area  ', 'length', cloud%nd == 3))//' ' &
            & //to_text(area, 4)//', middle at '//to_text(middle)
         print '(a)', '  set           '//text
      end do
   end associate
end subroutine explain_sets

!> Load steps, and growth of the activation
subroutine explain_load(scene)
   type(scene_type), intent(in) :: scene
   character(len=:), allocatable :: activation
   integer :: k

   k = scene%common_tissue()
   activation = ', activation to '//to_text(scene%load%activation)
   if (k > 0) activation = ', activation to '//to_text(scene%tissue(k)%activation)
   if (scene%has_own_activations()) activation = ''
   do k = 1, size(scene%tissue)
      if (.not. (scene%tissue(k)%material%fibered .and. scene%has_own_activations())) cycle
      if (scene%tissue(k)%level%given()) then
         activation = activation//', activation of '//scene%tissue(k)%name//' by its expression'
      else
         activation = activation//', activation of '//scene%tissue(k)%name//' to ' &
            & //to_text(scene%tissue(k)%activation)
      end if
   end do
   print '(a)', '  load          '//to_text(scene%steps()) &
      & //trim(merge(' step ', ' steps', scene%steps() == 1))//activation
   if (.not. allocated(scene%cloud%activation)) return
   do k = 1, size(scene%tissue)
      if (scene%tissue(k)%material%fibered .and. .not. scene%tissue(k)%level%given()) print '(a)', &
         & '  activation    '//scene%tissue(k)%name//': a part of it at each point of the model, ' &
         & //'mean '//to_text(sum(scene%cloud%activation*scene%cloud%volume, &
         & mask=scene%tissue_of == k)/sum(scene%cloud%volume, mask=scene%tissue_of == k), 3)
   end do
end subroutine explain_load

!> Rate of matrix products on this machine, in operations per CPU second
real(wp) function rate()
   integer, parameter :: n = 600
   real(wp), allocatable :: a(:, :), c(:, :)
   real(wp) :: before
   integer :: trial

   allocate (a(n, n), source=1.0_wp)
   allocate (c(n, n), source=0.0_wp)
   rate = 1.0_wp
   do trial = 1, 5
      before = cpu_seconds()
      call syrk(a, n, n, c)
      rate = max(rate, real(n, wp)**3/max(cpu_seconds() - before, 1.0e-6_wp))
   end do
end function rate

end module rk_explain
