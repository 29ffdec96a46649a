"""`myork run`: from the files of a deck to a force and a report, on bodies like the real ones.

The decks of inputs/images are run whole by tests/bench/real_images.py, for whoever has the data;
here synthetic bodies take the place of their files.
"""

from pathlib import Path

import numpy as np
import pytest
import pyvista

from myork.chain import stations_of
from myork.cli import main
from myork.core.deck import load_deck
from myork.summary import read_summary

DECKS = Path(__file__).parents[2] / "inputs" / "images"
COARSE = ["--set", "build.source_stride=[4,4,2]"]


@pytest.mark.parametrize("path", sorted(DECKS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_deck_of_real_images_goes_on_to_a_force(path):
    values = load_deck(path, command="solve")
    surface = "surface" in values["build"]
    assert stations_of(values) == [*([] if surface else ["segment"]), "build", "solve"]
    assert values["load"]["activation"] == 0.3 and values["boundary"]
    assert values["probe"][0]["name"] == "force"
    # fibers come from tracts, or the deck says how they are made
    assert ("tracts" in values["build"]) != values["build"]["flow"]


def run(name, data, out, *more):
    words = [str(DECKS / f"{name}.toml"), "--data", str(data), "--out", str(out), "-q", *more]
    assert main(["run", *words]) == 0
    assert (out / "report.html").stat().st_size > 10000
    summary = read_summary(out)
    assert summary["verdict"]["state"] != "refused"
    last = summary["steps"][-1]
    assert last["load"] == 1.0
    return last["probes"], last["probe_errors"]


def lines(starts, way, length):
    """Tracts of the same direction."""
    return [s + np.arange(0, length, 2.0)[:, None] * np.asarray(way) for s in starts]


def test_a_pennate_muscle_between_two_aponeuroses(tmp_path):
    """A slab whose fibers go from one face to the other, as mg_tracts.toml wants it."""
    lean = np.radians(20.0)
    way = np.array([np.sin(lean), 0.0, np.cos(lean)])
    pyvista.Box((-12, 12, -20, 20, 0, 120)).triangulate().save(tmp_path / "MG.stl")
    starts = np.random.default_rng(1).uniform([-50, -20, -10], [12, 20, 60], (300, 3))
    tracts = lines(starts, way, 90)
    np.savez(tmp_path / "tracts_MG.npz", points=np.vstack(tracts),
             offsets=np.arange(301) * len(tracts[0]))  # fmt: skip
    force, bar = run("mg_tracts", tmp_path, tmp_path / "out", "--set", "build.slices=[1,28]",
                     "--set", "build.voxel=[3,4,4]")  # fmt: skip
    # fibers across a face carry it: stress, cosine along the leg, section across the fibers
    estimate = 0.3 * 30 * np.cos(lean) * np.sin(lean) * 4.0 * 11.2
    assert -force["force"] == pytest.approx(estimate, rel=0.35)
    sum_of_all = force["force"] + force["force_proximal"] + force["force_top"]
    assert abs(sum_of_all) < 0.02 * abs(force["force"])
    assert 0 < bar["force"] < 0.25 * abs(force["force"])
