"""Muscle and fat in sections of calves, thighs, hips, arms and trunks with known truth."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from skimage.segmentation import random_walker

from myork.imaging.io import read_image, read_labels
from myork.imaging.phantom import rician
from myork.records import Image
from myork.segmentation.leg import leg_tissues
from myork.segmentation.regions import body_mask
from myork.segmentation.scores import dice
from myork.segmentation.shading import shading
from myork.segmentation.starts import kmeans
from myork.types import F64, I32

#: Sections of each part of the body; bounds were chosen on numbers 0 to 31
NUMBERS = range(6000, 6016)
#: Half axes of a section, and range of fat under the skin, between muscles, and as streaks in
#: muscles [mm, mm, mm, -], number of muscles, bones as (position on the radius, radius, cortex)
PARTS = {
    "calf": ((55, 52), (3, 12), (0.6, 3), (0, 0.08), 7, ((0.45, 12, 3.5), (0.55, 6, 2))),
    "thigh": ((85, 78), (5, 28), (0.8, 6), (0, 0.12), 12, ((0.15, 14, 5),)),
    "hip": ((170, 115), (12, 40), (1.5, 7), (0, 0.12), 16, ((0.55, 24, 1.5), (0.6, 18, 1.5))),
    "arm": ((46, 44), (2, 15), (0.6, 3), (0, 0.06), 4, ((0.1, 11, 3.5),)),
    "trunk": ((160, 110), (8, 35), (1.0, 4), (0, 0.1), 14, ((0.5, 22, 1.2),)),
}
#: Range of the signal of muscle, skin and marrow, relative to fat, for each kind of image
KINDS = {
    "T1": ((0.28, 0.5), (0.35, 0.5), (0.8, 1.0)),
    "PD": ((0.5, 0.68), (0.4, 0.6), (0.85, 1.0)),
    "T2": ((0.15, 0.3), (0.25, 0.4), (0.7, 1.0)),
    "out of phase": ((0.8, 1.25), (0.5, 0.8), (0.8, 1.0)),
    "fat suppressed": ((3.0, 6.0), (2.0, 3.0), (1.0, 1.3)),
}
MUSCLE, FAT, BONE, OTHER = 1, 2, 4, 5
FINE = 2  # voxels of the truth per voxel of the image, along each axis


class Section(NamedTuple):
    """Images of a section and its truth: muscle, fat with skin, bone, others, 0 outside."""

    name: str
    anatomy: Image
    fat: Image | None
    truth: I32


def blurred(random: np.random.Generator, shape: tuple[int, int], width: float) -> F64:
    """Noise correlated over a width [pixel], of variance one."""
    noise = ndimage.gaussian_filter(random.normal(size=shape), width, mode="wrap")
    return noise / noise.std()


def section(part: str, number: int) -> Section:
    """Draw a section and its images: any sequence, field, amount of fat, noise and shading."""
    random = np.random.default_rng([list(PARTS).index(part), number])
    (a, b), fat_depth, septum, streaks, count, bones = PARTS[part]
    size = random.uniform(0.85, 1.15)
    pixel = random.choice([0.8, 1.0, 1.25, 1.6]) if a < 100 else random.choice([1.25, 1.6, 2.0])
    h = pixel / FINE
    n = [2 * (int(1.15 * size * r / pixel) + 4) * FINE for r in (a, b)]
    x, y = np.meshgrid(*((np.arange(m) - 0.5 * (m - 1)) * h for m in n), indexing="ij")
    angle = np.arctan2(y, x)
    outline = 1.0 + sum(
        random.uniform(-0.05, 0.05) * np.cos(k * angle + random.uniform(0, 6.3)) for k in (2, 3, 4)
    )
    inside = np.hypot(x / (size * a), y / (size * b)) < outline
    depth = ndimage.distance_transform_edt(inside, sampling=h)
    thick = random.uniform(*fat_depth) * (1 + 0.35 * np.cos(angle + random.uniform(0, 6.3)))
    core = inside & (depth > 1.6 + thick)
    # muscles: cells around points, with fat along the borders
    places = np.argwhere(core)[random.choice(int(core.sum()), 40 * count, replace=False)]
    centre = [places[0]]
    for _ in range(count - 1):
        away = np.min([((places - c) ** 2).sum(axis=1) for c in centre], axis=0)
        centre.append(places[away.argmax()])
    warp = [blurred(random, x.shape, 8 / h) * 1.5 / h for _ in range(2)]
    at = np.stack(np.meshgrid(*map(np.arange, x.shape), indexing="ij"), 0) + warp
    distance = np.sort([np.hypot(*(at - np.reshape(c, (2, 1, 1)))) * h for c in centre], axis=0)[:2]
    width = random.uniform(*septum) * np.clip(1 + 0.5 * blurred(random, x.shape, 10 / h), 0.2, 3)
    truth = np.where(inside, FAT, 0)
    truth[core & (distance[1] - distance[0] > width)] = MUSCLE
    share = random.uniform(*streaks)
    fatty = blurred(random, x.shape, random.uniform(0.8, 1.6) / h)
    grey = np.zeros(x.shape)
    kind = ("T1", "T1", "T1", "PD", "T2", "T1", "out of phase", "fat suppressed")[number % 8]
    muscle, skin, marrow = (random.uniform(*bounds) for bounds in KINDS[kind])
    truth[(truth == MUSCLE) & (fatty > np.quantile(fatty, 1 - share))] = FAT
    grey[truth == FAT] = 1.0
    grey[truth == MUSCLE] = muscle
    fraction = np.where(truth == FAT, 0.95, 0.03)
    if part in ("hip", "trunk"):
        # organs in fat, with the grey value of muscle or between it and fat
        organs = core & (np.hypot(x / (0.5 * size * a), y / (0.45 * size * b)) < outline)
        truth[organs], grey[organs], fraction[organs] = FAT, 1.0, 0.95
        for _ in range(random.integers(5, 12)):
            c = places[random.integers(len(places))]
            r = random.uniform(12, 30) / h
            here = organs & (np.hypot(*(at - np.reshape(c, (2, 1, 1)))) < r)
            truth[here], fraction[here] = OTHER, 0.03
            grey[here] = muscle * random.uniform(0.8, 1.7)
    for _ in range(random.integers(1, 5)):
        c = places[random.integers(len(places))]
        here = core & (np.hypot(*(at - np.reshape(c, (2, 1, 1)))) * h < random.uniform(1, 3.5))
        truth[here], grey[here], fraction[here] = OTHER, random.choice([0.04, 0.7]), 0.05
    turn = random.uniform(0, 6.3)
    for away, radius, cortex in bones:
        turn += 0.7
        c = 0.8 * away * size * a * np.cos(turn), 0.8 * away * size * b * np.sin(turn)
        r = np.hypot(x - c[0], y - c[1]) / size
        truth[r < radius], grey[r < radius], fraction[r < radius] = BONE, 0.05, 0.1
        grey[r < radius - cortex], fraction[r < radius - cortex] = marrow, 0.9
    rind = inside & (depth < 1.6)
    grey[rind], fraction[rind], truth[rind] = skin, 0.1, FAT
    fibrous = blurred(random, x.shape, 3 / h) * 0.03 + 1

    def coarse(values: F64) -> F64:
        whole = values.reshape(n[0] // FINE, FINE, n[1] // FINE, FINE)
        return whole.mean(axis=(1, 3))[..., np.newaxis]

    share_of = {k: coarse((truth == k).astype(float)) for k in (0, MUSCLE, FAT, BONE, OTHER)}
    label = np.array(list(share_of))[np.argmax(list(share_of.values()), axis=0)]
    u, v = x / (size * a), y / (size * b)
    waves = (np.sin(f * w + random.uniform(0, 6.3)) for w in (u, v, u + v) for f in (1.2, 2.4))
    factor = np.exp(coarse(sum(0.12 * random.uniform(-1, 1) * wave for wave in waves)))
    sigma = max(muscle, 0.3 if kind != "fat suppressed" else 1.0) / random.uniform(10, 40)

    def noisy(signal: F64) -> Image:
        return Image(400 * rician(signal * factor, sigma, random), affine, "image")

    affine = np.diag([pixel, pixel, 5.0, 1.0])
    bright = np.where(grey > 0.1, 1.0, grey)
    both = number % 8 in (5, 6) and part != "calf"
    fat = noisy(coarse(bright * fraction)) if both else None
    if both and kind == "T1":
        kind = "water and fat"
        anatomy = noisy(coarse(bright * (1 - fraction)))
    else:
        anatomy = noisy(coarse(grey * fibrous))
    return Section(
        f"{part}, {kind}" + (", fat" if both and kind != "water and fat" else ""),
        anatomy,
        fat,
        label,
    )


def even(case: Section) -> tuple[Image, Image | None]:
    """Image of the whole body, and fat, with the shading removed as by `segment`."""
    affine, fat = case.anatomy.affine, case.fat
    both = "water and fat" in case.name and fat is not None
    whole = case.anatomy.data + (fat.data if both and fat is not None else 0.0)
    body = body_mask(Image(whole, affine))
    field = shading(whole, body, spacing=case.anatomy.spacing).field
    if fat is not None:
        fat = Image(fat.data / (whole if both else field), affine)
        if both:
            inside = body_mask(Image(whole, affine), rim=0.0)
            fat = Image(np.clip(fat.data, 0, 1) * inside, affine)
    return Image(whole / field, affine), fat


def baselines(anatomy: Image, fat: Image | None) -> list[I32]:
    """Muscle and fat by k-means of two clusters, and by scikit-image's walks from their centres."""
    shown = anatomy if fat is None else fat
    body = body_mask(anatomy, rim=0.0)
    values = shown.data
    found = kmeans(values[body][:, np.newaxis], 2)[0]
    bright = np.zeros(body.shape, bool)
    bright[body] = found == found[values[body].argmax()]
    seeds = np.where(body, 0, -1)
    for label, own in ((MUSCLE, body & ~bright), (FAT, bright)):
        middle = np.median(values[own])
        near = np.abs(values - middle)
        seeds[own & (near < np.quantile(near[own], 0.3))] = label
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        walked = random_walker(values[..., 0], seeds[..., 0], 130, "cg_j")[..., np.newaxis]
    return [np.where(body, np.where(bright, FAT, MUSCLE), 0), np.maximum(walked, 0)]


