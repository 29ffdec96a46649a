"""Scenes whose loads and materials change while they are open: the states of fresh scenes."""

import numpy as np
import pytest

from myork import Scene
from myork.errors import InputError
from tests.scenes import box, held, scene, solved

TABLES = scene(
    "rkpm-gauss", box(4, 4, 5, size=[1, 1, 2], places=(5, 5, 7)),
    material=[{"name": "muscle", "model": "muscle", "A10": 10, "K": 300, "fiber_angle": 30}],
    boundary=[
        held("z0"), held("z1", u_z=0.2, amplitude="pull"), {"set": "x1", "traction": [0.1, 0, 0]},
    ],
    amplitude=[{"name": "pull", "time": [0, 0.5, 1], "value": [0, 1, 1]}],
    load={"steps": 2, "activation": 0.1},
    probe=[{"name": "force", "quantity": "force_z", "set": "z1"}],
)  # fmt: skip
CHANGES = [
    {"material.muscle.K": 120.0},
    {"load.activation": 0.2},
    {"boundary.z1.u_z": -0.1},
    {"boundary.x1.traction": [0.4, 0, 0.1]},
    {"load.steps": 3},
    {"amplitude.pull.value": [0, 0.4, 1]},
    {"amplitude.pull.time": [0, 0.25, 1]},
    {"material.muscle.A10": 12, "material.muscle.sigma_max": 25},
    {"load.activation": 0, "boundary.z1.u_z": 0.3},
    {"solver.tolerance": 1e-8, "material.muscle.K": 1000},
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "tables"),
    [
        ("rkpm-gauss", {}),
        ("rkpm-gauss", {"galerkin": {"essential": "transformation"}}),
        ("rkpm-scni", {}),
        ("rkcm-mixed", {}),
    ],
)
def test_ten_changes_are_ten_fresh_scenes(method, tables):
    tables = {**TABLES, "scene": {"dimension": 3, "method": method}, **tables}
    overrides: list[str] = []
    with Scene.from_tables(tables, threads=1) as opened:
        opened.solve(error=False)
        for change in CHANGES:
            opened.update(change)
            overrides += [f"{key}={value}" for key, value in change.items()]
            found = opened.solve(error=False)
            with Scene.from_tables(tables, overrides=overrides, threads=1) as fresh:
                expected = fresh.solve(error=False)
                assert opened.deck == fresh.deck
                assert (opened.steps, opened.rows) == (fresh.steps, fresh.rows)
                assert np.array_equal(found.x, expected.x)
                assert np.array_equal(found.load, expected.load)
                assert np.array_equal(
                    opened.probes(found.x, found.load), fresh.probes(expected.x, expected.load)
                )


def test_error_bars_are_those_of_the_changed_scene():
    with Scene.from_tables(TABLES, threads=1) as opened:
        opened.update({"load.activation": 0.25})
        found = opened.solve()
    expected = solved(TABLES, "load.activation=0.25", error=True).states
    assert found.verdict == expected.verdict
    assert np.array_equal(found.probe_errors, expected.probe_errors, equal_nan=True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"geometry.source": [5, 5, 5]}, "geometry.source cannot be changed in an open scene"),
        ({"approximation.order": 2}, "cannot be changed"),
        ({"scene.method": "rkcm"}, "cannot be changed"),
        ({"galerkin.penalty": 10}, "cannot be changed"),
        ({"material.muscle.fiber_angle": 10}, "cannot be changed"),
        ({"boundary.z1.set": "z0"}, "cannot be changed"),
        ({"boundary.x1.u_x": 0.1}, "boundary.x1: an open scene keeps which components"),
        ({"material.muscle.K": -1}, "material.muscle.K: "),
        ({"material.muscle.KK": 1}, "KK"),
        ({"material.muscle.K": float("inf")}, "K = inf makes pressures unknowns"),
        ({"load.activation": None}, "None is not a value"),
    ],
)
def test_what_cannot_be_changed_says_so_and_leaves_the_scene(changes, message):
    with Scene.from_tables(TABLES, threads=1) as opened:
        before = opened.solve(error=False)
        deck = dict(opened.deck)
        with pytest.raises(InputError) as caught:
            opened.update({"load.steps": 4, **changes})
        assert message in str(caught.value)
        assert dict(opened.deck) == deck
        assert np.array_equal(opened.solve(error=False).x, before.x)


def test_loads_change_where_pressures_are_unknowns():
    tables = {**TABLES, "material": [{**TABLES["material"][0], "K": float("inf")}]}
    with Scene.from_tables(tables, threads=1) as opened:
        opened.update({"load.activation": 0.2})
        found = opened.solve(error=False)
    with Scene.from_tables(tables, overrides=["load.activation=0.2"], threads=1) as fresh:
        assert np.array_equal(found.x, fresh.solve(error=False).x)


@pytest.mark.parametrize("method", ["rkcm", "rkpm-gauss"])
def test_loads_of_a_linear_problem_are_those_of_its_deck(method):
    tables = {
        "scene": {"dimension": 2, "method": method},
        "geometry": box(5, 5),
        "linear": {"problem": "poisson", "source": "1"},
        "boundary": [{"set": "x0", "u": 0.0}],
    }
    with Scene.from_tables(tables) as opened:
        n = len(opened.field_points())
        with pytest.raises(InputError, match="loads of a linear problem"):
            opened.set_fields(np.ones((n, 3)), np.zeros((n, 3)), np.zeros((n, 3, 3)))


@pytest.mark.parametrize("method", ["rkcm", "rkpm-scni", "rkpm-gauss"])
def test_loads_of_its_own_have_no_second_solution(method):
    """Nothing can speak for such an answer: it is doubtful; and it cannot be changed."""
    tables = {key: value for key, value in TABLES.items() if key != "amplitude"}
    tables |= {"boundary": [TABLES["boundary"][0]], "scene": {"dimension": 3, "method": method}}
    with Scene.from_tables(tables, threads=1) as opened:
        n = len(opened.field_points())
        opened.set_fields(np.ones((n, 3)), np.zeros((n, 3)), np.zeros((n, 3, 3)))
        with pytest.raises(InputError, match="set_fields"):
            opened.update({"load.activation": 0.2})
        states = opened.solve()
    assert np.any(states.x) and np.isnan(states.probe_errors).all()
    assert states.verdict != "accepted"
    assert any("set point by point" in reason for reason in states.reasons)


def test_a_reduced_model_is_made_anew_after_a_change():
    tables = {key: value for key, value in TABLES.items() if key != "probe"}
    with Scene.from_tables(tables, threads=1) as opened:
        states = opened.solve(error=False)
        modes, _ = np.linalg.qr(states.x.T)
        opened.reduce(modes)
        opened.update({"load.activation": 0.2})
        with pytest.raises(InputError):
            opened.solve_reduced("")
