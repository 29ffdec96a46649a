"""Forces through boundary sets against the equilibrium of the body that they hold."""

import tomllib

import pytest

from myork import Scene


@pytest.mark.parametrize("method", ["rkcm-mixed", "rkpm-gauss"])
def test_a_symmetry_plane_beside_a_held_wall_carries_its_force(method, inputs):
    """A quarter tube with doubled inner radius pushes the symmetry plane with p r.

    p = 15.588823 N/cm2 at r = 12 cm is the radial boundary value problem of the deck's reference.
    The first point of the held wall is a fraction of a spacing away from the plane, so that no
    section below the plane tells the force. The tolerance is the error of the wall's stress, 1e-4
    (docs/verification.md), with room for the integral over 101 or 17 points.
    """
    tables = tomllib.loads((inputs / "tube.toml").read_text(encoding="utf-8"))
    del tables["reference"]
    tables["scene"]["method"] = method
    tables["load"]["steps"] = 8
    tables["probe"] = [
        {"name": axis, "quantity": f"force_{axis}", "set": f"{axis}0"} for axis in "xy"
    ]
    with Scene.from_tables(tables) as scene:
        states = scene.solve()
        forces = scene.probes(states.x[-1:], states.load[-1:])[0, :, 0]
    assert forces == pytest.approx([-15.588823 * 12] * 2, rel=5e-4)
