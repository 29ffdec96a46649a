"""Water and fat from magnitude and phase of two or more echoes (Dixon).

An echo is (W + c F) exp(i phase), where c sums the peaks of fat at the echo time, or is 1 in phase
and -1 in opposed phase. The magnitudes of two echoes admit two fractions of fat, each with its own
phase, and the true phase is smooth over the body. Pairs of voxels up to some millimetres apart vote
on whether they agree; voxels, then groups, join by these votes, also across dark cortex. One choice
is left for each body: fat lies under the skin.

With more echoes, three pairs are separated in this way, up to whole turns between their echoes. The
misfit of all echoes selects the turns, the decay exp(-R2* t) and, where it is clear, the choice.

References: Berglund, Ahlstrom, Johansson, Kullberg, Magn. Reson. Med. 65 (2011) 994-1004 (two
candidates at any echo times); Bydder, Yokoo, Yu, Carl, Reeder, Sirlin, Magn. Reson. Imaging 29
(2011) 216-221 (water and fat with one phase); Yu et al., Magn. Reson. Med. 60 (2008) 1122-1134
(peaks of fat and decay)
"""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from myork.errors import InputError
from myork.imaging.geometry import depth_in_slices, neighbours, slice_axis
from myork.records import Image
from myork.types import C128, F64, I64, Mask

Values = TypeVar("Values", F64, C128)

# Peaks of fat: shift from water [ppm] and part of the signal
_SHIFT = (-3.80, -3.40, -2.60, -1.94, -0.39, 0.60)
_PART = (0.087, 0.694, 0.128, 0.004, 0.039, 0.048)
_GYROMAGNETIC = 42.577  # [MHz/T]
# Values of a phase image that stand for one turn: radians, degrees, integers of manufacturers, and
# thousandths of a radian
_TURNS = (2.0 * np.pi, 360.0, 4096.0, 2000.0 * np.pi, 8192.0, 65536.0)
_REACH = 8.0  # largest distance of voxels that vote on each other [mm]
_NEAR = 2.0  # beyond this distance votes count less [mm]
_SMOOTH = 2.5  # standard deviation of the average over the phases of the chosen candidates [mm]
_ROUNDS = 10  # repetitions of the choice after averaging
_RIM = (2.5, 7.0)  # depths of the fat under the skin [mm]
_SMALL = 0.02  # part of the body below which a group is decided by the phases around it
_UNLIKE = 0.1  # fraction of fat by which rim and inside must differ
# Ratio of echoes beyond that of mixtures, and part of the body with it; on legs of SNR 12 to 40
# that decay by up to 14 % between the echoes, the right order had 0.013 where the other had less
_BEYOND, _MANY = 1.25, 0.05
_LEAST = 0.25  # least effective number of echoes averaged: noise is twice that of an echo
_TOO_FEW = 0.08  # below it echoes are refused: for two, fat turns by less than 23 degrees
_TURNS_TRIED = 2  # phase turns between the echoes of a pair
_FITS = 3  # alternations: water and fat, then frequency and decay
_PAIRS_TRIED = 3  # pairs of echoes
_BADLY = 4.0  # ratio of misfits beyond which a fit is not that of this tissue
_CLEARLY = 1.2  # ratio of misfits by which one candidate is clearly the better one


class WaterFat(NamedTuple):
    """Water and fat."""

    #: Signals, not negative, zero outside of the body, shape `(ni, nj, nk)`
    water: F64
    fat: F64
    fraction: F64  #: Fat fraction, 0 to 1, same shape [-]
    #: Smooth phase from the first echo to the second (with more: of the pair that separates best),
    #: same shape [radian]
    phase: F64
    decay: F64 | None  #: R2* of both, with three echoes or more, same shape [1/s]
    doubt: str  #: Why water and fat may be exchanged or wrong; empty without a doubt


def echo(magnitude: F64, phase: F64) -> C128:
    """Complex image of an echo.

    The value of a turn of the phase is the smallest of the usual ones (radians, degrees, 4096,
    thousandths of a radian, 8192, 65536) that covers its range.

    - `magnitude`, `phase`: shape `(ni, nj, nk)`
    """
    reach = float(np.ptp(phase))
    fitting = [one for one in _TURNS if reach <= 1.001 * one]
    if not fitting:
        raise InputError(
            f"the values of a phase image span {reach:g}, more than one turn in any usual unit; "
            "scale them to radians"
        )
    return np.asarray(magnitude * np.exp(2j * np.pi * phase / fitting[0]))


