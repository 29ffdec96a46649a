"""CPU time for a wanted error: MyoRK and finite elements, one after the other in this run.

Each problem is solved by both at rising sizes, one load step to the full load, without error bars.
The truth is exact on the tube, elsewhere the limit of the three finest meshes. The time for an
error is read off the work-precision curve between the last size that misses it and the next one, so
that no lucky size counts; beyond the finest size nothing is extrapolated. Errors below what is not
known of the truth have no line. felupe's time is that of set-up and solution in a process that has
imported it; MyoRK's is that of the whole process, reading the deck and writing the results
included. Short solves are repeated, and the least time counts.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from myork.bench.runs import read_deck
from myork.bench.tables import Columns, plot, table
from myork.bench.truths import Truth, Truths, lattice_text, sized_tables, solve_rivals
from myork.console import ProgressCallback, silent
from myork.core.scene import Scene
from myork.errors import MyorkError
from myork.records import PointCloud
from myork.reference.exact import inner_stress
from myork.reference.problems import PROBLEMS, Problem
from myork.reference.voxel_bodies import BODIES, Body, body_cloud

__all__ = ["cost", "run"]

#: Errors whose time is wanted [-]
_ERRORS = (1e-2, 1e-3, 1e-4)
_SMALLEST = 1e-6
#: Solves are repeated until they have taken so much together, at most so often [s], [-]
_ENOUGH, _MOST = 1.0, 3
#: Forms of MyoRK: name and overrides
_FORMS = (
    ("default", ()),
    ("order 1", ("approximation.order=1",)),
    ("order 2", ("approximation.order=2",)),
)

_SHEETS = ((5, 3), (9, 3), (17, 5), (33, 9), (65, 17))
# probes lie at quarters of the height
_SHEET_MESHES = ((4, 4), (8, 4), (16, 4), (32, 8), (64, 16))
_TUBES = ((3, 9), (3, 14), (5, 26), (7, 38), (9, 51), (17, 101), (25, 151))
_TUBE_MESHES = ((1, 4), (2, 8), (4, 16), (8, 32), (16, 64), (32, 128))
_BLOCKS = ((3, 3, 5), (5, 5, 9), (7, 7, 13), (9, 9, 17))
_BLOCK_MESHES = ((2, 2, 4), (4, 4, 8), (6, 6, 12))
_CUBES = ((3, 3, 3), (5, 5, 5), (7, 7, 7), (9, 9, 9))
_CUBE_MESHES = ((2, 2, 2), (4, 4, 4), (6, 6, 6))


class Entry(NamedTuple):
    """A problem of the race.

    Attributes
    ----------
    problem : Problem or Body
        With its sizes and meshes.
    forms : tuple of str
        Names of the forms that are tried.
    lines : tuple of str
        What is compared: kinds of probes, of which the largest error counts, or single probes.
    """

    problem: Problem | Body
    forms: tuple[str, ...]
    lines: tuple[str, ...]


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all problems; see `myork.bench` for the result."""
    cases: list[dict[str, Any]] = []
    races: list[dict[str, Any]] = []
    _warm_up()
    for entry in _entries(quick):
        own, truths = _cases(entry, progress)
        cases += own
        races += [race for line in entry.lines for race in _races(entry, line, own, truths)]
        ratios = [f"{race['ratio']:.2g}" for race in races if race["ratio"]]
        progress(f"{entry.problem.name}: ratios so far {', '.join(ratios)}")
    return {
        "title": "CPU time for a wanted error",
        "about": __doc__.split("\n\n")[1].replace("\n", " "),
        "cases": cases,
        "races": races,
        "tables": [
            _race_table(races),
            *(_case_table(name, cases) for name in dict.fromkeys(c["problem"] for c in cases)),
        ],
        "plots": [
            _plot(entry.problem.name, line, cases)
            for entry in _entries(quick)
            for line in entry.lines
        ],
    }


def cost(cases: Sequence[Mapping[str, Any]], key: str, error: float) -> float | None:
    """CPU time for an error, none where the finest size misses it.

    Parameters
    ----------
    cases : sequence of mapping
        Solves with `cpu_s` and errors.
    key : str
        The error of a case.
    error : float
        Wanted error [-].
    """
    points = sorted(
        (float(case["cpu_s"]), max(float(case[key]), 1e-300))
        for case in cases
        if case.get("cpu_s") and case.get(key) is not None and math.isfinite(case[key])
    )
    missed = [k for k, (_, found) in enumerate(points) if found > error]
    last = max(missed, default=-1)
    if last == len(points) - 1:
        return None
    if last == -1:
        return points[0][0]
    (low, above), (high, below) = points[last : last + 2]
    share = math.log(above / error) / math.log(above / below)
    return low * (high / low) ** share


