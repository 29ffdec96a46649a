"""A folder of images in place of a deck: BIDS trees and DICOM files as they are."""

import json

import numpy as np
import pytest
from matplotlib.image import imread
from pydicom.uid import generate_uid

from myork.chain import run_chain
from myork.cli import main
from myork.errors import InputError
from myork.imaging.diffusion import read_diffusion
from myork.imaging.gradients import GradientTable
from myork.imaging.io import read_image, read_labels, write_image
from myork.records import Image
from myork.stations.folder import deck_of_folder
from tests.images import angle, even_directions, save, write_gradients
from tests.imaging.test_formats import mr_file, siemens, weighted

AFFINE = np.diag([2.0, 2.0, 6.0, 1.0])
FIBER = np.array([0.0, np.sin(np.radians(20)), np.cos(np.radians(20))])


def tree(folder, labels=True):
    """A subject: T1 image of a leg, diffusion with fibers that lean by 20 degrees, labels."""
    for name in ("anat", "dwi"):
        (folder / name).mkdir(parents=True)
    i, j, _ = np.indices((40, 40, 6)) - np.array([19.5, 19.5, 2.5]).reshape(3, 1, 1, 1)
    r = np.hypot(i, j)
    anatomy = np.select([r < 12, r < 17], [300.0, 900.0], 0.0)
    anatomy += np.random.default_rng(1).normal(0, 15, r.shape) * (anatomy > 0)
    save(folder / "anat", AFFINE, **{"sub-01_T1w": anatomy})
    directions = np.vstack([np.zeros(3), even_directions(12)])
    table = GradientTable(np.array([0.0, *[500.0] * 12]), directions)
    tensor = 1.2e-3 * np.eye(3) + 0.8e-3 * np.outer(FIBER, FIBER)
    weight = np.exp(-table.b * np.einsum("ni,ij,nj->n", directions, tensor, directions))
    signal = np.where(r < 17, 500.0, 0.0)[..., np.newaxis] * weight
    write_image(folder / "dwi" / "sub-01_dwi.nii.gz", Image(signal, AFFINE))
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
    summary = json.loads((out / "summary.json").read_text())
    assert summary["verdict"]["state"] in ("accepted", "doubtful")
    assert summary["steps"][-1]["probes"]["force"] > 0
    assert summary["model"]["muscles"][0]["muscle"] == "soleus"
    fibers = read_image(out / "fibers.nii.gz", 3).data[20, 20, 3]
    assert angle(fibers, FIBER) < 1.0
    assert (out / "report.html").is_file()


@pytest.mark.slow
def test_a_bids_subject_without_labels_has_tissues(tmp_path):
    tree(tmp_path / "sub-01", labels=False)
    deck, lines = deck_of_folder(tmp_path / "sub-01", tmp_path / "out")
    assert "no label map (_dseg)" in lines[-2]
    assert main(["segment", str(deck), "-q", "--out", str(tmp_path / "out")]) == 0
    for name in ("segmentation", "tissue"):
        picture = imread(tmp_path / "out" / f"{name}.png")
        # grey is the image, coloured the contours
        coloured = np.ptp(picture[..., :3], axis=-1) > 0.3
        assert 100 < coloured.sum() < 0.3 * coloured.size
    tissue = read_labels(tmp_path / "out" / "tissue.nii.gz")
    names = {name: label for label, name in tissue.names.items()}
    assert tissue.data[20, 20, 3] == names["muscle"] and tissue.data[20, 6, 3] == names["fat"]


