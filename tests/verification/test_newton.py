"""Gauss-Newton where residuals remain, and where it ends."""

from pathlib import Path

import numpy as np
import pytest

from myork.errors import ConvergenceError
from tests.scenes import execute, history, solved

#: Contraction at which the strain beside the clamped edges leaves large residuals
EDGES = (
    "scene.method=rkcm-mixed", "approximation.order=2", "approximation.support=3",
    "geometry.source=[4,4,7]", "geometry.collocation=[7,7,13]", "material.curve=smooth",
    "load.steps=4", "load.activation=0.2",
)  # fmt: skip


@pytest.mark.slow
def test_steps_shrink_by_one_factor(inputs: Path, tmp_path: Path) -> None:
    """Convergence is linear: what is left at the end is the tolerance times rate/(1 - rate)."""
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
    """Fibers on the kink of the published curve make a cycle: it ends, with a cure."""
    overrides = [
        "scene.method=rkcm", "approximation.order=2", "approximation.support=3",
        "geometry.source=[5,5,9]", "geometry.collocation=[9,9,17]", "material.curve=published",
        "solver.max_iterations=60",
    ]  # fmt: skip
    with pytest.raises(ConvergenceError, match='curve = "smooth"') as caught:
        solved(inputs / "muscle_fibers.toml", *overrides)
    assert "load 0.0833" in str(caught.value)
