"""Channels of a segmentation: grey values and fiber directions on one scale."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage

from myork.errors import InputError
from myork.imaging.diffusion import SQUARES, dyads_of, finite_tensors, full_tensors
from myork.records import Image
from myork.segmentation.regions import otsu
from myork.types import F64, Mask

# The noise ratio says little about how much regions differ, so no channel counts more than this
# many times as much as another one.
_WEIGHTS = 16.0


def scaled_values(image: Image, region: Mask) -> F64:
    """Grey values with the 1st and 99th percentile of a region scaled to zero and one.

    - `image`: MR image, shape `(ni, nj, nk)`
    - `region`: voxels that count, same shape
    """
    if not region.any():
        raise InputError(
            f"{image.name}: the region to segment is empty; check image.box and image.region"
        )
    low, high = np.percentile(image.data[region], (1.0, 99.0))
    if not high > low:
        raise InputError(f"{image.name}: the region to segment has one grey value only, {low:g}")
    return (image.data - low) / (high - low)


def noise_level(values: F64, region: Mask) -> float:
    """Standard deviation of the noise, by the median of second differences in the slices.

    - `values`: shape `(ni, nj, nk)`
    - `region`: voxels that count, same shape
    """
    found = []
    for axis in (0, 1):
        grey, inside = np.moveaxis(values, axis, 0), np.moveaxis(region, axis, 0)
        whole = inside[2:] & inside[1:-1] & inside[:-2]
        found.append((grey[2:] - 2.0 * grey[1:-1] + grey[:-2])[whole])
    bends = np.abs(np.concatenate(found))
    return float(1.4826 * np.median(bends) / np.sqrt(6.0)) if bends.size else 0.0


def local_means(values: F64, where: Mask, sigma: Sequence[float] | F64, far: float) -> F64:
    """Mean of the values of some voxels under a Gaussian around each place.

    - `values`, `where`: values and the mask of the voxels, shape `(ni, nj, nk)`
    - `sigma`: standard deviations [voxel]
    - `far`: weight of the mean of all voxels, which remains far from all of them [-]
    """
    weight = ndimage.gaussian_filter(where.astype(float), sigma)
    total = ndimage.gaussian_filter(np.where(where, values, 0.0), sigma)
    return np.asarray((total + far * values[where].mean()) / (weight + far))


def noise_weight(first: float, other: float) -> float:
    """Weight of a channel relative to the first one, by the noise of both.

    - `first`, `other`: noise; if one is zero (a map of few values), the weight is 1
    """
    if not (first > 0 and other > 0):
        return 1.0
    return float(np.clip((first / other) ** 2, 1.0 / _WEIGHTS, _WEIGHTS))


def noise_weights(first: F64, others: Sequence[F64], region: Mask) -> list[float]:
    """Weights of channels relative to a first one by the noise of their values in a region."""
    noise = noise_level(first, region)
    return [noise_weight(noise, noise_level(one, region)) for one in others]


def smoothed_tensor(tensor: Image, region: Mask, sigma: float) -> Image:
    """Components of tensors averaged under a Gaussian inside a region.

    Components are averaged, not logarithms: tensors of noisy images need not be positive, and only
    the direction is used.

    - `tensor`: shape `(ni, nj, nk, 6)`; tensors that are not finite are ignored
    - `region`: voxels that count, shape `(ni, nj, nk)`
    - `sigma`: standard deviation [mm]
    """
    usable = region & np.isfinite(tensor.data).all(axis=-1)
    blur, where = (*(sigma / tensor.spacing), 0.0), usable[..., np.newaxis]
    weight = ndimage.gaussian_filter(where.astype(float), blur)
    sums = ndimage.gaussian_filter(np.where(where, tensor.data, 0.0), blur)
    return replace(tensor, data=sums / np.maximum(weight, 1e-8))


def fiber_channels(tensor: Image, region: Mask, kind: str) -> F64:
    """Channels of the lead eigenvectors of diffusion tensors; v and -v are the same fiber.

    Where water diffuses alike in all directions (fat, bone) the lead eigenvector is noise, so that
    channels fade with the difference of the largest and the smallest eigenvalue.

    - `tensor`: xx, yy, zz, xy, xz, yz, shape `(ni, nj, nk, 6)`; a tensor that is not finite counts
      as having no direction
    - `region`: voxels that count, shape `(ni, nj, nk)`
    - `kind`: `dyad`: the six components of v v^T, off-diagonal ones times the square root of
      two, so that squared differences are 2 sin^2 of the angle; `aligned`: v turned to point up,
      (4.2)
    - returns shape `(ni, nj, nk, 6)` or `(ni, nj, nk, 3)` [-]
    """
    values, vectors = np.linalg.eigh(full_tensors(finite_tensors(tensor.data)))
    lead, spread = vectors[..., :, 2], values[..., 2] - values[..., 0]
    if not np.ptp(spread[region]) > 0:
        raise InputError(
            f"{tensor.name}: the diffusion is isotropic everywhere, so that there are no fibers"
        )
    typical = np.median(spread[region & (spread > otsu(spread[region]))])
    strength = np.clip(spread / typical, 0.0, 1.0)[..., np.newaxis]
    if kind == "aligned":
        return strength * np.where(lead[..., 2:] < 0, -lead, lead)
    return strength * np.sqrt(SQUARES) * dyads_of(lead)
