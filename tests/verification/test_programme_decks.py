"""Decks of load programmes in inputs/: stages, motions, muscles of their own."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.truths.finite_elements import solve_deck
from myork import build, load_deck, run_deck

#: felupe with 6 x 6 x 16 quadratic elements, 18397 unknowns; with 4 x 4 x 12 and 2 x 2 x 6 the
#: torque is 0.1563 and 0.1578, the pull -0.0515 and -0.0546
TWISTED = {"torque": 0.15613, "pull": -0.05116}
SMALL = ("geometry.source=[4,4,7]", "geometry.collocation=[7,7,13]")


def steps(deck: Path, out: Path, *overrides: str) -> dict[str, np.ndarray]:
    """Loads, smallest J and probes of all steps by name."""
    summary = run_deck(deck, out, overrides=overrides, error=False)
    rows = [step | step["probes"] for step in summary["steps"]]
    names = ("load", "min_J", *summary["steps"][0]["probes"])
    return {name: np.array([row[name] for row in rows]) for name in names}


@pytest.mark.slow
def test_twisted_bar_agrees_with_finite_elements(inputs: Path, tmp_path: Path) -> None:
    deck = inputs / "twist.toml"
    coarse = ("geometry.source=[5,5,13]", "geometry.collocation=[9,9,25]")
    found = steps(deck, tmp_path, *coarse, "approximation.order=2", "approximation.support=2.5")
    assert found["torque"][-1] == pytest.approx(TWISTED["torque"], rel=0.01)
    assert found["pull"][-1] == pytest.approx(TWISTED["pull"], rel=0.06)
    # the middle turns by half of the angle, and torque grows with it
    assert found["middle"][-1] == pytest.approx(0, abs=0.02)
    assert np.all(np.diff(found["torque"]) > 0.03)


def test_finite_elements_follow_motions_and_amplitudes(inputs: Path) -> None:
    deck = load_deck(inputs / "twist.toml")
    deck["amplitude"] = [{"name": "back", "time": [0, 0.5, 1], "value": [0, 0.25, 0]}]
    deck["amplitude"][0]["curve"] = "smooth"
    deck["boundary"][1]["amplitude"] = "back"
    found = solve_deck(deck, [1, 1, 4], loads=[0.25, 0.5, 0.75, 1.0])
    torque = found["probes"]["torque"]
    # 22.5, 45 and 22.5 degrees, then at rest again
    assert torque[0] == pytest.approx(torque[2], rel=1e-6)
    assert torque[1] == pytest.approx(2 * torque[0], rel=0.02)
    assert abs(torque[3]) < 1e-9
    assert torque[1] == pytest.approx(TWISTED["torque"] / 4, rel=0.15)


@pytest.mark.slow
def test_a_shortening_muscle_loses_force_and_gives_off_energy(inputs: Path, tmp_path: Path) -> None:
    found = steps(inputs / "shortening.toml", tmp_path, *SMALL)
    active = found["load"] >= 0.2 - 1e-9
    force, length = found["force"][active], 3 + np.linspace(0, -0.6, int(active.sum()))
    assert np.all(np.diff(force) < 0)
    np.testing.assert_allclose(found["stretch"][active], length / 3, atol=0.01)
    # what the muscle does against the plate while its activation stands, by the trapezoidal rule
    work = float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(length)))
    assert np.ptp(found["energy"][active]) == pytest.approx(-work, rel=2e-3)


@pytest.mark.slow
def test_two_muscles_share_the_force_of_a_joint(inputs: Path, tmp_path: Path) -> None:
    coarse = ("build.collocation_stride=[2,2,2]", "build.source_stride=[4,4,4]",
              "geometry.blocks=[8,4,6]")  # fmt: skip
    deck = inputs / "two_muscles.toml"
    build(deck, tmp_path, overrides=coarse)
    probe = {"name": "force_tissue", "quantity": "force_z", "set": "top", "material": "tissue"}
    tables = load_deck(deck, overrides=coarse)
    assert [table["name"] for table in tables["material"]] == ["agonist", "antagonist", "tissue"]
    found = steps(deck, tmp_path, *coarse)
    parts = steps(deck, tmp_path, *coarse, f'probe.force_agonist.material="{probe["material"]}"')
    total = found["force_agonist"] + found["force_antagonist"] + parts["force_agonist"]
    np.testing.assert_allclose(total, found["force"], rtol=1e-9)
    # contraction; the plate gives way; contraction of the other
    assert found["load"] == pytest.approx([0.3, 0.7, 1.0])
    agonist, antagonist = found["force_agonist"], found["force_antagonist"]
    assert agonist[0] > agonist[1] > 0
    assert found["stretch_agonist"][1] < found["stretch_agonist"][0] - 0.01
    assert found["stretch_antagonist"][1] > 1.0
    assert antagonist[2] > antagonist[1] + 4
    assert found["torque"][2] < found["torque"][1] < found["torque"][0]
    # what is between the muscles is pressed, not crushed
    assert found["min_J"].min() > 0.6
