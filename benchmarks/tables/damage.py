"""Damaged slices planted into series of limbs and trunks, and whole series."""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from benchmarks.tables.tissues import PARTS, section
from myork.imaging.damage import damaged_slices
from myork.imaging.io import read_image
from myork.imaging.phantom import make_phantom, rician
from myork.records import Image
from myork.types import F64

#: First of the numbers of the series of a half, and how many are whole and how many damaged
HALVES = {"tuned": (0, 50), "other": (8000, 50)}
FAULTS = ("empty", "repeated", "displaced", "ghost", "jump")
#: First words of what is said of each
WORDS = ("no signal", "the values of", "a shift", "a copy", "a signal")


def series(random: np.random.Generator, number: int, thighs: Image | None) -> Image:
    """A whole series: a section that changes along the stack, a phantom, or a real one."""
    kind = number % 5
    if kind == 0 and thighs is not None:
        return part_of(thighs, random)
    if kind == 1:
        size = [int(random.integers(96, 160)) for _ in range(2)]
        keys: dict[str, Any] = {"growth": random.uniform(0, 15), "septum": random.uniform(0, 2)}
        count, pixel = int(random.integers(8, 24)), random.uniform(1.2, 1.6)
        snr, bias = random.uniform(8, 40), random.uniform(0, 0.6)
        return make_phantom(
            (*size, count), (pixel, pixel, 6.0), snr, bias, int(random.integers(1_000_000)), **keys
        ).anatomy
    base = section(list(PARTS)[number // 5 % len(PARTS)], int(random.integers(1_000_000)), 0.02)
    flat = base.anatomy.data[..., 0]
    count, middle = int(random.integers(7, 26)), 0.5 * np.array(flat.shape, float)[:, None, None]
    taper, turn = random.uniform(-0.02, 0.02), random.uniform(-0.03, 0.03)
    drift, bent = random.normal(0, 0.7, 2), random.normal(0, 1, (2, 2, *flat.shape))
    bent = ndimage.gaussian_filter(bent, (0, 0, 14, 14)) * 14 * random.uniform(0, 4)
    coil = random.uniform(0, 0.5)
    place = np.indices(flat.shape) - middle
    noise = np.median(flat[flat > 0.3 * flat.max()]) / random.uniform(8, 40)
    slices = []
    for k in range(count):
        t = k - 0.5 * (count - 1)
        wide, c, s = 1 + taper * t, np.cos(turn * t), np.sin(turn * t)
        at = wide * np.einsum("ab,bij->aij", [[c, -s], [s, c]], place) + drift[:, None, None] * t
        at += bent[0] * np.sin(0.3 * t) + bent[1] * 0.1 * t + middle
        even = ndimage.map_coordinates(flat, at, order=1, mode="constant")
        slices.append(even * (1 - coil * (2 * t / count) ** 2))
    whole = np.stack(slices, -1)
    if random.random() < 0.2:  # air set to zero, as some scanners do
        return Image(
            whole + random.normal(0, noise, whole.shape) * (whole > noise), base.anatomy.affine
        )
    return Image(rician(whole, noise, random), base.anatomy.affine)


def part_of(image: Image, random: np.random.Generator) -> Image:
    """Some slices of a real series, in any order of its axes, with more noise."""
    count = int(random.integers(8, image.data.shape[2] + 1))
    first = int(random.integers(image.data.shape[2] - count + 1))
    data = image.data[:, :, first : first + count][
        :: random.choice([-1, 1]), :: random.choice([-1, 1])
    ]
    noise = float(np.percentile(data, 90)) * random.uniform(0, 0.08)
    return Image(rician(data[..., :: random.choice([-1, 1])], noise, random), image.affine)


def damaged(image: Image, fault: str, random: np.random.Generator) -> tuple[Image, int]:
    """The series with one fault, and the slice that has it."""
    data = image.data.copy()
    n = data.shape[2]
    at = int(random.integers(1, n - 1))
    rest = slice(at, at + 1) if random.random() < 0.6 else slice(at, n)
    own = data[..., rest]
    if fault == "empty":
        air = np.percentile(data, 1)
        data[..., at] = random.choice([0.0, 1.0]) * random.random(data.shape[:2]) * 0.02 * air
    elif fault == "repeated":
        data[..., at] = data[..., at - 1]
    elif fault == "displaced":
        angle = random.uniform(0, 2 * np.pi)
        shift = random.uniform(5, 15) / image.spacing[:2] * (np.cos(angle), np.sin(angle))
        data[..., rest] = ndimage.shift(own, (*shift, 0), order=1, mode="nearest")
    elif fault == "ghost":
        axis = int(random.integers(2))
        away = data.shape[axis] // int(random.choice([2, 2, 3, 4]))
        phase = np.exp(1j * random.uniform(0, 6.3))
        strength = random.uniform(0.08, 0.3)
        data[..., rest] = np.abs(own + phase * strength * np.roll(own, away, axis))
    else:
        data[..., rest] *= random.uniform(1.6, 3) ** random.choice([-1, 1])
    return Image(data, image.affine), at


def outliers(data: F64) -> set[int]:
    """Slices whose mean, or likeness to both neighbours, is 3.5 robust deviations off the median.

    - `data`: a series, shape `(ni, nj, nk)`
    """
    flat = data.reshape(-1, data.shape[2]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        next_one = np.array([np.corrcoef(pair)[0, 1] for pair in pairwise(flat)])
    ends = np.pad(np.nan_to_num(next_one), 1, mode="edge")
    found: set[int] = set()
    for one in (flat.mean(axis=1), np.maximum(ends[1:], ends[:-1])):
        away = np.abs(one - np.median(one))
        spread = max(1.4826 * float(np.median(away)), 1e-9)
        found.update(np.flatnonzero(away > 3.5 * spread).tolist())
    return found


def damage(half: str, data: str = "") -> Iterator[tuple[str, ...]]:
    """Damaged slices in series of five parts of the body, and false alarms in undamaged series.

    Series of 7 to 31 slices that taper, turn, drift and bend, in any sequence, SNR 8 to 40, with
    the coil's fall at their ends, a fifth of them phantoms of a calf and, with the folder `data`, a
    fifth parts of a real series of thighs. In as many series one slice is made faulty: empty,
    repeated, displaced by 5 to 15 mm, with a signal off by a factor of 1.6 to 3, or with a
    ghost of 8 to 30 %; the last three also in all slices from there on. Bounds were chosen on
    `tuned`. For comparison, a script of a few lines: it reports slices whose mean, or correlation
    with both neighbours, is more than 3.5 robust standard deviations (from the median absolute
    deviation) off the median of all.
    """
    yield "fault", "series", "found", "also another fault", "by outliers", "CPU s"
    thighs = None
    if data:
        thighs = read_image(Path(data, "qmritools_legs", "thighs_outphase.nii.gz"))
    first, count = HALVES[half]
    rows = {name: np.zeros(5) for name in ("none", *FAULTS)}
    for number in range(first, first + 2 * count):
        random = np.random.default_rng([number, 3])
        image, at, fault = series(random, number, thighs), -1, "none"
        if number >= first + count:
            fault = FAULTS[(number + number // 5) % len(FAULTS)]
            image, at = damaged(image, fault, random)
        start = time.process_time()
        faults = damaged_slices(image)
        took = time.process_time() - start
        word = dict(zip(FAULTS, WORDS, strict=True)).get(fault, "none")
        right = [one for one in faults if one.why.startswith(word) and at in one.slices]
        others = outliers(image.data)
        rows[fault] += (
            1, bool(right) if at >= 0 else bool(faults), len(faults) > len(right),
            at in others if at >= 0 else bool(others), took,
        )  # fmt: skip
    for name, (n, hits, more, theirs, took) in rows.items():
        alarms = " (false alarms)" * (name == "none")
        yield (name, f"{n:.0f}", f"{hits:.0f}{alarms}", f"{more:.0f}" if name != "none" else "",
               f"{theirs:.0f}{alarms}", f"{took / max(n, 1):.2f}")  # fmt: skip
