"""The rivals: mixed finite elements of felupe, quadratic in displacement.

felupe (https://pypi.org/project/felupe) is an optional dependency: `pip install myork[bench]`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from myork.core.material import Material, stress, strong
from myork.errors import InstallationError

__all__ = ["felupe_block", "felupe_sheet", "felupe_tube"]


def felupe_tube(
    elements: tuple[int, int], table: dict[str, Any], geometry: dict[str, Any], steps: int
) -> dict[str, Any]:
    """Inflate a quarter tube until the inner radius is doubled.

    Parameters
    ----------
    elements : tuple of int
        Elements in the radial and the angular direction.
    table : dict
        Table `[[material]]` of the deck.
    geometry : dict
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
    try:
        import felupe as fem
        from felupe.constitution import tensortrax as law
    except ImportError as error:
        raise InstallationError(
            f"the rival curve needs felupe: {error}; pip install 'myork[bench]'"
        ) from error
    inner, outer = float(geometry["inner_radius"]), float(geometry["outer_radius"])
    started = time.perf_counter()
    mesh = fem.Rectangle(
        a=(inner, 0.0), b=(outer, 0.5 * np.pi), n=(elements[0] + 1, elements[1] + 1)
    )
    mesh = mesh.add_midpoints_edges().add_midpoints_faces()
    radius, angle = mesh.points.T.copy()
    mesh.points[:] = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    field = fem.FieldsMixed(fem.RegionBiQuadraticQuad(mesh), n=3, planestrain=True)
    inside = np.isclose(radius, inner)
    masks = {
        "x": (angle >= 0.5 * np.pi - 1e-9, (0, 1)),
        "y": (angle <= 1e-9, (1, 0)),
        "inner_x": (inside, (0, 1)),
        "inner_y": (inside, (1, 0)),
    }
    bounds = {
        name: fem.Boundary(field[0], mask=mask, skip=skip) for name, (mask, skip) in masks.items()
    }
    solid = _rubber(fem, law, table, field)
    normal = mesh.points[inside] / inner
    iterations = 0
    for step in range(1, steps + 1):
        for axis, name in enumerate(("inner_x", "inner_y")):
            bounds[name].value = normal[:, axis] * inner * step / steps
        dof0, dof1 = fem.dof.partition(field, bounds)
        result = fem.newtonraphson(
            items=[solid],
            dof0=dof0,
            dof1=dof1,
            ext0=fem.dof.apply(field, bounds, dof0),
            verbose=0,
            tol=1e-9,
        )
        iterations += int(result.iterations)
    force = solid.assemble.vector(field).toarray().ravel()[: mesh.points.size].reshape(-1, 2)
    return {
        "value": float(-(force[inside] * normal).sum() / (0.5 * np.pi * 2.0 * inner)),
        "dofs": int(sum(part.values.size for part in field.fields)),
        "iterations": iterations,
        "seconds": time.perf_counter() - started,
    }


