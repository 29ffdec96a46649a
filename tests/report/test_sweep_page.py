"""Pages of sweeps: effects that are known, failures."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork.errors import FileError
from myork.report import make_report
from myork.report.sweep_page import Column, Fit, read_sweep, tornado_figure, trend_figure
from tests.report.pages import Page


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
