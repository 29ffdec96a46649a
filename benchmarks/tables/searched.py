"""Searches for points beside the best evenly spaced points of the same error."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks import unseen
from benchmarks.runner import Truths, sized_tables
from benchmarks.runs import solve_case
from myork.types import F64

#: Cells across the thinnest direction of evenly spaced points, and decks
_CELLS, _DECKS = (4, 6, 8, 12, 16, 24, 32, 48, 64), 30


def searched() -> Iterator[tuple[str, ...]]:
    """Sheets without points on which no setting was chosen, at three target errors.

    Unknowns of the search, largest error and bar of all probes, relative to the largest of their
    kind, and the cheapest of nine evenly spaced lattices that errs by no more.
    """
    head = "target error", "unknowns", "error", "bar", "CPU [s]", "even unknowns", "their CPU [s]"
    yield ("deck", *head, "ratio")
    problems = map(unseen.problem_of, range(140, unseen.NUMBERS.stop))
    known = ((problem, unseen.known(problem.name)) for problem in problems)
    found = [(problem, truths) for problem, truths in known if truths and "plane" in problem.name]
    for problem, truths in found[:_DECKS]:
        print(problem.name, file=sys.stderr, flush=True)
        even = []
        for points in _lattices(problem.tables["geometry"]["size"]):
            even.append(_solved(sized_tables(problem.tables, points), truths))
        for accuracy in unseen.ACCURACIES:
            case = _solved(problem.tables, truths, f"accuracy={accuracy}", "cost=15")
            alike = [one for one in even if one["error"] <= case["error"]]
            best = min(alike, key=lambda one: float(one["cpu_s"]), default={"unknowns": "none"})
            numbers = [case["error"], case["bar"], case["cpu_s"], best.get("cpu_s", np.nan)]
            error, bar, cpu, even_cpu = (f"{number:.2g}" for number in numbers)
            yield (problem.name, f"{accuracy:.0%}", str(case["unknowns"]), error, bar, cpu,
                   str(best["unknowns"]), even_cpu, f"{numbers[2] / numbers[3]:.2g}")  # fmt: skip


def _lattices(size: Sequence[float]) -> list[list[int]]:
    edges: F64 = np.array(size) / min(size)
    return [(np.rint(n * edges).astype(int) + 1).tolist() for n in _CELLS]


def _solved(tables: Mapping[str, Any], truths: Truths, *words: str) -> dict[str, Any]:
    """Unknowns, largest error (infinite where there is no answer) and bar, CPU time."""
    case = solve_case(tables, words)
    if "probes" not in case:
        return {"error": np.inf, "bar": np.nan, "cpu_s": np.nan, "unknowns": "none"}
    found = truths.errors(case["probes"], case["probe_errors"], least=1.0)
    bar = max(found["bar"].values(), default=np.nan)
    return {"error": found["off"], "bar": bar, "cpu_s": case["cpu_s"], "unknowns": case["dofs"]}
