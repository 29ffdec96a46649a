"""Twelve muscles of which every fourth or eighth slice is drawn: walks with and without shapes.

    python benchmarks/outlines.py tuned|other

Two calves of the phantom with six muscles each in 17 slices of 6 mm, bent in each slice by up to
4 to 6 mm, otherwise every 90 to 150 mm along the stack; shading is taken out by `auto`. Whole
slices are drawn, or three clicks a muscle and 24 of what is around them. The default of
`image.edge_weight` and the constants of `segmentation.outlines` were chosen on `tuned`. Printed are
mean and least Dice of the twelve in the slices that are not drawn: of the interpolated outlines
alone, of walks without them and of walks with them. No test: it takes minutes.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from scipy import ndimage
from walks import WEIGHT, seeds  # type: ignore[import-not-found]

from myork.imaging.phantom import make_phantom
from myork.records import Image
from myork.segmentation.outlines import pull_of_outlines
from myork.segmentation.regions import body_mask
from myork.segmentation.scores import dice
from myork.segmentation.shading import shading
from myork.segmentation.walk import heights_of, random_walk
from myork.types import F64, I32

SIZE = (96, 96, 17)
SPACING = np.array([1.25, 1.25, 6.0])
MUSCLE = 400.0  # signal of the phantom
#: SNR, largest shift and its period along the stack [mm], keys of the phantom
HALVES: dict[str, list[tuple[float, float, float, dict[str, Any]]]] = {
    "tuned": [
        (25.0, 4.0, 90.0, {}),
        (12.0, 5.0, 120.0, {"septum": 1.0, "growth": 12.0, "imat": 0.03, "imct": 0.03, "seed": 3}),
    ],
    "other": [
        (20.0, 5.0, 90.0, {"septum": 0.8, "growth": 8.0, "imat": 0.05, "imct": 0.03, "seed": 22}),
        (10.0, 4.0, 120.0, {"septum": 2.0, "growth": 2.0, "scale": 0.9, "seed": 23}),
        (15.0, 6.0, 150.0, {"septum": 1.3, "growth": 15.0, "scale": 0.95, "seed": 24}),
    ],
}


def bent(snr: float, most: float, period: float, keys: dict[str, Any]) -> tuple[F64, I32]:
    """Image and labels of a leg whose slices are bent."""
    leg = make_phantom(SIZE, SPACING.tolist(), 1e5, **keys)
    random = np.random.default_rng(keys["seed"])
    place = np.indices(SIZE) * SPACING[:, np.newaxis, np.newaxis, np.newaxis]
    moved = np.indices(SIZE).astype(float)
    for axis in range(2):
        shift = np.zeros(SIZE)
        for _ in range(6):
            turn, way = random.uniform(0, 2 * np.pi), 2 * np.pi / random.uniform(50, 100)
            up = random.choice([-1, 1]) * random.uniform(0.6, 1.4) * 2 * np.pi / period
            waves = np.array([np.cos(turn) * way, np.sin(turn) * way, up])
            shift += random.normal() * np.sin(np.tensordot(waves, place, 1) + random.uniform(0, 7))
        moved[axis] += shift * most / (np.abs(shift).max() * SPACING[axis])
    signal = ndimage.map_coordinates(leg.anatomy.data, moved, order=1, mode="nearest")
    label = ndimage.map_coordinates(leg.truth.data, moved, order=0, mode="nearest")
    real, other = random.normal(0.0, MUSCLE / snr, (2, *SIZE))
    return np.hypot(signal + real, other), label.astype(np.int32)


def main(half: str) -> None:
    """All phantoms of a half."""
    total = np.zeros((2, 3))
    for snr, most, period, keys in HALVES[half]:
        first = keys.get("seed", 1)
        legs = [bent(snr, most, period, keys | {"seed": first + leg}) for leg in (0, 50)]
        raw = np.concatenate([legs[0][0], legs[1][0][::-1]])
        other = legs[1][1][::-1]
        truth = np.concatenate([legs[0][1], np.where(other > 0, other + 6, 0)])
        body = body_mask(Image(raw, np.diag([*SPACING, 1.0])))
        region = body | (truth > 0)
        image = raw / shading(raw, body, spacing=SPACING).field
        heights = heights_of(image, region)
        full = np.where(region, np.where(truth > 0, truth, 13), 0).astype(np.int32)
        for number, kind in enumerate(("outlines", "clicks")):
            random = np.random.default_rng(first)
            marks = full if kind == "outlines" else seeds(kind, full, SPACING, random)
            for step in (4, 8):
                known = np.full(full.shape, -1, np.int32)
                known[..., ::step] = np.where(marks > 0, marks, -1)[..., ::step]
                pull = pull_of_outlines(known, SPACING)
                between = np.arange(SIZE[2]) % step > 0
                alone = np.zeros_like(full)
                if pull is not None:
                    alone = np.where(pull.any(axis=0), pull.argmax(axis=0) + 1, 0)
                found = [alone] + [
                    random_walk(heights, region, known, SPACING, WEIGHT, rates)
                    for rates in (None, pull)
                ]
                line = f"SNR {snr:g}, shifts {most:g} mm, {kind:8s} every {step}th slice:"
                for column, labels in enumerate(found):
                    got, true = labels[..., between], full[..., between]
                    scores = [dice(got == label, true == label) for label in range(1, 13)]
                    total[number, column] += np.mean(scores) / (2 * len(HALVES[half]))
                    line += f"  {np.mean(scores):.3f} {min(scores):.3f}"
                print(line, flush=True)
    print("means:", total.round(4).tolist())


if __name__ == "__main__":
    if sys.argv[1:] not in (["tuned"], ["other"]):
        sys.exit(__doc__)
    main(sys.argv[1])
