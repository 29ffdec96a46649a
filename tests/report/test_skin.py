"""Surfaces from points: closed, outside, and with the hollows of the body."""

import numpy as np
import pytest

from myork.report.off_screen import Panel, draw
from myork.report.skin import outer_triangles, point_distances, spacing_of


def lattice(*counts: int, spacing: tuple[float, ...] = (1.0, 1.0, 1.0)) -> np.ndarray:
    axes = [np.arange(n) * h for n, h in zip(counts, spacing, strict=False)]
    return np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)


def volume(points: np.ndarray, triangles: np.ndarray) -> float:
    """By the divergence theorem: positive where triangles look outwards."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def is_closed(triangles: np.ndarray) -> bool:
    """Each edge belongs to two triangles, or to four where the surface touches itself."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all())


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.1, 0.1, 0.6)])
def test_block(spacing: tuple[float, float, float]) -> None:
    points = lattice(5, 4, 6, spacing=spacing)
    triangles = outer_triangles(points, np.array(spacing))
    assert is_closed(triangles)
    assert volume(points, triangles) == pytest.approx(60.0 * np.prod(spacing), rel=1e-9)
    # no triangle lies inside
    on = (points == points.min(axis=0)) | (points == points.max(axis=0))
    assert on[triangles].all(axis=1).any(axis=1).all()
    # and no point of the surface is hidden
    assert len(np.unique(triangles)) == on.any(axis=1).sum()


def test_hollow_stays_open() -> None:
    """The notch of a bracket is no part of it."""
    points = lattice(9, 4, 9)
    points = points[(points[:, 0] <= 2) | (points[:, 2] <= 2)]
    triangles = outer_triangles(points, np.ones(3))
    assert is_closed(triangles)
    whole, bracket = 8 * 3 * 8, (2 * 8 + 6 * 2) * 3
    # the inner edge is cut by half a square at most
    assert bracket <= volume(points, triangles) * (1 + 1e-9) < bracket + 0.1 * whole


def test_irregular_points() -> None:
    points = lattice(7, 7, 7)
    rng = np.random.default_rng(3)
    moved = points + rng.uniform(-0.2, 0.2, points.shape)
    triangles = outer_triangles(moved, np.ones(3))
    assert is_closed(triangles)
    assert volume(moved, triangles) == pytest.approx(216.0, rel=0.08)


def test_sheet() -> None:
    points = lattice(5, 3, spacing=(0.5, 0.5))
    triangles = outer_triangles(points, np.array([0.5, 0.5]))
    a, b, c = (points[triangles[:, k]] for k in range(3))
    u, v = b - a, c - a
    area = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()
    assert area == pytest.approx(2.0, rel=1e-12)


def test_distances_of_a_box() -> None:
    points = lattice(5, 4, 6, spacing=(0.25, 1 / 3, 0.4))
    deck = {"geometry": {"kind": "box", "size": [1.0, 1.0, 2.0]}}
    assert point_distances(points, deck, None) == pytest.approx([0.25, 1 / 3, 0.4])
    assert point_distances(points, {"geometry": {"kind": "annulus"}}, None).tolist() == [1, 1, 1]


def test_spacing_of_a_grid_whose_surface_was_moved() -> None:
    places = np.meshgrid(*(h * np.arange(n) for h, n in ((0.25, 9), (0.5, 8), (1.5, 7))))
    points = np.stack([part.ravel() for part in places], axis=1)
    surface = (points[:, 0] == 0.0) | (points[:, 1] == 3.5)
    points[surface] += np.random.default_rng(0).uniform(-0.1, 0.1, (surface.sum(), 3))
    assert spacing_of(points) == pytest.approx([0.25, 0.5, 1.5], rel=1e-4)
    assert spacing_of(np.random.default_rng(1).random((50, 3))).tolist() == [1.0, 1.0, 1.0]


@pytest.mark.slow
def test_no_third_colour_between_two_tissues() -> None:
    """Numbers of labels have no values between them."""
    points = lattice(9, 9, 1)
    triangles = outer_triangles(points[:, :2], np.ones(2))
    label = np.where(points[:, 0] < 4, 0.0, np.where(points[:, 0] < 7, 2.0, 1.0))
    colours = "#FF0000,#00FF00,#0000FF"
    panel = Panel(points, label, (-0.5, 2.5), colours, np.empty((0, 2, 3)))
    middle, half = np.array([3.5, 4.0, 0.0]), np.array([2.0, 4.0])  # 0 and 2 meet in it
    picture = draw([panel], triangles, points, [np.eye(3)], middle, half)[0][0].astype(int)
    red, green, blue = picture[..., 0], picture[..., 1], picture[..., 2]
    assert ((red > green + 60) & (red > blue + 60)).any()
    assert not ((green > red + 60) & (green > blue + 60)).any()
