"""Outward normals of voxel bodies from the smoothed signed distance.

The distance phi is positive inside, so the outward normal is -grad phi/|grad phi| (the sign of
equation (3.2) is the other one).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["signed_distance", "surface_normals"]

F64 = NDArray[np.float64]

# Standard deviation of the smoothing, times the mean voxel size: less leaves the stairs of the
# voxels in the normals, more rounds off thin bodies (see tests/imaging/test_normals.py).
_SMOOTHING = 1.5
# Layers by which the cut ends are continued, so that they do not bend the normals beside them.
_LAYERS = 6


def signed_distance(body: NDArray[np.bool_], spacing: F64) -> F64:
    """Distance to the surface between voxels, positive inside, shape of `body` [length].

    Parameters
    ----------
    body : NDArray
        Voxels of the body, shape `(ni, nj, nk)`, with some voxel outside.
    spacing : NDArray
        Voxel size, shape `(3,)` [length].
    """
    inside = ndimage.distance_transform_edt(body, sampling=spacing)
    outside = ndimage.distance_transform_edt(~body, sampling=spacing)
    return inside - outside


def surface_normals(body: NDArray[np.bool_], spacing: F64, voxels: NDArray[np.intp]) -> F64:
    """Outward unit normals at voxels of the lateral surface.

    The body is taken to go on beyond its first and last slice.

    Parameters
    ----------
    body : NDArray
        Voxels of the body, shape `(ni, nj, nk)`.
    spacing : NDArray
        Voxel size, shape `(3,)` [length].
    voxels : NDArray
        Where, shape `(n, 3)`.

    Returns
    -------
    NDArray
        Shape `(n, 3)` [-]; zeros where the distance has no gradient (in the middle of a sheet one
        voxel thick).
    """
    pad = np.array([_LAYERS, _LAYERS, 0])
    whole = np.pad(body, [(n, n) for n in pad])
    whole = np.pad(whole, [(0, 0), (0, 0), (_LAYERS, _LAYERS)], mode="edge")
    sigma = _SMOOTHING * np.cbrt(spacing.prod()) / spacing
    phi = ndimage.gaussian_filter(signed_distance(whole, spacing), sigma, truncate=3.0)
    gradient = np.stack(np.gradient(phi, *spacing), axis=-1)
    at = voxels + _LAYERS
    normal = -gradient[at[:, 0], at[:, 1], at[:, 2]]
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.where(length > 1e-6, normal / np.maximum(length, 1e-6), 0.0)
