"""Tensors from diffusion images: compared with DIPY and truth, in any frame; command and maps."""

import re
from dataclasses import replace

import numpy as np
import pytest
from dipy.core.gradients import gradient_table
from dipy.reconst.dti import TensorModel

from benchmarks.truths.scanners import even_directions, reordered, write_gradients
from myork.errors import InputError
from myork.imaging import diffusion
from myork.imaging.diffusion import fit_tensors, parse_axes, read_tensors, tensor_components
from myork.imaging.geometry import with_axis_at
from myork.imaging.gradients import GradientTable
from myork.imaging.io import write_image
from myork.imaging.phantom import make_phantom
from myork.model.orientation import check_orientation
from myork.records import Image, Labels
from tests.images import affine_of, centred, phantom_dwi
from tests.scenes import refuses


@pytest.fixture(scope="module")
def phantom():
    return make_phantom(size=(76, 76, 9), spacing=(1.5, 1.5, 6.0))


@pytest.fixture(scope="module")
def series(phantom):
    return phantom_dwi(phantom, snr=25.0)


@pytest.fixture(scope="module")
def tensor(series):
    return fit_tensors(*series)


def test_same_tensors_as_dipy(phantom, series, tensor):
    dwi, table = series
    some = tuple(np.argwhere(phantom.tissue.data == 1)[::100].T)
    model = TensorModel(gradient_table(table.b, bvecs=table.direction), fit_method="WLS")
    theirs = model.fit(dwi.data[some])
    ours = tensor.data[some]
    # Both solve the same normal equations of condition 1e3 in double precision.
    np.testing.assert_allclose(ours, tensor_components(theirs.quadratic_form), atol=1e-10 * 2e-3)
    np.testing.assert_allclose(diffusion.fractional_anisotropy(ours), theirs.fa, atol=1e-9)
    np.testing.assert_allclose(diffusion.mean_diffusivity(ours), theirs.md, rtol=1e-9)


def test_bad_signals_give_no_tensor_and_change_no_other(series):
    dwi, table = series
    data = dwi.data[34:38, 34:38, 4:5].copy()
    clean = fit_tensors(Image(data, dwi.affine), table).data
    data[0, 0, 0, 5] = np.nan
    data[1, 1, 0] = 0.0
    found = fit_tensors(Image(data, dwi.affine), table).data
    bad = np.isnan(found).any(axis=-1)
    assert np.argwhere(bad).tolist() == [[0, 0, 0], [1, 1, 0]]
    np.testing.assert_allclose(found[~bad], clean[~bad], rtol=1e-9)


def doubts(dwi, table):
    return diffusion.diffusion_doubts(dwi, table, fit_tensors(dwi, table))


def test_a_table_in_another_order_is_doubted(phantom):
    """Exchanged directions raise a doubt at any noise; a flipped axis or seven images do not."""
    for directions, snr in ((12, 5.0), (30, 25.0)):
        dwi, table = phantom_dwi(phantom, snr=snr, directions=directions)
        assert not doubts(dwi, table)
        flipped = table.direction * [1.0, -1.0, 1.0]
        assert not doubts(dwi, GradientTable(table.b, flipped))
        order = np.arange(len(table.b))
        weighted = np.flatnonzero(~table.still)
        for seed in range(3):
            order[weighted] = np.random.default_rng(seed).permutation(weighted)
            said = doubts(dwi, GradientTable(table.b, table.direction[order]))
            assert "the table may belong to another series" in said[0]
    few = np.r_[0, weighted[:6]]
    some = Image(dwi.data[..., few], dwi.affine)
    other = np.r_[0, few[:0:-1]]
    assert not doubts(some, GradientTable(table.b[few], table.direction[other]))


@pytest.mark.parametrize(("factor", "change", "message"), [
    (0.5, {}, r"volume 7 \(by a factor of 0.5\)"), (0.0, {}, "volume 7 "), (1.7, {}, "volume 7 "),
    (1.0, {"direction": np.abs}, "have the same sign"),
    (1.0, {"b": lambda b: 10.0 * b}, "up to 5000, are in s/mm"),
])  # fmt: skip
def test_damaged_volumes_lost_signs_and_other_units_are_doubted(series, factor, change, message):
    dwi, table = series
    data = dwi.data * np.where(np.arange(33) == 7, factor, 1.0)
    table = replace(table, **{key: way(getattr(table, key)) for key, way in change.items()})
    assert any(re.search(message, text) for text in doubts(Image(data, dwi.affine), table))


