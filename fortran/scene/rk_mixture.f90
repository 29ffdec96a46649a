!> The material at every position: one tissue, or several near an interface, with smooth fractions.
!>
!> Tissues belong to source points, each to one or, where the voxels of a model contain several, to
!> several by their volume fractions. The fractions at a position are the reproducing kernel
!> functions of order 0 times the points' fractions: never negative, so that a soft tissue beside a
!> stiff one keeps a positive modulus. All energies are linear in their moduli: mixing energies is
!> the same as interpolating moduli. The strong form then has the term P_t grad(fraction_t) in
!> addition to the derivatives of the stress.
!>
!> With a reach of 0 a position has the tissues of its voxel, in a box or an annulus the single
!> tissue there. They jump from one position to the next, which integrals of a Galerkin form allow.
!>
!> Fibers: a muscle's fraction extends into fat, where no fiber was measured. With the fiber of the
!> muscle's nearest point the whole fraction is active, and the volume of the muscle contracts. With
!> each point's own fiber a layer at the interface, in proportion to its width, is passive
!> (docs/galerkin.md), and the fraction of fibers jumps there: only for Galerkin forms.
!>
!> A linear problem has the coefficients of its operator instead of tissues: its stress is linear in
!> the gradient, which takes the place of F.
!>
!> Reference: thesis section 4.2.2
module rk_mixture
   use rk_coefficients, only : moduli, new_coefficients
   use rk_error, only : error_type, fatal_error, err_input
   use rk_expression, only : expression_type
   use rk_fiber_gradient, only : fiber_gradients
   use rk_fractions, only : fibered_points, fractions, has_fibers, own_parts, parts_at, shares
   use rk_kernel, only : kernel_quintic, window_product
   use rk_lattice, only : digits_of, lattice_coordinates, lattice_frame, place_at
   use rk_material, only : kind_i4, material_point
   use rk_precision, only : wp
   use rk_scene, only : scene_type
   use rk_shape, only : approximation_type, new_shape, shape_type
   use rk_text, only : to_text
   implicit none
   private

   public :: mixture_type, new_mixture

   !> Share of the largest lambda of a body that is negligible [-]
   real(wp), parameter :: least = 1.0e-6_wp
   !> Shear over bulk modulus below which a position is as incompressible as its tissue [-]
   real(wp), parameter :: trace = 1.0e-5_wp
   !> Difference between the mean of an activation at the corners of a spacing and its value at the
   !> centre, above which it is not linear there [-]
   real(wp), parameter :: bent_level = 1.0e-3_wp
   !> The same at a jump, relative to the largest activation: at the point nearest to a jump the
   !> mean differs by a quarter of it or more [-]
   real(wp), parameter :: least_jump = 0.2_wp
   !> Rounding by which an expression with terms of size one may lie outside 0 to 1 [-]
   real(wp), parameter :: rounded = 1.0e3_wp*epsilon(1.0_wp)

   !> Tissues at given positions in compressed rows
   type :: mixture_type
      private
      !> Scene
      type(scene_type), pointer :: scene => null()
      !> The tissues of position i are entries first(i)+1 .. first(i+1), shape (np + 1)
      integer, allocatable :: first(:)
      !> Tissue of each entry
      integer, allocatable :: tissue(:)
      !> Fraction of the tissue; the sum at a position is 1 [-]
      real(wp), allocatable :: fraction(:)
      !> Its gradient, shape (3, entries) [1/length]
      real(wp), allocatable :: slope(:, :)
      !> Fiber of the tissue, shape (3, entries) [-]
      real(wp), allocatable :: fiber(:, :)
      !> Its derivatives N_k,A, shape (3, nd, entries) [1/length]; not allocated if no form or no
      !> tissue needs them
      real(wp), allocatable :: fiber_gradient(:, :, :)
      !> Activation of each entry relative to that of its muscle, shape (entries); not allocated
      !> where it is 1 everywhere [-]
      real(wp), allocatable :: level(:)
      !> Lambda and mu of a linear problem at each position, shape (2, np) [stress]
      real(wp), allocatable, public :: pair(:, :)
      !> Their gradients, for strong forms, shape (2, nd, np) [stress/length]
      real(wp), allocatable :: pair_slope(:, :, :)
      !> Least lambda in use: a negligible value replaces zeros beside other values [stress]
      real(wp) :: least_lambda = -huge(1.0_wp)
   contains
      procedure :: parts, bulk, bulk_at_one_pressure, shear_modulus
      procedure :: part_of, beside, meets, activation_jumps
      procedure :: energy, stress, strong
   end type mixture_type

