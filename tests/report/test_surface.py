"""Surfaces that the core makes of lattices."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.voxel_bodies import BODIES, body_cloud
from myork.core.scene import Scene
from myork.types import F64, I32
from tests.report.pages import grid


def volume(points: F64, triangles: I32) -> float:
    """By the divergence theorem: positive where triangles look outwards."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def areas(points: F64, triangles: I32) -> F64:
    """Areas of plane triangles: positive where they turn counter-clockwise."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    u, v = b - a, c - a
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def is_closed(triangles: I32) -> bool:
    """Each edge belongs to two triangles, or to four where the surface touches itself."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all())


def test_block() -> None:
    points, triangles = grid(5, 4, 6)
    assert is_closed(triangles)
    assert volume(points, triangles) == pytest.approx(60.0, rel=1e-12)
    # no triangle lies inside, and no point of the surface is hidden
    on = (points == points.min(axis=0)) | (points == points.max(axis=0))
    assert on[triangles].all(axis=1).any(axis=1).all()
    assert len(np.unique(triangles)) == on.any(axis=1).sum()


def test_plane_bodies() -> None:
    assert areas(*grid(5, 3)) == pytest.approx(np.full(16, 0.5), rel=1e-12)
    ring = areas(*grid(9, 33, ring=True))
    assert ring.min() > 0.0 and ring.sum() == pytest.approx(0.75 * np.pi, rel=1e-3)


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
def test_voxels(body) -> None:
    """Slopes in place of stairs: closed, with every point of the surface, little lost."""
    cloud = body_cloud(body, body.sizes[0])
    with Scene.from_tables(dict(body.tables), cloud) as scene:
        points, triangles = scene.points(), scene.surface()
    assert is_closed(triangles)
    assert set(cloud.boundary_point) == set(triangles.ravel())
    assert volume(points, triangles) == pytest.approx(cloud.volume.sum(), rel=0.05)


@pytest.mark.slow
def test_without_a_lattice_there_is_no_surface() -> None:
    body = BODIES[0]
    cloud = replace(body_cloud(body, body.sizes[0]), voxels=None)
    tables = {**body.tables, "scene": {"dimension": 3, "method": "rkcm"}}
    with Scene.from_tables(tables, cloud) as scene:
        assert scene.surface().shape == (0, 3)
