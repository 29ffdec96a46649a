!> What a deck will model and what that costs, before anything is computed.
module rk_explain
   use rk_cloud, only : cloud_type
   use rk_deck, only : deck_type, word_length
   use rk_deck_blocks, only : finer_directions
   use rk_error, only : error_type
   use rk_estimate, only : estimate_cost, estimate_type
   use rk_forecast, only : forecast_bars, forecast_solve, may_be_halved
   use rk_lapack, only : syrk
   use rk_memory, only : available_bytes
   use rk_named_sets, only : extent_of
   use rk_precision, only : wp
   use rk_scene, only : condition_type, scene_type
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
      call explain_equation(scene)
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
   do k = 1, size(scene%tissue)
      associate (material => scene%tissue(k)%material)
         call get_parts(material%active, text)
         text = text//', K '
         if (material%bulk <= huge(1.0_wp)) then
            text = text//to_text(material%bulk)
         else
            text = text//'inf'
         end if
         print '(a)', '  material      '//scene%tissue(k)%name//': '//text//', shear modulus ' &
            & //to_text(material%shear)//', ' &
            & //to_text(count(scene%tissue_of == k))//' points'
      end associate
   end do
   call explain_sets(scene)
   do k = 1, size(scene%condition)
      associate (condition => scene%condition(k))
         call get_prescribed(condition, scene%cloud%nd, text)
         print '(a)', '  boundary      '//trim(scene%cloud%set_names(condition%set))//': '//text
      end associate
   end do
   if (.not. allocated(scene%equation%problem)) call explain_load(scene)
   print '(a)', '  solver        '//cost%solver//', '//to_text(1.0e-9_wp*cost%flops, 3) &
      & //' Gflop per solution'
   print '(a)', '  memory        '//to_text(1.0e-6_wp*cost%bytes, 3)//' MB of ' &
      & //to_text(1.0e-6_wp*available_bytes(), 3)//' MB free'
   speed = rate()
   bars = forecast_bars(deck, model, scene, halved=.false.)/speed
   whole = forecast_solve(scene, cost, halved=.false.)/speed + bars
   text = 'about '//to_text(whole, 2)//' CPU s, of which error bars '//to_text(bars, 2)
   if (may_be_halved(scene)) text = text//'; up to '//to_text((forecast_solve(scene, cost, &
      & halved=.true.) + forecast_bars(deck, model, scene, halved=.true.))/speed, 2) &
      & //' if load steps have to be halved'
   if (deck%has('refine')) text = text//'; finer points of the search take more'
   print '(a)', '  time          '//text
end subroutine explain

!> Blocks of voxels between the source points, and where they became finer by themselves
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

!> Sets that are parts of the surface, and which of them overlap
subroutine explain_sets(scene)
   type(scene_type), intent(in) :: scene
   type(error_type), allocatable :: error
   character(len=:), allocatable :: text
   real(wp) :: area, middle(scene%cloud%nd)
   integer :: k, l, n, shared

   associate (cloud => scene%cloud)
      n = size(cloud%set_names)
      do k = cloud%sides() + 1, n
         call extent_of(cloud, k, area, middle, error)
         text = trim(cloud%set_names(k))//': '//to_text(count(cloud%within(k, :)))//' of ' &
            & //to_text(size(cloud%boundary_set))//' boundary points, ' &
            & //trim(merge('area  ', 'length', cloud%nd == 3))//' ' &
            & //to_text(area, 4)//', middle at '//to_text(middle)
         do l = cloud%sides() + 1, n
            shared = count(cloud%within(k, :) .and. cloud%within(l, :))
            if (l /= k .and. shared > 0) text = text//'; '//to_text(shared)//' shared with ' &
               & //trim(cloud%set_names(l))
         end do
         print '(a)', '  set           '//text
      end do
   end associate
end subroutine explain_sets

