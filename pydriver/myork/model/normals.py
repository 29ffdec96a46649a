"""Outward normals of voxel bodies from a level set function phi.

phi is positive inside, so the outward normal is -grad phi/|grad phi| (equation (3.2) has the
opposite sign). phi is the signed distance smoothed by a Gaussian.
"""

import numpy as np
from scipy import ndimage

from myork.types import F64, Index, Mask

# Standard deviation of the smoothing, in-plane [voxel]: less leaves the stairs of the voxels in the
# normals, more rounds off thin bodies (see tests/imaging/test_points.py).
_SMOOTHING = 2.5
# Layers by which the cut ends are continued, so that they do not tilt the normals beside them.
_LAYERS = 10


def surface_normals(body: Mask, spacing: F64, voxels: Index | F64) -> F64:
    """Outward unit normals at the lateral surface.

    The body is assumed to continue beyond its first and last slice.

    Any phi that vanishes on the surface has its normals; the best one changes evenly from voxel to
    voxel. The distance in lengths jumps by whole slices above and below flat ends; in voxels a body
    of few slices is flattened. Distances are therefore measured in the metric, between voxels and
    lengths, in which the body is most nearly round.

    - `body`: voxels of the body, shape `(ni, nj, nk)`
    - `spacing`: voxel size, shape `(3,)` [length]
    - `voxels`: where, shape `(n, 3)`: voxels, or places between their middles [voxel]
    - returns shape `(n, 3)` [-]; zeros where phi has no gradient (in the middle of a sheet one
      voxel thick)
    """
    pad = np.array([_LAYERS, _LAYERS, 0])
    whole = np.pad(body, [(n, n) for n in pad])
    whole = np.pad(whole, [(0, 0), (0, 0), (_LAYERS, _LAYERS)], mode="edge")
    metric = _round_metric(body, spacing)
    inside, outside = (
        ndimage.distance_transform_edt(part, sampling=metric) for part in (whole, ~whole)
    )
    phi = inside - outside
    phi = ndimage.gaussian_filter(phi, _SMOOTHING / np.sqrt(metric), truncate=3.0)
    at = (voxels + _LAYERS).T
    normal = -np.stack(
        [ndimage.map_coordinates(slope, at, order=1) for slope in np.gradient(phi, *spacing)],
        axis=-1,
    )
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.where(length > 1e-6, normal / np.maximum(length, 1e-6), 0.0)


def _round_metric(body: Mask, spacing: F64) -> F64:
    """Sizes of voxels, from one to their length ratios, in which the body is nearly round."""
    pieces, _ = ndimage.label(body)
    piece, voxels = pieces[body], np.argwhere(body)
    size = np.maximum(np.bincount(piece), 1)
    spread = np.empty(3)
    for axis in range(3):
        middle = np.bincount(piece, voxels[:, axis]) / size
        spread[axis] = np.sqrt(((voxels[:, axis] - middle[piece]) ** 2).mean())
    ratio = spacing / spacing.min()
    extent = np.maximum(spread * spacing, 1e-12)
    return np.clip(ratio * extent.min() / extent, 1.0, ratio)
