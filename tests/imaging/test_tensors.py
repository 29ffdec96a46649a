"""Tensors by themselves: command, maps, less noise."""

import nibabel
import numpy as np
import pytest

from myork.cli import main
from myork.core.deck import text_of_tables
from myork.errors import InputError
from myork.imaging.diffusion import tensor_maps
from myork.imaging.io import write_image, write_labels
from myork.imaging.phantom import make_phantom
from myork.records import Image, Labels
from myork.stations.tensors import write_tensors
from myork.summary import read_summary
from tests.images import angle, phantom_dwi, write_gradients


@pytest.fixture(scope="module")
def calf():
    return make_phantom((96, 96, 5), (1.25, 1.25, 8.0))


@pytest.fixture(scope="module")
def series(calf):
    return phantom_dwi(calf, snr=25.0)


@pytest.mark.slow
def test_command_needs_no_anatomy(calf, series, tmp_path):
    images, table = series
    (tmp_path / "leg.toml").write_text(text_of_tables({"image": {"dwi": "dwi.nii.gz"}}))
    write_image(tmp_path / "dwi.nii.gz", images)
    write_gradients(tmp_path, "dwi", table, images.affine)
    write_labels(tmp_path / "muscles.nii.gz", calf.truth)
    out = tmp_path / "out"
    words = ["tensors", str(tmp_path / "leg.toml"), "--out", str(out), "-q"]
    assert main([*words, "--set", f"image.region={tmp_path / 'muscles.nii.gz'}"]) == 0
    record = read_summary(out)["tensors"]
    inside = calf.truth.data > 0
    assert record["voxels"] == inside.sum()
    assert record["md"] == pytest.approx((2.1e-3 + 1.5e-3 + 1.3e-3) / 3, rel=0.05)
    fibers = nibabel.load(out / "tensor_fibers.nii.gz").get_fdata()
    assert angle(fibers, calf.fiber.data)[inside].mean() < 2.5
    values = nibabel.load(out / "eigenvalues.nii.gz").get_fdata()[inside]
    assert (np.diff(values) <= 0).all()
    mean = nibabel.load(out / "md.nii.gz").get_fdata()[inside]
    np.testing.assert_allclose(values.mean(axis=1), mean, rtol=1e-5)
    # Without a mask the whole limb has fibers, air has none.
    assert main(words) == 0
    assert read_summary(out)["tensors"]["voxels"] > inside.sum()
    air = calf.still.data == 0
    assert not nibabel.load(out / "tensor_fibers.nii.gz").get_fdata()[:10, :10].any()
    assert air[:10, :10].all()


def test_medians_are_those_of_voxels_with_a_tensor(tmp_path):
    data = np.tile([1e-3, 3e-3, 2e-3, 0, 0, 0], (6, 4, 2, 1))
    data[:4] = np.nan
    write_image(tmp_path / "tensor.nii.gz", Image(data, np.eye(4)))
    write_labels(tmp_path / "all.nii.gz", Labels(np.ones((6, 4, 2), np.int32), np.eye(4)))
    write_labels(tmp_path / "none.nii.gz", Labels(np.zeros((6, 4, 2), np.int32), np.eye(4)))
    image = {"tensor": tmp_path / "tensor.nii.gz", "region": tmp_path / "all.nii.gz"}
    deck = {"image": {**image, "fiber_smoothing": 0.0}}
    told: list[str] = []
    record = write_tensors(deck, tmp_path / "out", progress=told.append)["tensors"]
    assert record["fa"] == pytest.approx(np.sqrt(1.5 * 2 / 14), rel=1e-5)
    assert (record["voxels"], record["filled"], record["far"]) == (48, 32, 32)
    assert any("up to 4 mm away" in line for line in told)
    deck["image"]["region"] = tmp_path / "none.nii.gz"
    with pytest.raises(InputError, match="no voxel to find fibers in"):
        write_tensors(deck, tmp_path / "out")


def test_maps_of_known_tensors():
    data = np.zeros((2, 1, 1, 6))
    data[0, 0, 0] = [1e-3, 3e-3, 2e-3, 0, 0, 0]
    data[1] = np.nan
    maps = tensor_maps(Image(data, np.eye(4)))
    np.testing.assert_allclose(maps["eigenvalues"].data[0, 0, 0], [3e-3, 2e-3, 1e-3])
    assert maps["md"].data[0, 0, 0] == pytest.approx(2e-3)
    assert maps["fa"].data[0, 0, 0] == pytest.approx(np.sqrt(1.5 * 2 / 14))
    assert not any(image.data[1].any() for image in maps.values())
