"""Parts of labels in each voxel, from grey values between the means of two labels.

Values of a voxel at a border lie between the means of voxels around it that touch no other label.
Half of the voxels along a border are whole, of the others all parts are as likely, and the expected
part is taken. Voxels of labels that are as grey as each other keep their label.

References: Laidlaw, Fleischer, Barr, IEEE Trans. Med. Imaging 17 (1998) 74-86,
doi:10.1109/42.668696; Tohka, Zijdenbos, Evans, NeuroImage 23 (2004) 84-97,
doi:10.1016/j.neuroimage.2004.05.007
"""

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.special import ndtr

from myork.records import Image, Labels
from myork.segmentation.channels import local_means
from myork.types import F64, I32, I64, Mask

_AROUND = 6.0  # standard deviation of the Gaussian for local means [mm]
_FAR = 1e-2  # weight of all voxels of a label in a local mean
_FEW = 20  # number of whole voxels that a label needs for a mean
_PEAK = 90.0  # percentile, away from the surroundings, that represents a label without whole voxels
_LEVEL = 0.01  # least noise relative to the range of the values
_LEAST = 3.0  # ratio of the distance of two means to the noise, below which a voxel is not divided
_WHOLE = 0.5  # fraction of voxels that are whole
# Distance from the mean of their label, relative to the noise, of inner voxels that are mixed
_UNLIKE = 3.0


def label_parts(labels: I32, channels: F64, spacing: ArrayLike, unmixed: Sequence[int] = ()) -> F64:
    """Fraction of each voxel that each label fills.

    - `labels`: label map, shape `(ni, nj, nk)`. Unlabelled voxels are below one; their different
      kinds have separate numbers.
    - `channels`: grey values, shape `(ni, nj, nk, nchannel)`
    - `spacing`: voxel sizes, shape `(3,)` [mm]
    - `unmixed`: numbers that share no voxel with others: tissue that is not uniform, such as bone,
      or the outside of a mask
    - returns fractions of the labels above zero in ascending order, 0 to 1, shape `(ni, nj, nk,
      nlabel)` [-]; their sum is below 1 in voxels along unlabelled ones
    """
    numbers = np.unique(labels)
    kind = np.searchsorted(numbers, labels)
    low, high = (filter_(kind, 3, mode="nearest") for filter_ in
                 (ndimage.minimum_filter, ndimage.maximum_filter))  # fmt: skip
    border = low != high
    means = _Means(kind, channels, border, numbers > 0, np.asarray(spacing, float))
    fixed = np.flatnonzero(np.isin(numbers, unmixed))
    there = (border | means.unlike()) & ~np.isin(kind, fixed)
    at = np.argwhere(there)
    own, rows, inside = kind[there], np.arange(len(at)), ~border[there]
    beside = _contacts(kind, at, len(numbers))
    beside[np.ix_(inside, numbers > 0)] = 1
    beside[rows, own] = 0
    beside[:, fixed] = 0
    values = channels[there] / means.noise
    near = [means.near(number, there) / means.noise for number in range(len(numbers))]

    best, second, part = np.full(len(at), -np.inf), own.copy(), np.zeros(len(at))
    for first, other in permutations(range(len(numbers)), 2):
        touched = np.flatnonzero((own == first) & (beside[:, other] > 0))
        way = near[other][touched] - near[first][touched]
        gone = values[touched] - near[first][touched]
        length = np.linalg.norm(way, axis=1)
        apart = length > _LEAST
        along = np.divide((gone * way).sum(axis=1), length, out=np.zeros_like(length), where=apart)
        nearest = np.divide(np.clip(along, 0.0, length), length, out=0.0 * along, where=apart)
        misfit = ((gone - nearest[:, np.newaxis] * way) ** 2).sum(axis=1)
        likely = np.log(beside[touched, other]) - 0.5 * misfit
        wins = likely > best[touched]
        chosen = touched[wins]
        best[chosen], second[chosen] = likely[wins], other
        expected = _expected(along, np.maximum(length, _LEAST))
        part[chosen] = np.where(apart, expected, 0.0)[wins]
    parts = np.zeros((*labels.shape, len(numbers)))
    np.put_along_axis(parts, kind[..., np.newaxis], 1.0, axis=-1)
    parts[there] = 0.0
    i, j, k = at.T
    parts[i, j, k, own] += 1.0 - part
    parts[i, j, k, second] += part
    return np.asarray(parts[..., numbers > 0])


