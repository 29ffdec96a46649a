"""Muscle architecture as reported by MR studies: size, fat, diffusion, fibers, PCSA.

The long axis of a muscle is the first principal axis of its voxels, if it is half as long again
as the second one. From a thousand voxels of a muscle, fibers are traced both ways until they leave
it; the median length is reported. PCSA is volume times the cosine of the pennation over
the length of the fibers [1].

Reference: [1] Lieber, Fridén, Muscle Nerve 23 (2000) 1647-1666
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from myork.imaging.diffusion import unit_vectors
from myork.imaging.geometry import slice_axis
from myork.records import Image, Labels
from myork.types import F64, Mask

# Ratio of the variances along the first two principal axes from which on a muscle has a long axis.
_LONG = 1.5**2
# Part of the largest section at an end of the image from which on the muscle is cut.
_CUT = 0.1
# Layers of voxels at the side of an image that a muscle may enter without being cut
_RIM = 2.0
# With at most so many layers a chord says little: a muscle is cut that is also this much wider than
# deep, and has less at its other side by this ratio. Of random ellipses of 3 to 5 layers that touch
# a side this takes 0 to 6 % for cut; of cut ones it finds 74 to 86 %.
_FEW, _WIDER, _LESS = 5, 4 / 3, 1.2
# Sides of an image by world axis, at its low and its high end
_SIDES = (("left", "right"), ("posterior", "anterior"), ("inferior", "superior"))
# Number of fibers traced; part of them that must end inside the image for their median to be given
_FIBERS, _WHOLE = 1000, 0.75
# Step length of fiber tracing, relative to the smallest voxel size
_STEP = 0.5


class Maps(NamedTuple):
    """Known maps of the voxels of a label map, on its grid; None where unknown."""

    fibers: Image | None = None  #: Vectors in the world frame, shape `(ni, nj, nk, 3)`
    fat: Image | None = None  #: Fraction of fat [-]
    signal: Image | None = None  #: Signal by which the fraction of fat is weighted
    #: Fractional anisotropy [-] and mean diffusivity [mm^2/s], 0 where there is no tensor
    fa: Image | None = None
    md: Image | None = None


class Numbers(NamedTuple):
    """Numbers of a muscle; None where the data at hand do not allow one."""

    muscle: str  #: Name
    volume: float  #: Of its voxels [mm^3]
    area: float  #: Largest section across the voxel axis nearest to its long axis [mm^2]
    fat_fraction: float | None  #: All its fat relative to all its signal [-]
    #: Medians of fractional anisotropy [-] and mean diffusivity [mm^2/s]
    fa: float | None
    md: float | None
    #: Median; None where a quarter of the fibers leave the image at an end of the muscle [mm]
    fiber_length: float | None
    #: Median angle between the fibers and its long axis, None without one [degree]
    pennation: float | None
    pcsa: float | None  #: None also for a muscle that the image cuts [mm^2]
    cut: bool  #: Whether the image cuts it


#: Header and unit of each column of a table, and the power of the length in it
COLUMNS: Mapping[str, tuple[str, str, int]] = {
    "volume": ("volume", "", 3),
    "area": ("area", "", 2),
    "fat_fraction": ("fat_fraction", "-", 0),
    "fa": ("FA", "-", 0),
    "md": ("MD", "mm^2/s", 0),
    "fiber_length": ("fiber_length", "", 1),
    "pennation": ("pennation", "deg", 0),
    "pcsa": ("PCSA", "", 2),
}


def muscle_numbers(
    labels: Labels, maps: Maps, left_out: Collection[int] = (), along: int | None = None
) -> list[Numbers]:
    """Numbers of all muscles of a label map.

    - `labels`: label map
    - `maps`: known maps of its voxels
    - `left_out`: labels that are not muscles
    - `along`: voxel axis of a prism, which is the long axis of all its muscles
    """
    if maps.fibers is not None:
        maps = maps._replace(fibers=replace(maps.fibers, data=unit_vectors(maps.fibers.data)[0]))
    return [_of(labels, number, maps, along) for number in labels.present if number not in left_out]


def fat_of_label(own: Mask, fraction: Image, signal: Image) -> float | None:
    """Total fat of some voxels relative to their total signal [-]; None without signal.

    - `own`: the voxels, shape `(ni, nj, nk)`
    - `fraction`, `signal`: fraction of fat [-] and signal of water and fat
    """
    weight = np.maximum(signal.data[own], 0.0)
    return float(np.average(fraction.data[own], weights=weight)) if weight.sum() > 0 else None


def _of(labels: Labels, number: int, maps: Maps, along: int | None) -> Numbers:
    """Numbers of a muscle."""
    own, size = labels.data == number, labels.spacing
    long, axis = long_axis(labels, own, along)
    layers = own.sum(axis=tuple({0, 1, 2} - {axis}))
    cut = bool(max(layers[0], layers[-1]) > _CUT * layers.max())
    volume = float(layers.sum() * size.prod())
    length, pennation = None, None
    if maps.fibers is not None:
        known = own & maps.fibers.data.any(axis=-1)
        if known.any():
            length = _median_length(maps.fibers, own, np.argwhere(known), axis)
            if long is not None:
                cosine = np.clip(np.abs(maps.fibers.data[known] @ long), 0.0, 1.0)
                pennation = _median(np.degrees(np.arccos(cosine)))
    pcsa = None
    if length is not None and pennation is not None and not cut:
        pcsa = volume * float(np.cos(np.radians(pennation))) / length
    fat = None
    if maps.fat is not None and maps.signal is not None:
        fat = fat_of_label(own, maps.fat, maps.signal)
    fa, md = (
        None if one is None else _median(one.data[own & (one.data > 0)])
        for one in (maps.fa, maps.md)
    )
    area = float(layers.max() * size.prod() / size[axis])
    return Numbers(
        labels.label_name(number), volume, area, fat, fa, md, length, pennation, pcsa, cut
    )


def _median(values: F64) -> float | None:
    """Median of the finite values."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None


