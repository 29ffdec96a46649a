"""The outside of a body that is known by its points, as triangles between them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial import Delaunay

from myork.records import PointCloud
from myork.types import F64, I32

__all__ = ["outer_triangles", "point_distances", "spacing_of"]


#: Simplices with an edge this many times as long as that of the median one bridge a gap
_BRIDGE = 1.5
#: Move of points before they are joined, of their distance
_JITTER = 1e-4
#: Volume of a tetrahedron that is none, of the cube of the distance
_FLAT = 1e-2
#: Corners of the faces of a tetrahedron, each with the corner that it does not have
_FACES = ((1, 2, 3, 0), (0, 2, 3, 1), (0, 1, 3, 2), (0, 1, 2, 3))


def point_distances(points: F64, deck: Mapping[str, Any], cloud: PointCloud | None) -> F64:
    """Distances of neighbouring points in each direction, ones where they are not known.

    Parameters
    ----------
    points : F64
        Points of the body, shape `(n, dimension)` [length].
    deck : mapping
        Deck of the body.
    cloud : PointCloud or None
        Points of its model file.
    """
    dimension = points.shape[1]
    if cloud is not None and cloud.voxels is not None:
        return np.asarray(cloud.voxels.size[:dimension])
    if deck["geometry"]["kind"] == "box":
        size = np.asarray(deck["geometry"]["size"], float)[:dimension]
        counts = [len(np.unique(np.round(axis / size[k], 6))) for k, axis in enumerate(points.T)]
        return np.asarray(size / np.maximum(np.array(counts) - 1, 1))
    return np.ones(dimension)


def spacing_of(points: F64) -> F64:
    """Distances of neighbours along each axis, from places that many points share.

    On a grid whose surface points were moved the others keep their planes; where there are no
    planes all distances are ones.

    Parameters
    ----------
    points : F64
        Points, shape `(n, dimension)` [length].
    """
    distance = np.ones(points.shape[1])
    reach = max(float(np.ptp(points, axis=0).max()), 1e-300)
    for axis, places in enumerate(points.T):
        levels, counts = np.unique(np.round(places / reach, 6), return_counts=True)
        levels = levels[counts > 0.2 * counts.max()]
        if counts.max() < 3 or len(levels) < 2:
            return np.ones(points.shape[1])
        distance[axis] = reach * np.median(np.diff(levels))
    return distance


def outer_triangles(points: F64, distance: F64) -> I32:
    """Triangles of the surface, or of the plane body itself.

    The body is what the simplices of Delaunay fill but for those that bridge a gap; a
    hollow narrower than about two points is filled.

    Parameters
    ----------
    points : F64
        Points, shape `(n, 2)` or `(n, 3)` [length].
    distance : F64
        Their distances in each direction, shape `(2,)` or `(3,)` [length].

    Returns
    -------
    NDArray
        Indices of corners, counter-clockwise from outside, shape `(m, 3)`.
    """
    # points of a lattice lie on common spheres: moved a little, no simplex is flat
    jitter = np.random.default_rng(0).uniform(-_JITTER, _JITTER, points.shape)
    scaled = points / distance + jitter
    simplices = Delaunay(scaled).simplices
    corners = scaled[simplices]
    edges = corners[:, :, None] - corners[:, None, :]
    longest = np.sqrt((edges**2).sum(axis=-1)).max(axis=(1, 2))
    kept = longest <= _BRIDGE * np.median(longest)
    body, corners = simplices[kept], corners[kept]
    if points.shape[1] == 2:
        return body.astype(np.int32)
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    while True:
        faces = np.concatenate([body[:, face] for face in _FACES])
        _, first, count = np.unique(
            np.sort(faces[:, :3], axis=1), axis=0, return_index=True, return_counts=True
        )
        first = first[count == 1]
        owner = first % len(body)
        flat = np.unique(owner[volume[owner] < _FLAT])
        if len(flat) == 0:
            break
        # flat ones hide points of the surface
        body, volume = np.delete(body, flat, axis=0), np.delete(volume, flat)
    outer = faces[first]
    a, b, c, inside = (scaled[outer[:, k]] for k in range(4))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), inside - a) > 0.0
    outer[inwards] = outer[inwards][:, [0, 2, 1, 3]]
    return outer[:, :3].astype(np.int32)
