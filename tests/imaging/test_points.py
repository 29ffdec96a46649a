"""Points of models from labels, surfaces and tracts: lattices, coverage, boundary sets, islands."""

import re
from dataclasses import replace

import numpy as np
import pytest
import pyvista
from scipy import ndimage
from scipy.spatial.transform import Rotation

from benchmarks.truths.compiled import shape_functions
from benchmarks.truths.scanners import reordered
from myork.core.deck import table_defaults
from myork.imaging.phantom import make_phantom
from myork.model import points
from myork.model.cloud import build_cloud
from myork.model.mesh import read_tracts, tract_fibers, voxelise
from myork.model.normals import surface_normals
from myork.records import Image, Labels
from tests.images import affine_of, angle, centred
from tests.scenes import refuses

TABLE = table_defaults("build")
MG = {**TABLE, "ids": [1], "collocation_stride": [2, 2, 1], "source_stride": [4, 4, 1]}


@pytest.fixture(scope="module")
def phantom():
    return make_phantom()


@pytest.fixture(scope="module")
def mg(phantom):
    return build_cloud(phantom.truth, phantom.fiber, MG, "cm")


def box(shape=(5, 4, 6), spacing=(2.0, 3.0, 5.0), pad=2):
    data = np.pad(np.ones(shape, np.int32), [(pad, pad), (pad, pad), (0, 0)])
    return Labels(data, affine_of(spacing, (-100.0, 20.0, 7.0)), {1: "block"}, "block.nii")


def test_block_by_hand():
    cloud, warnings = build_cloud(box(), None, TABLE, "cm")
    assert warnings == []
    assert len(cloud.points) == 120
    # First voxel of the block: index (2, 2, 0) of the map, in cm; points below the surface are the
    # centres of voxels in lexicographic order, those on it lie on the sides within a tenth of a
    # voxel (due to the blur of so small a block), and on the outer faces of the end slices.
    index = np.stack(np.meshgrid(*map(np.arange, (5, 4, 6)), indexing="ij"), axis=-1).reshape(-1, 3)
    centre = [-9.6, 2.6, 0.7] + index * [0.2, 0.3, 0.5]
    below = np.all((index[:, :2] > 0) & (index[:, :2] < [4, 3]), axis=1)
    at_end = np.where(index[:, 2] == 0, -0.25, np.where(index[:, 2] == 5, 0.25, 0.0))
    place = centre + np.outer(at_end, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(cloud.points[below], place[below])
    assert np.array_equal(cloud.voxels.index - cloud.voxels.index[0], index)
    voxels = cloud.voxels
    np.testing.assert_allclose(voxels.origin + voxels.index * voxels.size, centre)
    assert np.all(np.abs(cloud.points - place) <= [0.12, 0.18, 1e-9])
    np.testing.assert_allclose(np.ptp(cloud.points, axis=0), [1.0, 1.2, 3.0], rtol=0.05)
    np.testing.assert_allclose(cloud.volume, 0.2 * 0.3 * 0.5)
    np.testing.assert_allclose(cloud.spacing, [0.4, 0.6, 1.0])
    assert cloud.label_names == {1: "block"} and cloud.set_names == ("bottom", "top", "surface")
    for number, (name, z) in enumerate((("bottom", -1.0), ("top", 1.0))):
        here = cloud.boundary_set == number
        assert here.sum() == 20, name
        np.testing.assert_array_equal(cloud.normal[here], [[0, 0, z]] * 20)
        assert cloud.area[here].sum() == pytest.approx(5 * 4 * 0.06)
        end = cloud.points[:, 2].min() if z < 0 else cloud.points[:, 2].max()
        np.testing.assert_allclose(cloud.points[cloud.boundary_point[here], 2], end)
    surface = cloud.boundary_set == 2
    assert surface.sum() == 14 * 6
    faces = np.abs(cloud.normal[surface]).max(axis=1) > 0.99
    # The normals of four or five voxels are those of a rounded block: its corners contribute less.
    assert cloud.area[surface].sum() == pytest.approx(2 * (5 * 0.2 + 4 * 0.3) * 3.0, rel=0.2)
    assert faces.sum() >= 6


def test_every_point_has_a_source_point_nearer_than_a_step(mg):
    cloud, _ = mg
    step, apart = (
        (np.abs(points[:, None] - cloud.source[None]) / cloud.spacing).max(axis=2)
        for points in (cloud.points, cloud.source)
    )
    assert step.min(axis=1).max() < 1.0
    # never closer than one of the two voxels of a step
    assert (apart + 9 * np.eye(len(cloud.source))).min() > 0.49
    assert 300 < len(cloud.source) < 600
    assert 1000 < len(cloud.points) < 2000
    # second order shape functions exist at every point
    cloud, _ = mg
    found = shape_functions(cloud.source, 3.0 * cloud.spacing, cloud.points, order=2)
    row = np.repeat(np.arange(len(cloud.points)), np.diff(found.offset))
    np.testing.assert_allclose(np.bincount(row, found.value[:, 0]), 1.0, atol=1e-9)
    # A poorly covered boundary shows as large, cancelling values.
    assert np.abs(found.value[:, 0]).max() < 5.0


def test_volume_and_surface_of_the_medial_gastrocnemius(mg, phantom):
    cloud, _ = mg
    voxels = (phantom.truth.data == 1).sum() * 1.25 * 1.25 * 6.0e-3
    # Blocks of 2 x 2 pixels have the weight of their filled part.
    assert cloud.volume.sum() == pytest.approx(voxels, rel=1e-9)
    surface = cloud.boundary_set == cloud.set_names.index("surface")
    normal, where = cloud.normal[surface], cloud.boundary_point[surface]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-12)
    # Outward: away from the centre of the slice. Points move along inclined normals, by less than
    # half a slice.
    z = np.rint((cloud.points[:, 2] - cloud.points[0, 2]) / 0.6)
    for height in np.unique(z):
        centre, here = cloud.points[z == height].mean(axis=0), z[where] == height
        assert ((cloud.points[where[here]] - centre) * normal[here]).sum(axis=1).min() > 0
    # Perimeter of the ellipse (Ramanujan) times height. The tips have a radius of two blocks, and
    # there the normals are smoothed.
    a, b = np.outer([2.3, 1.1], 1 - 0.3 * ((np.arange(15) / 14 - 0.55) / 0.55) ** 2)
    exact = 0.6 * np.pi * (3 * (a + b) - np.sqrt((3 * a + b) * (a + 3 * b))).sum()
    assert cloud.area[surface].sum() == pytest.approx(exact, rel=0.08)


