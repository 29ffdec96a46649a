"""Voxels that the surface of a body or an interface cuts: they weigh what is filled of them."""

from dataclasses import replace
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from myork.bench import exact
from myork.bench.materials import RUBBER
from myork.core.deck import table_defaults
from myork.errors import InputError
from myork.model.cloud import build_cloud
from myork.model_file import read_model, write_model
from myork.records import Labels, PointCloud, Voxels


def brick(share: NDArray[Any], slices: int) -> PointCloud:
    """Voxels of edge 0.5 in a block, all slices filled alike, with a set for each face."""
    n = (*share.shape, slices)
    index = np.argwhere(np.ones(n, bool)).astype(np.int32)
    points = 0.5 * index + 0.25
    filled = np.repeat(share.ravel(), slices)
    names = ("x0", "x1", "y0", "y1", "z0", "z1")
    entries = [
        (point, number, (number % 2 * 2 - 1) * np.eye(3)[number // 2])
        for number in range(6)
        for point in np.flatnonzero(index[:, number // 2] == number % 2 * (n[number // 2] - 1))
    ]
    return PointCloud(
        source=points,
        spacing=np.full(3, 0.5),
        points=points,
        label=np.ones(len(points), np.int32),
        fiber=np.zeros(points.shape),
        volume=filled * 0.125,
        boundary_point=np.array([e[0] for e in entries], np.int32),
        boundary_set=np.array([e[1] for e in entries], np.int32),
        normal=np.array([e[2] for e in entries]),
        area=np.full(len(entries), 0.25),
        set_names=names,
        label_names={1: "rubber"},
        length_unit="cm",
        source_images="",
        voxels=Voxels(index, np.full(3, 0.5), np.full(3, 0.25)),
    )


@pytest.mark.parametrize("method", ["rkpm-scni", "rkpm-gauss"])
@pytest.mark.parametrize("pull", [{"u_z": 0.6}, {"traction": [0.0, 0.0, 4.0]}], ids=str)
def test_uniaxial_tension_is_exact_however_full_the_voxels_are(open_scene, pull, method) -> None:
    """Linear displacements leave no force on any point; the section is the sum of its shares."""
    share = np.random.default_rng(3).uniform(0.3, 1.3, (4, 3))
    planes = [{"set": f"{axis}0", f"u_{axis}": 0} for axis in "xyz"]
    tables = {
        "scene": {"dimension": 3, "method": method},
        "material": [RUBBER],
        "boundary": [*planes, {"set": "z1", **pull}],
        "probe": [
            {"name": "F", "quantity": "force_z", "set": "z0"},
            {"name": "s", "quantity": "cauchy_zz", "point": [1.0, 0.7, 1.1]},
            {"name": "u", "quantity": "u_z", "point": [0.5, 0.7, 3.0]},
        ],
    }
    scene = open_scene(tables, "solver.tolerance=1e-10", cloud=brick(share, 6))
    force, stress, move = scene.probes(scene.solve().x[-1:], np.ones(1))[0, :, 0]
    area = 0.25 * share.sum()
    rubber = exact.Polynomial.from_deck(RUBBER)
    assert stress == pytest.approx(exact.uniaxial(rubber, 1 + move / 3.0), rel=1e-7)
    if "traction" in pull:
        assert force == pytest.approx(-4.0 * area, rel=1e-7)
    else:
        stretched = open_scene(tables, "solver.tolerance=1e-10", cloud=brick(share**0, 6))
        whole = stretched.probes(stretched.solve().x[-1:], np.ones(1))[0, 0, 0]
        assert force == pytest.approx(whole * share.mean(), rel=1e-7)


def test_force_of_a_cylinder_off_the_lattice(open_scene) -> None:
    """Without contraction across, the force is that of the section of the label map."""
    errors = []
    for h in (0.25, 0.125):
        x = (np.arange(int(2.5 / h)) + 0.5) * h - 1.25
        a, b = np.meshgrid(x - 0.3 * h, x - 0.17 * h, indexing="ij")
        disc = (a**2 + b**2 < 1).astype(np.int32)
        data = np.repeat(disc[:, :, np.newaxis], int(2 / h), axis=2)
        table = {**table_defaults("build"), "source_stride": [2] * 3, "collocation_stride": [2] * 3}
        affine = np.diag([10 * h] * 3 + [1.0])
        cloud, _ = build_cloud(Labels(data, affine), None, table, "cm")
        assert cloud.volume.sum() == pytest.approx(data.sum() * h**3, rel=1e-12)
        tables = {
            "scene": {"dimension": 3, "method": "rkpm-scni"},
            # E = 2 mu
            "material": [{"name": "m", "model": "neo-hookean", "mu": 3.0, "K": 2.0}],
            "boundary": [
                {"set": "bottom", "u_x": 0, "u_y": 0, "u_z": 0},
                {"set": "top", "u_x": 0, "u_y": 0, "u_z": 2e-5},
            ],
            "probe": [{"name": "F", "quantity": "force_z", "set": "top"}],
        }
        scene = open_scene(tables, cloud=cloud)
        force = scene.probes(scene.solve().x[-1:], np.ones(1))[0, 0, 0] / 1e-5
        assert force == pytest.approx(6.0 * disc.sum() * h**2, rel=1e-3)
        errors.append(abs(force / (6.0 * np.pi) - 1.0))
    assert errors[0] < 0.02 and errors[1] < 0.8 * errors[0]


@pytest.mark.parametrize("method", ["rkpm-scni", "rkpm-gauss"])
def test_tissues_beside_each_other_within_voxels(open_scene, method) -> None:
    """Nearly incompressible tissues stretched together carry by their parts of the section."""
    part = np.repeat([0.0, 0.0, 0.3, 1.0, 1.0], 3).reshape(5, 3)
    cloud = brick(np.ones((5, 3)), 6)
    fraction = np.repeat(part.ravel(), 6)
    cloud = replace(
        cloud,
        label_names={1: "soft", 2: "stiff"},
        fraction=np.column_stack([1.0 - fraction, fraction]),
    )
    tables = {
        "scene": {"dimension": 3, "method": method},
        "material": [
            {"name": f"m{k}", "model": "neo-hookean", "mu": mu, "K": 1e3 * mu, "label": k + 1}
            for k, mu in enumerate((3.0, 12.0))
        ],
        "boundary": [{"set": f"{axis}0", f"u_{axis}": 0} for axis in "xyz"]
        + [{"set": "z1", "u_z": 3e-5}],
        "probe": [{"name": "F", "quantity": "force_z", "set": "z1"}],
    }
    scene = open_scene(tables, cloud=cloud)
    force = scene.probes(scene.solve().x[-1:], np.ones(1))[0, 0, 0]
    # by labels alone it would be 7.6 % less
    right = 1e-5 * 3 * 0.25 * (3.0 * (1 - part) + 12.0 * part).sum()
    assert force == pytest.approx(right, rel=5e-3)


def test_labels_keep_their_volumes_when_voxels_merge() -> None:
    """A ring around a core with a strip along it: smooth curved interfaces, any stride."""
    x, y, _ = np.meshgrid(*[np.arange(n) + 0.5 for n in (52, 52, 24)], indexing="ij")
    radius = np.hypot(x - 26.3, y - 25.9)
    data = np.select([radius < 14, radius < 16, radius < 22], [1, 3, 2], 0).astype(np.int32)
    for stride in (1, 2, 3, 4, 6):
        table = {
            **table_defaults("build"),
            "source_stride": [stride] * 3,
            "collocation_stride": [stride] * 3,
        }
        cloud, warnings = build_cloud(Labels(data, np.eye(4)), None, table, "mm")
        # the ring is 2 voxels thick, the others more at the least stride
        assert all("source points across" in text for text in warnings)
        assert stride > 1 or [text.split(" has ")[0] for text in warnings] == ["label 3"]
        volumes = {label: (data == label).sum() for label in (1, 2, 3)}
        assert cloud.label_volumes() == pytest.approx(volumes, rel=1e-12)
        assert (cloud.fraction is None) == (stride == 1)
        # no voxel is nearly empty, none stands for two
        filled = cloud.volume / stride**3
        assert filled.min() >= 1 / 3 and filled.max() < 1.5


@pytest.mark.slow
def test_muscle_in_points_of_other_tissues_asks_for_no_fiber(open_scene) -> None:
    """A block whose voxels are of fat and tendon, most of both muscle, has no direction at all.

    The coarser cloud of the error bar merges such voxels: its point must not become muscle.
    """
    cloud = brick(np.ones((8, 8)), 8)
    index = cloud.voxels.index
    label = np.full(len(cloud.points), 1, np.int32)
    fraction = np.zeros((len(cloud.points), 3))
    fraction[:, 0] = 1.0
    fiber = np.tile([0.0, 0.0, 1.0], (len(cloud.points), 1))
    inside = ((index >= 2) & (index < 4)).all(axis=1)
    first = inside & (index[:, 0] == 2)
    label[inside], fiber[inside] = 3, 0.0
    fraction[inside] = [0.45, 0.0, 0.55]
    label[first], fraction[first] = 2, [0.45, 0.55, 0.0]
    cloud = replace(
        cloud,
        label=label,
        fraction=fraction,
        fiber=fiber,
        label_names={1: "muscle", 2: "fat", 3: "tendon"},
    )
    soft = {"model": "neo-hookean", "K": 200.0}
    tables = {
        "scene": {"dimension": 3},
        "material": [
            {"name": "muscle", "model": "muscle", "A10": 1.0, "K": 200, "sigma_max": 30}
            | {"activation": 0.1, "label": 1},
            {"name": "fat", "mu": 1.0, "label": 2} | soft,
            {"name": "tendon", "mu": 4.0, "label": 3} | soft,
        ],
        "boundary": [{"set": f"z{k}", "u_x": 0, "u_y": 0, "u_z": 0} for k in (0, 1)],
        "probe": [{"name": "F", "quantity": "force_z", "set": "z1"}],
    }
    states = open_scene(tables, cloud=cloud).solve()
    assert np.isfinite(states.probe_errors[-1, 0, 0])


@pytest.mark.slow
def test_a_label_without_fractions_leaves_no_error_bar(open_scene) -> None:
    """Points may have a label that no fraction is told for. The coarser cloud of the error bar,
    which merges them, has no such point: there is no bar, but an answer.
    """
    cloud = brick(np.ones((8, 8)), 8)
    index = cloud.voxels.index
    fraction = np.zeros((len(cloud.points), 2))
    fraction[:, 0] = 1.0
    fraction[index[:, 2] < 4] = [0.25, 0.75]
    label = np.where(index[:, 2] < 4, 3, 1).astype(np.int32)
    cloud = replace(cloud, label=label, fraction=fraction, label_names={1: "fat", 2: "tendon"})
    soft = {"model": "neo-hookean", "K": 200.0}
    tables = {
        "scene": {"dimension": 3},
        "material": [
            {"name": "fat", "mu": 1.0, "label": 1} | soft,
            {"name": "tendon", "mu": 4.0, "label": 2} | soft,
            {"name": "other", "mu": 2.0, "label": 3} | soft,
        ],
        "boundary": [
            {"set": "z0", "u_x": 0, "u_y": 0, "u_z": 0},
            {"set": "z1", "u_x": 0, "u_y": 0, "u_z": 0.1},
        ],
        "probe": [{"name": "F", "quantity": "force_z", "set": "z1"}],
    }
    scene = open_scene(tables, cloud=cloud)
    states = scene.solve()
    assert scene.probes(states.x[-1:], np.ones(1))[0, 0, 0] > 0.0
    assert np.isnan(states.probe_errors[-1, 0, 0])


def test_fractions_need_materials_and_sums(open_scene, tmp_path) -> None:
    data = np.ones((4, 4, 4), np.int32)
    data[0] = 2
    table = {**table_defaults("build"), "source_stride": [2] * 3, "collocation_stride": [2] * 3}
    cloud, _ = build_cloud(Labels(data, np.eye(4)), None, table, "mm")
    tables = {
        "scene": {"dimension": 3},
        "material": [{"name": "m", "model": "neo-hookean", "mu": 1, "K": 5, "label": 1}],
        "boundary": [{"set": "bottom", "u_x": 0, "u_y": 0, "u_z": 0}],
    }
    with pytest.raises(InputError, match="label 2 has no material"):
        open_scene(tables, cloud=cloud)
    tables["material"].append({**tables["material"][0], "name": "n", "label": 2})
    path = tmp_path / "model.h5"
    write_model(path, cloud)
    back = read_model(path)
    np.testing.assert_array_equal(back.fraction, cloud.fraction)
    with h5py.File(path) as file:
        assert file["fraction_label"][:].tolist() == [1, 2]
    cloud.fraction[1, 0] += 0.1
    with pytest.raises(InputError, match="their sum must be 1"):
        open_scene(tables, cloud=cloud)
