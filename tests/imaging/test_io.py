"""Images in files and on other grids: round trips, faults, damaged slices."""

import json
from dataclasses import replace
from pathlib import Path

import nibabel
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.truths.scanners import reordered
from myork.cli import main
from myork.core.deck import text_of_tables
from myork.errors import InputError
from myork.imaging.damage import damaged_slices, missing_slices
from myork.imaging.diffusion import gradient_files, known_tensors, lead_vector
from myork.imaging.geometry import check_same_grid, corner_distance
from myork.imaging.headers import Header, bids_name, described_by, read_header
from myork.imaging.io import read_image, read_labels, read_reference, write_image
from myork.imaging.phantom import make_phantom
from myork.imaging.resampling import on_grid
from myork.model.fibers import fibers_of_labels
from myork.model_file import read_model
from myork.records import Image, Labels
from myork.segmentation.scores import dice
from myork.stations.build import build
from myork.stations.data import DeckFiles, OneGrid
from myork.stations.resample import resample
from myork.stations.segment import _times, segment
from tests.images import affine_of, angle, built, save
from tests.scenes import refuses

AFFINE = np.array([[-2.0, 0, 0, 10], [0, 3.0, 0, -5], [0, 0, 8.0, 1], [0, 0, 0, 1]])


def kept(path, data, affine=AFFINE):
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
    assert read_image(kept(tmp_path / "a.nii", np.ones((3, 4)))).data.shape == (3, 4, 1)
    assert read_image(kept(tmp_path / "b.nii", np.ones((3, 4, 2, 1)))).data.shape == (3, 4, 2)
    file = nibabel.Nifti1Image(np.ones((2, 2, 2)), np.diag([1e-3, 1e-3, 5e-3, 1]))
    file.header.set_xyzt_units("meter")
    nibabel.save(file, tmp_path / "a.nii")
    np.testing.assert_allclose(read_image(tmp_path / "a.nii").spacing, [1, 1, 5], rtol=1e-6)
    file.header.set_xyzt_units("unknown")
    nibabel.save(file, tmp_path / "a.nii")
    notes = []
    read_image(tmp_path / "a.nii", note=notes.append)
    assert "0.002 x 0.002 x 0.01 mm large" in notes[0]


def unfinite(path):
    data = np.ones((3, 3, 3))
    data[1, 2, 0] = np.nan
    return read_image(kept(path, data))


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
        kept(path, np.ones((2, 2, 2)), AFFINE + np.outer([0.5, 0, 0, 0], [0, 1, 0, 0]))
    )


@pytest.mark.parametrize(("read", "message"), [
    (unfinite, r"1 voxels are not finite, the first at voxel \(1, 2, 0\)"),
    (singular, "the affine is singular"),
    (sheared, "not perpendicular"),
    (lambda p: read_image(kept(p, np.ones((2, 2, 2, 6)))), r"3-D .* has shape \(2, 2, 2, 6\)"),
    (lambda p: read_image(kept(p, np.ones((2, 2, 2))), values=6), "a 4-D image with 6 volumes"),
    (lambda p: read_labels(kept(p, -np.ones((2, 2, 2), "i2"))), "must not be nega"),
])  # fmt: skip
def test_bad_files_are_named(tmp_path, read, message):
    path = tmp_path / "bad.nii.gz"
    assert str(path) in refuses(message, read, path)


def test_impossible_numbers_of_a_header_are_said_once(tmp_path, recwarn):
    content = kept(tmp_path / "a.nii", np.ones((3, 4, 5), np.int16)).read_bytes()
    signal = np.uint32(0x7F800001).tobytes()  # of not-a-number, in the last row of the sform
    (tmp_path / "a.nii").write_bytes(content[:312] + signal + content[316:])
    refuses("a.nii: .*affine is singular, not finite", read_image, tmp_path / "a.nii")
    assert not recwarn.list


