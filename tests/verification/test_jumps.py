"""Loads and activations that jump between points, few cells, and forces that balance to zero."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.truths.deck_parts import force, held, probe
from myork.bench.exact import inner_stress
from myork.bench.materials import MUSCLE
from tests.scenes import RUBBER, annulus, box, scene, solved

_SOFT = {"name": "gel", "model": "neo-hookean", "mu": 10.0, "K": 40.0}
_ACTIVE = {**MUSCLE, "fiber": [1, 0, 0]}


def plate(*source: int, push: str, **more: Any) -> dict[str, Any]:
    """A square that is held at one side and pressed on top."""
    pressed = {"set": "y1", "traction": ["0", push]}
    return scene(
        "rkpm-gauss", box(*source), material=[_SOFT], boundary=[held("x0", 2), pressed],
        probe=[force("reaction", "y", "x0"), probe("corner", "u_y", (1, 1))], **more,
    )  # fmt: skip


@pytest.mark.parametrize("low, high", [(0.377, 1.0), (0.2, 0.45)])
def test_a_traction_on_a_part_of_a_side_has_its_whole_force(low, high) -> None:
    # 64 points in place of two on a face with a jump: half of a part of an eighth of the side. The
    # two Gauss points of such a face alone missed 3 and 14 %
    found = solved(plate(9, 9, push=f"-0.5*(x > {low} and x < {high})")).last()
    assert found["reaction"] == pytest.approx(0.5 * (high - low), abs=2 * 0.5 / 8 / 64)


def test_smooth_tractions_take_no_finer_points() -> None:
    # the force of two Gauss points of order 4 a face, to the digit
    found = solved(plate(9, 9, push="-0.5*x^3")).last()
    assert found["reaction"] == pytest.approx(0.125, rel=1e-12)


def test_an_activation_that_jumps_acts_on_its_volume() -> None:
    # along the fibers, between held ends: the pull is that of the active share. At the Gauss points
    # alone the border moved to the middle between two of them, and 0.41 and 0.45 gave one answer
    def pull(border: float, *source: int) -> float:
        tables = scene(
            "rkpm-gauss", box(*source, size=[2.0, 1.0]),
            material=[{**_ACTIVE, "activation": f"0.3*(y < {border})"}],
            boundary=[held("x0", 2), held("x1", 2)], probe=[force("pull", "x", "x0")],
        )  # fmt: skip
        return solved(tables).last()["pull"]

    half = pull(0.5, 17, 9)
    for border in (0.37, 0.41, 0.45):
        assert pull(border, 17, 9) == pytest.approx(2 * border * half, rel=0.006)
        assert pull(border, 33, 17) == pytest.approx(2 * border * half, rel=0.0025)


@pytest.mark.parametrize("border", [0.9, 1.0])
@pytest.mark.parametrize("kind", ["0.1 + 0.05*{x}", "0.3*({x} < BORDER)"])
def test_activation_and_its_mirror_image_act_alike(kind, border) -> None:
    # the mean over a spacing is that of a slope in its middle, at the surface too
    pulls = []
    for x in ("x", "(2 - x)"):
        tables = scene(
            "rkpm-gauss", box(6, 5, size=[2.0, 1.0]),
            material=[{**_ACTIVE, "activation": kind.format(x=x).replace("BORDER", str(border))}],
            boundary=[held("x0", 2), held("x1", 2)], probe=[force("pull", "x", "x0")],
        )  # fmt: skip
        pulls.append(solved(tables).last()["pull"])
    assert pulls[0] == pytest.approx(pulls[1], rel=1e-9)


def test_the_smallest_square_is_near_finer_ones() -> None:
    # a single pressure group of 3 x 3 cells resisted hardly any change of volume: 38 % off
    corner = [solved(plate(n, n, push="-0.5*sin(3*x)")).last()["corner"] for n in (4, 17)]
    assert corner[0] == pytest.approx(corner[1], rel=0.02)


def test_a_free_contraction_is_accepted() -> None:
    # its only force is zero, and has the size of the stress
    tables = scene(
        "rkpm-gauss", box(9, 5, size=[2.0, 1.0]), material=[_ACTIVE],
        load={"activation": 0.1}, boundary=[held("x0", 2)],
        probe=[force("pull", "x", "x0"), probe("end", "u_x", (2, 0.5))],
    )  # fmt: skip
    tables["geometry"] = {"kind": "box", "size": [2.0, 1.0]}
    found = solved(tables, error=True)
    assert found.states.verdict == "accepted", found.states.reasons
    assert abs(found.last()["pull"]) < 1e-6


def test_tractions_of_order_three_are_lifted_with_their_degree() -> None:
    # errors of the force fall by 2^4.6; with tractions of degree 1 by 2^3, 3e-5 and 4e-6
    def error(*source: int) -> float:
        tables = scene(
            "rkpm-gauss", annulus(*source), material=[{**RUBBER, "K": 20.0}],
            approximation={"order": 3, "support": 3.5, "kernel": "quintic", "window": "polar"},
            galerkin={"gauss": 4, "essential": "transformation"},
            boundary=[
                {"set": "x0", "u_x": 0.0}, {"set": "y0", "u_y": 0.0},
                {"set": "inner", "radial": 6.0},
            ],
            probe=[force("force", "x", "x0")],
        )  # fmt: skip
        # the cut carries what presses on the bore
        exact = inner_stress(tables) * 12.0
        return abs(solved(tables).last()["force"] / exact - 1.0)

    coarse, fine = error(5, 26), error(9, 51)
    assert coarse < 1e-5
    assert fine < coarse / 2**4