def felupe_sheet(
    elements: tuple[int, int], table: dict[str, Any], geometry: dict[str, Any], steps: int
) -> dict[str, Any]:
    """Shear a sheet in plane strain by its height between two held edges.

    Parameters
    ----------
    elements : tuple of int
        Elements along and across, even numbers.
    table : dict
        Table `[[material]]` of the deck.
    geometry : dict
        Table `[geometry]` of the deck.
    steps : int
        Load steps.

    Returns
    -------
    dict
        `shear_stress` in the middle [stress], `top_force` [force/length], `dofs`, `seconds`.

    Raises
    ------
    InstallationError
        felupe is missing.
    """
    try:
        import felupe as fem
        from felupe.constitution import tensortrax as law
    except ImportError as error:
        raise InstallationError(
            f"the rival needs felupe: {error}; pip install 'myork[bench]'"
        ) from error
    started = time.perf_counter()
    size = np.asarray(geometry["size"], float)
    mesh = fem.Rectangle(b=tuple(size), n=(elements[0] + 1, elements[1] + 1))
    mesh = mesh.add_midpoints_edges().add_midpoints_faces()
    points = mesh.points
    field = fem.FieldsMixed(fem.RegionBiQuadraticQuad(mesh), n=3, planestrain=True)
    top = np.isclose(points[:, 1], size[1])
    bounds = {
        "bottom": fem.Boundary(field[0], mask=np.isclose(points[:, 1], 0.0)),
        "top_x": fem.Boundary(field[0], mask=top, skip=(0, 1)),
        "top_y": fem.Boundary(field[0], mask=top, skip=(1, 0)),
    }
    solid = _rubber(fem, law, table, field)
    for step in range(1, steps + 1):
        bounds["top_x"].value = size[1] * step / steps
        dof0, dof1 = fem.dof.partition(field, bounds)
        prescribed = fem.dof.apply(field, bounds, dof0)
        fem.newtonraphson(items=[solid], dof0=dof0, dof1=dof1, ext0=prescribed, verbose=0, tol=1e-9)
    force = solid.assemble.vector(field).toarray().ravel()[: points.size].reshape(-1, 2)
    gradient = np.eye(3)
    middle = _node(points, 0.5 * size)
    gradient[:2, :2] = _gradient(fem.BiQuadraticQuad(), mesh, field[0].values, middle)
    known = Material.__dataclass_fields__
    material = Material(**{key: table[key] for key in table if key in known})
    cauchy = stress(material, gradient[np.newaxis])[0] @ gradient.T / np.linalg.det(gradient)
    return {
        "shear_stress": float(cauchy[0, 1]),
        "top_force": float(force[top, 0].sum()),
        "dofs": int(sum(part.values.size for part in field.fields)),
        "seconds": time.perf_counter() - started,
    }


def felupe_block(
    elements: tuple[int, int, int],
    table: dict[str, Any],
    geometry: dict[str, Any],
    activations: Sequence[float],
) -> dict[str, Any]:
    """Contract a block held at both ends of z, with fibers in the x-z plane.

    Triquadratic displacement with trilinear continuous pressure and volume ratio (the Taylor-Hood
    pair), on the half of the block below its symmetry plane across y. The material is MyoRK's
    own, so that no difference of laws or force curves enters.

    Parameters
    ----------
    elements : tuple of int
        Elements of the half block in each direction, an even number in x and z.
    table : dict
        Table `[[material]]` of the deck.
    geometry : dict
        Table `[geometry]` of the deck.
    activations : sequence of float
        Activations, rising [-].

    Returns
    -------
    dict
        `activation`, by names of the deck's probes their values at these activations,
        `dofs` and `seconds`.

    Raises
    ------
    InstallationError
        felupe is missing.
    """
    try:
        import felupe as fem
    except ImportError as error:
        raise InstallationError(
            f"the rival needs felupe: {error}; pip install 'myork[bench]'"
        ) from error
    started = time.perf_counter()
    size = np.asarray(geometry["size"], float)
    middle = 0.5 * size
    angle = np.radians(float(table["fiber_angle"]))
    law = _Law(table, (np.sin(angle), 0.0, np.cos(angle)))
    half = size * [1.0, 0.5, 1.0]
    mesh = fem.Cube(b=tuple(half), n=tuple(count + 1 for count in elements))
    corners = mesh.npoints
    mesh = mesh.add_midpoints_edges().add_midpoints_faces().add_midpoints_volumes()
    points = mesh.points
    field = fem.FieldsMixed(
        fem.RegionTriQuadraticHexahedron(mesh), n=3, disconnect=False, npoints=corners
    )
    held = np.isclose(points[:, 2], 0.0)
    bounds = {
        "z0": fem.Boundary(field[0], mask=held),
        "z1": fem.Boundary(field[0], mask=np.isclose(points[:, 2], half[2])),
        "plane": fem.Boundary(field[0], mask=np.isclose(points[:, 1], half[1]), skip=(1, 0, 1)),
    }
    dof0, dof1 = fem.dof.partition(field, bounds)
    prescribed = fem.dof.apply(field, bounds, dof0)
    solid = fem.SolidBody(fem.NearlyIncompressible(law, bulk=float(table["K"])), field)
    side = _node(points, (size[0], middle[1], middle[2]))
    centre = _node(points[:corners], middle)
    values: dict[str, list[float]] = {name: [] for name in _PROBES}
    for activation in activations:
        law.activation = activation
        fem.newtonraphson(items=[solid], dof0=dof0, dof1=dof1, ext0=prescribed, verbose=0, tol=1e-7)
        force = solid.assemble.vector(field).toarray().ravel()[: points.size].reshape(-1, 3)
        u = field[0].values
        gradient = _gradient(fem.TriQuadraticHexahedron(), mesh, u, centre)
        stress = law.stress(gradient[:, :, None])[:, :, 0] @ gradient.T / np.linalg.det(gradient)
        pressure = float(field[1].values[centre, 0])
        reaction = 2.0 * force[held].sum(axis=0)
        now = (u[side, 0], u[side, 2], stress[2, 2] + pressure, stress[0, 2])
        for name, value in zip(_PROBES, (*now, reaction[0], reaction[2]), strict=True):
            values[name].append(float(value))
    return {
        "activation": [float(activation) for activation in activations],
        **values,
        "dofs": int(sum(part.values.size for part in field.fields)),
        "seconds": time.perf_counter() - started,
    }


