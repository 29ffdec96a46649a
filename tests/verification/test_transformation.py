"""Prescribed displacements that hold exactly at source points (galerkin.essential)."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from myork.bench import materials
from myork.core.deck import table_defaults
from myork.errors import InputError
from myork.records import Labels
from myork.stations.build import build_cloud

RUBBER = {**materials.RUBBER, "K": 1e3}
LINEAR = {"order": 1, "support": 2.0, "kernel": "cubic"}
EXACT = {"essential": "transformation", "gauss": 2}


def block(nd, method="rkpm-gauss", n=5, material=RUBBER, **more):
    """A clamped end and one that is stretched and shorn; places of output are the source points."""
    last = "xyz"[nd - 1]
    return {
        "scene": {"dimension": nd, "method": method},
        "geometry": {
            "kind": "box", "size": [1, 1, 2][:nd], "source": [n] * nd, "collocation": [n] * nd,
        },
        "approximation": LINEAR,
        "material": [material],
        "boundary": [
            {"set": f"{last}0", **{f"u_{axis}": 0 for axis in "xyz"[:nd]}},
            {"set": f"{last}1", "u_x": 0.1, f"u_{last}": 0.3},
            {"set": "x1", "traction": [0.5] * nd},
        ],
        "load": {"steps": 1},
        "solver": {"tolerance": 1e-10},
        "galerkin": EXACT,
        "probe": [
            {"name": name, "quantity": "force", "set": name} for name in (f"{last}0", f"{last}1")
        ],
    } | more  # fmt: skip


def solve(scene):
    """Displacements of all load steps at the source points, and the probes."""
    states = scene.solve()
    load = np.asarray(states.load)
    u = [scene.fields(x, at).u for x, at in zip(states.x, load, strict=True)]
    return np.array(u), scene.probes(states.x, load)


@pytest.mark.parametrize("bulk", [1e3, 1e7, np.inf])
@pytest.mark.parametrize("method", ["rkpm-gauss", "rkpm-scni"])
@pytest.mark.parametrize("nd", [2, 3])
def test_values_hold_at_source_points_and_forces_balance(open_scene, nd, method, bulk):
    """Both ends, held components and free ones; the side x1 of length 1 or 2 bears 0.5 an area."""
    scene = open_scene(block(nd, method, material={**RUBBER, "K": bulk}))
    u, forces = solve(scene)
    x = scene.points()
    low, high = x[:, -1] == 0.0, x[:, -1] == x[:, -1].max()
    assert np.abs(u[-1][low]).max() < 1e-13
    assert_allclose(u[-1][high, 0], 0.1, atol=1e-13)
    assert_allclose(u[-1][high, nd - 1], 0.3, atol=1e-13)
    if nd == 3:
        assert np.ptp(u[-1][high, 1]) > 1e-4, "a component that is not held stays free"
    total = forces[-1].sum(axis=0)
    assert_allclose(total[:nd], -0.5 * (2.0 if nd == 3 else 1.0), rtol=1e-7)


def test_values_follow_amplitudes_and_rotations(open_scene):
    """A plate that turns about its axis while it moves, in steps that are halved and grow."""
    tables = block(3, load={"at": [0.3, 0.7]})
    tables["boundary"][1] = {
        "set": "z1", "rotation": 60, "axis": [0, 0, 1], "about": [0.5, 0.5, 2], "u_z": 0.4,
        "amplitude": "there",
    }  # fmt: skip
    tables["amplitude"] = [{"name": "there", "time": [0, 0.7, 1], "value": [0, 1, 0.5]}]
    tables["probe"] += [
        {"name": "torque", "quantity": "torque_z", "set": "z1", "about": [0.5, 0.5, 2]},
        {"name": "other", "quantity": "torque_z", "set": "z0", "about": [0.5, 0.5, 2]},
    ]
    tables["boundary"].pop()
    scene = open_scene(tables)
    u, probes = solve(scene)
    x = scene.points()
    high = x[:, 2] == x[:, 2].max()
    arm = x[high, :2] - 0.5
    for k, share in ((-1, 0.5), (-2, 1.0)):
        angle = np.deg2rad(60 * share)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        assert_allclose(u[k][high, :2], arm @ turn.T - arm, atol=1e-13)
        assert_allclose(u[k][high, 2], 0.4 * share, atol=1e-13)
        low, top, torque, other = probes[k]
        assert_allclose(low, -top, atol=1e-7 * np.abs(top).max())
        assert torque[0] == pytest.approx(-other[0], rel=1e-6)
    assert abs(probes[-2, 2, 0]) > 0.5


def test_annulus_with_a_radial_wall_and_symmetry_planes(open_scene):
    """Three sets, corners that two of them hold; the forces of the planes balance the wall's."""
    scene = open_scene(
        {
            "scene": {"dimension": 2, "method": "rkpm-gauss"},
            "geometry": {
                "kind": "annulus", "inner_radius": 6, "outer_radius": 8,
                "source": [4, 13], "collocation": [4, 13],
            },
            "approximation": LINEAR,
            "material": [RUBBER],
            "boundary": [
                {"set": "inner", "radial": 0.5},
                {"set": "x0", "u_x": 0},
                {"set": "y0", "u_y": 0},
            ],
            "galerkin": EXACT,
            "load": {"steps": 1},
            "solver": {"tolerance": 1e-10},
            "probe": [
                {"name": name, "quantity": "force", "set": name} for name in ("inner", "x0", "y0")
            ],
        }
    )  # fmt: skip
    u, forces = solve(scene)
    x = scene.points()
    radius = np.linalg.norm(x, axis=1)
    inner = np.isclose(radius, 6)
    assert_allclose(u[-1][inner, :2], 0.5 * x[inner] / 6, atol=1e-13)
    assert np.abs(u[-1][np.isclose(x[:, 0], 0), 0]).max() < 1e-13
    assert np.abs(u[-1][np.isclose(x[:, 1], 0), 1]).max() < 1e-13
    assert_allclose(forces[-1].sum(axis=0)[:2], 0, atol=1e-7 * np.abs(forces).max())
    assert np.abs(forces[-1, 0]).max() > 1


