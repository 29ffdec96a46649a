"""Source points added until the error bars are as small as wanted."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork.core.scene import Scene
from myork.errors import InputError
from myork.report import make_report
from myork.stations.solve import run_deck
from tests.scenes import BEAM_TIP, RUBBER, beam, held, scene, solved, voxels


def cantilever(**refine: Any) -> dict[str, Any]:
    tables = beam(9, 3, places=(9, 3), refine=refine)
    tables["probe"].append({"name": "shear", "quantity": "cauchy_xy", "point": [0.5, 0.25]})
    return tables


@pytest.mark.parametrize("error", [0.01, 0.003])
def test_the_wanted_error_of_a_tip_is_met(error) -> None:
    with Scene.from_tables(cantilever(error=error, probe="tip")) as opened:
        points = opened.source_points
        found = solved(opened, error=True)
    states, tip = found.states, found.last()["tip"]
    assert tip == pytest.approx(BEAM_TIP, rel=error)
    assert states.probe_errors[-1, 0, 0] <= error * abs(tip)
    # the stress that nobody wanted to know may still be in doubt
    assert states.reasons[-1] == f"the wanted error of {100 * error:g} % is met"
    # uniform cells that do are 16 and 32 along it
    assert points < (17 * 5 if error == 0.01 else 33 * 9) * 1.45


def test_all_probes_are_wanted_by_default_and_cost_ends_the_search() -> None:
    states = solved(cantilever(error=0.01, cost=0.15), error=True).states
    assert re.fullmatch(
        r"the wanted error of 1 % is not met: the next points, \[\d+,\d+\] cells, would take "
        r"about .* CPU s, more than refine\.cost",
        states.reasons[-1],
    )


@pytest.mark.slow
def test_the_summary_tells_each_lattice(tmp_path: Path) -> None:
    summary = run_deck(cantilever(error=0.02, probe="tip"), tmp_path)
    said = summary["refine"]
    assert said["met"] and said["error"] == 0.02 and said["cpu_s"] > 0
    assert said["levels"][0].startswith("refine 1: [9,3] points, tip known to ")
    lattice = re.match(r"refine \d+: \[(\d+),(\d+)\]", said["levels"][-1])
    assert lattice is not None
    assert summary["deck"]["geometry"]["source"] == [int(n) for n in lattice.groups()]
    assert summary["source_points"] == int(lattice[1]) * int(lattice[2])
    assert json.loads((tmp_path / "summary.json").read_text())["refine"] == said
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert said["reason"] in page


def bar(**refine: Any) -> Scene:
    """A bar of 16 voxels along its axis, sheared."""
    tables = scene(
        "auto", {}, material=[{**RUBBER, "label": 1}], refine=refine,
        boundary=[held("bottom"), held("top", u_x=0.5)],
        probe=[{"name": "force", "quantity": "force_x", "set": "top"}],
    )  # fmt: skip
    return Scene.from_tables(tables, voxels(np.ones((4, 4, 16)), 2.5, source_stride=[2] * 3))


@pytest.mark.slow
def test_models_are_refined_up_to_their_voxels() -> None:
    with bar(error=0.002) as opened:
        states = opened.solve()
        assert opened.source_points > 3 * 3 * 9
    assert states.reasons[-1].endswith(
        "every voxel has its own source points; give a label map of finer voxels"
    )


def test_what_voxels_leave_open_is_not_promised() -> None:
    """Four voxels across, whose faces a force knows to 0.08 of a voxel on each side."""
    with bar(error=0.05) as opened:
        found = solved(opened, error=True)
    assert found.bars["force"][-1, 0] > 0.08 * abs(found.last()["force"])
    assert "is not met: the voxels leave 8 % open, however many" in found.states.reasons[-1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"refine": {"error": 0.01, "probe": "top"}}, "refine.probe: there is no probe 'top'"),
        ({"scene": {"dimension": 2, "method": "rkcm-mixed"}}, r"refine\.error.*rkpm-gauss"),
        ({"probe": []}, "refine: needs a probe"),
        ({"refine": {"error": 0.0001}}, r"refine\.error"),
    ],
)
def test_what_cannot_be_refined_is_refused(change, message) -> None:
    with pytest.raises(InputError, match=message):
        Scene.from_tables({**cantilever(error=0.01), **change}).close()