!> Load steps and what grows in them
subroutine explain_load(scene)
   type(scene_type), intent(in) :: scene
   integer :: k

   print '(a)', '  load          '//to_text(scene%steps()) &
      & //trim(merge(' step ', ' steps', scene%steps() == 1))//', activation to ' &
      & //to_text(scene%load%activation)
   associate (amplitude => scene%programme%amplitude)
      do k = 1, size(amplitude)
         print '(a)', '  amplitude     '//amplitude(k)%name//': '//to_text(amplitude(k)%value) &
            & //' at load '//to_text(amplitude(k)%time) &
            & //trim(merge(', smooth', '        ', amplitude(k)%curve == 'smooth'))
      end do
   end associate
   do k = 1, size(scene%tissue)
      associate (level => scene%tissue(k)%level)
         if (level%given()) then
            print '(a)', '  activation    '//scene%tissue(k)%name//': '//level%text &
               & //' at each place'
         else if (allocated(scene%cloud%activation) .and. scene%tissue(k)%material%fibered) then
            print '(a)', '  activation    '//scene%tissue(k)%name//': a part of it at each ' &
               & //'point of the model, mean ' &
               & //to_text(sum(scene%cloud%activation*scene%cloud%volume, &
               & mask=scene%tissue_of == k)/sum(scene%cloud%volume, mask=scene%tissue_of == k), 3)
         end if
      end associate
   end do
   if (.not. scene%has_own_activations()) return
   do k = 1, size(scene%tissue)
      if (scene%tissue(k)%material%fibered) print '(a)', '  activation    ' &
         & //scene%tissue(k)%name//' to '//to_text(scene%tissue(k)%activation)
   end do
end subroutine explain_load

!> What a linear problem is
subroutine explain_equation(scene)
   !> Scene with an equation
   type(scene_type), intent(in) :: scene
   character(len=:), allocatable :: text

   associate (equation => scene%equation)
      text = 'linear '//equation%problem
      if (equation%problem == 'elasticity') then
         if (scene%cloud%nd == 2) text = text//' in plane strain'
         text = text//', E '
         call equation%E%append_to(text)
         text = text//', nu '
         call equation%nu%append_to(text)
      else if (equation%conductivity%given()) then
         text = text//', conductivity '//equation%conductivity%text
      end if
      print '(a)', '  equation      '//text//': one assembly, one ' &
         & //trim(merge('least squares ', '              ', scene%method == 'rkcm'))//' solve'
      print '(a)', '  solution      '//trim(merge('given    ', 'not known', equation%is_known()))
   end associate
end subroutine explain_equation

!> What a condition prescribes
subroutine get_prescribed(condition, nd, text)
   type(condition_type), intent(in) :: condition
   !> Dimension
   integer, intent(in) :: nd
   character(len=:), allocatable, intent(out) :: text
   character(len=1), parameter :: axes(3) = ['x', 'y', 'z']
   integer :: d

   text = ''
   if (condition%is_radial) text = ', radial displacement '//to_text(condition%radial)
   do d = 1, nd
      if (.not. condition%fixed(d) .or. abs(condition%direction(d)) > 0.0_wp) cycle
      text = text//', u_'//axes(d)//' '
      call condition%value(d)%append_to(text)
   end do
   if (any(condition%traction(:nd)%given())) then
      text = text//', traction'
      do d = 1, nd
         text = text//' '//condition%traction(d)%text
      end do
   else if (any(condition%traction(:nd)%acts())) then
      text = text//', traction '//to_text(condition%traction(:nd)%number)
   end if
   if (abs(condition%pressure) > 0.0_wp) text = text//', pressure '//to_text(condition%pressure)
   if (any(condition%spring > 0.0_wp)) text = text//', spring '//to_text(condition%spring(:nd))
   if (condition%tendon > 0.0_wp) text = text//', tendon '//to_text(condition%tendon)//' along ' &
      & //to_text(condition%direction(:nd))
   if (abs(condition%pull) > 0.0_wp) text = text//', pulled by '//to_text(condition%pull)
   if (text == '') text = ', free'
   text = text(3:)
end subroutine get_prescribed

!> What of a material is paid for
subroutine get_parts(active, text)
   !> Whether the energy depends on I1, I2, I4
   logical, intent(in) :: active(3)
   character(len=:), allocatable, intent(out) :: text

   text = 'energy of J'
   if (active(1)) text = text//', I1'
   if (active(2)) text = text//', I2'
   if (active(3)) text = text//' and the fiber stretch'
end subroutine get_parts

!> Operations of a matrix product in a CPU second of this machine
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