def test_names_of_a_folder_are_for_references_only(tmp_path):
    path, lines = kept(tmp_path / "a.nii.gz", np.ones((2, 2, 2), np.uint8)), []
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
    (tmp_path / "a.json").write_text("[]")  # its own file must be correct
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
    (tmp_path / "dwi.nii.gz").touch()  # the table could belong to either
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
    labels = read_labels(kept(tmp_path / "l.nii", data), notes.append)
    assert labels.data[1].min() == labels.data.max() == 2 and labels.data[0, 0, 0] == 0
    (note,) = notes
    assert "voxels that are not numbers become background: 1" in note
    data[2, 2, 2] = 1.0015
    path = kept(tmp_path / "l.nii", data)
    refuses(r"1 voxels contain other values, the first is 1\.0015 in voxel", read_labels, path)


def test_vectors_with_an_axis_of_time(tmp_path):
    """As written by ITK: x, y, z, time, component."""
    data = np.random.default_rng(0).normal(size=(3, 4, 5, 1, 3))
    path = kept(tmp_path / "v.nii", data)
    assert np.array_equal(read_image(path, 3).data, data[..., 0, :])
    assert np.array_equal(read_image(path, None).data, data[..., 0, :])


def test_sform_and_qform_that_differ_are_noted(tmp_path):
    """A shift of one voxel is; rounding, a code of 0 and a damaged quaternion are not."""
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
    """Labels without geometry do not match their fibers: the warning comes before the refusal."""
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
    assert "2.3 ms for s_echo-1_MEGRE.nii.gz, its header 1.2 ms" in own.grid.doubts[0]
    near = files(tmp_path, echo_times=[1.15, 2.3], field_strength=3.0)
    assert _times(near, print)[1] == 3.0 and not near.grid.doubts
    table(tmp_path / "s_echo-2_MEGRE.json", EchoTime=0)
    assert _times(near, print)[1] == 3.0


THICK = np.diag([1.5, 1.5, 4.0, 1.0])


def stack(seed, slices=16):
    """A limb that becomes thinner along the stack, with noise; the signal fades at the ends."""
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
    # padding; a coarser limb resampled; volumes of a series; a single slice; empty images
    assert faults_of(np.pad(stack(1), ((0, 0), (0, 0), (3, 2)))) == []
    assert faults_of(np.repeat(stack(2), 2, axis=2)) == []
    assert faults_of(np.stack([stack(3), 0.3 * stack(4)], axis=3)) == []
    assert faults_of(stack(5)[..., :1]) == faults_of(np.zeros((4, 4, 6))) == []
    phantom = make_phantom(size=(48, 48, 12), spacing=(2.5, 2.5, 6.0))
    assert damaged_slices(phantom.anatomy) == missing_slices(phantom.truth) == []
    # sagittal and coronal slices cut a limb near its sides
    whole = make_phantom((52, 52, 40), (2.5, 2.5, 2.5), snr=40.0).anatomy.data
    for data in (whole, np.moveaxis(whole, 1, 0)):
        assert not damaged_slices(Image(data[::2] + data[1::2], affine_of((5.0, 2.5, 2.5))))


@pytest.mark.slow
def test_segment_and_build_name_the_slices(tmp_path):
    data, labels = stack(6), np.ones((6, 6, 9), "i2")
    data[..., 7:9], labels[..., 4] = 0.0, 0
    image = kept(tmp_path / "t1.nii", data, THICK)
    found = kept(tmp_path / "l.nii", labels, THICK)
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


# ---- images on other grids in the same world frame -----------------------------------------------


AXES = np.array([[0, 0, -2.0, 9], [-3.0, 0, 0, 4], [0, 5.0, 0, 1], [0, 0, 0, 1]])


@pytest.fixture(scope="module")
def calves():
    """One calf of 84 mm without noise on two grids: fine, and coarse."""
    return [
        make_phantom(size, spacing, snr=1e9, bias=0.0)
        for size, spacing in (((72, 72, 29), (1.7, 1.7, 3.0)), ((48, 48, 15), (2.5, 2.5, 6.0)))
    ]


