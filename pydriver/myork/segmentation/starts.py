"""First regions of a segmentation, and level sets made of regions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from myork.errors import InputError
from myork.segmentation.regions import otsu

__all__ = [
    "circle_regions",
    "kmeans",
    "level_sets_for",
    "level_sets_of",
    "regions_of",
    "seeded_regions",
    "threshold_regions",
]

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

# Level sets of a map of regions: a smoothed sign. Plain signs (or a plain threshold) start with
# jumps at every noisy voxel, which curvature takes long to remove.
_BLUR = 1.0  # standard deviation [voxels]
_HEIGHT = 3.0  # far from contours; several times the width of the step function [-]

_SAMPLE = 20_000  # values that place the centres of k-means
_RESTARTS = 8


def kmeans(values: F64, count: int, seed: int = 0) -> tuple[I32, F64]:
    """Clusters of values, in order of the first component of their centres.

    Parameters
    ----------
    values : NDArray
        Shape `(nvalue, nchannel)` [-].
    count : int
        Clusters.
    seed : int
        Start of the random numbers; equal arguments give equal clusters.

    Returns
    -------
    tuple
        Cluster of each value, shape `(nvalue,)`; centres, shape `(count, nchannel)`.

    References
    ----------
    Arthur, Vassilvitskii, Proc. SODA (2007), k-means++: the start; Lloyd, IEEE Trans. Inf.
    Theory 28 (1982), doi:10.1109/TIT.1982.1056489
    """
    random = np.random.default_rng(seed)
    some = values
    if len(values) > _SAMPLE:
        some = values[random.choice(len(values), _SAMPLE, replace=False)]
    best, least = _lloyd(some, _spread(some, count, random))
    for _ in range(_RESTARTS - 1):
        centres, rest = _lloyd(some, _spread(some, count, random))
        if rest < least:
            best, least = centres, rest
    best = best[np.lexsort(best.T[::-1])]
    return _nearest(values, best)[0], best


def seeded_regions(values: F64, region: NDArray[np.bool_], known: I32, count: int) -> I32:
    """Regions around the mean values of seeds, and clusters of what is like none of them.

    Parameters
    ----------
    values : NDArray
        Channels, each times the square root of its weight, shape `(ni, nj, nk, nchannel)` [-].
    region : NDArray
        Voxels that take part, shape `(ni, nj, nk)`.
    known : NDArray
        Label of the seeds, from 1, -1 elsewhere, same shape.
    count : int
        Number of regions: the labels less one, then the clusters.

    Returns
    -------
    NDArray
        Region of each voxel, zero outside of `region`, shape `(ni, nj, nk)`.
    """
    labels = np.unique(known[known > 0])
    if len(labels) > count:
        raise InputError(
            f"image.start = 'seeds': {len(labels)} muscles have seeds, image.regions is {count}; "
            "raise it"
        )
    inside = values[region]
    nearest, away = _nearest(inside, np.stack([values[known == n].mean(axis=0) for n in labels]))
    if count > len(labels):
        # Few voxels far from all would drag the threshold.
        strange = away > otsu(np.minimum(away, np.percentile(away, 99.0)))
        if strange.any():
            clusters = kmeans(inside[strange], count - len(labels))[0]
            nearest[strange] = len(labels) + clusters
    nearest[known[region] > 0] = np.searchsorted(labels, known[region & (known > 0)])
    result = np.zeros(region.shape, np.int32)
    result[region] = nearest
    return result


def _spread(values: F64, count: int, random: np.random.Generator) -> F64:
    """Centres far from each other, drawn among the values."""
    centres = values[[int(random.integers(len(values)))]]
    far = ((values - centres[0]) ** 2).sum(1)
    while len(centres) < count:
        total = far.sum()
        if total > 0:
            pick = min(int(np.searchsorted(np.cumsum(far), random.random() * total)), len(far) - 1)
        else:  # fewer different values than clusters
            pick = int(random.integers(len(values)))
        centres = np.vstack([centres, values[pick]])
        far = np.minimum(far, ((values - values[pick]) ** 2).sum(1))
    return centres


def _nearest(values: F64, centres: F64) -> tuple[I32, F64]:
    """Nearest centre of each value and the squared distance to it."""
    which = np.empty(len(values), np.int32)
    least = np.empty(len(values))
    lengths = (centres**2).sum(1)
    for first in range(0, len(values), _SAMPLE):
        some = values[first : first + _SAMPLE]
        # The squared distance less |value|^2, which is the same for all centres
        rest = lengths - 2.0 * (some @ centres.T)
        nearest = rest.argmin(axis=1)
        which[first : first + _SAMPLE] = nearest
        least[first : first + _SAMPLE] = ((some - centres[nearest]) ** 2).sum(1)
    return which, least


def _lloyd(values: F64, centres: F64, rounds: int = 100) -> tuple[F64, float]:
    """Move centres to the means of their clusters until they rest."""
    for _ in range(rounds):
        which, distance = _nearest(values, centres)
        count = np.maximum(np.bincount(which, minlength=len(centres)), 1)
        moved = np.stack(
            [np.bincount(which, part, len(centres)) / count for part in values.T], axis=1
        )
        moved[np.bincount(which, minlength=len(centres)) == 0] = values[np.argmax(distance)]
        if np.abs(moved - centres).max() < 1e-6 * max(np.abs(centres).max(), 1e-300):
            break
        centres = moved
    return centres, float(_nearest(values, centres)[1].sum())


def threshold_regions(values: F64, region: NDArray[np.bool_]) -> I32:
    """Two regions by Otsu's threshold: 0 dark, 1 bright."""
    return (values > otsu(values[region])).astype(np.int32)


