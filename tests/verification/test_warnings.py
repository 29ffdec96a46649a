"""Warnings and checks are the same in memory, through `run_deck` and by the executable itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork import Scene, run_deck
from myork.core.states import States
from myork.errors import ConvergenceError, InputError, MyorkError, RefusedError
from tests.scenes import execute

SMALL_MUSCLE = (
    "geometry.source=[3,3,5]", "geometry.collocation=[5,5,9]", "load.steps=2",
    "load.activation=0.3",
)  # fmt: skip

#: Deck, overrides, verdict, a part of each warning in its order, and the error that ends the run
CASES: dict[
    str, tuple[str, tuple[str, ...], str, tuple[str, ...], type[MyorkError] | None]
] = {
    "stiff, and right in the displacement form": (
        "uniaxial_tension",
        ("scene.method=rkcm", "geometry.source=[3,3,3]", "geometry.collocation=[5,5,5]"),
        "accepted",
        (),
        None,
    ),
    "too stiff for the displacement form": (
        "shear_3d",
        ("scene.method=rkcm", "material.K=1e4", "geometry.source=[3,3,3]",
         "geometry.collocation=[5,5,5]", "load.steps=2"),
        "refused",
        ("more work than the forces", "probe top_force is"),
        RefusedError,
    ),
    "a coarse tube": (
        "tube",
        ("scene.method=rkcm", "geometry.source=[3,9]", "geometry.collocation=[5,17]",
         "load.steps=4"),
        "refused",
        ("do not balance", "of their norm from", "probe radial_stress differs"),
        RefusedError,
    ),
    "unbalanced forces of the mixed form": (
        "tube",
        ("scene.method=rkcm-mixed", "geometry.source=[3,7]", "geometry.collocation=[5,13]",
         "load.steps=4"),
        "refused",
        ("do not balance", "of the volume J is", "probe radial_stress differs"),
        RefusedError,
    ),
    "ellipticity, mixed form": (
        "muscle_fibers",
        (*SMALL_MUSCLE, "scene.method=rkcm-mixed", "approximation.order=2",
         "approximation.support=3"),
        "refused",
        ("loses ellipticity at", "less work than the forces", "of the volume J is",
         "of their norm from", "probe stress_zz differs"),
        RefusedError,
    ),
    "ellipticity, nodal integration": (
        "muscle_fibers",
        (*SMALL_MUSCLE, "geometry.source=[5,5,9]", "scene.method=rkpm-scni",
         "approximation.order=1", "approximation.support=2"),
        "doubtful",
        ("loses ellipticity at", "J at points is",
         "of its size from a solution with [3,3,5] points"),
        None,
    ),
    "ended early": (
        "shear_2d",
        ("load.steps=2", "load.max_halvings=0", "solver.max_iterations=3"),
        "refused",
        ("did not converge at load 0.5",),
        ConvergenceError,
    ),
    "a linear problem with too few equations": (
        "poisson_2d",
        ("geometry.source=[9,9]", "geometry.collocation=[5,5]"),
        "refused",
        ("fewer equations (25) than unknowns (81)",),
        InputError,
    ),
}  # fmt: skip


def none_if_nan(value: float) -> float | None:
    """A number that may be missing."""
    return None if np.isnan(value) else value


def in_memory(deck: Path, overrides: tuple[str, ...]) -> tuple[States, type[MyorkError] | None]:
    """States, and the error where the run did not get to its end."""
    with Scene(deck, overrides, threads=1) as scene:
        try:
            return scene.solve(), None
        except MyorkError as ended:
            assert scene.states is not None
            return scene.states, type(ended)


def by_executable(deck: Path, overrides: tuple[str, ...], out: Path) -> dict[str, Any]:
    return execute(deck, out, "-q", sets=overrides)[0]


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_all_ways_give_the_same_list(case: str, inputs: Path, tmp_path: Path) -> None:
    name, overrides, verdict, parts, error = CASES[case]
    deck = inputs / f"{name}.toml"
    states, ended_by = in_memory(deck, overrides)
    warnings = states.warnings
    # a refused answer is one, and whole: nothing is raised where it is at hand
    assert ended_by is (None if error is RefusedError else error)
    assert states.verdict == verdict, states.reasons
    assert len(warnings) == len(parts), warnings
    assert all(part in text for part, text in zip(parts, warnings, strict=True)), warnings
    summary = by_executable(deck, overrides, tmp_path / "executable")
    assert summary["warnings"] == warnings
    assert summary["verdict"] == {"state": verdict, "reasons": states.reasons}
    ended = None
    try:
        run_deck(deck, tmp_path / "run", overrides=overrides, threads=1, verbosity=-1)
    except MyorkError as reason:
        ended = reason
    assert (None if ended is None else type(ended)) is error
    if error is RefusedError:
        assert all(reason in str(ended) for reason in states.reasons)
    through = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    assert through["warnings"] == warnings
    # the file has all digits of a number
    assert states.force_imbalance == summary["force_imbalance"]
    assert summary.get("work_mismatch") == none_if_nan(states.work_mismatch)
    for k, step in enumerate(summary["steps"]):
        assert states.min_acoustic[k] == step["min_acoustic"]["value"]
        assert states.min_acoustic_point[k].tolist() == step["min_acoustic"]["point"]


def test_errors_of_a_linear_problem(inputs: Path, tmp_path: Path) -> None:
    overrides = ("geometry.source=[9,9]", "geometry.collocation=[17,17]")
    states, _ = in_memory(inputs / "poisson_2d.toml", overrides)
    summary = by_executable(inputs / "poisson_2d.toml", overrides, tmp_path)
    assert states.warnings == summary["warnings"] == []
    assert set(states.errors) == {"L2", "H1", "relative_L2", "relative_H1"}
    assert states.errors == summary["errors"]
    assert states.force_imbalance == 0
    assert np.isnan(states.min_acoustic).all() and np.isnan(states.min_acoustic_point).all()


def test_warnings_are_those_of_the_last_solve(inputs: Path) -> None:
    """A reduced model has no checks of its own."""
    overrides = CASES["a coarse tube"][1]
    with Scene(inputs / "tube.toml", overrides, threads=1) as scene:
        full = scene.solve()
        assert len(full.warnings) == 3 and full.checks_s > 0
        scene.reduce(np.linalg.qr(full.x.T)[0])
        reduced = scene.solve_reduced("dgels")
        assert reduced.warnings == [] and reduced.checks_s == 0
        assert reduced.verdict == "" and reduced.reasons == []
        assert np.isnan(reduced.min_acoustic).all()


@pytest.mark.slow
def test_homogeneous_states_balance_their_work(inputs: Path) -> None:
    """The rows vanish at the solution and Simpson's rule is exact.

    What remains is the rounding of the state, 1e-13, times K over the shear modulus, 1.3e6, times
    the stretch to the power of three.
    """
    with Scene(inputs / "uniaxial_tension.toml", ("load.steps=5",), threads=1) as scene:
        assert abs(scene.solve().work_mismatch) < 1e-5
