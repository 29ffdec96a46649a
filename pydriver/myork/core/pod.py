"""Proper orthogonal decomposition: checks around the compiled core."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from myork import _core, errors

F64Array = NDArray[np.float64]


def pod_basis(snapshots: ArrayLike) -> tuple[F64Array, F64Array]:
    """Proper orthogonal modes and values of snapshots (6.22).

    Parameters
    ----------
    snapshots : ArrayLike
        One state a row, shape `(s, n)`.

    Returns
    -------
    modes, values : F64Array
        Orthonormal modes in columns, shape `(n, min(n, s))`, and proper orthogonal values.
    """
    states = np.asarray(snapshots, float)
    if states.ndim != 2 or states.size == 0:
        raise errors.InputError(f"snapshots must have shape (s, n), not {states.shape}")
    modes, values, stat, message = _core.pod_basis(min(states.shape), states.T)
    errors.check(stat, message)
    return modes, values
