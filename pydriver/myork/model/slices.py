"""Thick slices cut into thinner ones: labels by their shapes, fibers by their dyads; prisms.

Signed distances to the outlines are linear from slice to slice, moved along a spline through the
centres, and cut where the area is that of a spline through the areas. A label that is missing from
the next slice ends half way in a tip. Labels that touch in their slices leave no gap.

Reference: Herman, Zheng, Bucholtz, IEEE Comput. Graph. Appl. 12 (1992), doi:10.1109/38.135915
"""

from dataclasses import replace

import numpy as np
from scipy import ndimage, sparse
from scipy.interpolate import make_interp_spline
from scipy.sparse.csgraph import connected_components

from myork.errors import InputError
from myork.imaging.diffusion import dyads_of, lead_vector, unit_vectors
from myork.imaging.geometry import Grid, canonical, slice_axis
from myork.model.fibers import fill_from_own
from myork.records import Image, Labels
from myork.segmentation.outlines import signed_distances
from myork.types import F64, I32, I64, Mask

_ROOM = 8  # pixels around a label that it may move into
# Gaussian over the distances, which know the steps of pixels only [pixel]
_SMOOTHING = 0.5


def extruded(image: Grid, length: float) -> Grid:
    """A single slice drawn out to a prism, of slices about as thick as its pixels are wide.

    - `image`: one slice across the axis nearest to superior, however thick
    - `length`: length of the prism, whose middle is the slice [mm]
    """
    slice_ = canonical(image)
    if slice_.data.shape[2] != 1:
        raise InputError(
            f"{image.name}: build.extrude makes a prism of a single slice across the axis nearest "
            f"to superior, and this image has {slice_.data.shape[2]} of them; leave it out"
        )
    count = max(2, round(length / float(slice_.spacing[:2].max())))
    affine = slice_.affine.copy()
    affine[:3, 2] *= length / (count * slice_.spacing[2])
    affine[:3, 3] -= 0.5 * (count - 1) * affine[:3, 2]
    return replace(slice_, data=np.repeat(slice_.data, count, axis=2), affine=affine)


def slice_parts(spacing: F64, thickness: float) -> tuple[int, int]:
    """Axis along which voxels are longest, and the parts into which each is cut.

    - `spacing`: voxel sizes, shape `(3,)` [mm]
    - `thickness`: wanted thickness of slices [mm]
    """
    axis = slice_axis(spacing)
    return axis, max(1, round(float(spacing[axis]) / thickness))


def finer_labels(labels: Labels, axis: int, parts: int) -> Labels:
    """Labels on slices cut into parts.

    - `labels`: shape `(ni, nj, nk)`
    - `axis`: along which slices follow each other
    - `parts`: into which each slice is cut
    """
    data = np.moveaxis(labels.data, axis, 2)
    size = np.delete(labels.spacing, axis)
    shape = (*data.shape[:2], data.shape[2] * parts)
    result, inside = np.zeros(shape, np.int32), np.zeros(shape, np.bool_)
    # Of labels that meet, the one that is deepest inside has the voxel.
    depth = np.full(shape, -np.inf)
    low, _ = _neighbours(data.shape[2], parts)
    for group in _touching(data):
        # All together fill as much as each alone, and where one of them begins or ends none gives
        # way to the outline of all: that is no bend of the others.
        areas, changes = np.zeros(shape[2]), np.zeros(shape[2], np.bool_)
        for number in group:
            here = data == number
            around, centres = _around(here), _centres(data, [number])
            here = here[around]
            distance = _moved(here, size, parts, centres)
            wanted = _spline_areas(here, parts)
            distance = _cut(distance, wanted)
            better = distance > depth[around]
            result[around][better] = number
            depth[around][better] = distance[better]
            areas += np.where(np.isnan(wanted), (distance > 0).sum(axis=(0, 1)), wanted)
            there = here.any(axis=(0, 1))
            changes |= there[low] != there[np.minimum(low + 1, len(there) - 1)]
        if len(group) > 1:
            here = np.isin(data, group)
            around = _around(here)
            distance = _cut(_moved(here[around], size, parts, _centres(data, group)), areas)
        inside[around] |= (distance > 0) | (changes & (depth[around] > 0))
    result[~inside] = 0
    data = np.ascontiguousarray(np.moveaxis(result, 2, axis))
    affine = labels.affine.copy()
    affine[:3, axis] /= parts
    affine[:3, 3] -= labels.affine[:3, axis] * 0.5 * (1.0 - 1.0 / parts)
    return Labels(data, affine, labels.names, labels.name)


def finer_fibers(fibers: Image, labels: Labels, finer: Labels, axis: int, parts: int) -> Image:
    """Fibers for every voxel of the finer labels.

    - `fibers`: vectors, zero or not a number where there is none, shape `(ni, nj, nk, 3)`
    - `labels`, `finer`: labels before and after `finer_labels`; a voxel takes fibers of its own
      label only
    - `axis`, `parts`: as there
    """
    vector = np.moveaxis(fibers.data, axis, 2)
    before, after = (np.moveaxis(one.data, axis, 2) for one in (labels, finer))
    unit, valid = unit_vectors(vector)
    valid &= before > 0
    dyad = dyads_of(unit)
    low, share = _neighbours(before.shape[2], parts)
    share = np.clip(share, 0.0, 1.0)
    result = np.zeros((*after.shape, 3))
    for k, (first, part) in enumerate(zip(low, share, strict=True)):
        total = np.zeros((*after.shape[:2], 6))
        for slice_, weight in ((first, 1.0 - part), (min(first + 1, before.shape[2] - 1), part)):
            same = valid[:, :, slice_] & (before[:, :, slice_] == after[:, :, k])
            total += weight * same[..., np.newaxis] * dyad[:, :, slice_]
        known = total[..., :3].sum(axis=-1) > 1e-9
        result[:, :, k][known] = lead_vector(total[known])
    spacing = np.append(np.delete(finer.spacing, axis), finer.spacing[axis])
    done = np.asarray(result.any(axis=-1), np.bool_)
    fill_from_own(result, done, after, spacing)
    data = np.ascontiguousarray(np.moveaxis(result, 2, axis))
    return Image(data, finer.affine, fibers.name)


