"""Resample an image file onto the grid of another one, in the same way as images of decks."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from myork.console import ProgressCallback, silent
from myork.errors import InputError
from myork.imaging.io import read_image, read_labels, write_image, write_labels
from myork.imaging.resampling import WAYS
from myork.stations.data import OneGrid
from myork.types import F64

# Integers with more distinct values are grey values.
_MOST_LABELS = 128
# Masks under an image header are multiples of a small scale, with this deviation from integers.
_SCALED = 0.01


def resample(
    image: Path,
    like: Path,
    output: Path,
    *,
    way: str | None = None,
    progress: ProgressCallback = silent,
) -> Path:
    """Write an image on the grid of another one in the same world frame.

    - `image`: image of one or several volumes, or label map
    - `like`: image that gives the grid
    - `output`: file to write; the suffix gives the format
    - `way`: `nearest`, `linear` or `tensor-wise` (tensors, fibers), see `on_grid`; by default
      `nearest` for labels (whole numbers, not negative, of at most 128 values), and
      `linear` for all others, volume by volume
    - returns the file
    """
    if way not in (None, *WAYS):
        raise InputError(f"--how {way}: is not known; one of {', '.join(WAYS)}")
    grid = read_image(like, None)
    one = read_image(image, None)
    way = way or ("nearest" if _are_labels(image, one.data) else "linear")
    mover, single = OneGrid(progress), one.data.shape[3] == 1
    if way == "nearest" and single:
        write_labels(output, mover.of(read_labels(image), grid))
    else:
        found = mover.of(one, grid, way)
        write_image(output, replace(found, data=found.data[..., 0]) if single else found)
    if not mover.moved:
        progress(f"{image}: is on the grid of {like}")
    return output


def _are_labels(image: Path, values: F64) -> bool:
    """Whether values are non-negative integers with few distinct values, possibly scaled."""
    if values.shape[3] == 1 and np.abs(values - np.rint(values)).max() < _SCALED:
        try:
            values = read_labels(image).data.astype(float)
        except InputError:
            return False
    kinds = np.unique(values)
    return len(kinds) <= _MOST_LABELS and not (kinds % 1 != 0).any() and kinds.min() >= 0
