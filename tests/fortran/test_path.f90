!> Way of the unknowns through converged states; TAP for `meson test`.
program test_path
   use rk_path, only : path_type
   use rk_precision, only : wp
   use tap, only : check, finish
   implicit none

   call test_cubic
   call test_unequal_steps
   call finish()

contains

!> States on cubics of the load
pure function cubic(load) result(x)
   !> Load [-]
   real(wp), intent(in) :: load
   real(wp) :: x(2)

   x = [1.0_wp + load - 2.0_wp*load**2 + 3.0_wp*load**3, 4.0_wp*load - load**3]
end function cubic

!> Four states at equal distances determine a cubic, at any load and also behind the last state
subroutine test_cubic
   type(path_type) :: path
   real(wp) :: at(4)
   integer :: k

   at = [0.1_wp, 0.25_wp, 0.4_wp, 0.55_wp]
   call check('no state, no way', path%states() == 0)
   do k = 2, 4
      call path%note(cubic(at(k - 1)), cubic(at(k)), at(k - 1), at(k), .true.)
      call check('each equal step adds a state', path%states() == k - 1)
   end do
   call check('the next state', near(path%at(cubic(at(4)), at(4), 0.7_wp, 3), cubic(0.7_wp)))
   call check('a state at another distance', near(path%at(cubic(at(4)), at(4), 0.61_wp, 3), &
      & cubic(0.61_wp)))
   call check('the first state', near(path%at(cubic(at(4)), at(4), at(1), 3), cubic(at(1))))
   call check('two states are the secant', near(path%at(cubic(at(4)), at(4), 0.7_wp, 1), &
      & 2.0_wp*cubic(at(4)) - cubic(at(3))))
   call path%note(cubic(0.55_wp), cubic(0.7_wp), 0.55_wp, 0.7_wp, .true.)
   call check('no more states are kept', path%states() == 3)
   call check('the latest count', near(path%at(cubic(0.7_wp), 0.7_wp, 1.0_wp, 3), cubic(1.0_wp)))
end subroutine test_cubic

!> Steps of other lengths, and forgetting
subroutine test_unequal_steps
   type(path_type) :: path

   call path%note(cubic(0.0_wp), cubic(0.2_wp), 0.0_wp, 0.2_wp, .true.)
   call path%note(cubic(0.2_wp), cubic(0.3_wp), 0.2_wp, 0.3_wp, .true.)
   call check('a step of another length begins anew', path%states() == 1)
   call check('with its own secant', near(path%at(cubic(0.3_wp), 0.3_wp, 0.4_wp, 1), &
      & 2.0_wp*cubic(0.3_wp) - cubic(0.2_wp)))
   call path%note(cubic(0.3_wp), cubic(0.4_wp), 0.3_wp, 0.4_wp, .true.)
   call check('and goes on from there', path%states() == 2)
   call path%forget()
   call check('all is forgotten', path%states() == 0)
   call path%note(cubic(0.3_wp), cubic(0.4_wp), 0.3_wp, 0.4_wp, .false.)
   call path%note(cubic(0.4_wp), cubic(0.5_wp), 0.4_wp, 0.5_wp, .false.)
   call check('where steps are solved to all digits the secant is all', path%states() == 1)
end subroutine test_unequal_steps

!> Whether two states are one but for rounding
pure logical function near(x, y)
   !> States
   real(wp), intent(in) :: x(:), y(:)

   near = all(abs(x - y) < 1.0e-13_wp)
end function near

end program test_path
