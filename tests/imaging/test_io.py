"""Images in files: what comes back, what can be wrong, echo times of headers, damaged slices."""

import json
from pathlib import Path

import nibabel
import numpy as np
import pytest

from myork.errors import InputError
from myork.imaging.damage import damaged_slices, missing_slices
from myork.imaging.diffusion import gradient_files
from myork.imaging.geometry import check_same_grid
from myork.imaging.headers import Header, bids_name, described_by, read_header
from myork.imaging.io import read_image, read_labels, read_reference
from myork.imaging.phantom import make_phantom
from myork.records import Image, Labels
from myork.stations.build import build
from myork.stations.data import DeckFiles, OneGrid
from myork.stations.segment import _times, segment
from tests.scenes import refuses

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


def test_one_slice_trailing_axes_and_metres(tmp_path):
    assert read_image(save(tmp_path / "a.nii", np.ones((3, 4)))).data.shape == (3, 4, 1)
    assert read_image(save(tmp_path / "b.nii", np.ones((3, 4, 2, 1)))).data.shape == (3, 4, 2)
    file = nibabel.Nifti1Image(np.ones((2, 2, 2)), np.diag([1e-3, 1e-3, 5e-3, 1]))
    file.header.set_xyzt_units("meter")
    nibabel.save(file, tmp_path / "a.nii")
    np.testing.assert_allclose(read_image(tmp_path / "a.nii").spacing, [1, 1, 5], rtol=1e-6)


def unfinite(path):
    data = np.ones((3, 3, 3))
    data[1, 2, 0] = np.nan
    return read_image(save(path, data))


def singular(path):
    file = nibabel.Nifti1Image(np.ones((2, 2, 2)), np.eye(4))
    file.header.set_qform(None, code=0)
    for row, values in zip("xyz", AFFINE[:, [0, 0, 2, 3]], strict=False):
        file.header[f"srow_{row}"] = values
    file.header["sform_code"] = 1
    nibabel.save(nibabel.Nifti1Image(np.ones((2, 2, 2)), None, file.header), path)
    return read_image(path)


def sheared(path):
    return read_image(
        save(path, np.ones((2, 2, 2)), AFFINE + np.outer([0.5, 0, 0, 0], [0, 1, 0, 0]))
    )


@pytest.mark.parametrize(("read", "message"), [
    (unfinite, r"1 voxels are not finite, the first at voxel \(1, 2, 0\)"),
    (singular, "not perpendicular .largest cosine 1"),
    (sheared, "not perpendicular"),
    (lambda p: read_image(save(p, np.ones((2, 2, 2, 6)))), r"3-D .* has shape \(2, 2, 2, 6\)"),
    (lambda p: read_image(save(p, np.ones((2, 2, 2))), values=6), "a 4-D image with 6 volumes"),
    (lambda p: read_labels(save(p, -np.ones((2, 2, 2), "i2"))), "must not be nega"),
])  # fmt: skip
def test_bad_files_are_named(tmp_path, read, message):
    path = tmp_path / "bad.nii.gz"
    assert str(path) in refuses(message, read, path)


def test_names_of_a_folder_are_for_references_only(tmp_path):
    path, lines = save(tmp_path / "a.nii.gz", np.ones((2, 2, 2), np.uint8)), []
    assert read_reference(path, lines.append).names == {}
    (tmp_path / "labels.json").write_text(json.dumps({"soleus": 1}))
    assert read_reference(path, lines.append).names == {1: "soleus"}
    assert read_labels(path).names == {} and not lines
    for other in ('{"labels": ["soleus"]}', '{"1": "soleus"}', '{"a": 1e999}', "[]", "soleus"):
        (tmp_path / "labels.json").write_text(other)
        assert read_labels(path).names == read_reference(path, lines.append).names == {}
        assert "a.nii.gz" in lines[-1] and "labels.json: must contain" in lines.pop()
    (tmp_path / "a.json").write_text(json.dumps({"tibialis": 1}))
    assert read_reference(path, lines.append).names == {1: "tibialis"} and not lines
    (tmp_path / "a.json").write_text("[]")  # its own file must be right
    refuses("a.json: must contain", read_reference, path, lines.append)