def finer_values(image: Image, labels: Labels, finer: Labels, axis: int, parts: int) -> Image:
    """Values of slices, given to all of their parts.

    - `image`: shape `(ni, nj, nk)`
    - `labels`, `finer`: labels before and after `finer_labels`; a voxel of a label takes values of
      that one only: what lies outside of a muscle is often zero
    - `axis`, `parts`: as there
    """
    data = np.repeat(image.data, parts, axis=axis)
    own = np.repeat(labels.data, parts, axis=axis) == finer.data
    fill_from_own(data, own, finer.data, finer.spacing)
    return Image(data, finer.affine, image.name)


def _touching(data: I32) -> list[list[int]]:
    """Labels in groups of those that touch each other in a slice."""
    numbers, where = np.unique(data, return_inverse=True)
    where = where.reshape(data.shape)
    pairs = []
    for axis in (0, 1):
        one, next_ = (np.moveaxis(where, axis, 0)[part] for part in (np.s_[1:], np.s_[:-1]))
        both = (one != next_) & (numbers[one] > 0) & (numbers[next_] > 0)
        pairs.append(np.stack([one[both], next_[both]]))
    links = np.concatenate(pairs, axis=1)
    count = len(numbers)
    graph = sparse.coo_array((np.ones(links.shape[1]), tuple(links)), shape=(count, count))
    groups = connected_components(graph, directed=False)[1]
    found = [numbers[(groups == group) & (numbers > 0)].tolist() for group in np.unique(groups)]
    return [group for group in found if group]


def _around(here: Mask) -> tuple[slice, slice]:
    """The part of the slices that a label is in or may move into."""
    first, second = (
        slice(max(0, part.start - _ROOM), part.stop + _ROOM)
        for part in ndimage.find_objects(here.astype(np.int8))[0][:2]
    )
    return first, second


def _spline_areas(here: Mask, parts: int) -> F64:
    """Areas of a label in the parts of all slices [pixel]; not a number where it is in one only."""
    low, share = _neighbours(here.shape[2], parts)
    place = low + share
    area = here.sum(axis=(0, 1))
    runs, count = ndimage.label(area > 0)
    wanted = np.full(len(place), np.nan)
    for run in range(1, count + 1):
        there = np.flatnonzero(runs == run)
        if len(there) == 1:
            continue
        spline = make_interp_spline(there, area[there], k=min(3, len(there) - 1))
        between = (place >= there[0]) & (place <= there[-1])
        wanted[between] = np.maximum(spline(place[between]), 1.0)
    return wanted


def _cut(distance: F64, areas: F64) -> F64:
    """Distances, a little evened, whose zero bounds so many pixels in each part.

    Where no area is known they are cut at the level of what is next to them.
    """
    distance = ndimage.gaussian_filter(distance, (_SMOOTHING, _SMOOTHING, 0.0))
    known = np.flatnonzero(~np.isnan(areas))
    if len(known) == 0:
        return distance
    levels = np.empty(len(known))
    for at, k in enumerate(known):
        number = int(np.clip(round(float(areas[k])), 0, distance[..., k].size - 1))
        values = -np.partition(-distance[..., k], (max(number - 1, 0), number), axis=None)
        levels[at] = 0.5 * (values[max(number - 1, 0)] + values[number])
    nearest = np.abs(known[:, np.newaxis] - np.arange(len(areas))).argmin(axis=0)
    return distance - levels[nearest]


def _moved(here: Mask, size: F64, parts: int, centres: F64) -> F64:
    """Distances in the middles of the parts of all slices; outlines move with their centres."""
    distance = signed_distances(here, size)
    count = here.shape[2]
    low, share = _neighbours(count, parts)
    if count == 1:
        return np.repeat(distance, parts, axis=2)
    result = np.empty((*here.shape[:2], len(low)))
    way = make_interp_spline(np.arange(count), centres, k=min(3, count - 1), axis=0)
    for k, (first, part) in enumerate(zip(low, share, strict=True)):
        centre = way(first + part)
        below, above = (
            ndimage.shift(distance[..., one], centre - centres[one], order=1, mode="nearest")
            for one in (first, first + 1)
        )
        result[..., k] = (1.0 - part) * below + part * above
    return result


def _centres(data: I32, group: list[int]) -> F64:
    """Middle of labels in each slice, counted from the first one [pixel].

    From slice to slice it moves as the middle of the labels that are in both.
    """
    steps = np.zeros((data.shape[2], 2))
    own = [np.intersect1d(group, data[..., k]) for k in range(data.shape[2])]
    for k in range(1, len(steps)):
        both = np.intersect1d(own[k - 1], own[k])
        if len(both):
            before, after = (
                np.argwhere(np.isin(data[..., one], both)).mean(axis=0) for one in (k - 1, k)
            )
            steps[k] = after - before
    return steps.cumsum(axis=0)


def _neighbours(count: int, parts: int) -> tuple[I64, F64]:
    """Slice below each part, and how far it lies towards the next."""
    place = (np.arange(count * parts) + 0.5) / parts - 0.5
    low = np.clip(np.floor(place).astype(np.int64), 0, max(count - 2, 0))
    return low, place - low
