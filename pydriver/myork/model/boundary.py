"""Boundary points of a voxel body: its ends, its faces towards bone and the rest of its surface.

Centres of surface voxels lie up to half a voxel inside, so that conditions there would model a body
thinner by a voxel; they are moved onto the surface. Across a plane surface the blurred body follows
the normal distribution, so that its value gives the distance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.special import ndtri

from myork.imaging.geometry import block_sums
from myork.model.normals import surface_normals
from myork.model.points import BONE, first_voxel
from myork.records import Labels
from myork.types import F64, I32, Index, Mask

# Standard deviation of the blur [voxel]: as wide as the stairs of the voxels.
_BLUR = 1.0
# Layers added around the body, further than the blur reaches.
_LAYERS = 5
# A rim point moves only within its end plane; where the surface makes an angle of less than about
# 17 degrees with that plane, it stays.
_FLAT = 0.3
# Points closer to each other than this come from two sides of a hole [voxel].
_APART = 0.2


@dataclass(frozen=True)
class Boundary:
    """Boundary points by set."""

    names: tuple[str, ...]  #: Names of the sets
    point: Index  #: Index of the voxel in the list of body voxels, shape `(nboundary,)`
    set: Index  #: Index into `names`, shape `(nboundary,)`
    normal: F64  #: Outward unit normals, shape `(nboundary, 3)` [-]
    area: F64  #: Facet areas projected along the surface's normals, shape `(nboundary,)` [mm^2]


def boundary_sets(labels: Labels, around: I32 | None = None) -> Boundary:
    """Boundary points of a body: `bottom` and `top` (end slices), `bone` and `surface` (the rest).

    A voxel at the rim of an end slice belongs to the end and to the surface, one between bone and
    skin to both. A single slice has no ends; without bone there is no set `bone`.

    - `labels`: labels above zero are the body, `BONE` bounds it
    - `around`: labels with one more layer on all four sides, see `bone_beside`; by default that
      layer is empty
    """
    body = labels.data > 0
    spacing = labels.spacing
    index = np.full(body.shape, -1)
    index[body] = np.arange(int(body.sum()))
    flat = body.shape[2] == 1

    # Beyond the end slices the body is cut: neither surface nor bone.
    if around is None:
        around = np.pad(labels.data, [(1, 1), (1, 1), (0, 0)])
    around = np.pad(around, [(0, 0), (0, 0), (1, 1)], mode="edge")
    free = _facet_areas(body, around == 0, spacing)
    bone = _facet_areas(body, around == BONE, spacing)
    both = free + bone
    at_wall = body & (both.sum(axis=(-1, -2)) > 0)
    normal, cosine = np.zeros((*body.shape, 3)), np.zeros((*body.shape, 3, 2))
    normal[at_wall], cosine[at_wall] = _wall_normals(
        body, spacing, np.argwhere(at_wall), both[at_wall]
    )
    parts = []
    for name, facets in (("bone", bone), ("surface", free)):
        here = body & (facets.sum(axis=(-1, -2)) > 0)
        if here.any() or name == "surface":
            area = (facets[here] * cosine[here]).sum(axis=(-1, -2))
            # A facet of one set may face away from the mean normal of both sets.
            away = area <= 0
            area[away] = facets[here][away].sum(axis=(-1, -2))
            parts.append((name, index[here], normal[here], area))
    if not flat:
        area = spacing[0] * spacing[1]
        for name, k, sign in (("top", -1, 1.0), ("bottom", 0, -1.0)):
            points = index[:, :, k][body[:, :, k]]
            up = np.tile([0.0, 0.0, sign], (len(points), 1))
            parts.insert(0, (name, points, up, np.full(len(points), area)))
    return Boundary(
        names=tuple(part[0] for part in parts),
        point=np.concatenate([part[1] for part in parts]),
        set=np.repeat(np.arange(len(parts)), [len(part[1]) for part in parts]),
        normal=np.concatenate([part[2] for part in parts]),
        area=np.concatenate([part[3] for part in parts]),
    )


def _wall_normals(body: Mask, spacing: F64, voxels: Index, facets: F64) -> tuple[F64, F64]:
    """Outward normals at wall voxels, from their facets where the level set gives none.

    Also the cosines of the angles between facets and the normals in their middles, shape
    `(n, 3, 2)`: with the normal in the middle of the voxel, half a voxel inside, the area of a hole
    of 8 voxels across is 5 % too large.
    """
    at, axis, side = np.nonzero(facets)
    middles = voxels[at] + (side - 0.5)[:, np.newaxis] * np.eye(3)[axis]
    found = surface_normals(body, spacing, np.concatenate([voxels, middles]))
    normal, beside = found[: len(voxels)], found[len(voxels) :]
    cosine = np.zeros_like(facets)
    cosine[at, axis, side] = (2 * side - 1) * beside[np.arange(len(at)), axis]
    # In a sheet one voxel thick the distance has no slope across it; there the facets decide, the
    # upper ones if both sides are equal.
    along = np.stack([-normal, normal], axis=-1)
    lost = (facets * along.clip(0)).sum(axis=(-1, -2)) <= 0
    sides = facets[lost, :, 1] - facets[lost, :, 0]
    sides = np.where(sides.any(axis=1, keepdims=True), sides, facets[lost, :, 1])
    normal[lost] = sides / np.linalg.norm(sides, axis=1, keepdims=True)
    cosine[lost] = np.stack([-normal[lost], normal[lost]], axis=-1)
    return normal, cosine.clip(0)


def bone_beside(labels: Labels, merged: Labels, block: Sequence[int]) -> I32:
    """Labels of merged voxels with one more layer on all four sides, where bone may lie.

    The body is cut to the bounding box of its voxels; bone beyond the box still bounds it. A
    block of the layer is bone where bone fills more than half of it.

    - `labels`: labels as selected, not trimmed
    - `merged`: the trimmed and merged labels, shape `(ni, nj, nk)`
    - `block`: voxels per block in each direction
    - returns shape `(ni + 2, nj + 2, nk)`
    """
    size, n = np.array(block), np.array(merged.data.shape) + [2, 2, 0]
    first = first_voxel(labels, merged, block) - size * [1, 1, 0]
    at = [low + np.arange(count * s) for low, count, s in zip(first, n, size, strict=True)]
    limit = labels.data.shape
    inside = [(a >= 0) & (a < m) for a, m in zip(at[:2], limit, strict=False)]
    bone = labels.data[np.ix_(*(a.clip(0, m - 1) for a, m in zip(at, limit, strict=True)))] == BONE
    bone &= inside[0][:, np.newaxis, np.newaxis] & inside[1][:, np.newaxis]
    around = np.where(2 * block_sums(bone, size) > size.prod(), BONE, 0).astype(np.int32)
    around[1:-1, 1:-1] = merged.data
    return around


def _facet_areas(body: Mask, beyond: Mask, spacing: F64) -> F64:
    """Area of facets of a body to other voxels, `(..., 3, 2)`: direction, lower and upper side.

    - `body`: shape `(ni, nj, nk)`
    - `beyond`: the other voxels, with one more layer on all sides
    - `spacing`: voxel size, shape `(3,)` [mm]
    """
    facets = np.zeros((*body.shape, 3, 2))
    middle = (slice(1, -1),) * 3
    for d in range(3):
        area = spacing.prod() / spacing[d]
        for side, shift in enumerate((1, -1)):
            facets[..., d, side] = area * (body & np.roll(beyond, shift, axis=d)[middle])
    return facets


def surface_offsets(body: Mask, spacing: F64, voxels: Index, normal: F64) -> F64:
    """Displacements that move the centres of surface voxels onto the surface.

    The body is assumed to continue beyond its first and last slice, whose points stay in their
    plane. No point moves inwards or by more than a voxel; those that would meet in a hole of one
    voxel move by half of that.

    - `body`: voxels of the body, shape `(ni, nj, nk)`
    - `spacing`: voxel size, shape `(3,)` [length]
    - `voxels`: surface voxels, shape `(n, 3)`
    - `normal`: outward unit normals there, shape `(n, 3)` [-]
    - returns shape `(n, 3)` [length]
    """
    whole = np.pad(body.astype(float), [(_LAYERS, _LAYERS), (_LAYERS, _LAYERS), (0, 0)])
    whole = np.pad(whole, [(0, 0), (0, 0), (_LAYERS, _LAYERS)], mode="edge")
    share = ndimage.gaussian_filter(whole, _BLUR)
    at = voxels + _LAYERS
    # 1 - 1e-3: deeper than three standard deviations is cut off below anyway
    inside = ndtri(np.clip(share[at[:, 0], at[:, 1], at[:, 2]], 0.5, 1 - 1e-3))
    voxel = np.linalg.norm(normal * spacing, axis=1)
    depth = np.minimum(_BLUR * inside, 1.0) * voxel
    move = depth[:, np.newaxis] * normal
    ends = (voxels[:, 2] == 0) | (voxels[:, 2] == body.shape[2] - 1)
    level = np.linalg.norm(normal[:, :2], axis=1)
    stretch = np.where(level > _FLAT, depth / np.maximum(level, _FLAT) ** 2, 0.0)
    move[ends] = stretch[ends, np.newaxis] * normal[ends] * [1.0, 1.0, 0.0]
    pairs = cKDTree(voxels + move / spacing).query_pairs(_APART, output_type="ndarray")
    move[np.unique(pairs)] *= 0.5
    return np.asarray(move)
