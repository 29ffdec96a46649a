"""Manufactured solutions: observed orders of displacement and stress, strong and weak forms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.truths.manufactured import PROBLEMS, Problem, solve
from benchmarks.truths.measures import observed_order
from myork.bench.runs import METHODS
from myork.bench.tables import Columns, plot, table
from myork.console import ProgressCallback

__all__ = ["run"]

#: Problems of the Galerkin form, with linear and quadratic functions
_WEAK = ("rkpm-gauss", "rkpm-scni")
_SOFT = tuple(
    Problem(f"2-D, K = 50, order {order}", 2, (50.0, 50.0), order, support, (9, 17, 33))
    for order, support in ((1, 2.0), (2, 3.0))
)
_COLUMNS: Columns = (
    ("problem", "name"),
    ("method", "method"),
    ("points an edge", "source_per_edge"),
    ("unknowns", "dofs"),
    ("outcome", "outcome"),
    ("error of u", "u_error"),
    ("order", "u_order"),
    ("error of stress", "stress_error"),
    ("order", "stress_order"),
    ("iterations", "iterations"),
    ("time [s]", "seconds"),
)


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all problems at all sizes; see `myork.bench` for the result."""
    cases: list[dict[str, Any]] = []
    # those in space take ten times as long
    runs = [(problem, METHODS) for problem in PROBLEMS] + [(one, _WEAK) for one in _SOFT]
    runs = runs[: 2 if quick else None]
    for number, (problem, methods) in enumerate(runs):
        progress(f"problem {number + 1}/{len(runs)}  {problem.name}")
        for method in methods:
            own: list[dict[str, Any]] = []
            for n in problem.sizes[: 2 if quick else None]:
                own.append(solve(problem, method, n) | {"curve": f"{problem.name}, {method}"})
                if all("u_error" in case for case in own[-2:]) and len(own) > 1:
                    for what in ("u", "stress"):
                        own[-1][f"{what}_order"] = observed_order(own, f"{what}_error")
            cases += own
    return {
        "title": "Manufactured solutions",
        "about": "Active muscle with oblique fibers, stretches from 0.7 to 1.4; the order is that "
        "between the two finest sizes. Faces across x are held, the others carry tractions.",
        "cases": cases,
        "tables": [table("Relative errors and observed orders.", _COLUMNS, cases)],
        "plots": [
            plot(
                f"Manufactured solutions: {what}",
                (
                    "spacing of the source points h [cm]",
                    f"relative error of the {what} (root mean square)",
                ),
                cases,
                "h",
                key,
            )
            for what, key in (("displacement", "u_error"), ("Cauchy stress", "stress_error"))
        ],
    }
