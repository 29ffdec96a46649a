"""Models from surfaces and tracts."""

import numpy as np
import pytest
import pyvista

from myork.core.deck import table_defaults
from myork.errors import InputError
from myork.model.cloud import build_cloud
from myork.model.mesh import read_tracts, tract_fibers, voxelise

TABLE = table_defaults("build")


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
    volume = labels.data.sum() * 16.0
    assert volume == pytest.approx(np.pi * 400 * 60, rel=0.03)
    world = np.argwhere(labels.data) @ labels.affine[:3, :3].T + labels.affine[:3, 3]
    np.testing.assert_allclose(world.mean(axis=0), [5, -3, 100], atol=0.2)
    assert labels.names == {1: "muscle"}
    metres = voxelise(cylinder, 10.0, (20.0, 20.0, 40.0), "muscle")
    assert np.array_equal(metres.data, labels.data)


@pytest.mark.slow
def test_lines_give_fibers_whatever_their_sign(cylinder, tmp_path):
    labels = voxelise(cylinder, 1.0, (2.0, 2.0, 4.0), "muscle")
    direction = np.array([0.3, 0.0, 0.9]) / np.hypot(0.3, 0.9)
    random = np.random.default_rng(2)
    starts = random.uniform([-20, -25, 60], [30, 20, 70], (60, 3))
    lines = [s + np.arange(0, 70, 2.0)[:, None] * direction for s in starts]
    lines = [line[::-1] if n % 2 else line for n, line in enumerate(lines)]
    np.savez(tmp_path / "t.npz", points=np.vstack(lines), offsets=np.arange(61) * len(lines[0]))
    again = read_tracts(tmp_path / "t.npz", 1.0)
    assert len(again) == 60
    np.testing.assert_allclose(again[7], lines[7])
    fibers = tract_fibers(again, labels)
    inside = labels.data > 0
    assert np.abs(fibers.data[inside] @ direction).min() > 1 - 1e-9
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
    open_ = pyvista.read(cylinder).extract_cells(range(40)).extract_surface(
        algorithm="dataset_surface")  # fmt: skip
    open_.save(tmp_path / "open.stl")
    with pytest.raises(InputError, match="open.stl: the surface is not closed"):
        voxelise(tmp_path / "open.stl", 1.0, (2.0, 2.0, 2.0), "m")
    with pytest.raises(InputError, match="check build.surface_unit"):
        voxelise(cylinder, 1000.0, (2.0, 2.0, 2.0), "m")
    np.savez(tmp_path / "a.npz", points=np.zeros((4, 3)))
    with pytest.raises(InputError, match="needs the arrays points and offsets"):
        read_tracts(tmp_path / "a.npz", 1.0)
    np.savez(tmp_path / "c.npz", points=np.full((4, 3), np.nan), offsets=[0, 4])
    with pytest.raises(InputError, match="not finite"):
        read_tracts(tmp_path / "c.npz", 1.0)
