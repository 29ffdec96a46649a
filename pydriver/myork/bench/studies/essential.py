"""Prescribed displacements by the penalty and by the transformation method, side by side.

The problems of `bench trust` with held sides, solved with the penalty of the defaults, with one a
hundred times as large, and with values that hold exactly at source points. felupe solves the same
problems, and the limit of its three meshes is the truth. What is missed is the largest
|u - g| on held sides of boxes, at source points and at the places half way between them, of the
source spacing: the transformation has none at the first, the penalty little at both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from myork.bench.runs import outcome_text, solve_case
from myork.bench.tables import Columns, table
from myork.bench.truths import lattice_text, sized_tables, solve_rivals
from myork.console import ProgressCallback
from myork.reference.problems import PROBLEMS, Problem
from myork.results import Results

__all__ = ["run"]

#: Ways to hold: name and overrides
_WAYS = (
    ("penalty", ()),
    ("penalty, a hundred times", ("galerkin.penalty=1e4",)),
    ("transformation", ("galerkin.essential=transformation",)),
)
_NAMES = (
    "cantilever, dead traction",
    "clamped beam, end shear",
    "near shear",
    "tube",
    "cube between plates",
    "inclined block",
)
#: Wall time of one solve [s]
_LIMIT = 300.0
_COLUMNS: Columns = (
    ("points", "size"),
    ("held by", "method"),
    ("outcome", "outcome"),
    ("displacement", "error displacement"),
    ("force", "error force"),
    ("stress inside", "error stress"),
    ("at the surface", "error surface stress"),
    ("smallest J", "min_J"),
    ("largest J", "max_J"),
    ("missed at points", "missed at points"),
    ("between them", "missed between"),
    ("iterations", "iterations"),
    ("CPU [s]", "cpu_s"),
)


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all problems; see `myork.bench` for the result."""
    problems = [problem for problem in PROBLEMS if problem.name in _NAMES]
    cases: list[dict[str, Any]] = []
    for problem in problems[1:3] if quick else problems:
        cases += _cases(problem, progress, problem.sizes[:1] if quick else problem.sizes[:2])
    names = dict.fromkeys(case["problem"] for case in cases)
    return {
        "title": "Penalty and transformation",
        "about": __doc__.split("\n\n")[1].replace("\n", " "),
        "cases": cases,
        "tables": [
            table(
                f"{name}: largest relative error of a kind of probe",
                _COLUMNS,
                [case for case in cases if case["problem"] == name],
            )
            for name in names
        ],
    }


def _cases(
    problem: Problem, progress: ProgressCallback, sizes: Sequence[tuple[int, ...]]
) -> list[dict[str, Any]]:
    """A problem at these sizes, held in every way."""
    truths, _ = solve_rivals(problem, progress)
    cases = []
    for size in sizes:
        tables = sized_tables(problem.tables, size)
        for name, words in _WAYS:
            progress(f"{problem.name}: {name}, {lattice_text(size)}")
            case = solve_case(tables, words, limit=_LIMIT, look=partial(_missed, tables))
            errors = truths.errors(case.get("probes") or {}, {})
            cases.append(
                {
                    "problem": problem.name,
                    "method": name,
                    "size": lattice_text(size),
                    "unknowns": case.get("dofs"),
                    "outcome": outcome_text(case),
                    **{
                        key: case.get(key)
                        for key in ("cpu_s", "iterations", "min_J", "max_J", *_MISSED)
                    },
                    **errors,
                }
            )
    return cases


_MISSED = ("missed at points", "missed between")


def _missed(tables: Mapping[str, Any], folder: Path) -> dict[str, float]:
    """Largest |u - g| on the held sides of a box, of the source spacing, at full load."""
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