def fat_factors(times: Sequence[float], strength: float) -> tuple[complex, ...]:
    """Complex signal of a unit of fat at echo times, relative to water.

    - `times`: echo times [ms]
    - `strength`: field of the scanner [T]
    """
    turns = np.outer(times, _SHIFT) * (1e-3 * _GYROMAGNETIC * strength)
    return tuple(map(complex, np.exp(2j * np.pi * turns) @ np.array(_PART)))


def water_and_fat(
    magnitudes: Sequence[Image],
    phases: Sequence[Image],
    body: Mask,
    *,
    times: Sequence[float] = (),
    strength: float = 0.0,
) -> WaterFat:
    """Separate echoes, given by magnitude and phase, into water and fat.

    - `magnitudes`, `phases`: of all echoes (at least two), on one grid
    - `body`: voxels of the body, shape `(ni, nj, nk)`
    - `times`: echo times; without them, two echoes: in phase first, then in opposed phase [ms]
    - `strength`: field of the scanner, needed with times [T]
    """
    factors: tuple[complex, ...] = (complex(1.0), complex(-1.0))
    count = len(magnitudes)
    if len(phases) != count:
        raise InputError(
            f"dixon: {count} magnitudes and {len(phases)} phases; each echo needs one of each"
        )
    if len(times) or strength > 0 or count != 2:
        if len(set(times)) != count or not strength > 0:
            raise InputError(
                f"dixon: {count} echoes need {count} different echo times and a field above zero, "
                f"not {list(times)} ms and {strength:g} T; without both the first of two is in "
                "phase, the second opposed"
            )
        factors = fat_factors(times, strength)
    echoes = [echo(m.data, p.data) for m, p in zip(magnitudes, phases, strict=True)]
    spacing = magnitudes[0].spacing
    if count == 2:
        pair = factors[0], factors[1]
        return separate(echoes[0], echoes[1], body, spacing=spacing, factors=pair)
    return separate_many(echoes, body, spacing=spacing, factors=factors, times=times)


def separate_many(
    echoes: Sequence[C128],
    body: Mask,
    *,
    spacing: ArrayLike,
    factors: Sequence[complex],
    times: Sequence[float],
) -> WaterFat:
    """Separate three or more echoes into water and fat.

    - `echoes`, `body`, `spacing`, `factors`: of each echo, as in `separate`
    - `times`: echo times [ms]
    """
    size, signal = np.asarray(spacing, float), _inside(echoes, body)
    # Some scanners store phases with the opposite sign; the fullest slice shows which sign fits.
    axis = slice_axis(size, body.shape)
    place = np.arange(body.shape[axis]) == np.moveaxis(body, axis, 0).sum(axis=(1, 2)).argmax()
    some = body & np.expand_dims(place, tuple(np.delete(np.arange(3), axis)))
    signs = (signal[some[body]], signal[some[body]].conj())
    given, other = (_many(one, some, size, factors, times)[4].sum() for one in signs)
    sign = -1 if given > _CLEARLY * other else 1
    clear = max(given, other) > _CLEARLY * min(given, other)
    water, fat, decay, phase, _, doubts = _many(
        signal.conj() if sign < 0 else signal, body, size, factors, times, clear=clear
    )
    if sign < 0:
        doubts = (
            "dixon: all phases were taken with the opposite sign, with which the misfit of the "
            f"echoes is {given / max(other, 1e-300):.1f} times smaller; check that fat lies under "
            "the skin in fat.nii.gz",
            *doubts,
        )
    return _found(water, fat, sign * phase, body, doubts, decay)


