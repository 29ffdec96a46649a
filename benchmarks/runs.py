"""One solve of a deck in a process of its own, under a time limit, as one record.

A benchmark must survive what it measures: a crash, a hang or a refusal is an outcome like any
other.
"""

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from myork.bench.runs import Deck, path_of
from myork.core.cloud import with_cloud
from myork.core.deck import text_of_tables
from myork.errors import InputError
from myork.model_file import write_model
from myork.records import PointCloud
from myork.stations.solve import find_executable
from myork.summary import readable_summary

#: The two formulations of the collocation
METHODS = ("rkcm", "rkcm-mixed")

#: Row weights and curve that the reference has for the muscle block; its deck names no method
PUBLISHED_BLOCK = (
    'solver.weight_essential="ns-c4"',
    "solver.weight_traction=1",
    'material.curve="published"',
)

_KEPT = (
    "title", "method", "dimension", "solver", "source_points", "collocation_points", "dofs", "rows",
    "threads", "converged", "exact", "errors", "reference", "timings_s", "cpu_s",
    "memory_peak_bytes", "verdict", "companion", "work_mismatch", "warnings",
)  # fmt: skip


def _run(words: Sequence[str | Path], limit: float) -> tuple[str, str, float]:
    """Run a command with one thread; it is ended after a wall time of `limit` [s].

    Returns outcome (`done`, `not converged`, `refused`, `failed`, `crashed` or `time limit`), what
    it said on its error output, or its last lines, and wall time [s].
    """
    one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    started = time.perf_counter()
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
        return "time limit", f"not finished within {limit:g} s", limit
    seconds = time.perf_counter() - started
    outcomes = {0: "done", 1: "not converged", 2: "refused"}
    outcome = "crashed" if done.returncode < 0 else outcomes.get(done.returncode, "failed")
    message = done.stderr.strip() or "\n".join(done.stdout.strip().splitlines()[-2:])
    if done.returncode < 0:
        message = f"{signal.Signals(-done.returncode).name} {message}"
    return outcome, message, seconds


def solve_case(
    deck: Deck,
    overrides: Sequence[str] = (),
    *,
    cloud: PointCloud | None = None,
    limit: float = 600.0,
    look: Callable[[Path], Mapping[str, Any]] | None = None,
    error: bool = False,
) -> dict[str, Any]:
    """Solve a deck with one thread and record what the summary says.

    - `deck`: deck file, the name of one in `INPUTS`, or tables
    - `overrides`: `"table.key=value"` each
    - `cloud`: points of the body, where the tables want a model
    - `limit`: wall time after which the run is ended [s]
    - `look`: called with the folder of the results before it is removed, if a step converged; what
      it returns joins the record
    - `error`: compute a second solution for the error bars; its time is in that of the process
    - returns `deck`, `overrides`, `outcome`, `message`, `seconds` (wall time of the process), and
      of a solve that took place the sizes, solver, timings, verdict and `iterations`, `min_J`,
      `max_J`, `load` (reached), `probes` and `probe_errors` (by name, at the load reached),
      `history` (probes, activation and range of J in all steps)
    """
    with tempfile.TemporaryDirectory(prefix="myork-bench-") as folder:
        if isinstance(deck, Mapping):
            path = Path(folder) / "deck.toml"
            tables = deck if cloud is None else with_cloud(deck, cloud)
            path.write_text(text_of_tables(tables), encoding="utf-8")
        else:
            path = path_of(deck)
        words: list[str | Path] = [find_executable(), path, "-o", folder, "-t", "1", "-q"]
        if not error:
            words.append("--no-error")
        for override in overrides:
            words += ["--set", override]
        try:
            if cloud is not None:
                write_model(Path(folder) / "model.h5", cloud)
            outcome, message, seconds = _run(words, limit)
        except InputError as error:
            outcome, message, seconds = "refused", str(error), 0.0
        summary = readable_summary(Path(folder))
        # an answer that is refused converged none the less, and its numbers are on record
        if outcome == "done" or (outcome == "not converged" and summary.get("converged")):
            outcome = "converged"
        seen = look(Path(folder)) if look and summary.get("steps") else {}
    case: dict[str, Any] = {
        "deck": deck.get("title") if isinstance(deck, Mapping) else path.stem,
        "overrides": list(overrides),
        "outcome": outcome,
        "message": message,
        "seconds": seconds,
        **{key: summary[key] for key in _KEPT if key in summary},
    }
    case.update(seen)
    steps = summary.get("steps") or []
    if steps:
        case["iterations"] = sum(step["iterations"] for step in steps)
        # states of linear problems have none
        for key, most in (("min_J", min), ("max_J", max)):
            known = [step[key] for step in steps if step[key] is not None]
            case[key] = most(known, default=None)
        case["load"] = steps[-1]["load"]
        case["probes"] = steps[-1]["probes"]
        case["probe_errors"] = steps[-1].get("probe_errors", {})
        kept = ("load", "activation", "iterations", "probes", "min_J", "max_J")
        case["history"] = [{key: step[key] for key in kept} for step in steps]
    return case


def outcome_text(case: Mapping[str, Any]) -> str:
    """Outcome of a case; where it did not converge, how far it came."""
    if case["outcome"] != "not converged":
        return str(case["outcome"])
    return f"not converged, load {case.get('load', 0.0):.3g}"
