"""From files to a force: folders in place of decks, files named by decks, `myork run` on bodies.

The decks of inputs/images are run completely by `benchmarks/runner.py real_images`, for users who
have the data; here synthetic bodies replace their files.
"""

import json
import re
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import pyvista
import tomllib
from matplotlib.image import imread

from benchmarks.truths.scanners import gradient_table, stack, weighted, write_gradients
from myork.chain import run_chain
from myork.cli import main
from myork.core.deck import load_deck, text_of_tables
from myork.errors import FileError, InputError
from myork.imaging.diffusion import read_diffusion, tensor_components
from myork.imaging.geometry import check_same_grid, with_axis_at
from myork.imaging.gradients import GradientTable
from myork.imaging.io import read_image, read_labels, write_image, write_labels
from myork.imaging.phantom import make_phantom
from myork.model_file import read_model
from myork.records import Image, Labels
from myork.stations.build import build
from myork.stations.check import check_deck
from myork.stations.data import PATHS, data_overrides
from myork.stations.explain import explain_deck, stations_of
from myork.stations.folder import deck_of_folder
from myork.stations.new import new_deck
from myork.stations.segment import segment
from myork.stations.solve import run_deck
from myork.summary import read_summary, update_summary
from myork.sweeps import sweep
from tests.images import (
    UNITS,
    affine_of,
    angle,
    built,
    centred,
    labels_in,
    phantom_dwi,
    save,
    segmented,
)
from tests.scenes import refuses

AFFINE = np.diag([2.0, 2.0, 6.0, 1.0])
FIBER = np.array([0.0, np.sin(np.radians(20)), np.cos(np.radians(20))])


def tree(folder, labels=True):
    """A subject: T1 image of a leg, diffusion with fibers inclined by 20 degrees, labels."""
    for name in ("anat", "dwi"):
        (folder / name).mkdir(parents=True)
    r = np.hypot(*centred(40, 40, 6)[:2])
    anatomy = np.select([r < 12, r < 17], [300.0, 900.0], 0.0)
    anatomy += np.random.default_rng(1).normal(0, 15, r.shape) * (anatomy > 0)
    table = gradient_table(12)
    tensor = tensor_components(1.2e-3 * np.eye(3) + 0.8e-3 * np.outer(FIBER, FIBER))
    signal = weighted(np.where(r < 17, 500.0, 0.0), tensor, table)
    save(folder / "anat", AFFINE, **{"sub-01_T1w": anatomy})
    save(folder / "dwi", AFFINE, **{"sub-01_dwi": signal})
    write_gradients(folder / "dwi", "sub-01_dwi", table, AFFINE)
    if labels:
        save(folder / "anat", AFFINE, **{"sub-01_dseg": (r < 12).astype(int)})
        (folder / "anat" / "sub-01_dseg.json").write_text(json.dumps({"Manual": True}))
        (folder / "anat" / "sub-01_dseg.tsv").write_text("index\tname\n0\tnone\n1\tsoleus\n")