def parts_of_labels(
    labels: Labels, kinds: I32, channels: F64, unmixed: Sequence[int] = ()
) -> tuple[Image, dict[str, float]]:
    """Fractions of all labels, one volume each in ascending order, and the voxels that each fills.

    - `labels`: shape `(ni, nj, nk)`
    - `kinds`: numbers below one of unlabelled voxels, same shape
    - `channels`, `unmixed`: as in `label_parts`
    """
    everything = np.where(labels.data > 0, labels.data, kinds)
    parts = label_parts(everything, channels, labels.spacing, unmixed)
    filled = parts.sum(axis=(0, 1, 2)).tolist()
    return Image(parts, labels.affine), dict(zip(labels.present.values(), filled, strict=True))


def _contacts(kind: I64, at: I64, count: int) -> I32:
    """Number of voxels of each label among the 26 around places, shape `(nplace, nlabel)`."""
    wide = np.pad(kind, 1, mode="edge")
    found = np.zeros((len(at), count), np.int32)
    rows = np.arange(len(at))
    for step in np.ndindex(3, 3, 3):
        found[rows, wide[tuple((at + step).T)]] += 1
    return found


class _Means:
    """Values of labels around voxels, and the noise of whole voxels about them."""

    def __init__(self, kind: I64, channels: F64, border: Mask, labelled: Mask, size: F64) -> None:
        self._kind, self._channels = kind, channels
        self._width = _AROUND / size
        self._labelled = labelled[kind]
        inside = self._labelled & ~border
        inside = inside if inside.any() else np.ones_like(inside)
        # images without noise, or with a single value
        least = _LEVEL * np.maximum(np.ptp(channels.reshape(-1, channels.shape[3]), axis=0), 1e-300)
        self._whole = ~border
        self._apart = np.zeros(channels.shape)
        for number in np.unique(kind).tolist():
            mine = kind == number
            self._apart[mine] = channels[mine] - self.near(number, mine)
        noise = 1.4826 * np.median(np.abs(self._apart[inside]), axis=0)
        self.noise = np.maximum(noise, least)
        self._whole = ~border & ~self.unlike()

    def unlike(self) -> Mask:
        """Voxels of labels that are far from the mean of their label."""
        far = np.linalg.norm(self._apart / self.noise, axis=-1) > _UNLIKE
        return np.asarray(self._labelled & far)

    def near(self, number: int, there: Mask) -> F64:
        """Mean of a label around voxels, shape `(nvoxel, nchannel)`."""
        mine = self._kind == number
        whole = mine & self._whole
        if whole.sum() < _FEW:
            return np.tile(_peak(mine, self._channels), (int(there.sum()), 1))
        channels = np.moveaxis(self._channels, 3, 0)
        means = [local_means(one, whole, self._width, _FAR)[there] for one in channels]
        return np.stack(means, axis=-1)


def _peak(here: Mask, channels: F64) -> F64:
    """Values of a label that is thinner than three voxels everywhere."""
    around = ndimage.binary_dilation(here, iterations=2) & ~here
    result = []
    for c in range(channels.shape[3]):
        mine, other = channels[..., c][here], channels[..., c][around]
        bright = np.median(mine) > np.median(other) if other.size else True
        result.append(np.percentile(mine, _PEAK if bright else 100.0 - _PEAK))
    return np.array(result)


def _expected(along: F64, length: F64) -> F64:
    """Expected fraction of the other label.

    - `along`: distance from the own mean towards that of the other label, relative to the noise [-]
    - `length`: distance of both means, relative to the noise [-]
    """
    low, high = -along, length - along
    mixed = np.maximum(ndtr(high) - ndtr(low), 1e-12)
    normal = (np.exp(-0.5 * low**2) - np.exp(-0.5 * high**2)) / np.sqrt(2.0 * np.pi)
    mean = np.clip((along + normal / mixed) / length, 0.0, 1.0)
    one = _WHOLE * np.exp(-0.5 * along**2) / np.sqrt(2.0 * np.pi)
    some = (1.0 - _WHOLE) * mixed / length
    return some / (some + one) * mean