def long_axis(labels: Labels, own: Mask, along: int | None = None) -> tuple[F64 | None, int]:
    """Long axis of a muscle in the world (None without one), and the voxel axis nearest to it.

    - `along`: voxel axis of a prism
    """
    columns = labels.affine[:3, :3] / labels.spacing
    if along is not None:
        return columns[:, along], along
    place = labels.world(np.argwhere(own))
    place = place - place.mean(axis=0)
    variance, axes = np.linalg.eigh(place.T @ place)
    if variance[2] < _LONG * variance[1] or variance[2] <= 0:
        return None, slice_axis(labels.spacing, own.shape)
    return axes[:, 2], int(np.argmax(np.abs(axes[:, 2] @ columns)))


def cut_sides(labels: Labels, number: int, along: int | None = None) -> list[str]:
    """Sides of the image that cut off a part of a muscle, except its ends along the slices.

    - `along`: voxel axis of a prism

    A round muscle that only touches a side has there, within two voxels of its rim (less in a small
    one), a chord that follows from its width; a longer chord means that it is cut.
    """
    own = labels.data == number
    ends = {along}
    if along is None:
        ends = {long_axis(labels, own)[1], slice_axis(labels.spacing, own.shape)}
    extent = np.ptp(np.argwhere(own), axis=0) + 1
    found = []
    for axis in {0, 1, 2} - ends:
        layers = own.sum(axis=tuple({0, 1, 2} - {axis}))
        chord = np.sqrt(1.0 - (1.0 - min(2.0 * _RIM / extent[axis], 0.5)) ** 2)
        deep, *wide = np.roll(extent * labels.spacing, -axis)
        few = extent[axis] <= _FEW
        if few and (extent[axis] < 3 or min(wide) < _WIDER * deep):
            continue
        filled = np.flatnonzero(layers)
        column = labels.affine[:3, axis]
        world = int(np.argmax(np.abs(column)))
        for end, other, sense in ((0, filled[-1], -1), (-1, filled[0], 1)):
            least = max(chord * layers.max(), _LESS * layers[other] if few else 0.0)
            if layers[end] > least:
                found.append(_SIDES[world][int(sense * column[world] > 0)])
    return sorted(found)


def _median_length(fibers: Image, own: Mask, seeds: NDArray, axis: int) -> float | None:
    """Median length of the fibers of a muscle; None where too many of them are cut [mm]."""
    seeds = seeds[:: -(-len(seeds) // _FIBERS)]
    step = _STEP * float(fibers.spacing.min())
    most = int(np.linalg.norm(fibers.spacing * own.shape) / step) + 1
    to_voxels = np.linalg.inv(fibers.affine[:3, :3]).T * step
    unit, shape = fibers.data, np.array(own.shape)
    length, whole = np.zeros(len(seeds)), np.ones(len(seeds), bool)
    for sense in (1.0, -1.0):
        going, place = np.arange(len(seeds)), seeds.astype(float)
        heading = sense * unit[tuple(seeds.T)]
        for _ in range(most):
            place = place + heading @ to_voxels
            voxel = np.rint(place).astype(int)
            near = tuple(voxel.clip(0, shape - 1).T)
            inside = own[near] & ((voxel >= 0) & (voxel < shape)).all(axis=1)
            whole[going[(voxel[:, axis] < 0) | (voxel[:, axis] >= shape[axis])]] = False
            length[going] += np.where(inside, step, 0.5 * step)
            going, place, heading = going[inside], place[inside], heading[inside]
            if not len(going):
                break
            found = unit[near][inside]
            sign = np.where((found * heading).sum(axis=1) < 0, -1.0, 1.0)[:, np.newaxis]
            heading = np.where(found.any(axis=1, keepdims=True), sign * found, heading)
        whole[going] = False  # closed loops
    return float(np.median(length[whole])) if whole.mean() >= _WHOLE else None
