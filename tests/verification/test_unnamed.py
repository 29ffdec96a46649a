"""Decks that name no method, order, support, curve or load steps: all of them converge."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from myork import Scene, run_deck
from myork.bench import materials
from myork.core.deck import load_tables, table_defaults
from myork.core.material import Material, stress
from myork.model.cloud import build_cloud
from myork.records import Labels
from myork.tables import deck_text

SOFT = {"name": "soft", "model": "neo-hookean", "mu": 2.0, "K": 6.0}
#: The rubber of the reference, table 5.1, nearly incompressible
STIFF = {"name": "stiff", "model": "polynomial", "A10": 37.3, "A20": -3.1, "A30": 0.5, "K": 1e5}
RUBBER = {**STIFF, "K": 1e3}
MUSCLE = {**materials.MUSCLE, "K": 5e3}


def held(name: str, nd: int, **moved: float) -> dict[str, Any]:
    return {"set": name, **{f"u_{axis}": 0.0 for axis in "xyz"[:nd]}, **moved}


def box(size: list[float], source: list[int], **more: Any) -> dict[str, Any]:
    collocation = [2 * n - 1 for n in source]
    return {
        "scene": {"dimension": len(size)},
        "geometry": {"kind": "box", "size": size, "source": source, "collocation": collocation},
        **more,
    }


def cube(points: int, material: dict[str, Any] = RUBBER, **geometry: float) -> dict[str, Any]:
    """A cube between glued plates, 30 % shorter."""
    tables = box([1, 1, 1], [points] * 3, material=[material])
    tables["geometry"].update(geometry)
    return {**tables, "boundary": [held("z0", 3), held("z1", 3, u_z=-0.3)]}


def cantilever(points: list[int], load: float = 2.0) -> dict[str, Any]:
    """A beam of 4 x 1 under a dead traction on its end."""
    ends = [held("x0", 2), {"set": "x1", "traction": [0, load]}]
    tip = {"name": "tip", "quantity": "u_y", "point": [4, 0.5]}
    return box([4, 1], points, material=[RUBBER], boundary=ends, probe=[tip])


_PULLED = [held("x0", 2), held("x1", 2, u_x=1.0)]
_ENDS = [held("z0", 3), held("z1", 3)]
_TUBE = {
    "scene": {"dimension": 2},
    "geometry": {
        "kind": "annulus",
        "inner_radius": 6,
        "outer_radius": 8,
        "source": [5, 15],
        "collocation": [9, 29],
    },
    "material": [STIFF],
    "boundary": [{"set": "x0", "u_x": 0}, {"set": "y0", "u_y": 0}, {"set": "inner", "radial": 4}],
}
#: Tables and the method that they get
DECKS: dict[str, tuple[dict[str, Any], str]] = {
    "soft sheet": (box([2, 1], [9, 5], material=[SOFT], boundary=_PULLED), "rkpm-gauss"),
    "stiff sheet": (box([2, 1], [9, 5], material=[STIFF], boundary=_PULLED), "rkpm-gauss"),
    "soft cube": (cube(5, SOFT), "rkpm-gauss"),
    "stiff cube": (cube(5, STIFF), "rkpm-gauss"),
    "stiff cube, even number of points": (cube(6, STIFF), "rkpm-gauss"),
    "jittered cube": (cube(5, jitter=0.2), "rkpm-scni"),
    "tube": (_TUBE, "rkpm-gauss"),
    "beam": (cantilever([17, 5]), "rkpm-gauss"),
    "beam far beyond its length": (cantilever([17, 5], 20.0), "rkpm-gauss"),
    "muscle": (
        box(
            [1, 1, 2],
            [4, 4, 7],
            material=[{**MUSCLE, "fiber_angle": 30}],
            boundary=_ENDS,
            load={"activation": 0.3},
        ),
        "rkpm-gauss",
    ),
}


@pytest.mark.parametrize("name", DECKS)
def test_one_load_step_ends_where_eight_do(name: str) -> None:
    """Elastic bodies do not know the way; step and gradient end at 1e-6 of the first ones."""
    tables, method = DECKS[name]
    deck = load_tables(tables)
    assert deck["scene"]["method"] == method and deck["load"]["steps"] == 1
    with Scene.from_tables(tables) as scene:
        states = scene.solve()
    slow = {**tables, "load": {**tables.get("load", {}), "steps": 8}}
    with Scene.from_tables(slow) as scene:
        wanted = scene.solve().x[-1]
    assert len(states.x) == 1 and states.load[-1] == 1.0
    assert_allclose(states.x[-1], wanted, rtol=0, atol=1e-5 * np.abs(wanted).max())
    assert states.force_imbalance < 1e-8


def test_a_load_step_that_fails_is_given_up_early() -> None:
    """Three load steps of 25 iterations failed before one of an eighth of the load arrived: 103."""
    with Scene.from_tables(DECKS["beam far beyond its length"][0]) as scene:
        states = scene.solve()
    assert states.iterations.sum() < 60


def test_slow_iterations_of_a_hard_load_arrive() -> None:
    """A sheet sheared by 1.5 takes 17 iterations: without a halving left they are let run."""
    sheared = [held("y0", 2), held("y1", 2, u_x=1.5)]
    tables = box([2, 1], [17, 9], material=[RUBBER], boundary=sheared, load={"max_halvings": 0})
    with Scene.from_tables(tables) as scene:
        states = scene.solve()
    assert states.load[-1] == 1.0 and states.iterations.sum() > 10


def test_a_model_from_a_label_map() -> None:
    """A bar of muscle beside fat, held at both ends."""
    data = np.ones((8, 8, 8), np.int32)
    data[4:] = 2
    labels = Labels(data, np.diag([2.0, 2.0, 4.0, 1.0]), {1: "muscle", 2: "fat"})
    cloud, _ = build_cloud(labels, None, dict(table_defaults("build")), "cm")
    tables = {
        "scene": {"dimension": 3},
        "material": [
            {**MUSCLE, "label": 1, "fiber": [0, 0, 1]},
            {"name": "fat", "label": 2, "model": "neo-hookean", "mu": 3.0, "K": 1e3},
        ],
        "boundary": [held("bottom", 3), held("top", 3)],
        "load": {"activation": 0.5},
        "probe": [{"name": "pull", "quantity": "force_z", "set": "top"}],
    }
    with Scene.from_tables(tables, cloud) as scene:
        assert scene.deck["scene"]["method"] == "rkpm-gauss"
        assert scene.deck["approximation"]["interface"] == 0.0
        states = scene.solve()
        pull = scene.probes(states.x[-1:], states.load[-1:])[0, 0, 0]
    # half of the section of 16 x 16 mm is muscle, whose fibers keep their length between the ends
    whole = 0.5 * 2.56 * 0.5 * 30.0
    assert pull == pytest.approx(whole, rel=0.02)
    assert states.force_imbalance < 1e-8


def test_a_beam_bends() -> None:
    """felupe's quadratic elements with projected pressure, 4, 8 and 16 across, have 1.6485."""
    with Scene.from_tables(cantilever([33, 9])) as scene:
        states = scene.solve()
        tip = scene.probes(states.x, states.load)[-1, 0, 0]
    assert tip == pytest.approx(1.6485, rel=0.01)


