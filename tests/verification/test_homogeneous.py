"""Homogeneous states: patch test, exact answers for finite K, and indifference to rotation.

Shape functions of order 2 hold a homogeneous state exactly. A solve ends where its step is below
the tolerance, so that what remains is quadratically smaller; K amplifies rounding of J.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from myork.records import PointCloud

A10, A20, A30 = 37.3, -3.1, 0.5
XX, XY = 0, 3


def rubber(bulk):
    return {"name": "rubber", "model": "polynomial", "A10": A10, "A20": A20, "A30": A30, "K": bulk}


def cauchy(f, bulk):
    """Cauchy stress of the rubber, from dW/dI1 alone; written apart from the code under test."""
    j = np.linalg.det(f)
    b = f @ f.T * j ** (-2 / 3)
    i1 = np.trace(b)
    slope = A10 + 2 * A20 * (i1 - 3) + 3 * A30 * (i1 - 3) ** 2
    return 2 * slope / j * (b - i1 / 3 * np.eye(3)) + bulk * (j - 1) * np.eye(3)


def box(*counts, size=(1.0, 1.0, 1.0)):
    n = len(counts)
    return {
        "kind": "box",
        "size": list(size)[:n],
        "source": list(counts),
        "collocation": [2 * c - 1 for c in counts],
    }


def symmetry(ndim=3):
    return [{"set": f"{axis}0", f"u_{axis}": 0} for axis in "xyz"[:ndim]]


def last_fields(scene):
    states = scene.solve()
    return scene.fields(states.x[-1], 1.0)


@pytest.mark.parametrize("bulk", [1e3, 1e8])
@pytest.mark.parametrize("stretch", [0.4, 2.5])
def test_uniaxial(open_scene, stretch, bulk):
    scene = open_scene(
        {
            "scene": {"dimension": 3, "method": "rkcm"},
            "geometry": box(3, 3, 3),
            "material": [rubber(bulk)],
            "boundary": [*symmetry(), {"set": "x1", "u_x": stretch - 1}],
            "load": {"steps": 5},
            "solver": {"weight_essential": "c4"},
        }
    )

    def side_stress(side):
        return cauchy(np.diag([stretch, side, side]), bulk)[1, 1]

    incompressible = stretch**-0.5
    side = brentq(side_stress, 0.5 * incompressible, 2 * incompressible, xtol=1e-15, rtol=1e-14)
    fields = last_fields(scene)
    wanted = cauchy(np.diag([stretch, side, side]), bulk)[0, 0]
    assert_allclose(fields.f[:, 0, 0], stretch, rtol=1e-5)
    assert_allclose(fields.f[:, 1, 1], side, rtol=1e-5)
    assert_allclose(fields.cauchy[:, XX], wanted, rtol=1e-4)


@pytest.mark.parametrize("method", ["auto", "rkcm-mixed", "rkpm-gauss", "rkpm-scni"])
def test_infinite_bulk_modulus(open_scene, method):
    """K = inf keeps the volume; nothing but the boundary conditions sets the pressure."""
    stretch = 2.5
    tables = {
        "scene": {"dimension": 3, "method": method},
        "geometry": box(3, 3, 3),
        "material": [rubber(1e8)],
        "boundary": [*symmetry(), {"set": "x1", "u_x": stretch - 1}],
        "load": {"steps": 5},
    }
    scene = open_scene(tables, "material.K=inf")
    assert scene.deck["material"][0]["K"] == np.inf
    fields = last_fields(scene)
    i1 = stretch**2 + 2 / stretch
    slope = A10 + 2 * A20 * (i1 - 3) + 3 * A30 * (i1 - 3) ** 2
    # (5.114); Newton's last step was below 1e-6
    assert_allclose(np.linalg.det(fields.f), 1.0, rtol=1e-9)
    assert_allclose(fields.cauchy[:, XX], 2 * slope * (stretch**2 - 1 / stretch), rtol=1e-8)


def test_equibiaxial(open_scene):
    stretch, bulk = 1.6, 1e4
    scene = open_scene(
        {
            "scene": {"dimension": 3, "method": "rkcm"},
            "geometry": box(3, 3, 3),
            "material": [rubber(bulk)],
            "boundary": [
                *symmetry(),
                {"set": "x1", "u_x": stretch - 1},
                {"set": "y1", "u_y": stretch - 1},
            ],
            "load": {"steps": 5},
            "solver": {"weight_essential": "c4"},
        }
    )
    side = brentq(lambda s: cauchy(np.diag([stretch, stretch, s]), bulk)[2, 2], 0.2, 1.0)
    fields = last_fields(scene)
    assert_allclose(fields.f[:, 2, 2], side, rtol=1e-5)
    wanted = cauchy(np.diag([stretch, stretch, side]), bulk)
    assert_allclose(fields.cauchy[:, XX], wanted[0, 0], rtol=1e-4)


@pytest.mark.parametrize("ndim", [2, 3])
def test_dilation_and_its_plane_form(open_scene, ndim):
    """All normal displacements prescribed, all different: an affine patch without shear."""
    ends = np.array([0.5, -0.2, 0.3])[:ndim]
    scene = open_scene(
        {
            "scene": {"dimension": ndim, "method": "rkcm"},
            "geometry": box(*[4] * ndim),
            "material": [rubber(250.0)],
            "boundary": [
                *symmetry(ndim),
                *[
                    {"set": f"{axis}1", f"u_{axis}": float(end)}
                    for axis, end in zip("xyz", ends, strict=False)
                ],
            ],
            "load": {"steps": 3},
            "solver": {"tolerance": 1e-9},
        }
    )
    f = np.eye(3)
    f[range(ndim), range(ndim)] += ends
    fields = last_fields(scene)
    assert_allclose(fields.f, np.broadcast_to(f, fields.f.shape), rtol=0, atol=1e-9)
    wanted = np.diag(cauchy(f, 250.0))
    assert_allclose(fields.cauchy[:, :3], np.tile(wanted, (len(fields.u), 1)), rtol=1e-8)


@pytest.mark.slow
def test_near_simple_shear(open_scene):
    """A wide block: at its middle the free ends are felt by some per mille only."""
    gamma, bulk = 1.0, 1e3
    scene = open_scene(
        {
            "scene": {"dimension": 3, "method": "rkcm"},
            "geometry": box(9, 3, 3, size=(4.0, 1.0, 1.0)),
            "material": [rubber(bulk)],
            "boundary": [
                {"set": "y0", "u_x": 0, "u_y": 0, "u_z": 0},
                {"set": "y1", "u_x": gamma, "u_y": 0, "u_z": 0},
                {"set": "z0", "u_z": 0},
                {"set": "z1", "u_z": 0},
            ],
            "load": {"steps": 4},
        }
    )
    fields = last_fields(scene)
    middle = 5 * 5 * 8 + 5 * 2 + 2
    f = np.eye(3)
    f[0, 1] = gamma
    assert fields.cauchy[middle, XY] == pytest.approx(cauchy(f, bulk)[0, 1], rel=5e-3)


def cloud(rotation=None, fiber=(0.0, 0.0, 0.0)):
    """Cube as a model file: grids of 4 and 6 points a direction, every boundary point a set of
    its own, so that anything may be prescribed; turned as a whole where wanted.
    """
    turn = np.eye(3) if rotation is None else rotation

    def grid(n):
        axis = np.linspace(0.0, 1.0, n)
        return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)

    points = grid(6)
    low, high = np.isclose(points, 0), np.isclose(points, 1)
    on = np.flatnonzero((low | high).any(axis=1))
    normal = (high.astype(float) - low)[on]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return points[on], PointCloud(
        source=grid(4) @ turn.T,
        spacing=np.full(3, 1 / 3),
        points=points @ turn.T,
        label=np.ones(len(points), np.int32),
        fiber=np.tile(np.asarray(fiber) @ turn.T, (len(points), 1)),
        volume=np.full(len(points), 1 / 125),
        boundary_point=on.astype(np.int32),
        boundary_set=np.arange(len(on), dtype=np.int32),
        normal=normal @ turn.T,
        area=np.ones(len(on)),
        set_names=tuple(f"p{i}" for i in range(len(on))),
        label_names={1: "muscle"},
        length_unit="cm",
        source_images="",
    )


def fixed(number, u):
    return {"set": f"p{number}"} | {f"u_{axis}": float(v) for axis, v in zip("xyz", u, strict=True)}


def test_patch(open_scene):
    """An affine displacement with shear and rotation, prescribed on all faces, fills the body."""
    gradient = np.array([[0.1, 0.3, -0.05], [0.02, -0.1, 0.1], [0.04, 0.07, 0.2]])
    where, model = cloud()
    scene = open_scene(
        {
            "scene": {"dimension": 3, "method": "rkcm"},
            "material": [rubber(1e3)],
            "boundary": [fixed(i, gradient @ x) for i, x in enumerate(where)],
            "load": {"steps": 1},
            "solver": {"tolerance": 1e-10},
        },
        cloud=model,
    )
    fields = last_fields(scene)
    f = np.eye(3) + gradient
    assert_allclose(fields.u, model.points @ gradient.T, rtol=0, atol=1e-10)
    assert_allclose(fields.f, np.broadcast_to(f, fields.f.shape), rtol=0, atol=1e-9)
    wanted = cauchy(f, 1e3)[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    assert_allclose(fields.cauchy, np.tile(wanted, (216, 1)), rtol=1e-7)


def test_a_rotated_problem_has_the_rotated_answer(open_scene):
    """Round supports and a complete basis know no direction, nor does the weight of the
    prescribed displacements where it is a plain number. A muscle with inclined fibers is
    stretched, sheared and activated between its ends. Both answers are converged to 1e-6.
    """
    turn = Rotation.from_rotvec([0.4, -0.9, 0.3]).as_matrix()
    found = []
    for rotation in (np.eye(3), turn):
        where, model = cloud(rotation, fiber=(0.6, 0.0, 0.8))
        bottom, top = np.isclose(where[:, 2], 0), np.isclose(where[:, 2], 1)
        scene = open_scene(
            {
                "scene": {"dimension": 3, "method": "rkcm"},
                "approximation": {"window": "radial", "support": 3.6},
                "material": [
                    {"name": "m", "model": "muscle", "A10": 6.43, "A20": 0.94, "K": 100.0}
                    | {"curve": "smooth"}
                ],
                "boundary": [
                    *[fixed(i, np.zeros(3)) for i in np.flatnonzero(bottom)],
                    *[fixed(i, rotation @ [0.03, 0.01, 0.03]) for i in np.flatnonzero(top)],
                ],
                "load": {"steps": 1, "activation": 0.1},
                "solver": {"weight_essential": 1e4},
            },
            cloud=model,
        )
        found.append(last_fields(scene))
    plain, turned = found
    scale = abs(plain.u).max()
    assert scale > 0.03
    assert_allclose(turned.u, plain.u @ turn.T, rtol=0, atol=1e-5 * scale)
    assert_allclose(turned.f, turn @ plain.f @ turn.T, rtol=0, atol=1e-4)