@pytest.mark.parametrize(
    ("order", "flips"), [((0, 1, 2), (0,)), ((0, 1, 2), (0, 1, 2)), ((2, 0, 1), (0,))]
)
def test_storage_order_of_the_image_does_not_change_the_model(mg, phantom, order, flips):
    cloud, _ = mg
    labels, fibers = (reordered(own, order, flips) for own in (phantom.truth, phantom.fiber))
    again, _ = build_cloud(labels, fibers, MG, "cm")
    for name in ("points", "source", "fiber", "normal"):
        np.testing.assert_allclose(getattr(again, name), getattr(cloud, name), atol=1e-12)
    assert np.array_equal(again.boundary_point, cloud.boundary_point)


def test_rotated_header_gives_the_same_model_in_its_own_frame(mg, phantom):
    cloud, _ = mg
    turn = Rotation.from_euler("x", 15.0, degrees=True).as_matrix()
    affine = phantom.truth.affine.copy()
    affine[:3] = turn @ affine[:3]
    labels = Labels(phantom.truth.data, affine, phantom.truth.names)
    again, warnings = build_cloud(labels, Image(phantom.fiber.data @ turn.T, affine), MG, "cm")
    np.testing.assert_allclose(again.points, cloud.points, atol=1e-9)
    np.testing.assert_allclose(again.fiber, cloud.fiber, atol=1e-9)
    (said,) = [text for text in warnings if "rotated against the world axes" in text]
    assert "fibers in [[material]] and all loads and points of the deck are in x, y" in said


