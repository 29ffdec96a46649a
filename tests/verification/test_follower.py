"""Pressure that follows the surface, and springs on it, against exact states and limits."""

import pytest

from myork import Scene
from myork.errors import InputError

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


def test_pressure_follows_an_amplitude():
    tables = {
        **BLOCK,
        "amplitude": [{"name": "pump", "time": [0, 0.5, 1], "value": [0, 1, 0.5]}],
        "boundary": [*BLOCK["boundary"][:3], {"set": "z1", "pressure": 0.6, "amplitude": "pump"}],
    }
    assert answers(tables)["stress"] == pytest.approx(-0.3, rel=1e-3)


def test_a_tendon_is_between_a_held_and_a_free_end(inputs):
    """Force rises with the stiffness; it is the spring's own; both limits are met.

    The end is not flat: its mean displacement is by the areas of other points than
    those of the force, 1 % apart while it moves.
    """
    path = inputs / "tendon.toml"
    forces, ends = [], []
    stiffness = [1e-6, 5.0, 20.0, 80.0, 1e6]
    with Scene(path, threads=1) as scene:
        for k in stiffness:
            scene.update({"boundary.z1.spring": [0, 0, k]})
            found = solved(scene)
            forces.append(found["force"])
            ends.append(found["shortening"])
            if k < 1e3:
                assert found["force"] == pytest.approx(-k * found["shortening"], rel=1e-2)
    assert sorted(forces) == forces
    assert sorted(ends) == ends
    base = [{"set": "z0", "u_x": 0, "u_y": 0, "u_z": 0}]
    side = {"set": "z1", "u_x": 0, "u_y": 0}
    tables = {
        "scene": {"dimension": 3},
        "geometry": {
            "kind": "box", "size": [1, 1, 3], "source": [5, 5, 13], "collocation": [5, 5, 13],
        },
        "material": [
            {"name": "muscle", "model": "muscle", "A10": 10, "K": 1000, "fiber": [0, 0, 1]},
        ],
        "load": {"steps": 3, "activation": 0.3},
        "probe": [
            {"name": "force", "quantity": "force_z", "set": "z1"},
            {"name": "shortening", "quantity": "u_z", "set": "z1"},
        ],
    }  # fmt: skip
    held = answers({**tables, "boundary": [*base, {**side, "u_z": 0}]})
    free = answers({**tables, "boundary": [*base, side]})
    assert forces[-1] == pytest.approx(held["force"], rel=5e-3)
    assert ends[0] == pytest.approx(free["shortening"], rel=1e-3)
    assert forces[0] < 1e-5 * forces[-1]


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


@pytest.mark.parametrize("key", ["pressure", "spring"])
def test_other_forms_refuse_them(key):
    value = 1.0 if key == "pressure" else [0, 0, 1]
    tables = {**BLOCK, "scene": {"dimension": 3, "method": "rkcm"}}
    tables["boundary"] = [*BLOCK["boundary"][:3], {"set": "z1", key: value}]
    with pytest.raises(InputError, match=rf"boundary.z1.{key}: only for scene.method = rkpm"):
        Scene.from_tables(tables).close()


def test_loads_of_an_open_scene():
    with Scene.from_tables(BLOCK, threads=1) as scene:
        for pressure in (0.5, -0.8):
            scene.update({"boundary.z1.pressure": pressure})
            assert solved(scene)["stress"] == pytest.approx(-pressure, rel=1e-3)
