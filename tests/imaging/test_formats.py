"""NRRD, MetaImage and DICOM series: geometry and values as in NIfTI, errors that name the file."""

import sys
from itertools import product
from pathlib import Path

import numpy as np
import pydicom
import pytest
from pydicom.uid import generate_uid

from benchmarks.truths.scanners import gradient_table, slice_file, stack, weighted
from myork.errors import FileError, InstallationError
from myork.imaging.diffusion import read_diffusion, read_tensors
from myork.imaging.headers import Header, read_header
from myork.imaging.io import read_image, read_labels, write_image, write_labels
from myork.model_file import read_model
from myork.records import Image, Labels
from tests.images import affine_of, built, save
from tests.scenes import refuses

# Rotated by 30 degrees about z and with y downwards
C, S = np.cos(np.radians(30)), np.sin(np.radians(30))
AFFINE = np.array(
    [[2.0 * C, 3.0 * S, 0, 10], [2.0 * S, -3.0 * C, 0, -5], [0, 0, 8.0, 1], [0, 0, 0, 1]]
)


@pytest.mark.parametrize("suffix", [".nrrd", ".nhdr", ".mha", ".mhd", ".nii.gz"])
def test_images_and_labels_come_back(tmp_path, suffix):
    data = np.arange(24.0).reshape(2, 3, 4)
    vectors = np.random.default_rng(1).random((2, 3, 4, 6)).astype(np.float32)
    for values, own in ((1, data), (6, vectors)):
        write_image(tmp_path / f"a{suffix}", Image(own, AFFINE))
        image = read_image(tmp_path / f"a{suffix}", values=values)
        np.testing.assert_array_equal(image.data, own)
        np.testing.assert_allclose(image.affine, AFFINE, atol=1e-5)
    refuses("a 3-D image is needed", read_image, tmp_path / f"a{suffix}")
    write_labels(tmp_path / f"l{suffix}", Labels(data.astype(np.int32), AFFINE, {3: "soleus"}))
    labels = read_labels(tmp_path / f"l{suffix}")
    np.testing.assert_array_equal(labels.data, data)
    assert labels.names == {3: "soleus"} and labels.label_name(7) == "label 7"


def test_units_of_a_nrrd_header(tmp_path):
    (tmp_path / "a.nrrd").write_bytes(
        b"NRRD0004\ntype: uchar\ndimension: 3\nspace: right-anterior-superior\nsizes: 2 2 2\n"
        b"space directions: (0.1,0,0) (0,0.2,0) (0,0,0.5)\nkinds: domain domain domain\n"
        b'encoding: raw\nspace origin: (1,2,3)\nspace units: "cm" "cm" "cm"\n\n' + bytes(range(8))
    )
    image, expected = read_image(tmp_path / "a.nrrd"), affine_of((1, 2, 5), (10, 20, 30))
    np.testing.assert_allclose(image.affine, expected, atol=1e-9)
    assert image.data[1, 0, 0] == 1 and image.data[0, 0, 1] == 4


@pytest.mark.parametrize(("suffix", "line"), [
    (".nhdr", "space directions"), (".mhd", "ElementSpacing"), (".mhd", "TransformMatrix"),
])  # fmt: skip
def test_a_header_without_geometry_is_noted(tmp_path, suffix, line):
    """SimpleITK silently assumes cubes of 1 mm or unrotated axes."""
    path, said = tmp_path / f"a{suffix}", []
    write_labels(path, Labels(np.ones((2, 2, 2), np.int32), AFFINE))
    read_labels(path, said.append)
    assert not said
    kept = [one for one in path.read_text().splitlines(True) if not one.startswith((line, "space"))]
    path.write_text("".join(kept))
    read_labels(path, said.append)
    assert len(said) == 1 and "gives no size of voxels or no directions" in said[0]


def test_a_missing_library_names_the_extra(tmp_path, monkeypatch):
    write_image(tmp_path / "a.mha", Image(np.ones((2, 2, 2)), AFFINE))
    for name in ("SimpleITK", "pydicom"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InstallationError, match=r"a.mha needs .* pip install 'myork\[formats\]'"):
        read_image(tmp_path / "a.mha")
    refuses(r"pip install 'myork\[dicom\]'", read_image, tmp_path, kind=InstallationError)


def series(folder, heights=(5.0, 1.0, 9.0), uid=None, first=0, rows=3, **elements):
    """Slices of 3 x 2 pixels, 2 mm along the columns' direction and 1.5 mm along the rows'."""
    folder.mkdir(exist_ok=True, parents=True)
    uid = uid or generate_uid()
    for number, height in enumerate(heights, start=first):
        data = slice_file(uid, rows, 2)
        data.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
        data.ImagePositionPatient = [-10.0, -20.0, height]
        data.RescaleSlope, data.RescaleIntercept = 2.0, 1.0
        pixels = (100 * height + np.arange(rows * 2).reshape(rows, 2)).astype(np.uint16)
        data.PixelData = pixels.tobytes()
        for key, value in elements.items():
            setattr(data, key, value)
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
    np.testing.assert_allclose(image.affine, affine_of((-1.5, -2.0, 4.0), (10.0, 20.0, 1.0)))


