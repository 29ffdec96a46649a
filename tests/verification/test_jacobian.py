"""Linearised rows (5.66)-(5.70) against central differences of the residuals (5.71)-(5.73)."""

import numpy as np
import pytest

from myork.bench import materials

MUSCLE = {**materials.MUSCLE, "K": 500.0, "curve": "smooth"}
RUBBER = {**materials.RUBBER, "K": 1e3}
SOLID = {
    "scene": {"dimension": 3, "method": "rkcm"},
    "geometry": {"kind": "box", "size": [1, 1, 2], "source": [3, 3, 4], "collocation": [4, 4, 6]},
    "boundary": [
        {"set": "z0", "u_x": 0, "u_y": 0, "u_z": 0},
        {"set": "z1", "u_z": 0.2, "traction": [1.0, 2.0, 0.0]},
    ],
    "load": {"activation": 0.7},
}
PLANE = {
    "scene": {"dimension": 2, "method": "rkcm"},
    "geometry": {"kind": "box", "size": [1, 2], "source": [4, 6], "collocation": [7, 11]},
    "boundary": [
        {"set": "y0", "u_x": 0, "u_y": 0},
        {"set": "y1", "u_y": 0.2, "traction": [1.0, 0.0]},
    ],
    "load": {"activation": 0.7},
}


@pytest.mark.parametrize(
    ("tables", "material"),
    [
        (SOLID, {**MUSCLE, "fiber": [0.3, -0.5, 0.8]}),
        (SOLID, RUBBER),
        (PLANE, {**MUSCLE, "fiber": [0.5, 0.8, 0.0]}),
        (PLANE, {**MUSCLE, "fiber": [0.3, 0.5, 0.8]}),
        (PLANE, RUBBER),
    ],
    ids=["solid muscle", "solid rubber", "plane muscle", "fibers leave the plane", "plane rubber"],
)
def test_rows_are_the_derivative_of_the_residuals(open_scene, tables, material):
    """Fourth-order differences with steps of 1e-3 of the unknowns' size: truncation 1e-12,
    rounding 1e-16/1e-3 times the cancellation in the strong form.
    """
    scene = open_scene({**tables, "material": [material]})
    random = np.random.default_rng(11)
    # strains of some ten per cent and their gradients, unequal everywhere
    x = 0.02 * random.standard_normal(scene.dofs)
    direction = random.standard_normal(scene.dofs)
    _, product = scene.linearise(x, 0.6, direction)

    def residual(step):
        return scene.linearise(x + step * direction, 0.6, direction, start=x)[0]

    step = 2e-5
    difference = 8 * (residual(step) - residual(-step)) - residual(2 * step) + residual(-2 * step)
    difference /= 12 * step
    assert abs(product).max() > 1.0
    for rows in (slice(0, None), slice(0, scene.collocation_points * scene.dimension)):
        error = np.linalg.norm(difference[rows] - product[rows])
        assert error < 1e-7 * np.linalg.norm(product[rows])
