"""Short functions for tables of decks, for problems that are written in Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def held(name: str, dimension: int = 3, **values: Any) -> dict[str, Any]:
    """A fixed set, except for the components given.

    - `name`: boundary set
    - `dimension`: space dimension
    - `**values`: displacements by key, such as ``u_x`` [length], and other keys of the set
    """
    return {"set": name, **{f"u_{axis}": 0.0 for axis in "xyz"[:dimension]}, **values}


def probe(name: str, quantity: str, point: Sequence[float]) -> dict[str, Any]:
    """A probe of a quantity at a point [length]."""
    return {"name": name, "quantity": quantity, "point": list(point)}


def force(name: str, axis: str, on: str) -> dict[str, Any]:
    """A probe of a component of the force on a set."""
    return {"name": name, "quantity": f"force_{axis}", "set": on}


def deck(
    title: str,
    geometry: Mapping[str, Any],
    material: Sequence[Mapping[str, Any]],
    boundary: Sequence[Mapping[str, Any]],
    probes: Sequence[Mapping[str, Any]],
    activation: float = 0.0,
) -> dict[str, Any]:
    """A deck in N and cm without form, order, support or load steps.

    - `title`: title of the deck
    - `geometry`: table `[geometry]`; the dimension is the length of a box's `size`, annuli are
      plane and models three-dimensional
    - `material`, `boundary`, `probes`: their tables
    - `activation`: activation of muscle, at full load [-]
    """
    dimension = {"annulus": 2, "model": 3}.get(geometry["kind"]) or len(geometry["size"])
    return {
        "title": title,
        "units": {"force": "N", "length": "cm"},
        "scene": {"dimension": dimension},
        "geometry": dict(geometry),
        "material": [dict(entry) for entry in material],
        "boundary": [dict(entry) for entry in boundary],
        "load": {"activation": activation},
        "probe": [dict(entry) for entry in probes],
    }
