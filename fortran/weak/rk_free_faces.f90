!> Stress on the free faces of boxes.
!>
!> Where the pressure is linear in groups of cells, displacements of order 1 change the volume
!> within a group, and with it the derivatives along a face: the errors alternate with the period of
!> the groups. The means over a group, differences of displacements two spacings apart, do not. The
!> derivative across the face is one-sided, and the pressure there is extrapolated from the middle
!> of the groups; together they leave tractions as large as a tenth of the stress along the face.
!> The derivative a = F N is therefore chosen such that the material law gives zero traction,
!> P(F + (a - F N) N^T) N = 0: as many equations as unknowns, whose matrix is the acoustic tensor of
!> the normal. Stresses on edges are left unchanged.
module rk_free_faces
   use rk_csr, only : csr_type, group_by
   use rk_error, only : error_type
   use rk_lattice, only : lattice_frame
   use rk_mixture, only : mixture_type
   use rk_precision, only : i8, wp
   use rk_scene, only : scene_type
   use rk_shape, only : shape_type
   use rk_states, only : point_state
   use rk_tensor, only : cofactor, determinant, identity
   implicit none
   private

   public :: free_faces_type, new_free_faces

   !> Places on free faces: collocation points, then probes
   type :: free_faces_type
      !> Place of each collocation point and probe in the list, 0 without one
      integer, allocatable :: number(:)
      !> Probes in the list
      integer, allocatable :: probe(:)
      !> Outward unit normals, shape (3, places)
      real(wp), allocatable :: normal(:, :)
      !> Pair of window ends in each direction, 0 without one, shape (nd, places)
      integer, allocatable :: pair(:, :)
      !> Ends of the windows, shape (nd, 2*pairs) [length]
      real(wp), allocatable :: window(:, :)
      type(shape_type) :: shape
   contains
      procedure :: find, smooth, release
   end type free_faces_type

   !> Distance in spacings within which a place lies on the face of a point; cosine of the angle
   !> between normals that count as equal [-]
   real(wp), parameter :: on_face = 1.0e-6_wp, same = 1.0_wp - 1.0e-6_wp
   !> Largest number of iterations, and change of F N at which they stop [-]
   integer, parameter :: most = 20
   real(wp), parameter :: exact = 1.0e-9_wp

contains

