"""Proper orthogonal modes of snapshots (6.13)-(6.26)."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from myork.errors import InputError
from myork.types import F64

__all__ = ["Basis", "modes_for_energy", "proper_orthogonal_basis"]

#: Where modes may come from
_WAYS = ("svd", "eigen", "snapshots")


class Basis(NamedTuple):
    """Modes and how much of the snapshots each holds.

    Attributes
    ----------
    modes : F64
        Orthonormal columns, shape `(dofs, n)`.
    values : F64
        Proper orthogonal values (6.22), shape `(n,)`, falling.
    seconds : float
        Wall time of the decomposition [s].
    """

    modes: F64
    values: F64
    seconds: float


def proper_orthogonal_basis(snapshots: F64, way: str = "svd", *, unit: bool = False) -> Basis:
    """Proper orthogonal modes of snapshots.

    Parameters
    ----------
    snapshots : F64
        One state a row, shape `(s, dofs)`.
    way : str
        `svd` for singular values (6.22), `eigen` for the eigenvalue problem of the averaged
        autocorrelation (6.15), of size n, `snapshots` for that of the method of snapshots (6.19),
        of size s. The last two lose modes whose values are below rounding of the largest.
    unit : bool
        Divide every snapshot by its norm: errors that are relative to each state want modes that
        know the small ones as well as the large ones.
    """
    started = time.perf_counter()
    if way not in _WAYS:
        raise InputError(f"modes come from {', '.join(_WAYS)}, not from {way!r}")
    if unit:
        size = np.linalg.norm(snapshots, axis=1)
        snapshots = snapshots[size > 0.0] / size[size > 0.0, np.newaxis]
    s = len(snapshots)
    if not s:
        raise InputError("modes come from states that are not all zero; there is none")
    if way == "svd":
        modes, singular, _ = np.linalg.svd(snapshots.T, full_matrices=False)
        values = singular**2 / s
    else:
        products = snapshots.T @ snapshots if way == "eigen" else snapshots @ snapshots.T
        values, modes = np.linalg.eigh(products / s)
        # what is below rounding of the largest is no mode
        kept = np.flatnonzero(values > len(values) * np.finfo(float).eps * values[-1])
        kept = kept[: -min(snapshots.shape) - 1 : -1]
        values, modes = values[kept], modes[:, kept]
        if way == "snapshots":
            # (6.21)
            modes = snapshots.T @ modes / np.sqrt(s * values)
    return Basis(modes, values, time.perf_counter() - started)


def modes_for_energy(values: F64, share: float) -> int:
    """Number of modes that hold a share of the sum of all proper orthogonal values (6.32)."""
    return int(np.searchsorted(np.cumsum(values), share * values.sum())) + 1
