"""How many steps of a deck give the snapshots of `[rom]`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# Load steps that give the snapshots where the deck takes its load in one.
_STEPS = 10


def step_count(deck: Mapping[str, Any]) -> int:
    """Number of load or time steps that `myork rom` takes.

    A deck that takes its load in one step has ten if more than one mode is wanted, and no fewer
    than modes.
    """
    if "dynamics" in deck:
        return round(deck["dynamics"]["end_time"] / deck["dynamics"]["time_step"])
    steps, wanted = int(deck["load"]["steps"]), max(deck["rom"]["modes"])
    return max(_STEPS, wanted) if steps == 1 < wanted else steps
