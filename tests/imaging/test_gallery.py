"""Level sets on pictures like those of the thesis' chapters 3 and 4 whose answer is known."""

from itertools import product

import numpy as np
import pytest

from myork.core.deck import table_defaults
from myork.imaging.phantom import make_phantom
from myork.records import Image
from myork.segmentation.channels import scaled_values
from myork.segmentation.level_sets import LevelSets, segment_regions
from myork.segmentation.scores import dice
from myork.segmentation.starts import level_sets_of, threshold_regions

pytestmark = pytest.mark.nightly

LINE = (np.arange(96) + 0.5) / 48 - 1.0
X, Y = np.meshgrid(LINE, LINE, indexing="ij")
R = np.hypot(X, Y)
SECTORS = np.where(R < 0.75, 1 + (X > 0) + 2 * (Y > 0.2 * X), 0)
BOXES = np.where(np.hypot(X + 0.2, Y) < 0.5, 1, 0)
BOXES = np.where((abs(X - 0.4) < 0.35) & (abs(Y) < 0.6), 2, BOXES)
COLOURS = np.array([[0.2, 0.25, 0.65], [0.75, 0.25, 0.2], [0.2, 0.65, 0.2]])
DOTS = np.min([np.hypot(X - a, Y - b) for a, b in product(np.linspace(-0.4, 0.4, 4), repeat=2)], 0)
BLOB = 0.55 + 0.15 * np.cos(3 * np.arctan2(Y, X)) > R


def noisy(values, sigma):
    return values + np.random.default_rng(1).normal(0.0, sigma, values.shape)


def segmented(values, labels=None, **choice):
    """Regions of a picture of shape `(n, n)` or `(n, n, nchannel)`, maybe from labels."""
    channels = values[:, :, None, None] if values.ndim == 2 else values[:, :, None]
    first = None if labels is None else labels.astype(np.int32)[..., None]
    return segment_regions(
        channels, np.ones(channels.shape[:3], bool),
        LevelSets.of_table(table_defaults("image"), **choice), spacing=(1, 1, 1), labels=first,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("truth", "picture", "sigma", "choice"),
    [
        (BLOB, 0.25 + 0.5 * BLOB, 0.15, {"start": "circles", "mu": 0.1}),
        ((R < 0.8) & (DOTS >= 0.045), None, 0.08, {"start": "labels", "mu": 0.01}),
        (R < 0.8, None, 0.08, {"start": "labels", "mu": 1.0}),
        (SECTORS, SECTORS / 4.0, 0.06, {"regions": 5, "mu": 0.02}),
        (BOXES, COLOURS[BOXES], 0.1, {"regions": 3, "mu": 0.02}),
    ],
    ids=["blob", "small length weight", "large length weight", "five regions", "colours"],
)
def test_regions(truth, picture, sigma, choice):
    """Rims are a pixel of noise. A larger weight of the length leaves the dots out."""
    if picture is None:
        picture = 0.2 + 0.6 * ((R < 0.8) & (DOTS >= 0.045))
    start = R < 0.9 if choice.get("start") == "labels" else None
    label = segmented(noisy(picture, sigma), start, **choice).region[..., 0]
    scores = [
        dice(label == np.bincount(label[truth == number]).argmax(), truth == number)
        for number in np.unique(truth)
    ]
    assert np.mean(scores) > 0.96


def test_weight_of_the_area():
    image = noisy(np.clip(1.2 - R, 0.0, 1.0), 0.05)
    areas = [(segmented(image, mu=0.02, nu=nu).region == 1).sum() for nu in (-0.1, 0.0, 0.1)]
    assert areas == sorted(areas, reverse=True) and areas[0] > areas[2]


def energy(values, inside, mu, one_sided):
    """Energy (3.11) of labels: length by central or one-sided differences, and the misfit."""
    mask = inside.astype(float)
    squared = sum(np.square(np.gradient(mask)))
    if one_sided:
        rises = [
            np.concatenate([step, step[-1:]]) ** 2 + np.concatenate([step[:1], step]) ** 2
            for step in (np.diff(mask, axis=0), np.diff(mask.T, axis=0))
        ]
        squared = 0.5 * (rises[0] + rises[1].T)
    parts = [values[part] for part in (inside, ~inside)]
    return mu * np.sqrt(squared).sum() + sum(((part - part.mean()) ** 2).sum() for part in parts)


def test_less_energy_than_scikit_image():
    """Two regions of a noisy slice from Otsu's threshold, whatever scikit-image's iterations."""
    from skimage.segmentation import chan_vese

    phantom = make_phantom((128, 128, 3), (120 / 128, 120 / 128, 6.0), bias=0.0)
    image = Image(phantom.anatomy.data[:, :, [1]], phantom.anatomy.affine)
    clean = np.clip(scaled_values(image, np.ones(image.data.shape, bool)), 0.0, 1.0)[..., 0]
    truth = (phantom.truth.data[:, :, 1] == 0) & (clean > 0.6)
    values, mu = noisy(clean, 0.1), 0.05
    found = segmented(values, mu=mu, start="otsu", epsilon=0.1, iterations=300)
    inside = found.region[..., 0] == 1
    if (inside & truth).sum() < (~inside & truth).sum():
        inside = ~inside
    assert found.iterations[0] < 300 and dice(inside, truth) > 0.96
    regions = threshold_regions(values[..., None], np.ones((*values.shape, 1), bool))
    start = level_sets_of(regions, 2, volume=False)[..., 0, 0]
    for limit in (10, 50, 100, 200, 500):
        rival = chan_vese(values, mu=mu, tol=0.0, max_num_iter=limit, init_level_set=start)
        for one_sided in (False, True):
            own = energy(values, inside, mu, one_sided)
            assert own < energy(values, rival, mu, one_sided), limit
