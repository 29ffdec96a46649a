"""Slices damaged by a scanner or an export, detected by changes that no anatomy shows.

Such slices have no signal, repeat their neighbour, differ from it in brightness or position, or
show a copy of the body in the air (ghost).
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from myork.imaging.geometry import slice_axis
from myork.records import Image, Labels
from myork.types import C128, F64, I64, Mask

# Mean signal, relative to that of the neighbours, below which a slice is empty
_NO_SIGNAL = 0.05
# Share of repeated slices from which on they come from a coarser image
_COARSER = 0.25
# Ratio of the signals of two slices, relative to that of their neighbours
_JUMP = 1.4
# Displacement between two slices, relative to that of their neighbours [voxel], and the increase
# in the correlation of their edges that it must bring
_MOVED = 3.0
_BETTER = 0.05
# Ratio of areas from which on two slices are not compared: they cut a limb lengthwise near its side
_GROWN = 1.15
# Threshold of the body relative to a bright percentile; number of steps compared on either side
_BODY, _BRIGHT = 0.3, 98
_DIM = 0.15  # the same with its darkest parts included, and with bright ghosts
_AROUND = 3
# Least brightness of a ghost relative to the body. At noise level, it must correlate with the body
# by the first of these, and brighter ones by more, up to the second: dark fat does not.
# Least displacement as a part of the image, and distance from the border of the body [voxel]
_GHOST = 0.02
_LIKE = (0.5, 0.8)
_GROWS = 3.0
_AWAY = 0.12
_BORDER = 4
# Least variance of the body's copy in the air, relative to the square of its brightest value
_SEEN = 0.005


class Damage(NamedTuple):
    """Slices of an image with one fault."""

    slices: list[int]  #: From 0, along the axis of the longest voxels
    why: str  #: Description of the fault

    def said(self, name: str) -> str:
        """Warning about the file."""
        numbers = ", ".join(map(str, self.slices))
        plural = len(self.slices) > 1
        return (
            f"{name}: slice{'s' * plural} {numbers} (counted from 0) {'have' if plural else 'has'} "
            f"{self.why}: remove {'them' if plural else 'it'} from all images, or repeat the scan"
        )


def damaged_slices(image: Image) -> list[Damage]:
    """Slices of an image that cannot be anatomy.

    - `image`: values of one kind, shape `(ni, nj, nk)` or `(ni, nj, nk, nvolume)`; of several
      volumes the mean is used
    - returns `no signal` between slices with signal, `the values of the slice before`, a signal
      that differs by a factor of 1.4 and a shift of 3 voxels against the neighbours, and `a copy of
      the body`; where all slices from some slice on are off, only that one is named
    """
    data = np.abs(np.asarray(image.data, float))
    data = data.mean(axis=3) if data.ndim == 4 else data
    slices = np.moveaxis(data, slice_axis(image.spacing, data.shape[:3]), 0)
    full = _full(slices.mean(axis=(1, 2)))
    repeated = _repeated(slices, full)
    whole = np.setdiff1d(np.flatnonzero(full), repeated)
    smooth = ndimage.gaussian_filter(slices[whole], (0.0, 1.0, 1.0))
    body = np.array([one > _BODY * np.percentile(one, _BRIGHT) for one in smooth], dtype=bool)
    signal, place = _signal_steps(smooth, body), _place_steps(smooth)
    area = np.log(np.maximum(body.sum(axis=(1, 2)), 1)) if len(body) else np.zeros(0)
    unlike = np.abs(np.diff(area)) > np.log(_GROWN)
    signal[unlike], place[unlike] = 0.0, 0.0
    faults = [
        Damage(_between(full), "no signal"),
        Damage(repeated, "the values of the slice before"),
        Damage(
            _off(whole, signal, np.log(_JUMP)),
            f"a signal that differs from the neighbours by a factor of more than {_JUMP}",
        ),
        Damage(
            _off(whole, place, _MOVED),
            f"a shift of {_MOVED:g} voxels or more against the neighbours",
        ),
        Damage(
            _ghosts(whole, slices[whole], smooth),
            "a copy of the body in the air (ghost, or a second, dim limb)",
        ),
    ]
    return [fault for fault in faults if fault.slices]


def missing_slices(labels: Labels) -> list[Damage]:
    """Slices without any label between slices with labels: the body would be cut in two."""
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
    """Empty slices between slices with signal."""
    at = np.flatnonzero(full)
    return [k for k in range(at[0], at[-1]) if not full[k]] if len(at) else []


def _repeated(slices: F64, full: Mask) -> list[int]:
    """Slices equal to the one before, unless there are many: then a coarser image was resampled."""
    found = [
        k for k in range(1, len(slices)) if full[k] and np.array_equal(slices[k], slices[k - 1])
    ]
    return found if len(found) <= _COARSER * len(slices) else []


def _signal_steps(smooth: F64, body: Mask) -> F64:
    """Logarithm of the signal ratio between slices, within both bodies, shape `(n - 1, 1)`."""
    steps = np.zeros((max(len(smooth) - 1, 0), 1))
    for k in range(len(steps)):
        both = body[k] & body[k + 1]
        if both.any():
            steps[k] = np.median(np.log(smooth[k + 1][both] / smooth[k][both]))
    return steps


def _place_steps(smooth: F64) -> F64:
    """Displacement of the edges from each slice to the next [voxel], shape `(n - 1, 2)`.

    Position of the largest correlation of their gradients; zero if hardly above that unshifted.
    """
    shape = smooth.shape[1:]
    edges = [ndimage.gaussian_gradient_magnitude(np.sqrt(one), 1.0) for one in smooth]
    waves = [np.fft.rfft2((one - one.mean()) / max(one.std(), 1e-300)) for one in edges]
    steps = np.zeros((max(len(smooth) - 1, 0), 2))
    for k in range(len(steps)):
        alike = np.fft.irfft2(waves[k].conj() * waves[k + 1], shape) / np.prod(shape)
        at = np.unravel_index(int(alike.argmax()), shape)
        if alike[at] > alike[0, 0] + _BETTER:
            steps[k] = [(i + n // 2) % n - n // 2 for i, n in zip(at, shape, strict=True)]
    return steps


def _off(whole: I64, steps: F64, bound: float) -> list[int]:
    """Slices after a step that differs from the steps around it, except after the step back."""
    found, left = [], np.zeros(steps.shape[1])
    apart = np.diff(whole)[:, np.newaxis]
    for k, step in enumerate(steps):
        near = [n for n in range(k - _AROUND, k + _AROUND + 1) if n != k and 0 <= n < len(steps)]
        if len(near) < 2:
            break
        off = step - apart[k] * np.median((steps / apart)[near], axis=0)
        size = np.linalg.norm(off)
        if size < bound * apart[k, 0] or np.linalg.norm(off + left) < 0.5 * size:
            left = 0.0 * off
            continue
        found.append(int(whole[k + 1]))
        left = off
    return found


def _ghosts(whole: I64, slices: F64, smooth: F64) -> list[int]:
    """Slices whose air correlates with the body displaced along an axis."""
    found = []
    for k, raw, image in zip(whole, slices, smooth, strict=True):
        for part in (_BODY, _DIM):
            body = image > part * np.percentile(image, _BRIGHT)
            # the body with its dark parts, filled up to its border in rows and columns
            inside = _filled(body) | _filled(body.T).T
            # voxels set to zero are not air
            air = ~ndimage.binary_dilation(inside | (raw == 0), iterations=_BORDER)
            shown = np.where(inside, image, 0.0)
            if _copied(image, air, shown) or _copied(image.T, air.T, shown.T):
                found.append(int(k))
                break
    return found


def _filled(body: Mask) -> Mask:
    """Rows filled from the first to the last voxel of the body."""
    forth, back = (np.logical_or.accumulate(one, axis=1) for one in (body, body[:, ::-1]))
    return forth & back[:, ::-1]


def _copied(image: F64, air: Mask, shown: F64) -> bool:
    """Whether the air shows a copy of the body, displaced along the second axis."""
    n, count = image.shape[1], max(float(air.sum()), 1.0)
    where, value = (
        np.fft.rfft(one, axis=1).conj() for one in (air.astype(float), np.where(air, image, 0.0))
    )

    def mean(one: C128, other: F64) -> F64:
        return np.fft.irfft(one * np.fft.rfft(other, axis=1), n, axis=1).sum(axis=0) / count

    # moments of the image and of the body over the air, for each displacement
    own, body = image[air].sum() / count, mean(where, shown)
    scatter = (image[air] ** 2).sum() / count - own**2
    varies = mean(where, shown**2) - body**2
    along = mean(value, shown) - own * body
    away = np.minimum(np.arange(n), n - np.arange(n)) > _AWAY * n
    away &= varies > _SEEN * (shown**2).max()
    part = np.where(away, along / np.where(away, varies, 1.0), 0.0)
    like = np.where(away, along / np.sqrt(np.where(away, varies, 1.0) * max(scatter, 1e-300)), 0.0)
    return bool(((part > _GHOST) & (like > np.minimum(_LIKE[0] + _GROWS * part, _LIKE[1]))).any())
