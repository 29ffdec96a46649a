"""Fuzzy C-means clustering of voxels into dark and bright.

Reference: Bezdek, Ehrlich, Full, Comput. Geosci. 10 (1984), doi:10.1016/0098-3004(84)90020-7
"""

from itertools import combinations

import numpy as np

from myork.errors import InputError
from myork.types import F64, Mask

# Percentiles at which centres start, in pairs: where one cluster is small, a pair may end with it
# merged into the other; the pair with the least objective is kept.
_STARTS = (1.0, 50.0, 99.0)
_ITERATIONS = 100
_AT_REST = 1e-4  # remaining motion of the centres, relative to the range of the values


def bright_cluster(values: F64, region: Mask) -> tuple[F64, F64]:
    """Membership of voxels in the brighter one of two fuzzy clusters, with the usual exponent 2.

    - `values`: grey values, shape `(ni, nj, nk)`
    - `region`: voxels that take part, same shape
    - returns memberships, 0 outside of the region, same shape [-]; centres of the dark and of the
      bright cluster, shape `(2,)`
    """
    if not region.any():
        raise InputError("fuzzy clustering: the region is empty")
    inside = values[region].astype(float)[:, np.newaxis]
    if not np.isfinite(inside).all():
        raise InputError("fuzzy clustering: a grey value in the region is not finite")
    scale = float(np.ptp(inside))
    if not scale > 0:
        raise InputError("fuzzy clustering: the region has one grey value only")
    inside /= scale
    best, least = (np.zeros_like(inside), np.zeros(2)), np.inf
    for start in combinations(np.percentile(inside, _STARTS), 2):
        centre = np.array(start)
        for _ in range(_ITERATIONS):
            # memberships that minimise the objective for given centres
            closeness = 1.0 / np.maximum((inside - centre) ** 2, 1e-30)
            membership = closeness / closeness.sum(axis=1, keepdims=True)
            weight = membership**2
            before, centre = centre, (weight * inside).sum(axis=0) / weight.sum(axis=0)
            if np.abs(centre - before).max() < _AT_REST:
                break
        misfit = float((weight * (inside - centre) ** 2).sum())
        if misfit < least:
            least, order = misfit, np.argsort(centre)
            best = membership[:, order], centre[order] * scale
    found = np.zeros(region.shape)
    found[region] = best[0][:, 1]
    return found, best[1]
