"""Hard cases: each ends in the right answer or in an error that says what to do.

A case is one run of a program in a process of its own, under a time limit, or one answer of a
reduced model. What counts as wrong is an answer that is off and does not say so, a crash, and a
run without an end. An error of more than twice what it was before counts as worse.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from myork.bench.hard.again import again_cases
from myork.bench.hard.bent import bent_cases
from myork.bench.hard.case import Case, judge
from myork.bench.hard.inputs import input_cases
from myork.bench.hard.known import known_cases
from myork.bench.hard.stations import run_station
from myork.bench.runs import outcome_text
from myork.bench.tables import Columns, table
from myork.console import ProgressCallback

__all__ = ["cases", "run", "run_case"]

_COLUMNS: Columns = (
    ("case", "name"),
    ("end", "end"),
    ("error", "error"),
    ("J at full load is off by", "stray"),
    ("on the way", "way"),
    ("iterations", "iterations"),
    ("s", "seconds"),
    ("the run says", "told"),
    ("because", "why"),
)
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
        "Hard cases, one line each. J is off by how much it leaves the range of the right answer, "
        "at full load and at any load before."
    )
    return {
        "title": "Stability",
        "about": f"{len(records)} hard cases, {len(other)} of which end in another way than known.",
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
    record = run_station(case, limit)
    record |= {"name": case.name, "wanted": case.wanted, "why": case.why}
    record["end"] = judge(case, record)
    verdict = record.get("verdict") or {}
    told = "; ".join(verdict.get("reasons", [])) or record["message"] or outcome_text(record)
    state = verdict.get("state")
    record["told"] = (f"{state}: {told}" if state and state not in told else told)[:300]
    return record


def cases() -> list[Case]:
    """All hard cases."""
    return [*known_cases(), *bent_cases(), *again_cases(), *input_cases()]
