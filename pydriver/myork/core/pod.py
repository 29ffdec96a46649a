"""Proper orthogonal decomposition: checks around the compiled core."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from myork import _core, errors
from myork.types import F64

__all__ = ["BASES", "pod_basis"]


#: Where modes may come from
BASES = ("svd", "eigen", "snapshots")


def pod_basis(snapshots: ArrayLike, way: str = "svd") -> tuple[F64, F64]:
    """Proper orthogonal modes and values of snapshots (6.13)-(6.26).

    Parameters
    ----------
    snapshots : ArrayLike
        One state a row, shape `(s, n)`.
    way : str
        `svd` for singular values (6.22), `eigen` for the eigenvalue problem of the averaged
        autocorrelation (6.15), of size n, `snapshots` for that of the method of snapshots (6.19),
        of size s. The last two lose modes whose values are below rounding of the largest.

    Returns
    -------
    modes, values : F64
        Orthonormal modes in columns, shape `(n, k)`, `k = min(n, s)` or fewer where some are lost,
        and proper orthogonal values.
    """
    if way not in BASES:
        raise errors.InputError(f"modes come from {', '.join(BASES)}, not from {way!r}")
    states = np.asarray(snapshots, float)
    if states.ndim != 2 or states.size == 0:
        raise errors.InputError(f"snapshots must have shape (s, n), not {states.shape}")
    modes, values, kept, stat, message = _core.pod_basis(min(states.shape), states.T, way)
    errors.check(stat, message)
    return modes[:, : int(kept)], values[: int(kept)]
