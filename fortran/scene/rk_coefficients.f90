!> Coefficients of linear operators, which may vary over the body: the conductivity of Poisson's
!> problem, Lamé's constants of elasticity.
!>
!> They come in pairs, lambda and mu; a conductivity takes the place of mu.
module rk_coefficients
   use rk_equation, only : equation_type
   use rk_error, only : error_type, fatal_error, err_input
   use rk_expression, only : value_type
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   use rk_shape, only : approximation_type, new_shape, shape_type
   use rk_text, only : to_text
   implicit none
   private

   public :: new_coefficients, coefficient_at, moduli, set_essential_weight

   !> Distance of the points of finite differences, in sizes of the body [-]
   real(wp), parameter :: difference = 1.0e-3_wp

contains

!> Coefficients at points, with or without derivatives
subroutine new_coefficients(pair, slope, scene, x, with_slope, error)
   !> Lambda and mu, shape (2, np) [stress]
   real(wp), allocatable, intent(out) :: pair(:, :)
   !> Their first derivatives, if wanted, shape (2, nd, np) [stress/length]
   real(wp), allocatable, intent(out) :: slope(:, :, :)
   !> Scene with an equation
   type(scene_type), intent(in) :: scene
   !> Points, shape (nd, np) [length]
   real(wp), intent(in) :: x(:, :)
   !> Whether derivatives are wanted
   logical, intent(in) :: with_slope
   !> Error handling: an expression without a value there, coefficients that are not positive
   type(error_type), allocatable, intent(out) :: error
   integer :: ip

   allocate (pair(2, size(x, 2)))
   if (with_slope) allocate (slope(2, size(x, 1), size(x, 2)), source=0.0_wp)
   associate (equation => scene%equation)
      if (.not. equation%varies()) then
         call coefficient_at(equation, x(:, 1), pair(:, 1), error)
         pair(:, 2:) = spread(pair(:, 1), 2, size(x, 2) - 1)
         return
      end if
      if (equation%smoothing > 0.0_wp) then
         call interpolate(pair, slope, scene, x, error)
         return
      end if
      do ip = 1, size(x, 2)
         call coefficient_at(equation, x(:, ip), pair(:, ip), error)
         if (with_slope .and. .not. allocated(error)) &
            & call differentiate(equation, x(:, ip), slope(:, :, ip), error)
         if (allocated(error)) return
      end do
   end associate
end subroutine new_coefficients

!> Weight of the rows of prescribed values in a linear problem: the number of source points or a
!> number over the squared spacing, times the largest coefficient
subroutine set_essential_weight(scene, error)
   type(scene_type), intent(inout) :: scene
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(inout) :: error
   type(error_type), allocatable :: failure
   real(wp), allocatable :: pair(:, :), slope(:, :, :)

   if (scene%solver%weight_essential > 0.0_wp) return
   call new_coefficients(pair, slope, scene, scene%cloud%points, .false., failure)
   if (allocated(failure)) then
      if (.not. allocated(error)) call move_alloc(failure, error)
      return
   end if
   scene%solver%weight_essential = merge(scene%solver%weight_c4, &
      & real(size(scene%cloud%source, 2), wp), scene%solver%weight_c4 > 0.0_wp) &
      & *maxval(pair)
end subroutine set_essential_weight

!> Coefficients at a position, as given in the deck
subroutine coefficient_at(equation, x, pair, error)
   type(equation_type), intent(in) :: equation
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Lambda and mu [stress]
   real(wp), intent(out) :: pair(2)
   !> Error handling: no value there, or an invalid one
   type(error_type), allocatable, intent(inout) :: error
   real(wp) :: young, ratio

   pair = 0.0_wp
   if (equation%problem == 'poisson') then
      call equation%conductivity%at(x, pair(2), error)
      if (.not. (allocated(error) .or. pair(2) > 0.0_wp)) call refuse(equation%conductivity, &
         & 'must be positive', pair(2))
      return
   end if
   call equation%E%at(x, young, error)
   call equation%nu%at(x, ratio, error)
   if (allocated(error)) return
   if (.not. young > 0.0_wp) then
      call refuse(equation%E, 'must be positive', young)
   else if (.not. (ratio > -1.0_wp .and. ratio < 0.5_wp)) then
      call refuse(equation%nu, 'must be greater than -1 and less than 0.5', ratio)
   else
      pair = lame_constants(young, ratio)
   end if