def test_fibers_at_points_are_those_of_the_phantom(mg, phantom):
    cloud, _ = mg
    voxels = cloud.voxels
    place = (
        (voxels.origin + voxels.index * voxels.size) * 10 - phantom.truth.affine[:3, 3]
    ) / phantom.truth.spacing
    exact = phantom.fiber.data[tuple(np.rint(place).astype(int).T)]
    known = exact.any(axis=1)
    # Fibers turn by 12 degrees over 18 pixels; an offset of one voxel is a degree.
    assert angle(exact, cloud.fiber)[known].max() < 2.0


def test_islands_are_left_out_by_name():
    labels = box()
    data = np.pad(labels.data, [(0, 6), (0, 0), (0, 0)])
    data[-3:-1, 3:5, 2:4] = 1
    island = replace(labels, data=data)
    cloud, warnings = build_cloud(island, None, TABLE, "cm")
    assert len(cloud.points) == 120
    assert re.match(
        r"island of 8 points \(block\) around .* neither end and left out, 6.2 % of", warnings[0]
    )


def test_normals_of_a_thin_sheet_are_units():
    data = np.zeros((12, 9, 5), np.int32)
    data[2:8, 2:7] = data[8:11, 4] = 1
    cloud, _ = build_cloud(Labels(data, np.eye(4), {}, "a"), None, TABLE, "mm")
    np.testing.assert_allclose(np.linalg.norm(cloud.normal, axis=1), 1.0, atol=1e-12)
    assert (cloud.area > 0).all()


def spindle(lowest):
    """Ellipsoid of 20 slices whose lowest slice has about a given part of the largest section."""
    i, j, k = centred(24, 24, 20)
    radius = 10.0 * np.sqrt(np.clip(1.0 - (1.0 - lowest) * (k / 9.5) ** 2, 0.0, None))
    data = (np.hypot(i, j) < np.maximum(radius, 0.8)).astype(np.int32)
    return Labels(data, affine_of((1.0, 1.0, 4.0)), {1: "spindle"}, "spindle.nii")


def test_a_tip_is_named_with_the_slices_to_take():
    labels = spindle(0.0)
    (warning,) = [w for w in build_cloud(labels, None, TABLE, "cm")[1] if "ends in a tip" in w]
    area = labels.data.sum(axis=(0, 1))
    full = np.flatnonzero(area >= 0.2 * area.max())
    assert f"lower end has {area[0]} voxels in slice 0 and its upper end has {area[0]}" in warning
    assert f"build.slices = [{full[0]}, {full[-1]}]" in warning
    # the suggested remedy works
    cut = {**TABLE, "slices": [int(full[0]), int(full[-1])]}
    for other, table in ((labels, cut), (spindle(0.2), TABLE), (box(), TABLE)):
        assert not [w for w in build_cloud(other, None, table, "cm")[1] if "in a tip" in w]
    # a free tip, as where the muscle rests on springs along its surface, carries nothing
    held = build_cloud(labels, None, TABLE, "cm", held={"top", "surface"})[1]
    assert [w for w in held if "tip: its upper end has" in w and "lower" not in w]


def test_slices_and_blocks_of_models():
    cloud, warnings = build_cloud(box((5, 4, 1)), None, TABLE, "cm")
    assert cloud.set_names == ("surface",) and len(cloud.points) == 20
    np.testing.assert_allclose(cloud.normal[:, 2], 0.0, atol=1e-12)
    assert "one slice" in warnings[0]
    cloud, _ = build_cloud(box(), None, {**TABLE, "slices": [1, 4]}, "cm")
    np.testing.assert_allclose(np.unique(cloud.points[:, 2]), [0.95, 1.7, 2.2, 2.95])
    # blocks keep position and size
    coarse = points.coarsen(box((6, 4, 6)), (2, 2, 3))
    assert coarse.data.sum() == 3 * 2 * 2
    np.testing.assert_allclose(coarse.spacing, [4, 6, 15])
    # Centre of the first block of 2 x 2 x 3 voxels.
    np.testing.assert_allclose(coarse.world(np.argwhere(coarse.data)[0]), [-95.0, 27.5, 12.0])