def test_echoes_of_a_tree_and_what_is_refused(tmp_path):
    folder = tmp_path / "sub-01" / "anat"
    folder.mkdir(parents=True)
    for echo in (2, 1, 10):
        for part in ("mag", "phase"):
            (folder / f"sub-01_echo-{echo}_part-{part}_MEGRE.nii.gz").touch()
    deck, lines = deck_of_folder(tmp_path, tmp_path)
    text = deck.read_text()
    order = [text.index(f"sub-01_echo-{echo}_part-mag") for echo in (1, 2, 10)]
    assert order == sorted(order) and "water and fat of 3 echoes" in lines[1]
    for echo in (2, 1, 10):
        (folder / f"sub-01_echo-{echo}_MESE.nii.gz").touch()
    deck, lines = deck_of_folder(tmp_path, tmp_path)
    text = deck.read_text()
    order = [text.index(f"sub-01_echo-{echo}_MESE") for echo in (1, 2, 10)]
    assert order == sorted(order) and "T2 of 3 echoes" in lines[2]
    (tmp_path / "sub-02").mkdir()
    (tmp_path / "sub-02" / "sub-02_T1w.nii.gz").touch()
    with pytest.raises(InputError, match="holds 2 subjects or visits; name the folder of one"):
        deck_of_folder(tmp_path, tmp_path)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "scan.nii").touch()
    with pytest.raises(InputError, match="holds no image whose name or header says what it is"):
        deck_of_folder(tmp_path / "other", tmp_path)


def test_runs_visits_and_tables_of_the_root(tmp_path):
    """A tree as public ones are: visits, runs, acquisitions; tables that all images inherit."""
    visit = tmp_path / "study" / "sub-01" / "ses-2"
    tree(visit, labels=False)
    for path in [*visit.rglob("sub-01*")]:
        run = "_acq-ep2d_run-1_dwi" if "dwi" in path.name else "_run-1_T1w"
        path.rename(path.with_name("sub-01_ses-2" + run + path.name[path.name.index(".") :]))
    for kind in ("bval", "bvec"):
        (table,) = visit.rglob(f"*.{kind}")
        table.rename(tmp_path / "study" / f"acq-ep2d_dwi.{kind}")
    for run in (1, 2):
        for echo in (1, 2, 3):
            for part in ("mag", "phase"):
                name = f"sub-01_ses-2_acq-ME_run-{run}_echo-{echo}_part-{part}_MEGRE.nii.gz"
                (visit / "anat" / name).touch()
    (visit / "anat" / "sub-01_ses-2_run-2_T1w.nii.gz").touch()
    other = tmp_path / "study" / "sub-01" / "ses-1" / "anat"
    other.mkdir(parents=True)
    (other / "sub-01_ses-1_T1w.nii.gz").touch()
    with pytest.raises(InputError, match="name the folder of one, such as .*sub-01/ses-1"):
        deck_of_folder(tmp_path / "study", tmp_path)
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
    """An anatomy, a localiser and a diffusion series in one folder, as they leave the scanner."""
    folder, axes = tmp_path / "scan", np.eye(3)
    weighted(folder, "SIEMENS", siemens, axes, generate_uid())
    for number, size, slices in ((1, 8, 1), (3, 48, 3)):
        uid = generate_uid()
        i, j = np.indices((size, size)) - size / 2 + 0.5
        r = np.hypot(i, j) * 48 / size
        for k in range(slices):
            data = mr_file("SIEMENS", uid, number, k + 1, rows=size, columns=size)
            data.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
            data.ImagePositionPatient = [-40.0, -40.0, 5.0 * k]
            data.SeriesDescription = "t1_tse" if number == 3 else "localizer"
            pixels = np.select([r < 14, r < 20], [300, 900], 0) + (r < 20) * (3 * (i + k) % 17)
            data.PixelData = pixels.astype(np.uint16).tobytes()
            data.save_as(folder / f"{number}_{k}.dcm", enforce_file_format=True)
    deck, lines = deck_of_folder(folder, tmp_path / "out")
    assert "scan:series=3 (first of 2)" in lines[1] and lines[2].endswith("scan:series=7")
    run_chain(deck, tmp_path / "out")
    tissue = read_labels(tmp_path / "out" / "tissue.nii.gz")
    assert set(np.unique(tissue.data)) >= {0, 1, 2}