!> Find the places and their windows
subroutine new_free_faces(self, scene, error)
   type(free_faces_type), intent(out) :: self
   type(scene_type), intent(in) :: scene
   !> Error handling: a window that too few source points cover
   type(error_type), allocatable, intent(out) :: error
   type(csr_type) :: entry
   real(wp), allocatable :: place(:, :), window(:, :)
   real(wp) :: line(0:maxval(scene%cloud%lattice) - 1, scene%cloud%nd)
   real(wp) :: normal(scene%cloud%nd), ends(2), near, low(3), step(3)
   integer, allocatable :: nearest(:), pair(:, :)
   integer :: d, i, k, n, nc, pairs
   logical :: free

   associate (cloud => scene%cloud, nd => scene%cloud%nd)
      nc = size(cloud%points, 2)
      near = on_face*cloud%mean_spacing()
      call lattice_frame(cloud, low, step)
      do d = 1, nd
         n = cloud%lattice(d) - 1
         line(:n, d) = low(d) + step(d)*[(k, k=0, n)]
         if (allocated(cloud%line)) line(:n, d) = cloud%line(:n, d)
      end do
      call group_by(nc, cloud%boundary_point, entry)
      allocate (self%number(nc + size(scene%probe)), nearest(nc + size(scene%probe)), source=0)
      allocate (place(nd, size(nearest)))
      place(:, :nc) = cloud%points
      nearest(:nc) = [(i, i=1, nc)]
      do i = 1, size(scene%probe)
         if (.not. scene%probe(i)%at_a_place()) cycle
         place(:, nc + i) = scene%probe(i)%point(:nd)
         nearest(nc + i) = minloc(sum((cloud%points - spread(place(:, nc + i), 2, nc))**2, &
            & dim=1), dim=1)
      end do
      n = count(entry%offset(2:) > entry%offset(:nc)) + size(scene%probe)
      allocate (self%normal(3, n), window(nd, 2*nd*n))
      allocate (self%pair(nd, n), source=0)
      n = 0
      pairs = 0
      do i = 1, size(nearest)
         if (nearest(i) == 0) cycle
         call find_face(scene, entry, nearest(i), place(:, i), near, normal, free)
         if (.not. free) cycle
         n = n + 1
         self%number(i) = n
         self%normal(:, n) = 0.0_wp
         self%normal(:nd, n) = normal
         do d = 1, nd
            if (abs(normal(d)) > 0.0_wp) cycle
            associate (own => line(:cloud%lattice(d) - 1, d))
               ends = [(moved(own, place(d, i), k), k=-1, 1, 2)]
               if (ends(1) < own(1) .or. ends(2) > own(size(own))) cycle
            end associate
            ! derivatives jump in between
            if (allocated(scene%approximation%kink)) then
               if (any(scene%approximation%kink_axis == d .and. scene%approximation%kink > ends(1) &
                  & .and. scene%approximation%kink < ends(2))) cycle
            end if
            pairs = pairs + 1
            self%pair(d, n) = pairs
            window(:, 2*pairs - 1:2*pairs) = spread(place(:, i), 2, 2)
            window(d, 2*pairs - 1:2*pairs) = ends
         end do
      end do
      self%probe = pack([(i, i=1, size(scene%probe))], self%number(nc + 1:) > 0)
      self%normal = self%normal(:, :n)
      pair = self%pair(:, :n)
      call move_alloc(pair, self%pair)
      self%window = window(:, :2*pairs)
      call scene%shape_at(self%window, self%shape, error, plain=.true.)
   end associate
end subroutine new_free_faces

!> Outward normal at a place that lies on a single face without any condition
subroutine find_face(scene, entry, ip, x, near, normal, free)
   type(scene_type), intent(in) :: scene
   !> Boundary entries of each collocation point
   type(csr_type), intent(in) :: entry
   !> Collocation point nearest to the place
   integer, intent(in) :: ip
   !> Place, shape (nd) [length]
   real(wp), intent(in) :: x(:)
   !> Distance within which it lies on a face [length]
   real(wp), intent(in) :: near
   !> Normal, shape (nd)
   real(wp), intent(out) :: normal(:)
   !> Whether it lies on such a face
   logical, intent(out) :: free
   real(wp) :: away
   integer :: e
   integer(i8) :: k

   free = .false.
   normal = 0.0_wp
   associate (cloud => scene%cloud)
      do k = entry%offset(ip) + 1, entry%offset(ip + 1)
         e = entry%index(k)
         away = dot_product(x - cloud%points(:, ip), cloud%normal(:, e))
         if (abs(away) > near) cycle
         free = .not. any(cloud%in_set(e, scene%condition%set))
         if (norm2(normal) > 0.0_wp) free = free &
            & .and. dot_product(normal, cloud%normal(:, e)) >= same
         if (.not. free) return
         normal = cloud%normal(:, e)
      end do
   end associate
end subroutine find_face

!> Place shifted by some spacings of the source points along a direction
pure real(wp) function moved(line, x, spacings)
   !> Places of the source points along it [length]
   real(wp), intent(in) :: line(0:)
   !> Coordinate of the place [length]
   real(wp), intent(in) :: x
   !> Number of spacings; a place shifted beyond the ends of the body stays beyond them
   integer, intent(in) :: spacings
   real(wp) :: step
   integer :: k, n

   n = size(line) - 1
   step = (line(n) - line(0))/n
   k = max(0, min(n - 1, count(line <= x) - 1))
   moved = x + spacings*step
   if (k + spacings < 0 .or. k + 1 + spacings > n) then
      ! between the last point and a half one beyond it
      if (k + spacings < 0) moved = line(0) - step
      if (k + spacings >= 0) moved = line(n) + step
      if (abs(x - line(k)) <= on_face*step .and. k + spacings == n) moved = line(n)
      return
   end if
   moved = line(k + spacings) + (x - line(k))/(line(k + 1) - line(k)) &
      & *(line(k + 1 + spacings) - line(k + spacings))
