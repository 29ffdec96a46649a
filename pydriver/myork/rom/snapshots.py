"""States of the full model: those of a solve that has been made, or of one that is made now."""

import time
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import myork
from myork.console import ProgressCallback
from myork.core.cloud import model_path
from myork.core.scene import Scene
from myork.errors import InputError, MyorkError
from myork.results import Results
from myork.summary import read_summary
from myork.tables import differing_keys, in_words
from myork.types import F64

# Two builds of one version evaluate a state alike to rounding times the condition of the rows.
_ALIKE = 1e-8


class States(NamedTuple):
    """Converged states of the full model at all load steps."""

    x: F64  #: Unknowns, shape `(nstep, dofs)`
    load: F64  #: Fraction of the full load, shape `(nstep,)`
    iterations: list[int]  #: Iterations of each step
    seconds: float  #: Wall time of the load steps, without shape functions and output [s]
    origin: str  #: File that the states were read from; empty where they were solved for


def full_states(scene: Scene, out: Path, threads: int, progress: ProgressCallback) -> States:
    """States of the full model, from the results in a folder where they are those of the scene.

    - `scene`: the full model
    - `out`: folder in which an earlier solve may have left `results.vtkhdf` and `summary.json`
    - `threads`: number of threads; a solve with another number has other timings
    """
    try:
        found = _of_folder(scene, out, threads)
    except (MyorkError, OSError, LookupError, ValueError, TypeError, AttributeError) as reason:
        progress(f"full model is solved: the results in {out} cannot be used: {reason}")
    else:
        progress(f"full model: {len(found.x)} states of {found.origin}")
        return found
    started = time.perf_counter()
    states = scene.solve(progress=progress, error=False)
    # a reduced state is not looked at for what deserves a warning
    # nor is the largest stable time step of a motion looked for
    seconds = time.perf_counter() - started - states.checks_s
    if "dynamics" in scene.deck:
        seconds = states.solve_s
    for text in states.warnings:
        progress(f"warning: {text}")
    return States(states.x, states.load, states.iterations.tolist(), seconds, "")


def _of_folder(scene: Scene, out: Path, threads: int) -> States:
    """States in a folder, of this very version and number of threads."""
    summary = solution_of(out)
    for key, value in {"version": myork.__version__, "threads": threads}.items():
        if summary.get(key) != value:
            raise InputError(f"the solution has {key} {summary.get(key)}, not {value}")
    x, load, steps = stored_states(scene, out, summary, apart={"rom"})
    model = model_path(scene.deck, Path(scene.deck["folder"]), out)
    results = out / "results.vtkhdf"
    if model is not None and model.stat().st_mtime > results.stat().st_mtime:
        raise InputError(f"{model} is newer than the solution")
    if len(x) != scene.steps:
        raise InputError(f"{len(x)} load steps, not {scene.steps}")
    timings = summary["timings_s"]
    return States(
        x,
        load,
        [int(step["iterations"]) for step in steps],
        timings["total"] - timings["shape"] - timings["output"],
        results.name,
    )


def solution_of(folder: Path) -> dict[str, Any]:
    """Summary of the solve in a folder; refused where there is none that converged."""
    summary = read_summary(folder)
    if not summary:
        raise InputError(f"{folder}: there is no summary.json; give a folder of `myork solve`")
    if not summary.get("converged"):
        raise InputError(f"{folder}: the solve in it did not converge")
    return summary


def stored_states(
    scene: Scene,
    folder: Path,
    summary: dict[str, Any],
    tables: Collection[str] | None = None,
    apart: Collection[str] = (),
) -> tuple[F64, F64, list[dict[str, Any]]]:
    """Unknowns and loads of all load steps of the solve in a folder, and their entries.

    - `scene`: the scene whose states they are to be
    - `folder`: output folder of a solve
    - `summary`: its summary, from `solution_of`
    - `tables`, `apart`: what the decks must have in common, as `differing_keys` takes it
    - raises InputError: they are of another deck, of other points or of other materials
    """
    different = differing_keys(summary["deck"], scene.deck, tables, apart)
    if different:
        raise InputError(
            f"{folder}: its solution is of another deck, which differs in {in_words(different)}"
        )
    with Results(folder) as results:
        # step 0 is the undeformed body; loads of references lie between the steps
        steps = [i for i, step in enumerate(summary["steps"], 1) if step.get("planned", True)]
        states = [results.restart(i) for i in steps]
        x = np.array([scene.unknowns_of(state) for state in states])
        fields = scene.fields(x[-1], states[-1].load).named
        for name in {"u", "principal_stress"} & fields.keys() & set(results.fields):
            old, new = results.field(name, steps[-1]), fields[name]
            if np.abs(old - new).max() > _ALIKE * np.abs(old).max():
                raise InputError(f"{results.path} is not of these points and materials")
    load = np.array([state.load for state in states])
    return x, load, [summary["steps"][i - 1] for i in steps]
