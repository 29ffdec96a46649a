"""Pressure that follows the surface, and springs on it or behind a plate, against limit cases."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from myork import Scene, load_deck, run_deck
from myork.errors import ConvergenceError
from tests import scenes
from tests.scenes import box, explained, held, history, loaded, neo, probes, scene, solved

WEAK = pytest.mark.parametrize("method", ["rkpm-gauss", "rkpm-scni"])
CUT = {"name": "cut", "quantity": "section_force_z", "normal": [0, 0, 1]}


def pressed(end, method="rkpm-gauss", **tables):
    """A block between planes of symmetry, with a given condition at the end."""
    return scene(
        method, box(3, 3, 5, size=[1, 1, 2], places=(3, 3, 5)), material=[neo(2, 20)],
        boundary=[*scenes.PLANES, {"set": "z1", **end}], load={"steps": 2},
        probe=probes("below force_z z0", "above force_z z1", "stress cauchy_zz 0.5 0.5 1",
                     "wide u_x x1", "down u_z z1", {**CUT, "point": [0.5, 0.5, 1]}),
    ) | tables  # fmt: skip


@WEAK
@pytest.mark.parametrize("pressure", [0.6, -0.6, 4.0, -4.0])
def test_a_pressed_block_has_the_pressure_as_cauchy_stress(method, pressure):
    """Stress -p, force p times the deformed area, to twice the shear modulus; not a dead load."""
    found = solved(pressed({"pressure": pressure}, method)).last()
    area = (1 + found["wide"]) ** 2
    near = 1e-6 if method == "rkpm-gauss" else 1e-3
    assert found["stress"] == pytest.approx(-pressure, rel=near)
    assert found["below"] == pytest.approx(pressure * area, rel=near)
    assert found["above"] == pytest.approx(-pressure * area, rel=near)
    assert found["cut"] == pytest.approx(found["above"], rel=1e-4)
    if abs(pressure) < 1:
        dead = solved(pressed({"traction": [0, 0, -pressure]}, method)).last()
        assert dead["below"] == pytest.approx(pressure, rel=1e-3)
        assert abs(dead["down"] / found["down"] - 1) > 0.02


def test_the_tube_under_pressure_has_the_exact_radius(inputs):
    found = solved(inputs / "pressure_follower.toml")
    references = load_deck(inputs / "pressure_follower.toml")["reference"]
    exact = [reference["value"][0] for reference in references]
    assert list(found.last().values()) == pytest.approx(exact, rel=1e-3)
    # the stiffness is symmetric over a surface that ends in planes of symmetry
    assert found.states.iterations.max() <= 8


@WEAK
def test_newton_converges_quadratically_with_a_free_rim(method, tmp_path):
    """The ratio of logarithms of the last contractions; without the skew tangent it is 1."""
    run_deck(pressed({"pressure": 2}, method, load={"steps": 1}), tmp_path, error=False)
    rows = history(tmp_path)
    size = np.array([float(row["step_norm"]) for row in rows])
    # LU where the symmetric part of the tangent is not positive definite
    assert len(size) <= 8 and {row["solver"] for row in rows} == {"cgw", "lu"}
    contraction = np.log(size[1:] / size[:-1])
    assert max(contraction[-2:] / contraction[-3:-1]) > 1.7


def test_a_pressure_where_the_tangent_is_not_formed():
    """Minimal residuals use the stiffness of the pressure: without it 14 steps are needed here."""
    tables = scene(
        "rkpm-scni", box(7, 7, 4, size=[2, 2, 0.5], places=(7, 7, 4)), material=[neo(2, 200)],
        boundary=[*map(held, ("x0", "x1", "y0", "y1")), {"set": "z0", "pressure": 1}],
        probe=probes("up u_z 1 1 0.25"),
    )  # fmt: skip
    factored, found = solved(tables).last()["up"], solved(tables, "galerkin.direct_limit=0")
    assert factored > 0.4 and found.last()["up"] == pytest.approx(factored, rel=1e-6)
    assert found.states.iterations.max() <= 9


def test_a_free_rim_above_the_limit_is_named_where_nothing_converges():
    """A message about steps and gradients alone would not tell that a factorisation converges."""
    body, few = box(5, 5, 3, size=[2, 2, 0.5], places=(5, 5, 3)), {"max_iterations": 4}
    tables = loaded("rkpm-scni", body, neo(2, 200), "x0 z0", {"pressure": 6}, solver=few)
    tables["load"] = {"max_halvings": 0}
    with pytest.raises(ConvergenceError, match=r"rim .*direct_limit = 225 .*constrain the rim"):
        solved(tables, "galerkin.direct_limit=0")
    with pytest.raises(ConvergenceError, match="no convergence") as caught:
        solved(tables, "galerkin.direct_limit=225")
    assert "rim" not in str(caught.value)


def elastica(load: float) -> tuple[float, float]:
    """Tip of a cantilever of length and stiffness 1 under a load that stays normal to it."""

    def slope(y, load):
        turn, bend, along, across = y[:4]
        return [bend, -across, bend * across, load - bend * along, np.cos(turn), np.sin(turn)]

    def ends(a, b):
        return np.array([a[0], a[4], a[5], b[1], b[2], b[3]])

    s = np.linspace(0, 1, 100)
    y = np.zeros((6, s.size))
    y[4] = s
    for part in np.linspace(0.1, 1, 10) * load:
        found = solve_bvp(lambda _, y, q=part: np.array(slope(y, q)), ends, s, y, tol=1e-8)
        assert found.success
        s, y = found.x, found.y
    return y[4, -1] - 1, y[5, -1]


def test_a_cantilever_under_pressure_is_an_elastica():
    """A thin isochoric sheet in plane strain: its bending stiffness is 4 mu h^3/12."""
    length, thick, load = 10.0, 0.5, 3.0
    tables = loaded(
        "rkpm-gauss", box(41, 4, size=[length, thick], places=(41, 4)), neo(1, math.inf), "x0 y1",
        {"pressure": load * 4 * thick**3 / 12 / length**3}, f"tip u {length} {thick / 2}",
        load={"steps": 1}, approximation={"order": 2},
    )  # fmt: skip
    found = solved(tables).ends()["tip"]
    assert found[:2] / length == pytest.approx(elastica(load), rel=5e-3)


@pytest.mark.parametrize(("share", "unstable"), [(0.85, False), (1.1, True)])
def test_a_column_under_end_pressure_is_doubted_where_its_symmetric_tangent_is_lost(
    share, unstable
):
    """Normal to its free end the load does half its rotational work in the symmetric part, which
    is lost where 2 + 2 cos kL + kL sin kL = 0, at kL = pi: four times Euler's load; Beck's column
    flutters at twice that. The strain of 2 % and shear soften it by some 4 %.
    """
    load = share * np.pi**2 * 4 * 10 / 12 / 8**2
    body = box(33, 5, size=[8, 1], places=(33, 5))
    tables = loaded("auto", body, neo(10, 1e3), "x0 x1", {"pressure": load}, "tip u_y 8 0.5")
    states = solved(tables).states
    assert states.verdict == ("doubtful" if unstable else "accepted")
    assert any("equilibrium may be unstable" in reason for reason in states.reasons) is unstable


MUSCLE = {"name": "muscle", "model": "muscle", "A10": 10, "K": 1000, "fiber": [0, 0, 1]}
LONG = box(3, 3, 7, size=[1, 1, 3], places=(3, 3, 7))
GUIDED = {"set": "z1", "u_x": 0, "u_y": 0}


def tendon(end, method="auto", **tables):
    """An active muscle with a condition at its end."""
    return scene(
        method, LONG, material=[MUSCLE], boundary=[held("z0"), end],
        load={"steps": 2, "activation": 0.3},
        probe=probes("force force_z z1", "side force_x z1", "base force_z z0", "u_x u_x z1",
                     "u_z u_z z1", {**CUT, "point": [0.5, 0.5, 1.6]}),
    ) | tables  # fmt: skip


@pytest.mark.parametrize(
    ("method", "bulk"), [("rkpm-gauss", 1e3), ("rkpm-scni", 1e3), ("rkpm-gauss", float("inf"))]
)
def test_a_plate_in_every_form(method, bulk):
    """The force equals that of an equal prescribed displacement of the plate, at each section."""
    end = {**GUIDED, "tendon": 20, "direction": [0, 0, -3], "pull": -0.1}
    tables = tendon(end, method, material=[{**MUSCLE, "K": bulk}])
    found = solved(tables).last()
    moved = 0.1 - found["force"] / 20
    assert moved < -0.05
    still = solved({**tables, "boundary": [held("z0"), {**GUIDED, "u_z": moved}]}).last()
    # rounded values near the end of an iteration
    assert found == pytest.approx(still, rel=1e-6, abs=1e-6)
    assert found["base"] == pytest.approx(-found["force"], rel=1e-6)
    assert found["cut"] == pytest.approx(found["force"], rel=1e-4)


@pytest.mark.parametrize("bulk", [1e3, math.inf])
def test_a_plate_where_the_tangent_is_not_formed(bulk):
    """Minimal residuals give the result of a factorisation, also for two tendons, one inclined."""
    end = {**GUIDED, "tendon": 20, "direction": [0, 0, 1], "pull": 0.1}
    beside = {"set": "x1", "u_y": 0, "tendon": 5, "direction": [1, 0, 0.5], "pull": 0.02}
    tables = tendon(end, "rkpm-scni", material=[{**MUSCLE, "K": bulk}])
    tables["boundary"].append(beside)
    factored = solved(tables).last()
    assert factored["force"] > 0.1
    found = solved(tables, "galerkin.direct_limit=0").last()
    assert found == pytest.approx(factored, rel=1e-5, abs=1e-6)


def test_explain_counts_the_unknowns_of_the_plate(inputs):
    with Scene(inputs / "tendon.toml", threads=1) as opened:
        assert f"{opened.dofs} unknowns" in explained(inputs / "tendon.toml")


def test_an_inclined_tendon_pulls_along_its_direction():
    """The plate moves along it, with the work of the force along it; across it is constrained."""
    end = {"set": "z1", "u_y": 0, "tendon": 20, "direction": [1, 0, 1], "pull": 0.1}
    found = solved(tendon(end)).last()
    along = (found["force"] + found["side"]) / 2**0.5
    assert found["u_x"] == pytest.approx(found["u_z"], abs=1e-4)
    assert along == pytest.approx(20 * (0.1 - found["u_z"] * 2**0.5), rel=2e-3)
    assert abs(found["force"] - found["side"]) > 1


def test_pressures_and_tendons_follow_an_amplitude():
    """Pressed half as much at the end; pulled and released it returns to its position."""
    pump = {"name": "pump", "time": [0, 0.5, 1], "value": [0, 1, 0.5]}
    found = solved(pressed({"pressure": 0.6, "amplitude": "pump"}, amplitude=[pump])).last()
    assert found["stress"] == pytest.approx(-0.3, rel=1e-3)
    pulled = {**GUIDED, "tendon": 20, "direction": [0, 0, 1], "pull": 0.3}
    way = {"name": "pull", "time": [0, 0.5, 1], "value": [0, 1, 0]}
    tables = tendon({**pulled, "amplitude": "pull"}, load={"steps": 2}, amplitude=[way])
    path = solved(tables).probes["force"][:, 0]
    alone = solved(tendon(pulled, load={"steps": 1})).last()["force"]
    assert path[0] == pytest.approx(alone, rel=1e-6)
    assert abs(path[1]) < 1e-6 * path[0]


def test_a_spring_whose_other_end_moves():
    """Traction k g in addition to the spring k: its other end moves by g."""
    k, g = 50.0, 0.2
    found = solved(pressed({"spring": [0, 0, k], "traction": [0, 0, k * g]})).last()
    assert found["above"] == pytest.approx(k * (g - found["down"]), rel=1e-3)
    assert found["below"] == pytest.approx(-found["above"], rel=1e-4)
    assert 0 < found["down"] < g


@pytest.mark.parametrize(("ends", "seen", "value"), [
    # a bed under a uniform load moves by traction over stiffness
    (({"set": "x0", "u_x": 0}, {"set": "y0", "spring": [0, 3]},
      {"set": "y1", "traction": [0, -0.5]}), "u_y 0 0", -0.5 / 3),
    # nothing is prescribed: the springs carry the whole load
    (({"set": "x0", "spring": [50, 50]}, {"set": "x1", "traction": [0.5, 0]}), "force_x x0", -0.5),
])  # fmt: skip
def test_springs_are_supports(ends, seen, value):
    """Springs may be the only supports of a body, in one direction or in all."""
    tables = scene(
        "rkpm-gauss", box(5, 3, size=[2, 1]), material=[neo(2, 200)], boundary=list(ends),
        probe=probes(f"seen {seen}"),
    )  # fmt: skip
    assert solved(tables).last()["seen"] == pytest.approx(value, rel=1e-6)


def test_a_spring_is_as_stiff_whatever_its_amplitude():
    """The tension beside it follows the amplitude: the end is that of the ramp, the path is not."""
    early = {"name": "early", "time": [0, 0.5, 1], "value": [0, 1, 1]}
    end = {"spring": [0, 0, 3.0], "traction": [0, 0, 0.5]}
    ramp, soon = (
        solved(pressed({**end, **more}, amplitude=[early])).probes["below"][:, 0]
        for more in ({}, {"amplitude": "early"})
    )
    assert soon[-1] == pytest.approx(ramp[-1], rel=1e-6)
    assert soon[0] == pytest.approx(soon[-1], rel=1e-6)
    assert abs(ramp[0]) < 0.7 * abs(ramp[-1])


@pytest.mark.parametrize(("tables", "message"), [
    (pressed({"amplitude": "a", "spring": [1, 1, 1]},
             amplitude=[{"name": "a", "time": [0, 1], "value": [0, 1]}]),
     "nothing here varies with it: the stiffness of a spring or tendon"),
    # a bed across a direction does not prevent sliding along it
    (scene("rkpm-gauss", box(5, 3), material=[neo(2, 200)],
           boundary=[{"set": "y0", "spring": [0, 3]}]), "free to slide along x"),
    *((tendon({**GUIDED, "tendon": 20, "direction": [0, 0, 1], "pull": 0.1, **load}),
       "cannot act on the plate of a tendon") for load in ({"spring": [0, 0, 5]}, {"pressure": 1})),
])  # fmt: skip
def test_conditions_that_cannot_be(tables, message):
    assert message in scenes.refused(tables)