contains

!> Find the tissues at given positions
subroutine new_mixture(self, scene, position, nearest, error)
   type(mixture_type), intent(out) :: self
   !> Scene, which must outlive the mixture
   type(scene_type), target, intent(in) :: scene
   !> Positions, shape (nd, np) [length]
   real(wp), intent(in) :: position(:, :)
   !> Collocation point nearest to each position, shape (np)
   integer, intent(in) :: nearest(:)
   type(error_type), allocatable, intent(out) :: error
   type(shape_type) :: shape
   real(wp) :: part(size(scene%tissue)), gradient(3, size(scene%tissue))
   real(wp), allocatable :: fiber_gradient(:, :, :), share(:, :)
   integer, allocatable :: fibered(:, :)
   integer :: ip, k, n, np, round
   logical :: placed

   self%scene => scene
   if (allocated(scene%equation%problem)) then
      call new_coefficients(self%pair, self%pair_slope, scene, position, scene%method == 'rkcm', &
         & error)
      if (allocated(error)) return
      if (any(self%pair(1, :) > 0.0_wp)) self%least_lambda = least*maxval(self%pair(1, :))
      return
   end if
   call fiber_gradients(scene, fiber_gradient, error)
   if (allocated(error)) return
   np = size(position, 2)
   allocate (self%first(np + 1), fibered(size(scene%cloud%points, 2), size(scene%tissue)))
   do k = 1, size(scene%tissue)
      if (scene%tissue(k)%material%fibered) fibered(:, k) = fibered_points(scene, k)
   end do
   placed = allocated(scene%approximation%kink) .or. self%meets()
   if (size(scene%tissue) > 1 .and. scene%basis%interface > 0.0_wp .and. .not. placed) then
      call new_shape(shape, approximation_type(0, kernel_quintic, window_product), &
         & scene%cloud%source, scene%basis%interface*scene%cloud%spacing, position, error)
      if (allocated(error)) return
      share = shares(scene)
   end if
   do round = 1, 2
      n = 0
      self%first(1) = 0
      do ip = 1, np
         if (allocated(share)) then
            call fractions(shape, share, ip, part, gradient)
         else if (placed) then
            gradient = 0.0_wp
            call parts_at(scene, position(:, ip), part, error)
            if (allocated(error)) return
         else
            gradient = 0.0_wp
            part = own_parts(scene, nearest(ip))
         end if
         do k = 1, size(part)
            if (.not. part(k) > 0.0_wp) cycle
            n = n + 1
            if (round == 1) cycle
            self%tissue(n) = k
            self%fraction(n) = part(k)
            self%slope(:, n) = gradient(:, k)
            self%fiber(:, n) = 0.0_wp
            if (allocated(fiber_gradient)) self%fiber_gradient(:, :, n) = 0.0_wp
            if (.not. has_fibers(scene, k, nearest(ip))) cycle
            associate (at => fibered(nearest(ip), k))
               self%fiber(:, n) = scene%cloud%fiber(:, at)
               if (allocated(fiber_gradient)) &
                  & self%fiber_gradient(:, :, n) = fiber_gradient(:, :, at)
               if (allocated(self%level)) call find_level(scene, k, at, position(:, ip), &
                  & self%level(n), error)
               if (allocated(error)) return
            end associate
         end do
         self%first(ip + 1) = n
      end do
      if (round == 1) allocate (self%tissue(n), self%fraction(n), self%slope(3, n), &
         & self%fiber(3, n))
      if (round == 1 .and. has_levels(scene)) allocate (self%level(n), source=1.0_wp)
      if (round == 1 .and. allocated(fiber_gradient)) &
         & allocate (self%fiber_gradient(3, size(fiber_gradient, 2), n))
   end do
end subroutine new_mixture

!> Whether the tissues of a box or an annulus meet abruptly on surfaces other than planes
pure logical function meets(self)
   class(mixture_type), intent(in) :: self
   integer :: k

   meets = .not. (self%scene%basis%interface > 0.0_wp &
      & .or. allocated(self%scene%approximation%kink)) &
      & .and. any([(self%scene%tissue(k)%part%given(), k=1, size(self%scene%tissue))])
