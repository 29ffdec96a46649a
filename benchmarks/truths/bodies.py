"""Boxes of points, to be bent, perturbed or damaged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from myork.model.spacing import source_spacing
from myork.records import PointCloud
from myork.types import F64, I64

_FACES = ("x0", "x1", "y0", "y1", "z0", "z1")


def box(
    size: Sequence[float],
    source: Sequence[int],
    places: Sequence[int],
    fiber: Sequence[float] = (0.0, 0.0, 0.0),
) -> PointCloud:
    """Regular points of a box with its corner at the origin; sets x0 to z1.

    - `size`: edge lengths, shape `(3,)` [length]
    - `source`, `places`: source and collocation points along each edge; a single point lies in the
      middle
    - `fiber`: fiber direction of all points, shape `(3,)` [-]
    """
    points, index = _grid(size, places)
    sets = [(point, face) for face in range(6) for point in _on_face(index, places, face)]
    boundary_point = np.array([point for point, _ in sets], np.int32)
    boundary_set = np.array([face for _, face in sets], np.int32)
    normal = np.zeros((len(sets), 3))
    normal[np.arange(len(sets)), boundary_set // 2] = 2.0 * (boundary_set % 2) - 1.0
    spacing = np.array(size) / np.maximum(np.array(source) - 1, 1)
    width = _widths(points, size)
    return PointCloud(
        source=_grid(size, source)[0],
        spacing=spacing,
        points=points,
        label=np.ones(len(points), np.int32),
        fiber=np.tile(np.asarray(fiber, float), (len(points), 1)),
        volume=width.prod(axis=1),
        boundary_point=boundary_point,
        boundary_set=boundary_set,
        normal=normal,
        area=_areas(width, boundary_point, boundary_set),
        set_names=_FACES,
        label_names={1: "body"},
        length_unit="cm",
        source_images="none",
    )


def jittered(cloud: PointCloud, share: float) -> PointCloud:
    """Points moved by up to a share of the spacing, those on faces within their faces."""
    random = np.random.default_rng(7)
    low, high = cloud.source.min(axis=0), cloud.source.max(axis=0)

    def shaken(x: F64, spacing: F64) -> F64:
        step = share * spacing * random.uniform(-1.0, 1.0, x.shape)
        return x + np.where((x > low + 1e-9) & (x < high - 1e-9), step, 0.0)

    return _moved(
        cloud, shaken(cloud.source, cloud.spacing), shaken(cloud.points, 0.5 * cloud.spacing)
    )


def graded(cloud: PointCloud) -> PointCloud:
    """Points graded towards the planes x, y, z = 0: each relative coordinate is cubed."""
    high = cloud.source.max(axis=0)
    moved = _moved(cloud, high * (cloud.source / high) ** 3, high * (cloud.points / high) ** 3)
    width = _widths(moved.points, high)
    area = _areas(width, moved.boundary_point, moved.boundary_set)
    return replace(moved, volume=width.prod(axis=1), area=area)


def _moved(cloud: PointCloud, source: F64, points: F64) -> PointCloud:
    spacing = source_spacing(source / cloud.spacing) * cloud.spacing
    return replace(cloud, source=source, spacing=spacing, points=points)


def _grid(size: Sequence[float], n: Sequence[int]) -> tuple[F64, I64]:
    """Points of a grid and their indices, last direction fastest."""
    index = np.stack(np.meshgrid(*(np.arange(k) for k in n), indexing="ij"), axis=-1).reshape(-1, 3)
    last = np.maximum(np.array(n) - 1, 1)
    share = np.where(np.array(n) == 1, 0.5, index / last)
    return np.array(size) * share, index


def _widths(points: F64, size: Sequence[float]) -> F64:
    """Width of each point of a lattice along each axis, up to half the distance to its neighbours.

    Sums over points are then exact for linear functions, so that forces are those of the stress.
    """
    width = np.empty_like(points)
    for axis, edge in enumerate(size):
        line, place = np.unique(points[:, axis], return_inverse=True)
        middle = 0.5 * (line[1:] + line[:-1])
        width[:, axis] = np.diff(np.concatenate([[0.0], middle, [edge]]))[place]
    return width


def _areas(width: F64, point: NDArray[Any], face: NDArray[Any]) -> F64:
    """Area of each boundary point on its face."""
    across = width[point]
    across[np.arange(len(face)), face // 2] = 1.0
    return across.prod(axis=1)


def _on_face(index: I64, n: Sequence[int], face: int) -> I64:
    """Numbers of the points on a face."""
    axis, side = divmod(face, 2)
    return np.flatnonzero(index[:, axis] == side * (n[axis] - 1))
