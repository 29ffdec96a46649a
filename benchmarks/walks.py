"""Twelve muscles from seeds: our random walks and scikit-image's on the same seeds and images.

    python benchmarks/walks.py tuned|other [T1 LABELS]

Two calves of the phantom side by side with six muscles each, septa from 0.6 to 2.6 mm, streaks of
fat and sheets in muscles, several amounts of noise, shading taken out by `auto` for both; with a T1
slice of two calves and its twelve manual labels on that as well, where deep muscles are background.
Seeds: three clicks a muscle (and 24 of the background) in every other slice, the middle of each
muscle, and all but 2.5 mm along borders. Settings (`image.edge_weight` here, `beta` there) were
chosen by the mean on `tuned`. Printed are mean and least Dice of the twelve. No test: it takes
minutes.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage
from skimage.segmentation import random_walker

from myork.imaging.io import read_image, read_labels
from myork.imaging.phantom import make_phantom
from myork.records import Image
from myork.segmentation.regions import body_mask
from myork.segmentation.scores import dice
from myork.segmentation.shading import shading
from myork.segmentation.walk import heights_of, random_walk
from myork.types import F64, I32, Mask

HALVES: dict[str, list[dict[str, Any]]] = {
    "tuned": [
        {"snr": 25.0},
        {"snr": 25.0, "septum": 0.6, "growth": 15.0, "imat": 0.03, "imct": 0.05, "seed": 3},
        {"snr": 10.0, "septum": 1.3, "growth": 4.0, "seed": 2},
    ],
    "other": [
        {"snr": 40.0, "septum": 1.0, "growth": 15.0, "scale": 0.9, "seed": 21},
        {"snr": 20.0, "septum": 0.8, "growth": 8.0, "imat": 0.06, "imct": 0.03, "seed": 22},
        {"snr": 12.0, "septum": 2.0, "growth": 2.0, "scale": 0.85, "seed": 23},
        {"snr": 7.0, "septum": 1.6, "growth": 6.0, "seed": 24},
    ],
}
BETAS = (3.0, 10.0, 30.0, 130.0)
WEIGHT = 40.0  # default of image.edge_weight


def images(half: str, real: list[str]) -> Iterator[tuple[str, F64, I32, F64]]:
    """Name, image, labels 1 to 12 and size of voxels."""
    for keys in HALVES[half]:
        first = keys.get("seed", 1)
        legs = [make_phantom((96, 96, 4), **(keys | {"seed": first + leg})) for leg in (0, 50)]
        truth = legs[0].truth.data
        both = np.concatenate([truth, np.where(truth > 0, truth + 6, 0)[::-1]])
        name = f"SNR {keys['snr']:g}, septum {keys.get('septum', 2.6):g} mm"
        image = np.concatenate([legs[0].anatomy.data, legs[1].anatomy.data[::-1]])
        yield name, image, both, legs[0].anatomy.spacing
    if real:
        calves = read_image(Path(real[0]))
        yield "calves", calves.data, read_labels(Path(real[1])).data, calves.spacing


def seeds(kind: str, full: I32, spacing: F64, random: np.random.Generator) -> I32:
    """Seeds of every label in a map whose largest label is the background."""
    result = np.zeros(full.shape, np.int32)
    for k in range(0, full.shape[2], 2 if kind == "clicks" else 1):
        for number in np.unique(full[..., k][full[..., k] > 0]):
            mine = np.pad(full[..., k] == number, 1)
            depth = ndimage.distance_transform_edt(mine, sampling=spacing[:2])[1:-1, 1:-1]
            if kind == "clicks":
                inner = np.argwhere(depth > min(1.5 * spacing[0], 0.5 * depth.max()))
                count = min(24 if number == full.max() else 3, len(inner))
                chosen = np.zeros(depth.shape, bool)
                chosen[tuple(random.choice(inner, count, replace=False).T)] = True
                chosen = ndimage.binary_dilation(chosen) & (depth > 0)
            elif kind == "middle":
                chosen = depth > min(0.6 * depth.max(), 8.0)
            else:
                chosen = depth > min(2.5, 0.5 * depth.max())
            result[..., k][chosen] = number
    return result


def ours(image: F64, region: Mask, known: I32, spacing: F64, weight: float = WEIGHT) -> I32:
    """Labels by our walks."""
    heights = heights_of(image, region)
    free = np.where(region & (known > 0), known, -1).astype(np.int32)
    return random_walk(heights, region, free, spacing, weight)


def theirs(image: F64, region: Mask, known: I32, spacing: F64, beta: float) -> I32:
    """Labels by scikit-image's walks."""
    free = np.where(region, known, -1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return random_walker(image, free, beta, "cg_j", spacing=spacing / spacing.min())


def main(half: str, real: list[str]) -> None:
    """All images and seeds of a half."""
    random = np.random.default_rng(1 if half == "tuned" else 2)
    settings = [WEIGHT, *BETAS]
    total = np.zeros(len(settings))
    for name, raw, truth, spacing in images(half, real):
        body = body_mask(Image(raw, np.diag([*spacing, 1.0])))
        image = raw / shading(raw, body, spacing=spacing).field
        region = body | (truth > 0)
        full = np.where(region, np.where(truth > 0, truth, 13), 0).astype(np.int32)
        for kind in ("clicks", "middle", "borders free"):
            known = seeds(kind, full, spacing, random)
            line = f"{name:24s} {kind:12s}"
            for number, setting in enumerate(settings):
                walk = theirs if number else ours
                found = walk(image, region, known, spacing, setting)
                scores = [dice(found == label, full == label) for label in range(1, 13)]
                total[number] += np.mean(scores)
                line += f"  {'beta' if number else 'ours'} {setting:3g}: {np.mean(scores):.3f}"
                line += f" {min(scores):.3f}"
            print(line, flush=True)
    count = 3 * (len(HALVES[half]) + bool(real))
    print("means:", "  ".join(f"{one / count:.4f}" for one in total))


if __name__ == "__main__":
    if sys.argv[1:2] not in (["tuned"], ["other"]) or len(sys.argv) not in (2, 4):
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2:])
