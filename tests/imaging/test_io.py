"""NIfTI files: what comes back, and everything that can be wrong with one."""

import json

import nibabel
import numpy as np
import pytest

from myork.errors import FileError, InputError
from myork.imaging.geometry import check_same_grid
from myork.imaging.io import read_image, read_labels, read_reference
from myork.records import Image

AFFINE = np.array([[-2.0, 0, 0, 10], [0, 3.0, 0, -5], [0, 0, 8.0, 1], [0, 0, 0, 1]])


def save(path, data, affine=AFFINE):
    nibabel.save(nibabel.Nifti1Image(data, affine), path)
    return path


def test_scale_of_the_header_does_not_change_labels(tmp_path):
    file = nibabel.Nifti1Image(np.ones((2, 2, 2), np.uint8), AFFINE)
    file.header.set_slope_inter(17.4, 0.0)
    nibabel.save(file, tmp_path / "a.nii")
    raw = bytearray((tmp_path / "a.nii").read_bytes())
    raw[112:116] = np.float32(17.4).tobytes()  # scl_slope
    (tmp_path / "a.nii").write_bytes(raw)
    assert set(np.unique(read_labels(tmp_path / "a.nii").data)) <= {0, 1}


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.uint16])
@pytest.mark.parametrize("labels", [[0, 1], [0, 1, 2, 5, 12]])
def test_masks_written_under_the_header_of_an_image_are_whole_numbers(tmp_path, kind, labels):
    header = nibabel.Nifti1Header()
    header.set_data_dtype(kind)
    data = np.resize(np.array(labels, float), (5, 4, 3))
    nibabel.save(nibabel.Nifti1Image(data, AFFINE, header), tmp_path / "a.nii.gz")
    stored = nibabel.load(tmp_path / "a.nii.gz").dataobj.get_unscaled()
    assert (stored.min(), stored.max()) == (np.iinfo(kind).min, np.iinfo(kind).max)
    np.testing.assert_array_equal(read_labels(tmp_path / "a.nii.gz").data, data)


def test_one_slice_and_trailing_axes(tmp_path):
    assert read_image(save(tmp_path / "a.nii", np.ones((3, 4)))).data.shape == (3, 4, 1)
    assert read_image(save(tmp_path / "b.nii", np.ones((3, 4, 2, 1)))).data.shape == (3, 4, 2)


def test_metres_become_millimetres(tmp_path):
    file = nibabel.Nifti1Image(np.ones((2, 2, 2)), np.diag([1e-3, 1e-3, 5e-3, 1]))
    file.header.set_xyzt_units("meter")
    nibabel.save(file, tmp_path / "a.nii")
    np.testing.assert_allclose(read_image(tmp_path / "a.nii").spacing, [1, 1, 5], rtol=1e-6)


def nan_image(path):
    data = np.ones((3, 3, 3))
    data[1, 2, 0] = np.nan
    return read_image(save(path, data))


def singular(path):
    affine = AFFINE.copy()
    affine[:3, 1] = affine[:3, 0]
    file = nibabel.Nifti1Image(np.ones((2, 2, 2)), np.eye(4))
    file.header.set_sform(affine, code=1)
    file.header.set_qform(None, code=0)
    file.header["sform_code"] = 1
    file.header["srow_x"], file.header["srow_y"], file.header["srow_z"] = affine[:3]
    nibabel.save(nibabel.Nifti1Image(np.ones((2, 2, 2)), None, file.header), path)
    return read_image(path)


def sheared(path):
    affine = AFFINE.copy()
    affine[0, 1] = 0.5
    return read_image(save(path, np.ones((2, 2, 2)), affine))


def _text(path):
    path.write_text("no image")
    return read_image(path)


def _cut(path):
    save(path, np.random.default_rng(0).random((20, 20, 20)))
    path.write_bytes(path.read_bytes()[:20000])
    return read_image(path)


@pytest.mark.parametrize(
    ("read", "kind", "message"),
    [
        (read_image, FileError, "there is no such file"),
        (nan_image, InputError, r"1 voxels are not finite, the first at voxel \(1, 2, 0\)"),
        (singular, InputError, "affine is singular"),
        (sheared, InputError, "not perpendicular"),
        (lambda p: read_image(save(p, np.ones((2, 2, 2, 6)))), InputError,
         r"a 3-D image is needed, this one has shape \(2, 2, 2, 6\)"),
        (lambda p: read_image(save(p, np.ones((2, 2, 2))), values=6), InputError,
         "a 4-D image with 6 volumes is needed"),
        (lambda p: read_labels(save(p, -np.ones((2, 2, 2), "i2"))), InputError, "must not be nega"),
        (_text, FileError, "is not a readable NIfTI file"),
        (_cut, FileError, "cannot be read"),
    ],
)  # fmt: skip
def test_bad_files_are_named(tmp_path, read, kind, message):
    path = tmp_path / "bad.nii.gz"
    with pytest.raises(kind, match=message) as caught:
        read(path)
    assert str(path) in str(caught.value)


def test_names_of_a_folder_are_for_references_only(tmp_path):
    path, lines = save(tmp_path / "a.nii.gz", np.ones((2, 2, 2), np.uint8)), []
    assert read_reference(path, lines.append).names == {}
    (tmp_path / "labels.json").write_text(json.dumps({"soleus": 1}))
    assert read_reference(path, lines.append).names == {1: "soleus"}
    assert read_labels(path).names == {} and not lines
    for other in ('{"labels": ["soleus"]}', '{"1": "soleus"}', '{"a": 1e999}', "[]", "soleus"):
        (tmp_path / "labels.json").write_text(other)
        assert read_labels(path).names == read_reference(path, lines.append).names == {}
        assert "a.nii.gz" in lines[-1] and "labels.json: must hold" in lines.pop()
    (tmp_path / "a.json").write_text(json.dumps({"tibialis": 1}))
    assert read_reference(path, lines.append).names == {1: "tibialis"} and not lines
    (tmp_path / "a.json").write_text("[]")  # its own file must be right
    with pytest.raises(InputError, match="a.json: must hold"):
        read_reference(path, lines.append)


def test_grids_that_differ():
    a = Image(np.zeros((4, 4, 4)), AFFINE, "a")
    moved = AFFINE.copy()
    moved[0, 3] += 2.0
    with pytest.raises(InputError, match="b and a have different affines.* 2 mm"):
        check_same_grid(Image(a.data, moved, "b"), a)
    with pytest.raises(InputError, match=r"b has \(4, 4, 3\) voxels, a has \(4, 4, 4\)"):
        check_same_grid(Image(np.zeros((4, 4, 3)), AFFINE, "b"), a)
    check_same_grid(Image(np.zeros((4, 4, 4, 6)), AFFINE, "b"), a)