end function meets

!> Whether the activation of a tissue jumps on a lattice, off its mean over a spacing
logical function activation_jumps(self)
   class(mixture_type), intent(in) :: self
   type(error_type), allocatable :: error
   real(wp) :: level
   integer :: e, ip

   activation_jumps = .false.
   if (.not. (allocated(self%level) .and. allocated(self%scene%cloud%lattice))) return
   do ip = 1, size(self%scene%cloud%points, 2)
      do e = self%first(ip) + 1, self%first(ip + 1)
         associate (given => self%scene%tissue(self%tissue(e))%level)
            if (.not. given%given()) cycle
            call given%at(self%scene%cloud%points(:, ip), level, error)
            if (allocated(error)) return
            activation_jumps = abs(level - self%level(e)) > least_jump*maxval(self%level)
         end associate
         if (activation_jumps) return
      end do
   end do
end function activation_jumps

!> Tissues of a position with their fractions and fibers
pure subroutine parts(self, ip, tissue, fraction, fiber)
   class(mixture_type), intent(in) :: self
   !> Index of the position
   integer, intent(in) :: ip
   !> Tissues, shape (k)
   integer, allocatable, intent(out) :: tissue(:)
   !> Their fractions, shape (k) [-]
   real(wp), allocatable, intent(out) :: fraction(:)
   !> Their fibers, zeros if there is none, shape (3, k) [-]
   real(wp), allocatable, intent(out) :: fiber(:, :)

   associate (first => self%first(ip) + 1, last => self%first(ip + 1))
      tissue = self%tissue(first:last)
      fraction = self%fraction(first:last)
      fiber = self%fiber(:, first:last)
   end associate
end subroutine parts

!> State at which the material of an entry is evaluated; tissues without fibers have no activation
pure function point_of(self, e, f, load, volumetric) result(at)
   class(mixture_type), intent(in) :: self
   !> Entry
   integer, intent(in) :: e
   !> Deformation gradient F(i,A) [-]
   real(wp), intent(in) :: f(3, 3)
   !> Load [-]
   real(wp), intent(in) :: load
   !> Whether to include K/2 (J-1)^2
   logical, intent(in) :: volumetric
   type(material_point) :: at

   at%f = f
   at%fiber = self%fiber(:, e)
   at%volumetric = volumetric
   if (self%scene%tissue(self%tissue(e))%material%active(kind_i4)) &
      & at%activation = self%scene%activation_at(self%tissue(e), load)
   if (allocated(self%level)) at%activation = self%level(e)*at%activation
end function point_of

!> Bulk modulus at a position [stress]
pure real(wp) function bulk(self, ip)
   class(mixture_type), intent(in) :: self
   integer, intent(in) :: ip
   integer :: e

   bulk = 0.0_wp
   do e = self%first(ip) + 1, self%first(ip + 1)
      bulk = bulk + self%fraction(e)*self%scene%tissue(self%tissue(e))%material%bulk
   end do
end function bulk

!> Bulk modulus at a position where tissues share one pressure: their compliances add up, so that a
!> share of stiff tissue reduces the compliance only by its own share [stress]
pure real(wp) function bulk_at_one_pressure(self, ip) result(bulk)
   class(mixture_type), intent(in) :: self
   integer, intent(in) :: ip
   real(wp) :: compliance, shear
   integer :: e

   if (allocated(self%pair)) then
      bulk = max(self%pair(1, ip), self%least_lambda)
      return
   end if
   compliance = 0.0_wp
   bulk = 0.0_wp
   shear = 0.0_wp
   do e = self%first(ip) + 1, self%first(ip + 1)
      associate (material => self%scene%tissue(self%tissue(e))%material)
         compliance = compliance + self%fraction(e)/material%bulk
         bulk = max(bulk, material%bulk)
         shear = max(shear, material%shear)
      end associate
   end do
   ! a trace of another tissue does not make an incompressible one compressible
   if (bulk > huge(1.0_wp) .and. .not. compliance*shear > trace) return
   bulk = 1.0_wp/compliance
end function bulk_at_one_pressure

