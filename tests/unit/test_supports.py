"""What holds a body, and runs whose numbers say nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.truths import bodies
from myork import Scene
from myork.errors import ConvergenceError
from myork.records import PointCloud
from tests.refusals import refuses
from tests.scenes import box, held, refused, scene

METHODS = ("rkcm", "rkcm-mixed", "rkpm-gauss", "rkpm-scni")
RUBBER = [{"name": "rubber", "model": "polynomial", "A10": 10.0, "K": 500.0}]


def tables(nd: int, method: str, **sets: str) -> dict[str, Any]:
    """A block, or its plane, with the given components of these sets at rest."""
    geometry = box(*[3, 3, 4][:nd], size=[1, 1, 2][:nd], places=[4, 4, 7][:nd])
    approximation = {"order": 1 if method.startswith("rkpm") else 2, "support": 2.5}
    still = [{"set": name, **{f"u_{axis}": 0 for axis in axes}} for name, axes in sets.items()]
    return scene(method, geometry, boundary=still, approximation=approximation, material=RUBBER)


#: Motions that prescribed components do not hinder, counted by hand; in the last line of space the
#: axis of the turn lies in both planes
FREE = [
    (3, {"x1": "x"}, "slide along y, to slide along z, to turn about an axis along x"),
    (3, {"x0": "x", "y0": "y"}, "slide along z"),
    (3, {"z0": "z", "z1": "z"}, "slide along x, to slide along y, to turn about an axis along z"),
    (3, {"x0": "yz"}, "slide along x, to turn about an axis along y, to turn about an axis along"),
    (3, {"z0": "xy", "x0": "z"}, "turn about an axis along y"),
    (2, {"x0": "x"}, "slide along y"),
    (2, {"x0": "y"}, "slide along x, to turn in its plane"),
]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("dimension", "sets", "motions"), FREE)
def test_motions_that_nothing_hinders(dimension, sets, motions, method):
    assert f"leave the body free to {motions}" in refused(tables(dimension, method, **sets))


@pytest.mark.parametrize(("dimension", "sets"), [
    (3, {"z0": "xyz"}), (3, {"x0": "x", "y0": "y", "z0": "z"}), (3, {"x0": "yz", "x1": "x"}),
    (2, {"x0": "x", "y0": "y"}),
])  # fmt: skip
def test_bodies_that_are_held(dimension: int, sets: dict[str, str]) -> None:
    """Clamped, by planes of symmetry, by sides of which each holds what the other leaves."""
    for method in METHODS:
        Scene.from_tables(tables(dimension, method, **sets)).close()


def test_a_volume_that_is_prescribed_leaves_the_pressure_of_rigid_volumes_open() -> None:
    """With one side free, or with a material that gives way, it follows."""
    sides = dict.fromkeys(("x0", "x1", "y0", "y1"), "xy")
    deck = tables(2, "rkpm-gauss", **sides)
    Scene.from_tables(deck).close()
    deck["material"] = [{**RUBBER[0], "K": float("inf")}]
    assert "leaves its pressure undetermined" in refused(deck)
    Scene.from_tables({**deck, "boundary": deck["boundary"][:3]}).close()


def pinned(points: np.ndarray) -> PointCloud:
    cube = bodies.box((1.0, 1.0, 1.0), (4, 4, 4), (4, 4, 4))
    place = [np.linalg.norm(cube.points - point, axis=1).argmin() for point in points]
    n = len(place)
    return replace(
        cube, boundary_point=np.array(place, np.int32), boundary_set=np.zeros(n, np.int32),
        normal=np.tile([0.0, 0, -1], (n, 1)), area=np.full(n, 1 / 16), set_names=("pins",),
    )  # fmt: skip


def test_a_hinge_is_no_support_and_three_pins_are() -> None:
    """Points held on a diagonal leave the turn about it; one beside it ends that."""
    deck = scene(
        "rkcm", {}, material=RUBBER, boundary=[held("pins")],
        approximation={"order": 2, "support": 3},
    )  # fmt: skip
    diagonal = np.array([[0, 0, 0], [1 / 3, 1 / 3, 0], [2 / 3, 2 / 3, 0], [1, 1, 0]])
    assert "free to turn about an axis along (1, 1, 0);" in refused(deck, pinned(diagonal))
    Scene.from_tables(deck, pinned(np.vstack([diagonal, [1, 0, 0]]))).close()


#: A stiffness beside which the stress of the muscle, 1.5, is less than a rounding
DROWNED = (
    "geometry.source=[4,4,5]", "geometry.collocation=[7,7,9]", "load.steps=2",
    "load.activation=0.05", "material.A10=9e18",
)  # fmt: skip


@pytest.mark.parametrize("method", ["rkcm", "rkpm-gauss"])
def test_a_load_that_drowns_in_rounding_has_no_answer(inputs, open_scene, method: str) -> None:
    opened = open_scene(inputs / "muscle_block.toml", *DROWNED, f"scene.method={method}")
    refuses(r"rounding errors of a stiffness of 1\.8E\+19", opened.solve, kind=ConvergenceError)
    # no load is no reason to complain
    opened = open_scene(inputs / "muscle_block.toml", *DROWNED[:3], "load.activation=0")
    assert not opened.solve().x.any()