contains

   !> Report an invalid value
   subroutine refuse(given, what, value)
      type(value_type), intent(in) :: given
      character(len=*), intent(in) :: what
      real(wp), intent(in) :: value

      call fatal_error(error, err_input, given%where//': '//what//', not '//to_text(value) &
         & //' as at '//to_text(x))
   end subroutine refuse

end subroutine coefficient_at

!> First derivatives of the coefficients, by sixth-order central differences about a position
subroutine differentiate(equation, x, slope, error)
   type(equation_type), intent(in) :: equation
   real(wp), intent(in) :: x(:)
   !> Derivatives, shape (2, nd) [stress/length]
   real(wp), intent(out) :: slope(:, :)
   !> Error handling: no value near there
   type(error_type), allocatable, intent(inout) :: error
   real(wp), parameter :: weight(3) = [45.0_wp, -9.0_wp, 1.0_wp]/60.0_wp
   real(wp) :: step, there(size(x)), up(2), down(2)
   integer :: d, k

   slope = 0.0_wp
   step = difference*minval(equation%extent(:size(x)))
   do d = 1, size(x)
      do k = 1, 3
         there = x
         there(d) = x(d) + k*step
         call coefficient_at(equation, there, up, error)
         there(d) = x(d) - k*step
         call coefficient_at(equation, there, down, error)
         slope(:, d) = slope(:, d) + weight(k)*(up - down)/step
      end do
   end do
end subroutine differentiate

!> Coefficients interpolated between source points by reproducing kernel functions of order 1: jumps
!> become smooth, as rows of second derivatives require (thesis, figure 6.5)
subroutine interpolate(pair, slope, scene, x, error)
   real(wp), intent(inout) :: pair(:, :)
   !> Not allocated if not requested
   real(wp), allocatable, intent(inout) :: slope(:, :, :)
   type(scene_type), intent(in) :: scene
   real(wp), intent(in) :: x(:, :)
   !> Error handling: no value at a source point, a support that is too small
   type(error_type), allocatable, intent(out) :: error
   type(approximation_type) :: linear
   type(shape_type) :: shape
   real(wp), allocatable :: values(:), field(:, :)
   integer :: ip, is

   associate (cloud => scene%cloud)
      allocate (values(2*size(cloud%source, 2)))
      do is = 1, size(cloud%source, 2)
         call coefficient_at(scene%equation, cloud%source(:, is), values(2*is - 1:2*is), error)
         if (allocated(error)) return
      end do
      linear = scene%approximation
      linear%order = 1
      call new_shape(shape, linear, cloud%source, &
         & scene%equation%smoothing*cloud%spacing, x, error)
      if (allocated(error)) then
         error%message = 'linear.smoothing: '//error%message
         return
      end if
      allocate (field(2, shape%nq))
      do ip = 1, size(x, 2)
         call shape%interpolate(ip, values, 1, 1 + size(x, 1), field)
         pair(:, ip) = field(:, 1)
         if (allocated(slope)) slope(:, :, ip) = field(:, 2:1 + size(x, 1))
      end do
   end associate
end subroutine interpolate

!> Moduli c(i, A, k, B) of the operators, zero where there are fewer fields
pure function moduli(equation, pair) result(c)
   type(equation_type), intent(in) :: equation
   !> Lambda and mu, or their derivatives
   real(wp), intent(in) :: pair(2)
   real(wp) :: c(3, 3, 3, 3)
   integer :: i, k

   c = 0.0_wp
   if (equation%problem == 'poisson') then
      do i = 1, 3
         c(1, i, 1, i) = pair(2)
      end do
      return
   end if
   do i = 1, 3
      do k = 1, 3
         c(i, i, k, k) = c(i, i, k, k) + pair(1)
         c(i, k, i, k) = c(i, k, i, k) + pair(2)
         c(i, k, k, i) = c(i, k, k, i) + pair(2)
      end do
   end do
end function moduli

!> Lamé's constants
pure function lame_constants(young, ratio) result(lame)
   !> Young's modulus [force/length^2]
   real(wp), intent(in) :: young
   !> Poisson's ratio [-]
   real(wp), intent(in) :: ratio
   !> [force/length^2]
   real(wp) :: lame(2)

   lame(2) = 0.5_wp*young/(1.0_wp + ratio)
   lame(1) = 2.0_wp*lame(2)*ratio/(1.0_wp - 2.0_wp*ratio)
end function lame_constants

end module rk_coefficients