end function moved

!> Number of a place in the list, 0 without one
pure integer function find(self, scene, ip, x)
   class(free_faces_type), intent(in) :: self
   type(scene_type), intent(in) :: scene
   integer, intent(in) :: ip
   real(wp), intent(in) :: x(:)
   integer :: i

   associate (points => scene%cloud%points)
      find = self%number(ip)
      if (.not. any(abs(x - points(:, ip)) > 0.0_wp)) return
      find = 0
      do i = 1, size(self%probe)
         if (any(abs(x - scene%probe(self%probe(i))%point(:size(x))) > 0.0_wp)) cycle
         find = self%number(size(points, 2) + self%probe(i))
         return
      end do
   end associate
end function find

!> Replace derivatives along the face in a displacement gradient by differences two spacings apart
pure subroutine smooth(self, i, x, h)
   class(free_faces_type), intent(in) :: self
   !> Number of the place
   integer, intent(in) :: i
   !> Unknowns, shape (n) [length]
   real(wp), contiguous, intent(in) :: x(:)
   !> Displacement gradient [-]
   real(wp), intent(inout) :: h(3, 3)
   real(wp) :: u(size(self%pair, 1), 1), before(size(self%pair, 1))
   integer :: d, k, nd

   nd = size(self%pair, 1)
   do d = 1, nd
      k = self%pair(d, i)
      if (k == 0) cycle
      call self%shape%interpolate(2*k - 1, x, 1, 1, u)
      before = u(:, 1)
      call self%shape%interpolate(2*k, x, 1, 1, u)
      h(:nd, d) = (u(:, 1) - before)/(self%window(d, 2*k) - self%window(d, 2*k - 1))
   end do
end subroutine smooth

!> Stress in balance with a traction, by default zero; unchanged if no such stress is found
subroutine release(self, i, mixture, load, f, local, traction)
   class(free_faces_type), intent(in) :: self
   integer, intent(in) :: i
   !> Mixture of the place
   type(mixture_type), intent(in) :: mixture
   !> Load [-]
   real(wp), intent(in) :: load
   !> Deformation gradient along the face [-]
   real(wp), intent(in) :: f(3, 3)
   !> State there, of which P and the Cauchy stress are set
   type(point_state), intent(inout) :: local
   !> Force per area at rest [stress]
   real(wp), intent(in), optional :: traction(3)
   real(wp) :: c4(3, 3, 3, 3), g(3, 3), p(3, 3), slope(3, 3), step(3)
   integer :: a, b, k, nd

   ! there is no law for the volume alone
   if (.not. mixture%bulk(1) <= huge(1.0_wp)) return
   nd = size(self%pair, 1)
   g = f
   associate (normal => self%normal(:, i))
      do k = 1, most
         if (.not. determinant(g) > 0.0_wp) return
         call mixture%stress(1, g, load, p, c4, volumetric=.true.)
         slope = identity
         slope(:nd, :nd) = 0.0_wp
         do b = 1, nd
            do a = 1, nd
               slope(:nd, :nd) = slope(:nd, :nd) + normal(a)*normal(b)*c4(:nd, a, :nd, b)
            end do
         end do
         if (.not. determinant(slope) > 0.0_wp) return
         step = 0.0_wp
         step(:nd) = -matmul(p(:nd, :), normal)
         if (present(traction)) step(:nd) = step(:nd) + traction(:nd)
         step = matmul(transpose(cofactor(slope)), step)/determinant(slope)
         if (k > 1 .and. norm2(step) <= exact) then
            local%p = p
            local%cauchy = matmul(p, transpose(g))/determinant(g)
            return
         end if
         g = g + spread(step, 2, 3)*spread(normal, 1, 3)
      end do
   end associate
end subroutine release

end module rk_free_faces
