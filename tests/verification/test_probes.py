"""Probes of sets and sections: torques, mean displacements and forces inside the body.

A block is held at one end, and its other end is moved sideways and lengthened. No force acts in
between: every section carries the force of the ends, and the moments of both ends about one point
balance where they have moved to. In Galerkin forms both hold as exactly as the equations are
solved; collocation knows them as well as it balances forces.
"""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

from myork import Scene
from myork.errors import InputError
from myork.stations.solve import run_deck
from tests.scenes import box, held, refused, scene, solved

ABOUT = [0.3, 0.2, 0.1]
PLACES = (0.05, 0.6, 1.0, 1.37, 1.98)


def block(method: str, source: list[int], bulk: float) -> dict:
    """Block with probes of its ends and of sections from one to the other."""
    cut = {"quantity": "section_force", "normal": [0, 0, 2]}
    return scene(
        method, box(*source, size=[1, 1.2, 2]), load={"steps": 2},
        material=[{"name": "rubber", "model": "polynomial", "A10": 10, "K": bulk}],
        boundary=[held("z0"), held("z1", u_x=0.3, u_y=0.1, u_z=0.2)],
        probe=[
            *({"name": f"force{k}", "quantity": "force", "set": f"z{k}"} for k in (0, 1)),
            *({"name": f"section{z}", "point": [0.4, 0.5, z], **cut} for z in PLACES),
            *({"name": f"torque{a}{k}", "quantity": f"torque_{a}", "set": f"z{k}", "about": ABOUT}
              for a in "xyz" for k in (0, 1)),
            {"name": "own", "quantity": "torque_y", "set": "z1"},
            {"name": "middle", "quantity": "u", "set": "z1"},
            {"name": "side", "quantity": "u_z", "set": "x1"},
        ],
    )  # fmt: skip


def values(tables: dict) -> dict[str, np.ndarray]:
    return {name: value[-1] for name, value in solved(tables).probes.items()}


@pytest.mark.parametrize(
    ("method", "bulk", "tolerance"),
    [
        ("rkpm-gauss", 50.0, 1e-5),
        ("rkpm-gauss", float("inf"), 1e-5),
        ("rkpm-scni", 50.0, 1e-5),
        # least squares balance forces as well as they can: 4 % on this cloud
        ("rkcm-mixed", 50.0, 0.06),
    ],
)
def test_sections_carry_the_force_of_the_ends_and_torques_balance(method, bulk, tolerance):
    found = values(block(method, [4, 4, 5], bulk))
    force = found["force1"]
    near = tolerance * np.linalg.norm(force)
    assert_allclose(found["force0"], -force, atol=near)
    for z in PLACES:
        assert_allclose(found[f"section{z}"], force, atol=near)
    for axis in "xyz":
        ends = [found[f"torque{axis}{end}"][0] for end in (0, 1)]
        assert ends[1] == pytest.approx(-ends[0], abs=2 * near)
    # about its own middle an end carries the moment that bends the block: less than that of the
    # force about the far end, and of its sign
    assert found["own"][0] * force[0] < 0
    assert 0.3 < -found["own"][0] / (2 * force[0]) < 1.1
    assert_allclose(found["middle"], [0.3, 0.1, 0.2], atol=2e-4)
    assert found["side"][0] == pytest.approx(0.06, abs=0.02)