def _many(
    signal: C128,
    body: Mask,
    size: F64,
    factors: Sequence[complex],
    times: Sequence[float],
    clear: bool = True,
) -> tuple[F64, F64, F64, F64, F64, tuple[str, ...]]:
    """Water, fat, R2* [1/s], phase and misfit, shape `(nvoxel,)` each, and doubts.

    - `clear`: whether the echoes decide the sign of their phases; otherwise the skin has to
    """
    pairs = list(combinations(range(len(times)), 2))
    worth = [_averages((factors[i], factors[j])) for i, j in pairs]
    gap = [abs(times[j] - times[i]) for i, j in pairs]
    # of nearly equally good pairs the one with the shortest gap first: it admits the fewest turns
    order = sorted(range(len(pairs)), key=lambda n: (worth[n] < 0.8 * max(worth), gap[n]))
    found, doubt = [], ""
    for n in order[:_PAIRS_TRIED]:
        i, j = pairs[n]
        *ways, why = _pair(signal[:, i], signal[:, j], body, size, (factors[i], factors[j]))
        doubt = doubt or why
        for phase in map(np.angle, ways):
            fit = _all_echoes(signal, phase, times[j] - times[i], times, factors, body, size)
            found.append((*fit, phase))
    misfit, water, fat, decay, phase = map(np.stack, zip(*found, strict=True))
    fraction = fat / np.maximum(water + fat, 1e-30)
    # the choice of candidate is made once for each connected component of the body
    piece, pieces = ndimage.label(body)
    piece = piece[body]
    whole = np.stack([np.bincount(piece, one) for one in misfit])
    chosen, sure = np.zeros(pieces + 1, int), np.ones(pieces + 1, bool)
    for number in range(1, pieces + 1):
        own, mine = whole[:, number], piece == number
        best = int(own.argmin())
        other = np.abs(fraction[:, mine] - fraction[best, mine]).mean(axis=1) > _UNLIKE
        sure[number] = not other.any() or own[other].min() > _CLEARLY * own[best]
        # where the echoes do not decide, the fat under the skin has decided in the first pair
        chosen[number] = best if sure[number] or own[0] > _CLEARLY * own[best] else 0
    pick = chosen[piece]
    badly = np.take_along_axis(misfit, pick[np.newaxis], axis=0)[0] > _BADLY * misfit.min(axis=0)
    pick = np.where(badly, misfit.argmin(axis=0), pick)[np.newaxis]
    water, fat, decay, phase, misfit = (
        np.take_along_axis(values, pick, axis=0)[0] for values in (water, fat, decay, phase, misfit)
    )
    doubts = (
        "" if clear and sure[piece].mean() > 1.0 - _SMALL else doubt,
        _misfit_doubt(misfit),
        _times_doubt(factors),
    )
    return water, fat, decay, phase, misfit, doubts


def separate(
    first: C128,
    second: C128,
    body: Mask,
    *,
    spacing: ArrayLike,
    factors: tuple[complex, complex] = (1.0, -1.0),
) -> WaterFat:
    """Separate two echoes into water and fat.

    - `first`, `second`: complex echoes, shape `(ni, nj, nk)`
    - `body`: voxels of the body, same shape
    - `spacing`: voxel sizes, shape `(3,)` [mm]
    - `factors`: of fat in both echoes, see `fat_factors`; by default in phase and in opposed phase
      [-]
    """
    size = np.asarray(spacing, float)
    one, two = _inside((first, second), body).T
    smooth, _, doubt = _pair(one, two, body, size, factors)
    phase = np.angle(smooth)
    turned = np.stack([one, two * np.exp(-1j * phase)], axis=-1)
    water, fat = _fit(turned, np.array(factors), np.ones(turned.shape))[:2]
    doubts = (doubt, _order_doubt(np.abs(one), np.abs(two), factors), _times_doubt(factors))
    return _found(water, fat, phase, body, doubts)


def _inside(echoes: Sequence[C128], body: Mask) -> C128:
    """Signal in the body, shape `(nvoxel, necho)`."""
    if not body.any():
        raise InputError("dixon: the body is empty; check image.body")
    signal = np.stack([one[body] for one in echoes], axis=-1)
    if not np.isfinite(signal).all():
        raise InputError("dixon: magnitude or phase is not finite in the body; replace the values")
    return signal


def _pair(
    one: C128, two: C128, body: Mask, size: F64, factors: tuple[complex, complex]
) -> tuple[C128, C128, str]:
    """Smooth phasors between two echoes without fat; same with both exchanged; doubt."""
    fractions = _fractions(np.abs(one), np.abs(two), factors)
    phasors = [_phasor(one, two, part, factors) for part in fractions]
    trust = np.minimum(np.abs(one), np.abs(two))
    typical = float(np.median(trust[trust > 0])) if (trust > 0).any() else 0.0
    if not typical > 0:
        raise InputError("dixon: one of the echoes has no signal in the body; check the files")
    trust = trust / typical
    state, group = _states(trust * (phasors[0] - phasors[1]), body, size)
    state, doubt = _rim_decides(state, group, fractions, trust, body, size)
    smooth = np.zeros(len(state), complex)
    for _ in range(_ROUNDS):
        chosen = np.asarray(np.where(state > 0, phasors[0], phasors[1]), complex)
        smooth = _average(trust * chosen, body, size)
        again = np.where(((phasors[0] - phasors[1]) * smooth.conj()).real >= 0, 1, -1)
        if np.array_equal(again, state):
            break
        state = again
    other = np.asarray(np.where(state > 0, phasors[1], phasors[0]), complex)
    return smooth, _average(trust * other, body, size), doubt