def test_mixed_or_broken_series_are_refused(tmp_path):
    folder = tmp_path / "s"
    uid = series(folder)
    series(folder, uid=uid, first=3)
    refuses("lie at the same position, so there are several times", read_image, folder)
    series(tmp_path / "gap", heights=(1.0, 5.0, 13.0))
    refuses("spacing of the slices varies from 4 to 8 mm", read_image, tmp_path / "gap")
    uid = series(tmp_path / "size")
    series(tmp_path / "size", heights=(13.0,), uid=uid, first=7, rows=4)
    said = r"made 2 images of its 4 .*\(2x3x3x1\); .*\(2x4x1x1\)"
    refuses(said, read_image, tmp_path / "size")
    (tmp_path / "empty").mkdir()
    refuses("contains no DICOM images", read_image, tmp_path / "empty", kind=FileError)


def mixed(folder):
    """Folder of a localiser, two echoes with magnitude and phase, and a series without a number."""
    series(folder, SeriesNumber=1, SeriesDescription="localiser", heights=(0.0,), first=0)
    uid = generate_uid()
    for slope, (time, word) in enumerate(product((2.46, 1.23), "MP"), 2):
        kind = ["ORIGINAL", "PRIMARY", f"{word}_FFE", word, "FFE"]
        series(
            folder, uid=uid, first=10 * slope, SeriesNumber=5, EchoTime=time, ImageType=kind,
            SeriesDescription="dixon", RescaleSlope=float(slope), SliceThickness=4,
        )  # fmt: skip
    return uid, series(folder, first=90, SeriesDescription="t2")


def test_images_of_a_dicom_folder_are_listed_and_chosen(tmp_path):
    folder = tmp_path / "scan"
    uid, lone = mixed(folder)
    listed = refuses("scan: contains 6 images; write one of these", read_image, folder)
    rows = [line.split("  ") for line in listed.splitlines()[1:]]
    rows = [[word.strip() for word in row if word.strip()] for row in rows]
    echoes = product((1, 2), ("magnitude", "phase"))
    assert [row[0] for row in rows] == [
        "scan:series=1",
        *(f"scan:series=5,echo={echo},kind={kind}" for echo, kind in echoes),
        f"scan:series={lone}",
    ]
    assert rows[2][1:] == ["dixon", "TE 1.23 ms", "phase", "3 slices", "2 x 3", "1.5 x 2 x 4 mm"]
    # Each listed text is a valid choice in the deck; the echo of 1.23 ms came last.
    values = [read_image(tmp_path / row[0]).data for row in rows]
    assert values[0].shape == (2, 3, 1)
    slopes = [round((one[0, 0, 2] - 1.0) / 900.0, 6) for one in values[1:5]]
    assert slopes == [4.0, 5.0, 2.0, 3.0] and values[5][0, 0, 2] == 1801.0
    again = read_image(tmp_path / f"scan:kind=Phase, series={uid}, echo=2")
    assert np.array_equal(again.data, values[4])
    for choice, said in (
        ("series=5,echo=1", r"(?s)contains 2 images with series=5,echo=1;.*=phase"),
        ("series=7", r"(?s)contains no image with series=7; write.*series=1 "),
        ("serie=5", r"scan:serie=5: 'serie=5' chooses nothing; write DIR:"),
    ):
        refuses(said, read_image, tmp_path / f"scan:{choice}")


def test_the_list_of_images_is_that_of_the_page(tmp_path):
    folder, uid = tmp_path / "scan", generate_uid()
    kinds = {word: ["ORIGINAL", "PRIMARY", word] for word in "MP"}
    plain = {"rows": 320, "Columns": 320, "PixelData": bytes(2 * 320**2), "PixelSpacing": [1.5] * 2}
    plain |= {"ImageType": kinds["M"], "SliceThickness": 8}
    series(folder, [0.0], None, 120, SeriesNumber=1, SeriesDescription="localiser", **plain)
    plain |= {"SeriesNumber": 5, "SeriesDescription": "dixon", "SliceThickness": 4}
    for k, (time, word) in enumerate(product((1.23, 2.46), kinds)):
        plain |= {"EchoTime": time, "ImageType": kinds[word]}
        series(folder, np.arange(30.0) * 4, uid, 30 * k, **plain)
    shown = refuses("contains", read_image, folder).replace(f"{folder}", folder.name)
    page = Path(__file__).parents[2] / "docs/imaging.md"
    assert f"```text\n{shown}\n```" in page.read_text(encoding="utf-8")


