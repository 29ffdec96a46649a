"""Slices damaged by a scanner or an export: without signal, repeated, far brighter or darker."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from myork.imaging.geometry import slice_axis
from myork.records import Image, Labels
from myork.types import F64, Mask

# Mean signal of a slice, of that of its neighbours, below which it has none
_NO_SIGNAL = 0.05
# Factor from the signal between both neighbours that no anatomy makes where those beyond them agree
_JUMP = 1.4
# Factor up to which they agree
_ALIKE = 1.15
# Share of repeated slices from which on they are those of a coarser image
_COARSER = 0.25


class Damage(NamedTuple):
    """Slices of an image with one fault."""

    slices: list[int]  #: From 0, along the axis of the longest voxels
    why: str  #: Fault

    def said(self, name: str) -> str:
        """Warning about the file."""
        numbers = ", ".join(map(str, self.slices))
        plural = len(self.slices) > 1
        return (
            f"{name}: slice{'s' * plural} {numbers} (from 0) {'have' if plural else 'has'} "
            f"{self.why}: take {'them' if plural else 'it'} out of all images, or measure again"
        )


def damaged_slices(image: Image) -> list[Damage]:
    """Slices of an image that cannot be anatomy.

    - `image`: values of one kind, shape `(ni, nj, nk)` or `(ni, nj, nk, nvolume)`; of several
      volumes the mean is looked at
    - returns `no signal` between slices with signal, `the values of the slice before`, and a signal
      1.4 times brighter or darker than two neighbours on either side agree on
    """
    data = np.abs(np.asarray(image.data, float))
    data = data.mean(axis=3) if data.ndim == 4 else data
    slices = np.moveaxis(data, slice_axis(image.spacing, data.shape[:3]), 0)
    signal = slices.mean(axis=(1, 2))
    full = _full(signal)
    faults = [
        Damage(_between(full), "no signal"),
        Damage(_repeated(slices, full), "the values of the slice before"),
        Damage(_jumps(signal, full), f"a signal more than {_JUMP} times off its neighbours'"),
    ]
    return [fault for fault in faults if fault.slices]


def missing_slices(labels: Labels) -> list[Damage]:
    """Slices without any label between slices that have some: the body would be cut in two."""
    data = np.asarray(labels.data)
    axis = slice_axis(labels.spacing, data.shape)
    gaps = _between(np.any(np.moveaxis(data, axis, 0) > 0, axis=(1, 2)))
    return [Damage(gaps, "no label, which cuts the body in two")] if gaps else []


def _full(signal: F64) -> Mask:
    """Slices with signal."""
    if not signal.any():
        return np.zeros(len(signal), bool)
    usual = np.median(signal[signal > _NO_SIGNAL * signal.max()])
    full: Mask = signal > _NO_SIGNAL * usual
    return full


def _between(full: Mask) -> list[int]:
    """Empty slices that have full ones on both sides."""
    at = np.flatnonzero(full)
    return [k for k in range(at[0], at[-1]) if not full[k]] if len(at) else []


def _repeated(slices: F64, full: Mask) -> list[int]:
    """Slices with all values of the one before, unless many are so: a coarser image stretched."""
    found = [
        k for k in range(1, len(slices)) if full[k] and np.array_equal(slices[k], slices[k - 1])
    ]
    return found if len(found) <= _COARSER * len(slices) else []


def _jumps(signal: F64, full: Mask) -> list[int]:
    """Single slices far from what both neighbours and those beyond them agree on."""
    level = np.log(np.where(full, signal, 1.0))
    found = []
    for k in range(2, len(level) - 2):
        if not full[k - 2 : k + 3].all():
            continue
        near, far = (0.5 * (level[k - n] + level[k + n]) for n in (1, 2))
        if abs(near - far) < np.log(_ALIKE) and abs(level[k] - near) > np.log(_JUMP):
            found.append(k)
    return found
