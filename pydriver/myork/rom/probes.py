"""Probes of states by their names in the deck."""

from collections.abc import Mapping, Sequence
from typing import Any

from myork.core.scene import Scene
from myork.types import F64

#: Quantities at a point that follow from its deformation and pressure
_STRESSES = {f"cauchy_{a}{b}" for a in "xyz" for b in "xyz"} | {"J", "pressure", "principal_max"}
#: Quantities of several components
_VECTORS = ("u", "force", "section_force")


def probe_columns(probe: Mapping[str, Any], dimension: int) -> list[str]:
    """Names of the numbers of a probe: its own, or one for each component of a vector."""
    ends = [f"_{axis}" for axis in "xyz"[:dimension]] if probe["quantity"] in _VECTORS else [""]
    return [probe["name"] + end for end in ends]


def places_of(probes: Sequence[Mapping[str, Any]], dimension: int) -> dict[str, tuple[int, int]]:
    """Probe and component of each number, by the names of `probe_columns`."""
    return {
        name: (i, k)
        for i, probe in enumerate(probes)
        for k, name in enumerate(probe_columns(probe, dimension))
    }


def units_of(
    probes: Sequence[Mapping[str, Any]], dimension: int, units: Mapping[str, str]
) -> dict[str, str]:
    """Unit of each number, by the names of `probe_columns`; `units` are by names of probes."""
    return {
        name: units[probe["name"]] for probe in probes for name in probe_columns(probe, dimension)
    }


def named_probes(scene: Scene, x: F64, load: F64) -> dict[str, Any]:
    """Probe values by name: a list of numbers or vectors."""
    values = scene.probes(x, load)
    named = {}
    for i, probe in enumerate(scene.deck["probe"]):
        vector = probe["quantity"] in _VECTORS
        named[probe["name"]] = (
            values[:, i, : scene.dimension] if vector else values[:, i, 0]
        ).tolist()
    return named


def is_stress(quantity: str) -> bool:
    """Whether a quantity follows from the deformation and the pressure at a point."""
    return quantity in _STRESSES