def test_series_of_one_uid_differ_by_their_numbers(tmp_path):
    """As where names were removed."""
    uid = series(tmp_path / "s", heights=(1.0, 5.0), SeriesNumber=2)
    series(tmp_path / "s", heights=(9.0, 13.0), uid=uid, first=5, SeriesNumber=3)
    refuses(r"(?s)contains 2 images; .*s:series=2 .*s:series=3 ", read_image, tmp_path / "s")
    for name in ("s:series=3", "s/:series=3"):
        assert read_image(tmp_path / name).data[0, 0, 0] == 1801.0


def test_a_model_takes_its_activation_from_a_folder_of_several_images(tmp_path):
    for number, most in ((2, 1.0), (3, 0.5)):
        scaled = {"SeriesNumber": number, "RescaleSlope": most / 1000, "RescaleIntercept": 0.0}
        series(tmp_path / "s", (1.0, 3.0, 5.0, 7.0), first=10 * number, rows=4, **scaled)
    image = read_image(tmp_path / "s:series=3")
    save(tmp_path, image.affine, l=np.ones((2, 4, 4), np.int32))
    stride = {"collocation_stride": [1, 1, 1], "source_stride": [1, 1, 1]}
    built(tmp_path, labels="l.nii.gz", activation=str(tmp_path / "s:series=3"), **stride)
    activation = read_model(tmp_path / "out" / "model.h5").activation
    assert activation.max() == pytest.approx(image.data.max(), rel=0.1)  # the other has twice that


def test_one_series_of_several_echo_times_is_one_image_and_folders_below_are_searched(tmp_path):
    folder = tmp_path / "study" / "a" / "b"
    uid = series(folder, heights=(1.0, 5.0), EchoTime=2.0)
    series(folder, heights=(9.0,), uid=uid, first=7, EchoTime=3.0)
    for name in ("study", "study:kind=unknown"):
        assert read_image(tmp_path / name).data.shape == (2, 3, 3)


@pytest.mark.parametrize(("elements", "kind"), [
    ({"ImageType": ["ORIGINAL", "PRIMARY", "PHASE MAP", "P", "FFE"]}, "phase"),
    ({"ImageType": ["DERIVED", "PRIMARY", "DIXON", "WATER"]}, "water"),
    ({"ImageType": ["ORIGINAL", "PRIMARY", "F", "F", "DERIVED"]}, "fat"),
    ({"ImageType": ["DERIVED", "SECONDARY", "T2 MAP", "T2"]}, "t2-map"),
    ({"ComplexImageComponent": "REAL"}, "real"),
    ({"ImageType": ["ORIGINAL", "PRIMARY", "OTHER"], "ge": 3}, "imaginary"),
    ({"ImageType": ["ORIGINAL", "PRIMARY"]}, "unknown"),
])  # fmt: skip
def test_kinds_of_dicom_images(tmp_path, elements, kind):
    part = elements.pop("ge", None)
    uid = series(tmp_path / "s", **elements)
    if part is not None:
        for path in (tmp_path / "s").iterdir():
            data = pydicom.dcmread(path)
            data.private_block(0x0043, "GEMS_PARM_01", create=True).add_new(0x2F, "SS", part)
            data.save_as(path)
    series(tmp_path / "s", uid=uid, first=5, ImageType=["ORIGINAL", "PRIMARY", "M", "ND"])
    image = read_image(tmp_path / f"s:kind={kind}")
    assert image.data.shape == (2, 3, 3)
    refuses(rf"s:kind={kind} ", read_image, tmp_path / "s")


OBLIQUE = np.array([[0, 0.6, -0.8, 0], [0, 0.8, 0.6, 0], [1.0, 0, 0, 0]])  # columns: LPS of i, j, k
TENSOR = np.array([0.9, 1.1, 1.6, 0.1, -0.2, 0.3]) * 1e-3  # xx, yy, zz, xy, xz, yz


@pytest.mark.parametrize("maker", ["Siemens", "Philips", "standard elements", "GE"])
def test_diffusion_series_of_the_makers(tmp_path, maker):
    table = gradient_table(6)
    values = weighted(np.full((16, 12, 3), 2000.0), TENSOR, table)
    stack(tmp_path / "scan", values, OBLIQUE, maker=maker, number=7, weighting=table)
    # with a second series, one has to be chosen
    series(tmp_path / "scan", first=100, SeriesNumber=1)
    refuses(
        r"(?s)contains 2 images.*scan:series=7 .*3 slices x 7", read_diffusion, tmp_path / "scan"
    )
    keys = {"dwi": "scan:series=7", "gradient_axes": "x y z"}
    found = read_tensors(keys, tmp_path)
    assert sorted(found.tensor.data.shape[:3]) == [3, 12, 16]
    # signals are whole numbers near 1000
    np.testing.assert_allclose(found.tensor.data - TENSOR, 0.0, atol=1e-5)
    assert read_header(tmp_path / "scan:series=7") == Header(60.0, 3.0)
    refuses("made 0 tables of gradients of its 3 files", read_diffusion, tmp_path / "scan:series=1")