@pytest.mark.parametrize(("change", "message"), [
    ({"ids": [4]}, r"no voxel has label \[4\]; the labels there are: 1"),
    ({"bone": [9]}, r"no voxel has label \[9\]; the labels there are: 1"),
    ({"slices": [3, 9]}, r"build.slices = \[3, 9\] does not lie in the 6 slices"),
    ({"collocation_stride": [2, 2, 1], "source_stride": [3, 4, 1]}, "must be a multiple of bu"),
    (dict.fromkeys(("collocation_stride", "source_stride"), [40, 40, 1]), "nothing is left of"),
])  # fmt: skip
def test_impossible_wishes(change, message):
    refuses(message, build_cloud, box(), None, {**TABLE, **change}, "cm")
    empty = Labels(np.zeros((3, 3, 3), np.int32), np.eye(4), {}, "empty.nii")
    refuses("empty.nii: no voxel has a label above zero", build_cloud, empty, None, TABLE, "cm")
    refuses("units.length = 'inch'", build_cloud, box(), None, TABLE, "inch")


def test_surface_points_lie_on_the_surface():
    """Around a cylinder of radius 8.3 voxels, centres of surface voxels lie 0.5 voxels inside on
    average; moved ones lie on it: 0.05 on average, at most a fifth of a voxel due to its stairs.
    """
    data = (np.hypot(*centred(25, 25, 6)[:2]) <= 8.3).astype(np.int32)
    cloud, _ = build_cloud(Labels(data, affine_of(10.0)), None, TABLE, "cm")
    skin = cloud.boundary_point[cloud.boundary_set == 2]
    first = cloud.points[np.argmin(np.abs(cloud.points - cloud.points.mean(axis=0)).sum(axis=1))]
    radius = np.hypot(*(cloud.points[skin] - first)[:, :2].T)
    assert abs(radius.mean() - 8.3) < 0.06 and radius.std() < 0.2
    assert np.unique(cloud.points[:, 2].round(9)).size == 6


def test_a_hole_of_one_voxel_keeps_the_points_around_it_apart():
    """Points on two sides of it once moved to the same place, and the model was refused."""
    labels = box((5, 5, 4))
    labels.data[4, 4] = 0
    cloud, _ = build_cloud(labels, None, {**TABLE, "source_stride": [1, 1, 1]}, "mm")
    near = np.linalg.norm(cloud.points[:, None] - cloud.points[None], axis=-1)
    assert near[~np.eye(len(near), dtype=bool)].min() > 1.0


@pytest.fixture
def cylinder(tmp_path):
    """Radius 20 mm, length 60 mm, along z about (5, -3, 100)."""
    mesh = pyvista.Cylinder(
        center=(5, -3, 100), direction=(0, 0, 1), radius=20.0, height=60.0, resolution=60
    ).triangulate()
    mesh.save(tmp_path / "a.stl")
    return tmp_path / "a.stl"


@pytest.mark.slow
def test_volume_and_place_of_a_cylinder(cylinder):
    labels = voxelise(cylinder, 1.0, (2.0, 2.0, 4.0), "muscle")
    assert labels.data.sum() * 16.0 == pytest.approx(np.pi * 400 * 60, rel=0.03)
    world = labels.world(np.argwhere(labels.data))
    np.testing.assert_allclose(world.mean(axis=0), [5, -3, 100], atol=0.2)
    assert labels.names == {1: "muscle"}
    metres = voxelise(cylinder, 10.0, (20.0, 20.0, 40.0), "muscle")
    assert np.array_equal(metres.data, labels.data)


