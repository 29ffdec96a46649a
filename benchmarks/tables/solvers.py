"""Solvers of least squares on one system of equations."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.runs import PUBLISHED_BLOCK
from myork import run_deck
from myork.errors import ConvergenceError
from myork.files import INPUTS


def solvers() -> Iterator[tuple[str, ...]]:
    """Each solver on the equations of the muscle block by collocation (docs/solvers.md).

    CPU seconds of the first iteration of a load step, and what the summary reports of it.
    """
    yield "solver", "s", "times `dgels`", "backward error", "distance", "condition"
    words = (*PUBLISHED_BLOCK, "scene.method=rkcm", "approximation.order=2",
             "approximation.support=3", "load.steps=10", "load.max_halvings=0",
             "solver.max_iterations=1")  # fmt: skip
    dgels = 0.0
    for name in ("dgels", "auto", "refined", "normal"):
        with TemporaryDirectory() as folder:
            with suppress(ConvergenceError):
                run_deck(INPUTS / "muscle_block.toml", folder, threads=1, error=False,
                         overrides=(*words, f"solver.linear={name}"))  # fmt: skip
            case = json.loads(Path(folder, "summary.json").read_text(encoding="utf-8"))
        said, times = case["solver"], case["timings_s"]
        # parts are wall times, of which the process had only a share
        spent = case["cpu_s"] * times["solve"] / times["total"]
        dgels = dgels or spent
        found = (said["backward_error"], said["misfit"], said["reciprocal_condition"])
        yield f"`{name}`", f"{spent:.2f}", f"{dgels / spent:.1f}", *(f"{one:.3e}" for one in found)
