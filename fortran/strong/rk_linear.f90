!> Strong form collocation of linear boundary value problems, thesis section 5.2.
!>
!> L u = f in the body, B^h u = h and B^g u = g on its boundary (5.7), for operators of second order
!> with constant coefficients: (L u)_i = c(i,A,k,B) u_k,AB, (B^h u)_i = c(i,A,k,B) n_A u_k,B and
!> B^g u = u. Poisson's problem has c = 1 for A = B, elasticity its moduli. The rows are weighted as
!> in (5.15); the deck gives f, h and g. Coefficients that vary add first derivatives:
!> (c u_k,B),A = c u_k,AB + c,A u_k,B.
!>
!> Collocation points inside carry L, those on the boundary B^h or B^g only (5.10). With L on the
!> boundary as well the L2 errors are 4 to 7 times larger and fall more slowly.
module rk_linear
   use rk_basis, only : second_index
   use rk_coefficients, only : coefficients_type, moduli, new_coefficients
   use rk_conditions, only : boundary_type, new_boundary
   use rk_error, only : error_type
   use rk_mixture, only : new_mixture
   use rk_precision, only : wp
   use rk_problem, only : evaluation_type, stage_type
   use rk_rows, only : new_rows
   use rk_scene, only : scene_type
   use rk_equation, only : source_at
   use rk_strong, only : strong_problem
   implicit none
   private

   public :: linear_problem, new_linear, set_essential_weight

   !> Linear problem of a scene
   type, extends(strong_problem) :: linear_problem
      !> Coefficients at the collocation points
      type(coefficients_type) :: coefficient
      !> Points inside; their blocks of rows come before those of the boundary points
      integer :: inside = 0
      !> Weighted right hand side, shape (m)
      real(wp), allocatable :: b(:)
   contains
      procedure :: own_side, assemble
   end type linear_problem

contains

!> Set up the linear problem of a scene
subroutine new_linear(self, scene, error)
   type(linear_problem), intent(inout) :: self
   !> Scene with an equation
   type(scene_type), target, intent(in) :: scene
   type(error_type), allocatable, intent(out) :: error
   integer, allocatable :: inside(:), range(:, :)
   integer :: nd, nb, b, d

   self%scene => scene
   self%linear = .true.
   nd = scene%cloud%nd
   self%fields = scene%equation%fields(nd)
   call new_boundary(self%boundary, scene, error)
   if (.not. allocated(error)) call new_mixture(self%mixture, scene, scene%cloud%points, &
      & [integer ::], .false., error)
   if (.not. allocated(error)) call new_coefficients(self%coefficient, scene, scene%cloud%points, &
      & .true., error)
   if (allocated(error)) return
   allocate (self%shape)
   call scene%shape_at(scene%cloud%points, self%shape, error)
   if (allocated(error)) return
   inside = [(b, b=1, self%shape%np)]
   inside(self%boundary%point) = 0
   inside = pack(inside, inside > 0)
   self%inside = size(inside)
   nb = size(self%boundary%point)
   allocate (range(2, self%inside + nb))
   range(1, :self%inside) = merge(2, 2 + nd, scene%equation%varies())
   range(2, :self%inside) = self%shape%nq
   range(1, self%inside + 1:) = 1
   range(2, self%inside + 1:) = 1 + nd
   call new_rows(self%rows, self%shape, self%fields, [inside, self%boundary%point], &
      & [(self%fields, b=1, self%inside + nb)], range, scene%cloud%points, &
      & [(minval(scene%cloud%spacing(d, :)), d=1, nd)])
   self%m = self%rows%m
   self%n = self%rows%n
   allocate (self%b(self%m), source=0.0_wp)
   ! (5.13)-(5.15)
   do b = 1, size(self%rows%place)
      if (b <= self%inside) then
         self%rows%coefficient(:, :, :, b) = domain_rows(self, self%rows%place(b))
      else
         self%rows%coefficient(:, :, :, b) = boundary_rows(self, b - self%inside)
      end if
   end do
   call self%own_side(0.0_wp, self%b, error)
end subroutine new_linear

