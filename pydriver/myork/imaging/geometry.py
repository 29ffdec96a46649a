"""Grids of images: checks of the affine, equality of grids, reorientation to the world axes."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import nibabel
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from myork.errors import InputError
from myork.records import Image, Labels, check_regular
from myork.types import F64, I32, I64, Index, Mask

Grid = TypeVar("Grid", Image, Labels)

# An affine is stored in single precision; spacings and angles are compared with this tolerance.
SLACK = 1e-4

# From voxels of a microscope to those of a whale [mm]; a header in another unit lies outside.
_VOXEL = (1e-4, 1e3)
# Ratio of length to width from which on voxels are those of slices.
_THICKER = 1.1
# Distance from the scanner's centre beyond which single precision does not resolve voxels [mm].
_FARTHEST = 1e6


def check_affine(affine: F64, name: str) -> None:
    """Refuse an affine whose voxels are not rectangular boxes.

    - `affine`: voxel indices to world coordinates, shape `(4, 4)` [mm]
    """
    check_regular(affine, name)
    columns = affine[:3, :3]
    size = np.linalg.norm(columns, axis=0)
    if size.min() < _VOXEL[0] or size.max() > _VOXEL[1] or np.abs(affine[:3, 3]).max() > _FARTHEST:
        raise InputError(
            f"{name}: the affine is implausible (voxel size {size} mm, first voxel at "
            f"{affine[:3, 3]} mm); check the unit of length and set sform or qform from the "
            "scanner's geometry"
        )
    cosines = (columns / size).T @ (columns / size) - np.eye(3)
    if np.abs(cosines).max() > 10 * SLACK:
        raise InputError(
            f"{name}: the voxel axes are not perpendicular (largest cosine "
            f"{np.abs(cosines).max():.3g}); resample the image to a grid without shear, "
            "or set sform or qform from the scanner's geometry"
        )


def corners(image: Image | Labels) -> F64:
    """World coordinates of the centres of the corner voxels, shape `(8, 3)` [mm]."""
    ends = [(0, n - 1) for n in image.data.shape[:3]]
    return image.world(np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(8, 3))


def corner_distance(image: Image | Labels, reference: Image | Labels) -> float:
    """Largest distance between corresponding corners of two grids with the same axis order [mm]."""
    return float(np.linalg.norm(corners(image) - corners(reference), axis=1).max())


def same_grid(image: Image | Labels, reference: Image | Labels) -> bool:
    """Whether voxels of two images have the same positions, to a tenth of a voxel."""
    alike = image.data.shape[:3] == reference.data.shape[:3]
    return alike and corner_distance(image, reference) <= 0.1 * reference.spacing.min()


def check_same_grid(image: Image | Labels, reference: Image | Labels) -> None:
    """Refuse two images that do not lie on one grid (shape and affine)."""
    shape, wanted = image.data.shape[:3], reference.data.shape[:3]
    if shape != wanted:
        raise InputError(
            f"{image.name} has {shape} voxels, {reference.name} has {wanted}; "
            "bring one onto the grid of the other with `myork resample`"
        )
    if not same_grid(image, reference):
        raise InputError(
            f"{image.name} and {reference.name} have different affines: their corners are up to "
            f"{corner_distance(image, reference):.3g} mm apart; bring one onto the grid of the "
            "other with `myork resample`"
        )


def canonical(image: Grid) -> Grid:
    """Reorder the voxel axes to follow the nearest world axes (right, anterior, superior).

    Only the order and the direction of the axes change, never a value: vectors and tensors in
    the world frame are unchanged.
    """
    return reordered(image, np.eye(4))


def reordered(image: Grid, affine: F64) -> Grid:
    """Put the voxel axes in the order and direction of the nearest axes of an affine."""
    own, wanted = (nibabel.orientations.io_orientation(one) for one in (image.affine, affine))
    order = nibabel.orientations.ornt_transform(own, wanted)
    data = nibabel.orientations.apply_orientation(image.data, order)
    turn = nibabel.orientations.inv_ornt_aff(order, image.data.shape[:3])
    return replace(image, data=np.ascontiguousarray(data), affine=image.affine @ turn)


def frame(affine: F64) -> F64:
    """Directions of the voxel axes in the world, as columns, shape `(3, 3)` [-].

    Exactly the identity where the axes agree with the world axes to the precision of the file.
    """
    columns = affine[:3, :3] / np.linalg.norm(affine[:3, :3], axis=0)
    if np.abs(columns - np.eye(3)).max() < SLACK:
        return np.eye(3)
    # The nearest rotation: the columns are perpendicular only to the precision of the file.
    left, _, right = np.linalg.svd(columns)
    return left @ right


def to_voxels(affine: F64, world: F64) -> F64:
    """World coordinates to voxel indices, both of shape `(..., 3)`."""
    return (world - affine[:3, 3]) @ np.linalg.inv(affine[:3, :3]).T


def seed_voxel(image: Image, seed: F64, name: str) -> tuple[int, ...]:
    """Voxel that contains a seed; a seed outside the image is refused.

    - `seed`: world coordinates, shape `(3,)` [mm]
    """
    place = tuple(np.rint(to_voxels(image.affine, seed)).astype(int).tolist())
    if min(place) < 0 or any(p >= n for p, n in zip(place, image.data.shape, strict=True)):
        raise InputError(
            f"{name} = {seed.tolist()} mm (voxel {place}) lies outside of {image.name}, which has "
            f"{image.data.shape} voxels"
        )
    return place


def slice_axis(spacing: F64, shape: Sequence[int] = ()) -> int:
    """Axis along which slices are stacked: that of a single slice, or of the longest voxel edge.

    - `spacing`: voxel sizes, shape `(3,)` [mm]; if none is a tenth longer than both others, the
      last axis is taken
    - `shape`: numbers of voxels, shape `(3,)`
    """
    single = [axis for axis, count in enumerate(shape) if count == 1]
    if single:
        return max(single, key=lambda axis: float(spacing[axis]) * (1.0 + 1e-6 * axis))
    order = np.argsort(spacing)
    return int(order[2]) if spacing[order[2]] > _THICKER * spacing[order[1]] else 2


def with_axis_at(image: Grid, source: int, target: int) -> Grid:
    """Move a voxel axis to another place in the order; world positions do not change.

    - `image`: values, shape `(ni, nj, nk)` or `(ni, nj, nk, nvalue)`
    - `source`, `target`: place of the axis before and after, 0 to 2
    """
    if source == target:
        return image
    affine = image.affine.copy()
    affine[:, target] = image.affine[:, source]
    affine[:, np.delete(np.arange(3), target)] = np.delete(image.affine[:, :3], source, axis=1)
    data = np.ascontiguousarray(np.moveaxis(image.data, source, target))
    return replace(image, data=data, affine=affine)


def boxes_of(labels: I32) -> Iterator[tuple[tuple[slice, ...], Mask]]:
    """Bounding box of each label above zero, and the mask of the label in it."""
    for number, box in enumerate(ndimage.find_objects(labels), start=1):
        if box is not None:
            yield box, labels[box] == number


def neighbours(inside: Mask, axis: int, step: int = 1) -> tuple[I64, I64]:
    """Pairs of voxels of a mask that lie `step` voxels apart along an axis.

    - returns the numbers of both in the order of the mask's voxels, the lower one first
    """
    number = np.full(inside.shape, -1)
    number[inside] = np.arange(int(inside.sum()))
    count = inside.shape[axis] - step
    low, high = (np.take(number, np.arange(count) + first, axis) for first in (0, step))
    both = (low >= 0) & (high >= 0)
    return low[both], high[both]


def depth_in_slices(inside: Mask, pixel: ArrayLike = 1.0, *, cut: bool = False) -> F64:
    """Distance of voxels to the outside within their slice.

    - `inside`: shape `(ni, nj, nk)`; slices along the last axis
    - `pixel`: sizes of the pixels, shape `(2,)`
    - `cut`: whether parts at the border continue beyond it; otherwise the outside begins there
    """
    room = [(1, 1), (1, 1), (0, 0)]
    wide = np.moveaxis(np.pad(inside, room, mode="edge" if cut else "constant"), 2, 0)
    found = [ndimage.distance_transform_edt(section, sampling=pixel) for section in wide]
    return np.stack(found, axis=2)[1:-1, 1:-1]


def block_sums(values: NDArray[Any], block: Index) -> NDArray[Any]:
    """Sums of values over blocks of voxels; the grid consists of whole blocks in each direction."""
    n = np.array(values.shape) // block
    return values.reshape(n[0], block[0], n[1], block[1], n[2], block[2]).sum(axis=(1, 3, 5))


def length_factor(unit: str, key: str = "units.length") -> float:
    """Factor from millimetres to the unit of length given by a key of the deck."""
    factors = {"mm": 1.0, "cm": 0.1, "m": 0.001}
    if unit not in factors:
        raise InputError(
            f"{key} = '{unit}': images need one of {', '.join(factors)} to be converted to"
        )
    return factors[unit]