_PROBES = ("side_u_x", "side_u_z", "stress_zz", "stress_xz", "reaction_x", "reaction_z")


def _rubber(fem: Any, law: Any, table: dict[str, Any], field: Any) -> Any:
    """Body of the polynomial material of a deck."""
    model = law.Hyperelastic(
        law.models.hyperelastic.yeoh, C10=table["A10"], C20=table["A20"], C30=table["A30"]
    )
    return fem.SolidBody(fem.NearlyIncompressible(model, bulk=float(table["K"])), field)


class _Law:
    """Isochoric part of a deck's material in the form that felupe calls."""

    def __init__(self, table: dict[str, Any], fiber: tuple[float, float, float]) -> None:
        known = Material.__dataclass_fields__
        self.material = Material(**{key: table[key] for key in table if key in known})
        self.fiber = fiber
        self.activation = 0.0
        # felupe reads the shapes of the arguments and of the state variables from here
        self.x = [np.zeros((3, 3)), np.zeros(0)]

    def stress(self, gradient: NDArray[np.float64]) -> NDArray[np.float64]:
        """First Piola-Kirchhoff stress of F[i, A, ...]."""
        return self._evaluate(gradient)[0]

    def gradient(self, x: list[Any]) -> list[Any]:
        """Stress and state variables of [F, state variables]."""
        return [self.stress(x[0]), x[-1]]

    def hessian(self, x: list[Any]) -> list[Any]:
        """Tangent of [F, state variables]."""
        return [self._evaluate(x[0])[1]]

    def _evaluate(
        self, gradient: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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


def _node(points: NDArray[np.float64], place: Any) -> int:
    """Node at a place."""
    return int(np.argmin(np.linalg.norm(points - np.asarray(place), axis=1)))


def _gradient(element: Any, mesh: Any, u: NDArray[np.float64], node: int) -> NDArray[np.float64]:
    """Deformation gradient at a node: the mean over the elements that meet there.

    Each counts with the nearest Gauss point of second order, where the slopes of quadratic
    elements are best.
    """
    found = []
    for cell in mesh.cells[(mesh.cells == node).any(axis=1)]:
        slope = element.gradient(element.points[int(np.argmax(cell == node))] / np.sqrt(3.0))
        slope = slope @ np.linalg.inv(mesh.points[cell].T @ slope)
        found.append(np.eye(mesh.dim) + u[cell].T @ slope)
    return np.mean(found, axis=0)
