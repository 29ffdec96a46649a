"""Which answers can be trusted: every form on problems of a new user, beside finite elements.

Each deck of `myork.reference.problems` is solved as it stands, which is what `auto` takes, and by
each other form, at three sizes, and each body of `myork.reference.voxel_bodies` at two, from merged
label maps. felupe solves the same problems in the same run, bodies in their true shape, and the
limit of its three meshes is the truth. A line that is more than 5 % off and accepted is a fault of
the verdict; it is counted in the first table.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from myork.bench.runs import outcome_text, read_deck, solve_case
from myork.bench.tables import Columns, plot, table
from myork.console import ProgressCallback
from myork.errors import ConvergenceError
from myork.records import PointCloud
from myork.reference.finite_elements import solve_deck
from myork.reference.problems import PROBLEMS, Problem, probe_kind
from myork.reference.voxel_bodies import BODIES, Body, body_cloud, box_tables

__all__ = ["run"]

#: What is tried: name and overrides
_FORMS = (
    ("auto", ()),
    ("rkpm-scni", ("scene.method=rkpm-scni",)),
    ("rkcm-mixed", ("scene.method=rkcm-mixed",)),
    ("rkcm", ("scene.method=rkcm",)),
)
#: Those for bodies of voxels: `auto` takes nodal cells there
_VOXEL_FORMS = ("auto", "rkcm-mixed")
#: Those whose time grows fastest with the points
_STRONG = ("rkcm-mixed", "rkcm")
_KINDS = ("displacement", "force", "stress", "surface stress")
#: An error that must not be accepted [-]
_WRONG = 0.05
#: Wall time of one solve [s]
_LIMIT = 120.0


class _Truth(NamedTuple):
    """Value of a probe, and by how much it may be off."""

    value: float
    doubt: float


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all problems; see `myork.bench` for the result."""
    cases: list[dict[str, Any]] = []
    for problem in PROBLEMS[:2] + BODIES[:1] if quick else PROBLEMS + BODIES:
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
        ],
        "plots": [_problem_plot(name, kind, cases) for name in _names(cases)
                  for kind in ("displacement", "force")],
    }  # fmt: skip


def _names(cases: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(case["problem"] for case in cases))


