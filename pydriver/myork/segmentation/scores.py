"""Agreement of two segmentations."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["dice", "pearson"]


def dice(found: ArrayLike, truth: ArrayLike) -> float:
    """Dice coefficient (4.6): twice the common voxels over the sum of both [-].

    Not a number where both are empty.
    """
    a, m = np.asarray(found, bool), np.asarray(truth, bool)
    total = int(a.sum()) + int(m.sum())
    return 2.0 * int((a & m).sum()) / total if total else float("nan")


def pearson(found: ArrayLike, truth: ArrayLike) -> float:
    """Pearson's correlation coefficient (4.7) of two images of one shape [-].

    Not a number where one of them is constant.
    """
    f, g = (np.asarray(a, float).ravel() for a in (found, truth))
    f, g = f - f.mean(), g - g.mean()
    scale = float(np.sqrt((f @ f) * (g @ g)))
    return float(f @ g) / scale if scale > 0 else float("nan")
