"""Tubes with prescribed motion of the inner wall: stresses on both walls at any angle; truth."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.truths import exact
from benchmarks.truths.deck_parts import deck
from myork.bench.materials import RUBBER

#: Angles of wall probes: on the planes of symmetry and between them [rad]
_ANGLES = {"x": 0.0, "between": np.pi / 4, "y": np.pi / 2}


def tube_deck(inner: float, outer: float, moved: float, bulk: float) -> dict[str, Any]:
    """Quarter of a rubber tube; no form, order or number of points is given.

    - `inner`, `outer`: radii [length]
    - `moved`: radial displacement of the inner wall [length]
    - `bulk`: bulk modulus [stress]
    - returns tables with the probes `inner x` to `outer y`, radial and hoop stress
    """
    probes = []
    for name, angle in _ANGLES.items():
        at = np.array([np.cos(angle), np.sin(angle)])
        for wall, radius, stress in (("inner", inner, "rr"), ("outer", outer, "tt")):
            point = [float(x) for x in np.where(np.abs(at) < 1e-12, 0.0, radius * at)]
            probes.append(
                {"name": f"{wall} {name}", "quantity": f"cauchy_{stress}", "point": point}
            )
    return deck(
        "tube",
        {"kind": "annulus", "inner_radius": inner, "outer_radius": outer},
        ({**RUBBER, "K": bulk},),
        (
            {"set": "x0", "u_x": 0.0},
            {"set": "y0", "u_y": 0.0},
            {"set": "inner", "radial": moved},
        ),
        probes,
    )


def wall_stresses(inner: float, outer: float, moved: float, bulk: float) -> dict[str, float]:
    """Radial stress on the `inner` and hoop stress on the `outer` wall; see `tube_deck`."""
    material = exact.Polynomial.from_deck(RUBBER, bulk)
    found = exact.tube(material, inner, outer, moved, [inner, outer])
    return {"inner": float(found.radial[0]), "outer": float(found.hoop[1])}