@pytest.mark.slow
def test_lines_give_fibers_whatever_their_sign(cylinder, tmp_path):
    labels = voxelise(cylinder, 1.0, (2.0, 2.0, 4.0), "muscle")
    direction = np.array([0.3, 0.0, 0.9]) / np.hypot(0.3, 0.9)
    starts = np.random.default_rng(2).uniform([-20, -25, 60], [30, 20, 70], (60, 3))
    lines = starts[:, None] + np.arange(0, 70, 2.0)[:, None] * direction
    lines[1::2] = lines[1::2, ::-1]
    np.savez(tmp_path / "t.npz", points=np.vstack(lines), offsets=np.arange(61) * len(lines[0]))
    again = read_tracts(tmp_path / "t.npz", 1.0)
    assert len(again) == 60
    np.testing.assert_allclose(again[7], lines[7])
    fibers = tract_fibers(again, labels)
    assert np.abs(fibers.data[labels.data > 0] @ direction).min() > 1 - 1e-9
    cloud, warnings = build_cloud(labels, fibers, TABLE, "cm")
    assert warnings == [] and cloud.set_names == ("bottom", "top", "surface")
    assert np.abs(cloud.fiber @ direction).min() > 1 - 1e-9


@pytest.mark.slow
def test_a_structured_grid_is_a_surface_and_its_fibers(tmp_path):
    x, y, z = np.meshgrid(np.linspace(0, 2, 5), np.linspace(0, 2, 5), np.linspace(0, 6, 30),
                          indexing="ij")  # fmt: skip
    pyvista.StructuredGrid(x + 0.5 * z, y, z).save(tmp_path / "g.vts")
    tracts = read_tracts(tmp_path / "g.vts", 10.0)
    assert len(tracts) == 25 and tracts[0].shape == (30, 3)
    labels = voxelise(tmp_path / "g.vts", 10.0, (2.0, 2.0, 2.0), "biceps")
    assert labels.data.sum() * 8.0 == pytest.approx(24_000, rel=0.03)
    fibers = tract_fibers(tracts, labels)
    direction = np.array([0.5, 0, 1]) / np.hypot(0.5, 1)
    assert np.abs(fibers.data[labels.data > 0] @ direction).min() > 1 - 1e-9


@pytest.mark.slow
def test_bad_surfaces_and_tracts_are_named(cylinder, tmp_path):
    part = pyvista.read(cylinder).extract_cells(range(40))
    part.extract_surface(algorithm="dataset_surface").save(tmp_path / "open.stl")
    size = (2.0, 2.0, 2.0)
    said = "open.stl: the surface is not closed"
    refuses(said, voxelise, tmp_path / "open.stl", 1.0, size, "m")
    refuses("check build.surface_unit", voxelise, cylinder, 1000.0, size, "m")
    np.savez(tmp_path / "a.npz", points=np.zeros((4, 3)))
    refuses("needs the arrays points and offsets", read_tracts, tmp_path / "a.npz", 1.0)
    np.savez(tmp_path / "c.npz", points=np.full((4, 3), np.nan), offsets=[0, 4])
    refuses("not finite", read_tracts, tmp_path / "c.npz", 1.0)


# ---- normals of voxel bodies against spheres and ellipsoids --------------------------------------


def ellipsoid(shape, spacing, axes, off=(0.0, 0.0, 0.0)):
    centre = (np.array(shape) - 1) / 2 + off
    place = (np.stack(np.indices(shape), -1) - centre) * spacing
    body = ((place / axes) ** 2).sum(-1) < 1
    rim = body & ~ndimage.binary_erosion(body)
    exact = place[rim] / np.square(axes)
    return body, np.argwhere(rim), exact / np.linalg.norm(exact, axis=1, keepdims=True)


# Centred on a voxel, where whole rings at the poles are flat, and off the grid's symmetry
@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.3, 0.1, 0.4), (0.5, 0.5, 0.5)])
@pytest.mark.parametrize(("spacing", "axes", "mean"), [
    # Ten voxels from the centre to every pole: two degrees
    ((1.0, 1.0, 1.0), (10.0, 10.0, 10.0), 2.0), ((1.0, 1.0, 5.0), (10.0, 10.0, 50.0), 2.0),
    ((1.0, 1.0, 5.0), (20.0, 15.0, 50.0), 2.0), ((1.25, 1.25, 6.0), (18.0, 13.0, 60.0), 2.0),
    ((2.0, 1.0, 1.0), (20.0, 12.0, 12.0), 2.0),
    # Nine, six and two: a step between slices is larger relative to the body
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
    """The metric is that of a typical component, not of two whole legs."""
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