def test_an_odd_number_of_cells_is_as_good_as_an_even_one() -> None:
    """A cell that is left over makes a group of its own.

    In a group of three volume went from cell to cell: J was 0.08 to 4.0 and the force below that of
    finer clouds, with a part across. Now the force falls from cloud to cloud, and det F of the
    written F is 0.31 to 1.39 at most, at the rims of the odd points.
    """
    pull = {"name": "pull", "quantity": "force", "set": "z1"}
    forces = []
    for points in (5, 6, 7):
        with Scene.from_tables({**cube(points), "probe": [pull]}) as scene:
            states = scene.solve()
            forces.append(scene.probes(states.x, states.load)[-1, 0])
            assert states.min_j[-1] > 0.25 and states.max_j[-1] < 1.5
    across = np.abs(np.array(forces)[:, :2]).max()
    assert across < 1e-9 * abs(forces[0][2])
    assert -forces[0][2] > -forces[1][2] > -forces[2][2]


def test_halved_steps_are_told(tmp_path: Path) -> None:
    deck = tmp_path / "beam.toml"
    heading = {"title": "beam", "units": {"force": "N", "length": "cm"}}
    deck.write_text(deck_text({**heading, **cantilever([17, 5], 20.0)}), encoding="utf-8")
    summary = run_deck(deck, tmp_path / "out", threads=1, verbosity=-1)
    assert [step["load"] for step in summary["steps"] if step["load"] > 0] == [1.0]
    told = [
        line
        for line in (tmp_path / "out" / "run.log").read_text(encoding="utf-8").splitlines()
        if "the load step is halved to" in line
    ]
    assert told and all(line.startswith("  load ") for line in told)
    assert not any("halved" in text for text in summary["warnings"])


def test_one_step_does_not_turn_sides_over() -> None:
    """A block on symmetry planes, stretched to six times its length: uniform, and free across.

    In one step of the load the iteration ends at a state with its sides exchanged, u_y = -1.53 on a
    width of 1, in equilibrium and with J > 0.
    """
    planes = [{"set": f"{axis}0", f"u_{axis}": 0.0} for axis in "xyz"]
    side = {"name": "side", "quantity": "u_y", "point": [2, 1, 0.5]}
    tables = box(
        [4, 1, 1],
        [9, 3, 3],
        material=[RUBBER],
        boundary=[*planes, {"set": "x1", "u_x": 20.0}],
        probe=[side],
    )
    with Scene.from_tables({"title": "stretched", **tables}) as scene:
        states = scene.solve()
        (across,) = scene.probes(states.x[-1:], states.load[-1:])[0, :, 0] + 1.0
    law = Material.of_table(RUBBER)
    nominal = stress(law, np.diag([6.0, across, across])[np.newaxis])[0]
    assert across > 0
    assert abs(nominal[1, 1]) < 1e-6 * nominal[0, 0]
    assert states.verdict == "accepted"
