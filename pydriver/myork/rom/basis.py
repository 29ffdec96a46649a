"""Modes of snapshots."""

from __future__ import annotations

import time
from typing import NamedTuple

from myork.core.pod import pod_basis
from myork.core.scene import F64Array

__all__ = ["Basis", "proper_orthogonal_basis"]


class Basis(NamedTuple):
    """Modes and how much of the snapshots each holds.

    Attributes
    ----------
    modes : F64Array
        Orthonormal columns, shape `(dofs, n)`.
    values : F64Array
        Proper orthogonal values (6.22), shape `(n,)`, falling.
    seconds : float
        Wall time of the decomposition [s].
    """

    modes: F64Array
    values: F64Array
    seconds: float


def proper_orthogonal_basis(snapshots: F64Array) -> Basis:
    """Proper orthogonal modes of snapshots, one state a row, shape `(s, dofs)`."""
    started = time.perf_counter()
    modes, values = pod_basis(snapshots)
    return Basis(modes, values, time.perf_counter() - started)
