"""Masks that Dafne writes: a NumPy archive with an array for each region of interest.

They have no grid: rows run from anterior to posterior, columns from right to left as on the screen,
slices upwards, as Dafne shows axial images; the image they were drawn in says where that is.
"""

from pathlib import Path

import numpy as np

from myork.errors import FileError, InputError
from myork.records import Image, Labels
from myork.types import F64


def read_rois(path: Path, like: Image | Labels | None) -> Labels:
    """Masks of Dafne as a label map, in alphabetical order of their names.

    - `path`: archive (.npz): for each region a mask of shape `(nrow, ncolumn, nslice)`, or of a
      single slice without the last axis
    - `like`: image that they were drawn in
    - returns on the grid of the image; where masks overlap the later name
    """
    if like is None:
        raise InputError(
            f"{path}: masks of Dafne have no grid; bring them onto that of their image before: "
            f"myork resample {path.name} IMAGE -o labels.nii.gz"
        )
    try:
        with np.load(path, allow_pickle=False) as archive:
            masks = {name: np.atleast_3d(archive[name]) for name in sorted(archive.files)}
    except Exception as reason:  # for each kind of damage NumPy raises another
        raise FileError(f"{path}: is not a readable NumPy archive: {reason}") from None
    order, flipped = _screen(like.affine)
    shape = tuple(like.data.shape[axis] for axis in order)
    wrong = [name for name, mask in masks.items() if mask.shape != (shape[1], shape[0], shape[2])]
    if wrong or not masks:
        what = f"mask {wrong[0]} has shape {masks[wrong[0]].shape}" if wrong else "holds no mask"
        raise InputError(
            f"{path}: {what}; rows, columns and slices of {like.name} are "
            f"{(shape[1], shape[0], shape[2])}: give the image that they were drawn in"
        )
    data = np.zeros(shape, np.int32)
    for number, mask in enumerate(masks.values(), start=1):
        data[np.swapaxes(mask, 0, 1) > 0] = number
    stored = np.flip(np.transpose(data, np.argsort(order)), tuple(flipped))
    return Labels(stored, like.affine, dict(enumerate(masks, start=1)), str(path))


def _screen(affine: F64) -> tuple[list[int], list[int]]:
    """Voxel axes that run to the left, backwards and upwards, and which of them do it reversed."""
    directions = affine[:3, :3] / np.linalg.norm(affine[:3, :3], axis=0)
    order: list[int] = []
    for axis in range(3):
        free = [column for column in range(3) if column not in order]
        order.append(max(free, key=lambda column: abs(float(directions[axis, column]))))
    ways = zip(range(3), order, (-1.0, -1.0, 1.0), strict=True)
    return order, [column for axis, column, sign in ways if directions[axis, column] * sign < 0]
