"""The way from an image to a model on arrays, without decks or folders: for notebooks.

Arrays have the voxel axes i, j, k first; affines take voxel indices to world coordinates (right,
anterior, superior) in millimetres. Defaults are those of the decks' tables.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from myork.core.deck import load_deck
from myork.core.level_sets import evolve_level_sets
from myork.errors import InputError
from myork.imaging import diffusion
from myork.imaging.dixon import separate_images
from myork.imaging.gradients import GradientTable
from myork.model.cloud import build_cloud
from myork.model.fibers import fiber_field
from myork.model.shares import checked_parts
from myork.model.slices import finer_fibers, finer_labels, slice_parts
from myork.records import Image, Labels, PointCloud
from myork.segmentation.bias import check_positive
from myork.segmentation.images import Images, segment_images
from myork.segmentation.partial import label_parts
from myork.segmentation.regions import body_mask
from myork.segmentation.shading import shading
from myork.types import F64, I32, Mask

__all__ = [
    "build_points",
    "correct_bias",
    "fit_tensors",
    "mean_fibers",
    "parts_of_voxels",
    "resample",
    "segment",
    "water_and_fat",
]


def fit_tensors(dwi: ArrayLike, affine: ArrayLike, b: ArrayLike, directions: ArrayLike) -> F64:
    """Diffusion tensors by weighted least squares.

    Parameters
    ----------
    dwi : ArrayLike
        Diffusion-weighted images, shape `(ni, nj, nk, nvolume)`.
    affine : ArrayLike
        Shape `(4, 4)` [mm].
    b : ArrayLike
        Weighting of each volume, shape `(nvolume,)` [s/mm^2].
    directions : ArrayLike
        Gradients in the world frame, any where `b` is next to zero, shape `(nvolume, 3)`.

    Returns
    -------
    NDArray
        xx, yy, zz, xy, xz, yz in the world frame, shape `(ni, nj, nk, 6)` [mm^2/s].
    """
    image = _image(dwi, affine, 4)
    weights, vectors = np.asarray(b, float), np.asarray(directions, float)
    if vectors.shape != (image.data.shape[3], 3) or weights.shape != vectors.shape[:1]:
        raise InputError(
            f"{image.data.shape[3]} volumes need as many b values and directions, not "
            f"{weights.shape} and {vectors.shape}"
        )
    if not (np.isfinite(weights).all() and np.isfinite(vectors).all()):
        raise InputError("b values and directions are finite numbers; some of these are not")
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
    return diffusion.fit_tensors(image, GradientTable(weights, unit)).data


def mean_fibers(
    tensor: ArrayLike, affine: ArrayLike, labels: ArrayLike, smoothing: float | None = None
) -> F64:
    """Fibers of averaged tensors, label by label.

    Parameters
    ----------
    tensor : ArrayLike
        Components in the world frame, shape `(ni, nj, nk, 6)`.
    affine : ArrayLike
        Shape `(4, 4)` [mm].
    labels : ArrayLike
        Labels, or a mask, shape `(ni, nj, nk)`.
    smoothing : float, optional
        Width of the average [mm]; default the one that foretells tensors best.

    Returns
    -------
    NDArray
        Unit vectors in the world frame, zero outside of the labels, shape `(ni, nj, nk, 3)`.
    """
    image = _image(tensor, affine, 4)
    return fiber_field(image, _labels(labels, affine, image).data, smoothing).fibers.data


def correct_bias(
    image: ArrayLike, affine: ArrayLike, body: ArrayLike | None = None
) -> tuple[F64, F64, str]:
    """Image without the shading of the coils (`bias.method = "auto"`).

    Parameters
    ----------
    image : ArrayLike
        Shape `(ni, nj, nk)`.
    affine : ArrayLike
        Shape `(4, 4)` [mm].
    body : ArrayLike, optional
        Voxels that tell the field, same shape; default found by threshold.

    Returns
    -------
    tuple
        Corrected image, field, and why the field may be wrong (empty where starts agree).
    """
    grid = _image(image, affine, 3)
    mask = _body(grid, body)
    check_positive(grid, mask)
    found = shading(grid.data, mask, spacing=grid.spacing)
    return grid.data / found.field, found.field, found.doubt


def water_and_fat(
    magnitudes: Sequence[ArrayLike],
    phases: Sequence[ArrayLike],
    affine: ArrayLike,
    echo_times: Sequence[float] = (),
    field_strength: float = 0.0,
    body: ArrayLike | None = None,
) -> tuple[F64, F64, F64, str]:
    """Water and fat of two echoes (two-point Dixon).

    Parameters
    ----------
    magnitudes, phases : sequence of ArrayLike
        Of both echoes, shape `(ni, nj, nk)` each.
    affine : ArrayLike
        Shape `(4, 4)` [mm].
    echo_times : sequence, optional
        Shape `(2,)` [ms]; without them the first echo is in phase and the second in opposed phase.
    field_strength : float
        Of the scanner, with echo times [T].
    body : ArrayLike, optional
        Voxels of the body; default found by threshold.

    Returns
    -------
    tuple
        Water, fat, fraction of fat, and why they may be exchanged (empty where nothing speaks
        for it).
    """
    if len(magnitudes) != 2 or len(phases) != 2:
        raise InputError(
            f"two echoes are needed, not {len(magnitudes)} magnitudes and {len(phases)} phases"
        )
    images = [_image(one, affine, 3) for one in (*magnitudes, *phases)]
    if len({one.data.shape for one in images}) > 1:
        raise InputError("magnitudes and phases of the same shape are needed")
    whole = Image(images[0].data + images[1].data, images[0].affine)
    mask = body_mask(whole, rim=0.0) if body is None else _body(whole, body)
    found = separate_images(images[:2], images[2:], mask, times=echo_times, strength=field_strength)
    return found.water, found.fat, found.fraction, found.doubt


def segment(image: ArrayLike, affine: ArrayLike, body: ArrayLike | None = None, **keys: Any) -> I32:
    """Regions of an image by level sets.

    Parameters
    ----------
    image : ArrayLike
        Shape `(ni, nj, nk)`; shading is not taken out.
    affine : ArrayLike
        Shape `(4, 4)` [mm].
    body : ArrayLike, optional
        Voxels that take part, same shape; default found by threshold.
    **keys
        Of the table `image` of decks: `regions`, `start` (`kmeans`, `otsu`, `circles`), `mu`,
        `volume`, `iterations`, ...

    Returns
    -------
    NDArray
        0 outside, then 1 for the darkest region and so on, shape `(ni, nj, nk)`.
    """
    grid = _image(image, affine, 3)
    images = Images(grid, body=_body(grid, body))
    found = segment_images(images, _table("image", keys), evolve_level_sets)
    return (found.regions.region + 1).astype(np.int32)


def parts_of_voxels(
    labels: ArrayLike, images: Sequence[ArrayLike], affine: ArrayLike, unmixed: Sequence[int] = ()
) -> F64:
    """Part of each voxel that each label fills, by the grey values along borders.

    Parameters
    ----------
    labels : ArrayLike
        Shape `(ni, nj, nk)`; kinds of what has no label (air, other tissue) may have numbers below
        one of their own.
    images : sequence of ArrayLike
        Without shading, shape `(ni, nj, nk)` each.
    affine : ArrayLike
        Shape `(4, 4)` [mm].
    unmixed : sequence
        Numbers that share no voxel with others.

    Returns
    -------
    NDArray
        Of the labels above zero, ascending, shape `(ni, nj, nk, nlabel)` [-].
    """
    grids = [_image(one, affine, 3) for one in images]
    if not grids:
        raise InputError("parts of voxels are told by images; give one at least")
    found = [_labels(labels, affine, one) for one in grids][0]
    values = np.stack([one.data for one in grids], axis=-1)
    return label_parts(found.data, values, found.spacing, unmixed)


def resample(
    labels: ArrayLike, affine: ArrayLike, thickness: float, fibers: ArrayLike | None = None
) -> tuple[I32, F64, F64 | None]:
    """Labels and fibers of thick slices on thinner ones.

    Parameters
    ----------
    labels : ArrayLike
        Shape `(ni, nj, nk)`.
    affine : ArrayLike
        Shape `(4, 4)` [mm].
    thickness : float
        Wanted thickness of slices [mm].
    fibers : ArrayLike, optional
        Vectors, zero where there is none, shape `(ni, nj, nk, 3)`.

    Returns
    -------
    tuple
        Labels, affine and fibers (or None) of the finer grid.
    """
    grid = _labels(labels, affine)
    if not 0.0 < thickness < np.inf:
        raise InputError(f"a thickness above zero is wanted, not {thickness} mm")
    axis, parts = slice_parts(grid.spacing, thickness)
    finer = finer_labels(grid, axis, parts)
    if fibers is None:
        return finer.data, finer.affine, None
    vectors = _image(fibers, affine, 4)
    if vectors.data.shape != (*grid.data.shape, 3):
        raise InputError(
            f"fibers of the shape {(*grid.data.shape, 3)} are wanted, not {vectors.data.shape}"
        )
    way = finer_fibers(vectors, grid, finer, axis, parts)
    return finer.data, finer.affine, way.data


def build_points(
    labels: ArrayLike,
    affine: ArrayLike,
    fibers: ArrayLike | None = None,
    *,
    fractions: ArrayLike | None = None,
    names: dict[int, str] | None = None,
    unit: str = "cm",
    **keys: Any,
) -> tuple[PointCloud, list[str]]:
    """Points of a model, as `myork build` makes them; `Scene.from_tables` takes them.

    Parameters
    ----------
    labels : ArrayLike
        Shape `(ni, nj, nk)`.
    affine : ArrayLike
        Shape `(4, 4)` [mm].
    fibers : ArrayLike, optional
        Vectors in the world frame, shape `(ni, nj, nk, 3)`.
    fractions : ArrayLike, optional
        As of `parts_of_voxels`.
    names : dict, optional
        Names of the labels.
    unit : str
        Unit of length of the model: `mm`, `cm` or `m`.
    **keys
        Of the table `build` of decks: `collocation_stride`, `source_stride`, `bone`, ...

    Returns
    -------
    tuple
        The points and warnings.
    """
    grid = _labels(labels, affine)
    grid = Labels(grid.data, grid.affine, dict(names or {}))
    way = None if fibers is None else _image(fibers, affine, 4)
    parts = None
    if fractions is not None:
        parts = checked_parts(_image(fractions, affine, 4), grid, "fractions")
    return build_cloud(grid, way, _table("build", keys), unit, fractions=parts)


def _table(name: str, keys: dict[str, Any]) -> dict[str, Any]:
    """Table of a deck with its defaults."""
    units = {"force": "N", "length": "cm"}
    tables = {"title": "arrays", "units": units, "scene": {"dimension": 3}, name: keys}
    found: dict[str, Any] = load_deck(tables)[name]
    return found


def _image(values: ArrayLike, affine: ArrayLike, axes: int) -> Image:
    data, grid = np.asarray(values, float), np.asarray(affine, float)
    if data.ndim != axes or grid.shape != (4, 4):
        raise InputError(
            f"an array with {axes} axes and an affine of 4 x 4 are wanted, not {data.shape} and "
            f"{grid.shape}"
        )
    if axes == 3 and not np.isfinite(data).all():
        raise InputError("the image has values that are not finite; replace them")
    return Image(data, grid)


def _labels(values: ArrayLike, affine: ArrayLike, like: Image | None = None) -> Labels:
    data = np.asarray(values)
    if data.ndim != 3 or (like is not None and data.shape != like.data.shape[:3]):
        wanted = "three axes" if like is None else f"the shape {like.data.shape[:3]}"
        raise InputError(f"labels with {wanted} are wanted, not {data.shape}")
    grid = np.asarray(affine, float)
    if grid.shape != (4, 4):
        raise InputError(f"an affine of 4 x 4 is wanted, not {grid.shape}")
    if not np.array_equal(data, np.round(data)):
        raise InputError("labels are whole numbers; some of these are not")
    return Labels(data.astype(np.int32), grid)


def _body(image: Image, body: ArrayLike | None) -> Mask:
    if body is None:
        return body_mask(image)
    mask = np.asarray(body) > 0
    if mask.shape != image.data.shape:
        raise InputError(f"a body of the shape {image.data.shape} is wanted, not {mask.shape}")
    return np.asarray(mask, np.bool_)
