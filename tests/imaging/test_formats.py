"""NRRD, MetaImage and DICOM series: geometry and values as in NIfTI, errors that name the file."""

import importlib

import numpy as np
import pydicom
import pytest
from pydicom.dataset import FileDataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, generate_uid

from myork.errors import FileError, InputError, InstallationError
from myork.imaging import formats
from myork.imaging.io import read_image, read_labels, write_image, write_labels
from myork.records import Image, Labels

# Turned by 30 degrees about z and with y downwards
C, S = np.cos(np.radians(30)), np.sin(np.radians(30))
AFFINE = np.array(
    [[2.0 * C, 3.0 * S, 0, 10], [2.0 * S, -3.0 * C, 0, -5], [0, 0, 8.0, 1], [0, 0, 0, 1]]
)


@pytest.mark.parametrize("suffix", [".nrrd", ".nhdr", ".mha", ".mhd", ".nii.gz"])
def test_images_and_labels_come_back(tmp_path, suffix):
    data = np.arange(24.0).reshape(2, 3, 4)
    write_image(tmp_path / f"a{suffix}", Image(data, AFFINE))
    image = read_image(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(image.data, data)
    np.testing.assert_allclose(image.affine, AFFINE, atol=1e-5)
    write_labels(tmp_path / f"l{suffix}", Labels(data.astype(np.int32), AFFINE, {3: "soleus"}))
    labels = read_labels(tmp_path / f"l{suffix}")
    np.testing.assert_array_equal(labels.data, data)
    assert labels.names == {3: "soleus"}


@pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
def test_vectors_come_back(tmp_path, suffix):
    data = np.random.default_rng(1).random((2, 3, 4, 6)).astype(np.float32)
    write_image(tmp_path / f"a{suffix}", Image(data, AFFINE))
    image = read_image(tmp_path / f"a{suffix}", values=6)
    np.testing.assert_array_equal(image.data, data)
    np.testing.assert_allclose(image.affine, AFFINE, atol=1e-5)
    with pytest.raises(InputError, match="a 3-D image is needed"):
        read_image(tmp_path / f"a{suffix}")


def test_units_of_a_nrrd_header(tmp_path):
    (tmp_path / "a.nrrd").write_bytes(
        b"NRRD0004\ntype: uchar\ndimension: 3\nspace: right-anterior-superior\nsizes: 2 2 2\n"
        b"space directions: (0.1,0,0) (0,0.2,0) (0,0,0.5)\nkinds: domain domain domain\n"
        b'encoding: raw\nspace origin: (1,2,3)\nspace units: "cm" "cm" "cm"\n\n' + bytes(range(8))
    )
    image = read_image(tmp_path / "a.nrrd")
    expected = np.diag([1.0, 2.0, 5.0, 1.0])
    expected[:3, 3] = 10.0, 20.0, 30.0
    np.testing.assert_allclose(image.affine, expected, atol=1e-9)
    assert image.data[1, 0, 0] == 1 and image.data[0, 0, 1] == 4


def test_broken_and_floating_files(tmp_path):
    (tmp_path / "a.nrrd").write_text("no image")
    with pytest.raises(FileError, match=r"a.nrrd: cannot be read"):
        read_image(tmp_path / "a.nrrd")
    write_image(tmp_path / "b.mha", Image(np.ones((2, 2, 2)), AFFINE))
    with pytest.raises(InputError, match=r"b.mha: a label map must hold integers, not float32"):
        read_labels(tmp_path / "b.mha")


def test_a_missing_library_names_the_extra(tmp_path, monkeypatch):
    def no_import(name):
        raise ImportError(name)

    write_image(tmp_path / "a.mha", Image(np.ones((2, 2, 2)), AFFINE))
    monkeypatch.setattr(formats, "importlib", type("Fake", (), {"import_module": no_import}))
    with pytest.raises(InstallationError, match=r"a.mha: .* pip install 'myork\[formats\]'"):
        read_image(tmp_path / "a.mha")
    with pytest.raises(InstallationError, match=r"pip install 'myork\[dicom\]'"):
        read_image(tmp_path)
    assert importlib.import_module("SimpleITK")


def series(folder, heights=(5.0, 1.0, 9.0), uid=None, first=0, rows=3):
    """Slices of 3 x 2 pixels, 2 mm along the columns' direction and 1.5 mm along the rows'."""
    folder.mkdir(exist_ok=True)
    uid = uid or generate_uid()
    for number, height in enumerate(heights, start=first):
        meta = FileMetaDataset()
        meta.MediaStorageSOPClassUID = pydicom.uid.MRImageStorage
        meta.MediaStorageSOPInstanceUID = generate_uid()
        meta.TransferSyntaxUID = ExplicitVRLittleEndian
        data = FileDataset(None, {}, file_meta=meta, preamble=bytes(128))
        data.SOPClassUID, data.SOPInstanceUID = meta.MediaStorageSOPClassUID, generate_uid()
        data.SeriesInstanceUID = uid
        data.Rows, data.Columns, data.PixelSpacing = rows, 2, [2.0, 1.5]
        data.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
        data.ImagePositionPatient = [-10.0, -20.0, height]
        data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
        data.BitsAllocated, data.BitsStored, data.HighBit = 16, 16, 15
        data.PixelRepresentation = 0
        data.RescaleSlope, data.RescaleIntercept = 2.0, 1.0
        pixels = (100 * height + np.arange(rows * 2).reshape(rows, 2)).astype(np.uint16)
        data.PixelData = pixels.tobytes()
        data.save_as(folder / f"{number}.dcm", enforce_file_format=True)
    return uid


def test_dicom_slices_are_sorted_by_position(tmp_path):
    series(tmp_path / "s")
    (tmp_path / "s" / "readme.txt").write_text("no image")
    image = read_image(tmp_path / "s")
    assert image.data.shape == (2, 3, 3)
    # Column 1 of row 2 in the lowest slice (1 mm): stored 105, scaled 211.
    assert image.data[1, 2, 0] == 211.0
    np.testing.assert_allclose(image.data[0, 0], [201.0, 1001.0, 1801.0])
    expected = np.diag([-1.5, -2.0, 4.0, 1.0])
    expected[:3, 3] = 10.0, 20.0, 1.0
    np.testing.assert_allclose(image.affine, expected)


def test_mixed_or_broken_series_are_refused(tmp_path):
    folder = tmp_path / "s"
    uid = series(folder)
    series(folder, uid=uid, first=3)
    with pytest.raises(InputError, match="lie at the same position, so the folder mixes echoes"):
        read_image(folder)
    series(tmp_path / "two")
    series(tmp_path / "two", heights=(13.0,), first=7)
    with pytest.raises(InputError, match="holds different series: 0.dcm has .* keep one series"):
        read_image(tmp_path / "two")
    series(tmp_path / "gap", heights=(1.0, 5.0, 13.0))
    with pytest.raises(InputError, match="distances of the slices run from 4 to 8 mm"):
        read_image(tmp_path / "gap")
    uid = series(tmp_path / "size")
    series(tmp_path / "size", heights=(13.0,), uid=uid, first=7, rows=4)
    with pytest.raises(InputError, match="holds different sizes"):
        read_image(tmp_path / "size")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match="holds no DICOM images"):
        read_image(tmp_path / "empty")
