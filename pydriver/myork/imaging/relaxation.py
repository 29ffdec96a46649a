"""T2 from the magnitudes of a multi-echo spin-echo series.

The signal of a voxel decays as exp(-t / T2). Magnitudes end on a floor of noise, which the air
shows: the mean square of air is taken off the squared signal, and echoes whose fit lies near the
floor are left out. The rest is a line through logarithms, each weighted by its squared signal.
Refocusing pulses short of 180 degrees make stimulated echoes, in all but the first echo: it lies
below the decay of the others, and is then left out. Of three echoes the second one is: it has the
largest stimulated part, and in the ratio of the others most of theirs cancels.

References
----------
Gudbjartsson, Patz, Magn. Reson. Med. 34 (1995) 910-914, doi:10.1002/mrm.1910340618 (noise of
magnitudes); Miller, Joseph, Magn. Reson. Imaging 11 (1993) 1051-1056 (squared signals less noise)
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from myork.errors import InputError
from myork.records import Image
from myork.types import F64, Mask

# Echoes whose fit is not this many times the typical air are left out: three times the noise of a
# magnitude, whose median in air is 1.18 times it.
_FLOOR = 2.5
_ROUNDS = 5  # of fitting and leaving out
_LONGEST = 10.0  # times the last echo: a slower decay cannot be measured
# Parts by which the first echo may lie below the decay of the others, and any be off that of all,
# in the median over the body
_BELOW, _OFF = 0.02, 0.05


class Decay(NamedTuple):
    """Decay of each voxel."""

    #: Time constant, zero outside of the body and where two echoes are not above the noise, shape
    #: `(ni, nj, nk)` [ms]
    time: F64
    first: F64  #: Signal at time zero, same shape
    doubt: str  #: Why times may be wrong; empty where nothing speaks for it


def t2_map(echoes: Sequence[Image], times: Sequence[float], body: Mask) -> Decay:
    """Fit a decay to every voxel.

    Parameters
    ----------
    echoes : sequence of Image
        Magnitudes of two echoes or more on one grid.
    times : sequence
        Their times, in any order [ms].
    body : NDArray
        Voxels to fit, shape `(ni, nj, nk)`; what is outside is taken as air.
    """
    count = len(echoes)
    if count < 2 or len(set(times)) != count:
        raise InputError(
            f"t2: {count} echoes need as many different echo times, at least two, not "
            f"{list(times)} ms; name one image for each echo, and give t2.echo_times"
        )
    if not body.any():
        raise InputError("t2: the body is empty; check image.body")
    order = np.argsort(times)
    time = np.asarray(times, float)[order]
    signal = np.stack([echoes[n].data[body] for n in order], axis=-1)
    if not np.isfinite(signal).all():
        raise InputError("t2: an echo is not finite in the body; replace the values")
    air = np.stack([one.data[~body] for one in echoes])
    air = air[np.isfinite(air) & (air > 0)]
    floor, power = (float(np.median(air)), float(np.mean(air**2))) if air.size else (0.0, 0.0)
    clean = np.sqrt(np.maximum(signal**2 - power, 0.0))
    rate, first, off = _fit(clean, time, _FLOOR * floor)
    doubt = ""
    if count > 2:
        rest = _fit(clean[:, 1:], time[1:], _FLOOR * floor)
        beyond = np.median(clean[:, 0] / np.maximum(rest[1] * np.exp(-rest[0] * time[0]), 1e-30))
        if beyond < 1.0 - _BELOW:
            if count == 3:
                rest = _fit(clean[:, ::2], time[::2], _FLOOR * floor)
            rate, first, off = rest
            out = "the second one" if count == 3 else "it"
            error = " (a third where it is long)" if count == 3 else ""
            doubt = (
                f"t2: the first echo, at {time[0]:.4g} ms, has {100 * beyond:.0f} % of the signal "
                f"that the others lead to; {out} was left out: refocusing pulses are short of 180 "
                f"degrees, and T2 may be some per cent off{error}"
            )
    if not doubt and off > _OFF:
        doubt = (
            f"t2: an echo is {100 * off:.0f} % off the decay of all in the median over the body; "
            "check t2.echo_times, and that magnitudes are of one series"
        )
    known = rate > 0
    found, start = np.zeros((2, *body.shape))
    found[body] = np.where(known, 1.0 / np.where(known, rate, 1.0), 0.0)
    start[body] = first
    return Decay(found, start, doubt)


def _fit(signal: F64, time: F64, floor: float) -> tuple[F64, F64, float]:
    """Rate [1/ms], zero where it is not known, signal at time zero, and how far an echo is off."""
    logarithm = np.log(np.maximum(signal, 1e-3 * floor + 1e-30))
    model = signal
    rate, first = np.zeros((2, len(signal)))
    known = np.zeros(len(signal), np.bool_)
    for _ in range(_ROUNDS):
        # echoes behind the first one in the noise are in it as well
        used = np.logical_and.accumulate(model > floor, axis=1)
        weight = np.where(used, model**2, 0.0)
        whole = np.maximum(weight.sum(axis=1, keepdims=True), 1e-30)
        middle = (weight * time).sum(axis=1, keepdims=True) / whole
        height = (weight * logarithm).sum(axis=1, keepdims=True) / whole
        spread = (weight * (time - middle) ** 2).sum(axis=1)
        known = (used.sum(axis=1) > 1) & (spread > 0)
        slope = (weight * (time - middle) * (logarithm - height)).sum(axis=1)
        slope = np.divide(slope, spread, out=np.zeros_like(slope), where=known)
        rate = np.clip(-slope, 1.0 / (_LONGEST * time[-1]), 10.0 / time[0])
        first = np.where(known, np.exp(height[:, 0] + rate * middle[:, 0]), 0.0)
        model = first[:, np.newaxis] * np.exp(-rate[:, np.newaxis] * time)
        model = np.where(known[:, np.newaxis], model, signal)
    seen = (model > floor) & known[:, np.newaxis]
    off = [
        abs(float(np.median(signal[own, n] / model[own, n])) - 1.0)
        for n, own in enumerate(seen.T)
        if own.sum() > 0.1 * len(signal)
    ]
    return np.where(known, rate, 0.0), first, max(off, default=0.0)
