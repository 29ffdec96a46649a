"""Masks, maps, tensors and fibers on other grids of one world."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import nibabel
import numpy as np
from nibabel.processing import resample_from_to
from scipy import ndimage
from scipy.spatial.transform import Rotation

from benchmarks.truths.scanners import reordered
from myork.errors import MyorkError
from myork.imaging.diffusion import dyads_of, lead_vector
from myork.imaging.io import read_image, read_labels, write_image
from myork.records import Image
from myork.segmentation.scores import dice
from myork.stations.resample import resample
from myork.types import F64, I32

#: Numbers of the cases of each kind in a half
HALVES = {"tuned": range(10), "other": range(4000, 4010)}


class Body(NamedTuple):
    """Three muscles side by side in the world, as functions of the place."""

    bends: F64  #: Amplitudes of waves, shape `(4,)` [mm]
    lean: float  #: Largest angle of fibers to the axis [rad]

    def labels(self, x: F64) -> I32:
        """Labels 1 to 3 and 0 around them, at places of shape `(..., 3)` [mm]."""
        along = x[..., 2] / 40.0
        found = np.zeros(x.shape[:-1], np.int32)
        for label, away in enumerate((-24.0, 0.0, 24.0), start=1):
            across = np.hypot(
                (x[..., 0] - away - self.bends[0] * np.sin(along)) / 11.0,
                (x[..., 1] - self.bends[1] * np.cos(along + label)) / 17.0,
            )
            found[across < 1.0 - 0.1 * along**2] = label
        return found

    def fibers(self, x: F64) -> F64:
        """Unit vectors, shape `(..., 3)` [-]."""
        lean = self.lean * np.sin(x[..., 0] / 20.0 + x[..., 2] / 30.0)
        turn = x[..., 1] / 25.0 + self.bends[2]
        ways = np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)
        return np.stack(ways, axis=-1)

    def grey(self, x: F64) -> F64:
        """A slow function from 0 to 1, shape `(...)`."""
        return 0.5 + 0.5 * np.sin(x @ [0.06, 0.04, 0.02] + self.bends[3])


def grid(random: np.random.Generator, wide: float = 1.0, turned: bool = True) -> Image:
    """A grid that holds the body, of a size times `wide`, its axes in any order and direction."""
    pixel, thick = random.uniform(1.0, 2.0), random.uniform(3.0, 6.0)
    size = np.array([pixel, pixel, thick])
    shape = np.ceil(wide * np.array([96.0, 64.0, 90.0]) / size).astype(int)
    angles = random.uniform(-20.0, 20.0, 3) * turned
    order = random.permutation(3)
    columns = Rotation.from_euler("xyz", angles, degrees=True).as_matrix() * size
    columns = (columns * random.choice([-1.0, 1.0], 3))[:, order]
    affine = np.eye(4)
    affine[:3, :3] = columns
    affine[:3, 3] = random.uniform(-3.0, 3.0, 3) - columns @ (shape[order] - 1) / 2
    return Image(np.zeros(shape[order]), affine)


def places(image: Image) -> F64:
    """World coordinates of all voxels, shape `(ni, nj, nk, 3)` [mm]."""
    return image.world(np.moveaxis(np.indices(image.data.shape[:3]), 0, -1))


def shuffled(image: Image, random: np.random.Generator) -> Image:
    """The same voxels with their axes in another order and direction."""
    order = random.permutation(3)
    flips = np.flatnonzero(random.choice([-1, 1], 3) < 0)
    return reordered(image, order.tolist(), order[flips].tolist())


def save(path: Path, image: Image, random: np.random.Generator, masks: bool) -> None:
    """Write a file in single precision; masks as floats, or under the header of an image."""
    kind = random.choice(["f4", "f8", "spread"]) if masks else "f4"
    file = nibabel.Nifti1Image(image.data.astype(float), image.affine)
    file.set_data_dtype(np.int16 if kind == "spread" else kind)
    nibabel.save(file, path)


def grids(half: str) -> Iterator[tuple[str, ...]]:
    """Masks, maps, tensors and fibers on other grids of one world, by `myork resample`.

    Three bent muscles side by side, known as functions of position, drawn on grids of 1 to 2 mm
    and slices of 3 to 6 mm whose axes have any order and direction, turned against each other by
    up to 20 degrees about each axis; masks as floating point numbers or under the header of an
    image (whole numbers spread over all values of its type). Score on the other grid against the
    functions there: least Dice of the three, or mean error in the muscles, of all cases, the worst
    in brackets; beside it nibabel's `resample_from_to` (order 0 for masks, which are rounded, 1 for
    all else, each component by itself), and the array stretched to the size of the other grid,
    headers ignored. For images that do not overlap: how many are refused.
    """
    yield "what", "cases", "score", "`myork resample`", "nibabel", "array as it lies"
    with TemporaryDirectory() as folder:
        for place, (kind, (unit, measure)) in enumerate(KINDS.items()):
            rows = []
            for number in HALVES[half]:
                random = np.random.default_rng([place, number])
                rows.append(_moved(Path(folder), kind, measure, random))
            count = str(len(rows))
            if kind == "worlds apart":
                yield kind, count, unit, *(str(int(np.sum(one))) for one in np.transpose(rows))
                continue
            worst = np.min if unit == "Dice" else np.max
            shown = (f"{np.mean(one):.3g} ({worst(one):.3g})" for one in np.transpose(rows))
            yield kind, count, unit, *shown


def _dice(found: F64, body: Body, x: F64) -> float:
    true = body.labels(x)
    return min(dice(found == label, true == label) for label in (1, 2, 3))


def _off(found: F64, body: Body, x: F64) -> float:
    own = body.labels(x) > 0
    return float(100.0 * np.abs(found - body.grey(x))[own].mean())


def _angle(found: F64, body: Body, x: F64) -> float:
    own = body.labels(x) > 0
    vector = found[own]
    if vector.shape[-1] == 6:
        vector = lead_vector(vector)
    length = np.maximum(np.linalg.norm(vector, axis=-1), 1e-12)
    cosine = np.abs((vector * body.fibers(x)[own]).sum(axis=-1)) / length
    return float(np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0))).mean())


#: What is moved: unit of the score, and the score
KINDS: dict[str, tuple[str, Callable[[F64, Body, F64], float]]] = {
    "masks in float": ("Dice", _dice),
    "masks, voxels in another order": ("Dice", _dice),
    "masks on another grid": ("Dice", _dice),
    "a map on another grid": ("error [%]", _off),
    "tensors on another grid": ("angle [°]", _angle),
    "fibers of any sign on another grid": ("angle [°]", _angle),
    "worlds apart": ("refused", _dice),
}


def _moved(
    folder: Path, kind: str, measure: Callable[[F64, Body, F64], float], random: np.random.Generator
) -> list[float]:
    """Scores of ours, nibabel and the array as it lies."""
    body = Body(random.uniform(-5.0, 5.0, 4), random.uniform(0.2, 0.6))
    like, own = grid(random), grid(random, 1.6)
    if kind in ("masks in float", "masks, voxels in another order"):
        own = Image(like.data, like.affine)
    masks = kind.startswith("masks") or kind == "worlds apart"
    at, way, order = places(own), None, 0 if masks else 1
    if masks:
        own = Image(body.labels(at).astype(float), own.affine)
    elif kind.startswith("a map"):
        own = Image(body.grey(at), own.affine)
    else:
        fiber, way = body.fibers(at), "tensor-wise"
        if kind.startswith("tensors"):
            own = Image(1e-3 * (dyads_of(fiber) + [1, 1, 1, 0, 0, 0]), own.affine)
        else:
            sign = random.choice([-1.0, 1.0], (*fiber.shape[:3], 1))
            own = Image(fiber * sign, own.affine)
    if "order" in kind:
        own = shuffled(own, random)
    if kind == "worlds apart":
        own.affine[:3, 3] += 300.0 * random.choice([-1.0, 1.0], 3)
    paths = [folder / f"{name}.nii.gz" for name in ("own", "like", "out")]
    save(paths[0], own, random, masks)
    write_image(paths[1], like)
    refused = False
    try:
        resample(paths[0], paths[1], paths[2], way=way)
    except MyorkError:
        refused = True
    if kind == "worlds apart":
        return [refused, 0, 0]  # nibabel fills with zeros
    found = read_labels(paths[2]) if masks else read_image(paths[2], None)
    file: Any = nibabel.load(paths[0])
    raw = np.asarray(file.get_fdata())
    shape = like.data.shape
    volumes = np.moveaxis(raw.reshape(*raw.shape[:3], -1), -1, 0)
    theirs, lies = [], []
    for one in volumes:
        moved = resample_from_to(
            nibabel.Nifti1Image(one, file.affine), (shape, like.affine), order=order
        )
        theirs.append(np.asarray(moved.get_fdata()))
        lies.append(ndimage.zoom(one, np.divide(shape, one.shape), order=order, grid_mode=True,
                                 mode="nearest"))  # fmt: skip
    x, scores = places(like), []
    for one in (np.asarray(found.data, float), np.stack(theirs, -1), np.stack(lies, -1)):
        one = one[..., 0] if one.ndim == 4 and one.shape[3] == 1 else one
        scores.append(measure(np.rint(one) if masks else one, body, x))
    return scores
