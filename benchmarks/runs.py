"""One solve of a deck in a separate process, under a time limit, as one record.

A benchmark must survive its subject: a crash, a hang or a refusal is an outcome like any
other.
"""

import os
import signal
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from myork.core.cloud import with_cloud
from myork.core.deck import text_of_tables
from myork.errors import InputError
from myork.model_file import write_model
from myork.records import PointCloud
from myork.stations.solve import find_executable
from myork.summary import readable_summary

#: The two formulations of collocation
METHODS = ("rkcm", "rkcm-mixed")

#: Row weights and curve of the reference for the muscle block; its deck names no method
PUBLISHED_BLOCK = (
    'solver.weight_essential="ns-c4"',
    "solver.weight_traction=1",
    'material.curve="published"',
)

_KEPT = ("method", "dofs", "converged", "cpu_s", "memory_peak_bytes", "verdict", "companion")


def _run(words: Sequence[str | Path], limit: float) -> tuple[str, str]:
    """Run a command with one thread; it is stopped after a wall time of `limit` [s].

    Returns outcome (`done`, `not converged`, `refused`, `failed`, `crashed` or `time limit`), and
    its error output or last lines.
    """
    one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [str(word) for word in words],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            env={**os.environ, **one},
            timeout=limit,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "time limit", f"not finished within {limit:g} s"
    message = done.stderr.strip() or "\n".join(done.stdout.strip().splitlines()[-2:])
    if done.returncode < 0:
        return "crashed", f"{signal.Signals(-done.returncode).name} {message}"
    return {0: "done", 1: "not converged", 2: "refused"}.get(done.returncode, "failed"), message


def solve_case(
    tables: Mapping[str, Any],
    overrides: Sequence[str] = (),
    *,
    cloud: PointCloud | None = None,
    limit: float = 600.0,
) -> dict[str, Any]:
    """Solve a deck and its second solution with one thread, and record the entries of the summary.

    - `overrides`: `"table.key=value"` each
    - `cloud`: points of the body, for tables that need a model
    - `limit`: wall time after which the run is stopped [s]
    - returns `outcome`, `message`, and of a solve that took place `_KEPT`, `load` (reached),
      `probes` and `probe_errors` (by name, at the load reached)
    """
    with tempfile.TemporaryDirectory(prefix="myork-bench-") as folder:
        path = Path(folder) / "deck.toml"
        if cloud is not None:
            tables = with_cloud(tables, cloud)
        path.write_text(text_of_tables(tables), encoding="utf-8")
        words: list[str | Path] = [find_executable(), path, "-o", folder, "-t", "1", "-q"]
        for override in overrides:
            words += ["--set", override]
        try:
            if cloud is not None:
                write_model(Path(folder) / "model.h5", cloud)
            outcome, message = _run(words, limit)
        except InputError as error:
            outcome, message = "refused", str(error)
        summary = readable_summary(Path(folder))
    # a refused answer has converged all the same, and its numbers are on record
    if outcome == "done" or (outcome == "not converged" and summary.get("converged")):
        outcome = "converged"
    case: dict[str, Any] = {"outcome": outcome, "message": message}
    case |= {key: summary[key] for key in _KEPT if key in summary}
    steps = summary.get("steps") or []
    if steps:
        case |= {key: steps[-1][key] for key in ("load", "probes")}
        case["probe_errors"] = steps[-1].get("probe_errors", {})
    return case


def outcome_text(case: Mapping[str, Any]) -> str:
    """Outcome of a case; without convergence, also the load reached."""
    if case["outcome"] != "not converged":
        return str(case["outcome"])
    return f"not converged, load {case.get('load', 0.0):.3g}"
