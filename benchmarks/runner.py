"""One long table: a row for each problem, form and size, with error, bar, verdict and cost.

felupe solves the same problems in the same run, bodies of voxels in their true shape; the limit of
its meshes is the truth, with what is not known of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.problems import Problem, probe_kind
from benchmarks.truths.finite_elements import solve_deck
from benchmarks.voxel_bodies import Body, body_cloud, box_tables
from myork.bench.exact import inner_stress
from myork.bench.runs import outcome_text, read_deck, solve_case
from myork.console import ProgressCallback
from myork.core.scene import Scene
from myork.errors import ConvergenceError, MyorkError
from myork.records import PointCloud

__all__ = [
    "KINDS",
    "WRONG",
    "Form",
    "Truth",
    "Truths",
    "lattice_text",
    "rows_of",
    "sized_tables",
    "solve_rivals",
]

#: Kinds of probes
KINDS = ("displacement", "force", "stress", "surface stress")
#: An error that must not be accepted [-]
WRONG = 0.05
#: Wall time of one solve [s]
_LIMIT = 300.0
#: Timed solves are repeated until they have taken so much together, at most so often [s], [-]
_ENOUGH, _MOST = 1.0, 3

#: What is seen of a deck in the folder of its results
Look = Callable[[Mapping[str, Any], Path], Mapping[str, Any]]

#: Name of a form, and the overrides that choose it
Form = tuple[str, Sequence[str]]


class Truth(NamedTuple):
    """Value of a probe, and by how much it may be off."""

    value: float
    doubt: float


class Truths(NamedTuple):
    """What is known of a problem's probes.

    Attributes
    ----------
    kinds : mapping
        Kind of each probe, by name.
    values : mapping
        Their truths.
    """

    kinds: Mapping[str, str]
    values: Mapping[str, Truth]

    def errors(self, probes: Mapping[str, float], bars: Mapping[str, float]) -> dict[str, Any]:
        """Compare an answer.

        Parameters
        ----------
        probes, bars : mapping
            Values and error bars, by name.

        Returns
        -------
        dict
            `error`, `bar` and `doubt` of the truth by probe, relative; `off`, the largest error
            beyond the doubt; `held`, how many bars contain it; `error` and `bar` followed by a
            kind, the largest of it, and `error` followed by a name.
        """
        size = {name: abs(truth.value) for name, truth in self.values.items() if name in probes}
        error = {name: abs(probes[name] - self.values[name].value) / size[name] for name in size}
        bar = {name: bars[name] / size[name] for name in size if bars.get(name) is not None}
        doubt = {name: self.values[name].doubt / size[name] for name in size}
        held = [error[name] <= bar[name] + doubt[name] for name in bar]
        largest = {
            f"{key} {kind}": max((of[n] for n in of if self.kinds[n] == kind), default=None)
            for kind in KINDS
            for key, of in (("error", error), ("bar", bar))
        }
        return {
            "error": error,
            "bar": bar,
            "doubt": doubt,
            "off": max((max(error[name] - doubt[name], 0.0) for name in error), default=None),
            "held": f"{sum(held)} of {len(held)}" if held else None,
            **{f"error {name}": value for name, value in error.items()},
            **largest,
        }


def rows_of(
    problem: Problem | Body,
    forms: Sequence[Form] | Callable[[Any], Sequence[Form]],
    progress: ProgressCallback,
    *,
    sizes: int | None = None,
    timed: bool = False,
    error: bool = True,
    look: Look | None = None,
) -> tuple[Truths, list[dict[str, Any]]]:
    """Solve a problem by finite elements and by all forms.

    Parameters
    ----------
    problem : Problem or Body
        What is solved.
    forms : sequence of Form, or callable
        Name and overrides of each form; a callable chooses them by the size.
    progress : callable
        Called with every line of progress.
    sizes : int, optional
        How many of the problem's sizes; all by default.
    timed : bool
        Solve in this process without output, short solves repeated: the least time counts.
    error : bool
        Compute error bars and a verdict, which a timed solve has not.
    look : callable, optional
        Of the deck and the folder of its results; what it returns joins the row.

    Returns
    -------
    truths : Truths
        Limit of the meshes; the exact values of a tube where solves are timed.
    rows : list of dict
        `problem`, `method`, `size`, `unknowns`, `cpu_s`, `memory`, `outcome`, `verdict`, `reasons`
        and what `Truths.errors` returns; `rival` marks finite elements.
    """
    truths, rivals = solve_rivals(problem, progress)
    if timed:
        truths = _exact(problem, truths)
    rows = []
    for mesh, rival in zip(problem.elements, rivals, strict=True):
        again = _peer_time(problem, mesh) if timed else None
        rows.append(
            {
                "problem": problem.name,
                "method": "felupe",
                "rival": True,
                "size": rival["size"],
                "unknowns": rival["dofs"],
                "outcome": rival["outcome"],
                **_times(rival["cpu_s"], again),
                **truths.errors(rival["probes"], {}),
            }
        )
    chosen = {size: forms(size) if callable(forms) else forms for size in problem.sizes[:sizes]}
    for name in dict.fromkeys(name for own in chosen.values() for name, _ in own):
        for size, own in chosen.items():
            words = dict(own).get(name)
            if words is None:
                continue
            text, tables, cloud = _sized(problem, size)
            progress(f"{problem.name}: {name}, {text}")
            row = {"problem": problem.name, "method": name, "size": text}
            if timed:
                solve = _timed_solve(tables, words, cloud)
                case = solve()
                case |= _times(case["cpu_s"], partial(_own_time, solve))
            else:
                seen: dict[str, Any] = {}
                case = _record(
                    solve_case(
                        tables,
                        words,
                        cloud=cloud,
                        limit=_LIMIT,
                        error=error,
                        look=partial(_look, look, tables, seen),
                    )
                )
                case |= seen
            found = truths.errors(case.pop("probes"), case.pop("bars", {}))
            rows.append({**row, **case, **found})
    return truths, rows


def solve_rivals(
    problem: Problem | Body, progress: ProgressCallback
) -> tuple[Truths, list[dict[str, Any]]]:
    """Solve a problem on all its meshes.

    Parameters
    ----------
    problem : Problem or Body
        Problem.
    progress : callable
        Called with every line of progress.

    Returns
    -------
    truths : Truths
        Limit of the meshes.
    rivals : list of dict
        Of each mesh `size`, `probes` (empty where the iteration failed), `dofs`, `cpu_s` and
        `outcome`.
    """
    if isinstance(problem, Body):
        deck = read_deck(box_tables(problem))
    else:
        deck = read_deck(sized_tables(problem.tables, problem.sizes[0]))
    size = deck["geometry"].get("size")
    kinds = {entry["name"]: probe_kind(entry, size) for entry in deck["probe"]}
    rivals = []
    for count in problem.elements:
        progress(f"{problem.name}: finite elements, {lattice_text(count)}")
        found = _finite_elements(problem, deck, count)
        rivals.append({**found, "size": lattice_text(count)})
    limits = _limits([rival["probes"] for rival in rivals if rival["probes"]])
    return Truths(kinds, limits), rivals


def sized_tables(tables: Mapping[str, Any], size: Sequence[int]) -> dict[str, Any]:
    """Deck with its source points, and collocation points at half their spacing."""
    places = {"source": list(size), "collocation": [2 * n - 1 for n in size]}
    return {**tables, "geometry": {**tables["geometry"], **places}}


def lattice_text(count: Sequence[int]) -> str:
    """Numbers along the edges as tables show them."""
    return " x ".join(str(n) for n in count)


def _sized(problem: Problem | Body, size: Any) -> tuple[str, dict[str, Any], PointCloud | None]:
    """Name, deck and points of a size."""
    if isinstance(problem, Body):
        return f"voxels {size:g}", dict(problem.tables), body_cloud(problem, size)
    return lattice_text(size), sized_tables(problem.tables, size), None


def _look(
    look: Look | None, tables: Mapping[str, Any], seen: dict[str, Any], folder: Path
) -> dict[str, Any]:
    """Keep what is seen in the folder of a solve."""
    if look is not None:
        seen |= look(tables, folder)
    return {}


def _record(case: dict[str, Any]) -> dict[str, Any]:
    """What the table keeps of a solve in a process of its own."""
    verdict = case.get("verdict") or {"state": "refused", "reasons": [case["message"]]}
    kept = ("cpu_s", "iterations", "min_J", "max_J", "work_mismatch", "companion")
    return {
        **{key: case.get(key) for key in kept},
        "unknowns": case.get("dofs"),
        "memory": case.get("memory_peak_bytes"),
        "outcome": outcome_text(case),
        "verdict": verdict["state"],
        "reasons": verdict["reasons"],
        "probes": case.get("probes") or {},
        "bars": case.get("probe_errors") or {},
    }


def _timed_solve(
    tables: Mapping[str, Any], words: Sequence[str], cloud: PointCloud | None
) -> Callable[[], dict[str, Any]]:
    """A solve in this process on one thread, without time where it fails."""

    def solve() -> dict[str, Any]:
        begin = time.process_time()
        try:
            with Scene.from_tables(tables, cloud, overrides=words, threads=1) as scene:
                states = scene.solve(error=False)
                values = scene.probes(states.x[-1:], states.load[-1:])[0, :, 0]
                unknowns = scene.dofs
        except MyorkError as error:
            return {"probes": {}, "unknowns": None, "cpu_s": None, "outcome": str(error)}
        names = [entry["name"] for entry in tables["probe"]]
        return {
            "cpu_s": time.process_time() - begin,
            "probes": dict(zip(names, values.tolist(), strict=True)),
            "unknowns": unknowns,
            "iterations": int(states.iterations.sum()),
            "outcome": "converged",
        }

    return solve


def _own_time(solve: Callable[[], Mapping[str, Any]]) -> float | None:
    """CPU time of a solve [s]."""
    seconds: float | None = solve()["cpu_s"]
    return seconds


def _times(first: float | None, again: Callable[[], float | None] | None) -> dict[str, Any]:
    """Least time of a solve and how much longer the longest took, after some repeats."""
    if again is None:
        return {"cpu_s": first}
    times = [] if first is None else [first]
    while times and sum(times) < _ENOUGH and len(times) < _MOST:
        times.append(again() or times[0])
    if not times:
        return {"cpu_s": None, "spread": None}
    return {"cpu_s": min(times), "spread": max(times) / min(times) - 1.0}


def _peer_time(problem: Problem | Body, mesh: tuple[int, ...]) -> Callable[[], float | None]:
    """CPU time of one mesh, solved again [s]."""
    one: Problem | Body = problem._replace(elements=(mesh,))  # type: ignore[arg-type]

    def solve() -> float | None:
        seconds: float | None = solve_rivals(one, lambda line: None)[1][0]["cpu_s"]
        return seconds

    return solve


def _finite_elements(
    problem: Problem | Body, deck: Mapping[str, Any], count: Sequence[int]
) -> dict[str, Any]:
    """Last values of the probes, empty where the iteration failed."""
    body = problem if isinstance(problem, Body) else None
    try:
        rival = solve_deck(
            deck, count, labels=body.part if body else None, warp=body.warp if body else None
        )
    except ConvergenceError as error:
        return {"probes": {}, "dofs": None, "cpu_s": None, "outcome": str(error)}
    probes = {name: values[-1] for name, values in rival["probes"].items()}
    return {**rival, "probes": probes, "outcome": "converged"}


def _limits(found: Sequence[Mapping[str, float]]) -> dict[str, Truth]:
    """Limit of the meshes: Aitken's where the changes shrink, otherwise the finest value."""
    truths = {}
    for name in found[-1] if found else ():
        values = [probes[name] for probes in found]
        last = values[-1]
        change = last - values[-2] if len(values) > 1 else abs(last)
        doubt = abs(change)
        if len(values) > 2:
            before = values[-2] - values[-3]
            if change * before > 0.0 and abs(change) < 0.7 * abs(before):
                rest = change * change / (before - change)
                last, doubt = last + rest, abs(rest)
        truths[name] = Truth(last, doubt)
    return truths


def _exact(problem: Problem | Body, truths: Truths) -> Truths:
    """Of a tube the exact values: the cut carries what presses on the bore."""
    if isinstance(problem, Body) or problem.tables["geometry"]["kind"] != "annulus":
        return truths
    deck = read_deck(sized_tables(problem.tables, problem.sizes[0]))
    wall = inner_stress(deck)
    moved = next(entry["radial"] for entry in deck["boundary"] if entry.get("radial") is not None)
    known = {"wall": wall, "force": wall * (deck["geometry"]["inner_radius"] + moved)}
    exact = {name: Truth(value, 1e-8 * abs(value)) for name, value in known.items()}
    return truths._replace(values={**truths.values, **exact})
