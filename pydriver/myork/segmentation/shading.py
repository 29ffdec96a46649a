"""Bias field without a given number of tissues; the best result of several starts is kept.

The logarithm of the field is a sum of cosines over the body. It is fitted to the slopes of the
image, most of which lie inside tissues, by a redescending estimator, and separate components of the
body are aligned by their histograms. From such starts, and from no field, voxels are moved to the
nearest peak of the histogram of the corrected image (mean shift); the least entropy is kept.

References
----------
Zheng, Grossman, Awate, Gee, Proc. MICCAI (2009), doi:10.1007/978-3-642-04271-3_101 (slopes);
Mangin, Proc. MMBIA (2000), doi:10.1109/MMBIA.2000.852360 (entropy); Comaniciu, Meer, IEEE Trans.
Pattern Anal. Mach. Intell. 24 (2002), doi:10.1109/34.1000236 (mean shift)
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from myork.errors import InputError
from myork.imaging.geometry import neighbours
from myork.segmentation.regions import otsu
from myork.types import F64, I64, Mask

# Lengths are relative to the width of a limb, so that a mouse is treated like a man.
_WAVE = 0.64  # shortest wavelength of the field
_SLOPES = (0.64, 1.1)  # shortest wavelengths of the fields that are fitted to slopes
_STEP = 0.04  # distance over which slopes are taken
_BEYOND = 0.15  # extension of the waves beyond the body at each end, relative to its extent
_MOST = 250  # number of coefficients; a body that would need more gets longer waves
_SAMPLE = 40_000  # number of voxels to which a field is fitted
_FEWEST = 64  # number of voxels, below which a fit is unreliable
_STIFF = 1e-3  # weight of the field's bending relative to the data
_DARKEST = 1e-3  # lower limit of values before taking logarithms, relative to the bright ones
_EDGE = 0.1  # relative change from pixel to pixel at which a voxel has a quarter of its weight
# Rounds of the fits; window widths of the histogram from first to last [logarithm]
_ROUNDS_SLOPES, _ROUNDS_CONVEX = 30, 12
_ROUNDS_PEAKS = 60
_WIDE, _NARROW = 0.12, 0.05
_NEGATIVE = 0.01  # part of the body's voxels that ringing of a resampled image makes negative
_SEAM = (3.0, 3.0, 0.0)  # width of the smoothing beyond the mask [pixel]
_RISE = 1.1  # a field that raises the coefficient of joint variation by less causes no doubt
# That coefficient for one normal distribution cut in the middle: an image that reaches it shows no
# two tissues, so that the coefficient is meaningless for it.
_ONE_TISSUE = float(np.sqrt(0.5 * np.pi - 1.0))


@dataclass(frozen=True)
class Shading:
    """Field, its start and its reliability."""

    #: Factor on the true values, mean one inside the mask and continued beyond it, shape
    #: `(ni, nj, nk)` [-]
    field: F64
    start: str  #: `flat`, or the shortest wavelength of the slopes
    doubt: str  #: Why it may be wrong; empty without a doubt


def shading(values: F64, mask: Mask, *, spacing: ArrayLike) -> Shading:
    """Bias field of an image.

    - `values`: image, shape `(ni, nj, nk)` [-]; slices along the last axis, one is enough
    - `mask`: voxels of the body, same shape
    - `spacing`: voxel sizes, shape `(3,)` [mm]
    """
    if not mask.any():
        raise InputError("bias: no voxel to estimate the field from; check the mask")
    if mask.sum() < _FEWEST:
        raise InputError(
            f"bias: {mask.sum()} voxels are too few to estimate a field; check the mask, "
            "or set bias.method = 'none'"
        )
    if not np.isfinite(values[mask]).all():
        raise InputError("bias: values of the body are not finite; replace them")
    negative = float((values[mask] < 0).mean())
    if negative > _NEGATIVE:
        raise InputError(
            f"bias: {negative:.0%} of the values in the body are negative, which no field makes; "
            "give the magnitude image, or set bias.method = 'none'"
        )
    size = np.asarray(spacing, float)
    bright = float(np.percentile(values[mask], 90.0))
    if not bright > 0:
        raise InputError("bias: the body has no signal, its 90th percentile is not above zero")
    smooth = _smoothed(values, mask) / bright
    width = _limb_width(mask, size)
    random = np.random.default_rng(0)
    voxels = np.argwhere(mask)
    if len(voxels) > _SAMPLE:
        voxels = voxels[random.choice(len(voxels), _SAMPLE, replace=False)]
    peaks = _Peaks(smooth, mask, voxels, _Waves(mask, size, _WAVE * width), size)
    start = "flat"
    found, least = peaks.field(np.zeros(len(voxels)))
    for wave in _SLOPES:
        waves = _Waves(mask, size, wave * width)
        slow = waves.everywhere(_fit_slopes(smooth, mask, waves, size, _STEP * width, random))
        slow = _aligned(smooth, mask, slow)
        other, entropy = peaks.field(slow[tuple(voxels.T)])
        if entropy < least:
            start, found, least = f"slopes, {wave:g} of the limb", other, entropy
    field = _of_mean_one(found, mask)
    return Shading(field, start, variation_doubt(values, field, mask))


def joint_variation(values: F64, mask: Mask) -> float:
    """Coefficient of joint variation: scatter of bright and dark tissue over their difference.

    Both tissues are separated by Otsu's threshold in the mask.

    - `values`: image, shape `(ni, nj, nk)` [-]
    - `mask`: voxels of the body, same shape
    """
    inside = values[mask]
    if not np.ptp(inside) > 0:
        return 0.0
    bright = inside > otsu(inside)
    high, low = inside[bright], inside[~bright]
    return float((high.std() + low.std()) / (high.mean() - low.mean()))


def variation_doubt(values: F64, field: F64, mask: Mask) -> str:
    """Warning where tissues scatter less without the field than with it, otherwise empty.

    An image without two tissues causes no doubt.

    - `values`, `mask`: as in `joint_variation`
    - `field`: factor on the true values, shape `(ni, nj, nk)` [-]
    """
    before, after = (joint_variation(one, mask) for one in (values, values / field))
    if after <= _RISE * before or not 0.0 < before < _ONE_TISSUE:
        return ""
    return (
        "the bias field raises the coefficient of joint variation of bright and dark tissue from "
        f"{before:.3g} to {after:.3g}; look at bias.nii.gz, or set bias.method = 'none'"
    )


def _of_mean_one(field: F64, mask: Mask) -> F64:
    """Field with mean one inside a mask, continued beyond it."""
    found = field / field[mask].mean()
    if mask.all():
        return found
    # There are no data beyond the mask: the rim values are continued, with smoothed seams.
    nearest = ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True)
    spread = found[tuple(nearest)]
    return np.where(mask, found, ndimage.gaussian_filter(spread, _SEAM, mode="nearest"))


class _Waves:
    """Products of cosines over a body, without the constant."""

    def __init__(self, mask: Mask, size: F64, shortest: float) -> None:
        place = np.argwhere(mask)
        low, high = place.min(axis=0) * size, place.max(axis=0) * size
        extent = np.maximum(high - low, size)
        self.shape, self.size = mask.shape, size
        self.first, self.length = low - _BEYOND * extent, extent * (1.0 + 2.0 * _BEYOND)
        many = np.array(mask.shape) > 1
        while True:
            order = np.where(many, np.maximum(np.floor(2.0 * self.length / shortest), 1), 0)
            counts = tuple(int(n) + 1 for n in order)
            grid = np.indices(counts).reshape(3, -1).T
            inside = ((grid / np.maximum(order, 1)) ** 2).sum(axis=1) <= 1.0 + 1e-9
            self.order = grid[inside & grid.any(axis=1)]
            if len(self.order) <= _MOST:
                break
            shortest *= 1.1
        self.bending = ((np.pi * self.order / self.length) ** 2).sum(axis=1) ** 2
        self.bending /= np.median(self.bending)

    def at(self, voxels: I64) -> F64:
        """Values at voxels, shape `(nvoxel, nwave)`."""
        result = np.ones((len(voxels), len(self.order)))
        for axis in range(3):
            result *= self._table(axis)[voxels[:, axis]][:, self.order[:, axis]]
        return result

    def everywhere(self, coefficient: F64) -> F64:
        """Sum on the whole grid, shape `(ni, nj, nk)`."""
        full = np.zeros(self.order.max(axis=0) + 1)
        full[tuple(self.order.T)] = coefficient
        for axis in range(3):
            # the axis is replaced in place
            full = np.moveaxis(np.tensordot(self._table(axis), full, (1, axis)), 0, axis)
        return full

    def _table(self, axis: int) -> F64:
        """Cosines along an axis, shape `(n, order + 1)`."""
        u = (np.arange(self.shape[axis]) * self.size[axis] - self.first[axis]) / self.length[axis]
        return np.cos(np.pi * np.outer(u, np.arange(self.order[:, axis].max() + 1)))


def _fit_slopes(
    smooth: F64, mask: Mask, waves: _Waves, size: F64, step: float, random: np.random.Generator
) -> F64:
    """Coefficients of the field whose slopes agree with those of most of the image."""
    logarithm = np.log(np.maximum(smooth, _DARKEST))
    voxels = np.argwhere(mask)
    parts, slopes, brightness = [], [], []
    for axis in range(3):
        pixels = max(1, round(step / size[axis]))
        pairs = np.stack(neighbours(mask, axis, pixels))
        if pairs.shape[1] > _SAMPLE // 2:
            pairs = pairs[:, random.choice(pairs.shape[1], _SAMPLE // 2, replace=False)]
        a, b = voxels[pairs]
        length = pixels * size[axis]
        parts.append((waves.at(b) - waves.at(a)) / length)
        slopes.append((logarithm[tuple(b.T)] - logarithm[tuple(a.T)]) / length)
        brightness.append(np.minimum(smooth[tuple(a.T)], smooth[tuple(b.T)]))
    if not sum(map(len, parts)):
        return np.zeros(len(waves.order))  # no two voxels are that close
    rows = np.vstack(parts)
    slope = np.concatenate(slopes)
    # The noise of a logarithm is inversely proportional to the signal.
    trust = np.clip(np.concatenate(brightness) / _typical(smooth, mask), 0.0, 1.0)
    stiff = np.diag(_STIFF * len(slope) * waves.bending * np.mean(rows**2))
    coefficient = np.zeros(rows.shape[1])
    for done in range(_ROUNDS_SLOPES):
        miss = np.abs(slope - rows @ coefficient)
        scale = max(1.4826 * float(np.median(miss)), 1e-9)
        if done < _ROUNDS_CONVEX:
            weight = trust / np.maximum(miss, 0.05 * scale)
        else:
            weight = trust / (1.0 + (miss / (1.5 * scale)) ** 2) ** 2
        weight /= weight.mean()
        coefficient = np.linalg.solve(
            rows.T @ (weight[:, None] * rows) + stiff, rows.T @ (weight * slope)
        )
    return coefficient


def _aligned(smooth: F64, mask: Mask, slow: F64) -> F64:
    """Log field that aligns histograms of all components of the body with that of the largest.

    Slopes do not show the brightness of a component relative to another that it does not touch.
    """
    pieces, n = ndimage.label(mask)
    if n < 2:
        return slow
    corrected = np.log(np.maximum(smooth, _DARKEST)) - slow
    count = np.bincount(pieces.ravel())[1:]
    edges = np.arange(corrected[mask].min() - 0.5, corrected[mask].max() + 0.5, 0.02)
    histogram = [
        ndimage.gaussian_filter1d(
            np.histogram(corrected[pieces == k + 1], edges)[0] / count[k], 3.0
        )
        for k in range(n)
    ]
    result = slow.copy()
    largest = histogram[int(count.argmax())]
    for k in range(n):
        match = np.correlate(histogram[k], largest, "full")
        result[pieces == k + 1] += 0.02 * (int(match.argmax()) - (len(largest) - 1))
    return result


class _Peaks:
    """Fields that move the logarithms of voxels to the peaks of their histogram."""

    def __init__(self, smooth: F64, mask: Mask, voxels: I64, waves: _Waves, size: F64) -> None:
        self.mask, self.waves = mask, waves
        here = smooth[tuple(voxels.T)]
        self.logarithm = np.log(np.maximum(here, _DARKEST))
        self.trust = np.clip(here / _typical(smooth, mask), 0.0, 1.0)
        # Values at borders are mixtures, which would pull the field towards a peak on one side.
        self.trust /= (1.0 + (_slope(smooth)[tuple(voxels.T)] / _EDGE) ** 2) ** 2
        rows = waves.at(voxels)
        self.rows = np.column_stack([rows, np.ones(len(rows))])
        stiff = _STIFF * len(rows) * waves.bending * np.mean((rows - rows.mean(axis=0)) ** 2)
        self.stiff = np.diag(np.append(stiff, 0.0))

    def field(self, start: F64) -> tuple[F64, float]:
        """Field and entropy of the corrected image, from the logarithm of an initial field."""
        coefficient = self._fit(start, np.ones(len(start)))
        for width in np.geomspace(_WIDE, _NARROW, _ROUNDS_PEAKS):
            corrected = self.logarithm - self.rows @ coefficient
            centre, density, moment = self._histogram(corrected, width)
            mean = moment / np.maximum(density, 1e-12)
            peak = corrected
            for _ in range(4):
                peak = np.interp(peak, centre, mean)
            away = (corrected - peak) / (1.5 * width)
            # The constant of the fit absorbs that of the peaks.
            coefficient = self._fit(self.logarithm - peak, self.trust / (1.0 + away**2) ** 2)
        corrected = self.logarithm - self.rows @ coefficient
        centre, density, _ = self._histogram(corrected, _NARROW)
        likely = np.interp(corrected, centre, density)
        entropy = -float((self.trust * np.log(likely)).sum() / self.trust.sum())
        slow = self.waves.everywhere(coefficient[:-1])
        return np.exp(slow - slow[self.mask].mean()), entropy

    def _fit(self, wanted: F64, weight: F64) -> F64:
        weighted = weight[:, None] * self.rows
        return np.linalg.solve(self.rows.T @ weighted + self.stiff, weighted.T @ wanted)

    def _histogram(self, corrected: F64, width: float) -> tuple[F64, F64, F64]:
        """Positions, density and first moment under a Gaussian window."""
        step = width / 6.0
        first = corrected.min() - 5.0 * width
        bins = ((corrected - first) / step).astype(int)
        n = int(bins.max()) + 30
        centre = first + (np.arange(n) + 0.5) * step
        count = np.bincount(bins, weights=self.trust, minlength=n) / (self.trust.sum() * step)
        density, moment = (
            ndimage.gaussian_filter1d(one, 6.0, mode="constant") for one in (count, count * centre)
        )
        return centre, density, moment


def _smoothed(values: F64, mask: Mask) -> F64:
    """Image smoothed in the slice by a narrow Gaussian, using voxels of the mask only."""
    share = ndimage.gaussian_filter(mask.astype(float), (0.8, 0.8, 0.0))
    total = ndimage.gaussian_filter(np.where(mask, values, 0.0), (0.8, 0.8, 0.0))
    return np.divide(total, share, out=np.zeros_like(total), where=mask)


def _slope(smooth: F64) -> F64:
    """Slope of the logarithm in each slice [1/pixel]."""
    logarithm = np.log(np.maximum(smooth, _DARKEST))
    slopes = (ndimage.correlate1d(logarithm, [-0.5, 0.0, 0.5], axis) for axis in (0, 1))
    return np.asarray(np.hypot(*slopes))


def _typical(smooth: F64, mask: Mask) -> float:
    """Median of the values that are not close to zero."""
    inside = smooth[mask]
    return float(np.median(inside[inside > _DARKEST]))


def _limb_width(mask: Mask, size: F64) -> float:
    """Diameter of a disc with the area of the largest component in a slice [mm]."""
    plane = np.zeros((3, 3, 3), dtype=bool)
    plane[:, 1, 1] = plane[1, :, 1] = True
    pieces, _ = ndimage.label(mask, plane)
    return float(2.0 * np.sqrt(np.bincount(pieces.ravel())[1:].max() * size[0] * size[1] / np.pi))
