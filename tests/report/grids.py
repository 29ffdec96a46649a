"""Places and surfaces of blocks of points, as the core writes them for boxes."""

import numpy as np

from myork.types import F64, I32


def lattice_of(points: F64) -> I32:
    """Place of each point of a block, shape `(n, 3)`."""
    places = [np.unique(np.round(axis, 9), return_inverse=True)[1] for axis in points.T]
    return np.stack(places, axis=1).astype(np.int32)


def surface_of(lattice: I32) -> I32:
    """Triangles of the six faces, or those that fill a plane block."""
    at = np.empty(lattice.max(axis=0) + 1, np.int32)
    at[tuple(lattice.T)] = np.arange(len(lattice))
    sheets = [at[:, :, 0]]
    if at.shape[2] > 1:
        # sheets of x, z turn the other way
        sheets = [
            np.take(at, side, axis=axis)[:: 1 if (side == -1) == (axis != 1) else -1]
            for axis in range(3)
            for side in (0, -1)
        ]
    found = []
    for sheet in sheets:
        corners = [sheet[:-1, :-1], sheet[1:, :-1], sheet[1:, 1:], sheet[:-1, 1:]]
        square = np.stack(corners, axis=-1).reshape(-1, 4)
        found += [square[:, [0, 1, 2]], square[:, [0, 2, 3]]]
    return np.concatenate(found)
