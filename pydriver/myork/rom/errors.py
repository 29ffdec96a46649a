"""Errors of a reduced solution against the full one, summed over the load steps."""

from __future__ import annotations

import numpy as np

from myork.core.states import Fields
from myork.types import F64

__all__ = ["displacement_error", "gradient_error", "largest_error"]


def displacement_error(full: list[Fields], reduced: list[Fields]) -> float:
    """Error e1 of the displacement (6.70), (6.71), over time (6.51), (6.52) [-]."""
    return _relative([a.u for a in full], [b.u for b in reduced])


def gradient_error(full: list[Fields], reduced: list[Fields]) -> float:
    """Error e2 of the displacement gradient (6.72) [-].

    The components are summed at each point before the norm is taken, as printed.
    """
    return _relative(
        [(a.f - np.eye(3)).sum(axis=(1, 2)) for a in full],
        [(b.f - np.eye(3)).sum(axis=(1, 2)) for b in reduced],
    )


def largest_error(full: F64, reduced: F64) -> float:
    """Largest difference over the largest value of the full model, NaN if one of them is [-]."""
    scale = float(np.abs(full).max())
    return float(np.abs(full - reduced).max()) / scale if scale != 0.0 else 0.0


def _relative(full: list[F64], reduced: list[F64]) -> float:
    """Sum over the steps of |full - reduced| / |full|."""
    return float(
        sum(
            np.linalg.norm(a - b) / np.linalg.norm(a)
            for a, b in zip(full, reduced, strict=True)
            if np.linalg.norm(a) > 0.0
        )
    )
