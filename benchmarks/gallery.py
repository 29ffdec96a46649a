"""Segmentation examples of the thesis' chapters 3 and 4 on synthetic images with a known answer.

Two regions, the weights of length and area, five regions with triple junctions, colours, the
bias field, muscles by the directions of their fibers; and the time of two regions against
`chan_vese` of scikit-image.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import ndimage

from myork.bench.tables import Columns, table
from myork.console import ProgressCallback
from myork.core.deck import table_defaults
from myork.imaging.phantom import make_phantom
from myork.records import Image
from myork.segmentation.bias import clustered_bias
from myork.segmentation.channels import fiber_channels, scaled_values
from myork.segmentation.level_sets import LevelSets, Regions, segment_regions
from myork.segmentation.regions import body_mask
from myork.segmentation.scores import dice
from myork.segmentation.starts import level_sets_of, threshold_regions
from myork.types import F64, I32, Mask

__all__ = ["chan_vese_energy", "run"]


#: Pixels of a piece that counts; smaller ones are noise
_PIECE = 20
_COLUMNS: Columns = (
    ("example", "name"),
    ("Dice", "dice"),
    ("correlation", "correlation"),
    ("pieces", "pieces"),
    ("muscles of grouped pieces", "grouped"),
    ("iterations", "iterations"),
    ("energy at the start", "first_energy"),
    ("at the end", "last_energy"),
)
_TIMED: Columns = (
    ("program", "name"),
    ("iterations", "iterations"),
    ("s", "seconds"),
    ("energy, central", "energy"),
    ("energy, one-sided", "one_sided_energy"),
    ("Dice", "dice"),
    ("times faster", "ratio"),
)


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Run the examples; see `myork.bench` for the result."""
    n = 96 if quick else 192
    cases, pictures = [], []
    for example in (_two_regions, _length, _area, _five_regions, _colours, _bias, _misfit):
        progress(f"example {example.__name__[1:]}")
        found, figure, caption = example(n)
        cases += found
        file = f"gallery_{example.__name__[1:]}.png"
        figure.savefig(out / file, dpi=110, facecolor="white")
        pictures.append({"file": file, "caption": caption})
    progress("time against scikit-image")
    timing = _timing(128 if quick else 256)
    size = f"{timing['size']} x {timing['size']}"
    tables = [
        table(
            "Agreement with the truth; Dice is the mean over the regions. Pieces are connected "
            f"parts of at least {_PIECE} pixels; grouped to the muscle that most of each lies in, "
            "the mean Dice of six muscles.",
            _COLUMNS,
            cases,
        ),
        table(
            f"Two regions on a noisy slice of {size} pixels. Energy: length of the contour and "
            "squared differences from the two means, of the labels, the length by central or by "
            "one-sided differences. All start from Otsu's threshold. Times faster: than "
            "scikit-image to energies not above its own, with either length.",
            _TIMED,
            timing["runs"],
        ),
    ]
    return {
        "title": "Segmentation",
        "about": __doc__.splitlines()[0] if __doc__ else "",
        "pictures": pictures,
        "cases": cases,
        "timing": timing,
        "tables": tables,
    }


def chan_vese_energy(values: F64, inside: Mask, mu: float, one_sided: bool = False) -> float:
    """Energy (3.11) of labels: length as sum of |grad| of the mask, misfit to the two means.

    Parameters
    ----------
    values, inside : NDArray
        Image and mask, shape `(ni, nj)` [-].
    mu : float
        Weight of the length [-].
    one_sided : bool
        Root mean square of the one-sided differences for the gradient, as in the core, rather
        than central differences, as in scikit-image, which do not see single pixels.
    """
    mask = inside.astype(float)
    if one_sided:
        rises = [
            np.concatenate([step, step[-1:]]) ** 2 + np.concatenate([step[:1], step]) ** 2
            for step in (np.diff(mask, axis=0), np.diff(mask.T, axis=0))
        ]
    squared = 0.5 * (rises[0] + rises[1].T) if one_sided else sum(np.square(np.gradient(mask)))
    misfit = sum(
        float(((values[part] - values[part].mean()) ** 2).sum())
        for part in (inside, ~inside)
        if part.any()
    )
    return mu * float(np.sqrt(squared).sum()) + misfit


def _grid(n: int) -> tuple[F64, F64]:
    """Coordinates from -1 to 1."""
    line = (np.arange(n) + 0.5) / n * 2.0 - 1.0
    x, y = np.meshgrid(line, line, indexing="ij")
    return x, y


def _noisy(values: NDArray[np.floating[Any]], sigma: float, seed: int = 1) -> F64:
    return values + np.random.default_rng(seed).normal(0.0, sigma, values.shape)