@pytest.mark.parametrize("method", ["rkpm-gauss", "rkpm-scni", "rkcm"])
def test_a_homogeneous_state_knows_its_sections_and_moments(method):
    """Uniaxial tension between symmetry planes: force sigma a b, moment arms half the edges."""
    tables = scene(
        method, box(4, 4, 4, size=[1, 2, 3]),
        material=[{"name": "rubber", "model": "neo-hookean", "mu": 2, "K": 10}],
        boundary=[*({"set": f"{a}0", f"u_{a}": 0} for a in "xyz"), {"set": "z1", "u_z": 0.6}],
        probe=[
            {"name": "end", "quantity": "force_z", "set": "z1"},
            {"name": "inside", "quantity": "section_force_z", "point": [0.5, 1, 1.2],
             "normal": [0, 0, 1]},
            {"name": "about_x", "quantity": "torque_x", "set": "z1", "about": [0, 0, 0]},
            {"name": "own", "quantity": "torque_x", "set": "z1"},
            {"name": "side", "quantity": "u_x", "set": "x1"},
            {"name": "point", "quantity": "u_x", "point": [1, 1, 2]},
            {"name": "y", "quantity": "u_y", "point": [1, 2, 2]},
        ],
    )  # fmt: skip
    found = {name: value[0] for name, value in values(tables).items()}
    assert found["inside"] == pytest.approx(found["end"], rel=1e-3)
    # the force acts in the middle of the deformed end, half of the narrowed edge from the plane
    assert found["about_x"] == pytest.approx(found["end"] * (1 + found["y"] / 2), rel=2e-3)
    assert found["own"] == pytest.approx(found["end"] * found["y"] / 2, rel=0.02)
    assert found["side"] == pytest.approx(found["point"], rel=2e-3)


def test_a_cloud_without_room_for_a_section_tells_the_force_as_well():
    """Two cells along the block: every source point is seen by an end."""
    tables = block("rkpm-gauss", [3, 3, 3], 50.0)
    found = values(tables)
    for z in PLACES:
        assert_allclose(found[f"section{z}"], found["force1"], rtol=1e-4)


def test_the_executable_writes_them_with_error_bars(tmp_path):
    tables = block("rkpm-gauss", [4, 4, 5], 50.0)
    summary = run_deck(tables, tmp_path, threads=1)
    last = summary["steps"][-1]
    inside = solved(tables, error=True)
    for probe in tables["probe"]:
        name, wide = probe["name"], probe["quantity"] in ("u", "force", "section_force")
        value, bar = last["probes"][name], last["probe_errors"][name]
        n = 3 if wide else 1
        assert_allclose(value, inside.probes[name][-1, :n].squeeze(), rtol=1e-9, atol=1e-9)
        assert_allclose(bar, inside.bars[name][-1, :n].squeeze(), rtol=1e-6)
        assert np.all(np.asarray(bar) > 0)
    assert "torque" in json.dumps(summary["deck"]["probe"])


@pytest.mark.parametrize(
    ("probe", "message"),
    [
        ({"quantity": "torque_z"}, "missing, a text is needed for quantity ="),
        ({"quantity": "torque_z", "point": [0, 0, 0]}, "probe.p.set: missing"),
        ({"quantity": "section_force", "point": [0.5, 0.5, 1]}, "probe.p.normal: missing"),
        ({"quantity": "section_force", "set": "z1", "normal": [0, 0, 1]}, "probe.p.set: only for"),
        ({"quantity": "force", "set": "z1", "about": [0, 0, 0]}, "probe.p.about: only for"),
        ({"quantity": "section_force", "point": [0.5, 0.5, 3], "normal": [0, 0, 1]}, "outside"),
        ({"quantity": "section_force", "point": [0.5, 0.5, 1], "normal": [0, 0, 0]}, "normal"),
        ({"quantity": "cauchy_xx", "set": "z1"}, "probe.p.set: only for"),
    ],
)
def test_a_probe_that_is_not_whole_is_refused(probe, message):
    tables = {**block("rkpm-gauss", [3, 3, 3], 50.0), "probe": [{"name": "p", **probe}]}
    assert message in refused(tables)


def test_a_plane_has_one_torque():
    tables = scene(
        "auto", box(4, 4, places=(4, 4)), boundary=[held("x0", 2), {"set": "x1", "u_y": 0.1}],
        material=[{"name": "rubber", "model": "neo-hookean", "mu": 1, "K": 10}],
        probe=[{"name": "t", "quantity": "torque_x", "set": "x1"}],
    )  # fmt: skip
    with pytest.raises(InputError, match="torque_x is always zero in two dimensions"):
        Scene.from_tables(tables).close()
