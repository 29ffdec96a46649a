!> Linear constraints B x = c of a square system, met exactly by multipliers.
!>
!> Of the equations K x + B^T m = b, B x = c only the part of b across the constraints counts: the
!> system is P K x = P b, B x = c with the projection P = 1 - B^T (B B^T)^-1 B. As one matrix it is
!> A = P K + B^T R B with positive resistances R. It is never formed: K has R B^T B in it, whose
!> places are few, is factorised as it is, and the multipliers follow from minimal residuals with
!> B K^-1 B^T, which R preconditions; where the factor has half of the digits, unknowns and
!> multipliers follow together. That is an augmented Lagrangian with exact multipliers; the same
!> equations in a basis of the null space would couple all that a face holds.
!>
!> Reference: Benzi, Golub, Liesen, Acta Numerica 14 (2005), sections 6 and 8,
!>            doi:10.1017/S0962492904000212
module rk_constraint
   use rk_csr, only : csr_type
   use rk_error, only : error_type, fatal_error, err_linalg
   use rk_minres, only : minres, symmetric_system
   use rk_operator, only : square_report
   use rk_precision, only : i8, wp
   use rk_sparse, only : factor_upper, sparse_factor
   use rk_symmetric, only : new_symmetric, preconditioned_type, solve_near, symmetric_matrix
   use rk_text, only : to_text
   implicit none
   private

   public :: constraint_type, new_constraint, constrained_matrix

   !> Constraints, a row each
   type :: constraint_type
      !> Number of constraints
      integer :: rows = 0
      !> Unknowns of each row, and what they count in it
      type(csr_type) :: unknown
      real(wp), allocatable :: value(:)
      !> Resistance of each row in the matrix K, shape (rows)
      real(wp), allocatable :: resistance(:)
      !> Factor of B B^T
      type(sparse_factor), private :: square
   contains
      procedure :: times, add_transposed, multipliers
   end type constraint_type

   !> A matrix under constraints; of what it inherits the entries stay empty
   type, extends(symmetric_matrix) :: constrained_matrix
      !> K, with R B^T B
      class(symmetric_matrix), pointer :: matrix => null()
      type(constraint_type), pointer :: constraint => null()
   contains
      procedure :: apply, apply_transposed, solve_square
   end type constrained_matrix

   !> B K^-1 B^T with the last factor of K
   type, extends(symmetric_system) :: compliance_type
      type(constrained_matrix), pointer :: whole => null()
   contains
      procedure :: multiply, precondition
   end type compliance_type

   !> Unknowns and multipliers: K and B^T, B and 0
   type, extends(preconditioned_type) :: saddle_type
      type(constraint_type), pointer :: constraint => null()
   contains
      procedure :: multiply => multiply_saddle, precondition => precondition_saddle
   end type saddle_type

   !> Residual of one search for multipliers, and their number: the next one starts from the rest
   real(wp), parameter :: tolerance = 1.0e-8_wp
   integer, parameter :: searches = 3
   !> Violation of the constraints, of the vector's part in them, that is rounding
   real(wp), parameter :: rounding = 1.0e-13_wp
   !> Iterations of one search
   integer, parameter :: most = 200

contains

!> Take over rows and factorise B B^T
subroutine new_constraint(self, n, unknown, value, resistance, error)
   type(constraint_type), intent(inout) :: self
   !> Unknowns in all
   integer, intent(in) :: n
   !> Unknowns of each row
   type(csr_type), intent(in) :: unknown
   !> What they count in it, shape (entries)
   real(wp), intent(in) :: value(:)
   !> Resistance of each row, > 0, shape (rows)
   real(wp), intent(in) :: resistance(:)
   !> Error handling: rows that depend on each other, no memory
   type(error_type), allocatable, intent(out) :: error
   type(csr_type) :: rows
   type(symmetric_matrix) :: square
   integer(i8), allocatable :: entry(:)
   integer :: j

   self%rows = size(resistance)
   self%unknown = unknown
   self%value = value
   self%resistance = resistance
   if (self%rows == 0) return
   call unknown%transposed(n, rows, entry)
   call new_symmetric(square, 1, self%rows, rows)
   do j = 1, n
      associate (first => rows%offset(j) + 1, last => rows%offset(j + 1))
         if (last < first) cycle
         associate (column => value(entry(first:last)))
            call square%add(square%value, rows%index(first:last), spread(column, 2, size(column)) &
               & *spread(column, 1, size(column)))
         end associate
      end associate
   end do
   call factor_upper(self%square, self%rows, square%start, square%rows(), square%value, error)
