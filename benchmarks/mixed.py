"""The mixed form on the block with inclined fibers: which choices matter, and how far it is right.

Every case is `muscle_fibers.toml` to an activation of 0.3 with some keys overridden, compared with
two finite element solutions: FEBio's of the deck, which takes the published force curves of the
fibers, and felupe's, solved in this run with the smooth curves of the deck. Above an activation
of 0.2 the two differ by 2 to 4 %. docs/mixed.md tells what follows from the tables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.truths.finite_elements import solve_half_block
from myork.bench.runs import lattice, outcome_text, read_deck, solve_case
from myork.bench.tables import Columns, Shown, plane_map, table
from myork.console import ProgressCallback
from myork.errors import InstallationError
from myork.results import Results

__all__ = ["run"]

_DECK = "muscle_fibers"
_ACTIVATIONS = (0.05, 0.10, 0.15, 0.20, 0.25, 0.30)
_ELEMENTS = (6, 3, 12)
#: Distances from the edges between ends and sides at which J is judged [cm], the block is 1 wide
_DISTANCES = (0.25, 0.5)
#: What counts as kept volume
_KEPT = 0.02


def _size(n: int) -> tuple[str, ...]:
    """Sources n x n x (2n-1)."""
    return lattice((n, n, 2 * n - 1))


_COARSE = _size(5)
_ORDER_2 = ("approximation.order=2", "approximation.support=3", *_COARSE)
_ORDER_3 = ("approximation.order=3", "approximation.support=4", *_COARSE)

_CHOICES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("displacement form, order 2", ("scene.method=rkcm", *_ORDER_2)),
    ("order 2, no edge weights", ("mixed.edge_exponent=0", *_ORDER_2)),
    ("order 2", _ORDER_2),
    ("order 3", _ORDER_3),
    ("order 4", _COARSE),
    ("order 4, no edge weights", ("mixed.edge_exponent=0", *_COARSE)),
    ("order 4, edge exponent 0.75", ("mixed.edge_exponent=0.75", *_COARSE)),
    ("order 4, edge exponent 1.5", ("mixed.edge_exponent=1.5", *_COARSE)),
    ("order 4, volume weight 3", ("mixed.volume_weight=3", *_COARSE)),
    ("order 4, volume weight 30", ("mixed.volume_weight=30", *_COARSE)),
)
_SIZES = (5, 6, 7)


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all cases; see `myork.bench` for the result."""
    activations = _ACTIVATIONS[:1] if quick else _ACTIVATIONS
    rival = {angle: _felupe(progress, angle, activations, quick) for angle in (30, 0)}
    choices = [_case(progress, *choice, activations) for choice in _CHOICES[: 3 if quick else None]]
    sizes, straight = [], []
    for n in _SIZES[: 1 if quick else None]:
        name = f"{n} x {n} x {2 * n - 1}"
        sizes.append(_case(progress, name, _size(n), activations))
        angle = ("material.muscle.fiber_angle=0", *_size(n))
        straight.append(_case(progress, f"{name}, straight fibers", angle, activations))
    shown = sizes[min(1, len(sizes) - 1)]
    judged = [at for at in activations if at in (0.05, 0.15, 0.30)]
    return {
        "title": "Mixed form on the block with inclined fibers",
        "about": __doc__.split("\n\n")[1].replace("\n", " "),
        "cases": [*choices, *sizes, *straight],
        "rival": rival[30],
        "maps": [{**entry, "title": f"{entry['title']}, {shown['name']} source points"}
                 for entry in shown.get("maps", [])],
        "tables": [
            *(_choice_table(choices, rival[30], at) for at in judged),
            *(_ramp_table(case, rival[30]) for case in sizes),
            _spread_table(rival[30], sizes[0]),
            _straight_table(straight, rival[0], judged[-1]),
        ],
    }  # fmt: skip


def _case(
    progress: ProgressCallback, name: str, overrides: tuple[str, ...], activations: Sequence[float]
) -> dict[str, Any]:
    """One solve with what its result file says about the volume."""
    progress(name)
    load = (f"load.steps={len(activations)}", f"load.activation={activations[-1]}")
    return {
        "name": name,
        **solve_case(_DECK, (*load, *overrides), limit=7200.0, look=_look),
    }


def _look(folder: Path) -> dict[str, Any]:
    """Volume ratio by the distance from the edges; maps of the middle plane at the last step."""
    with Results(folder) as results:
        x = results.points
        low, high = x.min(axis=0), x.max(axis=0)
        wall = np.minimum(x - low, high - x)
        away = np.hypot(wall[:, 2], np.minimum(wall[:, 0], wall[:, 1]))
        volume = []
        for step in range(1, results.nstep):
            j = results.field("J", step)
            entry: dict[str, Any] = {"activation": float(results.activations[step])}
            for distance in _DISTANCES:
                far = j[away >= distance * (1.0 - 1e-9)]
                entry[f"{distance:g}"] = {
                    "min": float(far.min()),
                    "max": float(far.max()),
                    "share": float(np.mean(abs(far - 1.0) <= _KEPT)),
                }
            volume.append(entry)
        plane = np.isclose(x[:, 1], 0.5 * (low[1] + high[1]))
        maps = []
        if plane.any():
            at = results.activations[-1]
            for title, unit, values in (
                ("Volume ratio J", "-", results.field("J")),
                ("Cauchy stress zz", "N/cm²", results.field("cauchy")[:, 2, 2]),
            ):
                heading = f"{title} on the middle plane, activation {at:.2g}"
                places = x[plane][:, [0, 2]]
                maps.append(plane_map(heading, f"{title} [{unit}]", places, values[plane]))
    return {"volume": volume, "maps": maps}