def _all_echoes(
    signal: C128,
    phase: F64,
    step: float,
    times: Sequence[float],
    factors: Sequence[complex],
    body: Mask,
    size: F64,
) -> tuple[F64, F64, F64, F64]:
    """Misfit around each voxel, water and fat in the first echo, R2* [1/s], shape `(nvoxel,)` each.

    The phase over a time `step` leaves whole turns open. Each number of turns is fitted; the
    frequency and the decay follow from the slope of the residual, averaged around each voxel.
    """
    time, mixed = np.array(times) - min(times), np.array(factors)
    fits = []
    for turn in range(-_TURNS_TRIED, _TURNS_TRIED + 1):
        # a slope of the logarithm: frequency and decay
        slope = np.asarray(1j * (phase + 2.0 * np.pi * turn) / step, np.complex128)
        for _ in range(_FITS):
            grown = np.exp(slope[:, np.newaxis] * time)
            even = signal * np.exp(-1j * slope.imag[:, np.newaxis] * time)
            water, fat, turned, misfit = _fit(even, mixed, np.abs(grown))
            model = np.asarray(
                grown * (water[:, np.newaxis] + fat[:, np.newaxis] * mixed) * turned,
                np.complex128,
            )
            slope = _slope(slope, signal, model, time, body, size)
        fits.append((_average(misfit, body, size), water, fat, -1000.0 * slope.real))
        if np.allclose(np.round(time / step), time / step, atol=1e-3):
            break  # turns make no difference
    best = np.argmin([fit[0] for fit in fits], axis=0)
    misfit, water, fat, decay = (
        np.take_along_axis(np.stack(values), best[np.newaxis], axis=0)[0]
        for values in zip(*fits, strict=True)
    )
    return misfit, water, fat, decay


def _found(
    water: F64, fat: F64, phase: F64, body: Mask, doubts: Sequence[str], decay: F64 | None = None
) -> WaterFat:
    """Values of the body voxels put on the grid."""
    both = water + fat
    fraction = np.divide(fat, both, out=np.zeros_like(fat), where=both > 0)
    return WaterFat(
        water=_on_grid(water, body),
        fat=_on_grid(fat, body),
        fraction=_on_grid(fraction, body),
        phase=_on_grid(phase, body),
        decay=None if decay is None else _on_grid(decay, body),
        doubt="; ".join(text for text in doubts if text),
    )


def _on_grid(values: Values, body: Mask) -> Values:
    grid = np.zeros(body.shape, values.dtype)
    grid[body] = values
    return grid


def _fractions(one: F64, two: F64, factors: tuple[complex, complex]) -> tuple[F64, F64]:
    """The two fractions of fat that explain two magnitudes, the smaller one first."""
    c = np.array(factors)
    slope, bend = 2.0 * (c.real - 1.0), np.abs(1.0 - c) ** 2
    a = one**2 * bend[1] - two**2 * bend[0]
    b = one**2 * slope[1] - two**2 * slope[0]
    root = np.sqrt(np.maximum(b**2 - 4.0 * a * (one**2 - two**2), 0.0))
    a = np.where(np.abs(a) > 1e-12 * (one**2 + two**2), a, np.inf)
    ends = np.clip((-b - root) / (2.0 * a), 0.0, 1.0), np.clip((-b + root) / (2.0 * a), 0.0, 1.0)
    return np.minimum(*ends), np.maximum(*ends)


def _phasor(one: C128, two: C128, fraction: F64, factors: tuple[complex, complex]) -> C128:
    """Unit phasor of the phase between the echoes, with that of the fat removed."""
    made = [1.0 - fraction + c * fraction for c in factors]
    product = two * one.conj() * made[0] * made[1].conj()
    size = np.abs(product)
    return np.divide(product, size, out=np.zeros_like(product), where=size > 0)


