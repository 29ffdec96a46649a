"""Problems of a new user: boxes, tubes and label maps, stretched, bent, active.

Boxes and tubes are in `problems.json`. No deck gives a form, order, support, weights, a curve or
load steps, and none was used to choose a default of MyoRK, so that the results are those of a user
who sets none of these.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.voxel_bodies import BODIES, Body

Sizes = tuple[tuple[int, ...], ...]


class Race(NamedTuple):
    """Settings of a problem in the race."""

    lines: Sequence[str]  #: Kinds of probes or single probes to compare
    sizes: Sizes  #: As in the problem
    elements: Sizes


class Problem(NamedTuple):
    """A problem with the sizes at which it is solved."""

    name: str  #: Name in tables
    tables: Mapping[str, Any]  #: Deck without `geometry.source`
    sizes: Sizes  #: Source points along each edge, ascending
    #: Finite elements along each edge, ascending; each coordinate of a probe is a corner
    elements: Sizes
    race: Race | None = None


def probe_kind(entry: Mapping[str, Any], size: Sequence[float] | None = None) -> str:
    """Kind of a probe: `displacement`, `force`, `surface stress` or `stress`.

    - `entry`: table `[[probe]]`
    - `size`: edges of the box; for other bodies the probe's name tells where its point lies
    """
    quantity = str(entry["quantity"])
    if quantity.startswith("u_"):
        return "displacement"
    if quantity.startswith(("force", "torque")):
        return "force"
    if size is None:
        return "surface stress" if "wall" in entry["name"] else "stress"
    on = any(x in (0, edge) for x, edge in zip(entry["point"], size, strict=True))
    return "surface stress" if on else "stress"


def _problem(entry: Mapping[str, Any]) -> Problem:
    """A problem with its deck as in the file, which may give only what differs from another."""
    if "like" in entry:
        other = next(one for one in _ALL if one["name"] == entry["like"])
        own = {"title": entry["name"], **entry["tables"]}
        entry = {**other, **entry, "tables": other["tables"] | own}
    race = entry.get("race")
    return Problem(
        entry["name"], entry["tables"], _sizes(entry["sizes"]), _sizes(entry["elements"]),
        race and Race(race["lines"], _sizes(race["sizes"]), _sizes(race["elements"])),
    )  # fmt: skip


def _sizes(lists: Sequence[Sequence[int]]) -> Sizes:
    return tuple(tuple(one) for one in lists)


_ALL = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))

#: Problems by the feature that they test, each at three sizes
PROBLEMS = tuple(map(_problem, _ALL))

#: All problems, and the same by their names in tables
ALL: tuple[Problem | Body, ...] = (*PROBLEMS, *BODIES)
BY_NAME: Mapping[str, Any] = {problem.name: problem for problem in ALL}