def plane(shape, affine):
    """An image whose values are a linear function of position."""
    image = Image(np.zeros(shape), affine, "plane")
    at = image.world(np.moveaxis(np.indices(shape), 0, -1))
    return Image(at @ [0.3, -0.2, 0.5] + 7.0, affine, "plane")


@pytest.mark.parametrize("values", [(), (6,)])
def test_other_orders_of_voxels_keep_every_value(values):
    random = np.random.default_rng(1)
    image = Image(random.random((3, 4, 5, *values)), AXES, "image")
    found, move = on_grid(reordered(image), image)
    np.testing.assert_array_equal(found.data, image.data)
    assert (move.file, move.how) == ("other", "reordered") and move.shift < 1e-9
    assert on_grid(image, image) == (image, None)


def test_linear_functions_are_kept_on_oblique_grids():
    turn = affine_of(1.0, [-20.0, -28.0, -16.0])
    turn[:3, :3] = Rotation.from_euler("xyz", [20, -10, 35], degrees=True).as_matrix()
    image = plane((40, 30, 20), turn @ affine_of((1.5, 2.0, 3.0)))
    like = plane((9, 9, 9), affine_of((1.2, 1.1, 2.5)))
    found, move = on_grid(image, like)
    np.testing.assert_allclose(found.data, like.data, atol=1e-9)
    assert move.how == "linear" and move.shift == corner_distance(image, like) > 10.0


def test_half_a_voxel_beyond_the_outer_centres_has_values_and_more_has_none():
    image = Image(np.full((4, 4, 1), 5.0), affine_of((2.0, 2.0, 8.0)))
    like = Image(np.zeros((10, 4, 5)), affine_of((0.5, 0.5, 3.0), [-2.0, 0.0, -6.0]))
    found, move = on_grid(image, like)
    # centres at -2 -1.5 -1 -0.5 ..: the image begins at -1; its slice reaches from -4 to 4
    assert found.data[:, 0, 2].tolist() == [0, 0, *[5.0] * 8]
    assert found.data[5, 0].tolist() == [0, 5, 5, 5, 0]
    assert "48 % of the grid lies in the image" in move.said
    # disjoint images are refused with their extents
    one = Image(np.zeros((4, 4, 4)), affine_of(2.0, [0, 0, 900.0]), "a.nii")
    two = Image(np.zeros((4, 4, 4)), np.eye(4), "b.nii")
    said = "a.nii and b.nii do not overlap: the first reaches .* z 900 to 906, .* z 0 to 3 mm; "
    refuses(said, on_grid, one, two)


def test_a_file_is_written_in_a_known_format(tmp_path):
    one = Image(np.ones((2, 2, 2, 1)), np.eye(4))
    refuses("no image format has this suffix", write_image, tmp_path / "one.txt", one)
    assert not list(tmp_path.iterdir())


def test_volumes_are_resampled_one_by_one_around_what_is_not_finite():
    first, second = plane((6, 6, 6), np.eye(4)), plane((6, 6, 6), np.eye(4)).data ** 2
    second[2, 2, 2] = np.nan
    like = Image(np.zeros((5, 5, 5)), affine_of(1.0, 0.25), "like")
    found, _ = on_grid(Image(np.stack([first.data, second], -1), np.eye(4)), like)
    np.testing.assert_array_equal(found.data[..., 0], on_grid(first, like)[0].data)
    assert np.isfinite(found.data).all()
    assert np.argwhere(found.data[..., 1] == 0).tolist() == [[2, 2, 2]]  # the nearest is unknown


@pytest.mark.parametrize(("one", "other"), [(0, 1), (1, 0)])
def test_labels_take_the_nearest_voxel(calves, one, other):
    truth = calves[other].truth
    found, move = on_grid(reordered(calves[one].truth), truth)
    assert found.affine is truth.affine and found.data.dtype == np.int32
    assert min(dice(found.data == number, truth.data == number) for number in range(1, 7)) > 0.88
    assert move.how == "nearest" and not move.doubts
    assert move.shift == pytest.approx(np.hypot(*[0.5 * abs(71 * 1.7 - 47 * 2.5)] * 2))


