"""Mixed finite elements of felupe, quadratic in displacement: another code to compare with.

felupe (https://pypi.org/project/felupe) is an optional dependency: `pip install myork[bench]`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from myork.core.material import Material, stress, strong
from myork.errors import InstallationError

__all__ = ["felupe_block", "felupe_sheet", "felupe_tube"]

F64Array = NDArray[np.float64]

_PROBES = ("side_u_x", "side_u_z", "stress_zz", "stress_xz", "reaction_x", "reaction_z")


def felupe_tube(
    elements: tuple[int, int], table: Mapping[str, Any], geometry: Mapping[str, Any], steps: int
) -> dict[str, Any]:
    """Inflate a quarter tube until the inner radius is doubled.

    Parameters
    ----------
    elements : tuple of int
        Elements in the radial and the angular direction.
    table : mapping
        Table `[[material]]` of the deck.
    geometry : mapping
        Table `[geometry]` of the deck.
    steps : int
        Load steps.

    Returns
    -------
    dict
        `value`, the radial stress on the inner surface from the work-conjugate reaction [stress],
        `dofs`, `iterations`, `seconds`.

    Raises
    ------
    InstallationError
        felupe is missing.
    """
    fem = _felupe()
    inner, outer = float(geometry["inner_radius"]), float(geometry["outer_radius"])
    started = time.perf_counter()
    mesh = _rectangle(fem, (inner, 0.0), (outer, 0.5 * np.pi), elements)
    radius, angle = mesh.points.T.copy()
    mesh.points[:] = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    inside = np.isclose(radius, inner)
    body = _Body(_plane_strain(fem, mesh), _rubber(table), float(table["K"]))
    body.hold("x", angle >= 0.5 * np.pi - 1e-9, (0, 1))
    body.hold("y", angle <= 1e-9, (1, 0))
    body.hold("inner_x", inside, (0, 1))
    body.hold("inner_y", inside, (1, 0))
    normal = mesh.points[inside] / inner
    iterations = 0
    for step in range(1, steps + 1):
        for axis, name in enumerate(("inner_x", "inner_y")):
            body.bounds[name].value = normal[:, axis] * inner * step / steps
        iterations += body.solve(1e-9)
    force = body.forces()[inside]
    return {
        "value": float(-(force * normal).sum() / (0.5 * np.pi * 2.0 * inner)),
        "iterations": iterations,
        **body.cost(started),
    }


def felupe_sheet(
    elements: tuple[int, int], table: Mapping[str, Any], geometry: Mapping[str, Any], steps: int
) -> dict[str, Any]:
    """Shear a sheet in plane strain by its height between two held edges; as `felupe_tube`.

    Parameters
    ----------
    elements : tuple of int
        Elements along and across, even numbers.

    Returns
    -------
    dict
        `shear_stress` in the middle [stress], `top_force` [force/length], `dofs`, `seconds`.
    """
    fem = _felupe()
    started = time.perf_counter()
    size = np.asarray(geometry["size"], float)
    mesh = _rectangle(fem, (0.0, 0.0), tuple(size), elements)
    points = mesh.points
    top = np.isclose(points[:, 1], size[1])
    body = _Body(_plane_strain(fem, mesh), _rubber(table), float(table["K"]))
    body.hold("bottom", np.isclose(points[:, 1], 0.0))
    body.hold("top_x", top, (0, 1))
    body.hold("top_y", top, (1, 0))
    for step in range(1, steps + 1):
        body.bounds["top_x"].value = size[1] * step / steps
        body.solve(1e-9)
    gradient = np.eye(3)
    middle = _node(points, 0.5 * size)
    gradient[:2, :2] = body.gradient(fem.BiQuadraticQuad(), middle)
    nominal = stress(Material.of_table(table), gradient[np.newaxis])[0]
    cauchy = nominal @ gradient.T / np.linalg.det(gradient)
    return {
        "shear_stress": float(cauchy[0, 1]),
        "top_force": float(body.forces()[top, 0].sum()),
        **body.cost(started),
    }


def felupe_block(
    elements: tuple[int, int, int],
    table: Mapping[str, Any],
    geometry: Mapping[str, Any],
    activations: Sequence[float],
) -> dict[str, Any]:
    """Contract a block held at both ends of z, with fibers in the x-z plane; as `felupe_tube`.

    Triquadratic displacement with trilinear continuous pressure and volume ratio (the Taylor-Hood
    pair), on the half of the block below its symmetry plane across y. The material is MyoRK's
    own, so that no difference of laws or force curves enters.

    Parameters
    ----------
    elements : tuple of int
        Elements of the half block in each direction, an even number in x and z.
    activations : sequence of float
        Activations, rising [-].

    Returns
    -------
    dict
        `activation`, by names of the deck's probes their values at these activations,
        `dofs` and `seconds`.
    """
    fem = _felupe()
    started = time.perf_counter()
    size = np.asarray(geometry["size"], float)
    middle, half = 0.5 * size, size * [1.0, 0.5, 1.0]
    angle = np.radians(float(table["fiber_angle"]))
    law = _Law(table, (np.sin(angle), 0.0, np.cos(angle)))
    mesh = fem.Cube(b=tuple(half), n=tuple(count + 1 for count in elements))
    corners = mesh.npoints
    mesh = mesh.add_midpoints_edges().add_midpoints_faces().add_midpoints_volumes()
    points = mesh.points
    region = fem.RegionTriQuadraticHexahedron(mesh)
    field = fem.FieldsMixed(region, n=3, disconnect=False, npoints=corners)
    held = np.isclose(points[:, 2], 0.0)
    body = _Body(field, law, float(table["K"]))
    body.hold("z0", held)
    body.hold("z1", np.isclose(points[:, 2], half[2]))
    body.hold("plane", np.isclose(points[:, 1], half[1]), (1, 0, 1))
    side = _node(points, (size[0], middle[1], middle[2]))
    centre = _node(points[:corners], middle)
    values: dict[str, list[float]] = {name: [] for name in _PROBES}
    for activation in activations:
        law.activation = activation
        body.solve(1e-7)
        u = field[0].values
        gradient = body.gradient(fem.TriQuadraticHexahedron(), centre)
        cauchy = law.stress(gradient[:, :, None])[:, :, 0] @ gradient.T / np.linalg.det(gradient)
        pressure = float(field[1].values[centre, 0])
        reaction = 2.0 * body.forces()[held].sum(axis=0)
        now = (u[side, 0], u[side, 2], cauchy[2, 2] + pressure, cauchy[0, 2])
        for name, value in zip(_PROBES, (*now, reaction[0], reaction[2]), strict=True):
            values[name].append(float(value))
    return {
        "activation": [float(activation) for activation in activations],
        **values,
        **body.cost(started),
    }


def _felupe() -> Any:
    """The package, imported when a solution is wanted."""
    try:
        import felupe
    except ImportError as error:
        raise InstallationError(
            f"the rival needs felupe: {error}; pip install 'myork[bench]'"
        ) from error
    return felupe


def _rectangle(fem: Any, low: Sequence[float], high: Sequence[float], n: Sequence[int]) -> Any:
    """Mesh of biquadratic elements."""
    mesh = fem.Rectangle(a=low, b=high, n=tuple(count + 1 for count in n))
    return mesh.add_midpoints_edges().add_midpoints_faces()


def _plane_strain(fem: Any, mesh: Any) -> Any:
    """Displacement, pressure and volume ratio on such a mesh."""
    return fem.FieldsMixed(fem.RegionBiQuadraticQuad(mesh), n=3, planestrain=True)


def _rubber(table: Mapping[str, Any]) -> Any:
    """Isochoric part of a deck's polynomial material, by felupe's own automatic derivatives."""
    try:
        from felupe.constitution import tensortrax as law
    except ImportError as error:
        raise InstallationError(
            f"the rival needs tensortrax: {error}; pip install 'myork[bench]'"
        ) from error
    return law.Hyperelastic(
        law.models.hyperelastic.yeoh, C10=table["A10"], C20=table["A20"], C30=table["A30"]
    )


class _Body:
    """A nearly incompressible body, what holds it, and its Newton iterations."""

    def __init__(self, field: Any, law: Any, bulk: float) -> None:
        self.fem, self.field = _felupe(), field
        self.mesh = field.region.mesh
        self.solid = self.fem.SolidBody(self.fem.NearlyIncompressible(law, bulk=bulk), field)
        self.bounds: dict[str, Any] = {}

    def hold(self, name: str, mask: NDArray[np.bool_], skip: tuple[int, ...] | None = None) -> None:
        """Prescribe the displacement of nodes, but for the components to skip."""
        self.bounds[name] = self.fem.Boundary(
            self.field[0], mask=mask, **({} if skip is None else {"skip": skip})
        )

    def solve(self, tolerance: float) -> int:
        """Iterate to equilibrium; return how often."""
        dof0, dof1 = self.fem.dof.partition(self.field, self.bounds)
        prescribed = self.fem.dof.apply(self.field, self.bounds, dof0)
        found = self.fem.newtonraphson(
            items=[self.solid], dof0=dof0, dof1=dof1, ext0=prescribed, verbose=0, tol=tolerance
        )
        return int(found.iterations)

    def forces(self) -> F64Array:
        """Forces at the nodes, shape `(nnode, dim)` [force]."""
        points = self.mesh.points
        vector = self.solid.assemble.vector(self.field).toarray().ravel()
        return np.asarray(vector[: points.size].reshape(points.shape))

    def gradient(self, element: Any, node: int) -> F64Array:
        """Deformation gradient at a node: the mean over the elements that meet there.

        Each counts with the nearest Gauss point of second order, where the slopes of quadratic
        elements are best.
        """
        mesh, u = self.mesh, self.field[0].values
        found = []
        for cell in mesh.cells[(mesh.cells == node).any(axis=1)]:
            slope = element.gradient(element.points[int(np.argmax(cell == node))] / np.sqrt(3.0))
            slope = slope @ np.linalg.inv(mesh.points[cell].T @ slope)
            found.append(np.eye(mesh.dim) + u[cell].T @ slope)
        return np.mean(found, axis=0)

    def cost(self, started: float) -> dict[str, Any]:
        """Number of unknowns, and seconds since the clock's value given."""
        dofs = int(sum(part.values.size for part in self.field.fields))
        return {"dofs": dofs, "seconds": time.perf_counter() - started}