def test_grids_that_differ():
    a = Image(np.zeros((4, 4, 4)), AFFINE, "a")
    moved = Image(a.data, AFFINE + 2.0 * np.eye(4, k=3), "b")
    refuses("b and a have different affines.* 2 mm", check_same_grid, moved, a)
    less = Image(np.zeros((4, 4, 3)), AFFINE, "b")
    refuses(r"b has \(4, 4, 3\) voxels, a has \(4, 4, 4\)", check_same_grid, less, a)
    check_same_grid(Image(np.zeros((4, 4, 4, 6)), AFFINE, "b"), a)


def table(path: Path, **entries):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(entries))


def test_the_nearest_and_most_special_file_wins(tmp_path):
    image = tmp_path / "sub-01" / "anat" / "sub-01_echo-2_part-mag_MEGRE.nii.gz"
    assert bids_name(Path("a/sub-01_echo-2_dwi.nii.gz")) == ({"sub": "01", "echo": "2"}, "dwi")
    assert bids_name(Path("t1.nii")) == ({}, "t1")
    assert read_header(image) == Header(None, None)
    table(tmp_path / "MEGRE.json", MagneticFieldStrength=1.5, EchoTime=0.009)
    table(tmp_path / "echo-2_MEGRE.json", EchoTime=0.0046)
    table(tmp_path / "echo-1_MEGRE.json", EchoTime=0.0023)
    table(tmp_path / "sub-02_MEGRE.json", MagneticFieldStrength=7)
    assert read_header(image) == Header(pytest.approx(4.6), 1.5)
    table(image.parent / "sub-01_echo-2_part-mag_MEGRE.json", MagneticFieldStrength=3)
    assert read_header(image) == Header(pytest.approx(4.6), 3.0)
    table(image.parent / "sub-01_echo-2_part-mag_MEGRE.json", EchoTime="long")
    refuses("EchoTime of its header is 'long', a number above zero", read_header, image)
    (tmp_path / "MEGRE.json").write_text("{")
    refuses(r"MEGRE.json: is not readable JSON", read_header, image)


def test_a_plain_name_takes_no_table_of_another_image(tmp_path):
    image = tmp_path / "arm2_dwi.nii.gz"
    for name in ("arm1_dwi.bval", "xdwi.bval", "dwi.bval"):
        (tmp_path / name).touch()
    assert described_by(image, "bval") == [tmp_path / "dwi.bval"]
    (tmp_path / "dwi.nii.gz").touch()  # whose table that is
    assert described_by(image, "bval") == []
    inner = tmp_path / "inner" / image.name
    inner.parent.mkdir()
    (tmp_path / "dwi.nii.gz").unlink()
    assert described_by(inner, "bval") == []
    # entities are inherited from above
    assert described_by(inner.with_name("sub-1_dwi.nii.gz"), "bval") == [tmp_path / "dwi.bval"]


def test_the_log_names_tables_of_another_name(tmp_path):
    for name in ("dwi.bval", "a_dwi.bvec"):
        (tmp_path / name).touch()
    lines = []
    image = tmp_path / "a_dwi.nii.gz"
    OneGrid(lines.append).tell_strangers(image, gradient_files(image))
    assert lines == ["a_dwi.nii.gz: described by dwi.bval"]


def test_labels_nearly_whole_and_without_a_number(tmp_path):
    data = np.zeros((3, 3, 3))
    data[1], data[0, 0, 0] = 2.0000001, np.nan
    notes = []
    labels = read_labels(save(tmp_path / "l.nii", data), notes.append)
    assert labels.data[1].min() == labels.data.max() == 2 and labels.data[0, 0, 0] == 0
    (note,) = notes
    assert "1 voxels are not a number and count as background" in note
    data[2, 2, 2] = 1.0015
    path = save(tmp_path / "l.nii", data)
    refuses(r"1 voxels contain other values, the first is 1\.0015 in voxel", read_labels, path)