def _felupe(
    progress: ProgressCallback, angle: float, activations: Sequence[float], quick: bool
) -> dict[str, Any]:
    """The rival's values; nothing where it is not installed."""
    progress(f"felupe, fibers at {angle:g} degrees")
    words = [f"material.muscle.fiber_angle={angle}", f"load.activation={activations[-1]}"]
    loads = [activation / activations[-1] for activation in activations]
    elements = (2, 2, 4) if quick else _ELEMENTS
    try:
        found = solve_half_block(read_deck(_DECK, words), elements, loads)
        return {"activation": list(activations), **found["probes"], "dofs": found["dofs"],
                "seconds": found["seconds"]}  # fmt: skip
    except InstallationError as error:
        progress(str(error))
        return {}


def _probes(case: Mapping[str, Any]) -> list[str]:
    return list(case.get("reference") or {})


def _from(wanted: Mapping[float, float] | None, value: float | None, at: float) -> float | None:
    """Signed difference from a reference by activation relative to its size, where both exist."""
    for activation, right in (wanted or {}).items():
        if value is not None and abs(activation - at) < 1e-9:
            return float((value - right) / abs(right))
    return None


def _febio(case: Mapping[str, Any], probe: str) -> dict[float, float]:
    """Values of FEBio by activation."""
    entry = (case.get("reference") or {}).get(probe)
    return dict(zip(entry["activation"], entry["reference"], strict=True)) if entry else {}


def _felupe_values(rival: Mapping[str, Any], probe: str) -> dict[float, float]:
    """Values of felupe by activation."""
    return dict(zip(rival["activation"], rival[probe], strict=True)) if rival else {}


def _largest(values: Sequence[float | None]) -> float | None:
    """Largest size, None where one is missing."""
    known = [abs(value) for value in values if value is not None]
    return max(known) if known and len(known) == len(values) else None


def _comparison(
    case: Mapping[str, Any], rival: Mapping[str, Any], probes: Sequence[str], activation: float
) -> dict[str, Any]:
    """Differences from FEBio and from felupe by probe, and the largest of each."""
    reached = [s for s in case.get("history", []) if abs(s["activation"] - activation) < 1e-9]
    found = reached[0]["probes"] if reached else {}
    febio = {p: _from(_febio(case, p), found.get(p), activation) for p in probes}
    felupe = {p: _from(_felupe_values(rival, p), found.get(p), activation) for p in probes}
    largest = {"febio_largest": _largest([*febio.values()])}
    largest |= {"felupe_largest": _largest([*felupe.values()])}
    return {"febio": febio, "felupe": felupe, **largest}


def _differences(probes: Sequence[str]) -> Columns:
    """Columns of a comparison."""
    return (
        *((probe, f"febio.{probe}") for probe in probes),
        ("largest", "febio_largest"),
        ("largest, felupe", "felupe_largest"),
    )


def _choice_table(
    cases: Sequence[Mapping[str, Any]], rival: Mapping[str, Any], activation: float
) -> dict[str, Any]:
    probes = max((_probes(case) for case in cases), key=len)
    return table(
        f"5 x 5 x 9 source points, activation {activation:g}: relative difference from "
        "FEBio, the largest of them, and the largest from felupe",
        (
            ("case", "name"),
            ("unknowns", "dofs"),
            *_differences(probes),
            ("time [s]", "timings_s.total"),
            ("outcome", outcome_text),
        ),
        [{**case, **_comparison(case, rival, probes, activation)} for case in cases],
    )


def _ramp_table(case: Mapping[str, Any], rival: Mapping[str, Any]) -> dict[str, Any]:
    probes = _probes(case)
    steps = [
        {**step, "volume": volume, **_comparison(case, rival, probes, step["activation"])}
        for step, volume in zip(case.get("history", []), case.get("volume", []), strict=False)
    ]
    columns: list[tuple[str, Shown]] = [("activation", lambda step: round(step["activation"], 6))]
    columns += [*_differences(probes), ("iterations", "iterations")]
    for distance in _DISTANCES:
        for head, key in (
            (f"least J {distance:g} from the edges", "min"),
            ("largest J", "max"),
            (f"share within {_KEPT:.0%}", "share"),
        ):
            columns.append((head, ("volume", f"{distance:g}", key)))
    return table(
        f"{case['name']} source points, order 4: relative difference from FEBio, and "
        "the volume ratio away from the edges between ends and sides",
        columns,
        steps,
    )


def _spread_table(rival: Mapping[str, Any], case: Mapping[str, Any]) -> dict[str, Any]:
    """The two finite element solutions against each other."""
    probes = _probes(case)
    return table(
        "felupe, mixed Q2/Q1 elements and smooth curves, relative to FEBio, three-field "
        "hex20 and published curves",
        (("activation", "activation"), *((probe, probe) for probe in probes)),
        [
            {"activation": at}
            | {p: _from(_febio(case, p), _felupe_values(rival, p)[at], at) for p in probes}
            for at in rival.get("activation", [])
        ],
    )


def _straight_table(
    cases: Sequence[Mapping[str, Any]], rival: Mapping[str, Any], activation: float
) -> dict[str, Any]:
    probes = ("side_u_x", "stress_zz", "reaction_z")
    return table(
        f"Straight fibers, activation {activation:g}: relative difference from felupe",
        (
            ("source points", lambda case: case["name"].split(",")[0]),
            *((probe, f"felupe.{probe}") for probe in probes),
            ("least J", "min_J"),
            ("largest J", "max_J"),
            ("outcome", outcome_text),
        ),
        [{**case, **_comparison(case, rival, probes, activation)} for case in cases],
    )
