"""Verdicts and error bars: wrong answers are refused, right ones accepted, bars cover.

References, each from meshes that are refined until they no longer change: the cantilever's tip
0.9145 (where the Galerkin form and felupe's Q2/P1 go, see test_warnings); the tube's pressure on
its inner wall -15.588823 N/cm² at K = 1e3 from the boundary value problem of the radius; the near
shear's force 247.93 N. Homogeneous states are exact.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork import Scene
from myork.core.states import States
from myork.stations.solve import find_executable

GAUSS = (
    "scene.method=rkpm-gauss", "approximation.order=1", "approximation.support=2",
    "approximation.kernel=cubic", "galerkin.gauss=2",
)  # fmt: skip
CANTILEVER: dict[str, Any] = {
    "scene": {"dimension": 2},
    "geometry": {"kind": "box", "size": [4, 1], "source": [17, 5], "collocation": [33, 9]},
    "material": [{"name": "rubber", "model": "polynomial", "A10": 37.3, "K": 1e3}],
    "boundary": [{"set": "x0", "u_x": 0, "u_y": 0}, {"set": "x1", "traction": [0, 1]}],
    "load": {"steps": 2},
    "probe": [
        {"name": "tip", "quantity": "u_y", "point": [4, 0.5]},
        {"name": "root", "quantity": "force", "set": "x0"},
    ],
}
TIP = 0.9145


def size(*source: int) -> tuple[str, str]:
    """Source points, and collocation points at half their distance."""
    other = [2 * n - 1 for n in source]
    return f"geometry.source={list(source)}", f"geometry.collocation={other}"


def solved(deck: Any, overrides: tuple[str, ...], **how: Any) -> tuple[States, dict[str, Any]]:
    """States, and the last values of the probes by name with their bars."""
    make = Scene if isinstance(deck, Path) else Scene.from_tables
    with make(deck, overrides=overrides, threads=1) as scene:
        states = scene.solve(**how)
        values = scene.probes(states.x, states.load)[-1]
        names = [probe["name"] for probe in scene.deck["probe"]]
    bars = states.probe_errors[-1]
    return states, {name: (values[i], bars[i]) for i, name in enumerate(names)}


@pytest.mark.parametrize("method", ["rkcm", "rkcm-mixed"])
def test_collocation_that_bends_is_refused(method: str) -> None:
    """Its bar reaches the truth, 80 to 95 % away; a finer cloud would not have told."""
    states, found = solved(CANTILEVER, (f"scene.method={method}", *size(33, 9)))
    assert states.verdict == "refused"
    tip, bar = found["tip"][0][0], found["tip"][1][0]
    assert tip < 0.3 * TIP < TIP < tip + bar


def test_the_weak_form_that_bends_is_accepted() -> None:
    states, found = solved(CANTILEVER, (*GAUSS, *size(33, 9)))
    assert states.verdict == "accepted" and not states.reasons
    tip, bar = found["tip"][0][0], found["tip"][1][0]
    assert abs(tip - TIP) < bar < 0.02 * TIP
    assert np.all(np.abs(found["root"][0] - [0, -1, 0]) <= found["root"][1])


def test_a_muscle_that_locks_is_refused(inputs: Path) -> None:
    """Its stress is right and its forces balance: only the displacements tell."""
    overrides = ("scene.method=rkcm", "load.steps=2", *size(5, 5, 9))
    states, _ = solved(inputs / "muscle_block.toml", overrides)
    assert states.verdict == "refused" and states.force_imbalance < 1e-10


@pytest.mark.parametrize(
    ("deck", "overrides", "reference"),
    [
        ("uniaxial_tension", ("scene.method=rkcm",), {"stress": 107185.0}),
        ("uniaxial_tension", GAUSS, {"stress": 107185.0}),
        ("uniaxial_compression", ("scene.method=rkcm-mixed",), {"stress": -7309.62}),
        ("shear_2d", ("scene.method=rkcm-mixed", *size(17, 5)), {"top_force": 247.93}),
        ("shear_2d", (*GAUSS, *size(17, 5)), {"top_force": 247.93}),
        (
            "tube",
            ("scene.method=rkcm-mixed", *size(5, 26), "material.K=1e3"),
            {"radial_stress": -15.588823},
        ),
    ],
)
def test_right_answers_are_accepted_and_covered(
    inputs: Path, deck: str, overrides: tuple[str, ...], reference: dict[str, float]
) -> None:
    states, found = solved(inputs / f"{deck}.toml", overrides)
    assert states.verdict == "accepted", states.reasons
    for name, wanted in reference.items():
        value, bar = found[name][0][0], found[name][1][0]
        assert abs(value / wanted - 1) < 0.02
        assert abs(value - wanted) <= bar


def test_a_stress_at_the_surface_that_is_off_is_not_accepted(inputs: Path) -> None:
    """Order 1 has the pressure on the wall of the tube 10 % too low."""
    overrides = (*GAUSS, *size(9, 51), "material.K=1e3")
    states, found = solved(inputs / "tube.toml", overrides)
    (value, *_), (bar, *_) = found["radial_stress"]
    assert abs(value / -15.588823 - 1) > 0.08
    assert states.verdict == "doubtful" and abs(value + 15.588823) < 1.05 * bar


def test_without_a_second_solution_nothing_is_silent(tmp_path: Path, inputs: Path) -> None:
    """No bars, and a note in the place of the reasons, however the run was started."""
    deck, overrides = inputs / "shear_2d.toml", (*GAUSS, *size(9, 5))
    states, found = solved(deck, overrides, error=False)
    assert np.isnan(found["top_force"][1]).all()
    assert states.reasons == ["no error estimate: no second solution was wanted"]
    words = [word for text in overrides for word in ("--set", text)]
    subprocess.run(
        [find_executable(), deck, "-o", tmp_path, "-q", "--no-error", *words], check=True
    )
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["verdict"] == {"state": states.verdict, "reasons": states.reasons}
    assert summary["steps"][-1]["probe_errors"] == {} and "companion" not in summary


def test_bars_of_steps_grow_with_the_load() -> None:
    states, _ = solved(CANTILEVER, (*GAUSS, *size(17, 5)))
    first, last = states.probe_errors[:, 0, 0]
    assert first == pytest.approx(0.5 * last)


def test_two_runs_have_the_same_bars() -> None:
    one, two = (solved(CANTILEVER, (*GAUSS, *size(9, 5)))[0].probe_errors for _ in range(2))
    np.testing.assert_array_equal(one, two)


def test_bars_of_linear_problems_are_their_errors(inputs: Path) -> None:
    """3P/(2D) = 75 N/m² in the middle of the cantilever, and the force -P."""
    overrides = ("geometry.source=[17,5]", "geometry.collocation=[33,9]")
    states, found = solved(inputs / "cantilever.toml", overrides)
    (stress, *_), (bar, *_) = found["shear_stress"]
    assert abs(stress - 75) == pytest.approx(bar)
    assert states.verdict != "accepted" and abs(stress / 75 - 1) > 0.05