def test_vectors_with_an_axis_of_time(tmp_path):
    """As ITK writes them: x, y, z, time, component."""
    data = np.random.default_rng(0).normal(size=(3, 4, 5, 1, 3))
    path = save(tmp_path / "v.nii", data)
    assert np.array_equal(read_image(path, 3).data, data[..., 0, :])
    assert np.array_equal(read_image(path, None).data, data[..., 0, :])


def test_sform_and_qform_that_differ_are_noted(tmp_path):
    """One voxel of shift is; rounding, a code of 0 and a damaged quaternion are not."""
    path, affine = tmp_path / "labels.nii", np.diag([2.0, 2.0, 5.0, 1.0])
    said, moved = [], affine.copy()
    moved[0, 3] = 2.0
    for qform, code, shift in (
        (moved, 1, "2 mm"), (affine + 1e-4 * np.eye(4), 1, ""), (moved, 0, ""), (None, 1, ""),
    ):  # fmt: skip
        file = nibabel.Nifti1Image(np.ones((4, 4, 4), np.int16), affine)
        file.set_qform(affine if qform is None else qform, code)
        if qform is None:
            file.header["quatern_b"] = 5.0
        nibabel.save(file, path)
        said.clear()
        assert (read_labels(path, said.append).affine == affine).all()
        assert len(said) == (shift != "") and all(
            f"place voxels up to {shift} apart; the sform is used here" in text for text in said
        )


def test_a_header_without_codes_is_noted(tmp_path):
    file = nibabel.Nifti1Image(np.ones((2, 2, 2), np.uint8), AFFINE)
    for code, said in ((1, False), (0, True)):
        file.set_sform(AFFINE, code)
        file.set_qform(AFFINE, 0)
        nibabel.save(file, tmp_path / "a.nii")
        for read in (read_image, read_labels):
            notes = []
            read(tmp_path / "a.nii", note=notes.append)
            assert any("left and right are not known" in note for note in notes) == said


def test_what_a_header_lacks_is_said_before_what_it_makes_fail(tmp_path, capsys):
    """Labels without geometry do not lie on their fibers: the warning comes before the refusal."""
    affine = np.diag([2.0, 2.0, 2.0, 1.0])
    affine[:3, 3] = -50.0
    file = nibabel.Nifti1Image(np.ones((6, 6, 6), np.uint8), affine)
    file.set_sform(affine, 0)
    file.set_qform(affine, 0)
    nibabel.save(file, tmp_path / "labels.nii")
    fibers = np.tile(np.float32([0, 0, 1]), (6, 6, 6, 1))
    nibabel.save(nibabel.Nifti1Image(fibers, affine), tmp_path / "fibers.nii")
    names = {"labels": str(tmp_path / "labels.nii"), "fibers": str(tmp_path / "fibers.nii")}
    deck = {"scene": {"dimension": 3}, "build": names}
    with pytest.raises(InputError, match="do not overlap"):
        build(deck, tmp_path / "out", progress=print)
    assert "warning: " in capsys.readouterr().out.partition("left and right are not known")[0]


def files(folder, **dixon):
    magnitude = ["s_echo-1_MEGRE.nii.gz", "s_echo-2_MEGRE.nii.gz"]
    deck = {"folder": str(folder), "dixon": {"magnitude": magnitude, **dixon}}
    return DeckFiles(deck, "dixon", OneGrid(print))


def test_times_of_the_deck_stand_before_those_of_headers(tmp_path):
    assert _times(files(tmp_path), print) == ((), 0.0)
    for number in (1, 2):
        table(tmp_path / f"s_echo-{number}_MEGRE.json", EchoTime=0.0012 * number)
    one = files(tmp_path)
    assert _times(one, print) == ((), 0.0)
    assert "contain 2 echo times but no field" in one.grid.doubts[0]
    times, strength = _times(files(tmp_path, field_strength=3.0), print)
    np.testing.assert_allclose([*times, strength], [1.2, 2.4, 3.0])
    own = files(tmp_path, echo_times=[2.3, 4.6], field_strength=1.5)
    assert _times(own, print) == ([2.3, 4.6], 1.5)


