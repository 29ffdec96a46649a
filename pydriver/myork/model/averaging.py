"""Averaging of diffusion tensors inside a muscle: logarithms, trust, width.

Logarithms are averaged under a Gaussian within one label, so that fibers keep their direction up to
its border. Tensors whose trace lies far from that of the muscle (fat, connective tissue) get little
weight.

The width is the one with which tensors around a voxel best predict its own. Neighbours with
correlated noise, as in interpolated images, would predict that noise; they are left out, as many in
each direction as the variogram shows. Where the narrowest width predicts best, a usual one is
taken. Families of fibers within a label, as in adjacent muscles, are found by the same error.

References: Arsigny, Fillard, Pennec, Ayache, Magn. Reson. Med. 56 (2006), doi:10.1002/mrm.20965;
Stone, J. R. Stat. Soc. B 36 (1974), doi:10.1111/j.2517-6161.1974.tb00994.x (cross-validation);
Burman, Chow, Nolan, Biometrika 81 (1994), doi:10.1093/biomet/81.2.351 (neighbours left out)
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from myork.imaging.diffusion import SQUARES, dyads_of, full_tensors, lead_vector, tensor_components
from myork.imaging.geometry import boxes_of
from myork.records import Image
from myork.segmentation.starts import kmeans
from myork.types import F64, I32, Mask

#: Gaussian weight below which a place has no usable neighbour [-]
LEAST_WEIGHT = 1e-8


_TRUNCATE = 3.0  # standard deviations at which Gaussians are truncated
# Traces this many times the scatter away from the median have a fourth of the trust; the scatter
# is at least that of this change of the diffusivity.
_STRANGE, _LEAST_SCATTER = 2.5, 0.02
# Widths tried, in units of the smallest voxel size; the usual one where they do not differ
_WIDTHS = (0.6, 0.8, 1.0, 1.2, 1.6, 2.0, 2.4, 3.2, 4.0, 4.8)
_USUAL = 1.6
# Numbers of fiber families tried; relative difference of the error within which they are equal
_FAMILIES, _AS_WELL = (2, 3, 4, 6, 8), 0.04
# Correlation above which the noise of two voxels counts as correlated [-]; most voxels left out;
# pairs of voxels that a correlation needs
_ALIKE, _FARTHEST, _PAIRS = 0.1, 2, 100


def tensor_logarithms(tensor: Image, inside: Mask) -> tuple[F64, Mask]:
    """Logarithms of the tensors, and a mask of the voxels that have one.

    - `tensor`: components xx, yy, zz, xy, xz, yz, shape `(ni, nj, nk, 6)` [any unit]
    - `inside`: requested voxels, shape `(ni, nj, nk)`
    - returns components of the logarithms, zero where unusable, shape `(ni, nj, nk, 6)`; voxels
      whose tensor is finite and positive, shape `(ni, nj, nk)`
    """
    usable = inside & np.isfinite(tensor.data).all(-1)
    value, vector = np.linalg.eigh(full_tensors(tensor.data[usable]))
    positive = value[:, 0] > 0
    usable[usable] = positive
    logarithm = np.zeros(tensor.data.shape)
    value, vector = value[positive], vector[positive]
    logarithm[usable] = tensor_components(
        (vector * np.log(value)[:, np.newaxis, :]) @ np.swapaxes(vector, 1, 2)
    )
    return logarithm, usable


def tensor_trust(logarithm: F64, usable: Mask, label: I32) -> F64:
    """Weight of each tensor in the average of its label, 1 for a typical one, shape `(ni, nj, nk)`.

    - `logarithm`, `usable`: from `tensor_logarithms`
    - `label`: label of each voxel, shape `(ni, nj, nk)`
    """
    trust = np.zeros(label.shape)
    for box, own in boxes_of(label):
        here = usable[box] & own
        if here.any():
            mean = logarithm[box][here][:, :3].mean(axis=1)
            away = np.abs(mean - np.median(mean))
            scatter = max(1.4826 * float(np.median(away)), _LEAST_SCATTER)
            trust[box][here] = (1.0 + (away / (_STRANGE * scatter)) ** 2) ** -2
    return trust


class Average(NamedTuple):
    """Parameters of the averaging of tensors."""

    label: I32  #: Voxels with equal labels are averaged together, shape `(ni, nj, nk)`
    width: float  #: Standard deviation of the Gaussian [mm]


def best_average(logarithm: F64, trust: F64, label: I32, spacing: F64) -> Average:
    """The Gaussian that best predicts tensors from those around them, within families of fibers.

    Labels may contain several muscles. Averages over whole labels are clustered by their fibers,
    and the smallest number of clusters is taken whose averages predict tensors as well as any.

    - `logarithm`: logarithms of the tensors, shape `(ni, nj, nk, 6)`
    - `trust`: their weights, shape `(ni, nj, nk)`
    - `label`: labels, within which tensors are averaged, shape `(ni, nj, nk)`
    - `spacing`: voxel sizes, shape `(3,)` [mm]
    """
    shape = logarithm.copy()
    shape[..., :3] -= shape[..., :3].mean(axis=-1, keepdims=True)
    alike = [_alike(shape, trust, label, axis) for axis in range(3)]
    width, least = _width(logarithm, trust, label, spacing, alike)
    found = [(least, Average(label, width))]
    fiber, known = label_fibers(logarithm, trust, label, width / spacing)
    dyads = dyads_of(fiber[known]) * np.sqrt(SQUARES)
    for count in _FAMILIES if len(dyads) else ():
        family = label.copy()
        family[known] += (int(label.max()) + 1) * kmeans(dyads, count)[0]
        names, place = np.unique(family[label > 0], return_inverse=True)
        family[label > 0] = 1 + place
        width, error = _width(logarithm, trust, family, spacing, alike)
        found.append((error, Average(family, width)))
        if count == _FAMILIES[0] and not error < least:
            break
    best = min(error for error, _ in found)
    # too many families would split off the blurred fibers between two of them
    return next(average for error, average in found if not error > best * (1.0 + _AS_WELL))


def label_fibers(logarithm: F64, trust: F64, label: I32, sigma: F64) -> tuple[F64, Mask]:
    """Fibers of averages within each label, shape `(ni, nj, nk, 3)`, and where they exist."""
    fiber, known = np.zeros((*label.shape, 3)), np.zeros(label.shape, bool)
    for box, here in boxes_of(label):
        weight = trust[box] * here
        sums, near = gathered(logarithm[box] * weight[..., np.newaxis], weight, sigma)
        usable = here & (near > LEAST_WEIGHT)
        fiber[box][usable] = lead_vector(sums[usable] / near[usable][:, np.newaxis])
        known[box] |= usable
    return fiber, known


def _width(
    logarithm: F64, trust: F64, label: I32, spacing: F64, alike: Sequence[int]
) -> tuple[float, float]:
    """Width of the best prediction [mm], and the mean square error of its predictions."""
    smallest = float(spacing[np.array(label.shape) > 1].min(initial=np.inf))
    smallest = smallest if np.isfinite(smallest) else float(spacing.min())
    # With a narrower Gaussian hardly any weight lies beyond the voxels left out.
    widths = [width for width in _WIDTHS if width >= _WIDTHS[0] * (1 + max(alike))]
    best, least = _USUAL * smallest, np.inf
    for width in smallest * np.array(widths):
        error = _prediction_error(logarithm, trust, label, width / spacing, alike)
        if not error < least:
            if np.isfinite(error):
                break  # the error decreases with the noise and then increases as fibers bend
            continue
        best, least = float(width), error
    # The narrowest is best without noise, or where the noise of neighbours is correlated.
    return (best if best > smallest * _WIDTHS[0] else _USUAL * smallest), least


def _alike(shape: F64, trust: F64, label: I32, axis: int) -> int:
    """Number of neighbours along an axis whose noise is correlated with that of a voxel.

    Half the mean square difference of tensors at a distance in voxels is the noise variance times
    one minus its correlation, plus a part that grows with the square of the distance as fibers
    bend. Noise three and four voxels apart is uncorrelated, which separates the two parts.

    - `shape`: logarithms without their traces, shape `(ni, nj, nk, 6)`
    - `trust`, `label`: as in `best_average`
    """
    apart = np.arange(1, 5)
    half = np.full(4, np.nan)
    along = [np.moveaxis(array, axis, 0) for array in (shape, trust, label)]
    for k in apart[apart < label.shape[axis]]:
        (value, other), (weight, weight_other), (one, two) = ((a[k:], a[:-k]) for a in along)
        pairs = (one == two) & (one > 0)
        both = (weight * weight_other)[pairs]
        if len(both) < _PAIRS or not both.sum() > 0.0:
            continue
        half[k - 1] = 0.5 * (both @ ((value - other)[pairs] ** 2 @ SQUARES)) / both.sum()
    bend = max((half[3] - half[2]) / 7.0, 0.0)
    noise = half[2] - 9.0 * bend
    if not noise > 0:  # also where there are too few voxels
        return 0
    like = 1.0 - (half - bend * apart**2) / noise > _ALIKE
    return int(np.cumprod(like[:_FARTHEST]).sum())


def _prediction_error(
    logarithm: F64, trust: F64, label: I32, sigma: F64, alike: Sequence[int]
) -> float:
    """Mean square error of directions and shapes of tensors predicted from those around them."""
    inner = []
    for s, beside in zip(sigma, alike, strict=True):
        reach = int(_TRUNCATE * s + 0.5)  # as in scipy
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(float(s), 1e-9)) ** 2)
        beside = min(beside, reach)
        inner.append((kernel / kernel.sum())[reach - beside : reach + beside + 1])
    own = float(np.prod([kernel.max() for kernel in inner]))

    def left_out(values: F64) -> F64:
        for axis, kernel in enumerate(inner):
            values = ndimage.correlate1d(values, kernel, axis=axis, mode="constant")
        return values

    total = weights = 0.0
    for box, here in boxes_of(label):
        weight = trust[box] * here
        values = logarithm[box] * weight[..., np.newaxis]
        sums, near = gathered(values, weight, sigma)
        others = near - left_out(weight)
        known = (weight > 0) & (others > 0.05 * own)
        if not known.any():
            continue
        guess = (sums - left_out(values))[known] / others[known][:, np.newaxis]
        miss = guess - logarithm[box][known]
        miss[:, :3] -= miss[:, :3].mean(axis=1, keepdims=True)
        total += float(weight[known] @ (miss**2 @ SQUARES))
        weights += float(weight[known].sum())
    return total / weights if weights else np.inf


def gathered(values: F64, weight: NDArray[Any], sigma: F64) -> tuple[F64, F64]:
    """Gaussian sums of weighted values and of weights; their ratio is the average.

    - `values`: values times their weights, shape `(ni, nj, nk, n)`
    - `weight`: weights, shape `(ni, nj, nk)`
    - `sigma`: standard deviations [voxel]
    """
    look: Any = {"mode": "constant", "truncate": _TRUNCATE}
    near = ndimage.gaussian_filter(weight.astype(float), sigma, **look)
    return ndimage.gaussian_filter(values, (*sigma, 0.0), **look), near
