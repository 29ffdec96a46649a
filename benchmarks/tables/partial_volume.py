"""Parts of labels in voxels that several of them fill."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tables.phantoms import coarse, fine_phantom
from myork.imaging.io import read_image, read_labels, write_image
from myork.records import Image
from myork.segmentation.partial import label_parts
from myork.stations.segment import segment
from myork.types import F64, I32

HALVES: dict[str, list[dict[str, Any]]] = {
    "tuned": [
        {"imat": 0.03, "imct": 0.1, "seed": 1},
        {"imat": 0.03, "imct": 0.17, "septum": 1.0, "seed": 2},
        {"imat": 0.08, "septum": 1.5, "growth": 15.0, "scale": 0.9, "seed": 3},
    ],
    "other": [
        {"imat": 0.05, "imct": 0.08, "scale": 0.93, "seed": 11},
        {"imat": 0.1, "imct": 0.05, "septum": 0.8, "growth": 15.0, "seed": 12},
        {"imct": 0.15, "septum": 1.8, "scale": 0.85, "seed": 13},
    ],
}
# Anatomy, fat image and image of connective tissue: air, muscle, fat, connective tissue, bone
SIGNALS = np.array(
    [[0, 0, 0], [400, 40, 250], [1000, 1000, 120], [150, 60, 1000], [60, 20, 700]], float
)
SIZE = (1.4, 1.4, 7.0)
TISSUES = 4


def noisy(clean: F64, snr: float) -> F64:
    """Magnitudes with noise; `snr` is that of muscle in the anatomy."""
    noise = np.random.default_rng(5).normal(0.0, 400.0 / snr, (2, *clean.shape))
    return np.asarray(np.hypot(clean + noise[0], noise[1]))


def row_of(found: F64, truth: F64) -> list[str]:
    """Volumes against the truth and the error."""
    right = truth.sum(axis=(0, 1, 2))[:3]
    off = 100.0 * (found.sum(axis=(0, 1, 2))[:3] - right) / np.where(right > 0, right, np.nan)
    error = np.sqrt(np.mean((found - truth)[..., :3] ** 2))
    return [*(f"{one:.1f}" for one in off), f"{error:.4f}"]


def both(labels: I32, parts: F64, truth: F64) -> list[str]:
    """Rows of labels, which are a part of each whole voxel, and of parts."""
    whole = (labels[..., np.newaxis] == np.arange(1, TISSUES + 1)).astype(float)
    pairs = zip(row_of(whole, truth), row_of(all_of(parts, labels), truth), strict=True)
    return [f"{one}, {other}" for one, other in pairs]


def all_of(parts: F64, labels: I32) -> F64:
    """Parts of all tissues, those without a voxel among them."""
    whole = np.zeros((*labels.shape, TISSUES))
    whole[..., np.unique(labels[labels > 0]) - 1] = parts
    return whole


def by_truth(fine: I32, truth: F64, snr: float) -> list[str]:
    """Labels are right, tissues have one value each."""
    x = np.linspace(-1.0, 1.0, truth.shape[0])
    shade = (1.0 + 0.15 * x)[:, None, None, None] * (1.0 - 0.1 * x)[None, :, None, None]
    images = noisy(coarse(SIGNALS[fine]) * shade, snr)
    labels = np.where(truth.sum(axis=-1) >= 0.5, truth.argmax(axis=-1) + 1, 0).astype(np.int32)
    return both(labels, label_parts(labels, images, SIZE, unmixed=(0, 4)), truth)


def by_tissue(images: dict[str, F64], truth: F64, snr: float) -> list[str]:
    """Everything as `myork segment` finds it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind, data in images.items():
            image = Image(noisy(coarse(data), snr), np.diag([*SIZE, 1.0]))
            write_image(folder / f"{kind}.nii.gz", image)
        tables = {
            "scene": {"dimension": 3},
            "image": {"anatomy": str(folder / "anatomy.nii.gz"), "partial": True},
            "bias": {"method": "none"},
            "tissue": {"find": True}
            | {kind: str(folder / f"{kind}.nii.gz") for kind in ("fat", "connective")},
        }
        segment(tables, folder / "out")
        labels = read_labels(folder / "out" / "tissue.nii.gz").data
        parts = read_image(folder / "out" / "tissue_fractions.nii.gz", values=None).data
    return both(labels, parts, truth)


def partial_volume(half: str) -> Iterator[tuple[str, ...]]:
    """Parts of labels in each voxel against a truth in finer voxels.

    Legs of the phantom in voxels of 0.35 mm, averaged to 1.4 mm. First with one value for each
    tissue, shading and noise in three channels, the labels being what fills most of each voxel;
    then the phantom's own images (septa are darker than fat, skin) through `[tissue]`. For labels
    and for parts: volumes against the truth [%] and the root mean square error of all three.
    """
    yield "leg", "SNR", "muscle: labels, parts", "fat", "connective tissue", "error: labels, parts"
    for keys in HALVES[half]:
        leg = fine_phantom(**keys)
        fine, name = leg.tissue.data, " ".join(f"{key} {value:g}" for key, value in keys.items())
        truth = coarse(np.stack([fine == n for n in range(1, TISSUES + 1)], -1).astype(float))
        for snr in (30.0, 15.0):
            yield name, f"{snr:g}", *by_truth(fine, truth, snr)
        images = {"anatomy": leg.anatomy, "fat": leg.fat, "connective": leg.connective}
        data = {kind: one.data for kind, one in images.items()}
        yield name, "25, `[tissue]`", *by_tissue(data, truth, 25.0)