!> Shear modulus of a deformed state at a position, without fibers [stress]
pure real(wp) function shear_modulus(self, ip, f)
   class(mixture_type), intent(in) :: self
   integer, intent(in) :: ip
   real(wp), intent(in) :: f(3, 3)
   integer :: e

   if (allocated(self%pair)) then
      shear_modulus = maxval(moduli(self%scene%equation, [0.0_wp, self%pair(2, ip)]))
      return
   end if
   shear_modulus = 0.0_wp
   do e = self%first(ip) + 1, self%first(ip + 1)
      shear_modulus = shear_modulus &
         & + self%fraction(e)*self%scene%tissue(self%tissue(e))%material%shear_modulus(f)
   end do
end function shear_modulus

!> Fraction of a tissue at a position [-]
pure real(wp) function part_of(self, ip, tissue)
   class(mixture_type), intent(in) :: self
   integer, intent(in) :: ip
   integer, intent(in) :: tissue

   associate (first => self%first(ip) + 1, last => self%first(ip + 1))
      part_of = sum(self%fraction(first:last), mask=self%tissue(first:last) == tissue)
   end associate
end function part_of

!> Energy of a tissue at a position, times its fraction [stress]
pure real(wp) function energy(self, ip, f, load, tissue, volumetric)
   class(mixture_type), intent(in) :: self
   integer, intent(in) :: ip
   real(wp), intent(in) :: f(3, 3)
   real(wp), intent(in) :: load
   !> Tissue, 0 for all
   integer, intent(in) :: tissue
   logical, intent(in) :: volumetric
   integer :: e

   energy = 0.0_wp
   do e = self%first(ip) + 1, self%first(ip + 1)
      if (tissue > 0 .and. self%tissue(e) /= tissue) cycle
      associate (material => self%scene%tissue(self%tissue(e))%material)
         energy = energy + self%fraction(e)*material%energy(point_of(self, e, f, load, volumetric))
      end associate
   end do
end function energy

!> First Piola-Kirchhoff stress at a position and, if requested, its tangent
pure subroutine stress(self, ip, f, load, p, c4, volumetric, tissue)
   class(mixture_type), intent(in) :: self
   integer, intent(in) :: ip
   real(wp), intent(in) :: f(3, 3)
   real(wp), intent(in) :: load
   !> Stress P(i,A) [stress]
   real(wp), intent(out) :: p(3, 3)
   !> Tangent C4(i,A,j,B) [stress]
   real(wp), intent(out), optional :: c4(3, 3, 3, 3)
   logical, intent(in) :: volumetric
   !> Include only the part of this tissue
   integer, intent(in), optional :: tissue
   real(wp) :: part(3, 3), part4(3, 3, 3, 3)
   integer :: b, e, k

   p = 0.0_wp
   if (allocated(self%pair)) then
      ! the part of lambda is a pressure
      part4 = moduli(self%scene%equation, [0.0_wp, self%pair(2, ip)])
      do b = 1, 3
         do k = 1, 3
            p = p + part4(:, :, k, b)*f(k, b)
         end do
      end do
      if (present(c4)) c4 = part4
      return
   end if
   e = self%first(ip) + 1
   if (e == self%first(ip + 1) .and. .not. present(tissue)) then
      ! nearly all positions have one tissue
      call self%scene%tissue(self%tissue(e))%material%stress(point_of(self, e, f, load, &
         & volumetric), p, c4)
      p = self%fraction(e)*p
      if (present(c4)) c4 = self%fraction(e)*c4
      return
   end if
   if (present(c4)) c4 = 0.0_wp
   do e = self%first(ip) + 1, self%first(ip + 1)
      if (present(tissue)) then
         if (self%tissue(e) /= tissue) cycle
      end if
      associate (material => self%scene%tissue(self%tissue(e))%material, &
         & at => point_of(self, e, f, load, volumetric))
         if (present(c4)) then
            call material%stress(at, part, part4)
            c4 = c4 + self%fraction(e)*part4
         else
            call material%stress(at, part)
         end if
      end associate
      p = p + self%fraction(e)*part
   end do
end subroutine stress