@pytest.mark.parametrize("directions", [even_directions(5), np.tile([[0, 0, 1.0]], (8, 1))])
def test_too_few_directions(directions):
    n = len(directions)
    table = GradientTable(np.r_[0.0, np.full(n, 500.0)], np.vstack([[0, 0, 0], directions]))
    with pytest.raises(InputError, match="gradients do not determine a tensor"):
        fit_tensors(Image(np.ones((2, 2, 2, n + 1)), np.eye(4), "dwi.nii"), table)


@pytest.mark.slow
def test_axes_of_the_file_do_not_change_the_fibers(phantom, series, tmp_path):
    dwi, table = series
    keys = {"dwi": "a.nii.gz", "gradient_axes": "x y z"}

    def turned(image):
        return reordered(image, (2, 0, 1), (0,))

    found = []
    for image in (dwi, turned(dwi)):
        write_image(tmp_path / "a.nii.gz", image)
        write_gradients(tmp_path, "a", table, image.affine)
        found.append(read_tensors(keys, tmp_path).tensor)
    inside = turned(phantom.tissue).data == 1
    # Files are in single precision; tensors are of order 2e-3.
    np.testing.assert_allclose(
        found[1].data[inside], turned(found[0]).data[inside], atol=1e-5 * 2e-3
    )


def test_axes_turn_tensors_in_the_voxel_frame():
    components = np.random.default_rng(1).random((1, 1, 1, 6))
    affine = np.array([[0, -2.0, 0, 0], [2.0, 0, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]])
    axes = parse_axes("y -x z")
    columns = affine[:3, :3] / 2.0
    turn = columns @ axes @ columns.T
    full = turn @ diffusion.full_tensors(components) @ turn.T
    turned = diffusion.turn_tensors(Image(components, affine), axes).data
    np.testing.assert_allclose(turned, tensor_components(full))


@pytest.mark.parametrize("text", ["x y", "x y y", "x y w", "x y z -x", ""])
def test_bad_axes(text):
    assert read_tensors({"gradient_axes": "x y z"}, ".") is None
    refuses("image.gradient_axes = .* x, y and z are needed", parse_axes, text)


def test_maps_of_known_tensors():
    stick, plate = (tensor_components(np.diag(d)) for d in ([0.0, 0.0, 2.0], [1.0, 1.0, 0.0]))
    found = diffusion.fractional_anisotropy(np.stack([stick, plate, [1, 1, 1, 0, 0, 0], 6 * [0.0]]))
    np.testing.assert_allclose(found, [1.0, np.sqrt(0.5), 0.0, 0.0], atol=1e-12)
    data = np.zeros((2, 1, 1, 6))
    data[0, 0, 0] = [1e-3, 3e-3, 2e-3, 0, 0, 0]
    data[1] = np.nan
    maps = diffusion.tensor_maps(Image(data, np.eye(4)))
    np.testing.assert_allclose(maps["eigenvalues"].data[0, 0, 0], [3e-3, 2e-3, 1e-3])
    assert maps["md"].data[0, 0, 0] == pytest.approx(2e-3)
    assert maps["fa"].data[0, 0, 0] == pytest.approx(np.sqrt(1.5 * 2 / 14))
    assert not any(image.data[1].any() for image in maps.values())


# ---- wrong gradient axes are found by walls and by anatomy, right ones raise no doubt ------------


@pytest.fixture(scope="module")
def calf():
    return make_phantom(size=(58, 58, 9), spacing=(2.0, 2.0, 10.0))


def wrong(calf, axes):
    return Image(calf.fiber.data @ parse_axes(axes).T, calf.fiber.affine)