def tissues(data: str = "") -> Iterator[tuple[str, ...]]:
    """Muscle and fat of `[tissue]` in sections of five parts of the body, against their truth.

    Sections of a calf, a thigh, hips, an arm and a trunk, drawn with any amount of fat under the
    skin, between and in muscles, bones, vessels and organs, in T1, PD, T2, opposed phase and fat
    suppressed images, water and fat or a fat image beside; 0.8 to 2 mm, muscle at SNR 10 to 40,
    shading taken out by `auto`. Bounds were chosen on others, and on the two real images that
    `data` names (T1 calves, scored by the fraction of labelled muscle that is found, and thighs in
    opposed phase). A section is right if the Dice coefficients of muscle and of fat are 0.95 or
    more. The table gives the mean of the smaller coefficient for MyoRK, for k-means (two clusters)
    and for scikit-image's random walker from the middle of these clusters (bone counts as neither
    for all).
    """
    yield ("part", "sections", "right, no doubt", "right, doubt", "wrong, doubt", "wrong, no doubt",
           "ours", "k-means", "walks", "CPU s")  # fmt: skip
    for part in PARTS:
        outcome, scores, spent = np.zeros(4, int), [], 0.0
        for number in NUMBERS:
            case = section(part, number)
            anatomy, fat = even(case)
            start = time.process_time()
            ours = leg_tissues(anatomy, fat=fat)
            spent += time.process_time() - start
            maps = [ours.labels.data, *baselines(anatomy, fat)]
            least = [min(dice(one == n, case.truth == n) for n in (MUSCLE, FAT)) for one in maps]
            scores.append(least)
            wrong, doubt = least[0] < 0.95, bool(ours.doubts)
            outcome[3 - doubt if wrong else int(doubt)] += 1
        means = (f"{mean:.3f}" for mean in np.mean(scores, axis=0))
        count = len(NUMBERS)
        yield (part, str(count), *map(str, outcome), *means, f"{spent / count:.2f}")
    if data:
        calves = read_image(Path(data, "dafne_calf", "t1_a.nii.gz"))
        drawn = read_labels(Path(data, "dafne_calf", "t1_a_muscles.nii.gz")).data > 0
        thighs = read_image(Path(data, "qmritools_legs", "thighs_outphase.nii.gz"))
        thighs = Image(thighs.data[:, :, 12:15], thighs.affine, thighs.name)
        for one, truth in ((calves, drawn), (thighs, None)):
            anatomy = even(Section("", one, None, np.zeros(0, int)))[0]
            ours = leg_tissues(anatomy)
            score = "" if truth is None else f"{(ours.labels.data[truth] == MUSCLE).mean():.3f}"
            doubts = f"{len(ours.doubts)} doubts"
            yield Path(one.name).name, "1", doubts, *[""] * 3, score, *[""] * 3