def test_fibers_of_any_sign_are_the_true_ones_on_another_grid(calves):
    fine, coarse = calves
    sign = np.random.default_rng(0).choice([-1.0, 1.0], (*coarse.fiber.data.shape[:3], 1))
    fibers = reordered(Image(coarse.fiber.data * sign, coarse.fiber.affine))
    found, true = on_grid(fibers, fine.fiber, "tensor-wise")[0].data, fine.fiber.data
    both = found.any(axis=-1) & true.any(axis=-1)
    assert both.sum() > 0.9 * true.any(axis=-1).sum()
    away = angle(found[both], true[both])
    assert np.median(away) < 0.3 and np.percentile(away, 90) < 2.0
    np.testing.assert_allclose(np.linalg.norm(found[both], axis=-1), 1.0)


def test_tensors_are_interpolated_among_those_that_are_known(calves):
    fine, coarse = calves
    data = np.where(coarse.truth.data[..., np.newaxis] > 0, coarse.clean_tensor.data, np.nan)
    tensor, inside = Image(data, coarse.tensor.affine, "dti"), fine.truth.data > 0
    found, move = on_grid(tensor, fine.clean_tensor, "tensor-wise")
    known = known_tensors(found.data) & inside
    assert known.sum() > 0.9 * inside.sum() and move.how == "tensor-wise"
    # tensors at the rim of the known region are not reduced towards zero
    np.testing.assert_allclose(found.data[known][:, :3].sum(axis=-1), 4.9e-3, rtol=1e-3)
    assert np.median(angle(lead_vector(found.data[known]), fine.fiber.data[known])) < 0.3
    two = replace(tensor, data=data[..., :2])
    refuses("six values per voxel and fibers three", on_grid, two, fine.truth, "tensor-wise")


def test_what_a_grid_does_not_hold_is_said(calves):
    truth = calves[1].truth
    affine = truth.affine + 40.0 * np.eye(4, k=3)  # cuts the lateral side off
    move = on_grid(truth, Image(np.zeros(truth.data.shape), affine, "t1"))[1]
    assert "40 mm apart" in move.said and "one of the headers is wrong" in move.doubts[0]
    assert move.doubts[1].endswith("no voxel of the grid lies in peroneus")
    assert "the rest lies beyond it" in move.doubts[2]
    half = Image(np.ones((4, 4, 4)), np.eye(4), "active")
    bar = Labels(np.ones((4, 4, 8), np.int32), np.eye(4), {1: "soleus"})
    (doubt,) = on_grid(half, bar)[1].doubts
    assert doubt == "active: has no value, taken as 0, in 50 % of soleus"


@pytest.mark.slow
def test_noise_of_tensors_is_averaged_where_it_was_measured(calves):
    fine = make_phantom((180, 180, 9), (0.65, 0.65, 6.0))
    coarse = make_phantom((48, 48, 9), (2.5, 2.5, 6.0), snr=15)
    found = fibers_of_labels(reordered(coarse.tensor), fine.truth, None)
    inside = fine.truth.data > 0
    away = angle(found.fibers.data[inside], fine.fiber.data[inside])
    # if interpolated first, neighbours share their noise: the mean is 5 degrees or more
    assert away.mean() < 1.5 and np.percentile(away, 95) < 3.0
    np.testing.assert_array_equal(found.fibers.data.any(axis=-1), inside)
    assert found.far == 0
    cut = replace(coarse.tensor, data=coarse.tensor.data[:, :, :5])  # up to 27 mm of 51
    found = fibers_of_labels(cut, fine.truth, 3.0)
    beyond = fine.truth.world(np.argwhere(inside))[:, 2] > 33.0
    assert found.far == beyond.sum() and found.distance == pytest.approx(24.0, abs=2.0)
    assert "voxels have no usable tensor around them" in found.doubts()[-1]


