"""Wrong gradient axes are found by tracts and by anatomy."""

import numpy as np
import pytest

from myork.imaging.diffusion import parse_axes
from myork.imaging.phantom import make_phantom
from myork.model.orientation import check_orientation
from myork.model.tracts import follow, tract_lengths
from myork.records import Image, Labels


@pytest.fixture(scope="module")
def phantom():
    return make_phantom(size=(58, 58, 9), spacing=(2.0, 2.0, 10.0))


def wrong(phantom, axes):
    return Image(phantom.fiber.data @ parse_axes(axes).T, phantom.fiber.affine)


def test_the_right_axes_raise_no_doubt(phantom):
    evidence, doubt = check_orientation(phantom.fiber, phantom.truth)
    assert doubt == ""
    assert len(evidence) == 24 and evidence[0].axes == "x y z"
    assert evidence[0].agreement > 0.99
    assert len({entry.axes for entry in evidence}) == 24


# What mends a table is the inverse of what spoilt it.
@pytest.mark.parametrize(
    ("spoilt", "mended"),
    [("-x y z", "-x y z"), ("x -y z", "x -y z"), ("x y -z", "x y -z"), ("x z y", "x z y"),
     ("y -x z", "-y x z")],
)  # fmt: skip
def test_anatomy_tells_which_axes_are_wrong(phantom, spoilt, mended):
    _, doubt = check_orientation(wrong(phantom, spoilt), phantom.truth)
    assert "contradict anatomy" in doubt
    assert f'image.gradient_axes = "{mended}"' in doubt


def test_without_names_tracts_tell_exchanged_axes_but_not_flips(phantom):
    muscles = Labels((phantom.truth.data > 0).astype(np.int32), phantom.truth.affine)
    for axes in ("x y z", "x -y z"):
        evidence, doubt = check_orientation(wrong(phantom, axes), muscles)
        assert doubt == "" and evidence[0].agreement is None
    _, doubt = check_orientation(wrong(phantom, "x z y"), muscles)
    assert "axes of the diffusion gradients may be exchanged" in doubt


def test_no_fibers_no_evidence(phantom):
    nothing = Image(np.zeros_like(phantom.fiber.data), phantom.fiber.affine)
    assert check_orientation(nothing, phantom.truth) == ([], "")


def test_tracts_of_a_circular_field():
    affine = np.diag([1.0, 1.0, 2.0, 1.0])
    affine[:3, 3] = -20.0, -20.0, 0.0
    place = np.stack(np.indices((41, 41, 3)), -1) @ affine[:3, :3].T + affine[:3, 3]
    radius = np.hypot(place[..., 0], place[..., 1])
    vector = np.stack([-place[..., 1], place[..., 0], np.zeros(radius.shape)], -1)
    vector /= np.maximum(radius, 1e-9)[..., np.newaxis]
    vector *= np.random.default_rng(1).choice([-1.0, 1.0], radius.shape)[..., np.newaxis]
    inside = (radius > 4.0) & (radius < 18.0)
    seeds = np.array([[32, 20, 1]])
    tracts, length = follow(Image(vector, affine), inside, seeds, 0.5, 30.0)
    # 12 mm from the axis on all its way; each way ends at the reach.
    away = np.hypot(tracts[0][:, 0], tracts[0][:, 1])
    np.testing.assert_allclose(away, 12.0, atol=0.15)
    assert length[0] == pytest.approx(60.0)
    steps = np.linalg.norm(np.diff(tracts[0], axis=0), axis=1)
    np.testing.assert_allclose(steps, 0.5, atol=1e-9)


def test_tracts_end_at_the_rim():
    vector = np.zeros((5, 5, 30, 3))
    vector[..., 2] = 1.0
    inside = np.ones((5, 5, 30), bool)
    inside[:, :, :10] = False
    length = tract_lengths(Image(vector, np.eye(4)), inside)
    np.testing.assert_allclose(length, 20.0, atol=1.0)