end subroutine new_constraint

!> B x
function times(self, x) result(y)
   class(constraint_type), intent(in) :: self
   !> Vector, shape (n)
   real(wp), intent(in) :: x(:)
   real(wp) :: y(self%rows)
   integer(i8) :: k
   integer :: i

   y = 0.0_wp
   do i = 1, self%rows
      do k = self%unknown%offset(i) + 1, self%unknown%offset(i + 1)
         y(i) = y(i) + self%value(k)*x(self%unknown%index(k))
      end do
   end do
end function times

!> Add B^T m
subroutine add_transposed(self, m, y)
   class(constraint_type), intent(in) :: self
   !> Multipliers, shape (rows)
   real(wp), intent(in) :: m(:)
   !> Vector, to which this is added, shape (n)
   real(wp), intent(inout) :: y(:)
   integer(i8) :: k
   integer :: i

   do i = 1, self%rows
      do k = self%unknown%offset(i) + 1, self%unknown%offset(i + 1)
         y(self%unknown%index(k)) = y(self%unknown%index(k)) + self%value(k)*m(i)
      end do
   end do
end subroutine add_transposed

!> Multipliers m for which B^T m is nearest to a vector: what is left is its projection
function multipliers(self, y) result(m)
   class(constraint_type), intent(in) :: self
   !> Vector, shape (n)
   real(wp), intent(in) :: y(:)
   real(wp) :: m(self%rows)

   m = self%times(y)
   if (self%rows > 0) call self%square%solve(m)
end function multipliers

!> Part of a vector across the constraints
function projected(self, x) result(y)
   type(constraint_type), intent(in) :: self
   real(wp), intent(in) :: x(:)
   real(wp) :: y(size(x))

   y = x
   call self%add_transposed(-self%multipliers(x), y)
end function projected

!> y = (P K + B^T R B) x
subroutine apply(self, x, y)
   class(constrained_matrix), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)

   call self%matrix%apply(x, y)
   y = projected(self%constraint, y)
   call self%constraint%add_transposed(self%constraint%resistance*self%constraint%times(x), y)
end subroutine apply

!> y = (K P + B^T R B) x
subroutine apply_transposed(self, x, y)
   class(constrained_matrix), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)

   call self%matrix%apply_transposed(projected(self%constraint, x), y)
   call self%constraint%add_transposed(self%constraint%resistance*self%constraint%times(x), y)
end subroutine apply_transposed

