"""States of the full model: those of a solve that has been made, or of one that is made now."""

from __future__ import annotations

import time
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import myork
from myork.console import ProgressCallback
from myork.core.cloud import model_path
from myork.core.scene import Scene
from myork.errors import MyorkError
from myork.results import Results
from myork.rom.decks import differing_keys, in_words
from myork.rom.probes import named_probes
from myork.summary import read_summary
from myork.types import F64

__all__ = ["Snapshots", "full_states"]

# Two builds of one version evaluate a state alike to rounding times the condition of the rows.
_ALIKE = 1e-8


class Snapshots(NamedTuple):
    """Converged states of the full model at all load steps.

    Attributes
    ----------
    x : F64
        Unknowns, shape `(nstep, dofs)`.
    load : F64
        Fraction of the full load, shape `(nstep,)`.
    iterations : list of int
        Iterations of each step.
    seconds : float
        Wall time of the load steps, without shape functions and output [s].
    origin : str
        File that the states were read from; empty where they were solved for.
    """

    x: F64
    load: F64
    iterations: list[int]
    seconds: float
    origin: str


class _Unusable(Exception):
    """Why states of an earlier solve are not those of this scene."""


def full_states(
    scene: Scene, out: Path, hashes: Collection[str], threads: int, progress: ProgressCallback
) -> Snapshots:
    """States of the full model, from the results in a folder where they are those of the scene.

    Parameters
    ----------
    scene : Scene
        The full model.
    out : Path
        Folder in which an earlier solve may have left `results.vtkhdf` and `summary.json`.
    hashes : collection of str
        SHA-256 of the decks, overrides included, whose solution this is.
    threads : int
        Number of threads; a solve with another number has other timings.
    progress : callable
        Called with every line of progress.
    """
    try:
        found = _stored(scene, out, hashes, threads)
    except _Unusable as reason:
        progress(f"full model is solved: {reason}")
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
    return Snapshots(states.x, states.load, states.iterations.tolist(), seconds, "")


def _stored(scene: Scene, out: Path, hashes: Collection[str], threads: int) -> Snapshots:
    """States in a folder; whatever does not belong to this scene is refused."""
    summary = read_summary(out)
    if not summary:
        raise _Unusable(f"there is no solution in {out}")
    wanted = {"converged": True, "version": myork.__version__, "threads": threads}
    for key, value in wanted.items():
        if summary.get(key) != value:
            raise _Unusable(f"the solution in {out} has {key} {summary.get(key)}, not {value}")
    if summary["deck_sha256"] not in hashes:
        # what the table [rom] says makes no other full model
        different = differing_keys(summary.get("deck", {}), scene.deck, apart={"rom"})
        raise _Unusable(
            f"the solution in {out} is of another deck, which differs in "
            + (in_words(different) or "its text, in no value")
        )
    with Results(out) as results:
        model = model_path(scene.deck, Path(scene.deck["folder"]), out)
        if model is not None and model.stat().st_mtime > results.path.stat().st_mtime:
            raise _Unusable(f"{model} is newer than the solution in {out}")
        # step 0 is the undeformed body; loads of references lie between the steps
        steps = [i for i, step in enumerate(summary["steps"], 1) if step.get("planned", True)]
        states = [results.restart(i) for i in steps]
        last = summary["steps"][steps[-1] - 1]
        found = Snapshots(
            x=np.array([state.coefficients for state in states]),
            load=np.array([state.load for state in states]),
            iterations=[int(summary["steps"][i - 1]["iterations"]) for i in steps],
            seconds=_seconds(summary["timings_s"]),
            origin=results.path.name,
        )
        if found.x.shape != (scene.steps, scene.dofs):
            raise _Unusable(f"the solution in {out} has states of shape {found.x.shape}")
        _check(scene, found, results, last["probes"])
    return found


def _seconds(timings: dict[str, float]) -> float:
    """Wall time of the load steps of a solve [s]."""
    return timings["total"] - timings["shape"] - timings["output"]


def _check(scene: Scene, found: Snapshots, results: Results, probes: dict[str, Any]) -> None:
    """Refuse states that mean something else in this scene than they did when they were written."""
    x, load = found.x[-1:], found.load[-1:]
    fields = scene.fields(x[0], load[0])
    cauchy = results.field("cauchy")[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    points = results.points[:, : scene.dimension]
    here = named_probes(scene, x, load)
    pairs = [(points, scene.points()), (results.field("u"), fields.u), (cauchy, fields.cauchy)]
    pairs += [(np.array(probes[name]), np.array(values[0])) for name, values in here.items()]
    for old, new in pairs:
        if old.shape != new.shape or np.abs(old - new).max() > _ALIKE * np.abs(old).max():
            raise _Unusable(f"{results.path} is not of these points and materials")
