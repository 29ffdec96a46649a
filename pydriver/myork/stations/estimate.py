"""Force of a muscle by its PCSA, beside the one that was computed."""

from collections.abc import Mapping
from typing import Any

import numpy as np

# A computed force further than this factor from the estimate is named.
_FACTOR = 3.0


def pcsa_force(summary: Mapping[str, Any]) -> tuple[dict[str, Any], str] | None:
    """Activation times PCSA times `sigma_max`, summed over the muscles of a model, at the end.

    It is the force of fibers at their optimal length without the passive one.

    - `summary`: content of `summary.json` after a solve
    - returns entry `pcsa_force` of the summary: `value` in the deck's unit of force, the `probe` of
      the largest force on a set and the `ratio` of both; a warning where they are three times
      apart, else no text. None without activation, one muscle material, PCSA of all active muscles,
      or a probe of a force.
    """
    deck, steps = summary.get("deck", {}), summary.get("steps") or [{}]
    materials = [own for own in deck.get("material", []) if own.get("model") == "muscle"]
    rows = (summary.get("model") or {}).get("muscles", [])
    if deck.get("geometry", {}).get("kind") != "model" or len(materials) != 1:
        return None
    activation = materials[0].get("activation", steps[-1].get("activation", 0.0))
    areas = [value for row in rows for head, value in row.items() if head.startswith("PCSA")]
    areas = [value for value in areas if value is not None]
    whole = len(areas) == 1 or len(areas) == len(rows)
    forces = {
        probe["name"]: float(np.linalg.norm(steps[-1].get("probes", {}).get(probe["name"]) or 0.0))
        for probe in deck.get("probe", [])
        if str(probe.get("quantity")).split("_")[0] == "force" and probe.get("set")
    }
    if not (areas and whole and any(forces.values()) and isinstance(activation, int | float)):
        return None
    value = float(activation * sum(areas) * materials[0]["sigma_max"])
    if not value > 0.0:
        return None
    probe = max(forces, key=lambda name: forces[name])
    ratio = forces[probe] / value
    warning = ""
    if not 1.0 / _FACTOR <= ratio <= _FACTOR:
        warning = (
            f"probe {probe} is {ratio:.2g} times activation x PCSA x sigma_max = {value:.4g} "
            f"{summary.get('units', {}).get('force', '')}: look at fibers, attachments and unit of "
            "sigma_max"
        )
    return {"value": value, "probe": probe, "ratio": ratio}, warning