def test_a_muscle_thinner_than_the_voxels_of_the_tensors_takes_the_fibers_beside_it(calves):
    fine, coarse = calves
    thin = np.where(fine.truth.data == 3, 3, 0)
    thin[36, 30:34, 11] = 7  # a strip of the soleus, between two slices of the coarse grid
    labels = replace(fine.truth, data=thin.astype(np.int32))
    assert 7 not in on_grid(labels, coarse.truth)[0].data
    found = fibers_of_labels(coarse.clean_tensor, labels, 2.5).fibers.data
    assert (np.abs(np.linalg.norm(found, axis=-1) - (thin > 0)) < 1e-9).all()


DECK = {
    "scene": {"dimension": 3},
    "image": {
        "anatomy": "t1.nii.gz", "tensor": "dti.nii.gz", "reference": "old.nii.gz",
        "region": "near.nii.gz", "body": "body.nii.gz", "truth": "truth.nii.gz",
        "regions": 3, "tolerance": 0.01,
    },
    "bias": {"method": "none"},
    "build": {
        "collocation_stride": [4, 4, 1], "source_stride": [8, 8, 1], "ids": [1],
    },
}  # fmt: skip


def chain(folder, t1, dti, labels, fibers):
    """Summary after both stations; models from their own label map, and from labels and fibers."""
    folder.mkdir()
    truth = labels.data.astype(float)  # masks in single precision
    images = {"t1": t1.anatomy, "truth": t1.truth, "dti": dti, "vectors": fibers}
    masks = {"old": truth, "near": 1.0 * (truth > 0), "body": 1.0 * (truth >= 0)}
    save(folder, labels.affine, **images, **masks)
    (folder / "old.json").write_text(json.dumps({n: k for k, n in t1.truth.names.items()}))
    (folder / "deck.toml").write_text(text_of_tables(DECK))
    found, lines = [], []
    options = ("build.labels=truth.nii.gz", "build.fibers=vectors.nii.gz")
    segment(folder / "deck.toml", folder / "out", progress=lines.append)
    for overrides in ((), options):
        build(folder / "deck.toml", folder / "out", overrides=overrides, progress=lines.append)
        found.append(read_model(folder / "out" / "model.h5"))
    return json.loads((folder / "out" / "summary.json").read_text()), found, lines


@pytest.mark.slow
def test_a_run_on_four_grids_is_that_on_one(calves, tmp_path):
    fine, coarse = calves
    one, models, _ = chain(tmp_path / "one", fine, fine.clean_tensor, fine.truth, fine.fiber)
    four, others, lines = chain(
        tmp_path / "four", fine, reordered(coarse.clean_tensor), reordered(coarse.truth),
        reordered(fine.fiber),
    )  # fmt: skip
    assert one["resampled"] == []
    how = {entry["file"].rpartition("/")[2]: entry["how"] for entry in four["resampled"]}
    masks = dict.fromkeys(("old.nii.gz", "near.nii.gz", "body.nii.gz"), "nearest")
    assert how == {"dti.nii.gz": "tensor-wise", **masks, "vectors.nii.gz": "reordered"}
    assert {entry["station"] for entry in four["resampled"]} == {"segment", "build"}
    assert sum("resampled onto the grid of" in line for line in lines) == 4
    scores = [own["segmentation"]["scores"]["medial_gastrocnemius"]["dice"] for own in (one, four)]
    assert scores[1] > 0.95 and scores[1] > scores[0] - 0.02
    # labels on the anatomy's grid and fibers in another order: the same model
    np.testing.assert_allclose(others[1].fiber, models[1].fiber, atol=1e-5)
    np.testing.assert_array_equal(others[1].points, models[1].points)
    # labels and tensors on a coarser grid: nearly the same
    assert others[0].volume.sum() == pytest.approx(models[0].volume.sum(), rel=0.03)
    lean, wanted = (np.median(angle(own[0].fiber, [0, 0, 1])) for own in (others, models))
    assert lean == pytest.approx(wanted, abs=0.5)