!> L
pure function domain_rows(self, ip) result(rows)
   class(linear_problem), intent(in) :: self
   !> Collocation point
   integer, intent(in) :: ip
   real(wp) :: rows(self%fields, self%fields, self%shape%nq)
   real(wp), allocatable :: c(:, :, :, :)
   integer :: a, b, q

   rows = 0.0_wp
   if (self%scene%equation%varies()) then
      do a = 1, self%shape%nd
         c = moduli(self%scene%equation, self%shape%nd, self%coefficient%slope(:, a, ip))
         do b = 1, self%shape%nd
            rows(:, :, 1 + b) = rows(:, :, 1 + b) + c(:, a, :, b)
         end do
      end do
   end if
   c = moduli(self%scene%equation, self%shape%nd, self%coefficient%pair(:, ip))
   do a = 1, size(c, 2)
      do b = a, size(c, 2)
         q = second_index(size(c, 2), a, b)
         rows(:, :, q) = c(:, a, :, b)
         if (a /= b) rows(:, :, q) = rows(:, :, q) + c(:, b, :, a)
      end do
   end do
end function domain_rows

!> B^g and B^h with their weights
pure function boundary_rows(self, b) result(rows)
   class(linear_problem), intent(in) :: self
   !> Boundary point
   integer, intent(in) :: b
   real(wp) :: rows(self%fields, self%fields, self%shape%nq)
   real(wp), allocatable :: c(:, :, :, :)
   integer :: a, d, i

   rows = 0.0_wp
   c = moduli(self%scene%equation, self%shape%nd, self%coefficient%pair(:, &
      & self%boundary%point(b)))
   do i = 1, self%fields
      if (self%boundary%essential(i, b)) then
         rows(i, i, 1) = self%scene%solver%weight_essential
         cycle
      end if
      do d = 1, self%shape%nd
         do a = 1, self%shape%nd
            rows(i, :, 1 + d) = rows(i, :, 1 + d) + self%scene%solver%weight_traction &
               & *self%boundary%normal(a, i, b)*c(i, a, :, d)
         end do
      end do
   end do
end function boundary_rows

!> Weighted right hand side at a time: sources inside, values and tractions at the boundary
subroutine own_side(self, time, side, error)
   class(linear_problem), intent(in) :: self
   !> Time, of no meaning where nothing moves
   real(wp), intent(in) :: time
   !> Right hand side, shape (m)
   real(wp), intent(inout) :: side(:)
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(out) :: error
   type(boundary_type) :: boundary
   real(wp) :: f(self%fields)
   integer :: b, i, row

   associate (scene => self%scene)
      call new_boundary(boundary, scene, error, time)
      if (allocated(error)) return
      do b = 1, size(self%rows%place)
         row = self%rows%row(b)
         if (b <= self%inside) then
            call source_at(scene%equation, scene%cloud%points(:, self%rows%place(b)), time, f, &
               & error)
            if (allocated(error)) return
            side(row + 1:row + self%fields) = -f
            cycle
         end if
         do i = 1, self%fields
            if (boundary%essential(i, b - self%inside)) then
               side(row + i) = scene%solver%weight_essential*boundary%value(1, i, b - self%inside)
            else
               side(row + i) = scene%solver%weight_traction*boundary%traction(1, i, b - self%inside)
            end if
         end do
      end do
   end associate
end subroutine own_side

!> Weight of essential rows: the number of source points or a number over the squared spacing, times
!> the largest coefficient
subroutine set_essential_weight(scene, error)
   type(scene_type), intent(inout) :: scene
   !> Error handling: an expression without a value somewhere
   type(error_type), allocatable, intent(inout) :: error
   type(coefficients_type) :: coefficient
   type(error_type), allocatable :: failure

   if (scene%solver%weight_essential > 0.0_wp) return
   call new_coefficients(coefficient, scene, scene%cloud%points, .false., failure)
   if (allocated(failure)) then
      if (.not. allocated(error)) call move_alloc(failure, error)
      return
   end if
   scene%solver%weight_essential = merge(scene%solver%weight_c4, &
      & real(size(scene%cloud%source, 2), wp), scene%solver%weight_c4 > 0.0_wp) &
      & *maxval(coefficient%pair)
end subroutine set_essential_weight

!> Residuals A x - load b; the rows are the same in every state
subroutine assemble(self, x, stage, r, seen)
   class(linear_problem), target, intent(inout) :: self
   real(wp), contiguous, intent(in) :: x(:)
   type(stage_type), intent(in) :: stage
   real(wp), contiguous, intent(inout) :: r(:)
   type(evaluation_type), intent(out) :: seen

   self%linearised => self%rows
   call self%rows%apply(x, r)
   r = r - stage%load*self%b
   seen%valid = all(abs(r) <= huge(1.0_wp))
end subroutine assemble

end module rk_linear
