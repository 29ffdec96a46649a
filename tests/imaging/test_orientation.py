"""Wrong gradient axes are found by walls and by anatomy, right ones raise no doubt."""

import numpy as np
import pytest

from myork.imaging.diffusion import parse_axes
from myork.imaging.geometry import with_axis_at
from myork.imaging.phantom import make_phantom
from myork.model.orientation import check_orientation
from myork.records import Image, Labels
from tests.images import affine_of, centred


@pytest.fixture(scope="module")
def phantom():
    return make_phantom(size=(58, 58, 9), spacing=(2.0, 2.0, 10.0))


def wrong(phantom, axes):
    return Image(phantom.fiber.data @ parse_axes(axes).T, phantom.fiber.affine)


def test_the_right_axes_raise_no_doubt(phantom):
    evidence, doubt, remark = check_orientation(phantom.fiber, phantom.truth)
    assert doubt == "" and "with anatomy +1.00" in remark
    assert evidence[0].axes == "x y z" and evidence[0].agreement > 0.99
    assert len(evidence) == len({entry.axes for entry in evidence}) == 24
    nothing = Image(np.zeros_like(phantom.fiber.data), phantom.fiber.affine)
    assert check_orientation(nothing, phantom.truth) == ([], "", "")


# What mends a table is the inverse of what damaged it.
@pytest.mark.parametrize(("damaged", "mended"), [
    ("-x y z", "-x y z"), ("x -y z", "x -y z"), ("x y -z", "x y -z"), ("x z y", "x z y"),
    ("y -x z", "-y x z"),
])  # fmt: skip
def test_anatomy_tells_which_axes_are_wrong(phantom, damaged, mended):
    doubt = check_orientation(wrong(phantom, damaged), phantom.truth).doubt
    assert "contradict anatomy" in doubt and f'image.gradient_axes = "{mended}"' in doubt


@pytest.mark.slow
def test_without_names_walls_tell_the_long_axis_but_not_flips(phantom):
    muscles = Labels((phantom.truth.data > 0) * phantom.truth.data, phantom.truth.affine)
    for axes in ("x y z", "x -y z", "y x z"):
        found = check_orientation(wrong(phantom, axes), muscles)
        assert found.doubt == "" and found.evidence[0].agreement is None
        assert "cannot be seen without muscles of known names" in found.remark
    for axes in ("x z y", "z y x"):
        found = check_orientation(wrong(phantom, axes), muscles)
        assert "fibers cross the walls of muscles" in found.doubt and found.remark == ""
        # Nothing parts the mended table from one with the two axes across exchanged as well.
        said = found.doubt.split('image.gradient_axes = "')[1].split('"')[0]
        assert said.replace("-", "") in (axes, "z x y", "y z x")


@pytest.mark.slow
@pytest.mark.parametrize("pennation", [0.5, 1.0, 1.4])
@pytest.mark.parametrize("slices", [(4, 8.0), (9, 10.0)])
def test_right_tables_of_short_and_pennate_muscles_raise_no_doubt(pennation, slices):
    """Tracts of these are up to three times as long along wrong axes."""
    n, h = slices
    calf = make_phantom((58, 58, n), (2.0, 2.0, h), pennation=pennation)
    for labels in ([3], [1], [1, 2, 3, 4, 5, 6]):
        data = np.where(np.isin(calf.truth.data, labels), calf.truth.data, 0).astype(np.int32)
        assert check_orientation(calf.fiber, Labels(data, calf.truth.affine)).doubt == ""


def test_outlines_that_end_before_the_image_are_no_walls():
    """A short bar, drawn in part of the image, whose fibers lean 20 degrees."""
    x, y, z = centred(20, 16, 16)
    inside = ((x / 8) ** 2 + (y / 6) ** 2 < 1) & (np.abs(2.5 * z) < 16)
    lean = np.radians(20.0)
    along = np.array([np.sin(lean), 0.0, np.cos(lean)])
    affine = affine_of((1, 1, 2.5))
    muscle = Labels(inside.astype(np.int32), affine)
    right, swapped = (
        check_orientation(Image(inside[..., np.newaxis] * way, affine), muscle)
        for way in (along, along[::-1])
    )
    # all around, the mean square of the cosine to the walls' normals is half that of the lean
    assert right.evidence[0].crossing == pytest.approx(0.5 * np.sin(lean) ** 2, abs=0.03)
    assert right.doubt == "" and "swapped" in swapped.doubt


def test_the_axes_are_those_of_the_diffusion_images(phantom):
    """Labels on voxels in another order do not rename what is to be exchanged."""
    fibers, muscles = (with_axis_at(one, 2, 0) for one in (wrong(phantom, "x z y"), phantom.truth))
    doubt = check_orientation(fibers, muscles, phantom.truth.affine).doubt
    assert 'image.gradient_axes = "x z y"' in doubt