def test_the_right_axes_raise_no_doubt(calf):
    evidence, doubt, remark = check_orientation(calf.fiber, calf.truth)
    assert doubt == "" and "with anatomy +1.00" in remark
    assert evidence[0].axes == "x y z" and evidence[0].agreement > 0.99
    assert len(evidence) == len({entry.axes for entry in evidence}) == 24
    nothing = Image(np.zeros_like(calf.fiber.data), calf.fiber.affine)
    assert check_orientation(nothing, calf.truth) == ([], "", "")


# The correction of a table is the inverse of the error.
@pytest.mark.parametrize(("damaged", "mended"), [
    ("-x y z", "-x y z"), ("x -y z", "x -y z"), ("x y -z", "x y -z"), ("x z y", "x z y"),
    ("y -x z", "-y x z"),
])  # fmt: skip
def test_anatomy_tells_which_axes_are_wrong(calf, damaged, mended):
    doubt = check_orientation(wrong(calf, damaged), calf.truth).doubt
    assert "contradict anatomy" in doubt and f'image.gradient_axes = "{mended}"' in doubt


@pytest.mark.slow
def test_without_names_walls_tell_the_long_axis_but_not_flips(calf):
    muscles = Labels((calf.truth.data > 0) * calf.truth.data, calf.truth.affine)
    for axes in ("x y z", "x -y z", "y x z"):
        found = check_orientation(wrong(calf, axes), muscles)
        assert found.doubt == "" and found.evidence[0].agreement is None
        assert "cannot be seen without muscles of known names" in found.remark
    for axes in ("x z y", "z y x"):
        found = check_orientation(wrong(calf, axes), muscles)
        assert "fibers cross the walls of muscles" in found.doubt and found.remark == ""
        # The corrected table cannot be distinguished from one with both transverse axes exchanged.
        said = found.doubt.split('image.gradient_axes = "')[1].split('"')[0]
        assert said.replace("-", "") in (axes, "z x y", "y z x")


@pytest.mark.slow
@pytest.mark.parametrize("pennation", [0.5, 1.0, 1.4])
@pytest.mark.parametrize("slices", [(4, 8.0), (9, 10.0)])
def test_right_tables_of_short_and_pennate_muscles_raise_no_doubt(pennation, slices):
    """Their tracts are up to three times as long along wrong axes."""
    n, h = slices
    calf = make_phantom((58, 58, n), (2.0, 2.0, h), pennation=pennation)
    for labels in ([3], [1], [1, 2, 3, 4, 5, 6]):
        data = np.where(np.isin(calf.truth.data, labels), calf.truth.data, 0).astype(np.int32)
        assert check_orientation(calf.fiber, Labels(data, calf.truth.affine)).doubt == ""


@pytest.mark.parametrize(("degrees", "seen"), [(20, True), (35, True), (42, False)])
def test_outlines_that_end_before_the_image_are_no_walls(degrees, seen):
    """A short bar, drawn in part of the image, whose fibers lean."""
    x, y, z = centred(20, 16, 16)
    inside = ((x / 8) ** 2 + (y / 6) ** 2 < 1) & (np.abs(2.5 * z) < 16)
    lean = np.radians(degrees)
    along = np.array([np.sin(lean), 0.0, np.cos(lean)])
    affine = affine_of((1, 1, 2.5))
    muscle = Labels(inside.astype(np.int32), affine)
    right, swapped = (
        check_orientation(Image(inside[..., np.newaxis] * way, affine), muscle)
        for way in (along, along[::-1])
    )
    # all around, the mean squared cosine to the wall normals is half that of the inclination
    exact = 0.5 * np.sin(lean) ** 2
    assert not seen or right.evidence[0].crossing == pytest.approx(exact, abs=0.03)
    assert right.doubt == "" and ("swapped" in swapped.doubt) == seen
    assert ("walls of muscles do not decide" in swapped.remark) == (not seen)


def test_the_axes_are_those_of_the_diffusion_images(calf):
    """The axes to exchange are named correctly for labels with another voxel order."""
    fibers, muscles = (with_axis_at(one, 2, 0) for one in (wrong(calf, "x z y"), calf.truth))
    doubt = check_orientation(fibers, muscles, calf.truth.affine).doubt
    assert 'image.gradient_axes = "x z y"' in doubt