def _problem_cases(
    problem: Problem | Body, progress: ProgressCallback, quick: bool
) -> list[dict[str, Any]]:
    """A problem by finite elements and by every form."""
    if isinstance(problem, Body):
        deck = read_deck(box_tables(problem))
    else:
        deck = read_deck(_sized(problem.tables, problem.sizes[0]))
    kinds = {
        probe["name"]: probe_kind(probe, deck["geometry"].get("size")) for probe in deck["probe"]
    }
    found = []
    for count in problem.elements:
        progress(f"{problem.name}: finite elements, {_text(count)}")
        found.append((count, _finite_elements(problem, deck, count)))
    truths = _truths([rival["probes"] for _, rival in found if rival["probes"]])
    cases = [
        {
            "problem": problem.name,
            "method": "felupe",
            "size": _text(count),
            "unknowns": rival["dofs"],
            "cpu_s": rival["cpu_s"],
            "outcome": rival["outcome"],
            "rival": True,
            **_errors(kinds, truths, rival["probes"], {}),
        }
        for count, rival in found
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
                **_errors(kinds, truths, case.get("probes") or {}, bars),
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
            yield name, words, _text(count), _sized(problem.tables, count), None


def _strong_sizes(sizes: Sequence[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """In space a coarser size for the finest."""
    if len(sizes[0]) == 2:
        return list(sizes)
    return [tuple(n // 2 + 1 for n in sizes[0]), *sizes[:2]]


def _sized(tables: Mapping[str, Any], size: Sequence[int]) -> dict[str, Any]:
    """Deck with its source points."""
    places = {"source": list(size), "collocation": [2 * n - 1 for n in size]}
    return {**tables, "geometry": {**tables["geometry"], **places}}


def _finite_elements(
    problem: Problem | Body, deck: Mapping[str, Any], count: Sequence[int]
) -> dict[str, Any]:
    """Last values of the probes, none where the iteration failed."""
    body = problem if isinstance(problem, Body) else None
    try:
        rival = solve_deck(
            deck, count, labels=body.part if body else None, warp=body.warp if body else None
        )
    except ConvergenceError as error:
        return {"probes": {}, "dofs": None, "cpu_s": None, "outcome": str(error)}
    probes = {name: values[-1] for name, values in rival["probes"].items()}
    return {**rival, "probes": probes, "outcome": "converged"}


def _truths(found: Sequence[Mapping[str, float]]) -> dict[str, _Truth]:
    """Limit of the meshes: Aitken's where the changes shrink, otherwise the finest value."""
    truths = {}
    for name in found[-1] if found else ():
        values = [probes[name] for probes in found]
        last = values[-1]
        change = last - values[-2] if len(values) > 1 else abs(last)
        doubt = abs(change)
        if len(values) > 2:
            before = values[-2] - values[-3]
            if change * before > 0.0 and abs(change) < 0.7 * abs(before):
                rest = change * change / (before - change)
                last, doubt = last + rest, abs(rest)
        truths[name] = _Truth(last, doubt)
    return truths


def _errors(
    kinds: Mapping[str, str],
    truths: Mapping[str, _Truth],
    probes: Mapping[str, float],
    bars: Mapping[str, float],
) -> dict[str, Any]:
    """Relative errors and bars by probe, the largest of each kind, and which bars hold."""
    error = {
        name: abs(probes[name] - truth.value) / abs(truth.value)
        for name, truth in truths.items()
        if name in probes
    }
    bar = {
        name: bars[name] / abs(truths[name].value) for name in error if bars.get(name) is not None
    }
    doubt = {name: truths[name].doubt / abs(truths[name].value) for name in error}
    held = [error[name] <= bar[name] + doubt[name] for name in bar]
    largest = {
        f"{key} {kind}": max((of[name] for name in of if kinds[name] == kind), default=None)
        for kind in _KINDS
        for key, of in (("error", error), ("bar", bar))
    }
    off = max((max(error[name] - doubt[name], 0.0) for name in error), default=None)
    return {
        "error": error,
        "bar": bar,
        "doubt": doubt,
        "off": off,
        "held": f"{sum(held)} of {len(held)}" if held else None,
        **largest,
    }


def _is_wrong_and_accepted(case: Mapping[str, Any]) -> bool:
    off = case.get("off")
    return bool(case.get("verdict") == "accepted" and (off is None or off > _WRONG))


def _wrong_and_accepted(cases: Sequence[Mapping[str, Any]]) -> int:
    return sum(map(_is_wrong_and_accepted, cases))


def _verdict_table(cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """How often each verdict was right."""
    rows = []
    for name, _ in _FORMS:
        own = [case for case in cases if case["method"] == name]
        right = [case for case in own if case["off"] is not None and case["off"] <= _WRONG]
        wrong = [case for case in own if not (case["off"] is not None and case["off"] <= _WRONG)]
        row: dict[str, Any] = {"form": name}
        for key, among in (("right", right), ("wrong", wrong)):
            for state in ("accepted", "doubtful", "refused"):
                row[f"{key} {state}"] = sum(case["verdict"] == state for case in among)
        rows.append(row)
    heads = [f"{key} {state}" for key in ("right", "wrong")
             for state in ("accepted", "doubtful", "refused")]  # fmt: skip
    return table(
        f"Verdicts: right is within {_WRONG:.0%} of the truth in all probes, the truth's own "
        "doubt allowed for; what failed is wrong and refused",
        (("form", "form"), *((head, head) for head in heads)),
        rows,
    )


def _race_table(cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The finest answer of `auto` against finite elements of no larger error."""
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
                    "cpu_s": best["cpu_s"],
                    "peer_cpu_s": cheapest,
                    "ratio": best["cpu_s"] / cheapest if known else None,
                }
            )
    columns: Columns = (
        ("problem", "problem"),
        ("of", "kind"),
        ("source points", "size"),
        ("error", "error"),
        ("CPU [s]", "cpu_s"),
        ("felupe, no larger error [s]", "peer_cpu_s"),
        ("ratio", "ratio"),
    )
    return table(
        "`auto` at its finest size against the cheapest mesh with no larger error; empty where "
        "no mesh had one",
        columns,
        rows,
    )


def _problem_table(name: str, cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """All solves of a problem."""
    columns: Columns = (
        ("form", "method"),
        ("size", "size"),
        ("unknowns", "unknowns"),
        ("CPU [s]", "cpu_s"),
        *((f"error, {kind}", f"error {kind}") for kind in _KINDS),
        *((f"bar, {kind}", f"bar {kind}") for kind in _KINDS),
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


def _text(count: Sequence[int]) -> str:
    return " x ".join(str(n) for n in count)
