"""Initial regions of a segmentation, and level sets of regions."""

import numpy as np
from scipy import ndimage
from scipy.cluster import vq

from myork.errors import InputError
from myork.segmentation.regions import otsu
from myork.types import F64, I32, Mask

# Level sets of a region map: a smoothed sign. A plain sign (or a plain threshold) would start with
# jumps at every noisy voxel, which curvature removes only slowly.
_BLUR = 1.0  # standard deviation [voxels]
_HEIGHT = 3.0  # value far from contours; several times the width of the step function [-]

_SAMPLE = 20_000  # number of values from which the centres of k-means are found
_RESTARTS = 8


def kmeans(values: F64, count: int) -> tuple[I32, F64]:
    """Clusters of values, in order of their centres; equal arguments give equal clusters.

    - `values`: shape `(nvalue, nchannel)` [-]
    - `count`: number of clusters
    - returns cluster of each value, shape `(nvalue,)`; centres, shape `(count, nchannel)`

    Reference: Lloyd, IEEE Trans. Inf. Theory 28 (1982), doi:10.1109/TIT.1982.1056489, as in SciPy,
    with the best of several random starts
    """
    random = np.random.default_rng(0)
    some = values
    if len(values) > _SAMPLE:
        some = values[random.choice(len(values), _SAMPLE, replace=False)]
    elif len(values) < count:
        some = np.resize(values, (count, values.shape[1]))
    # SciPy leaves out clusters that have become empty
    best = vq.kmeans(some, count, iter=_RESTARTS, seed=random)[0]
    best = np.resize(best[np.lexsort(best.T[::-1])], (count, values.shape[1]))
    return vq.vq(values, best)[0], best


def seeded_regions(values: F64, region: Mask, known: I32, count: int) -> I32:
    """Regions around the mean values of seeds, and clusters of the voxels unlike all seeds.

    - `values`: channels, each times the square root of its weight, shape `(ni, nj, nk, nchannel)`
      [-]
    - `region`: voxels that take part, shape `(ni, nj, nk)`
    - `known`: label of the seeds, from 1, -1 elsewhere, same shape
    - `count`: number of regions, at least that of labels: the labels less one, then the clusters
    - returns region of each voxel, zero outside of `region`, shape `(ni, nj, nk)`
    """
    labels = np.unique(known[known > 0])
    inside = values[region]
    nearest, away = vq.vq(inside, np.stack([values[known == n].mean(axis=0) for n in labels]))
    if count > len(labels):
        # A few distant voxels would shift the threshold.
        away = np.minimum(away**2, np.percentile(away, 99.0) ** 2)
        strange = away > otsu(away)
        if strange.any():
            clusters = kmeans(inside[strange], count - len(labels))[0]
            nearest[strange] = len(labels) + clusters
    nearest[known[region] > 0] = np.searchsorted(labels, known[region & (known > 0)])
    result = np.zeros(region.shape, np.int32)
    result[region] = nearest
    return result


def level_sets_for(regions: int) -> int:
    """Number of level sets needed for a number of regions."""
    return max(int(regions - 1).bit_length(), 1)


def level_sets_of(region: I32, regions: int) -> F64:
    """Level sets whose signs give a map of regions.

    - `region`: region of each voxel, 0 to `regions - 1`, shape `(ni, nj, nk)`
    - `regions`: number of regions
    - returns shape `(ni, nj, nk, level_sets_for(regions))`; positive inside, where bit `level` of
      the region's number is set [-]
    """
    if region.min() < 0 or region.max() >= regions:
        raise InputError(
            f"the start has {region.max() + 1} regions, image.regions is {regions}; raise it"
        )
    phi = np.empty((*region.shape, level_sets_for(regions)), order="F")
    for level in range(phi.shape[-1]):
        sign = 2.0 * ((region >> level) & 1) - 1.0
        phi[..., level] = _HEIGHT * ndimage.gaussian_filter(sign, (_BLUR, _BLUR, 0.0), truncate=3.0)
    return phi


def regions_of(phi: F64, regions: int) -> I32:
    """Map of regions from the signs of level sets; the inverse of `level_sets_of`."""
    region = ((phi > 0) << np.arange(phi.shape[-1])).sum(-1, dtype=np.int32)
    # combinations of signs without a separate region lose their highest bit
    highest = 1 << (level_sets_for(regions) - 1)
    return np.where(region < regions, region, region - highest).astype(np.int32)
