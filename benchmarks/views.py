"""Views of the runner's rows: which answers to trust, at what cost, and beside whom."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.problems import BY_NAME, DECKS, PROBLEMS, Problem
from benchmarks.runner import KINDS, WRONG, Form, Truths, rows_of, solve_rivals
from benchmarks.truths.deck_parts import deck, force, held, probe
from benchmarks.voxel_bodies import BODIES, Body
from myork.bench.tables import Columns, plot, table
from myork.console import ProgressCallback, silent
from myork.results import Results

__all__ = ["certify", "cost", "essential", "newcomer", "race", "trust"]

Rows = Sequence[Mapping[str, Any]]

_STATES = ("accepted", "doubtful", "refused")
_FORMS: tuple[Form, ...] = (
    ("auto", ()),
    ("rkpm-scni", ("scene.method=rkpm-scni",)),
    ("rkcm-mixed", ("scene.method=rkcm-mixed",)),
    ("rkcm", ("scene.method=rkcm",)),
)
#: What `auto` should be within of finite elements [-]
_NEAR = 0.01


def _names(rows: Rows) -> list[str]:
    return list(dict.fromkeys(row["problem"] for row in rows))


def _of(rows: Rows, **wanted: Any) -> list[Mapping[str, Any]]:
    """Rows with these values."""
    return [row for row in rows if all(row.get(key) == value for key, value in wanted.items())]


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None


def _mean(ratios: Sequence[float]) -> float | None:
    """Geometric mean."""
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else None


def _is_right(row: Mapping[str, Any]) -> bool:
    """Within 5 % in all probes, the doubt of the truth allowed for; what failed is not."""
    return row["off"] is not None and row["off"] <= WRONG


def _wrong_and_accepted(rows: Rows) -> int:
    return sum(row.get("verdict") == "accepted" and not _is_right(row) for row in rows)


def _bar_counts(rows: Rows) -> tuple[int, int]:
    """Bars that contain the error, and all of them."""
    counts = [row["held"].split() for row in rows if row["held"]]
    return sum(int(words[0]) for words in counts), sum(int(words[2]) for words in counts)


def _work_precision(name: str, line: str, rows: Rows) -> dict[str, Any]:
    """Error over CPU time, a curve a form."""
    own = [
        {**row, "curve": row["method"]}
        for row in rows
        if row["problem"] == name and row["cpu_s"] and row.get(f"error {line}")
    ]
    axes = ("CPU time [s]", f"relative error: {line} [-]")
    return plot(f"{name}: {line}", axes, own, "cpu_s", f"error {line}")


# ---- trust -------------------------------------------------------------------------------------


def trust(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Which answers can be trusted: every form on problems of a new user."""
    rows: list[dict[str, Any]] = []
    for problem in PROBLEMS[:2] if quick else PROBLEMS + BODIES:
        _, own = rows_of(problem, _trust_forms(problem), progress, sizes=1 if quick else None)
        rows += own
        progress(f"{problem.name}: {_wrong_and_accepted(own)} wrong and accepted")
    plots = [
        _work_precision(name, kind, rows)
        for name in _names(rows)
        for kind in ("displacement", "force")
    ]
    return {
        "title": "Which answers can be trusted",
        "about": "Each problem as it stands, which `auto` solves, and by each other form, at "
        "three sizes, and each body of voxels at two, from label maps. An answer that is more than "
        f"{WRONG:.0%} off and accepted is a fault of the verdict.",
        "cases": rows,
        "tables": [
            _verdict_table(rows),
            _near_table(rows),
            *(_problem_table(name, rows) for name in _names(rows)),
            _end_table(rows),
        ],
        "plots": [drawn for drawn in plots if drawn["series"]],
    }


def _trust_forms(problem: Problem | Body) -> Callable[[Any], Sequence[Form]]:
    """Forms of each size: collocation, whose cost grows fastest, at fewer sizes."""
    first, last = problem.sizes[0], problem.sizes[-1]

    def forms(size: Any) -> Sequence[Form]:
        if isinstance(problem, Body):
            return _FORMS[:3] if size == first else _FORMS[:1]
        if len(problem.sizes[0]) == 3 and size == last:
            return _FORMS[:2]
        return _FORMS

    return forms


