"""Hard cases: each ends in the right answer or in an error that says what to do.

A case is one run of a program in a process of its own, under a time limit. What counts as wrong is
an answer that is off and does not say so, a crash, and a run without an end. An error of more than
twice what it was before counts as worse.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from benchmarks.hard.bent import bent_cases
from benchmarks.hard.case import EXPLAINED, Case, judge, volume_error
from benchmarks.hard.inputs import input_cases
from benchmarks.hard.known import known_cases
from benchmarks.truths.manufactured import solve as solve_manufactured
from myork.bench.runs import outcome_text, solve_case
from myork.bench.tables import Columns, table
from myork.console import ProgressCallback
from myork.results import Results

__all__ = ["cases", "run", "run_case"]

_COLUMNS: Columns = (
    ("case", "name"),
    ("end", "end"),
    ("error", "error"),
    ("of", "worst"),
    ("J is off by", "stray"),
    ("at worst", "way"),
    ("iterations", "iterations"),
    ("s", "seconds"),
    ("the run says", "told"),
    ("because", "why"),
)
#: Letters of what a run says of itself
_LONGEST = 400
_NO_ANSWER = "this input has no answer: it is refused, and the message says what to change"
_COUNTS: Columns = (("end", "end"), ("cases", "cases"))


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Run all hard cases, the fast ones where `quick`; see `myork.bench` for the result."""
    chosen = [case for case in cases() if case.fast or not quick]
    records = []
    for number, case in enumerate(chosen):
        progress(f"case {number + 1}/{len(chosen)}  {case.name}")
        records.append(run_case(case, 60.0 if quick else 300.0))
    counts = Counter(record["end"] for record in records)
    other = [record for record in records if record["end"] != record["wanted"]]
    shown = [table("How they end.", _COUNTS, [{"end": e, "cases": n} for e, n in counts.items()])]
    if other:
        shown.append(table("Those that should end otherwise.", _COLUMNS, other))
    caption = (
        "Hard cases, with what the run says of itself and why it ends so. The error is relative, "
        "that of the quantity which is furthest off. J is off by how much it leaves the range of "
        "the right answer at full load, root mean square, and at the worst place and load. Right, "
        "doubted: the answer is right, and its verdict does not trust it. Off, told: it is wrong, "
        "and its verdict says so. Explained: there is none, and the message says why."
    )
    return {
        "title": "Stability",
        "about": f"{__doc__}\n{len(records)} cases; {len(other)} of them end in another way than "
        "known.",
        "cases": records,
        "tables": [*shown, table(caption, _COLUMNS, records)],
    }


def run_case(case: Case, limit: float) -> dict[str, Any]:
    """Run a case and judge it.

    Parameters
    ----------
    case : Case
        Case.
    limit : float
        Wall time after which it is ended [s].

    Returns
    -------
    dict
        The record with `name`, `end` (see `judge`), `wanted`, `told` (what the run says of itself)
        and `why`.
    """
    if case.manufactured is None:

        def look(folder: Path) -> dict[str, float]:
            with Results(folder) as results:
                return {"stray": volume_error(case, results.field("J"))}

        record = solve_case(
            case.deck, case.overrides, cloud=case.cloud, limit=limit, look=look, error=True
        )
    else:
        problem, form = case.manufactured
        record = {"seconds": 0.0}
        record |= solve_manufactured(problem, form, problem.sizes[0], case.overrides)
        if "u_error" in record:
            record |= {"error": record["u_error"], "stray": record["j_error"]}
    record |= {"name": case.name, "wanted": case.wanted, "why": case.why}
    record["end"] = judge(case, record)
    if record["end"] == EXPLAINED and record["outcome"] == "refused":
        record["why"] = case.why or _NO_ANSWER
    verdict = record.get("verdict") or {}
    texts = [*verdict.get("reasons", []), *record.get("warnings", [])]
    told = "; ".join(dict.fromkeys(texts)) or record["message"]
    state = verdict.get("state")
    if state != "accepted" or told:
        told = told or outcome_text(record)
        told = f"{state}: {told}" if state and state not in told else told
    record["told"] = told if len(told) <= _LONGEST else told[:_LONGEST] + " ..."
    return record


def cases() -> list[Case]:
    """All hard cases."""
    return [*known_cases(), *bent_cases(), *input_cases()]
