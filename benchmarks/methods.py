"""Collocation (RKCM) beside the Galerkin form (RKPM): the same decks, both discretisations.

Tables 5.2 and 5.3 of Basava (2015) again with the error of each method, the stress fields of
figures 5.13 and 5.17, the muscle block of figure 5.30, and speed against error. Errors on the
sheet are differences from felupe's finite elements, solved in this run, so that neither of the
two methods is judged by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.truths.finite_elements import solve_deck
from benchmarks.truths.measures import oscillation
from myork.bench.curves import Choice, block_cases, choice, sweep, tube_cases
from myork.bench.materials import along_fibers
from myork.bench.runs import (
    PUBLISHED_BLOCK,
    lattice,
    outcome_text,
    read_deck,
    seconds,
    solve_case,
)
from myork.bench.tables import Columns, plane_map, speed_plot, speed_table, table
from myork.console import ProgressCallback
from myork.results import Results

__all__ = ["run"]

_LIMIT = 120.0
_SHEET = "shear_2d"
# As many as the slowest method needs; the reference stops after two iterations
_SHEET_STEPS = 2
_RAMP = (f"load.steps={_SHEET_STEPS}",)
_ELEMENTS = ((16, 4), (32, 8), (64, 16))
#: Source points of tables 5.2 and 5.3 and their unknowns, as the published numbers are keyed
_TABLES = {"5.2": (17, 5), "5.3": (65, 17)}


# Error of a case from its record and its overrides
_Error = Callable[[dict[str, Any], list[str]], float]


class _Method(NamedTuple):
    """A row of the tables."""

    name: str
    choice: Choice
    overrides: tuple[str, ...] = ()


_BALANCED = ("solver.weight_essential=balanced", "solver.weight_traction=balanced")
_AS_PUBLISHED = ("solver.linear=dgels", "solver.newton=gauss-newton")
_ROWS = (
    _Method("RKCM as published: QR", (2, 3.0, "rkcm"), _AS_PUBLISHED),
    _Method("RKCM, published weights", (2, 3.0, "rkcm")),
    _Method("RKCM, weights of MyoRK", (2, 3.0, "rkcm"), _BALANCED),
    _Method("RKCM-mixed", (2, 3.0, "rkcm-mixed")),
    _Method("RKPM, 5 Gauss points, quadratic", (2, 3.0, "rkpm-gauss"), ("galerkin.gauss=5",)),
    _Method("RKPM, 5 Gauss points, linear", (1, 2.0, "rkpm-gauss"), ("galerkin.gauss=5",)),
    _Method("RKPM, 2 Gauss points, linear", (1, 2.0, "rkpm-gauss")),
    _Method("RKPM-SCNI, linear", (1, 2.0, "rkpm-scni")),
)
_FIELDS = (
    _Method("RKCM", (2, 3.0, "rkcm")),
    _Method("RKCM-mixed", (2, 3.0, "rkcm-mixed")),
    _Method("RKPM, Gauss, quadratic", (2, 3.0, "rkpm-gauss")),
    _Method("RKPM, Gauss, linear", (1, 2.0, "rkpm-gauss")),
    _Method("RKPM-SCNI, linear", (1, 2.0, "rkpm-scni")),
)
#: Deck of a figure, component of the stress that it shows, and source points: those of the
#: reference, and more where a refined solution is another one
_FIGURES = {
    "5.13": ("shear_3d", (0, 1), ((9, 3, 3), (17, 5, 3))),
    "5.17": ("uniaxial_compression", (0, 0), ((9, 3, 3),)),
}
# Without kinks of the passive curve, on which every fiber of the straight block sits
_SMOOTH = (*PUBLISHED_BLOCK, "load.steps=4", 'material.curve="smooth"')
#: Methods with source points on an edge; the mixed form's matrix is the largest by far
_BLOCKS = (
    (_FIELDS[0], (5, 7, 9)),
    (_FIELDS[1], (5, 6, 7)),
    (_FIELDS[3], (5, 7, 9)),
    (_FIELDS[4], (5, 7, 9)),
)

_COMMON: tuple[Choice, ...] = ((2, 3.0, "rkcm"), (2, 3.0, "rkcm-mixed"))
_LINEAR: tuple[Choice, ...] = ((1, 2.0, "rkpm-gauss"), (1, 2.0, "rkpm-scni"))
_QUADRATIC: tuple[Choice, ...] = ((2, 3.0, "rkpm-gauss"), (2, 3.0, "rkpm-scni"))
_TUBE: tuple[Choice, ...] = (*_COMMON, (4, 6.0, "rkcm"), (4, 6.0, "rkcm-mixed"), *_QUADRATIC)
_TUBE_SIZES = ((5, 26), (9, 51))
_SHEAR: tuple[Choice, ...] = (*_COMMON, *_LINEAR, (2, 3.0, "rkpm-gauss"))
_SHEAR_SIZES = ((9, 3), (17, 5), (33, 9), (65, 17))
_INCLINED: tuple[Choice, ...] = (*_COMMON, (4, 5.0, "rkcm-mixed"))
_SIZES = ((5, 5, 9), (6, 6, 11))
_GALERKIN_SIZES = ((5, 5, 9), (7, 7, 13))


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve everything; see `myork.bench` for the result."""
    deck = read_deck(_SHEET)
    progress("felupe, sheet")
    loads = [(step + 1) / _SHEET_STEPS for step in range(_SHEET_STEPS)]
    sheets = []
    for n in _ELEMENTS:
        sheet = solve_deck(deck, n, loads=loads, tolerance=1e-9)
        values = {name: values[-1] for name, values in sheet["probes"].items()}
        kept = ("dofs", "iterations", "cpu_s", "seconds")
        sheets.append({**values, **{key: sheet[key] for key in kept}})
    finest = sheets[-1]["shear_stress"]
    wanted = _limit([sheet["shear_stress"] for sheet in sheets])

    def error(case: dict[str, Any], _: list[str]) -> float:
        return float(abs(case["probes"]["shear_stress"] / wanted - 1.0))

    tables = {"5.2": _TABLES["5.2"]} if quick else _TABLES
    performance = {name: _performance(progress, name, n, error) for name, n in tables.items()}
    fields = {name: _figure(progress, name, quick) for name in _FIGURES}
    agreement = [
        _block(progress, method, n)
        for method, edges in _BLOCKS
        for n in edges[: 1 if quick else None]
    ]
    sizes = _SHEAR_SIZES[: 2 if quick else None]
    shear = sweep(progress, _SHEET, _SHEAR, sizes, _RAMP, error, limit=_LIMIT)
    # the collocation's points on these bodies are in small in the benchmark `curves`
    count = 1 if quick else None
    tube = tube_cases(progress, _QUADRATIC if quick else _TUBE, _TUBE_SIZES[:count], _LIMIT)
    straight, inclined = [], []
    if not quick:
        straight = block_cases(progress, "muscle_block", _COMMON, _SIZES, _LIMIT)
        inclined = block_cases(progress, "muscle_fibers", _INCLINED, _SIZES, _LIMIT)
    galerkin = _GALERKIN_SIZES[:count]
    straight += block_cases(progress, "muscle_block", _LINEAR, galerkin, _LIMIT)
    inclined += block_cases(progress, "muscle_fibers", _LINEAR, galerkin, _LIMIT)
    curves = {
        "Sheared sheet: shear stress in the middle": shear,
        "Tube: radial stress at the inner surface": tube,
        "Muscle block, straight fibers: axial stress in the middle": straight,
        "Muscle block, fibers inclined 30°: largest error of six probes": inclined,
    }
    return {
        "title": "Collocation beside the Galerkin form",
        "about": "The same decks by both discretisations, one thread; published times are beside "
        "ours in `myork reproduce 5.2 5.3`. Times are of a whole solve in "
        f"{_SHEET_STEPS} load steps, and of two of its iterations. Errors on the sheet are against "
        f"the limit {wanted:.6g} of felupe's quadratic elements on three meshes, the finest "
        f"of which is {abs(finest / wanted - 1.0):.1e} from it; errors below that say nothing.",
        "rival": sheets,
        "cases": [
            *(case for cases in performance.values() for case in cases),
            *(case for cases in fields.values() for case in cases),
            *agreement,
            *(case for cases in curves.values() for case in cases),
        ],
        "plots": [speed_plot(title, cases) for title, cases in curves.items()],
        "maps": [entry for cases in fields.values() for case in cases for entry in case["maps"]],
        "tables": [
            *(_performance_table(name, cases) for name, cases in performance.items()),
            *(_figure_table(name, cases) for name, cases in fields.items()),
            _block_table(agreement),
            *(speed_table(title, cases) for title, cases in curves.items()),
        ],
    }


