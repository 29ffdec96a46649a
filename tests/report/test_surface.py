"""Surfaces that the core makes of lattices, and pictures of them."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.voxel_bodies import BODIES, body_cloud
from myork.core.scene import Scene
from myork.report.sketch import Panel, show
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


def picture_of(panel: Panel, middle: F64, half: F64) -> F64:
    """Pixels of a body as it is seen along z, shape `(n, n, 3)`."""
    figure = Figure(figsize=(3.0, 3.0 * half[1] / half[0]))
    show(figure.add_axes((0.0, 0.0, 1.0, 1.0)), panel, middle, half)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].astype(float)


def picture(whole: bool = True) -> F64:
    """A sheet of three tissues in the plane of the picture, or its points alone."""
    points, triangles = grid(9, 9)
    label = np.select([points[:, 0] < 4, points[:, 0] < 7], [0.0, 2.0], 1.0)
    shown, ends = triangles if whole else triangles[:0], (-0.5, 2.5, "neither")
    panel = Panel(points, points, shown, label, ends, "#FF0000,#00FF00,#0000FF")
    # 0 and 2 meet in it
    return picture_of(panel, np.array([3.5, 4.0, 0.0]), np.array([2.0, 4.0]))


@pytest.mark.slow
def test_no_third_colour_between_two_tissues() -> None:
    """Numbers of labels have no values between them."""
    red, green, blue = np.moveaxis(picture(), -1, 0)
    assert ((red > green + 60) & (red > blue + 60)).any()
    assert ((blue > green + 60) & (blue > red + 60)).any()
    assert not ((green > red + 60) & (green > blue + 60)).any()
    # no pixel of the sheet is left out
    assert not ((red > 250) & (green > 250) & (blue > 250)).any()


def test_points_are_drawn_where_there_is_no_surface() -> None:
    seen = picture(whole=False)
    assert (seen.min(axis=2) < 60).any() and (seen.min(axis=2) > 250).any()


@pytest.mark.slow
def test_what_is_nearer_hides_what_is_behind() -> None:
    """The front of a block is seen, not its back, and a stroke inside it is hidden."""
    points, surface = grid(5, 5, 5)
    stroke = np.array([[[1.0, 2.0, 2.0], [3.0, 2.0, 2.0]]])
    panel = Panel(points, points, surface, points[:, 2], (0.0, 4.0, "neither"), "gray", stroke)
    # corners at the rim are shaded by the normals of two faces
    front = picture_of(panel, np.full(3, 2.0), np.full(2, 0.95))
    assert front.max() - front.min() <= 2.0 and front.min() > 200
