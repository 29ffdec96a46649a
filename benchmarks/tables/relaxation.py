"""T2 of multi-echo spin-echo series, and tissue from it, in sections of known truth."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from benchmarks.tables.tissues import FAT, MUSCLE, section
from myork.imaging.relaxation import t2_map
from myork.records import Image
from myork.segmentation.leg import leg_tissues
from myork.segmentation.regions import body_mask
from myork.segmentation.scores import dice
from myork.segmentation.shading import shading
from myork.segmentation.starts import kmeans
from myork.types import F64, I32, Mask

#: Numbers of the cases of a half
HALVES = {"tuned": range(24), "other": range(9000, 9024)}
#: T1 of muscle and fat at 3 T, of marrow and all else as of fat [ms]
T1 = (1400.0, 370.0)


class Series(NamedTuple):
    """Echoes of a section, their times [ms], true T2 [ms], its labels and the angle of pulses."""

    echoes: list[Image]
    times: list[float]
    true: F64
    label: I32
    angle: float


def spin_echoes(count: int, step: float, t1: float, t2: float, angle: float) -> F64:
    """Echoes of a train of equal pulses by extended phase graphs (Hennig 1991), shape `(count,)`.

    - `step`, `t1`, `t2`: time between echoes, relaxation times [ms]
    - `angle`: of the refocusing pulses [degree]
    """
    a = np.radians(angle)
    half = 0.5 * (1.0 + np.cos(a)), 0.5 * (1.0 - np.cos(a))
    pulse = np.array([[half[0], half[1], -1j * np.sin(a)], [half[1], half[0], 1j * np.sin(a)],
                      [-0.5j * np.sin(a), 0.5j * np.sin(a), np.cos(a)]])  # fmt: skip
    fade = np.exp(-0.5 * step / np.array([[t2], [t2], [t1]]))
    state = np.zeros((3, 2 * count + 2), complex)
    state[:2, 0] = 1.0

    def later(state: np.ndarray) -> np.ndarray:
        state = state * fade
        state[2, 0] += 1.0 - fade[2, 0]
        state[0, 1:] = state[0, :-1].copy()
        state[1, :-1] = state[1, 1:].copy()
        state[1, -1] = 0.0
        state[0, 0] = state[1, 0].conj()
        return state

    found = []
    for _ in range(count):
        state = later(pulse @ later(state))
        found.append(abs(state[0, 0]))
    return np.array(found)


def series(number: int) -> Series:
    """A section of a calf, thigh or arm in a train of echoes."""
    random = np.random.default_rng([number, 7])
    drawn = section(("calf", "thigh", "arm")[number % 3], 8 * (number // 3), 0.02, 0.0)
    count, step = int(random.integers(5, 18)), random.uniform(7.0, 12.0)
    angle = 180.0 if number % 2 else random.uniform(140.0, 175.0)
    noise, label = 1.0 / random.uniform(20.0, 80.0), drawn.truth
    rows = [
        (own, *values)
        for own, values in (
            (label == MUSCLE, (1.0, T1[0], random.uniform(28.0, 45.0))),
            (label == FAT, (random.uniform(0.9, 1.3), T1[1], random.uniform(70.0, 140.0))),
        )
    ]
    rest = drawn.anatomy.data / np.median(drawn.anatomy.data[label == FAT])
    rows.append(((label > 0) & (label != MUSCLE) & (label != FAT), rest, T1[1], 90.0))
    # pulses are weaker where the coil reaches badly
    u = np.linspace(-1.0, 1.0, label.shape[0])[:, np.newaxis, np.newaxis]
    factor, true = 1.0 + 0.25 * random.uniform(-1.0, 1.0) * u, np.zeros(label.shape)
    signal = np.zeros((count, *label.shape))
    for own, proton, t1, t2 in rows:
        signal += own * proton * spin_echoes(count, step, t1, t2, angle)[:, None, None, None]
        true[own] = t2
    real, other = random.normal(0.0, noise, (2, *signal.shape))
    affine = drawn.anatomy.affine
    echoes = [Image(300.0 * one, affine) for one in np.hypot(factor * signal + real, other)]
    return Series(echoes, [step * (n + 1) for n in range(count)], true, label, angle)


def t2_maps(half: str) -> Iterator[tuple[str, ...]]:
    """T2 of `[t2]` in sections of calves, thighs and arms, and tissue from it.

    Trains of 5 to 17 echoes, 7 to 12 ms apart, first echo of muscle at SNR 15 to 70, muscle of 28
    to 45 and fat of 70 to 140 ms; refocusing pulses of 180 degrees, or of 140 to 175 with the
    stimulated echoes of extended phase graphs. Mean of the median relative error of T2, in muscle
    and in fat that touch nothing else, of ours and of a line through the logarithms of all echoes;
    mean of the lesser Dice of muscle and of fat by two clusters (k-means) of T2, and by `[tissue]`
    of the first echo alone, of the mean of the echoes and of this mean with T2 as in `[t2]`; right
    is 0.95 at least. Constants were chosen on `tuned`.
    """
    yield ("pulses", "series", "muscle: ours", "line", "fat: ours", "line", "with a doubt",
           "clusters of T2", "first echo", "mean", "mean and T2", "right")  # fmt: skip
    groups: dict[str, list[list[float]]] = {"180°": [], "140° to 175°": []}
    for number in HALVES[half]:
        case = series(number)
        first, time = case.echoes[0], np.array(case.times)
        body = body_mask(Image(np.sum([m.data for m in case.echoes], axis=0), first.affine), 0.0)
        found = t2_map(case.echoes, case.times, body)
        stack = np.log(np.maximum([one.data[body] for one in case.echoes], 1e-6))
        line = np.zeros(body.shape)
        line[body] = -1.0 / np.minimum(np.polyfit(time, stack, 1)[0], -1e-4)
        row = []
        for label in (MUSCLE, FAT):
            own = inner(case.label == label)
            row += [
                float(np.median(np.abs(one[own] / case.true[own] - 1.0)))
                for one in (found.time, line)
            ]
        mean = Image(np.mean([m.data for m in case.echoes], axis=0), first.affine)
        relaxation = Image(found.time, first.affine)
        maps = [
            leg_tissues(even(one), fat=fat).labels.data
            for one, fat in ((first, None), (mean, None), (mean, relaxation))
        ]
        maps.insert(0, clusters(relaxation))
        scores = [min(dice(one == n, case.label == n) for n in (MUSCLE, FAT)) for one in maps]
        wrong = scores[-1] < 0.95
        groups["180°" if case.angle == 180.0 else "140° to 175°"].append(
            [*row, bool(found.doubt), *scores, not wrong]
        )
    for name, rows in groups.items():
        mean = np.mean(rows, axis=0)
        doubts, right = (sum(row[n] for row in rows) for n in (4, -1))
        yield (name, str(len(rows)), *(f"{100 * one:.1f} %" for one in mean[:4]), f"{doubts:.0f}",
               *(f"{one:.3f}" for one in mean[5:-1]), f"{right:.0f}")  # fmt: skip


def even(image: Image) -> Image:
    """Without shading, as by `segment`."""
    field = shading(image.data, body_mask(image), spacing=image.spacing).field
    return Image(image.data / field, image.affine)


def clusters(relaxation: Image) -> I32:
    """Muscle and fat by two clusters of T2."""
    where = relaxation.data > 0
    found = kmeans(relaxation.data[where][:, np.newaxis], 2)[0]
    labels = np.zeros(where.shape, np.int32)
    labels[where] = np.where(found == found[relaxation.data[where].argmax()], FAT, MUSCLE)
    return labels


def inner(where: Mask) -> Mask:
    """Voxels that touch nothing else in their slice."""
    return np.asarray(ndimage.binary_erosion(where, np.ones((3, 3, 1))))
