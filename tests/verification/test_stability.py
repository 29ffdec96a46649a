"""Hard cases: each ends as it is known to; the fast ones of the bench."""

import json

import pytest

from benchmarks import stability
from benchmarks.hard import case as hard
from benchmarks.hard.case import DOUBTED, EXPLAINED, RIGHT, WARNED, Case

pytestmark = pytest.mark.nightly

#: A hang, not a measurement [s]
PATIENCE = 120.0


@pytest.mark.parametrize(
    "case", [case for case in stability.cases() if case.fast], ids=lambda case: case.name
)
def test_hard_case(case: Case) -> None:
    record = stability.run_case(case, PATIENCE)
    assert record["end"] == case.wanted, (
        f"{record['end']}: {record['outcome']}, error {record.get('error')}, J off by "
        f"{record.get('stray')}, on the way {record.get('way')}; {record['told']}"
    )
    assert record["end"] == RIGHT or (record["told"] and record["why"])
    if case.manufactured is None and "error" in record:
        assert record["worst"]


def test_no_line_is_unexplained() -> None:
    """What is neither right nor refused has a reason, as has J that strays in a right answer."""
    cases = stability.cases()
    names = [case.name for case in cases]
    assert len(set(names)) == len(names)
    for case in cases:
        assert case.wanted in (RIGHT, EXPLAINED, DOUBTED, WARNED), case.name
        if case.wanted in (DOUBTED, WARNED):
            assert case.why, case.name
        if case.wanted == EXPLAINED:
            assert case.words, case.name
    measured = json.loads(hard._MEASURED.read_text(encoding="utf-8"))
    assert measured.keys() <= set(names)
    # a case without numbers of before can get worse and nobody sees it
    assert {case.name for case in cases if case.wanted in (RIGHT, DOUBTED)} <= measured.keys()
    # nothing is right that a user would not call right
    assert max(case.tolerance for case in cases) <= 0.05
    assert max(case.stray for case in cases) <= 0.05
    strays = {name for name, found in measured.items() if found.get("way", 0.0) > 0.1}
    assert not [case.name for case in cases if case.name in strays and not case.why]
