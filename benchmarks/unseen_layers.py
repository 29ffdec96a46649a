"""Random sheets of two materials that name no points, and whose interface lies anywhere.

    python benchmarks/unseen_layers.py [FIRST [LAST]]

solves sheets that `benchmarks/truths/unseen_layers.json` lacks by finite elements that end at the
interface, and adds their limits. The even numbers are for tuning, the odd ones for looking at the
result.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.problems import Problem
from benchmarks.truths.deck_parts import deck, force, held, probe
from benchmarks.truths.finite_elements import solve_deck
from benchmarks.unseen import answers, fill
from myork.bench.runs import read_deck
from myork.console import ProgressCallback
from myork.types import F64

NUMBERS = range(40)
#: Elements across the sheet
_MESHES = (16, 32)
#: How much finer elements are at ends and interface
_FINER = 0.75
_SEED = 20261127
_FILE = Path(__file__).parent / "truths" / "unseen_layers.json"


class _Sheet(NamedTuple):
    """A sheet of height one, and where its second material begins."""

    length: float
    across: bool  #: The interface bounds it below
    along: bool  #: The interface bounds it on the left
    at: F64  #: Where, shares of length and height
    name: str
    tables: Mapping[str, Any]

    def place(self, share: F64) -> F64:
        """Places of shares of length and height, of which a half is the interface."""
        x, y = np.moveaxis(share, -1, 0)
        bend = [
            np.where(q < 0.5, 2 * q * at, at + (2 * q - 1) * (1 - at)) if bent else q
            for q, at, bent in ((x, self.at[0], self.along), (y, self.at[1], self.across))
        ]
        return np.stack([self.length * bend[0], bend[1]], axis=-1)

    def label(self, corner: F64) -> int:
        """Material of an element by its middle on the lattice."""
        right, above = corner[0] / self.length > 0.5, corner[1] > 0.5
        return 1 + int((right or not self.along) and (above or not self.across))

    def warp(self, nodes: F64) -> F64:
        """Nodes of the lattice moved to the interface, finer beside it and at the ends."""
        share = nodes / [self.length, 1.0]
        half = 2 * share - np.floor(np.minimum(2 * share, 1.999))
        moved = half - _FINER * np.sin(2 * np.pi * half) / (2 * np.pi)
        return self.place(0.5 * (np.floor(np.minimum(2 * share, 1.999)) + moved))


def sheet_of(number: int) -> _Sheet:
    """Random sheet of a number, which any machine draws alike."""
    rng = np.random.default_rng([_SEED, number])
    length = float(rng.choice([1.0, 1.5, 2.0, 3.0]))
    kind = str(rng.choice(["across", "along", "inside"]))
    height, share = np.round([rng.uniform(0.25, 0.75), rng.uniform(0.3, 0.7)], 3)
    left = round(float(share) * length, 4)
    ratio, bulk = float(rng.choice([0.05, 0.2, 5.0, 20.0])), float(rng.choice([4.0, 30.0]))
    way = str(rng.choice(["pulled", "sheared", "bent", "plates"]))
    size = float(rng.choice([-1, 1, 1]) * rng.uniform(0.05, 0.15))
    far: dict[str, dict[str, Any]] = {
        "pulled": held("x1", 2, u_x=round(abs(size) * length, 4)),
        "sheared": held("x1", 2, u_y=round(2 * size * length, 4)),
        "bent": {"set": "x1", "traction": [0.0, round(5 * min(1, ratio) * size / length**2, 4)]},
        "plates": {"set": "x1", "u_x": round(size * length, 4)},
    }
    near = [held("x0", 2)]
    if way == "plates":
        near = [{"set": "x0", "u_x": 0.0}, {"set": "y0", "u_y": 0.0}]
    where = {"across": f"y > {height}", "along": f"x > {left}"}
    law = {"name": "first", "model": "neo-hookean", "mu": 10.0, "K": 10.0 * bulk}
    other = {**law, "name": "second", "mu": 10.0 * ratio, "K": 10.0 * ratio * bulk}
    other["where"] = where.get(kind, f"x > {left} and y > {height}")
    sheet = _Sheet(
        length, kind != "along", kind != "across", np.array([left / length, height]), "", {}
    )

    def at(x: float, y: float) -> tuple[float, ...]:
        return tuple(np.round(sheet.place(np.array([x, y])), 6).tolist())

    middle = 0.5 if kind == "across" else 0.25
    stress = str(rng.choice(["cauchy_xx", "cauchy_yy", "cauchy_xy"]))
    probes = [
        probe("u_end", "u_x", at(0.75, 0.25)),
        probe("u_side", "u_y", at(0.75, 1.0)),
        probe("s_low", "cauchy_xx", at(middle, 0.25)),
        probe("s_high", stress, at(0.5 if kind == "across" else 0.75, 0.75)),
        force("f_x", "x", "x0"),
        force("f_y", "y", "y0" if way == "plates" else "x0"),
    ]
    name = f"{number}: {kind}, {way}, moduli 1:{ratio:g}, K/mu {bulk:g}"
    geometry = {"kind": "box", "size": [length, 1.0]}
    tables = deck(name, geometry, (law, other), [*near, far[way]], probes, 0.0)
    return sheet._replace(name=name, tables=tables)


def rows(progress: ProgressCallback, quick: bool) -> list[dict[str, Any]]:
    """Solve all sheets that have truths at each target error; a few of them for `quick`."""
    sheets = {n: sheet_of(n) for n in (NUMBERS[:6] if quick else NUMBERS)}
    problems = {n: Problem(s.name, s.tables, ((),), ()) for n, s in sheets.items()}
    return answers(problems, _FILE, progress)


def _limits(sheet: _Sheet) -> dict[str, Any]:
    """Value of each probe and what the finer mesh changes."""
    found = read_deck(dict(sheet.tables))
    # the mesh moves with the interface, and loads of its sides would be those before
    if "traction" in found["boundary"][-1] and sheet.across:
        return {}
    for label, table in enumerate(found["material"], 1):
        table["label"] = label
        table.pop("where", None)
    coarse, fine = (
        solve_deck(found, (n * max(1, round(sheet.length)), n), labels=sheet.label, warp=sheet.warp)
        for n in _MESHES
    )
    ends = [{name: values[-1] for name, values in s["probes"].items()} for s in (coarse, fine)]
    return {name: [value, abs(value - ends[0][name])] for name, value in ends[1].items()}


def main(first: int = NUMBERS.start, last: int = NUMBERS.stop) -> None:
    """Solve sheets by finite elements."""
    sheets = [sheet_of(number) for number in range(first, last)]
    fill(_FILE, [(sheet.name, partial(_limits, sheet)) for sheet in sheets])


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
