"""Probes of states by their names in the deck."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from myork.core.scene import F64Array, Scene

__all__ = ["force_names", "is_stress", "named_probes", "unit_of"]

#: Quantities of a point that follow from its deformation and pressure
_STRESSES = {f"cauchy_{a}{b}" for a in "xyz" for b in "xyz"} | {"J", "pressure", "principal_max"}


def named_probes(scene: Scene, x: F64Array, load: F64Array) -> dict[str, Any]:
    """Probe values by name: a list of numbers, or of vectors."""
    values = scene.probes(x, load)
    named = {}
    for i, probe in enumerate(scene.deck["probe"]):
        vector = probe["quantity"] in ("u", "force")
        named[probe["name"]] = (
            values[:, i, : scene.dimension] if vector else values[:, i, 0]
        ).tolist()
    return named


def force_names(scene: Scene) -> list[str]:
    """Names of the probes of forces."""
    return [probe["name"] for probe in scene.deck["probe"] if "set" in probe]


def is_stress(quantity: str) -> bool:
    """Whether a quantity follows from the deformation and the pressure at a point."""
    return quantity in _STRESSES


def unit_of(quantity: str, units: Mapping[str, str]) -> str:
    """Unit of what a reduced model knows of a probe; none of a ratio."""
    if quantity.startswith("force"):
        return units["force"]
    if quantity == "J":
        return ""
    if is_stress(quantity):
        return units.get("stress") or f"{units['force']}/{units['length']}^2"
    return units["length"]
