"""Where the surface of a voxel body lies: surface points are moved onto it.

A body is what its voxels fill: a slice is as thick as its spacing, and the ends are the outer
faces of the first and the last one. Centres of surface voxels lie up to half a voxel inside.
Conditions of a free surface set there model a body thinner by a voxel. The body is blurred; across
a plane surface the blurred body falls like the normal distribution, so that its value tells the
distance to the surface, and the mean over the stairs of the voxels is the plane they stand for.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.special import ndtri

from myork.types import F64, Mask

# Standard deviation of the blur [voxel]: as far as a stair of the voxels reaches.
_BLUR = 1.0
# Layers added around the body, further than the blur reaches.
_LAYERS = 5
# A rim point moves in its end plane only; where the surface leaves that plane at less than about
# 17 degrees it stays.
_FLAT = 0.3
# Points nearer to each other than this came from two sides of a hole [voxel].
_APART = 0.2


def end_offsets(body: Mask, spacing: F64, voxels: NDArray[np.intp]) -> F64:
    """Moves that bring the voxels' centres of the end slices onto the ends of the body.

    - `body`: voxels of the body, shape `(ni, nj, nk)`; a single slice is plane and has no ends
    - `spacing`: voxel size, shape `(3,)` [length]
    - `voxels`: voxels, shape `(n, 3)`
    - returns shape `(n, 3)` [length]
    """
    move = np.zeros(voxels.shape)
    last = body.shape[2] - 1
    if last > 0:
        at = voxels[:, 2]
        move[:, 2] = 0.5 * spacing[2] * ((at == last).astype(float) - (at == 0))
    return move


def surface_offsets(body: Mask, spacing: F64, voxels: NDArray[np.intp], normal: F64) -> F64:
    """Moves that bring surface voxels' centres onto the surface.

    The body is taken to go on beyond its first and last slice, whose points stay in their plane.
    No point moves inwards, none by more than a voxel, and those that would meet in a hole of one
    voxel by half of that.

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
