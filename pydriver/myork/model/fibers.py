"""Fiber directions: from diffusion tensors to voxels, from voxels to points.

A direction and its opposite are the same fiber, so vectors are never averaged directly: tensors are
averaged by their logarithms, vectors by their dyads, and the lead eigenvector of the average is
the fiber.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from myork.errors import InputError
from myork.imaging.diffusion import dyads_of, lead_vector, unit_vectors
from myork.imaging.geometry import frame
from myork.imaging.resampling import on_grid
from myork.model.averaging import (
    LEAST_WEIGHT,
    best_average,
    gathered,
    label_fibers,
    tensor_logarithms,
    tensor_trust,
)
from myork.model.orientation import Finding, check_orientation
from myork.records import Image, Labels
from myork.types import F64, I32, Mask


class FiberField(NamedTuple):
    """Fibers of a tissue."""

    #: Unit vectors in the world frame, zero outside of the tissue, shape `(ni, nj, nk, 3)`
    fibers: Image
    #: Voxels whose own tensor was unusable (not finite or not positive) and replaced by the average
    #: around them
    filled: int
    #: Voxels without usable data within reach of the average, or outside the tensor image; they
    #: took the average at the nearest voxel that has one
    far: int
    distance: float  #: Largest distance to such a voxel [mm]
    smoothing: float  #: Standard deviation of the average [mm]
    axes: Finding = Finding([], "", "")  #: Evidence of the fibers of labels on the gradient axes

    def doubts(self) -> list[str]:
        """Warnings about wrong gradient axes, and about fibers not taken from their own tensors."""
        sentences = [self.axes.doubt] if self.axes.doubt else []
        if self.filled:
            sentences.append(
                f"{self.filled} tensors of the tissue are not finite or not positive; "
                "the mean of their neighbours replaces them"
            )
        if self.far:
            sentences.append(
                f"{self.far} voxels have no usable tensor around them; they have the fiber of "
                f"the nearest voxel with one, up to {self.distance:.3g} mm away"
            )
        return sentences


def fiber_field(tensor: Image, tissue: NDArray[Any], smoothing: float | None) -> FiberField:
    """Fiber vector of every voxel of a tissue, zero elsewhere.

    - `tensor`: components xx, yy, zz, xy, xz, yz in the world frame, shape `(ni, nj, nk, 6)` [any
      unit]
    - `tissue`: voxels of the tissue (true, or the label of a muscle), shape `(ni, nj, nk)`; only
      those of one label are averaged, so that fibers keep their direction up to the border
    - `smoothing`: standard deviation of the Gaussian weights of the log-Euclidean average [mm];
        None takes the one that predicts tensors best, within families of fibers, see `best_average`
    """
    label = np.asarray(tissue).astype(np.int32)
    inside = label != 0
    logarithm, usable = tensor_logarithms(tensor, inside)
    trust = tensor_trust(logarithm, usable, label)
    width = smoothing
    if width is None:
        label, width = best_average(logarithm, trust, label, tensor.spacing)
    fiber, known = label_fibers(logarithm, trust, label, width / tensor.spacing)
    if not inside.any():
        raise InputError(f"{tensor.name}: no voxel to find fibers in; check the mask or the labels")
    if not known.any():
        raise _no_fiber(
            tensor.name,
            int(inside.sum()),
            int(inside.sum()),
            np.argwhere(inside)[0],
            "diffusion tensor (all are zero, not finite or not positive)",
        )
    missing = inside & ~known
    away = _fill(fiber, known, label, tensor.spacing)
    return FiberField(
        Image(fiber, tensor.affine, "fibers"),
        int((inside & ~usable).sum()),
        int(missing.sum()),
        float(away[missing].max(initial=0.0)),
        width,
    )


def fibers_of_labels(
    tensor: Image, labels: Labels, smoothing: float | None, muscles: Labels | None = None
) -> FiberField:
    """Fibers of labels from tensors on any grid of the same world, on the grid of the labels.

    Tensors are averaged on the grid of their measurement: interpolated ones share their noise,
    which would determine the width of the average.

    - `tensor`, `smoothing`: as in `fiber_field`
    - `labels`: muscles
    - `muscles`: muscles whose walls and names are used to check the gradient axes, on the same
      grid; by default the labels
    """
    there, move = on_grid(labels, tensor)
    found = fiber_field(tensor, there.data, smoothing)
    if move is not None:
        inside = labels.data > 0
        fiber = on_grid(found.fibers, labels, "tensor-wise")[0].data * inside[..., np.newaxis]
        away = _fill(fiber, np.asarray(fiber.any(axis=-1)), labels.data, labels.spacing)
        # the rim of a label lies within a voxel of the tensors
        far = away > np.linalg.norm(tensor.spacing)
        found = found._replace(
            fibers=Image(fiber, labels.affine, found.fibers.name),
            far=found.far + int(far.sum()),
            distance=max(found.distance, float(away[far].max(initial=0.0))),
        )
    axes = check_orientation(found.fibers, muscles or labels, tensor.affine)
    return found._replace(axes=axes)


def _fill(fiber: F64, known: Mask, label: I32, spacing: F64) -> F64:
    """Give voxels without a fiber that of the nearest one, of their own label if possible.

    - `fiber`: changed in place, shape `(ni, nj, nk, 3)`
    - `known`: voxels that have a fiber, shape `(ni, nj, nk)`
    - `label`: labels, 0 outside the requested voxels, same shape
    - returns distance to that voxel, zero where a fiber was known, same shape [mm]
    """
    away = np.zeros(label.shape)
    for number in np.unique(label[(label != 0) & ~known]):
        own = label == number
        source, missing = own & known, own & ~known
        distance, nearest = ndimage.distance_transform_edt(
            ~(source if source.any() else known), sampling=spacing, return_indices=True
        )
        fiber[missing] = fiber[tuple(index[missing] for index in nearest)]
        away[missing] = distance[missing]
    return away


def fibers_at_points(
    fibers: Image, labels: Labels, place: F64, label: I32, block: Sequence[int]
) -> F64:
    """Fiber vectors at points, in the frame of the voxel axes.

    - `fibers`: vectors in the world frame, zero or not a number where unknown, on the grid of
      `labels`, shape `(ni, nj, nk, 3)`
    - `labels`: labels; only voxels of a point's own label count for it
    - `place`: voxel indices of the points, whole or between voxels, shape `(npoint, 3)`
    - `label`: labels of the points, shape `(npoint,)`
    - `block`: voxels per point in each direction, the length scale of the average
    - returns unit vectors, shape `(npoint, 3)`; zeros for a label without any fiber
    """
    unit, valid = unit_vectors(fibers.data)
    if not valid.any():
        raise InputError(f"{fibers.name}: contains no fiber: all vectors are zero or not finite")
    dyads = dyads_of(unit)
    result = np.zeros(place.shape)
    for number in np.unique(label):
        usable = (labels.data == number) & valid
        here = label == number
        if not usable.any():
            continue
        average, near = _averages(dyads, usable, place[here], block)
        known = near > LEAST_WEIGHT
        if not known.all():
            first = np.rint(place[here][~known][0]).astype(int)
            raise _no_fiber(
                f"{fibers.name}, {labels.label_name(int(number))}",
                int((~known).sum()),
                int(here.sum()),
                first,
                "fiber vector (all are zero or not finite)",
            )
        result[here] = lead_vector(average / near[:, np.newaxis])
    return result @ frame(fibers.affine)


def activation_at_points(
    image: Image, labels: Labels, place: F64, label: I32, block: Sequence[int]
) -> F64:
    """Fraction of their muscle's activation at points.

    - `image`: fractions from 0 to 1 on the grid of `labels`, shape `(ni, nj, nk)`
    - `labels`, `place`, `label`, `block`: as in `fibers_at_points`
    - returns shape `(npoint,)` [-]
    """
    bad = np.argwhere((labels.data > 0) & ~((image.data >= 0) & (image.data <= 1)))
    if len(bad):
        raise InputError(
            f"{image.name}: activation must lie between 0 and 1, but is "
            f"{image.data[tuple(bad[0])]:g} at voxel {tuple(bad[0].tolist())}"
        )
    result = np.zeros(len(place))
    for number in np.unique(label):
        here = label == number
        values, usable = image.data[..., np.newaxis], labels.data == number
        sums, near = _averages(values, usable, place[here], block)
        result[here] = np.clip(sums[:, 0] / np.maximum(near, LEAST_WEIGHT), 0.0, 1.0)
    return result


def _averages(values: F64, usable: Mask, place: F64, block: Sequence[int]) -> tuple[F64, F64]:
    """Sums of usable values around places, and of their weights, `(n, nvalue)` and `(n,)`."""
    some = np.where(usable[..., np.newaxis], values, 0.0)
    sums, weight = gathered(some, usable, 0.5 * np.array(block, float))
    near, *found = (
        ndimage.map_coordinates(one, place.T, order=1, mode="nearest")
        for one in (weight, *np.moveaxis(sums, -1, 0))
    )
    return np.stack(found, axis=-1), near


def _no_fiber(name: str, missing: int, total: int, voxel: NDArray, what: str) -> InputError:
    """Error for places without a usable neighbour."""
    return InputError(
        f"{name}: {missing} of {total} voxels have no usable {what} at or around them, the first "
        f"is voxel {tuple(voxel.tolist())}; repair the file, smooth more, or leave these voxels "
        "out of the label"
    )
