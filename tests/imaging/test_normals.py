"""Normals of voxel bodies against spheres and ellipsoids."""

import numpy as np
import pytest
from scipy import ndimage

from myork.model.normals import surface_normals
from tests.images import centred


def ellipsoid(shape, spacing, axes, off=(0.0, 0.0, 0.0)):
    centre = (np.array(shape) - 1) / 2 + off
    place = (np.stack(np.indices(shape), -1) - centre) * spacing
    body = ((place / axes) ** 2).sum(-1) < 1
    rim = body & ~ndimage.binary_erosion(body)
    exact = place[rim] / np.square(axes)
    return body, np.argwhere(rim), exact / np.linalg.norm(exact, axis=1, keepdims=True)


# Centred on a voxel, where whole rings of the poles are flat, and off the grid's symmetry
@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.3, 0.1, 0.4), (0.5, 0.5, 0.5)])
@pytest.mark.parametrize(("spacing", "axes", "mean"), [
    # Ten voxels from the centre to every pole: two degrees
    ((1.0, 1.0, 1.0), (10.0, 10.0, 10.0), 2.0), ((1.0, 1.0, 5.0), (10.0, 10.0, 50.0), 2.0),
    ((1.0, 1.0, 5.0), (20.0, 15.0, 50.0), 2.0), ((1.25, 1.25, 6.0), (18.0, 13.0, 60.0), 2.0),
    ((2.0, 1.0, 1.0), (20.0, 12.0, 12.0), 2.0),
    # Nine, six and two: a step between slices is a larger part of the body
    ((1.0, 1.0, 5.0), (40.0, 35.0, 45.0), 2.2), ((1.0, 1.0, 5.0), (30.0, 30.0, 30.0), 3.0),
    ((1.0, 1.0, 5.0), (10.0, 10.0, 10.0), 6.0),
])  # fmt: skip
def test_outward_and_near_the_exact_normal(spacing, axes, mean, off):
    spacing, axes = np.array(spacing), np.array(axes)
    shape = tuple(2 * np.ceil(axes / spacing).astype(int) + 7)
    body, voxels, exact = ellipsoid(shape, spacing, axes, off)
    normal = surface_normals(body, spacing, voxels)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-12)
    cosine = (normal * exact).sum(1)
    assert cosine.min() > 0.8  # outward everywhere
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() < mean


def test_normals_do_not_depend_on_what_lies_beside():
    """The metric is that of a typical piece, not of the whole of two legs."""
    spacing, axes = np.array([1.0, 1.0, 5.0]), np.array([10.0, 10.0, 50.0])
    body, voxels, exact = ellipsoid((27, 27, 27), spacing, axes)
    both = np.concatenate([body, body], axis=0)
    normal = surface_normals(both, spacing, voxels)
    assert np.degrees(np.arccos(np.clip((normal * exact).sum(1), -1, 1))).mean() < 2.0


def test_a_plane_is_exact():
    body = np.zeros((15, 33, 9), bool)
    body[:7] = True
    voxels = np.argwhere(body & ~np.roll(body, -1, axis=0))
    voxels = voxels[(np.abs(voxels[:, 1] - 16) < 3)]
    normal = surface_normals(body, np.array([1.0, 1.0, 3.0]), voxels)
    np.testing.assert_allclose(normal, np.tile([1.0, 0, 0], (len(voxels), 1)), atol=1e-9)


def test_ends_do_not_bend_the_normals_of_a_cylinder():
    body = np.hypot(*centred(21, 21, 7)[:2]) < 8
    voxels = np.argwhere(body & ~ndimage.binary_erosion(body, np.ones((3, 3, 1))))
    normal = surface_normals(body, np.array([1.0, 1.0, 4.0]), voxels)
    np.testing.assert_allclose(normal[:, 2], 0.0, atol=1e-12)
    # the middle of a sheet has none
    sheet = np.zeros((9, 9, 9), bool)
    sheet[4] = True
    assert not surface_normals(sheet, np.ones(3), np.array([[4, 4, 4]])).any()
