"""Phantoms as tables about images take them."""

from __future__ import annotations

from typing import Any

import numpy as np

from myork.imaging.phantom import make_phantom
from myork.types import F64

__all__ = ["coarse", "fine_phantom"]


def fine_phantom(slices: int = 5, **keys: Any) -> Any:
    """A calf in pixels of 0.35 mm, without noise and shading."""
    return make_phantom((352, 352, slices), (0.35, 0.35, 7.0), snr=1e6, bias=0.0, **keys)


def coarse(values: F64) -> F64:
    """Means of 4 x 4 voxels in the slices."""
    n = values.shape[0] // 4, values.shape[1] // 4
    return np.asarray(values.reshape(n[0], 4, n[1], 4, *values.shape[2:]).mean(axis=(1, 3)))
