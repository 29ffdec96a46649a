"""Twenty decks of a new user, as they stand: which converge, and whether their verdicts are right.

Nothing but the body, its materials, what holds and moves it and the number of points is named.
felupe solves the same problems, bodies of voxels in their true shape, and the limit of its three
meshes is the truth. A verdict is right where an answer within 5 % of it in all probes is accepted,
or one farther off is doubtful or refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from myork.bench.runs import outcome_text, solve_case
from myork.bench.tables import Columns, table
from myork.bench.truths import WRONG, lattice_text, sized_tables, solve_rivals
from myork.console import ProgressCallback
from myork.reference.newcomer import DECKS
from myork.reference.problems import Problem
from myork.reference.voxel_bodies import Body, body_cloud

__all__ = ["run"]

#: Wall time of one solve [s]
_LIMIT = 300.0
_COLUMNS: Columns = (
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
    ("bars that hold", "held"),
    ("verdict", "verdict"),
    ("right", "right"),
)


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all decks; see `myork.bench` for the result."""
    problems = DECKS[:2] if quick else DECKS
    cases = []
    for problem in problems:
        case = _case(problem, progress)
        progress(f"{problem.name}: {case['verdict']}, right: {case['right']}")
        cases.append(case)
    return {
        "title": "Twenty decks of a new user",
        "about": __doc__.split("\n\n")[1].replace("\n", " "),
        "cases": cases,
        "tables": [
            table("The largest relative error of each, and its verdict", _COLUMNS, cases),
            table("Sums", (("of", "of"), ("is", "is")), _sums(cases)),
        ],
    }


def _case(problem: Problem | Body, progress: ProgressCallback) -> dict[str, Any]:
    """One deck."""
    truths, rivals = solve_rivals(problem, progress)
    progress(f"{problem.name}: as it stands")
    if isinstance(problem, Body):
        size = f"voxels {problem.sizes[0]:g}"
        cloud = body_cloud(problem, problem.sizes[0])
        case = solve_case(problem.tables, cloud=cloud, limit=_LIMIT, error=True)
    else:
        size = lattice_text(problem.sizes[0])
        tables = sized_tables(problem.tables, problem.sizes[0])
        case = solve_case(tables, limit=_LIMIT, error=True)
    verdict = case.get("verdict") or {"state": "refused", "reasons": [case["message"]]}
    found = truths.errors(case.get("probes") or {}, case.get("probe_errors") or {})
    worst = max(found["error"], key=lambda name: found["error"][name], default=None)
    wrong = found["off"] is None or found["off"] > WRONG
    return {
        "problem": problem.name,
        "size": size,
        "unknowns": case.get("dofs"),
        "cpu_s": case.get("cpu_s"),
        "peer_cpu_s": rivals[-1]["cpu_s"],
        "outcome": outcome_text(case),
        "verdict": verdict["state"],
        "reasons": verdict["reasons"],
        "right": "yes" if wrong != (verdict["state"] == "accepted") else "no",
        "worst": worst,
        "worst error": found["error"].get(worst),
        "its bar": found["bar"].get(worst),
        "known to": found["doubt"].get(worst),
        **found,
    }


def _sums(cases: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Counts over all decks."""
    counts = {
        "decks": len(cases),
        "converged": sum(case["outcome"] == "converged" for case in cases),
        "verdicts right": sum(case["right"] == "yes" for case in cases),
        "wrong and accepted": sum(
            case["right"] == "no" and case["verdict"] == "accepted" for case in cases
        ),
        "bars that hold": sum(int(case["held"].split()[0]) for case in cases if case["held"]),
        "bars": sum(int(case["held"].split()[2]) for case in cases if case["held"]),
    }
    return [{"of": name, "is": count} for name, count in counts.items()]