def _choice(**changes: Any) -> LevelSets:
    """Level sets as a deck without a word about them has them, with some fields changed."""
    return LevelSets.of_table(table_defaults("image"), **changes)


def _segment(values: F64, choice: LevelSets, labels: NDArray[Any] | None = None) -> Regions:
    """Segment a picture of shape `(n, n)` or `(n, n, nchannel)`, maybe from labels."""
    channels = values[:, :, None, None] if values.ndim == 2 else values[:, :, None]
    region = np.ones(channels.shape[:3], bool)
    first = None if labels is None else labels.astype(np.int32)[..., None]
    return segment_regions(channels, region, choice, spacing=(1, 1, 1), labels=first)


def _score(name: str, result: Regions, truth: I32) -> dict[str, Any]:
    """Mean Dice of the true regions, each with the region found in most of it."""
    label = result.region[..., 0]
    scores = []
    for number in np.unique(truth):
        major = np.bincount(label[truth == number]).argmax()
        scores.append(dice(label == major, truth == number))
    return {
        "name": name,
        "dice": float(np.mean(scores)),
        "iterations": int(result.iterations.max()),
        "first_energy": float(result.energy[0]),
        "last_energy": float(result.energy[-1]),
    }


def _panels(
    pictures: Sequence[tuple[str, F64, NDArray[Any] | None]],
) -> Figure:
    """Pictures side by side; a third entry is a map whose borders are drawn in red."""
    figure = Figure(figsize=(2.7 * len(pictures), 3.0), layout="constrained")
    row = figure.subplots(1, len(pictures), squeeze=False)[0]
    for axes, (title, picture, border) in zip(row, pictures, strict=True):
        shown = np.clip(picture, 0, 1) if picture.ndim == 3 else picture
        axes.imshow(np.swapaxes(shown, 0, 1), origin="lower", cmap="gray")
        if border is not None:
            for number in np.unique(border):
                axes.contour((border == number).T, levels=[0.5], colors="#D55E00", linewidths=1.1)
        axes.set_title(title, fontsize=10)
        axes.set_axis_off()
    return figure


def _blob(n: int) -> I32:
    x, y = _grid(n)
    angle = np.arctan2(y, x)
    return (np.hypot(x, y) < 0.55 + 0.15 * np.cos(3 * angle)).astype(np.int32)


def _two_regions(n: int) -> tuple[list[dict[str, Any]], Figure, str]:
    truth = _blob(n)
    image = _noisy(0.25 + 0.5 * truth, 0.15)
    start = _segment(image, _choice(start="circles", mu=0.1, iterations=1))
    result = _segment(image, _choice(start="circles", mu=0.1))
    figure = _panels(
        [
            ("circles at the start", image, start.region[..., 0]),
            ("contour at the end", image, result.region[..., 0]),
        ]
    )
    text = "Two regions from a grid of circles, as in figure 3.2; noise of 0.3 of the contrast."
    return [_score("two regions", result, truth)], figure, text


def _length(n: int) -> tuple[list[dict[str, Any]], Figure, str]:
    x, y = _grid(n)
    dots = np.zeros((n, n), bool)
    for a in np.linspace(-0.4, 0.4, 4):
        for b in np.linspace(-0.4, 0.4, 4):
            dots |= np.hypot(x - a, y - b) < 0.045
    large = (np.hypot(x, y) < 0.8).astype(np.int32)
    detail = np.where(dots, 0, large).astype(np.int32)
    image = _noisy(0.2 + 0.6 * detail, 0.08)
    cases, panels = [], []
    for mu, truth, name in ((0.01, detail, "small"), (1.0, large, "large")):
        result = _segment(image, _choice(start="labels", mu=mu), np.hypot(x, y) < 0.9)
        cases.append(_score(f"{name} length weight, mu = {mu:g}", result, truth))
        panels.append((f"μ = {mu:g}", image, result.region[..., 0]))
    text = (
        "Weight of the length, as in figure 3.3, from a circle around everything: with the larger "
        "one the dots are left out."
    )
    return cases, _panels(panels), text


def _area(n: int) -> tuple[list[dict[str, Any]], Figure, str]:
    x, y = _grid(n)
    truth = (np.hypot(x, y) < 0.5).astype(np.int32)
    image = _noisy(np.clip(1.2 - np.hypot(x, y), 0.0, 1.0), 0.05)
    cases, panels = [], []
    for nu in (-0.1, 0.0, 0.1):
        result = _segment(image, _choice(mu=0.02, nu=nu))
        label = result.region[..., 0]
        case = _score(f"area weight, nu = {nu:g}", result, truth)
        case["area"] = int((label == 1).sum())
        del case["dice"]  # a gradient has no true contour
        cases.append(case)
        panels.append((f"ν = {nu:g}: {case['area']} pixels", image, label))
    text = "Weight of the area inside, as in figure 3.4, on a disc that fades outwards."
    return cases, _panels(panels), text


