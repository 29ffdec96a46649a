"""Sides, prescribed displacements and probes of decks, for finite elements of every kind.

It needs only NumPy: dolfinx runs in another Python.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

AXES = "xyz"


def side_of(name: str, ring: bool) -> tuple[int, int]:
    """Lattice axis normal to a side, and its end: 0 or 1; radius and angle of an annulus."""
    if ring:
        return {"inner": (0, 0), "outer": (0, 1), "y0": (1, 0), "x0": (1, 1)}[name]
    return AXES.index(name[0]), int(name[1])


def fiber_of(table: Mapping[str, Any], plane: bool) -> tuple[float, float, float]:
    """Unit vector of a material's fibers, zeros without fibers."""
    if table.get("fiber_angle") is not None:
        angle = np.radians(float(table["fiber_angle"]))
        across, along = float(np.sin(angle)), float(np.cos(angle))
        return (across, along, 0.0) if plane else (across, 0.0, along)
    if table.get("fiber") is not None:
        unit = np.asarray(table["fiber"], float) / np.linalg.norm(table["fiber"])
        return (float(unit[0]), float(unit[1]), float(unit[2]))
    return (0.0, 0.0, 0.0)


def moved(entry: Mapping[str, Any], points: Any, load: float = 1.0) -> dict[int, Any]:
    """Displacements prescribed by a set, by axis: a number or one for each node.

    - `entry`: table `[[boundary]]`
    - `points`: nodes of the set, shape `(n, dim)` [length]
    - `load`: fraction of the full load
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


class Ended(NamedTuple):
    """Nodes at the end of a load."""

    places: Any  #: Undeformed positions, shape `(n, dim)` [length]
    moves: Any  #: Displacements, shape `(n, dim)` [length]
    #: Nodes of a set, and their forces, shape `(m, dim)` [force]
    pull: Callable[[str], tuple[Any, Any]]
    #: Component of the Cauchy stress at a node; None if undefined
    stress: Callable[[int, str], float] | None
    near: float  #: Tolerance for nodes at the place of a probe [length]

    def probes(self, deck: Mapping[str, Any]) -> dict[str, float]:
        """Values of the deck's probes, except those without a value."""
        found = {probe["name"]: self.probe(probe) for probe in deck["probe"]}
        return {name: value for name, value in found.items() if value is not None}

    def probe(self, probe: Mapping[str, Any]) -> float | None:
        """Value of a table `[[probe]]`; None where no node lies there, or has no such value."""
        kind, _, component = probe["quantity"].partition("_")
        if kind in ("force", "torque"):
            on, force = self.pull(probe["set"])
            if kind == "force":
                return float(force[:, AXES.index(component)].sum())
            dim = self.places.shape[1]
            arm, force3 = np.zeros((2, len(force), 3))
            arm[:, :dim] = (self.places + self.moves)[on] - np.asarray(probe["about"], float)
            force3[:, :dim] = force
            return float(np.cross(arm, force3).sum(axis=0)[AXES.index(component)])
        place = np.zeros(self.places.shape[1])
        place[: len(probe["point"])] = probe["point"]
        away = np.linalg.norm(self.places - place, axis=1)
        node = int(np.argmin(away))
        if away[node] > self.near:
            return None
        if kind == "u":
            return float(self.moves[node, AXES.index(component)])
        return self.stress(node, component) if self.stress and kind == "cauchy" else None
