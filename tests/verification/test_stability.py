"""Hard cases: each ends in the right answer or in an error that says what to do.

A case is one run of a program in a process of its own, under a time limit. What counts as wrong is
an answer that is off and does not say so, a crash, and a run without an end. An error of more than
twice what it was before counts as worse.

    python tests/verification/test_stability.py

prints those that end otherwise than known and how many end in which way, and writes each
case to `docs/results/hard_cases.md` and the errors by which later ones are judged to
`tests/verification/hard_measured.json`: look at them before they are committed.
"""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from benchmarks.truths.manufactured import solve as solve_manufactured
from myork.bench.machine import machine
from myork.bench.runs import outcome_text, solve_case
from myork.results import Results
from tests.verification.hard_cases import (
    BESIDE,
    CASES,
    DOUBTED,
    EXPLAINED,
    MEASURED,
    RIGHT,
    WARNED,
    Case,
    judge,
    measured,
    volume_error,
)

pytestmark = pytest.mark.nightly

#: A hang, not a measurement [s]
PATIENCE = 120.0


def run_case(case: Case, limit: float) -> dict[str, Any]:
    """Record of a case with its `end`, what the run says of itself and why it ends so."""
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
    verdict = record.get("verdict") or {}
    texts = [*verdict.get("reasons", []), *record.get("warnings", [])]
    reported = "; ".join(dict.fromkeys(texts)) or record["message"]
    if verdict.get("state") != "accepted" and not reported:
        reported = outcome_text(record)
    refused = "this input has no answer: it is refused, and the message says what to change"
    record["end"] = judge(case, record)
    record |= {"name": case.name, "reported": reported, "why": case.why}
    if record["end"] == EXPLAINED and record["outcome"] == "refused":
        record["why"] = case.why or refused
    return record


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_hard_case(case: Case) -> None:
    record = run_case(case, PATIENCE)
    assert record["end"] == case.wanted, (
        f"{record['end']}: {record['outcome']}, error {record.get('error')}, J off by "
        f"{record.get('stray')}, at worst {record.get('way')}; {record['reported']}"
    )
    assert record["end"] == RIGHT or (record["reported"] and record["why"])
    if case.manufactured is None and "error" in record:
        assert record["worst"]


def test_no_line_is_unexplained() -> None:
    """What is neither right nor refused has a reason, as has J that strays in a right answer."""
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    for case in CASES:
        assert case.wanted in (RIGHT, EXPLAINED, DOUBTED, WARNED), case.name
        if case.wanted in (DOUBTED, WARNED):
            assert case.why, case.name
        if case.wanted == EXPLAINED:
            assert case.words, case.name
    assert measured().keys() <= set(names)
    # a case without numbers of before can get worse and nobody sees it
    assert {case.name for case in CASES if case.wanted in (RIGHT, DOUBTED)} <= measured().keys()
    # nothing is right that a user would not call right
    assert max(case.tolerance for case in CASES) <= BESIDE == 0.05
    assert max(case.stray for case in CASES) <= BESIDE
    for case in CASES:
        # a number of before by which an answer that is off would be no worse is of another day
        if case.wanted in (RIGHT, DOUBTED):
            found = measured()[case.name]
            assert found["error"] <= case.tolerance, case.name
            assert found.get("stray", 0.0) <= case.stray, case.name
    # a single place may stray further than their mean may, but from twice that on with a reason
    strays = {name for name, found in measured().items() if found.get("way", 0.0) > 2 * BESIDE}
    assert not [case.name for case in CASES if case.name in strays and not case.why]


def test_a_case_that_should_end_otherwise_is_found() -> None:
    some = next(case for case in CASES if case.name == "64 million source points")
    assert run_case(some, PATIENCE)["end"] == EXPLAINED != some._replace(expected=RIGHT).wanted


#: What the table of all cases calls the ends; a crash or an end without its reason has its own name
ENDS = {
    RIGHT: "right, accepted",
    DOUBTED: "right, doubted",
    WARNED: "off, and the run says so",
    EXPLAINED: "stopped with the reason",
    "wrong": "wrong and accepted",
}
PAGE = Path(__file__).parents[2] / "docs" / "results" / "hard_cases.md"


def main() -> None:
    """Run all cases, count how they end, and write them and their errors."""
    known, cases, counts = {}, [], dict.fromkeys(ENDS.values(), 0)
    for case in CASES:
        record = run_case(case, 300.0)
        if record["end"] != case.wanted:
            print(f"{case.name}: {record['end']}, not {case.wanted}: {record['reported']}")
        if "error" in record:
            kept = [what for what in ("error", "stray", "way") if what in record]
            known[case.name] = {what: float(f"{record[what]:.2g}") for what in kept}
        end = ENDS.get(record["end"], record["end"])
        counts[end] = counts.get(end, 0) + 1
        off = [f"{record[what]:.2g}" if what in record else "" for what in ("error", "stray")]
        why = "" if record["end"] == RIGHT else str(record["reported"]).replace("\n", " ")
        cases.append(f"| {case.name} | {end} | {' | '.join(off)} | {why.replace('|', '/')} |")
    rows = [f"  {json.dumps(name)}: {json.dumps(values)}" for name, values in known.items()]
    MEASURED.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")
    sums = [f"| {end} | {count} |" for end, count in counts.items()]
    about = machine()
    lines = [
        "# Hard cases",
        "",
        f"Written by `python tests/verification/test_stability.py` on {about['date'][:10]} (MyoRK "
        f"{about['version']}): {len(cases)} cases in all four forms. Error: the largest relative "
        "one of the probes; J: root mean square off its range.",
        "",
        *("| end | cases |", "|---|---|", *sums, ""),
        *("| case | end | error | J | what the run says |", "|---|---|---|---|---|", *cases),
    ]
    PAGE.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(sums))


if __name__ == "__main__":
    main()
