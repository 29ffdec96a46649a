"""Images: files, geometry of their grids, and a phantom with a known answer.

The functions below work on arrays with affines, from images to the points of a model; they are
loaded when they are first used.
"""

import importlib
from typing import Any

__all__ = [
    "build_points",
    "correct_bias",
    "fit_tensors",
    "mean_fibers",
    "parts_of_voxels",
    "resample",
    "segment",
    "water_and_fat",
]


def __getattr__(name: str) -> Any:
    """Load a function on arrays; they stand above the rooms that they use."""
    if name not in __all__:
        raise AttributeError(f"module 'myork.imaging' has no attribute {name!r}")
    return getattr(importlib.import_module("myork.stations.arrays"), name)


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
