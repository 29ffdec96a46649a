"""Searches for points compared with the best evenly spaced points of the same error."""

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
    """Sheets without points on which no setting was chosen, at target errors of 5, 2 and 1 %.

    Unknowns of the searches, largest error and bar of all probes, relative to the largest of their
    kind; and over the CPU time of the cheapest of nine evenly spaced lattices that errs by no more,
    which nobody knows beforehand (nan: none of them does). Medians are of each number.
    """
    yield "deck", "unknowns", "error", "bar", "CPU [s]", "over the best even points"
    problems = map(unseen.problem_of, range(140, unseen.NUMBERS.stop))
    known = ((problem, unseen.known(problem.name)) for problem in problems)
    decks = [(problem, truths) for problem, truths in known if truths and "plane" in problem.name]
    found = []
    for problem, truths in decks[:_DECKS]:
        print(problem.name, file=sys.stderr, flush=True)
        even = np.array([_solved(sized_tables(problem.tables, points), truths)
                         for points in _lattices(problem.tables["geometry"]["size"])])  # fmt: skip
        cases = []
        for words in unseen.at(0.05, 0.02, 0.01).values():
            case = _solved(problem.tables, truths, *words)
            alike = even[even[:, 1] <= case[1]]
            cases.append([*case, case[3] / alike[:, 3].min() if len(alike) else np.nan])
        found.append(cases)
        yield problem.name, *_cells(cases)
    yield "median", *_cells(np.nanmedian(found, axis=0))


def _cells(cases: Any) -> Iterator[str]:
    for numbers in np.transpose(cases):
        yield " / ".join(f"{number:.{0 if number > 99 else 2}{'f' if number > 99 else 'g'}}"
                         for number in numbers)  # fmt: skip


def _lattices(size: Sequence[float]) -> list[list[int]]:
    edges: F64 = np.array(size) / min(size)
    return [(np.rint(n * edges).astype(int) + 1).tolist() for n in _CELLS]


def _solved(tables: Mapping[str, Any], truths: Truths, *words: str) -> list[float]:
    """Unknowns, largest error (infinite without an answer) and bar, CPU time."""
    case = solve_case(tables, words)
    if "probes" not in case:
        return [np.nan, np.inf, np.nan, np.nan]
    found = truths.errors(case["probes"], case["probe_errors"], least=1.0)
    bar = max(found["bar"].values(), default=np.nan)
    return [case["dofs"], found["off"], bar, case["cpu_s"]]
