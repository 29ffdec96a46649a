"""What jumps between points: loads, activations, materials; few cells; forces that balance to 0."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.truths.deck_parts import probe
from benchmarks.truths.exact import inner_stress
from myork import Scene
from myork.bench.materials import MUSCLE
from tests import scenes
from tests.scenes import annulus, box, gripped, held, loaded, neo, probes, scene, slip, solved

_ACTIVE = {**MUSCLE, "fiber": [1, 0, 0]}


def plate(*source: int, push: str) -> dict[str, Any]:
    """A square that is held at one side and pressed on top."""
    end, wanted = {"traction": ["0", push]}, ("reaction force_y x0", "corner u_y 1 1")
    return loaded("rkpm-gauss", box(*source), neo(10.0, 40.0), "x0 y1", end, *wanted)


def pull(activation: Any, *source: int, size: Any = (2.0, 1.0), beside: Any = ()) -> float:
    """Force of an active sheet between held ends."""
    materials = [{**_ACTIVE, "activation": activation}, *beside]
    tables = gripped("rkpm-gauss", box(*source, size=size), materials, "x0 x1", "pull force_x x0")
    return solved(tables).last()["pull"]


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
    half = pull("0.3*(y < 0.5)", 17, 9)
    for border in (0.37, 0.41, 0.45):
        for source, near in (((17, 9), 0.006), ((33, 17), 0.0025)):
            found = pull(f"0.3*(y < {border})", *source)
            assert found == pytest.approx(2 * border * half, rel=near)


@pytest.mark.parametrize("border", [0.9, 1.0])
@pytest.mark.parametrize("kind", ["0.1 + 0.05*{x}", "0.3*({x} < {border})"])
def test_activation_and_its_mirror_image_act_alike(kind, border) -> None:
    # the mean over a spacing is that of a slope in its middle, at the surface too
    one, other = (pull(kind.format(x=x, border=border), 6, 5) for x in ("x", "(2 - x)"))
    assert one == pytest.approx(other, rel=1e-9)


@pytest.mark.parametrize("activation", ["0.1*x", "0.3*(x < 1)"])
@pytest.mark.parametrize("quantity", ["cauchy_xx", "expression"])
def test_stress_has_the_activation_of_its_own_place(activation, quantity) -> None:
    # half way between two points the stress is one from either side, but for its slope over 2e-5;
    # with the activation of the nearest point it jumped there by 12 % and more
    middles = [1.0 + (k + 0.5) / 8 for k in range(-3, 3)]
    sides = [(middle, middle + side * 1e-5) for middle in middles for side in (-1, 1)]
    tables = scene(
        "rkpm-gauss", box(9, 5, size=[2.0, 1.0]),
        material=[{**_ACTIVE, "activation": activation}],
        boundary=[held("x0", 2), held("x1", 2)],
        probe=[probe(f"p{k}", quantity, (x, 0.47)) for k, (_, x) in enumerate(sides)],
    )  # fmt: skip
    if quantity == "expression":
        for table in tables["probe"]:
            table["expression"] = "cauchy_xx - cauchy_yy"
    found = list(solved(tables).last().values())
    assert found[::2] == pytest.approx(found[1::2], rel=1e-3)


def test_an_activation_may_be_below_zero_by_a_rounding() -> None:
    # the radius of a point on the inner surface is 1 up to roundings
    tables = scene(
        "rkpm-gauss", annulus(5, 9, radii=(1.0, 1.5)),
        material=[{**_ACTIVE, "activation": "0.3*(r-1)"}],
        boundary=[{"set": "x0", "u_x": 0.0}, {"set": "y0", "u_y": 0.0}],
    )  # fmt: skip
    with Scene.from_tables(tables) as opened:
        assert opened.dofs > 0


def test_the_smallest_square_is_near_finer_ones() -> None:
    # a single pressure group of 3 x 3 cells resisted hardly any change of volume: 38 % off
    corner = [solved(plate(n, n, push="-0.5*sin(3*x)")).last()["corner"] for n in (4, 17)]
    assert corner[0] == pytest.approx(corner[1], rel=0.02)


def test_a_free_contraction_is_accepted() -> None:
    # its only force is zero, and has the size of the stress
    tables = scene(
        "rkpm-gauss", box(size=[2.0, 1.0]), material=[_ACTIVE], load={"activation": 0.1},
        boundary=[held("x0", 2)], probe=probes("pull force_x x0", "end u_x 2 0.5"),
    )  # fmt: skip
    found = solved(tables, error=True)
    assert found.states.verdict == "accepted", found.states.reasons
    assert abs(found.last()["pull"]) < 1e-6


def test_tractions_of_order_three_are_lifted_with_their_degree() -> None:
    # errors of the force fall by 2^4.6; with tractions of degree 1 by 2^3, 3e-5 and 4e-6
    def error(*source: int) -> float:
        tables = scene(
            "rkpm-gauss", scenes.annulus(*source), material=[{**scenes.RUBBER, "K": 20.0}],
            approximation={"order": 3, "support": 3.5, "kernel": "quintic", "window": "polar"},
            galerkin={"gauss": 4, "essential": "transformation"},
            boundary=[*scenes.PLANES[:2], {"set": "inner", "radial": 6.0}],
            probe=probes("force force_x x0"),
        )  # fmt: skip
        # the cut carries what presses on the bore
        exact = inner_stress(tables) * 12.0
        return abs(solved(tables).last()["force"] / exact - 1.0)

    coarse, fine = error(5, 26), error(9, 51)
    assert coarse < 1e-5
    assert fine < coarse / 2**4


def plates(geometry: Any, layer: str, mu: float = 0.5, ends: str = "y0 y1") -> dict[str, Any]:
    """Stiff plates with a soft layer between them, sheared by a twentieth."""
    materials = [neo(50.0, 200.0, "plates"), neo(mu, 4 * mu, "layer", where=layer)]
    return gripped("rkpm-gauss", geometry, materials, ends, f"f force_x {ends[-2:]}", u_x=0.05)


def test_a_sheet_between_two_planes_is_no_stiffer_than_it_is() -> None:
    # kinks cannot resolve less than 1.5 spacings: with them 9 x 9 points had 1.70, accepted
    found, fine = (
        solved(plates(body, "y > 0.3 and y < 0.34")).last()["f"]
        for body in (box(size=[1.0, 1.0]), box(33, 65))
    )
    assert found == pytest.approx(fine, rel=0.02)


def test_a_thin_sheet_in_space_is_doubted() -> None:
    tables = plates(box(5, 5, 4), "z > 0.47 and z < 0.53", 5.0, "z0 z1")
    states = solved(tables, error=True).states
    assert states.verdict == "doubtful"
    assert any("less than 1.5 spacings" in reason for reason in states.reasons)


@pytest.mark.parametrize(("plane", "near"), [(0.5, 0.48), (0.51, 0.53)])
def test_a_stress_beside_a_plane_is_of_its_own_side(plane, near) -> None:
    # along the plane both sides have one strain, and stress the modulus of its own side
    far = 0.25 if near < plane else 0.8
    tables = scene(
        "rkpm-gauss", box(9, 9),
        material=[neo(1.0, 4.0, "soft"), neo(10.0, 4.0, "stiff", where=f"y > {plane}")],
        boundary=[{"set": "x0", "u_x": 0.0}, {"set": "x1", "u_x": 0.1}, *slip("y")],
        probe=probes(f"near cauchy_xx 0.5 {near}", f"far cauchy_xx 0.5 {far}"),
    )  # fmt: skip
    found = solved(tables).last()
    assert found["near"] == pytest.approx(found["far"], rel=1e-3)


@pytest.mark.parametrize("plane", [0.375, 0.36])
def test_groups_between_planes_have_a_mirror_image(plane) -> None:
    # of five spacings beyond a plane none of the two middle lines is the nearer one
    def aside(where: str, ends: str, u_x: float) -> float:
        materials = [neo(0.5, 2.0, "soft"), neo(10.0, 40.0, "stiff", where=where)]
        body = "rkpm-gauss", box(9, 9), materials, ends
        return solved(gripped(*body, "top u_y 0.5 1", u_x=u_x, u_y=0.1)).last()["top"]

    one = aside(f"x > {plane}", "x0 x1", 0.05)
    assert aside(f"x < {1 - plane}", "x1 x0", -0.05) == pytest.approx(one, rel=1e-6)


def test_a_muscle_beside_a_plane_has_its_own_activation() -> None:
    # the mean over a spacing ends at the plane, beyond which the expression is zero or has no value
    gel = {"size": 1.0, "beside": [neo(1.0, 4.0, "gel", where="y > 0.37")]}
    number = pull(0.3, 9, 9, **gel)
    for field in ("0.3*(y < 0.37)", "0.3*sqrt(max(0.37 - y, 0)/(0.37 - y))"):
        assert pull(field, 9, 9, **gel) == pytest.approx(number, rel=1e-6)