@pytest.mark.slow
def test_a_bids_subject_with_labels_becomes_a_force(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tree(tmp_path / "study" / "sub-01")
    assert main(["run", "study", "-q", "--set", "build.collocation_stride=[4,4,1]",
                 "--set", "build.source_stride=[8,8,1]"]) == 0  # fmt: skip
    out = tmp_path / "out" / "study"
    summary = read_summary(out)
    assert summary["verdict"]["state"] in ("accepted", "doubtful")
    assert summary["steps"][-1]["probes"]["force"] > 0
    assert summary["model"]["muscles"][0]["muscle"] == "soleus"
    assert angle(read_image(out / "fibers.nii.gz", 3).data[20, 20, 3], FIBER) < 1.0
    assert (out / "report.html").is_file()


@pytest.mark.slow
def test_a_bids_subject_without_labels_has_tissues(tmp_path):
    tree(tmp_path / "sub-01", labels=False)
    deck, lines = deck_of_folder(tmp_path / "sub-01", tmp_path / "out")
    assert "no label map (_dseg)" in lines[-2]
    assert main(["segment", str(deck), "-q", "--out", str(tmp_path / "out")]) == 0
    for name in ("segmentation", "tissue"):
        picture = imread(tmp_path / "out" / f"{name}.png")
        # the image is grey, the contours are coloured
        coloured = np.ptp(picture[..., :3], axis=-1) > 0.3
        assert 100 < coloured.sum() < 0.3 * coloured.size
    tissue = read_labels(tmp_path / "out" / "tissue.nii.gz")
    names = {name: label for label, name in tissue.names.items()}
    assert tissue.data[20, 20, 3] == names["muscle"] and tissue.data[20, 6, 3] == names["fat"]


def touched(*paths):
    """Empty files in folders, which are created."""
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def test_echoes_of_a_tree_and_what_is_refused(tmp_path):
    folder = tmp_path / "sub-01" / "anat"
    for part, echo in product(("mag", "phase"), (2, 1, 10)):
        touched(folder / f"sub-01_echo-{echo}_part-{part}_MEGRE.nii.gz")
    deck, lines = deck_of_folder(tmp_path, tmp_path)
    order = [deck.read_text().index(f"sub-01_echo-{k}_part-mag") for k in (1, 2, 10)]
    assert order == sorted(order) and "water and fat of 3 echoes" in lines[1]
    touched(tmp_path / "other" / "scan.nii")
    said = "contains no image that can be identified"
    refuses(said, deck_of_folder, tmp_path / "other", tmp_path)


def test_a_folder_of_decks_is_no_folder_of_images(tmp_path):
    refuses("contains no DICOM images", deck_of_folder, tmp_path, tmp_path, kind=FileError)
    touched(tmp_path / "box.toml")
    refuses("is a folder; name a deck inside it, such as .*box.toml", deck_of_folder, tmp_path,
            tmp_path)  # fmt: skip


def test_runs_visits_and_tables_of_the_root(tmp_path):
    """A tree like public ones: visits, runs, acquisitions; tables inherited by all images."""
    study = tmp_path / "study"
    visit = study / "sub-01" / "ses-2"
    tree(visit, labels=False)
    for path in [*visit.rglob("sub-01*")]:
        run = "_acq-ep2d_run-1_dwi" if "dwi" in path.name else "_run-1_T1w"
        path.rename(path.with_name("sub-01_ses-2" + run + path.name[path.name.index(".") :]))
    for kind in ("bval", "bvec"):
        (table,) = visit.rglob(f"*.{kind}")
        table.rename(study / f"acq-ep2d_dwi.{kind}")
    for run, echo, part in product((1, 2), (1, 2, 3), ("mag", "phase")):
        name = f"sub-01_ses-2_acq-ME_run-{run}_echo-{echo}_part-{part}_MEGRE.nii.gz"
        touched(visit / "anat" / name)
    touched(visit / "anat" / "sub-01_ses-2_run-2_T1w.nii.gz")
    touched(study / "sub-01" / "ses-1" / "anat" / "sub-01_ses-1_T1w.nii.gz")
    said = "contains 2 subjects or visits; give the folder of one, such as .*sub-01/ses-1"
    refuses(said, deck_of_folder, study, tmp_path)
    deck, lines = deck_of_folder(visit, tmp_path)
    assert "water and fat of 3 echoes" in lines[1] and "run-1_echo-1" in lines[1]
    assert deck.read_text().count("run-2") == 0
    (dwi,) = visit.rglob("*dwi.nii.gz")
    images, gradients = read_diffusion(dwi)
    assert images.data.shape[3] == len(gradients.b) == 13
    for path in visit.rglob("*MEGRE.nii.gz"):
        path.unlink()
    _, lines = deck_of_folder(visit, tmp_path)
    assert "run-1_T1w.nii.gz (first of 2)" in lines[1] and "ep2d_run-1_dwi" in lines[2]


@pytest.mark.slow
def test_a_dicom_folder(tmp_path):
    """An anatomy, a localiser and a diffusion series in one folder, as exported by the scanner."""
    folder, table = tmp_path / "scan", gradient_table(6)
    tensor = 1e-3 * np.array([0.9, 1.1, 1.6, 0.1, -0.2, 0.3])
    values = weighted(np.full((16, 12, 3), 2000.0), tensor, table)
    stack(folder, values, np.eye(3), number=7, weighting=table)
    for number, size, slices, name in ((1, 8, 1, "localizer"), (3, 48, 3, "t1_tse")):
        i, j, k = np.indices((size, size, slices)) - size / 2 + 0.5
        r = np.hypot(i, j) * 48 / size
        values = np.select([r < 14, r < 20], [300, 900], 0) + (r < 20) * (3 * (i + k) % 17)
        stack(folder, values, np.eye(3), first=[-40, -40, 0], number=number, SeriesDescription=name)
    deck, lines = deck_of_folder(folder, tmp_path / "out")
    assert "scan:series=3 (first of 2)" in lines[1] and lines[2].endswith("scan:series=7")
    run_chain(deck, tmp_path / "out")
    assert set(np.unique(labels_in(tmp_path / "out", "tissue"))) >= {0, 1, 2}


SCHEMA = Path(__file__).parents[2] / "fortran" / "deck" / "schema.toml"

DECK = """title = "own"
[units]
force = "N"
length = "cm"
[scene]
dimension = 3
[image]
anatomy = "t1.nii.gz"
truth = "truth.nii.gz"
"""


def test_every_path_of_images_is_known():
    schema = tomllib.loads(SCHEMA.read_text())
    keys = {
        f"{table}.{key}"
        for table in ("image", "dixon", "build", "tissue")
        for key, entry in schema[table].items()
        if isinstance(entry, dict) and entry.get("unit") == "path"
    }
    assert keys == set(PATHS)


@pytest.fixture
def deck(tmp_path):
    path, folder = tmp_path / "decks" / "own.toml", tmp_path / "data" / "first visit"
    touched(path, path.with_name("truth.nii.gz"), folder / "t1.nii.gz", folder / "truth.nii.gz")
    path.write_text(DECK)
    return path


def test_files_of_the_folder_come_first_then_those_beside_the_deck(deck, tmp_path):
    """Beside the deck those of another subject may lie: here a truth."""
    visit = tmp_path / "data" / "first visit"
    found = [f"image.anatomy={visit / 't1.nii.gz'}", f"image.truth={visit / 'truth.nii.gz'}"]
    assert data_overrides(deck, tmp_path / "data") == found
    (visit / "truth.nii.gz").unlink()
    found.pop()
    assert data_overrides(deck, tmp_path / "data") == found
    assert data_overrides(deck, tmp_path / "data", found) == []
    # as in a BIDS tree, in which each subject has files of the same names
    wanted = tmp_path / "data" / "sub-02" / "anat" / "t1.nii.gz"
    touched(wanted)
    own = ["image.anatomy=sub-02/anat/t1.nii.gz"]
    assert data_overrides(deck, tmp_path / "data", own) == [f"image.anatomy={wanted}"]


def test_missing_and_double_files_are_reported(deck, tmp_path):
    data = tmp_path / "data"
    refuses("there is no such folder", data_overrides, deck, data / "nowhere", kind=FileError)
    said, own = r"there is no other.nii.gz \(image.anatomy\) below", ["image.anatomy=other.nii.gz"]
    refuses(said, data_overrides, deck, data, own, kind=FileError)
    touched(data / "t1.nii.gz")
    refuses("2 files .* t1.nii.gz .* --set image.anatomy=PATH", data_overrides, deck, data)


def test_the_command_reads_the_file_that_was_found(deck, tmp_path, capsys):
    # The file is empty, and the message gives its path.
    assert main(["segment", str(deck), "--data", str(tmp_path / "data")]) == 2
    assert str(tmp_path / "data" / "first visit" / "t1.nii.gz") in capsys.readouterr().err


def test_of_several_files_those_at_the_deck_stay_there(tmp_path, monkeypatch):
    """The deck is called from another folder, which must not be prefixed to its files twice."""
    monkeypatch.chdir(tmp_path)
    touched(*(tmp_path / name for name in ("deck/t1.nii.gz", "deck/t2.nii.gz", "data/t3.nii.gz")))
    image = 'anatomy = "t1.nii.gz"\nchannels = ["t2.nii.gz", "t3.nii.gz"]\n'
    (tmp_path / "deck" / "a.toml").write_text(DECK.split("anatomy")[0] + image)
    (found,) = data_overrides("deck/a.toml", "data")
    places = [str(tmp_path / name) for name in ("deck/t2.nii.gz", "data/t3.nii.gz")]
    assert found == f"image.channels={json.dumps(places)}"


def test_what_is_chosen_in_a_folder_stays_behind_its_name(deck, tmp_path):
    place = tmp_path / "data" / "visit" / "scan"
    place.mkdir(parents=True)
    asked = [
        'dixon.magnitude=["scan:series=5,echo=1", "scan:series=5,echo=2"]',
        f'dixon.phase=["{place}:echo=1", "{place}:echo=2"]',
        f"image.anatomy={place}:kind=water",
    ]
    *_, found = data_overrides(deck, tmp_path / "data", asked)
    wanted = [f"{place}:series=5,echo={echo}" for echo in (1, 2)]
    assert found == f"dixon.magnitude={json.dumps(wanted)}"


DECKS = Path(__file__).parents[2] / "inputs" / "images"


@pytest.mark.parametrize("path", sorted(DECKS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_deck_of_real_images_goes_on_to_a_force(path):
    values = load_deck(path, command="solve")
    surface = "surface" in values["build"]
    assert stations_of(values) == [*([] if surface else ["segment"]), "build", "solve"]
    assert values["load"]["activation"] == 0.3 and values["boundary"]
    assert values["probe"][0]["name"] == "force"
    # fibers come from tracts, or the deck says how to make them
    assert ("tracts" in values["build"]) != values["build"]["flow"]


def test_the_attachments_that_the_deck_of_labels_shows_are_right(tmp_path):
    """Its last comment is also a deck: a surface by its normals and bone, on springs."""
    path = new_deck("labels", tmp_path / "deck.toml")
    before, shown = path.read_text().split("aponeuroses, which are compliant", 1)
    shown, after = shown.split("[load]", 1)
    lines = [line.removeprefix("# ").removeprefix("#") for line in shown.splitlines()[1:]]
    path.write_text("\n".join([before, *lines, "[load]" + after]))
    values = load_deck(path, ["build.bone=[3]"], command="solve")
    assert values["set"][0]["where"] == "nx < -0.4"
    assert [one["set"] for one in values["boundary"]] == ["bottom", "top", "aponeurosis", "bone"]


def run(name, data, *overrides):
    """Last probes of a deck of inputs/images on files of a folder, and their bars."""
    out = data / "out"
    words = [str(DECKS / f"{name}.toml"), "--data", str(data), "--out", str(out), "-q"]
    assert main(["run", *words, *(word for text in overrides for word in ("--set", text))]) == 0
    assert (out / "report.html").stat().st_size > 10000
    summary = read_summary(out)
    last = summary["steps"][-1]
    assert summary["verdict"]["state"] != "refused" and last["load"] == 1.0
    return last["probes"], last["probe_errors"]


@pytest.mark.slow
def test_a_pennate_muscle_between_two_aponeuroses(tmp_path):
    """A slab whose fibers run from one face to the other, as required by mg_tracts.toml."""
    lean = np.radians(20.0)
    way = np.arange(0, 90, 2.0)[:, None] * [np.sin(lean), 0.0, np.cos(lean)]
    pyvista.Box((-12, 12, -20, 20, 0, 120)).triangulate().save(tmp_path / "MG.stl")
    starts = np.random.default_rng(1).uniform([-50, -20, -10], [12, 20, 60], (300, 3))
    points = (starts[:, None] + way).reshape(-1, 3)
    np.savez(tmp_path / "tracts_MG.npz", points=points, offsets=np.arange(301) * len(way))
    force, bar = run("mg_tracts", tmp_path, "build.slices=[1,28]", "build.voxel=[3,4,4]")
    # the fibers across a face carry it: stress, cosine along the leg, section across the fibers
    estimate = 0.3 * 30 * np.cos(lean) * np.sin(lean) * 4.0 * 11.2
    assert -force["force"] == pytest.approx(estimate, rel=0.35)
    sum_of_all = force["force"] + force["force_proximal"] + force["force_top"]
    assert abs(sum_of_all) < 0.02 * abs(force["force"])
    assert 0 < bar["force"] < 0.25 * abs(force["force"])


@pytest.mark.slow
def test_muscles_of_a_slice_by_a_reference(tmp_path):
    """Two dark muscles in a bright limb, one slice, as required by calf_reference.toml."""
    x, y, _ = centred(64, 64, 1)
    muscles = np.where((np.abs(x) < 18) & (np.abs(y) < 10), np.where(x < 0, 1, 2), 0)
    grey = np.select([muscles > 0, np.hypot(x, y) < 27], [70.0, 200.0], 2.0)
    grey += np.random.default_rng(3).normal(0.0, 2.0, grey.shape)
    affine = affine_of((-2.0, -2.0, 1.0))
    labels = Labels(muscles.astype(np.int32), affine, {1: "a", 2: "b"})
    save(tmp_path, affine, t1_a=np.abs(grey), t1_a_muscles=labels)
    force, bar = run("calf_reference", tmp_path, "build.extrude=24")
    assert force["force"] == pytest.approx(0.3 * 30 * 36 * 20 * 0.04, rel=0.05)
    assert 0 < bar["force"] < 0.1 * force["force"]


@pytest.mark.slow
def test_muscles_around_a_bone_that_grow_wider(tmp_path):
    """Two cones with a hole, as the walks pass them to thighs.toml."""
    x, y, k = np.indices((40, 24, 10)) * np.reshape([3.0, 3.0, 1.0], (3, 1, 1, 1))
    data = np.zeros(x.shape, np.int32)
    for number, middle in ((1, 30.0), (2, 88.0)):
        away = np.hypot(x - middle, y - 36.0)
        data[away < 20 + k], data[away < 6] = number, 3
    affine = affine_of((3.0, 3.0, 6.0))
    labels = Labels(data, affine, {1: "left", 2: "right", 3: "bone"})
    save(tmp_path, affine, labels=labels, thighs_outphase=data.astype(float))
    force, bar = run("thighs", tmp_path, f"build.labels={tmp_path / 'labels.nii.gz'}",
                     "build.collocation_stride=[2,2,1]", "build.source_stride=[4,4,2]")  # fmt: skip
    # the smallest section without the bone pulls with about the capacity of its fibers
    section = ((data[..., 0] == 1) | (data[..., 0] == 2)).sum() * 0.09
    assert 0.7 < -force["force"] / (0.3 * 30 * section) < 1.5
    assert 0 < bar["force"] < 0.25 * -force["force"]


@pytest.mark.slow
def test_a_grid_of_fibers_is_its_own_surface(tmp_path):
    """A spindle of lines, as required by biceps.toml."""
    side = np.linspace(-1.0, 1.0, 7)
    a, b, t = np.meshgrid(side, side, np.linspace(-1.0, 1.0, 40), indexing="ij")
    wide = 1.2 * (1.0 - 0.35 * t**2)
    grid = pyvista.StructuredGrid(a * wide, b * wide, 3.0 * t)
    grid.save(tmp_path / "left_biceps_brachii_7x7fibers.vts")
    force, bar = run("biceps", tmp_path)
    # its force is larger than that of its ends alone and smaller than that of its middle
    assert 0.65**2 < force["force"] / (0.3 * 30 * (2 * 1.2) ** 2) < 1.0
    assert 0 < bar["force"] < 0.25 * force["force"]


# ---- the stations segment and build on decks: files, summary, errors -----------------------------


@pytest.fixture(scope="module")
def mg(tmp_path_factory, inputs):
    """Output folder after both stations of `mg_muscle`, and the lines of progress."""
    out, lines = tmp_path_factory.mktemp("mg"), []
    for station in (segment, build):
        station(inputs / "mg_muscle.toml", out, progress=lines.append)
    return out, lines


@pytest.mark.slow
def test_files_and_summary_of_the_phantom(mg):
    out, lines = mg
    image, labels = read_image(out / "anatomy.nii.gz"), read_labels(out / "segmentation.nii.gz")
    fibers, truth = read_image(out / "fibers.nii.gz", 3), read_labels(out / "truth.nii.gz")
    read_image(out / "tensor.nii.gz", 6)
    for other in (labels, fibers, truth):
        check_same_grid(other, image)
    assert labels.names == {1: "medial_gastrocnemius"}
    summary = read_summary(out)
    found = summary["segmentation"]
    entry = found["labels"]["medial_gastrocnemius"]
    assert entry["pixels"] == int((labels.data == 1).sum())
    # Volume in the deck's unit: 1.25 x 1.25 x 6 mm voxels in cm^3.
    assert entry["volume"] == pytest.approx(entry["pixels"] * 9.375e-3, rel=1e-5)
    score = found["scores"]["medial_gastrocnemius"]
    assert score["dice"] > 0.97 and score["pcc"] > 0.97 and min(score["dice_by_slice"]) > 0.95
    assert len(found["energy"]) == found["iterations"] and found["converged"]
    assert (np.diff(found["energy"]) <= 0).all()
    model = read_model(out / "model.h5")
    assert summary["model"]["source_points"] == len(model.source)
    assert summary["model"]["points_without_fiber"] == 0
    units = {"force": "N", "length": "cm", "stress": "N/cm^2", "volume": "cm^3"}
    assert summary["units"] == units
    files = [line.split()[0] for line in model.source_images.splitlines()]
    assert files == ["segmentation.nii.gz", "fibers.nii.gz"]
    assert any("Dice" in line for line in lines)
    # Pennation 22 degrees times 1.15 at the lower and 0.85 at the upper end; noise of a degree.
    lean = np.degrees(np.arccos(np.abs(model.fiber[:, 2])))
    low, high = model.points[:, 2] < 1.0, model.points[:, 2] > 7.4
    assert np.median(lean[low]) == pytest.approx(25.0, abs=1.0)
    assert np.median(lean[high]) == pytest.approx(19.0, abs=1.0)


#: All muscles as two regions
MUSCLES = {
    "scene": {"dimension": 3},
    "image": {"phase": "dark"},
    "bias": {"method": "none"},
    "build": {"collocation_stride": [4, 4, 1], "source_stride": [8, 8, 1]},
}


@pytest.fixture
def own(tmp_path):
    """A deck on the user's files, and their folder."""
    (tmp_path / "deck.toml").write_text(text_of_tables(MUSCLES))
    phantom = make_phantom()
    images = {"t1": phantom.anatomy, "dti": phantom.tensor, "truth": phantom.truth}
    save(tmp_path, phantom.truth.affine, **images)

    def run(*overrides, station=segment, names=("anatomy=t1", "truth=truth")):
        options = [f"image.{name}.nii.gz" for name in names]
        return station(tmp_path / "deck.toml", tmp_path / "out", overrides=[*options, *overrides])

    return run, tmp_path


@pytest.mark.parametrize("axis", [0, 1])
def test_results_are_those_of_the_slices_wherever_a_file_has_them(tmp_path, axis):
    """Sagittal slices, as one axis of the file or another: the same labels at the same places."""
    phantom = make_phantom(size=(40, 40, 4), spacing=(3.0, 3.0, 9.0))
    outs = []
    for name, place in (("last", 2), ("other", axis)):
        folder = tmp_path / name
        folder.mkdir()
        images = {"t1": phantom.anatomy, "dti": phantom.tensor, "truth": phantom.truth}
        placed = {key: with_axis_at(one, 2, place) for key, one in images.items()}
        save(folder, phantom.truth.affine, **placed)
        keys = {"phase": "dark", "partial": True, "tolerance": 0.1}
        files = {"anatomy": "t1.nii.gz", "tensor": "dti.nii.gz", "truth": "truth.nii.gz"}
        tables = {"image": keys | files, "bias": {"method": "auto"}, "tissue": {"find": True}}
        summary = segmented(folder, **tables)
        assert not summary["resampled"]
        outs.append((folder / "out", summary["segmentation"]["scores"]))
    (last, score), (other, same) = outs
    assert same == score
    for path in sorted(last.glob("*.nii.gz")):
        one, two = (read_image(folder / path.name, None) for folder in (last, other))
        one = with_axis_at(one, 2, axis)
        if "fibers" in path.name:
            # tensors are averaged on their own file's grid; sums in another order separate
            # families of fibers differently in a few voxels
            inside = one.data.any(axis=-1)
            np.testing.assert_array_equal(two.data.any(axis=-1), inside)
            assert np.percentile(angle(one.data[inside], two.data[inside]), 95) < 0.1
        else:
            np.testing.assert_array_equal(two.data, one.data, path.name)
        np.testing.assert_allclose(two.affine, one.affine, atol=1e-5)


def test_exchanged_gradient_axes_are_said_where_tensors_become_fibers(tmp_path):
    x, y, _ = centred(20, 16, 12)
    inside = (x / 8) ** 2 + (y / 6) ** 2 < 1
    tensor = inside[..., np.newaxis] * [1.2e-3, 1.2e-3, 2e-3, 0.0, 0.0, 0.0]
    save(tmp_path, affine_of((1, 1, 2.5)), bar=inside.astype(np.int32), dti=tensor)
    lines = []
    for axes, said in (("x y z", False), ("z y x", True)):
        image = {"tensor": "dti.nii.gz", "region": "bar.nii.gz", "gradient_axes": axes}
        deck = {"scene": {"dimension": 3}, "units": UNITS, "image": image}
        deck["build"] = {"labels": "bar.nii.gz", "source_stride": [4, 4, 2]}
        (tmp_path / "deck.toml").write_text(text_of_tables(deck))
        build(tmp_path / "deck.toml", tmp_path / "out", progress=lines.append)
        warned = [line for line in lines if "axes of the diffusion gradients are swapped" in line]
        assert bool(warned) == said and all(line.startswith("warning") for line in warned)
    along = read_image(tmp_path / "out" / "fibers.nii.gz", 3).data[..., ::-1]
    for axes, said in ((along, False), (along[..., ::-1], True)):
        save(tmp_path, affine_of((1, 1, 2.5)), f=3.0 * np.where(inside[..., None], axes, np.nan))
        table = {"labels": "bar.nii.gz", "fibers": "f.nii.gz", "source_stride": [4, 4, 2]}
        warned = [
            text for text in built(tmp_path, **table)["warnings"] if "cross the walls" in text
        ]
        assert len(warned) == said


def test_build_says_its_size_and_leaves_labels_out_that_are_not_chosen(tmp_path):
    data = np.zeros((12, 8, 6), np.int32)
    data[:5], data[7:] = 3, 12
    save(
        tmp_path, affine_of((2, 2, 5)), l=data, a=np.where(np.arange(6) < 3, 0.8, 0.0) * (data > 0)
    )
    material = {"name": "m", "label": 12, "model": "neo-hookean", "mu": 1.0, "K": 9.0}
    deck = {"scene": {"dimension": 3}, "units": UNITS | {"length": "cm"}, "material": [material]}
    deck["build"] = {"labels": str(tmp_path / "l.nii.gz"), "ids": [12], "source_stride": [2, 2, 2]}
    deck["build"]["activation"] = str(tmp_path / "a.nii.gz")
    lines = []
    found = build(deck, tmp_path / "out", progress=lines.append)["model"]
    assert "build.activation: 0.4 on average over the model" in lines
    assert [row["muscle"] for row in found["muscles"]] == ["m"]
    (said,) = [line for line in lines if line.startswith("body of ")]
    places = r"\((.+), (.+), (.+)\)"
    shown = re.fullmatch(rf"body of (.+) x (.+) x (.+) mm, from {places} to {places} cm", said)
    size, low, high = np.array(shown.groups(), float).reshape(3, 3)
    # five, eight and six voxels; edge points move along normals by less than a tenth of a voxel
    np.testing.assert_allclose([size, 10 * (high - low)], [[10.0, 16.0, 30.0]] * 2, atol=0.2)


def test_a_model_of_another_label_map_is_not_solved(tmp_path, monkeypatch):
    """After a change of the map the force would be that of the body before."""
    monkeypatch.chdir(tmp_path)
    voxels = np.pad(np.ones((4, 4, 6), np.uint8), 1)
    map_ = tmp_path / "l.nii.gz"
    write_labels(map_, Labels(voxels.astype(np.int32), np.eye(4)))
    deck = tmp_path / "a.toml"
    deck.write_text(
        '[scene]\ndimension = 3\n[geometry]\nkind = "model"\n[units]\nforce = "N"\nlength = "cm"\n'
        '[[material]]\nname = "m"\nlabel = 1\nmodel = "neo-hookean"\nmu = 1\nK = 9\n'
        '[[boundary]]\nset = "bottom"\nu_x = 0\nu_y = 0\nu_z = 0\n'
        '[[boundary]]\nset = "top"\ntraction = [0, 0, 0.01]\n'
        '[[probe]]\nname = "u"\nquantity = "u_z"\nset = "top"\n[build]\nlabels = "l.nii.gz"\n'
    )
    out = tmp_path / "out" / "a"
    with_stride = ["build.collocation_stride=[1,1,1]"]
    uses = [
        partial(run_deck, deck, out), partial(explain_deck, deck, progress=lambda _: None),
        partial(check_deck, deck, out, quick=True),
        # the points of a sweep are those of `out/<deck>`
        partial(sweep, deck, ["material.mu=1"], tmp_path / "a_sweep", dry_run=True),
    ]  # fmt: skip
    build(deck, out, overrides=with_stride)
    assert run_deck(deck, out, threads=1)["converged"]
    for use in uses:
        use(overrides=with_stride)
        for word in (f"build.labels={map_}", "build.source_stride=[2,2,2]"):
            use(overrides=[word])
        for word in ("build.source_stride=[1,1,1]", "image.region=a.nii.gz"):
            refuses(f"--set {re.escape(word)}: acts before .* is made", use, overrides=[word])
    voxels[1] = 0
    write_labels(map_, Labels(voxels.astype(np.int32), np.eye(4)))
    for use in uses:
        refuses("build.labels: .* is not the file that .*model.h5 was built from", use)


@pytest.mark.slow
def test_tensor_gives_fibers_and_a_run_without_takes_them_away(own):
    run, folder = own
    run(names=("anatomy=t1", "tensor=dti"))
    fibers = read_image(folder / "out" / "fibers.nii.gz", 3).data
    labels = labels_in(folder / "out")
    np.testing.assert_allclose(np.linalg.norm(fibers, axis=-1), labels, atol=1e-6)
    # every muscle; the cortex of bones is as dark as muscle and counts as muscle
    assert run()["segmentation"]["scores"]["muscle"]["dice"] > 0.9
    assert not (folder / "out" / "fibers.nii.gz").exists()
    model = run(station=build)["model"]
    assert model["points_without_fiber"] == model["collocation_points"]
    # bad tensors are counted
    tensor = read_image(folder / "dti.nii.gz", 6)
    tensor.data[40:44, 40, 7] = np.nan
    write_image(folder / "nan.nii.gz", tensor)
    warnings = run(names=("anatomy=t1", "tensor=nan"))["segmentation"]["warnings"]
    assert any("nan.nii.gz" in text and "neighbours replaces them" in text for text in warnings)


@pytest.mark.slow
def test_diffusion_images_give_fibers_and_a_wrong_table_is_reported(own):
    run, folder = own
    phantom = make_phantom()
    dwi, table = phantom_dwi(phantom, directions=12)
    write_image(folder / "dwi.nii.gz", dwi)
    write_gradients(folder, "dwi", table, dwi.affine)
    names = ("anatomy=t1", "dwi=dwi", "truth=truth", "region=truth")
    found = run(names=names)["segmentation"]
    assert found["orientation"][0]["axes"] == "x y z"
    assert not any("gradient" in text for text in found["warnings"])
    fibers = read_image(folder / "out" / "fibers.nii.gz", 3).data
    inside = (phantom.tissue.data == 1) & fibers.any(axis=-1)
    # Required: 3 degrees at SNR 25 (there with 30 directions)
    assert np.median(angle(fibers, phantom.fiber.data)[inside]) < 3.0
    wrong = GradientTable(table.b, table.direction * [1.0, -1.0, 1.0])
    write_gradients(folder, "dwi", wrong, dwi.affine)
    warnings = run(names=names)["segmentation"]["warnings"]
    assert any('image.gradient_axes = "x -y z"' in text for text in warnings)
    warnings = run('image.gradient_axes="x -y z"', names=names)["segmentation"]["warnings"]
    assert not any("gradient" in text for text in warnings)
    (folder / "dwi.bval").write_text("0 500 500")
    refuses(r"dwi.bval has 3 values .* 13 diffusion images", run, names=names)
    shifted = dwi.affine + 5.0 * np.eye(4, k=3)
    write_image(folder / "dwi.nii.gz", Image(dwi.data, shifted))
    write_gradients(folder, "dwi", table, shifted)
    (entry,) = run(names=names)["resampled"]
    assert entry["file"].endswith("dwi.nii.gz") and entry["how"] == "tensor-wise"
    assert entry["shift"] == pytest.approx(5.0)


@pytest.mark.slow
def test_a_region_and_a_body_of_the_user_are_kept_whole(own):
    run, folder = own
    labels, image = read_labels(folder / "truth.nii.gz"), read_image(folder / "t1.nii.gz").data
    # Half of the calf and a strip of air beside it, which is not body for any threshold
    mine = np.zeros(labels.data.shape, np.int32)
    mine[:48] = 1
    save(folder, labels.affine, mine=mine, nothing=0 * mine, near=labels.data == 3)
    for key in ("region", "body"):
        run("image.margin=0", "bias.method=auto", names=("anatomy=t1", f"{key}=mine"))
        np.testing.assert_array_equal(labels_in(folder / "out", "regions") > 0, mine > 0)
        field = read_image(folder / "out" / "bias.nii.gz").data
        anatomy = read_image(folder / "out" / "anatomy.nii.gz").data
        np.testing.assert_allclose(anatomy * field, image, rtol=1e-5)
    said = "image.body: .*nothing.nii.gz: the body is empty"
    refuses(said, run, names=("anatomy=t1", "body=nothing"))
    said = "voxels of image.region lie outside of image.body"
    refuses(said, run, names=("anatomy=t1", "body=mine", "region=truth"))
    # a muscle of a label map, within a margin
    names = ("anatomy=t1", "truth=near", "region=near")
    summary = run("image.margin=1.3", names=names)
    assert summary["segmentation"]["scores"]["muscle"]["dice"] > 0.95


@pytest.mark.slow
def test_bias_corrected_image_and_grouping_by_a_reference(own):
    run, _ = own
    found = run("bias.method=auto", "image.reference=truth.nii.gz", "image.regions=3",
                "image.tolerance=0.001")["segmentation"]  # fmt: skip
    # Fat separates the muscles of this phantom, so that each is a component of a region; the third
    # region is cortex, which would connect them.
    assert len(found["scores"]) == 6
    assert all(score["dice"] > 0.9 for score in found["scores"].values())
    assert len(found["scores"]["soleus"]["dice_by_slice"]) == 15
    assert (np.diff(found["energy"]) <= 0).all()


@pytest.mark.slow
def test_errors_name_file_or_key_and_what_to_do(own):
    run, _ = own
    refuses(r"image.truth needs image.anatomy", run, names=("truth=truth",))
    with pytest.raises(InputError, match=r"region to segment is empty; check image.box"):
        run("image.box=[900, 910, 900, 910, 900, 910]")
    refuses(r"there is no label map; run `myork segment`", run, kind=FileError, station=build)


def test_summary_keeps_other_entries_and_survives_a_broken_file(tmp_path):
    update_summary(tmp_path, {"a": 1, "b": {"c": float("nan")}})
    update_summary(tmp_path, {"a": [2, float("inf")]})
    assert json.loads((tmp_path / "summary.json").read_text()) == {"a": [2, None], "b": {"c": None}}
    (tmp_path / "summary.json").write_text("{")
    update_summary(tmp_path, {"a": 3})
    assert json.loads((tmp_path / "summary.json").read_text()) == {"a": 3}