def _five_regions(n: int) -> tuple[list[dict[str, Any]], Figure, str]:
    x, y = _grid(n)
    sector = 1 + (x > 0) + 2 * (y > 0.2 * x)
    truth = np.where(np.hypot(x, y) < 0.75, sector, 0).astype(np.int32)
    image = _noisy(truth / 4.0, 0.06)
    result = _segment(image, _choice(regions=5, mu=0.02))
    panels = [("contours", image, result.region[..., 0])]
    panels += [
        (f"level set {k + 1}", image, (result.phi[..., 0, k] > 0).astype(int))
        for k in range(result.phi.shape[3])
    ]
    text = "Five regions with triple junctions by three level sets, as in figure 3.6."
    return [_score("five regions", result, truth)], _panels(panels), text


def _colours(n: int) -> tuple[list[dict[str, Any]], Figure, str]:
    x, y = _grid(n)
    truth = np.where(np.hypot(x + 0.2, y) < 0.5, 1, 0)
    truth = np.where((np.abs(x - 0.4) < 0.35) & (np.abs(y) < 0.6), 2, truth).astype(np.int32)
    colours = np.array([[0.2, 0.25, 0.65], [0.75, 0.25, 0.2], [0.2, 0.65, 0.2]])
    image = _noisy(colours[truth], 0.1)
    result = _segment(image, _choice(regions=3, mu=0.02))
    figure = _panels(
        [("image", image, None), ("contours", image, result.region[..., 0])]
        + [(f"channel {name}", image[..., k], None) for k, name in enumerate("RGB")]
    )
    text = "Three regions by two level sets on three channels, as in figure 3.8."
    return [_score("three regions in colours", result, truth)], figure, text


def _bias(n: int) -> tuple[list[dict[str, Any]], Figure, str]:
    del n  # the phantom has its own size
    phantom = make_phantom(bias=0.6)
    image, mask = phantom.anatomy, body_mask(phantom.anatomy)
    found = clustered_bias(image.data, mask, spacing=image.spacing, regions=2)
    truth = phantom.bias.data
    cases: list[dict[str, Any]] = [
        {
            "name": "bias field by level sets",
            "correlation": float(np.corrcoef(found.field[mask], truth[mask])[0, 1]),
            "iterations": len(found.energy),
            "first_energy": float(found.energy[0]),
            "last_energy": float(found.energy[-1]),
        }
    ]
    k = mask.shape[2] // 2
    body = np.where(mask, 1.0, np.nan)
    figure = _panels(
        [
            ("image", image.data[..., k], None),
            ("true field", (truth * body)[..., k], None),
            ("field found", (found.field * body)[..., k], None),
            ("image corrected", (image.data / found.field)[..., k], None),
        ]
    )
    return cases, figure, "Bias field of the phantom, as in figure 3.9."


def _misfit(n: int) -> tuple[list[dict[str, Any]], Figure, str]:
    """Figures 4.2 to 4.4: grey values and fibers of a slice of touching muscles in eight regions.

    Grey values and fibers from 0 to 255 as there: channels of the size of one need 255^2 as much.
    """
    del n  # the phantom has its own size
    phantom = make_phantom((96, 96, 3), (1.25, 1.25, 30.0), septum=0, growth=15, bias=0.0)
    anatomy, tensor = (
        Image(image.data[:, :, [1]], image.affine) for image in (phantom.anatomy, phantom.tensor)
    )
    everywhere = np.ones(anatomy.data.shape, bool)
    body = body_mask(phantom.anatomy)[:, :, [1]]
    grey = scaled_values(anatomy, everywhere)[..., np.newaxis]
    channels = np.concatenate([grey, fiber_channels(tensor, body, "aligned")], axis=-1)
    truth = phantom.truth.data[:, :, 1]
    cases: list[dict[str, Any]] = []
    panels: list[tuple[str, F64, NDArray[Any] | None]] = []
    for start, weight in product(("circles", "kmeans"), (0.02, 2.0)):
        choice = _choice(start=start, regions=8, mu=1.0, lambdas=(weight * 255.0**2,))
        result = segment_regions(
            channels,
            body,
            choice,
            spacing=(1, 1, 1),
            channel_weights=(0.25,) * 4,
        )
        label = result.region[..., 0]
        pieces, grouped = _grouped(label, truth)
        cases.append(
            {
                "name": f"weight of the misfit, lambda = {weight:g}, {start}",
                "pieces": pieces,
                "grouped": float(np.mean([dice(grouped == m, truth == m) for m in range(1, 7)])),
                "iterations": int(result.iterations.max()),
                "first_energy": float(result.energy[0]),
                "last_energy": float(result.energy[-1]),
            }
        )
        panels.append((f"{start}, λ = {weight:g}: {pieces} pieces", grey[:, :, 0, 0], label))
    panels.append(("the six muscles", grey[:, :, 0, 0], truth))
    text = (
        "Weight of the misfit, as in figures 4.2 and 4.3, from circles and from clusters, and the "
        "truth (figure 4.4 has outlines by hand). From circles a larger weight makes more "
        "homogeneous pieces, as there, to be grouped to muscles; clusters are homogeneous already."
    )
    return cases, _panels(panels), text


