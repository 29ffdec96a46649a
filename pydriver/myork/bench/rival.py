"""The rival on the tube: mixed finite elements of felupe, biquadratic in displacement.

felupe (https://pypi.org/project/felupe) is an optional dependency: `pip install myork[bench]`.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from myork.errors import InstallationError

__all__ = ["felupe_tube"]


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
    rubber = law.Hyperelastic(
        law.models.hyperelastic.yeoh, C10=table["A10"], C20=table["A20"], C30=table["A30"]
    )
    solid = fem.SolidBody(fem.NearlyIncompressible(rubber, bulk=float(table["K"])), field)
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
