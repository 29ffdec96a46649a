"""Pages of sweeps and of several runs: effects that are known, failures, runs that disagree."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork.errors import FileError, InputError
from myork.report import compare_runs, make_report
from myork.report.sweep_page import Column, Fit, read_sweep, tornado_figure, trend_figure
from myork.stations.solve import run_deck
from tests.report.pages import Page, change_summary
from tests.scenes import RUBBER, box, held, scene


def force_of(sigma: float, angle: float) -> float:
    return -2.0 * sigma + 0.1 * angle + 0.005 * sigma * angle


@pytest.fixture
def swept(tmp_path: Path) -> Path:
    """Thirty points of three keys, of which one does nothing; one failed, one is not solved."""
    folder = tmp_path / "swept"
    folder.mkdir()
    rng = np.random.default_rng(4)
    points = [[float(x) for x in row] for row in rng.uniform([20, 0, 1], [40, 30, 2], (31, 3))]
    head = {"deck": "9f", "keys": ["m.sigma_max", "m.fiber_angle", "m.K"], "points": points}
    lines = [json.dumps({"sweep": {**head, "model": None}})]
    for number, (sigma, angle, _) in enumerate(points[:30]):
        row: dict[str, Any] = {"point": number, "verdict": "accepted", "message": "", "cpu_s": 2.0}
        row |= {"probes": {"force": force_of(sigma, angle)}, "errors": {"force": 0.5}}
        if number == 7:
            row |= {"probes": {}, "errors": {}, "verdict": "failed", "message": "J below <0>"}
        lines.append(json.dumps(row))
    (folder / "points.jsonl").write_text("\n".join(lines) + '\n{"point": 30, "pro')
    (folder / "sweep.json").write_text('{"title": "Block", "units": {"force": "N"}}')
    return folder


@pytest.mark.slow
def test_sweep_page(swept: Path, open_page: Callable[[str], Any]) -> None:
    path = make_report(swept)
    page = Page(path)
    assert page.sections == ["trends", "effects", "surfaces", "failures", "points"]
    for wanted in (
        "Sweep: Block", "29 accepted", "1 failed", "1 to do", "31 points by full solutions",
        "m.sigma_max from", "60.0 CPU s in all, 2.00 s per point", "J below <0>", "force [N]",
    ):  # fmt: skip
        assert wanted in page.text, wanted
    assert len(page.images) == 3
    shown = open_page(path.as_uri())
    assert shown.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 100)")


def test_effects_are_those_of_the_function(swept: Path) -> None:
    sweep = read_sweep(swept)
    fit = Fit.of(sweep.keys, sweep.probes[0])
    assert fit is not None and fit.degree == 2 and fit.predicted > 1.0 - 1e-9
    places = [np.array(key.values) for key in sweep.keys]
    low, high = (np.array([end(place) for place in places]) for end in (np.min, np.max))
    middle = 0.5 * (low + high)
    for j, ends in enumerate(fit.effects()):
        for value, end in zip(ends, (low, high), strict=True):
            at = middle.copy()
            at[j] = end[j]
            assert value == pytest.approx(force_of(at[0], at[1]), abs=1e-9)
    assert fit.strongest() == [0, 1]
    axes = tornado_figure([fit]).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()][-1] == "m.sigma_max"


def test_noise_is_not_predicted() -> None:
    rng = np.random.default_rng(0)
    key = Column("a", "", rng.random(40).tolist(), [])
    noise = Column("b", "", rng.normal(size=40).tolist(), [])
    fit = Fit.of([key], noise)
    assert fit is not None and fit.predicted < 0.3
    assert Fit.of([key], Column("c", "", [1.0] * 40, [])) is None


def test_words_stand_side_by_side() -> None:
    key = Column("method", "", ["rkcm", "rkpm-gauss", "rkcm"], [])
    probe = Column("force", "N", [1.0, 2.0, 1.1], [0.1, np.nan, 0.1])
    axes = trend_figure([key], probe, ["accepted", "doubtful", "accepted"]).axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["rkcm", "rkpm-gauss"]
    assert Fit.of([key], probe) is None


def test_damaged_sweeps_are_refused_by_name(swept: Path) -> None:
    file = swept / "points.jsonl"
    first = file.read_text().splitlines()[0]
    for text in ("", "{}", '{"sweep": {"keys": 3}}', "[]"):
        file.write_text(text)
        with pytest.raises(FileError, match=r"points\.jsonl: is not what myork sweep writes"):
            make_report(swept)
    file.write_text(first + "\n")
    with pytest.raises(FileError, match="no point is finished"):
        make_report(swept)


def copy_of(folder: Path, name: str, change: Callable[[dict[str, Any]], object]) -> Path:
    other = folder.parent / name
    other.mkdir()
    (other / "summary.json").write_text((folder / "summary.json").read_text())
    change_summary(other, change)
    return other


@pytest.mark.slow
def test_runs_side_by_side(folder: Path, open_page: Callable[[str], Any]) -> None:
    near = copy_of(folder, "near", lambda s: s["steps"][-1]["probes"].update(reaction=-3.0 * 1.008))
    far = copy_of(folder, "far", lambda s: s["steps"][-1]["probes"].update(reaction=-3.3))
    change_summary(far, lambda s: s["deck"].update(load={"steps": 20}))
    text = Page(compare_runs([folder, near])).text
    assert "reaction from −3.024 to −3.000 N: 0.79 % apart" in text
    assert "All numbers agree within their error bars" in text
    assert "Nothing: all keys have the same values." in text
    path = compare_runs([folder, near, far], folder / "page")
    assert path == folder / "page" / "compare.html"
    page = Page(path)
    assert page.sections == ["answers", "curves", "decks", "cost"]
    assert "Further apart than their error bars: reaction" in page.text
    assert "load.steps" in page.text and "−10 %" in page.text
    shown = open_page(path.as_uri())
    assert shown.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 100)")


def test_what_cannot_be_compared(folder: Path) -> None:
    with pytest.raises(InputError, match="two folders or more"):
        compare_runs([folder])
    with pytest.raises(FileError, match="is named twice"):
        compare_runs([folder, folder])
    empty = copy_of(folder, "empty", lambda s: s.update(steps=[]))
    with pytest.raises(FileError, match="empty: has no load steps"):
        compare_runs([folder, empty])


def solved(folder: Path, move: float, size: list[float]) -> Path:
    """A rubber block of this size, one end of which is held and the other moved."""
    n = len(size)
    tables = scene(
        "auto", box(*[4] * n, size=size, places=[6] * n), material=[RUBBER],
        boundary=[held("x0", n), held("x1", n, u_x=move)],
    )  # fmt: skip
    run_deck(tables, folder, threads=1, error=False)
    return folder


@pytest.mark.slow
def test_bodies_stand_side_by_side(tmp_path: Path) -> None:
    """Plane or in space, in one scale; a plane body is not put beside one in space."""
    cubes = [solved(tmp_path / name, move, [1, 1, 1]) for name, move in (("a", 0.1), ("b", 0.4))]
    sheets = [solved(tmp_path / name, move, [2, 1]) for name, move in (("c", 0.2), ("d", 0.6))]
    for number, pair in enumerate((cubes, sheets)):
        page = Page(compare_runs(pair, tmp_path / f"page{number}"))
        assert "bodies" in page.sections and "the same for all" in page.text
    mixed = Page(compare_runs([cubes[0], sheets[0]], tmp_path / "page2"))
    assert "bodies" not in mixed.sections
