"""Bias fields of known shape on images of known truth."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from myork.imaging.io import read_image, read_labels
from myork.imaging.phantom import make_phantom
from myork.records import Image
from myork.segmentation.bias import clustered_bias
from myork.segmentation.regions import body_mask
from myork.segmentation.shading import shading
from myork.types import F64, I32, Mask

PHANTOMS: dict[str, list[dict[str, Any]]] = {
    "tuned": [
        {},
        {"septum": 0.0, "growth": 15.0},
        {"imat": 0.05, "imct": 0.1, "septum": 0.6, "growth": 15.0},
    ],
    "other": [
        {"scale": 0.9},
        {"septum": 0.0, "growth": 15.0, "imat": 0.03, "seed": 4},
        {"imct": 0.1, "imat": 0.02, "growth": 4.0},
    ],
}
STRONG = {1: (0.4, 2.0), 3: (0.27, 2.4)}  # ranges of the factor, in a slice and in a stack
WEAK = (0.75, 1.3)
SNR = 25.0


def field(
    family: str, ends: tuple[float, float], mask: Mask, spacing: F64, random: np.random.Generator
) -> F64:
    """Factor with given least and largest value in the body."""
    place = np.moveaxis(np.indices(mask.shape), 0, -1) * spacing
    low, high = place[mask].min(axis=0), place[mask].max(axis=0)
    half = np.maximum(0.5 * (high - low), 1e-9)
    x, width, flat = place - 0.5 * (low + high), half[:2].mean(), mask.shape[2] == 1
    raw = np.zeros(mask.shape)
    for _ in range(3 if family == "sine" else random.integers(1, 4) if family == "coil" else 0):
        if family == "sine":
            way = random.normal(size=3) * (1.0, 1.0, 0.0 if flat else 0.7)
            turns = x @ way / np.linalg.norm(way) / (width * random.uniform(1.6, 3.0))
            raw += random.uniform(0.5, 1) * np.sin(1.2 * np.pi * turns + random.uniform(0, 6.28))
        else:
            angle, height = random.uniform(0, 2 * np.pi), random.uniform(-0.6, 0.6)
            coil = 1.15 * half * (np.cos(angle), np.sin(angle), 0.0 if flat else height / 1.15)
            reach = random.uniform(0.8, 1.3) * width
            away = ((x - coil) ** 2).sum(axis=-1) / reach**2
            raw += random.uniform(0.5, 1) * (1.0 + away) ** -1.5
    if family == "polynomial":
        u = x / half
        for i, j, k in np.ndindex(4, 4, 1 if flat else 4):
            if 0 < i + j + k < 4:
                term = u[..., 0] ** i * u[..., 1] ** j * u[..., 2] ** k
                raw += random.normal() / (i + j + k) * term
        raw = np.exp(raw / np.ptp(raw[mask]) * np.log(ends[1] / ends[0]))
    least, most = raw[mask].min(), raw[mask].max()
    return ends[0] + (ends[1] - ends[0]) * (raw - least) / (most - least)


def even_calves(image: Image, muscles: I32) -> Image:
    """Both legs without what shading a quadratic field tells of their labelled muscle."""
    legs, n = ndimage.label(body_mask(image))
    x = np.indices(image.data.shape)[:2] / 100.0
    terms = np.stack([x[0] ** i * x[1] ** j for i in range(3) for j in range(3 - i)], -1)
    logarithm = np.log(np.maximum(image.data, 5.0))
    result = image.data.copy()
    for leg in range(1, n + 1):
        here = (legs == leg) & (muscles > 0)
        weight = np.ones(here.sum())
        for _ in range(20):
            fit = np.linalg.lstsq(
                terms[here] * weight[:, None], logarithm[here] * weight, rcond=None
            )[0]
            weight = (1.0 + ((logarithm[here] - terms[here] @ fit) / 0.08) ** 2) ** -0.5
        box = ndimage.binary_dilation(legs == leg, iterations=8)
        known = terms[here] @ fit
        slow = np.clip(terms[box] @ fit, known.min(), known.max())
        result[box] *= 200.0 / np.exp(slow)
    return Image(result, image.affine)


def images(half: str, real: tuple[str, ...]) -> Iterator[tuple[str, Image, float]]:
    """Images without shading, and the noise they get."""
    for kind, size, spacing in (
        ("slice", (224, 224, 3), (0.55, 0.55, 40.0)),
        ("stack", (96, 96, 15), (1.25, 1.25, 6.0)),
    ):
        for number, keys in enumerate(PHANTOMS[half]):
            whole = make_phantom(size, spacing, snr=1e6, bias=0.0, **keys).anatomy
            data = whole.data[:, :, 1:2] if kind == "slice" else whole.data
            yield f"{kind} {number}", Image(data, whole.affine), 400.0 / SNR
    if real:
        calves = read_image(Path(real[0]))
        yield "calves", even_calves(calves, read_labels(Path(real[1])).data), 0.0


def shading_fields(half: str, *real: str) -> Iterator[tuple[str, ...]]:
    """Bias fields of known shape on images of known truth: what is found of them.

    Fields of three families (coils beside the body, polynomials, sines), strong and weak, on
    phantom slices and stacks; behind `half` a T1 slice of two calves and its manual muscle labels,
    its own shading taken out first by a quadratic field fitted to the labelled muscle of each leg.
    Settings were chosen on the phantoms `tuned`. Correlation of the field in the body, seconds, and
    whether it is doubted, by `auto` and by level sets; of `auto` the correlation at the skin (what
    lies beyond the mask that the field is estimated in, and its rim) and in the two first and last
    slices of a stack.
    """
    random = np.random.default_rng(1 if half == "tuned" else 2)
    yield "images", "field", "factor", "`auto`", "`level-sets`", "skin", "last slices"
    for name, image, noise in images(half, real):
        mask = body_mask(image)
        one = image.data.shape[2] == 1
        inner = ndimage.binary_erosion(mask, np.ones((3, 3, 1)))
        last = mask.copy()
        last[:, :, 2:-2] = False
        parts = [body_mask(image, rim=0.0) & ~inner, last & (not one)]
        for family in ("coil", "polynomial", "sine"):
            for ends in (STRONG[1 if one else 3], WEAK):
                truth = field(family, ends, mask, image.spacing, random)
                error = random.normal(0.0, noise, (2, *mask.shape))
                values = np.hypot(image.data * truth + error[0], error[1])
                body = body_mask(Image(values, image.affine))
                fields = []
                row = [name, family, f"{ends[0]:g} to {ends[1]:g}"]
                for way in (shading, partial(clustered_bias, regions=3)):
                    start = time.process_time()
                    found: Any = way(values, body, spacing=image.spacing)
                    took = time.process_time() - start
                    fields.append(found.field)
                    alike = np.corrcoef(found.field[mask], truth[mask])[0, 1]
                    doubt = ", doubt" if getattr(found, "doubt", "") else ""
                    row.append(f"{alike:.4f}, {took:.1f} s{doubt}")
                for where in parts:
                    pair = fields[0][where], truth[where]
                    row.append(f"{np.corrcoef(*pair)[0, 1]:.4f}" if where.any() else "-")
                yield tuple(row)
