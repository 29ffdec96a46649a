"""Decks that name no method, order, support, curve or load steps: all of them converge."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from myork import run_deck
from myork.bench import materials
from myork.core.deck import load_deck
from tests.scenes import PLANES, RUBBER, annulus, beam, box, gripped, neo, scene, solved

SOFT = neo(2.0, 6.0, "soft")
#: The rubber of the reference, table 5.1, nearly incompressible
STIFF = {**RUBBER, "name": "stiff", "K": 1e5}
MUSCLE = {**materials.MUSCLE, "K": 5e3}


def cube(points: int, material: Any = RUBBER, *wanted: str, **geometry: float) -> dict[str, Any]:
    """A cube between glued plates, 30 % shorter."""
    return gripped("auto", box(*[points] * 3, **geometry), material, "z0 z1", *wanted, u_z=-0.3)


def sheet(material: dict[str, Any]) -> dict[str, Any]:
    return gripped("auto", box(9, 5, size=[2, 1]), material, "x0 x1", u_x=1.0)


#: Tables and the method that they get
DECKS: dict[str, tuple[dict[str, Any], str]] = {
    "soft sheet": (sheet(SOFT), "rkpm-gauss"),
    "stiff sheet": (sheet(STIFF), "rkpm-gauss"),
    "soft cube": (cube(5, SOFT), "rkpm-gauss"),
    "stiff cube": (cube(5, STIFF), "rkpm-gauss"),
    "stiff cube, even number of points": (cube(6, STIFF), "rkpm-gauss"),
    "jittered cube": (cube(5, jitter=0.2), "rkpm-scni"),
    "tube": (
        scene("auto", annulus(5, 15), material=[STIFF],
              boundary=[*PLANES[:2], {"set": "inner", "radial": 4}]), "rkpm-gauss",
    ),
    "beam": (beam(17, 5), "rkpm-gauss"),
    "beam far beyond its length": (beam(17, 5, load=20.0), "rkpm-gauss"),
    "muscle": (
        gripped("auto", box(4, 4, 7, size=[1, 1, 2]), {**MUSCLE, "fiber_angle": 30}, "z0 z1",
                load={"activation": 0.3}), "rkpm-gauss",
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", DECKS)
def test_one_load_step_ends_where_eight_do(name: str) -> None:
    """Elastic bodies do not know the way; step and gradient end at 1e-6 of the first ones."""
    tables, method = DECKS[name]
    deck = load_deck(tables)
    assert deck["scene"]["method"] == method and deck["load"]["steps"] == 1
    states = solved(tables, error=True).states
    slow = {**tables, "load": {**tables.get("load", {}), "steps": 8}}
    wanted = solved(slow).states.x[-1]
    assert len(states.x) == 1 and states.load[-1] == 1.0
    assert_allclose(states.x[-1], wanted, rtol=0, atol=1e-5 * np.abs(wanted).max())
    assert states.force_imbalance < 1e-8


def test_slow_iterations_of_a_hard_load_arrive() -> None:
    """A sheet sheared by 1.5 takes 17 iterations: without a halving left they are let run."""
    body, load = box(17, 9, size=[2, 1]), {"max_halvings": 0}
    states = solved(gripped("auto", body, RUBBER, "y0 y1", u_x=1.5, load=load)).states
    assert states.load[-1] == 1.0 and states.iterations.sum() > 10


def test_halved_steps_are_reported_and_given_up_early(tmp_path: Path) -> None:
    """Three load steps of 25 iterations failed before one of an eighth of the load arrived: 103."""
    summary = run_deck(beam(17, 5, load=20.0), tmp_path / "out", threads=1, verbosity=-1)
    assert [step["load"] for step in summary["steps"] if step["load"] > 0] == [1.0]
    assert sum(step["iterations"] for step in summary["steps"]) < 60
    lines = (tmp_path / "out" / "run.log").read_text(encoding="utf-8").splitlines()
    said = [line for line in lines if "the load step is halved to" in line]
    assert said and all(line.startswith("  load ") for line in said)
    assert not any("halved" in text for text in summary["warnings"])