@pytest.mark.slow
def test_parts_and_activation_of_another_grid_are_interpolated(calves, tmp_path):
    fine, coarse = calves
    whole, affine = coarse.truth.data, coarse.truth.affine
    parts = np.stack([(whole == number).astype(float) for number in range(1, 7)], axis=-1)
    height = plane(whole.shape, affine)
    low, rise = height.data.min(), np.ptp(height.data)
    parts, active = (reordered(Image(x, affine)) for x in (parts, (height.data - low) / rise))
    save(tmp_path, affine, labels=fine.truth, parts=parts, active=active)
    table = {"labels": "labels.nii.gz", "fractions": "parts.nii.gz", "activation": "active.nii.gz"}
    built(tmp_path, **table, collocation_stride=[4, 4, 2], source_stride=[8, 8, 4])
    moved = json.loads((tmp_path / "out" / "summary.json").read_text())["resampled"]
    assert [entry["how"] for entry in moved] == ["linear", "linear"]
    model = read_model(tmp_path / "out" / "model.h5")
    volumes = {n: (whole == n).sum() * coarse.truth.spacing.prod() for n in range(1, 7)}
    assert model.label_volumes() == pytest.approx(volumes, rel=0.06)
    expected = (model.points @ [0.3, -0.2, 0.5] + 7.0 - low) / rise
    assert np.abs(model.activation - expected).max() < 0.06


def test_the_command_resamples_files(calves, tmp_path, capsys):
    fine, coarse = calves
    tensor = coarse.clean_tensor
    images = {"t1": fine.anatomy, "fat": coarse.fat, "mask": reordered(coarse.truth)}
    save(tmp_path, np.eye(4), **images, dwi=reordered(tensor), dti=reordered(tensor))

    def on_t1(name, *options):
        out = tmp_path / f"{name}_on_t1.nii.gz"
        words = [str(tmp_path / f"{one}.nii.gz") for one in (name, "t1")]
        status = main(["resample", *words, "-o", str(out), *options])
        return status, out, capsys.readouterr()

    status, out, said = on_t1("mask")
    assert status == 0 and f"image: {out}" in said.out
    mask = read_labels(out)
    np.testing.assert_array_equal(mask.data, on_grid(coarse.truth, fine.anatomy)[0].data)
    assert mask.names == fine.truth.names and mask.data.shape == (72, 72, 29)
    dwi = read_image(on_t1("dwi")[1], 6).data
    for k in range(6):
        one = Image(tensor.data[..., k], coarse.fat.affine)
        np.testing.assert_allclose(dwi[..., k], on_grid(one, fine.fat)[0].data, atol=1e-7)
    tensors = read_image(on_t1("dti", "--how", "tensor-wise")[1], 6).data
    expected = on_grid(tensor, fine.anatomy, "tensor-wise")[0].data
    np.testing.assert_allclose(tensors, expected, atol=1e-7)
    assert not np.allclose(tensors, dwi, atol=1e-4)  # at the skin
    status, _, said = on_t1("fat", "--how", "cubic")
    assert status == 2 and "--how cubic: is not known; one of nearest, linear" in said.err
    save(tmp_path, affine_of(1.0, 5000.0), fat=np.ones((3, 3, 3)))
    status, _, said = on_t1("fat")
    assert status == 2 and "do not overlap" in said.err


@pytest.mark.parametrize("factor", [1.0, 0.25])
def test_masks_under_the_header_of_an_image_stay_labels_and_grey_values_do_not(tmp_path, factor):
    values = np.zeros((8, 8, 4))
    values[2:6, 2:6] = 2 * factor
    save(tmp_path, affine_of(1.0, [0.5, 0, 0]), like=np.zeros((8, 8, 4)))
    path, like, out = (tmp_path / f"{name}.nii.gz" for name in ("values", "like", "out"))
    file = nibabel.Nifti1Image(values, np.eye(4))
    file.set_data_dtype(np.int16)  # spread over all its values, as in an image header
    nibabel.save(file, path)
    assert (nibabel.load(path).get_fdata() != values).any()
    found = read_image(resample(path, like, out)).data
    if factor == 1.0:
        assert set(np.unique(found)) == {0, 2}
    else:  # half-way across the rim
        assert found[1, 3, 1] == pytest.approx(0.25, abs=1e-4)
