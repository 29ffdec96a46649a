"""Bias fields against the truth."""

import re

import numpy as np
import pytest

from myork.imaging.phantom import make_phantom, rician
from myork.records import Image
from myork.segmentation.regions import body_mask
from myork.segmentation.shading import joint_variation, shading, variation_doubt
from tests.scenes import refuses


def shaded(ends, beside, *, slices=slice(1, 2), size=(160, 160, 3), spacing=(0.8, 0.8, 40.0)):
    """Calf under a coil beside it: image, body, true field."""
    phantom = make_phantom(size, spacing, snr=1e6, bias=0.0, septum=0.0, growth=15.0).anatomy
    whole = Image(phantom.data[:, :, slices], phantom.affine)
    mask, shape = body_mask(whole), whole.data.shape
    away = (np.stack(np.indices(shape), -1) - np.array(beside) * shape) * whole.spacing
    coil = (1.0 + (away**2).sum(-1) / 60.0**2) ** -1.5
    low, high = coil[mask].min(), coil[mask].max()
    field = ends[0] + (ends[1] - ends[0]) * (coil - low) / (high - low)
    noisy = rician(whole.data * field, 16.0, np.random.default_rng(1))
    return Image(noisy, whole.affine), mask, field


def likeness(found, truth, mask):
    return np.corrcoef(found[mask], truth[mask])[0, 1]


@pytest.mark.slow
@pytest.mark.parametrize("ends", [(0.4, 2.0), (0.75, 1.3)])
def test_one_slice_under_a_coil(ends):
    image, mask, truth = shaded(ends, (0.1, 0.2, 0.5))
    found = shading(image.data, body_mask(image), spacing=image.spacing)
    assert likeness(found.field, truth, mask) >= 0.98 and not found.doubt
    again = shading(np.where(mask, 5.0 * image.data, np.nan), mask, spacing=image.spacing / 10.0)
    assert likeness(again.field, truth, mask) >= 0.98


@pytest.mark.slow
def test_stack_under_a_strong_coil():
    size = {"slices": slice(None), "size": (96, 96, 9), "spacing": (1.25, 1.25, 10)}
    image, mask, truth = shaded((0.27, 2.4), (0.0, 0.2, 0.3), **size)
    found = shading(image.data, body_mask(image), spacing=image.spacing)
    assert likeness(found.field, truth, mask) >= 0.985


@pytest.mark.slow
def test_limbs_that_do_not_touch():
    """Slopes do not know how bright one leg is against the other."""
    image, mask, truth = shaded((0.5, 1.5), (0.1, 0.2, 0.5))
    values, mask, truth = (
        np.concatenate([one, np.zeros_like(one[:40]), one if one is mask else 0.5 * one])
        for one in (image.data, mask, truth)
    )
    found = shading(values, mask, spacing=image.spacing)
    assert likeness(found.field, truth, mask) >= 0.98 and not found.doubt


def test_a_field_that_makes_tissues_scatter_more_is_doubted():
    i, j, _ = np.indices((60, 60, 1))
    tissue = np.where((i // 6 + j // 6) % 2, 1.0, 3.0)
    random = np.random.default_rng(2)
    even = tissue * 100.0 + random.normal(0.0, 5.0, tissue.shape)
    mask = even > 0
    # scatter of both is 5, their difference 200; Otsu's threshold separates them
    assert joint_variation(even, mask) == pytest.approx(0.05, rel=0.05)
    field = 1.0 + 0.4 * np.sin(i / 9.0)
    assert not variation_doubt(even * field, field, mask)
    doubt = variation_doubt(even, field, mask)
    assert re.search(r"of bright and dark tissue from 0\.0\d+ to 0\.\d+; look", doubt)
    # a rise as small as what noise makes is no evidence
    slight = 1.0 + 0.01 * np.sin(i / 9.0)
    assert joint_variation(even / slight, mask) > joint_variation(even, mask)
    assert not variation_doubt(even, slight, mask)
    assert joint_variation(np.ones(mask.shape), mask) == 0.0
    # one tissue alone: its scatter is cut in two, and a field that adds to it is no evidence
    alone = 100.0 + random.normal(0.0, 20.0, tissue.shape)
    assert joint_variation(alone, mask) == pytest.approx(np.sqrt(np.pi / 2 - 1), rel=0.03)
    spotted = random.choice([0.5, 1.0, 2.0], tissue.shape, p=[0.02, 0.96, 0.02])
    assert joint_variation(alone / spotted, mask) > joint_variation(alone, mask)
    assert not variation_doubt(alone, spotted, mask)


@pytest.mark.slow
def test_voxels_that_do_not_touch_have_no_slopes():
    mask = np.zeros((40, 40, 1), bool)
    mask[::4, ::4] = True
    found = shading(np.ones(mask.shape), mask, spacing=(1, 1, 1))
    np.testing.assert_allclose(found.field[mask], 1.0, atol=1e-6)
    assert not found.doubt


def test_nothing_to_look_at():
    nothing = np.zeros((8, 8, 1))
    few = np.indices((8, 8, 1))[0] < 2
    for values, where, said in (
        (nothing + 1.0, nothing > 0, "no voxel to estimate the field from"),
        (nothing + 1.0, few, "16 voxels are too few to estimate a field"),
        (nothing + np.nan, nothing == 0, "not finite"),
        (nothing, nothing == 0, "the body has no signal"),
        (nothing - 1.0, nothing == 0, "100% of the values in the body are negative"),
    ):
        refuses(said, shading, values, where, spacing=(1, 1, 1))
