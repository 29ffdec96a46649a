"""Water and fat of two echoes of known truth."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.tables.phantoms import coarse, fine_phantom
from myork.imaging.dixon import echo, fat_factors, separate
from myork.records import Image
from myork.segmentation.regions import body_mask
from myork.segmentation.scores import dice
from myork.types import F64, Mask

HALVES: dict[str, list[dict[str, Any]]] = {
    "tuned": [
        {},
        {"imat": 0.08, "septum": 1.0, "growth": 15.0, "seed": 2},
        {"imat": 0.04, "imct": 0.05, "scale": 0.85, "seed": 3},
    ],
    "other": [
        {"scale": 0.93, "septum": 1.8, "seed": 11},
        {"imat": 0.15, "septum": 0.6, "growth": 15.0, "seed": 12},
        {"imat": 0.03, "imct": 0.1, "growth": 5.0, "scale": 0.8, "seed": 13},
    ],
}
# Echo times [ms] of opposed and equal phase, the second one in another order at 3 T
TIMES = {1.5: (2.3, 4.6), 3.0: (2.46, 1.23)}
DECAY = 35.0  # [1/s]


class Echoes(NamedTuple):
    """Two echoes and the answer."""

    images: list[tuple[F64, F64]]  # magnitude and phase, in counts of 4096 a turn
    phases: list[F64]  # of water in both echoes, without noise [radian]
    water: F64
    fat: F64
    body: Mask
    spacing: F64


def make_echoes(
    strength: float, snr: float, hertz: float, seed: int, slices: int = 5, **keys: Any
) -> Echoes:
    """Echoes of a calf; `snr` is that of muscle, `hertz` half of the range of the field."""
    fine = fine_phantom(slices, seed=seed, **keys)
    kind, bright = fine.tissue.data, fine.fat.data
    water, fat = np.zeros((2, *kind.shape))
    for tissue, parts in ((1, (0.97, 0.03)), (2, (0.12, 1.1)), (3, (0.35, 0.02)), (4, (0.08, 0.0))):
        water[kind == tissue], fat[kind == tissue] = parts
    marrow = (kind == 4) & (bright > 500.0)
    water[marrow], fat[marrow] = 0.05, 0.95
    skin = (kind == 2) & (bright < 200.0)
    water[skin], fat[skin] = 0.8, 0.1
    water, fat = coarse(water), coarse(fat)
    size = np.array([1.4, 1.4, 7.0])
    random = np.random.default_rng(seed)
    x, y, z = (np.indices(water.shape) - (np.array(water.shape)[:, None, None, None] - 1) / 2) * (
        size[:, None, None, None] / 60.0
    )

    def slow(waves: float) -> F64:
        raw = np.zeros_like(x)
        for _ in range(4):
            way = random.normal(size=3) * (1, 1, 0.5)
            raw += random.normal() * np.sin(waves * (way[0] * x + way[1] * y + way[2] * z)
                                            + random.uniform(0, 6.28))  # fmt: skip
        raw += random.normal() * (x**2 + y**2) + random.normal() * x
        return 2.0 * (raw - raw.min()) / np.ptp(raw) - 1.0

    field, coil = hertz * (slow(1.2) + random.uniform(-0.5, 0.5)), np.pi * slow(0.8)
    images, phases = [], []
    for number, (t, c) in enumerate(zip(TIMES[strength], fat_factors(TIMES[strength], strength),
                                        strict=True)):  # fmt: skip
        phases.append(2e-3 * np.pi * t * field + coil + 0.8 * number)
        signal = (water + c * fat) * np.exp(1j * phases[-1] - 1e-3 * t * DECAY)
        signal = signal + random.normal(0.0, 1.0 / snr, (*signal.shape, 2)) @ (1.0, 1j)
        images.append(
            (1000.0 * np.abs(signal), np.floor(2048.0 + 2047.9 * np.angle(signal) / np.pi))
        )
    body = (water + fat) > 0.3
    return Echoes(images, phases, water, fat, body, size)


def told_phases(case: Echoes, strength: float) -> F64:
    """Fraction of fat where nobody has to find the phases: least squares in each voxel."""
    turned = [
        -echo(*image) * np.exp(-1j * phase)  # the images put phase zero at half a turn
        for image, phase in zip(case.images, case.phases, strict=True)
    ]
    matrix = np.array([[1.0, c] for c in fat_factors(TIMES[strength], strength)])
    both = np.concatenate([np.stack(turned).real, np.stack(turned).imag]).reshape(4, -1)
    found = np.linalg.lstsq(np.concatenate([matrix.real, matrix.imag]), both, rcond=None)[0]
    water, fat = np.maximum(found, 0.0).reshape(2, *case.body.shape)
    whole = np.where(case.body, water + fat, 0.0)
    return np.divide(fat, whole, out=np.zeros_like(fat), where=whole > 0)


def score(fraction: F64, inside: Mask, case: Echoes) -> list[float]:
    """Dice of water and of fat, correlation of the fraction."""
    true = np.divide(case.fat, case.water + case.fat, out=np.zeros_like(case.fat), where=case.body)
    is_fat = fraction > 0.5
    return [
        dice(~is_fat & case.body & inside, (true <= 0.5) & case.body),
        dice(is_fat & case.body, (true > 0.5) & case.body),
        float(np.corrcoef(fraction[case.body], true[case.body])[0, 1]),
    ]


def row_of(scores: Sequence[float]) -> list[str]:
    """Found, and in brackets what can be found."""
    pairs = zip(scores[:3], scores[3:], strict=True)
    return [f"{found:.4f} ({limit:.4f})" for found, limit in pairs]


def water_fat(half: str) -> Iterator[tuple[str, ...]]:
    """Water and fat of two echoes of known truth: what is found of them.

    Calves of the phantom with water and fat of known amounts (partial volume, marrow, fat among the
    fibers), fields that are off by up to hundreds of hertz with steps' worth of bending, a phase of
    the coils, decay and noise, at 1.5 and 3 T, with six peaks of fat. Settings were chosen on
    `tuned`. Dice coefficients of water and fat tissue, correlation of the fraction of fat in the
    body; in brackets the same of a separation that knows the phases of both echoes (what noise
    and the half filled voxels leave, voxel by voxel); then the least of each noise.
    """
    yield "phantom, field, SNR of muscle, off by", "water", "fat", "fraction r", "CPU [s]", "doubt"
    every: dict[float, list[list[float]]] = {}
    for number, keys in enumerate(HALVES[half]):
        for strength in TIMES:
            for snr, hertz in ((10.0, 80.0), (15.0, 400.0), (30.0, 250.0)):
                seed = keys.get("seed", 1) + (100 if strength > 2 else 200)
                case = make_echoes(strength, snr, hertz, **(keys | {"seed": seed}))
                start = time.process_time()
                one, two = (echo(*image) for image in case.images)
                both = case.images[0][0] + case.images[1][0]
                body = body_mask(Image(both, np.diag([*case.spacing, 1.0])), rim=0.0)
                factors = fat_factors(TIMES[strength], strength)
                found = separate(one, two, body, spacing=case.spacing, factors=factors)
                took = f"{time.process_time() - start:.1f}"
                scores = score(found.fraction, found.water + found.fat > 0, case)
                scores += score(told_phases(case, strength), case.body, case)
                every.setdefault(snr, []).append(scores)
                name = f"{number}, {strength:g} T, {snr:g}, {hertz:g} Hz"
                yield name, *row_of(scores), took, str(found.doubt)
    for snr, rows in every.items():
        yield f"least at SNR {snr:g}", *row_of(np.min(rows, axis=0).tolist()), "", ""
