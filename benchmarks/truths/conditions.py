"""Sides and prescribed displacements of decks, for finite elements of every kind.

It needs NumPy alone: dolfinx runs in another Python.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

AXES = "xyz"


def side_of(name: str, ring: bool) -> tuple[int, int]:
    """Axis of the lattice across a side, and its end: 0 or 1; radius and angle of an annulus."""
    if ring:
        return {"inner": (0, 0), "outer": (0, 1), "y0": (1, 0), "x0": (1, 1)}[name]
    return AXES.index(name[0]), int(name[1])


def moved(entry: Mapping[str, Any], points: Any, load: float = 1.0) -> dict[int, Any]:
    """Displacements that a set prescribes, by axis: a number or one for each node.

    - `entry`: table `[[boundary]]`
    - `points`: nodes of the set, shape `(n, dim)` [length]
    - `load`: share of the full load
    """
    shift = {
        axis: load * float(entry[f"u_{name}"])
        for axis, name in enumerate(AXES)
        if entry.get(f"u_{name}") is not None
    }
    if entry.get("radial") is not None:
        flat = points[:, :2]
        unit = flat / np.linalg.norm(flat, axis=1)[:, None]
        return dict(enumerate((load * float(entry["radial"]) * unit).T))
    if entry.get("rotation") is None:
        return shift
    dim = points.shape[1]
    normal = np.asarray(entry.get("axis") or (0.0, 0.0, 1.0), float)
    normal /= np.linalg.norm(normal)
    arm = np.zeros((len(points), 3))
    arm[:, :dim] = points - np.asarray(entry["about"], float)
    across = np.cross(normal, arm)
    angle = np.radians(float(entry["rotation"])) * load
    turned = np.sin(angle) * across + (1.0 - np.cos(angle)) * np.cross(normal, across)
    return {axis: turned[:, axis] + shift.get(axis, 0.0) for axis in range(dim)}
