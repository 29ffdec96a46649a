"""Stresses on the walls of tubes, where these meet planes of symmetry as well as between them.

The state is the same at every angle, so the boundary value problem of the radius
(`myork.reference.exact`) is the truth everywhere. What a run says of its own error is the
tolerance.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from myork import Scene
from myork.reference.exact import Polynomial, tube
from myork.reference.materials import RUBBER

#: Where walls are probed, in angles [rad]
ANGLES = {"x": 0.0, "between": np.pi / 4, "y": np.pi / 2}


def deck(inner: float, outer: float, moved: float, bulk: float, source: list[int]) -> Any:
    """Quarter of a tube whose inner wall is moved; no form, order or support is named."""
    geometry = {"kind": "annulus", "inner_radius": inner, "outer_radius": outer}
    probes = []
    for name, angle in ANGLES.items():
        at = np.array([np.cos(angle), np.sin(angle)])
        for wall, radius, stress in (("inner", inner, "rr"), ("outer", outer, "tt")):
            point = [float(x) for x in np.where(np.abs(at) < 1e-12, 0.0, radius * at)]
            probes.append(
                {"name": f"{wall} {name}", "quantity": f"cauchy_{stress}", "point": point}
            )
    return {
        "scene": {"dimension": 2},
        "geometry": {**geometry, "source": source, "collocation": [2 * n - 1 for n in source]},
        "material": [{**RUBBER, "K": bulk}],
        "boundary": [
            {"set": "x0", "u_x": 0.0},
            {"set": "y0", "u_y": 0.0},
            {"set": "inner", "radial": moved},
        ],
        "probe": probes,
    }


def truths(inner: float, outer: float, moved: float, bulk: float) -> dict[str, float]:
    """Radial stress on the inner and hoop stress on the outer wall."""
    material = Polynomial.from_deck(RUBBER, bulk)
    found = tube(material, inner, outer, moved, [inner, outer])
    hoop = found.radius[1] / outer
    # nothing pulls at the outer wall: its radial stretch is that of a free one
    stretch, pressure = 1.0 / hoop, 0.0
    for _ in range(50):
        stress = material.isochoric(np.array([stretch, hoop, 1.0]))
        pressure = -stress[0] / hoop
        stretch = (1.0 + pressure / bulk) / hoop
    stress = material.isochoric(np.array([stretch, hoop, 1.0]))
    return {
        "inner": float(found.radial[0]),
        "outer": float(stress[1] / stretch + pressure),
    }


@pytest.mark.parametrize(
    ("inner", "outer", "moved", "bulk", "source"),
    [
        (6.0, 8.0, 6.0, 1e3, [9, 51]),
        (6.0, 8.0, 6.0, 1e7, [9, 51]),
        (10.0, 11.0, 5.0, 1e3, [5, 51]),
        (6.0, 8.0, -1.0, 1e3, [9, 51]),
    ],
)
def test_stress_on_the_walls_is_as_right_as_the_run_says(
    inner: float, outer: float, moved: float, bulk: float, source: list[int]
) -> None:
    """With a support of 2.5 the walls were 20 and 6 % off at the planes of symmetry, accepted."""
    exact = truths(inner, outer, moved, bulk)
    with Scene.from_tables(deck(inner, outer, moved, bulk, source), threads=1) as scene:
        states = scene.solve()
        values = scene.probes(states.x, states.load)[-1]
        names = [probe["name"] for probe in scene.deck["probe"]]
    assert states.verdict == "accepted", states.reasons
    for name, value, bar in zip(names, values, states.probe_errors[-1], strict=True):
        truth = exact[name.split()[0]]
        assert abs(value[0] - truth) <= bar[0], f"{name}: {value} instead of {truth}, bar {bar}"
        assert bar[0] < 0.05 * abs(truth), f"{name}: bar of {bar[0] / abs(truth):.1%}"
