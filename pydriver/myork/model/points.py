"""From labels to points: collocation points and source points.

The model uses the frame of the voxel axes nearest to the world axes, so that source points and
collocation points below the surface form lattices along x, y and z; for an image without rotation
this is the world frame.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage

from myork.errors import InputError
from myork.imaging.geometry import Grid, block_sums, canonical, frame, to_voxels
from myork.records import Labels
from myork.types import F64, I32, Index, Mask

# Label of voxels outside the model that are bone
BONE = -1
# Part of a block from which on it belongs to the body [-]. The volume is correct in any case:
# blocks below it give theirs to neighbours. With a half, the force of a spindle 5 to 8 blocks
# across was 2 to 6 % low, with a tenth 2 to 3 % high, with a third within 1 %.
_FILLED = 1.0 / 3.0
# Part of a volume from which on its change is reported; fractions of blocks keep it exactly, except
# for slices that do not fill whole blocks
_CHANGED = 0.02


def select(
    labels: Labels,
    ids: Sequence[int],
    slices: Sequence[int] | None,
    bone: Sequence[int] = (),
) -> Labels:
    """Keep some labels, in the slices of the model.

    - `labels`: label map with axes along the world's, shape `(ni, nj, nk)`
    - `ids`: labels to keep; empty keeps all above zero
    - `slices`: first and last slice to keep, counted from 0 at the lower end
    - `bone`: labels of bone, which is no part of the model but bounds it; they become `BONE`
    """
    present = list(labels.present)
    missing = sorted({*ids, *bone} - {*present} | {*ids} & {*bone})
    if missing or not present:
        raise InputError(
            f"{labels.name}: "
            + (f"no voxel has label {missing}" if missing else "no voxel has a label above zero")
            + f"; the labels there are: {', '.join(map(str, present)) or 'none'}"
        )
    data = np.where(np.isin(labels.data, bone), BONE, labels.data).astype(np.int32)
    data = np.where(np.isin(data, [*ids, BONE]), data, 0) if len(ids) else data
    low, high = (0, data.shape[2] - 1) if slices is None else slices
    if not 0 <= low <= high < data.shape[2]:
        raise InputError(
            f"build.slices = {[low, high]} does not lie in the {data.shape[2]} slices of "
            f"{labels.name} (counted from 0)"
        )
    part = data[:, :, low : high + 1]
    if not (part > 0).any():
        raise InputError(
            f"{labels.name}: slices {low} to {high} contain none of the model's labels"
        )
    return _moved(labels, part, np.array([0, 0, low]), np.ones(3))


def extruded(image: Grid, length: float) -> Grid:
    """A single slice extruded to a prism of slices about as thick as its pixels are wide.

    - `image`: one slice across the axis nearest to superior, however thick
    - `length`: length of the prism, centred on the slice [mm]
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