def _states(difference: C128, body: Mask, size: F64) -> tuple[I64, I64]:
    """Choice of candidate of each voxel, 1 or -1, consistent within a group, and its group number.

    Two voxels vote by Re(d conj(d')), where d is the difference of the candidates: positive where
    they should choose alike. Groups join their strongest partners, round by round.
    """
    low, high, vote = _pairs(difference, body, size)
    state = np.ones(len(difference), np.int64)
    group = np.arange(len(difference))
    while len(vote):
        count = int(group.max()) + 1
        order = np.argsort(np.abs(vote), kind="stable")
        rank = np.empty(len(vote), np.int64)
        rank[order] = np.arange(len(vote))
        best = np.full(count, -1)
        np.maximum.at(best, low, rank)
        np.maximum.at(best, high, rank)
        node = np.arange(count)
        pair = order[best]  # values of groups without a pair are not used
        other = low[pair] + high[pair] - node
        # Ranks differ, so that the only possible cycle is that of two mutual partners.
        root = (best < 0) | ((best[np.where(best < 0, node, other)] == best) & (node < other))
        parent = np.where(root, node, other)
        sign = np.where(root | (vote[pair] > 0), 1, -1)
        while (parent[parent] != parent).any():
            sign, parent = sign * sign[parent], parent[parent]
        state *= sign[group]
        names, place = np.unique(parent, return_inverse=True)
        group = place[group]
        vote = vote * sign[low] * sign[high]
        low, high = np.sort([place[low], place[high]], axis=0)
        key, where = np.unique(low * len(names) + high, return_inverse=True)
        vote = np.bincount(where, vote, len(key)).astype(np.float64)
        low, high = np.divmod(key, len(names))
        apart = (low != high) & (vote != 0)
        low, high, vote = low[apart], high[apart], vote[apart]
    return state, group


def _pairs(difference: C128, body: Mask, size: F64) -> tuple[I64, I64, F64]:
    """Pairs of voxels along the axes with their votes: lower and higher number, vote."""
    ends: list[tuple[I64, I64, F64]] = []
    for axis in range(3):
        step = 1
        while step == 1 or step * size[axis] <= _REACH:
            low, high = neighbours(body, axis, step)
            vote = (difference[low] * difference[high].conj()).real
            ends.append((low, high, vote / (1.0 + (step * size[axis] / _NEAR) ** 2)))
            step *= 2
    low, high, vote = (np.concatenate(part) for part in zip(*ends, strict=True))
    some = vote != 0
    return low[some], high[some], vote[some]


def _rim_decides(
    state: I64,
    group: I64,
    fractions: tuple[F64, F64],
    trust: F64,
    body: Mask,
    size: F64,
) -> tuple[I64, str]:
    """Candidates of all large groups, chosen such that fat lies under the skin; doubts."""
    axis = slice_axis(size, body.shape)
    depth = depth_in_slices(np.moveaxis(body, axis, 2), np.delete(size, axis))
    deep = np.moveaxis(depth, 2, axis)[body]
    outer = (deep > _RIM[0]) & (deep <= _RIM[1])
    result, doubt = state.copy(), ""
    for number in np.flatnonzero(np.bincount(group) >= _SMALL * len(group)):
        mine = group == number
        contrast = []
        for way in (1, -1):
            fraction = np.where(way * state > 0, fractions[0], fractions[1])
            means = [
                np.average(fraction[part], weights=trust[part])
                for part in (mine & outer, mine & (deep > _RIM[1]))
                if trust[part].any()
            ]
            contrast.append(means[0] - means[1] if len(means) == 2 else 0.0)
        if contrast[1] > contrast[0]:
            result[mine] *= -1
        if max(contrast) < _UNLIKE:
            doubt = (
                "dixon: there is no more fat under the skin than inside (fractions differ by "
                f"{max(contrast):.2f}); check whether water and fat are swapped"
            )
    return result, doubt


def _order_doubt(one: F64, two: F64, factors: tuple[complex, complex]) -> str:
    """Warning where the magnitudes fit mixtures better with the echoes exchanged."""
    part = np.linspace(0.0, 1.0, 101)
    first, second = (np.maximum(np.abs(1.0 - part + c * part), 1e-3) for c in factors)
    low, high = (second / first).min() / _BEYOND, (second / first).max() * _BEYOND
    bright = np.maximum(one, two)
    seen = bright > 0.5 * np.median(bright)
    mine, other = (
        float(((b > high * a) | (b < low * a))[seen].mean()) for a, b in ((one, two), (two, one))
    )
    if mine < max(_MANY, 2.0 * other):
        return ""
    return (
        f"dixon: {100.0 * mine:.0f} % of the body is brighter in one of the echoes than any "
        f"mixture of water and fat ({100.0 * other:.0f} % with the echoes swapped); check whether "
        "their order is that of dixon.echo_times (without these in phase first, opposed second)"
    )


