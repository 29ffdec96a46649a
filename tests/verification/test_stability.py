"""Hard cases: right, or an error that names its reason; the fast ones of the bench."""

import pytest

from myork.bench.studies import stability

#: A hang, not a measurement [s]
PATIENCE = 120.0


@pytest.mark.parametrize(
    "case", [case for case in stability.cases() if case.fast], ids=lambda case: case.name
)
def test_hard_case(case: stability.Case) -> None:
    record = stability.run_case(case, PATIENCE)
    verdict = record["verdict"]
    assert verdict in (stability.RIGHT, stability.EXPLAINED), (
        f"{verdict}: {record['outcome']}, error {record.get('error')}, {record['message']}"
    )


def test_names_are_unique() -> None:
    names = [case.name for case in stability.cases()]
    assert len(set(names)) == len(names)


def test_a_hang_is_an_outcome() -> None:
    """A limit that nothing can meet ends the run and says so."""
    case = next(case for case in stability.cases() if case.name.startswith("tension to 6,"))
    record = stability.run_case(case, 1e-3)
    assert record["verdict"] == record["outcome"] == "time limit"
