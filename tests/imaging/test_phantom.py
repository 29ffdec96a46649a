"""The phantom: repeatable, and as its formulas say."""

import numpy as np
import pytest

from myork.errors import InputError
from myork.imaging.phantom import make_phantom, mg_area


@pytest.fixture(scope="module")
def phantom():
    return make_phantom()


def test_same_seed_same_images_other_seed_other_noise(phantom):
    again, other = make_phantom(), make_phantom(seed=2)
    assert np.array_equal(phantom.anatomy.data, again.anatomy.data)
    assert np.array_equal(phantom.tensor.data, again.tensor.data)
    assert not np.array_equal(phantom.anatomy.data, other.anatomy.data)
    assert np.array_equal(phantom.truth.data, other.truth.data)


def test_section_of_the_medial_gastrocnemius_follows_the_closed_form(phantom):
    pixel = np.prod(phantom.truth.spacing[:2])
    area = (phantom.truth.data == 1).sum(axis=(0, 1)) * pixel
    exact = np.array([mg_area(k / (len(area) - 1)) for k in range(len(area))])
    # Counting pixels of 1.25 mm: the error is a part of the rim, some pixels of about a hundred.
    assert np.abs(area - exact).max() < 12 * pixel
    assert abs(area.sum() / exact.sum() - 1) < 0.01
    assert exact.max() > 2 * exact.min()


def test_six_muscles_in_every_slice_and_apart(phantom):
    for k in range(phantom.truth.data.shape[2]):
        assert set(np.unique(phantom.truth.data[:, :, k])) == set(range(7))


def test_muscle_noise_has_the_asked_ratio(phantom):
    truth = phantom.truth.data == 1
    clean = make_phantom(snr=1e9).anatomy.data
    noise = (phantom.anatomy.data - clean)[truth]
    # Muscle is 393 units bright here; 5705 samples give the deviation to 1 %, Rician ones less.
    assert np.std(noise) == pytest.approx(400 / 25, rel=0.05)


def test_shading_is_the_asked_amplitude(phantom):
    body = phantom.bias.data
    assert np.abs(body - 1).max() == pytest.approx(0.3)
    plain = make_phantom(bias=0.0, snr=1e9).anatomy.data
    shaded = make_phantom(snr=1e9).anatomy.data
    lit = plain > 1.0
    np.testing.assert_allclose(shaded[lit] / plain[lit], body[lit], rtol=1e-6)


def test_fibers_are_unit_vectors_in_muscles_only(phantom):
    length = np.linalg.norm(phantom.fiber.data, axis=-1)
    muscle = phantom.truth.data > 0
    np.testing.assert_allclose(length[muscle], 1.0, atol=1e-12)
    assert not length[~muscle].any()


def test_field_of_view_too_small():
    with pytest.raises(InputError, match="needs 112 x 112 mm"):
        make_phantom(size=(40, 40, 5))