def test_force_is_the_derivative_of_the_energy(open_scene):
    """Work-conjugate: dE/du of a plate that moves by central differences of 1e-3 is its force; the
    energy has no part of supports that give way.
    """
    tables = block(3)
    tables["boundary"].pop()
    tables["probe"] = [
        {"name": "force", "quantity": "force_z", "set": "z1"},
        {"name": "energy", "quantity": "energy"},
    ]
    found = []
    for step in (-1e-3, 0.0, 1e-3):
        tables["boundary"][1]["u_z"] = 0.3 + step
        _, probes = solve(open_scene(tables))
        found.append(probes[-1, :, 0])
    slope = (found[2][1] - found[0][1]) / 2e-3
    assert slope == pytest.approx(found[1][0], rel=2e-6)


def test_the_penalty_comes_to_it_as_it_grows(open_scene):
    """Sides of a box are source points in a plane: between them the field hardly leaves the value,
    and both ways of holding it have nearly one limit.
    """

    def force(**galerkin):
        scene = open_scene(block(3, galerkin={"gauss": 2, **galerkin}))
        return solve(scene)[1][-1, 1]

    exact = force(essential="transformation")
    distance = [
        np.linalg.norm(force(penalty=penalty) - exact) / np.linalg.norm(exact)
        for penalty in (10.0, 100.0, 1e4)
    ]
    assert distance[0] > 2 * distance[1] > 4 * distance[2], distance
    assert distance[2] < 2e-3


