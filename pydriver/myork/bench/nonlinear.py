"""All nonlinear problems of Basava (2015), section 5.3.10, in both formulations.

Errors are taken against the exact solution for the bulk modulus of the deck and, where one exists,
against the incompressible closed form with which the reference compares.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from myork.bench import exact
from myork.bench.materials import along_fibers
from myork.bench.runs import (
    METHODS,
    PUBLISHED_BLOCK,
    lattice,
    outcome_text,
    read_deck,
    solve_case,
)
from myork.bench.tables import Columns, table
from myork.console import ProgressCallback

__all__ = ["run"]

# Value of a problem from its deck, with a bulk modulus in place of the deck's where given
_Solution = Callable[[dict[str, Any], float | None], float]


class _Problem(NamedTuple):
    """A problem: its deck, the probe that is compared, and its solution for a material."""

    name: str
    deck: str
    probe: str
    overrides: tuple[str, ...]
    solution: _Solution
    note: str = ""
    mixed_only: bool = False


def _of(function: Callable[[exact.Polynomial, float], float], amount: float) -> _Solution:
    """Solution of a homogeneous problem from the deck."""
    return lambda deck, bulk: function(
        exact.Polynomial.from_deck(deck["material"][0], bulk), amount
    )


def _fixed_fibers(deck: dict[str, Any], bulk: float | None) -> float:
    """Axial stress of a muscle block far from its fixed ends, where fibers keep their length."""
    table, activation = deck["material"][0], deck["load"]["activation"]
    if bulk is not None:
        # no volume can change: the active stress alone, against sides free of stress
        return float(table["sigma_max"] * activation)
    return along_fibers(table, 1.0, activation)


_BLOCK = (*lattice((5, 5, 9)), "load.activation=0.5", "load.steps=5", *PUBLISHED_BLOCK)

_PROBLEMS = (
    _Problem(
        "shear, gamma = 5",
        "shear_3d",
        "shear_stress",
        (),
        _of(exact.simple_shear, 5.0),
        "exact solution of the infinitely wide block; the block has free ends",
    ),
    _Problem("uniaxial tension, 6", "uniaxial_tension", "stress", (), _of(exact.uniaxial, 6.0)),
    _Problem(
        "uniaxial compression, 0.1", "uniaxial_compression", "stress", (), _of(exact.uniaxial, 0.1)
    ),
    _Problem("equibiaxial, 2", "equibiaxial", "stress", (), _of(exact.equibiaxial, 2.0)),
    _Problem("dilation, 6", "dilation", "stress", (), _of(exact.dilation, 6.0)),
    _Problem("tube, K = 1e3", "tube", "radial_stress", (), exact.inner_stress),
    _Problem("tube, K = 1e7", "tube", "radial_stress", ("material.K=1e7",), exact.inner_stress),
    _Problem("tube, K = 1e10", "tube", "radial_stress", ("material.K=1e10",), exact.inner_stress),
    _Problem(
        "tube, K infinite",
        "tube",
        "radial_stress",
        ("material.K=inf",),
        exact.inner_stress,
        mixed_only=True,
    ),
    _Problem(
        "muscle block, straight fibers",
        "muscle_block",
        "stress_zz",
        _BLOCK,
        _fixed_fibers,
        "exact solution far from the fixed ends; every fiber sits on a kink of the passive curve",
    ),
    _Problem(
        "the same, smooth curves",
        "muscle_block",
        "stress_zz",
        (*_BLOCK, 'material.curve="smooth"'),
        _fixed_fibers,
        "exact solution far from the fixed ends",
    ),
)
_QUICK = {
    "shear_3d": lattice((5, 3, 3)),
    "equibiaxial": lattice((5, 5, 3)),
    "dilation": lattice((4, 4, 4)),
    "tube": (*lattice((5, 26)), "load.steps=12"),
    "muscle_block": (*lattice((4, 4, 7)), "load.steps=2"),
}
_COLUMNS: Columns = (
    ("problem", "name"),
    ("method", "method"),
    ("outcome", outcome_text),
    ("unknowns", "dofs"),
    ("value [N/cm²]", "value"),
    ("exact", "solution"),
    ("error", "error"),
    ("incompressible", "incompressible"),
    ("error", "error_incompressible"),
    ("iterations", "iterations"),
    ("J", lambda case: [case.get("min_J"), case.get("max_J")]),
    ("solver", "solver.used"),
    ("time [s]", lambda case: case.get("timings_s", {}).get("total", case["seconds"])),
)


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all problems with both methods; see `myork.bench` for the result."""
    cases = []
    for number, problem in enumerate(_PROBLEMS):
        progress(f"problem {number + 1}/{len(_PROBLEMS)}  {problem.name}")
        for method in METHODS[1:] if problem.mixed_only else METHODS:
            cases.append(_case(problem, method, quick))
    return {
        "title": "Nonlinear problems",
        "about": "Problems of Basava (2015), section 5.3.10, at full load, one thread. The error "
        "is that of the stress probe against the exact solution for the bulk modulus of the deck "
        "and against the incompressible closed form.",
        "cases": cases,
        "tables": [table("Stress at full load against exact solutions.", _COLUMNS, cases)],
    }


def _case(problem: _Problem, method: str, quick: bool) -> dict[str, Any]:
    """One problem with one method."""
    small = _QUICK.get(problem.deck, ()) if quick else ()
    overrides = [*problem.overrides, *small, f"scene.method={method}"]
    case = solve_case(problem.deck, overrides, limit=120.0 if quick else 900.0)
    deck = read_deck(problem.deck, overrides)
    case["name"], case["method"], case["note"] = problem.name, method, problem.note
    case["solution"] = problem.solution(deck, None)
    if problem.deck != "dilation":
        case["incompressible"] = problem.solution(deck, float("inf"))
    if case["outcome"] == "converged":
        case["value"] = case["probes"][problem.probe]
        case["error"] = abs(case["value"] / case["solution"] - 1.0)
        if "incompressible" in case:
            case["error_incompressible"] = abs(case["value"] / case["incompressible"] - 1.0)
    return case
