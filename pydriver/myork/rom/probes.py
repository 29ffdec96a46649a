"""Probes of states by their names in the deck."""

from __future__ import annotations

from typing import Any

from myork.core.scene import F64Array, Scene

__all__ = ["force_names", "named_probes"]


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