THICK = np.diag([1.5, 1.5, 4.0, 1.0])


def stack(seed, slices=16):
    """A limb that gets thinner along the stack, with noise and a signal that falls to its ends."""
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(*(np.linspace(-1, 1, 40),) * 2, indexing="ij")
    radius = 0.8 - 0.3 * random.random() * np.linspace(0, 1, slices)
    coil = 1.0 - 0.4 * random.random() * np.linspace(-1, 1, slices) ** 2
    body = 300.0 * coil * (np.hypot(x, y)[..., None] < radius)
    noise = random.normal(0.0, 15.0, (2, 40, 40, slices))
    return np.hypot(body + noise[0], noise[1])


def faults_of(data):
    return damaged_slices(Image(data, THICK, "t1.nii"))


@pytest.mark.parametrize("seed", range(25))
def test_each_fault_is_found_and_no_other(seed):
    random = np.random.default_rng([seed, 1])
    assert faults_of(stack(seed)) == []
    at = int(random.integers(3, 13))
    empty, repeated, jump, moved, ghost, lower = (stack(seed) for _ in range(6))
    empty[..., at] *= 0.01
    repeated[..., at] = repeated[..., at - 1]
    jump[..., at] *= random.choice([0.5, 0.6, 1.6, 2.0])
    lower[..., at:] *= 0.6
    axis = int(random.integers(2))
    moved[..., at] = np.roll(moved[..., at], random.choice([-6, 5]), axis)
    ghost[..., at] += random.uniform(0.08, 0.25) * np.roll(ghost[..., at], 20, axis)
    for data, why in (
        (empty, "no signal"), (repeated, "the values of"), (jump, "a signal that differs"),
        (lower, "a signal that differs"), (moved, "a shift of 3 voxels"),
        (ghost, "a copy of the body"),
    ):  # fmt: skip
        (fault,) = faults_of(data)
        assert fault.slices == [at] and fault.why.startswith(why)


def test_what_is_no_fault():
    # padding; a coarser limb stretched; volumes of a series; a single slice; nothing at all
    assert faults_of(np.pad(stack(1), ((0, 0), (0, 0), (3, 2)))) == []
    assert faults_of(np.repeat(stack(2), 2, axis=2)) == []
    assert faults_of(np.stack([stack(3), 0.3 * stack(4)], axis=3)) == []
    assert faults_of(stack(5)[..., :1]) == faults_of(np.zeros((4, 4, 6))) == []
    phantom = make_phantom(size=(48, 48, 12), spacing=(2.5, 2.5, 6.0))
    assert damaged_slices(phantom.anatomy) == missing_slices(phantom.truth) == []


@pytest.mark.slow
def test_segment_and_build_name_the_slices(tmp_path):
    data, labels = stack(6), np.ones((6, 6, 9), "i2")
    data[..., 7:9], labels[..., 4] = 0.0, 0
    image, found = save(tmp_path / "t1.nii", data, THICK), save(tmp_path / "l.nii", labels, THICK)
    summary = segment({"image": {"anatomy": image, "regions": 2}}, tmp_path)
    (entry,) = summary["damaged_slices"]
    wanted = {"slices": [7, 8], "why": "no signal", "station": "segment"}
    assert entry == {"file": entry["file"], **wanted}
    said = "slices 7, 8 (counted from 0) have no signal"
    assert said in "\n".join(summary["segmentation"]["warnings"])
    build({"scene": {"dimension": 3}, "build": {"labels": found, "ids": [1]}}, tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [own["slices"] for own in summary["damaged_slices"]] == [[7, 8], [4]]
    assert any("cuts the body in two" in text for text in summary["model"]["warnings"])


def test_gaps_of_labels():
    data = np.zeros((4, 4, 8), int)
    data[1:3, 1:3, 2:7] = 3
    assert missing_slices(Labels(data, THICK)) == []
    data[..., 4] = 0
    assert missing_slices(Labels(data, THICK))[0].slices == [4]