def _verdict_table(rows: Rows) -> dict[str, Any]:
    """How often each verdict was right."""
    heads = [f"{key} {state}" for key in ("right", "wrong") for state in _STATES]
    counted = []
    for name, _ in _FORMS:
        counts = Counter(
            f"{'right' if _is_right(row) else 'wrong'} {row['verdict']}"
            for row in _of(rows, method=name)
        )
        counted.append({"form": name, **dict.fromkeys(heads, 0), **counts})
    columns: Columns = (
        ("form", "form"),
        *((head, head) for head in heads),
    )
    return table(
        f"Verdicts: right is within {WRONG:.0%} of the truth in all probes, the truth's own "
        "doubt allowed for; what failed is wrong and refused",
        columns,
        counted,
    )


def _near(rows: Rows) -> list[dict[str, Any]]:
    """The finest answer of `auto` to each problem and the cheapest mesh with no larger error."""
    found = []
    for name in _names(rows):
        own, meshes = _of(rows, problem=name, method="auto"), _of(rows, problem=name, rival=True)
        for kind in ("displacement", "force"):
            key = f"error {kind}"
            done = [row for row in own if row[key] is not None]
            if not done:
                continue
            best = done[-1]
            times = [m["cpu_s"] for m in meshes if m[key] is not None and m[key] <= best[key]]
            cheapest = min(times, default=None)
            known = cheapest is not None and best["cpu_s"] is not None
            near, peer_near = (
                min(
                    (row["cpu_s"] for row in among if row[key] is not None and row[key] <= _NEAR),
                    default=None,
                )
                for among in (own, meshes)
            )
            found.append(
                {
                    "problem": name,
                    "kind": kind,
                    "size": best["size"],
                    "error": best[key],
                    "within": best[key] <= _NEAR,
                    "cpu_s": best["cpu_s"],
                    "peer_cpu_s": cheapest,
                    "ratio": best["cpu_s"] / cheapest if known else None,
                    "near_cpu_s": near,
                    "peer_near_cpu_s": peer_near,
                }
            )
    return found


def _near_table(rows: Rows) -> dict[str, Any]:
    """Errors and costs of `auto` and of finite elements."""
    columns: Columns = (
        ("problem", "problem"),
        ("of", "kind"),
        ("source points", "size"),
        ("error", "error"),
        (f"within {_NEAR:.0%}", "within"),
        ("CPU [s]", "cpu_s"),
        ("felupe, no larger error [s]", "peer_cpu_s"),
        ("ratio", "ratio"),
        (f"CPU for {_NEAR:.0%} [s]", "near_cpu_s"),
        (f"felupe for {_NEAR:.0%} [s]", "peer_near_cpu_s"),
    )
    return table(
        "`auto` at its finest size against the cheapest mesh with no larger error; empty where "
        "no mesh had one",
        columns,
        _near(rows),
    )


def _end_table(rows: Rows) -> dict[str, Any]:
    """Sums of the run."""
    found = _near(rows)
    ratios = [entry["ratio"] for entry in found if entry["ratio"]]
    near = [
        entry["near_cpu_s"] / entry["peer_near_cpu_s"]
        for entry in found
        if entry["near_cpu_s"] and entry["peer_near_cpu_s"]
    ]
    held, bars = _bar_counts(_of(rows, method="auto"))
    judged = sum(not row.get("rival") for row in rows)
    within = sum(entry["within"] for entry in found)
    sums = {
        f"wrong and accepted, of {judged} answers": _wrong_and_accepted(rows),
        f"`auto` within {_NEAR:.0%} at its finest size, of {len(found)}": within,
        f"bars of `auto` that contain the error, of {bars}": held,
        "their median over the error": _sharpness(_of(rows, method="auto"))[1],
        f"CPU of `auto` over felupe's at no larger error, mean of {len(ratios)}": _mean(ratios),
        "the largest such ratio": max(ratios, default=None),
        f"the same for {_NEAR:.0%}, mean of {len(near)}": _mean(near),
        "the largest of these": max(near, default=None),
        "answers of `auto` nearer than any mesh": sum(not entry["ratio"] for entry in found),
    }
    return _sum_table(sums)


def _sum_table(sums: Mapping[str, Any]) -> dict[str, Any]:
    lines = [{"of": name, "is": value} for name, value in sums.items()]
    return table("Sums", (("of", "of"), ("is", "is")), lines)


