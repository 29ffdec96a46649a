"""Twelve muscles by random walks from seeds."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage
from skimage.segmentation import random_walker

from myork.imaging.io import read_image, read_labels
from myork.imaging.phantom import make_phantom, rician
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
        {"pd": True, "snr": 25.0, "septum": 0.6, "growth": 15.0, "imat": 0.03, "seed": 3},
        {"pd": True, "snr": 10.0, "septum": 1.3, "growth": 4.0, "seed": 2},
    ],
    "other": [
        {"snr": 40.0, "septum": 1.0, "growth": 15.0, "scale": 0.9, "seed": 21},
        {"snr": 20.0, "septum": 0.8, "growth": 8.0, "imat": 0.06, "imct": 0.03, "seed": 22},
        {"snr": 12.0, "septum": 2.0, "growth": 2.0, "scale": 0.85, "seed": 23},
        {"snr": 7.0, "septum": 1.6, "growth": 6.0, "seed": 24},
        {"pd": True, "snr": 20.0, "septum": 0.8, "growth": 8.0, "imat": 0.04, "seed": 25},
        {"pd": True, "snr": 12.0, "septum": 1.8, "growth": 4.0, "scale": 0.9, "seed": 26},
    ],
}
BETAS = (3.0, 10.0, 30.0, 130.0)
WEIGHT = 50.0  # default of image.edge_weight
#: Signals of the phantom without noise, and those of a PD image
PD = (0.0, 60.0, 400.0, 1000.0), (0.0, 80.0, 620.0, 1000.0)
#: Edges of the phantom's voxels [mm]
SPACING = np.array([1.25, 1.25, 6.0])


class Calves(NamedTuple):
    """Image without shading, where walks may go, labels 1 to 12 and 13 around them."""

    image: F64
    region: Mask
    full: I32
    spacing: F64

    def score(self, found: I32) -> tuple[float, float]:
        """Mean and least Dice of the twelve muscles."""
        each = [dice(found == label, self.full == label) for label in range(1, 13)]
        return float(np.mean(each)), float(np.min(each))


def even(raw: F64, truth: I32, spacing: F64) -> Calves:
    """Calves whose shading is taken out by `auto`."""
    body = body_mask(Image(raw, np.diag([*spacing, 1.0])))
    region = body | (truth > 0)
    full = np.where(region, np.where(truth > 0, truth, 13), 0).astype(np.int32)
    return Calves(raw / shading(raw, body, spacing=spacing).field, region, full, spacing)


def two_legs(keys: dict[str, Any]) -> Calves:
    """Two legs of a kind side by side."""
    seed = keys.get("seed", 1)
    (raw, truth), (right, other) = straight(keys, seed), straight(keys, seed + 50)
    both = np.concatenate([truth, np.where(other > 0, other + 6, 0)[::-1]])
    return even(np.concatenate([raw, right[::-1]]), both, SPACING)


def images(half: str, real: tuple[str, ...]) -> Iterator[tuple[str, Calves]]:
    """Name and calves."""
    for keys in HALVES[half]:
        kind = "PD" if keys.get("pd") else "T1"
        name = f"{kind}, SNR {keys['snr']:g}, septa {keys.get('septum', 2.6):g} mm"
        yield name, two_legs(keys)
    if real:
        calves = read_image(Path(real[0]))
        yield "T1 slice", even(calves.data, read_labels(Path(real[1])).data, calves.spacing)


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


def straight(keys: dict[str, Any], seed: int) -> tuple[F64, I32]:
    """Image and labels of a leg."""
    own = {key: value for key, value in keys.items() if key != "pd"} | {"seed": seed}
    if not keys.get("pd"):
        leg = make_phantom((96, 96, 4), SPACING.tolist(), **own)
        return leg.anatomy.data, leg.truth.data
    leg = make_phantom((96, 96, 4), SPACING.tolist(), **(own | {"snr": 1e6}))
    clean = np.interp(leg.anatomy.data / leg.bias.data, *PD) * leg.bias.data
    noisy = rician(clean, PD[1][2] / keys["snr"], np.random.default_rng(seed))
    return noisy, leg.truth.data


def theirs(calves: Calves, known: I32, beta: float) -> I32:
    """Labels by scikit-image's walks."""
    free = np.where(calves.region, known, -1)
    edges = calves.spacing / calves.spacing.min()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return random_walker(calves.image, free, beta, "cg_j", spacing=edges)


def walks(half: str, *real: str) -> Iterator[tuple[str, ...]]:
    """Twelve muscles from seeds: our random walks and scikit-image's on the same seeds and images.

    Two calves of the phantom side by side with six muscles each, septa from 0.6 to 2.6 mm, streaks
    of fat and sheets in muscles, several amounts of noise, as T1 and as PD images, shading taken
    out by `auto` for both; after `half` a T1 slice of two calves and its twelve manual labels,
    where deep muscles are background. Seeds: three clicks a muscle (and 24 of the background) in
    every other slice, the middle of each muscle, and all but 2.5 mm along borders. Settings
    (`image.edge_weight` here, `beta` there) were chosen by the mean on `tuned`. Mean and least Dice
    of the twelve.
    """
    random = np.random.default_rng(1 if half == "tuned" else 2)
    yield "images", "seeds", f"ours {WEIGHT:g}", *(f"beta {beta:g}" for beta in BETAS)
    means: dict[str, list[list[float]]] = {}
    for name, calves in images(half, real):
        heights = heights_of(calves.image, calves.region)
        for kind in ("clicks", "middle", "borders free"):
            known = seeds(kind, calves.full, calves.spacing, random)
            free = np.where(calves.region & (known > 0), known, -1).astype(np.int32)
            found = [random_walk(heights, calves.region, free, calves.spacing, WEIGHT)]
            found += [theirs(calves, known, beta) for beta in BETAS]
            scores = [calves.score(labels) for labels in found]
            for group in ("all", name.split(",")[0]):
                means.setdefault(group, []).append([mean for mean, _ in scores])
            yield name, kind, *(f"{mean:.3f} ({least:.3f})" for mean, least in scores)
    for group, rows in means.items():
        yield "mean", group, *(f"{mean:.4f}" for mean in np.mean(rows, axis=0))


def _means(rows: list[list[str]]) -> list[list[str]]:
    """The means of the cases."""
    return [row for row in rows if row[0] in (rows[0][0], "mean")]


#: What the page of results shows
PIVOTS = {"walks": _means}
