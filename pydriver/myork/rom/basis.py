"""Modes of snapshots."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from myork.core.pod import pod_basis
from myork.types import F64

__all__ = ["Basis", "modes_for_energy", "proper_orthogonal_basis"]


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
        `svd`, `eigen` or `snapshots`, see `pod_basis`.
    unit : bool
        Divide every snapshot by its norm: errors that are relative to each state want modes that
        know the small ones as well as the large ones.
    """
    started = time.perf_counter()
    if unit:
        size = np.linalg.norm(snapshots, axis=1)
        snapshots = snapshots[size > 0.0] / size[size > 0.0, np.newaxis]
    modes, values = pod_basis(snapshots, way)
    return Basis(modes, values, time.perf_counter() - started)


def modes_for_energy(values: F64, share: float) -> int:
    """Number of modes that hold a share of the sum of all proper orthogonal values (6.32)."""
    return int(np.searchsorted(np.cumsum(values), share * values.sum())) + 1
