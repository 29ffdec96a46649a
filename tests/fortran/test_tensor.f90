!> Matrices of space against closed forms; TAP for `meson test`.
program test_tensor
   use rk_precision, only : wp
   use rk_tensor, only : cofactor, cross, cross_form, determinant, identity, principal_values, &
      & solve_definite, vector_product
   use tap, only : check, finish
   implicit none

   !> Rounding of a few products of numbers up to 10
   real(wp), parameter :: tight = 1.0e-13_wp
   !> A matrix without symmetry whose determinant is -59, and its cofactors
   real(wp), parameter :: f(3, 3) = reshape([2.0_wp, 1.0_wp, -3.0_wp, 4.0_wp, -1.0_wp, 2.0_wp, &
      & 5.0_wp, 3.0_wp, 1.0_wp], [3, 3])
   real(wp), parameter :: cof(3, 3) = reshape([-7.0_wp, 6.0_wp, 17.0_wp, -10.0_wp, 17.0_wp, &
      & -1.0_wp, -1.0_wp, -16.0_wp, -6.0_wp], [3, 3])
   !> A rotation: columns are a right-handed orthonormal basis
   real(wp), parameter :: turn(3, 3) = reshape([2.0_wp, -1.0_wp, 2.0_wp, 2.0_wp, 2.0_wp, -1.0_wp, &
      & -1.0_wp, 2.0_wp, 2.0_wp]/3.0_wp, [3, 3])

   call test_determinant
   call test_products
   call test_principal_values
   call test_solve
   call finish()

contains

!> Determinant, cofactors and what binds them: F^T cof F = det F 1
subroutine test_determinant
   call check('determinant of the identity', near(determinant(identity), 1.0_wp))
   call check('determinant of a matrix without symmetry', near(determinant(f), -59.0_wp))
   call check('of a rotation', near(determinant(turn), 1.0_wp))
   call check('an exchange of rows changes the sign', near(determinant(f([2, 1, 3], :)), 59.0_wp))
   call check('equal columns', near(determinant(f(:, [1, 1, 3])), 0.0_wp))
   call check('cofactors by hand', all(near(cofactor(f), cof)))
   call check('F^T cof F', all(near(matmul(transpose(f), cofactor(f)), -59.0_wp*identity)))
   call check('cofactors of a rotation are the rotation', all(near(cofactor(turn), turn)))
end subroutine test_determinant

!> The product of matrices, its form, and the product of vectors
subroutine test_products
   real(wp) :: form(9, 9), image(3, 3)

   call check('half of F x F is cof F', all(near(0.5_wp*cross(f, f), cofactor(f))))
   call check('1 x 1', all(near(cross(identity, identity), 2.0_wp*identity)))
   call check('the product commutes', all(near(cross(f, turn), cross(turn, f))))
   ! cof (A + B) = cof A + A x B + cof B
   call check('polarisation of the cofactors', &
      & all(near(cofactor(f + turn), cofactor(f) + cross(f, turn) + cofactor(turn))))
   form = cross_form(f)
   image = reshape(matmul(form, reshape(turn, [9])), [3, 3])
   call check('the form gives the product', all(near(image, cross(f, turn))))
   call check('the form is symmetric', all(near(form, transpose(form))))
   call check('vector product of a right-handed basis', &
      & all(near(vector_product(turn(:, 1), turn(:, 2)), turn(:, 3))))
   call check('against the order', all(near(vector_product(turn(:, 2), turn(:, 1)), -turn(:, 3))))
end subroutine test_products

!> Eigenvalues of matrices that were made from them
subroutine test_principal_values
   call check('distinct, descending', made_of([7.0_wp, 2.0_wp, -3.0_wp]))
   call check('not given in order', made_of([-3.0_wp, 7.0_wp, 2.0_wp]))
   call check('two equal, the larger ones', made_of([4.0_wp, 4.0_wp, 1.0_wp]))
   call check('two equal, the smaller ones', made_of([4.0_wp, 1.0_wp, 1.0_wp]))
   call check('all equal', made_of([5.0_wp, 5.0_wp, 5.0_wp]))
   call check('zero', made_of([0.0_wp, 0.0_wp, 0.0_wp]))
end subroutine test_principal_values

!> Whether the principal values of a matrix are those it was made of
logical function made_of(values)
   real(wp), intent(in) :: values(3)
   real(wp) :: a(3, 3), found(3)
   integer :: k

   a = 0.0_wp
   do k = 1, 3
      a = a + values(k)*spread(turn(:, k), 2, 3)*spread(turn(:, k), 1, 3)
   end do
   found = principal_values(a)
   ! the cosine of an angle near 0 loses half of the digits of equal values
   made_of = all(abs(found - [maxval(values), sum(values) - maxval(values) - minval(values), &
      & minval(values)]) <= 1.0e-7_wp)
end function made_of

!> Small systems of two and three unknowns with several right-hand sides
subroutine test_solve
   real(wp) :: a(3, 3), work(3, 3), b(3, 2), x(3, 2)

   a = matmul(transpose(f), f)
   x = reshape([1.0_wp, -2.0_wp, 3.0_wp, 0.0_wp, 4.0_wp, -1.0_wp], [3, 2])
   b = matmul(a, x)
   work = a
   call solve_definite(work, b)
   call check('three unknowns', all(abs(b - x) <= 1.0e-11_wp))
   b(:2, :) = matmul(a(:2, :2), x(:2, :))
   work = a
   call solve_definite(work(:2, :2), b(:2, :))
   call check('two unknowns', all(abs(b(:2, :) - x(:2, :)) <= 1.0e-11_wp))
end subroutine test_solve

!> Equal up to rounding
elemental logical function near(a, b)
   !> Numbers
   real(wp), intent(in) :: a, b

   near = abs(a - b) <= tight*max(1.0_wp, abs(b))
end function near

end program test_tensor
