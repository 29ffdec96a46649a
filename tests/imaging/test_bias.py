"""Bias fields against the truth of the phantom."""

import numpy as np
import pytest

from myork.imaging.phantom import make_phantom
from myork.records import Image
from myork.segmentation import bias
from myork.segmentation.bias import check_positive, clustered_bias
from myork.segmentation.regions import body_mask
from tests.refusals import refuses


def shaded(bias, size):
    """Image, mask and true field."""
    phantom = make_phantom(size, (1.25, 1.25, 6.0), bias=bias)
    return phantom.anatomy, body_mask(phantom.anatomy), phantom.bias.data


@pytest.mark.slow
@pytest.mark.parametrize("bias", [0.3, 0.9])
def test_field_of_the_phantom(bias):
    image, mask, truth = shaded(bias, (96, 96, 15))
    found = clustered_bias(image.data, mask, spacing=image.spacing, regions=2)
    # 0.98 is what was asked for; muscles differ by 3 % and fat from septa by 15 % in the phantom.
    assert np.corrcoef(found.field[mask], truth[mask])[0, 1] >= 0.98
    assert (np.diff(found.energy) <= 1e-9 * found.energy[0]).all()
    assert found.converged
    assert found.field[mask].mean() == pytest.approx(1.0)
    # Under the skin, where nothing is looked at, the field goes on: it takes away more than half of
    # the shading there, without the slope that it would have over three pixels.
    rim = body_mask(image, rim=0.0) & ~mask
    shading = truth[rim] / truth[mask].mean()
    ratios = found.field[rim] / shading, 1 / shading
    left, before = (np.percentile(np.abs(ratio - 1.0), 95) for ratio in ratios)
    assert left < 0.5 * before


@pytest.mark.slow
@pytest.mark.parametrize(
    "other", [{"bias": 0.5}, {"imat": 0.05, "imct": 0.1}, {"scale": 0.85}, {"snr": 10.0}]
)
def test_three_regions_on_phantoms_full_of_muscle(other):
    """Dark tissue, little fat or strong shading: two regions reach 0.88 to 0.96 on some."""
    phantom = make_phantom((96, 96, 7), (1.25, 1.25, 14.0), septum=0.0, growth=15.0, **other)
    image, mask = phantom.anatomy, body_mask(phantom.anatomy)
    found = clustered_bias(image.data, mask, spacing=image.spacing, regions=3)
    assert np.corrcoef(found.field[mask], phantom.bias.data[mask])[0, 1] >= 0.98


@pytest.mark.slow
def test_brightness_and_values_outside_do_not_matter(monkeypatch):
    monkeypatch.setattr(bias, "_ROUNDS", 5)
    image, mask, _ = shaded(0.3, (96, 96, 3))
    a, b = (
        clustered_bias(values, mask, spacing=image.spacing, regions=2)
        for values in (image.data, np.where(mask, 7.0 * image.data, np.nan))
    )
    np.testing.assert_allclose(a.field, b.field, rtol=1e-10)


def test_weights_of_the_contours(monkeypatch):
    """Three regions have two level sets: their weights may differ; equal ones are one for both."""
    monkeypatch.setattr(bias, "_ROUNDS", 2)
    image, mask, _ = shaded(0.3, (96, 96, 3))

    def field(mu):
        return clustered_bias(image.data, mask, spacing=image.spacing, regions=3, mu=mu).field

    np.testing.assert_array_equal(field([0.02, 0.02]), field(0.02))
    assert not np.array_equal(field([0.02, 2.0]), field(0.02))
    refuses("bias.mu has 3 weights; give one for all or 2", field, [0.1, 0.1, 0.1])


def test_images_without_a_field_are_refused():
    image, mask, _ = shaded(0.3, (96, 96, 3))
    options = {"spacing": (1, 1, 1), "regions": 2}
    nowhere = np.zeros_like(mask)
    refuses("no voxel to estimate the field from", clustered_bias, image.data, nowhere, **options)
    refuses("the body has no signal", clustered_bias, 0.0 * image.data, mask, **options)
    check_positive(image, mask)
    negative = Image(-image.data, image.affine)
    refuses("100% of the values in the body are negative", check_positive, negative, mask)
