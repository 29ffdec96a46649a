"""Every benchmark that has no test of its own, in small: it ends, and its numbers make sense."""

from pathlib import Path
from typing import Any

import pytest

from benchmarks import stability
from benchmarks.hard.case import DOUBTED, EXPLAINED, RIGHT
from myork.bench import BENCHES, run_benches

pytestmark = pytest.mark.nightly


def quick(name: str, folder: Path) -> dict[str, Any]:
    """Result of a benchmark; its page has all its tables and plots."""
    bench: dict[str, Any] = run_benches([name], folder, quick=True)["benches"][name]
    page = (folder / "bench.html").read_text(encoding="utf-8")
    assert page.count("<table") >= len(bench["tables"]) > 0
    drawn = len(bench.get("plots", [])) + len(bench.get("maps", []))
    assert page.count("<img alt=") == drawn + len(bench.get("pictures", []))
    return bench


def test_every_benchmark_is_run_by_a_test() -> None:
    text = "".join(
        path.read_text(encoding="utf-8") for path in Path(__file__).parent.parent.rglob("test_*.py")
    )
    for name in BENCHES:
        called = (f'quick("{name}"', f'run_benches(["{name}"]', f'run_limited("{name}"')
        own = f"import {name}" in text
        assert own or any(call in text for call in called), name


def test_curves(tmp_path: Path) -> None:
    """The mixed form, without which the tube locks, is nearer at both sizes, and finite elements
    come nearer with each mesh."""
    bench = quick("curves", tmp_path)
    tube = [case for case in bench["cases"] if case["size"] in ("5 x 26", "7 x 38")]
    assert {case["outcome"] for case in tube} == {"converged"}
    error = {(case["curve"], case["size"]): case["error"] for case in tube}
    locked, mixed = (f"{form}, order 2, 4 h" for form in ("rkcm", "rkcm-mixed"))
    for size in ("5 x 26", "7 x 38"):
        assert error[mixed, size] < 0.2 * error[locked, size]
    rivals = [case["error"] for case in bench["cases"] if case.get("rival")]
    assert len(rivals) == 3 and rivals == sorted(rivals, reverse=True)


def test_mixed(tmp_path: Path) -> None:
    """The displacement form misses the side's motion, the mixed one does not."""
    locked, _, mixed, *_ = quick("mixed", tmp_path)["cases"]
    side = [case["probes"]["side_u_x"] for case in (locked, mixed)]
    assert abs(side[0]) < 0.2 * abs(side[1])
    assert mixed["name"] == "order 2" and mixed["outcome"] == "converged"


def test_clouds(tmp_path: Path) -> None:
    """Turned bars of voxels of an eighth, order 2: measured to 0.06 in the forces and stresses."""
    bars = [case for case in quick("clouds", tmp_path)["cases"] if "error" in case]
    assert len(bars) == 2
    for case in bars:
        assert abs(case["error"]["reaction_z"]) < 0.05 and abs(case["error"]["stress_zz"]) < 0.05


def test_trust(tmp_path: Path) -> None:
    """A cantilever and a clamped beam: no wrong answer is accepted, and `auto` is right."""
    bench = quick("trust", tmp_path)
    assert bench["tables"][-1]["rows"][0] == [bench["tables"][-1]["rows"][0][0], 0]
    own = [case for case in bench["cases"] if case["method"] == "auto"]
    assert len(own) == 2 and all(case["off"] < 0.05 for case in own)


def test_newcomer(tmp_path: Path) -> None:
    cases = quick("newcomer", tmp_path)["cases"]
    assert [case["right"] for case in cases] == ["yes", "yes"]
    assert max(case["worst error"] for case in cases) < 0.05


def test_certify(tmp_path: Path) -> None:
    """Bars of two loads cover the errors, and are not ten times as wide."""
    bench = quick("certify", tmp_path)
    for form, covered in bench["coverage"].items():
        assert covered >= 0.9 and 1.0 < bench["sharpness"][form] < 10.0


def test_mms(tmp_path: Path) -> None:
    """Errors of manufactured solutions fall, but for the published weights at order 2."""
    cases = quick("mms", tmp_path)["cases"]
    orders = [case["u_order"] for case in cases if "u_order" in case]
    assert len(orders) == 4 and min(orders) > 1.0


def test_isometric(tmp_path: Path) -> None:
    """The straighter the fibers, the larger the force; the reference has 1.69 times that of the
    measured ones. Sections of a calf in blocks of 15 and 10 mm differ by a hundredth.
    """
    bench = quick("isometric", tmp_path)
    assert {case["outcome"] for case in bench["cases"]} == {"converged"}
    found = {case["fibers"]: case for case in bench["directions"]}
    forces = [found[f"assumed, {angle} degrees"]["force"] for angle in (0, 10, 17)]
    forces.append(found["measured"]["force"])
    assert forces == sorted(forces, reverse=True)
    assert found["assumed, 0 degrees"]["ratio"] == pytest.approx(1.69, rel=0.1)
    assert found["their mean"]["ratio"] == pytest.approx(1.0, abs=0.05)
    coarse, fine = bench["sections"]
    assert coarse["force"] == pytest.approx(fine["force"], rel=0.03)
    assert coarse["difference"] < 0.03


def test_stability(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page of three cases, one of which ends in another way than it should."""
    some = {case.name: case for case in stability.cases()}
    chosen = [
        some["lattice moved by 0.4 h, rkpm-gauss"],
        some["points jittered by 0.3 h, rkcm"],
        some["empty label"]._replace(expected=RIGHT),
    ]
    monkeypatch.setattr(stability, "cases", lambda: chosen)
    bench = quick("stability", tmp_path)
    assert [case["end"] for case in bench["cases"]] == [RIGHT, DOUBTED, EXPLAINED]
    counts, others, every = (table["rows"] for table in bench["tables"])
    assert dict(counts) == {RIGHT: 1, DOUBTED: 1, EXPLAINED: 1}
    assert [row[0] for row in others] == ["empty label"] and len(every) == 3
    assert "3 cases; 1 of them end" in bench["about"]