def _problem_table(name: str, rows: Rows) -> dict[str, Any]:
    """All solves of a problem."""
    columns: Columns = (
        ("form", "method"),
        ("size", "size"),
        ("unknowns", "unknowns"),
        ("CPU [s]", "cpu_s"),
        *((f"error, {kind}", f"error {kind}") for kind in KINDS),
        *((f"bar, {kind}", f"bar {kind}") for kind in KINDS),
        ("bars that contain it", "held"),
        ("work", "work_mismatch"),
        ("verdict", "verdict"),
        ("outcome", "outcome"),
    )
    own = _of(rows, problem=name)
    doubts = [max(row["doubt"].values()) for row in own if row["doubt"]]
    doubt = f"; the truth is known to {max(doubts):.1g}" if doubts else ""
    return table(f"{name}: largest relative errors and bars of their kinds{doubt}", columns, own)


# ---- newcomer ----------------------------------------------------------------------------------


def newcomer(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Twenty decks of a new user as they stand: which converge, and which verdicts are right."""
    cases = []
    for problem in DECKS[:2] if quick else DECKS:
        _, rows = rows_of(problem, _FORMS[:1], progress, sizes=1)
        row = rows[-1]
        worst = max(row["error"], key=row["error"].get, default=None)
        right = _is_right(row) == (row["verdict"] == "accepted")
        cases.append(
            {
                **row,
                "peer_cpu_s": rows[-2]["cpu_s"],
                "right": "yes" if right else "no",
                "worst": worst,
                "worst error": row["error"].get(worst),
                "its bar": row["bar"].get(worst),
                "known to": row["doubt"].get(worst),
            }
        )
        progress(f"{problem.name}: {row['verdict']}, right: {cases[-1]['right']}")
    columns: Columns = (
        ("problem", "problem"),
        ("points", "size"),
        ("unknowns", "unknowns"),
        ("CPU [s]", "cpu_s"),
        ("felupe's finest [s]", "peer_cpu_s"),
        ("outcome", "outcome"),
        ("error", "worst error"),
        ("its bar", "its bar"),
        ("of probe", "worst"),
        ("truth known to", "known to"),
        ("bars that contain it", "held"),
        ("verdict", "verdict"),
        ("right", "right"),
    )
    held, bars = _bar_counts(cases)
    sums = {
        "decks": len(cases),
        "converged": len(_of(cases, outcome="converged")),
        "verdicts right": len(_of(cases, right="yes")),
        "wrong and accepted": _wrong_and_accepted(cases),
        "bars that contain the error": held,
        "bars": bars,
        "median bar over error": _sharpness(cases)[1],
    }
    return {
        "title": "Twenty decks of a new user",
        "about": "Only the body, its materials, what holds and moves it and the number of points "
        f"are named. A verdict is right where an answer within {WRONG:.0%} in all probes is "
        "accepted, or one farther off is doubtful or refused.",
        "cases": cases,
        "tables": [
            table("The largest relative error of each, and its verdict", columns, cases),
            _sum_table(sums),
        ],
    }


# ---- certify -----------------------------------------------------------------------------------

_CERTIFIED: tuple[Form, ...] = (
    ("rkpm-gauss", ("scene.method=rkpm-gauss",)),
    ("rkcm-mixed", ("scene.method=rkcm-mixed",)),
)
#: Length of a box of height 1, and its source points
_BOXES = (
    (1.5, ((9, 7), (17, 13))),
    (3.0, ((13, 5), (25, 9))),
    (6.0, ((25, 5), (49, 9))),
)
#: What the far end carries, of the shear modulus 10 and of the length
_LOADS: Mapping[str, Callable[[float], dict[str, Any]]] = {
    "pulled by its end": lambda length: {"u_x": 0.25 * length, "u_y": 0},
    "pressed by a traction": lambda length: {"traction": [-4.0, 0]},
    "sheared with its end upright": lambda length: {"u_x": 0, "u_y": 0.3},
    "bent by a traction": lambda length: {"traction": [0, 0.6 / length**2]},
}


def certify(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Coverage and sharpness of error bars on boxes that chose no default."""
    rows: list[dict[str, Any]] = []
    for length, sizes in _BOXES[1:2] if quick else _BOXES:
        for name, load in list(_LOADS.items())[: 2 if quick else None]:
            problem = _certified_box(f"{length:g} x 1 {name}", length, load(length), sizes)
            rows += [row for row in rows_of(problem, _CERTIFIED, progress)[1]]
    own = [row for row in rows if not row.get("rival")]
    shown = [
        _coverage(own, method, kind) for method, _ in _CERTIFIED for kind in (None, *KINDS[:3])
    ]
    sums = [entry for entry in shown if entry["kind"] == "all"]
    by_verdict = [
        {
            "method": method,
            "verdict": verdict,
            "answers": len(among),
            "median": _median([100 * max(row["error"].values()) for row in among if row["error"]]),
        }
        for method, _ in _CERTIFIED
        for verdict in _STATES
        for among in [_of(own, method=method, verdict=verdict)]
    ]
    return {
        "title": "Error bars",
        "about": "Boxes of three proportions under loads of four kinds, each at two sizes and in "
        "two forms. A probe is covered where its error is within its bar and the doubt of the "
        "reference; sharpness is the bar over the error, where that is above twice this doubt.",
        "cases": own,
        "coverage": {e["method"]: e["covered"] / 100.0 for e in sums if e["covered"] is not None},
        "sharpness": {entry["method"]: entry["median"] for entry in sums},
        "tables": [
            table(
                "Bars of the probes against their errors",
                (
                    ("form", "method"),
                    ("probes", "kind"),
                    ("pairs", "pairs"),
                    ("covered [%]", "covered"),
                    ("bar over error, median", "median"),
                    ("10 %", "low"),
                    ("90 %", "high"),
                ),
                shown,
            ),
            table(
                "Largest error of a probe by verdict",
                (
                    ("form", "method"),
                    ("verdict", "verdict"),
                    ("answers", "answers"),
                    ("median of the largest error [%]", "median"),
                ),
                by_verdict,
            ),
        ],
    }


def _certified_box(
    name: str, length: float, load: Mapping[str, Any], sizes: tuple[tuple[int, ...], ...]
) -> Problem:
    """A box clamped at one end; probes at nodes of the meshes, away from corners."""
    point, middle = (0.75 * length, 0.75), (0.5 * length + 0.125, 0.25)
    tables = deck(
        name,
        {"kind": "box", "size": [length, 1.0]},
        ({"name": "soft", "model": "neo-hookean", "mu": 10.0, "K": 400.0},),
        (held("x0", 2), {"set": "x1", **load}),
        (
            probe("u_x", "u_x", point),
            probe("u_y", "u_y", point),
            force("force_x", "x", "x0"),
            force("force_y", "y", "x0"),
            probe("cauchy_xx", "cauchy_xx", middle),
            probe("cauchy_xy", "cauchy_xy", middle),
        ),
    )
    tables["load"]["steps"] = 2
    elements = tuple((round(n * length), n) for n in (8, 16, 32))
    return Problem(name, tables, sizes, elements)


def _sharpness(rows: Rows, names: Sequence[str] | None = None) -> tuple[Any, Any, Any]:
    """Bar over error where that is above twice the truth's doubt: 10 %, median, 90 %."""
    ratios = [
        row["bar"][name] / row["error"][name]
        for row in rows
        for name in row["bar"]
        if (names is None or name in names) and row["error"][name] > 2 * row["doubt"][name]
    ]
    return tuple(np.percentile(ratios, (10, 50, 90)).tolist()) if ratios else (None,) * 3


def _coverage(rows: Rows, method: str, kind: str | None) -> dict[str, Any]:
    """Coverage and sharpness of one form and kind of probe."""
    starts = {"displacement": "u_", "force": "force_", "stress": "cauchy_"}
    among = _of(rows, method=method)
    names = {n for row in among for n in row["bar"] if kind is None or n.startswith(starts[kind])}
    covered = [
        row["error"][n] <= row["bar"][n] + row["doubt"][n]
        for row in among
        for n in row["bar"]
        if n in names
    ]
    low, median, high = _sharpness(among, sorted(names))
    return {
        "method": method,
        "kind": kind or "all",
        "pairs": len(covered),
        "covered": 100.0 * float(np.mean(covered)) if covered else None,
        "median": median,
        "low": low,
        "high": high,
    }


# ---- essential ---------------------------------------------------------------------------------

_WAYS: tuple[Form, ...] = (
    ("penalty", ()),
    ("penalty, a hundred times", ("galerkin.penalty=1e4",)),
    ("transformation", ("galerkin.essential=transformation",)),
)
_PRESCRIBED = (
    "cantilever, dead traction",
    "clamped beam, end shear",
    "near shear",
    "tube",
    "cube between plates",
    "inclined block",
)
_MISSED = ("missed at points", "missed between")


def essential(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Prescribed displacements by the penalty and by the transformation method."""
    problems = [BY_NAME[name] for name in _PRESCRIBED]
    rows: list[dict[str, Any]] = []
    for problem in problems[1:3] if quick else problems:
        _, own = rows_of(
            problem, _WAYS, progress, sizes=1 if quick else 2, error=False, look=_missed
        )
        rows += [row for row in own if not row.get("rival")]
    columns: Columns = (
        ("points", "size"),
        ("prescribed by", "method"),
        ("outcome", "outcome"),
        *((kind, f"error {kind}") for kind in KINDS),
        ("smallest J", "min_J"),
        ("largest J", "max_J"),
        *((name, name) for name in _MISSED),
        ("iterations", "iterations"),
        ("CPU [s]", "cpu_s"),
    )
    return {
        "title": "Penalty and transformation",
        "about": "Problems with prescribed displacements, with the default penalty, with one a "
        "hundred times as large, and with values that are exact at source points. Missed: the "
        "largest |u - g| on these sides of boxes, at source points and half way between them, of "
        "the source spacing.",
        "cases": rows,
        "tables": [
            table(f"{name}: largest relative error of a kind", columns, _of(rows, problem=name))
            for name in _names(rows)
        ],
    }


def _missed(tables: Mapping[str, Any], folder: Path) -> dict[str, float]:
    """Largest |u - g| on the prescribed sides of a box, of the source spacing, at full load."""
    geometry = tables["geometry"]
    if geometry["kind"] != "box":
        return {}
    edges = np.array(geometry["size"], float)
    spacing = edges / (np.array(geometry["source"]) - 1)
    with Results(folder) as results:
        points = results.points[:, : len(edges)]
        u = results.field("u")
    offset = np.abs(points / spacing - np.round(points / spacing))
    at_source = (offset < 1e-6).all(axis=1)
    missed = {True: 0.0, False: 0.0}
    for entry in tables["boundary"]:
        axis = "xyz".index(entry["set"][0])
        on = np.isclose(points[:, axis], edges[axis] * int(entry["set"][1]), atol=1e-9)
        for i, name in enumerate("xyz"[: len(edges)]):
            if f"u_{name}" not in entry:
                continue
            away = np.abs(u[:, i] - entry[f"u_{name}"]) / spacing.min()
            for key in missed:
                most = float(away[on & (at_source == key)].max(initial=0.0))
                missed[key] = max(missed[key], most)
    return dict(zip(_MISSED, (missed[True], missed[False]), strict=True))


# ---- race --------------------------------------------------------------------------------------

#: Errors whose time is wanted [-]
_ERRORS = (1e-2, 1e-3, 1e-4)
_SMALLEST = 1e-6
_RACERS: tuple[Form, ...] = (
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
_TWISTS = ((3, 3, 7), (5, 5, 9), (5, 5, 13), (7, 7, 19))
_TWIST_MESHES = ((2, 2, 8), (4, 4, 8), (4, 4, 12))


class _Entry(NamedTuple):
    """A problem of the race: its forms, and the kinds of probes or single probes compared."""

    problem: Problem | Body
    forms: tuple[str, ...]
    lines: tuple[str, ...]


def race(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """CPU time for a wanted error: MyoRK and finite elements, one after the other."""
    rows: list[dict[str, Any]] = []
    races: list[dict[str, Any]] = []
    entries = list(_entries(quick))
    # felupe imports what it needs: that is no part of a solution
    solve_rivals(BY_NAME["tube"]._replace(elements=((1, 4),)), silent)
    for entry in entries:
        forms = [form for form in _RACERS if form[0] in entry.forms]
        truths, own = rows_of(entry.problem, forms, progress, timed=True)
        rows += own
        races += [found for line in entry.lines for found in _races(entry, line, own, truths)]
        ratios = [f"{found['ratio']:.2g}" for found in races if found["ratio"]]
        progress(f"{entry.problem.name}: ratios so far {', '.join(ratios)}")
    shown: Columns = (
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
    each: Columns = (
        ("form", "method"),
        ("size", "size"),
        ("unknowns", "unknowns"),
        ("iterations", "iterations"),
        ("CPU [s]", "cpu_s"),
        ("spread", "spread"),
        *((kind, f"error {kind}") for kind in KINDS),
        ("outcome", "outcome"),
    )
    known = [found["ratio"] for found in races if found["ratio"] is not None]
    below = sum(ratio < 1.0 for ratio in known)
    return {
        "title": "CPU time for a wanted error",
        "about": "Each problem by both at rising sizes, one load step to the full load, without "
        "error bars. The time for an error is read off the work-precision curve between the last "
        "size that misses it and the next one, so that no lucky size counts; beyond the finest "
        "size nothing is extrapolated. Errors below what is not known of the truth have no line.",
        "cases": rows,
        "races": races,
        "tables": [
            table(
                f"CPU time for an error: below 1 on {below} of {len(known)} lines that both reach",
                shown,
                races,
            ),
            *(
                table(f"{name}: relative errors", each, _of(rows, problem=name))
                for name in _names(rows)
            ),
        ],
        "plots": [
            _work_precision(entry.problem.name, line, rows)
            for entry in entries
            for line in entry.lines
        ],
    }


def cost(rows: Rows, key: str, error: float) -> float | None:
    """CPU time for an error; `None` where the finest size misses it.

    Parameters
    ----------
    rows : sequence of mapping
        Solves with `cpu_s` and errors.
    key : str
        The error of a row.
    error : float
        Wanted error [-].
    """
    points = sorted(
        (float(row["cpu_s"]), max(float(row[key]), 1e-300))
        for row in rows
        if row.get("cpu_s") and row.get(key) is not None and math.isfinite(row[key])
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


def _entries(quick: bool) -> Iterator[_Entry]:
    """Problems of `trust` at the sizes of the race."""

    def sized(
        name: str, sizes: tuple[tuple[int, ...], ...], meshes: tuple[tuple[int, ...], ...]
    ) -> Problem:
        return BY_NAME[name]._replace(
            sizes=sizes[1:4] if quick else sizes, elements=meshes[:4] if quick else meshes
        )

    # probes at the surface make order 2 the default in the plane
    plane, solid = ("default", "order 1"), ("default", "order 2")
    both = ("displacement", "force")
    yield _Entry(sized("tube", _TUBES, _TUBE_MESHES), plane, ("force", "wall"))
    yield _Entry(sized("near shear", _SHEETS, _SHEET_MESHES), plane, both)
    if quick:
        return
    yield _Entry(sized("tube, K = 1e7", _TUBES, _TUBE_MESHES), plane, ("force", "wall"))
    cantilever = sized("cantilever, dead traction", _SHEETS, _SHEET_MESHES)
    yield _Entry(cantilever, plane, ("displacement", "surface stress"))
    yield _Entry(sized("inclined block", _BLOCKS, _BLOCK_MESHES), solid, both)
    yield _Entry(sized("straight block", _BLOCKS, _BLOCK_MESHES), solid, ("force", "stress"))
    twist = sized("twist", _TWISTS, _TWIST_MESHES)
    half = [{**end, "rotation": 90.0} if "rotation" in end else end
            for end in twist.tables["boundary"]]  # fmt: skip
    torsion = twist._replace(
        name="torsion by 90 degrees", tables={**twist.tables, "boundary": half}
    )
    yield _Entry(torsion, solid, both)
    yield _Entry(sized("cube between plates", _CUBES, _CUBE_MESHES), solid, both)
    yield _Entry(BY_NAME["three tissues of voxels"], ("default",), both)


def _races(entry: _Entry, line: str, rows: Rows, truths: Truths) -> Iterator[dict[str, Any]]:
    """Times for each error that the truth can resolve."""
    key = f"error {line}"
    doubt = max(
        truth.doubt / abs(truth.value)
        for name, truth in truths.values.items()
        if line in (name, truths.kinds[name])
    )
    smallest = (_SMALLEST,) if line == "force" and "tube" in entry.problem.name else ()
    for error in (*_ERRORS, *smallest):
        peer = cost(_of(rows, rival=True), key, error)
        costs = {name: cost(_of(rows, method=name), key, error) for name in entry.forms}
        own = {name: seconds for name, seconds in costs.items() if seconds}
        best = min(own, key=lambda name: own[name], default=None)
        known = error >= 2.0 * doubt
        reached = {(1, 1): "both", (1, 0): "MyoRK only", (0, 1): "felupe only"}
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
            "outcome": reached.get((bool(own), bool(peer)), "neither")
            if known
            else "truth not known so well",
        }
