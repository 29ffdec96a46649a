"""The demo: what a first user sees is an accepted force and a muscle to touch."""

import json
from pathlib import Path
from typing import Any

import pytest

from myork import ReducedModel
from myork.cli import main

pytestmark = pytest.mark.nightly


def test_it_ends_accepted(
    open_page: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--out", str(tmp_path), "--threads", "1"]) == 0
    said = capsys.readouterr().out
    lines = said.splitlines()
    summary = json.loads((tmp_path / "summary.json").read_text())
    # nothing is lost in any place, at no load
    assert summary["verdict"]["state"] == "accepted" and summary["warnings"] == []
    last = summary["steps"][-1]
    force, bar = last["probes"]["reaction_top"], last["probe_errors"]["reaction_top"]
    assert 0.0 < bar < 0.06 * force
    assert lines[-4:] == [
        f"reaction_top at load 1: {force:.4g} +- {bar:.2g} N",
        "verdict: accepted",
        f"report: {tmp_path / 'report.html'}",
        f"the muscle with sliders, in any browser: {tmp_path / 'mg_muscle.html'}",
    ]
    # every station and what takes its time says where it is
    assert [f"station {k}/5" in said for k in range(1, 6)] == [True] * 5
    assert "full solve 24/24" in said and "test 6/6" in said and "state 100/" in said
    # the check stands in its file and in the model
    check = json.loads((tmp_path / "check.json").read_text())
    assert check["failed"] == 0 and check["points"] == 6
    assert check["force"]["max"] < 1e-3 and check["u"]["max_of_largest"] < 2e-3
    (model,) = tmp_path.glob("*.rom.h5")
    rom = ReducedModel.load(model, threads=1)
    assert rom.certificate == check
    assert rom.solve(activation=0.3, u_z=0.0).probes["reaction_top"] == pytest.approx(
        force, rel=1e-3
    )
    page = open_page((tmp_path / "mg_muscle.html").as_uri())
    page.wait_for_function("shown.answers > 0")
    page.evaluate(
        "() => { const s = document.getElementById('p0'); s.value = 0.3;"
        " s.dispatchEvent(new Event('input')); }"
    )
    page.wait_for_function("shown.values[0] === 0.3")
    at = page.evaluate("about.probes.findIndex((p) => p.name === 'reaction_top')")
    assert page.evaluate("shown.probes")[at] == pytest.approx(force, rel=1e-3)
    assert page.inner_text("#verdict") == "✓ accepted"
    # the error of the full model is in that of the force
    of = page.evaluate("about.bar")
    off = (of["full"] + of["reduced"]) * force + of["between"]
    assert bar < off < 1.02 * bar
    assert page.inner_text("#bar0") == f"± {off:.2g}"
    report = open_page((tmp_path / "report.html").as_uri())
    report.wait_for_function("shown.answers > 0")
    assert report.inner_text("h1").endswith("✓ numerical error accepted phantom data")
