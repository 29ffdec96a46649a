"""Spacing of scattered source points, the unit of their supports."""

import numpy as np
from scipy.spatial import cKDTree

from myork.errors import InputError
from myork.types import F64


def source_spacing(source: F64) -> F64:
    """Spacing around each source point: the distance of its sixth neighbour, four in a plane.

    On a cubic lattice these are the nearest ones, one spacing away. At faces, edges and where
    points are torn apart the distance grows, and the support with it, as one-sided neighbourhoods
    need; where points crowd it shrinks. For a cloud that is drawn out along axes, divide its
    coordinates by what each axis is drawn out by, and multiply the spacing by that.

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
