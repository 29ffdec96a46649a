"""How far the error bars hold: their coverage and sharpness on problems that did not choose them.

Boxes of three proportions under loads of four kinds, each at two sizes and in two forms, against
finite elements (felupe) on two meshes in the same run. A probe is covered where its error is within
its bar and the doubt of the reference; sharpness is the bar over the error, where that is above
twice this doubt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from myork.bench.runs import lattice, read_deck, solve_case
from myork.bench.tables import Columns, table
from myork.console import ProgressCallback
from myork.reference.finite_elements import solve_deck

__all__ = ["run"]

_FORMS = ("rkpm-gauss", "rkcm-mixed")
#: Length of a box of height 1, and its source points
_BODIES = (
    (1.5, ((9, 7), (17, 13))),
    (3.0, ((13, 5), (25, 9))),
    (6.0, ((25, 5), (49, 9))),
)
_HELD = {"set": "x0", "u_x": 0, "u_y": 0}
#: What the far end carries, of the shear modulus 10 and of the length
_LOADS: dict[str, Any] = {
    "pulled by its end": lambda length: {"u_x": 0.25 * length, "u_y": 0},
    "pressed by a traction": lambda length: {"traction": [-4.0, 0]},
    "sheared with its end upright": lambda length: {"u_x": 0, "u_y": 0.3},
    "bent by a traction": lambda length: {"traction": [0, 0.6 / length**2]},
}
_COLUMNS: Columns = (
    ("form", "method"),
    ("probes", "kind"),
    ("pairs", "pairs"),
    ("covered [%]", "covered"),
    ("bar over error, median", "median"),
    ("10 %", "low"),
    ("90 %", "high"),
)
_VERDICTS: Columns = (
    ("form", "method"),
    ("verdict", "verdict"),
    ("answers", "answers"),
    ("median of the largest error [%]", "median"),
    ("largest [%]", "largest"),
)


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all problems; see `myork.bench` for the result."""
    cases: list[dict[str, Any]] = []
    bodies = _BODIES[1:2] if quick else _BODIES
    for number, (length, sizes) in enumerate(bodies):
        for name, load in list(_LOADS.items())[: 2 if quick else None]:
            progress(f"body {number + 1}/{len(bodies)}  {length:g} x 1 {name}")
            cases += _problem(f"{length:g} x 1 {name}", _tables(length, load(length)), sizes)
    rows = [
        _row(cases, method, kind) for method in _FORMS for kind in (None, "u", "force", "cauchy")
    ]
    return {
        "title": "Error bars",
        "about": __doc__.split("\n\n")[1].replace("\n", " "),
        "cases": cases,
        "coverage": {row["method"]: row["covered"] / 100.0 for row in rows if row["kind"] == "all"},
        "sharpness": {row["method"]: row["median"] for row in rows if row["kind"] == "all"},
        "tables": [
            table("Bars of the probes against their errors.", _COLUMNS, rows),
            table("Errors by verdict.", _VERDICTS, _by_verdict(cases)),
        ],
    }


def _tables(length: float, load: Mapping[str, Any]) -> dict[str, Any]:
    """A box held at one end; probes at nodes of the meshes, away from corners."""
    middle = [0.5 * length + 0.125, 0.25]
    return {
        "title": "Box",
        "scene": {"dimension": 2},
        "geometry": {"kind": "box", "size": [length, 1.0], "source": [5, 5], "collocation": [9, 9]},
        "material": [{"name": "soft", "model": "neo-hookean", "mu": 10.0, "K": 400.0}],
        "boundary": [_HELD, {"set": "x1", **load}],
        "load": {"steps": 2},
        "probe": [
            {"name": "u_x", "quantity": "u_x", "point": [0.75 * length, 0.75]},
            {"name": "u_y", "quantity": "u_y", "point": [0.75 * length, 0.75]},
            {"name": "force_x", "quantity": "force_x", "set": "x0"},
            {"name": "force_y", "quantity": "force_y", "set": "x0"},
            {"name": "cauchy_xx", "quantity": "cauchy_xx", "point": middle},
            {"name": "cauchy_xy", "quantity": "cauchy_xy", "point": middle},
        ],
    }


def _problem(
    name: str, tables: Mapping[str, Any], sizes: Sequence[tuple[int, int]]
) -> list[dict[str, Any]]:
    """One problem by both forms at both sizes."""
    deck = read_deck(tables)
    across = 8
    along = round(across * deck["geometry"]["size"][0])
    coarse, fine = (
        {
            probe: values[-1]
            for probe, values in solve_deck(deck, [k * along, k * across])["probes"].items()
        }
        for k in (1, 2)
    )
    # the error of the finer mesh, if it falls with the square of the size at least
    doubt = {probe: abs(fine[probe] - coarse[probe]) / 3 for probe in fine}
    cases = []
    for method in _FORMS:
        for size in sizes:
            words = (f"scene.method={method}", *lattice(size))
            case = solve_case(tables, words, limit=120.0, error=True)
            probes, bars = case.get("probes", {}), case.get("probe_errors", {})
            cases.append(
                {
                    "problem": name,
                    "method": method,
                    "size": "x".join(str(n) for n in size),
                    "unknowns": case.get("dofs"),
                    "cpu_s": case.get("cpu_s"),
                    "outcome": case["outcome"],
                    "verdict": case.get("verdict", {}).get("state", "refused"),
                    "error": {probe: abs(probes[probe] - fine[probe]) for probe in probes},
                    "bar": bars,
                    "companion": case.get("companion"),
                    "doubt": doubt,
                    "truth": fine,
                }
            )
    return cases


def _row(cases: Sequence[Mapping[str, Any]], method: str, kind: str | None) -> dict[str, Any]:
    """Coverage and sharpness of one form and kind of probe."""
    held, sharp = [], []
    for case in cases:
        if case["method"] != method:
            continue
        for probe, bar in case["bar"].items():
            if kind is not None and not probe.startswith(kind + "_"):
                continue
            error, doubt = case["error"][probe], case["doubt"][probe]
            held.append(error <= bar + doubt)
            if error > 2 * doubt and error > 1e-9 * max(map(abs, case["truth"].values())):
                sharp.append(bar / error)
    low, median, high = np.percentile(sharp, (10, 50, 90)) if sharp else [np.nan] * 3
    return {
        "method": method,
        "kind": kind or "all",
        "pairs": len(held),
        "covered": 100.0 * float(np.mean(held)) if held else None,
        "median": float(median),
        "low": float(low),
        "high": float(high),
    }


def _by_verdict(cases: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Errors of displacements and stresses, of the largest of their kind, by verdict."""
    rows = []
    for method in _FORMS:
        for verdict in ("accepted", "doubtful", "refused"):
            among = [c for c in cases if (c["method"], c["verdict"]) == (method, verdict)]
            off = [100.0 * _largest(case) for case in among if case["error"]]
            rows.append(
                {
                    "method": method,
                    "verdict": verdict,
                    "answers": len(among),
                    "median": float(np.median(off)) if off else None,
                    "largest": max(off, default=None),
                }
            )
    return rows


def _largest(case: Mapping[str, Any]) -> float:
    """Largest error of a probe, of the largest value of its kind."""
    found = 0.0
    for kind in ("u", "force", "cauchy"):
        names = [name for name in case["error"] if name.startswith(kind + "_")]
        size = max(abs(case["truth"][name]) for name in names)
        found = max(found, max(case["error"][name] for name in names) / size)
    return found
