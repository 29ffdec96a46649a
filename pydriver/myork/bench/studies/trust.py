"""Which answers can be trusted: every form on problems of a new user, beside finite elements.

Each deck of `myork.reference.problems` is solved as it stands, which is what `auto` takes, and by
each other form, at three sizes, and each body of `myork.reference.voxel_bodies` at two, from label
maps. felupe solves the same problems in the same run, bodies in their true shape, and the
limit of its three meshes is the truth. A line that is more than 5 % off and accepted is a fault of
the verdict; the last table counts them, and says how near `auto` comes to finite elements at what
cost.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from myork.bench.runs import outcome_text, solve_case
from myork.bench.tables import Columns, plot, table
from myork.bench.truths import KINDS, WRONG, lattice_text, sized_tables, solve_rivals
from myork.console import ProgressCallback
from myork.records import PointCloud
from myork.reference.problems import PROBLEMS, Problem
from myork.reference.voxel_bodies import BODIES, Body, body_cloud

__all__ = ["run"]

#: What is tried: name and overrides
_FORMS = (
    ("auto", ()),
    ("rkpm-scni", ("scene.method=rkpm-scni",)),
    ("rkcm-subdomain", ("scene.method=rkcm-subdomain",)),
    ("rkcm-mixed", ("scene.method=rkcm-mixed",)),
    ("rkcm", ("scene.method=rkcm",)),
)
#: Those for bodies of voxels
_VOXEL_FORMS = ("auto", "rkpm-scni", "rkcm-subdomain", "rkcm-mixed")
#: Those whose time grows fastest with the points
_STRONG = ("rkcm-mixed", "rkcm")
#: What `auto` should be within of finite elements [-]
_NEAR = 0.01
#: Wall time of one solve [s]
_LIMIT = 300.0


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all problems; see `myork.bench` for the result."""
    cases: list[dict[str, Any]] = []
    for problem in PROBLEMS[:2] if quick else PROBLEMS + BODIES:
        own = _problem_cases(problem, progress, quick)
        cases += own
        progress(f"{problem.name}: {_wrong_and_accepted(own)} wrong and accepted")
    return {
        "title": "Which answers can be trusted",
        "about": __doc__.split("\n\n")[1].replace("\n", " "),
        "cases": cases,
        "tables": [
            _verdict_table(cases),
            _race_table(cases),
            *(_problem_table(name, cases) for name in _names(cases)),
            _end_table(cases),
        ],
        "plots": [
            drawn
            for name in _names(cases)
            for kind in ("displacement", "force")
            if (drawn := _problem_plot(name, kind, cases))["series"]
        ],
    }


def _names(cases: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(case["problem"] for case in cases))


def _problem_cases(
    problem: Problem | Body, progress: ProgressCallback, quick: bool
) -> list[dict[str, Any]]:
    """A problem by finite elements and by every form."""
    truths, rivals = solve_rivals(problem, progress)
    cases = [
        {
            "problem": problem.name,
            "method": "felupe",
            "size": rival["size"],
            "unknowns": rival["dofs"],
            "cpu_s": rival["cpu_s"],
            "outcome": rival["outcome"],
            "rival": True,
            **truths.errors(rival["probes"], {}),
        }
        for rival in rivals
    ]
    for name, words, size, tables, cloud in _tries(problem, quick):
        progress(f"{problem.name}: {name}, {size}")
        case = solve_case(tables, words, cloud=cloud, limit=_LIMIT, error=True)
        bars = case.get("probe_errors") or {}
        cases.append(
            {
                "problem": problem.name,
                "method": name,
                "size": size,
                "unknowns": case.get("dofs"),
                "cpu_s": case.get("cpu_s"),
                "outcome": outcome_text(case),
                "verdict": (case.get("verdict") or {}).get("state", "refused"),
                "reasons": (case.get("verdict") or {}).get("reasons", [case["message"]]),
                "work_mismatch": case.get("work_mismatch"),
                **truths.errors(case.get("probes") or {}, bars),
            }
        )
    return cases


def _tries(
    problem: Problem | Body, quick: bool
) -> Iterator[tuple[str, Sequence[str], str, Mapping[str, Any], PointCloud | None]]:
    """Form, overrides, size, deck and points of each solve; quickly of the first size only."""
    if isinstance(problem, Body):
        clouds = {size: body_cloud(problem, size) for size in problem.sizes[: 1 if quick else None]}
        for name, words in _FORMS:
            if name not in _VOXEL_FORMS:
                continue
            # collocation at the first size only: one of its solves takes longer than all others
            for size in problem.sizes[:1] if name != "auto" else clouds:
                yield name, words, f"voxels {size:g}", problem.tables, clouds[size]
        return
    for name, words in _FORMS:
        sizes = _strong_sizes(problem.sizes) if name in _STRONG else problem.sizes
        for count in sizes[: 1 if quick else None]:
            yield name, words, lattice_text(count), sized_tables(problem.tables, count), None


