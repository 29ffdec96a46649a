"""Problems that a new user would bring: boxes, tubes and label maps, stretched, bent, active.

Boxes and tubes stand in `problems.json`. No deck names a form, order, support, weights, a curve or
load steps, and none chose a default of MyoRK, so that what is tried is what somebody gets who knows
none of them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.voxel_bodies import BODIES, TWO_TISSUES, Body

Sizes = tuple[tuple[int, ...], ...]


class Race(NamedTuple):
    """How a problem races."""

    lines: Sequence[str]  #: Kinds of probes or single probes that are compared
    sizes: Sizes  #: As of the problem
    elements: Sizes


class Problem(NamedTuple):
    """A problem with the sizes at which it is solved."""

    name: str  #: What tables show
    tables: Mapping[str, Any]  #: Deck without `geometry.source`
    sizes: Sizes  #: Source points along each edge, rising
    #: Finite elements along each edge, rising; each coordinate of a probe is a corner
    elements: Sizes
    race: Race | None = None


def probe_kind(entry: Mapping[str, Any], size: Sequence[float] | None = None) -> str:
    """What a probe tells: `displacement`, `force`, `surface stress` or `stress`.

    - `entry`: table `[[probe]]`
    - `size`: edges of the box; of other bodies the probe's name says where its point lies
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
    """A problem with its deck as it stands in the file."""
    race = entry.get("race")
    return Problem(
        entry["name"], entry["tables"], _sizes(entry["sizes"]), _sizes(entry["elements"]),
        race and Race(race["lines"], _sizes(race["sizes"]), _sizes(race["elements"])),
    )  # fmt: skip


def _sizes(lists: Sequence[Sequence[int]]) -> Sizes:
    return tuple(tuple(one) for one in lists)


_ALL = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))

#: Problems by what they try, each at three sizes
PROBLEMS = tuple(_problem(entry) for entry in _ALL if entry["of"] == "forms")

#: Twenty decks at the number of points that somebody new to MyoRK would take
DECKS: tuple[Problem | Body, ...] = (
    *(_problem(entry) for entry in _ALL if entry["of"] == "newcomer"),
    *(body._replace(sizes=body.sizes[:1]) for body in (*BODIES, *TWO_TISSUES)),
)

#: All problems, by what tables call them
BY_NAME: Mapping[str, Any] = {problem.name: problem for problem in (*DECKS, *PROBLEMS, *BODIES)}
