"""Forces through boundary sets against the equilibrium of the body that they hold."""

import pytest

from myork import Scene

TUBE = {
    "scene": {"dimension": 2},
    "geometry": {
        "kind": "annulus",
        "inner_radius": 6,
        "outer_radius": 8,
        "source": [9, 51],
        "collocation": [17, 101],
    },
    "approximation": {"order": 2, "support": 4, "kernel": "quintic"},
    "material": [
        {"name": "rubber", "model": "polynomial", "A10": 37.3, "A20": -3.1, "A30": 0.5, "K": 1e3}
    ],
    "boundary": [
        {"set": "x0", "u_x": 0},
        {"set": "y0", "u_y": 0},
        {"set": "inner", "radial": 6},
    ],
    "load": {"steps": 8},
    "solver": {"weight_essential": "ns-c4", "weight_traction": 1},
    "mixed": {"volume_weight": 3},
    "galerkin": {"gauss": 3},
    "probe": [{"name": axis, "quantity": f"force_{axis}", "set": f"{axis}0"} for axis in "xy"],
}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["rkcm-mixed", "rkpm-gauss"])
def test_a_symmetry_plane_beside_a_held_wall_carries_its_force(method):
    """A quarter tube with doubled inner radius pushes the symmetry plane with p r.

    p = 15.588823 N/cm2 at r = 12 cm is the radial boundary value problem of `inputs/tube.toml`.
    The first point of the held wall is a fraction of a spacing away from the plane, so that no
    section below the plane tells the force. The tolerance is the error of the wall's stress, 1e-4
    (docs/verification.md), with room for the integral over 101 or 17 points.
    """
    tables = {**TUBE, "scene": {"dimension": 2, "method": method}}
    with Scene.from_tables(tables) as scene:
        states = scene.solve()
        forces = scene.probes(states.x[-1:], states.load[-1:])[0, :, 0]
    assert forces == pytest.approx([-15.588823 * 12] * 2, rel=5e-4)
