"""Spacing of scattered source points, the unit of their supports."""

import numpy as np
from scipy.spatial import cKDTree

from myork.errors import InputError
from myork.types import F64


def source_spacing(source: F64) -> F64:
    """Spacing around each source point: the distance to its sixth neighbour, the fourth in a plane.

    On a cubic lattice these are the nearest ones, one spacing away. At faces, edges and where
    points are far apart the distance grows, and the support with it, as one-sided neighbourhoods
    need; where points are dense it shrinks. For a cloud that is stretched along axes, divide its
    coordinates by the stretch of each axis, and multiply the spacing by it.

    - `source`: source points, shape `(n, 3)`, in a plane all with the same third coordinate
      [length]
    - returns shape `(n, 3)` [length]
    """
    directions = int((np.ptp(source, axis=0) > 0).sum())
    if len(source) <= 2 * directions:
        raise InputError(
            f"{len(source)} source points are too few to determine their spacing: "
            f"{2 * directions + 1} are needed"
        )
    distance, _ = cKDTree(source).query(source, k=2 * directions + 1)
    return np.asarray(np.tile(distance[:, -1:], 3))