def _entries(quick: bool) -> Iterator[Entry]:
    """Problems of `bench trust` at the sizes of this one."""
    known: dict[str, Problem] = {problem.name: problem for problem in PROBLEMS}

    def sized(
        name: str, sizes: tuple[tuple[int, ...], ...], meshes: tuple[tuple[int, ...], ...]
    ) -> Problem:
        return known[name]._replace(
            sizes=sizes[1:4] if quick else sizes, elements=meshes[:4] if quick else meshes
        )

    # probes at the surface make order 2 the default in the plane
    plane, solid = ("default", "order 1"), ("default", "order 2")
    both = ("displacement", "force")
    yield Entry(sized("tube", _TUBES, _TUBE_MESHES), plane, ("force", "wall"))
    yield Entry(sized("near shear", _SHEETS, _SHEET_MESHES), plane, both)
    if quick:
        return
    yield Entry(sized("tube, K = 1e7", _TUBES, _TUBE_MESHES), plane, ("force", "wall"))
    yield Entry(
        sized("cantilever, dead traction", _SHEETS, _SHEET_MESHES),
        plane,
        ("displacement", "surface stress"),
    )
    yield Entry(sized("inclined block", _BLOCKS, _BLOCK_MESHES), solid, both)
    yield Entry(sized("straight block", _BLOCKS, _BLOCK_MESHES), solid, ("force", "stress"))
    yield Entry(_torsion(known["twist"]), solid, both)
    yield Entry(sized("cube between plates", _CUBES, _CUBE_MESHES), solid, both)
    yield Entry(
        next(body for body in BODIES if body.name == "three tissues of voxels"),
        ("default",),
        both,
    )


def _torsion(twist: Problem) -> Problem:
    """The bar of the problem `twist`, turned half as far."""
    boundary = [
        {**held, "rotation": 90.0} if "rotation" in held else held
        for held in twist.tables["boundary"]
    ]
    return twist._replace(
        name="torsion by 90 degrees",
        tables={**twist.tables, "boundary": boundary},
        sizes=((3, 3, 7), (5, 5, 9), (5, 5, 13), (7, 7, 19)),
        elements=((2, 2, 8), (4, 4, 8), (4, 4, 12)),
    )


def _warm_up() -> None:
    """Let felupe import what it needs: that is no part of a solution."""
    tube = next(problem for problem in PROBLEMS if problem.name == "tube")
    solve_rivals(tube._replace(elements=((1, 4),)), silent)


def _cases(entry: Entry, progress: ProgressCallback) -> tuple[list[dict[str, Any]], Truths]:
    """Solves of a problem by both."""
    problem = entry.problem
    truths, rivals = solve_rivals(problem, progress)
    truths = _exact(problem, truths)
    cases = []
    for mesh, rival in zip(problem.elements, rivals, strict=True):
        times = _times(rival["cpu_s"], partial(_rival_time, problem, mesh))
        cases.append(
            {
                "problem": problem.name,
                "method": "felupe",
                "rival": True,
                "size": rival["size"],
                "unknowns": rival["dofs"],
                "outcome": rival["outcome"],
                **times,
                **_errors(truths, rival["probes"]),
            }
        )
    for name, words in _FORMS:
        if name not in entry.forms:
            continue
        for size, tables, cloud in _sizes(problem):
            progress(f"{problem.name}: {name}, {size}")
            solve = partial(_solve, tables, words, cloud)
            case = solve()
            times = _times(case["cpu_s"], partial(_own_time, solve))
            cases.append(
                {
                    "problem": problem.name,
                    "method": name,
                    "size": size,
                    **case,
                    **times,
                    **_errors(truths, case["probes"]),
                }
            )
    return cases, truths


def _solve(
    tables: Mapping[str, Any], words: Sequence[str], cloud: PointCloud | None
) -> dict[str, Any]:
    """One solve in this process, on one thread; without time where it failed."""
    begin = time.process_time()
    try:
        with Scene.from_tables(tables, cloud, overrides=words, threads=1) as scene:
            states = scene.solve(error=False)
            values = scene.probes(states.x[-1:], states.load[-1:])[0, :, 0]
            unknowns = scene.dofs
    except MyorkError as error:
        return {"probes": {}, "unknowns": None, "cpu_s": None, "outcome": str(error)}
    seconds = time.process_time() - begin
    names = [entry["name"] for entry in tables["probe"]]
    return {
        "probes": dict(zip(names, values.tolist(), strict=True)),
        "unknowns": unknowns,
        "iterations": int(states.iterations.sum()),
        "cpu_s": seconds,
        "outcome": "converged",
    }


def _rival_time(problem: Problem | Body, mesh: tuple[int, ...]) -> float | None:
    """CPU time of one mesh again [s]."""
    one: Problem | Body = problem._replace(elements=(mesh,))  # type: ignore[arg-type]
    seconds: float | None = solve_rivals(one, silent)[1][0]["cpu_s"]
    return seconds


def _own_time(solve: Callable[[], Mapping[str, Any]]) -> float | None:
    """CPU time of a solve [s]."""
    seconds: float | None = solve()["cpu_s"]
    return seconds