!> Divergence of the stress, and all terms of a row of the strong form
pure subroutine strong(self, ip, nd, f, h, load, volumetric, divergence, p, c4, t)
   class(mixture_type), intent(in) :: self
   integer, intent(in) :: ip
   !> Space dimension: 3, or 2 for plane strain
   integer, intent(in) :: nd
   real(wp), intent(in) :: f(3, 3)
   !> Second derivatives of the displacement H(j,B,A) = u_j,BA [1/length]
   real(wp), intent(in) :: h(3, 3, 3)
   real(wp), intent(in) :: load
   !> Whether to include K/2 (J-1)^2
   logical, intent(in) :: volumetric
   !> P_iA,A [stress/length]
   real(wp), intent(out) :: divergence(3)
   real(wp), intent(out) :: p(3, 3)
   !> Tangent C4(i,A,j,B), which is the divergence's derivative by H(j,B,A) [stress]
   real(wp), intent(out) :: c4(3, 3, 3, 3)
   !> Derivative T(i,k,C) of the divergence by F(k,C), if requested [stress/length]
   real(wp), intent(out), optional :: t(3, 3, 3)
   real(wp) :: part(3, 3), part4(3, 3, 3, 3), slope(3, 3, 3), pull(3)
   real(wp) :: turn(3, nd)
   integer :: a, b, e

   divergence = 0.0_wp
   if (allocated(self%pair)) then
      ! (c u_k,B),A = c u_k,AB + c,A u_k,B
      slope = 0.0_wp
      do a = 1, merge(nd, 0, self%scene%equation%varies())
         c4 = moduli(self%scene%equation, self%pair_slope(:, a, ip))
         slope = slope + c4(:, a, :, :)
      end do
      if (present(t)) t = slope
      c4 = moduli(self%scene%equation, self%pair(:, ip))
      p = 0.0_wp
      do b = 1, nd
         do a = 1, nd
            p = p + c4(:, :, a, b)*f(a, b)
            divergence = divergence + slope(:, a, b)*f(a, b)
         end do
      end do
   else
      p = 0.0_wp
      c4 = 0.0_wp
      if (present(t)) t = 0.0_wp
      turn = 0.0_wp
      do e = self%first(ip) + 1, self%first(ip + 1)
         if (allocated(self%fiber_gradient)) turn = self%fiber_gradient(:, :, e)
         associate (material => self%scene%tissue(self%tissue(e))%material)
            if (present(t)) then
               call material%strong(nd, point_of(self, e, f, load, volumetric), h, turn, part, &
                  & part4, pull, slope)
               t = t + self%fraction(e)*slope
            else
               call material%strong(nd, point_of(self, e, f, load, volumetric), h, turn, part, &
                  & part4, pull)
            end if
         end associate
         p = p + self%fraction(e)*part
         c4 = c4 + self%fraction(e)*part4
         divergence = divergence + self%fraction(e)*pull
         do a = 1, nd
            divergence = divergence + part(:, a)*self%slope(a, e)
            if (present(t)) t = t + part4(:, a, :, :)*self%slope(a, e)
         end do
      end do
   end if
   do a = 1, nd
      do b = 1, nd
         divergence(:nd) = divergence(:nd) + matmul(c4(:nd, a, :nd, b), h(:nd, b, a))
      end do
   end do
end subroutine strong

!> Mixture at a position that self does not contain (nonlinear problems): tissues and fibers of a
!> nearby position, but an activation by expression at the position itself, by the rule for
!> integration points. Where it is linear, or nearly so, its value is taken; where it jumps, its
!> mean over a spacing, as in the displacements and the balance of stress
subroutine beside(self, ip, place, one)
   class(mixture_type), intent(in) :: self
   !> Index of the nearby position
   integer, intent(in) :: ip
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: place(:)
   type(mixture_type), intent(out) :: one
   type(error_type), allocatable :: error
   real(wp) :: level
   integer :: e

   one%scene => self%scene
   associate (first => self%first(ip) + 1, last => self%first(ip + 1))
      one%first = [0, last - first + 1]
      one%tissue = self%tissue(first:last)
      one%fraction = self%fraction(first:last)
      one%fiber = self%fiber(:, first:last)
      if (allocated(self%level)) one%level = self%level(first:last)
   end associate
   if (.not. allocated(one%level)) return
   ! a collocation point needs no evaluation
   if (ip <= size(self%scene%cloud%points, 2)) then
      if (.not. any(abs(place - self%scene%cloud%points(:, ip)) > 0.0_wp)) return
   end if
   do e = 1, size(one%tissue)
      if (.not. (self%scene%tissue(one%tissue(e))%level%given() &
         & .and. norm2(one%fiber(:, e)) > 0.0_wp)) cycle
      call find_level(self%scene, one%tissue(e), 0, place, level, error)
      ! an expression without a value here has that of the nearby position
      if (.not. allocated(error)) one%level(e) = level
      if (allocated(error)) deallocate (error)
   end do
