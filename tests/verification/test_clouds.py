"""Clouds other than regular boxes, and fields that vary over them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.truths import exact
from benchmarks.truths.bodies import box, graded, jittered
from myork import Scene
from myork.bench.materials import MUSCLE, RUBBER
from myork.core import material as core_material
from myork.errors import MyorkError
from myork.model.spacing import source_spacing
from myork.records import PointCloud
from tests import scenes
from tests.scenes import check_strong_rows, refuses

CUBE = (1.0, 1.0, 1.0)
SMOOTH = {**MUSCLE, "curve": "smooth"}
LAW = core_material.Material(**SMOOTH)


def stretched(method: str = "rkcm", material: Any = RUBBER, activation: float = 0.0) -> Any:
    """A deck that stretches a box along x; the box is a separate cloud."""
    return scenes.scene(
        method, {}, material=[material], approximation={"order": 2, "support": 3.5},
        boundary=[*scenes.PLANES, {"set": "x1", "u_x": 0.2}],
        load={"steps": 2, "activation": activation},
    )  # fmt: skip


def bent(cloud: PointCloud, rate: float = 0.8) -> PointCloud:
    """Fibers that turn in the x-z plane, with random signs."""
    signs = np.random.default_rng(2).choice([-1.0, 1.0], (len(cloud.points), 1))
    return replace(cloud, fiber=signs * direction(cloud.points, rate))


def direction(x: NDArray[Any], rate: float) -> NDArray[Any]:
    angle = rate * (x[:, 0] + 0.5 * x[:, 2])
    return np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=1)


def pull(cloud: PointCloud, rate: float, activation: float) -> NDArray[Any]:
    """Div P of the undeformed body by central differences of P along exact fibers."""
    rest = np.tile(np.eye(3), (len(cloud.points), 1, 1))
    total = np.zeros((len(cloud.points), 3))
    for axis in range(3):
        step = 1e-5 * np.eye(3)[axis]
        for side in (-1, 1):
            fiber = direction(cloud.points + side * step, rate)
            p = core_material.stress(LAW, rest, fiber=fiber, activation=activation)
            total += side * p[:, :, axis] / 2e-5
    return total


@pytest.mark.slow
def test_turning_fibers_pull() -> None:
    """The residual at rest is the divergence of the active stress, to second order."""
    errors = []
    for n in (5, 9):
        cloud = bent(box(CUBE, (n, n, n), (2 * n - 1,) * 3))
        tables = stretched(material=SMOOTH, activation=0.5)
        with Scene.from_tables(tables, cloud) as scene:
            x = np.zeros(scene.dofs)
            residual, _ = scene.linearise(x, 1.0, x)
        found = residual[: 3 * len(cloud.points)].reshape(-1, 3)
        right = pull(cloud, 0.8, 0.5)
        inside = np.all((cloud.points > 0.3) & (cloud.points < 0.7), axis=1)
        errors.append(np.linalg.norm((found - right)[inside]) / np.linalg.norm(right[inside]))
    assert errors[1] < 0.01
    assert errors[1] < 0.35 * errors[0]


def test_turning_fibers_in_the_rows(open_scene: Any) -> None:
    """Rows of fibers that turn from point to point."""
    cloud = bent(box(CUBE, (4, 4, 4), (5, 5, 5)))
    tables = stretched(material=SMOOTH, activation=0.5)
    scene = open_scene(tables, "material.K=500", cloud=cloud)
    check_strong_rows(scene)


def test_a_rotated_problem_has_the_rotated_answer() -> None:
    """Round supports and a complete basis prefer no direction; both answers converge to 1e-6."""
    model = box(CUBE, (4, 4, 4), (6, 6, 6), fiber=(0.6, 0.0, 0.8))
    muscle = {"name": "m", "model": "muscle", "A10": 6.43, "A20": 0.94, "K": 100.0}
    found = []
    for turn in (np.eye(3), Rotation.from_rotvec([0.4, -0.9, 0.3]).as_matrix()):
        moved = dict(zip(("u_x", "u_y", "u_z"), (turn @ [0.03, 0.01, 0.03]).tolist(), strict=True))
        tables = scenes.gripped(
            "rkcm", {}, muscle | {"curve": "smooth"}, "z0 z1", **moved,
            approximation={"window": "radial", "support": 3.6},
            load={"steps": 1, "activation": 0.1}, solver={"weight_essential": 1e4},
        )  # fmt: skip
        names = "source", "points", "fiber", "normal"
        turned = {name: getattr(model, name) @ turn.T for name in names}
        found.append(scenes.solved(tables, cloud=replace(model, **turned)).fields)
    plain, other = found
    scale = abs(plain.u).max()
    assert scale > 0.03
    assert_allclose(other.u, plain.u @ turn.T, rtol=0, atol=1e-5 * scale)
    assert_allclose(other.f, turn @ plain.f @ turn.T, rtol=0, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("body", [
    *(jittered(box(CUBE, (5, 5, 5), (9, 9, 9)), far) for far in (0.3, 0.9)),
    jittered(box((1.0, 2.0, 10.0), (5, 5, 5), (9, 9, 9)), 0.3),
    graded(box(CUBE, (5, 5, 5), (9, 9, 9))),
], ids=["jittered", "random", "long and jittered", "graded 1 : 37"])  # fmt: skip
def test_homogeneous_tension_on_any_cloud(body: PointCloud, order: int) -> None:
    """Linear fields are in the space of any cloud, to rounding times the condition of the rows."""
    tables, order_of = stretched(), f"approximation.order={order}"
    stress = scenes.solved(tables, order_of, cloud=body).fields.cauchy
    strain = 0.2 / np.ptp(body.points[:, 0])
    right = exact.uniaxial(exact.Polynomial.from_deck(RUBBER), 1.0 + strain)
    assert abs(stress[:, 0] / right - 1.0).max() < 1e-7
    assert abs(stress[:, 1:]).max() < 1e-7 * right


SOLID = box(CUBE, (5, 5, 5), (9, 9, 9), (1.0, 0.0, 0.0))


def changed(name: str, value: float) -> PointCloud:
    """The cube with another number in the middle of an array."""
    values = getattr(SOLID, name).copy()
    values[len(values) // 2] = value
    return replace(SOLID, **{name: values})


@pytest.mark.parametrize(("body", "method", "said"), [
    *((box((1.0, 1.0, 0.2), (5, 5, n), (9, 9, 2 * n - 1)), "rkcm", "point") for n in (1, 2)),
    (replace(graded(SOLID), spacing=SOLID.spacing), "rkcm", "support"),
    *((SOLID, method, "a model of voxels") for method in ("rkpm-gauss", "rkpm-scni")),
    (SOLID, "rkcm-mixed", "a model has no lattice"),
    *((changed(name, np.nan), "rkcm", f"'{name}' must contain finite numbers")
      for name in ("points", "source", "fiber")),
    (changed("fiber", 3.0), "rkcm", "'fiber' at collocation point "),
])  # fmt: skip
def test_clouds_that_carry_no_approximation(body: PointCloud, method: str, said: str) -> None:
    """Too few layers, equal supports on graded points, no lattice, values that are not numbers."""
    assert said in scenes.refused(stretched(method, SMOOTH), body)


def test_an_island_that_nothing_holds() -> None:
    data = np.ones((4, 4, 10))
    data[:, :, 5] = 0
    tables = scenes.scene("rkpm-scni", {}, material=[RUBBER], boundary=[scenes.held("bottom")])
    assert "not connected to the rest" in scenes.refused(tables, scenes.voxels(data))


def test_more_than_any_memory_holds_is_refused() -> None:
    tables = scenes.scene("rkcm", scenes.box(400, 400, 400), material=[RUBBER],
                          boundary=[scenes.held("x0")])  # fmt: skip
    refuses(r"the model needs about .* GB", Scene.from_tables, tables, kind=MyorkError)


def test_spacing_of_scattered_points() -> None:
    lattice = box((2.0, 2.0, 2.0), (5, 5, 5), (5, 5, 5)).source
    spacing = source_spacing(lattice)
    inside = np.all((lattice > 0) & (lattice < 2), axis=1)
    np.testing.assert_allclose(spacing[inside], 0.5)
    # a corner has three neighbours at one spacing, the next ones are across the faces
    np.testing.assert_allclose(spacing[0], 0.5 * np.sqrt(2))
    refuses("too few", source_spacing, lattice[:2])


@pytest.mark.parametrize(("place", "outside"), [(2.39, False), (2.41, True)])
def test_a_probe_beside_a_body_of_voxels(place: float, outside: bool) -> None:
    """Up to half a voxel, by which the surface is uncertain, functions are extrapolated."""
    tables = scenes.scene(
        "auto", {"kind": "model"}, material=[scenes.neo(1.0, 10.0, label=1)],
        boundary=[scenes.held("bottom"), {"set": "top", "traction": [0, 0, 1e-3]}],
        probe=scenes.probes(f"end u_z 0.1 0.1 {place}"),
    )  # fmt: skip
    points = scenes.voxels(np.ones((4, 4, 24)), 1.0, source_stride=[2, 2, 2])
    if outside:
        refuses("more than half a voxel outside the body", Scene.from_tables, tables, points)
    else:
        Scene.from_tables(tables, points).close()