class _Law:
    """Isochoric part of a deck's material in the form that felupe calls."""

    def __init__(self, table: Mapping[str, Any], fiber: tuple[float, float, float]) -> None:
        self.material = Material.of_table(table)
        self.fiber = fiber
        self.activation = 0.0
        # felupe reads the shapes of the arguments and of the state variables from here
        self.x = [np.zeros((3, 3)), np.zeros(0)]

    def stress(self, gradient: F64Array) -> F64Array:
        """First Piola-Kirchhoff stress of F[i, A, ...]."""
        return self._evaluate(gradient)[0]

    def gradient(self, x: list[Any]) -> list[Any]:
        """Stress and state variables of [F, state variables]."""
        return [self.stress(x[0]), x[-1]]

    def hessian(self, x: list[Any]) -> list[Any]:
        """Tangent of [F, state variables]."""
        return [self._evaluate(x[0])[1]]

    def _evaluate(self, gradient: F64Array) -> tuple[F64Array, F64Array]:
        places = gradient.shape[2:]
        f = np.moveaxis(gradient.reshape(3, 3, -1), -1, 0)
        found = strong(
            self.material,
            f,
            np.zeros((len(f), 3, 3, 3)),
            fiber=self.fiber,
            activation=self.activation,
            volumetric=False,
        )
        return (
            np.moveaxis(found.stress, 0, -1).reshape(3, 3, *places),
            np.moveaxis(found.tangent, 0, -1).reshape(3, 3, 3, 3, *places),
        )


def _node(points: F64Array, place: Any) -> int:
    """Node at a place."""
    return int(np.argmin(np.linalg.norm(points - np.asarray(place), axis=1)))
