"""Images resampled onto the grid of another image in the same world frame.

Where both grids have the same voxels in another order, values are only reordered. Otherwise labels
take the nearest voxel, scalars are interpolated linearly, tensors by their components in the world
frame, and fibers, which have no sign, by their dyads.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from myork.errors import InputError
from myork.imaging.diffusion import dyads_of, known_tensors, lead_vector, unit_vectors
from myork.imaging.geometry import Grid, corner_distance, corners, reordered, same_grid
from myork.records import Image, Labels
from myork.types import F64, Mask

#: Ways to resample values
WAYS = ("nearest", "linear", "tensor-wise")
# Labels that lose more of their volume than this are reported.
_LOST = 0.05
# Part of a label beyond an image from which on it is reported.
_BEYOND = 0.01


class Move(NamedTuple):
    """Record of how an image was brought onto a grid."""

    file: str  #: Name of the image
    how: str  #: `reordered`, or one of `WAYS`
    shift: float  #: Largest distance between the corners of both grids, axes in the same order [mm]
    said: str  #: A sentence for the log
    doubts: tuple[str, ...] = ()  #: Warnings


def on_grid(image: Grid, like: Image | Labels, way: str = "") -> tuple[Grid, Move | None]:
    """Bring an image onto the grid of another one.

    - `image`: values, shape `(ni, nj, nk)` or `(ni, nj, nk, nvalue)`
    - `like`: gives the grid
    - `way`: one of `WAYS`; by default `nearest` for labels and `linear` for images. With
      `tensor-wise` six values are a tensor and three a fiber, both in the world frame.
    - returns the image, 0 where it does not reach, and a record of the move; None where both grids
      are equal
    - raises InputError: the images do not overlap
    """
    if same_grid(image, like):
        return image, None
    turned = reordered(image, like.affine)
    shift = corner_distance(turned, like)
    if same_grid(turned, like):
        text = f"{image.name}: voxels put in the order of {like.name}"
        return turned, Move(image.name, "reordered", shift, text)
    way = way or ("nearest" if isinstance(image, Labels) else "linear")
    reach = _sampled(np.ones(turned.data.shape[:3], np.int8), turned, like, 0) > 0
    if not reach.any():
        raise InputError(
            f"{image.name} and {like.name} do not overlap: the first reaches {_extent(image)}, the "
            f"other {_extent(like)} mm; take images of one session, register the first to the "
            "other, or correct the geometry (sform, qform) of its header"
        )
    moved = replace(turned, data=_values(turned, like, way), affine=like.affine)
    said = (
        f"{image.name}: resampled onto the grid of {like.name} ({way}); corners of the grids are "
        f"up to {shift:.3g} mm apart, {100.0 * reach.mean():.3g} % of the grid lies in the image"
    )
    doubts = []
    if image.data.shape[:3] == like.data.shape[:3]:
        doubts.append(
            f"{image.name} and {like.name} have the same number of voxels, {like.data.shape[:3]}, "
            "but in different places: check whether one of the headers is wrong"
        )
    if isinstance(image, Labels) and isinstance(moved, Labels):
        doubts += _lost(image, moved)
    elif isinstance(like, Labels):
        doubts += _beyond(image, like, ~reach)
    return moved, Move(image.name, way, shift, said, tuple(doubts))


def _values(image: Image | Labels, like: Image | Labels, way: str) -> NDArray[Any]:
    """Values of an image at the voxels of another one."""
    data = image.data
    if way == "tensor-wise":
        return _tensors(image, like)
    volumes = np.moveaxis(data.reshape(*data.shape[:3], -1), -1, 0)
    if way == "nearest":
        found = [_sampled(one, image, like, 0) for one in volumes]
    else:
        found = [_mean(one[..., np.newaxis], np.isfinite(one), image, like) for one in volumes]
    return np.stack(found, axis=-1).reshape(*like.data.shape[:3], *data.shape[3:])


def _tensors(image: Image | Labels, like: Image | Labels) -> F64:
    """Tensors at the voxels of another image, or fibers by their dyads."""
    data = np.asarray(image.data, float)
    if data.shape[3:] == (6,):
        return _mean(data, known_tensors(data), image, like)
    if data.shape[3:] != (3,):
        raise InputError(
            f"{image.name}: tensors have six values per voxel and fibers three, this image has "
            f"shape {data.shape}"
        )
    unit, known = unit_vectors(data)
    mean = _mean(dyads_of(unit), known, image, like)
    some = mean.any(axis=-1)
    fibers = np.zeros((*some.shape, 3))
    fibers[some] = lead_vector(mean[some])
    return fibers


def _mean(data: F64, known: Mask, image: Image | Labels, like: Image | Labels) -> F64:
    """Linear means of known values, shape `(ni, nj, nk, nvalue)`; 0 if the nearest is unknown."""
    some = _sampled(known.astype(np.int8), image, like, 0) > 0
    weight = _sampled(known.astype(float), image, like, 1)
    found = np.zeros((*weight.shape, data.shape[3]))
    for k in range(data.shape[3]):
        sums = _sampled(np.where(known, data[..., k], 0.0), image, like, 1)
        found[some, k] = sums[some] / weight[some]
    return found


def _sampled(data: NDArray[Any], image: Image | Labels, like: Image | Labels, order: int) -> Any:
    """A volume of an image at the voxels of another one, 0 beyond the image."""
    to_own = np.linalg.inv(image.affine) @ like.affine
    return ndimage.affine_transform(
        data, to_own[:3, :3], to_own[:3, 3], like.data.shape[:3], order=order, mode="grid-constant"
    )


def _extent(image: Image | Labels) -> str:
    """Bounding box of the corners of an image in the world [mm]."""
    ends = zip("xyz", corners(image).min(axis=0), corners(image).max(axis=0), strict=True)
    return ", ".join(f"{axis} {low:.4g} to {high:.4g}" for axis, low, high in ends)


def _beyond(image: Grid, labels: Labels, outside: Mask) -> list[str]:
    """Sentence about labels that an image does not cover."""
    parts = {
        name: float(outside[labels.data == number].mean())
        for number, name in labels.present.items()
    }
    said = [f"{100.0 * part:.0f} % of {name}" for name, part in parts.items() if part > _BEYOND]
    return [f"{image.name}: has no value, taken as 0, in {', '.join(said)}"] if said else []


def _lost(before: Labels, after: Labels) -> list[str]:
    """Sentences about labels that the grid contains only in part, or not at all."""
    volume = [float((one.data > 0).sum() * one.spacing.prod()) for one in (before, after)]
    kept = after.present
    gone = [name for number, name in before.present.items() if number not in kept]
    said = []
    if gone:
        said.append(f"{before.name}: no voxel of the grid lies in {', '.join(gone)}")
    if volume[1] < (1.0 - _LOST) * volume[0]:
        said.append(
            f"{before.name}: its labels fill {volume[0] / 1000:.4g} cm^3, and "
            f"{volume[1] / 1000:.4g} cm^3 on the grid: the rest lies beyond it, or is thinner than "
            "its voxels"
        )
    return said
