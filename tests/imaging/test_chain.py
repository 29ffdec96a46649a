"""`myork run`: from the files of a deck to a force and a report, on bodies like the real ones.

The decks of inputs/images are run whole by `benchmarks/runner.py real_images`, for whoever has the
data; here synthetic bodies take the place of their files.
"""

from pathlib import Path

import numpy as np
import pytest
import pyvista

from myork.cli import main
from myork.core.deck import load_deck
from myork.imaging.io import write_image, write_labels
from myork.records import Image, Labels
from myork.stations.explain import stations_of
from myork.summary import read_summary

DECKS = Path(__file__).parents[2] / "inputs" / "images"


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_muscles_of_a_slice_by_a_reference(tmp_path):
    """Two dark muscles in a bright limb, one slice, as calf_reference.toml wants them."""
    x, y = np.meshgrid(np.arange(64) - 31.5, np.arange(64) - 31.5, indexing="ij")
    muscles = np.zeros((64, 64, 1), np.int32)
    muscles[..., 0] = np.where((np.abs(x) < 18) & (np.abs(y) < 10), np.where(x < 0, 1, 2), 0)
    grey = np.where(np.hypot(x, y) < 27, 200.0, 2.0)[..., None]
    grey[muscles > 0] = 70.0
    grey += np.random.default_rng(3).normal(0.0, 2.0, grey.shape)
    affine = np.diag([-2.0, -2.0, 1.0, 1.0])
    write_image(tmp_path / "t1_a.nii.gz", Image(np.abs(grey), affine))
    write_labels(tmp_path / "t1_a_muscles.nii.gz", Labels(muscles, affine, {1: "a", 2: "b"}))
    force, bar = run("calf_reference", tmp_path, tmp_path / "out", "--set", "build.extrude=24")
    assert force["force"] == pytest.approx(0.3 * 30 * 36 * 20 * 0.04, rel=0.05)
    assert 0 < bar["force"] < 0.1 * force["force"]


@pytest.mark.slow
def test_muscles_around_a_bone_that_grow_wider(tmp_path):
    """Two cones with a hole, as the walks leave them to thighs.toml."""
    x, y = np.meshgrid(np.arange(40) * 3.0, np.arange(24) * 3.0, indexing="ij")
    data = np.zeros((40, 24, 10), np.int32)
    for k in range(10):
        for number, middle in ((1, 30.0), (2, 88.0)):
            away = np.hypot(x - middle, y - 36.0)
            data[..., k][away < 20 + k] = number
            data[..., k][away < 6] = 3
    labels = Labels(data, np.diag([3.0, 3.0, 6.0, 1.0]), {1: "left", 2: "right", 3: "bone"})
    write_labels(tmp_path / "labels.nii.gz", labels)
    write_image(tmp_path / "thighs_outphase.nii.gz", Image(data.astype(float), labels.affine))
    force, bar = run("thighs", tmp_path, tmp_path / "out", "--set",
                     f"build.labels={tmp_path / 'labels.nii.gz'}", "--set",
                     "build.collocation_stride=[2,2,1]", "--set",
                     "build.source_stride=[4,4,2]")  # fmt: skip
    # the lowest section without the bone pulls with what its fibers can, more or less
    section = ((data[..., 0] == 1) | (data[..., 0] == 2)).sum() * 0.09
    assert 0.7 < -force["force"] / (0.3 * 30 * section) < 1.5
    assert 0 < bar["force"] < 0.25 * -force["force"]


@pytest.mark.slow
def test_a_grid_of_fibers_is_its_own_surface(tmp_path):
    """A spindle of lines, as biceps.toml wants it."""
    side = np.linspace(-1.0, 1.0, 7)
    a, b, t = np.meshgrid(side, side, np.linspace(-1.0, 1.0, 40), indexing="ij")
    wide = 1.2 * (1.0 - 0.35 * t**2)
    grid = pyvista.StructuredGrid(a * wide, b * wide, 3.0 * t)
    grid.save(tmp_path / "left_biceps_brachii_7x7fibers.vts")
    force, bar = run("biceps", tmp_path, tmp_path / "out")
    # it pulls with more than its ends could by themselves and less than its middle
    middle = (2 * 1.2) ** 2
    assert 0.65**2 < force["force"] / (0.3 * 30 * middle) < 1.0
    assert 0 < bar["force"] < 0.25 * force["force"]
