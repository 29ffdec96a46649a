"""Manufactured solutions: observed orders of displacement and stress in both formulations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from myork.console import ProgressCallback
from myork.reference.manufactured import PROBLEMS, Problem, solve
from myork.reference.measures import observed_order

__all__ = ["run"]

METHODS = ("rkcm", "rkcm-mixed")


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all problems at all sizes with both methods; see `myork.bench` for the result."""
    cases: list[dict[str, Any]] = []
    for number, problem in enumerate(PROBLEMS):
        progress(f"problem {number + 1}/{len(PROBLEMS)}  {problem.name}")
        sizes = problem.sizes[:2] if quick else problem.sizes
        cases += [solve(problem, method, n) for method in METHODS for n in sizes]
    plots = [
        {
            "title": f"Manufactured solutions: {what}",
            "x": "spacing of the source points h [cm]",
            "y": f"relative error of the {what} (root mean square)",
            "series": [
                {"name": f"{problem.name}, {method}", "x": x, "y": y}
                for problem in PROBLEMS
                for method in METHODS
                for x, y in [_curve(cases, problem, method, key)]
                if x
            ],
        }
        for what, key in (("displacement", "u_error"), ("Cauchy stress", "stress_error"))
    ]
    return {
        "title": "Manufactured solutions",
        "about": "Active muscle with oblique fibers, stretches from 0.7 to 1.4; the order is that "
        "between the two finest sizes. Faces across x are held, the others carry tractions.",
        "cases": cases,
        "tables": [_table(cases)],
        "plots": plots,
    }


def _curve(
    cases: list[dict[str, Any]], problem: Problem, method: str, key: str
) -> tuple[list[float], list[float]]:
    found = [
        case
        for case in cases
        if case["name"] == problem.name and case["method"] == method and key in case
    ]
    return [case["h"] for case in found], [case[key] for case in found]


def _table(cases: list[dict[str, Any]]) -> dict[str, Any]:
    """A line a solve, with the order from the line before it."""
    rows = []
    for before, case in zip([None, *cases], cases, strict=False):
        orders: list[float | None] = [None, None]
        if before is not None and before["name"] == case["name"]:
            same = before["method"] == case["method"]
            if same and all("u_error" in entry for entry in (before, case)):
                orders = [observed_order([before, case], k) for k in ("u_error", "stress_error")]
        rows.append(
            [
                case["name"],
                case["method"],
                case["source_per_edge"],
                case.get("dofs"),
                case["outcome"],
                case.get("u_error"),
                orders[0],
                case.get("stress_error"),
                orders[1],
                case.get("iterations"),
                case.get("seconds"),
            ]
        )
    head = ["problem", "method", "points an edge", "unknowns", "outcome", "error of u", "order"]
    head += ["error of stress", "order", "iterations", "time [s]"]
    return {"caption": "Relative errors and observed orders.", "head": head, "rows": rows}
