"""Convergence of Newton's method, with nonzero residuals and in decks without settings."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.optimize
import scipy.special
from numpy.testing import assert_allclose

from myork import Scene, run_deck
from myork.bench import materials
from myork.errors import ConvergenceError
from tests import scenes
from tests.scenes import RUBBER, box, execute, gripped, history, loaded, neo, scene, solved

#: Contraction at which the strain beside the clamped edges leaves large residuals
EDGES = (
    "scene.method=rkcm-mixed", "approximation.order=2", "approximation.support=3",
    "geometry.source=[4,4,7]", "geometry.collocation=[7,7,13]", "material.curve=smooth",
    "load.steps=4", "load.activation=0.2",
)  # fmt: skip


@pytest.mark.slow
def test_steps_shrink_by_one_factor(inputs: Path, tmp_path: Path) -> None:
    """Convergence is linear: the remaining error is the tolerance times rate/(1 - rate)."""
    deck = inputs / "muscle_fibers.toml"
    summary, done = execute(deck, tmp_path, "--no-error", sets=(*EDGES, "solver.tolerance=1e-8"))
    assert summary["converged"], done.stderr
    last = [float(row["step_norm"]) for row in history(tmp_path) if row["step"] == "4"]
    last = last[: 1 + next(i for i, step in enumerate(last) if step < 1e-8)]
    rates = np.array(last[-3:]) / last[-4:-1]
    assert np.ptp(rates) < 0.3 * rates.mean()
    fine, rough = (
        solved(deck, *EDGES, f"solver.tolerance={tolerance}").states.x[-1]
        for tolerance in (1e-9, 1e-5)
    )
    rate = rates.max()
    assert abs(rough - fine).max() < 1e-5 * rate / (1 - rate) * abs(fine).max() * 2


@pytest.mark.slow
def test_kinks_end_the_iteration(inputs: Path) -> None:
    """Fibers at the kink of the published curve cause a cycle: it is stopped, with a remedy."""
    overrides = [
        "scene.method=rkcm", "approximation.order=2", "approximation.support=3",
        "geometry.source=[5,5,9]", "geometry.collocation=[9,9,17]", "material.curve=published",
        "solver.max_iterations=60",
    ]  # fmt: skip
    with pytest.raises(ConvergenceError, match='curve = "smooth"') as caught:
        solved(inputs / "muscle_fibers.toml", *overrides)
    assert "load 0.0833" in str(caught.value)


@pytest.mark.parametrize(("slender", "over"), [(6, 1.6), (8, 1.3), (10, 1.6)])
def test_columns_bend_beyond_the_load_of_euler(slender: int, over: float) -> None:
    """A step along the soft mode strains the length, so that residuals increase on the way.

    The tip follows the elastica, except for shortening and shear of such a thick body and a side
    load of 1.5 % of Euler's load.
    """
    modulus = scipy.optimize.brentq(
        lambda k: scipy.special.ellipk(k * k) - 0.5 * np.pi * np.sqrt(over), 1e-6, 1 - 1e-9
    )
    sway = 2 * modulus / scipy.special.ellipk(modulus**2) * slender
    euler = np.pi**2 * 40.0 / 12 / (4 * slender**2)
    tables = loaded(
        "auto", box(4 * slender + 1, 5, size=[slender, 1]), neo(10.0, 1000.0), "x0 x1",
        {"traction": [-over * euler, 0.015 * euler]}, f"sway u_y {slender} 0.5",
    )  # fmt: skip
    found = solved(tables)
    assert found.states.load[-1] == 1.0 and found.states.iterations.sum() < 130
    assert found.last()["sway"] == pytest.approx(sway, rel=0.05)


def test_a_load_that_no_state_carries_costs_few_iterations() -> None:
    """A tube has no equilibrium beyond its limit pressure.

    Halved steps that fail are given up early, like the first; with 25 iterations each it took 132.
    """
    tables = scene(
        "auto", scenes.annulus(5, 13, radii=(6, 7), places=False), material=[neo(2.0, 50.0)],
        boundary=[*scenes.PLANES[:2], {"set": "inner", "pressure": 0.4512}],
    )  # fmt: skip
    with Scene.from_tables(tables) as body:
        with pytest.raises(ConvergenceError, match="did not converge at load 0.6") as caught:
            body.solve(error=False)
        assert 0.6 < body.states.load[-1] < 0.65
        assert body.states.iterations.sum() < 120
    # and the place where the step fails
    assert re.search(r"smallest J [\d.]+ at \([\d.]+, [\d.]+\)", str(caught.value))


@pytest.mark.parametrize("push", [-300.0, 1e4])
def test_the_last_attempt_is_let_run(push: float) -> None:
    """A block under a dead load of hundreds of its modulus: only a slow attempt, or one with a
    distant first iterate, converges."""
    with Scene.from_tables(scenes.pushed(push)) as body:
        assert body.solve(error=False).load[-1] == 1.0


# ---- decks without method, order, support, curve or load steps -----------------------------------


SOFT = neo(2.0, 6.0, "soft")
#: The rubber of the reference, table 5.1, nearly incompressible
STIFF = {**RUBBER, "name": "stiff", "K": 1e5}
MUSCLE = {**materials.MUSCLE, "K": 5e3}


def cube(points: int, material: Any = RUBBER, method: str = "auto") -> dict[str, Any]:
    """A cube between glued plates, 30 % shorter."""
    return gripped(method, box(points, points, points), material, "z0 z1", u_z=-0.3)


DECKS: dict[str, dict[str, Any]] = {
    **{f"{one['name']} sheet": gripped("auto", box(9, 5, size=[2, 1]), one, "x0 x1", u_x=1.0)
       for one in (SOFT, STIFF)},
    "soft cube": cube(5, SOFT), "stiff cube": cube(5, STIFF),
    "stiff cube, even number of points": cube(6, STIFF), "nodal cells": cube(5, method="rkpm"),
    "tube": scene("auto", scenes.annulus(5, 15), material=[STIFF],
                  boundary=[*scenes.PLANES[:2], {"set": "inner", "radial": 4}]),
    "beam": scenes.beam(17, 5), "beam far beyond its length": scenes.beam(17, 5, load=20.0),
    "muscle": gripped("auto", box(4, 4, 7, size=[1, 1, 2]), {**MUSCLE, "fiber_angle": 30}, "z0 z1",
                      load={"activation": 0.3}),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", DECKS)
def test_one_load_step_ends_where_eight_do(name: str) -> None:
    """Elastic bodies have no path dependence; step and gradient end at 1e-6 of the first ones.
    Forms chosen by default: tests/unit/test_defaults.py.
    """
    tables = DECKS[name]
    states = solved(tables, error=True).states
    slow = {**tables, "load": {**tables.get("load", {}), "steps": 8}}
    wanted = solved(slow).states.x[-1]
    assert len(states.x) == 1 and states.load[-1] == 1.0
    assert_allclose(states.x[-1], wanted, rtol=0, atol=1e-5 * np.abs(wanted).max())
    assert states.force_imbalance < 1e-8


def test_slow_iterations_of_a_hard_load_arrive() -> None:
    """A sheet sheared by 1.5 takes 17 iterations: without a halving left they may run on."""
    body, load = box(17, 9, size=[2, 1]), {"max_halvings": 0}
    states = solved(gripped("auto", body, RUBBER, "y0 y1", u_x=1.5, load=load)).states
    assert states.load[-1] == 1.0 and states.iterations.sum() > 10


def test_halved_steps_are_reported_and_given_up_early(tmp_path: Path) -> None:
    """Three load steps of 25 iterations failed before one of an eighth of the load did not: 103."""
    summary = run_deck(scenes.beam(17, 5, load=20.0), tmp_path / "out", threads=1, verbosity=-1)
    assert [step["load"] for step in summary["steps"] if step["load"] > 0] == [1.0]
    assert sum(step["iterations"] for step in summary["steps"]) < 60
    lines = (tmp_path / "out" / "run.log").read_text(encoding="utf-8").splitlines()
    said = [line for line in lines if "the load step is halved to" in line]
    assert said and all(line.startswith("  load ") for line in said)
    assert not any("halved" in text for text in summary["warnings"])
