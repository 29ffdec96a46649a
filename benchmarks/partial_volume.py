"""Parts of labels in each voxel against a truth in finer voxels.

    python benchmarks/partial_volume.py tuned|other

Legs of the phantom in voxels of 0.35 mm, averaged to 1.4 mm. First with one value for each tissue,
shading and noise in three channels, the labels being what fills most of each voxel; then the
phantom's own images (septa are darker than fat, skin) through `[tissue]`. Settings were chosen on
`tuned`. Printed are, for labels and for parts, the volumes of muscle, fat and connective tissue
against the truth [%] and the root mean square error of these three. No test: it takes a minute.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from myork.imaging.io import read_image, read_labels, write_image
from myork.imaging.phantom import make_phantom
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


def coarse(values: F64) -> F64:
    """Means of 4 x 4 voxels in the slices."""
    n = values.shape[0] // 4, values.shape[1] // 4
    return np.asarray(values.reshape(n[0], 4, n[1], 4, *values.shape[2:]).mean(axis=(1, 3)))


def noisy(clean: F64, snr: float) -> F64:
    """Magnitudes with noise; `snr` is that of muscle in the anatomy."""
    noise = np.random.default_rng(5).normal(0.0, 400.0 / snr, (2, *clean.shape))
    return np.asarray(np.hypot(clean + noise[0], noise[1]))


def told(found: F64, truth: F64) -> str:
    """Volumes against the truth and the error."""
    right = truth.sum(axis=(0, 1, 2))[:3]
    off = 100.0 * (found.sum(axis=(0, 1, 2))[:3] - right) / np.where(right > 0, right, np.nan)
    error = np.sqrt(np.mean((found - truth)[..., :3] ** 2))
    return "  ".join(f"{one:6.1f}" for one in off) + f"  {error:.4f}"


def all_of(parts: F64, labels: I32) -> F64:
    """Parts of all tissues, those without a voxel among them."""
    whole = np.zeros((*labels.shape, TISSUES))
    whole[..., np.unique(labels[labels > 0]) - 1] = parts
    return whole


def whole_voxels(labels: I32) -> F64:
    """Labels as parts."""
    return (labels[..., np.newaxis] == np.arange(1, TISSUES + 1)).astype(float)


def by_truth(fine: I32, truth: F64, snr: float) -> None:
    """Labels are right, tissues have one value each."""
    x = np.linspace(-1.0, 1.0, truth.shape[0])
    shade = (1.0 + 0.15 * x)[:, None, None, None] * (1.0 - 0.1 * x)[None, :, None, None]
    images = noisy(coarse(SIGNALS[fine]) * shade, snr)
    labels = np.where(truth.sum(axis=-1) >= 0.5, truth.argmax(axis=-1) + 1, 0).astype(np.int32)
    parts = all_of(label_parts(labels, images, SIZE, unmixed=(0, 4)), labels)
    print(f"  SNR {snr:g}, labels {told(whole_voxels(labels), truth)}, parts {told(parts, truth)}")


def by_tissue(images: dict[str, F64], truth: F64, snr: float) -> None:
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
    print(f"  [tissue], SNR {snr:g}, labels {told(whole_voxels(labels), truth)}, "
          f"parts {told(all_of(parts, labels), truth)}")  # fmt: skip


def main(half: str) -> None:
    """All legs of a half."""
    for keys in HALVES[half]:
        leg = make_phantom((352, 352, 5), (0.35, 0.35, 7.0), snr=1e6, bias=0.0, **keys)
        fine = leg.tissue.data
        truth = coarse(np.stack([fine == n for n in range(1, TISSUES + 1)], -1).astype(float))
        print(keys, flush=True)
        for snr in (30.0, 15.0):
            by_truth(fine, truth, snr)
        images = {"anatomy": leg.anatomy, "fat": leg.fat, "connective": leg.connective}
        by_tissue({kind: one.data for kind, one in images.items()}, truth, 25.0)


if __name__ == "__main__":
    if sys.argv[1:] not in (["tuned"], ["other"]):
        sys.exit(__doc__)
    main(sys.argv[1])