end subroutine beside

pure logical function has_levels(scene)
   type(scene_type), intent(in) :: scene
   integer :: k

   has_levels = allocated(scene%cloud%activation) &
      & .or. any([(scene%tissue(k)%level%given(), k=1, size(scene%tissue))])
end function has_levels

!> Activation of a muscle at a position, relative to that of the muscle
subroutine find_level(scene, tissue, point, place, level, error)
   type(scene_type), intent(in) :: scene
   !> Muscle
   integer, intent(in) :: tissue
   !> Collocation point whose fibers it has there, not used if its activation is an expression
   integer, intent(in) :: point
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: place(:)
   !> Relative activation, from 0 to 1 [-]
   real(wp), intent(out) :: level
   !> Error handling: an expression without a value there, or with one out of range
   type(error_type), allocatable, intent(inout) :: error

   level = 1.0_wp
   associate (given => scene%tissue(tissue)%level)
      if (given%given()) then
         call given%at(place, level, error)
         if (allocated(error)) return
         if (level >= -rounded .and. level <= 1.0_wp + rounded) then
            level = min(max(level, 0.0_wp), 1.0_wp)
            if (allocated(scene%cloud%lattice)) call spread_level(scene, given, place, level)
            return
         end if
         call fatal_error(error, err_input, given%where//": '"//given%text//"' is " &
            & //to_text(level)//' at '//to_text(place)//', but must be between 0 and 1')
      else if (allocated(scene%cloud%activation)) then
         level = scene%cloud%activation(point)
      end if
   end associate
end subroutine find_level

!> Mean of an activation over a spacing around a position of a lattice: a jump between points then
!> acts on the right volume. Where the activation is linear, it is not changed
subroutine spread_level(scene, given, place, level)
   !> Scene, whose cloud has a lattice
   type(scene_type), intent(in) :: scene
   type(expression_type), intent(in) :: given
   !> Position, shape (nd) [length]
   real(wp), intent(in) :: place(:)
   !> Value there; on return its mean [-]
   real(wp), intent(inout) :: level
   type(error_type), allocatable :: error
   real(wp), dimension(size(place)) :: q, half
   real(wp) :: low(3), step(3), corners, mean
   integer :: k

   call lattice_frame(scene%cloud, low, step)
   q = lattice_coordinates(scene%cloud, place)
   ! as far to either side, so that a slope does not change the mean
   associate (before => q - low(:size(q)), spacing => step(:size(q)))
      half = max(0.0_wp, min(0.5_wp*spacing, before, spacing*(scene%cloud%lattice - 1) - before))
   end associate
   ! beyond a plane there is another material
   if (allocated(scene%approximation%kink)) then
      do k = 1, size(scene%approximation%kink)
         associate (d => scene%approximation%kink_axis(k))
            half(d) = min(half(d), abs(q(d) - scene%approximation%kink(k)))
         end associate
      end do
   end if
   ! the midpoints of two parts in each direction are half as far away
   call mean_of(2, 2.0_wp*half, corners)
   ! if an expression has no value nearby, the value at the position is kept
   if (allocated(error) .or. .not. abs(corners - level) > bent_level) return
   call mean_of(merge(24, 8, size(place) == 2), half, mean)
   if (.not. allocated(error)) level = min(max(mean, 0.0_wp), 1.0_wp)

contains

   !> Mean over equal parts of a box, by their midpoints
   subroutine mean_of(parts, reach, mean)
      !> Number of parts in each direction
      integer, intent(in) :: parts
      !> Half the width of the box, shape (nd)
      real(wp), intent(in) :: reach(:)
      real(wp), intent(out) :: mean
      real(wp) :: at(size(place)), value
      integer :: k, n

      n = parts**size(place)
      mean = 0.0_wp
      do k = 0, n - 1
         associate (digit => digits_of(k, spread(parts, 1, size(place))))
            at = q + reach*((2.0_wp*digit + 1.0_wp)/parts - 1.0_wp)
         end associate
         call given%at(place_at(scene%cloud, at), value, error)
         if (allocated(error)) return
         mean = mean + value/n
      end do
   end subroutine mean_of

end subroutine spread_level

end module rk_mixture