def _limit(values: Sequence[float]) -> float:
    """Limit of three values that approach it geometrically (Aitken)."""
    first, second = np.diff(values)
    return float(values[2] + second**2 / (first - second))


def _performance(
    progress: ProgressCallback, name: str, source: tuple[int, int], error: _Error
) -> list[dict[str, Any]]:
    """The rows of table 5.2 or 5.3."""
    cases = []
    for method in _ROWS:
        progress(f"table {name}  {method.name}")
        words = [*lattice(source), *choice(method.choice), *method.overrides, *_RAMP]
        case = solve_case(_SHEET, words, limit=_LIMIT)
        if case["outcome"] == "converged":
            case["error"] = error(case, words)
        cases.append(case | {"name": method.name})
    return cases


def _performance_table(name: str, cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    source = _TABLES[name]
    return table(
        f"Table {name}: sheet of {source[0]} x {source[1]} source points to 100 % "
        "shear; error of the shear stress in the middle",
        _TIMES,
        cases,
    )


def _two_iterations(case: Mapping[str, Any]) -> float | None:
    """Time of shape functions and two iterations [s]."""
    spent, iterations = case.get("timings_s"), case.get("iterations")
    if not (spent and iterations):
        return None
    return float(spent["shape"] + 2 * (spent["assemble"] + spent["solve"]) / iterations)


_TIMES: Columns = (
    ("method", "name"),
    ("unknowns", "dofs"),
    ("shape [s]", "timings_s.shape"),
    ("assembly [s]", "timings_s.assemble"),
    ("solution [s]", "timings_s.solve"),
    ("total [s]", seconds),
    ("iterations", "iterations"),
    ("two iterations [s]", _two_iterations),
    ("error", "error"),
    ("outcome", outcome_text),
)


def _figure(progress: ProgressCallback, name: str, quick: bool) -> list[dict[str, Any]]:
    """Stress fields of figure 5.13 or 5.17."""
    deck, component, sizes = _FIGURES[name]
    cases = []
    for source in sizes[: 1 if quick else None]:
        size = " x ".join(str(n) for n in source)
        for method in _FIELDS:
            progress(f"figure {name}  {method.name}, {size}")
            look = _look(component, f"Figure {name}, {method.name}, {size}")
            words = [*lattice(source), *choice(method.choice)]
            case = solve_case(deck, words, limit=_LIMIT, look=look)
            cases.append({"maps": [], **case, "name": method.name, "size": size})
    return cases


def _look(component: tuple[int, int], title: str) -> Callable[[Path], dict[str, Any]]:
    """Reader of a stress on the middle line along x and on the middle plane across z."""

    def look(folder: Path) -> dict[str, Any]:
        with Results(folder) as results:
            x = results.points
            stress = results.field("cauchy")[:, component[0], component[1]]
        low, high = x.min(axis=0), x.max(axis=0)
        middle = 0.5 * (low + high)
        plane = np.isclose(x[:, 2], middle[2])
        line = np.flatnonzero(plane & np.isclose(x[:, 1], middle[1]))
        line = line[np.argsort(x[line, 0])]
        inner = line[abs(x[line, 0] - middle[0]) <= 0.2501 * (high[0] - low[0])]
        label = f"Cauchy stress {'xyz'[component[0]]}{'xyz'[component[1]]} [N/cm²]"
        return {
            "line": stress[line].tolist(),
            "oscillation": oscillation(stress[line]),
            "oscillation_inner": oscillation(stress[inner]),
            "range": [float(stress.min()), float(stress.max())],
            "maps": [plane_map(title, label, x[plane, :2], stress[plane])],
        }

    return look


def _exact(key: str) -> Callable[[Mapping[str, Any]], float | None]:
    """Entry about the only probe that has an exact solution."""

    def entry(case: Mapping[str, Any]) -> float | None:
        found: list[Mapping[str, float]] = [*case.get("exact", {}).values()]
        return found[0].get(key) if found else None

    return entry


_STRESSES: Columns = (
    ("method", "name"),
    ("source points", "size"),
    ("middle [N/cm²]", _exact("value")),
    ("error", _exact("relative_error")),
    ("least in the body", lambda case: case["range"][0] if "range" in case else None),
    ("largest", lambda case: case["range"][1] if "range" in case else None),
    ("oscillation", "oscillation"),
    ("oscillation, middle half", "oscillation_inner"),
    ("outcome", outcome_text),
)


def _figure_table(name: str, cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return table(
        f"Figure {name}: stress in the middle against the exact solution of an endless "
        "body, and its largest second difference along the middle line over its mean",
        _STRESSES,
        cases,
    )


def _block(progress: ProgressCallback, method: _Method, edge: int) -> dict[str, Any]:
    """The block of figure 5.30 with straight fibers at full activation."""
    source = (edge, edge, 2 * edge - 1)
    progress(f"figure 5.30  {method.name}, {edge}")
    words = [*lattice(source), *choice(method.choice), *_SMOOTH]
    case = solve_case("muscle_block", words, limit=_LIMIT)
    case |= {"name": method.name, "size": " x ".join(str(n) for n in source)}
    deck = read_deck("muscle_block", words)
    case["solution"] = along_fibers(deck["material"][0], 1.0, deck["load"]["activation"])
    return case


def _block_table(cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Stress and reaction, and how far they are from those of RKPM at the largest size."""
    known = [case for case in cases if case["outcome"] == "converged"]
    last = known[-1]["probes"] if known else {}

    def apart(probe: str) -> Callable[[Mapping[str, Any]], float | None]:
        return lambda case: (
            case["probes"][probe] / last[probe] - 1.0 if probe in case.get("probes", {}) else None
        )

    columns: Columns = (
        ("method", "name"),
        ("source points", "size"),
        ("unknowns", "dofs"),
        ("stress zz [N/cm²]", "probes.stress_zz"),
        ("reaction [N]", "probes.reaction"),
        ("stress from the last row", apart("stress_zz")),
        ("reaction from the last row", apart("reaction")),
        ("time [s]", seconds),
        ("outcome", outcome_text),
    )
    return table(
        "Figure 5.30: muscle block with straight fibers at full activation, smooth "
        f"curves; far from the ends the stress is {cases[0]['solution']:.6g} N/cm²",
        columns,
        cases,
    )
