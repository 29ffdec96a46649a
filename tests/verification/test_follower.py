"""Pressure that follows the surface, and springs on it or behind a plate, against limits."""

import csv
import math

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from myork import Scene, run_deck
from myork.errors import ConvergenceError, InputError
from myork.stations.explain import explain_deck

BLOCK = {
    "scene": {"dimension": 3, "method": "rkpm-gauss"},
    "geometry": {"kind": "box", "size": [1, 1, 2], "source": [3, 3, 5], "collocation": [3, 3, 5]},
    "material": [{"name": "rubber", "model": "neo-hookean", "mu": 2, "K": 20}],
    "boundary": [
        {"set": "x0", "u_x": 0},
        {"set": "y0", "u_y": 0},
        {"set": "z0", "u_z": 0},
        {"set": "z1", "pressure": 0.6},
    ],
    "load": {"steps": 2},
    "probe": [
        {"name": "below", "quantity": "force_z", "set": "z0"},
        {"name": "above", "quantity": "force_z", "set": "z1"},
        {"name": "inside", "quantity": "section_force_z", "point": [0.5, 0.5, 1],
         "normal": [0, 0, 1]},
        {"name": "stress", "quantity": "cauchy_zz", "point": [0.5, 0.5, 1]},
        {"name": "wide", "quantity": "u_x", "set": "x1"},
        {"name": "down", "quantity": "u_z", "set": "z1"},
    ],
}  # fmt: skip


def solved(scene: Scene) -> dict[str, float]:
    states = scene.solve(error=False)
    values = scene.probes(states.x[-1:], states.load[-1:])[0]
    names = [probe["name"] for probe in scene.deck["probe"]]
    return {name: float(value[0]) for name, value in zip(names, values, strict=True)}


def answers(tables: dict) -> dict[str, float]:
    with Scene.from_tables(tables, threads=1) as scene:
        return solved(scene)


@pytest.mark.parametrize("method", ["rkpm-gauss", "rkpm-scni"])
@pytest.mark.parametrize("pressure", [0.6, -0.6])
def test_a_pressed_block_has_the_pressure_as_cauchy_stress(method, pressure):
    """The state is homogeneous: stress -p, force p times the deformed area; a dead load differs."""
    tables = {**BLOCK, "scene": {"dimension": 3, "method": method}}
    tables["boundary"] = [*BLOCK["boundary"][:3], {"set": "z1", "pressure": pressure}]
    found = answers(tables)
    area = (1 + found["wide"]) ** 2
    assert found["stress"] == pytest.approx(-pressure, rel=1e-3)
    assert found["below"] == pytest.approx(pressure * area, rel=1e-3)
    assert found["above"] == pytest.approx(-pressure * area, rel=1e-3)
    assert found["inside"] == pytest.approx(found["above"], rel=1e-4)
    tables["boundary"] = [*BLOCK["boundary"][:3], {"set": "z1", "traction": [0, 0, -pressure]}]
    dead = answers(tables)
    assert dead["below"] == pytest.approx(pressure, rel=1e-3)
    assert abs(dead["down"] / found["down"] - 1) > 0.02


def test_the_tube_under_pressure_has_the_exact_radius(inputs):
    with Scene(inputs / "pressure_follower.toml", threads=1) as scene:
        states = scene.solve(error=False)
        found = scene.probes(states.x[-1:], states.load[-1:])[0, :, 0]
        exact = [reference["value"][0] for reference in scene.deck["reference"]]
    assert found == pytest.approx(exact, rel=1e-3)
    # the stiffness is symmetric over a surface that ends in planes of symmetry
    assert states.iterations.max() <= 8