def _grouped(label: NDArray[Any], truth: NDArray[Any]) -> tuple[int, I32]:
    """Number of connected parts that are no specks, and the true label of most of each part."""
    count, grouped = 0, np.zeros(label.shape, np.int32)
    for number in np.unique(label[label >= 0]):
        parts, found = ndimage.label(label == number)
        for part in range(1, found + 1):
            here = parts == part
            count += int(here.sum() >= _PIECE)
            grouped[here] = np.bincount(truth[here]).argmax()
    return count, grouped


def _timing(size: int) -> dict[str, Any]:
    """Two regions on a phantom's slice: time and energy of ours and of scikit-image.

    The slice is noisy: without noise the threshold that both start from has the least
    energy already. Ours is timed from the image to the labels,
    `chan_vese` from the level set that ours starts from.
    """
    field = 120.0 / size
    phantom = make_phantom((size, size, 3), (field, field, 6.0), bias=0.0)
    image = Image(phantom.anatomy.data[:, :, [1]], phantom.anatomy.affine)
    clean = np.clip(scaled_values(image, np.ones(image.data.shape, bool)), 0.0, 1.0)[..., 0]
    truth = (phantom.truth.data[:, :, 1] == 0) & (clean > 0.6)
    values, mu = _noisy(clean, 0.1), 0.05
    runs: list[dict[str, Any]] = []

    def note(name: str, found: tuple[float, Mask], iterations: int) -> None:
        seconds, inside = found
        if (inside & truth).sum() < (~inside & truth).sum():
            inside = ~inside
        energies = [chan_vese_energy(values, inside, mu, sided) for sided in (False, True)]
        runs.append(
            {"name": name, "iterations": iterations, "seconds": seconds, "energy": energies[0]}
            | {"one_sided_energy": energies[1], "dice": dice(inside, truth)}
        )

    for limit in (1, 2, 3, 5, 10, 20, 40, 300):
        choice = _choice(mu=mu, start="otsu", epsilon=0.1, iterations=limit)
        seconds, result = _fastest(partial(_segment, values, choice))
        note("MyoRK", (seconds, result.region[..., 0] == 1), int(result.iterations[0]))
        if result.iterations[0] < limit:
            # it has ended by itself: a larger limit is the same run
            break
    ours = list(runs)
    try:
        rival = import_module("skimage.segmentation").chan_vese
    except ImportError:
        return {"size": size, "mu": mu, "runs": runs}
    start = _threshold_start(values)
    for limit in (10, 50, 100, 200, 500):
        keys = {"mu": mu, "tol": 0.0, "max_num_iter": limit, "init_level_set": start}
        note("scikit-image chan_vese", _fastest(partial(rival, values, **keys)), limit)
        enough = [run["seconds"] for run in ours if _not_above(run, runs[-1])]
        runs[-1]["ratio"] = runs[-1]["seconds"] / enough[0] if enough else None
    return {"size": size, "mu": mu, "runs": runs}


def _threshold_start(values: F64) -> F64:
    """Level set that a segmentation of a slice starts from with `start="otsu"`."""
    everywhere = np.ones((*values.shape, 1), bool)
    regions = threshold_regions(values[..., None], everywhere)
    return level_sets_of(regions, 2, volume=False)[..., 0, 0]


def _fastest(work: Callable[[], Any], times: int = 3) -> tuple[float, Any]:
    """Shortest time of a few runs, and the result."""
    seconds = []
    for _ in range(times):
        start = perf_counter()
        result = work()
        seconds.append(perf_counter() - start)
    return min(seconds), result


def _not_above(run: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether no energy of a run is above that of another."""
    return all(run[key] <= other[key] for key in ("energy", "one_sided_energy"))
