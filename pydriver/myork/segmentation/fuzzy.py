"""Fuzzy C-means clustering of voxels.

References: [1] Bezdek, Ehrlich, Full, Comput. Geosci. 10 (1984), doi:10.1016/0098-3004(84)90020-7;
[2] Arthur, Vassilvitskii, SODA (2007): the start (k-means++)
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from myork.errors import InputError
from myork.types import F64, Mask

# The best of so many starts: where one cluster is small, a start may end with it in another.
_STARTS = 6
_FUZZINESS = 2.0  # the usual exponent of memberships
_ITERATIONS = 100
_AT_REST = 1e-4  # part of the range of the values by which centres may still move


@dataclass(frozen=True)
class Clusters:
    """Result of a clustering."""

    membership: F64  #: Of every voxel of the region, rows sum to one, shape `(n, clusters)` [-]
    centre: F64  #: Sorted by the first channel, shape `(clusters, channels)`

    def place(self, region: Mask, cluster: int) -> Mask:
        """Voxels of a region whose largest membership is that of a cluster."""
        mask = np.zeros(region.shape, dtype=bool)
        number = cluster % self.membership.shape[1]
        mask[region] = self.membership.argmax(axis=1) == number
        return mask


def fuzzy_c_means(channels: F64, region: Mask, clusters: int) -> Clusters:
    """Cluster the voxels of a region by their grey values; equal arguments give equal clusters.

    - `channels`: grey values, shape `(ni, nj, nk)` or `(ni, nj, nk, channels)`
    - `region`: voxels that take part, shape `(ni, nj, nk)`
    - `clusters`: number of clusters, 2 at least
    """
    if not region.any():
        raise InputError("fuzzy clustering: the region is empty")
    data = channels if channels.ndim == 4 else channels[..., np.newaxis]
    values = data[region].astype(float)
    if not np.isfinite(values).all():
        raise InputError("fuzzy clustering: a grey value in the region is not finite")
    scale = np.maximum(np.ptp(values, axis=0), 1e-300)
    values = values / scale
    if len(np.unique(values, axis=0)) < clusters:
        raise InputError(
            f"fuzzy clustering: the region has fewer different grey values than {clusters} clusters"
        )
    random = np.random.default_rng(1)
    best, least = None, np.inf
    for _ in range(_STARTS):
        centre = _first_centres(values, clusters, random)
        for _ in range(_ITERATIONS):
            # memberships that minimise the objective for given centres
            distances = np.maximum(cdist(values, centre, "sqeuclidean"), 1e-30)
            closeness = distances ** (-1.0 / (_FUZZINESS - 1.0))
            membership = closeness / closeness.sum(axis=1, keepdims=True)
            weight = membership**_FUZZINESS
            moved = weight.T @ values / weight.sum(axis=0)[:, np.newaxis]
            still = np.abs(moved - centre).max() < _AT_REST
            centre = moved
            if still:
                break
        misfit = float((weight * cdist(values, centre, "sqeuclidean")).sum())
        if misfit < least:
            least = misfit
            order = np.argsort(centre[:, 0], kind="stable")
            best = Clusters(membership[:, order], (centre * scale)[order])
    assert best is not None
    return best


def _first_centres(values: F64, clusters: int, random: np.random.Generator) -> F64:
    """Centres picked one after the other, far places more likely [2]."""
    centres = [values[random.integers(len(values))]]
    nearest = np.full(len(values), np.inf)
    while len(centres) < clusters:
        nearest = np.minimum(nearest, ((values - centres[-1]) ** 2).sum(axis=1))
        centres.append(values[random.choice(len(values), p=nearest / nearest.sum())])
    return np.array(centres)