def _sizes(
    problem: Problem | Body,
) -> Iterator[tuple[str, Mapping[str, Any], PointCloud | None]]:
    """Name, deck and points of each size."""
    sizes: tuple[Any, ...] = problem.sizes
    for size in sizes:
        if isinstance(problem, Body):
            yield f"voxels {size:g}", problem.tables, body_cloud(problem, size)
        else:
            yield lattice_text(size), sized_tables(problem.tables, size), None


def _times(first: float | None, again: Callable[[], float | None]) -> dict[str, Any]:
    """Least time of a solve and how much longer the longest took, after some repeats."""
    times = [] if first is None else [first]
    while times and sum(times) < _ENOUGH and len(times) < _MOST:
        times.append(again() or times[0])
    if not times:
        return {"cpu_s": None, "spread": None}
    return {"cpu_s": min(times), "spread": max(times) / min(times) - 1.0}


def _exact(problem: Problem | Body, truths: Truths) -> Truths:
    """Of a tube the exact values: the cut carries what presses on the bore."""
    if problem.tables["geometry"]["kind"] != "annulus":
        return truths
    sizes: tuple[Any, ...] = problem.sizes
    deck = read_deck(sized_tables(problem.tables, sizes[0]))
    wall = inner_stress(deck)
    moved = next(entry["radial"] for entry in deck["boundary"] if entry.get("radial") is not None)
    known = {"wall": wall, "force": wall * (deck["geometry"]["inner_radius"] + moved)}
    exact = {name: Truth(value, 1e-8 * abs(value)) for name, value in known.items()}
    return truths._replace(values={**truths.values, **exact})


def _errors(truths: Truths, probes: Mapping[str, float]) -> dict[str, Any]:
    """Errors by kind and by probe."""
    found = truths.errors(probes, {})
    return {**found, **{f"error {name}": value for name, value in found["error"].items()}}


def _doubt(line: str, truths: Truths) -> float:
    """What is not known of the truth of a line [-]."""
    return max(
        truth.doubt / abs(truth.value)
        for name, truth in truths.values.items()
        if line in (name, truths.kinds[name])
    )


def _races(
    entry: Entry, line: str, cases: Sequence[Mapping[str, Any]], truths: Truths
) -> Iterator[dict[str, Any]]:
    """Times for each error that the truth can tell."""
    key = f"error {line}"
    doubt = _doubt(line, truths)
    smallest = (_SMALLEST,) if line == "force" and "tube" in entry.problem.name else ()
    for error in (*_ERRORS, *smallest):
        peer = cost([case for case in cases if case.get("rival")], key, error)
        own = {
            name: seconds
            for name in entry.forms
            if (seconds := cost([case for case in cases if case["method"] == name], key, error))
        }
        best = min(own, key=lambda name: own[name], default=None) if own else None
        known = error >= 2.0 * doubt
        yield {
            "problem": entry.problem.name,
            "line": line,
            "error": error,
            "doubt": doubt,
            "method": best if known else None,
            "cpu_s": own[best] if best and known else None,
            "peer": "felupe",
            "peer_cpu_s": peer if known else None,
            "ratio": own[best] / peer if best and peer and known else None,
            "outcome": _outcome(known, bool(own), bool(peer)),
        }


def _outcome(known: bool, own: bool, peer: bool) -> str:
    """Who got there."""
    if not known:
        return "truth not known so well"
    if own and peer:
        return "both"
    return "MyoRK only" if own else "felupe only" if peer else "neither"


def _race_table(races: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    columns: Columns = (
        ("problem", "problem"),
        ("of", "line"),
        ("error", "error"),
        ("truth known to", "doubt"),
        ("form", "method"),
        ("CPU [s]", "cpu_s"),
        ("felupe [s]", "peer_cpu_s"),
        ("ratio", "ratio"),
        ("reached by", "outcome"),
    )
    below = sum(race["ratio"] is not None and race["ratio"] < 1.0 for race in races)
    count = sum(race["ratio"] is not None for race in races)
    return table(
        f"CPU time for an error: below 1 on {below} of {count} lines that both reach",
        columns,
        races,
    )


def _case_table(name: str, cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    columns: Columns = (
        ("form", "method"),
        ("size", "size"),
        ("unknowns", "unknowns"),
        ("iterations", "iterations"),
        ("CPU [s]", "cpu_s"),
        ("spread", "spread"),
        ("displacement", "error displacement"),
        ("force", "error force"),
        ("stress", "error stress"),
        ("surface stress", "error surface stress"),
        ("outcome", "outcome"),
    )
    return table(
        f"{name}: relative errors", columns, [case for case in cases if case["problem"] == name]
    )


def _plot(name: str, line: str, cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Work-precision curves."""
    own = [
        {**case, "curve": case["method"]}
        for case in cases
        if case["problem"] == name and case["cpu_s"] and case.get(f"error {line}")
    ]
    axes = ("CPU time [s]", f"relative error: {line} [-]")
    return plot(f"{name}: {line}", axes, own, "cpu_s", f"error {line}")
