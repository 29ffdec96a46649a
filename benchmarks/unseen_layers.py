"""Random sheets and boxes of two materials without points, with interfaces anywhere.

Finite elements aligned with the interface give the truths, `benchmarks/truths/unseen_layers.json`,
beforehand. The even numbers are for tuning, the odd ones for assessing the result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.problems import Problem
from benchmarks.truths.deck_parts import deck, force, held, probe
from benchmarks.truths.finite_elements import solve_deck
from benchmarks.unseen import Wanted, answers, at
from myork.bench.runs import read_deck
from myork.console import ProgressCallback
from myork.types import F64

#: Numbers of sheets come before those of boxes in space
_SHEETS = 40
NUMBERS = range(_SHEETS + 24)
#: Refinement of elements at ends and interface
_FINER = 0.75
#: Largest doubt, relative to the largest of a kind, of a known probe: the middle of a sheared bar
#: has no stress along it
_KNOWN = 0.2
_SEED = 20261127
_AXES = "xyz"
TRUTHS = Path(__file__).parent / "truths" / "unseen_layers.json"


class _Body(NamedTuple):
    """A box, and the position of its second material."""

    lines: Sequence[F64]  #: Ends and interfaces along each edge [length]
    second: Sequence[
        Sequence[bool]
    ]  #: Whether it lies between each two of these, in each direction
    meshes: Sequence[int]  #: Number of elements between two of these
    name: str
    tables: Mapping[str, Any]

    def place(self, share: F64) -> F64:
        """Positions for relative coordinates that give all parts between two lines equal length."""
        bent = [
            np.interp(q, np.linspace(0.0, 1.0, len(lines)), lines)
            for q, lines in zip(np.moveaxis(share, -1, 0), self.lines, strict=True)
        ]
        return np.stack(bent, axis=-1)

    def label(self, corner: F64) -> int:
        """Material of an element, by its centre on the lattice."""
        parts = [
            own[min(int(len(own) * x / lines[-1]), len(own) - 1)]
            for x, own, lines in zip(corner, self.second, self.lines, strict=True)
        ]
        return 1 + int(all(parts))

    def warp(self, nodes: F64) -> F64:
        """Nodes of the lattice moved to the interfaces, refined beside them and at the ends."""
        parts = np.array([len(own) for own in self.second])
        share = parts * nodes / [lines[-1] for lines in self.lines]
        part = np.minimum(np.floor(share), parts - 1)
        within = share - part
        moved = within - _FINER * np.sin(2 * np.pi * within) / (2 * np.pi)
        return self.place((part + moved) / parts)


def body_of(number: int) -> _Body:
    """Random sheet or box of a number, identical on every machine."""
    return _sheet_of(number) if number < _SHEETS else _box_of(number)


def _sheet_of(number: int) -> _Body:
    """Sheet of height one."""
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
    bent = {"x": kind != "across", "y": kind != "along"}
    lines = [
        np.array([0.0, at if bent[axis] else 0.5 * end, end])
        for axis, at, end in (("x", left, length), ("y", height, 1.0))
    ]
    second = [(not bent[axis], True) for axis in "xy"]
    sheet = _Body(lines, second, (8, 16), "", {})
    at = partial(_at, sheet)

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


def _box_of(number: int) -> _Body:
    """Box of width and height one with a plate, a bar or a block of the second material."""
    rng = np.random.default_rng([_SEED, number])
    length = float(rng.choice([1.0, 1.5, 2.0]))
    kind = str(rng.choice(["plate across", "plate along", "bar", "edge", "block", "bar"]))
    lines = [length * np.array([0.0, 0.5, 1.0]), *[np.array([0.0, 0.5, 1.0])] * 2]
    second = [(True, True)] * 3
    bent = {"plate across": "z", "plate along": "x", "bar": "yz", "edge": "xz", "block": "xyz"}
    for axis in bent[kind]:
        k = _AXES.index(axis)
        lines[k] = np.array([0.0, round(lines[k][-1] * rng.uniform(0.3, 0.7), 3), lines[k][-1]])
        second[k] = (False, True)
    ratio = float(rng.choice([0.05, 0.2, 5.0, 20.0]))
    bulk = [float(k) for k in rng.choice([4.0, 30.0, 300.0], 2)]
    way = str(rng.choice(["pulled", "sheared", "bent", "twisted", "plates"]))
    size = float(rng.choice([-1, 1, 1]) * rng.uniform(0.05, 0.15))
    end = {"set": "x1", "about": [length, 0.5, 0.5]}
    far: dict[str, dict[str, Any]] = {
        "pulled": held("x1", u_x=round(abs(size) * length, 4)),
        "sheared": held("x1", u_z=round(2 * size * length, 4)),
        "bent": {**end, "rotation": round(100 * size, 2), "axis": [0.0, 1.0, 0.0]},
        "twisted": {**end, "rotation": round(200 * size, 2), "axis": [1.0, 0.0, 0.0]},
        "plates": {"set": "x1", "u_x": round(size * length, 4)},
    }
    near = [held("x0")]
    if way == "plates":
        near = [{"set": f"{axis}0", f"u_{axis}": 0.0} for axis in _AXES]
    conditions = [f"{axis} > {lines[_AXES.index(axis)][1]}" for axis in bent[kind]]
    law = {"name": "first", "model": "neo-hookean", "mu": 10.0, "K": 10.0 * bulk[0]}
    other = {**law, "name": "second", "mu": 10.0 * ratio, "K": 10.0 * ratio * bulk[1]}
    other["where"] = " and ".join(conditions)
    box = _Body(lines, second, (2, 4), "", {})
    at = partial(_at, box)
    # the middles of both parts, or of the whole length where it has no interface
    low, high = [0.25] * 3, [0.75] * 3
    if all(second[0]):
        low[0] = high[0] = 0.5
    probes = [
        probe("u_end", "u_x", at(0.75, low[1], low[2])),
        probe("u_side", "u_z", at(0.75, high[1], 1.0)),
        probe("s_low", "cauchy_xx", at(*low)),
        probe("s_high", str(rng.choice(["cauchy_xx", "cauchy_zz", "cauchy_xz"])), at(*high)),
        force("f_x", "x", "x0"),
        force("f_z", "z", "z0" if way == "plates" else "x0"),
    ]
    name = f"{number}: box, {kind}, {way}, moduli 1:{ratio:g}, K/mu {bulk[0]:g} and {bulk[1]:g}"
    geometry = {"kind": "box", "size": [length, 1.0, 1.0]}
    tables = deck(name, geometry, (law, other), [*near, far[way]], probes, 0.0)
    return box._replace(name=name, tables=tables)


def _at(body: _Body, *share: float) -> tuple[float, ...]:
    """Position in a body for relative coordinates."""
    return tuple(np.round(body.place(np.array(share)), 6).tolist())


def rows(progress: ProgressCallback, quick: bool) -> list[dict[str, Any]]:
    """Solve sheets that have truths at each target error, and boxes at one; with `quick` a few."""
    numbers = [*NUMBERS[:6], *NUMBERS[_SHEETS : _SHEETS + 2]] if quick else NUMBERS
    bodies = {number: body_of(number) for number in numbers}
    problems = {n: Problem(body.name, body.tables, ((),), ()) for n, body in bodies.items()}
    sheets = {n: problem for n, problem in problems.items() if n < _SHEETS}
    boxes = {n: problem for n, problem in problems.items() if n >= _SHEETS}
    return [
        *answers(sheets, TRUTHS, progress, NUMBERS[1::2]),
        *answers(boxes, TRUTHS, progress, NUMBERS[1::2], at(0.02)),
    ]


def _limits(body: _Body) -> dict[str, Any]:
    """Value of each probe and its change by the finer mesh; unknown probes are left out."""
    found = read_deck(dict(body.tables))
    # the mesh moves with the interface, so that loads on its sides would be the earlier ones
    if "traction" in found["boundary"][-1] and not all(body.second[1]):
        return {}
    for label, table in enumerate(found["material"], 1):
        table["label"] = label
        table.pop("where", None)
    ends = []
    for n in body.meshes:
        count = [n * len(own) for own in body.second]
        if len(count) == 2:
            count[0] *= max(1, round(body.lines[0][-1]))
        solid = len(count) == 3
        solved = solve_deck(found, count, labels=body.label, warp=body.warp, symmetric=solid)
        ends.append(solved["probes"])
    doubt = {name: abs(value - ends[0][name]) for name, value in ends[1].items()}
    most = {name: max(abs(v) for k, v in ends[1].items() if k[0] == name[0]) for name in doubt}
    return {
        name: [value, doubt[name]]
        for name, value in ends[1].items()
        if doubt[name] <= _KNOWN * most[name]
    }


def wanted(numbers: range) -> list[Wanted]:
    """Bodies and their limits."""
    return [(body.name, partial(_limits, body)) for body in map(body_of, numbers)]
