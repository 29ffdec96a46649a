"""Bias fields of known shape on images of known truth."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK
from scipy import ndimage

from benchmarks.tables.tissues import PARTS, section
from myork.imaging.io import read_image, read_labels
from myork.imaging.phantom import make_phantom, rician
from myork.records import Image
from myork.segmentation.regions import body_mask
from myork.segmentation.shading import joint_variation, shading
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
FAMILIES = ("coil", "polynomial", "sine")
SNR = 25.0
#: First of the numbers of the sections of a half, and how many there are of each part of the body
SECTIONS = {"tuned": (8, 8), "other": (7000, 8)}
#: Edges of a whole calf [voxel], [mm]
CALF = (96, 96, 20), (1.25, 1.25, 16.0)


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


def whole_calf(keys: dict[str, Any]) -> Image:
    """A calf from below the knee to above the ankle, where it is half as thick."""
    whole = make_phantom(*CALF, snr=1e6, bias=0.0, **keys).anatomy
    middle, data = 0.5 * (CALF[0][0] - 1), np.zeros_like(whole.data)
    for k, t in enumerate(np.linspace(0.0, 1.0, CALF[0][2])):
        size = 0.55 + 0.45 * np.sin(np.pi * (0.15 + 0.62 * t))
        data[..., k] = ndimage.affine_transform(
            whole.data[..., k], np.eye(2) / size, offset=middle - middle / size, order=1
        )
    return Image(data, whole.affine)


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
    yield "whole calf", whole_calf(PHANTOMS[half][0]), 400.0 / SNR
    if real:
        calves = read_image(Path(real[0]))
        yield "calves", even_calves(calves, read_labels(Path(real[1])).data), 0.0


def n4(values: F64, mask: Mask, spacing: F64) -> F64:
    """Field by N4 (Tustison et al. 2010) of SimpleITK, of every third pixel.

    With the width of its deconvolution doubled, and a tighter tolerance, as its defaults stop too
    early at strong fields.
    """
    way = SimpleITK.N4BiasFieldCorrectionImageFilter()
    way.SetBiasFieldFullWidthAtHalfMaximum(0.3)
    way.SetConvergenceThreshold(1e-4)
    flat = values.shape[2] == 1

    def image(data: Any) -> Any:
        found = SimpleITK.GetImageFromArray(data[..., 0].T if flat else data.T)
        found.SetSpacing([float(one) for one in spacing[: 2 if flat else 3]])
        return found

    whole, body = image(values.astype(np.float32)), image(mask.astype(np.uint8))
    few = [3, 3] if flat else [3, 3, 1]
    way.Execute(SimpleITK.Shrink(whole, few), SimpleITK.Shrink(body, few))
    logarithm = SimpleITK.GetArrayFromImage(way.GetLogBiasFieldAsImage(whole)).T
    return np.asarray(np.exp(logarithm.reshape(values.shape)), float)


def shading_fields(half: str, *real: str) -> Iterator[tuple[str, ...]]:
    """Estimation of known bias fields on images of known truth.

    Fields of three families (coils beside the body, polynomials, sines), strong and weak, on
    phantom slices, stacks and a calf of 32 cm (coil and sines) that is half as thick at its ankle;
    after `half` a T1 slice of two calves and its manual muscle labels, its own shading taken out
    first by a quadratic field fitted to the labelled muscle of each leg. Settings were chosen on
    `tuned`. Correlation of the field in the body and seconds, by `auto` and by N4 (SimpleITK, full
    width 0.3, tolerance 1e-4, every third pixel); of `auto` the coefficient of joint variation
    (scatter of bright and of dark tissue over their difference) before and after, whether the field
    is doubtful, and the correlation at the skin (what lies beyond the mask that the field is
    estimated in, and its rim) and in the two first and last slices of a stack. In brackets, the
    standard deviation of the logarithm of the field found over the true one: if a field hardly
    varies, as in the last slices under a weak coil, the correlation is meaningless.
    """
    random = np.random.default_rng(1 if half == "tuned" else 2)
    yield ("images", "field", "factor", "`auto`", "N4", "joint variation", "doubt", "skin",
           "last slices")  # fmt: skip
    for name, image, noise in images(half, real):
        mask = body_mask(image)
        one = image.data.shape[2] == 1
        inner = ndimage.binary_erosion(mask, np.ones((3, 3, 1)))
        last = mask.copy()
        last[:, :, 2:-2] = False
        parts = [body_mask(image, rim=0.0) & ~inner, last & (not one)]
        for family in FAMILIES if name != "whole calf" else FAMILIES[::2]:
            for ends in (STRONG[1 if one else 3], WEAK):
                truth = field(family, ends, mask, image.spacing, random)
                values = rician(image.data * truth, noise, random)
                body = body_mask(Image(values, image.affine))
                clock = [time.process_time()]
                ours = shading(values, body, spacing=image.spacing)
                clock.append(time.process_time())
                theirs = n4(values, body, image.spacing)
                took, longer = np.diff([*clock, time.process_time()])
                scatter = [joint_variation(v, body) for v in (values, values / ours.field)]
                shown = [
                    f"{np.corrcoef(found[where], truth[where])[0, 1]:.4f}" if where.any() else "-"
                    for found, where in (
                        (ours.field, mask), (theirs, mask), *((ours.field, one) for one in parts)
                    )
                ]  # fmt: skip
                for place, where in ((0, mask), (3, parts[1])):
                    if where.any():
                        miss = float(np.std(np.log(ours.field[where] / truth[where])))
                        shown[place] += f" ({100 * miss:.1f} %)"
                yield (name, family, f"{ends[0]:g} to {ends[1]:g}", f"{shown[0]}, {took:.1f} s",
                       f"{shown[1]}, {longer:.1f} s", f"{scatter[0]:.2f} to {scatter[1]:.2f}",
                       "yes" if ours.doubt else "no", *shown[2:])  # fmt: skip


def shading_doubts(half: str) -> Iterator[tuple[str, ...]]:
    """Bias fields in sections of five parts of the body in any sequence, and doubts about them.

    Sections of the table of tissues (T1, PD, T2, out of phase, fat suppressed, water and fat),
    muscle at SNR 10 to 40, under fields of three families, two thirds of them weak (0.75 to 1.3)
    and one third strong (0.4 to 2). Error is the standard deviation of the logarithm of the field
    found over the true one in the body; bounds of doubts were chosen on `tuned`.
    """
    groups = {"below 5 %": 0.05, "5 to 10 %": 0.1, "10 % and more": np.inf}
    rows = {name: np.zeros((2, 2)) for name in groups}
    random = np.random.default_rng(11 if half == "tuned" else 12)
    first, count = SECTIONS[half]
    cases = [(part, number) for part in PARTS for number in range(first, first + count)]
    for case, (part, number) in enumerate(cases):
        image, label = section(part, number, 0.02, 0.0)[1::2]
        mask = body_mask(image)
        ends = STRONG[1] if case % 3 == 2 else WEAK
        truth = field(FAMILIES[case % 3], ends, mask, image.spacing, random)
        noise = np.median(image.data[label == 1]) / random.uniform(10.0, 40.0)
        values = rician(image.data * truth, float(noise), random)
        body = body_mask(Image(values, image.affine))
        ours = shading(values, body, spacing=image.spacing)
        inside = body & mask
        for place, found in enumerate((ours.field, n4(values, body, image.spacing))):
            miss = float(np.std(np.log(found[inside] / truth[inside])))
            group = next(name for name, most in groups.items() if miss < most)
            rows[group][place] += 1, place == 0 and bool(ours.doubt)
    yield "error", "by `auto`", "with a doubt", "by N4"
    for name, (own, theirs) in rows.items():
        yield (name, *(f"{one:.0f}" for one in own), f"{theirs[0]:.0f}")


def _by_images(rows: list[list[str]]) -> list[list[str]]:
    """Correlations, and the largest error, of images of a kind under a range of factors."""
    shown = [["images", "factor", "cases", "`auto`: least, mean", "largest error",
              "N4: least, mean", "doubts", "skin: least", "last slices: least"]]  # fmt: skip
    groups: dict[tuple[str, str], list[list[str]]] = {}
    for row in rows[1:]:
        groups.setdefault((row[0].rstrip(" 0123456789"), row[2]), []).append(row)
    for names, own in groups.items():
        ours, theirs, skin, last = (
            [float(row[k].split()[0].rstrip(",")) for row in own if row[k] != "-"]
            for k in (3, 4, 7, 8)
        )
        worst = max(float(row[3].split("(")[1].split()[0]) for row in own)
        pairs = [f"{min(found):.4f}, {np.mean(found):.4f}" for found in (ours, theirs)]
        doubts = sum(row[6] == "yes" for row in own)
        ends = [f"{min(found):.4f}" if found else "-" for found in (skin, last)]
        shown.append(
            [*names, str(len(own)), pairs[0], f"{worst:g} %", pairs[1], str(doubts), *ends]
        )
    return shown


#: What the page of results shows
PIVOTS = {"shading_fields": _by_images}
