"""The muscle block between fixed ends at the smallest size that is of use, 5 x 5 x 9 at order 4."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.truths.finite_elements import solve_half_block
from myork.bench.materials import along_fibers
from myork.core.deck import load_deck
from myork.stations.solve import run_deck

SIZE = ("geometry.source=[5,5,9]", "geometry.collocation=[9,9,17]")


@pytest.mark.slow
def test_inclined_fibers_meet_finite_elements(inputs: Path, tmp_path: Path) -> None:
    """Within 1.5 % of the deck's references to activation 0.15 in all six quantities.

    Measured: 1.2 %. With full weight of the rows on faces it is 2.1 %, with weights that do not
    fade towards the edges 3 % and more: the bound holds the row weights where the study put them.
    """
    overrides = (*SIZE, "load.steps=3", "load.activation=0.15")
    summary = run_deck(inputs / "muscle_fibers.toml", tmp_path, overrides=overrides, threads=1)
    assert summary["converged"] and len(summary["reference"]) == 6
    for probe, entry in summary["reference"].items():
        assert len(entry["relative_error"]) == 3, probe
        assert max(entry["relative_error"]) < 0.015, probe


@pytest.mark.slow
def test_straight_fibers_keep_their_length_and_volume(inputs: Path, tmp_path: Path) -> None:
    """Nearly uniform: the middle as the exact state far from the ends, J within 1e-3 everywhere.

    The ends' influence on the stress in the middle is 3e-4, on the force 1e-4 (felupe).
    """
    overrides = (
        *SIZE, "material.muscle.fiber_angle=0", "load.steps=1", "load.activation=0.15",
    )  # fmt: skip
    summary = run_deck(inputs / "muscle_fibers.toml", tmp_path, overrides=overrides, threads=1)
    assert summary["converged"]
    deck = load_deck(inputs / "muscle_fibers.toml", overrides)
    exact = along_fibers(deck["material"][0], 1.0, deck["load"]["activation"])
    (step,) = summary["steps"]
    assert step["probes"]["stress_zz"] == pytest.approx(exact, rel=5e-4)
    assert -step["probes"]["reaction_z"] == pytest.approx(exact, rel=5e-4)
    assert step["min_J"] > 0.999 and step["max_J"] < 1.001


@pytest.mark.slow
def test_rival_block_agrees_with_the_references(inputs: Path) -> None:
    """Another code and another element give the same block, 4 x 2 x 8 elements on its half.

    Measured: 0.6 % in displacements and axial values, 2.5 % in the shear stress, 2 % in
    reaction_x, which depends most on the mesh along the edges.
    """
    deck = load_deck(inputs / "muscle_fibers.toml", ["load.activation=0.05"])
    found = solve_half_block(deck, (4, 2, 8))["probes"]
    for entry in deck["reference"]:
        wanted = entry["value"][entry["activation"].index(0.05)]
        rel = 0.04 if entry["probe"] in ("stress_xz", "reaction_x") else 0.01
        assert found[entry["probe"]][0] == pytest.approx(wanted, rel=rel), entry["probe"]
