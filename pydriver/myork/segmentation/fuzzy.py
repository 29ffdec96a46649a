"""Fuzzy C-means clustering of voxels.

References
----------
1. Bezdek, Ehrlich, Full, Comput. Geosci. 10 (1984), doi:10.1016/0098-3004(84)90020-7
2. Arthur, Vassilvitskii, SODA (2007): the start (k-means++)
3. Chuang et al., Comput. Med. Imaging Graph. 30 (2006), doi:10.1016/j.compmedimag.2005.10.001:
   the spatial term
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from myork.errors import InputError

__all__ = ["Clusters", "fuzzy_c_means"]

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Clusters:
    """Result of a clustering.

    Attributes
    ----------
    membership : NDArray
        Of every voxel of the region, rows sum to one, shape `(n, clusters)` [-].
    centre : NDArray
        Sorted by the first channel, shape `(clusters, channels)`.
    iterations : int
        Iterations done.
    converged : bool
        Whether no centre moved any more.
    """

    membership: F64
    centre: F64
    iterations: int
    converged: bool

    def place(self, region: NDArray[np.bool_], cluster: int) -> NDArray[np.bool_]:
        """Voxels of a region whose largest membership is that of a cluster."""
        mask = np.zeros(region.shape, dtype=bool)
        number = cluster % self.membership.shape[1]
        mask[region] = self.membership.argmax(axis=1) == number
        return mask


def fuzzy_c_means(
    channels: F64,
    region: NDArray[np.bool_],
    clusters: int,
    *,
    exponent: float = 2.0,
    spatial: float = 0.0,
    seed: int = 1,
    tolerance: float = 1e-4,
    iterations: int = 100,
) -> Clusters:
    """Cluster the voxels of a region by their grey values.

    Parameters
    ----------
    channels : NDArray
        Grey values, shape `(ni, nj, nk)` or `(ni, nj, nk, channels)`.
    region : NDArray
        Voxels that take part, shape `(ni, nj, nk)`.
    clusters : int
        Number of clusters, 2 at least.
    exponent : float
        Fuzziness above 1; 2 is usual.
    spatial : float
        Power with which the memberships of the eight neighbours in the slice count; 0 leaves
        them out, 1 removes single voxels of noise (and thins sheets).
    seed : int
        Start of the random numbers that pick the first centres.
    tolerance : float
        Part of the range of the values by which centres may still move at rest.
    iterations : int
        Most iterations.
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
    centre = _first_centres(values, clusters, seed)
    converged, done = False, 0
    while not converged and done < iterations:
        membership = _membership(values, centre, exponent)
        if spatial > 0:
            membership = _with_neighbours(membership, region, spatial)
        weight = membership**exponent
        moved = weight.T @ values / weight.sum(axis=0)[:, np.newaxis]
        converged = bool(np.abs(moved - centre).max() < tolerance)
        centre, done = moved, done + 1
    order = np.argsort(centre[:, 0], kind="stable")
    return Clusters(membership[:, order], (centre * scale)[order], done, converged)


def _first_centres(values: F64, clusters: int, seed: int) -> F64:
    """Centres picked one after the other, far places more likely [2]."""
    random = np.random.default_rng(seed)
    centres = [values[random.integers(len(values))]]
    nearest = np.full(len(values), np.inf)
    while len(centres) < clusters:
        nearest = np.minimum(nearest, ((values - centres[-1]) ** 2).sum(axis=1))
        centres.append(values[random.choice(len(values), p=nearest / nearest.sum())])
    return np.array(centres)


def _membership(values: F64, centre: F64, exponent: float) -> F64:
    """Memberships that minimise the objective for given centres."""
    squared = ((values[:, np.newaxis, :] - centre) ** 2).sum(axis=-1)
    closeness = np.maximum(squared, 1e-30) ** (-1.0 / (exponent - 1.0))
    return closeness / closeness.sum(axis=1, keepdims=True)


def _with_neighbours(membership: F64, region: NDArray[np.bool_], power: float) -> F64:
    """Memberships times a power of those around, in the slice [3]."""
    around = np.empty_like(membership)
    grid = np.zeros(region.shape)
    for cluster in range(membership.shape[1]):
        grid[region] = membership[:, cluster]
        around[:, cluster] = ndimage.uniform_filter(grid, (3, 3, 1), mode="constant")[region]
    both = membership * around**power
    return both / both.sum(axis=1, keepdims=True)