def coarsen(labels: Labels, block: Sequence[int], merge: str = "majority") -> Labels:
    """Merge blocks of voxels into one.

    Blocks are laid symmetrically about the middle; those that reach beyond the map are filled up
    with nothing, along z with the end slices.

    - `labels`: label map
    - `block`: voxels per block in each direction
    - `merge`: `majority`: a block of which the body fills a third belongs to it (its volume counts
      by what is filled, see `myork.model.shares`), and gets the label that fills most of that,
      after a little blur, so that where two are even the voxels around decide. `sample`: a block
      gets the label (or nothing) of the voxel in its middle (thesis section 4.1.2).
    """
    if max(block) == 1:
        return labels
    shape = np.array(labels.data.shape)
    size = np.array(block)
    extra = -shape % size
    # A whole block of nothing around each slice, too: the blur must see the outside.
    before = extra // 2 + size * [1, 1, 0]
    after = extra - extra // 2 + size * [1, 1, 0]
    pad = list(zip(before.tolist(), after.tolist(), strict=True))
    data = np.pad(labels.data, [*pad[:2], (0, 0)])
    data = np.pad(data, [(0, 0), (0, 0), pad[2]], mode="edge")
    if merge == "sample":
        best = data[tuple(slice((s - 1) // 2, None, s) for s in block)]
    else:
        best = _majority(data, size)
    if not (best > 0).any():
        raise InputError(
            f"{labels.name}: nothing is left of the labels in blocks of {tuple(block)} voxels; "
            "lower build.collocation_stride"
        )
    return trimmed(_moved(labels, best.astype(np.int32), -before + 0.5 * (size - 1), size))


def _majority(data: I32, size: Index) -> I32:
    """Label of each block: of what is no body, or where the body fills enough, of the body."""
    sigma = np.where(size > 1, 0.5, 0.0)
    filled = block_sums(data > 0, size) / size.prod() >= _FILLED
    best, votes = np.zeros(filled.shape, np.int32), np.zeros(filled.shape)
    for label in np.unique(data):
        blurred = ndimage.gaussian_filter((data == label).astype(float), sigma, mode="nearest")
        share = block_sums(blurred, size)
        share[filled != (label > 0)] = 0.0
        best = np.where(share > votes, label, best)
        votes = np.maximum(votes, share)
    return best


def first_voxel(fine: Labels, coarse: Labels, block: Sequence[int]) -> Index:
    """Voxel of a label map in which the first block of its merged voxels begins, shape `(3,)`."""
    middle = to_voxels(fine.affine, coarse.affine[:3, 3])
    return np.rint(middle - 0.5 * (np.array(block) - 1)).astype(np.intp)


def changed_volumes(
    fine: Labels,
    model: Mapping[int, float],
    wanted: Mapping[int, float] | None = None,
) -> list[str]:
    """A sentence for each label whose volume the merging of voxels changed.

    - `fine`: label map before the merging
    - `model`: volume of each label afterwards [mm^3]
    - `wanted`: volume of each label before; without it that of its voxels [mm^3]
    """
    sentences = []
    for label, name in fine.present.items():
        before = float((fine.data == label).sum() * fine.spacing.prod())
        before = before if wanted is None else wanted[label]
        after = model.get(label, 0.0)
        if abs(after - before) > _CHANGED * before:
            sentences.append(
                f"{name} has {after / 1000:.4g} cm^3 in the model and "
                f"{before / 1000:.4g} cm^3 in the label map: blocks of build.collocation_stride "
                "do not resolve it, or its slices do not fill whole blocks; lower the stride, or "
                "move build.slices"
            )
    return sentences


def connected_body(labels: Labels) -> tuple[Labels, list[str]]:
    """Leave out pieces that touch neither end, which nothing would hold in place.

    - `labels`: label map whose first and last slice are the ends; a single slice has no ends
    - returns labels without the pieces, and a sentence for each piece left out
    """
    body = labels.data > 0
    if body.shape[2] == 1:
        return labels, []
    pieces, n = ndimage.label(body)
    fixed = set(np.unique(pieces[:, :, [0, -1]]).tolist())
    loose = [piece for piece in range(1, n + 1) if piece not in fixed]
    if not loose:
        return labels, []
    sentences = []
    for piece in loose:
        voxels = np.argwhere(pieces == piece)
        names = sorted({labels.label_name(int(v)) for v in np.unique(labels.data[pieces == piece])})
        centre = labels.world(voxels.mean(axis=0))
        sentences.append(
            f"island of {len(voxels)} points ({', '.join(names)}) around "
            f"({', '.join(f'{c:.1f}' for c in centre)}) mm is connected to neither end and left "
            f"out, {100.0 * len(voxels) / body.sum():.2g} % of the body"
        )
    kept = np.where(np.isin(pieces, loose), 0, labels.data)
    return Labels(kept, labels.affine, labels.names, labels.name), sentences


def blunt_ends(body: Mask, least: float) -> tuple[int, int]:
    """First and last slice that hold at least a part of the largest section.

    - `body`: voxels of the body, shape `(ni, nj, nk)`
    - `least`: the part [-]
    """
    area = body.sum(axis=(0, 1))
    full = np.flatnonzero(area >= least * area.max())
    return int(full[0]), int(full[-1])


def source_voxels(body: Mask, step: Sequence[int]) -> Index:
    """Choose source points among the voxels of the body.

    A lattice with the given step that contains both ends in each direction, and then, so that the
    supports cover the boundary too, every voxel (in lexicographic order) that still has no source
    point nearer than one step in all directions at once.

    - `body`: voxels of the body, shape `(ni, nj, nk)`
    - `step`: distance of source points in each direction [voxel]
    - returns voxels in lexicographic order, shape `(nsource, 3)`
    """
    chosen = np.zeros(body.shape, dtype=bool)
    chosen[np.ix_(*(_nodes(n, s) for n, s in zip(body.shape, step, strict=True)))] = True
    chosen &= body
    reach = [2 * s - 1 for s in step]
    covered = ndimage.maximum_filter(chosen, size=reach, mode="constant")
    for voxel in np.argwhere(body & ~covered):
        if not covered[tuple(voxel)]:
            chosen[tuple(voxel)] = True
            near = tuple(slice(max(v - s + 1, 0), v + s) for v, s in zip(voxel, step, strict=True))
            covered[near] = True
    return np.argwhere(chosen)


def positions(labels: Labels, voxels: Index) -> F64:
    """Coordinates of voxel centres in the frame of the voxel axes, shape `(n, 3)` [mm]."""
    return voxels * labels.spacing + labels.affine[:3, 3] @ frame(labels.affine)


def trimmed(labels: Labels) -> Labels:
    """Cut a label map to the box of all labels above zero."""
    body = labels.data > 0
    box = [np.flatnonzero(body.any(axis=tuple({0, 1, 2} - {d}))) for d in range(3)]
    data = labels.data[tuple(slice(b[0], b[-1] + 1) for b in box)]
    return _moved(labels, data, np.array([b[0] for b in box]), np.ones(3))


def _moved(labels: Labels, data: I32, first: F64, scale: F64) -> Labels:
    """Labels on a grid that starts at a voxel of the old one, with voxels `scale` times as big."""
    affine = labels.affine.copy()
    affine[:3, 3] += affine[:3, :3] @ first
    affine[:3, :3] *= scale
    return Labels(data, affine, labels.names, labels.name)


def _nodes(n: int, step: int) -> Index:
    """Places 0 to n - 1 in even steps as near to `step` as both ends allow."""
    count = max(1, round((n - 1) / step))
    return np.unique(np.rint(np.linspace(0, n - 1, count + 1)).astype(np.intp))
