"""Spacing of scattered source points, the unit of their supports."""

import numpy as np
from scipy.spatial import cKDTree

from myork.errors import InputError
from myork.types import F64


def source_spacing(source: F64, aspect: F64 | None = None) -> F64:
    """Spacing around each source point: the distance of its sixth neighbour, four in a plane.

    On a cubic lattice these are the nearest ones, one spacing away. At faces, edges and where
    points are torn apart the distance grows, and the support with it, as one-sided neighbourhoods
    need; where points crowd it shrinks.

    - `source`: source points, shape `(n, 3)`, in a plane all with the same third coordinate
      [length]
    - `aspect`: spacing in each direction relative to the others, for clouds drawn out along axes,
      shape `(3,)` [-]
    - returns shape `(n, 3)` [length]
    """
    unit = np.ones(3) if aspect is None else np.asarray(aspect, float)
    directions = int((np.ptp(source, axis=0) > 0).sum())
    if len(source) <= 2 * directions:
        raise InputError(
            f"{len(source)} source points are too few to determine their spacing: "
            f"{2 * directions + 1} are needed"
        )
    distance, _ = cKDTree(source / unit).query(source / unit, k=2 * directions + 1)
    return np.asarray(distance[:, -1:] * unit)