@pytest.mark.parametrize("method", ["rkpm-gauss", "rkpm-scni"])
def test_newton_converges_quadratically_with_a_free_rim(method, write_deck, tmp_path):
    """Order of the last steps from the ratio of logarithms of their contractions, 2 in the limit.

    Without the skew part of the tangent the contraction is constant at a pressure of half a shear
    modulus (229 iterations), and above there is no convergence.
    """
    tables = {**BLOCK, "scene": {"dimension": 3, "method": method}, "load": {"steps": 1}}
    tables["boundary"] = [*BLOCK["boundary"][:3], {"set": "z1", "pressure": 2}]
    run_deck(write_deck(tables), tmp_path / "out")
    with (tmp_path / "out" / "history.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    size = np.array([float(row["step_norm"]) for row in rows])
    assert len(size) <= 8
    assert {row["solver"] for row in rows} == {"lu"}
    contraction = np.log(size[1:] / size[:-1])
    assert max(contraction[-2:] / contraction[-3:-1]) > 1.7


@pytest.mark.parametrize("pressure", [4.0, -4.0])
def test_a_free_rim_goes_on_beyond_the_shear_modulus(pressure):
    """Twice the shear modulus; the state stays homogeneous."""
    tables = {**BLOCK, "boundary": [*BLOCK["boundary"][:3], {"set": "z1", "pressure": pressure}]}
    found = answers(tables)
    area = (1 + found["wide"]) ** 2
    assert found["stress"] == pytest.approx(-pressure, rel=1e-6)
    assert found["below"] == pytest.approx(pressure * area, rel=1e-6)


def test_a_pressure_where_the_tangent_is_not_formed():
    """Minimal residuals have the stiffness of the pressure, and Newton's method its few steps.

    Without it 14 steps are needed here, and none are enough at twice the pressure.
    """
    rim = [{"set": side, "u_x": 0, "u_y": 0, "u_z": 0} for side in ("x0", "x1", "y0", "y1")]
    tables = {
        "scene": {"dimension": 3, "method": "rkpm-scni"},
        "geometry": {
            "kind": "box", "size": [2, 2, 0.5], "source": [7, 7, 4], "collocation": [7, 7, 4],
        },
        "material": [{"name": "rubber", "model": "neo-hookean", "mu": 2, "K": 200}],
        "boundary": [*rim, {"set": "z0", "pressure": 1}],
        "probe": [{"name": "up", "quantity": "u_z", "point": [1, 1, 0.25]}],
    }  # fmt: skip
    factored = answers(tables)
    with Scene.from_tables({**tables, "galerkin": {"direct_limit": 0}}, threads=1) as scene:
        states = scene.solve(error=False)
        found = scene.probes(states.x[-1:], states.load[-1:])[0, 0, 0]
    assert factored["up"] > 0.4
    assert found == pytest.approx(factored["up"], rel=1e-6)
    assert states.iterations.max() <= 9


def test_a_free_rim_above_the_limit_is_named_where_nothing_converges():
    """A message of steps and gradients alone would not tell that a factor converges."""
    tables = {
        "scene": {"dimension": 3, "method": "rkpm-scni"},
        "geometry": {
            "kind": "box", "size": [2, 2, 0.5], "source": [5, 5, 3], "collocation": [5, 5, 3],
        },
        "material": [{"name": "rubber", "model": "neo-hookean", "mu": 2, "K": 200}],
        "boundary": [
            {"set": "x0", "u_x": 0, "u_y": 0, "u_z": 0},
            {"set": "z0", "pressure": 6},
        ],
        "galerkin": {"direct_limit": 0},
        "load": {"max_halvings": 0},
        "solver": {"max_iterations": 4},
    }  # fmt: skip
    with (
        Scene.from_tables(tables, threads=1) as scene,
        pytest.raises(ConvergenceError, match=r"rim .*direct_limit = 225 .*hold the rim"),
    ):
        scene.solve(error=False)
    tables["galerkin"]["direct_limit"] = 225
    with (
        Scene.from_tables(tables, threads=1) as scene,
        pytest.raises(ConvergenceError, match="no convergence") as caught,
    ):
        scene.solve(error=False)
    assert "rim" not in str(caught.value)


def elastica(load: float) -> tuple[float, float]:
    """Tip of a cantilever of length and stiffness 1 under a load that stays normal to it."""

    def slope(_, y, load):
        turn, bend, along, across = y[:4]
        return np.array([
            bend, -across, bend * across, load - bend * along, np.cos(turn), np.sin(turn),
        ])  # fmt: skip

    def ends(a, b):
        return np.array([a[0], a[4], a[5], b[1], b[2], b[3]])

    s = np.linspace(0, 1, 100)
    y = np.zeros((6, s.size))
    y[4] = s
    for part in np.linspace(0.1, 1, 10) * load:
        found = solve_bvp(lambda s, y, q=part: slope(s, y, q), ends, s, y, tol=1e-8)
        assert found.success
        s, y = found.x, found.y
    return y[4, -1] - 1, y[5, -1]


def test_a_cantilever_under_pressure_is_an_elastica():
    """A thin sheet in plane strain, bent by a pressure that stays normal to it.

    Its bending stiffness is 4 mu h^3/12 where it keeps its volume.
    """
    length, thick, load = 10.0, 0.5, 3.0
    tables = {
        "scene": {"dimension": 2, "method": "rkpm-gauss"},
        "geometry": {"kind": "box", "size": [length, thick], "source": [41, 4],
                     "collocation": [41, 4]},
        "approximation": {"order": 2},
        "material": [{"name": "rubber", "model": "neo-hookean", "mu": 1, "K": math.inf}],
        "boundary": [
            {"set": "x0", "u_x": 0, "u_y": 0},
            {"set": "y1", "pressure": load * 4 * thick**3 / 12 / length**3},
        ],
        "load": {"steps": 1},
        "probe": [{"name": "tip", "quantity": "u", "point": [length, thick / 2]}],
    }  # fmt: skip
    with Scene.from_tables(tables, threads=1) as scene:
        states = scene.solve(error=False)
        found = scene.probes(states.x[-1:], states.load[-1:])[0, 0]
    x, y = elastica(load)
    assert found[0] / length == pytest.approx(x, rel=5e-3)
    assert found[1] / length == pytest.approx(y, rel=5e-3)


def test_pressure_follows_an_amplitude():
    tables = {
        **BLOCK,
        "amplitude": [{"name": "pump", "time": [0, 0.5, 1], "value": [0, 1, 0.5]}],
        "boundary": [*BLOCK["boundary"][:3], {"set": "z1", "pressure": 0.6, "amplitude": "pump"}],
    }
    assert answers(tables)["stress"] == pytest.approx(-0.3, rel=1e-3)


TENDON = {
    "scene": {"dimension": 3},
    "geometry": {"kind": "box", "size": [1, 1, 3], "source": [3, 3, 7], "collocation": [3, 3, 7]},
    "material": [{"name": "muscle", "model": "muscle", "A10": 10, "K": 1000, "fiber": [0, 0, 1]}],
    "load": {"steps": 2, "activation": 0.3},
    "probe": [
        {"name": "force", "quantity": "force_z", "set": "z1"},
        {"name": "side", "quantity": "force_x", "set": "z1"},
        {"name": "base", "quantity": "force_z", "set": "z0"},
        {"name": "cut", "quantity": "section_force_z", "point": [0.5, 0.5, 1.6],
         "normal": [0, 0, 1]},
        {"name": "u_x", "quantity": "u_x", "set": "z1"},
        {"name": "u_z", "quantity": "u_z", "set": "z1"},
    ],
}  # fmt: skip
FOOT = {"set": "z0", "u_x": 0, "u_y": 0, "u_z": 0}
GUIDED = {"set": "z1", "u_x": 0, "u_y": 0}


def tendon(end: dict, **tables) -> dict:
    return {**TENDON, **tables, "boundary": [FOOT, end]}


@pytest.mark.slow
def test_a_tendon_is_between_a_held_and_a_free_end(inputs):
    """Force rises with the stiffness and is the spring's; both limits are met.

    A plate that stands where the tendon left it has the same force: held there it is the same
    state. The set gives way a little to the penalty, the plate does not.
    """
    path = inputs / "tendon.toml"
    forces, ends = [], []
    with Scene(path, threads=1) as scene:
        for k in [1e-6, 5.0, 20.0, 80.0, 1e6]:
            scene.update({"boundary.z1.tendon": k})
            found = solved(scene)
            forces.append(found["force"])
            ends.append(found["shortening"])
            if k < 1e3:
                assert found["force"] == pytest.approx(-k * found["shortening"], rel=1e-3)
    assert sorted(forces) == forces
    assert sorted(ends) == ends
    tables = tendon({**GUIDED, "u_z": 0}, geometry=TENDON["geometry"] | {
        "source": [5, 5, 13], "collocation": [5, 5, 13],
    }, load={"steps": 3, "activation": 0.3})  # fmt: skip
    with Scene.from_tables(tables, threads=1) as scene:
        # its length against that of the tendon
        assert forces[-1] == pytest.approx(solved(scene)["force"], rel=3e-5)
        scene.update({"boundary.z1.u_z": -forces[2] / 20.0})
        assert solved(scene)["force"] == pytest.approx(forces[2], rel=1e-6)
        # a plate that nothing pulls
        scene.update({"boundary.z1.u_z": ends[0]})
        assert abs(solved(scene)["force"]) < 2e-4 * forces[-1]


@pytest.mark.parametrize(
    ("method", "bulk"), [("rkpm-gauss", 1e3), ("rkpm-scni", 1e3), ("rkpm-gauss", float("inf"))]
)
def test_a_plate_in_every_form(method, bulk):
    """The force is that of a prescribed displacement as large as the plate's, at each cut."""
    tables = tendon(
        {**GUIDED, "tendon": 20, "direction": [0, 0, -3], "pull": -0.1},
        scene={"dimension": 3, "method": method},
        material=[{**TENDON["material"][0], "K": bulk}],
    )
    found = answers(tables)
    moved = 0.1 - found["force"] / 20
    assert moved < -0.05
    held = answers({**tables, "boundary": [FOOT, {**GUIDED, "u_z": moved}]})
    # rounded values near the end of an iteration
    assert found == pytest.approx(held, rel=1e-6, abs=1e-6)
    assert found["base"] == pytest.approx(-found["force"], rel=1e-6)
    assert found["cut"] == pytest.approx(found["force"], rel=1e-4)


@pytest.mark.parametrize("bulk", [1e3, float("inf")])
def test_a_plate_where_the_tangent_is_not_formed(bulk):
    """Minimal residuals find what a factor finds, also of an inclined tendon beside another."""
    tables = tendon(
        {**GUIDED, "tendon": 20, "direction": [0, 0, 1], "pull": 0.1},
        scene={"dimension": 3, "method": "rkpm-scni"},
        material=[{**TENDON["material"][0], "K": bulk}],
    )
    tables["boundary"].append(
        {"set": "x1", "u_y": 0, "tendon": 5, "direction": [1, 0, 0.5], "pull": 0.02}
    )
    tables["boundary"][1]["u_x"] = 0
    factored = answers(tables)
    assert factored["force"] > 0.1
    found = answers({**tables, "galerkin": {"direct_limit": 0}})
    assert found == pytest.approx(factored, rel=1e-5, abs=1e-6)


def test_explain_counts_the_unknowns_of_the_plate(inputs):
    path, lines = inputs / "tendon.toml", []
    explain_deck(path, progress=lines.append)
    with Scene(path, threads=1) as scene:
        assert any(f"{scene.dofs} unknowns" in line for line in lines)


def test_an_inclined_tendon_pulls_along_its_direction():
    """The plate goes along it, and its work is that of the force along it; across it is held."""
    found = answers(
        tendon({"set": "z1", "u_y": 0, "tendon": 20, "direction": [1, 0, 1], "pull": 0.1})
    )
    along = (found["force"] + found["side"]) / 2**0.5
    assert found["u_x"] == pytest.approx(found["u_z"], abs=1e-4)
    assert along == pytest.approx(20 * (0.1 - found["u_z"] * 2**0.5), rel=2e-3)
    assert abs(found["force"] - found["side"]) > 1


def test_a_tendon_follows_an_amplitude():
    """Pulled and let go it is where it was."""
    pulled = {**GUIDED, "tendon": 20, "direction": [0, 0, 1], "pull": 0.3}
    tables = tendon({**pulled, "amplitude": "pull"}, load={"steps": 2}, amplitude=[
        {"name": "pull", "time": [0, 0.5, 1], "value": [0, 1, 0]},
    ])  # fmt: skip
    with Scene.from_tables(tables, threads=1) as scene:
        states = scene.solve(error=False)
        path = scene.probes(states.x, states.load)[:, 0, 0]
    assert path[0] == pytest.approx(answers(tendon(pulled, load={"steps": 1}))["force"], rel=1e-6)
    assert abs(path[1]) < 1e-6 * path[0]


@pytest.mark.parametrize(
    ("end", "message"),
    [
        ({"tendon": 20}, "boundary.z1.direction: missing"),
        ({"u_z": 0, "pull": 1}, "boundary.z1.pull: needs tendon"),
        ({"u_z": 0, "tendon": 20, "direction": [0, 0, 1]}, "boundary.z1.u_z: cannot be given"),
        ({"tendon": 0, "direction": [0, 0, 1]}, "boundary.z1.tendon: must be"),
        ({"tendon": 2, "direction": [0, 0, 0]}, "boundary.z1.direction: "),
    ],
)
def test_tendons_that_say_too_little_or_too_much(end, message):
    with pytest.raises(InputError, match=message):
        Scene.from_tables(tendon({"set": "z1", **end})).close()


def test_a_spring_whose_other_end_moves():
    """Traction k g beside the spring k: its other end moves by g."""
    k, g = 50.0, 0.2
    tables = {**BLOCK, "boundary": [
        *BLOCK["boundary"][:3], {"set": "z1", "spring": [0, 0, k], "traction": [0, 0, k * g]}
    ]}  # fmt: skip
    found = answers(tables)
    assert found["above"] == pytest.approx(k * (g - found["down"]), rel=1e-3)
    assert found["below"] == pytest.approx(-found["above"], rel=1e-4)
    assert 0 < found["down"] < g


@pytest.mark.parametrize("key", ["pressure", "spring", "tendon"])
def test_other_forms_refuse_them(key):
    entry = {key: [0, 0, 1] if key == "spring" else 1.0}
    if key == "tendon":
        entry["direction"] = [0, 0, 1]
    tables = {**BLOCK, "scene": {"dimension": 3, "method": "rkcm"}}
    tables["boundary"] = [*BLOCK["boundary"][:3], {"set": "z1", **entry}]
    with pytest.raises(InputError, match=rf"boundary.z1.{key}: only for scene.method = rk"):
        Scene.from_tables(tables).close()


def test_loads_of_an_open_scene():
    with Scene.from_tables(BLOCK, threads=1) as scene:
        for pressure in (0.5, -0.8):
            scene.update({"boundary.z1.pressure": pressure})
            assert solved(scene)["stress"] == pytest.approx(-pressure, rel=1e-3)


def test_a_spring_is_as_stiff_whatever_its_amplitude() -> None:
    """What pulls beside it follows the amplitude: the end is that of the ramp, the way is not."""
    found = []
    for more in ({}, {"amplitude": "early"}):
        tables = {
            **BLOCK,
            "boundary": [
                *BLOCK["boundary"][:3],
                {"set": "z1", "spring": [0, 0, 3.0], "traction": [0, 0, 0.5], **more},
            ],
            "amplitude": [{"name": "early", "time": [0, 0.5, 1], "value": [0, 1, 1]}],
            "load": {"steps": 2},
        }
        with Scene.from_tables(tables, threads=1) as scene:
            states = scene.solve(error=False)
            found.append(scene.probes(states.x, states.load)[:, 0, 0])
    ramp, early = found
    assert early[-1] == pytest.approx(ramp[-1], rel=1e-6)
    assert early[0] == pytest.approx(early[-1], rel=1e-6)
    assert abs(ramp[0]) < 0.7 * abs(ramp[-1])


def test_an_amplitude_that_nothing_follows() -> None:
    tables = {
        **BLOCK,
        "boundary": [*BLOCK["boundary"][:3], {"set": "z1", "amplitude": "a", "spring": [1, 1, 1]}],
        "amplitude": [{"name": "a", "time": [0, 1], "value": [0, 1]}],
    }
    with pytest.raises(InputError, match="nothing here follows it: a spring or a tendon"):
        Scene.from_tables(tables)
