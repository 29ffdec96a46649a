"""`myork bench`: record and page; every benchmark in a small version, with plausible numbers."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from benchmarks import runner
from benchmarks.pivots import PIVOTS, cost
from benchmarks.runner import WRONG, Truth, Truths
from benchmarks.runs import solve_case
from benchmarks.truths.deck_parts import deck, force, held, probe
from benchmarks.truths.finite_elements import solve_deck
from myork.bench import run_benches
from myork.bench.materials import MUSCLE
from myork.bench.runs import read_deck
from myork.errors import InputError
from tests.scenes import neo, refuses

pytestmark = pytest.mark.nightly


def quick(name: str, folder: Path) -> dict[str, Any]:
    """Result of a small benchmark; its record and its page contain all of it."""
    record = run_benches([name], folder, quick=True)
    assert json.loads((folder / "bench.json").read_text(encoding="utf-8")).keys() == record.keys()
    bench: dict[str, Any] = record["benches"][name]
    page = (folder / "bench.html").read_text(encoding="utf-8")
    assert page.count("<table") >= len(bench["tables"]) > 0
    drawn = {plot.get("figure", plot["title"]) for plot in bench.get("plots", [])}
    assert page.count("<img alt=") == len(drawn)
    for case in bench["cases"]:
        # the keys that others read; failed cases have no error
        assert {"problem", "method", "unknowns", "cpu_s", "error"} <= set(case)
        assert all(isinstance(error, float) for error in case["error"].values())
    return bench


def test_unknown_bench_is_refused(tmp_path: Path) -> None:
    refuses("unknown benchmark 'linaer'; choose one of linear", run_benches, ["linaer"], tmp_path)


def test_without_a_checkout_there_are_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither here nor around the running environment."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.prefix", str(tmp_path / ".venv"))
    refuses("linear: benchmarks belong to a checkout", run_benches, ["linear"], tmp_path)


def test_a_failure_ends_no_other_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any) -> dict[str, Any]:
        raise InputError("it is off")

    monkeypatch.setattr("benchmarks.pivots.view", fails)
    record = run_benches(["trust", "nonlinear"], tmp_path, quick=True)
    assert record["benches"]["trust"]["ended"] == "InputError: it is off"
    assert record["benches"]["nonlinear"]["cases"]
    page = (tmp_path / "bench.html").read_text(encoding="utf-8")
    assert "1 benchmarks have results; without: trust" in page


@pytest.mark.parametrize("name", ["linear", "nonlinear"])
def test_what_others_assert_is_drawn(name: str, tmp_path: Path) -> None:
    """Rates, exact states and locking are tested in test_linear, test_forms and test_hard_cases."""
    cases = quick(name, tmp_path)["cases"]
    assert {case["outcome"] for case in cases} == {"converged"}


def test_cost_is_read_off_behind_the_last_miss() -> None:
    points = [(1.0, 1e-1), (10.0, 1e-4), (100.0, 1e-3), (1000.0, 1e-5), (5.0, None)]
    points += [(2000.0, math.nan)]  # an answer that is not a number has no error
    cases = [{"cpu_s": seconds, "e": error} for seconds, error in points]
    # the accidentally accurate size at 10 s does not count
    assert cost(cases, "e", 1e-4) == pytest.approx(100 * 10**0.5)
    assert cost(cases, "e", 1e-2) == pytest.approx(10 ** (1 / 3))
    assert cost(cases, "e", 0.5) == 1.0
    assert cost(cases, "e", 1e-6) is None and cost([], "e", 1.0) is None


def test_race(tmp_path: Path) -> None:
    """Both reach 1 % of the force of the tube and of the sheet; times of both are recorded."""
    bench = quick("race", tmp_path)
    absent = {case["form"] for case in bench["cases"] if "not installed" in case["outcome"]}
    assert all(c["outcome"] == "converged" for c in bench["cases"] if c["form"] not in absent)
    races = {(race["problem"], race["line"], race["error"]): race for race in bench["races"]}
    for problem in ("tube", "near shear"):
        race = races[problem, "force", 1e-2]
        assert race["outcome"] == "both" and race["peer"] not in absent
        assert race["ratio"] == pytest.approx(race["cpu_s"] / race["peer_cpu_s"])
    # values that the meshes do not resolve are not asserted
    known = [race for race in bench["races"] if race["ratio"] is not None]
    assert all(race["error"] >= 2 * race["doubt"] for race in known)
    assert len(bench["plots"]) == 4


def test_trust_and_methods_are_views_of_the_same_rows(tmp_path, monkeypatch):
    """A cantilever and a clamped beam: no wrong answer is accepted, and `auto` is right."""
    bench = quick("trust", tmp_path)
    assert bench["tables"][0]["rows"][0][1] == 0
    own = [case for case in bench["cases"] if case["form"] == "auto"]
    assert len(own) == 2 and all(case["off"] < 0.05 for case in own)
    assert all({"verdict", "bar", "peer", "memory"} <= set(case) for case in own)
    # a page of the runner
    monkeypatch.setitem(PIVOTS, "methods", (lambda *_: bench["cases"], PIVOTS["methods"][1]))
    runner.main("methods", "--quick", "--out", str(tmp_path))

    page = (tmp_path / "methods.md").read_text("utf-8")
    assert "Written by `python benchmarks/runner.py methods --quick` on 20" in page
    (line,) = [line for line in page.splitlines() if line.startswith("| auto |")]
    assert line.split(" | ")[1:4] == ["2", "0", "0"]
    rows = json.loads((tmp_path / "results.json").read_text("utf-8"))
    assert [row["error"] for row in rows] == [case["error"] for case in bench["cases"]]
    assert all({"problem", "bar", "cpu_s", "memory", "peer", "size"} <= set(row) for row in rows)


def test_certify(tmp_path: Path) -> None:
    """Bars of two loads contain the errors, and are not ten times as wide."""
    bench = quick("certify", tmp_path)
    for form, covered in bench["coverage"].items():
        assert covered >= 0.9 and 1.0 < bench["sharpness"][form] < 10.0


# ---- bars and verdicts beside finite elements ----------------------------------------------------


#: Decks of few cells: points of the second solution, values of finer ones and the widest bar
FEW: dict[str, tuple[dict[str, Any], int, dict[str, float], float]] = {
    "soft sheet": (
        deck(
            "soft sheet", {"kind": "box", "size": [2, 1], "source": [9, 5]}, [neo(2.0, 6.0)],
            [held("x0", 2), held("x1", 2, u_x=1.0)],
            [probe("waist", "u_y", (1, 1)), probe("middle", "cauchy_xx", (1, 0.5)),
             force("pull", "x", "x1")],
        ),
        # finite elements, which change by 2e-4 relative to half as many elements
        17 * 9, {}, WRONG,
    ),
    "free muscle": (
        deck(
            "free muscle", {"kind": "box", "size": [1, 1, 3], "source": [5, 5, 13]},
            [{**MUSCLE, "fiber_angle": 0}], [held("z0"), {"set": "z1", "u_x": 0, "u_y": 0}],
            [probe("end", "u_z", (0.5, 0.5, 3)), probe("belly", "u_x", (1, 0.5, 1.5))], 0.05,
        ),
        # 9x9x25 points; half of the cells are enough
        3 * 3 * 7, {"end": -0.27302, "belly": 0.02571}, 0.1,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FEW)
def test_few_cells_are_compared_with_more(name: str) -> None:
    """Bars contain the error, and are narrower than those from half as many cells."""
    tables, points, values, widest = FEW[name]
    case = solve_case(tables)
    assert case["companion"]["source_points"] == points
    assert case["verdict"]["state"] == "accepted"
    if not values:
        values = solve_deck(read_deck(tables), (32, 16))["probes"]
    for key, value in values.items():
        error, bar = abs(case["probes"][key] - value), case["probe_errors"][key]
        assert error <= bar + 2e-4 * abs(value) and bar < widest * abs(value), key


def test_errors_of_an_answer() -> None:
    known = {"u": Truth(2.0, 0.02), "f": Truth(-1.0, 0)}
    truths = Truths({"u": "displacement", "f": "force"}, known)
    found = truths.errors({"u": 2.1, "f": -1.0}, {"u": 0.06})
    assert found["error"] == {"u": pytest.approx(0.05), "f": 0.0}
    assert found["off"] == pytest.approx(0.04) and found["held"] == "0 of 1"
    assert found["error displacement"] == pytest.approx(0.05)
    # a force that vanishes by symmetry, beside another
    zero = Truths({"f": "force", "g": "force"}, {"f": Truth(10.0, 0), "g": Truth(1e-15, 0)})
    assert zero.errors({"f": 10.0, "g": 1e-4}, {})["error"]["g"] == pytest.approx(0.01)


def test_corners_inside_out_near_a_probe_are_named() -> None:
    """J is negative in the glued corners of the pad, where no stress exists."""
    tables = deck(
        "pad between plates", {"kind": "box", "size": [3, 1], "source": [25, 9]}, [neo(20.0, 1e4)],
        [held("y0", 2), held("y1", 2, u_y=-0.25)],
        [probe("middle", "cauchy_yy", (1.5, 0.5)), probe("corner", "u_x", (2.9, 0.9))],
    )  # fmt: skip
    case = solve_case(tables)
    assert case["verdict"]["state"] == "doubtful"
    (reason,) = (text for text in case["verdict"]["reasons"] if "near probe corner" in text)
    assert "the material is inverted (in 0.29 % of the volume, near probe corner)" in reason