!> Solve A x = b, with shift times the diagonal of K in K
recursive subroutine solve_square(self, shift, b, x, report, error)
   class(constrained_matrix), target, intent(inout) :: self
   real(wp), intent(in) :: shift
   real(wp), contiguous, intent(in) :: b(:)
   real(wp), contiguous, intent(inout) :: x(:)
   type(square_report), intent(out) :: report
   !> Error handling: singular matrix, no memory, multipliers that are not found
   type(error_type), allocatable, intent(out) :: error
   type(compliance_type) :: compliance
   real(wp), allocatable :: wanted(:), left(:), m(:), right(:)
   real(wp) :: reached, size_
   logical :: found
   integer :: done, k

   associate (rows => self%constraint)
      ! b = P b + B^T R c
      m = rows%multipliers(b)
      wanted = m/rows%resistance
      call solve_together(self, shift, b, wanted, x, report, found)
      if (found) return
      right = b
      call self%matrix%solve_square(shift, right, x, report, error)
      if (allocated(error)) return
      compliance%whole => self
      compliance%size = rows%rows
      size_ = norm2(wanted)
      do k = 1, searches
         left = rows%times(x) - wanted
         size_ = max(size_, norm2(left))
         if (norm2(left) <= rounding*size_) exit
         call minres(compliance, left, tolerance, most, m, done, reached)
         report%iterations = report%iterations + done
         right = 0.0_wp
         call rows%add_transposed(m, right)
         call self%matrix%kept%solve(right)
         x = x - right
      end do
      left = rows%times(x) - wanted
      if (.not. norm2(left) <= sqrt(tolerance)*size_) then
         call fatal_error(error, err_linalg, 'displacements prescribed at source points are ' &
            & //'missed by '//to_text(norm2(left)/size_, 2)//' of their size: use ' &
            & //'galerkin.essential = "penalty"')
         return
      end if
      ! rounding of the last search
      call rows%square%solve(left)
      call rows%add_transposed(-left, x)
   end associate
end subroutine solve_square

!> Solve for unknowns and multipliers together where the factor has half of the digits
subroutine solve_together(self, shift, b, wanted, x, report, found)
   type(constrained_matrix), target, intent(in) :: self
   real(wp), intent(in) :: shift
   real(wp), intent(in) :: b(:)
   !> What the constraints want, shape (rows)
   real(wp), intent(in) :: wanted(:)
   !> Solution where it was found, shape (n)
   real(wp), contiguous, intent(inout) :: x(:)
   type(square_report), intent(inout) :: report
   !> Whether it was found
   logical, intent(out) :: found
   type(saddle_type) :: system
   real(wp) :: both(size(b) + size(wanted)), left(size(wanted))

   found = .false.
   associate (matrix => self%matrix, rows => self%constraint)
      if (matrix%indefinite .or. allocated(matrix%skew)) return
      system%size = size(both)
      system%constraint => self%constraint
      if (shift > 0.0_wp) then
         call solve_near(matrix, matrix%shifted(shift), system, [b, wanted], &
            & both, report, found)
      else
         call solve_near(matrix, matrix%value, system, [b, wanted], both, &
            & report, found)
      end if
      if (.not. found) return
      x = both(:size(x))
      ! what the iteration leaves of the constraints
      left = rows%times(x) - wanted
      call rows%square%solve(left)
      call rows%add_transposed(-left, x)
   end associate
end subroutine solve_together

subroutine multiply_saddle(self, x, y)
   class(saddle_type), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)

   associate (n => self%places%n)
      call self%preconditioned_type%multiply(x(:n), y(:n))
      call self%constraint%add_transposed(x(n + 1:), y(:n))
      y(n + 1:) = self%constraint%times(x(:n))
   end associate
end subroutine multiply_saddle

subroutine precondition_saddle(self, x, y)
   class(saddle_type), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)

   associate (n => self%places%n)
      call self%preconditioned_type%precondition(x(:n), y(:n))
      y(n + 1:) = self%constraint%resistance*x(n + 1:)
   end associate
end subroutine precondition_saddle

!> y = B K^-1 B^T x
subroutine multiply(self, x, y)
   class(compliance_type), intent(in) :: self
   !> Multipliers, shape (rows)
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)
   real(wp) :: u(self%whole%n)

   u = 0.0_wp
   call self%whole%constraint%add_transposed(x, u)
   call self%whole%matrix%kept%solve(u)
   y = self%whole%constraint%times(u)
end subroutine multiply

!> y = R x: where resistances are large, little else resists
subroutine precondition(self, x, y)
   class(compliance_type), intent(in) :: self
   real(wp), contiguous, intent(in) :: x(:)
   real(wp), contiguous, intent(inout) :: y(:)

   y = self%whole%constraint%resistance*x
end subroutine precondition

end module rk_constraint
