"""Parts of labels in each voxel: written beside a label map by `segment`, read by `build`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import ndimage

from myork.errors import InputError
from myork.imaging.geometry import check_same_grid
from myork.imaging.io import read_image, write_image
from myork.records import Image, Labels
from myork.segmentation.partial import label_parts
from myork.types import F64, I32

__all__ = ["checked_parts", "read_parts", "write_parts"]


# Parts are written in single precision.
_SLACK = 1e-3


def write_parts(
    path: Path, labels: Labels, kinds: I32, values: F64, unmixed: Sequence[int] = ()
) -> dict[str, float]:
    """Write the parts of all labels, one volume each in ascending order; voxels each label fills.

    Parameters
    ----------
    path : Path
        File to write.
    labels : Labels
        Shape `(ni, nj, nk)`.
    kinds : NDArray
        Numbers below one of what has no label, as `label_parts` takes them, same shape.
    values : NDArray
        Grey values without shading, shape `(ni, nj, nk, nchannel)`.
    unmixed : sequence
        As of `label_parts`.
    """
    everything = np.where(labels.data > 0, labels.data, kinds)
    parts = label_parts(everything, values, labels.spacing, unmixed)
    write_image(path, Image(parts, labels.affine))
    numbers = np.unique(labels.data[labels.data > 0]).tolist()
    filled = parts.sum(axis=(0, 1, 2)).tolist()
    return {labels.label_name(n): f for n, f in zip(numbers, filled, strict=True)}


def read_parts(path: Path, labels: Labels) -> Image:
    """Read the parts of the labels of a map, one volume each in ascending order.

    Parameters
    ----------
    path : Path
        4-D image.
    labels : Labels
        Label map whose labels above zero the volumes are of.
    """
    image = read_image(path, values=None)
    if image.data.ndim == 3:
        image = Image(image.data[..., np.newaxis], image.affine, image.name)
    return checked_parts(image, labels, str(path))


def checked_parts(image: Image, labels: Labels, name: str) -> Image:
    """Refuse parts that do not go with the labels of a map, or are none.

    Parameters
    ----------
    image : Image
        Shape `(ni, nj, nk, nlabel)`.
    labels : Labels
        Label map whose labels above zero the volumes are of.
    name : str
        Of the parts, for messages.
    """
    check_same_grid(image, labels)
    numbers = np.unique(labels.data[labels.data > 0]).tolist()
    if image.data.shape[3] != len(numbers):
        raise InputError(
            f"{name}: {image.data.shape[3]} volumes do not go with the labels {numbers} of "
            f"{labels.name}; give one volume for each, in ascending order"
        )
    # a comparison with what is no number is false
    whole = image.data.sum(axis=3)
    fine = (image.data >= -_SLACK).all(axis=3) & (whole <= 1.0 + _SLACK)
    if not fine.all():
        at = tuple(np.argwhere(~fine)[0].tolist())
        raise InputError(
            f"{name}: parts of labels must be 0 at least and their sum 1 at most, but in "
            f"{int((~fine).sum())} voxels they are not, first in {at}: {image.data[at].tolist()}"
        )
    # Parts differ from labels along borders; labels that were changed afterwards have none inside.
    places = np.searchsorted(numbers, np.maximum(labels.data, numbers[0]))[..., np.newaxis]
    own = np.where(
        labels.data > 0, np.take_along_axis(image.data, places, axis=3)[..., 0], 1.0 - whole
    )
    low, high = (one(labels.data, 3) for one in (ndimage.minimum_filter, ndimage.maximum_filter))
    lost = (low == high) & (own <= _SLACK)
    if lost.any():
        raise InputError(
            f"{name}: {int(lost.sum())} voxels that all their neighbours share the label of in "
            f"{labels.name} hold none of it, first {tuple(np.argwhere(lost)[0].tolist())}: these "
            "are the parts of other labels; make them of these, or take the file away"
        )
    return Image(np.maximum(image.data, 0.0), image.affine, image.name)