def _misfit_doubt(misfit: F64) -> str:
    """Warning where echoes are no mixture of water and fat in a large part of the body."""
    part = float((misfit > _BADLY * np.quantile(misfit, 0.2)).mean())
    if part < _MANY:
        return ""
    return (
        f"dixon: in {100.0 * part:.0f} % of the body the echoes are further from a mixture of "
        "water and fat than elsewhere; look at the fraction of fat there, and at "
        "dixon.echo_times and dixon.field_strength"
    )


def _averages(factors: Sequence[complex]) -> float:
    """Effective number of echoes averaged in water and fat: 1 for one, 2 for the mean of two."""
    matrix = np.stack([np.ones(len(factors)), np.array(factors)], axis=-1)
    smallest = np.linalg.eigvalsh((matrix.conj().T @ matrix).real)[0]
    return max(float(smallest), 1e-12)


def _times_doubt(factors: Sequence[complex]) -> str:
    """Warning where fat differs too little between the echoes, so that noise grows."""
    averages = _averages(factors)
    what = (
        f"dixon: fat has nearly the same phase in {'both' if len(factors) == 2 else 'all'} echoes, "
        f"which makes the noise of water and fat {averages**-0.5:.1f} times that of an echo; look "
        "at dixon.echo_times and dixon.field_strength"
    )
    if averages < _TOO_FEW:
        raise InputError(f"{what}; such echoes cannot separate water and fat")
    return what if averages < _LEAST else ""


def _average(values: Values, body: Mask, size: F64) -> Values:
    """Sum under a Gaussian."""
    return np.asarray(ndimage.gaussian_filter(_on_grid(values, body), _SMOOTH / size)[body])


def _fit(signal: C128, factors: C128, left: F64) -> tuple[F64, F64, C128, F64]:
    """Water and fat, not negative, by least squares with a common phase (Bydder 2011).

    - `signal`, `left`: echoes of one frequency, and the decay factor of each, shape
      `(nvoxel, necho)`
    - `factors`: of fat in each echo, shape `(necho,)`
    - returns water, fat, the phasor of both, shape `(nvoxel, 1)`, and the remaining sum of
      squares
    """
    weight = left**2
    a, b, c = weight.sum(-1), weight @ factors.real, weight @ np.abs(factors) ** 2
    normal = np.stack([np.stack([c, -b], -1), np.stack([-b, a], -1)], -2)
    normal /= np.maximum(a * c - b**2, 1e-12)[:, np.newaxis, np.newaxis]
    right = np.stack([(left * signal).sum(-1), (left * signal) @ factors.conj()], -1)
    half = np.einsum("vij,vj->vi", normal, right)
    turned = np.exp(0.5j * np.angle((half * right).sum(axis=-1)))[:, np.newaxis]
    found = np.einsum("vij,vj->vi", normal, (right * turned.conj()).real)
    sign = np.where(found.sum(axis=-1, keepdims=True) < 0, -1.0, 1.0)
    water, fat = np.maximum(found * sign, 0.0).T
    model = left * (water[:, np.newaxis] + fat[:, np.newaxis] * factors) * turned * sign
    return water, fat, turned * sign, (np.abs(signal - model) ** 2).sum(-1)


def _slope(slope: C128, signal: C128, model: C128, time: F64, body: Mask, size: F64) -> C128:
    """Frequency and decay corrected by the residual of a model, averaged around each voxel."""
    weight = np.abs(model) ** 2
    ratio = signal * model.conj()
    left = ratio * np.exp(-1j * np.angle(ratio.sum(-1, keepdims=True)))
    known = (np.abs(left) > 0) & (weight > 0)
    logarithm = np.log(np.divide(left, weight, out=np.ones_like(left), where=known))
    whole = np.maximum(weight.sum(-1, keepdims=True), 1e-30)
    away = time - (weight * time).sum(-1, keepdims=True) / whole
    top = (weight * away * logarithm).sum(-1)
    bottom = (weight * away**2).sum(-1)
    more = _average(top, body, size) / np.maximum(_average(bottom, body, size), 1e-30)
    new = slope + more
    return np.asarray(np.minimum(new.real, 0.0) + 1j * new.imag, np.complex128)
