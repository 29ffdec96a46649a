"""Pages of sweeps: trends, failures."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork.errors import FileError
from myork.report import make_report
from myork.report.sweep_page import Column, trend_figure
from tests.refusals import refuses
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
    assert page.sections == ["trends", "failures", "points"]
    for wanted in (
        "Sweep: Block", "29 accepted", "1 failed", "1 to do", "31 points by full solutions",
        "m.sigma_max from", "60.0 CPU s in all, 2.00 s per point", "J below <0>", "force [N]",
    ):  # fmt: skip
        assert wanted in page.text, wanted
    assert len(page.images) == 1
    shown = open_page(path.as_uri())
    assert shown.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 100)")


def test_words_stand_side_by_side() -> None:
    key = Column("method", "", ["rkcm", "rkpm-gauss", "rkcm"], [])
    probe = Column("force", "N", [1.0, 2.0, 1.1], [0.1, np.nan, 0.1])
    axes = trend_figure([key], probe, ["accepted", "doubtful", "accepted"]).axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["rkcm", "rkpm-gauss"]


def test_damaged_sweeps_are_refused_by_name(swept: Path) -> None:
    file = swept / "points.jsonl"
    first = file.read_text().splitlines()[0]
    for text in ("", "{}", '{"sweep": {"keys": 3}}', "[]"):
        file.write_text(text)
        with pytest.raises(FileError, match=r"points\.jsonl: is not a table written by"):
            make_report(swept)
    file.write_text(first + "\n")
    refuses("no point is finished", make_report, swept, kind=FileError)