def _strong_sizes(sizes: Sequence[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """In space a coarser size for the finest."""
    if len(sizes[0]) == 2:
        return list(sizes)
    return [tuple(n // 2 + 1 for n in sizes[0]), *sizes[:2]]


def _is_wrong_and_accepted(case: Mapping[str, Any]) -> bool:
    off = case.get("off")
    return bool(case.get("verdict") == "accepted" and (off is None or off > WRONG))


def _wrong_and_accepted(cases: Sequence[Mapping[str, Any]]) -> int:
    return sum(map(_is_wrong_and_accepted, cases))


def _verdict_table(cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """How often each verdict was right."""
    rows = []
    for name, _ in _FORMS:
        own = [case for case in cases if case["method"] == name]
        right = [case for case in own if case["off"] is not None and case["off"] <= WRONG]
        wrong = [case for case in own if not (case["off"] is not None and case["off"] <= WRONG)]
        row: dict[str, Any] = {"form": name}
        for key, among in (("right", right), ("wrong", wrong)):
            for state in ("accepted", "doubtful", "refused"):
                row[f"{key} {state}"] = sum(case["verdict"] == state for case in among)
        rows.append(row)
    heads = [f"{key} {state}" for key in ("right", "wrong")
             for state in ("accepted", "doubtful", "refused")]  # fmt: skip
    return table(
        f"Verdicts: right is within {WRONG:.0%} of the truth in all probes, the truth's own "
        "doubt allowed for; what failed is wrong and refused",
        (("form", "form"), *((head, head) for head in heads)),
        rows,
    )


def _races(cases: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The finest answer of `auto` to each problem and the cheapest mesh with no larger error."""
    rows = []
    for name in _names(cases):
        own = [case for case in cases if case["problem"] == name and case["method"] == "auto"]
        meshes = [case for case in cases if case["problem"] == name and case.get("rival")]
        for kind in ("displacement", "force"):
            key = f"error {kind}"
            done = [case for case in own if case[key] is not None]
            if not done:
                continue
            best = done[-1]
            rivals = [mesh for mesh in meshes if mesh[key] is not None and mesh[key] <= best[key]]
            cheapest = min((mesh["cpu_s"] for mesh in rivals), default=None)
            known = cheapest is not None and best["cpu_s"] is not None
            rows.append(
                {
                    "problem": name,
                    "kind": kind,
                    "size": best["size"],
                    "error": best[key],
                    "within": "yes" if best[key] <= _NEAR else "no",
                    "cpu_s": best["cpu_s"],
                    "peer_cpu_s": cheapest,
                    "ratio": best["cpu_s"] / cheapest if known else None,
                    "near_cpu_s": _cheapest(own, key),
                    "peer_near_cpu_s": _cheapest(meshes, key),
                }
            )
    return rows


def _cheapest(cases: Sequence[Mapping[str, Any]], key: str) -> float | None:
    """Time of the cheapest answer that is near enough."""
    near = [case["cpu_s"] for case in cases if case[key] is not None and case[key] <= _NEAR]
    return min((seconds for seconds in near if seconds is not None), default=None)


def _race_table(cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
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
        _races(cases),
    )


def _mean(ratios: Sequence[float]) -> float | None:
    """Geometric mean."""
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else None


def _end_table(cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What the run comes to."""
    races = _races(cases)
    ratios = [race["ratio"] for race in races if race["ratio"]]
    both = [race for race in races if race["near_cpu_s"] and race["peer_near_cpu_s"]]
    near_ratios = [race["near_cpu_s"] / race["peer_near_cpu_s"] for race in both]
    judged = sum(not case.get("rival") for case in cases)
    near = sum(race["within"] == "yes" for race in races)
    rows = [
        {"of": f"wrong and accepted, of {judged} answers", "is": _wrong_and_accepted(cases)},
        {"of": f"`auto` within {_NEAR:.0%} at its finest size, of {len(races)}", "is": near},
        {
            "of": "CPU of `auto` over that of felupe at no larger error, geometric mean "
            f"of {len(ratios)}",
            "is": _mean(ratios),
        },
        {"of": "the largest such ratio", "is": max(ratios, default=None)},
        {
            "of": f"the same of the cheapest answers within {_NEAR:.0%}, geometric mean "
            f"of {len(near_ratios)}",
            "is": _mean(near_ratios),
        },
        {"of": "the largest of these", "is": max(near_ratios, default=None)},
        {
            "of": "answers of `auto` that no mesh was as near as",
            "is": sum(race["ratio"] is None for race in races),
        },
    ]
    return table("What the run comes to", (("of", "of"), ("is", "is")), rows)


def _problem_table(name: str, cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """All solves of a problem."""
    columns: Columns = (
        ("form", "method"),
        ("size", "size"),
        ("unknowns", "unknowns"),
        ("CPU [s]", "cpu_s"),
        *((f"error, {kind}", f"error {kind}") for kind in KINDS),
        *((f"bar, {kind}", f"bar {kind}") for kind in KINDS),
        ("bars that hold", "held"),
        ("work", "work_mismatch"),
        ("verdict", "verdict"),
        ("outcome", "outcome"),
    )
    own = [case for case in cases if case["problem"] == name]
    doubts = [max(case["doubt"].values()) for case in own if case["doubt"]]
    doubt = f"; the truth is known to {max(doubts):.1g}" if doubts else ""
    return table(f"{name}: largest relative errors and bars of their kinds{doubt}", columns, own)


def _problem_plot(name: str, kind: str, cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Work-precision curves of a problem."""
    own = [
        {**case, "curve": case["method"]}
        for case in cases
        if case["problem"] == name and case["cpu_s"] and case[f"error {kind}"]
    ]
    axes = ("CPU time [s]", f"relative error of the {kind} [-]")
    return plot(f"{name}: {kind}", axes, own, "cpu_s", f"error {kind}")