def level_sets_for(regions: int) -> int:
    """Number of level sets that make a number of regions."""
    return max(int(regions - 1).bit_length(), 1)


def level_sets_of(region: I32, regions: int, volume: bool) -> F64:
    """Level sets whose signs give a map of regions.

    Parameters
    ----------
    region : NDArray
        Region of each voxel, 0 to `regions - 1`, shape `(ni, nj, nk)`.
    regions : int
        Number of regions.
    volume : bool
        Whether to smooth across slices as well.

    Returns
    -------
    NDArray
        Shape `(ni, nj, nk, level_sets_for(regions))`; positive inside, where bit `level` of the
        region's number is set [-].
    """
    if region.min() < 0 or region.max() >= regions:
        raise InputError(
            f"the start has {region.max() + 1} regions, image.regions is {regions}; raise it"
        )
    blur = (_BLUR, _BLUR, _BLUR if volume else 0.0)
    phi = np.empty((*region.shape, level_sets_for(regions)), order="F")
    for level in range(phi.shape[-1]):
        sign = 2.0 * ((region >> level) & 1) - 1.0
        phi[..., level] = _HEIGHT * ndimage.gaussian_filter(sign, blur, truncate=3.0)
    return phi


def circle_regions(shape: tuple[int, ...], regions: int, pitch: float = 16.0) -> I32:
    """Regions from square grids of circles, one grid a level set.

    The grids are shifted against each other, so that all regions occur, and their pitches
    differ: equal ones would fit a symmetric image everywhere alike.

    Parameters
    ----------
    shape : tuple
        Of the result, `(ni, nj, nk)`.
    regions : int
        Number of regions.
    pitch : float
        Distance of the circles of the first grid [pixel].
    """
    count = level_sets_for(regions)
    combination = np.zeros(shape, np.int32)
    for level in range(count):
        step = pitch * (1.0 + 0.25 * level)
        i, j = (
            np.abs((np.arange(n) + step * level / count) % step - 0.5 * step) for n in shape[:2]
        )
        inside = np.hypot(i[:, None], j[None, :]) < 0.35 * step
        combination += inside[..., None].astype(np.int32) << level
    return _known(combination, regions)


def regions_of(phi: F64, regions: int) -> I32:
    """Map of regions from the signs of level sets; the inverse of `level_sets_of`."""
    bits = (phi > 0).astype(np.int32)
    return _known((bits << np.arange(phi.shape[-1])).sum(-1, dtype=np.int32), regions)


def _known(combination: I32, regions: int) -> I32:
    """Combinations of signs without a region of their own lose their highest bit."""
    highest = 1 << (level_sets_for(regions) - 1)
    return np.where(combination < regions, combination, combination - highest).astype(np.int32)
