"""Dice and Pearson's coefficient."""

import numpy as np
import pytest

from myork.segmentation.scores import dice, pearson


def test_dice_by_hand():
    a = np.array([1, 1, 1, 0, 0, 0])
    m = np.array([0, 1, 1, 1, 1, 0])
    assert dice(a, m) == pytest.approx(2 * 2 / (3 + 4))
    assert dice(a, a) == 1.0
    assert dice(a, 1 - a) == 0.0
    assert np.isnan(dice(a * 0, a * 0))


def test_pearson_against_numpy_and_its_limits():
    random = np.random.default_rng(0)
    f, g = random.random((2, 5, 7))
    assert pearson(f, g) == pytest.approx(np.corrcoef(f.ravel(), g.ravel())[0, 1], abs=1e-14)
    assert pearson(f, 3 * f + 2) == pytest.approx(1.0)
    assert np.isnan(pearson(f, f * 0 + 1))
