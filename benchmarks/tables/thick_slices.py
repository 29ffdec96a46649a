"""Slices of two muscles, cut into finer ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from scipy.interpolate import make_interp_spline

from myork.model.slices import finer_labels
from myork.records import Labels
from myork.segmentation.scores import dice
from myork.types import F64, I32

PARTS = 8
HEIGHTS = np.arange(0.5, 96.0)
MIDDLES = np.arange(4.0, 96.0, PARTS)
X, Y = np.meshgrid(np.arange(110) - 55.0, np.arange(90) - 45.0, indexing="ij")
SEEDS = {"tuned": range(0, 8, 2), "other": range(1, 8, 2)}
AROUND = np.arange(2, 11)  # waves around the outline
ALONG = np.arange(1, 7)  # half waves along the border between the muscles


def smooth(distance: F64) -> F64:
    """Correlation of waves that change smoothly along the stack."""
    return np.exp(-0.5 * distance**2)


def jagged(distance: F64) -> F64:
    """Correlation of waves with kinks along the stack (Matern, 3/2)."""
    return (1.0 + np.sqrt(3.0) * distance) * np.exp(-np.sqrt(3.0) * distance)


class Muscles:
    """Two muscles with wavy outlines."""

    def __init__(self, seed: int, height: float, length: float, kind: Callable[[F64], F64]) -> None:
        random = np.random.default_rng(seed)
        self.lean = random.uniform(0.1, 0.35) * random.choice([-1, 1])
        self.bend, self.bends = random.uniform(4, 10), random.uniform(24, 40)
        self.taper = random.uniform(0.2, 0.45)
        self.axes = random.uniform([26, 16], [30, 20])
        self.alike = kind(np.abs(HEIGHTS[:, np.newaxis] - HEIGHTS) / length)
        root = np.linalg.cholesky(self.alike + 1e-9 * np.eye(len(HEIGHTS)))
        number = 2 * len(AROUND)
        self.waves = height * np.sqrt(2 / number) * root @ random.normal(size=(96, number))
        number = 2 * len(ALONG)
        self.border = height * np.sqrt(2 / number) * root @ random.normal(size=(96, number))

    def labels(self, heights: F64, waves: F64, border: F64) -> I32:
        """Label map of slices at heights, with waves of these amplitudes."""
        result = np.zeros((*X.shape, len(heights)), np.int32)
        for k, height in enumerate(heights):
            x = X - self.lean * (height - 48.0)
            y = Y - self.bend * np.sin(height / self.bends)
            size = 1.0 - self.taper * ((height - 48.0) / 48.0) ** 2
            radius = np.hypot(x, y)
            scaled = np.hypot(x / self.axes[0], y / self.axes[1])
            rim = size * radius / np.maximum(scaled, 1e-9)
            turn = np.arctan2(y / self.axes[1], x / self.axes[0])[..., np.newaxis] * AROUND
            inside = radius < rim + np.concatenate([np.cos(turn), np.sin(turn)], -1) @ waves[k]
            part = np.pi * y[..., np.newaxis] / self.axes[1] * ALONG
            edge = x + 0.4 * y + np.concatenate([np.cos(part), np.sin(part)], -1) @ border[k]
            result[..., k] = np.where(inside, np.where(edge < 0, 1, 2), 0)
        return result

    def truth(self) -> I32:
        """In slices of 1 mm."""
        return self.labels(HEIGHTS, self.waves, self.border)

    def thick(self) -> I32:
        """In slices of 8 mm."""
        parts = (make_interp_spline(HEIGHTS, one)(MIDDLES) for one in (self.waves, self.border))
        return self.labels(MIDDLES, *parts)

    def predicted(self) -> I32:
        """Mean of all outlines through those of the thick slices."""
        seen = make_interp_spline(HEIGHTS, np.eye(len(HEIGHTS)))(MIDDLES)
        weights = self.alike @ seen.T @ np.linalg.pinv(seen @ self.alike @ seen.T, rcond=1e-8)
        return self.labels(HEIGHTS, *(weights @ seen @ one for one in (self.waves, self.border)))


def scores(found: I32, truth: I32) -> list[tuple[float, float]]:
    """Dice coefficient and relative error of the volume of both muscles."""
    pairs = [(found == number, truth == number) for number in (1, 2)]
    return [(dice(a, b), a.sum() / b.sum() - 1) for a, b in pairs]


def thick_slices(half: str) -> Iterator[tuple[str, ...]]:
    """Two muscles known in slices of 1 mm, given in slices of 8 mm and cut back into such of 1 mm.

    Muscles touch, lean, bend and taper; their outlines and the border between them are wavy by
    2 mm (root mean square), alike over so many millimetres along the stack. Dice coefficient and
    error of the volume [%]; slices repeated; and how well outlines can be known at all: the means
    of all outlines that pass through those of the slices, of muscles whose lean, bend, taper and
    kind of waves are known.
    """
    affine = np.diag([1.0, 1.0, float(PARTS), 1.0])
    yield "waves", "Dice, mean (least)", "volume, at most", "slices repeated", "predicted"
    for title, height, length, kind in (
        ("none", 0.0, 20.0, smooth),
        ("alike over 20 mm", 2.0, 20.0, smooth),
        ("alike over 10 mm", 2.0, 10.0, smooth),
        ("the same with kinks from slice to slice", 2.0, 10.0, jagged),
        ("alike over 5 mm", 2.0, 5.0, smooth),
    ):
        ours, repeated, predicted = [], [], []
        for seed in SEEDS[half]:
            muscles = Muscles(seed, height, length, kind)
            truth, thick = muscles.truth(), muscles.thick()
            ours += scores(finer_labels(Labels(thick, affine), 2, PARTS).data, truth)
            repeated += scores(np.repeat(thick, PARTS, axis=2), truth)
            predicted += scores(muscles.predicted(), truth)
        found, volume = np.array(ours).T
        others = (f"{np.mean(each, axis=0)[0]:.3f}" for each in (repeated, predicted))
        least = f"{found.mean():.3f} ({found.min():.3f})"
        yield title, least, f"{100 * np.abs(volume).max():.1f} %", *others