@pytest.mark.parametrize("method", ["rkpm-scni", "rkpm-gauss"])
def test_voxel_bodies(open_scene, method):
    """Nodal cells hold what is above their points at the ends of the body, blocks their corners."""
    data = np.ones((6, 5, 6), np.int32)
    data[:2, :2, :3] = 0
    data[4:, 3:, 4:] = 0
    labels = Labels(data, np.diag([10.0, 8.0, 12.0, 1.0]), {1: "muscle"})
    build = {**table_defaults("build"), "source_stride": [2] * 3}
    cloud, _ = build_cloud(labels, None, build, "cm")
    clamp = {"u_x": 0, "u_y": 0, "u_z": 0}
    found = {}
    for essential in ("penalty", "transformation"):
        scene = open_scene(
            {
                "scene": {"dimension": 3, "method": method},
                "approximation": LINEAR,
                "material": [{**RUBBER, "label": 1}],
                "boundary": [{"set": "bottom", **clamp}, {"set": "top", **clamp, "u_z": 0.3}],
                "load": {"steps": 1},
                "solver": {"tolerance": 1e-10},
                "galerkin": {"essential": essential},
                "probe": [
                    {"name": name, "quantity": "force", "set": name} for name in ("bottom", "top")
                ],
            },
            cloud=cloud,
        )
        u, forces = solve(scene)
        assert_allclose(forces[-1].sum(axis=0), 0, atol=1e-7 * np.abs(forces).max())
        found[essential] = forces[-1, 1, 2]
    assert found["transformation"] == pytest.approx(found["penalty"], rel=0.05)


def test_points_of_a_part_of_a_side_are_held(open_scene):
    """A set of one's own: the points in it take its value, the others of the side stay free."""
    tables = block(2, n=9)
    tables["set"] = [{"name": "right", "side": "y1", "where": "x > 0.45"}]
    tables["boundary"] = [tables["boundary"][0], {"set": "right", "u_x": 0.1, "u_y": 0.1}]
    tables["probe"] = [
        {"name": name, "quantity": "force", "set": name} for name in ("y0", "right", "y1")
    ]
    scene = open_scene(tables)
    u, forces = solve(scene)
    x = scene.points()
    top = x[:, 1] == 1.0
    inside = top & (x[:, 0] > 0.45)
    assert inside.sum() == 5
    assert_allclose(u[-1][inside, :2], 0.1, atol=1e-13)
    assert np.abs(u[-1][top & ~inside, 1] - 0.1).min() > 1e-3
    bottom, right, whole = forces[-1, :, :2]
    assert_allclose(right, -bottom, atol=1e-7 * np.abs(right).max())
    assert_allclose(whole, right, atol=1e-7 * np.abs(right).max())


def test_an_open_scene_takes_other_values(open_scene):
    tables = block(3)
    scene = open_scene(tables)
    solve(scene)
    scene.update({"boundary.z1.u_z": 0.2, "material.A10": 20.0})
    u, _ = solve(scene)
    x = scene.points()
    assert_allclose(u[-1][x[:, 2] == x[:, 2].max(), 2], 0.2, atol=1e-13)
    tables["boundary"][1]["u_z"] = 0.2
    tables["material"] = [{**RUBBER, "A10": 20.0}]
    fresh, _ = solve(open_scene(tables))
    assert_allclose(u[-1], fresh[-1], atol=1e-12)


def test_what_it_does_not_do_is_refused(open_scene):
    scene = open_scene(block(3))
    solve(scene)
    with pytest.raises(InputError, match='"transformation": take "penalty"'):
        scene.reduce(np.eye(scene.dofs)[:, :3])
    nodal = block(3, "rkpm-scni", galerkin={**EXACT, "direct_limit": 0})
    with pytest.raises(InputError, match="factorised.*direct_limit = 375"):
        open_scene(nodal)
    free = block(3)
    free["boundary"][2] = {"set": "x1", "pressure": 0.1}
    with pytest.raises(InputError, match="neither tendons nor pressures with a free rim"):
        open_scene(free)
    clash = block(3)
    clash["boundary"].append({"set": "x0", "u_z": 0.1})
    with pytest.raises(InputError, match="two displacements"):
        open_scene(clash)
